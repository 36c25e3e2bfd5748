//! The fourth phase: records are sorted into chunks, in one temporary file of extents.
//!
//! Each chunk has a buffer; a full one is appended to the spool as an extent and noted in the chunk's list, so that a
//! chunk keeps the order of the source. One file, however many chunks: files are dear on some systems.
//!
//! The more chunks, the smaller the buffers, and the more extents to be kept in mind and read one by one. Where these would be too
//! many for the memory, chunks are made larger, and each is sorted again when its turn comes.

use std::ops::Range;

use rayon::prelude::*;
use xxhash_rust::xxh3::xxh3_64_with_seed;

use crate::error::Result;
use crate::event::Monitor;

use super::grid::{CellCode, Grid, Placement, Unit, UnitFinder, merge, places};
use super::options::Tuning;
use super::record::Layout;
use super::spool::Spool;
use super::subtree::cell_of;
use super::words::Words;

/// A run of words in a spool.
#[derive(Clone, Copy, Debug)]
pub(super) struct Extent {
    pub at: u64,
    pub words: u64,
}

/// Records that lie in a spool as extents.
#[derive(Clone, Copy)]
pub(super) struct Records<'a> {
    pub spool: &'a Spool<'a>,
    pub extents: &'a [Extent],
    pub layout: Layout,
}

impl Records<'_> {
    /// Calls `take` with all records in order, at most `piece` of them at a time.
    pub fn pieces(&self, piece: u64, monitor: Monitor<'_>, mut take: impl FnMut(&[u32]) -> Result<()>) -> Result<()> {
        let records = |words: u64| words / self.layout.words() as u64;
        let piece = piece * self.layout.words() as u64;
        let total: u64 = self.extents.iter().map(|extent| extent.words).sum();
        let (mut words, mut done) = (Vec::new(), 0);
        for extent in self.extents {
            for at in (0..extent.words).step_by(piece as usize) {
                monitor.check()?;
                words.resize(piece.min(extent.words - at) as usize, 0);
                self.spool.read(extent.at + at, &mut words)?;
                take(&words)?;
                done += words.len() as u64;
                monitor.progress(records(done), Some(records(total)), "triangles");
            }
        }
        Ok(())
    }

    /// Reads all of them.
    pub fn load(&self) -> Result<Words> {
        let total: u64 = self.extents.iter().map(|extent| extent.words).sum();
        let (mut words, mut done) = (Words::zeroed(total as usize)?, 0);
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
    /// XXH3-64 of the extents' words in order, the value of each being the seed of the next; 0 for none.
    pub sum: u64,
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
    pub tuning: &'a Tuning,
    pub placement: Placement,
    /// Most triangles of a chunk.
    pub limit: u64,
    /// Level of the deepest cells.
    pub depth: u32,
    pub monitor: Monitor<'a>,
}

impl Sorting<'_> {
    /// A grid of counts for the triangles of `cell`.
    pub fn grid(self, cell: CellCode) -> Grid {
        Grid::new(cell, (cell.level + self.tuning.grid_levels).min(self.depth))
    }

    /// Counts the triangles of `records`, which belong to `cell`.
    pub fn count(self, records: Records<'_>, cell: CellCode) -> Result<Grid> {
        let grid = self.grid(cell);
        let layout = records.layout;
        records.pieces(self.tuning.piece, self.monitor, |words| {
            words.par_chunks_exact(layout.words()).with_min_len(1024).for_each(|record| {
                if self.placement.repeats() {
                    grid.count(&layout.triangle(record), self.placement);
                } else {
                    grid.count_box(layout.bounds(record), self.placement.root);
                }
            });
            Ok(())
        })?;
        Ok(grid)
    }

    /// Sorts the triangles of `records`, which belong to `cell`, into chunks of `units`; they go to `spool`.
    pub fn distribute<'s>(
        self,
        records: Records<'_>,
        cell: CellCode,
        units: &[Unit],
        spool: Spool<'s>,
    ) -> Result<(Spool<'s>, Vec<Chunk>)> {
        let ends = merge(units, self.limit.max(self.least(units, records.layout)));
        let layout = records.layout;
        let mut writer = ChunkWriter::new(self.tuning.buffer_words, spool, layout, units, &ends);
        // The chunk of each unit.
        let chunk_of: Vec<u32> = (0..units.len()).map(|unit| ends.partition_point(|&end| end <= unit) as u32).collect();
        let mut waiting: Vec<Sorted> = Vec::new();
        records.pieces(self.tuning.piece, self.monitor, |words| {
            // The piece before is written while this one is sorted.
            let before = std::mem::take(&mut waiting);
            let sort = || -> Vec<Sorted> {
                let parts = words.par_chunks(PART * layout.words());
                parts.map(|part| self.sorted(part, layout, cell, units, &chunk_of)).collect()
            };
            let (sorted, written) = rayon::join(sort, || writer.take(&before));
            waiting = sorted;
            written
        })?;
        writer.take(&waiting)?;
        writer.finish()
    }

    /// Triangles that a chunk of these units must have lest extents are too many.
    fn least(self, units: &[Unit], layout: Layout) -> u64 {
        let triangles = units.iter().map(|unit| unit.triangles).sum::<u64>();
        let words = triangles * layout.words() as u64;
        let Tuning { buffer_words, extents, .. } = *self.tuning;
        // So many chunks share the buffers, and have an extent for each buffer full. Half of that, since chunks are cut as it fits.
        let most = u128::from(buffer_words as u64) * u128::from(extents) / 2 / u128::from(words.max(1));
        triangles.div_ceil(u64::try_from(most).unwrap_or(u64::MAX).min(extents / 2).max(2))
    }

    /// A part by chunks: each record once in each chunk it belongs to.
    fn sorted(self, part: &[u32], layout: Layout, cell: CellCode, units: &[Unit], chunk_of: &[u32]) -> Sorted {
        let words = layout.words();
        // Runs of records that go to the same chunk: neighbours in a mesh's file mostly do.
        let mut goals: Vec<(u32, Range<usize>)> = Vec::new();
        let mut finder = UnitFinder::new(units);
        for (number, record) in part.chunks_exact(words).enumerate() {
            if self.placement.repeats() {
                let triangle = layout.triangle(record);
                places(units, &triangle, cell, self.placement, |unit| {
                    // Units come in order, so a chunk that has the record already is the last one.
                    let goal = (chunk_of[unit], number..number + 1);
                    if goals.last() != Some(&goal) {
                        goals.push(goal);
                    }
                });
            } else {
                let chunk = chunk_of[finder.place(cell_of(self.placement.root, layout.bounds(record)))];
                match goals.last_mut() {
                    Some((last, run)) if *last == chunk => run.end = number + 1,
                    _ => goals.push((chunk, number..number + 1)),
                }
            }
        }
        goals.sort_unstable_by_key(|(chunk, run)| (*chunk, run.start));
        let all: usize = goals.iter().map(|(_, run)| run.len()).sum();
        let mut sorted = Sorted { words: Vec::with_capacity(words * all), runs: Vec::new() };
        for runs in goals.chunk_by(|a, b| a.0 == b.0) {
            let before = sorted.words.len();
            for (_, run) in runs {
                sorted.words.extend_from_slice(&part[run.start * words..run.end * words]);
            }
            sorted.runs.push((runs[0].0, sorted.words.len() - before));
        }
        sorted
    }
}

/// Records that are sorted at a time by one thread.
const PART: usize = 4096;

/// Records by chunks.
struct Sorted {
    words: Vec<u32>,
    /// Chunk and number of words of each run.
    runs: Vec<(u32, usize)>,
}

/// Chunks being filled.
struct ChunkWriter<'a> {
    spool: Spool<'a>,
    chunks: Vec<Chunk>,
    buffers: Vec<Vec<u32>>,
    buffer_words: usize,
}

impl<'a> ChunkWriter<'a> {
    fn new(buffer_words: usize, spool: Spool<'a>, layout: Layout, units: &[Unit], ends: &[usize]) -> Self {
        let starts = std::iter::once(0).chain(ends.iter().copied());
        let chunks: Vec<Chunk> = starts
            .zip(ends)
            .map(|(from, &to)| Chunk { units: units[from..to].to_vec(), extents: vec![], sum: 0 })
            .collect();
        ChunkWriter {
            spool,
            buffers: vec![Vec::new(); chunks.len()],
            buffer_words: (buffer_words / chunks.len()).clamp(layout.words(), 1 << 18),
            chunks,
        }
    }

    fn take(&mut self, parts: &[Sorted]) -> Result<()> {
        for part in parts {
            let mut rest = &part.words[..];
            for &(chunk, words) in &part.runs {
                let (run, after) = rest.split_at(words);
                rest = after;
                self.push(chunk as usize, run)?;
            }
        }
        Ok(())
    }

    fn push(&mut self, chunk: usize, run: &[u32]) -> Result<()> {
        let buffer = &mut self.buffers[chunk];
        if buffer.len() + run.len() > self.buffer_words {
            self.flush(chunk)?;
        }
        let buffer = &mut self.buffers[chunk];
        if buffer.capacity() == 0 {
            buffer.reserve_exact(self.buffer_words.max(run.len()));
        }
        buffer.extend_from_slice(run);
        Ok(())
    }

    fn flush(&mut self, chunk: usize) -> Result<()> {
        let buffer = &mut self.buffers[chunk];
        if !buffer.is_empty() {
            let Chunk { extents, sum, .. } = &mut self.chunks[chunk];
            extents.push(Extent { at: self.spool.len(), words: buffer.len() as u64 });
            *sum = xxh3_64_with_seed(bytemuck::cast_slice(buffer), *sum);
            self.spool.append(buffer)?;
            buffer.clear();
        }
        Ok(())
    }

    fn finish(mut self) -> Result<(Spool<'a>, Vec<Chunk>)> {
        (0..self.chunks.len()).try_for_each(|chunk| self.flush(chunk))?;
        self.chunks.iter_mut().for_each(|chunk| chunk.extents.shrink_to_fit());
        Ok((self.spool, self.chunks))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::build::tests::TINY;
    use crate::build::work::WorkFolder;
    use crate::format::SplitMode;
    use crate::geometry::{Aabb, RootCube};

    #[test]
    fn extents_are_as_many_as_they_may_be() {
        let folder = tempfile::tempdir().unwrap();
        let work = WorkFolder::new(folder.path(), "a.oct".as_ref(), true).unwrap();
        let layout = Layout::default();
        // Triangles all over a cube, in no order.
        let at = |i: u32, k: u32| (i.wrapping_mul(2_654_435_761).rotate_left(k) >> 8) as f32 * 0.9 / 16_777_216.0;
        let record = |i: u32| -> Vec<u32> {
            let corner = |j: u32| [at(i, 3), at(i, 11) + 1e-3 * j as f32, at(i, 19) + 1e-3 * (j * j) as f32];
            [corner(0), corner(1), corner(2)].as_flattened().iter().map(|x| x.to_bits()).chain([i]).collect()
        };
        let mut spool = Spool::new(&work, "records", 0);
        (0..4000).for_each(|i| spool.append(&record(i)).unwrap());
        let bounds = Aabb { min: glam::Vec3::ZERO, max: glam::Vec3::splat(0.95) };
        let placement = Placement { root: RootCube::around(bounds), split: SplitMode::Sah };
        let extents = [Extent { at: 0, words: spool.len() }];
        let records = Records { spool: &spool, extents: &extents, layout };
        let mut chunks_of = Vec::new();
        for most in [1 << 20, 300, 60] {
            let tuning = Tuning { buffer_words: 3000, extents: most, ..TINY };
            let sorting = Sorting { tuning: &tuning, placement, limit: 100, depth: 21, monitor: Monitor::silent() };
            let units = sorting.count(records, CellCode::ROOT).unwrap().units(100, placement);
            let goal = Spool::new(&work, "chunks", 0);
            let (spool, chunks) = sorting.distribute(records, CellCode::ROOT, &units, goal).unwrap();
            let made = chunks.iter().map(|chunk| chunk.extents.len() as u64).sum::<u64>();
            assert!(made <= most, "{made} extents in {} chunks", chunks.len());
            let mut ids = Vec::new();
            for chunk in &chunks {
                let words = Records { spool: &spool, extents: &chunk.extents, layout }.load().unwrap();
                let held: Vec<u32> = words.chunks(layout.words()).map(|record| layout.id(record)).collect();
                assert!(held.is_sorted() && held.len() as u64 == chunk.triangles());
                ids.extend(held);
            }
            ids.sort_unstable();
            assert!(ids.into_iter().eq(0..4000));
            chunks_of.push(chunks.len());
        }
        assert!(chunks_of[0] > 50 && chunks_of[1] < chunks_of[0] && chunks_of[2] < chunks_of[1], "{chunks_of:?}");
    }
}
