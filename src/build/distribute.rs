//! The fourth phase: records are sorted into chunks, in one temporary file of extents.
//!
//! Each chunk has a buffer; a full one is appended to the spool as an extent and noted in the chunk's list, so that a
//! chunk keeps the order of the source. One file, however many chunks: files are dear on some systems.

use std::path::Path;

use rayon::prelude::*;

use crate::error::Result;
use crate::event::Monitor;

use super::grid::{CellCode, Grid, Placement, Unit, merge, places};
use super::options::Tuning;
use super::record::Layout;
use super::spool::Spool;

/// A run of words in a spool.
#[derive(Clone, Copy, Debug)]
pub(super) struct Extent {
    pub at: u64,
    pub words: u64,
}

/// Records that lie in a spool as extents.
pub(super) struct Records<'a> {
    pub spool: &'a mut Spool,
    pub extents: &'a [Extent],
    pub layout: Layout,
}

impl Records<'_> {
    /// Calls `take` with all records in order, a piece at a time.
    fn pieces(&mut self, monitor: Monitor<'_>, mut take: impl FnMut(&[u32]) -> Result<()>) -> Result<()> {
        const PIECE: u64 = 1 << 18;
        let piece = PIECE * self.layout.words() as u64;
        let total: u64 = self.extents.iter().map(|extent| extent.words).sum();
        let (mut words, mut done) = (Vec::new(), 0);
        for extent in self.extents {
            for at in (0..extent.words).step_by(piece as usize) {
                monitor.check()?;
                words.resize(piece.min(extent.words - at) as usize, 0);
                self.spool.read(extent.at + at, &mut words)?;
                take(&words)?;
                done += words.len() as u64;
                let records = |words: u64| words / self.layout.words() as u64;
                monitor.progress(records(done), Some(records(total)), "triangles");
            }
        }
        Ok(())
    }

    /// Reads all of them.
    pub fn load(&mut self) -> Result<Vec<u32>> {
        let total: u64 = self.extents.iter().map(|extent| extent.words).sum();
        let (mut words, mut done) = (vec![0; total as usize], 0);
        for extent in self.extents {
            let end = done + extent.words as usize;
            self.spool.read(extent.at, &mut words[done..end])?;
            done = end;
        }
        Ok(words)
    }
}

/// Units that are taken into memory together, and where their triangles lie.
pub(super) struct Chunk {
    pub units: Vec<Unit>,
    pub extents: Vec<Extent>,
}

impl Chunk {
    /// Triangles, those in several units counted in each.
    pub fn triangles(&self) -> u64 {
        self.units.iter().map(|unit| unit.triangles).sum()
    }
}

/// How to sort: sizes, and how triangles belong to cells.
#[derive(Clone, Copy)]
pub(super) struct Sorting<'a> {
    pub folder: &'a Path,
    pub tuning: &'a Tuning,
    pub placement: Placement,
    /// Most triangles of a chunk.
    pub limit: u64,
    /// Level of the deepest cells.
    pub depth: u32,
    pub monitor: Monitor<'a>,
}

impl Sorting<'_> {
    /// Counts the triangles of `records`, which belong to `cell`, and makes units.
    pub fn count(self, records: &mut Records<'_>, cell: CellCode) -> Result<Vec<Unit>> {
        let grid = Grid::new(cell, (cell.level + self.tuning.grid_levels).min(self.depth));
        let layout = records.layout;
        records.pieces(self.monitor, |words| {
            words.par_chunks_exact(layout.words()).with_min_len(1024).for_each(|record| {
                grid.count(&layout.triangle(record), self.placement);
            });
            Ok(())
        })?;
        Ok(grid.units(self.limit))
    }

    /// Sorts the triangles of `records`, which belong to `cell`, into chunks of `units`.
    pub fn distribute(self, records: &mut Records<'_>, cell: CellCode, units: &[Unit]) -> Result<(Spool, Vec<Chunk>)> {
        let ends = merge(units, self.limit);
        let layout = records.layout;
        let mut writer = ChunkWriter::new(self, layout, units, &ends);
        // The chunk of each unit.
        let chunk_of: Vec<u32> = (0..units.len()).map(|unit| ends.partition_point(|&end| end <= unit) as u32).collect();
        records.pieces(self.monitor, |words| {
            let goals: Vec<Vec<(u32, u32)>> = words
                .par_chunks(4096 * layout.words())
                .map(|part| self.goals(part, layout, cell, units, &chunk_of))
                .collect();
            for (part, goals) in words.chunks(4096 * layout.words()).zip(goals) {
                for (record, chunk) in goals {
                    let at = record as usize * layout.words();
                    writer.push(chunk as usize, &part[at..at + layout.words()])?;
                }
            }
            Ok(())
        })?;
        writer.finish()
    }

    /// Pairs of record and chunk: each record once in each chunk it belongs to.
    fn goals(self, part: &[u32], layout: Layout, cell: CellCode, units: &[Unit], chunk_of: &[u32]) -> Vec<(u32, u32)> {
        let mut goals = Vec::with_capacity(part.len() / layout.words());
        for (number, record) in (0..).zip(part.chunks_exact(layout.words())) {
            places(units, &layout.triangle(record), cell, self.placement, |unit| {
                // Units come in order, so a chunk that has the record already is the last one.
                let goal = (number, chunk_of[unit]);
                if goals.last() != Some(&goal) {
                    goals.push(goal);
                }
            });
        }
        goals
    }
}

/// Chunks being filled.
struct ChunkWriter {
    spool: Spool,
    chunks: Vec<Chunk>,
    buffers: Vec<Vec<u32>>,
    buffer_words: usize,
}

impl ChunkWriter {
    fn new(sorting: Sorting<'_>, layout: Layout, units: &[Unit], ends: &[usize]) -> Self {
        let starts = std::iter::once(0).chain(ends.iter().copied());
        let chunks: Vec<Chunk> =
            starts.zip(ends).map(|(from, &to)| Chunk { units: units[from..to].to_vec(), extents: vec![] }).collect();
        let tuning = sorting.tuning;
        ChunkWriter {
            spool: Spool::new(sorting.folder, tuning.record_words),
            buffers: vec![Vec::new(); chunks.len()],
            buffer_words: (tuning.buffer_words / chunks.len()).clamp(layout.words(), 1 << 18),
            chunks,
        }
    }

    fn push(&mut self, chunk: usize, record: &[u32]) -> Result<()> {
        self.buffers[chunk].extend(record);
        if self.buffers[chunk].len() >= self.buffer_words { self.flush(chunk) } else { Ok(()) }
    }

    fn flush(&mut self, chunk: usize) -> Result<()> {
        let buffer = &mut self.buffers[chunk];
        if !buffer.is_empty() {
            self.chunks[chunk].extents.push(Extent { at: self.spool.len(), words: buffer.len() as u64 });
            self.spool.append(buffer)?;
            buffer.clear();
        }
        Ok(())
    }

    fn finish(mut self) -> Result<(Spool, Vec<Chunk>)> {
        (0..self.chunks.len()).try_for_each(|chunk| self.flush(chunk))?;
        Ok((self.spool, self.chunks))
    }
}
