//! The opened octree file: header and top at once, pages when they are first used.

use std::path::Path;

use crate::error::Result;
use crate::event::Monitor;
use crate::format::{Brick, Flags, Header, LeafUnit, MaterialRecord, Node, PageHeader, PageId};
use crate::geometry::{Aabb, FaceId, RootCube};

/// An octree file, opened. Cheap to open: header and top are checked; a page is checked when it is first used.
pub struct Octree {}

/// A page, checked and resident while this value lives.
#[derive(Clone, Copy)]
pub struct Page<'a> {
    bytes: &'a [u8],
}

impl Octree {
    /// Opens a file.
    pub fn open(path: &Path) -> Result<Octree> {
        let _ = path;
        todo!()
    }
    /// The header.
    pub fn header(&self) -> &Header {
        todo!()
    }
    /// The file's path as it was given.
    pub fn path(&self) -> &Path {
        todo!()
    }
    /// The flags.
    pub fn flags(&self) -> Flags {
        self.header().flags
    }
    /// The unit of leaf offsets.
    pub fn leaf_unit(&self) -> LeafUnit {
        todo!()
    }
    /// The root cube.
    pub fn root(&self) -> RootCube {
        todo!()
    }
    /// Bounds of all stored triangles.
    pub fn bounds(&self) -> Aabb {
        todo!()
    }
    /// Top nodes, empty for a file of one page.
    pub fn top_nodes(&self) -> &[Node] {
        todo!()
    }
    /// Brick records, one a page.
    pub fn bricks(&self) -> &[Brick] {
        todo!()
    }
    /// Materials.
    pub fn materials(&self) -> &[MaterialRecord] {
        todo!()
    }
    /// A string that a material names by offset and length.
    pub fn string(&self, place: [u32; 2]) -> &str {
        let _ = place;
        todo!()
    }
    /// A page; checked (checksum and structure) at its first use.
    pub fn page(&self, id: PageId) -> Result<Page<'_>> {
        let _ = id;
        todo!()
    }
    /// Checks everything: every page, and what only shows over all pages (counts, depth, bounds, ids).
    pub fn verify(&self, monitor: Monitor<'_>) -> Result<()> {
        let _ = monitor;
        todo!()
    }
}

impl<'a> Page<'a> {
    /// The page's header.
    pub fn header(&self) -> &'a PageHeader {
        todo!()
    }
    /// The nodes.
    pub fn nodes(&self) -> &'a [Node] {
        todo!()
    }
    /// All bytes of the page; leaves and side arrays by the offsets of the header.
    pub fn bytes(&self) -> &'a [u8] {
        self.bytes
    }
    /// The leaf's bytes from offset `offset` (from the page's start) on.
    pub fn leaf(&self, offset: usize) -> crate::format::Leaf<'a> {
        let _ = offset;
        todo!()
    }
    /// The face id of a reference (counted within the brick).
    pub fn face(&self, reference: u32) -> FaceId {
        let _ = reference;
        todo!()
    }
    /// The material number of a reference, 0 = none.
    pub fn material(&self, reference: u32) -> u32 {
        let _ = reference;
        todo!()
    }
    /// The three vertex normals of a reference, as the source gives them (not of unit length), if all three corners have one.
    pub fn normals(&self, reference: u32) -> Option<[[f32; 3]; 3]> {
        let _ = reference;
        todo!()
    }
    /// The three texture coordinates of a reference, if all three corners have one.
    pub fn texcoords(&self, reference: u32) -> Option<[[f32; 2]; 3]> {
        let _ = reference;
        todo!()
    }
}
