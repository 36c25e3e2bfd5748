//! Meshes, and other scene files: everything that names a file to be read.

use std::path::{Path, PathBuf};

use super::super::args::Args;
use super::super::diagnose::{Problem, Step, quote};
use super::super::lexer::Word;
use super::super::parser::{Include, State};
use super::super::source::{MAX_BYTES, check_readable, read_limited};
use super::super::suggest::nearest;
use super::super::{Instance, MeshFile};

/// Help where a file is not there.
const RELATIVE: &str = "names of files are relative to the file in which they stand";

pub(super) fn obj(state: &mut State, args: &mut Args) -> Step<()> {
    let word = args.file()?;
    if has_suffix(word.text, "oct") {
        let problem = Problem::new(word.span.clone(), "`obj` takes a mesh, and this is an octree file");
        return Err(problem.help(format!("did you mean `oct {}`?", word.text)));
    }
    place_mesh(state, word, false)
}

/// Alone or with `on` or `off` a switch, else a mesh that is built already.
pub(super) fn oct(state: &mut State, args: &mut Args) -> Step<()> {
    let Some(next) = args.peek() else {
        state.scene.octree = true;
        return Ok(());
    };
    if !next.quoted && ["on", "off"].contains(&next.text) {
        state.scene.octree = args.switch()?;
        return Ok(());
    }
    let word = args.file()?;
    if ["obj", "ply", "stl", "obj.gz", "obj.zst"].iter().any(|suffix| has_suffix(word.text, suffix)) {
        let problem = Problem::new(word.span.clone(), "`oct` takes an octree file, and this is a mesh");
        return Err(problem.help(format!("did you mean `obj {}`?", word.text)));
    }
    place_mesh(state, word, true)
}

pub(super) fn include(state: &mut State, args: &mut Args) -> Step<()> {
    let word = args.file()?;
    let path = state.folder.join(word.text);
    state.named.push(path.clone());
    let problem = |what: String| Problem::new(word.span.clone(), what);
    let canonical = check_readable(&path).map_err(|why| missing(word, &path, &why, RELATIVE.into()))?;
    if let Some(at) = state.including.iter().position(|file| file.canonical == canonical) {
        let mut chain: Vec<_> = state.including[at..].iter().map(|file| file.name.to_string()).collect();
        chain.push(state.including[at].name.to_string());
        return Err(problem("this file includes itself".into()).help(chain.join(" includes ")));
    }
    let budget = MAX_BYTES.saturating_sub(state.bytes);
    let bytes =
        read_limited(&path, budget).map_err(|why| problem(format!("cannot read {}: {why}", quote(word.text))))?;
    state.bytes += bytes.len() as u64;
    state.included = Some(Include { path, canonical, bytes });
    Ok(())
}

fn has_suffix(name: &str, suffix: &str) -> bool {
    name.to_ascii_lowercase().strip_suffix(suffix).is_some_and(|stem| stem.ends_with('.'))
}

/// Places the mesh file that `word` names; a file named twice is listed once.
fn place_mesh(state: &mut State, word: &Word, built: bool) -> Step<()> {
    let path = state.folder.join(word.text);
    state.named.push(path.clone());
    let canonical = check_readable(&path).map_err(|why| {
        let quote = if word.quoted { "\"" } else { "" };
        let build = format!("build it first: `octbuild MESH.obj -o {quote}{}{quote}`", word.text);
        missing(word, &path, &why, if built { build } else { RELATIVE.into() })
    })?;
    let meshes = &mut state.scene.meshes;
    let mesh = *state.mesh_numbers.entry((canonical, built)).or_insert_with(|| {
        meshes.push(MeshFile { path, built });
        meshes.len() - 1
    });
    let material = state.material_index();
    let (to_world, mtl, smooth) = (state.transform, state.mtl, state.smooth);
    state.scene.instances.push(Instance { mesh, material, to_world, mtl, smooth });
    Ok(())
}

/// A file that cannot be opened. If it is not there, the help names one of the same kind nearby whose name is much
/// alike; if there is none such, it is `otherwise`.
fn missing(word: &Word, path: &Path, why: &str, otherwise: String) -> Problem {
    let problem = Problem::new(word.span.clone(), format!("cannot open {}: {why}", quote(&path.to_string_lossy())));
    if path.exists() {
        return problem;
    }
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let names = neighbours(path);
    let near = nearest(&name, names.iter().map(String::as_str));
    let near = near.map(|near| format!("did you mean `{}`?", with_name(word.text, near)));
    problem.help(near.unwrap_or(otherwise))
}

/// `given` with its last part replaced.
fn with_name(given: &str, name: &str) -> String {
    let folder = given.rfind(['/', std::path::MAIN_SEPARATOR]).map_or("", |slash| &given[..=slash]);
    format!("{folder}{name}")
}

/// Names of files in the folder of `path` with its suffix; few enough that looking is quick.
fn neighbours(path: &Path) -> Vec<String> {
    let folder = match path.parent() {
        Some(folder) if folder != Path::new("") => folder.to_path_buf(),
        _ => PathBuf::from("."),
    };
    let Ok(entries) = std::fs::read_dir(folder) else { return Vec::new() };
    let names = entries.take(1000).flatten().map(|entry| PathBuf::from(entry.file_name()));
    names.filter(|name| name.extension() == path.extension()).filter_map(|name| name.to_str().map(Into::into)).collect()
}
