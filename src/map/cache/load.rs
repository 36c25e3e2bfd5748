//! The threads that read, unpack and check pages.

use std::fs::File;
use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::Duration;

use super::desk::{Loaded, Task};
use super::{Core, Failure};
use crate::format::{
    Brick, Flags, PageId, PageRecord, SectionKind, checksum, unpack_into, validate_entry, validate_page,
};

/// How long a loader waits before it looks again whether visits have ended.
const PAUSE: Duration = Duration::from_micros(100);

impl Core {
    /// Loads pages until the cache is dropped.
    pub(super) fn load_all(&self) {
        let mut desk = self.desk();
        while !desk.stop {
            let page = match desk.next(self) {
                Task::Load(page) => page,
                // Nobody tells of the ends of visits, so one loader looks; the others are told when there is something to do.
                Task::Wait if !desk.looking => {
                    desk.looking = true;
                    desk = match self.work.wait_timeout(desk, PAUSE) {
                        Ok((desk, _)) => desk,
                        Err(poison) => poison.into_inner().0,
                    };
                    desk.looking = false;
                    continue;
                }
                Task::Wait | Task::Nothing => {
                    desk = self.work.wait(desk).unwrap_or_else(|poison| poison.into_inner());
                    continue;
                }
            };
            if desk.is_asked() {
                self.work.notify_one();
            }
            drop(desk);
            // Whoever waits for the page must be told, whatever happens here.
            let outcome = catch_unwind(AssertUnwindSafe(|| self.load(page)));
            let broken = |_| Err(Failure::Damaged("checking it failed; please report this".into()));
            let outcome = outcome.unwrap_or_else(broken);
            desk = self.desk();
            match outcome {
                Ok(loaded) => desk.loaded(self, page, loaded),
                Err(failure) => desk.lost(self, page, failure),
            }
            self.came.notify_all();
        }
    }

    /// Reads a page to its place and checks it.
    fn load(&self, page: u32) -> Result<Loaded, Failure> {
        let i = page as usize;
        #[cfg(test)]
        assert!(self.trap.load(std::sync::atomic::Ordering::Relaxed) != page + 1, "a trap for tests");
        let known = self.arena.length(i).is_some();
        let record = self.record(i, known)?;
        let Some(mut filling) = self.arena.fill(i) else {
            return Err(Failure::Damaged("it is in use while it is to be read; please report this".into()));
        };
        let bytes = filling.bytes(record.bytes as usize);
        if bytes.len() != record.bytes as usize {
            return Err(Failure::Damaged("it is larger than the header says of any page".into()));
        }
        if self.header.flags.has(Flags::PACKED) {
            let mut packed = vec![0; record.stored_bytes as usize];
            self.read_stored(&record, &mut packed)?;
            unpack_into(&packed, bytes).map_err(Failure::Damaged)?;
        } else {
            self.read_stored(&record, bytes)?;
        }
        if !known {
            let (id, h) = (PageId(page), &self.header);
            validate_page(bytes, id, &record, h.flags, h.materials, h.source_triangles).map_err(Failure::Damaged)?;
        }
        filling.finish(record.bytes);
        Ok(Loaded { stored: record.stored_bytes, again: known })
    }

    /// What the directory says of a page, read from the file; checked if that is not known.
    fn record(&self, i: usize, known: bool) -> Result<PageRecord, Failure> {
        let first = i.saturating_sub(usize::from(!known));
        let mut records: [PageRecord; 2] = bytemuck::Zeroable::zeroed();
        let records = &mut records[..=i - first];
        self.read_section(SectionKind::Pages, 32 * first as u64, bytemuck::cast_slice_mut(records))?;
        if !known {
            let mut bricks: [Brick; 2] = bytemuck::Zeroable::zeroed();
            let bricks = &mut bricks[..=i - first];
            self.read_section(SectionKind::Bricks, 32 * first as u64, bytemuck::cast_slice_mut(bricks))?;
            let mut entries = records.iter().zip(&*bricks);
            let before = if first < i { entries.next() } else { None };
            let entry = entries.next().ok_or_else(|| Failure::Damaged("there is no such page".into()))?;
            validate_entry(&self.header, i, before, entry).map_err(Failure::Damaged)?;
        }
        records.last().copied().ok_or_else(|| Failure::Damaged("there is no such page".into()))
    }

    /// Reads bytes of a section, from so many on.
    fn read_section(&self, kind: SectionKind, from: u64, bytes: &mut [u8]) -> Result<(), Failure> {
        let section = self.header.section(kind).filter(|s| from + bytes.len() as u64 <= s.bytes);
        let section = section.ok_or_else(|| Failure::Damaged("there is no such page".into()))?;
        Ok(read_at(&self.file, bytes, section.offset + from)?)
    }

    /// Reads a page as it is stored.
    fn read_stored(&self, record: &PageRecord, bytes: &mut [u8]) -> Result<(), Failure> {
        read_at(&self.file, bytes, record.offset)?;
        match checksum(bytes) == record.checksum {
            true => Ok(()),
            false => Err(Failure::Damaged("its checksum is wrong".into())),
        }
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
