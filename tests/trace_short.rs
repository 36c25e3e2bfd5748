//! Short rays in groups: the answers of rays walked one by one, however short, long or odd they are.

mod trace_common;

use octrace::build::BuildOptions;
use octrace::format::SplitMode;
use octrace::geometry::{FaceId, Ray, Skip};
use octrace::trace::{Counters, Isa, LinearTracer, OctreeTracer, Tracer};
use trace_common::{Mesh, Random, nasty_ray};

/// Rays from near a surface across it, or nearly: a few ulps to a few triangles long. Each leaves out a face that it may well meet.
fn short_rays(mesh: &Mesh, count: usize, seed: u64) -> (Vec<Ray>, Vec<Skip>) {
    let mut random = Random(seed);
    let ray = |random: &mut Random| {
        let number = random.below(mesh.faces.len());
        let [a, b, c] = mesh.faces[number].map(|i| mesh.positions[i as usize]);
        let (u, v) = (random.unit().abs() / 2.0, random.unit().abs() / 2.0);
        let point: [f32; 3] = std::array::from_fn(|i| a[i] + u * (b[i] - a[i]) + v * (c[i] - a[i]));
        let size = (0..3).map(|i| (b[i] - a[i]).abs() + (c[i] - a[i]).abs()).fold(0.0, f32::max);
        let step = size * random.pick(&[1e-7, 1e-5, 1e-3, 0.1, 1.0]);
        let from: [f32; 3] = random.vector().map(|x| x * step);
        let origin: [f32; 3] = std::array::from_fn(|i| point[i] + from[i]);
        let scale = random.pick(&[1.0f32, 1.0, 1e10, 1e-10]);
        let direction = from.map(|x| -x * scale);
        let end = random.pick(&[0.5, 1.0, 1.0 + 1.0 / 256.0, 2.0]) / scale;
        let begin = random.pick(&[0.0, 0.0, 0.0, end / 2.0, end]);
        let skip = random.pick(&[Skip::NONE, Skip::one(FaceId(number as u32)), Skip::one(FaceId(0))]);
        (Ray::new(origin, direction).between(begin, end), skip)
    };
    (0..count).map(|_| ray(&mut random)).unzip()
}

fn compare(name: &str, mesh: &Mesh, rays: &[Ray], skips: &[Skip]) {
    let linear = LinearTracer::new(&mesh.octree(&BuildOptions::default())).unwrap();
    let answers = |tracer: &dyn Tracer, count: usize| {
        let mut blocked = vec![true; rays.len()];
        let mut counters = Counters::default();
        for ((rays, skips), blocked) in rays.chunks(count).zip(skips.chunks(count)).zip(blocked.chunks_mut(count)) {
            tracer.any_short(rays, skips, blocked, &mut counters).unwrap();
        }
        assert_eq!(counters.rays, rays.len() as u64);
        blocked
    };
    let want = answers(&linear, rays.len());
    let met = want.iter().filter(|&&b| b).count();
    assert!(met * 20 > rays.len() && met < rays.len(), "{name}: {met} of {} tell little", rays.len());
    for split in [SplitMode::Sah, SplitMode::Octree, SplitMode::Strict] {
        for (leaf, brick) in [(16, None), (2, Some(40))] {
            let octree = mesh.octree(&BuildOptions { split, leaf, brick, ..BuildOptions::default() });
            for isa in Isa::available() {
                let tracer = OctreeTracer::new(&octree).with_isa(isa);
                for count in [rays.len(), 64, 3] {
                    let got = answers(&tracer, count);
                    let differ = got.iter().zip(&want).position(|(a, b)| a != b);
                    assert_eq!(
                        differ.map(|i| (rays[i], skips[i])),
                        None,
                        "{name}, {split:?}, {leaf}, {isa:?}, {count}"
                    );
                }
            }
        }
    }
}

#[test]
fn short_rays_get_the_answers_of_single_ones() {
    for (name, mesh) in [
        ("sphere", Mesh::sphere(4, 0.0)),
        ("bumps", Mesh::sphere(4, 0.1)),
        ("cube", Mesh::cube(8)),
        ("soup", Mesh::soup(800, 5)),
        ("far", Mesh::sphere(3, 0.05).placed(1.0, 1e6)),
        ("tiny", Mesh::sphere(3, 0.05).placed(1e-30, 0.0)),
        ("huge", Mesh::sphere(3, 0.05).placed(1e30, 0.0)),
    ] {
        let (rays, skips) = short_rays(&mesh, 1500, 11);
        compare(name, &mesh, &rays, &skips);
    }
}

#[test]
fn long_and_odd_rays_are_answered_too() {
    for (name, mesh) in [("bumps", Mesh::sphere(3, 0.1)), ("soup", Mesh::soup(500, 9)), ("room", Mesh::room())] {
        let mut random = Random(3);
        let mut rays: Vec<Ray> = (0..1500).map(|_| nasty_ray(&mesh, &mut random)).collect();
        rays[7].direction = [0.0; 3];
        rays[8].origin[1] = f32::NAN;
        rays[9] = rays[9].between(2.0, 1.0);
        let skips = vec![Skip::NONE; rays.len()];
        compare(name, &mesh, &rays, &skips);
    }
}
