//! From the source, or from what a killed build left of it, to triangles that are ready to be built.

use std::path::Path;

use crate::error::{Error, Result};
use crate::event::Monitor;
use crate::geometry::RootCube;
use crate::mesh::TriangleSource;

use super::checkpoint::{ChunkState, JoinedState, Reached, State, can_note};
use super::distribute::Chunk;
use super::grid::{CellCode, Grid, Placement};
use super::join::{Tally, join};
use super::options::{BuildOptions, Tuning};
use super::origin::{suggestion, warn_if_merged};
use super::phases::Phases;
use super::polygon::CLIP_LIMIT;
use super::record::Layout;
use super::room::{Growth, check_after, check_before};
use super::scan::{Scan, scan};
use super::scanned;
use super::snap::{Positions, Snap};
use super::sound::{Told, Unfit};
use super::spool::Spool;
use super::work::WorkFolder;

/// The triangles of a mesh, ready to be built, and all else that is needed of it.
pub(super) struct Triangles<'w> {
    pub mesh: Mesh,
    pub stage: Stage<'w>,
    /// What to note of the build, if it can be taken up.
    pub state: Option<State>,
}

/// What is still needed of the source.
pub(super) struct Mesh {
    pub layout: Layout,
    pub tally: Tally,
    /// Different points, about.
    pub points: u64,
    pub materials: Vec<crate::mesh::MaterialInfo>,
    pub vertices: u64,
    pub triangles: u64,
    pub root: RootCube,
}

/// How far the triangles are.
pub(super) enum Stage<'w> {
    /// In the source's order, perhaps counted.
    Joined(Spool<'w>, Option<Grid>),
    /// Sorted into chunks, some of which may be written.
    Sorted(Spool<'w>, Vec<Chunk>),
}

/// What a killed build left.
pub(super) enum Left<'w> {
    /// All that the source sent.
    Scanned(Scan<'w>),
    /// Triangles, perhaps sorted.
    Joined(Triangles<'w>),
}

/// Reads the source.
pub(super) fn read<'w>(
    source: &mut dyn TriangleSource,
    work: &'w WorkFolder,
    options: &BuildOptions,
    tuning: &Tuning,
    phases: &mut Phases<'_>,
    monitor: Monitor<'_>,
) -> Result<Scan<'w>> {
    let triangles = source.triangles_hint();
    check_before(triangles, options.memory, work.temp(), monitor)?;
    phases.expect_sorting(triangles.is_none_or(|triangles| triangles > tuning.chunk(Layout::default())));
    phases.begin("scan");
    // What is expected to stay in memory needs no room.
    let growth = triangles.is_none().then(|| Growth::new(work.temp(), options.memory / 40));
    let mut scan = scan(source, work, tuning, growth, monitor)?;
    if scan.is_spilled() {
        // Memory goes to windows on the tables.
        scan.faces.spill()?;
    }
    scanned::note(&mut scan, work, options, tuning)?;
    Ok(scan)
}

/// Joins the faces of a source that has been read.
pub(super) fn join_all<'w>(
    mut scan: Scan<'w>,
    (work, output): (&'w WorkFolder, &Path),
    options: &BuildOptions,
    tuning: &Tuning,
    phases: &mut Phases<'_>,
    monitor: Monitor<'_>,
) -> Result<Triangles<'w>> {
    let mut tuning = *tuning;
    if scan.is_spilled() {
        tuning.record_words = 0;
    }
    let records = scan.faces.triangles() * 4 * scan.layout().words() as u64;
    if records > 4 * tuning.record_words as u64 {
        // They go to a file in the end, so from the first on.
        tuning.record_words = 0;
        check_after(records, scan.faces.triangles(), work.temp(), output)?;
    }
    phases.expect_sorting(scan.counts_ahead(options, &tuning));
    phases.begin("join");
    let guess = Placement { root: RootCube::around(scan.bounds), split: options.split };
    let snap = Snap::new(options.positions, scan.bounds, scan.faces.triangles());
    let mut grid = scan.counts_ahead(options, &tuning).then(|| Grid::new(CellCode::ROOT, tuning.first_grid(options)));
    let joined = join(&scan, work, &tuning, grid.as_mut().map(|grid| (grid, guess)), snap, monitor)?;
    check_joined(&joined.tally, options, monitor)?;
    let root = RootCube::around(joined.tally.bounds);
    let mesh = Mesh {
        layout: joined.layout,
        tally: joined.tally,
        points: joined.points,
        vertices: scan.positions.len(),
        triangles: scan.faces.triangles(),
        materials: std::mem::take(&mut scan.info.materials),
        root,
    };
    let files = &scan.info.files;
    let noted = joined.records.memory().is_none() && can_note(&mesh.materials, files, &tuning);
    let mut state = if noted { State::joined(options, files, mesh.state(&joined.records)) } else { None };
    state.as_mut().map_or(Ok(()), |state| state.save(work))?;
    Ok(Triangles { mesh, stage: Stage::Joined(joined.records, grid.filter(|_| root == guess.root)), state })
}

/// What a killed build left, if it is of this one, and whole.
pub(super) fn taken_up<'w>(
    work: &'w WorkFolder,
    options: &BuildOptions,
    tuning: &Tuning,
    monitor: Monitor<'_>,
) -> Result<Left<'w>, Unfit> {
    if !work.is_own() {
        return Err(Unfit::Other);
    }
    let state = State::load(work, options, tuning.top_bytes)?;
    let (joined, parts, chunks) = match &state.reached {
        Reached::Scanned(scanned) => {
            work.keep(&["state"].iter().chain(&scanned::SPOOLS).copied().collect::<Vec<_>>());
            return scanned::taken_up(scanned, state.beside(), work, tuning, monitor).map(Left::Scanned);
        }
        Reached::Joined { joined, parts, chunks } => (joined, *parts, chunks),
    };
    if joined.materials.len() > tuning.noted_materials {
        return Err(Unfit::Other);
    }
    let mesh = Mesh::of(joined);
    let told = Told { options, state: joined, mesh: &mesh, parts, monitor };
    if !told.counts_agree() {
        return Err(Unfit::lies(work, "state"));
    }
    let stage = match chunks {
        Some(chunks) => {
            let chunks: Vec<Chunk> = chunks.iter().map(ChunkState::chunk).collect();
            work.keep(&["state", "chunks0", "pages", "progress"]);
            Stage::Sorted(told.chunks(work, "chunks0", &chunks)?, chunks)
        }
        None => {
            let name = if parts { "parts" } else { "records" };
            work.keep(&["state", name]);
            Stage::Joined(told.records(work, name)?, None)
        }
    };
    Ok(Left::Joined(Triangles { mesh, stage, state: Some(state) }))
}

impl Mesh {
    fn state(&self, records: &Spool<'_>) -> JoinedState {
        let numbers = [self.points, self.vertices, self.triangles, records.len(), records.checksum()];
        JoinedState::new(&self.tally, self.layout, numbers, &self.materials)
    }

    fn of(state: &JoinedState) -> Mesh {
        let tally = state.tally();
        Mesh {
            layout: state.layout(),
            tally,
            points: state.points,
            materials: state.materials(),
            vertices: state.vertices,
            triangles: state.triangles,
            root: RootCube::around(tally.bounds),
        }
    }
}

/// Says what the join dropped or could not do well; fails if nothing is left.
fn check_joined(tally: &Tally, options: &BuildOptions, monitor: Monitor<'_>) -> Result<()> {
    let dropped = tally.dropped;
    if tally.kept == 0 {
        let mut what = String::from("holds no triangles");
        if dropped != Default::default() {
            what += &format!(
                " that can be hit (dropped: {} of zero area, {} with a vertex that is not finite, {} with a bad index; \
                 {} faces with too few corners)",
                dropped.degenerate, dropped.non_finite, dropped.bad_index, dropped.too_few_corners
            );
        }
        what += &match suggestion(tally, options) {
            Some(origin) => {
                format!("; it lies far from zero, where single precision merges vertices: try --origin {origin}")
            }
            None if dropped.degenerate > 0 && options.positions != Positions::Exact => {
                String::from("; the step of the grid may be too large for it: give a smaller one, or none")
            }
            None if dropped != Default::default() => String::from("; mend them in the program that made the mesh"),
            None => String::from("; name a mesh that has faces"),
        };
        return Err(Error::Input { file: options.source_name(), what });
    }
    warn_if_merged(tally, options, monitor);
    if tally.polygons.fanned > 0 {
        monitor.warn(format!(
            "{} faces have more than {CLIP_LIMIT} corners and were cut as fans, which overlap where a face is concave; \
             cut them in the program that made the mesh if they are",
            tally.polygons.fanned
        ));
    }
    Ok(())
}
