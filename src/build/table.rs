//! Vertex data (positions, texture coordinates, normals) in a spool, and how faces find theirs in it.
//!
//! A table that fits its share of memory is read in place. One that does not is read in one of two ways, whichever moves
//! fewer bytes; the scan has noted which parts of a table each block of faces touches, so both are known beforehand.
//!
//! - **Window**: where faces lie near their vertices in the file, as they do in most, the parts that a wave of blocks
//!   needs are held, and the least recently used make room for others. A block that touches many parts, as one does along the
//!   seam of two patches, looks its items up by itself, in the order of the table.
//! - **Answers** ([`super::answers`]): else numbers are sorted by parts of the table, looked up part by part, and read
//!   back in the order of the faces.

use rayon::prelude::*;

use super::answers::Answers;
use super::blocks::{LoadedBlock, Touched};
use super::faces::Faces;
use super::spool::Spool;
use super::steps::Steps;
use super::words::Words;
use crate::error::Result;

/// log2 of the items of a part.
pub(super) const PART: u32 = 13;
/// The parts that a block touches are listed if they are not more than this.
pub(super) const FEW: usize = 64;

/// Which of a face's numbers name items of a table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Position,
    Texcoord,
    Normal,
}

/// Items of `N` f32.
pub(super) struct Table<'a, const N: usize> {
    pub spool: Spool<'a>,
    pub kind: Kind,
}

impl<'a, const N: usize> Table<'a, N> {
    pub fn new(spool: Spool<'a>, kind: Kind) -> Self {
        Table { spool, kind }
    }

    /// Items in it.
    pub fn len(&self) -> u64 {
        self.spool.len() / N as u64
    }

    pub fn append(&mut self, items: &[[f32; N]]) -> Result<()> {
        self.spool.append(bytemuck::cast_slice(items.as_flattened()))
    }

    /// Decides how to read it for all blocks of `faces`, taken `wave` at a time, with `share` words of memory.
    pub fn way(&self, faces: &Faces<'_>, wave: usize, share: usize) -> Way {
        if self.spool.memory().is_some() {
            return Way::Whole;
        }
        let windowed = window_parts(faces, self.kind, wave, share / (N << PART)) * (N << PART) as u64;
        // Each number is written and read once, each item likewise.
        let answered = faces.corners() * 2 * (1 + N as u64);
        if windowed <= answered { Way::Window } else { Way::Answers }
    }

    /// Makes ready to read it. Where that is a [step](Way::steps) of its own, `steps` says how far it is.
    pub fn reader<'t>(
        &'t self,
        way: Way,
        faces: &Faces<'_>,
        share: usize,
        steps: &mut Steps<'_>,
    ) -> Result<Reader<'t, N>> {
        match (way, self.spool.memory()) {
            (Way::Whole, Some(words)) => Ok(Reader::Whole(bytemuck::cast_slice(words))),
            (Way::Answers, _) => Ok(Reader::Answers(Answers::new(self, faces, share, steps)?)),
            _ => Ok(Reader::Window(Window::new(self, share / (N << PART))?)),
        }
    }
}

/// How a table is read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Way {
    /// In place.
    Whole,
    Window,
    Answers,
}

impl Way {
    /// How many times faces are gone over before they are joined.
    pub fn steps(self) -> u64 {
        u64::from(self == Way::Answers)
    }
}

/// How many parts are loaded by a window of `capacity` parts, and by blocks that look up by themselves, at most.
fn window_parts(faces: &Faces<'_>, kind: Kind, wave: usize, capacity: usize) -> u64 {
    let (mut recent, mut alone) = (Recent::new(capacity), 0);
    for first in (0..faces.blocks()).step_by(wave) {
        for block in first..faces.blocks().min(first + wave) {
            let touched = faces.touched(block, kind);
            if !recent.hold_all(touched, first, |_, _| Ok(())).unwrap_or(false) {
                alone += touched.len();
            }
        }
    }
    recent.loads + alone
}

/// Which parts are held, and where; the least recently used goes first.
struct Recent {
    /// The place of each part that is held, counted from 1.
    places: Vec<u32>,
    /// Part and wave of last use, by place.
    held: Vec<(u32, usize)>,
    capacity: usize,
    loads: u64,
}

impl Recent {
    fn new(capacity: usize) -> Self {
        Recent { places: Vec::new(), held: Vec::new(), capacity, loads: 0 }
    }

    /// Holds a part in `wave`: its place, and whether it has to be loaded. `None` if all places are needed in this wave.
    fn hold(&mut self, part: u32, wave: usize) -> Option<(usize, bool)> {
        if self.places.len() <= part as usize {
            self.places.resize(part as usize + 1, 0);
        }
        if let Some(place) = (self.places[part as usize] as usize).checked_sub(1) {
            self.held[place].1 = wave;
            return Some((place, false));
        }
        self.loads += 1;
        let place = if self.held.len() < self.capacity {
            self.held.push((part, wave));
            self.held.len() - 1
        } else {
            let (place, &(old, last)) = self.held.iter().enumerate().min_by_key(|(_, (_, last))| *last)?;
            if last == wave {
                return None;
            }
            self.places[old as usize] = 0;
            self.held[place] = (part, wave);
            place
        };
        self.places[part as usize] = place as u32 + 1;
        Some((place, true))
    }

    /// Holds all parts that a block touches, if it can; `load` is given the part and the place of each that is to be loaded.
    fn hold_all(
        &mut self,
        touched: &Touched,
        wave: usize,
        mut load: impl FnMut(u32, usize) -> Result<()>,
    ) -> Result<bool> {
        let Touched::Few(parts) = touched else { return Ok(false) };
        for &part in parts {
            match self.hold(part, wave) {
                None => return Ok(false),
                Some((place, true)) => load(part, place)?,
                Some((_, false)) => {}
            }
        }
        Ok(true)
    }

    fn place(&self, part: u32) -> Option<usize> {
        (*self.places.get(part as usize)? as usize).checked_sub(1)
    }
}

/// A table being read, wave by wave.
pub(super) enum Reader<'t, const N: usize> {
    Whole(&'t [[f32; N]]),
    Window(Window<'t, N>),
    Answers(Answers<'t, N>),
}

/// The items of one block.
pub(super) enum View<'v, const N: usize> {
    Whole(&'v [[f32; N]]),
    Window(&'v Window<'v, N>),
    /// One for each corner of the block.
    Items(Vec<[f32; N]>),
}

impl<'t, const N: usize> Reader<'t, N> {
    /// Makes ready for a wave of blocks, which come in order; a view for each.
    pub fn views<'v>(&'v mut self, first: usize, wave: &[LoadedBlock], faces: &Faces<'_>) -> Result<Vec<View<'v, N>>> {
        match self {
            Reader::Whole(items) => Ok(wave.iter().map(|_| View::Whole(items)).collect()),
            Reader::Window(window) => {
                let held = window.hold(first, wave.len(), faces)?;
                let window: &Window<'_, N> = window;
                let view = |(block, held): (&LoadedBlock, bool)| match held {
                    true => Ok(View::Window(window)),
                    false => window.look_up(block.view().numbers(window.table.kind)).map(View::Items),
                };
                wave.par_iter().zip(held).map(view).collect()
            }
            Reader::Answers(answers) => {
                wave.iter().map(|block| Ok(View::Items(answers.of_block(&block.view())?))).collect()
            }
        }
    }
}

impl<const N: usize> View<'_, N> {
    /// The item that a corner names: `number` in the table, `corner` in the block. The number must be in the table.
    #[inline]
    pub fn get(&self, corner: usize, number: u32) -> [f32; N] {
        match self {
            View::Whole(items) => items[number as usize],
            View::Window(window) => window.get(number),
            View::Items(items) => items[corner],
        }
    }
}

/// Parts of a table.
pub(super) struct Window<'t, const N: usize> {
    table: &'t Table<'t, N>,
    recent: Recent,
    words: Words,
}

impl<'t, const N: usize> Window<'t, N> {
    fn new(table: &'t Table<'t, N>, capacity: usize) -> Result<Self> {
        Ok(Window { table, recent: Recent::new(capacity), words: Words::zeroed(capacity * (N << PART))? })
    }

    /// Holds the parts that the blocks from `first` on touch; for each block, whether all of them are there.
    fn hold(&mut self, first: usize, blocks: usize, faces: &Faces<'_>) -> Result<Vec<bool>> {
        let Window { table, recent, words } = self;
        let mut load = |part: u32, place: usize| {
            let from = u64::from(part) * (N << PART) as u64;
            let len = ((N << PART) as u64).min(table.spool.len().saturating_sub(from)) as usize;
            let at = place * (N << PART);
            table.spool.read(from, &mut words[at..at + len])
        };
        (first..first + blocks)
            .map(|block| recent.hold_all(faces.touched(block, table.kind), first, &mut load))
            .collect()
    }

    /// The items of these numbers, zeros for those that are not in the table. The table is read from the first to the last, a part
    /// at a time.
    fn look_up(&self, numbers: &[u32]) -> Result<Vec<[f32; N]>> {
        let known = numbers.iter().zip(0u64..).filter(|&(&number, _)| u64::from(number) < self.table.len());
        let mut order: Vec<u64> = known.map(|(&number, corner)| u64::from(number) << 32 | corner).collect();
        order.sort_unstable();
        let (mut items, mut words) = (vec![[0.0; N]; numbers.len()], Vec::new());
        for run in order.chunk_by(|a, b| a >> (32 + PART) == b >> (32 + PART)) {
            let (first, last) = (run[0] >> 32, run[run.len() - 1] >> 32);
            words.resize(N * (last - first + 1) as usize, 0);
            self.table.spool.read(N as u64 * first, &mut words)?;
            for &entry in run {
                let at = N * ((entry >> 32) - first) as usize;
                items[entry as u32 as usize] = std::array::from_fn(|i| f32::from_bits(words[at + i]));
            }
        }
        Ok(items)
    }

    #[inline]
    fn get(&self, number: u32) -> [f32; N] {
        let within = number as usize & ((1 << PART) - 1);
        let place = self.recent.place(number >> PART).expect("the scan noted every part that a block touches");
        let at = (place << PART | within) * N;
        std::array::from_fn(|i| f32::from_bits(self.words[at + i]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::build::work::WorkFolder;
    use crate::event::Monitor;
    use crate::mesh::{FaceBatch, NO_INDEX};

    /// Reads a table for all blocks, and compares what comes with what is in it.
    fn check(numbers: &[u32], block_corners: usize, share: usize, expect: Way) {
        let folder = tempfile::tempdir().unwrap();
        let work = WorkFolder::new(folder.path(), "a.oct".as_ref(), true).unwrap();
        let count = 100_000u32;
        let mut table = Table::<3>::new(Spool::new(&work, "positions", 0), Kind::Position);
        for first in (0..count).step_by(1000) {
            let items: Vec<[f32; 3]> = (first..first + 1000).map(|i| [i as f32, -(i as f32), 0.5]).collect();
            table.append(&items).unwrap();
        }
        let mut faces = Faces::new(Spool::new(&work, "faces", 0), block_corners);
        faces.append(&FaceBatch { corners: numbers.to_vec(), ..Default::default() }).unwrap();
        faces.flush().unwrap();
        let way = table.way(&faces, 2, share);
        assert_eq!(way, expect);
        let mut steps = Steps::new(Monitor::silent(), 1, way.steps() + 1);
        let mut reader = table.reader(way, &faces, share, &mut steps).unwrap();
        let mut seen = 0;
        for first in (0..faces.blocks()).step_by(2) {
            let end = faces.blocks().min(first + 2);
            let wave: Vec<LoadedBlock> = (first..end).map(|block| faces.load(block).unwrap()).collect();
            let views = reader.views(first, &wave, &faces).unwrap();
            for (block, view) in wave.iter().zip(&views) {
                for (corner, &number) in block.view().corners.iter().enumerate() {
                    assert_eq!(number, numbers[seen]);
                    if number < count {
                        assert_eq!(view.get(corner, number), [number as f32, -(number as f32), 0.5]);
                    }
                    seen += 1;
                }
            }
        }
        assert_eq!(seen, numbers.len());
    }

    #[test]
    fn faces_near_their_vertices_take_a_window() {
        let numbers: Vec<u32> = (0..33_000).flat_map(|i| [3 * i, 3 * i + 1, 3 * i / 2]).collect();
        check(&numbers, 3000, 8 * (3 << PART), Way::Window);
        // One part is too little.
        check(&numbers, 3000, 3 << PART, Way::Answers);
    }

    #[test]
    fn scattered_faces_are_answered() {
        let mut numbers: Vec<u32> = (0..99_999u32).map(|i| (u64::from(i) * 7_919_173 % 100_000) as u32).collect();
        numbers[500] = 100_000;
        numbers[700] = u32::MAX;
        for share in [2 * (3 << PART), 5 * (3 << PART)] {
            check(&numbers, 3000, share, Way::Answers);
        }
    }

    /// Corners of blocks that are near each other in the table, but for every tenth block's.
    fn with_seams(blocks: u32, part: u32) -> Vec<u32> {
        let number = |i: u32| match i / 9000 % 10 {
            3 => (u64::from(i) * 7_919_173 % 100_000) as u32,
            _ => i / 10 % 100_000 / part * part + i % part,
        };
        (0..blocks * 9000).map(number).collect()
    }

    #[test]
    fn blocks_along_seams_look_up_by_themselves() {
        let mut numbers = with_seams(100, 1 << 13);
        numbers[31_000] = 100_000;
        numbers[31_001] = NO_INDEX;
        check(&numbers, 9000, 6 * (3 << PART), Way::Window);
        // Two blocks of a wave do not find room at the same time.
        let apart: Vec<u32> =
            (0..90_000).map(|i| if i / 9000 % 2 == 0 { i % 8192 } else { 50_000 + i % 8192 }).collect();
        check(&apart, 9000, 2 * (3 << PART), Way::Window);
    }

    #[test]
    fn looking_up_can_be_interrupted() {
        let folder = tempfile::tempdir().unwrap();
        let work = WorkFolder::new(folder.path(), "a.oct".as_ref(), true).unwrap();
        let mut table = Table::<2>::new(Spool::new(&work, "texcoords", 0), Kind::Texcoord);
        table.append(&[[0.5; 2]; 100]).unwrap();
        let mut faces = Faces::new(Spool::new(&work, "faces", 0), 30);
        let corners: Vec<u32> = (0..99).collect();
        faces.append(&FaceBatch { texcoords: corners.clone(), corners, ..Default::default() }).unwrap();
        faces.flush().unwrap();
        let (told, stop) = (std::sync::atomic::AtomicU64::new(0), std::sync::atomic::AtomicBool::new(false));
        let stop_at_third = |_| {
            stop.store(
                told.fetch_add(1, std::sync::atomic::Ordering::Relaxed) == 2,
                std::sync::atomic::Ordering::Relaxed,
            )
        };
        let mut steps = Steps::new(Monitor::new(&stop_at_third, &stop), 33, 2);
        assert!(matches!(table.reader(Way::Answers, &faces, 300, &mut steps), Err(crate::Error::Interrupted)));
        assert_eq!(told.into_inner(), 3);
    }
}
