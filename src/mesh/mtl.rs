//! Material libraries (`.mtl`), read through the crate tobj.
//!
//! The file is made fit for tobj first: Latin-1 becomes UTF-8, and lines that tobj would refuse (it gives up the whole
//! file) or panic at are taken out with a warning. Only what [`MaterialInfo`] holds is kept. Of a texture's options
//! (`-s 1 1 1`) only the file name behind them is used.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use super::MaterialInfo;
use crate::error::{Error, Result};
use crate::event::Monitor;

/// How many names or lines a warning lists.
const LISTED: usize = 8;

/// Reads a material library, in the file's order.
///
/// What is wrong in it is told to `monitor`; it fails only if the file cannot be read at all. Paths of textures can be
/// opened from the current folder.
pub fn load(path: &Path, monitor: Monitor<'_>) -> Result<Vec<MaterialInfo>> {
    if !std::fs::metadata(path).map_err(Error::io(path, "open"))?.is_file() {
        return Err(Error::Input {
            file: path.to_owned(),
            what: "not a material library but a folder or device".into(),
        });
    }
    let bytes = std::fs::read(path).map_err(Error::io(path, "open"))?;
    let (text, bad) = sanitize(&decode(&bytes));
    if !bad.is_empty() {
        let lines = list(bad.iter().map(|line| line.to_string()));
        monitor.warn(format!("{}: lines that make no sense are ignored: {lines}", path.display()));
    }
    let folder = path.parent().unwrap_or(Path::new(""));
    let (found, _) = tobj::load_mtl_buf(&mut text.as_bytes())
        .map_err(|error| Error::Input { file: path.to_owned(), what: format!("not a material library ({error})") })?;
    Ok(found.into_iter().map(|material| convert(material, folder, monitor)).collect())
}

/// Finds the materials that a mesh uses by name in the libraries that it names, relative to its `folder`.
///
/// A library that is missing and a material that no library defines are warnings; such a material has only its name.
pub(super) fn resolve(
    folder: &Path,
    libraries: &[String],
    used: Vec<String>,
    monitor: Monitor<'_>,
) -> Vec<MaterialInfo> {
    let mut known: HashMap<String, MaterialInfo> = HashMap::new();
    for path in libraries.iter().flat_map(|names| library_paths(folder, names)) {
        match load(&path, monitor) {
            // The first definition of a name counts.
            Ok(materials) => materials.into_iter().for_each(|found| {
                known.entry(found.name.clone()).or_insert(found);
            }),
            Err(error) => monitor.warn(format!("{error}; its materials get the default look")),
        }
    }
    let find = |name: &String| known.get(name).or_else(|| known.get(name.split(" #").next()?.trim_end()));
    let missing: Vec<&String> = used.iter().filter(|name| find(name).is_none()).collect();
    if !missing.is_empty() {
        let names = list(missing.iter().map(|name| format!("\"{name}\"")));
        monitor.warn(format!("no material library defines {names}: such faces get the default look"));
    }
    used.iter().map(|name| MaterialInfo { name: name.clone(), ..find(name).cloned().unwrap_or_default() }).collect()
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

/// UTF-8 if it can be, else Latin-1; without a byte-order mark.
fn decode(bytes: &[u8]) -> String {
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    match std::str::from_utf8(bytes) {
        Ok(text) => text.to_owned(),
        Err(_) => bytes.iter().map(|&byte| byte as char).collect(),
    }
}

/// The lines that tobj is to see, and the numbers of those that make no sense.
fn sanitize(text: &str) -> (String, Vec<usize>) {
    let (mut kept, mut bad) = (String::with_capacity(text.len()), Vec::new());
    let mut inside = false;
    for (number, line) in text.lines().enumerate() {
        let (keyword, rest) = line.trim().split_once(char::is_whitespace).unwrap_or((line.trim(), ""));
        let rest = rest.trim();
        if keyword == "newmtl" {
            // What follows a material without a name belongs to none.
            inside = !rest.is_empty();
        }
        let Some(clean) = clean(keyword, rest) else { continue };
        match clean {
            Some(clean) if inside => kept.extend([keyword, " ", &clean, "\n"]),
            Some(_) => {}
            None => bad.push(number + 1),
        }
    }
    (kept, bad)
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

/// The first few of some words.
fn list(words: impl ExactSizeIterator<Item = String>) -> String {
    let more = words.len().saturating_sub(LISTED);
    let shown = words.take(LISTED).collect::<Vec<_>>().join(", ");
    if more > 0 { format!("{shown} and {more} more") } else { shown }
}

#[cfg(test)]
mod tests {
    use std::sync::Mutex;
    use std::sync::atomic::AtomicBool;

    use super::*;
    use crate::event::Event;

    fn watched<T>(work: impl FnOnce(Monitor<'_>) -> T) -> (T, String) {
        let seen = Mutex::new(String::new());
        let note = |event: Event| {
            if let Event::Warning(text) = event {
                *seen.lock().unwrap() += &format!("{text}\n");
            }
        };
        let stop = AtomicBool::new(false);
        let result = work(Monitor::new(&note, &stop));
        (result, seen.into_inner().unwrap())
    }

    fn load_bytes(bytes: &[u8]) -> (Vec<MaterialInfo>, String) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mtl");
        std::fs::write(&path, bytes).unwrap();
        let (materials, warnings) = watched(|monitor| load(&path, monitor).unwrap());
        (materials, warnings.replace(folder.path().to_str().unwrap(), "DIR"))
    }

    #[test]
    fn all_properties_are_read() {
        let (found, warnings) = load_bytes(
            b"Kd 9 9 9\nnewmtl red one\r\nKa .1 .2 .3\r\nKd 1 0 0 # red\r\n\tKs 1\nNs 10\nNi 1.5\nd 0.5\nillum 2\nKe x\n\
              newmtl glass\nTr 0.75",
        );
        assert_eq!(warnings, "");
        assert_eq!(found.len(), 2);
        let red = MaterialInfo {
            name: "red one".into(),
            ka: Some([0.1, 0.2, 0.3]),
            kd: Some([1.0, 0.0, 0.0]),
            ks: Some([1.0; 3]),
            ns: Some(10.0),
            ni: Some(1.5),
            d: Some(0.5),
            illum: Some(2),
            map_kd: None,
        };
        assert_eq!(found[0], red);
        assert_eq!((found[1].d, &found[1].name[..]), (Some(0.25), "glass"));
    }

    #[test]
    fn what_makes_no_sense_is_a_warning() {
        let (found, warnings) = load_bytes(
            b"newmtl a\nKd 1 x 0\nKd spectral x.rfl\nKs\nd -halo 0.5\nillum 999\nmap_Kd\nNs 5\nnewmtl\nKd 1 1 1\nnewmtl b\xe9\nKd 1\n",
        );
        assert_eq!(warnings, "DIR/a.mtl: lines that make no sense are ignored: 2, 3, 4, 5, 6, 7, 9\n");
        let names: Vec<&str> = found.iter().map(|material| &material.name[..]).collect();
        assert_eq!(names, ["a", "bé"]);
        assert_eq!((found[0].ns, found[0].kd, found[1].kd), (Some(5.0), None, Some([1.0; 3])));
    }

    #[test]
    fn textures_are_found_behind_options_and_odd_paths() {
        assert_eq!(texture_name("-s 1 1 1 -o -0.5 a b.png"), "a b.png");
        assert_eq!(texture_name("-s 2 c.png"), "c.png");
        assert_eq!(texture_name("-clamp on -mm 0 1 -bm 0.2 d.png"), "d.png");
        assert_eq!(texture_name("-x.png"), "-x.png");
        assert_eq!(texture_name("-clamp"), "");
        let (found, warnings) = load_bytes(b"newmtl a\nmap_Kd -s 1 1 1 maps\\sub\\x y.png\n");
        assert!(found[0].map_kd.as_ref().unwrap().ends_with("maps/sub/x y.png"));
        assert_eq!(warnings, "DIR/maps/sub/x y.png: no such texture, material \"a\" goes without\n");
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("t.png"), "").unwrap();
        assert_eq!(locate(folder.path(), "C:\\Users\\x\\t.png"), folder.path().join("t.png"));
        assert_eq!(locate(folder.path(), "\"t.png\""), folder.path().join("t.png"));
    }

    #[test]
    fn libraries_may_have_blanks_in_their_names_or_be_several() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        std::fs::write(at("a b.mtl"), "newmtl ab\nNs 1").unwrap();
        std::fs::write(at("c.mtl"), "newmtl c\nNs 2\nnewmtl ab\nNs 3").unwrap();
        assert_eq!(library_paths(folder.path(), "a b.mtl"), [at("a b.mtl")]);
        assert_eq!(library_paths(folder.path(), "c.mtl d.mtl"), [at("c.mtl"), at("d.mtl")]);
        assert_eq!(library_paths(folder.path(), "x y.mtl"), [at("x y.mtl")]);
        let used = vec!["c".to_owned(), "ab".to_owned(), "no".to_owned(), "c # blue".to_owned()];
        let libraries = ["a b.mtl".to_owned(), "c.mtl".to_owned(), "gone.mtl".to_owned()];
        let (found, warnings) = watched(|monitor| resolve(folder.path(), &libraries, used, monitor));
        assert_eq!(
            found.iter().map(|material| material.ns).collect::<Vec<_>>(),
            [Some(2.0), Some(1.0), None, Some(2.0)]
        );
        assert_eq!((&found[2].name[..], &found[3].name[..]), ("no", "c # blue"));
        assert!(warnings.contains("gone.mtl: cannot open"), "{warnings}");
        assert!(warnings.contains("no material library defines \"no\": "), "{warnings}");
    }
}
