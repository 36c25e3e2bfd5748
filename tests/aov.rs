//! Pictures of data against what is known of the scene and of the mesh.

use std::sync::Arc;

use glam::{DAffine3, DVec3};
use octrace::map::Octree;
use octrace::render::{Aov, AovKind, Eye, Settings, Values, aovs};
use octrace::scene::{Camera, Geometry, Instance, Light, Material, MeshFile, Scene, Shape};
use octrace::shade::World;
use octrace::{Error, Event, Monitor};

/// A ball before a wall at z = 0, seen from (0, 0, 10), 65 x 65 pixels over 2 x 2 of the wall, with one light from the right.
fn ball_before_wall() -> Scene {
    let ball = Geometry::Sphere { center: DVec3::Z, radius: 0.25, to_world: DAffine3::IDENTITY };
    let wall = Geometry::Plane { point: DVec3::ZERO, normal: DVec3::Z };
    let (eye, origin) = (DVec3::Z * 10.0, DVec3::new(-1.0, -1.0, 0.0));
    Scene {
        size: [65, 65],
        camera: Camera::Rectangle { eye, origin, horiz: DVec3::X * 2.0, vert: DVec3::Y * 2.0 },
        shapes: vec![Shape { geometry: ball, material: 1 }, Shape { geometry: wall, material: 0 }],
        materials: vec![Material::default(); 2],
        lights: vec![Light::Sun { direction: DVec3::new(-1.0, 0.0, -1.0), color: DVec3::ONE }],
        samples: 4,
        ..Scene::default()
    }
}

fn all(world: &World, settings: Settings) -> Vec<Aov> {
    aovs(world, &settings, &AovKind::ALL, Monitor::silent()).unwrap()
}

fn scalars(aovs: &[Aov], kind: AovKind) -> &[f32] {
    match &aovs.iter().find(|aov| aov.kind == kind).unwrap().values {
        Values::Scalar(values) => values,
        other => panic!("{other:?}"),
    }
}

fn vectors(aovs: &[Aov], kind: AovKind) -> &[[f32; 3]] {
    match &aovs.iter().find(|aov| aov.kind == kind).unwrap().values {
        Values::Vector(values) => values,
        other => panic!("{other:?}"),
    }
}

fn ids(aovs: &[Aov], kind: AovKind) -> &[u32] {
    match &aovs.iter().find(|aov| aov.kind == kind).unwrap().values {
        Values::Id(values) => values,
        other => panic!("{other:?}"),
    }
}

#[test]
fn shapes_are_where_they_are() {
    let world = World::new(ball_before_wall(), Vec::new(), Monitor::silent()).unwrap();
    let aovs = all(&world, Settings::default());
    let at = |x: usize, y: usize| y * 65 + x;
    let (middle, corner) = (at(32, 32), at(0, 0));
    let depth = scalars(&aovs, AovKind::Depth);
    assert_eq!(depth[middle], 8.75);
    assert!((f64::from(depth[corner]) - DVec3::new(64.0 / 65.0, 64.0 / 65.0, 10.0).length()).abs() < 1e-5);
    let normal = vectors(&aovs, AovKind::Normal);
    assert_eq!((normal[middle], normal[corner]), ([0.0, 0.0, 1.0], [0.0, 0.0, 1.0]));
    assert!(normal[at(30, 32)][0] < -0.1, "the ball's left side");
    let position = vectors(&aovs, AovKind::Position);
    assert!((position[middle][2] - 1.25).abs() < 1e-6 && (position[corner][1] - 64.0 / 65.0).abs() < 1e-6);
    let material = ids(&aovs, AovKind::Material);
    assert_eq!((material[middle], material[corner]), (1, 0));
    assert!(ids(&aovs, AovKind::Face).iter().all(|&face| face == u32::MAX), "spheres and planes have no faces");
    // The shadow falls to the left of the ball, by its height above the wall.
    let shadow = scalars(&aovs, AovKind::Shadow);
    let column = |x: f64| ((x + 1.0) * 32.5) as usize;
    assert_eq!((shadow[at(column(-0.95), 32)], shadow[at(column(0.9), 32)]), (1.0, 0.0));
    assert_eq!((shadow[at(column(-0.25), 32)], shadow[at(column(0.25), 32)]), (1.0, 0.0), "the ball's own dark side");
    // Without a mesh no node is visited.
    assert!(scalars(&aovs, AovKind::Cost).iter().all(|&cost| cost == 0.0));
}

#[test]
fn shadows_are_of_light_and_not_of_what_a_surface_makes_of_it() {
    let mut scene = ball_before_wall();
    let mirror = Material { local: 0.0, reflect: 1.0, ..Material::default() };
    let black = Material { diffuse: DVec3::ZERO, specular: DVec3::ZERO, ..Material::default() };
    scene.materials = vec![black, mirror];
    let world = World::new(scene, Vec::new(), Monitor::silent()).unwrap();
    let plain = World::new(ball_before_wall(), Vec::new(), Monitor::silent()).unwrap();
    let [odd, plain] = [world, plain].map(|world| all(&world, Settings::default()));
    assert_eq!(scalars(&odd, AovKind::Shadow), scalars(&plain, AovKind::Shadow));
}

#[test]
fn work_is_counted_among_many_objects_too() {
    let folder = tempfile::tempdir().unwrap();
    let octree = sheet(folder.path());
    let mut scene = with_sheet(octree.clone()).scene().clone();
    // More than stand in a list; none is seen.
    scene.shapes = (0..20)
        .map(|i| {
            let center = DVec3::new(f64::from(i), 50.0, 0.0);
            let geometry = Geometry::Sphere { center, radius: 0.25, to_world: DAffine3::IDENTITY };
            Shape { geometry, material: 1 }
        })
        .collect();
    let world = World::new(scene, vec![octree], Monitor::silent()).unwrap();
    let aovs = all(&world, Settings::default());
    let (faces, cost) = (ids(&aovs, AovKind::Face), scalars(&aovs, AovKind::Cost));
    assert!(faces.iter().zip(cost).filter(|x| *x.0 != u32::MAX).all(|x| *x.1 >= 8.0));
}

/// The planet of `octbench mesh` is not at hand here: a bumpy sheet of many pages.
fn sheet(folder: &std::path::Path) -> Arc<Octree> {
    let n = 60;
    let point = |i: usize, j: usize| {
        let [x, y] = [i, j].map(|k| k as f64 / n as f64 * 2.0 - 1.0);
        format!("v {x} {y} {}\n", 0.1 * ((7.0 * x).sin() + (5.0 * y).cos()))
    };
    let corner = |i: usize, j: usize| i * (n + 1) + j + 1;
    let faces = |(i, j): (usize, usize)| {
        let (a, b, c, d) = (corner(i, j), corner(i + 1, j), corner(i + 1, j + 1), corner(i, j + 1));
        format!("f {a} {b} {c}\nf {a} {c} {d}\n")
    };
    let grid = |n: usize| (0..n).flat_map(move |i| (0..n).map(move |j| (i, j)));
    let text: String = grid(n + 1).map(|(i, j)| point(i, j)).chain(grid(n).map(faces)).collect();
    let (obj, oct) = (folder.join("sheet.obj"), folder.join("sheet.oct"));
    std::fs::write(&obj, text).unwrap();
    let options = octrace::build::BuildOptions { brick: Some(500), ..Default::default() };
    let mut source = octrace::mesh::open(&obj, &octrace::mesh::ReadOptions::default()).unwrap();
    octrace::build::build(source.as_mut(), &oct, &options, Monitor::silent()).unwrap();
    Arc::new(Octree::open(&oct).unwrap())
}

fn with_sheet(octree: Arc<Octree>) -> World {
    let mut scene = ball_before_wall();
    scene.shapes.clear();
    scene.meshes = vec![MeshFile { path: octree.path().to_owned(), built: true }];
    scene.instances = vec![Instance { mesh: 0, to_world: DAffine3::IDENTITY, material: 1, mtl: false, smooth: false }];
    World::new(scene, vec![octree], Monitor::silent()).unwrap()
}

#[test]
fn a_mesh_tells_faces_and_work() {
    let folder = tempfile::tempdir().unwrap();
    let octree = sheet(folder.path());
    let world = with_sheet(octree.clone());
    let aovs = all(&world, Settings::default());
    let faces = ids(&aovs, AovKind::Face);
    let eye = Eye::new(&world, [65, 65]).unwrap();
    for (i, &face) in faces.iter().enumerate() {
        let (x, y) = (i % 65, i / 65);
        let ray = eye.ray(x as f64 + 0.5, (64 - y) as f64 + 0.5);
        let contact = world.closest(&ray, octrace::shade::Omit::NOTHING).unwrap();
        assert_eq!(face == u32::MAX, contact.is_none(), "pixel {x}, {y}");
        if let Some(contact) = contact {
            let depth = f64::from(contact.t) * ray.direction().length();
            assert!((f64::from(scalars(&aovs, AovKind::Depth)[i]) / depth - 1.0).abs() < 1e-5);
        }
    }
    let distinct: std::collections::HashSet<_> = faces.iter().filter(|face| **face != u32::MAX).collect();
    assert!(distinct.len() > 2000 && distinct.iter().all(|face| **face < 7200), "{}", distinct.len());
    // Four samples, each with a shadow ray: more than four nodes where the sheet is seen.
    let (cost, pages) = (scalars(&aovs, AovKind::Cost), scalars(&aovs, AovKind::Pages));
    assert!((0..cost.len()).filter(|&i| faces[i] != u32::MAX).all(|i| cost[i] >= 8.0 && pages[i] >= 4.0));
    assert!(cost.iter().any(|c| *c != cost[0]));
}

/// Where pages have to be read: nowhere in a mapped file, and again and again where only one has room. All else is the same.
#[test]
fn reads_are_where_pages_were_not_in_memory() {
    let folder = tempfile::tempdir().unwrap();
    let mapped = sheet(folder.path());
    let cache = Octree::least_cache(mapped.path()).unwrap();
    let read = |cache| Octree::open_with(mapped.path(), octrace::map::Read::Budgeted { cache }).map(Arc::new).unwrap();
    let (small, large) = (read(cache), read(1000 * cache));
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let settings = Settings { crop: Some([20, 20, 40, 40]), ..Settings::default() };
    let make = |octree: &Arc<Octree>, kinds: &[AovKind]| {
        let world = with_sheet(octree.clone());
        pool.install(|| aovs(&world, &settings, kinds, Monitor::silent()).unwrap())
    };
    let [mapped_reads, one, all_of_it] = [&mapped, &small, &large].map(|octree| make(octree, &[AovKind::Reads]));
    let sum = |aovs: &[Aov]| scalars(aovs, AovKind::Reads).iter().map(|&n| f64::from(n)).sum::<f64>();
    assert_eq!(sum(&mapped_reads), 0.0);
    let figures = [&small, &large].map(|octree| octree.figures());
    assert!(sum(&one) > sum(&all_of_it) && sum(&all_of_it) > 0.0, "{} {}", sum(&one), sum(&all_of_it));
    assert!(figures[0].reread > 10 && figures[1].reread == 0, "{figures:?}");
    assert!(sum(&all_of_it) <= figures[1].read as f64, "{figures:?}");
    // Nothing is there once it is forgotten.
    large.forget();
    assert_eq!(make(&large, &[AovKind::Reads]), all_of_it);
    let kinds = AovKind::ALL.into_iter().filter(|kind| *kind != AovKind::Reads).collect::<Vec<_>>();
    let expected = make(&mapped, &kinds);
    for octree in [&small, &large] {
        for (expected, aov) in expected.iter().zip(make(octree, &kinds)) {
            if *expected == aov {
                continue;
            }
            // Questions that are asked for several rays at a time are asked again, ray by ray, where a page is missing.
            assert!(matches!(aov.kind, AovKind::Cost | AovKind::Pages), "{:?}", aov.kind);
            let (Values::Scalar(least), Values::Scalar(work)) = (&expected.values, &aov.values) else { unreachable!() };
            assert!(least.iter().zip(work).all(|(least, work)| least <= work), "{:?}: work is lost", aov.kind);
            let more = least.iter().zip(work).filter(|(least, work)| least < work).count();
            assert!(more < least.len() / 8, "{:?}: {more} of {}", aov.kind, least.len());
        }
    }
}

#[test]
fn a_crop_and_threads_change_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let world = with_sheet(sheet(folder.path()));
    let whole = all(&world, Settings::default());
    let part = all(&world, Settings { crop: Some([20, 10, 40, 50]), ..Settings::default() });
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    assert_eq!(pool.install(|| all(&world, Settings::default())), whole);
    assert_eq!(all(&world, Settings { wave: 7, tile: 5, ..Settings::default() }), whole);
    for (whole, part) in whole.iter().zip(&part) {
        assert_eq!((part.width, part.height), (20, 40));
        let from = |x: usize, y: usize| (y + 10) * 65 + x + 20;
        for (x, y) in (0..40).flat_map(|y| (0..20).map(move |x| (x, y))) {
            let same = match (&whole.values, &part.values) {
                (Values::Scalar(a), Values::Scalar(b)) => a[from(x, y)] == b[y * 20 + x],
                (Values::Vector(a), Values::Vector(b)) => a[from(x, y)] == b[y * 20 + x],
                (Values::Id(a), Values::Id(b)) => a[from(x, y)] == b[y * 20 + x],
                _ => false,
            };
            assert!(same, "{:?} at {x}, {y}", whole.kind);
        }
    }
}

#[test]
fn an_interruption_ends_it() {
    let world = World::new(ball_before_wall(), Vec::new(), Monitor::silent()).unwrap();
    let stop = std::sync::atomic::AtomicBool::new(true);
    let silent = |_: Event| {};
    let result = aovs(&world, &Settings::default(), &[AovKind::Depth], Monitor::new(&silent, &stop));
    assert!(matches!(result, Err(Error::Interrupted)));
}
