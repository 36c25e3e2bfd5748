//! The threads that read, unpack and check pages.

use std::fs::File;
use std::io;
use std::time::Duration;

use super::desk::Task;
use super::{Core, Failure};
use crate::format::{Flags, PageId, checksum, unpack_into, validate_page};

/// How long a loader waits before it looks again whether visits have ended.
const PAUSE: Duration = Duration::from_micros(100);

impl Core {
    /// Loads pages until the cache is dropped.
    pub(super) fn load_all(&self) {
        let mut packed = Vec::new();
        let mut desk = self.desk();
        while !desk.stop {
            let (page, known) = match desk.next(self) {
                Task::Load { page, known } => (page, known),
                Task::Wait => {
                    desk = match self.work.wait_timeout(desk, PAUSE) {
                        Ok((desk, _)) => desk,
                        Err(poison) => poison.into_inner().0,
                    };
                    continue;
                }
                Task::Nothing => {
                    desk = self.work.wait(desk).unwrap_or_else(|poison| poison.into_inner());
                    continue;
                }
            };
            drop(desk);
            let outcome = self.load(page, known, &mut packed);
            desk = self.desk();
            match outcome {
                Ok(()) => desk.loaded(self, page),
                Err(failure) => desk.lost(self, page, failure),
            }
            self.came.notify_all();
        }
    }

    /// Reads a page to its place and checks it.
    fn load(&self, page: u32, known: bool, packed: &mut Vec<u8>) -> Result<(), Failure> {
        let i = page as usize;
        let record = &self.records[i];
        let Some(mut filling) = self.arena.fill(i) else {
            return Err(Failure::Damaged("it is in use while it is to be read; please report this".into()));
        };
        let bytes = filling.bytes(record.bytes as usize);
        if bytes.len() != record.bytes as usize {
            return Err(Failure::Damaged("it is larger than the header says of any page".into()));
        }
        let is_packed = self.flags.has(Flags::PACKED);
        let stored = match is_packed {
            true => {
                packed.resize(record.stored_bytes as usize, 0);
                packed.as_mut_slice()
            }
            false => &mut *bytes,
        };
        read_at(&self.file, stored, record.offset).map_err(|error| match error.kind() {
            io::ErrorKind::UnexpectedEof => Failure::Damaged("cut short while in use".into()),
            kind => Failure::Read(kind, error.raw_os_error()),
        })?;
        if checksum(stored) != record.checksum {
            return Err(Failure::Damaged("its checksum is wrong".into()));
        }
        if is_packed {
            unpack_into(packed, bytes).map_err(Failure::Damaged)?;
        }
        if !known {
            let id = PageId(page);
            validate_page(bytes, id, record, self.flags, self.materials, self.source_triangles)
                .map_err(Failure::Damaged)?;
        }
        filling.finish();
        Ok(())
    }
}

/// Reads exactly those bytes.
pub(in crate::map) fn read_at(file: &File, bytes: &mut [u8], offset: u64) -> io::Result<()> {
    #[cfg(unix)]
    return std::os::unix::fs::FileExt::read_exact_at(file, bytes, offset);
    #[cfg(windows)]
    {
        let mut done = 0;
        while done < bytes.len() {
            match std::os::windows::fs::FileExt::seek_read(file, &mut bytes[done..], offset + done as u64) {
                Ok(0) => return Err(io::ErrorKind::UnexpectedEof.into()),
                Ok(n) => done += n,
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }
}
