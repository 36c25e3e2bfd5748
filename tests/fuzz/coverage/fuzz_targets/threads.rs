//! For the thread sanitizer: an opened file whose pages come and go, shared by threads. The bytes say how many rays each casts in
//! which order, and how much of the file may be in memory meanwhile.
#![no_main]

// Of what they share only the folder.
#[allow(dead_code)]
mod common;

use std::path::PathBuf;
use std::sync::LazyLock;

use common::fuzz::random::Random;
use octrace::Monitor;
use octrace::build::BuildOptions;
use octrace::geometry::{Hit, Ray};
use octrace::map::{Octree, Read};
use octrace::mesh::ReadOptions;
use octrace::trace::{OctreeTracer, Order, Tracer};

/// Threads at a time.
const THREADS: u64 = 4;

/// A sheet in about a hundred pages, plain and packed.
static FILES: LazyLock<[PathBuf; 2]> = LazyLock::new(|| {
    let obj = common::FOLDER.path().join("threads.obj");
    std::fs::write(&obj, common::fuzz::seeds::sheet(60)).unwrap();
    [None, Some(1)].map(|compress| {
        let oct = obj.with_extension(if compress.is_some() { "packed.oct" } else { "oct" });
        let options = BuildOptions { brick: Some(100), compress, ..BuildOptions::default() };
        let mut source = octrace::mesh::open(&obj, &ReadOptions::default()).unwrap();
        octrace::build::build(source.as_mut(), &oct, &options, Monitor::silent()).unwrap();
        oct
    })
});

/// Rays down on the sheet from all sides.
fn rays(seed: u64, count: usize) -> Vec<Ray> {
    let mut random = Random(seed);
    let mut share = || (random.bits() >> 40) as f32 / 16_777_216.0;
    let mut ray = || {
        let (from, to) = ([3.0 * share() - 1.0, 3.0 * share() - 1.0, 1.0], [share(), share(), 0.0]);
        Ray::new(from, std::array::from_fn(|i| to[i] - from[i]))
    };
    (0..count).map(|_| ray()).collect()
}

fn trace(octree: &Octree, order: Order, rays: &[Ray]) -> Vec<Hit> {
    let tracer = OctreeTracer::new(octree).with_order(order);
    let (mut hits, mut blocked) = (vec![Hit::MISS; rays.len()], vec![false; rays.len()]);
    tracer.closest_batch(rays, &mut hits).unwrap();
    tracer.any_batch(rays, &mut blocked).unwrap();
    assert!(hits.iter().zip(&blocked).all(|(hit, blocked)| hit.is_hit() == *blocked));
    hits
}

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    let byte = |i: usize| data.get(i).copied().unwrap_or(i as u8);
    let alone = Octree::open(&FILES[0]).unwrap();
    let path = &FILES[usize::from(byte(0) % 2)];
    let least = Octree::least_cache(path).unwrap();
    let read = Read::Budgeted { cache: least * (1 + u64::from(byte(1) % 4)) };
    let shared = Octree::open_with(path, read).unwrap();
    std::thread::scope(|scope| {
        for thread in 0..THREADS {
            let (alone, shared, byte) = (&alone, &shared, &byte);
            scope.spawn(move || {
                for round in 0..3 {
                    let at = 2 + 9 * thread as usize + 3 * round;
                    let rays = rays(u64::from(byte(at)) << 8 | thread, 20 + usize::from(byte(at + 1)));
                    let order = [Order::Single, Order::Flight, Order::Packet][usize::from(byte(at + 2) % 3)];
                    assert!(trace(shared, order, &rays) == trace(alone, Order::Single, &rays), "{read:?} {order:?}");
                    // Others open and close the file meanwhile, and change how much of it may be in memory.
                    drop(Octree::open_with(path, read).unwrap());
                    shared.set_cache(least * (1 + u64::from(byte(at + 2) / 64)));
                }
            });
        }
    });
    shared.fault().unwrap();
});
