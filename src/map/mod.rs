//! The opened octree file: header and top at once, pages when they are first used.
//!
//! [`Octree::open`] maps the file and checks header and top, which takes time by the count of pages, not by their
//! size. [`Octree::page`] checks a page's checksum and structure when it is first asked for and remembers that it is
//! sound; a page of a packed file is unpacked then, and kept. [`Octree::verify`] checks all of it. A file cut short while it is mapped reads as zeros from there on
//! (`mmap.rs`), and [`Octree::fault`] says so: ask it before trusting what was read.

mod detail;
mod mmap;
mod page;
#[cfg(test)]
mod sample;
mod survey;
#[cfg(test)]
mod tests;
mod verify;

use std::fs::File;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, Ordering};

use glam::{DVec3, Vec3};

use crate::error::{Error, Result};
use crate::format::{
    Brick, Flags, Header, LeafUnit, MaterialRecord, Node, PageId, PageRecord, Refusal, SectionKind, TopView, checksum,
    read_header, string_at, unpack, validate_page, validate_top,
};
use crate::geometry::{Aabb, RootCube};
use mmap::Mapping;

pub use detail::Detail;
pub use page::Page;
pub use survey::Parts;

/// An octree file, opened. Cheap to open: header and top are checked; a page is checked when it is first used.
pub struct Octree {
    path: PathBuf,
    map: Mapping,
    header: Header,
    /// Where the sections lie in the map, by kind - 1; empty for those the file has not.
    sections: [Range<usize>; SectionKind::COUNT],
    /// Whether what is for level of detail is sound, once that was asked.
    detail: OnceLock<Result<(), String>>,
    /// Which pages were checked and found sound.
    sound: Box<[AtomicBool]>,
    /// The pages of a packed file, each unpacked when it is first used; empty for one that is not packed.
    unpacked: Box<[OnceLock<Box<[Node]>>]>,
}

impl Octree {
    /// Opens a file: maps it, checks header and top.
    ///
    /// Errors: a missing file, another kind of file or a newer version (input), a damaged one, or the system's.
    pub fn open(path: &Path) -> Result<Octree> {
        let foreign = |what: &str| Error::Input { file: path.to_owned(), what: what.into() };
        let metadata = std::fs::metadata(path).map_err(Error::io(path, "open"))?;
        if !metadata.is_file() {
            return Err(foreign("not an ordinary file; name an octree file (build one with octbuild)"));
        }
        let file = File::open(path).map_err(Error::io(path, "open"))?;
        let length = file.metadata().map_err(Error::io(path, "open"))?.len();
        if length == 0 {
            return Err(foreign("an empty file, not an octree file (build one with octbuild)"));
        }
        let map = Mapping::new(&file).map_err(Error::io(path, "map"))?;
        let header = read_header(map.bytes(), map.bytes().len() as u64).map_err(|refusal| match refusal {
            Refusal::Foreign(what) => foreign(&what),
            Refusal::Damaged(what) => Error::damaged(path, None, what),
        })?;
        let sections = section_ranges(&header, map.bytes()).map_err(|what| Error::damaged(path, None, what))?;
        let sound = (0..header.pages).map(|_| AtomicBool::new(false)).collect();
        let packed = if header.flags.has(Flags::PACKED) { header.pages } else { 0 };
        let unpacked = (0..packed).map(|_| OnceLock::new()).collect();
        let detail = OnceLock::new();
        let octree = Octree { path: path.to_owned(), map, header, sections, detail, sound, unpacked };
        validate_top(&octree.header, &octree.top()).map_err(|what| octree.damaged(None, what))?;
        octree.fault()?;
        Ok(octree)
    }

    /// The header.
    pub fn header(&self) -> &Header {
        &self.header
    }

    /// The file's path as it was given.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The flags.
    #[inline]
    pub fn flags(&self) -> Flags {
        self.header.flags
    }

    /// The unit of leaf offsets.
    #[inline]
    pub fn leaf_unit(&self) -> LeafUnit {
        self.header.flags.leaf_unit()
    }

    /// The root cube.
    pub fn root(&self) -> RootCube {
        RootCube { corner: DVec3::from_array(self.header.root_corner), log2_side: self.header.root_log2_side }
    }

    /// Bounds of all stored triangles.
    pub fn bounds(&self) -> Aabb {
        Aabb { min: Vec3::from_array(self.header.bounds_min), max: Vec3::from_array(self.header.bounds_max) }
    }

    /// Top nodes, empty for a file of one page.
    #[inline]
    pub fn top_nodes(&self) -> &[Node] {
        self.section(SectionKind::TopNodes)
    }

    /// Brick records, one a page.
    #[inline]
    pub fn bricks(&self) -> &[Brick] {
        self.section(SectionKind::Bricks)
    }

    /// Page records.
    #[inline]
    pub fn records(&self) -> &[PageRecord] {
        self.section(SectionKind::Pages)
    }

    /// Materials.
    pub fn materials(&self) -> &[MaterialRecord] {
        self.section(SectionKind::Materials)
    }

    /// A string that a material names by offset and length.
    pub fn string(&self, place: [u32; 2]) -> &str {
        let strings = std::str::from_utf8(self.section(SectionKind::Strings));
        strings.ok().and_then(|strings| string_at(strings, place)).unwrap_or("")
    }

    /// A page; checked (checksum and structure) at its first use.
    ///
    /// Several threads may check the same page at once, to the same end. A page that fails does so at every use.
    #[inline(always)]
    pub fn page(&self, id: PageId) -> Result<Page<'_>> {
        let i = id.0 as usize;
        if self.sound.get(i).is_some_and(|sound| sound.load(Ordering::Acquire)) {
            let (Some(record), Some(brick)) = (self.records().get(i), self.bricks().get(i)) else {
                return Err(self.no_page(id));
            };
            return Ok(Page::new(self.page_bytes(i, record), brick, self.header.flags));
        }
        self.check_page(id)
    }

    /// The records of the pages that were used so far, and found sound.
    pub fn used(&self) -> impl Iterator<Item = &PageRecord> {
        let sound = self.sound.iter().map(|sound| sound.load(Ordering::Relaxed));
        self.records().iter().zip(sound).filter_map(|(record, sound)| sound.then_some(record))
    }

    /// An error if the file was cut short while it was in use: what was read since may be zeros, and no result holds.
    #[inline]
    pub fn fault(&self) -> Result<()> {
        if self.map.faulted() { Err(self.damaged(None, "cut short while in use".into())) } else { Ok(()) }
    }

    /// Checks a page and remembers that it is sound.
    #[cold]
    fn check_page(&self, id: PageId) -> Result<Page<'_>> {
        let i = id.0 as usize;
        let (Some(record), Some(brick)) = (self.records().get(i), self.bricks().get(i)) else {
            return Err(self.no_page(id));
        };
        let Header { flags, materials, source_triangles, .. } = self.header;
        let stored = self.stored_bytes(record);
        let outcome = match checksum(stored) == record.checksum {
            true => self
                .unpack(i, stored, record)
                .and_then(|bytes| validate_page(bytes, id, record, flags, materials, source_triangles).map(|_| bytes)),
            false => Err("its checksum is wrong".into()),
        };
        // Zeros in place of lost bytes fail the checks; say what really happened.
        self.fault()?;
        let bytes = outcome.map_err(|what| self.damaged(Some(id.0), what))?;
        self.sound[i].store(true, Ordering::Release);
        Ok(Page::new(bytes, brick, flags))
    }

    /// The error for a page number beyond the last, or for a top that turned to zeros.
    fn no_page(&self, id: PageId) -> Error {
        self.fault().err().unwrap_or_else(|| self.damaged(Some(id.0), "there is no such page".into()))
    }

    /// A page's bytes as they are stored; empty if the record is not as it was when it was checked.
    #[inline]
    fn stored_bytes(&self, record: &PageRecord) -> &[u8] {
        let begin = record.offset as usize;
        self.map.bytes().get(begin..begin.saturating_add(record.stored_bytes as usize)).unwrap_or(&[])
    }

    /// The bytes of a page that was used before.
    #[inline]
    fn page_bytes(&self, i: usize, record: &PageRecord) -> &[u8] {
        match self.unpacked.get(i) {
            Some(page) => page.get().map_or(&[], |nodes| bytemuck::cast_slice(nodes)),
            None => self.stored_bytes(record),
        }
    }

    /// The bytes of a page whose checksum is right; those of a packed one stay in memory.
    fn unpack<'s>(&'s self, i: usize, stored: &'s [u8], record: &PageRecord) -> Result<&'s [u8], String> {
        let Some(page) = self.unpacked.get(i) else { return Ok(stored) };
        let nodes = match page.get() {
            Some(nodes) => nodes,
            None => {
                let nodes = unpack(stored, record.bytes)?;
                page.get_or_init(|| nodes)
            }
        };
        Ok(bytemuck::cast_slice(nodes))
    }

    /// A section's records.
    #[inline]
    fn section<T: bytemuck::Pod>(&self, kind: SectionKind) -> &[T] {
        let bytes = &self.map.bytes()[self.sections[kind as usize - 1].clone()];
        bytemuck::try_cast_slice(bytes).unwrap_or(&[])
    }

    /// The whole top.
    fn top(&self) -> TopView<'_> {
        TopView {
            nodes: self.top_nodes(),
            bricks: self.bricks(),
            records: self.records(),
            materials: self.materials(),
            strings: self.section(SectionKind::Strings),
        }
    }

    /// A damage of this file.
    fn damaged(&self, page: Option<u32>, what: String) -> Error {
        Error::damaged(&self.path, page, what)
    }
}

/// Where the sections lie in memory, by kind - 1, the checksums of those that are always used verified.
fn section_ranges(header: &Header, file: &[u8]) -> Result<[Range<usize>; SectionKind::COUNT], String> {
    let mut ranges = [const { 0..0 }; SectionKind::COUNT];
    for section in header.sections.iter().filter(|s| s.kind != 0) {
        let range = section.offset as usize..(section.offset + section.bytes) as usize;
        let bytes = file.get(range.clone()).ok_or("a section reaches beyond the end of the file")?;
        // What is for level of detail grows with the file and is checked when it is first used.
        if section.kind < SectionKind::Heads as u32 && checksum(bytes) != section.checksum {
            return Err(format!("the checksum of section {} is wrong", section.kind));
        }
        ranges[section.kind as usize - 1] = range;
    }
    Ok(ranges)
}
