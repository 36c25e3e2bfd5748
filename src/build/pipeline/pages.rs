//! The main phase: a chunk in memory becomes pages, and these are written.

use rayon::prelude::*;

use super::super::brick::BuiltBrick;
use super::super::chunk::{BrickList, bricks};
use super::super::grid::Unit;
use super::super::page_log::PageEntry;
use super::super::subtree::{BrickTriangle, Cell, TopBrick};
use super::Build;
use crate::error::{Error, Result};
use crate::format::{Brick, Flags, PageId, SplitMode};

impl Build<'_> {
    /// Writes the pages of a chunk in memory, built in parallel in waves of bounded size.
    pub(super) fn chunk(&mut self, words: &[u32], units: &[Unit]) -> Result<()> {
        let lists = bricks(words, self.layout, units, self.rule);
        let most = self.tuning.wave(self.layout) as usize;
        // How large a strict brick becomes does not show before it is built.
        let bricks = if self.rule.placement.repeats() { rayon::current_num_threads() } else { usize::MAX };
        let mut rest = &lists[..];
        while !rest.is_empty() {
            self.monitor.check()?;
            let mut sum = 0;
            let fits = |list: &&BrickList| {
                sum += list.records.len();
                sum <= most
            };
            let wave = rest.iter().take(bricks).take_while(fits).count().max(1);
            self.wave(&rest[..wave], words)?;
            rest = &rest[wave..];
        }
        Ok(())
    }

    /// Builds bricks side by side, and from the first on that takes more than its share one after the other.
    pub(super) fn wave(&mut self, lists: &[BrickList], words: &[u32]) -> Result<()> {
        let first = self.records.len() as u32;
        let (bricks, monitor) = (&self.bricks, self.monitor);
        let share = self.tuning.wave_bytes / lists.len() as u64;
        let build = |(number, list): (u32, &BrickList)| {
            monitor.check()?;
            bricks.build(PageId(number), list, words, share)
        };
        let numbers = first..first + lists.len() as u32;
        let built: Vec<Option<BuiltBrick>> =
            numbers.into_par_iter().zip(lists).with_max_len(1).map(build).collect::<Result<_>>()?;
        let mut rest = lists;
        for brick in built.into_iter().map_while(|brick| brick) {
            self.append(brick)?;
            rest = &rest[1..];
        }
        rest.iter().try_for_each(|list| self.alone(list, words))?;
        // In strict mode, and where large triangles are cut, triangles repeat, so that this is only near enough for a bar.
        let done = self.report.references.min(self.report.triangles);
        self.monitor.progress(done, Some(self.report.triangles), "triangles");
        Ok(())
    }

    /// Builds a brick with all the memory that its chunk leaves.
    fn alone(&mut self, list: &BrickList, words: &[u32]) -> Result<()> {
        self.monitor.check()?;
        let taken = 4 * words.len() + (size_of::<BrickTriangle>() + 20) * list.records.len();
        let memory = self.tuning.alone_bytes().saturating_sub(taken as u64);
        match self.bricks.build(PageId(self.records.len() as u32), list, words, memory)? {
            Some(brick) => self.append(brick),
            None => Err(Error::Option(format!(
                "the strict octree of a page of {} triangles does not fit in the memory allowed; allow more, or take larger \
                 cells (--cell) or smaller pages (--brick)",
                list.records.len()
            ))),
        }
    }

    fn append(&mut self, brick: BuiltBrick) -> Result<()> {
        let first_reference = first_reference(self.report.references, brick.references, self.options.split)?;
        self.tuning.check_pages(self.records.len() as u64 + 1)?;
        let page = match &brick.packed {
            Some(packed) => self.writer.append_packed(&brick.page, packed)?,
            None => self.writer.append(&brick.page)?,
        };
        let record = self.writer.records()[page.0 as usize];
        let attributes =
            if brick.normals { Flags::NORMALS } else { 0 } | if brick.texcoords { Flags::TEXCOORDS } else { 0 };
        let entry = PageEntry {
            bounds_root: brick.top.bounds_root,
            nodes: brick.nodes,
            record,
            brick: Brick { node: 0, first_reference, corner: brick.corner, unit: brick.unit },
            level: brick.top.cell.level,
            index: brick.top.cell.index,
            leaves: brick.leaves,
            depth: brick.depth,
            attributes,
            zero: 0,
        };
        self.count(&entry);
        if let Some(log) = &mut self.log {
            log.push(entry);
        }
        Ok(())
    }

    /// Takes a page that is written into account.
    pub(super) fn count(&mut self, entry: &PageEntry) {
        let cell = Cell { level: entry.level, index: entry.index };
        self.records.push(entry.brick);
        self.tops.push(TopBrick { cell, bounds_root: entry.bounds_root });
        self.depths.push(entry.depth);
        self.report.references += u64::from(entry.record.references);
        self.report.nodes += entry.nodes;
        self.report.leaves += u64::from(entry.leaves);
        self.attributes |= entry.attributes;
    }
}
/// The number of the first reference of a page that has so `many`, after those `before` it.
fn first_reference(before: u64, many: u32, split: SplitMode) -> Result<u32> {
    // The highest number stands for none.
    if before + u64::from(many) < u64::from(u32::MAX) {
        return Ok(before as u32);
    }
    let advice = match split {
        SplitMode::Sah => "give --no-ids, which stores no triangle twice, or divide the mesh",
        SplitMode::Octree => "divide the mesh",
        SplitMode::Strict => "use --split sah or a larger --cell",
    };
    Err(Error::Option(format!(
        "the tree would hold more than {} references, which is the limit; {advice}",
        u32::MAX - 1
    )))
}
#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn references_end_below_the_highest_number() {
        let most = u64::from(u32::MAX - 1);
        assert_eq!(first_reference(most - 7, 7, SplitMode::Sah).unwrap(), u32::MAX - 8);
        for (split, way_out) in
            [(SplitMode::Sah, "--no-ids"), (SplitMode::Strict, "--split sah"), (SplitMode::Octree, "divide")]
        {
            let error = first_reference(most - 6, 7, split).unwrap_err();
            assert!(
                error.to_string().contains("4294967294 references") && error.to_string().contains(way_out),
                "{error}"
            );
        }
    }
}
