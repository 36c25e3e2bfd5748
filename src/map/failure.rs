//! Why a part of a file cannot be had, kept so that everyone who asks for it can be told.

use std::io;
use std::path::Path;

use crate::error::Error;

/// Why a part of a file cannot be had.
#[derive(Clone, Debug)]
pub(super) enum Failure {
    /// The system's reason.
    Read(io::ErrorKind, Option<i32>),
    /// A rule that it breaks.
    Damaged(String),
}

/// What is said of a file that ends before it should.
pub(super) const CUT_SHORT: &str = "cut short while in use";

impl Failure {
    /// The error, for a page or for the top.
    pub(super) fn error(&self, path: &Path, page: Option<u32>) -> Error {
        match self {
            Failure::Damaged(what) => Error::damaged(path, page, what.clone()),
            Failure::Read(kind, code) => {
                let reason = code.map_or_else(|| (*kind).into(), io::Error::from_raw_os_error);
                let place = page.map_or(String::new(), |page| format!("page {page}: "));
                Error::io(path, "read")(io::Error::new(*kind, format!("{place}{reason}")))
            }
        }
    }
}

impl From<io::Error> for Failure {
    fn from(error: io::Error) -> Failure {
        match error.kind() {
            io::ErrorKind::UnexpectedEof => Failure::Damaged(CUT_SHORT.into()),
            kind => Failure::Read(kind, error.raw_os_error()),
        }
    }
}
