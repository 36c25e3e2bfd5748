//! Builds that are to go on with what a killed one left, when that is not what it was.
//!
//! An input is a recipe: which build, killed at which moment, and what happened to its files since (12 bytes a change). So an input
//! means something on every machine, though what builds leave names the boot that it is of.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};

use octrace::build::build_spilling;
use octrace::map::Octree;
use octrace::{Event, Monitor};
use serde_json::Value;

use super::leftovers::{self, Build, Files, OUTPUT, PART, builds, part_file, repair, work_folder};
use super::random::Random;
use super::targets::{Outcome, told};

/// Bytes that say which build it was, when it was killed, and what is done at the end ([`REPAIRED`], [`OLDER`]).
const HEAD: usize = 3;
/// Bytes of a change: what, of which file, where (4), which value, how much (4), one to spare.
const CHANGE: usize = 12;
/// All checksums are made right again.
const REPAIRED: u8 = 1;
/// There is an older output.
const OLDER: u8 = 2;

/// What lies in the place of a file.
enum Odd {
    Folder,
    Link,
    #[cfg(unix)]
    Pipe,
}

/// A recipe, followed.
struct Dish {
    build: &'static Build,
    files: Files,
    odd: BTreeMap<String, Odd>,
    repaired: bool,
    older: bool,
}

/// A recipe of one to four changes; three in four have their checksums made right.
pub fn recipe(random: &mut Random) -> Vec<u8> {
    let flags = if random.once_in(4) { 0 } else { REPAIRED } | if random.once_in(2) { OLDER } else { 0 };
    // The two largest meshes take as long as many others.
    let build = match random.below(64) {
        0 => 7,
        1..=4 => 5,
        n => [0, 1, 2, 3, 4, 6][n % 6],
    };
    let mut bytes = vec![build, random.bits() as u8, flags];
    for _ in 0..1 + random.below(2) * random.below(4) {
        bytes.extend((0..CHANGE).map(|_| random.bits() as u8));
    }
    bytes
}

/// The recipes that change nothing: one for each moment of each build.
pub fn unchanged() -> Vec<Vec<u8>> {
    let moments =
        |(i, build): (usize, &Build)| (0..build.moments.len()).map(move |moment| vec![i as u8, moment as u8, 0]);
    builds().iter().enumerate().flat_map(moments).collect()
}

/// Whether a build of a recipe finds checksums that are right.
pub fn passes(bytes: &[u8]) -> bool {
    let dish = follow(bytes);
    dish.odd.is_empty() && leftovers::passes(&dish.files)
}

fn follow(bytes: &[u8]) -> Dish {
    let head = |i: usize| bytes.get(i).copied().unwrap_or(0);
    let build = &builds()[usize::from(head(0)) % builds().len()];
    let files = build.moments[usize::from(head(1)) % build.moments.len()].clone();
    let [repaired, older] = [REPAIRED, OLDER].map(|flag| head(2) & flag != 0);
    let mut dish = Dish { build, files, odd: BTreeMap::new(), repaired, older };
    for change in bytes.get(HEAD..).unwrap_or_default().chunks_exact(CHANGE) {
        dish.change(change.try_into().unwrap());
    }
    if repaired {
        repair(&mut dish.files);
    }
    dish
}

/// A number that hurts.
fn value(kind: u8, old: u64, length: u64, extra: u32) -> u64 {
    const ODD: [f32; 6] = [f32::NAN, f32::INFINITY, -1.0, 1e-45, 3.4e38, 0.5];
    match kind % 32 {
        kind @ 0..=3 => kind.into(),
        4 | 5 => old.wrapping_add(1),
        6 | 7 => old.wrapping_sub(1),
        8 => old.wrapping_mul(2),
        9 => old / 2,
        10 => u32::MAX.into(),
        11 => u64::from(u32::MAX) - 1,
        12 => 1 << 31,
        13 => 1 << 32,
        14 => u64::MAX,
        15 => 1 << 63,
        16 => u64::MAX / 4 + 1,
        17 => 1 << 53,
        18 => length,
        19 => length / 4,
        20 => length / 4 + 1,
        21 => 21 + u64::from(extra % 2),
        22..=25 => u64::from(ODD[extra as usize % ODD.len()].to_bits()),
        26..=28 => old ^ 1 << (extra % 64),
        29 => u64::from(extra % 64),
        _ => extra.into(),
    }
}

impl Dish {
    /// Follows a change.
    fn change(&mut self, change: [u8; CHANGE]) {
        let [what, which, a, b, c, d, kind, e, f, g, h, _] = change;
        let (place, extra) = (u32::from_le_bytes([a, b, c, d]), u32::from_le_bytes([e, f, g, h]));
        let names: Vec<String> = self.files.keys().cloned().collect();
        let Some(name) = names.get(usize::from(which) % names.len().max(1)) else { return };
        let other = &names[extra as usize % names.len()];
        let file = self.files.get_mut(name).unwrap();
        let (length, at) = (file.len(), place as usize % file.len().max(1));
        match what % 32 {
            // The state is the file that says most, so it lies most.
            0..=5 => self.number(place, kind, extra),
            6..=8 => self.list(place, kind, extra),
            9 | 10 => {
                if let Some(byte) = file.get_mut(at) {
                    *byte ^= 1 << (kind % 8);
                }
            }
            11 => {
                if let Some(byte) = file.get_mut(at) {
                    *byte = kind;
                }
            }
            12..=15 => {
                if let Some(field) = file.get_mut(at & !3..).and_then(|rest| rest.first_chunk_mut::<4>()) {
                    let old = u32::from_le_bytes(*field).into();
                    *field = (value(kind, old, length as u64, extra) as u32).to_le_bytes();
                }
            }
            16..=18 => {
                if let Some(field) = file.get_mut(at & !7..).and_then(|rest| rest.first_chunk_mut::<8>()) {
                    let old = u64::from_le_bytes(*field);
                    *field = value(kind, old, length as u64, extra).to_le_bytes();
                }
            }
            19 => file.truncate(at),
            20 => file.clear(),
            21 => drop(self.files.remove(name)),
            22 => file.extend(vec![kind; extra as usize % 5000]),
            23 => {
                // One record over another of its kind.
                let size = [4, 32, 40, 64, 152][usize::from(kind) % 5];
                let (from, to) = (at / size * size, extra as usize % length.max(1) / size * size);
                if from.max(to) + size <= length {
                    file.copy_within(from..from + size, to);
                }
            }
            24 => {
                let end = length.min(at + extra as usize % 300);
                file[at.min(length)..end].fill(0);
            }
            25 => {
                let copy = file.clone();
                self.files.insert(other.clone(), copy);
            }
            26 => {
                let (one, two) = (self.files[name].clone(), self.files[other].clone());
                self.files.insert(name.clone(), two);
                self.files.insert(other.clone(), one);
            }
            // Of the same build at another moment, or of another one: one file, or all but one.
            27 | 28 => {
                let moments = &self.build.moments;
                self.strange(name, &moments[place as usize % moments.len()], kind);
            }
            29 => {
                let build = &builds()[place as usize % builds().len()];
                self.strange(name, &build.moments[extra as usize % build.moments.len()], kind);
            }
            30 => {
                let stray = ["state.new", "chunks1", "positions-answers", "records", "stray"];
                self.files.insert(stray[usize::from(kind) % stray.len()].into(), vec![7; extra as usize % 100]);
            }
            _ => {
                let odd = match kind % 3 {
                    0 => Odd::Folder,
                    #[cfg(unix)]
                    1 => Odd::Pipe,
                    _ => Odd::Link,
                };
                self.files.remove(name);
                self.odd.insert(name.clone(), odd);
            }
        }
    }

    /// Puts what lies at `from` in the place of a file, or of all others.
    fn strange(&mut self, name: &str, from: &Files, kind: u8) {
        let others = |key: &str| (key == name) == kind.is_multiple_of(2);
        self.files.retain(|key, _| !others(key));
        self.files.extend(from.iter().filter(|(key, _)| others(key)).map(|(key, file)| (key.clone(), file.clone())));
    }

    /// Gives a number of the state another value.
    fn number(&mut self, place: u32, kind: u8, extra: u32) {
        let Some((_, mut state)) = leftovers::state(&self.files) else { return };
        let count = each(&mut state, &mut |value| value.is_number().then_some(0)).len();
        let (mut left, goal) = (0, place as usize % count.max(1));
        each::<()>(&mut state, &mut |number| {
            let old = number.as_u64()?;
            if left == goal {
                *number = value(kind, old, 1 << 20, extra).into();
            }
            left += 1;
            None
        });
        self.put(&state);
    }

    /// Takes an element out of a list of the state, doubles it, or changes places with another; or empties the list.
    fn list(&mut self, place: u32, kind: u8, extra: u32) {
        let Some((_, mut state)) = leftovers::state(&self.files) else { return };
        let count = each(&mut state, &mut |value| value.as_array().map(Vec::len)).len();
        let (mut left, goal) = (0, place as usize % count.max(1));
        each::<()>(&mut state, &mut |value| {
            let list = value.as_array_mut()?;
            if left == goal && !list.is_empty() {
                let (at, to) = (extra as usize % list.len(), (extra >> 16) as usize % list.len());
                match kind % 5 {
                    0 => drop(list.remove(at)),
                    1 => list.insert(to, list[at].clone()),
                    2 | 3 => list.swap(at, to),
                    _ => list.clear(),
                }
            }
            left += 1;
            None
        });
        self.put(&state);
    }

    fn put(&mut self, state: &Value) {
        let text = serde_json::to_vec(state).unwrap();
        match self.repaired {
            true => leftovers::put_state(&mut self.files, &text),
            // The checksum stays as it was.
            false => {
                let file = self.files.get_mut("state").unwrap();
                let end = file.iter().position(|&byte| byte == b'\n').unwrap_or(file.len());
                file.splice(..end, text);
            }
        }
    }

    /// Lays everything out in a folder.
    fn serve(&self, folder: &Path) {
        let work = work_folder(folder);
        std::fs::create_dir_all(&work).unwrap();
        let path = |name: &str| if name == PART { part_file(folder) } else { work.join(name) };
        self.files.iter().for_each(|(name, bytes)| std::fs::write(path(name), bytes).unwrap());
        for (name, odd) in &self.odd {
            let path = path(name);
            let _ = std::fs::remove_file(&path);
            match odd {
                Odd::Folder => std::fs::create_dir(path).unwrap(),
                #[cfg(unix)]
                Odd::Link => std::os::unix::fs::symlink(folder.join(VICTIM), path).unwrap(),
                #[cfg(not(unix))]
                Odd::Link => {}
                #[cfg(unix)]
                Odd::Pipe => nix::unistd::mkfifo(&path, nix::sys::stat::Mode::S_IRWXU).unwrap(),
            }
        }
    }
}

/// Calls `visit` with a value and all within it; what it gives, but for `None`.
fn each<T>(value: &mut Value, visit: &mut dyn FnMut(&mut Value) -> Option<T>) -> Vec<T> {
    let mut found: Vec<T> = visit(value).into_iter().collect();
    match value {
        Value::Array(list) => list.iter_mut().for_each(|value| found.extend(each(value, visit))),
        Value::Object(map) => map.values_mut().for_each(|value| found.extend(each(value, visit))),
        _ => {}
    }
    found
}

/// A file of somebody else's, that links lead to.
const VICTIM: &str = "victim";
const KEPT: &[u8] = b"what was here before";

/// Builds on with what the recipe makes of a killed build's files. The result must be the file that an undisturbed build makes, or an
/// error that leaves an older file alone. Only where all checksums were made right may it be another file: a sound one, or, where pages
/// are of the lie too, at least one of which a reader is told that it is damaged.
pub fn run(bytes: &[u8], folder: &Path) -> Outcome {
    let (dish, folder) = (follow(bytes), folder.join("resumed"));
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir(&folder).unwrap();
    std::fs::write(folder.join(VICTIM), KEPT).unwrap();
    let output = folder.join(OUTPUT);
    if dish.older {
        std::fs::write(&output, KEPT).unwrap();
    }
    dish.serve(&folder);
    let (stop, scanned, warnings) = (AtomicBool::new(false), AtomicBool::new(false), Mutex::new(Vec::new()));
    let sink = |event: Event| match event {
        Event::Phase { name: "scan", .. } => scanned.store(true, Ordering::Relaxed),
        Event::Warning(text) => warnings.lock().unwrap().push(text),
        _ => {}
    };
    let Build { mesh, options, whole, .. } = dish.build;
    let built = build_spilling(&mut mesh.clone(), &output, options, Monitor::new(&sink, &stop));
    assert_eq!(std::fs::read(folder.join(VICTIM)).unwrap(), KEPT, "a file of somebody else's is changed");
    let report = match built {
        Ok(report) => report,
        Err(error) => {
            let left = std::fs::read(&output).ok();
            assert_eq!(left.as_deref(), dish.older.then_some(KEPT), "{error}: but the output is another");
            return told(&error);
        }
    };
    let names = std::fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap());
    let strays: Vec<String> = names.filter(|name| ![OUTPUT, VICTIM].contains(&&**name)).collect();
    // What is no file is not for a build to remove, where it is not in its own folder.
    assert!(strays.is_empty() || dish.odd.contains_key(PART), "left behind: {strays:?}");
    if std::fs::read(&output).unwrap() != *whole {
        assert!(dish.repaired, "another file, though checksums could tell");
        assert!(!scanned.load(Ordering::Relaxed), "another file, though the build began anew");
        match Octree::open(&output).and_then(|octree| octree.verify(Monitor::silent()).map(|()| octree)) {
            Ok(octree) => {
                assert_eq!((octree.header().triangles, octree.header().file_bytes), (report.triangles, report.bytes))
            }
            Err(error) => assert!(dish.files.contains_key("progress"), "a file that is not sound: {error}"),
        }
    }
    // What nobody touched is gone on with, but for what the last phase leaves, which has no triangles any more.
    let has_triangles = ["faces", "records", "parts", "chunks0"].iter().any(|&name| dish.files.contains_key(name));
    if bytes.len() < HEAD + CHANGE && dish.files.contains_key("state") && has_triangles {
        let warnings = warnings.into_inner().unwrap();
        let anew = scanned.load(Ordering::Relaxed) || warnings.iter().any(|text| text.contains("anew"));
        assert!(!anew, "{warnings:?}");
    }
    // Refused is what was not gone on with.
    if scanned.into_inner() { Outcome::Refused } else { Outcome::Taken }
}
