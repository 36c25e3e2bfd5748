//! The builder as a whole: the phases in order, and what passes from one to the next.

use std::path::Path;

use bytemuck::Zeroable;
use rayon::prelude::*;

use crate::error::{Error, Result};
use crate::event::Monitor;
use crate::format::{Brick, Flags, Header, LeafUnit, Node, OctWriter, PageId, Points, SplitMode, Surrogate, Top};
use crate::mesh::TriangleSource;

use super::brick::{BrickBuilder, BuiltBrick};
use super::checkpoint::{PageEntry, PageLog, State};
use super::chunk::{BrickList, BrickRule, bricks};
use super::distribute::{Chunk, Extent, Records, Sorting};
use super::early::Early;
use super::grid::{CellCode, Grid, Placement, Unit};
use super::materials::{diffuse, materials};
use super::options::{BuildOptions, Tuning, alone_bytes};
use super::phases::Phases;
use super::record::Layout;
use super::report::BuildReport;
use super::spool::Spool;
use super::subtree::{BrickTriangle, Cell, TopBrick, build_top, top_levels, top_surrogates};
use super::triangles::{Left, Mesh, Stage, Triangles, join_all, read, taken_up};
use super::work::WorkFolder;

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
    build.run(stage, state, &work, &mut phases)?;
    phases.begin("stitch");
    let mut report = build.finish(output)?;
    report.phases = phases.finish();
    Ok(report)
}

/// Bytes held of each page until the end, its share of the top tree included.
const PAGE_BYTES: u64 = 400;

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

    /// Fails if a brick, or the records of all bricks, would not fit in the memory.
    fn check_memory(&self) -> Result<()> {
        let largest = u64::from(self.rule.limit).min(self.report.triangles);
        // Alone, a brick may have the whole share of a chunk and of a wave, and its records too.
        let needed = largest * alone_bytes(self.layout, self.options.split);
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
        work: &'w WorkFolder,
        phases: &mut Phases<'_>,
    ) -> Result<()> {
        let stage = self.early(stage, &mut state, work, phases)?;
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

    /// Cuts large triangles where that pays, if it was not done before: then records stand for parts of triangles.
    fn early<'w>(
        &mut self,
        mut stage: Stage<'w>,
        state: &mut Option<State>,
        work: &'w WorkFolder,
        phases: &mut Phases<'_>,
    ) -> Result<Stage<'w>> {
        let early = Early {
            rule: self.rule,
            layout: self.layout,
            longest: self.mesh.tally.longest,
            tuning: self.tuning,
            monitor: self.monitor,
        };
        let mut is_cut = state.as_ref().is_some_and(State::has_parts);
        if let Stage::Joined(records, _) = &stage
            && !is_cut
            && self.options.ids
            && early.is_for(self.report.triangles)
        {
            phases.begin("split");
            if let Some(mut parts) = early.cut(records, work)? {
                if let Some(state) = state {
                    parts.spill()?;
                    state.add_parts(parts.len());
                    state.save(work)?;
                }
                // Only now may the records of whole triangles go.
                (stage, is_cut) = (Stage::Joined(parts, None), true);
            }
        }
        self.layout.parts = is_cut;
        self.bricks.layout = self.layout;
        self.check_memory()?;
        Ok(stage)
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
        // In strict mode triangles repeat, so that this is only near enough for a bar.
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
        let first = u32::try_from(self.report.references);
        let fits = self.report.references + u64::from(brick.references) <= u64::from(u32::MAX);
        let (Ok(first_reference), true) = (first, fits) else {
            return Err(Error::Option(format!(
                "the tree would hold more than {} references, which is the limit; use --split sah or a larger --cell",
                u32::MAX
            )));
        };
        if (self.records.len() + 1) as u64 * PAGE_BYTES > self.tuning.top_bytes {
            return Err(Error::Option(format!(
                "the directory of more than {} pages does not fit in the memory allowed; allow more, or take larger pages \
                 (--brick)",
                self.records.len()
            )));
        }
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

    /// Writes the top and the header, and gives the file its name.
    fn finish(mut self, output: &Path) -> Result<BuildReport> {
        self.monitor.check()?;
        let nodes = if self.tops.len() > 1 { build_top(&self.tops).0 } else { Vec::new() };
        let folder = output.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        // Only named where some face has one: then the file has material numbers too.
        let used: &[_] = if self.layout.materials { &self.mesh.materials } else { &[] };
        let (materials, strings) = materials(used, folder);
        let header = self.header(&nodes, materials.len());
        (self.report.nodes, self.report.depth) = (header.nodes, header.depth);
        self.report.pages = self.records.len() as u32;
        let tops = &self.tops;
        let surrogates = &mut |bricks: &[Brick], roots: &[Surrogate]| top_surrogates(&nodes, tops, bricks, roots);
        let bricks = &mut self.records;
        let top = Top { nodes: &nodes, bricks, materials: &materials, strings: &strings, surrogates };
        self.report.bytes = self.writer.finish(header, top)?;
        self.report.bytes_per_triangle = self.report.bytes as f64 / self.report.triangles as f64;
        Ok(self.report)
    }

    /// The header, but for what the writer fills in.
    fn header(&self, top: &[Node], materials: usize) -> Header {
        let report = &self.report;
        Header {
            flags: self.flags(),
            triangles: report.triangles,
            references: report.references,
            source_triangles: report.source_triangles,
            vertices: report.vertices,
            nodes: report.nodes + top.len() as u64,
            leaves: report.leaves,
            pages: self.records.len() as u32,
            top_nodes: top.len() as u32,
            materials: materials as u32,
            depth: self.depth(top),
            root_corner: self.mesh.root.corner.to_array(),
            origin: self.options.origin,
            root_log2_side: self.mesh.root.log2_side,
            bounds_min: self.mesh.tally.bounds.min.to_array(),
            bounds_max: self.mesh.tally.bounds.max.to_array(),
            brick_limit: self.rule.limit,
            cell_limit: self.options.cell,
            dropped: report.dropped,
            split: match self.options.split {
                SplitMode::Sah => 0,
                SplitMode::Octree => 1,
                SplitMode::Strict => 2,
            },
            leaf_limit: self.options.leaf,
            depth_limit: self.options.depth,
            ..Header::zeroed()
        }
    }

    /// Nodes on the longest path from the root down to a leaf.
    fn depth(&self, top: &[Node]) -> u32 {
        let above = top_levels(top, self.depths.len());
        above.iter().zip(&self.depths).map(|(above, below)| above + below).max().unwrap_or(0)
    }

    fn flags(&self) -> Flags {
        let repeats = self.rule.placement.repeats() || self.report.references > self.report.triangles;
        let flag = |mask: u32, set: bool| if set { mask } else { 0 };
        Flags(
            self.attributes
                | flag(Flags::PACKED, self.options.compress.is_some())
                | flag(Flags::IDS, self.options.ids)
                | flag(Flags::DETAIL, self.options.lod)
                | flag(Flags::MATERIALS, self.layout.materials)
                | flag(Flags::WIDE_MATERIALS, self.layout.materials && self.bricks.wide_materials)
                | flag(Flags::STEPS, self.options.positions.points() == Points::Steps)
                | flag(Flags::LEAF_UNIT_32, self.bricks.unit == LeafUnit::B32)
                | flag(Flags::REPEATS, repeats),
        )
    }
}
