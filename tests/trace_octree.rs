//! The octree against the linear reference: every answer the same, bit for bit, however the file is built.

mod trace_common;

use octrace::build::BuildOptions;
use octrace::format::SplitMode;
use octrace::geometry::{Aabb, FaceId, Hit, Ray, Skip};
use octrace::trace::{Found, LinearTracer, OctreeTracer, Tracer, all_hits, triangles_in_box};
use trace_common::{Mesh, Random, nasty_ray};

const SPLITS: [SplitMode; 3] = [SplitMode::Sah, SplitMode::Octree, SplitMode::Strict];

fn files() -> Vec<BuildOptions> {
    let mut all = Vec::new();
    for split in SPLITS {
        for (leaf, cell, depth, brick) in [
            (16, 16, 21, None),
            (1, 1, 9, None),
            (2, 8, 21, Some(8)),
            (8, 64, 3, Some(100)),
            (16, u32::MAX, 0, Some(1000)),
        ] {
            all.push(BuildOptions { split, leaf, cell, depth, brick, ..BuildOptions::default() });
        }
    }
    all
}

fn seen(found: Option<Found>) -> Hit {
    found.map_or(Hit::MISS, |found| found.hit)
}

fn bits(hit: Hit) -> [u32; 4] {
    [hit.t.to_bits(), hit.face.0, hit.u.to_bits(), hit.v.to_bits()]
}

fn compare(name: &str, mesh: &Mesh, rays: usize, seed: u64) {
    let octree = mesh.octree(&BuildOptions::default());
    let linear = LinearTracer::new(&octree).unwrap();
    let mut random = Random(seed);
    let rays: Vec<Ray> = (0..rays).map(|_| nasty_ray(mesh, &mut random)).collect();
    let mut expected = vec![Hit::MISS; rays.len()];
    linear.closest_batch(&rays, &mut expected).unwrap();
    let hits = expected.iter().filter(|hit| hit.is_hit()).count();
    assert!(hits * 8 > rays.len(), "{name}: only {hits} hits, the rays test little");
    for options in files() {
        let octree = mesh.octree(&options);
        let tracer = OctreeTracer::new(&octree);
        let (mut hits, mut blocked) = (vec![Hit::MISS; rays.len()], vec![false; rays.len()]);
        let counters = tracer.closest_batch(&rays, &mut hits).unwrap();
        tracer.any_batch(&rays, &mut blocked).unwrap();
        assert_eq!(counters.rays, rays.len() as u64);
        for (i, ray) in rays.iter().enumerate() {
            assert_eq!(
                bits(hits[i]),
                bits(expected[i]),
                "{name}, {options:?}, {ray:?}: {:?} {:?}",
                hits[i],
                expected[i]
            );
            assert_eq!(blocked[i], expected[i].is_hit(), "{name}, any, {options:?}, {ray:?}");
        }
    }
}

#[test]
fn sphere() {
    compare("sphere", &Mesh::sphere(4, 0.0), 3000, 1);
    compare("bumpy sphere", &Mesh::sphere(3, 0.3), 3000, 2);
}

#[test]
fn cube_on_the_grid() {
    compare("cube", &Mesh::cube(8), 3000, 3);
}

#[test]
fn soup() {
    compare("soup", &Mesh::soup(700, 4), 3000, 4);
}

/// Triangles are cut there and stored several times.
#[test]
fn room() {
    let mesh = Mesh::room();
    let header = *mesh.octree(&BuildOptions::default()).header();
    assert!(header.references > header.triangles + header.triangles / 50, "{} references", header.references);
    assert_eq!(header.triangles, mesh.faces.len() as u64);
    compare("room", &mesh, 3000, 6);
    compare("small room, far away", &mesh.placed(0.01, 1e3), 1000, 7);
}

#[test]
fn scales_and_offsets() {
    for (k, &(scale, offset)) in
        [(1e-30, 0.0), (1e30, 0.0), (1e-38, 0.0), (5e37, 0.0), (1.0, 1e3), (1.0, 1e6), (1e-40, 0.0), (1e20, 1e26)]
            .iter()
            .enumerate()
    {
        let name = format!("soup at scale {scale}, offset {offset}");
        compare(&name, &Mesh::soup(150, 5).placed(scale, offset), 300, 10 + k as u64);
        compare(&name, &Mesh::cube(3).placed(scale, offset), 300, 30 + k as u64);
    }
}

#[test]
fn invalid_rays_miss() {
    let octree = Mesh::cube(2).octree(&BuildOptions::default());
    let (tracer, linear) = (OctreeTracer::new(&octree), LinearTracer::new(&octree).unwrap());
    let good = Ray::new([0.0, 0.1, 5.0], [0.0, 0.0, -1.0]);
    assert!(tracer.any(&good, Skip::NONE).unwrap());
    let mut bad =
        vec![good.between(2.0, 1.0), good.between(f32::NAN, 1.0), Ray { direction: [0.0, -0.0, 0.0], ..good }];
    for x in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        bad.push(Ray { origin: [0.0, x, 5.0], ..good });
        bad.push(Ray { direction: [x, 0.0, -1.0], ..good });
    }
    for ray in bad {
        assert_eq!(tracer.closest(&ray, Skip::NONE).unwrap(), None);
        assert!(!tracer.any(&ray, Skip::NONE).unwrap());
        assert_eq!(linear.closest(&ray, Skip::NONE).unwrap(), None);
    }
}

#[test]
fn interval_is_closed_on_the_rounded_t() {
    let octree = Mesh::sphere(2, 0.2).octree(&BuildOptions::default());
    let tracer = OctreeTracer::new(&octree);
    let ray = Ray::new([0.1, 0.2, 5.0], [0.01, 0.02, -1.3]);
    let t = tracer.closest(&ray, Skip::NONE).unwrap().unwrap().hit.t;
    let at = |tmin, tmax| seen(tracer.closest(&ray.between(tmin, tmax), Skip::NONE).unwrap()).t;
    assert_eq!(at(t, t), t);
    assert!(at(t.next_up(), f32::INFINITY) > t);
    assert_eq!(at(0.0, t.next_down()), f32::INFINITY);
    assert_eq!(at(f32::NEG_INFINITY, f32::INFINITY), t);
}

#[test]
fn all_hits_come_once_and_in_order() {
    for (mesh, brick) in [(Mesh::soup(300, 8), 50), (Mesh::sphere(3, 0.1), 50), (Mesh::room(), 10_000)] {
        for split in SPLITS {
            let octree = mesh.octree(&BuildOptions { split, brick: Some(brick), cell: 4, ..BuildOptions::default() });
            let (tracer, linear) = (OctreeTracer::new(&octree), LinearTracer::new(&octree).unwrap());
            let mut random = Random(9);
            for _ in 0..200 {
                let ray = nasty_ray(&mesh, &mut random);
                let skip = Skip::one(FaceId(random.below(mesh.faces.len()) as u32));
                let hits: Vec<_> = all_hits(&tracer, &ray, skip).map(|h| bits(h.unwrap().hit)).collect();
                let expected: Vec<_> = all_hits(&linear, &ray, skip).map(|h| bits(h.unwrap().hit)).collect();
                assert_eq!(hits, expected, "{ray:?}");
                let line = octrace::exact::Line::new(&ray);
                let within = |stored: &&octrace::trace::Stored| {
                    let crossing = ray.is_valid().then(|| line.meet(&stored.triangle).crossing).flatten();
                    crossing.is_some_and(|c| c.t_within(&line).is_some()) && !skip.has(stored.face)
                };
                assert_eq!(hits.len(), linear.triangles().iter().filter(within).count());
                assert!(hits.windows(2).all(|w| f32::from_bits(w[0][0]) <= f32::from_bits(w[1][0])));
            }
        }
    }
}

#[test]
fn closed_surfaces_are_crossed_an_even_number_of_times() {
    for mesh in [Mesh::sphere(3, 0.0), Mesh::sphere(2, 0.3), Mesh::cube(4), Mesh::room().placed(0.5, 0.0)] {
        let octree = mesh.octree(&BuildOptions::default());
        let tracer = OctreeTracer::new(&octree);
        let mut random = Random(11);
        for i in 0..2000 {
            let target: [f32; 3] = match i % 2 {
                0 => random.pick(&mesh.positions),
                _ => {
                    let [a, b, _] = random.pick(&mesh.faces).map(|i| mesh.positions[i as usize]);
                    std::array::from_fn(|i| (a[i] + b[i]) / 2.0)
                }
            };
            let mut origin = random.vector().map(|x| x * 4.0);
            origin[random.below(3)] = random.pick(&[-4.0, 4.0]);
            let ray = Ray::new(origin, std::array::from_fn::<f32, 3, _>(|i| target[i] - origin[i]));
            let crossings = all_hits(&tracer, &ray, Skip::NONE).count();
            assert_eq!(crossings % 2, 0, "{ray:?}");
        }
    }
}

#[test]
fn box_queries_find_what_touches() {
    let mut random = Random(13);
    let soup = Mesh::soup(500, 12);
    for (mesh, split, brick) in
        SPLITS.map(|split| (&soup, split, 64)).into_iter().chain([(&Mesh::room(), SplitMode::Sah, 10_000)])
    {
        let octree = mesh.octree(&BuildOptions { split, brick: Some(brick), cell: 4, ..BuildOptions::default() });
        let mut all = Vec::new();
        triangles_in_box(&octree, None, &mut |s| {
            all.push(s);
            Ok(())
        })
        .unwrap();
        let mut ids: Vec<_> = all.iter().map(|s| s.face).collect();
        ids.sort();
        ids.dedup();
        assert_eq!(ids.len(), all.len());
        assert_eq!(all.len() as u64, octree.header().triangles);
        for _ in 0..200 {
            let (p, q) = (random.vector(), random.vector());
            let size = random.pick(&[0.0, 0.01, 0.3, 1.0]);
            let p = if random.below(3) == 0 { random.pick(&mesh.positions) } else { p };
            let bounds = Aabb::around([p.into(), std::array::from_fn::<f32, 3, _>(|i| p[i] + size * q[i]).into()]);
            let mut found = Vec::new();
            triangles_in_box(&octree, Some(bounds), &mut |s| {
                found.push(s.face);
                Ok(())
            })
            .unwrap();
            let touching = all.iter().filter(|s| octrace::exact::touches_box(&s.triangle, bounds));
            let mut expected: Vec<_> = touching.map(|s| s.face).collect();
            found.sort();
            expected.sort();
            assert_eq!(found, expected);
        }
    }
}

#[test]
fn far_origins_test_few_triangles() {
    let mesh = Mesh::cube(12);
    let octree = mesh.octree(&BuildOptions::default());
    let (tracer, linear) = (OctreeTracer::new(&octree), LinearTracer::new(&octree).unwrap());
    let mut random = Random(77);
    let mut rays = Vec::new();
    for exponent in (10..126).step_by(4) {
        let far = 2f32.powi(exponent);
        for axis in 0..3 {
            // Along an axis, beside it by amounts from nothing to what still meets the mesh, from either side.
            for tilt in [0.0, 1e-45, 1e-30, 0.4 / far, -0.7 / far, 3.0 / far] {
                for side in [1.0, -1.0] {
                    let mut origin = [0; 3].map(|_| random.unit() * 0.9);
                    let mut direction = [0.0; 3];
                    origin[axis] = side * far;
                    direction[axis] = -side;
                    direction[(axis + 1) % 3] = tilt;
                    rays.push(Ray::new(origin, direction));
                    rays.push(Ray::new(origin, direction.map(|x| x * 4.0)).between(far / 8.0, far));
                    rays.push(Ray::new(origin, direction.map(|x| -x)).between(-2.0 * far, 0.0));
                }
            }
        }
        // Exactly diagonal: the coordinates are multiples of far's last place, so the line passes the origin.
        for signs in [[1.0, 1.0, 1.0], [1.0, -1.0, 1.0], [-1.0, 1.0, 0.5]] {
            rays.push(Ray::new(signs.map(|s| s * far), signs.map(|s| -s)));
        }
    }
    let mut expected = vec![Hit::MISS; rays.len()];
    linear.closest_batch(&rays, &mut expected).unwrap();
    assert!(expected.iter().filter(|hit| hit.is_hit()).count() * 3 > rays.len());
    let mut hits = expected.clone();
    let counters = tracer.closest_batch(&rays, &mut hits).unwrap();
    for (ray, (hit, expected)) in rays.iter().zip(hits.iter().zip(&expected)) {
        assert_eq!(bits(*hit), bits(*expected), "{ray:?}");
    }
    let all = octree.header().triangles;
    assert!(counters.triangles < counters.rays * all / 6, "{counters:?} of {all} triangles");
}
