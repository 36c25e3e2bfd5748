//! Files that appear whole or not at all.

use std::io::Write;
use std::path::{Path, PathBuf};

use octrace::Error;

/// A text or data file being written: under a temporary name beside its place, renamed when it is whole.
///
/// Devices and pipes cannot be replaced and are written directly. Dropped before [`Whole::commit`], it leaves nothing.
pub struct Whole {
    path: PathBuf,
    file: Target,
}

enum Target {
    Temporary(std::io::BufWriter<tempfile::NamedTempFile>),
    Direct(std::io::BufWriter<std::fs::File>),
}

impl Whole {
    /// Begins a file that will be named `path`.
    pub fn create(path: &Path) -> Result<Whole, Error> {
        let file = if is_special(path) {
            let file = std::fs::OpenOptions::new().write(true).open(path).map_err(Error::io(path, "write"))?;
            Target::Direct(std::io::BufWriter::with_capacity(1 << 20, file))
        } else {
            let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
            let mut builder = tempfile::Builder::new();
            builder.prefix(".octrace-").suffix(".tmp");
            #[cfg(unix)]
            builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
            let file = builder.tempfile_in(folder).map_err(|e| Error::io(path, "create")(without_path(e)))?;
            Target::Temporary(std::io::BufWriter::with_capacity(1 << 20, file))
        };
        Ok(Whole { path: path.to_owned(), file })
    }

    /// Flushes, syncs and gives the file its name.
    pub fn commit(self) -> Result<(), Error> {
        let failed = |doing| Error::io(&self.path, doing);
        match self.file {
            Target::Direct(mut file) => file.flush().map_err(failed("write")),
            Target::Temporary(file) => {
                let file = file.into_inner().map_err(|e| failed("write")(e.into_error()))?;
                file.as_file().sync_all().map_err(failed("sync"))?;
                file.persist(&self.path).map_err(|e| failed("create")(e.error))?;
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
pub fn is_special(path: &Path) -> bool {
    std::fs::metadata(path).is_ok_and(|m| !m.is_file() && !m.is_dir())
}

/// The temporary name would only confuse in a message.
fn without_path(error: std::io::Error) -> std::io::Error {
    error.raw_os_error().map_or_else(|| error.kind().into(), std::io::Error::from_raw_os_error)
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
    fn devices_are_not_replaced() {
        write_whole(Path::new("/dev/null"), b"gone").unwrap();
        assert!(is_special(Path::new("/dev/null")));
    }
}
