//! Temporary words: in memory while they are few, then in a file without a name.
//!
//! The file is unlinked as soon as it is made (where the system allows that), so that nothing of it stays behind however
//! the process ends. All reads and writes are meant to be large; there is no buffer in between.

use std::fs::File;
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use crate::error::{Error, Result};

/// An append-only store of `u32` words that can be read at any place.
pub(super) struct Spool {
    folder: PathBuf,
    limit: usize,
    memory: Vec<u32>,
    file: Option<File>,
    words: u64,
}

impl Spool {
    /// An empty spool that keeps up to `limit` words in memory, and more than that in a file in `folder`.
    pub fn new(folder: &Path, limit: usize) -> Spool {
        Spool { folder: folder.to_owned(), limit, memory: Vec::new(), file: None, words: 0 }
    }

    /// Words in it.
    pub fn len(&self) -> u64 {
        self.words
    }

    /// All words, if they are in memory.
    pub fn memory(&self) -> Option<&[u32]> {
        self.file.is_none().then_some(&self.memory)
    }

    pub fn append(&mut self, words: &[u32]) -> Result<()> {
        if self.file.is_none() && self.memory.len() + words.len() > self.limit {
            self.spill()?;
        }
        match &mut self.file {
            None => self.memory.extend_from_slice(words),
            Some(file) => write(file, self.words, words).map_err(Error::io(&self.folder, WRITE))?,
        }
        self.words += words.len() as u64;
        Ok(())
    }

    /// Fills `words` with those from `at` on, which must have been written.
    pub fn read(&mut self, at: u64, words: &mut [u32]) -> Result<()> {
        match &mut self.file {
            None => words.copy_from_slice(&self.memory[at as usize..at as usize + words.len()]),
            Some(file) => read(file, at, words).map_err(Error::io(&self.folder, "read a temporary file in"))?,
        }
        Ok(())
    }

    fn spill(&mut self) -> Result<()> {
        let mut file = temporary(&self.folder)?;
        write(&mut file, 0, &self.memory).map_err(Error::io(&self.folder, WRITE))?;
        self.memory = Vec::new();
        self.file = Some(file);
        Ok(())
    }
}

const WRITE: &str = "write a temporary file in";

/// A nameless file in `folder`; also the test whether temporary files can be made there.
pub(super) fn temporary(folder: &Path) -> Result<File> {
    tempfile::tempfile_in(folder).map_err(Error::io(folder, "create a temporary file in this folder"))
}

fn write(file: &mut File, at: u64, words: &[u32]) -> std::io::Result<()> {
    file.seek(SeekFrom::Start(4 * at))?;
    file.write_all(bytemuck::cast_slice(words))
}

fn read(file: &mut File, at: u64, words: &mut [u32]) -> std::io::Result<()> {
    file.seek(SeekFrom::Start(4 * at))?;
    file.read_exact(bytemuck::cast_slice_mut(words))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reads_back_from_memory_and_from_the_file() {
        let folder = tempfile::tempdir().unwrap();
        for limit in [1000, 10] {
            let mut spool = Spool::new(folder.path(), limit);
            for piece in (0..100u32).collect::<Vec<_>>().chunks(7) {
                spool.append(piece).unwrap();
            }
            let mut words = [0; 5];
            spool.read(42, &mut words).unwrap();
            assert_eq!((words, spool.len()), ([42, 43, 44, 45, 46], 100));
            spool.append(&[7]).unwrap();
            spool.read(98, &mut words[..3]).unwrap();
            assert_eq!(words[..3], [98, 99, 7]);
            assert_eq!(spool.memory().is_some(), limit == 1000);
            assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
        }
    }

    #[test]
    fn names_the_folder_that_is_not_there() {
        let mut spool = Spool::new(Path::new("/no/such/folder"), 0);
        let message = spool.append(&[1]).unwrap_err().to_string();
        assert!(message.starts_with("/no/such/folder: cannot create a temporary file in"), "{message}");
    }
}
