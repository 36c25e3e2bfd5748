//! Rays that start on surfaces: what blocks them, and what must not.

use std::sync::Arc;

use glam::{DVec3, Vec3};
use octrace::geometry::{Ray, Skip};
use octrace::trace::{Counters, Footprint, OctreeTracer, Tracer};

use super::trace_common::{Mesh, Random};
use super::{pages, planet, view};

/// Shadows, likewise: what truly blocks a ray before its end is never lost.
#[test]
fn no_blocked_ray_is_let_through() {
    let octree = planet();
    let tracer = OctreeTracer::new(octree.clone());
    let view = view(&octree, 60, DVec3::new(0.3, 0.2, 1.0));
    let footprint = Footprint { width: 0.02, spread: 0.0, lifted: false };
    let (skips, footprints) = (vec![Skip::NONE; view.rays.len()], vec![footprint; view.rays.len()]);
    let (mut coarse, mut exact) = (vec![false; view.rays.len()], vec![false; view.rays.len()]);
    let counters = &mut Counters::default();
    tracer.any_coarse(&view.rays, &skips, &footprints, 2.0, &mut coarse, counters).unwrap();
    let visits = counters.triangles;
    tracer.any_each(&view.rays, &skips, &mut exact, counters).unwrap();
    let blocked = exact.iter().filter(|&&b| b).count();
    assert!(blocked > 500 && coarse.iter().zip(&exact).all(|(coarse, exact)| *coarse || !exact));
    // And hardly more are: the limb has grown by a part of a pixel.
    let more = coarse.iter().filter(|&&b| b).count() - blocked;
    assert!(more < blocked / 10, "{more} of {blocked}");
    assert!(visits < counters.triangles - visits, "{visits} of {counters:?}");
}

/// Thin upright blades without a ground, turned any way: nothing that a plane could stand for.
fn forest() -> Mesh {
    let mut random = Random(5);
    let mut mesh = Mesh::default();
    for _ in 0..20_000 {
        let [x, z, angle] = random.vector();
        let across = [0.004 * (7.0 * angle).cos(), 0.0, 0.004 * (7.0 * angle).sin()];
        let foot = [x, 0.0, z];
        let top = [x, 0.1 + 0.05 * random.unit(), z];
        let first = mesh.positions.len() as u32;
        let moved = |sign: f32| std::array::from_fn(|i| foot[i] + sign * across[i]);
        mesh.positions.extend([moved(-1.0), moved(1.0), top]);
        mesh.faces.push([first, first + 1, first + 2]);
    }
    mesh
}

/// The sun low over a forest: rays that start from a surrogate are blocked by blades far from there, however the mean planes of these lie.
#[test]
fn no_light_leaks_through_what_is_no_surface() {
    let octree = Arc::new(forest().octree(&pages(500)));
    let tracer = OctreeTracer::new(octree.clone());
    let mut random = Random(9);
    let rays = (0..4000).map(|_| {
        let from = DVec3::new(-1.5, 0.05 + 0.05 * f64::from(random.unit()), f64::from(random.unit()));
        let to = DVec3::new(1.5, 0.08 + 0.08 * f64::from(random.unit()), f64::from(random.unit()));
        let mut ray = Ray::new(from.as_vec3().to_array(), (to - from).as_vec3().to_array());
        (ray.tmin, ray.tmax) = (0.01, 1.0);
        ray
    });
    let rays: Vec<Ray> = rays.collect();
    let footprint = Footprint { width: 0.03, spread: 0.0, lifted: true };
    let (skips, footprints) = (vec![Skip::NONE; rays.len()], vec![footprint; rays.len()]);
    let (mut coarse, mut exact) = (vec![false; rays.len()], vec![false; rays.len()]);
    let counters = &mut Counters::default();
    tracer.any_coarse(&rays, &skips, &footprints, 1.0, &mut coarse, counters).unwrap();
    tracer.any_each(&rays, &skips, &mut exact, counters).unwrap();
    let blocked = exact.iter().filter(|&&b| b).count();
    let leaks = exact.iter().zip(&coarse).filter(|(exact, coarse)| **exact && !**coarse).count();
    assert!(blocked > 2000, "{blocked}");
    assert_eq!(leaks, 0, "of {blocked} rays");
}

/// A ray that leaves a triangle straight up is not blocked by what stands for that triangle, and seldom by that of a neighbour, which may have grown over it.
#[test]
fn nothing_stands_in_its_own_way() {
    let octree = planet();
    let tracer = OctreeTracer::new(octree.clone());
    let view = view(&octree, 60, DVec3::new(0.3, 0.2, 1.0));
    let mut up = Vec::new();
    for ray in &view.rays {
        let Some(found) = tracer.closest(ray, Skip::NONE).unwrap() else { continue };
        let [a, b, c] = found.triangle.vertices().map(|v| v.as_dvec3());
        let normal = (b - a).cross(c - a).normalize();
        let at = Vec3::from_array(ray.origin).as_dvec3()
            + f64::from(found.hit.t) * Vec3::from_array(ray.direction).as_dvec3();
        up.push(Ray::new((at + 1e-5 * normal).as_vec3().to_array(), normal.as_vec3().to_array()));
    }
    assert!(up.len() > 500);
    let (skips, mut blocked) = (vec![Skip::NONE; up.len()], vec![false; up.len()]);
    let footprints = vec![Footprint { width: 0.03, spread: 0.0, lifted: false }; up.len()];
    tracer.any_coarse(&up, &skips, &footprints, 2.0, &mut blocked, &mut Counters::default()).unwrap();
    let count = blocked.iter().filter(|&&b| b).count();
    assert!(count * 10 < up.len(), "{count} of {}", up.len());
}
