//! Readers of an octree's pages.

use super::cache::Reader;
use super::mapped::Sheets;
use super::{Octree, Page, Pages};
use crate::error::{Error, Result};
use crate::format::{Brick, Flags, PageId};

/// A reader of an octree's pages: what it was given stays in memory while it lives.
///
/// Keep it no longer than a few thousand rays take, and ask for no page that may have to be waited for while it is open: what it
/// holds may be what has to go first.
pub struct Visit<'o> {
    octree: &'o Octree,
    /// The file's, looked up once.
    bricks: &'o [Brick],
    flags: Flags,
    access: Access<'o>,
}

enum Access<'o> {
    Mapped(Sheets<'o>),
    Cached(Reader<'o>),
}

/// Why a page was not given.
#[derive(Debug)]
pub enum Halt {
    /// It is not in memory: end the visit and ask for it. Never in a mapped file.
    Absent(PageId),
    /// It cannot be had.
    Failed(Error),
}

impl From<Error> for Halt {
    fn from(error: Error) -> Halt {
        Halt::Failed(error)
    }
}

impl Halt {
    /// The error, where no page can be absent as the file is mapped.
    pub(crate) fn mapped(self, octree: &Octree) -> Error {
        match self {
            Halt::Failed(error) => error,
            Halt::Absent(id) => octree.no_page(id),
        }
    }
}

impl Octree {
    /// Opens a visit to the pages.
    #[inline]
    pub fn visit(&self) -> Visit<'_> {
        let access = match &self.pages {
            Pages::Mapped(mapped) => Access::Mapped(mapped.sheets(self)),
            Pages::Cached(cache) => Access::Cached(cache.reader()),
        };
        Visit { octree: self, bricks: self.bricks(), flags: self.flags(), access }
    }
}

impl Visit<'_> {
    /// The file.
    #[inline(always)]
    pub fn octree(&self) -> &Octree {
        self.octree
    }

    /// A page, if it is in memory; checked (checksum and structure) when it is read, in a mapped file at its first use.
    ///
    /// Several threads may check the same page at once, to the same end. A page that fails does so at every use.
    #[inline(always)]
    pub fn page(&self, id: PageId) -> Result<Page<'_>, Halt> {
        let i = id.0 as usize;
        let bytes = match &self.access {
            Access::Mapped(sheets) => sheets.bytes(i),
            Access::Cached(reader) => reader.bytes(i),
        };
        match (bytes, self.bricks.get(i)) {
            (Some(bytes), Some(brick)) => Ok(Page::new(bytes, brick, self.flags)),
            _ => self.missing(id),
        }
    }

    /// A page that was not given: of a mapped file it is checked now.
    #[cold]
    fn missing(&self, id: PageId) -> Result<Page<'_>, Halt> {
        match &self.access {
            Access::Mapped(sheets) => sheets.check(self.octree, id).map_err(Halt::Failed),
            Access::Cached(_) if (id.0 as usize) < self.bricks.len() => Err(Halt::Absent(id)),
            Access::Cached(_) => Err(Halt::Failed(self.octree.no_page(id))),
        }
    }
}
