//! The builder as a whole: the phases in order, and what passes from one to the next.
//!
//! The phases themselves stand apart: [`early`] (split), [`sorting`] (count and distribute), [`pages`] (chunks), [`finish`]
//! (stitch), and [`taken_up`] (what a killed build wrote of the file).

use std::path::Path;

use crate::error::{Error, Result};
use crate::event::Monitor;
use crate::format::{Brick, LeafUnit, OctWriter};
use crate::mesh::TriangleSource;

use super::brick::BrickBuilder;
use super::checkpoint::State;
use super::chunk::BrickRule;
use super::distribute::{Chunk, Extent, Sorting};
use super::grid::{CellCode, Placement, Unit};
use super::materials::diffuse;
use super::options::{BuildOptions, Tuning, alone_bytes};
use super::page_log::PageLog;
use super::phases::Phases;
use super::record::Layout;
use super::report::BuildReport;
use super::sound::Unfit;
use super::subtree::TopBrick;
use super::triangles::{Left, Mesh, Stage, Triangles, join_all, read, taken_up};
use super::work::WorkFolder;

mod early;
mod finish;
mod pages;
mod sorting;
mod taken_up;

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

/// [`build`] as of a mesh far too large for its memory, however small it is: all of it goes through temporary files, in small
/// pieces, and is sorted again and again. The bytes written are the same. For tests and fuzzers of what killed builds leave.
#[doc(hidden)]
pub fn build_spilling(
    source: &mut dyn TriangleSource,
    output: &Path,
    options: &BuildOptions,
    monitor: Monitor<'_>,
) -> Result<BuildReport> {
    build_tuned(source, output, options, &Tuning::TINY, monitor)
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

    let found = if options.resume { to_go_on_with((&work, output), options, tuning, monitor)? } else { None };
    let joined = |scan, phases: &mut _| join_all(scan, (&work, output), options, tuning, phases, monitor);
    let Triangles { mesh, stage, state } = match found {
        Some(Left::Joined(triangles)) => triangles,
        Some(Left::Scanned(scan)) => joined(scan, &mut phases)?,
        None => {
            writer.restart(0)?;
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

/// What a killed build left, if it can be gone on with; else it is told why not.
fn to_go_on_with<'w>(
    (work, output): (&'w WorkFolder, &Path),
    options: &BuildOptions,
    tuning: &Tuning,
    monitor: Monitor<'_>,
) -> Result<Option<Left<'w>>> {
    match taken_up(work, options, tuning, monitor) {
        Ok(left) => return Ok(Some(left)),
        Err(Unfit::Interrupted) => return Err(Error::Interrupted),
        Err(Unfit::Other) => monitor.warn(format!(
            "{}: there is no unfinished build of this mesh with these options, or it had more memory; it begins anew",
            output.display()
        )),
        Err(Unfit::Damaged(what)) => {
            monitor.warn(format!("{what}; the unfinished build cannot be gone on with, and it begins anew"));
        }
    }
    Ok(None)
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
        let mut sorting = Sorting {
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
                let whole = Chunk { units: vec![root], extents, sum: 0 };
                self.writer.restart(0)?;
                if whole.triangles() <= sorting.limit {
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
                    self.begin_pages(work, state.sum())?;
                }
                (spool, chunks, 0)
            }
            Stage::Sorted(spool, chunks) => {
                phases.expect_sorting(true);
                let done = self.take_up_pages(work, state.as_ref().map_or(0, State::sum), &chunks)?;
                // What remains of memory is not the same in each run; and the source's reader took none in this one.
                sorting.limit += sorting.limit / 8;
                (spool, chunks, done)
            }
        };
        phases.begin("chunks");
        self.chunks(&spool, &chunks, done, sorting, (work, 1), phases)
    }
}
