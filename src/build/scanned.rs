//! What is noted when the scan is done, so that a build that is killed while it joins need not read its source again.
//!
//! The tables and the faces lie in the work folder as they are, tables that are in memory as copies. An `index` file lists
//! the blocks of faces and the faces that were cut as they came: it grows with the mesh, so it is no part of the state.
//! Nothing is noted where the faces fit in memory: then the mesh is small for it, and quick to read again.

use std::path::PathBuf;

use glam::Vec3;
use serde::{Deserialize, Serialize};

use super::checkpoint::{MaterialState, State, bits, materials_of, states_of};
use super::faces::{FaceCounts, Faces};
use super::options::{BuildOptions, Tuning};
use super::scan::Scan;
use super::sound::Unfit;
use super::spool::Spool;
use super::table::{Kind, Table};
use super::work::WorkFolder;
use crate::error::Result;
use crate::event::Monitor;
use crate::geometry::Aabb;
use crate::mesh::SourceInfo;

/// The outcome of the scan.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct ScannedState {
    /// Words of the tables of positions, texture coordinates and normals, of the faces, and of their index.
    words: [u64; 5],
    /// Their checksums.
    sums: [u64; 5],
    counts: FaceCounts,
    too_few_corners: u64,
    bad_index: u64,
    bounds: [u32; 6],
    materials: Vec<MaterialState>,
}

/// Names of the spools, in the order of [`ScannedState::words`].
pub(super) const SPOOLS: [&str; 5] = ["positions", "texcoords", "normals", "faces", "index"];

/// Notes what the scan found, if its faces are in a file and the source can be told from others.
pub(super) fn note<'a>(
    scan: &mut Scan<'a>,
    work: &'a WorkFolder,
    options: &BuildOptions,
    tuning: &Tuning,
) -> Result<()> {
    let can_note = super::checkpoint::can_note(&scan.info.materials, &scan.info.files, tuning);
    if !scan.faces.is_spilled() || !can_note || options.source.is_none() {
        return Ok(());
    }
    let [positions, texcoords, normals] = scan.tables();
    let [positions, texcoords, normals] =
        [positions.copy_to_file()?, texcoords.copy_to_file()?, normals.copy_to_file()?];
    let mut index = Spool::new(work, SPOOLS[4], 0).summed();
    index.spill()?;
    scan.faces.write_index(&mut index)?;
    let state = ScannedState {
        words: [positions, texcoords, normals, scan.faces.words(), index.len()],
        sums: [
            scan.positions.spool.checksum(),
            scan.texcoords.spool.checksum(),
            scan.normals.spool.checksum(),
            scan.faces.checksum(),
            index.checksum(),
        ],
        counts: scan.faces.counts(),
        too_few_corners: scan.info.too_few_corners,
        bad_index: scan.info.bad_index,
        bounds: bits(scan.bounds),
        materials: states_of(&scan.info.materials),
    };
    scan.index = Some(index);
    State::scanned(options, &scan.info.files, state).map_or(Ok(()), |mut state| state.save(work))
}

/// The scan of a killed build, if all of it is there and its blocks are not too large for the memory of this one. `files`: what
/// the source read beside its own.
pub(super) fn taken_up<'w>(
    state: &ScannedState,
    files: Vec<PathBuf>,
    work: &'w WorkFolder,
    tuning: &Tuning,
    monitor: Monitor<'_>,
) -> Result<Scan<'w>, Unfit> {
    // What remains of memory, and so the size of blocks, is not quite the same in each run. This one has no reader that takes any.
    let fits = state.counts.block_corners <= tuning.block_corners + tuning.block_corners / 8;
    if !fits || state.materials.len() > tuning.noted_materials || !tuning.holds_index(state.words[4]) {
        return Err(Unfit::Other);
    }
    let lies = |sound: bool, name: &str| if sound { Ok(()) } else { Err(Unfit::lies(work, name)) };
    let numbers = |words: u64, size: u64| words.is_multiple_of(size) && words / size <= u64::from(u32::MAX);
    let [positions, texcoords, normals, ..] = state.words;
    lies(numbers(positions, 3) && numbers(texcoords, 2) && numbers(normals, 3), "state")?;
    lies(state.too_few_corners.checked_add(state.counts.too_few_corners()).is_some(), "state")?;
    let mut bounds = Aabb::EMPTY;
    let mut spool = |i: usize| {
        let spool = Spool::reopen(work, SPOOLS[i], state.words[i]).ok_or_else(|| Unfit::short(work, SPOOLS[i]))?;
        // Faces are looked at block by block, below.
        let whole = i == 3
            || spool.holds(state.sums[i], 3, monitor, |words| {
                if i == 0 {
                    let points = words.chunks_exact(3).map(|p| Vec3::from([p[0], p[1], p[2]].map(f32::from_bits)));
                    bounds = bounds.union(Aabb::around(points.filter(|p| p.is_finite())));
                }
                true
            })?;
        if whole { Ok(spool) } else { Err(Unfit::checksum(work, SPOOLS[i])) }
    };
    let [positions, texcoords, normals] = [spool(0)?, spool(1)?, spool(2)?];
    let (faces, index) = (spool(3)?, spool(4)?);
    lies(bounds == super::checkpoint::bounds(state.bounds), "state")?;
    let faces = Faces::reopen(faces, &index, &state.counts).ok_or_else(|| Unfit::lies(work, SPOOLS[4]))?;
    match faces.check(&state.counts, monitor)? {
        None => return Err(Unfit::lies(work, SPOOLS[3])),
        Some(sum) if sum != state.sums[3] => return Err(Unfit::checksum(work, SPOOLS[3])),
        Some(_) => {}
    }
    let mut scan = Scan {
        positions: Table::new(positions, Kind::Position),
        texcoords: Table::new(texcoords, Kind::Texcoord),
        normals: Table::new(normals, Kind::Normal),
        faces,
        info: SourceInfo {
            materials: materials_of(&state.materials),
            too_few_corners: state.too_few_corners,
            bad_index: state.bad_index,
            files,
        },
        bounds,
        index: Some(index),
    };
    // What fits in memory is taken there again, the smallest first.
    let mut room = tuning.table_words as u64;
    let mut tables = scan.tables();
    tables.sort_by_key(|table| table.len());
    for table in tables {
        if table.len() <= room {
            room -= table.len();
            table.recall()?;
        }
    }
    Ok(scan)
}
