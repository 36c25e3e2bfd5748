//! `--assemble`: the picture from its parts, and the pictures of data that they have.

use std::path::{Path, PathBuf};

use indicatif::HumanCount;
use octrace::output::{self, Format, Part};
use octrace::render::{self, Aov, AovKind, Film, Identity};
use octrace::{Error, Result};

use crate::WRITING;
use crate::aovs::{self, AovFile, Wish};
use crate::cli::{self, Session};
use crate::place::Place;

/// Most shares or files that a message names.
const NAMED: usize = 20;

/// Puts parts together and writes the picture, and the data that is wished for; nothing is written unless all of it is there.
pub fn assemble(paths: &[PathBuf], output: Option<&Path>, data: &[Wish], session: &Session<'_>) -> Result<()> {
    let (Some(output), Some(first)) = (output, paths.first()) else {
        return Err(Error::Option("--assemble needs parts, and -o IMAGE".into()));
    };
    if let Some(part) = paths.iter().find(|part| cli::output::same_place(part, output)) {
        return Err(Error::Option(format!(
            "{}: the picture would be written over a part; name another file",
            part.display()
        )));
    }
    let place = Place::choose(Some(output), None, first)?;
    let inputs: Vec<&Path> = paths.iter().map(PathBuf::as_path).collect();
    let files = aovs::files(data, &place, &inputs, "a part")?;
    let monitor = session.monitor();
    monitor.phase("check");
    let parts = paths.iter().map(|path| Part::open(path)).collect::<Result<Vec<_>>>()?;
    // As many as there are paths, of which there is one.
    let identity = whole(&parts[0], &parts, &files)?;
    let (size @ [width, height], tonemap) = (identity.size(), identity.tonemap);
    render::room_for(memory(size, &parts, &files), || format!("putting together {width} x {height} pixels"))?;
    let mut film = Film::new(width, height)?;
    let mut aovs = files.iter().map(|file| Aov::new(file.kind, size)).collect::<Result<Vec<_>>>()?;
    monitor.phase("assemble");
    for (done, part) in (1..).zip(&parts) {
        monitor.check()?;
        let portion = part.read()?;
        portion.put(&mut film)?;
        aovs.iter_mut().try_for_each(|aov| portion.put_aov(aov))?;
        monitor.progress(done, Some(parts.len() as u64), "parts");
    }
    monitor.phase("write");
    match &place {
        Place::Stdout => cli::output::print_bytes(&output::encode(&film, Format::PNG, tonemap)?)?,
        Place::File(path) => output::save(&film, path, tonemap)?,
    }
    files.iter().zip(aovs).try_for_each(|(file, aov)| output::save_aov(aov, &file.path))?;
    session.say(format!("{place}: {width} x {height} pixels from {} parts", HumanCount(parts.len() as u64)));
    Ok(())
}

/// Bytes that assembling takes: the picture and all data, and beside them one part after the other, or one of them as it is written.
fn memory([width, height]: [u32; 2], parts: &[Part], files: &[AovFile]) -> u64 {
    let pixels = u64::from(width) * u64::from(height);
    let held = 12 + files.iter().map(|file| file.kind.bytes()).sum::<u64>();
    let largest = parts.iter().map(Part::reading).max().unwrap_or(0);
    held * pixels + largest.max(WRITING * pixels)
}

/// What picture these parts are of. Fails unless they are all of its parts, each once, and have the data for these files; says which are missing,
/// doubled, of another picture, or without data.
fn whole<'a>(first: &'a Part, parts: &[Part], files: &[AovFile]) -> Result<&'a Identity> {
    let mut wrong = Vec::new();
    for part in parts {
        if let Some(what) = difference(first, part) {
            let [this, other] = [part, first].map(|part| part.path.display());
            wrong.push(format!(
                "{this} is of another picture than {other}: {what}; make both of one scene, with the same options"
            ));
        }
    }
    if wrong.is_empty() {
        let mut places: Vec<Option<&Part>> = vec![None; first.share.of() as usize];
        for part in parts {
            match &mut places[part.share.index() as usize] {
                Some(other) => {
                    let (a, b) = (other.path.display(), part.path.display());
                    wrong.push(format!("share {} is there twice: {a} and {b}; leave one out", part.share));
                }
                place => *place = Some(part),
            }
        }
        let missing: Vec<usize> = (0..places.len()).filter(|i| places[*i].is_none()).collect();
        if !missing.is_empty() {
            let (count, of) = (missing.len(), places.len());
            let list = few(missing.iter().map(ToString::to_string));
            wrong.push(format!("{count} of {of} shares are missing: {list}; make them with --shard I/{of}"));
        }
        wrong.extend(parts.iter().filter_map(|part| lacking(part, files)));
    }
    if wrong.is_empty() { Ok(&first.identity) } else { Err(Error::Option(few_lines(wrong))) }
}

/// What data a part should have and has not.
fn lacking(part: &Part, files: &[AovFile]) -> Option<String> {
    let mut kinds: Vec<AovKind> = files.iter().map(|file| file.kind).filter(|kind| !part.data.contains(kind)).collect();
    kinds.sort_unstable();
    kinds.dedup();
    let options: Vec<String> = kinds.iter().map(|kind| format!("--aov {}", kind.name())).collect();
    let (path, share, options) = (part.path.display(), part.share, options.join(" "));
    (!kinds.is_empty()).then(|| format!("{path} was made without {options}: make share {share} again with it"))
}

/// How two parts differ in what all parts of a picture have in common.
fn difference(a: &Part, b: &Part) -> Option<String> {
    let (x, y): (&Identity, &Identity) = (&a.identity, &b.identity);
    let size = |[w, h]: [u32; 2]| format!("{w} x {h} pixels");
    let (what, y, x) = if x.version != y.version {
        ("made by octrace", y.version.clone(), x.version.clone())
    } else if x.whole != y.whole {
        ("a picture of", size(y.whole), size(x.whole))
    } else if x.crop != y.crop {
        ("a crop of", format!("{:?}", y.crop), format!("{:?}", x.crop))
    } else if x.samples != y.samples {
        ("samples a pixel", y.samples.to_string(), x.samples.to_string())
    } else if x.depth != y.depth {
        ("bounces", y.depth.to_string(), x.depth.to_string())
    } else if a.share.of() != b.share.of() {
        ("shares", b.share.of().to_string(), a.share.of().to_string())
    } else if x != y {
        return Some("another scene, other files in it, or another --lod".into());
    } else {
        return None;
    };
    Some(format!("{what} {y}, not {x}"))
}

/// The first of a list, and how many more there are.
fn few(items: impl ExactSizeIterator<Item = String>) -> String {
    let rest = items.len().saturating_sub(NAMED);
    let list = items.take(NAMED).collect::<Vec<_>>().join(", ");
    if rest > 0 { format!("{list} and {rest} more") } else { list }
}

fn few_lines(lines: Vec<String>) -> String {
    let rest = lines.len().saturating_sub(NAMED);
    let mut lines: Vec<String> = lines.into_iter().take(NAMED).collect();
    if rest > 0 {
        lines.push(format!("and {rest} more"));
    }
    lines.join("\n")
}
