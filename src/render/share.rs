//! Shares of a picture, for several machines: each makes its tiles, and one puts them together.
//!
//! Tiles are dealt out along the Hilbert curve like cards, so that shares cost about alike: neighbours go to different shares. Which tiles
//! there are depends on the picture's size and on the number of shares alone, never on the machine. Pixels do not depend
//! on tiles, so that what is put together is the picture that one machine makes, bit for bit.

use std::fmt;
use std::sync::Mutex;
use std::time::Instant;

use super::aov::{Aov, AovKind, Values};
use super::film::{self, Film};
use super::hilbert;
use super::tiles::{Job, Settings, Statistics, Tile, tiles};
use crate::error::{Error, Result};
use crate::event::Monitor;
use crate::scene::ToneMap;
use crate::shade::World;

/// Most shares of a picture.
const MOST: u32 = 65_536;
/// Sides of tiles in pixels, the first that gives each share [`TILES`] tiles.
const SIDES: [u32; 6] = [256, 128, 64, 32, 16, 8];
/// Tiles that a share should have: many, so that chance evens out what they cost.
const TILES: u64 = 64;
/// Bytes that putting a picture's tiles in order takes for each: its place, what it is sorted by, and the place again.
const ORDER: u64 = 32;

/// One of several shares of a picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Share {
    index: u32,
    of: u32,
}

impl Share {
    /// Share `index` of `of`, counted from 0; at most 65,536 of them.
    pub fn new(index: u32, of: u32) -> Result<Share> {
        if !(1..=MOST).contains(&of) || index >= of {
            let what = format!(
                "share {index} of {of}: a picture has 1 to {MOST} shares, which are counted from 0 to one less"
            );
            return Err(Error::Option(what));
        }
        Ok(Share { index, of })
    }

    /// Which it is, from 0.
    pub fn index(self) -> u32 {
        self.index
    }

    /// How many there are.
    pub fn of(self) -> u32 {
        self.of
    }
}

impl fmt::Display for Share {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.index, self.of)
    }
}

/// The tiles of a share.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Tiling {
    /// Side of a tile in pixels; those at the right and lower edge may be cut.
    pub side: u32,
    /// Where each tile of the share stands along the curve.
    pub numbers: Vec<u32>,
    /// Columns and rows of each, counted in tiles.
    pub cells: Vec<[u32; 2]>,
    size: [u32; 2],
}

/// Side of the tiles of a picture that is made by so many shares, and how many there are.
fn sides([width, height]: [u32; 2], of: u32) -> (u32, u64) {
    let count = |side: u32| u64::from(width.div_ceil(side)) * u64::from(height.div_ceil(side));
    let least = SIDES[SIDES.len() - 1];
    let side = SIDES.into_iter().find(|side| count(*side) >= TILES * u64::from(of)).unwrap_or(least);
    (side, count(side))
}

impl Tiling {
    /// Side and number of the tiles of a share of a picture of `size` pixels, without taking memory for them.
    pub fn outline(size: [u32; 2], share: Share) -> (u32, u64) {
        let (side, tiles) = sides(size, share.of);
        (side, tiles.saturating_sub(u64::from(share.index)).div_ceil(u64::from(share.of)))
    }

    /// The tiles of a share of a picture of `width` x `height` pixels; fails if there are fewer tiles than shares, or if memory does not
    /// allow it.
    pub fn new(size: [u32; 2], share: Share) -> Result<Tiling> {
        let ([width, height], of) = (size, share.of);
        let (side, tiles) = sides(size, of);
        if tiles < u64::from(of) {
            let what = format!(
                "a picture of {width} x {height} pixels has {tiles} tiles, too few for {of} shares; take at most {tiles}"
            );
            return Err(Error::Option(what));
        }
        film::room_for(ORDER * tiles, || format!("a picture of {tiles} tiles"))?;
        let order = hilbert::order(width.div_ceil(side), height.div_ceil(side));
        let own = (0..).zip(order).skip(share.index as usize).step_by(share.of as usize);
        let (numbers, cells) = own.unzip();
        Ok(Tiling { side, numbers, cells, size })
    }

    /// The pixels of each tile, as `[x0, y0, x1, y1]`.
    pub fn places(&self) -> impl Iterator<Item = [u32; 4]> {
        self.cells.iter().map(|&[i, j]| {
            let (x, y) = (i * self.side, j * self.side);
            [x, y, (x + self.side).min(self.size[0]), (y + self.side).min(self.size[1])]
        })
    }

    /// Pixels of all tiles.
    pub fn pixels(&self) -> usize {
        self.places().map(area).sum()
    }

    /// Width and height in pixels of the cell that each tile takes in a part: those of its widest and of its highest tile.
    ///
    /// A tile is cut where a picture is narrower than its side, or ends within it; so is the cell if all tiles of the share are.
    pub fn cell(&self) -> [u32; 2] {
        let sizes = self.places().map(|[x0, y0, x1, y1]| [x1 - x0, y1 - y0]);
        sizes.fold([0; 2], |most, size| [most[0].max(size[0]), most[1].max(size[1])])
    }

    /// Columns and rows of cells in a part: about as many of either.
    pub fn grid(&self) -> [usize; 2] {
        let columns = self.cells.len().isqrt().max(1);
        [columns, self.cells.len().div_ceil(columns)]
    }

    /// Pixels that a part has room for, in each channel; cells that a tile does not fill count in full.
    pub fn room(&self) -> usize {
        let ([width, height], [columns, rows]) = (self.cell(), self.grid());
        columns * width as usize * rows * height as usize
    }

    /// Writes what the pixels of the tiles have, tile after tile, to where they stand in the picture; false, and nothing written, if either
    /// has another number of pixels.
    fn put<T: Copy>(&self, from: &[T], to: &mut [T]) -> bool {
        let width = self.size[0] as usize;
        if from.len() != self.pixels() || to.len() != width * self.size[1] as usize {
            return false;
        }
        let mut rest = from;
        for [x0, y0, x1, y1] in self.places() {
            for y in y0..y1 {
                let (row, next) = rest.split_at((x1 - x0) as usize);
                let first = y as usize * width + x0 as usize;
                to[first..first + row.len()].copy_from_slice(row);
                rest = next;
            }
        }
        true
    }
}

/// Pixels of a tile.
fn area([x0, y0, x1, y1]: [u32; 4]) -> usize {
    (x1 - x0) as usize * (y1 - y0) as usize
}

/// What a picture's pixels depend on. Shares belong together if they have the same.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Identity {
    /// Version of this library: another may round otherwise.
    pub version: String,
    /// [`World::fingerprint`].
    pub scene: u64,
    /// Width and height of the whole picture in pixels.
    pub whole: [u32; 2],
    /// The part of it that is drawn, as in [`Settings::crop`].
    pub crop: [u32; 4],
    /// Samples a pixel.
    pub samples: u32,
    /// Bounces.
    pub depth: u32,
    /// How the picture is to be encoded.
    pub tonemap: ToneMap,
}

impl Identity {
    /// That of a world's picture.
    pub fn of(world: &World, settings: &Settings) -> Identity {
        let scene = world.scene();
        let whole = settings.size.unwrap_or(scene.size);
        Identity {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            scene: world.fingerprint(),
            whole,
            crop: settings.crop.unwrap_or([0, 0, whole[0], whole[1]]),
            samples: settings.samples.unwrap_or(scene.samples),
            depth: settings.depth.unwrap_or(scene.depth),
            tonemap: scene.tonemap,
        }
    }

    /// Width and height of what is drawn.
    pub fn size(&self) -> [u32; 2] {
        let [x0, y0, x1, y1] = self.crop;
        [x1 - x0, y1 - y0]
    }
}

/// The pixels of a share.
#[derive(Clone, Debug, PartialEq)]
pub struct Portion {
    /// Of what picture.
    pub identity: Identity,
    /// Which share of it.
    pub share: Share,
    /// Linear light: tile after tile as in [`Tiling`], rows from the top.
    pub pixels: Vec<[f32; 3]>,
    /// Pictures of data, each kind once, in the order of [`AovKind::ALL`]; values in the order of `pixels`.
    pub data: Vec<(AovKind, Values)>,
}

impl Portion {
    /// Writes its tiles to the picture, which has the size that its identity says.
    ///
    /// Fails if there are not as many pixels as its tiles have.
    pub fn put(&self, film: &mut Film) -> Result<()> {
        let fits = [film.width(), film.height()] == self.identity.size();
        self.whole(fits && self.tiling()?.put(&self.pixels, film.pixels_mut()))
    }

    /// Writes its tiles to a picture of data of that size, which is of a kind that it has.
    ///
    /// Fails if it has no such data, or not for as many pixels as its tiles have.
    pub fn put_aov(&self, aov: &mut Aov) -> Result<()> {
        let (tiling, own) = (self.tiling()?, self.data.iter().find(|data| data.0 == aov.kind));
        let fits = [aov.width, aov.height] == self.identity.size();
        let done = match (&mut aov.values, own) {
            (Values::Scalar(to), Some((_, Values::Scalar(from)))) => tiling.put(from, to),
            (Values::Vector(to), Some((_, Values::Vector(from)))) => tiling.put(from, to),
            (Values::Id(to), Some((_, Values::Id(from)))) => tiling.put(from, to),
            _ => false,
        };
        self.whole(fits && done)
    }

    fn tiling(&self) -> Result<Tiling> {
        Tiling::new(self.identity.size(), self.share)
    }

    fn whole(&self, fits: bool) -> Result<()> {
        if fits { Ok(()) } else { Err(Error::Option(format!("share {} does not fit the picture", self.share))) }
    }
}

/// A share of the picture of a world, on the threads of the current rayon pool; `watcher` sees each tile as it is done. Pictures of data are
/// made by [`share_aovs`](super::share_aovs()).
///
/// Tiles are as the share says, whatever the settings do. Fails as [`render`](super::render()) does, and with [`Error::Interrupted`].
pub fn render_share(
    world: &World,
    settings: &Settings,
    share: Share,
    watcher: &(dyn Fn(Tile<'_>) + Sync),
    monitor: Monitor<'_>,
) -> Result<(Portion, Statistics)> {
    let begin = Instant::now();
    monitor.phase("render");
    let job = Job::new(world, settings)?;
    let tiling = Tiling::new([job.width, job.height], share)?;
    let count = tiling.pixels();
    // Written, it takes as much as the part has room for, and at most as much again as a file.
    film::room_for(12 * (count + 2 * tiling.room()) as u64, || format!("a share of {count} pixels"))?;
    let starts: Vec<usize> = tiling
        .places()
        .scan(0, |next, place| {
            let start = *next;
            *next += area(place);
            Some(start)
        })
        .collect();
    let pixels = Mutex::new(vec![[0.0; 3]; count]);
    let keep = |tile: Tile<'_>| {
        let start = starts[tile.number];
        let mut pixels = pixels.lock().unwrap_or_else(|poison| poison.into_inner());
        pixels[start..start + tile.pixels.len()].copy_from_slice(tile.pixels);
        drop(pixels);
        watcher(tile);
    };
    let mut statistics = tiles(&job, &tiling.cells, tiling.side, &keep, monitor)?;
    if statistics.tiles < tiling.cells.len() as u64 {
        return Err(Error::Interrupted);
    }
    statistics.seconds = begin.elapsed().as_secs_f64();
    let pixels = pixels.into_inner().unwrap_or_else(|poison| poison.into_inner());
    Ok((Portion { identity: Identity::of(world, settings), share, pixels, data: Vec::new() }, statistics))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_cover_the_picture_once() {
        for (size, of) in [([64, 48], 5), ([1000, 3], 7), ([1, 1], 1), ([1920, 1080], 8), ([300, 200], 64)] {
            let mut seen = vec![0; (size[0] * size[1]) as usize];
            let mut most = [usize::MAX, 0];
            for index in 0..of {
                let tiling = Tiling::new(size, Share::new(index, of).unwrap()).unwrap();
                for [x0, y0, x1, y1] in tiling.places() {
                    (y0..y1).flat_map(|y| (x0..x1).map(move |x| (x, y))).for_each(|(x, y)| {
                        seen[(y * size[0] + x) as usize] += 1;
                    });
                }
                let tiles = tiling.cells.len();
                assert!(tiling.numbers.iter().all(|n| n % of == index) && tiles == tiling.numbers.len());
                most = [most[0].min(tiles), most[1].max(tiles)];
            }
            assert!(seen.iter().all(|&n| n == 1) && most[1] - most[0] <= 1, "{size:?} of {of}: {most:?}");
        }
    }

    #[test]
    fn a_part_has_little_more_room_than_its_picture_has_pixels() {
        for (size, of) in [
            ([1, 65_536], 1),
            ([65_536, 1], 1),
            ([1, 65_536], 8),
            ([3, 40_000], 5),
            ([257, 20_000], 2),
            ([257, 257], 1),
            ([7, 7], 1),
            ([1920, 1080], 8),
        ] {
            let tilings: Vec<Tiling> =
                (0..of).map(|i| Tiling::new(size, Share::new(i, of).unwrap()).unwrap()).collect();
            let room: usize = tilings.iter().map(Tiling::room).sum();
            let pixels = (size[0] * size[1]) as usize;
            // Up to twice as much on either axis, and the last row of cells.
            assert!(room >= pixels && room <= 5 * pixels, "{size:?} of {of}: {room} for {pixels}");
            for (i, tiling) in (0..).zip(&tilings) {
                let outline = Tiling::outline(size, Share::new(i, of).unwrap());
                assert_eq!(outline, (tiling.side, tiling.numbers.len() as u64), "{size:?}, {i} of {of}");
                assert!(tiling.room() >= tiling.pixels());
            }
        }
        let one = Tiling::new([1, 65_536], Share::new(0, 1).unwrap()).unwrap();
        assert_eq!((one.cell(), one.room()), ([1, 256], 65_536));
    }

    #[test]
    fn shares_have_enough_tiles_and_no_more_are_made_than_there_are_tiles() {
        let tiles = |size, of| Tiling::new(size, Share::new(of - 1, of).unwrap()).map(|t| (t.side, t.cells.len()));
        assert_eq!(tiles([1024, 1024], 8).unwrap(), (32, 128));
        assert_eq!(tiles([7680, 4320], 8).unwrap(), (128, 255));
        assert_eq!(tiles([64, 48], 48).unwrap(), (8, 1));
        assert!(tiles([64, 48], 49).is_err_and(|e| e.to_string().contains("48 tiles")));
        assert!(Share::new(0, 0).is_err() && Share::new(3, 3).is_err() && Share::new(0, MOST + 1).is_err());
        assert_eq!(Share::new(3, 8).unwrap().to_string(), "3/8");
    }
}
