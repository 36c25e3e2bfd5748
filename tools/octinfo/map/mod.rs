//! `octinfo --map`: a picture of where a file's bytes lie, and how full its pages and leaves are.

mod census;
mod picture;

use std::path::Path;

use octrace::map::Octree;
use octrace::{Error, Monitor, Result};

use crate::cli;
use census::Census;

/// Whether a map can be written to that file: asked before any work is done.
pub fn check(model: &Path, path: &Path) -> Result<()> {
    let suffix = path.extension().and_then(|suffix| suffix.to_str()).unwrap_or_default().to_ascii_lowercase();
    if !matches!(suffix.as_str(), "png" | "svg") {
        let what = "a map is written as .png or .svg".to_owned();
        return Err(Error::Input { file: path.to_owned(), what });
    }
    cli::output::check(path)?;
    if cli::output::same_place(path, model) {
        return Err(Error::Option(format!(
            "{}: --map would write over the octree file; name another file",
            path.display()
        )));
    }
    Ok(())
}

/// Draws the map of a file, as PNG or SVG by the suffix of `path`.
pub fn write(octree: &Octree, path: &Path, monitor: Monitor<'_>) -> Result<()> {
    let drawing = picture::draw(octree, &Census::of(octree, monitor)?);
    let svg = path.extension().is_some_and(|suffix| suffix.eq_ignore_ascii_case("svg"));
    let bytes = if svg { drawing.svg().into_bytes() } else { drawing.png()? };
    cli::output::write_whole(path, &bytes)
}
