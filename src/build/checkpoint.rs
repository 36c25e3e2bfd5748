//! What a build notes on its way, so that it can go on after it was killed.
//!
//! The work folder holds a `state` file, written anew (and renamed) when a phase ends: what the source and the options
//! are, and all that the next phases need beside the spools ([`super::scanned`] for the scan). While pages are written, a `pages` file grows by an entry
//! a page, and `progress` says how many chunks, and so how many entries, are whole. Nothing is synced: after a kill the system still has
//! what was written. After a restart of the machine that does not hold, so the state names the boot it belongs to.

use std::fs::{self, File};
use std::io::Write;

use bytemuck::{Pod, Zeroable};
use serde::{Deserialize, Serialize};
use xxhash_rust::xxh3::xxh3_64;

use super::distribute::{Chunk, Extent};
use super::grid::{CellCode, Unit};
use super::join::Tally;
use super::options::BuildOptions;
use super::record::Layout;
use super::report::Polygons;
use super::scanned::ScannedState;
use super::work::WorkFolder;
use crate::error::{Error, Result};
use crate::format::{Brick, Dropped, PageRecord, VERSION};
use crate::geometry::Aabb;
use crate::mesh::MaterialInfo;

/// What was made so far.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct State {
    key: Key,
    pub reached: Reached,
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
    kept: u64,
    dropped: [u64; 4],
    polygons: [u64; 3],
    merged: u64,
    shift: u64,
    longest: u32,
    bounds: [u32; 6],
    all_bounds: [u32; 6],
    materials: Vec<MaterialState>,
}

/// Name, Ka, Kd, Ks, Ns, Ni, d, illum, map_Kd.
pub(super) type MaterialState =
    (String, [Option<[u32; 3]>; 3], [Option<u32>; 3], Option<u32>, Option<std::path::PathBuf>);

/// Units (level, code, triangles) and extents (place, words) of a chunk.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct ChunkState {
    units: Vec<(u32, u64, u64)>,
    extents: Vec<(u64, u64)>,
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
    /// The state after the scan; `None` if the source cannot be told from others.
    pub fn scanned(options: &BuildOptions, scanned: ScannedState) -> Option<State> {
        Some(State { key: Key::of(options)?, reached: Reached::Scanned(scanned) })
    }

    /// The state after the join, likewise.
    pub fn joined(options: &BuildOptions, joined: JoinedState) -> Option<State> {
        Some(State { key: Key::of(options)?, reached: Reached::Joined { joined, parts: false, chunks: None } })
    }

    /// Whether records stand for parts of triangles.
    pub fn has_parts(&self) -> bool {
        matches!(self.reached, Reached::Joined { parts: true, .. })
    }

    /// Notes that records, so many words of them, stand for parts of triangles from now on.
    pub fn add_parts(&mut self, words: u64) {
        if let Reached::Joined { joined, parts, .. } = &mut self.reached {
            (*parts, joined.record_words) = (true, words);
        }
    }

    /// Adds the chunks that the triangles are sorted into.
    pub fn add_chunks(&mut self, sorted: &[Chunk]) {
        if let Reached::Joined { chunks, .. } = &mut self.reached {
            *chunks = Some(sorted.iter().map(ChunkState::of).collect());
        }
    }

    /// What an earlier build of the same source with the same options left.
    pub fn load(work: &WorkFolder, options: &BuildOptions) -> Option<State> {
        let text = fs::read(work.path().join("state")).ok()?;
        let state: State = serde_json::from_slice(&text).ok()?;
        (Some(&state.key) == Key::of(options).as_ref()).then_some(state)
    }

    /// Notes the state.
    pub fn save(&self, work: &WorkFolder) -> Result<()> {
        let mut file = work.create("state.new")?;
        let path = work.path().join("state");
        let text = serde_json::to_vec(self).map_err(|e| Error::Option(format!("cannot note the state: {e}")))?;
        file.write_all(&text).map_err(Error::io(&path, "write"))?;
        fs::rename(work.path().join("state.new"), &path).map_err(Error::io(&path, "write"))
    }
}

/// Whether materials are few enough for a state, which would be large itself.
pub(super) fn can_note(materials: &[MaterialInfo]) -> bool {
    materials.len() <= 1 << 16
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
        [points, vertices, triangles, record_words]: [u64; 4],
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
        }
    }

    pub fn chunk(&self) -> Chunk {
        let unit = |&(level, code, triangles): &(u32, u64, u64)| Unit { cell: CellCode { level, code }, triangles };
        Chunk {
            units: self.units.iter().map(unit).collect(),
            extents: self.extents.iter().map(|&(at, words)| Extent { at, words }).collect(),
        }
    }

    /// Where the last extent ends.
    pub fn end(&self) -> u64 {
        self.extents.iter().map(|(at, words)| at + words).max().unwrap_or(0)
    }
}

/// What is noted of a page.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(super) struct PageEntry {
    pub bounds_root: [[f64; 3]; 2],
    pub nodes: u64,
    pub record: PageRecord,
    pub brick: Brick,
    pub level: u32,
    pub index: [u32; 3],
    pub leaves: u32,
    pub depth: u32,
    /// Flags for normals and texture coordinates.
    pub attributes: u32,
    pub zero: u32,
}

/// How far the pages are.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
struct Progress {
    chunks: u64,
    pages: u64,
    checksum: u64,
}

impl Progress {
    fn new(chunks: u64, pages: u64) -> Progress {
        Progress { chunks, pages, checksum: xxh3_64(bytemuck::bytes_of(&[chunks, pages])) }
    }
}

/// The entries of all pages, as they are written.
pub(super) struct PageLog {
    pages: File,
    progress: File,
    waiting: Vec<PageEntry>,
    written: u64,
    path: std::path::PathBuf,
}

impl PageLog {
    /// An empty one.
    pub fn create(work: &WorkFolder) -> Result<PageLog> {
        let (pages, progress) = (work.create("pages")?, work.create("progress")?);
        Ok(PageLog { pages, progress, waiting: Vec::new(), written: 0, path: work.path().join("pages") })
    }

    /// What an earlier build left: chunks that are whole, and their pages. `None` if that cannot be read.
    pub fn reopen(work: &WorkFolder) -> Option<(PageLog, u64, Vec<PageEntry>)> {
        let progress = fs::read(work.path().join("progress")).ok()?;
        let Progress { chunks, pages, checksum } = bytemuck::try_pod_read_unaligned(&progress).ok()?;
        let bytes = fs::read(work.path().join("pages")).ok()?;
        let whole = bytes.get(..(pages as usize).checked_mul(size_of::<PageEntry>())?)?;
        if checksum != Progress::new(chunks, pages).checksum {
            return None;
        }
        let entries = whole.chunks_exact(size_of::<PageEntry>()).map(bytemuck::pod_read_unaligned).collect();
        let (pages_file, progress) = (work.reopen("pages").ok()?, work.reopen("progress").ok()?);
        let path = work.path().join("pages");
        Some((PageLog { pages: pages_file, progress, waiting: Vec::new(), written: pages, path }, chunks, entries))
    }

    /// Takes the next page's entry.
    pub fn push(&mut self, entry: PageEntry) {
        self.waiting.push(entry);
    }

    /// Notes that the first `chunks` chunks are whole. Their pages must have been handed to the system.
    pub fn note(&mut self, chunks: u64) -> Result<()> {
        let failed = || Error::io(&self.path, "write");
        let at = self.written * size_of::<PageEntry>() as u64;
        super::spool::write_at(&self.pages, at, bytemuck::cast_slice(&self.waiting)).map_err(failed())?;
        self.written += self.waiting.len() as u64;
        self.waiting.clear();
        let progress = Progress::new(chunks, self.written);
        super::spool::write_at(&self.progress, 0, bytemuck::bytes_of(&progress)).map_err(failed())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn entry(page: u32) -> PageEntry {
        PageEntry { leaves: page, nodes: 7, ..PageEntry::zeroed() }
    }

    #[test]
    fn whole_chunks_are_found_again() {
        let folder = tempfile::tempdir().unwrap();
        let work = WorkFolder::new(folder.path(), "a.oct".as_ref(), true).unwrap();
        assert!(PageLog::reopen(&work).is_none());
        let mut log = PageLog::create(&work).unwrap();
        (0..3).for_each(|page| log.push(entry(page)));
        log.note(1).unwrap();
        (3..5).for_each(|page| log.push(entry(page)));
        log.note(2).unwrap();
        log.push(entry(5));
        drop(log);
        let (mut log, chunks, entries) = PageLog::reopen(&work).unwrap();
        assert_eq!((chunks, entries), (2, (0..5).map(entry).collect()));
        log.push(entry(9));
        log.note(3).unwrap();
        assert_eq!(PageLog::reopen(&work).unwrap().2[5], entry(9));
        fs::write(work.path().join("progress"), [1; 24]).unwrap();
        assert!(PageLog::reopen(&work).is_none());
    }

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
        let joined = JoinedState::new(&tally, layout, [1, 2, 3, 4], &[MaterialInfo::default(), material.clone()]);
        let options = BuildOptions { source: Some("mesh".into()), ..Default::default() };
        assert!(State::joined(&BuildOptions::default(), joined.clone()).is_none());
        let mut state = State::joined(&options, joined).unwrap();
        let unit = Unit { cell: CellCode { level: 3, code: 77 }, triangles: 9 };
        let chunk = Chunk { units: vec![unit], extents: vec![Extent { at: 1, words: 2 }] };
        state.add_chunks(&[chunk]);
        state.save(&work).unwrap();
        let again = State::load(&work, &BuildOptions { memory: 1 << 40, ..options.clone() }).unwrap();
        assert_eq!(again, state);
        let Reached::Joined { joined, chunks: Some(chunks), .. } = again.reached else { panic!("joined and sorted") };
        assert_eq!(chunks[0].chunk().units, [unit]);
        let back = joined.materials().remove(1);
        assert_eq!(back.kd.map(|c| c.map(f32::to_bits)), material.kd.map(|c| c.map(f32::to_bits)));
        assert_eq!((back.name, back.map_kd, joined.tally().bounds.is_empty()), ("red".into(), material.map_kd, true));
        assert!(State::load(&work, &BuildOptions { ids: false, ..options.clone() }).is_none());
        assert!(State::load(&work, &BuildOptions { source: Some("other".into()), ..options }).is_none());
    }
}
