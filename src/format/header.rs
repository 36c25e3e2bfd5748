//! The header page.

use bytemuck::{Pod, Zeroable};

/// Size of the header page.
pub const HEADER_BYTES: usize = 4096;
/// Magic bytes at the start of every file, in the manner of PNG.
pub const MAGIC: [u8; 8] = *b"\x89OCT\r\n\x1a\n";
/// The format version that this library writes and reads.
pub const VERSION: u32 = 1;

/// How cells are split while building.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum SplitMode {
    /// Octree cells down to bricks, binned surface-area splits inside.
    #[default]
    Sah,
    /// Octree cells all the way, each triangle stored once.
    Octree,
    /// Octree cells all the way, a reference in every leaf cell a triangle overlaps.
    Strict,
}

/// Flag bits of the header.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Pod, Zeroable)]
#[repr(transparent)]
pub struct Flags(pub u32);

impl Flags {
    /// Pages are zstd frames.
    pub const PACKED: u32 = 1;
    /// Pages have face ids.
    pub const IDS: u32 = 2;
    /// Pages have material numbers.
    pub const MATERIALS: u32 = 4;
    /// Material numbers are u32, else u16.
    pub const WIDE_MATERIALS: u32 = 8;
    /// Pages may have normals.
    pub const NORMALS: u32 = 16;
    /// Pages may have texture coordinates.
    pub const TEXCOORDS: u32 = 32;
    /// Leaf offsets count 32 bytes, else 16.
    pub const LEAF_UNIT_32: u32 = 64;
    /// A triangle may be stored several times.
    pub const REPEATS: u32 = 128;

    /// Leaves may hold their vertices as steps.
    pub const STEPS: u32 = 256;

    /// Nodes have surrogates.
    pub const DETAIL: u32 = 512;

    /// All flags that version 1 knows.
    pub const KNOWN: u32 = 1023;

    /// The unit of leaf offsets that the flags name.
    pub fn leaf_unit(self) -> super::LeafUnit {
        if self.has(Flags::LEAF_UNIT_32) { super::LeafUnit::B32 } else { super::LeafUnit::B16 }
    }

    /// How the vertices of leaves may be stored.
    pub fn points(self) -> super::Points {
        if self.has(Flags::STEPS) { super::Points::Steps } else { super::Points::Floats }
    }

    /// Whether all bits of `mask` are set.
    pub fn has(self, mask: u32) -> bool {
        self.0 & mask == mask
    }
}

/// Kinds of section.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum SectionKind {
    /// Top nodes.
    TopNodes = 1,
    /// Brick records.
    Bricks = 2,
    /// Page records.
    Pages = 3,
    /// Material records.
    Materials = 4,
    /// String bytes.
    Strings = 5,
    /// Heads of bricks: copies of their uppermost nodes, and surrogates.
    Heads = 6,
    /// Where the heads lie.
    HeadPlaces = 7,
    /// Surrogates of the top nodes.
    TopSurrogates = 8,
}

impl SectionKind {
    /// How many kinds there are.
    pub const COUNT: usize = 8;
}

/// An entry of the section directory.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Pod, Zeroable)]
#[repr(C)]
pub struct Section {
    /// A [`SectionKind`], 0 = unused.
    pub kind: u32,
    /// Zero.
    pub zero: u32,
    /// Offset in the file, a multiple of 64.
    pub offset: u64,
    /// Length.
    pub bytes: u64,
    /// XXH3-64.
    pub checksum: u64,
}

/// What was left out of the source, counted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Pod, Zeroable)]
#[repr(C)]
pub struct Dropped {
    /// Triangles of exactly zero area.
    pub degenerate: u64,
    /// Triangles with a vertex that is not finite.
    pub non_finite: u64,
    /// Triangles of faces with a bad index.
    pub bad_index: u64,
    /// Faces with fewer than three corners; not triangles, so outside the sum.
    pub too_few_corners: u64,
}

/// The header page, field for field as in FORMAT.md.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
pub struct Header {
    /// [`MAGIC`].
    pub magic: [u8; 8],
    /// [`VERSION`].
    pub version: u32,
    /// Flag bits.
    pub flags: Flags,
    /// Length of the whole file.
    pub file_bytes: u64,
    /// Triangles, each counted once.
    pub triangles: u64,
    /// Triangles as stored, repeats counted.
    pub references: u64,
    /// Face ids lie below this number.
    pub source_triangles: u64,
    /// Vertices of the source.
    pub vertices: u64,
    /// Nodes, top nodes included.
    pub nodes: u64,
    /// Leaves.
    pub leaves: u64,
    /// Pages, at least 1.
    pub pages: u32,
    /// Top nodes; 0 in a file of one page.
    pub top_nodes: u32,
    /// Materials.
    pub materials: u32,
    /// Nodes on the longest path from the root to a leaf.
    pub depth: u32,
    /// Root cube: lowest corner.
    pub root_corner: [f64; 3],
    /// Origin that was subtracted from the source's coordinates.
    pub origin: [f64; 3],
    /// Root cube: log2 of its side.
    pub root_log2_side: i32,
    /// Lowest corner of the bounds.
    pub bounds_min: [f32; 3],
    /// Highest corner of the bounds.
    pub bounds_max: [f32; 3],
    /// Bytes of the largest page, unpacked.
    pub largest_page: u32,
    /// Brick limit as asked for.
    pub brick_limit: u32,
    /// Cell limit, `u32::MAX` = all.
    pub cell_limit: u32,
    /// What was dropped.
    pub dropped: Dropped,
    /// Split mode: 0 sah, 1 octree, 2 strict.
    pub split: u8,
    /// Leaf limit, 1 to 16.
    pub leaf_limit: u8,
    /// Depth limit, 0 to 21.
    pub depth_limit: u8,
    /// Zero.
    pub zero0: [u8; 45],
    /// Section directory.
    pub sections: [Section; 16],
    /// Zero.
    pub zero1: [u64; 415],
    /// XXH3-64 of the bytes before it.
    pub checksum: u64,
}

const _: () = assert!(size_of::<Header>() == HEADER_BYTES);
const _: () = assert!(std::mem::offset_of!(Header, root_corner) == 88);
const _: () = assert!(std::mem::offset_of!(Header, dropped) == 176);
const _: () = assert!(std::mem::offset_of!(Header, sections) == 256);
