//! What a build tells when it is done.

use super::Phase;
use crate::format::Dropped;

/// How faces of more than three corners were cut; counts of faces.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Polygons {
    /// Cut in all, each into (corners - 2) triangles.
    pub cut: u64,
    /// Of these concave ones, cut by ear clipping.
    pub clipped: u64,
    /// Of these, of more corners than ear clipping takes: cut as fans, which overlap where a face is concave.
    pub fanned: u64,
}

impl std::ops::AddAssign for Polygons {
    fn add_assign(&mut self, other: Polygons) {
        self.cut += other.cut;
        self.clipped += other.clipped;
        self.fanned += other.fanned;
    }
}

/// What was built, and what it cost.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BuildReport {
    /// Triangles in the file, each counted once.
    pub triangles: u64,
    /// Triangles as stored, repeats counted.
    pub references: u64,
    /// Triangles of the source, dropped ones included; face ids lie below.
    pub source_triangles: u64,
    /// Vertices of the source.
    pub vertices: u64,
    /// What was left out.
    pub dropped: Dropped,
    /// Faces of more than three corners.
    pub polygons: Polygons,
    /// Degenerate triangles with two different vertices of bit-equal position: the mark of coordinates too large for f32.
    pub merged: u64,
    /// How far a vertex was moved to the grid, on any axis; 0 where positions are exact.
    pub largest_shift: f64,
    /// Length of the file.
    pub bytes: u64,
    /// Length of the file by triangles.
    pub bytes_per_triangle: f64,
    /// Pages.
    pub pages: u32,
    /// Nodes, top nodes included.
    pub nodes: u64,
    /// Leaves.
    pub leaves: u64,
    /// Nodes on the longest path from the root to a leaf.
    pub depth: u32,
    /// The phases in order.
    pub phases: Vec<Phase>,
}
