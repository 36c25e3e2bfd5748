//! The opened octree file: header and top at once, pages when they are first used.
//!
//! There are two ways to read one ([`Read`]), with the same answers. *Mapped*, the file's bytes are used where they lie in the system's
//! page cache (`mapped.rs`). *Budgeted*, pages are read, and unpacked, into a cache of a given size by threads of their own
//! (`cache/`), so that no more memory is taken whatever the file's size. Pages are used through a [`Visit`], which gives a page
//! or says that it is not in memory; [`Octree::with_page`] waits for one.
//!
//! Opening reads and checks header and top: some 75 bytes a page, a few thousandths of a file. A page's checksum and structure are checked
//! when it is first used, its checksum whenever it is read again. [`Octree::verify`] checks all of it. A file cut short while it is mapped
//! reads as zeros from there on (`mmap.rs`), and [`Octree::fault`] says so: ask it before trusting what was read.

mod cache;
mod detail;
mod mapped;
mod mmap;
mod page;
#[cfg(test)]
mod sample;
mod survey;
#[cfg(test)]
mod tests;
mod verify;
mod visit;

use std::fs::File;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use glam::{DVec3, Vec3};

use crate::error::{Error, Result};
use crate::format::{
    Brick, Flags, HEADER_BYTES, Header, LeafUnit, MaterialRecord, Node, PageId, PageRecord, Refusal, SectionKind,
    TopView, checksum, read_header, string_at, validate_top,
};
use crate::geometry::{Aabb, RootCube};
use cache::Cache;
use mapped::Mapped;
use mmap::Mapping;

pub(crate) use cache::Ticket;
pub use detail::Detail;
pub use page::Page;
pub use survey::Parts;
pub use visit::{Halt, Visit};

/// How a file's pages come into memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Read {
    /// Used where the system maps them; memory is the system's care. Not for packed files.
    Mapped,
    /// Read into a cache that takes at most so many bytes for pages; [`Octree::least_cache`] at least.
    Budgeted {
        /// Bytes of memory for pages.
        cache: u64,
    },
}

/// What was read of a file so far.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Figures {
    /// Pages of the file.
    pub total: u64,
    /// Different pages that were used.
    pub touched: u64,
    /// Their bytes as they are stored.
    pub bytes_touched: u64,
    /// Pages read, and of these those that had been read before.
    pub read: u64,
    /// Pages read again, as they had been evicted.
    pub reread: u64,
    /// Bytes read of pages.
    pub bytes_read: u64,
    /// How often a page was entered that was there; 0 for a mapped file, where that is not counted.
    pub entered: u64,
    /// How often a thread had nothing to do but to wait for a page.
    pub stalls: u64,
    /// For how long in all, seconds.
    pub stalled_seconds: f64,
    /// The most memory that pages took at a time, bytes; 0 for a mapped file.
    pub most_bytes: u64,
}

/// An octree file, opened. Cheap to open: header and top are checked; a page is checked when it is first used.
pub struct Octree {
    path: PathBuf,
    header: Header,
    /// Where the sections lie, by kind - 1, in the map or in `top`; empty for those the file has not.
    sections: [Range<usize>; SectionKind::COUNT],
    /// Whether what is for level of detail is sound, once that was asked.
    detail: OnceLock<Result<(), String>>,
    /// What follows the pages, but for level of detail; empty for a mapped file.
    top: Box<[Node]>,
    /// The sections for level of detail, once they were used; never for a mapped file.
    heads: OnceLock<Box<[Node]>>,
    pages: Pages,
}

enum Pages {
    Mapped(Mapped),
    Cached(Cache),
}

impl Octree {
    /// Opens a file: mapped, or a packed one with a cache of half of the memory that is free.
    ///
    /// Errors: a missing file, another kind of file or a newer version (input), a damaged one, or the system's.
    pub fn open(path: &Path) -> Result<Octree> {
        Octree::open_as(path, None)
    }

    /// Opens a file to be read in the given way.
    ///
    /// Errors: as [`Octree::open`]; a packed file that is to be mapped, or a cache that the largest page does not fit in.
    pub fn open_with(path: &Path, read: Read) -> Result<Octree> {
        Octree::open_as(path, Some(read))
    }

    /// The least cache that a file can be read with: one page, the largest, in memory.
    ///
    /// Errors: as [`Octree::open`].
    pub fn least_cache(path: &Path) -> Result<u64> {
        let (_, header) = head(path)?;
        Ok(least_cache(&header))
    }

    /// What [`Octree::least_cache`] says of this file.
    pub fn least(&self) -> u64 {
        least_cache(&self.header)
    }

    /// The header of a file, read by itself. Errors: as [`Octree::open`].
    pub fn header_of(path: &Path) -> Result<Header> {
        head(path).map(|x| x.1)
    }

    fn open_as(path: &Path, read: Option<Read>) -> Result<Octree> {
        let (file, header) = head(path)?;
        let read = read.unwrap_or_else(|| match header.flags.has(Flags::PACKED) {
            true => Read::Budgeted { cache: least_cache(&header).max(free_memory() / 2) },
            false => Read::Mapped,
        });
        let octree = match read {
            Read::Mapped => Octree::map(path, &file, header)?,
            Read::Budgeted { cache } => Octree::read(path, file, header, cache)?,
        };
        octree.fault()?;
        Ok(octree)
    }

    /// Maps a file.
    fn map(path: &Path, file: &File, header: Header) -> Result<Octree> {
        if header.flags.has(Flags::PACKED) {
            let what = "its pages are packed, so it cannot be mapped; read it within a budget of memory";
            return Err(Error::Input { file: path.to_owned(), what: what.into() });
        }
        let map = Mapping::new(file).map_err(Error::io(path, "map"))?;
        let sections =
            section_ranges(&header, map.bytes(), 0, None).map_err(|what| Error::damaged(path, None, what))?;
        let pages = Pages::Mapped(Mapped::new(map, header.pages));
        let (top, heads, detail) = (Box::default(), OnceLock::new(), OnceLock::new());
        let octree = Octree { path: path.to_owned(), header, sections, detail, top, heads, pages };
        validate_top(&octree.header, &octree.top()).map_err(|what| octree.damaged(None, what))?;
        Ok(octree)
    }

    /// Reads a file's top, and makes a cache for its pages.
    fn read(path: &Path, file: File, header: Header, budget: u64) -> Result<Octree> {
        let least = least_cache(&header);
        if budget < least {
            let what = format!(
                "its largest page needs {least} bytes of memory, but pages may take {budget} in all; allow more (--memory)"
            );
            return Err(Error::Input { file: path.to_owned(), what });
        }
        let begin = header.sections[0].offset;
        let heads = heads_at(&header);
        let bytes = (heads.unwrap_or(header.file_bytes) - begin) as usize;
        let mut top = vec![Node::EMPTY; bytes.div_ceil(size_of::<Node>())].into_boxed_slice();
        let damaged = |what: String| Error::damaged(path, None, what);
        cache::read_at(&file, &mut bytemuck::cast_slice_mut(&mut top)[..bytes], begin).map_err(|error| match error
            .kind()
        {
            std::io::ErrorKind::UnexpectedEof => damaged("cut short while in use".into()),
            _ => Error::io(path, "read")(error),
        })?;
        let sections = section_ranges(&header, bytemuck::cast_slice(&top), begin, heads).map_err(damaged)?;
        let view = top_view(&sections, bytemuck::cast_slice(&top));
        validate_top(&header, &view).map_err(damaged)?;
        let records = view.records;
        let cache = Cache::new(path.to_owned(), file, &header, records, budget);
        let pages = Pages::Cached(cache.map_err(Error::io(path, "make room for the pages of"))?);
        let (heads, detail) = (OnceLock::new(), OnceLock::new());
        Ok(Octree { path: path.to_owned(), header, sections, detail, top, heads, pages })
    }

    /// Lets pages take so many bytes of memory from now on, at least what [`Octree::least_cache`] says. Nothing for a mapped file.
    pub fn set_cache(&self, bytes: u64) {
        if let Pages::Cached(cache) = &self.pages {
            cache.set_budget(bytes.max(least_cache(&self.header)));
        }
    }

    /// Whether pages are read into a cache.
    #[inline]
    pub fn is_budgeted(&self) -> bool {
        matches!(self.pages, Pages::Cached(_))
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

    /// Uses a page; waits for it if it is not in memory.
    ///
    /// Errors: a page that is damaged, or cannot be read.
    pub fn with_page<T>(&self, id: PageId, mut read: impl FnMut(Page<'_>) -> T) -> Result<T> {
        if let Some(outcome) = self.if_there(id, &mut read)? {
            return Ok(outcome);
        }
        loop {
            let ticket = self.ask(id, 1);
            self.wait(std::iter::once(&ticket));
            ticket.check()?;
            if let Some(outcome) = self.if_there(id, &mut read)? {
                return Ok(outcome);
            }
        }
    }

    /// Uses a page if it is in memory.
    fn if_there<T>(&self, id: PageId, read: &mut impl FnMut(Page<'_>) -> T) -> Result<Option<T>> {
        match self.visit().page(id) {
            Ok(page) => Ok(Some(read(page))),
            Err(Halt::Absent(_)) => Ok(None),
            Err(Halt::Failed(error)) => Err(error),
        }
    }

    /// Asks for an absent page that so many rays need. Only of a file whose pages are cached.
    pub(crate) fn ask(&self, id: PageId, rays: u64) -> Ticket<'_> {
        match &self.pages {
            Pages::Cached(cache) => cache.ask(id.0, rays),
            Pages::Mapped(_) => unreachable!("pages of a mapped file are never absent"),
        }
    }

    /// Waits until one of the pages asked for has come, or cannot be had.
    pub(crate) fn wait<'t>(&self, tickets: impl Iterator<Item = &'t Ticket<'t>> + Clone) {
        if let Pages::Cached(cache) = &self.pages {
            cache.wait(tickets);
        }
    }

    /// What was read so far.
    pub fn figures(&self) -> Figures {
        let mapped = match &self.pages {
            Pages::Cached(cache) => return cache.figures(),
            Pages::Mapped(mapped) => mapped,
        };
        // A page is read once, when it is checked.
        let (touched, bytes) = mapped.used(self).fold((0, 0), |(n, sum), r| (n + 1, sum + u64::from(r.stored_bytes)));
        Figures {
            total: self.header.pages.into(),
            touched,
            bytes_touched: bytes,
            read: touched,
            bytes_read: bytes,
            ..Figures::default()
        }
    }

    /// An error if the file was cut short while it was mapped: what was read since may be zeros, and no result holds.
    #[inline]
    pub fn fault(&self) -> Result<()> {
        match &self.pages {
            Pages::Mapped(mapped) if mapped.map.faulted() => Err(self.damaged(None, "cut short while in use".into())),
            _ => Ok(()),
        }
    }

    /// The error for a page number beyond the last, or for a top that turned to zeros.
    fn no_page(&self, id: PageId) -> Error {
        self.fault().err().unwrap_or_else(|| self.damaged(Some(id.0), "there is no such page".into()))
    }

    /// A section's records.
    #[inline]
    fn section<T: bytemuck::Pod>(&self, kind: SectionKind) -> &[T] {
        let bytes = match &self.pages {
            Pages::Mapped(mapped) => mapped.map.bytes(),
            Pages::Cached(_) => bytemuck::cast_slice(&self.top),
        };
        cut(&self.sections, bytes, kind)
    }

    /// What the ranges of the sections for level of detail count from; read from the file when it is first used, unless that is mapped.
    fn heads_bytes(&self) -> Result<&[u8]> {
        let cache = match &self.pages {
            Pages::Mapped(mapped) => return Ok(mapped.map.bytes()),
            Pages::Cached(cache) => cache,
        };
        if let Some(heads) = self.heads.get() {
            return Ok(bytemuck::cast_slice(heads));
        }
        let begin = heads_at(&self.header).unwrap_or(self.header.file_bytes);
        let bytes = (self.header.file_bytes - begin) as usize;
        let mut heads = vec![Node::EMPTY; bytes.div_ceil(size_of::<Node>())].into_boxed_slice();
        cache
            .read_at(&mut bytemuck::cast_slice_mut(&mut heads)[..bytes], begin)
            .map_err(Error::io(&self.path, "read"))?;
        Ok(bytemuck::cast_slice(self.heads.get_or_init(|| heads)))
    }

    /// The bytes from one place of the file to another, of no page.
    fn gap(&self, range: Range<u64>) -> Result<Vec<u8>> {
        match &self.pages {
            Pages::Mapped(mapped) => {
                Ok(mapped.map.bytes().get(range.start as usize..range.end as usize).unwrap_or(&[]).to_vec())
            }
            Pages::Cached(cache) => {
                let mut bytes = vec![0; range.end.saturating_sub(range.start) as usize];
                cache.read_at(&mut bytes, range.start).map_err(Error::io(&self.path, "read"))?;
                Ok(bytes)
            }
        }
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

/// The file and its header, checked by itself.
fn head(path: &Path) -> Result<(File, Header)> {
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
    let mut bytes = vec![0; length.min(HEADER_BYTES as u64) as usize];
    cache::read_at(&file, &mut bytes, 0).map_err(Error::io(path, "read"))?;
    let header = read_header(&bytes, length).map_err(|refusal| match refusal {
        Refusal::Foreign(what) => foreign(&what),
        Refusal::Damaged(what) => Error::damaged(path, None, what),
    })?;
    Ok((file, header))
}

/// Where the sections for level of detail begin, if there are any: after all others.
fn heads_at(header: &Header) -> Option<u64> {
    header.sections.iter().filter(|s| s.kind >= SectionKind::Heads as u32).map(|s| s.offset).min()
}

/// Bytes of memory that one page takes at most.
fn least_cache(header: &Header) -> u64 {
    u64::from(header.largest_page).next_multiple_of(mmap::machine_page() as u64)
}

/// Where the sections lie, by kind - 1, in `bytes`, which begin at byte `begin` of the file; the checksums of those that are always used
/// verified. What is for level of detail is checked when it is first used; if it is read by itself, from byte `heads` on, that is what its ranges
/// count from.
fn section_ranges(
    header: &Header,
    bytes: &[u8],
    begin: u64,
    heads: Option<u64>,
) -> Result<[Range<usize>; SectionKind::COUNT], String> {
    let mut ranges = [const { 0..0 }; SectionKind::COUNT];
    for section in header.sections.iter().filter(|s| s.kind != 0) {
        let late = section.kind >= SectionKind::Heads as u32;
        let from = heads.filter(|_| late).unwrap_or(begin);
        let start = section.offset.checked_sub(from).ok_or("a section lies before the first")? as usize;
        let range = start..start + section.bytes as usize;
        if !(late && heads.is_some()) {
            let bytes = bytes.get(range.clone()).ok_or("a section reaches beyond the end of the file")?;
            if !late && checksum(bytes) != section.checksum {
                return Err(format!("the checksum of section {} is wrong", section.kind));
            }
        }
        ranges[section.kind as usize - 1] = range;
    }
    Ok(ranges)
}

/// A section's records.
#[inline]
fn cut<'a, T: bytemuck::Pod>(
    sections: &[Range<usize>; SectionKind::COUNT],
    bytes: &'a [u8],
    kind: SectionKind,
) -> &'a [T] {
    bytemuck::try_cast_slice(&bytes[sections[kind as usize - 1].clone()]).unwrap_or(&[])
}

/// The whole top, in `bytes`.
fn top_view<'a>(sections: &[Range<usize>; SectionKind::COUNT], bytes: &'a [u8]) -> TopView<'a> {
    TopView {
        nodes: cut(sections, bytes, SectionKind::TopNodes),
        bricks: cut(sections, bytes, SectionKind::Bricks),
        records: cut(sections, bytes, SectionKind::Pages),
        materials: cut(sections, bytes, SectionKind::Materials),
        strings: cut(sections, bytes, SectionKind::Strings),
    }
}

/// Bytes of memory that are free; some where the system does not tell.
fn free_memory() -> u64 {
    let text = std::fs::read_to_string("/proc/meminfo").unwrap_or_default();
    let line = text.lines().find_map(|line| line.strip_prefix("MemAvailable:"));
    let kib = line.and_then(|line| line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok());
    kib.map_or(2 << 30, |kib| kib << 10)
}
