//! Level of detail: one far view of a file over `--lod 0, 0.25, 0.5, 1, 2, 4`: time, what is read, and how far the picture is from the
//! exact one.
//!
//! The mesh fills four fifths of a picture's width, lit by a lamp, with shadows and a mirror's bounce. Each picture is drawn from a
//! file opened anew, so that the pages that it uses are counted and checked, and their checking is part of the time; the file itself
//! stays in the system's memory after the first.
//!
//! Of few samples even the exact picture is off: samples of a rough surface differ within a pixel. So each is also held to an exact picture of many
//! samples, which is what all of them would be.

use std::fmt::Write as _;
use std::path::Path;
use std::sync::Arc;

use glam::DVec3;
use octrace::map::Octree;
use octrace::render::{Picture, Settings, render};
use octrace::scene::{Camera, Light, Scene};
use octrace::shade::World;
use octrace::{Monitor, Result};
use serde::Serialize;

use crate::timing::{Clock, median};

/// The errors that are allowed, in pixels.
const LEVELS: [f64; 6] = [0.0, 0.25, 0.5, 1.0, 2.0, 4.0];
/// Samples a pixel.
pub const SAMPLES: u32 = 4;
/// Samples a pixel of the exact picture that all are held to.
pub const MANY: u32 = 64;
/// Field of view, degrees.
const FOV: f64 = 30.0;

/// One picture.
#[derive(Clone, Debug, Serialize)]
pub struct Level {
    /// The file's name.
    pub file: String,
    /// Its triangles.
    pub triangles: u64,
    /// Width of the mesh in pixels.
    pub across: u32,
    /// What was allowed.
    pub lod: f64,
    /// From opening the file to the picture, the median.
    pub seconds: f64,
    /// How many times as fast as the exact picture.
    pub speedup: f64,
    /// Pages used.
    pub pages: u64,
    /// Pages of the file.
    pub pages_total: u64,
    /// Bytes of these pages, and of what lies beside them for level of detail.
    pub bytes: u64,
    /// Surrogates that rays took for hits.
    pub hits: u64,
    /// Of rays from the eye, and all that they gave rise to but those to lights.
    pub rays: u64,
    /// The largest error that was claimed, in pixels.
    pub largest_claim: f64,
    /// Root mean square of the difference from the exact picture, linear, all channels.
    pub rmse: f64,
    /// The largest difference of a channel.
    pub largest_difference: f64,
    /// Root mean square of the difference from an exact picture of [`MANY`] samples.
    pub rmse_of_many: f64,
}

/// Draws a file at all levels.
pub fn levels(path: &Path, across: u32, rounds: u32, clock: Clock, monitor: Monitor<'_>) -> Result<Vec<Level>> {
    let octree = Octree::open(path)?;
    let scene = scene(&octree, across);
    let mut seconds = vec![Vec::new(); LEVELS.len()];
    let mut drawn: Vec<Option<Drawn>> = (0..LEVELS.len()).map(|_| None).collect();
    for _ in 0..rounds {
        for (i, &lod) in LEVELS.iter().enumerate() {
            monitor.check()?;
            let (took, picture) = clock.time(|| draw(path, &scene, lod))?;
            seconds[i].push(took);
            drawn[i] = Some(picture);
        }
    }
    let seconds: Vec<f64> = seconds.into_iter().map(median).collect();
    let drawn: Vec<Drawn> = drawn.into_iter().flatten().collect();
    monitor.check()?;
    let many = draw(path, &Scene { samples: MANY, ..scene.clone() }, 0.0)?.picture;
    let file = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let level = |i: usize| {
        let Drawn { picture, pages, bytes } = &drawn[i];
        let (rmse, largest_difference) = difference(&drawn[0].picture, picture);
        let (rays, detail) = (picture.statistics.rays, picture.statistics.detail);
        Level {
            file: file.clone(),
            triangles: octree.header().triangles,
            across,
            lod: LEVELS[i],
            seconds: seconds[i],
            speedup: seconds[0] / seconds[i].max(1e-9),
            pages: *pages,
            pages_total: octree.header().pages.into(),
            bytes: *bytes,
            hits: detail.hits,
            rays: rays.primary + rays.mirror + rays.refracted,
            largest_claim: detail.largest,
            rmse,
            largest_difference,
            rmse_of_many: difference(&many, picture).0,
        }
    };
    Ok((0..drawn.len()).map(level).collect())
}

/// A picture and what was read for it.
struct Drawn {
    picture: Picture,
    pages: u64,
    bytes: u64,
}

fn draw(path: &Path, scene: &Scene, lod: f64) -> Result<Drawn> {
    let octree = Arc::new(Octree::open(path)?);
    let world = World::new(scene.clone(), vec![octree.clone()], Monitor::silent())?.with_lod(lod)?;
    let picture = render(&world, &Settings::default(), Monitor::silent())?;
    octree.fault()?;
    let beside = if lod > 0.0 { octree.detail_bytes() } else { 0 };
    let read = octree.figures();
    Ok(Drawn { picture, pages: read.touched, bytes: beside + read.bytes_read })
}

/// A view in which the mesh's longest side takes so many pixels.
fn scene(octree: &Octree, across: u32) -> Scene {
    let bounds = octree.bounds();
    let (low, high) = (bounds.min.as_dvec3(), bounds.max.as_dvec3());
    let radius = 0.5 * (high - low).max_element();
    let (at, from) = (0.5 * (low + high), DVec3::new(0.36, 0.48, 0.8));
    // A picture that is a quarter wider than the mesh at that distance.
    let eye = at + from * (1.25 * radius / (0.5 * FOV).to_radians().tan());
    let mut scene = Scene::for_mesh(octree.path(), true);
    scene.size = [across + across.div_ceil(4); 2];
    scene.camera = Camera::LookAt { eye, at, up: DVec3::Y, fov: FOV };
    scene.lights = vec![Light::Sun { direction: DVec3::new(-0.7, -0.5, -0.5), color: DVec3::splat(0.9) }];
    scene.background = DVec3::new(0.05, 0.06, 0.1);
    scene.floor = None;
    scene.materials.iter_mut().for_each(|material| material.reflect = 0.3);
    (scene.samples, scene.depth) = (SAMPLES, 1);
    scene
}

/// Root mean square and largest difference.
fn difference(a: &Picture, b: &Picture) -> (f64, f64) {
    let channels = a.film.pixels().as_flattened().iter().zip(b.film.pixels().as_flattened());
    let count = a.film.pixels().as_flattened().len().max(1);
    let (sum, most) = channels.fold((0.0, 0f64), |(sum, most), (a, b)| {
        let d = f64::from(a - b);
        (sum + d * d, most.max(d.abs()))
    });
    ((sum / count as f64).sqrt(), most)
}

const HEADS: [&str; 9] = [
    "--lod",
    "seconds",
    "speed",
    "pages",
    "MB read",
    "largest claim",
    "RMSE",
    "largest difference",
    "RMSE against many",
];

fn cells(level: &Level) -> [String; 9] {
    [
        level.lod.to_string(),
        format!("{:.3}", level.seconds),
        format!("{:.1} x", level.speedup),
        format!("{} of {}", level.pages, level.pages_total),
        format!("{:.1}", level.bytes as f64 * 1e-6),
        if level.lod == 0.0 { "exact".to_owned() } else { format!("{:.3} px", level.largest_claim) },
        format!("{:.5}", level.rmse),
        format!("{:.3}", level.largest_difference),
        format!("{:.5}", level.rmse_of_many),
    ]
}

fn heading(level: &Level) -> String {
    format!(
        "{} ({} triangles), {} pixels wide, {SAMPLES} samples a pixel; \"many\" are {MANY}",
        level.file, level.triangles, level.across
    )
}

/// Each file's levels; a file's begin with the exact picture.
fn by_file(levels: &[Level]) -> impl Iterator<Item = &[Level]> {
    levels.chunks(LEVELS.len())
}

/// As a table for people.
pub fn table(levels: &[Level]) -> String {
    let mut text = String::new();
    for file in by_file(levels) {
        let line = |cells: [String; 9]| cells.iter().map(|cell| format!("{cell:>19}")).collect::<String>() + "\n";
        let _ = write!(text, "\n{}\n{}", heading(&file[0]), line(HEADS.map(str::to_owned)));
        file.iter().for_each(|level| text += &line(cells(level)));
    }
    text
}

/// As Markdown.
pub fn markdown(levels: &[Level]) -> String {
    let mut text = String::new();
    for file in by_file(levels) {
        let _ =
            write!(text, "\n{}\n\n| {} |\n|{}\n", heading(&file[0]), HEADS.join(" | "), " ---: |".repeat(HEADS.len()));
        file.iter().for_each(|level| text += &format!("| {} |\n", cells(level).join(" | ")));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::octree_at;
    use octrace::build::BuildOptions;

    #[test]
    fn levels_are_told_from_the_exact_picture_on() {
        let mesh = crate::planet::mesh(30_000, 1);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("planet.oct");
        let options = BuildOptions { brick: Some(500), ..BuildOptions::default() };
        octree_at(&mesh, &path, &options).unwrap();
        let levels = levels(&path, 10, 1, Clock::Wall, Monitor::silent()).unwrap();
        assert_eq!(levels.iter().map(|l| l.lod).collect::<Vec<_>>(), LEVELS);
        assert!((levels[0].rmse, levels[0].hits, levels[0].speedup) == (0.0, 0, 1.0));
        let last = &levels[5];
        assert!(last.rmse > 0.0 && last.rmse < 0.2 && last.largest_difference >= last.rmse, "{last:?}");
        assert!(levels.iter().all(|l| l.rmse_of_many > 0.0 && l.rmse_of_many < 0.2), "{levels:?}");
        assert!(last.hits > 0 && last.largest_claim <= 4.0 && last.pages < levels[0].pages, "{last:?}");
        assert_eq!(table(&levels).lines().count(), 9);
        assert_eq!(markdown(&levels).lines().count(), 11);
    }
}
