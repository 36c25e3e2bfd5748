//! The top of a file: what lies behind its pages. Each part of it is read and checked when it is first used.
//!
//! The first ray needs the top tree and the bricks' frames (43 bytes a page); materials are needed to shade, page records by nobody but those
//! who go over all pages (what a single page needs of them is read with it). A part that is damaged, or cannot be read, is given as empty,
//! and [`Octree::fault`] says so from then on: no result holds, as with a file that is cut short while it is mapped.

use std::fs::File;
use std::ops::Range;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, Ordering};

use super::failure::{CUT_SHORT, Failure};
use super::{Octree, Pages, cache};
use crate::error::{Error, Result};
use crate::format::{
    Brick, Header, MaterialRecord, Node, PageRecord, SectionKind, checksum, string_at, validate_directory,
    validate_materials, validate_tree,
};

/// A part of the top that is read and checked as one; what is for level of detail stands in `detail.rs`.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Part {
    /// Top nodes and bricks.
    Tree,
    /// Page records.
    Records,
    /// Materials and their strings.
    Materials,
}

impl Part {
    const ALL: [Part; 3] = [Part::Tree, Part::Records, Part::Materials];

    /// The part that a kind of section belongs to.
    fn of(kind: u32) -> Option<Part> {
        match kind {
            1 | 2 => Some(Part::Tree),
            3 => Some(Part::Records),
            4 | 5 => Some(Part::Materials),
            _ => None,
        }
    }

    /// Where it lies in the file.
    fn range(self, header: &Header) -> Range<u64> {
        let sections = || header.sections.iter().filter(|s| Part::of(s.kind) == Some(self));
        let begin = sections().map(|s| s.offset).min().unwrap_or(0);
        begin..sections().map(|s| s.offset + s.bytes).max().unwrap_or(begin)
    }
}

/// The parts of the top, as far as they were used.
#[derive(Default)]
pub(super) struct Parts {
    /// Of each whether it is sound; with its bytes, unless the file is mapped.
    parts: [OnceLock<Result<Box<[Node]>, Failure>>; 3],
    /// Whether one of them is not.
    flawed: AtomicBool,
}

/// Bytes of the top but for level of detail: what a file takes of memory beside its pages.
pub(super) fn bytes_of(header: &Header) -> u64 {
    [Part::Tree, Part::Materials].iter().map(|part| part.range(header)).map(|range| range.end - range.start).sum()
}

/// Where the sections lie, by kind - 1: in the map of the file, or else in the bytes of their parts, and those for level of detail from byte
/// `heads` of the file on.
pub(super) fn section_ranges(header: &Header, mapped: bool, heads: u64) -> [Range<usize>; SectionKind::COUNT] {
    let mut ranges = [const { 0..0 }; SectionKind::COUNT];
    for section in header.sections.iter().filter(|s| s.kind != 0) {
        let base = Part::of(section.kind).map_or(heads, |part| part.range(header).start);
        let start = (section.offset - if mapped { 0 } else { base }) as usize;
        ranges[section.kind as usize - 1] = start..start + section.bytes as usize;
    }
    ranges
}

/// A section's records; none where there are not that many bytes.
#[inline]
pub(super) fn cut<'a, T: bytemuck::Pod>(
    sections: &[Range<usize>; SectionKind::COUNT],
    bytes: &'a [u8],
    kind: SectionKind,
) -> &'a [T] {
    let bytes = bytes.get(sections[kind as usize - 1].clone()).unwrap_or(&[]);
    bytemuck::try_cast_slice(bytes).unwrap_or(&[])
}

/// Reads bytes of a file to a place where records are aligned.
pub(super) fn read_nodes(file: &File, range: Range<u64>) -> Result<Box<[Node]>, Failure> {
    let bytes = usize::try_from(range.end - range.start).unwrap_or(usize::MAX);
    let mut nodes = Vec::new();
    let no_room = |_| Failure::Read(std::io::ErrorKind::OutOfMemory, None);
    nodes.try_reserve_exact(bytes.div_ceil(size_of::<Node>())).map_err(no_room)?;
    nodes.resize(bytes.div_ceil(size_of::<Node>()), Node::EMPTY);
    cache::read_at(file, &mut bytemuck::cast_slice_mut(&mut nodes)[..bytes], range.start)?;
    Ok(nodes.into_boxed_slice())
}

impl Octree {
    /// Top nodes, empty for a file of one page.
    #[inline]
    pub fn top_nodes(&self) -> &[Node] {
        self.section(Part::Tree, SectionKind::TopNodes)
    }

    /// Brick records, one a page.
    #[inline]
    pub fn bricks(&self) -> &[Brick] {
        self.section(Part::Tree, SectionKind::Bricks)
    }

    /// Page records.
    pub fn records(&self) -> &[PageRecord] {
        self.section(Part::Records, SectionKind::Pages)
    }

    /// Materials.
    pub fn materials(&self) -> &[MaterialRecord] {
        self.section(Part::Materials, SectionKind::Materials)
    }

    /// A string that a material names by offset and length.
    pub fn string(&self, place: [u32; 2]) -> &str {
        let strings = std::str::from_utf8(self.section(Part::Materials, SectionKind::Strings));
        strings.ok().and_then(|strings| string_at(strings, place)).unwrap_or("")
    }

    /// An error if a part of the top proved damaged, or the file was cut short or could not be read while it was mapped: what was read
    /// since may be zeros, and no result holds.
    #[inline]
    pub fn fault(&self) -> Result<()> {
        match &self.pages {
            Pages::Mapped(mapped) if mapped.map.faulted() => Err(self.flaw()),
            _ if self.parts.flawed.load(Ordering::Acquire) => Err(self.flaw()),
            _ => Ok(()),
        }
    }

    /// What is wrong.
    #[cold]
    fn flaw(&self) -> Error {
        let lost = match &self.pages {
            Pages::Mapped(mapped) if mapped.map.faulted() => Some(mapped.lost(&self.header)),
            _ => self.parts.parts.iter().find_map(|part| part.get()?.as_ref().err().cloned()),
        };
        lost.unwrap_or_else(|| Failure::Damaged(CUT_SHORT.into())).error(&self.path, None)
    }

    /// A section's records; none if its part is not sound.
    #[inline]
    fn section<T: bytemuck::Pod>(&self, part: Part, kind: SectionKind) -> &[T] {
        let loaded = self.parts.parts[part as usize].get_or_init(|| self.load_part(part));
        let bytes = match (loaded, &self.pages) {
            (Err(_), _) => &[],
            (Ok(_), Pages::Mapped(mapped)) => mapped.map.bytes(),
            (Ok(nodes), Pages::Cached(_)) => bytemuck::cast_slice(nodes),
        };
        cut(&self.sections, bytes, kind)
    }

    /// Reads a part, unless the file is mapped, and checks it.
    #[cold]
    fn load_part(&self, part: Part) -> Result<Box<[Node]>, Failure> {
        let loaded = match &self.pages {
            Pages::Mapped(mapped) => self.check_part(part, mapped.map.bytes()).map(|()| Box::default()),
            Pages::Cached(cache) => read_nodes(cache.file(), part.range(&self.header))
                .and_then(|nodes| self.check_part(part, bytemuck::cast_slice(&nodes)).map(|()| nodes)),
        };
        if loaded.is_err() {
            self.parts.flawed.store(true, Ordering::Release);
        }
        loaded
    }

    /// Checks the structure of a part, then its checksums: structure is found wrong sooner where a file only says that it is large.
    fn check_part(&self, part: Part, bytes: &[u8]) -> Result<(), Failure> {
        let structure = match part {
            Part::Tree => {
                let nodes = cut(&self.sections, bytes, SectionKind::TopNodes);
                validate_tree(&self.header, nodes, cut(&self.sections, bytes, SectionKind::Bricks))
            }
            // Against the bricks, in `check_directory`.
            Part::Records => Ok(()),
            Part::Materials => {
                let materials = cut(&self.sections, bytes, SectionKind::Materials);
                validate_materials(materials, cut(&self.sections, bytes, SectionKind::Strings))
            }
        };
        structure.map_err(Failure::Damaged)?;
        for section in self.header.sections.iter().filter(|s| Part::of(s.kind) == Some(part)) {
            let bytes = bytes.get(self.sections[section.kind as usize - 1].clone()).unwrap_or(&[]);
            if checksum(bytes) != section.checksum {
                return Err(Failure::Damaged(format!("the checksum of section {} is wrong", section.kind)));
            }
        }
        Ok(())
    }

    /// Checks all of the top but for level of detail, and that the directory is whole. For those who go over all pages.
    pub(crate) fn check_top(&self) -> Result<()> {
        for part in Part::ALL {
            self.parts.parts[part as usize].get_or_init(|| self.load_part(part));
        }
        self.fault()?;
        validate_directory(&self.header, self.records(), self.bricks()).map_err(|what| self.damaged(None, what))
    }
}

#[cfg(test)]
mod tests;
