//! The file that an octree is written to before it has its name.
//!
//! `NAME` is written as `.NAME.part` in the same folder, locked while it is written. A build that was killed leaves it, and
//! the next build of the same file finds it: to go on with, or to write over. If another process holds the lock, a name
//! that nobody else has is taken instead.

use std::fs::{self, File, OpenOptions};
use std::io;
use std::path::{Path, PathBuf};

use crate::error::folder_of;

/// A partial file; removed when dropped, unless it got its name before.
pub(super) struct Part {
    pub file: File,
    path: PathBuf,
    /// Whether this is `.NAME.part`.
    pub is_first: bool,
    persisted: bool,
}

impl Part {
    /// Begins, or opens what an earlier build left of, the file that will be named `target`. It is not emptied.
    pub fn open(target: &Path) -> io::Result<Part> {
        let mut name = std::ffi::OsString::from(".");
        name.push(target.file_name().unwrap_or_default());
        name.push(".part");
        let path = folder_of(target).join(name);
        if let Some(file) = open_locked(&path).map_err(plain)? {
            return Ok(Part { file, path, is_first: true, persisted: false });
        }
        let mut builder = tempfile::Builder::new();
        builder.prefix(".octrace-").suffix(".part");
        #[cfg(unix)]
        builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666)); // less the umask, as for any new file
        let (file, path) = builder.tempfile_in(folder_of(target))?.keep().map_err(|e| e.error)?;
        Ok(Part { file, path, is_first: false, persisted: false })
    }

    /// Gives the file its name.
    pub fn persist(mut self, target: &Path) -> io::Result<()> {
        fs::rename(&self.path, target)?;
        self.persisted = true;
        Ok(())
    }
}

impl Drop for Part {
    fn drop(&mut self) {
        if !self.persisted {
            let _ = fs::remove_file(&self.path);
        }
    }
}

/// Opens and locks a file; `None` if another process has it, or locks do not work here.
fn open_locked(path: &Path) -> io::Result<Option<File>> {
    // The file may be renamed or removed between opening and locking: then another one is to be taken.
    for _ in 0..3 {
        let file = OpenOptions::new().read(true).write(true).create(true).truncate(false).open(path)?;
        if file.try_lock().is_err() {
            return Ok(None);
        }
        // A link would lead to somebody else's file, and so may a file of several names; a pipe or a device is none.
        let data = file.metadata()?;
        if is_at(&file, path) && data.is_file() && is_single(&data) {
            return Ok(Some(file));
        }
    }
    Ok(None)
}

/// Whether a file has one name only, where the system tells.
#[cfg(unix)]
pub(crate) fn is_single(data: &fs::Metadata) -> bool {
    std::os::unix::fs::MetadataExt::nlink(data) == 1
}

#[cfg(not(unix))]
pub(crate) fn is_single(_: &fs::Metadata) -> bool {
    true
}

/// Whether an open file is the one of that name.
#[cfg(unix)]
fn is_at(file: &File, path: &Path) -> bool {
    use std::os::unix::fs::MetadataExt;
    match (file.metadata(), fs::symlink_metadata(path)) {
        (Ok(a), Ok(b)) => (a.dev(), a.ino()) == (b.dev(), b.ino()),
        _ => false,
    }
}

/// Whether an open file is the one of that name: open files cannot be renamed here.
#[cfg(not(unix))]
fn is_at(_: &File, path: &Path) -> bool {
    path.exists()
}

/// The error without its number, so that its text is made from its kind.
fn plain(error: io::Error) -> io::Error {
    io::Error::new(error.kind(), error.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;

    #[test]
    fn the_second_writer_takes_another_name() {
        let folder = tempfile::tempdir().unwrap();
        let target = folder.path().join("a.oct");
        let mut first = Part::open(&target).unwrap();
        let second = Part::open(&target).unwrap();
        assert!(first.is_first && !second.is_first);
        first.file.write_all(b"1").unwrap();
        first.persist(&target).unwrap();
        drop(second);
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
        assert_eq!(fs::read(&target).unwrap(), b"1");
    }

    #[cfg(unix)]
    #[test]
    fn a_file_that_has_another_name_is_not_written_to() {
        let folder = tempfile::tempdir().unwrap();
        let other = folder.path().join("other");
        fs::write(&other, b"mine").unwrap();
        fs::hard_link(&other, folder.path().join(".a.oct.part")).unwrap();
        let part = Part::open(&folder.path().join("a.oct")).unwrap();
        assert!(!part.is_first && part.file.metadata().unwrap().len() == 0);
        assert_eq!(fs::read(&other).unwrap(), b"mine");
    }

    #[test]
    fn what_was_left_is_found_again() {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join(".a.oct.part"), b"left").unwrap();
        let part = Part::open(&folder.path().join("a.oct")).unwrap();
        assert!(part.is_first && part.file.metadata().unwrap().len() == 4);
        drop(part);
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
    }
}
