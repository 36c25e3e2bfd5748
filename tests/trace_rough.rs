//! The walk without exactness, which tells what exactness costs, finds what the exact walk finds but for the odd ray at an edge: else
//! it would not do the same work.

mod trace_common;

use octrace::build::BuildOptions;
use octrace::format::SplitMode;
use octrace::geometry::{Hit, Ray};
use octrace::trace::{Isa, OctreeTracer, Order, Tracer};
use trace_common::{Mesh, Random};

const RAYS: usize = 40_000;
/// Most rays of these that may be answered otherwise: one in 10^4. Seen were none on the sphere and the cube, one in the room.
const MOST_OTHER: usize = RAYS / 10_000;

/// Half from far outside, half from within, not aimed at anything; a few with an end. In bundles of 20, of which every other one starts
/// at one point.
fn rays(random: &mut Random) -> Vec<Ray> {
    let (mut point, mut aim) = ([0.0; 3], [0.0; 3]);
    (0..RAYS)
        .map(|k| {
            if k % 20 == 0 {
                (point, aim) = (random.vector(), random.vector());
            }
            let (by, to) = (random.vector(), random.vector());
            let near = if k / 20 % 2 == 0 { 0.0 } else { 0.01 };
            let size = if k / 20 % 4 < 2 { 3.0 } else { 0.5 };
            let from: [f32; 3] = std::array::from_fn(|i| size * point[i] + near * by[i]);
            let to: [f32; 3] = std::array::from_fn(|i| aim[i] + 0.1 * to[i]);
            let ray = Ray::new(from, std::array::from_fn::<f32, 3, _>(|i| to[i] - from[i]));
            if k % 8 == 0 { ray.between(0.25, 1.0) } else { ray }
        })
        .collect()
}

fn close(a: f32, b: f32, by: f32) -> bool {
    (a - b).abs() <= by * b.abs().max(1.0)
}

fn same(got: &Hit, exact: &Hit) -> bool {
    if !exact.is_hit() {
        return got == exact;
    }
    got.face == exact.face && close(got.t, exact.t, 1e-4) && close(got.u, exact.u, 1e-2) && close(got.v, exact.v, 1e-2)
}

#[test]
fn all_but_a_few_random_rays_hit_the_same_without_exactness() {
    let mut random = Random(1);
    // Leaves of both codings, with few and with many triangles.
    let meshes = [Mesh::sphere(5, 0.05), Mesh::cube(7), Mesh::room().placed(0.2, 0.0)];
    for (m, mesh) in meshes.iter().enumerate() {
        let rays = rays(&mut random);
        for (split, leaf) in [(SplitMode::Sah, 16), (SplitMode::Octree, 16), (SplitMode::Strict, 3)] {
            let octree = mesh.octree(&BuildOptions { split, leaf, brick: Some(3000), ..BuildOptions::default() });
            for (isa, packets) in Isa::available().into_iter().flat_map(|isa| [(isa, false), (isa, true)]) {
                let order = if packets { Order::Packet } else { Order::Single };
                let tracer = OctreeTracer::new(&octree).with_isa(isa).with_order(order);
                let (mut hits, mut rough) = (vec![Hit::MISS; RAYS], vec![Hit::MISS; RAYS]);
                let exact_work = tracer.closest_batch(&rays, &mut hits).unwrap();
                let rough_work = tracer.rough_closest_batch(&rays, &mut rough, packets).unwrap();
                let (mut any, mut rough_any) = (vec![false; RAYS], vec![false; RAYS]);
                tracer.any_batch(&rays, &mut any).unwrap();
                tracer.rough_any_batch(&rays, &mut rough_any, packets).unwrap();
                let found = hits.iter().filter(|hit| hit.is_hit()).count();
                assert!(found > RAYS / 4, "{found} hits test little");
                let what = format!("mesh {m}, {split:?}, {}, {order:?}", isa.name());
                let other = rough.iter().zip(&hits).filter(|(got, exact)| !same(got, exact)).count();
                assert!(other <= MOST_OTHER, "{what}: {other} of {RAYS} hits are others");
                let other = rough_any.iter().zip(&any).filter(|(got, exact)| got != exact).count();
                assert!(other <= MOST_OTHER, "{what}: {other} of {RAYS} answers are others");
                // The same nodes and leaves but where the bound of a hit lets in one more.
                let near = |a: u64, b: u64| a.abs_diff(b) * 1000 <= b;
                assert!(
                    packets
                        || near(rough_work.nodes, exact_work.nodes) && near(rough_work.triangles, exact_work.triangles),
                    "{what}: {rough_work:?} {exact_work:?}"
                );
                assert_eq!((rough_work.rays, rough_work.doubts, rough_work.exact), (RAYS as u64, 0, 0));
            }
        }
    }
}

#[test]
fn bad_rays_miss_and_ends_count() {
    let octree = Mesh::cube(2).octree(&BuildOptions::default());
    let good = Ray::new([0.3, 0.15, 5.0], [0.0, 0.0, -1.0]);
    let nan = Ray { origin: [f32::NAN, 0.0, 0.0], ..good };
    let rays =
        [good, good.between(3.9, 4.1), good.between(4.5, 5.0), nan, good.between(2.0, 1.0), good.between(5.0, 7.0)];
    for isa in Isa::available() {
        let tracer = OctreeTracer::new(&octree).with_isa(isa);
        let (mut hits, mut any) = ([Hit::MISS; 6], [false; 6]);
        tracer.rough_closest_batch(&rays, &mut hits, false).unwrap();
        tracer.rough_any_batch(&rays, &mut any, false).unwrap();
        let found = [4.0, 4.0, f32::INFINITY, f32::INFINITY, f32::INFINITY, 6.0];
        assert!(hits.iter().zip(found).all(|(hit, t)| hit.t == t || close(hit.t, t, 1e-6)), "{hits:?}");
        assert_eq!(any, [true, true, false, false, false, true]);
    }
}
