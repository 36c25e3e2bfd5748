//! The builder as a whole: the phases in order, and what passes from one to the next.
//!
//! Two phases stand apart: [`early`] (split) and [`finish`] (stitch).

use std::path::Path;

use rayon::prelude::*;

use crate::error::{Error, Result};
use crate::event::Monitor;
use crate::format::{Brick, Flags, LeafUnit, OctWriter, PageId, SplitMode};
use crate::mesh::TriangleSource;

use super::brick::{BrickBuilder, BuiltBrick};
use super::checkpoint::{PageEntry, PageLog, State};
use super::chunk::{BrickList, BrickRule, bricks};
use super::distribute::{Chunk, Extent, Records, Sorting};
use super::grid::{CellCode, Grid, Placement, Unit};
use super::materials::diffuse;
use super::options::{BuildOptions, Tuning, alone_bytes};
use super::phases::Phases;
use super::record::Layout;
use super::report::BuildReport;
use super::spool::Spool;
use super::subtree::{BrickTriangle, Cell, TopBrick};
use super::triangles::{Left, Mesh, Stage, Triangles, join_all, read, taken_up};
use super::work::WorkFolder;

mod early;
mod finish;

/// Builds the octree file `output` from `source`.
///
/// The file is written under a temporary name, synced and renamed: on any error, and when `monitor` says stop
/// ([`Error::Interrupted`]), nothing is left behind and an older `output` stays as it was. The work runs on the current
/// rayon pool; the bytes written do not depend on it. Errors: options out of range, a source without triangles
/// ([`Error::Input`]), whatever the source reports, and [`Error::Io`].
pub fn build(
    source: &mut dyn TriangleSource,
    output: &Path,
    options: &BuildOptions,
    monitor: Monitor<'_>,
) -> Result<BuildReport> {
    let tuning = Tuning::within(options.memory, rayon::current_num_threads());
    build_tuned(source, output, options, &tuning, monitor)
}

/// [`build`] with sizes that only tests change.
pub(super) fn build_tuned(
    source: &mut dyn TriangleSource,
    output: &Path,
    options: &BuildOptions,
    tuning: &Tuning,
    monitor: Monitor<'_>,
) -> Result<BuildReport> {
    options.validate()?;
    // Both at once, so that a folder that cannot be written is told before a long scan.
    let mut writer = OctWriter::open(output)?;
    let work = WorkFolder::new(&options.temp_folder(output), output, writer.is_first())?;
    let mut phases = Phases::new(options.memory, monitor);

    let found = if options.resume { taken_up(&work, options, tuning) } else { None };
    if options.resume && found.is_none() {
        monitor.warn("there is no unfinished build of this mesh with these options to go on with; it begins anew");
    }
    let joined = |scan, phases: &mut _| join_all(scan, (&work, output), options, tuning, phases, monitor);
    let Triangles { mesh, stage, state } = match found {
        Some(Left::Joined(triangles)) => triangles,
        Some(Left::Scanned(scan)) => joined(scan, &mut phases)?,
        None => {
            writer.restart()?;
            work.clear()?;
            joined(read(source, &work, options, tuning, &mut phases, monitor)?, &mut phases)?
        }
    };
    let mut build = Build::new(&mesh, options, tuning, writer, monitor);
    build.run(stage, state, (&work, output), &mut phases)?;
    phases.begin("stitch");
    let mut report = build.finish(output)?;
    report.phases = phases.finish();
    Ok(report)
}

/// A file being built, from the join on.
struct Build<'a> {
    mesh: &'a Mesh,
    options: &'a BuildOptions,
    tuning: &'a Tuning,
    monitor: Monitor<'a>,
    layout: Layout,
    bricks: BrickBuilder<'a>,
    rule: BrickRule,
    writer: OctWriter,
    records: Vec<Brick>,
    tops: Vec<TopBrick>,
    depths: Vec<u32>,
    report: BuildReport,
    attributes: u32,
    /// Entries of the pages, noted chunk by chunk.
    log: Option<PageLog>,
}

impl<'a> Build<'a> {
    fn new(
        mesh: &'a Mesh,
        options: &'a BuildOptions,
        tuning: &'a Tuning,
        writer: OctWriter,
        monitor: Monitor<'a>,
    ) -> Self {
        let Mesh { tally, layout, root, .. } = *mesh;
        // Where few vertices are shared, 16 triangles have more than 16 of them.
        let shares_few = mesh.points as f64 > 0.75 * tally.kept as f64;
        let placement = Placement { root, split: options.split };
        Build {
            bricks: BrickBuilder {
                options,
                layout,
                root,
                unit: if shares_few { LeafUnit::B32 } else { LeafUnit::B16 },
                wide_materials: mesh.materials.len() > usize::from(u16::MAX),
                colors: mesh.materials.iter().map(diffuse).collect(),
            },
            rule: BrickRule { placement, limit: options.brick_limit(tally.kept, layout), depth: options.depth.into() },
            report: BuildReport {
                triangles: tally.kept,
                source_triangles: mesh.triangles,
                vertices: mesh.vertices,
                dropped: tally.dropped,
                polygons: tally.polygons,
                merged: tally.merged,
                largest_shift: tally.shift,
                ..Default::default()
            },
            attributes: 0,
            log: None,
            records: Vec::new(),
            tops: Vec::new(),
            depths: Vec::new(),
            mesh,
            options,
            tuning,
            monitor,
            layout,
            writer,
        }
    }

    /// Fails if a brick of records of that layout would not fit in the memory.
    fn check_memory(&self, layout: Layout) -> Result<()> {
        let largest = u64::from(self.rule.limit).min(self.report.triangles);
        // Alone, a brick may have the whole share of a chunk and of a wave, and its records too.
        let needed = largest * alone_bytes(layout, self.options.split);
        let there = self.tuning.alone_bytes();
        if needed <= there {
            return Ok(());
        }
        let more = (self.options.memory + (needed - there) * 8 / 6).div_ceil(1 << 20);
        Err(Error::Option(format!(
            "a page of {largest} triangles cannot be built within the memory allowed; allow about {more} MiB, or take \
             smaller pages (--brick)"
        )))
    }

    /// Sorts the records into chunks if there are more than one, and writes all pages.
    fn run<'w>(
        &mut self,
        stage: Stage<'w>,
        mut state: Option<State>,
        (work, output): (&'w WorkFolder, &Path),
        phases: &mut Phases<'_>,
    ) -> Result<()> {
        let stage = self.early(stage, &mut state, (work, output), phases)?;
        let sorting = Sorting {
            tuning: self.tuning,
            placement: self.rule.placement,
            limit: self.tuning.chunk(self.layout).max(self.rule.limit.into()),
            depth: self.rule.depth,
            monitor: self.monitor,
        };
        let (spool, chunks, done) = match stage {
            Stage::Joined(records, grid) => {
                let root = Unit { cell: CellCode::ROOT, triangles: records.len() / self.layout.words() as u64 };
                let extents = vec![Extent { at: 0, words: records.len() }];
                let whole = Chunk { units: vec![root], extents };
                self.writer.restart()?;
                if self.is_small(&whole, sorting) {
                    drop((grid, state));
                    phases.begin("chunks");
                    return match records.memory() {
                        Some(words) => self.chunk(words, &whole.units),
                        None => self.load(&records, &whole),
                    };
                }
                phases.expect_sorting(true);
                let (spool, chunks) = self.sort(&records, &whole, grid, sorting, (work, 0), phases)?;
                if let Some(mut state) = state {
                    state.add_chunks(&chunks);
                    state.save(work)?;
                    self.log = Some(PageLog::create(work)?);
                }
                (spool, chunks, 0)
            }
            Stage::Sorted(spool, chunks) => {
                phases.expect_sorting(true);
                let done = self.take_up_pages(work)?;
                (spool, chunks, done)
            }
        };
        phases.begin("chunks");
        self.chunks(&spool, &chunks, done, sorting, (work, 1), phases)
    }

    /// Goes on with the pages that a killed build wrote: how many chunks they make.
    fn take_up_pages(&mut self, work: &WorkFolder) -> Result<usize> {
        if let Some((log, chunks, entries)) = PageLog::reopen(work)
            && self.writer.resume(entries.iter().map(|entry| entry.record).collect())?
        {
            entries.iter().for_each(|entry| self.count(entry));
            self.log = Some(log);
            return Ok(chunks as usize);
        }
        self.writer.restart()?;
        self.log = Some(PageLog::create(work)?);
        Ok(0)
    }

    /// Whether a chunk is to be taken into memory as it is: it is small, or runs of units that are.
    fn is_small(&self, chunk: &Chunk, sorting: Sorting<'_>) -> bool {
        chunk.triangles() <= sorting.limit || chunk.units.len() > 1
    }

    /// Sorts an overfull chunk (of one cell) into smaller ones. `place`: where the files go, and how deep this is.
    fn sort<'w>(
        &self,
        spool: &Spool<'_>,
        chunk: &Chunk,
        grid: Option<Grid>,
        sorting: Sorting<'_>,
        (work, depth): (&'w WorkFolder, usize),
        phases: &mut Phases<'_>,
    ) -> Result<(Spool<'w>, Vec<Chunk>)> {
        let cell = chunk.units[0].cell;
        let records = Records { spool, extents: &chunk.extents, layout: self.layout };
        let grid = match grid {
            Some(grid) => grid,
            None => {
                phases.begin("count");
                sorting.count(records, cell)?
            }
        };
        let units = grid.units(sorting.limit, sorting.placement);
        phases.begin("distribute");
        sorting.distribute(records, cell, &units, Spool::new(work, format!("chunks{depth}"), 0))
    }

    /// Writes the pages of all chunks but the first `done`; one that is still overfull is sorted again, below its own cell.
    fn chunks(
        &mut self,
        spool: &Spool<'_>,
        chunks: &[Chunk],
        done: usize,
        sorting: Sorting<'_>,
        (work, depth): (&WorkFolder, usize),
        phases: &mut Phases<'_>,
    ) -> Result<()> {
        for (number, chunk) in chunks.iter().enumerate().skip(done) {
            if self.is_small(chunk, sorting) {
                self.load(spool, chunk)?;
            } else if chunk.units[0].cell.level >= self.rule.depth {
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

    fn load(&mut self, spool: &Spool<'_>, chunk: &Chunk) -> Result<()> {
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

    /// Writes the pages of a chunk in memory, built in parallel in waves of bounded size.
    fn chunk(&mut self, words: &[u32], units: &[Unit]) -> Result<()> {
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
    fn wave(&mut self, lists: &[BrickList], words: &[u32]) -> Result<()> {
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
    fn count(&mut self, entry: &PageEntry) {
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
