//! Temporary words: in memory while they are few, then in a file of the work folder.
//!
//! All reads and writes are meant to be large; there is no buffer in between. Reading needs no exclusive access, so that
//! threads may read side by side.

use std::fs::File;

use xxhash_rust::xxh3::Xxh3;

use crate::error::{Error, Result};
use crate::event::Monitor;

use super::words::Words;
use super::work::WorkFolder;

/// An append-only store of `u32` words that can be read at any place.
pub(super) struct Spool<'a> {
    work: &'a WorkFolder,
    name: String,
    limit: usize,
    memory: Words,
    file: Option<File>,
    /// Whether the file holds what is in memory.
    copied: bool,
    words: u64,
    /// Of all that went to the file, if that may be noted.
    sum: Option<Box<Xxh3>>,
}

/// Words that are checked at a time, about.
const CHECKED: usize = 1 << 18;

impl<'a> Spool<'a> {
    /// An empty spool that keeps up to `limit` words in memory, and more than that in a file of that name.
    pub fn new(work: &'a WorkFolder, name: impl Into<String>, limit: usize) -> Spool<'a> {
        Spool {
            work,
            name: name.into(),
            limit,
            memory: Words::default(),
            file: None,
            copied: false,
            words: 0,
            sum: None,
        }
    }

    /// The same, of which a [checksum](Spool::checksum) is kept, so that a build that goes on can tell whether it is whole.
    pub fn summed(mut self) -> Spool<'a> {
        self.sum = Some(Box::default());
        self
    }

    /// The spool of that name which an earlier build left, if it holds at least `words`.
    pub fn reopen(work: &'a WorkFolder, name: &str, words: u64) -> Option<Spool<'a>> {
        let file = work.reopen(name).ok()?;
        let whole = file.metadata().ok()?.len() >= words.checked_mul(4)?;
        let mut spool = Spool::new(work, name, 0);
        (spool.file, spool.words) = (Some(file), words);
        whole.then_some(spool)
    }

    /// An empty one in the same folder, whose name says `what` of this it holds, and that keeps nothing in memory.
    pub fn beside(&self, what: &str) -> Spool<'a> {
        Spool::new(self.work, format!("{}-{what}", self.name), 0)
    }

    /// XXH3-64 of all that is in the file.
    pub fn checksum(&self) -> u64 {
        self.sum.as_ref().map_or(0, |sum| sum.digest())
    }

    /// Whether what an earlier build left has that checksum, and `take` finds nothing wrong: it is given all words in order, whole
    /// records of `record` words at a time.
    pub fn holds(
        &self,
        checksum: u64,
        record: usize,
        monitor: Monitor<'_>,
        mut take: impl FnMut(&[u32]) -> bool,
    ) -> Result<bool> {
        let (mut sum, mut words) = (Xxh3::new(), Vec::new());
        let piece = CHECKED / record * record;
        for at in (0..self.words).step_by(piece) {
            monitor.check()?;
            words.resize((self.words - at).min(piece as u64) as usize, 0);
            self.read(at, &mut words)?;
            sum.update(bytemuck::cast_slice(&words));
            if !take(&words) {
                return Ok(false);
            }
        }
        Ok(sum.digest() == checksum)
    }

    /// Words in it.
    pub fn len(&self) -> u64 {
        self.words
    }

    /// All words, if they are in memory.
    pub fn memory(&self) -> Option<&[u32]> {
        self.file.is_none().then(|| &self.memory[..self.words as usize])
    }

    pub fn append(&mut self, words: &[u32]) -> Result<()> {
        let len = self.words as usize;
        if self.file.is_none() && len + words.len() > self.limit {
            self.spill()?;
        }
        if let Some(file) = &self.file {
            write_at(file, 4 * self.words, bytemuck::cast_slice(words)).map_err(self.failed(WRITE))?;
            if let Some(sum) = &mut self.sum {
                sum.update(bytemuck::cast_slice(words));
            }
        } else if !words.is_empty() {
            if self.memory.is_empty() {
                self.memory = Words::zeroed(self.limit)?;
            }
            self.memory[len..len + words.len()].copy_from_slice(words);
        }
        self.words += words.len() as u64;
        Ok(())
    }

    /// Fills `words` with those from `at` on, which must have been written.
    pub fn read(&self, at: u64, words: &mut [u32]) -> Result<()> {
        match &self.file {
            None => words.copy_from_slice(&self.memory[at as usize..at as usize + words.len()]),
            Some(file) => read_at(file, 4 * at, bytemuck::cast_slice_mut(words)).map_err(self.failed(READ))?,
        }
        Ok(())
    }

    /// Writes what is in memory to the file too, so that it can be opened again; nothing may be appended after that. Says
    /// how many words there are.
    pub fn copy_to_file(&mut self) -> Result<u64> {
        if self.file.is_none() && !self.copied {
            let file = self.work.create(&self.name)?;
            self.copied = true;
            let words = &self.memory[..self.words as usize];
            write_at(&file, 0, bytemuck::cast_slice(words)).map_err(self.failed(WRITE))?;
            if let Some(sum) = &mut self.sum {
                sum.update(bytemuck::cast_slice(words));
            }
        }
        Ok(self.words)
    }

    /// Takes what is in the file into memory again; the file stays.
    pub fn recall(&mut self) -> Result<()> {
        let mut words = Words::zeroed(self.words as usize)?;
        self.read(0, &mut words)?;
        (self.memory, self.file, self.copied) = (words, None, true);
        Ok(())
    }

    /// Moves what is in memory to the file, where all that follows goes too.
    pub fn spill(&mut self) -> Result<()> {
        if self.file.is_none() {
            let file = self.work.create(&self.name)?;
            let words = &self.memory[..self.words as usize];
            write_at(&file, 0, bytemuck::cast_slice(words)).map_err(self.failed(WRITE))?;
            if let Some(sum) = &mut self.sum {
                sum.update(bytemuck::cast_slice(words));
            }
            self.memory = Words::default();
            self.file = Some(file);
        }
        Ok(())
    }

    fn failed(&self, doing: &'static str) -> impl FnOnce(std::io::Error) -> Error + use<> {
        Error::io(self.work.path().join(&self.name), doing)
    }
}

impl Drop for Spool<'_> {
    fn drop(&mut self) {
        if self.file.is_some() || self.copied {
            self.work.remove(&self.name);
        }
    }
}

const WRITE: &str = "write this temporary file";
const READ: &str = "read this temporary file";

#[cfg(unix)]
pub(super) fn write_at(file: &File, at: u64, bytes: &[u8]) -> std::io::Result<()> {
    std::os::unix::fs::FileExt::write_all_at(file, bytes, at)
}

#[cfg(unix)]
fn read_at(file: &File, at: u64, bytes: &mut [u8]) -> std::io::Result<()> {
    std::os::unix::fs::FileExt::read_exact_at(file, bytes, at)
}

#[cfg(not(unix))]
pub(super) fn write_at(mut file: &File, at: u64, bytes: &[u8]) -> std::io::Result<()> {
    use std::io::{Seek, SeekFrom, Write};
    file.seek(SeekFrom::Start(at))?;
    file.write_all(bytes)
}

#[cfg(not(unix))]
fn read_at(mut file: &File, at: u64, bytes: &mut [u8]) -> std::io::Result<()> {
    use std::io::{Read, Seek, SeekFrom};
    file.seek(SeekFrom::Start(at))?;
    file.read_exact(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reads_back_from_memory_and_from_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let work = WorkFolder::new(folder.path(), "a.oct".as_ref(), true).unwrap();
        for limit in [1000, 10] {
            let mut spool = Spool::new(&work, "words", limit);
            for piece in (0..100u32).collect::<Vec<_>>().chunks(7) {
                spool.append(piece).unwrap();
            }
            let mut words = [0; 5];
            spool.read(42, &mut words).unwrap();
            assert_eq!((words, spool.len()), ([42, 43, 44, 45, 46], 100));
            spool.append(&[7]).unwrap();
            spool.read(98, &mut words[..3]).unwrap();
            assert_eq!(words[..3], [98, 99, 7]);
            assert_eq!(spool.memory().map(<[u32]>::len), (limit == 1000).then_some(101));
            drop(spool);
            assert!(work.reopen("words").is_err());
        }
    }

    #[test]
    fn a_copy_can_be_opened_again_and_recalled() {
        let folder = tempfile::tempdir().unwrap();
        let work = WorkFolder::new(folder.path(), "a.oct".as_ref(), true).unwrap();
        let mut spool = Spool::new(&work, "words", 1000);
        spool.append(&[1, 2, 3]).unwrap();
        assert_eq!((spool.copy_to_file().unwrap(), spool.memory()), (3, Some(&[1, 2, 3][..])));
        // As a kill does.
        std::mem::forget(spool);
        let mut again = Spool::reopen(&work, "words", 3).unwrap();
        assert_eq!(again.memory(), None);
        again.recall().unwrap();
        assert_eq!(again.memory(), Some(&[1, 2, 3][..]));
        drop(again);
        assert!(work.reopen("words").is_err());
    }
}
