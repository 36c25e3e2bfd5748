//! Tiles in parallel.

use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Instant;

use glam::DVec3;

use super::camera::Eye;
use super::film::Film;
use super::{hilbert, sampling};
use crate::error::{Error, Result};
use crate::event::Monitor;
use crate::shade::{RayCounts, Scratch, World};

/// Most pixels on a side.
const MOST_SIDE: u32 = 65_536;

/// What the scene leaves to whoever renders it, or what is to be other than the scene says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Settings {
    /// Width and height in pixels, each 1 to 65,536; `None` = the scene's.
    pub size: Option<[u32; 2]>,
    /// Samples a pixel, a square number; `None` = the scene's.
    pub samples: Option<u32>,
    /// Bounces; `None` = the scene's.
    pub depth: Option<u32>,
    /// Only the pixels of columns x0..x1 and rows y0..y1, as `[x0, y0, x1, y1]` from the top-left corner, upper ends
    /// left out; the film then has this region's size.
    pub crop: Option<[u32; 4]>,
    /// Side of a tile in pixels, at least 1; changes no pixel.
    pub tile: u32,
}

impl Default for Settings {
    fn default() -> Self {
        Settings { size: None, samples: None, depth: None, crop: None, tile: 32 }
    }
}

/// A picture, whole or broken off.
#[derive(Clone, Debug)]
pub struct Picture {
    /// The pixels; black where `complete` is false and no tile was done.
    pub film: Film,
    /// What it took.
    pub statistics: Statistics,
    /// Whether all tiles are done.
    pub complete: bool,
}

/// What a picture took.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Statistics {
    /// Rays traced, by purpose.
    pub rays: RayCounts,
    /// Seconds in [`render`].
    pub seconds: f64,
    /// Of these, seconds in which tiles were traced and shaded.
    pub trace_seconds: f64,
    /// Tiles done.
    pub tiles: u64,
}

/// The picture of a world, on the threads of the current rayon pool.
///
/// An interruption is no error: it returns the tiles done so far, `complete` false. A damaged page or a failed read is
/// one, at once: never a wrong picture. Settings that make no picture are [`Error::Option`].
pub fn render(world: &World, settings: &Settings, monitor: Monitor<'_>) -> Result<Picture> {
    let begin = Instant::now();
    monitor.phase("render");
    let job = Job::new(world, settings)?;
    let mut film = Film::new(job.width, job.height)?;
    let tile = settings.tile.max(1);
    let order = hilbert::order(job.width.div_ceil(tile), job.height.div_ceil(tile));
    let shared = Shared {
        next: AtomicUsize::new(0),
        stop: AtomicBool::new(false),
        state: Mutex::new(State { film: &mut film, statistics: Statistics::default(), error: None }),
    };
    let start = Instant::now();
    rayon::broadcast(|_| job.work(&order, tile, &shared, monitor));
    let trace_seconds = start.elapsed().as_secs_f64();
    let State { mut statistics, error, .. } = shared.state.into_inner().unwrap_or_else(|poison| poison.into_inner());
    if let Some(error) = error {
        return Err(error);
    }
    (statistics.trace_seconds, statistics.seconds) = (trace_seconds, begin.elapsed().as_secs_f64());
    Ok(Picture { film, statistics, complete: statistics.tiles == order.len() as u64 })
}

/// What the threads share.
struct Shared<'f> {
    /// The next tile to take.
    next: AtomicUsize,
    /// Something went wrong: take no more.
    stop: AtomicBool,
    state: Mutex<State<'f>>,
}

/// What they add to, a tile at a time.
struct State<'f> {
    film: &'f mut Film,
    statistics: Statistics,
    error: Option<Error>,
}

/// A picture to be made, resolved from scene and settings.
struct Job<'w> {
    world: &'w World,
    eye: Eye,
    /// Rows of the whole picture.
    rows: u32,
    /// Top-left corner of the region.
    corner: [u32; 2],
    width: u32,
    height: u32,
    depth: u32,
    /// Samples are k * k.
    k: u32,
}

impl<'w> Job<'w> {
    fn new(world: &'w World, settings: &Settings) -> Result<Job<'w>> {
        let scene = world.scene();
        let size @ [columns, rows] = settings.size.unwrap_or(scene.size);
        if !(1..=MOST_SIDE).contains(&columns) || !(1..=MOST_SIDE).contains(&rows) {
            let what = format!("a picture of {columns} x {rows} cannot be made: each side is 1 to {MOST_SIDE} pixels");
            return Err(Error::Option(what));
        }
        let samples = settings.samples.unwrap_or(scene.samples);
        let k = sampling::side(samples).ok_or_else(|| {
            Error::Option(format!("{samples} samples a pixel: the number must be a square: 1, 4, 9, 16, ..."))
        })?;
        let [x0, y0, x1, y1] = settings.crop.unwrap_or([0, 0, columns, rows]);
        if x0 >= x1 || y0 >= y1 || x1 > columns || y1 > rows {
            let what = format!(
                "crop {x0},{y0},{x1},{y1} is no part of a picture of {columns} x {rows}: it is X0,Y0,X1,Y1 with X0 < X1 <= {columns} and Y0 < Y1 <= {rows}"
            );
            return Err(Error::Option(what));
        }
        let depth = settings.depth.unwrap_or(scene.depth);
        let eye = Eye::new(world, size)?;
        Ok(Job { world, eye, rows, corner: [x0, y0], width: x1 - x0, height: y1 - y0, depth, k })
    }

    /// One thread: takes tiles until none is left.
    fn work(&self, order: &[[u32; 2]], tile: u32, shared: &Shared<'_>, monitor: Monitor<'_>) {
        let mut scratch = Scratch::new(self.depth);
        let mut pixels = Vec::new();
        while !shared.stop.load(Ordering::Relaxed) && !monitor.stopped() {
            let Some(&[i, j]) = order.get(shared.next.fetch_add(1, Ordering::Relaxed)) else { return };
            let (x0, y0) = (i * tile, j * tile);
            let (x1, y1) = (x0.saturating_add(tile).min(self.width), y0.saturating_add(tile).min(self.height));
            scratch.rays = RayCounts::default();
            let done = self.tile([x0, y0, x1, y1], &mut pixels, &mut scratch, shared, monitor);
            let done = self.world.fault().and(done);
            let mut state = shared.state.lock().unwrap_or_else(|poison| poison.into_inner());
            match done {
                Ok(false) => return,
                Ok(true) => {
                    let rows = pixels.chunks((x1 - x0) as usize);
                    rows.zip(y0..).for_each(|(row, y)| state.film.put(x0, y, row));
                    state.statistics.rays += scratch.rays;
                    state.statistics.tiles += 1;
                    monitor.progress(state.statistics.tiles, Some(order.len() as u64), "tiles");
                }
                Err(error) => {
                    shared.stop.store(true, Ordering::Relaxed);
                    state.error.get_or_insert(error);
                }
            }
        }
    }

    /// The pixels of one tile, rows from the top; false if it was broken off.
    fn tile(
        &self,
        [x0, y0, x1, y1]: [u32; 4],
        pixels: &mut Vec<[f32; 3]>,
        scratch: &mut Scratch,
        shared: &Shared<'_>,
        monitor: Monitor<'_>,
    ) -> Result<bool> {
        pixels.clear();
        for y in y0..y1 {
            if monitor.stopped() || shared.stop.load(Ordering::Relaxed) {
                return Ok(false);
            }
            for x in x0..x1 {
                pixels.push(self.pixel(self.corner[0] + x, self.corner[1] + y, scratch)?);
            }
        }
        Ok(true)
    }

    /// The pixel in column x and row y from the top of the whole picture.
    fn pixel(&self, x: u32, y: u32, scratch: &mut Scratch) -> Result<[f32; 3]> {
        let row = self.rows - 1 - y;
        let mut sum = DVec3::ZERO;
        for s in 0..self.k * self.k {
            let [u, v] = sampling::position(s, self.k);
            let ray = self.eye.ray(f64::from(x) + u, f64::from(row) + v);
            sum += self.world.color(ray, scratch)?;
        }
        Ok((sum / f64::from(self.k * self.k)).as_vec3().to_array())
    }
}
