//! The pages of a mapped file.

use std::fs::File;
use std::io;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use super::failure::{CUT_SHORT, Failure};
use super::mmap::{Blank, Mapping};
use super::top::cut;
use super::{Figures, Octree, Page};
use crate::error::Result;
use crate::format::{Header, PageId, PageRecord, SectionKind, checksum, validate_entry, validate_page};

/// A mapped file, whose pages are checked when they are first used.
pub(super) struct Mapped {
    pub(super) map: Mapping,
    file: File,
    /// Which pages were checked and found sound.
    sound: Blank<AtomicBool>,
    /// How many these are, and their bytes.
    touched: AtomicU64,
    bytes_touched: AtomicU64,
}

impl Mapped {
    pub(super) fn new(file: File, header: &Header) -> io::Result<Mapped> {
        let map = Mapping::new(&file)?;
        let sound = Blank::new(header.pages as usize)?;
        Ok(Mapped { map, file, sound, touched: AtomicU64::new(0), bytes_touched: AtomicU64::new(0) })
    }

    /// The pages as a visit needs them. Records are checked with their pages.
    #[inline]
    pub(super) fn sheets<'a>(&'a self, octree: &'a Octree) -> Sheets<'a> {
        let records = cut(&octree.sections, self.map.bytes(), SectionKind::Pages);
        Sheets { mapped: self, bytes: self.map.bytes(), records, sound: &self.sound }
    }

    /// What was read so far. A page is read once, when it is checked.
    pub(super) fn figures(&self, header: &Header) -> Figures {
        let [touched, bytes] = [&self.touched, &self.bytes_touched].map(|n| n.load(Ordering::Relaxed));
        let total = header.pages.into();
        Figures { total, touched, bytes_touched: bytes, read: touched, bytes_read: bytes, ..Figures::default() }
    }

    /// Why bytes of the map could not be had: the file was cut short, or else the system could not read it.
    pub(super) fn lost(&self, header: &Header) -> Failure {
        match self.file.metadata() {
            Ok(metadata) if metadata.len() >= header.file_bytes => {
                Failure::Read(io::ErrorKind::Other, cfg!(unix).then_some(libc::EIO))
            }
            _ => Failure::Damaged(CUT_SHORT.into()),
        }
    }
}

/// A mapped file's pages.
pub(super) struct Sheets<'a> {
    mapped: &'a Mapped,
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

    /// Checks a page and what the directory says of it, and remembers that it is sound.
    #[cold]
    pub(super) fn check(&self, octree: &Octree, id: PageId) -> Result<Page<'a>> {
        let (i, bricks, header) = (id.0 as usize, octree.bricks(), octree.header());
        let entry = |i: usize| self.records.get(i).zip(bricks.get(i));
        let Some((record, brick)) = entry(i) else { return Err(octree.no_page(id)) };
        let outcome = validate_entry(header, i, i.checked_sub(1).and_then(entry), (record, brick));
        let checked = outcome.and_then(|()| {
            self.mapped.map.fetch(record.offset as usize, record.stored_bytes as usize);
            let bytes = self.stored(record);
            if checksum(bytes) != record.checksum {
                return Err("its checksum is wrong".into());
            }
            validate_page(bytes, id, record, header.flags, header.materials, header.source_triangles)?;
            Ok(bytes)
        });
        // Zeros in place of lost bytes fail the checks; say what really happened.
        octree.fault()?;
        let bytes = checked.map_err(|what| octree.damaged(Some(id.0), what))?;
        if !self.sound[i].swap(true, Ordering::AcqRel) {
            self.mapped.touched.fetch_add(1, Ordering::Relaxed);
            self.mapped.bytes_touched.fetch_add(record.stored_bytes.into(), Ordering::Relaxed);
        }
        Ok(Page::new(bytes, brick, header.flags))
    }

    /// A page's bytes; empty if the record is not as it was when it was checked.
    #[inline]
    fn stored(&self, record: &PageRecord) -> &'a [u8] {
        let begin = record.offset as usize;
        self.bytes.get(begin..begin.saturating_add(record.stored_bytes as usize)).unwrap_or(&[])
    }
}
