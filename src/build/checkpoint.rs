//! What a build notes on its way, so that it can go on after it was killed.
//!
//! The work folder holds a `state` file, written anew (and renamed) when a phase ends: what the source and the options
//! are, and all that the next phases need beside the spools ([`super::scanned`] for the scan), with checksums of these; behind it
//! stands its own. Pages are noted apart ([`super::page_log`]). What was noted is checked before it is used ([`super::sound`]).
//! Nothing is synced: after a kill the system still has what was written. After a restart of the machine that does not hold, so
//! the state names the boot it belongs to.

use std::fs;
use std::io::Write;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use super::distribute::{Chunk, Extent};
use super::grid::{CellCode, Unit};
use super::join::Tally;
use super::options::{BuildOptions, Tuning};
use super::record::Layout;
use super::report::Polygons;
use super::scanned::ScannedState;
use super::sound::Unfit;
use super::work::WorkFolder;
use crate::error::{Error, Result};
use crate::format::{Dropped, VERSION, checksum};
use crate::geometry::Aabb;
use crate::mesh::{self, MaterialInfo};

/// What was made so far.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct State {
    key: Key,
    /// Other files that the source read, and what they were.
    beside: Vec<(PathBuf, Option<String>)>,
    pub reached: Reached,
    /// The checksum of the text that it was noted as, or read from.
    #[serde(skip)]
    sum: u64,
}

/// How far the build is.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) enum Reached {
    /// The source is read.
    Scanned(ScannedState),
    /// The triangles are joined.
    Joined {
        joined: JoinedState,
        /// Whether records stand for parts of triangles: then they lie in the spool of that name.
        parts: bool,
        /// The chunks, if the records were sorted into some.
        chunks: Option<Vec<ChunkState>>,
    },
}

/// What must be the same for a build to go on.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Key {
    program: String,
    source: String,
    options: String,
    boot: String,
}

/// The outcome of scan and join; floating point numbers by their bits.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct JoinedState {
    pub layout: [bool; 3],
    pub points: u64,
    pub vertices: u64,
    pub triangles: u64,
    pub record_words: u64,
    /// The checksum of the spool of records, or of their parts.
    pub record_sum: u64,
    kept: u64,
    dropped: [u64; 4],
    polygons: [u64; 3],
    merged: u64,
    shift: u64,
    longest: u32,
    bounds: [u32; 6],
    all_bounds: [u32; 6],
    pub materials: Vec<MaterialState>,
}

/// Name, Ka, Kd, Ks, Ns, Ni, d, illum, map_Kd.
pub(super) type MaterialState =
    (String, [Option<[u32; 3]>; 3], [Option<u32>; 3], Option<u32>, Option<std::path::PathBuf>);

/// Units (level, code, triangles), extents (place, words) and checksum of a chunk.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct ChunkState {
    units: Vec<(u32, u64, u64)>,
    extents: Vec<(u64, u64)>,
    sum: u64,
}

impl Key {
    /// The key of a build; `None` if the source has none.
    fn of(options: &BuildOptions) -> Option<Key> {
        // What does not change the bytes is left out.
        let plain = BuildOptions { memory: 0, temp: None, name: None, resume: false, source: None, ..options.clone() };
        Some(Key {
            program: format!("{} {VERSION}", env!("CARGO_PKG_VERSION")),
            source: options.source.clone()?,
            options: format!("{plain:?}"),
            boot: fs::read_to_string("/proc/sys/kernel/random/boot_id").unwrap_or_default(),
        })
    }
}

impl State {
    /// The state after the scan of a source that read the files `beside` too; `None` if it cannot be told from others.
    pub fn scanned(options: &BuildOptions, beside: &[PathBuf], scanned: ScannedState) -> Option<State> {
        Some(State { key: Key::of(options)?, beside: stamps(beside), reached: Reached::Scanned(scanned), sum: 0 })
    }

    /// The state after the join, likewise.
    pub fn joined(options: &BuildOptions, beside: &[PathBuf], joined: JoinedState) -> Option<State> {
        let reached = Reached::Joined { joined, parts: false, chunks: None };
        Some(State { key: Key::of(options)?, beside: stamps(beside), reached, sum: 0 })
    }

    /// The files that the source read beside its own.
    pub fn beside(&self) -> Vec<PathBuf> {
        self.beside.iter().map(|(path, _)| path.clone()).collect()
    }

    /// Whether records stand for parts of triangles.
    pub fn has_parts(&self) -> bool {
        matches!(self.reached, Reached::Joined { parts: true, .. })
    }

    /// Notes that records, so many words of them with that checksum, stand for parts of triangles from now on.
    pub fn add_parts(&mut self, words: u64, sum: u64) {
        if let Reached::Joined { joined, parts, .. } = &mut self.reached {
            (*parts, joined.record_words, joined.record_sum) = (true, words, sum);
        }
    }

    /// The checksum of what was noted or read: what is noted apart names it.
    pub fn sum(&self) -> u64 {
        self.sum
    }

    /// Adds the chunks that the triangles are sorted into.
    pub fn add_chunks(&mut self, sorted: &[Chunk]) {
        if let Reached::Joined { chunks, .. } = &mut self.reached {
            *chunks = Some(sorted.iter().map(ChunkState::of).collect());
        }
    }

    /// What an earlier build of the same source with the same options left, if it takes no more than `most` bytes.
    pub fn load(work: &WorkFolder, options: &BuildOptions, most: u64) -> std::result::Result<State, Unfit> {
        let bytes = Some(work.bytes(STATE)).filter(|bytes| (1..=most).contains(bytes)).ok_or(Unfit::Other)?;
        let file = work.read(STATE, bytes).ok_or(Unfit::Other)?;
        let text = file.get(..file.len().saturating_sub(SUM_BYTES)).unwrap_or_default();
        let sum = checksum(text);
        if file.get(text.len()..) != Some(format!("\n{sum:016x}\n").as_bytes()) {
            return Err(Unfit::checksum(work, STATE));
        }
        // Of another version, whose text is another.
        let state: State = serde_json::from_slice(text).map_err(|_| Unfit::Other)?;
        let same = |(path, stamp): &(PathBuf, Option<String>)| mesh::stamp(path) == *stamp;
        let fits = Some(&state.key) == Key::of(options).as_ref() && state.beside.iter().all(same);
        if fits { Ok(State { sum, ..state }) } else { Err(Unfit::Other) }
    }

    /// Notes the state, and behind its text the checksum of that, as a line of 16 digits.
    pub fn save(&mut self, work: &WorkFolder) -> Result<()> {
        let mut file = work.create("state.new")?;
        let path = work.path().join(STATE);
        let mut text = serde_json::to_vec(self).map_err(|e| Error::Option(format!("cannot note the state: {e}")))?;
        self.sum = checksum(&text);
        text.extend(format!("\n{:016x}\n", self.sum).into_bytes());
        file.write_all(&text).map_err(Error::io(&path, "write"))?;
        fs::rename(work.path().join("state.new"), &path).map_err(Error::io(&path, "write"))
    }
}

/// The file that holds the state.
const STATE: &str = "state";
/// Bytes behind the text of a state: its checksum.
const SUM_BYTES: usize = 18;

fn stamps(files: &[PathBuf]) -> Vec<(PathBuf, Option<String>)> {
    files.iter().map(|path| (path.clone(), mesh::stamp(path))).collect()
}

/// Whether a state can hold these materials and the names of files `beside`: few enough, since it would be large itself, and
/// of paths that are text.
pub(super) fn can_note(materials: &[MaterialInfo], beside: &[PathBuf], tuning: &Tuning) -> bool {
    let textures = materials.iter().filter_map(|material| material.map_kd.as_ref());
    materials.len() + beside.len() <= tuning.noted_materials
        && textures.chain(beside).all(|path| path.to_str().is_some())
}

pub(super) fn bits(bounds: Aabb) -> [u32; 6] {
    let ([a, b, c], [d, e, f]) = (bounds.min.to_array(), bounds.max.to_array());
    [a, b, c, d, e, f].map(f32::to_bits)
}

pub(super) fn bounds(bits: [u32; 6]) -> Aabb {
    let [a, b, c, d, e, f] = bits.map(f32::from_bits);
    Aabb { min: [a, b, c].into(), max: [d, e, f].into() }
}

impl JoinedState {
    pub fn new(
        tally: &Tally,
        layout: Layout,
        [points, vertices, triangles, record_words, record_sum]: [u64; 5],
        materials: &[MaterialInfo],
    ) -> JoinedState {
        let d = tally.dropped;
        let p = tally.polygons;
        JoinedState {
            layout: [layout.materials, layout.normals, layout.texcoords],
            points,
            vertices,
            triangles,
            record_words,
            record_sum,
            kept: tally.kept,
            dropped: [d.degenerate, d.non_finite, d.bad_index, d.too_few_corners],
            polygons: [p.cut, p.clipped, p.fanned],
            merged: tally.merged,
            shift: tally.shift.to_bits(),
            longest: tally.longest.to_bits(),
            bounds: bits(tally.bounds),
            all_bounds: bits(tally.all_bounds),
            materials: states_of(materials),
        }
    }

    pub fn layout(&self) -> Layout {
        let [materials, normals, texcoords] = self.layout;
        Layout { materials, normals, texcoords, parts: false }
    }

    pub fn tally(&self) -> Tally {
        let [degenerate, non_finite, bad_index, too_few_corners] = self.dropped;
        let [cut, clipped, fanned] = self.polygons;
        Tally {
            kept: self.kept,
            dropped: Dropped { degenerate, non_finite, bad_index, too_few_corners },
            polygons: Polygons { cut, clipped, fanned },
            merged: self.merged,
            shift: f64::from_bits(self.shift),
            longest: f32::from_bits(self.longest),
            bounds: bounds(self.bounds),
            all_bounds: bounds(self.all_bounds),
        }
    }

    pub fn materials(&self) -> Vec<MaterialInfo> {
        materials_of(&self.materials)
    }
}

/// Materials as the state holds them.
pub(super) fn states_of(materials: &[MaterialInfo]) -> Vec<MaterialState> {
    let colour = |c: Option<[f32; 3]>| c.map(|c| c.map(f32::to_bits));
    let number = |n: Option<f32>| n.map(f32::to_bits);
    let state = |m: &MaterialInfo| -> MaterialState {
        let colours = [colour(m.ka), colour(m.kd), colour(m.ks)];
        (m.name.clone(), colours, [number(m.ns), number(m.ni), number(m.d)], m.illum, m.map_kd.clone())
    };
    materials.iter().map(state).collect()
}

/// The inverse of [`states_of`].
pub(super) fn materials_of(states: &[MaterialState]) -> Vec<MaterialInfo> {
    let colour = |c: Option<[u32; 3]>| c.map(|c| c.map(f32::from_bits));
    let number = |n: Option<u32>| n.map(f32::from_bits);
    let material = |(name, [ka, kd, ks], [ns, ni, d], illum, map_kd): &MaterialState| MaterialInfo {
        name: name.clone(),
        ka: colour(*ka),
        kd: colour(*kd),
        ks: colour(*ks),
        ns: number(*ns),
        ni: number(*ni),
        d: number(*d),
        illum: *illum,
        map_kd: map_kd.clone(),
    };
    states.iter().map(material).collect()
}

impl ChunkState {
    pub fn of(chunk: &Chunk) -> ChunkState {
        ChunkState {
            units: chunk.units.iter().map(|unit| (unit.cell.level, unit.cell.code, unit.triangles)).collect(),
            extents: chunk.extents.iter().map(|extent| (extent.at, extent.words)).collect(),
            sum: chunk.sum,
        }
    }

    pub fn chunk(&self) -> Chunk {
        let unit = |&(level, code, triangles): &(u32, u64, u64)| Unit { cell: CellCode { level, code }, triangles };
        Chunk {
            units: self.units.iter().map(unit).collect(),
            extents: self.extents.iter().map(|&(at, words)| Extent { at, words }).collect(),
            sum: self.sum,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn states_are_found_by_source_and_options() {
        let folder = tempfile::tempdir().unwrap();
        let work = WorkFolder::new(folder.path(), "a.oct".as_ref(), true).unwrap();
        let mut tally = Tally::new();
        (tally.kept, tally.dropped.bad_index, tally.merged) = (5, 6, 7);
        let layout = Layout { materials: true, normals: false, texcoords: true, parts: false };
        let material = MaterialInfo {
            name: "red".into(),
            kd: Some([0.1, f32::NAN, -0.0]),
            illum: Some(2),
            map_kd: Some("a/b.png".into()),
            ..Default::default()
        };
        let joined = JoinedState::new(&tally, layout, [1, 2, 3, 4, 5], &[MaterialInfo::default(), material.clone()]);
        let options = BuildOptions { source: Some("mesh".into()), ..Default::default() };
        assert!(State::joined(&BuildOptions::default(), &[], joined.clone()).is_none());
        let library = folder.path().join("a.mtl");
        let beside = [library.clone(), folder.path().join("missing.mtl")];
        fs::write(&library, "newmtl red").unwrap();
        let mut state = State::joined(&options, &beside, joined).unwrap();
        let unit = Unit { cell: CellCode { level: 3, code: 77 }, triangles: 9 };
        let chunk = Chunk { units: vec![unit], extents: vec![Extent { at: 1, words: 2 }], sum: 3 };
        state.add_chunks(&[chunk]);
        state.save(&work).unwrap();
        let again = State::load(&work, &BuildOptions { memory: 1 << 40, ..options.clone() }, 1 << 20).unwrap();
        assert_eq!(again, state);
        let Reached::Joined { joined, chunks: Some(chunks), .. } = again.reached else { panic!("joined and sorted") };
        assert_eq!(chunks[0].chunk().units, [unit]);
        let back = joined.materials().remove(1);
        assert_eq!(back.kd.map(|c| c.map(f32::to_bits)), material.kd.map(|c| c.map(f32::to_bits)));
        assert_eq!((back.name, back.map_kd, joined.tally().bounds.is_empty()), ("red".into(), material.map_kd, true));
        assert!(State::load(&work, &BuildOptions { ids: false, ..options.clone() }, 1 << 20).is_err());
        assert!(
            State::load(&work, &BuildOptions { source: Some("other".into()), ..options.clone() }, 1 << 20).is_err()
        );
        let load = |most| State::load(&work, &options, most);
        assert!(load(100).is_err() && load(1 << 20).is_ok());
        // A library that was missing, and one that is another now.
        fs::write(&beside[1], "newmtl blue").unwrap();
        assert!(load(1 << 20).is_err());
        fs::remove_file(&beside[1]).unwrap();
        assert!(load(1 << 20).is_ok());
        fs::write(&library, "newmtl red\nKd 1 0 0").unwrap();
        assert!(load(1 << 20).is_err());
    }
}
