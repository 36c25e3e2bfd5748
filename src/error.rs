//! The one error type of the library.
//!
//! Each error says what was wrong, where, and what to do about it. Its [`Kind`] decides the exit code of a tool.

use std::fmt;
use std::io;
use std::path::{Path, PathBuf};

/// A result of the library.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// What kind of thing went wrong; decides the exit code of a tool.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// The user's input or options are at fault: exit code 2.
    Input,
    /// An octree file is damaged: exit code 3.
    Damaged,
    /// The machine failed (disk, permission, I/O): exit code 4.
    Machine,
    /// Stopped by the user: exit code 130.
    Interrupted,
}

impl Kind {
    /// The exit code that stands for this kind.
    pub fn exit_code(self) -> u8 {
        match self {
            Kind::Input => 2,
            Kind::Damaged => 3,
            Kind::Machine => 4,
            Kind::Interrupted => 130,
        }
    }
}

/// How bad a [`Diagnostic`] is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Severity {
    /// The work cannot go on.
    Error,
    /// The work goes on; the user should know.
    Warning,
}

/// A remark about a place in a text file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Diagnostic {
    /// Error or warning.
    pub severity: Severity,
    /// What is wrong, one sentence without a full stop.
    pub message: String,
    /// The file's name as the user gave it, or `<stdin>`.
    pub file: String,
    /// Line number from 1.
    pub line: u64,
    /// Column from 1, in characters.
    pub column: u64,
    /// The line itself, without its newline, shortened if it is very long.
    pub text: String,
    /// Byte range of the marked word within `text`.
    pub span: std::ops::Range<usize>,
    /// What to do about it.
    pub help: Option<String>,
}

impl fmt::Display for Diagnostic {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Diagnostic { message, file, line, column, text, .. } = self;
        write!(f, "{file}:{line}:{column}: {message}: `{}`", text.trim())?;
        self.help.as_ref().map_or(Ok(()), |help| write!(f, " ({help})"))
    }
}

/// Everything that can go wrong.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// Text input is wrong in one or more places.
    #[error("{}", .0.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n"))]
    Text(Vec<Diagnostic>),
    /// Input as a whole is wrong (empty mesh, wrong kind of file).
    #[error("{}: {what}", .file.display())]
    Input {
        /// The file.
        file: PathBuf,
        /// What is wrong and what to do.
        what: String,
    },
    /// An option or argument does not make sense.
    #[error("{0}")]
    Option(String),
    /// An octree file breaks a rule of FORMAT.md.
    #[error("{}: damaged octree file{}: {what}; build it again with octbuild, or fetch it again", .file.display(), .page.map(|p| format!(", page {p}")).unwrap_or_default())]
    Damaged {
        /// The file.
        file: PathBuf,
        /// The page, where the damage is in one.
        page: Option<u32>,
        /// Which rule is broken, and where.
        what: String,
    },
    /// The operating system refused something.
    #[error("{}: cannot {doing}: {source}", .file.display())]
    Io {
        /// The file.
        file: PathBuf,
        /// What was being done, as an infinitive ("read", "create").
        doing: &'static str,
        /// The system's reason.
        source: io::Error,
    },
    /// The user asked to stop.
    #[error("interrupted")]
    Interrupted,
}

impl Error {
    /// The kind, which decides a tool's exit code.
    ///
    /// A file that is not there or is a folder counts as [`Kind::Input`] when it was to be opened for reading.
    pub fn kind(&self) -> Kind {
        match self {
            Error::Text(_) | Error::Input { .. } | Error::Option(_) => Kind::Input,
            Error::Damaged { .. } => Kind::Damaged,
            Error::Io { doing: "open", source, .. } if source.kind() == io::ErrorKind::NotFound => Kind::Input,
            Error::Io { .. } => Kind::Machine,
            Error::Interrupted => Kind::Interrupted,
        }
    }

    /// An I/O error on `file` while `doing` something; use `"open"` for opening a file to read.
    pub fn io(file: impl AsRef<Path>, doing: &'static str) -> impl FnOnce(io::Error) -> Error {
        let file = file.as_ref().to_owned();
        move |source| Error::Io { file, doing, source: plain(source) }
    }

    /// An I/O error on a file that was to be made under a temporary name, which would only confuse in the message.
    pub fn create(file: impl AsRef<Path>) -> impl FnOnce(io::Error) -> Error {
        let file = file.as_ref().to_owned();
        move |error| {
            let folder = folder_of(&file);
            let source = match error.kind() {
                kind @ io::ErrorKind::NotFound if !folder.is_dir() => {
                    io::Error::new(kind, format!("there is no folder {}; make it first", folder.display()))
                }
                kind @ io::ErrorKind::IsADirectory => io::Error::new(kind, "this is a folder; name a file in it"),
                _ => plain(error),
            };
            Error::Io { file, doing: "create", source }
        }
    }

    /// A damaged octree file.
    pub fn damaged(file: impl AsRef<Path>, page: Option<u32>, what: impl Into<String>) -> Error {
        Error::Damaged { file: file.as_ref().to_owned(), page, what: what.into() }
    }
}

/// The system's own reason, where crate tempfile has put the name of the temporary file behind it.
fn plain(error: io::Error) -> io::Error {
    let text = error.to_string();
    match text.split_once(" at path ") {
        Some((reason, _)) if error.get_ref().is_some() => io::Error::new(error.kind(), reason),
        _ => error,
    }
}

/// The folder that a file of that name lies in: `.` for a name alone.
#[doc(hidden)]
pub fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missing_folder_is_named_and_the_temporary_name_is_not() {
        let failed = tempfile::tempfile_in("/no/such/folder").unwrap_err();
        let failed = [failed, tempfile::NamedTempFile::new_in("/no/such/folder").unwrap_err()];
        for source in failed {
            let error = Error::create("/no/such/folder/a.png")(io::Error::new(source.kind(), source));
            let expected = "/no/such/folder/a.png: cannot create: there is no folder /no/such/folder; make it first";
            assert_eq!((error.to_string(), error.kind()), (expected.to_owned(), Kind::Machine));
        }
    }

    #[test]
    fn a_folder_in_the_place_of_a_file_is_told() {
        let source = std::fs::File::create("/").unwrap_err();
        assert_eq!(Error::create("/")(source).to_string(), "/: cannot create: this is a folder; name a file in it");
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_folder_that_is_there_is_not_called_missing_and_the_systems_reason_is_plain() {
        let failed = || tempfile::NamedTempFile::new_in("/proc").unwrap_err();
        assert!(failed().to_string().contains("/proc/.tmp"), "{}", failed());
        let reason = "No such file or directory (os error 2)";
        for error in [Error::create("/proc/a")(failed()), Error::io("/proc/a", "create")(failed())] {
            assert_eq!(error.to_string(), format!("/proc/a: cannot create: {reason}"));
        }
    }
}
