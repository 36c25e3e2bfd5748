//! What fits into one leaf record: so many triangles, so many distinct vertices.

use glam::Vec3;

use super::wide::{Bounds, Child, WideTree};
use crate::format::{LeafUnit, VertexTable};
use crate::geometry::Triangle;

/// The limits of a leaf record.
#[derive(Clone, Copy, Debug)]
pub(super) struct RecordLimits {
    /// Most triangles, 1..=16.
    pub triangles: usize,
    /// Most distinct vertices, 16 or 32.
    pub vertices: usize,
}

impl RecordLimits {
    /// The limits for leaves of at most `leaf` triangles in units of `unit`.
    pub fn new(leaf: usize, unit: LeafUnit) -> RecordLimits {
        RecordLimits { triangles: leaf.clamp(1, crate::format::LEAF_MAX), vertices: unit.vertex_limit() }
    }

    /// Whether the triangles fit one record.
    pub fn fit<'a>(&self, triangles: impl ExactSizeIterator<Item = &'a Triangle>) -> bool {
        let count = triangles.len();
        if count > self.triangles || 3 * count <= self.vertices {
            return count <= self.triangles;
        }
        let mut set = VertexTable::default();
        triangles.into_iter().all(|t| set.add_triangle(t) <= self.vertices)
    }
}

/// A vertex's bits: -0 and 0 are told apart, as the file does.
pub(super) fn bits(vertex: Vec3) -> [u32; 3] {
    vertex.to_array().map(f32::to_bits)
}

/// Lays `references` (in the order that is to be kept) into as few records as their order allows, spread evenly over
/// nodes of eight where one slot is not enough. `bounds_of` is the box of what a reference is responsible for.
///
/// Used for octree cells that hold more than one record; the records of a cell lie along the Morton curve.
pub(super) fn spread<'a>(
    tree: &mut WideTree,
    limits: RecordLimits,
    references: &[u32],
    triangle: impl Fn(u32) -> &'a Triangle,
    bounds_of: impl Fn(u32) -> Bounds,
) -> Child {
    let mut records = Vec::new();
    let mut rest = references;
    while !rest.is_empty() {
        let (record, after) = rest.split_at(fill(limits, rest, &triangle));
        let bounds = record.iter().fold(Bounds::EMPTY, |b, &r| b.union(bounds_of(r)));
        let first = tree.references.len() as u32;
        tree.references.extend_from_slice(record);
        records.push(tree.add_leaf(bounds, first, record.len() as u32));
        rest = after;
    }
    over_eights(tree, &records)
}

/// How many of the first references fit one record; at least 1.
fn fill<'a>(limits: RecordLimits, references: &[u32], triangle: &impl Fn(u32) -> &'a Triangle) -> usize {
    let mut set = VertexTable::default();
    let first = references.iter().take(limits.triangles);
    first.take_while(|&&r| set.add_triangle(triangle(r)) <= limits.vertices).count()
}

/// A balanced tree of eights over children in order.
fn over_eights(tree: &mut WideTree, children: &[Child]) -> Child {
    if let [only] = children {
        return *only;
    }
    if children.len() <= 8 {
        return tree.add_node_by_place(children);
    }
    let share = children.len().div_ceil(8);
    let groups: Vec<Child> = children.chunks(share).map(|group| over_eights(tree, group)).collect();
    tree.add_node_by_place(&groups)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn soup(i: usize) -> Triangle {
        let i = i as f32;
        Triangle { a: Vec3::new(i, 0.0, 0.0), b: Vec3::new(i, 1.0, 0.0), c: Vec3::new(i, 0.0, 1.0) }
    }

    #[test]
    fn vertices_are_counted_by_bits() {
        let limits = RecordLimits::new(16, LeafUnit::B16);
        let triangles: Vec<Triangle> = (0..6).map(soup).collect();
        assert!(limits.fit(triangles[..5].iter()));
        assert!(!limits.fit(triangles.iter()), "18 vertices");
        assert!(RecordLimits::new(16, LeafUnit::B32).fit(triangles.iter()));
        assert!(limits.fit([soup(1); 16].iter()));
        assert!(!limits.fit([soup(1); 17].iter()));
        let mut set = VertexTable::default();
        let (zero, minus) = (Vec3::ZERO, Vec3::new(-0.0, 0.0, 0.0));
        assert_eq!(set.add_triangle(&Triangle { a: zero, b: minus, c: zero }), 2);
    }

    #[test]
    fn spread_keeps_every_reference_in_order() {
        for n in [1usize, 5, 6, 40, 41, 1000] {
            let triangles: Vec<Triangle> = (0..n).map(soup).collect();
            let references: Vec<u32> = (0..n as u32).collect();
            let mut tree = WideTree::default();
            let limits = RecordLimits::new(16, LeafUnit::B16);
            let bounds = Bounds { min: glam::DVec3::ZERO, max: glam::DVec3::ONE };
            spread(&mut tree, limits, &references, |r| &triangles[r as usize], |_| bounds);
            assert_eq!(tree.references, references);
            assert_eq!(tree.leaves.len(), n.div_ceil(5));
        }
    }
}
