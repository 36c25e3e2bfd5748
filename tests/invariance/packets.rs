//! Rays that run side by side, in packets, and those that do not among them.

use super::*;

/// Rays that run beside one that is aimed at something nasty; from its origin, or from points around it.
fn beside(ray: Ray, apart: f32, random: &mut Random) -> Vec<Ray> {
    let largest = ray.direction.iter().fold(0f32, |m, d| m.max(d.abs()));
    let nudge = |x: f32, by: f32, random: &mut Random| x + by * (random.below(2001) as f32 / 1000.0 - 1.0);
    let reach = random.pick(&[1e-7, 1e-5, 1e-3, 0.03]) * largest;
    let count = [64, 63, 17, 16, 8][random.below(5)];
    (0..count)
        .map(|i| {
            let exact = i % 5 == 0;
            let direction = ray.direction.map(|d| if exact { d } else { nudge(d, reach, random) });
            let origin = ray.origin.map(|o| if exact { o } else { nudge(o, apart, random) });
            Ray { origin, direction, ..ray }
        })
        .collect()
}

/// Gives rays intervals of their own, some that end at a hit or a step of f32 beside it; and makes some of them invalid.
fn mix(rays: &mut [Ray], tracer: &dyn Tracer, random: &mut Random) {
    for (i, ray) in rays.iter_mut().enumerate() {
        let t = tracer.closest(ray, Skip::NONE).unwrap().map_or(1.0, |found| found.hit.t);
        let [under, over] = [t.next_down(), t.next_up()];
        *ray = match i % 9 {
            1 => ray.between(f32::NEG_INFINITY, f32::INFINITY),
            2 => ray.between(random.pick(&[0.0, under, t, over]), f32::INFINITY),
            3 => ray.between(-1.0, random.pick(&[under, t, over, 2.0 * t])),
            4 => ray.between(t, t),
            _ => *ray,
        };
        match random.below(40) {
            0 => ray.origin[i % 3] = f32::NAN,
            1 => ray.direction[i % 3] = random.pick(&[0.0, -0.0, f32::INFINITY]),
            2 => ray.direction = [0.0; 3],
            3 => (ray.tmin, ray.tmax) = (1.0, 0.5),
            4 => ray.origin[i % 3] = 1e30,
            _ => {}
        }
    }
}

#[test]
fn in_packets() {
    let (mut together, mut alone) = (0, 0);
    for bench in Bench::all() {
        let mut random = Random(77);
        let split = random.pick(&SPLITS);
        let octree = bench.mesh.octree(&BuildOptions { split, brick: Some(300), ..BuildOptions::default() });
        let size = octree.root().side() as f32;
        for query in bench.queries.iter().take(300) {
            let apart = random.pick(&[0.0, 1e-6, 1e-3]) * size;
            let mut rays = beside(query.ray, apart, &mut random);
            if random.below(2) == 0 {
                mix(&mut rays, &OctreeTracer::new(&octree), &mut random);
            }
            let skips: Vec<Skip> = rays.iter().map(|_| random.pick(&[query.skip, Skip::NONE])).collect();
            let asked = |isa, order| {
                let tracer = OctreeTracer::new(&octree).with_isa(isa).with_order(order);
                let (mut found, mut blocked) = (vec![None; rays.len()], vec![false; rays.len()]);
                let mut counters = Counters::default();
                tracer.closest_each(&rays, &skips, &mut found, &mut counters).unwrap();
                tracer.any_each(&rays, &skips, &mut blocked, &mut Counters::default()).unwrap();
                (found, blocked, counters.nodes)
            };
            let (found, blocked, nodes) = asked(Isa::SCALAR, Order::Single);
            for isa in Isa::available() {
                let packed = asked(isa, Order::Packet);
                let what = format!("{} {} {query:?} {apart}", bench.name, isa.name());
                let of = |f: &Option<Found>| f.map(|f| (bits(f.hit), f.triangle));
                for i in 0..rays.len() {
                    assert_eq!(of(&packed.0[i]), of(&found[i]), "{what}: ray {i} {:?}", rays[i]);
                    assert_eq!(packed.1[i], blocked[i], "{what}: any hit of ray {i} {:?}", rays[i]);
                }
                together += u64::from(packed.2 < nodes);
                alone += 1;
            }
        }
    }
    // Else this compares a walk with itself. Rays along an axis and meshes of no moderate size make no packets.
    assert!(20 * together > alone, "{together} of {alone} went together");
}

/// A packet once took the second of two equal triangles for the first, met again in another leaf, when the packet before it had hit that.
#[test]
fn equal_triangles_in_a_packet_again_and_again() {
    let mut mesh = Mesh::cube(3);
    mesh.faces.extend(mesh.faces.clone());
    let (mut random, faces) = (Random(5), mesh.faces.len());
    for split in SPLITS {
        let octree = mesh.octree(&BuildOptions { split, brick: Some(64), ..BuildOptions::default() });
        for isa in Isa::available() {
            let tracer = OctreeTracer::new(&octree).with_isa(isa).with_order(Order::Packet);
            let (mut last, mut hits) = (Vec::new(), 0);
            for k in 0..600 {
                if k % 3 == 0 {
                    let (to, from) = (random.vector().map(|x| 0.4 * x), random.vector().map(|x| 4.0 * x));
                    let ray = Ray::new(from, std::array::from_fn::<f32, 3, _>(|i| to[i] - from[i]));
                    last = beside(ray, 0.0, &mut random);
                }
                // Now each leaves out one of the two, now the other.
                let skips: Vec<Skip> = (0..last.len())
                    .map(|i| match k % 3 {
                        0 => Skip::NONE,
                        _ => Skip::one(FaceId(((i * 7 + k) % faces) as u32)),
                    })
                    .collect();
                let mut found = vec![None; last.len()];
                tracer.closest_each(&last, &skips, &mut found, &mut Counters::default()).unwrap();
                for ((ray, skip), found) in last.iter().zip(&skips).zip(&found) {
                    let alone = tracer.closest(ray, *skip).unwrap();
                    assert_eq!(
                        found.map(|f| bits(f.hit)),
                        alone.map(|f| bits(f.hit)),
                        "{split:?} {isa:?} {ray:?} {skip:?}"
                    );
                    hits += u32::from(alone.is_some());
                }
            }
            assert!(hits > 1000, "{hits} hits test little");
        }
    }
}
