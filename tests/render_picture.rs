//! Pictures as a whole: pixels against the formula by hand, and what must not change a bit of them.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use glam::{DAffine3, DVec3, Vec3};
use octrace::map::Octree;
use octrace::render::{Picture, Settings, render};
use octrace::scene::{Camera, Color, Geometry, Light, LoadOptions, Material, Scene, Shape, ToneMap};
use octrace::shade::World;
use octrace::{Event, Monitor};

fn ball(center: DVec3, radius: f64, material: usize) -> Shape {
    Shape { geometry: Geometry::Sphere { center, radius, to_world: DAffine3::IDENTITY }, material }
}

fn floor(y: f64, material: usize) -> Shape {
    Shape { geometry: Geometry::Plane { point: DVec3::Y * y, normal: DVec3::Y }, material }
}

/// Looks from (0, 0, 10) at the origin; the image rectangle is 2 x 2 at the origin.
fn facing(shapes: Vec<Shape>, materials: Vec<Material>) -> Scene {
    Scene {
        size: [65, 65],
        camera: Camera::Rectangle {
            eye: DVec3::Z * 10.0,
            origin: DVec3::new(-1.0, -1.0, 0.0),
            horiz: DVec3::X * 2.0,
            vert: DVec3::Y * 2.0,
        },
        shapes,
        materials,
        ..Scene::default()
    }
}

fn picture(scene: &Scene, settings: Settings) -> Picture {
    let world = World::new(scene.clone(), Vec::new(), Monitor::silent()).unwrap();
    render(&world, &settings, Monitor::silent()).unwrap()
}

/// Many things at once: mirrors, glass, shadows, a rectangle, more than sixteen objects.
fn busy() -> Scene {
    let mirror = Material { reflect: 0.6, local: 0.5, specular: Color::ONE, ..Material::default() };
    let glass = Material { transmit: 0.8, ior: 1.5, local: 0.1, reflect: 0.1, ..Material::default() };
    let matte = Material { diffuse: Color::new(0.8, 0.3, 0.2), ..Material::default() };
    let at = |i: u32| DVec3::new(f64::from(i % 5) * 0.4 - 0.8, f64::from(i / 5) * 0.4 - 0.6, f64::from(i % 3) * 0.3);
    let mut shapes: Vec<Shape> = (0..20).map(|i| ball(at(i), 0.17, i as usize % 3)).collect();
    shapes.push(floor(-0.9, 2));
    Scene {
        lights: vec![
            Light::Point { position: DVec3::new(3.0, 5.0, 8.0), color: Color::splat(0.8) },
            Light::Sun { direction: DVec3::new(1.0, -2.0, -1.0), color: Color::splat(0.3) },
        ],
        background: Color::new(0.2, 0.3, 0.5),
        samples: 4,
        ..facing(shapes, vec![mirror, glass, matte])
    }
}

#[test]
fn a_sphere_by_hand() {
    let material = Material {
        ambient: Color::new(0.5, 0.0, 1.0),
        diffuse: Color::new(0.2, 0.6, 0.4),
        specular: Color::splat(0.5),
        shininess: 20.0,
        ..Material::default()
    };
    let light = DVec3::new(4.0, 3.0, 10.0);
    let mut scene = facing(vec![ball(DVec3::ZERO, 1.0, 0)], vec![material]);
    scene.lights = vec![Light::Point { position: light, color: Color::splat(0.7) }];
    let film = picture(&scene, Settings::default()).film;
    // Column 40, row 20 from the top = row 44 from the bottom.
    let eye = DVec3::Z * 10.0;
    let through = DVec3::new(-1.0 + 2.0 * 40.5 / 65.0, -1.0 + 2.0 * 44.5 / 65.0, 0.0);
    let d = (through - eye).normalize();
    let b = eye.dot(d);
    let n = eye + d * (-b - (b * b - 99.0).sqrt());
    let (l, v) = ((light - n).normalize(), -d);
    let h = (l + v).normalize();
    let want = 0.1 * material.ambient + 0.7 * (n.dot(l) * material.diffuse + n.dot(h).powf(20.0) * material.specular);
    let got = Vec3::from_array(film.at(40, 20)).as_dvec3();
    assert!((got - want).abs().max_element() < 1e-5, "{got} {want}");
    assert_eq!(film.at(0, 0), [0.0; 3], "past the sphere: the background");
}

#[test]
fn a_mirror_floor_shows_the_background_and_the_ball_its_shadow() {
    let mirror = Material { local: 0.0, reflect: 0.5, ..Material::default() };
    let mut scene = facing(vec![floor(-0.5, 0)], vec![mirror]);
    scene.background = Color::new(0.2, 0.4, 0.8);
    let film = picture(&scene, Settings::default()).film;
    assert_eq!(film.at(32, 64), [0.1, 0.2, 0.4]);
    assert_eq!(film.at(32, 0), [0.2, 0.4, 0.8]);
    // No bounce left: the mirror term is the background's colour as well.
    let none = picture(&scene, Settings { depth: Some(0), ..Settings::default() });
    assert_eq!((none.film.at(32, 64), none.statistics.rays.mirror), ([0.1, 0.2, 0.4], 0));

    let matte = Material { ambient: Color::ZERO, ..Material::default() };
    let mut scene = facing(vec![floor(-0.5, 0), ball(DVec3::new(0.0, 2.0, 0.0), 0.5, 0)], vec![matte]);
    scene.lights = vec![Light::Sun { direction: DVec3::NEG_Y, color: Color::ONE }];
    scene.camera = Camera::LookAt { eye: DVec3::new(0.0, 1.0, 9.0), at: DVec3::Y * -0.5, up: DVec3::Y, fov: 40.0 };
    let film = picture(&scene, Settings::default()).film;
    assert_eq!(film.at(32, 32), [0.0; 3], "in the shadow");
    assert!((film.at(2, 32)[0] - 1.0).abs() < 1e-6, "beside it");
}

#[test]
fn glass_without_refraction_is_not_there() {
    let clear = Material { local: 0.0, transmit: 1.0, ior: 1.0, ..Material::default() };
    let plain = Material { ambient: Color::new(0.1, 0.5, 0.9), ..Material::default() };
    let behind = ball(DVec3::new(0.1, 0.2, -3.0), 0.8, 1);
    let with = facing(vec![ball(DVec3::ZERO, 0.9, 0), behind], vec![clear, plain]);
    let without = facing(vec![behind], vec![clear, plain]);
    let [a, b] = [with, without].map(|s| picture(&s, Settings::default()).film);
    let differ = a.pixels().iter().zip(b.pixels()).filter(|(a, b)| a != b).count();
    assert!(differ < 20, "only the rounding of silhouettes may differ: {differ} pixels");
}

#[test]
fn threads_tiles_and_crops_change_nothing() {
    let scene = busy();
    let whole = picture(&scene, Settings::default());
    assert!(whole.complete && whole.statistics.rays.refracted > 0 && whole.statistics.rays.shadow > 0);
    assert_eq!(whole.statistics.rays.primary, 65 * 65 * 4);
    for threads in [1, 3] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let tile = if threads == 1 { 7 } else { 200 };
        let again = pool.install(|| picture(&scene, Settings { tile, ..Settings::default() }));
        assert_eq!(again.film, whole.film, "{threads} threads");
        assert_eq!(again.statistics.rays, whole.statistics.rays);
    }
    let crop = picture(&scene, Settings { crop: Some([11, 20, 50, 33]), ..Settings::default() }).film;
    assert_eq!((crop.width(), crop.height()), (39, 13));
    for y in 0..13 {
        for x in 0..39 {
            assert_eq!(crop.at(x, y), whole.film.at(x + 11, y + 20), "{x} {y}");
        }
    }
}

#[test]
fn an_interrupted_picture_is_partial() {
    let stop = AtomicBool::new(false);
    let tiles = AtomicU64::new(0);
    let sink = |event: Event| {
        if let Event::Progress { done, total, .. } = event {
            assert_eq!(total, Some(81));
            tiles.fetch_max(done, Ordering::Relaxed);
            stop.store(done >= 5, Ordering::Relaxed);
        }
    };
    let world = World::new(busy(), Vec::new(), Monitor::silent()).unwrap();
    let settings = Settings { tile: 8, ..Settings::default() };
    let picture = render(&world, &settings, Monitor::new(&sink, &stop)).unwrap();
    assert!(!picture.complete);
    assert_eq!(picture.statistics.tiles, tiles.into_inner());
    assert!((5..81).contains(&picture.statistics.tiles));
    assert!(picture.film.pixels().iter().any(|p| *p != [0.0; 3]));
    assert!(picture.film.pixels().contains(&[0.0; 3]));
}

#[test]
fn settings_that_make_no_picture_are_refused() {
    let world = World::new(busy(), Vec::new(), Monitor::silent()).unwrap();
    let wrong = [
        (Settings { size: Some([0, 5]), ..Settings::default() }, "65536"),
        (Settings { size: Some([70_000, 5]), ..Settings::default() }, "65536"),
        (Settings { samples: Some(3), ..Settings::default() }, "square"),
        (Settings { crop: Some([5, 5, 5, 9]), ..Settings::default() }, "crop"),
        (Settings { crop: Some([0, 0, 66, 9]), ..Settings::default() }, "crop"),
    ];
    for (settings, word) in wrong {
        let error = render(&world, &settings, Monitor::silent()).unwrap_err().to_string();
        assert!(error.contains(word), "{error}");
    }
}

#[test]
fn a_framed_scene_lies_within_the_picture() {
    for camera in [Camera::Auto, Camera::Frame(DVec3::NEG_Y), Camera::Frame(DVec3::new(1.0, 0.2, 0.0))] {
        let plain = Material { ambient: Color::splat(10.0), ..Material::default() };
        let shapes = vec![ball(DVec3::new(100.0, 7.0, 3.0), 2.0, 0), ball(DVec3::new(103.0, 7.0, 3.0), 1.0, 0)];
        let film = picture(&Scene { camera: camera.clone(), ..facing(shapes, vec![plain]) }, Settings::default()).film;
        let lit = film.pixels().iter().filter(|p| p[0] > 0.0).count();
        assert!(lit > 65 * 65 / 20, "{camera:?}: {lit}");
        for i in 0..65 {
            let border = [film.at(i, 0), film.at(i, 64), film.at(0, i), film.at(64, i)];
            assert_eq!(border, [[0.0; 3]; 4], "{camera:?}");
        }
    }
}

/// The folder of extra meshes, if there is one.
fn data() -> Option<PathBuf> {
    let folder = std::env::var_os("OCTRACE_DATA").map(PathBuf::from);
    if folder.is_none() {
        println!("OCTRACE_DATA is not set: skipped");
    }
    folder
}

/// Keeps a picture to be looked at, where OCTRACE_PICTURES names a folder.
fn keep(picture: &Picture, name: &str, tonemap: ToneMap) {
    if let Some(folder) = std::env::var_os("OCTRACE_PICTURES") {
        octrace::output::save(&picture.film, &Path::new(&folder).join(name), tonemap).unwrap();
        println!("{name}: {:?}", picture.statistics);
    }
}

#[test]
fn the_classic_scene_renders() {
    let Some(folder) = data() else { return };
    let path = folder.join("classic_scenes/input.txt");
    let scene = Scene::load(&path, LoadOptions::default(), Monitor::silent()).unwrap();
    let picture = picture(&scene, Settings::default());
    keep(&picture, "classic.png", scene.tonemap);
    let film = &picture.film;
    assert_eq!([film.width(), film.height()], [512, 512]);
    // Green sphere in the middle, red one to its right.
    let [r, g, _] = film.at(256, 256);
    assert!(g > 0.2 && g > r, "{:?}", film.at(256, 256));
    let [r, g, _] = film.at(352, 256);
    assert!(r > g, "{:?}", film.at(352, 256));
}

#[test]
fn meshes_render_the_same_by_octree_and_by_every_triangle() {
    let Some(folder) = data() else { return };
    let temp = tempfile::tempdir().unwrap();
    for (name, size) in [("bunny.obj", 24), ("spot.obj", 48), ("fandisk.obj", 48)] {
        let file = build(&folder.join(name), &temp.path().join(name).with_extension("oct"));
        let scene = Scene::for_mesh(&file, true);
        let make = |octree| {
            let mesh = Arc::new(Octree::open(&file).unwrap());
            World::new(Scene { octree, ..scene.clone() }, vec![mesh], Monitor::silent()).unwrap()
        };
        let settings = Settings { size: Some([size; 2]), samples: Some(1), ..Settings::default() };
        let fast = render(&make(true), &settings, Monitor::silent()).unwrap();
        let slow = render(&make(false), &settings, Monitor::silent()).unwrap();
        assert_eq!(fast.film, slow.film, "{name}");
        assert_eq!(fast.statistics.rays, slow.statistics.rays, "{name}");
        if std::env::var_os("OCTRACE_PICTURES").is_some() {
            let settings = Settings { samples: Some(1), ..Settings::default() };
            let large = render(&make(true), &settings, Monitor::silent()).unwrap();
            keep(&large, &format!("{name}.png"), scene.tonemap);
        }
    }
}

/// Builds `source` into `target`, textures found beside the source.
fn build(source: &Path, target: &Path) -> PathBuf {
    let texture = source.with_file_name("spot_texture.png");
    if texture.exists() {
        std::fs::copy(texture, target.with_file_name("spot_texture.png")).unwrap();
    }
    let mut mesh = octrace::mesh::open(source, &octrace::mesh::ReadOptions::default()).unwrap();
    octrace::build::build(&mut *mesh, target, &octrace::build::BuildOptions::default(), Monitor::silent()).unwrap();
    target.to_owned()
}

/// The six walls of a box, with shared corners.
fn walls(lo: Vec3, hi: Vec3) -> Vec<Geometry> {
    let corner = |i: usize| {
        let pick = |bit: usize, a: f32, b: f32| if i & bit > 0 { b } else { a };
        Vec3::new(pick(4, lo.x, hi.x), pick(2, lo.y, hi.y), pick(1, lo.z, hi.z))
    };
    let quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]];
    quads.map(|quad| Geometry::Rectangle(quad.map(corner))).to_vec()
}

#[test]
fn no_light_gets_into_a_room_of_mirrors() {
    let Some(folder) = data() else { return };
    let temp = tempfile::tempdir().unwrap();
    let file = build(&folder.join("bunny.obj"), &temp.path().join("bunny.oct"));
    let mut scene = Scene::for_mesh(&file, true);
    scene.materials.push(Material {
        ambient: Color::ZERO,
        diffuse: Color::splat(0.03),
        specular: Color::ZERO,
        reflect: 0.9,
        ..Material::default()
    });
    let (lo, hi) = (Vec3::new(-0.21, 0.0329, -0.17), Vec3::new(0.19, 0.31, 0.23));
    scene.shapes = walls(lo, hi).into_iter().map(|geometry| Shape { geometry, material: 2 }).collect();
    scene.floor = None;
    scene.lights = vec![Light::Point { position: DVec3::new(0.07, 0.29, 0.17), color: Color::splat(0.8) }];
    let at = DVec3::new(-0.02, 0.1, 0.0);
    scene.camera = Camera::LookAt { eye: DVec3::new(0.06, 0.19, 0.2), at, up: DVec3::Y, fov: 55.0 };
    // A ray that escapes brings a thousandfold light; one that is given up after 130 bounces, a thousandth.
    scene.background = Color::splat(1000.0);
    let mesh = Arc::new(Octree::open(&file).unwrap());
    let world = World::new(scene, vec![mesh], Monitor::silent()).unwrap();
    let side = if std::env::var_os("OCTRACE_PICTURES").is_some() { 512 } else { 64 };
    let settings = Settings { size: Some([side; 2]), samples: Some(1), depth: Some(1000), ..Settings::default() };
    let picture = render(&world, &settings, Monitor::silent()).unwrap();
    keep(&picture, "room.png", ToneMap::Srgb);
    let film = &picture.film;
    assert!(film.pixels().iter().flatten().all(|&x| x < 3.0 && x > 0.0), "a pixel is too bright, or black");
    assert!(picture.statistics.rays.mirror > 2 * picture.statistics.rays.primary);
}
