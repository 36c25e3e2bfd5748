//! Level of detail: what is claimed of surrogates, measured ray by ray on whole meshes.

#[path = "lod/scenes.rs"]
mod scenes;
#[path = "lod/secondary.rs"]
mod secondary;
mod trace_common;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use glam::{DVec3, Vec3};
use octrace::Monitor;
use octrace::build::{BuildOptions, build};
use octrace::format::SplitMode;
use octrace::geometry::{Aabb, Ray, Skip, Triangle};
use octrace::map::{Octree, Read};
use octrace::mesh::{self, ReadOptions};
use octrace::trace::{Approximate, Counters, Footprint, Isa, Met, OctreeTracer, Tracer, triangles_in_box};
use trace_common::Mesh;

/// An octree file of a mesh file, in pages of at most `brick` triangles.
fn file(obj: &Path, brick: u32, folder: &Path) -> Arc<Octree> {
    let name = format!("{}-{brick}.oct", obj.file_stem().unwrap().to_string_lossy());
    let output = folder.join(name);
    let mut source = mesh::open(obj, &ReadOptions::default()).unwrap();
    let options = BuildOptions { brick: Some(brick), ..BuildOptions::default() };
    build(source.as_mut(), &output, &options, Monitor::silent()).unwrap();
    Arc::new(Octree::open(&output).unwrap())
}

fn asset(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("assets").join(name)
}

/// A bumpy planet: fine enough for nodes below a pixel.
fn planet_mesh(levels: u32) -> Mesh {
    let mut mesh = Mesh::sphere(levels, 0.0);
    for p in &mut mesh.positions {
        let [x, y, z] = *p;
        let hill = (9.0 * x).sin() * (8.0 * y).cos()
            + (11.0 * z + 2.0 * x).sin()
            + 0.3 * (40.0 * (x - y)).sin() * (37.0 * z).cos();
        *p = p.map(|c| c * (1.0 + 0.03 * hill));
    }
    mesh
}

fn planet() -> Arc<Octree> {
    Arc::new(planet_mesh(7).octree(&pages(1000)))
}

/// Many small pages.
fn pages(brick: u32) -> BuildOptions {
    BuildOptions { brick: Some(brick), ..BuildOptions::default() }
}

/// Rays of a picture of `across` x `across` pixels that is filled by a mesh, and their widths.
struct View {
    rays: Vec<Ray>,
    footprint: Footprint,
}

/// Looks from the side at a mesh, so that it is about `across` pixels wide.
fn view(octree: &Arc<Octree>, across: u32, from: DVec3) -> View {
    let bounds = octree.bounds();
    let (centre, radius) =
        ((bounds.min + bounds.max).as_dvec3() * 0.5, 0.5 * (bounds.max - bounds.min).length() as f64);
    let ahead = -from.normalize();
    let distance = 12.0 * radius;
    let (right, up) = ahead.any_orthonormal_pair();
    let pixel = 2.0 * radius / distance / f64::from(across);
    let eye = centre - ahead * distance;
    let rays = (0..across * across).map(|i| {
        let at = |k: u32| (f64::from(k) + 0.37 - 0.5 * f64::from(across)) * pixel;
        let direction = ahead + at(i % across) * right + at(i / across) * up;
        Ray::new(eye.as_vec3().to_array(), direction.as_vec3().to_array())
    });
    View { rays: rays.collect(), footprint: Footprint { width: 0.0, spread: pixel, lifted: false } }
}

fn met(tracer: &OctreeTracer<Arc<Octree>>, view: &View, pixels: f64) -> Vec<Met> {
    let footprints = vec![view.footprint; view.rays.len()];
    let mut met = vec![Met::Nothing; view.rays.len()];
    tracer.closest_coarse(&view.rays, &footprints, pixels, &mut met, &mut Counters::default()).unwrap();
    met
}

fn point(ray: &Ray, t: f32) -> DVec3 {
    let v = |a: [f32; 3]| Vec3::from_array(a).as_dvec3();
    v(ray.origin) + f64::from(t) * v(ray.direction)
}

/// Distance from a point to a triangle.
fn distance(p: DVec3, triangle: &Triangle) -> f64 {
    let [a, b, c] = triangle.vertices().map(|v| v.as_dvec3());
    let to_segment = |a: DVec3, b: DVec3| {
        let k = ((p - a).dot(b - a) / (b - a).length_squared()).clamp(0.0, 1.0);
        (p - a - k * (b - a)).length()
    };
    let normal = (b - a).cross(c - a);
    let inside = [(a, b), (b, c), (c, a)].iter().all(|(u, v)| normal.cross(*v - *u).dot(p - *u) >= 0.0);
    let edges = to_segment(a, b).min(to_segment(b, c)).min(to_segment(c, a));
    if inside { ((p - a).dot(normal) / normal.length()).abs().min(edges) } else { edges }
}

/// The distance from a point to the nearest triangle, if that is at most `reach`.
fn to_surface(octree: &Arc<Octree>, p: DVec3, reach: f64) -> Option<f64> {
    let wide = DVec3::splat(reach * 1.001) + p.abs() * 1e-6;
    let bounds = Aabb { min: (p - wide).as_vec3(), max: (p + wide).as_vec3() };
    let mut least = f64::INFINITY;
    triangles_in_box(octree, Some(bounds), &mut |stored| {
        least = least.min(distance(p, &stored.triangle));
        Ok(())
    })
    .unwrap();
    (least <= reach).then_some(least)
}

/// What was measured over a view.
#[derive(Debug, Default)]
struct Measured {
    surrogates: usize,
    /// Surrogates whose ray truly hits something as near as was claimed.
    direct: usize,
    triangles: usize,
    /// Of these, not the one that is truly hit.
    beside: usize,
    /// Largest distance from the true surface, in parts of what was claimed.
    largest: f64,
    /// Rays that truly hit nothing but were given a surrogate.
    grown: usize,
}

/// Checks every ray of a view against the claims of `Approximate`.
fn measure(octree: &Arc<Octree>, view: &View, pixels: f64) -> Measured {
    let tracer = OctreeTracer::new(octree.clone());
    let mut sum = Measured::default();
    for (ray, met) in view.rays.iter().zip(met(&tracer, view, pixels)) {
        let truth = tracer.closest(ray, Skip::NONE).unwrap();
        let length = Vec3::from_array(ray.direction).as_dvec3().length();
        // Coordinates are rounded to f32, and the point's as well.
        let slack = 1e-6 * point(ray, 1.0).abs().max_element().max(1e-3);
        match met {
            Met::Nothing => assert!(truth.is_none(), "a hit was lost: {ray:?}"),
            Met::Triangle(found) => {
                // A part that holds the true hit may have been taken a little behind this one.
                let truth = truth.expect("a triangle is hit").hit;
                let beyond = f64::from(found.hit.t - truth.t) * length;
                assert!((0.0..=pixels * view.footprint.spread * f64::from(found.hit.t)).contains(&beyond), "{ray:?}");
                sum.triangles += 1;
                sum.beside += usize::from(truth != found.hit);
            }
            Met::Surrogate(Approximate { t, reach, error, deviation, .. }) => {
                let width = view.footprint.width + view.footprint.spread * f64::from(t);
                assert!(error <= pixels && reach <= error * width * (1.0 + 1e-6) && deviation >= 0.0);
                let off = to_surface(octree, point(ray, t), reach + slack);
                let off = off.unwrap_or_else(|| panic!("the surface is farther away than {reach}: {ray:?}, t {t}"));
                sum.largest = sum.largest.max(off / reach);
                sum.surrogates += 1;
                match truth {
                    Some(truth) => {
                        let beyond = (f64::from(t) - f64::from(truth.hit.t)) * length;
                        // Another part that holds it may have been taken behind this one, with its own error.
                        let allowed = pixels * width + slack;
                        assert!(beyond <= allowed, "the true hit is nearer by {beyond}, more than {allowed}: {ray:?}");
                        sum.direct += usize::from(beyond.abs() <= reach + slack);
                    }
                    None => sum.grown += 1,
                }
            }
        }
    }
    sum
}

/// The claims on a mesh, from near enough for triangles to far enough for hardly any.
fn check(octree: &Arc<Octree>, name: &str, least_surrogates: usize) {
    let from = [DVec3::new(0.3, 0.2, 1.0), DVec3::new(-1.0, 0.1, 0.05), DVec3::Y];
    let mut surrogates = 0;
    for (across, from) in [200, 40, 16].into_iter().zip(from) {
        for pixels in [0.5, 1.0, 3.0] {
            let view = view(octree, across, from);
            let m = measure(octree, &view, pixels);
            eprintln!("{name}, {across} pixels, --lod {pixels}: {m:?}");
            // The bound is no empty word: rays that are given a surrogate mostly do hit what it stands for.
            assert!(m.direct * 10 >= m.surrogates * 8, "{name}, {across}, {pixels}: {m:?}");
            assert!(m.beside * 50 <= m.triangles + 50, "{name}, {across}, {pixels}: {m:?}");
            surrogates += m.surrogates;
        }
    }
    assert!(surrogates >= least_surrogates, "{name}: {surrogates}");
}

#[test]
fn surrogates_are_as_near_as_they_claim() {
    let folder = tempfile::tempdir().unwrap();
    check(&planet(), "planet", 2000);
    check(&file(&asset("bunny.obj"), 1000, folder.path()), "bunny", 500);
    check(&file(&asset("bunny.obj"), 1 << 20, folder.path()), "bunny in one page", 500);
    check(&Arc::new(Mesh::room().octree(&pages(300))), "room", 0);
    for (split, name) in [(SplitMode::Octree, "planet in cells"), (SplitMode::Strict, "planet in strict cells")] {
        check(&Arc::new(planet_mesh(6).octree(&BuildOptions { split, ..pages(1000) })), name, 500);
    }
    match std::env::var_os("OCTRACE_DATA").map(|data| Path::new(&data).join("spot.obj")).filter(|spot| spot.exists()) {
        Some(spot) => check(&file(&spot, 1000, folder.path()), "spot", 50),
        None => eprintln!("skipped: spot.obj (OCTRACE_DATA is not set, or has none)"),
    }
}

#[test]
fn all_instruction_sets_agree() {
    let octree = planet();
    let view = view(&octree, 40, DVec3::new(0.3, 0.2, 1.0));
    let all = Isa::available().into_iter().map(|isa| met(&OctreeTracer::new(octree.clone()).with_isa(isa), &view, 1.0));
    let all: Vec<Vec<Met>> = all.collect();
    assert!(all.iter().all(|met| *met == all[0]));
    // Nor does the order matter.
    assert!(met(&OctreeTracer::new(octree.clone()).backward(), &view, 1.0) == all[0]);
}

/// Rays without width are traced exactly, as are those from very far away.
#[test]
fn lines_are_exact() {
    let octree = planet();
    let mut view = view(&octree, 40, DVec3::new(0.3, 0.2, 1.0));
    let tracer = OctreeTracer::new(octree.clone());
    let truth = |view: &View| -> Vec<Met> {
        let closest = |ray| tracer.closest(ray, Skip::NONE).unwrap().map_or(Met::Nothing, Met::Triangle);
        view.rays.iter().map(closest).collect()
    };
    view.footprint = Footprint::NONE;
    assert_eq!(met(&tracer, &view, 4.0), truth(&view));
    view.footprint = Footprint { width: 1.0, spread: 1.0, lifted: false };
    for ray in &mut view.rays {
        let d = Vec3::from_array(ray.direction).normalize() * 1e5;
        ray.origin = [ray.origin[0] - d.x, ray.origin[1] - d.y, ray.origin[2] - d.z];
    }
    assert_eq!(met(&tracer, &view, 4.0), truth(&view));
}

#[test]
fn rays_that_wait_for_pages_meet_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let octree = Arc::new(planet_mesh(7).octree_at(&folder.path().join("planet.oct"), &pages(500)));
    let view = view(&octree, 60, DVec3::new(0.4, 0.5, 0.8));
    let right = met(&OctreeTracer::new(octree.clone()), &view, 0.5);
    let surrogates = right.iter().filter(|met| matches!(met, Met::Surrogate(_))).count();
    let triangles = right.iter().filter(|met| matches!(met, Met::Triangle(_))).count();
    assert!(surrogates > 100 && triangles > 100, "{surrogates} surrogates, {triangles} triangles");
    let least = Octree::least_cache(octree.path()).unwrap();
    for cache in [least, 10 * least] {
        let octree = Arc::new(Octree::open_with(octree.path(), Read::Budgeted { cache }).unwrap());
        assert!(met(&OctreeTracer::new(octree.clone()), &view, 0.5) == right, "with {cache} bytes");
        let read = octree.figures();
        assert!(read.touched > 10 && read.reread > 0 && read.most_bytes <= cache, "{read:?}");
    }
}

#[test]
fn files_without_surrogates_and_linear_scenes_are_refused() {
    let octree = Arc::new(Mesh::sphere(3, 0.0).octree(&BuildOptions { lod: false, ..BuildOptions::default() }));
    let footprints = [Footprint { width: 1.0, spread: 0.0, lifted: false }];
    let ray = [Ray::new([0.0, 0.0, 5.0], [0.0, 0.0, -1.0])];
    let mut met = [Met::Nothing];
    let refused =
        OctreeTracer::new(octree.clone()).closest_coarse(&ray, &footprints, 1.0, &mut met, &mut Counters::default());
    assert!(refused.unwrap_err().to_string().contains("has no level of detail"));
}
