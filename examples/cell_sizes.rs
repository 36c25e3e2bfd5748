//! How much the octree gains, by the size of its cells: draws one small picture of a mesh by testing every triangle, and
//! through octrees whose cells hold ever more triangles, and prints a Markdown table.
//!
//! `cargo run --release --example cell_sizes [MESH.obj]`. The picture is 128 x 128 pixels with one lamp and its shadows;
//! it is compared bit for bit. Times are the best of several runs.

use std::error::Error;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use octrace::Monitor;
use octrace::build::BuildOptions;
use octrace::format::SplitMode;
use octrace::map::Octree;
use octrace::mesh::ReadOptions;
use octrace::render::{Picture, Settings, render};
use octrace::scene::Scene;
use octrace::shade::World;

/// Most triangles in a cell.
const CELLS: [u32; 7] = [1, 2, 4, 8, 16, 32, 64];
/// Most triangles in a leaf record, which bounds the leaves of `--split sah`.
const LEAF: u32 = 16;
/// Side of the picture in pixels.
const SIDE: u32 = 128;
/// How often a picture through an octree is drawn; the best time counts.
const RUNS: u32 = 7;

type Outcome<T> = Result<T, Box<dyn Error>>;

fn main() -> Outcome<()> {
    let mesh = PathBuf::from(std::env::args_os().nth(1).unwrap_or_else(|| "assets/bunny.obj".into()));
    let folder = tempfile::tempdir()?;
    let file = folder.path().join("mesh.oct");
    build(&mesh, &file, &BuildOptions::default())?;
    let (slow, reference) = best(&file, false, 1)?;
    let rays = reference.statistics.rays;
    println!("`oct off`: {:.2} s for {} rays\n", slow.as_secs_f64(), rays.primary + rays.shadow);
    println!("| triangles a cell | `strict` | `octree` | `sah` |\n| ---: | ---: | ---: | ---: |");
    for cell in CELLS {
        let mut line = format!("| {cell} |");
        for split in [SplitMode::Strict, SplitMode::Octree, SplitMode::Sah] {
            if split == SplitMode::Sah && cell > LEAF {
                line += " – |";
                continue;
            }
            build(&mesh, &file, &BuildOptions { split, cell, leaf: cell.min(LEAF) as u8, ..BuildOptions::default() })?;
            let (time, picture) = best(&file, true, RUNS)?;
            if picture.film != reference.film {
                return Err(format!("the picture differs: {split:?}, {cell} triangles a cell").into());
            }
            let (milliseconds, gain) = (time.as_secs_f64() * 1e3, slow.as_secs_f64() / time.as_secs_f64());
            line += &format!(" {milliseconds:.1} ms, {gain:.0} x |");
        }
        println!("{line}");
    }
    Ok(())
}

/// Builds the octree file.
fn build(mesh: &Path, file: &Path, options: &BuildOptions) -> Outcome<()> {
    let mut mesh = octrace::mesh::open(mesh, &ReadOptions::default())?;
    octrace::build::build(&mut *mesh, file, options, Monitor::silent())?;
    Ok(())
}

/// Draws the mesh as `octrender` does without a scene, but with one lamp: the least time of some runs, and the picture.
fn best(file: &Path, octree: bool, runs: u32) -> Outcome<(Duration, Picture)> {
    let mut scene = Scene { octree, ..Scene::for_mesh(file, true) };
    scene.lights.truncate(1);
    let world = World::new(scene, vec![Arc::new(Octree::open(file)?)], Monitor::silent())?;
    let settings = Settings { size: Some([SIDE; 2]), samples: Some(1), ..Settings::default() };
    let mut times = Vec::new();
    let mut last = None;
    for _ in 0..runs {
        let start = Instant::now();
        last = Some(render(&world, &settings, Monitor::silent())?);
        times.push(start.elapsed());
    }
    times.into_iter().min().zip(last).ok_or_else(|| "no run".into())
}
