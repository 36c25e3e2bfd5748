//! Vertex data (positions, texture coordinates, normals) in a spool, and how faces find theirs in it.
//!
//! A table that fits its share of memory is read in place. One that does not is read in one of two ways, whichever moves
//! fewer bytes; the scan has noted which parts of a table each block of faces touches, so both are known beforehand.
//!
//! - **Window**: where faces lie near their vertices in the file, as they do in most, the parts that a wave of blocks
//!   needs are held, and the least recently used make room for others.
//! - **Answers** ([`super::answers`]): else numbers are sorted by parts of the table, looked up part by part, and read
//!   back in the order of the faces.

use super::answers::Answers;
use super::blocks::LoadedBlock;
use super::faces::Faces;
use super::spool::Spool;
use super::words::Words;
use crate::error::Result;

/// log2 of the items of a part.
pub(super) const PART: u32 = 13;
/// A block of faces that touches more parts than this has no locality worth the name.
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
    pub fn reader<'t>(&'t self, faces: &Faces<'_>, wave: usize, share: usize) -> Result<Reader<'t, N>> {
        if let Some(words) = self.spool.memory() {
            return Ok(Reader::Whole(bytemuck::cast_slice(words)));
        }
        let capacity = share / (N << PART);
        let windowed = window_loads(faces, self.kind, wave, capacity).map(|loads| loads * (N << PART) as u64);
        // Each number is written and read once, each item likewise.
        let answered = faces.corners() * 2 * (1 + N as u64);
        match windowed {
            Some(words) if words <= answered => Ok(Reader::Window(Window::new(self, capacity)?)),
            _ => Ok(Reader::Answers(Answers::new(self, faces, share)?)),
        }
    }
}

/// How many parts a window of `capacity` parts has to load; `None` if a wave needs more than it holds.
fn window_loads(faces: &Faces<'_>, kind: Kind, wave: usize, capacity: usize) -> Option<u64> {
    let mut recent = Recent::new(capacity);
    for first in (0..faces.blocks()).step_by(wave) {
        for block in first..faces.blocks().min(first + wave) {
            for &part in faces.touched(block, kind)? {
                recent.hold(part, first)?;
            }
        }
    }
    Some(recent.loads)
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
    Answers(Vec<[f32; N]>),
}

impl<'t, const N: usize> Reader<'t, N> {
    /// Makes ready for a wave of blocks, which come in order; a view for each.
    pub fn views<'v>(&'v mut self, first: usize, wave: &[LoadedBlock], faces: &Faces<'_>) -> Result<Vec<View<'v, N>>> {
        match self {
            Reader::Whole(items) => Ok(wave.iter().map(|_| View::Whole(items)).collect()),
            Reader::Window(window) => {
                window.hold(first, wave.len(), faces)?;
                let window: &Window<'_, N> = window;
                Ok(wave.iter().map(|_| View::Window(window)).collect())
            }
            Reader::Answers(answers) => {
                wave.iter().map(|block| Ok(View::Answers(answers.of_block(&block.view())?))).collect()
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
            View::Answers(items) => items[corner],
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

    /// Holds all parts that the blocks from `first` on touch.
    fn hold(&mut self, first: usize, blocks: usize, faces: &Faces<'_>) -> Result<()> {
        for block in first..first + blocks {
            // The window was chosen because all blocks touch few parts, and no wave more than it holds.
            for &part in faces.touched(block, self.table.kind).unwrap_or_default() {
                if let Some((place, true)) = self.recent.hold(part, first) {
                    let from = u64::from(part) * (N << PART) as u64;
                    let len = ((N << PART) as u64).min(self.table.spool.len().saturating_sub(from)) as usize;
                    let at = place * (N << PART);
                    self.table.spool.read(from, &mut self.words[at..at + len])?;
                }
            }
        }
        Ok(())
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
    use crate::mesh::FaceBatch;

    /// Reads a table for all blocks, and compares what comes with what is in it.
    fn check(numbers: &[u32], block_corners: usize, share: usize, expect: &str) {
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
        let mut reader = table.reader(&faces, 2, share).unwrap();
        let way = match reader {
            Reader::Whole(_) => "whole",
            Reader::Window(_) => "window",
            Reader::Answers(_) => "answers",
        };
        assert_eq!(way, expect);
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
        check(&numbers, 3000, 8 * (3 << PART), "window");
        // One part is too little.
        check(&numbers, 3000, 3 << PART, "answers");
    }

    #[test]
    fn scattered_faces_are_answered() {
        let mut numbers: Vec<u32> = (0..99_999u32).map(|i| (u64::from(i) * 7_919_173 % 100_000) as u32).collect();
        numbers[500] = 100_000;
        numbers[700] = u32::MAX;
        for share in [2 * (3 << PART), 5 * (3 << PART)] {
            check(&numbers, 3000, share, "answers");
        }
    }
}
