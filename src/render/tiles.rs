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
use crate::scene::{MOST_DEPTH, MOST_PIXELS, MOST_SAMPLES, MOST_SIDE, Scene};
use crate::shade::{DetailCounts, RayCounts, Wave, World, WorldRay};

/// Pixels of a tile come in blocks of this side, and in each along a Z curve (Morton 1966): 16 or 64 rays in a row are neighbours.
const BLOCK: u32 = 8;

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
    /// Most samples that a thread follows together, at least 1; changes no pixel.
    pub wave: usize,
}

impl Default for Settings {
    fn default() -> Self {
        Settings { size: None, samples: None, depth: None, crop: None, tile: 32, wave: 1024 }
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
    /// Surrogates taken for hits.
    pub detail: DetailCounts,
    /// Seconds in [`render`].
    pub seconds: f64,
    /// Of these, seconds in which tiles were traced and shaded.
    pub trace_seconds: f64,
    /// Tiles done.
    pub tiles: u64,
}

/// A tile that is done.
#[derive(Clone, Copy, Debug)]
pub struct Tile<'a> {
    /// Where it stands in the order in which tiles are taken.
    pub number: usize,
    /// Its pixels: columns x0..x1, rows y0..y1 of the film, as `[x0, y0, x1, y1]`.
    pub place: [u32; 4],
    /// Linear light, rows from the top.
    pub pixels: &'a [[f32; 3]],
}

/// The picture of a world, on the threads of the current rayon pool.
///
/// An interruption is no error: it returns the tiles done so far, `complete` false. A damaged page or a failed read is
/// one, at once: never a wrong picture. Settings that make no picture are [`Error::Option`].
pub fn render(world: &World, settings: &Settings, monitor: Monitor<'_>) -> Result<Picture> {
    render_shown(world, settings, &|_| (), monitor)
}

/// The same; each tile is shown to `watcher` as it is done, by the thread that made it.
pub fn render_shown(
    world: &World,
    settings: &Settings,
    watcher: &(dyn Fn(Tile<'_>) + Sync),
    monitor: Monitor<'_>,
) -> Result<Picture> {
    let begin = Instant::now();
    monitor.phase("render");
    let job = Job::new(world, settings)?;
    let film = Mutex::new(Film::new(job.width, job.height)?);
    let tile = settings.tile.max(1);
    let order = hilbert::order(job.width.div_ceil(tile), job.height.div_ceil(tile));
    let keep = |done: Tile<'_>| {
        film.lock().unwrap_or_else(|poison| poison.into_inner()).put_tile(done.place, done.pixels);
        watcher(done);
    };
    let mut statistics = tiles(&job, &order, tile, &keep, monitor)?;
    statistics.seconds = begin.elapsed().as_secs_f64();
    let film = film.into_inner().unwrap_or_else(|poison| poison.into_inner());
    Ok(Picture { film, statistics, complete: statistics.tiles == order.len() as u64 })
}

/// Makes tiles of a side of `tile` pixels in the order given, and hands each to `done`. Some are left out if the work is interrupted.
pub(super) fn tiles(
    job: &Job<'_>,
    order: &[[u32; 2]],
    tile: u32,
    done: &(dyn Fn(Tile<'_>) + Sync),
    monitor: Monitor<'_>,
) -> Result<Statistics> {
    let shared = Shared {
        next: AtomicUsize::new(0),
        stop: AtomicBool::new(false),
        done,
        state: Mutex::new(State { statistics: Statistics::default(), error: None }),
    };
    let start = Instant::now();
    rayon::broadcast(|_| job.work(order, tile, &shared, monitor));
    let State { mut statistics, error } = shared.state.into_inner().unwrap_or_else(|poison| poison.into_inner());
    if let Some(error) = error {
        return Err(error);
    }
    statistics.trace_seconds = start.elapsed().as_secs_f64();
    Ok(statistics)
}

/// What the threads share.
struct Shared<'d> {
    /// The next tile to take.
    next: AtomicUsize,
    /// Something went wrong: take no more.
    stop: AtomicBool,
    /// Takes what is done.
    done: &'d (dyn Fn(Tile<'_>) + Sync),
    state: Mutex<State>,
}

/// What they add to, a tile at a time.
struct State {
    statistics: Statistics,
    error: Option<Error>,
}

/// A picture to be made, resolved from scene and settings.
pub(super) struct Job<'w> {
    pub world: &'w World,
    eye: Eye,
    /// Rows of the whole picture.
    rows: u32,
    /// Top-left corner of the region.
    corner: [u32; 2],
    pub width: u32,
    pub height: u32,
    pub depth: u32,
    /// Samples are k * k.
    pub k: u32,
    /// Most samples that are followed together.
    pub wave: usize,
}

/// Width and height of what is to be drawn: the picture or its crop. Fails if there is no such picture.
pub fn region(scene: &Scene, settings: &Settings) -> Result<[u32; 2]> {
    let [columns, rows] = settings.size.unwrap_or(scene.size);
    if !(1..=MOST_SIDE).contains(&columns) || !(1..=MOST_SIDE).contains(&rows) {
        let what = format!("a picture of {columns} x {rows} cannot be made: each side is 1 to {MOST_SIDE} pixels");
        return Err(Error::Option(what));
    }
    let [x0, y0, x1, y1] = settings.crop.unwrap_or([0, 0, columns, rows]);
    if x0 >= x1 || y0 >= y1 || x1 > columns || y1 > rows {
        let what = format!(
            "crop {x0},{y0},{x1},{y1} is no part of a picture of {columns} x {rows}: it is X0,Y0,X1,Y1 with X0 < X1 <= {columns} and Y0 < Y1 <= {rows}"
        );
        return Err(Error::Option(what));
    }
    let [width, height] = [x1 - x0, y1 - y0];
    let pixels = u64::from(width) * u64::from(height);
    if pixels > MOST_PIXELS {
        let what = format!(
            "{width} x {height} are {pixels} pixels, and a picture has at most {MOST_PIXELS}: draw it in parts (--crop)"
        );
        return Err(Error::Option(what));
    }
    Ok([width, height])
}

/// The side of the grid of samples in a pixel.
pub(super) fn samples_side(scene: &Scene, settings: &Settings) -> Result<u32> {
    let samples = settings.samples.unwrap_or(scene.samples);
    let side = sampling::side(samples).filter(|_| samples <= MOST_SAMPLES);
    side.ok_or_else(|| {
        let what =
            format!("{samples} samples a pixel: the number must be a square (1, 4, 9, 16, ...) up to {MOST_SAMPLES}");
        Error::Option(what)
    })
}

impl<'w> Job<'w> {
    pub fn new(world: &'w World, settings: &Settings) -> Result<Job<'w>> {
        let scene = world.scene();
        let size @ [_, rows] = settings.size.unwrap_or(scene.size);
        let [width, height] = region(scene, settings)?;
        let k = samples_side(scene, settings)?;
        let corner = settings.crop.map_or([0; 2], |[x0, y0, ..]| [x0, y0]);
        let wave = settings.wave.max(1);
        let depth = settings.depth.unwrap_or(scene.depth);
        if depth > MOST_DEPTH {
            return Err(Error::Option(format!("{depth} bounces are too many: at most {MOST_DEPTH}")));
        }
        let eye = Eye::new(world, size)?;
        Ok(Job { world, eye, rows, corner, width, height, depth, k, wave })
    }

    /// One thread: takes tiles until none is left.
    fn work(&self, order: &[[u32; 2]], tile: u32, shared: &Shared<'_>, monitor: Monitor<'_>) {
        let mut desk = Desk::new(self.depth);
        while !shared.stop.load(Ordering::Relaxed) && !monitor.stopped() {
            let number = shared.next.fetch_add(1, Ordering::Relaxed);
            let Some(&[i, j]) = order.get(number) else { return };
            let (x0, y0) = (i * tile, j * tile);
            let (x1, y1) = (x0.saturating_add(tile).min(self.width), y0.saturating_add(tile).min(self.height));
            (desk.wave.counts, desk.wave.detail) = (RayCounts::default(), DetailCounts::default());
            let stopped = || monitor.stopped() || shared.stop.load(Ordering::Relaxed);
            let done = self.tile([x0, y0, x1, y1], &mut desk, &stopped);
            let done = self.world.fault().and(done);
            if let Ok(true) = done {
                (shared.done)(Tile { number, place: [x0, y0, x1, y1], pixels: &desk.pixels });
            }
            let mut state = shared.state.lock().unwrap_or_else(|poison| poison.into_inner());
            match done {
                Ok(false) => return,
                Ok(true) => {
                    state.statistics.rays += desk.wave.counts;
                    state.statistics.detail += desk.wave.detail;
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
    fn tile(&self, [x0, y0, x1, y1]: [u32; 4], desk: &mut Desk, stopped: &dyn Fn() -> bool) -> Result<bool> {
        let (width, height) = (x1 - x0, y1 - y0);
        let count = self.k * self.k;
        desk.sums.clear();
        desk.sums.resize((width * height) as usize, DVec3::ZERO);
        desk.clear();
        for [left, top] in blocks(width, height) {
            for code in 0..BLOCK * BLOCK {
                let [x, y] = [left + every_other(code), top + every_other(code >> 1)];
                if x >= width || y >= height {
                    continue;
                }
                for s in 0..count {
                    desk.wave.add(self.ray(self.corner[0] + x0 + x, self.corner[1] + y0 + y, s));
                    desk.places.push(y * width + x);
                    if desk.places.len() == self.wave && !desk.follow(self.world, stopped)? {
                        return Ok(false);
                    }
                }
            }
        }
        if !desk.follow(self.world, stopped)? {
            return Ok(false);
        }
        desk.pixels.clear();
        desk.pixels.extend(desk.sums.iter().map(|&sum| (sum / f64::from(count)).as_vec3().to_array()));
        Ok(true)
    }

    /// The ray of sample `s` of the pixel in column x and row y from the top of the whole picture.
    fn ray(&self, x: u32, y: u32, s: u32) -> WorldRay {
        self.through(x, y, sampling::position(s, self.k))
    }

    /// The ray of sample `s` of the pixel in column x and row y from the top of the region.
    pub fn sample(&self, x: u32, y: u32, s: u32) -> WorldRay {
        self.ray(self.corner[0] + x, self.corner[1] + y, s)
    }

    /// The ray through the middle of the pixel in column x and row y from the top of the region.
    pub fn middle(&self, x: u32, y: u32) -> WorldRay {
        self.through(self.corner[0] + x, self.corner[1] + y, [0.5; 2])
    }

    /// The ray at `u` and `v` from the bottom-left corner of a pixel.
    fn through(&self, x: u32, y: u32, [u, v]: [f64; 2]) -> WorldRay {
        self.eye.ray(f64::from(x) + u, f64::from(self.rows - 1 - y) + v)
    }
}

/// What one thread works with.
struct Desk {
    wave: Wave,
    /// The pixel of each sample of the wave.
    places: Vec<u32>,
    /// The sums of each pixel's samples.
    sums: Vec<DVec3>,
    pixels: Vec<[f32; 3]>,
}

impl Desk {
    fn new(depth: u32) -> Desk {
        Desk { wave: Wave::new(depth), places: Vec::new(), sums: Vec::new(), pixels: Vec::new() }
    }

    /// Begins another wave.
    fn clear(&mut self) {
        self.wave.clear();
        self.places.clear();
    }

    /// Follows the wave to its end, adds what it has gathered, and begins another; false if it was broken off.
    fn follow(&mut self, world: &World, stopped: &dyn Fn() -> bool) -> Result<bool> {
        while world.follow(&mut self.wave)? {
            if stopped() {
                return Ok(false);
            }
        }
        // A pixel's samples come in their own order, so that its sum is the same whatever the waves.
        for (&place, &color) in self.places.iter().zip(self.wave.colors()) {
            self.sums[place as usize] += color;
        }
        self.clear();
        Ok(true)
    }
}

/// The top-left corners of the blocks of a rectangle.
fn blocks(width: u32, height: u32) -> impl Iterator<Item = [u32; 2]> {
    let rows = (0..height).step_by(BLOCK as usize);
    rows.flat_map(move |y| (0..width).step_by(BLOCK as usize).map(move |x| [x, y]))
}

/// Bits 0, 2 and 4.
fn every_other(code: u32) -> u32 {
    code & 1 | code >> 1 & 2 | code >> 2 & 4
}
