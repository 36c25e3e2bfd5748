//! Whole pictures with level of detail against exact ones.

use std::sync::Arc;

use glam::{DAffine3, DVec3};
use octrace::Monitor;
use octrace::map::{Octree, Read};
use octrace::render::{Picture, Settings, render};
use octrace::scene::{Camera, Geometry, Material, Scene, Shape};
use octrace::shade::World;

use super::{asset, file, pages, planet_mesh};

/// A scene that shows a mesh `across` pixels wide in the middle of a picture, with a lamp's shadows and a mirror's bounce.
fn far_scene(octree: &Octree, across: f64) -> Scene {
    let mut scene = Scene::for_mesh(octree.path(), true);
    let bounds = octree.bounds();
    let (centre, radius) =
        ((bounds.min + bounds.max).as_dvec3() * 0.5, 0.5 * (bounds.max - bounds.min).max_element() as f64);
    scene.size = [96, 96];
    let fov = 30f64;
    let distance = radius / (across / 96.0 * (fov / 2.0).to_radians().tan());
    scene.camera =
        Camera::LookAt { eye: centre + distance * DVec3::new(0.36, 0.48, 0.8), at: centre, up: DVec3::Y, fov };
    scene.floor = None;
    for material in &mut scene.materials {
        (material.reflect, material.diffuse) = (0.3, DVec3::new(0.4, 0.5, 0.6));
    }
    (scene.samples, scene.depth) = (4, 2);
    scene
}

fn drawn(octree: &Octree, scene: &Scene, lod: Option<f64>) -> (Picture, usize) {
    // Opened anew, so that it is known which pages are used.
    let octree = Arc::new(Octree::open(octree.path()).unwrap());
    let world = World::new(scene.clone(), vec![octree.clone()], Monitor::silent()).unwrap();
    let world = match lod {
        Some(pixels) => world.with_lod(pixels).unwrap(),
        None => world,
    };
    let picture = render(&world, &Settings::default(), Monitor::silent()).unwrap();
    (picture, octree.figures().touched as usize)
}

#[test]
fn level_zero_is_the_exact_picture() {
    let folder = tempfile::tempdir().unwrap();
    let octree = file(&asset("bunny.obj"), 1000, folder.path());
    let scene = far_scene(&octree, 60.0);
    let ((exact, pages), (zero, same_pages)) = (drawn(&octree, &scene, None), drawn(&octree, &scene, Some(0.0)));
    assert!(exact.film.pixels() == zero.film.pixels());
    assert_eq!((pages, zero.statistics.detail.hits), (same_pages, 0));
    assert_eq!(exact.statistics.rays, zero.statistics.rays);
}

#[test]
fn a_far_view_needs_few_pages_and_is_off_by_little() {
    let folder = tempfile::tempdir().unwrap();
    let octree = planet_mesh(8).octree_at(&folder.path().join("planet.oct"), &pages(4000));
    let scene = far_scene(&octree, 16.0);
    let (exact, pages) = drawn(&octree, &scene, None);
    let (coarse, few) = drawn(&octree, &scene, Some(1.0));
    assert!(few * 4 < pages, "{few} pages, {pages} of the exact picture");
    let detail = coarse.statistics.detail;
    assert!(detail.hits > 100 && detail.largest <= 1.0 && detail.largest > 0.2, "{detail:?}");
    assert_eq!(detail.histogram.iter().sum::<u64>(), detail.hits);
    let squares = exact
        .film
        .pixels()
        .iter()
        .zip(coarse.film.pixels())
        .flat_map(|(a, b)| (0..3).map(|i| f64::from(a[i] - b[i]).powi(2)));
    let (count, sum) = squares.fold((0, 0.0), |(count, sum), square| (count + 1, sum + square));
    let rmse = (sum / f64::from(count)).sqrt();
    eprintln!("{few} of {pages} pages, RMSE {rmse:.4}, {detail:?}");
    // The scene's own material is kept: the pictures are equally bright.
    let brightness = |film: &octrace::render::Film| film.pixels().iter().map(|p| f64::from(p[0])).sum::<f64>();
    let ratio = brightness(&coarse.film) / brightness(&exact.film);
    assert!((0.95..1.05).contains(&ratio), "{ratio}");
    assert!(rmse > 0.0 && rmse < 0.01, "{rmse}");
}

/// The same picture with what else is drawn, and how many surrogates its rays took.
fn picture(octree: &Octree, scene: &Scene, lod: f64, settings: &Settings) -> Picture {
    let octree = Arc::new(Octree::open(octree.path()).unwrap());
    let world = World::new(scene.clone(), vec![octree], Monitor::silent()).unwrap().with_lod(lod).unwrap();
    render(&world, settings, Monitor::silent()).unwrap()
}

/// A far scene with something of glass, or a mirror, between eye and mesh.
fn through(octree: &Octree, material: Material, shape: impl Fn(DVec3, DVec3) -> Geometry) -> Scene {
    let mut scene = far_scene(octree, 40.0);
    let Camera::LookAt { eye, at, .. } = scene.camera else { panic!("a camera that looks at something") };
    scene.shapes = vec![Shape { geometry: shape(eye, at - eye), material: scene.materials.len() }];
    scene.materials.push(material);
    scene.depth = 4;
    scene
}

/// What a lens shows may be larger by any factor than the same part of the mesh seen past it: no error in pixels is known there.
#[test]
fn what_a_lens_shows_is_exact() {
    let folder = tempfile::tempdir().unwrap();
    let octree = planet_mesh(6).octree_at(&folder.path().join("planet.oct"), &pages(1000));
    let glass = Material { local: 0.0, reflect: 0.0, transmit: 1.0, ior: 1.5, ..Material::default() };
    // It fills the view.
    let ball = |eye: DVec3, way: DVec3| Geometry::Sphere {
        center: eye + 0.3 * way,
        radius: 0.25 * way.length(),
        to_world: DAffine3::IDENTITY,
    };
    let scene = through(&octree, glass, ball);
    let [exact, coarse] = [0.0, 2.0].map(|lod| picture(&octree, &scene, lod, &Settings::default()));
    assert!(exact.statistics.rays.refracted > 10_000 && exact.statistics.rays.shadow > 100, "{:?}", exact.statistics);
    assert_eq!(coarse.statistics.detail.hits, 0);
    assert!(exact.film.pixels() == coarse.film.pixels());
    // Behind a flat boundary there are surrogates.
    let flat = |eye: DVec3, way: DVec3| Geometry::Plane { point: eye + 0.3 * way, normal: -way.normalize() };
    let scene = through(&octree, glass, flat);
    let [exact, coarse] = [0.0, 2.0].map(|lod| picture(&octree, &scene, lod, &Settings::default()));
    let detail = coarse.statistics.detail;
    assert!(detail.hits > 1000 && detail.largest <= 2.0, "{detail:?}");
    assert!(difference(&exact, &coarse) < 0.02, "{}", difference(&exact, &coarse));
}

/// Root mean square of the difference.
fn difference(a: &Picture, b: &Picture) -> f64 {
    let channels = a.film.pixels().as_flattened().iter().zip(b.film.pixels().as_flattened());
    let (sum, count) = channels.fold((0.0, 0), |(sum, n), (a, b)| (sum + f64::from(a - b).powi(2), n + 1));
    (sum / f64::from(count)).sqrt()
}

#[test]
fn threads_waves_and_reading_change_no_bit() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("planet.oct");
    let octree = planet_mesh(7).octree_at(&path, &pages(1000));
    let mirror = Material { local: 0.5, reflect: 0.5, ..Material::default() };
    let ball = |eye: DVec3, way: DVec3| Geometry::Sphere {
        center: eye + 0.9 * way + 0.2 * DVec3::X,
        radius: 0.02 * way.length(),
        to_world: DAffine3::IDENTITY,
    };
    let mut scene = through(&octree, mirror, ball);
    scene.floor = Some(0);
    let right = picture(&octree, &scene, 1.0, &Settings::default());
    let detail = right.statistics.detail;
    assert!(detail.hits > 1000 && right.statistics.rays.mirror > 1000, "{detail:?}");
    let same = |other: Picture, what: &str| {
        assert!(other.film.pixels() == right.film.pixels(), "{what}");
        assert_eq!((other.statistics.detail, other.statistics.rays), (detail, right.statistics.rays), "{what}");
    };
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let three = rayon::ThreadPoolBuilder::new().num_threads(3).build().unwrap();
    same(one.install(|| picture(&octree, &scene, 1.0, &Settings::default())), "one thread");
    let settings = Settings { tile: 8, wave: 5, ..Settings::default() };
    same(three.install(|| picture(&octree, &scene, 1.0, &settings)), "three threads, small waves");
    let least = Octree::least_cache(&path).unwrap();
    let small = Arc::new(Octree::open_with(&path, Read::Budgeted { cache: least }).unwrap());
    let world = World::new(scene.clone(), vec![small.clone()], Monitor::silent()).unwrap().with_lod(1.0).unwrap();
    same(three.install(|| render(&world, &Settings::default(), Monitor::silent()).unwrap()), "the least cache");
    assert!(small.figures().reread > 0, "{:?}", small.figures());
}
