//! Many at once: processes that draw a file while it is replaced again and again, and threads that share an opened file.
//!
//! OCTRACE_ROUNDS says how often the file is replaced (8 if it does not).

#[path = "cli_tools/support.rs"]
#[allow(dead_code, unused_macros, unused_imports)]
mod support;

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use octrace::geometry::{Hit, Ray};
use octrace::map::{Octree, Read};
use octrace::trace::{OctreeTracer, Order, Tracer};
use support::*;

/// Processes that draw at a time.
const PAINTERS: usize = 3;

fn rounds() -> usize {
    std::env::var("OCTRACE_ROUNDS").map_or(8, |text| text.parse().expect("OCTRACE_ROUNDS is a number"))
}

#[test]
fn a_file_that_is_replaced_while_it_is_drawn_gives_one_picture_or_the_other() {
    let lab = Lab::new();
    lab.write("a.obj", ball(60, 40));
    lab.write("b.obj", ball(24, 200));
    // Pages of other sizes, and packed ones: whatever is asked before the file is opened may be of the other.
    let builds = [
        ["a.obj", "-o", "m.oct", "-q", "--brick=300"],
        ["b.obj", "-o", "m.oct", "-q", "--brick=20000"],
        ["a.obj", "-o", "m.oct", "-q", "--compress=zstd"],
    ];
    let ways = [&["--threads", "1"][..], &["--memory", "128M", "--threads", "2"], &["--lod", "1"]];
    let draw = |way: &[&str], name: &str| {
        lab.done("octrender", &[&["m.oct", "--size", "40x30", "-q", "-o", name], way].concat());
        lab.read(name)
    };
    let mut right = vec![Vec::new(); ways.len()];
    for build in &builds {
        lab.done("octbuild", build);
        right.iter_mut().zip(ways).for_each(|(right, way)| right.push(draw(way, "right.png")));
    }
    assert!(right.iter().all(|right| right[0] != right[1]), "the pictures do not tell the files apart");
    let (over, drawn) = (AtomicBool::new(false), AtomicUsize::new(0));
    std::thread::scope(|scope| {
        for painter in 0..PAINTERS {
            let (right, over, drawn, draw) = (&right[painter], &over, &drawn, &draw);
            scope.spawn(move || {
                while !over.load(Ordering::Relaxed) {
                    let picture = draw(ways[painter], &format!("{painter}.png"));
                    assert!(right.contains(&picture), "painter {painter} made a picture of neither file");
                    drawn.fetch_add(1, Ordering::Relaxed);
                }
            });
        }
        let replaced = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
            for round in 0..rounds() {
                lab.done("octbuild", &builds[round % builds.len()]);
            }
        }));
        over.store(true, Ordering::Relaxed);
        replaced.unwrap();
    });
    println!("{} pictures while the file was replaced {} times", drawn.load(Ordering::Relaxed), rounds());
    assert!(drawn.load(Ordering::Relaxed) >= PAINTERS);
    assert!(lab.files().iter().all(|name| !name.starts_with('.')), "{:?}", lab.files());
}

/// Rays from all around through the ball.
fn rays(seed: usize) -> Vec<Ray> {
    let at = |k: usize| {
        let (s, c) = (k as f32 * 0.37).sin_cos();
        [3.0 * c, 2.0 * (k as f32 * 0.11).sin(), 3.0 * s]
    };
    let ray = |k: usize| {
        let [from, to] = [at(7 * k + seed), at(13 * k + 3 * seed + 5)];
        Ray::new(from, std::array::from_fn(|i| 0.2 * to[i] - from[i]))
    };
    (0..400).map(ray).collect()
}

#[test]
fn threads_share_an_opened_file() {
    let lab = Lab::new();
    lab.write("a.obj", ball(90, 60));
    lab.done("octbuild", &["a.obj", "-o", "a.oct", "-q", "--brick", "200"]);
    lab.done("octbuild", &["a.obj", "-o", "p.oct", "-q", "--brick", "200", "--compress=zstd"]);
    let trace = |octree: &Octree, order: Order, seed: usize| {
        let (rays, tracer) = (rays(seed), OctreeTracer::new(octree).with_order(order));
        let (mut hits, mut blocked) = (vec![Hit::MISS; rays.len()], vec![false; rays.len()]);
        tracer.closest_batch(&rays, &mut hits).unwrap();
        tracer.any_batch(&rays, &mut blocked).unwrap();
        assert!(hits.iter().zip(&blocked).all(|(hit, blocked)| hit.is_hit() == *blocked));
        hits
    };
    let alone = Octree::open(&lab.path("a.oct")).unwrap();
    let right: Vec<Vec<Hit>> = (0..8).map(|seed| trace(&alone, Order::Single, seed)).collect();
    assert!(right.iter().all(|hits| hits.iter().filter(|hit| hit.is_hit()).count() > 100));
    for name in ["a.oct", "p.oct"] {
        let path = lab.path(name);
        let least = Octree::least_cache(&path).unwrap();
        for read in [Read::Mapped, Read::Budgeted { cache: least }, Read::Budgeted { cache: 4 * least }] {
            if read == Read::Mapped && name == "p.oct" {
                continue;
            }
            let shared = Octree::open_with(&path, read).unwrap();
            std::thread::scope(|scope| {
                for thread in 0..8 {
                    let (shared, trace, right, path) = (&shared, &trace, &right, &path);
                    scope.spawn(move || {
                        for round in 0..4 {
                            let seed = (thread + round) % right.len();
                            let order = [Order::Single, Order::Flight, Order::Packet][(thread + round) % 3];
                            assert!(trace(shared, order, seed) == right[seed], "{read:?} {order:?}");
                            // Others open and close it meanwhile, and change how much of it may be in memory.
                            drop(Octree::open_with(path, read).unwrap());
                            shared.set_cache(least * (1 + round as u64));
                        }
                    });
                }
            });
            shared.fault().unwrap();
        }
    }
}
