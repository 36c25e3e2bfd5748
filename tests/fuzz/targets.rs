//! What is held against hostile input: each target takes bytes and must come back, without a panic, whatever they are.

use std::path::{Path, PathBuf};

use octrace::build::BuildOptions;
use octrace::geometry::{Aabb, Hit, Ray, Skip};
use octrace::map::{Octree, Read};
use octrace::mesh::ReadOptions;
use octrace::render::Settings;
use octrace::scene::{LoadOptions, Scene, ToneMap};
use octrace::shade::{Texture, World};
use octrace::trace::{
    Counters, Footprint, Isa, Met, OctreeTracer, Order, Tracer, all_hits, attributes, triangles_in_box,
};
use octrace::{Error, Monitor};

use super::reading;

/// A name, and what is done with the bytes in a folder of its own.
pub struct Target {
    pub name: &'static str,
    pub run: fn(&[u8], &Path) -> Outcome,
}

/// The target of that name.
pub fn named(name: &str) -> &'static Target {
    TARGETS.iter().find(|t| t.name == name).unwrap_or_else(|| panic!("no target {name}"))
}

/// How an input was taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// It was right, or near enough.
    Taken,
    /// It was refused with a message.
    Refused,
}

/// All of them.
pub const TARGETS: [Target; 10] = [
    Target { name: "obj", run: obj },
    Target { name: "mtl", run: mtl },
    Target { name: "ply", run: ply },
    Target { name: "stl", run: stl },
    Target { name: "archive", run: archive },
    Target { name: "texture", run: texture },
    Target { name: "scene", run: scene },
    Target { name: "oct", run: oct },
    Target { name: "rays", run: rays },
    Target { name: "resume", run: super::resume::run },
];

/// Every message must say something, and never ends in a line break.
pub fn told(error: &Error) -> Outcome {
    let text = error.to_string();
    assert!(!text.trim().is_empty() && !text.ends_with('\n'), "{text:?}");
    Outcome::Refused
}

/// A mesh is read, built and, where that succeeds, the file must be sound and hold what the report says.
fn mesh(bytes: &[u8], path: PathBuf) -> Outcome {
    std::fs::write(&path, bytes).unwrap();
    reading::check(&path);
    let oct = path.with_extension("oct");
    let mut outcome = Outcome::Refused;
    for lenient in [false, true] {
        let options = BuildOptions { brick: Some(100), memory: 64 << 20, ..BuildOptions::default() };
        let built = octrace::mesh::open(&path, &reading::options(lenient))
            .and_then(|mut source| octrace::build::build(source.as_mut(), &oct, &options, Monitor::silent()));
        match built {
            Ok(report) => {
                let octree = Octree::open(&oct).unwrap();
                octree.verify(Monitor::silent()).unwrap();
                assert_eq!(octree.header().triangles, report.triangles);
                trace(&octree, 1, true);
                outcome = Outcome::Taken;
            }
            Err(error) => {
                told(&error);
            }
        }
    }
    outcome
}

fn obj(bytes: &[u8], folder: &Path) -> Outcome {
    mesh(bytes, folder.join("mesh.obj"))
}

fn ply(bytes: &[u8], folder: &Path) -> Outcome {
    mesh(bytes, folder.join("mesh.ply"))
}

fn stl(bytes: &[u8], folder: &Path) -> Outcome {
    mesh(bytes, folder.join("mesh.stl"))
}

/// OBJ, compressed in one way or another.
fn archive(bytes: &[u8], folder: &Path) -> Outcome {
    mesh(bytes, folder.join(packed_name(bytes)))
}

fn packed_name(bytes: &[u8]) -> &'static str {
    if bytes.starts_with(&[0x1f, 0x8b]) { "packed.obj.gz" } else { "packed.obj.zst" }
}

/// Only reads a mesh, in the targets that build one; false for the others.
pub fn only_read(target: &str, bytes: &[u8], folder: &Path) -> bool {
    let (name, bytes) = match target {
        "obj" => ("mesh.obj", bytes),
        "ply" => ("mesh.ply", bytes),
        "stl" => ("mesh.stl", bytes),
        "archive" => (packed_name(bytes), bytes),
        "mtl" => {
            std::fs::write(folder.join("a.mtl"), bytes).unwrap();
            ("mesh.obj", MTL_MESH)
        }
        _ => return false,
    };
    let path = folder.join(name);
    std::fs::write(&path, bytes).unwrap();
    reading::check(&path);
    true
}

/// A mesh that uses materials.
const MTL_MESH: &[u8] =
    b"mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nusemtl red\nf 1/1 2/1 3/1\nusemtl glass\nf 3/1 2/1 1/1\n";

/// A picture on a mesh that is drawn. Formats are known by their first bytes; what has none that are known is taken for TGA.
fn texture(bytes: &[u8], folder: &Path) -> Outcome {
    let oct = folder.join("textured.oct");
    if !oct.exists() {
        std::fs::write(folder.join("t.mtl"), "newmtl t\nKd 1 1 1\nmap_Kd picture.tga\n").unwrap();
        let obj = folder.join("textured.obj");
        let text = "mtllib t.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nusemtl t\nf 1/1 2/2 3/3\n";
        std::fs::write(&obj, text).unwrap();
        let mut source = octrace::mesh::open(&obj, &ReadOptions::default()).unwrap();
        octrace::build::build(source.as_mut(), &oct, &BuildOptions::default(), Monitor::silent()).unwrap();
    }
    let picture = folder.join("picture.tga");
    std::fs::write(&picture, bytes).unwrap();
    let mut scene = Scene::for_mesh(oct, true);
    scene.size = [4, 4];
    draw(scene);
    match Texture::open(&picture, ToneMap::Srgb) {
        Ok(_) => Outcome::Taken,
        Err(error) => told(&error),
    }
}

/// Materials of a mesh that uses some.
fn mtl(bytes: &[u8], folder: &Path) -> Outcome {
    std::fs::write(folder.join("a.mtl"), bytes).unwrap();
    let taken = mesh(MTL_MESH, folder.join("mesh.obj"));
    if taken == Outcome::Taken {
        let mut scene = Scene::for_mesh(folder.join("mesh.oct"), true);
        scene.size = [4, 4];
        draw(scene);
    }
    taken
}

/// A scene is read and, if it is right, drawn small.
fn scene(bytes: &[u8], folder: &Path) -> Outcome {
    let path = folder.join("scene.txt");
    std::fs::write(&path, bytes).unwrap();
    let mut outcome = Outcome::Refused;
    for lenient in [false, true] {
        match Scene::load(&path, LoadOptions { lenient }, Monitor::silent()) {
            Ok(scene) => {
                draw(scene);
                // A lenient reader takes nearly everything.
                if !lenient {
                    outcome = Outcome::Taken;
                }
            }
            Err(error) => {
                told(&error);
            }
        }
    }
    outcome
}

/// Draws a few pixels; meshes that are not there are no concern here.
fn draw(scene: Scene) {
    let meshes: Result<Vec<_>, Error> = scene.meshes.iter().map(|m| Octree::open(&m.path).map(Into::into)).collect();
    let world = meshes.and_then(|meshes| World::new(scene, meshes, Monitor::silent()));
    let settings = Settings { size: Some([6, 4]), samples: Some(1), depth: Some(6), ..Settings::default() };
    let picture = world.and_then(|world| octrace::render::render(&world, &settings, Monitor::silent()));
    if let Err(error) = picture {
        told(&error);
    }
}

/// An octree file is opened, verified and traced.
fn oct(bytes: &[u8], folder: &Path) -> Outcome {
    let path = folder.join("file.oct");
    std::fs::write(&path, bytes).unwrap();
    let octree = match Octree::open(&path) {
        Ok(octree) => octree,
        Err(error) => return told(&error),
    };
    // Traced before it is verified: pages are checked when they are first used.
    let seed = xxhash_rust::xxh3::xxh3_64(bytes);
    trace(&octree, seed, false);
    coarse(&octree, seed);
    // With memory for few pages, which come and go.
    let cache = Octree::least_cache(&path).unwrap().min(64 << 20);
    if let Ok(octree) = Octree::open_with(&path, Read::Budgeted { cache }) {
        trace(&octree, seed / 3, false);
        coarse(&octree, seed);
    }
    // Its materials and attributes are used, and the textures that it names.
    let mut scene = Scene::for_mesh(path, true);
    scene.size = [6, 4];
    draw(scene);
    match octree.verify(Monitor::silent()) {
        Ok(()) => Outcome::Taken,
        Err(error) => told(&error),
    }
}

/// Rays through a file. An honest one is traced by every kernel in every order, and all give the same hits; one whose boxes lie by every
/// kernel in the order that the seed names, and nothing is expected but that rays come back.
fn trace(octree: &Octree, seed: u64, honest: bool) {
    let mut rays = some_rays(octree.bounds(), seed);
    if !honest && !seed.is_multiple_of(8) {
        // The rays that no floating point number can decide take longer than all the others.
        rays.truncate(rays.len() - EXTREME);
    }
    let orders = [Order::Single, Order::Flight, Order::Packet];
    let orders = if honest { &orders[..] } else { &orders[(seed % 3) as usize..][..1] };
    let skips = vec![Skip::NONE; rays.len()];
    let mut answers: Option<Vec<_>> = None;
    for isa in Isa::available() {
        for &order in orders {
            let tracer = OctreeTracer::new(octree).with_isa(isa).with_order(order);
            let mut found = vec![None; rays.len()];
            let mut blocked = vec![false; rays.len()];
            let counters = &mut Counters::default();
            let closest = tracer.closest_each(&rays, &skips, &mut found, counters);
            let any = tracer.any_each(&rays, &skips, &mut blocked, counters);
            let short = tracer.any_short(&rays, &skips, &mut blocked, counters);
            if closest.is_err() || any.is_err() || short.is_err() {
                return;
            }
            for found in found.iter().flatten() {
                let _ = attributes(octree, found);
            }
            let hits: Vec<Option<Hit>> = found.iter().map(|found| found.as_ref().map(|f| f.hit)).collect();
            match &answers {
                Some(before) if honest => assert_eq!(before, &hits, "{} {order:?}", isa.name()),
                _ => answers = Some(hits),
            }
        }
    }
    let tracer = OctreeTracer::new(octree);
    let _ = all_hits(&tracer, &rays[0], Skip::NONE).take(100).collect::<Vec<_>>();
    let _ = triangles_in_box(octree, Some(octree.bounds()), &mut |_| Ok(()));
}

/// The same with level of detail, if the file has it.
fn coarse(octree: &Octree, seed: u64) {
    let rays = some_rays(octree.bounds(), seed);
    let widths: Vec<Footprint> =
        (0..rays.len()).map(|i| Footprint { width: 0.02 * i as f64, spread: 0.01, lifted: i % 3 == 0 }).collect();
    let (mut met, counters) = (vec![Met::Nothing; rays.len()], &mut Counters::default());
    let _ = OctreeTracer::new(octree).closest_coarse(&rays, &widths, 1.0, &mut met, counters);
}

/// How many of the last of [`some_rays`] reach the ends of what a float can hold.
const EXTREME: usize = 3;

/// Rays about a box, some of them odd.
fn some_rays(bounds: Aabb, seed: u64) -> Vec<Ray> {
    let mut random = super::random::Random(seed);
    let (low, high) = (bounds.min.to_array(), bounds.max.to_array());
    let mut number = |axis: usize| {
        let share = (random.bits() >> 40) as f32 / 16_777_216.0;
        low[axis] + (high[axis] - low[axis]) * (1.5 * share - 0.25)
    };
    let mut rays: Vec<Ray> = (0..20)
        .map(|_| {
            let (a, b): ([f32; 3], [f32; 3]) = (std::array::from_fn(&mut number), std::array::from_fn(&mut number));
            Ray { origin: a, direction: std::array::from_fn(|i| b[i] - a[i]), tmin: 0.0, tmax: f32::INFINITY }
        })
        .collect();
    let ray = |origin, direction, tmax| Ray { origin, direction, tmin: 0.0, tmax };
    rays.push(ray(low, [0.0, 0.0, 1.0], f32::INFINITY));
    rays.push(ray(high, [-1e-30, 1e30, -0.0], 1.0));
    rays.push(ray([f32::NAN; 3], [1.0; 3], 1.0));
    rays.push(ray([3.4e38; 3], [-1.0; 3], f32::INFINITY));
    rays
}

/// Any 32 bytes are a ray: all kernels must give the same hits on a small mesh, of which each is what the test of every triangle gives.
fn rays(bytes: &[u8], folder: &Path) -> Outcome {
    let oct = folder.join("rays.oct");
    if !oct.exists() {
        let obj = folder.join("rays.obj");
        std::fs::write(&obj, super::seeds::sheet(20)).unwrap();
        let options = BuildOptions { brick: Some(64), ..BuildOptions::default() };
        let mut source = octrace::mesh::open(&obj, &ReadOptions::default()).unwrap();
        octrace::build::build(source.as_mut(), &oct, &options, Monitor::silent()).unwrap();
    }
    let octree = Octree::open(&oct).unwrap();
    let record =
        |b: &[u8]| -> [f32; 8] { std::array::from_fn(|i| f32::from_le_bytes(b[4 * i..][..4].try_into().unwrap())) };
    let ray = |r: [f32; 8]| Ray { origin: [r[0], r[1], r[2]], direction: [r[3], r[4], r[5]], tmin: r[6], tmax: r[7] };
    let rays: Vec<Ray> = bytes.chunks_exact(32).take(256).map(|b| ray(record(b))).collect();
    let linear = octrace::trace::LinearTracer::new(&octree).unwrap();
    let mut right = vec![Hit::MISS; rays.len()];
    linear.closest_batch(&rays, &mut right).unwrap();
    for isa in Isa::available() {
        for order in [Order::Single, Order::Flight, Order::Packet] {
            let tracer = OctreeTracer::new(&octree).with_isa(isa).with_order(order);
            let mut hits = vec![Hit::MISS; rays.len()];
            tracer.closest_batch(&rays, &mut hits).unwrap();
            assert_eq!(hits, right, "{} {order:?}", isa.name());
            let mut blocked = vec![false; rays.len()];
            tracer.any_batch(&rays, &mut blocked).unwrap();
            assert!(blocked.iter().zip(&right).all(|(b, hit)| *b == (*hit != Hit::MISS)), "{} {order:?}", isa.name());
        }
    }
    Outcome::Taken
}
