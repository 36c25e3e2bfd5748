//! Writes an octree file page by page: to a temporary name, synced, then renamed.

use std::path::Path;

use super::{Brick, Header, MaterialRecord, Node, PageId, PageRecord};
use crate::error::Result;

/// An octree file being written.
///
/// Pages are appended in order; [`OctWriter::finish`] writes the top and the header, syncs and renames. Dropped before
/// that, it removes its temporary file and leaves an older file of that name untouched.
pub struct OctWriter {
    records: Vec<PageRecord>,
}

/// All that is known only when the last page is written.
pub struct Top<'a> {
    /// Top nodes; empty for a file of one page.
    pub nodes: &'a [Node],
    /// Brick frames and first references, one a page; `node` is filled in by the writer.
    pub bricks: &'a mut [Brick],
    /// Materials.
    pub materials: &'a [MaterialRecord],
    /// The strings that the materials name.
    pub strings: &'a [u8],
}

impl OctWriter {
    /// Begins a file that will be named `path`; the temporary file lies in the same folder.
    pub fn create(path: &Path) -> Result<OctWriter> {
        let _ = path;
        todo!()
    }

    /// Appends a page as laid out by [`super::PageHeader::layout`]; pages come in the order of their numbers.
    pub fn append(&mut self, page: &[u8]) -> Result<PageId> {
        let _ = page;
        todo!()
    }

    /// Pages written so far.
    pub fn records(&self) -> &[PageRecord] {
        &self.records
    }

    /// Writes the top and the header, syncs, renames. The header's sizes, page count, sections and checksums are
    /// filled in here; everything else is taken from `header`. Returns the file's length.
    pub fn finish(self, header: Header, top: Top<'_>) -> Result<u64> {
        let _ = (header, top);
        todo!()
    }
}
