//! Files that appear whole or not at all.

use std::io::Write;
use std::path::{Path, PathBuf};

use octrace::Error;
use octrace::error::folder_of;

/// A text or data file being written: under a temporary name beside its place, renamed when it is whole.
///
/// Devices and pipes cannot be replaced and are written directly; a link is followed. Dropped before
/// [`Whole::commit`], it leaves nothing.
pub struct Whole {
    path: PathBuf,
    target: PathBuf,
    file: Target,
}

enum Target {
    Temporary(std::io::BufWriter<tempfile::NamedTempFile>),
    Direct(std::io::BufWriter<std::fs::File>),
}

impl Whole {
    /// Begins a file that will be named `path`.
    pub fn create(path: &Path) -> Result<Whole, Error> {
        let target = path.canonicalize().unwrap_or_else(|_| path.to_owned());
        let file = if is_special(path) {
            let file = std::fs::OpenOptions::new().append(true).open(path).map_err(Error::io(path, "write"))?;
            Target::Direct(std::io::BufWriter::with_capacity(1 << 20, file))
        } else {
            let mut builder = tempfile::Builder::new();
            builder.prefix(".octrace-").suffix(".tmp");
            #[cfg(unix)]
            builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
            let file = builder.tempfile_in(folder_of(&target)).map_err(Error::create(path))?;
            Target::Temporary(std::io::BufWriter::with_capacity(1 << 20, file))
        };
        Ok(Whole { path: path.to_owned(), target, file })
    }

    /// Flushes, syncs and gives the file its name.
    pub fn commit(self) -> Result<(), Error> {
        let failed = |doing| Error::io(&self.path, doing);
        match self.file {
            Target::Direct(mut file) => file.flush().map_err(failed("write")),
            Target::Temporary(file) => {
                let file = file.into_inner().map_err(|e| failed("write")(e.into_error()))?;
                file.as_file().sync_all().map_err(failed("sync"))?;
                file.persist(&self.target).map_err(|e| Error::create(&self.path)(e.error))?;
                Ok(())
            }
        }
    }

    /// The file's name, for messages.
    pub fn path(&self) -> &Path {
        &self.path
    }
}

impl Write for Whole {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        match &mut self.file {
            Target::Temporary(f) => f.write(bytes),
            Target::Direct(f) => f.write(bytes),
        }
    }

    fn flush(&mut self) -> std::io::Result<()> {
        match &mut self.file {
            Target::Temporary(f) => f.flush(),
            Target::Direct(f) => f.flush(),
        }
    }
}

/// Writes `bytes` as the whole content of `path`.
pub fn write_whole(path: &Path, bytes: &[u8]) -> Result<(), Error> {
    let mut file = Whole::create(path)?;
    file.write_all(bytes).map_err(Error::io(path, "write"))?;
    file.commit()
}

/// Prints text on standard output.
pub fn print(text: &str) -> Result<(), Error> {
    print_bytes(text.as_bytes())
}

/// Writes data to standard output.
pub fn print_bytes(bytes: &[u8]) -> Result<(), Error> {
    let mut out = std::io::stdout().lock();
    out.write_all(bytes).and_then(|()| out.flush()).map_err(Error::io("<stdout>", "write"))
}

/// Whether something is there that is neither a file nor a folder: a device or a pipe, which must not be replaced.
///
/// Nor must what stands in `/dev`: `/dev/stdout` is a link to whatever standard output is, which may be a file.
pub fn is_special(path: &Path) -> bool {
    let in_dev = path.parent().is_some_and(|p| p == Path::new("/dev") || p == Path::new("/dev/fd"));
    std::fs::metadata(path).is_ok_and(|m| !m.is_dir() && (in_dev || !m.is_file()))
}

/// Refuses, before any work is done, a place where a finished file could not be put.
pub fn check(path: &Path) -> Result<(), Error> {
    if path.is_dir() {
        return Err(Error::create(path)(std::io::ErrorKind::IsADirectory.into()));
    }
    if !folder_of(path).is_dir() {
        return Err(Error::create(path)(std::io::ErrorKind::NotFound.into()));
    }
    Ok(())
}

/// Whether two paths lead to the same file.
pub fn same_file(a: &Path, b: &Path) -> bool {
    matches!((a.canonicalize(), b.canonicalize()), (Ok(a), Ok(b)) if a == b)
}

/// Whether two paths name the same place, whether or not anything is there yet.
pub fn same_place(a: &Path, b: &Path) -> bool {
    let parent = |path: &Path| folder_of(path).canonicalize().ok();
    same_file(a, b) || a.file_name() == b.file_name() && parent(a).is_some() && parent(a) == parent(b)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn appears_whole_or_not_at_all() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.json");
        let mut file = Whole::create(&path).unwrap();
        file.write_all(b"half").unwrap();
        drop(file);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
        write_whole(&path, b"first").unwrap();
        write_whole(&path, b"second").unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"second");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn a_missing_folder_is_the_machines_failure() {
        let folder = tempfile::tempdir().unwrap();
        let error = write_whole(&folder.path().join("no/such/a.json"), b"").unwrap_err();
        assert_eq!(error.kind(), octrace::Kind::Machine);
    }

    #[cfg(unix)]
    #[test]
    fn links_are_followed() {
        let folder = tempfile::tempdir().unwrap();
        let (path, link) = (folder.path().join("a.json"), folder.path().join("link.json"));
        std::fs::write(&path, b"old").unwrap();
        std::os::unix::fs::symlink(&path, &link).unwrap();
        write_whole(&link, b"new").unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"new");
        assert!(std::fs::symlink_metadata(&link).unwrap().is_symlink());
        assert!(same_file(&path, &link) && !same_file(&path, Path::new("/dev/null")));
    }

    #[cfg(unix)]
    #[test]
    fn devices_are_not_replaced() {
        write_whole(Path::new("/dev/null"), b"gone").unwrap();
        assert!(is_special(Path::new("/dev/null")));
    }
}
