//! What killed builds leave: work folders and partial files of small meshes at all moments at which they change, with their checksums
//! made right again where they are changed on purpose.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::sync::{Mutex, OnceLock};

use octrace::build::{BuildOptions, Positions, build_spilling};
use octrace::format::SplitMode;
use octrace::mesh::{FaceBatch, MaterialInfo, MeshSink, NO_INDEX, SourceInfo, TriangleSource};
use octrace::{Event, Monitor, Result};
use serde_json::Value;
use xxhash_rust::xxh3::{xxh3_64, xxh3_64_with_seed};

/// Files of a work folder by name, and the partial file of the output as [`PART`].
pub type Files = BTreeMap<String, Vec<u8>>;
/// Stands for the partial file of the output.
pub const PART: &str = "the part";
/// Name of the output in its folder.
pub const OUTPUT: &str = "a.oct";

/// A mesh in memory.
#[derive(Clone, Default)]
pub struct Mesh {
    positions: Vec<[f32; 3]>,
    texcoords: Vec<[f32; 2]>,
    normals: Vec<[f32; 3]>,
    batches: Vec<FaceBatch>,
    materials: Vec<MaterialInfo>,
}

impl TriangleSource for Mesh {
    fn read(&mut self, sink: &mut dyn MeshSink, _: Monitor<'_>) -> Result<SourceInfo> {
        sink.positions(&self.positions)?;
        sink.texcoords(&self.texcoords)?;
        sink.normals(&self.normals)?;
        self.batches.iter().try_for_each(|batch| sink.faces(batch))?;
        Ok(SourceInfo { materials: self.materials.clone(), too_few_corners: 1, ..Default::default() })
    }

    fn size_hint(&self) -> Option<u64> {
        Some(1000)
    }
}

/// A bumpy sheet of 2 n^2 triangles, a batch a row.
fn sheet(n: u32) -> Mesh {
    let height = |x: u32, y: u32| ((x * x + 7 * y) % 11) as f32 * 0.05;
    let positions = (0..=n).flat_map(|y| (0..=n).map(move |x| [x as f32, y as f32, height(x, y)])).collect();
    let square = |x: u32, y: u32| {
        let at = y * (n + 1) + x;
        [at, at + 1, at + n + 2, at, at + n + 2, at + n + 1]
    };
    let row = |y: u32| FaceBatch { corners: (0..n).flat_map(|x| square(x, y)).collect(), ..Default::default() };
    Mesh { positions, batches: (0..n).map(row).collect(), ..Default::default() }
}

/// A sheet with normals, texture coordinates, materials, gaps, and faces that are dropped.
fn dressed(n: u32) -> Mesh {
    let mut mesh = sheet(n);
    mesh.normals = (0..50).map(|i| [0.1 * (i % 7) as f32, 0.0, 1.0]).collect();
    mesh.texcoords = (0..90).map(|i| [0.01 * i as f32, 0.5]).collect();
    let material = |name: &str| MaterialInfo {
        name: name.into(),
        kd: Some([0.5, 0.25, 1.0]),
        ns: Some(30.0),
        ..Default::default()
    };
    mesh.materials = vec![material("stone"), material("wood")];
    for (row, batch) in mesh.batches.iter_mut().enumerate() {
        let corners = batch.corners.len() as u32;
        batch.materials = vec![(0, row as u32 % 3)];
        batch.normals = (0..corners).map(|i| if i / 3 == 1 { NO_INDEX } else { i % 50 }).collect();
        if row % 2 == 0 {
            batch.texcoords = (0..corners).map(|i| i % 90).collect();
        }
        if row == 3 {
            // Pairs of triangles as one face of six corners, then a gap.
            batch.sizes = [vec![6; corners as usize / 6], vec![FaceBatch::GAP | 5]].concat();
        }
        if row == 5 {
            batch.corners[4] = 1_000_000;
        }
    }
    mesh
}

/// A sheet on a ground of two triangles, crossed by needles: records stand for parts of triangles.
fn town(n: u32) -> Mesh {
    let (mut mesh, size) = (sheet(n), n as f32);
    let mut add = |corners: [[f32; 3]; 3]| {
        let at = mesh.positions.len() as u32;
        mesh.positions.extend(corners);
        mesh.batches.insert(0, FaceBatch { corners: vec![at, at + 1, at + 2], ..Default::default() });
    };
    add([[-1.0, -1.0, -0.1], [size + 1.0, -1.0, -0.1], [size + 1.0, size + 1.0, -0.1]]);
    add([[-1.0, -1.0, -0.1], [size + 1.0, size + 1.0, -0.1], [-1.0, size + 1.0, -0.1]]);
    for i in 0..10 {
        let x = size * (i as f32 + 0.3) / 10.0;
        add([[x, 0.1, 0.2], [size - x, size - 0.3, 9.0], [size - x, size - 0.2, 9.1]]);
    }
    mesh
}

/// A sheet, and a face of so many corners that it is cut as it comes.
fn fan(n: u32) -> Mesh {
    let mut mesh = sheet(n);
    let first = mesh.positions.len() as u32;
    let corner = |i: u32| [f32::cos(0.0015 * i as f32), f32::sin(0.0015 * i as f32), 2.0];
    mesh.positions.extend((0..4100).map(corner));
    let face = FaceBatch { sizes: vec![4100], corners: (first..first + 4100).collect(), ..Default::default() };
    mesh.batches.insert(1, face);
    mesh
}

/// A build, what it makes, and what it leaves if it is killed.
pub struct Build {
    pub mesh: Mesh,
    pub options: BuildOptions,
    /// The file that it makes.
    pub whole: Vec<u8>,
    /// What it leaves, by moments.
    pub moments: Vec<Files>,
}

/// All builds; made when they are first asked for, the same in every process but for marks, which are random.
pub fn builds() -> &'static [Build] {
    static BUILDS: OnceLock<Vec<Build>> = OnceLock::new();
    BUILDS.get_or_init(|| {
        let base = BuildOptions { brick: Some(40), resume: true, ..BuildOptions::default() };
        let all = [
            (sheet(15), base.clone()),
            (dressed(14), base.clone()),
            (town(15), base.clone()),
            (sheet(10), BuildOptions { split: SplitMode::Strict, cell: 4, brick: Some(30), ..base.clone() }),
            (dressed(11), BuildOptions { compress: Some(1), lod: false, ids: false, ..base.clone() }),
            // Enough triangles for a window on the vertices.
            (sheet(26), BuildOptions { positions: Positions::Grid(None), brick: Some(300), ..base.clone() }),
            // Cells at the depth limit that are too full.
            (sheet(13), BuildOptions { depth: 2, brick: Some(9), ..base.clone() }),
            (fan(8), BuildOptions { brick: Some(900), ..base }),
        ];
        // One thread, so that the moments are the same each time.
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        pool.install(|| all.into_iter().enumerate().map(|(i, (mesh, options))| watched(i, mesh, options)).collect())
    })
}

/// Builds and keeps what there is of it at each moment at which files come, go, or are noted anew.
fn watched(number: usize, mesh: Mesh, options: BuildOptions) -> Build {
    let options = BuildOptions { source: Some(format!("mesh {number}")), ..options };
    let folder = tempfile::tempdir().unwrap();
    let seen = Mutex::new((BTreeSet::new(), Vec::new()));
    let (work, stop) = (work_folder(folder.path()), AtomicBool::new(false));
    let sink = |_: Event| {
        let files = read(folder.path(), &work);
        let noted = |name: &str| files.get(name).cloned().unwrap_or_default();
        let key = (files.keys().cloned().collect::<Vec<_>>(), noted("state"), noted("progress"));
        let (keys, moments) = &mut *seen.lock().unwrap();
        if keys.insert(key) {
            moments.push(files);
        }
    };
    let output = folder.path().join(OUTPUT);
    build_spilling(&mut mesh.clone(), &output, &options, Monitor::new(&sink, &stop)).unwrap();
    let (_, mut moments) = seen.into_inner().unwrap();
    // Where pages are written, a few moments will do.
    let (some, all) = (moments.len().div_ceil(24), moments.len());
    let mut place = 0..all;
    moments.retain(|files| place.next().is_some_and(|i| i % some == 0 || !files.contains_key("progress")));
    assert!(moments.iter().filter(|files| files.contains_key("state")).count() > 3, "build {number} leaves too little");
    Build { mesh, options, whole: std::fs::read(output).unwrap(), moments }
}

/// Where the build that writes [`OUTPUT`] in a folder keeps its temporary files.
pub fn work_folder(folder: &Path) -> PathBuf {
    let output = folder.canonicalize().unwrap().join(OUTPUT);
    let hash = xxh3_64(output.as_os_str().as_encoded_bytes()) as u32;
    folder.join(format!(".{OUTPUT}-{hash:08x}.octbuild"))
}

/// Where it keeps the partial file.
pub fn part_file(folder: &Path) -> PathBuf {
    folder.join(format!(".{OUTPUT}.part"))
}

fn read(folder: &Path, work: &Path) -> Files {
    let entries = std::fs::read_dir(work).into_iter().flatten().map(|entry| entry.unwrap());
    let file =
        |entry: std::fs::DirEntry| Some((entry.file_name().into_string().unwrap(), std::fs::read(entry.path()).ok()?));
    let part = std::fs::read(part_file(folder)).map(|bytes| (PART.to_owned(), bytes));
    entries.filter_map(file).chain(part).collect()
}

/// The text of a state and the value that it holds, if it can be read.
pub fn state(files: &Files) -> Option<(&[u8], Value)> {
    let text = files.get("state")?.split(|&byte| byte == b'\n').next()?;
    Some((text, serde_json::from_slice(text).ok()?))
}

/// Makes `text` the state, with its checksum.
pub fn put_state(files: &mut Files, text: &[u8]) {
    let sum = format!("\n{:016x}\n", xxh3_64(text));
    files.insert("state".into(), [text, sum.as_bytes()].concat());
}

/// Bytes of what is noted of a page, and of how far pages are.
const ENTRY: usize = 152;
const PROGRESS: usize = 48;

fn u64_at(bytes: &[u8], at: usize) -> u64 {
    bytes.get(at..).and_then(|b| b.first_chunk()).map_or(0, |b| u64::from_le_bytes(*b))
}

fn put(bytes: &mut [u8], at: usize, value: u64) {
    if let Some(place) = bytes.get_mut(at..).and_then(|b| b.first_chunk_mut()) {
        *place = value.to_le_bytes();
    }
}

/// Makes all checksums right, and everything name what it is of, as far as it can be read.
pub fn repair(files: &mut Files) {
    if let Some((text, mut value)) = state(files) {
        let (text, before) = (text.to_vec(), value.clone());
        repair_reached(&mut value["reached"], files);
        let text = if value == before { text } else { serde_json::to_vec(&value).unwrap() };
        put_state(files, &text);
    } else if let Some(text) = files.get("state") {
        let text = text.split(|&byte| byte == b'\n').next().unwrap_or_default().to_vec();
        put_state(files, &text);
    }
    let state_sum = files.get("state").map(|state| xxh3_64(state.split(|&b| b == b'\n').next().unwrap_or_default()));
    let part = files.get(PART).cloned().unwrap_or_default();
    if let Some(pages) = files.get_mut("pages") {
        for entry in pages.chunks_exact_mut(ENTRY) {
            let (offset, stored) = (u64_at(entry, 56) as usize, u64_at(entry, 72) as u32 as usize);
            if let Some(page) = offset.checked_add(stored).and_then(|end| part.get(offset..end)) {
                put(entry, 64, xxh3_64(page));
            }
        }
    }
    let pages = files.get("pages").cloned().unwrap_or_default();
    if let Some(progress) = files.get_mut("progress").filter(|progress| progress.len() >= PROGRESS) {
        let mark = u64_at(progress, 16);
        put(progress, 24, state_sum.unwrap_or(0));
        let noted = (u64_at(progress, 8) as usize).saturating_mul(ENTRY);
        put(progress, 32, xxh3_64(pages.get(..noted).unwrap_or(&pages)));
        let sum = xxh3_64(&progress[..40]);
        put(progress, 40, sum);
        if let Some(part) = files.get_mut(PART) {
            put(part, 8, mark);
        }
    }
}

/// The checksums within a state.
fn repair_reached(reached: &mut Value, files: &Files) {
    let words = |name: &str, at: u64, words: u64| {
        let end = at.checked_add(words)?.checked_mul(4)?;
        files.get(name)?.get(4 * at as usize..end as usize)
    };
    if let Some(scanned) = reached.get_mut("Scanned") {
        for (i, name) in ["positions", "texcoords", "normals", "faces", "index"].into_iter().enumerate() {
            let count = scanned["words"].get(i).and_then(Value::as_u64).unwrap_or(0);
            if let (Some(words), Some(sum)) =
                (words(name, 0, count), scanned.get_mut("sums").and_then(|s| s.get_mut(i)))
            {
                *sum = xxh3_64(words).into();
            }
        }
    }
    let Some(reached) = reached.get_mut("Joined") else { return };
    let name = if reached["parts"] == Value::Bool(true) { "parts" } else { "records" };
    let count = reached["joined"]["record_words"].as_u64().unwrap_or(0);
    if let (Some(words), Some(sum)) = (words(name, 0, count), reached["joined"].get_mut("record_sum")) {
        *sum = xxh3_64(words).into();
    }
    for chunk in reached["chunks"].as_array_mut().into_iter().flatten() {
        let extents = chunk["extents"].as_array().cloned().unwrap_or_default();
        let place = |extent: &Value, i: usize| extent.get(i).and_then(Value::as_u64).unwrap_or(0);
        let all: Option<u64> = extents.iter().try_fold(0, |sum, extent| {
            Some(xxh3_64_with_seed(words("chunks0", place(extent, 0), place(extent, 1))?, sum))
        });
        if let (Some(all), Some(sum)) = (all, chunk.get_mut("sum")) {
            *sum = all.into();
        }
    }
}

/// Whether there is a state that can be read, and everything that is checked by a checksum passes.
pub fn passes(files: &Files) -> bool {
    let mut repaired = files.clone();
    repair(&mut repaired);
    state(files).is_some() && repaired == *files
}
