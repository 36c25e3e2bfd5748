//! What the input is, and where the picture goes.

use std::path::{Path, PathBuf};

use octrace::output::Format;
use octrace::{Error, Result};

use crate::cli::args::is_stdio;

/// What the input is, by its name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum InputKind {
    /// A scene file.
    Scene,
    /// An octree file.
    Octree,
    /// A mesh.
    Mesh,
}

impl InputKind {
    /// By the suffix; whatever is no mesh is a scene.
    pub fn of(path: &Path) -> InputKind {
        let name = path.file_name().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
        let stem = [".gz", ".zst"].iter().find_map(|suffix| name.strip_suffix(suffix)).unwrap_or(&name);
        if name.ends_with(".oct") {
            InputKind::Octree
        } else if [".obj", ".ply", ".stl"].iter().any(|suffix| stem.ends_with(suffix)) {
            InputKind::Mesh
        } else {
            InputKind::Scene
        }
    }
}

/// Where the picture goes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Place {
    /// Standard output, as PNG.
    Stdout,
    /// A file.
    File(PathBuf),
}

impl Place {
    /// The command line's wish, else the scene's, else the input's name with `.png`, in the current folder.
    ///
    /// Fails for a suffix that is no kind of picture, before any work is done.
    pub fn choose(wish: Option<&Path>, scene: Option<&Path>, input: &Path) -> Result<Place> {
        let path = match wish.or(scene) {
            Some(path) if is_stdio(path) => return Ok(Place::Stdout),
            Some(path) => path.to_owned(),
            None if is_stdio(input) => {
                return Err(Error::Option("a scene on standard input has no name: give -o IMAGE".into()));
            }
            None => named_after(input),
        };
        crate::cli::output::check(&path)?;
        if crate::cli::output::same_file(&path, input) {
            return Err(Error::Option(format!(
                "{}: input and output are the same file; name another output",
                path.display()
            )));
        }
        // Devices have no suffix that would mean anything.
        if !crate::cli::output::is_special(&path) {
            Format::of(&path)?;
        }
        Ok(Place::File(path))
    }

    /// Where a picture that was broken off goes; nowhere if it was meant for standard output.
    pub fn partial(&self) -> Option<PathBuf> {
        match self {
            Place::Stdout => None,
            Place::File(path) => Some(path.with_extension("partial.png")),
        }
    }
}

impl std::fmt::Display for Place {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Place::Stdout => f.write_str("<stdout>"),
            Place::File(path) => path.display().fmt(f),
        }
    }
}

/// `models/bunny.obj.gz` gives `bunny.png`.
fn named_after(input: &Path) -> PathBuf {
    let mut name = PathBuf::from(input.file_name().unwrap_or("picture".as_ref()));
    while let Some(suffix) = name.extension() {
        if !["gz", "zst", "obj", "ply", "stl", "oct", "txt"].iter().any(|s| suffix.eq_ignore_ascii_case(s)) {
            break;
        }
        name.set_extension("");
    }
    let mut whole = name.into_os_string();
    whole.push(".png");
    whole.into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kinds_by_suffix() {
        for (name, kind) in [
            ("a.oct", InputKind::Octree),
            ("a.OBJ", InputKind::Mesh),
            ("x/a.obj.gz", InputKind::Mesh),
            ("a.obj.zst", InputKind::Mesh),
            ("a.txt", InputKind::Scene),
            ("obj", InputKind::Scene),
            ("-", InputKind::Scene),
        ] {
            assert_eq!(InputKind::of(name.as_ref()), kind, "{name}");
        }
    }

    #[test]
    fn the_command_line_wins() {
        let place = |wish: Option<&str>, scene: Option<&str>, input: &str| {
            Place::choose(wish.map(Path::new), scene.map(Path::new), input.as_ref())
        };
        let file = |name: &str| Place::File(name.into());
        assert!(place(Some("no/such/folder/a.png"), None, "c.txt").is_err_and(|e| e.kind() == octrace::Kind::Machine));
        assert_eq!(place(Some("a.exr"), Some("b.png"), "c.txt").unwrap(), file("a.exr"));
        assert_eq!(place(None, Some("b.png"), "c.txt").unwrap(), file("b.png"));
        assert_eq!(place(None, None, "x/c.txt").unwrap(), file("c.png"));
        assert_eq!(place(None, None, "x/c.v2.obj.gz").unwrap(), file("c.v2.png"));
        assert_eq!(place(Some("-"), None, "-").unwrap(), Place::Stdout);
        assert!(place(None, None, "-").is_err() && place(Some("a.xyz"), None, "c.txt").is_err());
        assert_eq!(file("d/a.exr").partial().unwrap(), Path::new("d/a.partial.png"));
        assert_eq!(Place::Stdout.partial(), None);
    }
}
