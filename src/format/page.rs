//! Brick records, page records and the header of a page.

use bytemuck::{Pod, Zeroable};

/// The number of a page, which is the number of its brick.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct PageId(pub u32);

/// How a brick is entered; FORMAT.md, "Brick".
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Brick {
    /// Offset of its root node in the file, in 64-byte units.
    pub node: u32,
    /// Number of its first reference in the file.
    pub first_reference: u32,
    /// Frame: corner in root units, multiples of 2^-24.
    pub corner: [f32; 3],
    /// Frame: unit in root units, powers of two.
    pub unit: [f32; 3],
}

/// Where a page lies; FORMAT.md, "Page record".
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct PageRecord {
    /// Offset in the file.
    pub offset: u64,
    /// XXH3-64 of the stored bytes.
    pub checksum: u64,
    /// Bytes as stored.
    pub stored_bytes: u32,
    /// Bytes when unpacked.
    pub bytes: u32,
    /// References.
    pub references: u32,
    /// Zero.
    pub zero: u32,
}

/// The first 64 bytes of a page; FORMAT.md, "Page". Offsets are from the start of the page.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Pod, Zeroable)]
#[repr(C)]
pub struct PageHeader {
    /// The page's own number.
    pub page: u32,
    /// Nodes, at least 1.
    pub nodes: u32,
    /// Offset of the leaves.
    pub leaf_offset: u32,
    /// Bytes of the leaves.
    pub leaf_bytes: u32,
    /// References.
    pub references: u32,
    /// Leaves.
    pub leaves: u32,
    /// Offset of face ids, 0 = none.
    pub ids: u32,
    /// Offset of material numbers, 0 = none.
    pub materials: u32,
    /// Offset of normal corners, 0 = none.
    pub normal_corners: u32,
    /// Offset of the normal table.
    pub normals: u32,
    /// Normals in it.
    pub normal_count: u32,
    /// Offset of texture corners, 0 = none.
    pub texcoord_corners: u32,
    /// Offset of the texture coordinate table.
    pub texcoords: u32,
    /// Texture coordinates in it.
    pub texcoord_count: u32,
    /// Zero.
    pub zero: [u32; 2],
}

const _: () = assert!(size_of::<Brick>() == 32);
const _: () = assert!(size_of::<PageRecord>() == 32);
const _: () = assert!(size_of::<PageHeader>() == 64);

/// The side arrays of a page, one entry a reference, before they are laid out.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SideArrays {
    /// Face ids; empty = none.
    pub ids: Vec<u32>,
    /// Material numbers (0 = no material); empty = none.
    pub materials: Vec<u32>,
    /// Corners' places in `normals`, `u32::MAX` = none; empty = none at all.
    pub normal_corners: Vec<[u32; 3]>,
    /// Normal table.
    pub normals: Vec<[f32; 3]>,
    /// Corners' places in `texcoords`, `u32::MAX` = none; empty = none at all.
    pub texcoord_corners: Vec<[u32; 3]>,
    /// Texture coordinate table.
    pub texcoords: Vec<[f32; 2]>,
}

impl PageHeader {
    /// Lays out a whole page: header, nodes, leaves, padding, side arrays. The result's length is a multiple of 64.
    ///
    /// `leaf_bytes` are the encoded leaves; `wide_materials` as in [`super::Flags::WIDE_MATERIALS`]. Errors when the
    /// page would pass 2^32 bytes.
    pub fn layout(
        page: PageId,
        nodes: &[super::Node],
        leaf_bytes: &[u8],
        leaves: u32,
        references: u32,
        side: &SideArrays,
        wide_materials: bool,
    ) -> Option<Vec<u8>> {
        let _ = (page, nodes, leaf_bytes, leaves, references, side, wide_materials);
        todo!()
    }
}
