//! Triangles are sorted into chunks, and chunks taken into memory one after the other.
//!
//! A chunk is too large for that where a cell of the grid is overfull; where there are so many chunks that they are sorted in two
//! steps (`distribute.rs`); and where a build goes on that had more memory.

use super::super::chunk::BrickList;
use super::super::distribute::{Chunk, Records, Sorting};
use super::super::grid::{CellCode, Grid, Unit};
use super::super::phases::Phases;
use super::super::spool::Spool;
use super::super::work::WorkFolder;
use super::Build;
use crate::error::Result;
use crate::event::Monitor;

impl Build<'_> {
    /// Sorts an overfull chunk into smaller ones: by its units, or, if it is one cell, by cells below that. Files go to `work`;
    /// `depth`: how many times the triangles were sorted before.
    pub(super) fn sort<'w>(
        &self,
        spool: &Spool<'_>,
        chunk: &Chunk,
        grid: Option<Grid>,
        sorting: Sorting<'_>,
        (work, depth): (&'w WorkFolder, usize),
        phases: &mut Phases<'_>,
    ) -> Result<(Spool<'w>, Vec<Chunk>)> {
        let records = Records { spool, extents: &chunk.extents, layout: self.layout };
        let goal = Spool::new(work, format!("chunks{depth}"), 0);
        let [Unit { cell, .. }] = chunk.units[..] else {
            phases.begin("distribute");
            return sorting.distribute(records, CellCode::ROOT, &chunk.units, goal);
        };
        let grid = match grid {
            Some(grid) => grid,
            None => {
                phases.begin("count");
                sorting.count(records, cell)?
            }
        };
        let units = grid.units(sorting.limit, sorting.placement);
        phases.begin("distribute");
        sorting.distribute(records, cell, &units, goal)
    }

    /// Writes the pages of all chunks but the first `done`; one that is still overfull is sorted again.
    pub(super) fn chunks(
        &mut self,
        spool: &Spool<'_>,
        chunks: &[Chunk],
        done: usize,
        sorting: Sorting<'_>,
        (work, depth): (&WorkFolder, usize),
        phases: &mut Phases<'_>,
    ) -> Result<()> {
        for (number, chunk) in chunks.iter().enumerate().skip(done) {
            if chunk.triangles() <= sorting.limit {
                self.load(spool, chunk)?;
            } else if chunk.units.len() == 1 && chunk.units[0].cell.level >= self.rule.depth {
                self.runs(spool, chunk)?;
            } else {
                let (spool, chunks) = self.sort(spool, chunk, None, sorting, (work, depth), phases)?;
                phases.begin("chunks");
                self.chunks(&spool, &chunks, 0, sorting, (work, depth + 1), phases)?;
            }
            if let (1, Some(log)) = (depth, &mut self.log) {
                self.writer.flush()?;
                log.note(number as u64 + 1)?;
            }
        }
        Ok(())
    }

    /// Takes a chunk into memory, and writes its pages.
    pub(super) fn load(&mut self, spool: &Spool<'_>, chunk: &Chunk) -> Result<()> {
        self.monitor.check()?;
        let words = Records { spool, extents: &chunk.extents, layout: self.layout }.load()?;
        self.chunk(&words, &chunk.units)
    }

    /// Writes the pages of an overfull cell at the depth limit, which are runs of its triangles.
    fn runs(&mut self, spool: &Spool<'_>, chunk: &Chunk) -> Result<()> {
        let (cell, layout, limit) = (chunk.units[0].cell, self.layout, self.rule.limit as usize);
        let run_words = limit * layout.words();
        let mut held: Vec<u32> = Vec::new();
        let build = |this: &mut Self, words: &[u32]| {
            let records = (0..(words.len() / layout.words()) as u32).collect();
            this.wave(&[BrickList { cell, records }], words)
        };
        let records = Records { spool, extents: &chunk.extents, layout };
        records.pieces(self.tuning.piece.min(limit as u64), Monitor::silent(), |words| {
            let fits = words.len().min(run_words - held.len());
            held.extend_from_slice(&words[..fits]);
            if held.len() == run_words {
                build(self, &held)?;
                held.clear();
                held.extend_from_slice(&words[fits..]);
            }
            Ok(())
        })?;
        if held.is_empty() { Ok(()) } else { build(self, &held) }
    }
}
