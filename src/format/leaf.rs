//! Leaves: up to 16 triangles over a local vertex table.

use crate::geometry::Triangle;

/// Most triangles in a leaf.
pub const LEAF_MAX: usize = 16;

/// The unit of leaf offsets and the alignment of leaves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LeafUnit {
    /// 16 bytes: coding 0 only.
    B16,
    /// 32 bytes: both codings.
    B32,
}

impl LeafUnit {
    /// Bytes of the unit.
    pub fn bytes(self) -> usize {
        match self {
            LeafUnit::B16 => 16,
            LeafUnit::B32 => 32,
        }
    }

    /// Most vertices a leaf may have.
    pub fn vertex_limit(self) -> usize {
        match self {
            LeafUnit::B16 => 16,
            LeafUnit::B32 => 32,
        }
    }
}

/// A leaf, read in place.
#[derive(Clone, Copy, Debug)]
pub struct Leaf<'a> {
    bytes: &'a [u8],
}

impl<'a> Leaf<'a> {
    /// The leaf at the start of `bytes` (which may go on beyond it); `None` if its counts or corners break a rule.
    pub fn parse(bytes: &'a [u8], unit: LeafUnit) -> Option<Leaf<'a>> {
        let _ = (bytes, unit);
        todo!()
    }

    /// First reference within the brick.
    pub fn first(&self) -> u32 {
        todo!()
    }

    /// Triangles.
    pub fn len(&self) -> usize {
        self.bytes[4].into()
    }

    /// Never: a leaf has at least one triangle.
    pub fn is_empty(&self) -> bool {
        false
    }

    /// Vertices.
    pub fn vertices(&self) -> usize {
        self.bytes[5].into()
    }

    /// Bytes of the record, padded to the unit.
    pub fn size(&self, unit: LeafUnit) -> usize {
        let _ = unit;
        todo!()
    }

    /// Vertex numbers of triangle `j`'s corners.
    pub fn corners(&self, j: usize) -> [usize; 3] {
        let _ = j;
        todo!()
    }

    /// Triangle `j`.
    pub fn triangle(&self, j: usize) -> Triangle {
        let _ = j;
        todo!()
    }

    /// The coordinates of one axis (0 x, 1 y, 2 z) of all vertices.
    pub fn coordinates(&self, axis: usize) -> impl Iterator<Item = f32> + 'a {
        let _ = axis;
        std::iter::empty()
    }
}

/// Appends a leaf to `out` (whose length is a multiple of the unit) and pads it. Vertices are merged by their bits.
///
/// `None`, and nothing appended, if there are more than [`LEAF_MAX`] triangles or more vertices than the unit allows.
/// Coding 0 is taken whenever 16 vertices suffice.
pub fn encode_leaf(out: &mut Vec<u8>, unit: LeafUnit, first: u32, triangles: &[Triangle]) -> Option<()> {
    let _ = (out, unit, first, triangles);
    todo!()
}
