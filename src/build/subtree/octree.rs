//! The pure octree: true octants down to the cell limit, each triangle once, in the cell of its box's centre.
//!
//! Triangles come sorted by Morton code, so a cell is a range and its octants are found by binary search. Cells with a
//! single occupied octant are skipped; one with more than a record holds is spread over several (see [`spread`]).

use super::cell::octant_of;
use super::record::{RecordLimits, spread};
use super::sah::Canonical;
use super::wide::{Bounds, Child, WideTree};
use crate::geometry::{Aabb, RootCube};

/// Refines a cell of `level`; `codes` are those of all triangles, in canonical order.
pub(super) struct OctreeBuilder<'a> {
    pub triangles: Canonical<'a>,
    pub codes: &'a [u64],
    pub root: RootCube,
    pub limits: RecordLimits,
    /// Most triangles in a cell that is not at the depth limit.
    pub cell: usize,
    /// Depth limit, in levels from the root cube.
    pub depth: u32,
}

impl OctreeBuilder<'_> {
    /// The tree over all triangles of a brick at `level`.
    pub fn build(&self, level: u32) -> WideTree {
        let mut tree = WideTree::default();
        let top = self.refine(&mut tree, 0..self.codes.len(), level);
        tree.root_of(top);
        tree
    }

    fn refine(&self, tree: &mut WideTree, range: std::ops::Range<usize>, level: u32) -> Child {
        if range.len() <= self.cell || level >= self.depth {
            return self.leaves(tree, range);
        }
        let codes = &self.codes[range.clone()];
        let ends: [usize; 8] =
            std::array::from_fn(|i| range.start + codes.partition_point(|&code| octant_of(code, level) <= i));
        let start = |i: usize| if i == 0 { range.start } else { ends[i - 1] };
        if let Some(only) = (0..8).find(|&i| ends[i] - start(i) == range.len()) {
            return self.refine(tree, start(only)..ends[only], level + 1);
        }
        let mut children = [Child::Empty; 8];
        for (i, child) in children.iter_mut().enumerate().filter(|(i, _)| start(*i) < ends[*i]) {
            *child = self.refine(tree, start(i)..ends[i], level + 1);
        }
        tree.add_node(children)
    }

    /// A cell that is not refined.
    fn leaves(&self, tree: &mut WideTree, range: std::ops::Range<usize>) -> Child {
        spread(
            tree,
            self.limits,
            &self.triangles.order[range],
            |r| &self.triangles.triangles[r as usize].triangle,
            |r| Bounds::of(Aabb::from(&self.triangles.triangles[r as usize].triangle), self.root),
        )
    }
}
