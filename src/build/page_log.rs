//! What a build notes of each page that it wrote, so that it can go on after them.
//!
//! A `pages` file grows by an entry a page, and `progress` says how many chunks, and so how many entries, are whole. The file
//! that the pages themselves go to has a mark, a random number, that `progress` repeats: under its name another build may
//! have left another one since. It names the state (`checkpoint.rs`) that the chunks are of, too, and has a checksum of the entries, of which
//! each has that of its page.

use std::fs::File;
use std::hash::{BuildHasher, RandomState};

use bytemuck::{Pod, Zeroable};
use xxhash_rust::xxh3::Xxh3;

use super::work::WorkFolder;
use crate::error::{Error, Result};
use crate::format::{Brick, PageRecord, checksum};

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
    /// The checksum of the state.
    state: u64,
    /// The checksum of the entries.
    entries: u64,
    /// Of all fields before.
    checksum: u64,
}

impl Progress {
    fn new([chunks, pages, mark, state, entries]: [u64; 5]) -> Progress {
        let checksum = checksum(bytemuck::bytes_of(&[chunks, pages, mark, state, entries]));
        Progress { chunks, pages, mark, state, entries, checksum }
    }

    /// What an earlier build left, if it is whole, of this state, and has all its entries beside it.
    fn left(work: &WorkFolder, of: u64) -> Option<Progress> {
        let bytes = work.read("progress", size_of::<Progress>() as u64)?;
        let left: Progress = bytemuck::try_pod_read_unaligned(&bytes).ok()?;
        let Progress { chunks, pages, mark, state, entries, checksum } = left;
        let whole = Progress::new([chunks, pages, mark, state, entries]).checksum == checksum && state == of;
        (whole && pages <= work.bytes("pages") / size_of::<PageEntry>() as u64).then_some(left)
    }
}

/// The entries of all pages, as they are written.
pub(super) struct PageLog {
    pages: File,
    progress: File,
    waiting: Vec<PageEntry>,
    written: u64,
    mark: u64,
    state: u64,
    /// Of the entries that are written.
    sum: Box<Xxh3>,
    path: std::path::PathBuf,
}

impl PageLog {
    /// An empty one of the build that is in a state of that checksum.
    pub fn create(work: &WorkFolder, state: u64) -> Result<PageLog> {
        let (pages, progress) = (work.create("pages")?, work.create("progress")?);
        // Nobody else has this number.
        let mark = RandomState::new().hash_one(std::process::id());
        let path = work.path().join("pages");
        Ok(PageLog { pages, progress, waiting: Vec::new(), written: 0, mark, state, sum: Box::default(), path })
    }

    /// What the file that the pages go to is marked with.
    pub fn mark(&self) -> u64 {
        self.mark
    }

    /// How many pages an earlier build noted in that state.
    pub fn pages(work: &WorkFolder, state: u64) -> u64 {
        Progress::left(work, state).map_or(0, |progress| progress.pages)
    }

    /// What an earlier build left: chunks that are whole, and their pages. `None` if that cannot be read.
    pub fn reopen(work: &WorkFolder, state: u64) -> Option<(PageLog, u64, Vec<PageEntry>)> {
        let Progress { chunks, pages, mark, entries: sum_of_entries, .. } = Progress::left(work, state)?;
        let whole = work.read("pages", pages.checked_mul(size_of::<PageEntry>() as u64)?)?;
        let mut sum = Box::<Xxh3>::default();
        sum.update(&whole);
        let entries = whole.chunks_exact(size_of::<PageEntry>()).map(bytemuck::pod_read_unaligned).collect();
        let (file, progress) = (work.reopen("pages").ok()?, work.reopen("progress").ok()?);
        let (waiting, path) = (Vec::new(), work.path().join("pages"));
        let is_whole = sum.digest() == sum_of_entries;
        let log = PageLog { pages: file, progress, waiting, written: pages, mark, state, sum, path };
        is_whole.then_some((log, chunks, entries))
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
        self.sum.update(bytemuck::cast_slice(&self.waiting));
        self.written += self.waiting.len() as u64;
        self.waiting.clear();
        let progress = Progress::new([chunks, self.written, self.mark, self.state, self.sum.digest()]);
        super::spool::write_at(&self.progress, 0, bytemuck::bytes_of(&progress)).map_err(failed())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    fn entry(page: u32) -> PageEntry {
        PageEntry { leaves: page, nodes: 7, ..PageEntry::zeroed() }
    }

    #[test]
    fn whole_chunks_are_found_again() {
        let folder = tempfile::tempdir().unwrap();
        let work = WorkFolder::new(folder.path(), "a.oct".as_ref(), true).unwrap();
        assert!(PageLog::reopen(&work, 8).is_none());
        let mut log = PageLog::create(&work, 8).unwrap();
        let mark = log.mark();
        (0..3).for_each(|page| log.push(entry(page)));
        log.note(1).unwrap();
        (3..5).for_each(|page| log.push(entry(page)));
        log.note(2).unwrap();
        log.push(entry(5));
        drop(log);
        let (mut log, chunks, entries) = PageLog::reopen(&work, 8).unwrap();
        assert_eq!((chunks, entries, log.mark(), PageLog::pages(&work, 8)), (2, (0..5).map(entry).collect(), mark, 5));
        assert_ne!(
            PageLog::create(&WorkFolder::new(folder.path(), "b.oct".as_ref(), true).unwrap(), 8).unwrap().mark(),
            mark
        );
        log.push(entry(9));
        log.note(3).unwrap();
        assert_eq!(PageLog::reopen(&work, 8).unwrap().2[5], entry(9));
        assert!(PageLog::reopen(&work, 9).is_none(), "of another state");
        let whole = fs::read(work.path().join("pages")).unwrap();
        fs::write(work.path().join("pages"), &whole[..whole.len() - 1]).unwrap();
        assert!(PageLog::reopen(&work, 8).is_none() && PageLog::pages(&work, 8) == 0, "cut short");
        fs::write(work.path().join("pages"), [&whole[..700], &[1], &whole[701..]].concat()).unwrap();
        assert!(PageLog::reopen(&work, 8).is_none(), "an entry is another");
        fs::write(work.path().join("pages"), whole).unwrap();
        assert!(PageLog::reopen(&work, 8).is_some());
        fs::write(work.path().join("progress"), [1; 48]).unwrap();
        assert!(PageLog::reopen(&work, 8).is_none() && PageLog::pages(&work, 8) == 0);
    }
}
