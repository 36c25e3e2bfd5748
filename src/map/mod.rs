//! The opened octree file: its header at once, all else when it is first used.
//!
//! There are two ways to read one ([`Read`]), with the same answers. *Mapped*, the file's bytes are used where they lie in the system's
//! page cache (`mapped.rs`). *Budgeted*, pages are read, and unpacked, into a cache of a given size by threads of their own
//! (`cache/`), so that no more memory is taken whatever the file's size. Pages are used through a [`Visit`], which gives a page
//! or says that it is not in memory; [`Octree::with_page`] waits for one.
//!
//! Opening reads and checks the header, 4 KiB, whatever the file's size. The tree above the pages is checked when the first visit begins (`top.rs`),
//! a page's entry in the directory, its checksum and structure when it is first used, its checksum whenever it is read again.
//! [`Octree::verify`] checks all of it. A file cut short while it is mapped reads as zeros from there on (`mmap.rs`), a damaged part of the top
//! as nothing, and [`Octree::fault`] says so: ask it before trusting what was read.

mod cache;
mod detail;
mod failure;
mod mapped;
mod memory;
mod mmap;
mod page;
#[cfg(test)]
mod sample;
mod survey;
#[cfg(test)]
mod tests;
mod top;
mod verify;
mod visit;

use std::fs::File;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use glam::{DVec3, Vec3};

use crate::error::{Error, Result};
use crate::format::{Flags, HEADER_BYTES, Header, LeafUnit, Node, PageId, Refusal, SectionKind, read_header};
use crate::geometry::{Aabb, RootCube};
use cache::Cache;
use mapped::Mapped;
use top::{cut, section_ranges};

pub(crate) use cache::Ticket;
pub use detail::Detail;
pub use memory::{free_memory, half_of_free_memory};
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

/// An octree file, opened. Cheap to open: only its header is checked; all else is when it is first used.
pub struct Octree {
    path: PathBuf,
    header: Header,
    /// Where the sections lie, by kind - 1, in the map or in the part of the top that was read; empty for those the file has not.
    sections: [Range<usize>; SectionKind::COUNT],
    /// Whether what is for level of detail is sound, once that was asked.
    detail: OnceLock<Result<(), String>>,
    /// What follows the pages, but for level of detail.
    parts: top::Parts,
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
    /// Errors: a missing file, another kind of file or a newer version (input), a damaged header, or the system's. Damage elsewhere is told when
    /// it is met.
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
        Ok(Octree::least_of(&Octree::header_of(path)?))
    }

    /// What [`Octree::least_cache`] says of this file.
    pub fn least(&self) -> u64 {
        Octree::least_of(&self.header)
    }

    /// The same of a file with that header: bytes of memory that one page takes at most.
    pub fn least_of(header: &Header) -> u64 {
        u64::from(header.largest_page).next_multiple_of(mmap::machine_page() as u64)
    }

    /// The header of a file, read by itself. Errors: as [`Octree::open`].
    pub fn header_of(path: &Path) -> Result<Header> {
        head(path).map(|x| x.1)
    }

    fn open_as(path: &Path, read: Option<Read>) -> Result<Octree> {
        let (file, header) = head(path)?;
        let read = read.unwrap_or_else(|| match header.flags.has(Flags::PACKED) {
            true => Read::Budgeted { cache: Octree::least_of(&header).max(half_of_free_memory()) },
            false => Read::Mapped,
        });
        let refused = |what: String| Err(Error::Input { file: path.to_owned(), what });
        let pages = match read {
            Read::Mapped if header.flags.has(Flags::PACKED) => {
                return refused(
                    "its pages are packed, so it cannot be mapped; read it within a budget of memory".into(),
                );
            }
            Read::Mapped => Pages::Mapped(Mapped::new(file, &header).map_err(Error::io(path, "map"))?),
            Read::Budgeted { cache } if cache < Octree::least_of(&header) => {
                let least = Octree::least_of(&header);
                return refused(format!(
                    "its largest page needs {least} bytes of memory, but pages may take {cache} in all; allow more (--memory)"
                ));
            }
            Read::Budgeted { cache } => {
                let cache = Cache::new(path.to_owned(), file, &header, cache);
                Pages::Cached(cache.map_err(Error::io(path, "make room for the pages of"))?)
            }
        };
        let heads = heads_at(&header).unwrap_or(header.file_bytes);
        let sections = section_ranges(&header, matches!(pages, Pages::Mapped(_)), heads);
        let (heads, detail, parts) = (OnceLock::new(), OnceLock::new(), top::Parts::default());
        Ok(Octree { path: path.to_owned(), header, sections, detail, parts, heads, pages })
    }

    /// Memory that reading a file within a budget takes beside the cache, bytes at most: what of its top is used, and what unpacks pages.
    pub fn beside_cache(header: &Header) -> u64 {
        // What is noted of a page once it was used.
        const NOTES: u64 = 16;
        top::bytes_of(header) + cache::unpacking(header) + NOTES * u64::from(header.pages)
    }

    /// Lets pages take so many bytes of memory from now on, at least what [`Octree::least_cache`] says. Nothing for a mapped file.
    pub fn set_cache(&self, bytes: u64) {
        if let Pages::Cached(cache) = &self.pages {
            cache.set_budget(bytes.max(self.least()));
        }
    }

    /// Evicts all pages that nobody is using, so that what follows begins with nothing in memory. Nothing for a mapped file.
    pub fn forget(&self) {
        if let Pages::Cached(cache) = &self.pages {
            cache.forget();
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
        match &self.pages {
            Pages::Cached(cache) => cache.figures(),
            Pages::Mapped(mapped) => mapped.figures(&self.header),
        }
    }

    /// The error for a page number beyond the last, or for a top that turned to zeros.
    fn no_page(&self, id: PageId) -> Error {
        self.fault().err().unwrap_or_else(|| self.damaged(Some(id.0), "there is no such page".into()))
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
        let heads = top::read_nodes(cache.file(), begin..self.header.file_bytes);
        let heads = heads.map_err(|failure| failure.error(&self.path, None))?;
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
                cache::read_at(cache.file(), &mut bytes, range.start).map_err(Error::io(&self.path, "read"))?;
                Ok(bytes)
            }
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
