//! Pictures of a file that is many times larger than the memory its pages may take: the same bits by every way of reading it.
//!
//! Primary, shadow and mirror rays all meet the mesh, which shades with normals of its own, so that pages are needed again when a hit is
//! shaded. Here pages may take as little as one page does; what the programs bound, all their memory, `streaming_tools.rs` tests.

mod trace_common;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use octrace::build::{BuildOptions, build};
use octrace::event::Monitor;
use octrace::map::{Figures, Octree, Read};
use octrace::render::{Settings, render};
use octrace::scene::{LoadOptions, Scene};
use octrace::shade::World;
use trace_common::Mesh;

/// A mirroring ball before a mirroring wall, with shadows of a lamp and of a sun.
const SCENE: &str = "\
resolution 72 60
samples 4
depth 3
lookat 1 1.5 4  0 0 0  0 1 0
background 0.2 0.3 0.4
light 3 5 4 1
sun -1 -1 -0.5 0.5
reflect 0.5
plane 0 0 -2  0 0.1 1
plane 0 -1 0  0 1 0
oct FILE
";

/// A picture's bits, with what was read for it.
fn draw(path: &Path, read: Read, threads: usize) -> (Vec<[u32; 3]>, Figures) {
    let text = path.with_extension("txt");
    std::fs::write(&text, SCENE.replace("FILE", path.file_name().unwrap().to_str().unwrap())).unwrap();
    let scene = Scene::load(&text, LoadOptions::default(), Monitor::silent()).unwrap();
    let octree = Arc::new(Octree::open_with(path, read).unwrap());
    let world = World::new(scene, vec![octree.clone()], Monitor::silent()).unwrap();
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    let picture = pool.install(|| render(&world, &Settings::default(), Monitor::silent())).unwrap();
    assert!(picture.complete);
    let rays = picture.statistics.rays;
    assert!(rays.mirror > 1000 && rays.shadow > 1000, "{rays:?}");
    (picture.film.pixels().iter().map(|pixel| pixel.map(f32::to_bits)).collect(), octree.figures())
}

/// The file, and the same packed.
fn files(folder: &Path) -> [PathBuf; 2] {
    let mesh = Mesh::sphere(6, 0.02);
    [("ball.oct", None), ("packed.oct", Some(1))].map(|(name, compress)| {
        let path = folder.join(name);
        let options = BuildOptions { brick: Some(300), compress, ..BuildOptions::default() };
        build(&mut mesh.source(), &path, &options, Monitor::silent()).unwrap();
        path
    })
}

#[test]
fn the_same_bits_by_every_way_of_reading() {
    let folder = tempfile::tempdir().unwrap();
    let [plain, packed] = &files(folder.path());
    let [one, file] = [Octree::least_cache(plain).unwrap(), std::fs::metadata(plain).unwrap().len()];
    // The smallest budget but for one page alone.
    let small = file / 16;
    assert!(file >= 8 * small && small >= 2 * one, "{file} bytes, {one} a page");
    let (expected, mapped) = draw(plain, Read::Mapped, 1);
    let cases = [
        (plain, Read::Mapped),
        (plain, Read::Budgeted { cache: small }),
        (plain, Read::Budgeted { cache: file / 4 }),
        (packed, Read::Budgeted { cache: small }),
        (plain, Read::Budgeted { cache: one }),
        (packed, Read::Budgeted { cache: one }),
    ];
    for (path, read) in cases {
        for threads in [1, 2] {
            let (bits, figures) = draw(path, read, threads);
            let case = format!("{}, {read:?}, {threads} threads: {figures:?}", path.display());
            println!("{case}");
            assert!(bits == expected, "{case}");
            let Read::Budgeted { cache } = read else { continue };
            assert!(figures.most_bytes <= cache && figures.touched <= mapped.touched, "{case}");
            assert!(figures.reread > 0 || cache > small, "{case}");
        }
    }
}
