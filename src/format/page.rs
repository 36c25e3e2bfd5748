//! Brick records, page records and the header of a page.

use bytemuck::{Pod, Zeroable};

use super::Surrogate;

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
    /// Offset of surrogates, 0 = none.
    pub surrogates: u32,
    /// Zero.
    pub zero: u32,
}

/// Bytes of the header of a page; the nodes follow.
pub const PAGE_HEADER_BYTES: usize = 64;
/// Zero bytes that follow the leaves, so that wide loads of the last leaf stay inside the page.
pub const LEAF_PADDING: usize = 64;
/// From this many references on, a page lies on a multiple of 4096 in the file.
pub const LARGE_PAGE: u32 = 16384;

impl PageRecord {
    /// The multiple on which a page of that many references lies in the file, which may be packed.
    pub fn alignment(references: u32, packed: bool) -> u64 {
        if references >= LARGE_PAGE && !packed { 4096 } else { 64 }
    }
}

const _: () = assert!(size_of::<Brick>() == 32);
const _: () = assert!(size_of::<PageRecord>() == 32);
const _: () = assert!(size_of::<PageHeader>() == 64);

/// The side arrays of a page, one entry a reference (but for the tables and surrogates), before they are laid out.
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
    /// Surrogates, one a node; empty = none.
    pub surrogates: Vec<Surrogate>,
}

impl PageHeader {
    /// The header of no page: all zero.
    pub(crate) const NONE: PageHeader = PageHeader {
        page: 0,
        nodes: 0,
        leaf_offset: 0,
        leaf_bytes: 0,
        references: 0,
        leaves: 0,
        ids: 0,
        materials: 0,
        normal_corners: 0,
        normals: 0,
        normal_count: 0,
        texcoord_corners: 0,
        texcoords: 0,
        texcoord_count: 0,
        surrogates: 0,
        zero: 0,
    };

    /// Lays out a whole page: header, nodes, leaves, padding, side arrays. The result's length is a multiple of 64.
    ///
    /// `leaf_bytes` are the encoded leaves; `wide_materials` as in [`super::Flags::WIDE_MATERIALS`]. `None` when the
    /// page would pass 2^32 bytes, a side array does not have `references` entries (or `nodes`), or a material number does not fit.
    pub fn layout(
        page: PageId,
        nodes: &[super::Node],
        leaf_bytes: &[u8],
        leaves: u32,
        references: u32,
        side: &SideArrays,
        wide_materials: bool,
    ) -> Option<Vec<u8>> {
        let count = references as usize;
        let lengths = [side.ids.len(), side.materials.len(), side.normal_corners.len(), side.texcoord_corners.len()];
        let surrogates = side.surrogates.len();
        if lengths.iter().any(|&n| n != 0 && n != count) || (surrogates != 0 && surrogates != nodes.len()) {
            return None;
        }
        let narrow: Vec<u16> = match wide_materials {
            true => Vec::new(),
            false => side.materials.iter().map(|&m| u16::try_from(m).ok()).collect::<Option<_>>()?,
        };
        let mut out = vec![0; PAGE_HEADER_BYTES];
        out.reserve(size_of_val(nodes) + leaf_bytes.len() + LEAF_PADDING + 64 + 48 * count);
        out.extend_from_slice(bytemuck::cast_slice(nodes));
        let mut header = PageHeader {
            page: page.0,
            nodes: u32::try_from(nodes.len()).ok()?,
            leaf_offset: u32::try_from(out.len()).ok()?,
            leaf_bytes: u32::try_from(leaf_bytes.len()).ok()?,
            references,
            leaves,
            normal_count: u32::try_from(side.normals.len()).ok()?,
            texcoord_count: u32::try_from(side.texcoords.len()).ok()?,
            ..PageHeader::default()
        };
        out.extend_from_slice(leaf_bytes);
        out.resize(out.len() + LEAF_PADDING, 0);
        header.ids = append(&mut out, bytemuck::cast_slice(&side.ids))?;
        header.materials = match wide_materials {
            true => append(&mut out, bytemuck::cast_slice(&side.materials))?,
            false => append(&mut out, bytemuck::cast_slice(&narrow))?,
        };
        header.normal_corners = append(&mut out, bytemuck::cast_slice(&side.normal_corners))?;
        header.normals = append(&mut out, bytemuck::cast_slice(&side.normals))?;
        header.texcoord_corners = append(&mut out, bytemuck::cast_slice(&side.texcoord_corners))?;
        header.texcoords = append(&mut out, bytemuck::cast_slice(&side.texcoords))?;
        header.surrogates = append(&mut out, bytemuck::cast_slice(&side.surrogates))?;
        out.resize(out.len().next_multiple_of(64), 0);
        u32::try_from(out.len()).ok()?;
        out[..PAGE_HEADER_BYTES].copy_from_slice(bytemuck::bytes_of(&header));
        Some(out)
    }
}

/// Appends a side array at the next multiple of 16 and returns its offset; 0, and nothing appended, if it is empty.
fn append(out: &mut Vec<u8>, array: &[u8]) -> Option<u32> {
    if array.is_empty() {
        return Some(0);
    }
    out.resize(out.len().next_multiple_of(16), 0);
    let offset = u32::try_from(out.len()).ok()?;
    out.extend_from_slice(array);
    Some(offset)
}
