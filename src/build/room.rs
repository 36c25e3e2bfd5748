//! Whether there is room on disk for what a build will write, asked before it is written.
//!
//! Before the scan only the input's size is known, by which triangles are guessed; of what comes through a pipe, nothing: then it is asked
//! while it is read, whenever there are twice as many. Records are on disk twice while they are sorted. After the scan the triangles are
//! counted, and so is the space. Where large triangles are cut
//! ([`super::early`]), records of parts take more: 1.6 times as much where there are no attributes, up to twice that with the most cuts. That shows only when cuts are
//! found, and is asked once more then.

use std::path::{Path, PathBuf};

use crate::error::{Error, Result, folder_of};
use crate::event::Monitor;

/// Bytes of the output for each triangle, about.
const OUTPUT: u64 = 24;

/// Bytes of the records of a triangle without attributes, twice.
const RECORDS: u64 = 80;
/// Bytes of a triangle's vertices and corners, which are gone when records are sorted.
const SCANNED: u64 = 18;

/// Fails if a source of so many triangles, about, will need more temporary space than `folder` has; says how much that is.
///
/// What is expected to stay in `memory` needs none.
pub(super) fn check_before(triangles: Option<u64>, memory: u64, folder: &Path, monitor: Monitor<'_>) -> Result<()> {
    let Some(needed) = triangles.map(|triangles| RECORDS * triangles).filter(|&needed| needed > memory) else {
        return Ok(());
    };
    monitor.note(format!("about {} MB of temporary files will lie in {}", needed / 1_000_000, folder.display()));
    check(needed, folder)
}

/// Asks for room while a source of unknown size is read.
pub(super) struct Growth {
    folder: PathBuf,
    /// When to ask next.
    triangles: u64,
}

impl Growth {
    /// Asks for room in `folder` from so many triangles on.
    pub fn new(folder: &Path, triangles: u64) -> Growth {
        Growth { folder: folder.to_owned(), triangles: triangles.max(1) }
    }

    /// Fails if the triangles so far will need more than there is; says how much that is, when they are twice as many as the last
    /// time.
    pub fn check(&mut self, triangles: u64, monitor: Monitor<'_>) -> Result<()> {
        if triangles < self.triangles {
            return Ok(());
        }
        self.triangles = 2 * triangles;
        monitor.note(format!(
            "{:.1} million triangles so far; about {} MB of temporary files for these will lie in {}",
            triangles as f64 * 1e-6,
            RECORDS * triangles / 1_000_000,
            self.folder.display()
        ));
        check((RECORDS - SCANNED) * triangles, &self.folder)
    }
}

/// Fails if records of `bytes`, to be sorted, and the pages of so many triangles do not find room.
pub(super) fn check_after(bytes: u64, triangles: u64, folder: &Path, output: &Path) -> Result<()> {
    check_both(2 * bytes, OUTPUT * triangles, folder, output)
}

/// Fails if so many `parts` of triangles, whose records take `bytes`, to be sorted, do not find room, nor their pages. Records of
/// whole triangles, of which `written` bytes are in the folder, go when those of parts are there.
pub(super) fn check_parts(bytes: u64, written: u64, parts: u64, folder: &Path, output: &Path) -> Result<()> {
    check_both(bytes.max((2 * bytes).saturating_sub(written)), OUTPUT * parts, folder, output)
}

/// Fails if `folder` has no room for `temporary` bytes, or the folder of `output` none for `pages`.
fn check_both(temporary: u64, pages: u64, folder: &Path, output: &Path) -> Result<()> {
    let beside = folder_of(output);
    if same_disk(folder, beside) {
        return check(temporary + pages, folder);
    }
    check(temporary, folder)?;
    check(pages, beside)
}

fn check(needed: u64, folder: &Path) -> Result<()> {
    match available(folder) {
        Some(free) if free < needed => {
            let megabytes = |bytes: u64| bytes.div_ceil(1_000_000);
            let what = format!(
                "about {} MB are needed, and {} MB are free; make room, or name another folder with --temp",
                megabytes(needed),
                megabytes(free)
            );
            let source = std::io::Error::new(std::io::ErrorKind::StorageFull, what);
            Err(Error::Io { file: folder.to_owned(), doing: "hold the files of this build", source })
        }
        _ => Ok(()),
    }
}

/// Bytes that may be written in a folder, if the system tells.
#[cfg(unix)]
fn available(folder: &Path) -> Option<u64> {
    let disk = nix::sys::statvfs::statvfs(folder).ok()?;
    Some(disk.blocks_available() as u64 * disk.fragment_size() as u64)
}

#[cfg(not(unix))]
fn available(_: &Path) -> Option<u64> {
    None
}

#[cfg(unix)]
fn same_disk(a: &Path, b: &Path) -> bool {
    use std::os::unix::fs::MetadataExt;
    let disk = |path: &Path| std::fs::metadata(path).map(|data| data.dev()).ok();
    disk(a) == disk(b)
}

#[cfg(not(unix))]
fn same_disk(_: &Path, _: &Path) -> bool {
    true
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Kind;

    #[test]
    fn what_does_not_fit_is_told_before_it_is_written() {
        let folder = tempfile::tempdir().unwrap();
        let silent = Monitor::silent();
        assert!(
            check_before(Some(1 << 50), 1 << 30, folder.path(), silent).is_err() || available(folder.path()).is_none()
        );
        let mut growth = Growth::new(folder.path(), 1000);
        growth.check(999, silent).unwrap();
        assert!(growth.check(1 << 50, silent).is_err() || available(folder.path()).is_none());
        // Not asked again before there are twice as many.
        growth.check((1 << 51) - 1, silent).unwrap();
        check_before(Some(1 << 20), 1 << 30, folder.path(), silent).unwrap();
        check_before(None, 1 << 30, folder.path(), silent).unwrap();
        check_after(1 << 10, 10, folder.path(), &folder.path().join("a.oct")).unwrap();
        let output = folder.path().join("a.oct");
        check_parts(1 << 10, 1 << 9, 10, folder.path(), &output).unwrap();
        let Some(free) = available(folder.path()) else { return };
        check_parts(free / 2, free / 2, 1, folder.path(), &output).unwrap();
        // Parts that fit once, but not while they are sorted, even when records of whole triangles are gone.
        let parts = check_parts(free / 4 * 3, free / 8, 1, folder.path(), &output);
        for error in [check_after(1 << 60, 1, folder.path(), &output), parts].map(Result::unwrap_err) {
            assert!(error.kind() == Kind::Machine && error.to_string().contains("--temp"), "{error}");
        }
    }
}
