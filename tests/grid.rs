//! Files whose vertices lie on a grid and take 16 bits an axis where the leaf is small enough: the same answers, bit for bit, as those
//! of a file of f32 over the moved mesh, and no crack where the two kinds of leaf meet.

mod trace_common;

use octrace::build::{BuildOptions, Positions};
use octrace::event::Monitor;
use octrace::format::{Flags, SplitMode};
use octrace::geometry::{Hit, Ray, Skip};
use octrace::map::Octree;
use octrace::trace::{Isa, LinearTracer, OctreeTracer, Order, Tracer, all_hits};
use trace_common::{Mesh, Random, nasty_ray};

/// The mesh with each coordinate moved to the nearest multiple of a power of two.
fn moved(mesh: &Mesh, step: f64) -> Mesh {
    let near = |x: f32| ((f64::from(x) / step).round() * step) as f32 + 0.0;
    Mesh { positions: mesh.positions.iter().map(|p| p.map(near)).collect(), faces: mesh.faces.clone() }
}

/// Leaves that hold steps, and all.
fn leaves(octree: &Octree) -> (u64, u64) {
    (octree.parts(Monitor::silent()).unwrap().step_leaves, octree.header().leaves)
}

fn bits(hit: Hit) -> [u32; 4] {
    [hit.t.to_bits(), hit.face.0, hit.u.to_bits(), hit.v.to_bits()]
}

/// Closest hits in a batch, any hits in a batch, and the list of all hits of every fourth ray.
type Answers = (Vec<[u32; 4]>, Vec<bool>, Vec<Vec<[u32; 4]>>);

fn answers(tracer: &dyn Tracer, rays: &[Ray]) -> Answers {
    let (mut hits, mut any) = (vec![Hit::MISS; rays.len()], vec![false; rays.len()]);
    tracer.closest_batch(rays, &mut hits).unwrap();
    tracer.any_batch(rays, &mut any).unwrap();
    let list = |ray: &Ray| all_hits(tracer, ray, Skip::NONE).map(|found| bits(found.unwrap().hit)).collect();
    (hits.into_iter().map(bits).collect(), any, rays.iter().step_by(4).map(list).collect())
}

/// Rays of all kinds, and bundles of them that run side by side, so that packets form.
fn rays(mesh: &Mesh, random: &mut Random) -> Vec<Ray> {
    let mut rays: Vec<Ray> = (0..300).map(|_| nasty_ray(mesh, random)).collect();
    for _ in 0..8 {
        let ray = nasty_ray(mesh, random);
        let reach = ray.direction.iter().fold(0f32, |m, d| m.max(d.abs())) * random.pick(&[1e-6, 1e-3, 0.03]);
        rays.extend((0..32).map(|_| {
            let apart = random.vector();
            Ray { direction: std::array::from_fn(|i| ray.direction[i] + reach * apart[i]), ..ray }
        }));
    }
    rays
}

/// A mesh and a step; where `mixed`, both kinds of leaf must be there in number.
fn same_answers(name: &str, mesh: &Mesh, step: f64, mixed: bool) {
    let mut random = Random(41);
    let on_grid = moved(mesh, step);
    let rays = rays(&on_grid, &mut random);
    let expected = answers(&LinearTracer::new(&on_grid.octree(&BuildOptions::default())).unwrap(), &rays);
    let hits = expected.0.iter().filter(|hit| hit[1] != u32::MAX).count();
    assert!(5 * hits > rays.len(), "{name}: {hits} hits, the rays test little");
    for split in [SplitMode::Sah, SplitMode::Octree, SplitMode::Strict] {
        for brick in [None, Some(300)] {
            let grid = BuildOptions { split, brick, positions: Positions::Grid(Some(step)), ..BuildOptions::default() };
            let octree = mesh.octree(&grid);
            octree.verify(Monitor::silent()).unwrap();
            let (steps, all) = leaves(&octree);
            assert!(octree.header().flags.has(Flags::STEPS) && steps > 0, "{name}: {steps} of {all}");
            assert!(
                !mixed || split != SplitMode::Sah || (6 * steps > all && 6 * (all - steps) > all),
                "{name}: {steps} of {all}"
            );
            // The moved mesh loses nothing more.
            let lossless = on_grid.octree(&BuildOptions { positions: Positions::LOSSLESS, ..grid.clone() });
            assert_eq!(leaves(&lossless), (steps, all), "{name}");
            assert_eq!(answers(&LinearTracer::new(&octree).unwrap(), &rays), expected, "{name}, {grid:?}, linear");
            for isa in Isa::available() {
                for order in [Order::Single, Order::Flight, Order::Packet] {
                    let tracer = OctreeTracer::new(&octree).with_isa(isa).with_order(order);
                    let what = format!("{name}, {grid:?}, {} {order:?}", isa.name());
                    assert_eq!(answers(&tracer, &rays), expected, "{what}");
                }
            }
        }
    }
}

#[test]
fn every_kernel_answers_as_on_floats() {
    same_answers("sphere", &Mesh::sphere(4, 0.05), 2f64.powi(-18), false);
    same_answers("far sphere", &Mesh::sphere(3, 0.1).placed(1.0, 100.0), 2f64.powi(-16), false);
    same_answers("tiny sphere", &Mesh::sphere(3, 0.1).placed(1e-30, 0.0), 2f64.powi(-117), false);
    same_answers("large sphere", &Mesh::sphere(3, 0.1).placed(1e30, 0.0), 2f64.powi(82), false);
    same_answers("soup", &Mesh::soup(200, 3), 2f64.powi(-14), false);
    // Spikes and walls across a room with small things in it: leaves of up to 32 vertices, triangles cut among leaves.
    same_answers("room", &Mesh::room(), 2f64.powi(-15), false);
}

#[test]
fn every_kernel_answers_as_on_floats_where_codings_meet() {
    same_answers("mixed sphere", &Mesh::sphere(5, 0.0), MIXED, true);
}

/// A step at which a part of the leaves of the sphere of 8192 triangles are too wide for 16 bits.
const MIXED: f64 = 1.0 / (1 << 19) as f64;

/// From inside, at each vertex and two points of each edge of a closed mesh with seams between leaves all over: nobody escapes, and no
/// line crosses an odd number of times.
#[test]
fn no_crack_where_codings_meet() {
    let mesh = Mesh::sphere(5, 0.0);
    let octree = mesh.octree(&BuildOptions { positions: Positions::Grid(Some(MIXED)), ..BuildOptions::default() });
    let (steps, all) = leaves(&octree);
    assert!(6 * steps > all && 6 * (all - steps) > all, "{steps} of {all}");
    let on_grid = moved(&mesh, MIXED);
    let (inside, mut rays) = ([0.01f32, 0.02, -0.03], Vec::new());
    for face in &on_grid.faces {
        let [a, b, c] = face.map(|i| on_grid.positions[i as usize]);
        let between =
            |p: [f32; 3], q: [f32; 3], at: f32| -> [f32; 3] { std::array::from_fn(|i| p[i] + at * (q[i] - p[i])) };
        for target in [a, between(a, b, 0.5), between(b, c, 0.25), between(between(a, b, 0.5), c, 0.3)] {
            rays.push(Ray::new(inside, std::array::from_fn(|i| target[i] - inside[i])));
        }
    }
    for isa in Isa::available() {
        for order in [Order::Single, Order::Flight, Order::Packet] {
            let tracer = OctreeTracer::new(&octree).with_isa(isa).with_order(order);
            let (mut hits, mut any) = (vec![Hit::MISS; rays.len()], vec![false; rays.len()]);
            tracer.closest_batch(&rays, &mut hits).unwrap();
            tracer.any_batch(&rays, &mut any).unwrap();
            let escaped = rays.iter().zip(&hits).zip(&any).find(|((_, hit), any)| hit.face.0 == u32::MAX || !**any);
            assert!(escaped.is_none(), "{} {order:?}: {escaped:?}", isa.name());
        }
        let tracer = OctreeTracer::new(&octree).with_isa(isa);
        for ray in rays.iter().step_by(7) {
            let line = ray.between(f32::NEG_INFINITY, f32::INFINITY);
            let ahead = all_hits(&tracer, ray, Skip::NONE).count();
            let all = all_hits(&tracer, &line, Skip::NONE).count();
            assert_eq!((ahead, all), (1, 2), "{ray:?}");
        }
    }
}
