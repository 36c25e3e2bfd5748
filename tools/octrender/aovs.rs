//! Pictures of data beside the picture: `--aov NAME=FILE`.

use std::path::{Path, PathBuf};

use octrace::output::{self, AovFormat};
use octrace::render::{self, AovKind, Settings};
use octrace::shade::World;
use octrace::{Error, Result};

use crate::cli::{self, Session};
use crate::place::Place;

/// A picture of data, and where it goes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AovFile {
    pub kind: AovKind,
    path: PathBuf,
}

/// Reads `NAME=FILE`.
pub fn parse(text: &str) -> Result<AovFile, String> {
    let names = || AovKind::ALL.map(AovKind::name).join(", ");
    let Some((name, path)) = text.split_once('=').filter(|x| !x.1.is_empty()) else {
        return Err(format!("expected NAME=FILE, NAME being one of {}", names()));
    };
    let kind = AovKind::named(name).ok_or_else(|| format!("no data of the name `{name}`; there are {}", names()))?;
    Ok(AovFile { kind, path: path.into() })
}

/// Whether all can be written: asked before any work is done.
pub fn check(aovs: &[AovFile], picture: &Place, input: &Path) -> Result<()> {
    let twice = |path: &Path, what: &str| {
        Err(Error::Option(format!("{}: --aov would write over {what}; name another file", path.display())))
    };
    for (i, AovFile { path, .. }) in aovs.iter().enumerate() {
        if cli::output::same_place(path, input) {
            return twice(path, "the input");
        }
        AovFormat::of(path)?;
        cli::output::check(path)?;
        if matches!(picture, Place::File(other) if cli::output::same_place(other, path)) {
            return twice(path, "the picture");
        }
        if aovs[..i].iter().any(|other| cli::output::same_place(&other.path, path)) {
            return twice(path, "another");
        }
    }
    Ok(())
}

/// Makes and writes them; nothing if none are asked for.
pub fn write(aovs: &[AovFile], world: &World, settings: &Settings, session: &Session<'_>) -> Result<()> {
    if aovs.is_empty() {
        return Ok(());
    }
    let kinds: Vec<AovKind> = aovs.iter().map(|aov| aov.kind).collect();
    let pictures = render::aovs(world, settings, &kinds, session.monitor())?;
    aovs.iter().zip(pictures).try_for_each(|(aov, picture)| output::save_aov(picture, &aov.path))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_and_files() {
        assert_eq!(parse("depth=a=b.exr").unwrap(), AovFile { kind: AovKind::Depth, path: "a=b.exr".into() });
        assert!(parse("heat=x.png").unwrap_err().contains("depth, normal"));
        assert!(parse("depth").is_err() && parse("depth=").is_err());
        let list = |text: &[&str]| text.iter().map(|t| parse(t).unwrap()).collect::<Vec<_>>();
        let picture = Place::File("p.png".into());
        let check = |text: &[&str]| check(&list(text), &picture, Path::new("scene.txt"));
        assert!(check(&["depth=d.exr", "cost=c.png"]).is_ok());
        for wrong in [
            &["depth=d.exr", "cost=d.exr"][..],
            &["depth=p.png"],
            &["depth=./p.png"],
            &["depth=d.jpg"],
            &["depth=no/such/d.exr"],
        ] {
            assert!(check(wrong).is_err(), "{wrong:?}");
        }
    }
}
