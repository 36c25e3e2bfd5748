//! What a build notes of each page that it wrote, so that it can go on after them.
//!
//! A `pages` file grows by an entry a page, and `progress` says how many chunks, and so how many entries, are whole. The file
//! that the pages themselves go to has a mark, a random number, that `progress` repeats: under its name another build may
//! have left another one since.

use std::fs::{self, File};
use std::hash::{BuildHasher, RandomState};

use bytemuck::{Pod, Zeroable};
use xxhash_rust::xxh3::xxh3_64;

use super::work::WorkFolder;
use crate::error::{Error, Result};
use crate::format::{Brick, PageRecord};

/// What is noted of a page.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(super) struct PageEntry {
    pub bounds_root: [[f64; 3]; 2],
    pub nodes: u64,
    pub record: PageRecord,
    pub brick: Brick,
    pub level: u32,
    pub index: [u32; 3],
    pub leaves: u32,
    pub depth: u32,
    /// Flags for normals and texture coordinates.
    pub attributes: u32,
    pub zero: u32,
}

/// How far the pages are.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
struct Progress {
    chunks: u64,
    pages: u64,
    mark: u64,
    checksum: u64,
}

impl Progress {
    fn new(chunks: u64, pages: u64, mark: u64) -> Progress {
        Progress { chunks, pages, mark, checksum: xxh3_64(bytemuck::bytes_of(&[chunks, pages, mark])) }
    }

    /// What an earlier build left, if it is whole.
    fn left(work: &WorkFolder) -> Option<Progress> {
        let bytes = fs::read(work.path().join("progress")).ok()?;
        let Progress { chunks, pages, mark, checksum } = bytemuck::try_pod_read_unaligned(&bytes).ok()?;
        let progress = Progress::new(chunks, pages, mark);
        (checksum == progress.checksum).then_some(progress)
    }
}

/// The entries of all pages, as they are written.
pub(super) struct PageLog {
    pages: File,
    progress: File,
    waiting: Vec<PageEntry>,
    written: u64,
    mark: u64,
    path: std::path::PathBuf,
}

impl PageLog {
    /// An empty one.
    pub fn create(work: &WorkFolder) -> Result<PageLog> {
        let (pages, progress) = (work.create("pages")?, work.create("progress")?);
        // Nobody else has this number.
        let mark = RandomState::new().hash_one(std::process::id());
        Ok(PageLog { pages, progress, waiting: Vec::new(), written: 0, mark, path: work.path().join("pages") })
    }

    /// What the file that the pages go to is marked with.
    pub fn mark(&self) -> u64 {
        self.mark
    }

    /// How many pages an earlier build noted.
    pub fn pages(work: &WorkFolder) -> u64 {
        Progress::left(work).map_or(0, |progress| progress.pages)
    }

    /// What an earlier build left: chunks that are whole, and their pages. `None` if that cannot be read.
    pub fn reopen(work: &WorkFolder) -> Option<(PageLog, u64, Vec<PageEntry>)> {
        let Progress { chunks, pages, mark, .. } = Progress::left(work)?;
        let bytes = fs::read(work.path().join("pages")).ok()?;
        let whole = bytes.get(..(pages as usize).checked_mul(size_of::<PageEntry>())?)?;
        let entries = whole.chunks_exact(size_of::<PageEntry>()).map(bytemuck::pod_read_unaligned).collect();
        let (pages_file, progress) = (work.reopen("pages").ok()?, work.reopen("progress").ok()?);
        let path = work.path().join("pages");
        Some((
            PageLog { pages: pages_file, progress, waiting: Vec::new(), written: pages, mark, path },
            chunks,
            entries,
        ))
    }

    /// Takes the next page's entry.
    pub fn push(&mut self, entry: PageEntry) {
        self.waiting.push(entry);
    }

    /// Notes that the first `chunks` chunks are whole. Their pages must have been handed to the system.
    pub fn note(&mut self, chunks: u64) -> Result<()> {
        let failed = || Error::io(&self.path, "write");
        let at = self.written * size_of::<PageEntry>() as u64;
        super::spool::write_at(&self.pages, at, bytemuck::cast_slice(&self.waiting)).map_err(failed())?;
        self.written += self.waiting.len() as u64;
        self.waiting.clear();
        let progress = Progress::new(chunks, self.written, self.mark);
        super::spool::write_at(&self.progress, 0, bytemuck::bytes_of(&progress)).map_err(failed())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn entry(page: u32) -> PageEntry {
        PageEntry { leaves: page, nodes: 7, ..PageEntry::zeroed() }
    }

    #[test]
    fn whole_chunks_are_found_again() {
        let folder = tempfile::tempdir().unwrap();
        let work = WorkFolder::new(folder.path(), "a.oct".as_ref(), true).unwrap();
        assert!(PageLog::reopen(&work).is_none());
        let mut log = PageLog::create(&work).unwrap();
        let mark = log.mark();
        (0..3).for_each(|page| log.push(entry(page)));
        log.note(1).unwrap();
        (3..5).for_each(|page| log.push(entry(page)));
        log.note(2).unwrap();
        log.push(entry(5));
        drop(log);
        let (mut log, chunks, entries) = PageLog::reopen(&work).unwrap();
        assert_eq!((chunks, entries, log.mark(), PageLog::pages(&work)), (2, (0..5).map(entry).collect(), mark, 5));
        assert_ne!(
            PageLog::create(&WorkFolder::new(folder.path(), "b.oct".as_ref(), true).unwrap()).unwrap().mark(),
            mark
        );
        log.push(entry(9));
        log.note(3).unwrap();
        assert_eq!(PageLog::reopen(&work).unwrap().2[5], entry(9));
        fs::write(work.path().join("progress"), [1; 32]).unwrap();
        assert!(PageLog::reopen(&work).is_none() && PageLog::pages(&work) == 0);
    }
}
