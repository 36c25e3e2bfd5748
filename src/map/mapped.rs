//! The pages of a mapped file.

use std::sync::atomic::{AtomicBool, Ordering};

use super::mmap::Mapping;
use super::{Octree, Page};
use crate::error::Result;
use crate::format::{Header, PageId, PageRecord, checksum, validate_page};

/// A mapped file, whose pages are checked when they are first used.
pub(super) struct Mapped {
    pub(super) map: Mapping,
    /// Which pages were checked and found sound.
    sound: Box<[AtomicBool]>,
}

impl Mapped {
    pub(super) fn new(map: Mapping, pages: u32) -> Mapped {
        Mapped { map, sound: (0..pages).map(|_| AtomicBool::new(false)).collect() }
    }

    /// The pages as a visit needs them.
    #[inline]
    pub(super) fn sheets<'a>(&'a self, octree: &'a Octree) -> Sheets<'a> {
        Sheets { map: &self.map, bytes: self.map.bytes(), records: octree.records(), sound: &self.sound }
    }

    /// The records of the pages that were used so far.
    pub(super) fn used<'a>(&'a self, octree: &'a Octree) -> impl Iterator<Item = &'a PageRecord> {
        let sound = self.sound.iter().map(|sound| sound.load(Ordering::Relaxed));
        octree.records().iter().zip(sound).filter_map(|(record, sound)| sound.then_some(record))
    }
}

/// A mapped file's pages.
pub(super) struct Sheets<'a> {
    map: &'a Mapping,
    bytes: &'a [u8],
    records: &'a [PageRecord],
    sound: &'a [AtomicBool],
}

impl<'a> Sheets<'a> {
    /// A page's bytes, if it was checked before.
    #[inline(always)]
    pub(super) fn bytes(&self, i: usize) -> Option<&'a [u8]> {
        let known = self.sound.get(i)?.load(Ordering::Acquire);
        let record = self.records.get(i).filter(|_| known)?;
        Some(self.stored(record))
    }

    /// Checks a page and remembers that it is sound.
    #[cold]
    pub(super) fn check(&self, octree: &Octree, id: PageId) -> Result<Page<'a>> {
        let i = id.0 as usize;
        let (Some(record), Some(brick)) = (self.records.get(i), octree.bricks().get(i)) else {
            return Err(octree.no_page(id));
        };
        let Header { flags, materials, source_triangles, .. } = *octree.header();
        self.map.fetch(record.offset as usize, record.stored_bytes as usize);
        let bytes = self.stored(record);
        let outcome = match checksum(bytes) == record.checksum {
            true => validate_page(bytes, id, record, flags, materials, source_triangles),
            false => Err("its checksum is wrong".into()),
        };
        // Zeros in place of lost bytes fail the checks; say what really happened.
        octree.fault()?;
        outcome.map_err(|what| octree.damaged(Some(id.0), what))?;
        self.sound[i].store(true, Ordering::Release);
        Ok(Page::new(bytes, brick, flags))
    }

    /// A page's bytes; empty if the record is not as it was when it was checked.
    #[inline]
    fn stored(&self, record: &PageRecord) -> &'a [u8] {
        let begin = record.offset as usize;
        self.bytes.get(begin..begin.saturating_add(record.stored_bytes as usize)).unwrap_or(&[])
    }
}
