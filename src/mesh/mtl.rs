//! Material libraries (`.mtl`), read through the crate tobj.
//!
//! The file is read line by line and given to tobj one material at a time, so that memory does not grow with it. It is made
//! fit for tobj first: Latin-1 becomes UTF-8, and lines that tobj would refuse (it gives up all of it) or panic at are taken
//! out with a warning. Only what [`MaterialInfo`] holds is kept. Of a texture's options
//! (`-s 1 1 1`) only the file name behind them is used.

use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};

use super::MaterialInfo;
use super::names::Names;
use crate::error::{Error, Result};
use crate::event::Monitor;

/// How many names or lines a warning lists.
const LISTED: usize = 8;
/// Bytes of a line; what is longer counts as several.
const LONGEST_LINE: u64 = 1 << 16;
/// Bytes of all lines of a material; what comes after that is passed over.
const LONGEST_MATERIAL: u64 = 1 << 18;

/// Reads a material library, in the file's order.
///
/// What is wrong in it is told to `monitor`; it fails only if the file cannot be read at all. Paths of textures can be
/// opened from the current folder.
pub fn load(path: &Path, monitor: Monitor<'_>) -> Result<Vec<MaterialInfo>> {
    let mut all = Vec::new();
    read(path, monitor, &mut |material| {
        all.push(material);
        Ok(())
    })?;
    Ok(all)
}

/// Reads a material library, one material at a time, until `take` fails.
fn read(path: &Path, monitor: Monitor<'_>, take: &mut dyn FnMut(MaterialInfo) -> Result<()>) -> Result<()> {
    if !std::fs::metadata(path).map_err(Error::io(path, "open"))?.is_file() {
        return Err(Error::Input {
            file: path.to_owned(),
            what: "not a material library but a folder or device".into(),
        });
    }
    let file = File::open(path).map_err(Error::io(path, "open"))?;
    let mut lines = BufReader::new(file);
    let folder = path.parent().unwrap_or(Path::new(""));
    let (mut line, mut number, mut bad, mut bad_count) = (Vec::new(), 0, Vec::new(), 0);
    // The lines of the material that is being read, as tobj is to see them.
    let (mut pending, mut inside) = (String::new(), false);
    loop {
        line.clear();
        let more = lines.by_ref().take(LONGEST_LINE).read_until(b'\n', &mut line);
        let ended = more.map_err(Error::io(path, "read"))? == 0;
        number += 1;
        let text = decode(line.strip_prefix(b"\xef\xbb\xbf").filter(|_| number == 1).unwrap_or(&line));
        let (keyword, rest) = text.trim().split_once(char::is_whitespace).unwrap_or((text.trim(), ""));
        let rest = rest.trim();
        if ended || keyword == "newmtl" {
            let materials = tobj::load_mtl_buf(&mut pending.as_bytes()).map(|(materials, _)| materials);
            let materials = materials.map_err(|error| Error::Input {
                file: path.to_owned(),
                what: format!("not a material library ({error})"),
            })?;
            materials.into_iter().try_for_each(|material| take(convert(material, folder, monitor)))?;
            pending.clear();
            // What follows a material without a name belongs to none.
            inside = !rest.is_empty();
        }
        if ended {
            break;
        }
        match clean(keyword, rest) {
            Some(Some(clean)) if inside && (pending.len() as u64) < LONGEST_MATERIAL => {
                pending.extend([keyword, " ", &clean, "\n"]);
            }
            Some(None) => {
                bad_count += 1;
                if bad.len() < LISTED {
                    bad.push(number.to_string());
                }
            }
            _ => {}
        }
    }
    if bad_count > 0 {
        let lines = list(bad.into_iter(), bad_count);
        monitor.warn(format!("{}: these lines make no sense and are ignored: {lines}", path.display()));
    }
    Ok(())
}

/// Finds the materials that a mesh (its name is for warnings) uses by name in the libraries that it names, relative to its `folder`.
///
/// A library that is missing and a material that no library defines are warnings; such a material has only its name.
/// `None` if all of them would take more than `memory` bytes.
pub(super) fn resolve(
    (mesh, folder): (&str, &Path),
    libraries: &Names,
    used: Names,
    memory: u64,
    monitor: Monitor<'_>,
) -> Option<Vec<MaterialInfo>> {
    let mut wanted = Wanted::new(used);
    let mut bytes = bytes_of(&wanted.names);
    for path in libraries.iter().flat_map(|names| library_paths(folder, names)) {
        let read = read(&path, monitor, &mut |material| {
            bytes += wanted.take(material);
            if bytes <= memory { Ok(()) } else { Err(Error::Interrupted) }
        });
        if bytes > memory {
            return None;
        }
        if let Err(error) = read {
            monitor.warn(format!("{error}; the materials that {mesh} takes from it get the default look"));
        }
    }
    let Wanted { found, names, rank, .. } = wanted;
    let missing = || (0..names.len()).filter(|&i| rank[i] == Rank::Missing);
    let count = missing().count();
    if count > 0 {
        let names = list(missing().map(|i| format!("\"{}\"", names.name(i))), count);
        monitor.warn(format!("{mesh}: no material library defines {names}: such faces get the default look; define them in a file that mtllib names"));
    }
    Some(found)
}

/// Bytes that the materials of these names take at most, while they are found and after that: the names, and a
/// [`MaterialInfo`] with its own copy of the name for each. Textures come to that.
pub(super) fn bytes_of(names: &Names) -> u64 {
    let each = (size_of::<MaterialInfo>() + size_of::<u32>() + size_of::<Rank>() + CHUNK) as u64;
    names.bytes() + names.text_bytes() + each * names.len() as u64
}

/// What an allocator adds to a small string, at most.
const CHUNK: usize = 32;

/// How a material was found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Rank {
    Missing,
    /// By what stands before a comment in its name.
    WithoutComment,
    ByName,
}

/// Materials that are looked for.
struct Wanted {
    names: Names,
    /// Those whose name may end in a comment, by what stands before that.
    commented: Vec<u32>,
    found: Vec<MaterialInfo>,
    rank: Vec<Rank>,
}

impl Wanted {
    fn new(names: Names) -> Wanted {
        let mut commented: Vec<u32> =
            (0..names.len() as u32).filter(|&i| names.name(i as usize).contains(" #")).collect();
        commented.sort_by_key(|&i| without_comment(names.name(i as usize)));
        let named = |name: &str| MaterialInfo { name: name.to_owned(), ..Default::default() };
        Wanted { found: names.iter().map(named).collect(), rank: vec![Rank::Missing; names.len()], commented, names }
    }

    /// Takes a material over if it is wanted: the first definition of a name counts. Says how many bytes it adds.
    fn take(&mut self, material: MaterialInfo) -> u64 {
        let name = |&i: &u32| without_comment(self.names.name(i as usize));
        let first = self.commented.partition_point(|i| name(i) < &material.name[..]);
        let same = self.commented[first..].iter().take_while(|i| name(i) == material.name);
        let commented = same.map(|&i| (i as usize, Rank::WithoutComment));
        let exact = self.names.get(&material.name).map(|i| (i, Rank::ByName));
        let mut added = 0;
        for (i, rank) in commented.chain(exact) {
            if self.rank[i] < rank {
                self.rank[i] = rank;
                let name = std::mem::take(&mut self.found[i].name);
                self.found[i] = MaterialInfo { name, ..material.clone() };
                added += material.map_kd.as_ref().map_or(0, |path| (path.as_os_str().len() + CHUNK) as u64);
            }
        }
        added
    }
}

/// A name up to a comment behind it.
fn without_comment(name: &str) -> &str {
    name.split(" #").next().unwrap_or(name).trim_end()
}

/// The files of all libraries, as absolute paths.
pub(super) fn library_files(folder: &Path, libraries: &Names) -> Vec<PathBuf> {
    let files = libraries.iter().flat_map(|names| library_paths(folder, names));
    files.map(|path| std::path::absolute(&path).unwrap_or(path)).collect()
}

/// The files that the rest of an `mtllib` line names: one whose name may hold blanks, or several.
fn library_paths(folder: &Path, names: &str) -> Vec<PathBuf> {
    let whole = locate(folder, names);
    let parts: Vec<&str> = names.split_whitespace().collect();
    if parts.len() < 2 || whole.exists() {
        return vec![whole];
    }
    let several: Vec<PathBuf> = parts.iter().map(|part| locate(folder, part)).collect();
    if several.iter().any(|path| path.exists()) { several } else { vec![whole] }
}

/// The path of a file named in a file in `folder`: as it is written, with backslashes as separators, or, if only that
/// is there, its last part beside the file (many files hold paths of the machine that wrote them).
fn locate(folder: &Path, name: &str) -> PathBuf {
    let name = name.strip_prefix('"').and_then(|name| name.strip_suffix('"')).unwrap_or(name);
    let slashed = name.replace('\\', "/");
    let written = folder.join(name);
    let usual = folder.join(&slashed);
    let beside = folder.join(slashed.rsplit('/').next().unwrap_or(&slashed));
    [&written, &usual, &beside].into_iter().find(|path| path.is_file()).unwrap_or(&usual).clone()
}

/// UTF-8 if it can be, else Latin-1.
fn decode(line: &[u8]) -> String {
    match std::str::from_utf8(line) {
        Ok(text) => text.to_owned(),
        Err(_) => line.iter().map(|&byte| byte as char).collect(),
    }
}

/// The rest of a line in a form that tobj understands; the outer `None` is for keywords that do not matter, the inner
/// for a rest that makes no sense.
fn clean(keyword: &str, rest: &str) -> Option<Option<String>> {
    let numbers = || -> Vec<f32> { rest.split_whitespace().map_while(|word| word.parse().ok()).collect() };
    let follows = |n: usize| rest.split_whitespace().nth(n).is_some_and(|word| !word.starts_with('#'));
    Some(match keyword {
        "newmtl" => (!rest.is_empty()).then(|| rest.to_owned()),
        "Ka" | "Kd" | "Ks" => match numbers()[..] {
            [r, g, b, ..] => Some(format!("{r} {g} {b}")),
            // The specification: g and b, if absent, are r.
            [_] if follows(1) => None,
            [_, _] if follows(2) => None,
            [r, ..] => Some(format!("{r} {r} {r}")),
            [] => None,
        },
        "Ns" | "Ni" | "d" | "Tr" => numbers().first().map(f32::to_string),
        "illum" => {
            numbers().first().filter(|&&model| (0.0..=255.0).contains(&model)).map(|model| format!("{}", *model as u8))
        }
        "map_Kd" => Some(texture_name(rest)).filter(|name| !name.is_empty()).map(str::to_owned),
        _ => return None,
    })
}

/// The file name behind a texture's options.
fn texture_name(mut rest: &str) -> &str {
    loop {
        let (option, after) = rest.split_once(char::is_whitespace).unwrap_or((rest, ""));
        let (least, most) = match option.to_ascii_lowercase().as_str() {
            "-s" | "-o" | "-t" => (1, 3),
            "-mm" => (2, 2),
            "-blendu" | "-blendv" | "-cc" | "-clamp" | "-texres" | "-imfchan" | "-boost" | "-bm" | "-type"
            | "-colorspace" => (1, 1),
            _ => return rest,
        };
        rest = after.trim_start();
        for i in 0..most {
            let (word, after) = rest.split_once(char::is_whitespace).unwrap_or((rest, ""));
            if i >= least && word.parse::<f32>().is_err() {
                break;
            }
            rest = after.trim_start();
        }
    }
}

/// What we keep of a material.
fn convert(material: tobj::Material, folder: &Path, monitor: Monitor<'_>) -> MaterialInfo {
    let transparency = material.unknown_param.get("Tr").and_then(|tr| tr.parse::<f32>().ok());
    let map_kd = material.diffuse_texture.map(|name| locate(folder, &name));
    if let Some(path) = map_kd.as_ref().filter(|path| !path.is_file()) {
        monitor.warn(format!("{}: no such texture, material \"{}\" goes without", path.display(), material.name));
    }
    MaterialInfo {
        name: material.name,
        ka: material.ambient,
        kd: material.diffuse,
        ks: material.specular,
        ns: material.shininess,
        ni: material.optical_density,
        d: material.dissolve.or(transparency.map(|tr| 1.0 - tr)),
        illum: material.illumination_model.map(u32::from),
        map_kd,
    }
}

/// The first few of `count` words.
fn list(words: impl Iterator<Item = String>, count: usize) -> String {
    let shown = words.take(LISTED).collect::<Vec<_>>().join(", ");
    let more = count.saturating_sub(LISTED);
    if more > 0 { format!("{shown} and {more} more") } else { shown }
}

#[cfg(test)]
mod tests;
