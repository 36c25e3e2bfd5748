//! Pictures of data beside the picture: `--aov NAME=FILE`, or `--aov NAME` for a share, whose part takes them.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use octrace::map::Octree;
use octrace::output::{self, AovFormat};
use octrace::render::{self, AovKind, Settings, Share, Values};
use octrace::shade::World;
use octrace::{Error, Result};

use crate::cli::{self, Session};
use crate::place::Place;

/// What `--aov` says.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Wish {
    kind: AovKind,
    path: Option<PathBuf>,
}

/// A picture of data, and where it goes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AovFile {
    pub kind: AovKind,
    pub path: PathBuf,
}

/// Reads `NAME=FILE` or `NAME`.
pub fn parse(text: &str) -> Result<Wish, String> {
    let names = || AovKind::ALL.map(AovKind::name).join(", ");
    let (name, path) = match text.split_once('=') {
        None => (text, None),
        Some((_, "")) => return Err(format!("expected NAME=FILE, NAME being one of {}", names())),
        Some((name, path)) => (name, Some(path.into())),
    };
    let kind = AovKind::named(name).ok_or_else(|| format!("no data of the name `{name}`; there are {}", names()))?;
    Ok(Wish { kind, path })
}

/// Where each goes, if all can be written: asked before any work is done. `inputs` are files that they must not be written over, each of them `what`.
pub fn files(wishes: &[Wish], picture: &Place, inputs: &[&Path], what: &str) -> Result<Vec<AovFile>> {
    let over = |path: &Path, what: &str| {
        Err(Error::Option(format!("{}: --aov would write over {what}; name another file", path.display())))
    };
    let mut files: Vec<AovFile> = Vec::new();
    for Wish { kind, path } in wishes {
        let name = kind.name();
        let Some(path) = path else {
            return Err(Error::Option(format!("--aov {name}: only a part takes data; give a file, --aov {name}=FILE")));
        };
        if inputs.iter().any(|input| cli::output::same_place(path, input)) {
            return over(path, what);
        }
        AovFormat::of(path)?;
        cli::output::check(path)?;
        if matches!(picture, Place::File(other) if cli::output::same_place(other, path)) {
            return over(path, "the picture");
        }
        if files.iter().any(|other| cli::output::same_place(&other.path, path)) {
            return over(path, "another");
        }
        files.push(AovFile { kind: *kind, path: path.clone() });
    }
    Ok(files)
}

/// What a part has to take: each once, in the order of [`AovKind::ALL`].
pub fn for_part(wishes: &[Wish]) -> Result<Vec<AovKind>> {
    if let Some((kind, path)) = wishes.iter().find_map(|wish| Some((wish.kind.name(), wish.path.as_ref()?.display()))) {
        let what = format!(
            "--aov {kind}={path}: a part takes the data of its share; give --aov {kind}, and --aov {kind}={path} to --assemble"
        );
        return Err(Error::Option(what));
    }
    let mut kinds: Vec<AovKind> = wishes.iter().map(|wish| wish.kind).collect();
    kinds.sort_unstable();
    kinds.dedup();
    Ok(kinds)
}

/// Where pages are read is told by a pass of its own that begins with none in memory.
fn of_its_own(kind: AovKind) -> bool {
    kind == AovKind::Reads
}

/// Makes and writes them; nothing if none are asked for.
pub fn write(
    aovs: &[AovFile],
    world: &World,
    settings: &Settings,
    meshes: &[Arc<Octree>],
    session: &Session<'_>,
) -> Result<()> {
    let (reads, others): (Vec<_>, Vec<_>) = aovs.iter().partition(|aov| of_its_own(aov.kind));
    for (afresh, aovs) in [(false, others), (true, reads)] {
        if aovs.is_empty() {
            continue;
        }
        meshes.iter().filter(|_| afresh).for_each(|mesh| mesh.forget());
        let kinds: Vec<AovKind> = aovs.iter().map(|aov| aov.kind).collect();
        let pictures = render::aovs(world, settings, &kinds, session.monitor())?;
        aovs.iter().zip(pictures).try_for_each(|(aov, picture)| output::save_aov(picture, &aov.path))?;
    }
    Ok(())
}

/// Makes those of a share, for its part.
pub fn of_share(
    kinds: &[AovKind],
    world: &World,
    settings: &Settings,
    share: Share,
    meshes: &[Arc<Octree>],
    session: &Session<'_>,
) -> Result<Vec<(AovKind, Values)>> {
    let (reads, others): (Vec<_>, Vec<_>) = kinds.iter().partition(|kind| of_its_own(**kind));
    let mut data = Vec::new();
    for (afresh, kinds) in [(false, others), (true, reads)] {
        if !kinds.is_empty() {
            meshes.iter().filter(|_| afresh).for_each(|mesh| mesh.forget());
            data.extend(render::share_aovs(world, settings, share, &kinds, session.monitor())?);
        }
    }
    data.sort_unstable_by_key(|(kind, _)| *kind);
    Ok(data)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn list(text: &[&str]) -> Vec<Wish> {
        text.iter().map(|t| parse(t).unwrap()).collect()
    }

    #[test]
    fn names_and_files() {
        assert_eq!(parse("depth=a=b.exr").unwrap(), Wish { kind: AovKind::Depth, path: Some("a=b.exr".into()) });
        assert!(parse("heat=x.png").unwrap_err().contains("depth, normal"));
        assert!(parse("heat").unwrap_err().contains("depth, normal") && parse("depth=").is_err());
        let picture = Place::File("p.png".into());
        let inputs = [Path::new("scene.txt"), Path::new("part.exr")];
        let files = |text: &[&str]| files(&list(text), &picture, &inputs, "the input");
        let good = files(&["depth=d.exr", "cost=c.png"]).unwrap();
        assert_eq!(good[1], AovFile { kind: AovKind::Cost, path: "c.png".into() });
        for wrong in [
            &["depth=d.exr", "cost=d.exr"][..],
            &["depth=p.png"],
            &["depth=./p.png"],
            &["depth=./part.exr"],
            &["depth=d.jpg"],
            &["depth=no/such/d.exr"],
            &["depth"],
        ] {
            assert!(files(wrong).is_err(), "{wrong:?}");
        }
    }

    #[test]
    fn a_part_takes_each_once_and_no_file() {
        let kinds = for_part(&list(&["shadow", "depth", "reads", "depth"])).unwrap();
        assert_eq!(kinds, [AovKind::Depth, AovKind::Reads, AovKind::Shadow]);
        let error = for_part(&list(&["shadow", "depth=d.exr"])).unwrap_err().to_string();
        assert!(error.contains("--aov depth=d.exr to --assemble"), "{error}");
    }
}
