//! A page of an opened file, read in place.
//!
//! Pages are validated before a [`Page`] is handed out, so its functions look up without further checks of their own,
//! but through safe code: where a mapped file is cut short its bytes turn to zeros, and then these functions give empty
//! nodes and leaves, no face and no material, and never panic. [`super::Octree::fault`] tells.

use crate::format::{Brick, Flags, Leaf, Node, PAGE_HEADER_BYTES, PageHeader, Surrogate};
use crate::geometry::FaceId;

/// A page, checked and resident while this value lives.
#[derive(Clone, Copy)]
pub struct Page<'a> {
    bytes: &'a [u8],
    first_reference: u32,
    flags: Flags,
}

impl<'a> Page<'a> {
    /// A page over bytes that were validated. They must be aligned to 64 bytes in memory.
    pub(crate) fn new(bytes: &'a [u8], brick: &Brick, flags: Flags) -> Page<'a> {
        Page { bytes, first_reference: brick.first_reference, flags }
    }

    /// The page's header.
    #[inline]
    pub fn header(&self) -> &'a PageHeader {
        let head = self.bytes.get(..PAGE_HEADER_BYTES).and_then(|head| bytemuck::try_from_bytes(head).ok());
        head.unwrap_or(&PageHeader::NONE)
    }

    /// The nodes; the brick's root is the first.
    #[inline]
    pub fn nodes(&self) -> &'a [Node] {
        let end = PAGE_HEADER_BYTES + size_of::<Node>() * self.header().nodes as usize;
        self.array(PAGE_HEADER_BYTES, end - PAGE_HEADER_BYTES)
    }

    /// All bytes of the page; leaves and side arrays by the offsets of the header.
    #[inline]
    pub fn bytes(&self) -> &'a [u8] {
        self.bytes
    }

    /// The leaf at `offset` from the page's start; [`Leaf::EMPTY`] if no leaf can lie there.
    ///
    /// A node at index i with first leaf f names, in a slot byte b, the leaf at `64 + 64 i + 16 f + b * unit`. A reader
    /// takes a node whose f is 0 to have no leaf at all, whatever its slots say: so a node of zeros is nothing.
    #[inline]
    pub fn leaf(&self, offset: usize) -> Leaf<'a> {
        self.bytes.get(offset..).and_then(Leaf::read).unwrap_or(Leaf::EMPTY)
    }

    /// The face id of a reference (counted within the brick); [`FaceId::NONE`] if there is no such reference.
    #[inline]
    pub fn face(&self, reference: u32) -> FaceId {
        if !self.flags.has(Flags::IDS) {
            return FaceId(self.first_reference.saturating_add(reference));
        }
        let header = self.header();
        let ids: &[FaceId] = self.array(header.ids as usize, 4 * header.references as usize);
        ids.get(reference as usize).copied().unwrap_or(FaceId::NONE)
    }

    /// The material number of a reference, 0 = none.
    #[inline]
    pub fn material(&self, reference: u32) -> u32 {
        let (header, i) = (self.header(), reference as usize);
        let (offset, count) = (header.materials as usize, header.references as usize);
        if offset == 0 {
            return 0;
        }
        let number = match self.flags.has(Flags::WIDE_MATERIALS) {
            true => self.array::<u32>(offset, 4 * count).get(i).copied(),
            false => self.array::<u16>(offset, 2 * count).get(i).map(|&m| u32::from(m)),
        };
        number.unwrap_or(0)
    }

    /// The three vertex normals of a reference, as the source gives them (not of unit length), if all three corners have one.
    pub fn normals(&self, reference: u32) -> Option<[[f32; 3]; 3]> {
        let h = self.header();
        self.corners(h.normal_corners, h.normals, h.normal_count, reference)
    }

    /// The three texture coordinates of a reference, if all three corners have one.
    pub fn texcoords(&self, reference: u32) -> Option<[[f32; 2]; 3]> {
        let h = self.header();
        self.corners(h.texcoord_corners, h.texcoords, h.texcoord_count, reference)
    }

    /// The surrogates, one a node; none where the file has no level of detail.
    #[inline]
    pub fn surrogates(&self) -> &'a [Surrogate] {
        let h = self.header();
        if h.surrogates == 0 {
            &[]
        } else {
            self.array(h.surrogates as usize, size_of::<Surrogate>() * h.nodes as usize)
        }
    }

    /// The entries of a table that a reference's three corners name.
    fn corners<T: bytemuck::Pod>(&self, corners: u32, table: u32, count: u32, reference: u32) -> Option<[T; 3]> {
        if corners == 0 || table == 0 {
            return None;
        }
        let corners: &[[u32; 3]] = self.array(corners as usize, 12 * self.header().references as usize);
        let table: &[T] = self.array(table as usize, size_of::<T>() * count as usize);
        let [a, b, c] = corners.get(reference as usize)?.map(|i| table.get(i as usize));
        Some([*a?, *b?, *c?])
    }

    /// An array at an offset; empty if it cannot lie there.
    #[inline]
    fn array<T: bytemuck::Pod>(&self, offset: usize, length: usize) -> &'a [T] {
        let bytes = self.bytes.get(offset..offset.saturating_add(length));
        bytes.and_then(|bytes| bytemuck::try_cast_slice(bytes).ok()).unwrap_or(&[])
    }
}
