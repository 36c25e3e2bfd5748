//! The strict octree: every leaf cell refers to every triangle it overlaps, as in Revelles, Ureña and Lastra (2000).
//!
//! A cell is refined until it holds at most `cell` references or the depth limit is reached. Taken literally that never
//! ends well: around a vertex of six triangles, or along a shared edge, no cell but the last is ever empty enough, and
//! the number of references grows eightfold a level. So a cell also stays whole when
//!
//! 1. one leaf record holds it, and all its triangles share a vertex, edge or face that passes through it (some child
//!    would hold them all again, and a record is tested at one go);
//! 2. each occupied octant would refer to all of its triangles, and more than one is occupied;
//! 3. the growth (references of the octants over references of the cell) multiplied along the path from the brick's
//!    root would pass [`GROWTH_LIMIT`].
//!
//! How many references a brick will have shows only while they are made, so the memory that they take is counted on the way.
//! By the third rule a brick of n triangles ends with at most 32 n references, however it is made; scans stay far below.
//! A reference's box is its triangle's box clipped to the cell; since octants are closed and the overlap test never says
//! no to one that is touched, the boxes of a triangle's references cover it.

use super::cell::{Cell, Separation};
use super::record::{RecordLimits, bits, spread};
use super::sah::Canonical;
use super::wide::{Child, WideTree};
use crate::geometry::{RootCube, Triangle};

/// Most references a triangle may become on average, counted along any path.
const GROWTH_LIMIT: f64 = 32.0;

/// Refines the cell of a brick.
pub(super) struct StrictBuilder<'a> {
    pub triangles: Canonical<'a>,
    pub root: RootCube,
    pub limits: RecordLimits,
    /// Most references in a cell that one of the other limits does not stop.
    pub cell: usize,
    /// Depth limit, in levels from the root cube.
    pub depth: u32,
    /// Bytes that the brick may take, from its lists to its page.
    pub memory: u64,
}

/// Bytes for each node, leaf and reference of a tree, at most, from here to a finished page: they lie in lists that double as
/// they grow, then in the records that are emitted, then in the page.
const BYTES: [u64; 3] = [400, 272, 150];

impl StrictBuilder<'_> {
    /// The tree over all triangles of a brick; `None` if it would take more than its memory.
    pub fn build(&self, cell: Cell) -> Option<WideTree> {
        let mut tree = WideTree::default();
        let all = self.triangles.order.to_vec();
        let held = 8 * all.len() as u64;
        let top = self.refine(&mut tree, all, cell, (1.0, held))?;
        tree.root_of(top);
        Some(tree)
    }

    /// Whether a tree, with so many bytes of lists held beside it, takes no more memory than it may.
    fn fits(&self, tree: &WideTree, held: u64) -> bool {
        let counts = [tree.nodes.len(), tree.leaves.len(), tree.references.len()];
        held + counts.iter().zip(BYTES).map(|(&count, bytes)| count as u64 * bytes).sum::<u64>() <= self.memory
    }

    fn triangle(&self, reference: u32) -> &Triangle {
        &self.triangles.triangles[reference as usize].triangle
    }

    /// `growth`: product of the growths so far; `held`: bytes of the lists of this cell and those above. `None`: see
    /// [`StrictBuilder::build`].
    fn refine(
        &self,
        tree: &mut WideTree,
        references: Vec<u32>,
        cell: Cell,
        (growth, held): (f64, u64),
    ) -> Option<Child> {
        if !self.fits(tree, held) {
            return None;
        }
        if references.len() <= self.cell || cell.level >= self.depth || self.stays_together(&references, cell) {
            return Some(self.leaves(tree, &references, cell));
        }
        let octants = self.distribute(&references, cell);
        let occupied = octants.iter().filter(|octant| !octant.is_empty()).count();
        let all = octants.iter().map(Vec::len).sum::<usize>();
        let growth = growth * all as f64 / references.len() as f64;
        let nothing_gained = occupied > 1 && all == occupied * references.len();
        if nothing_gained || growth > GROWTH_LIMIT {
            drop(octants);
            return Some(self.leaves(tree, &references, cell));
        }
        drop(references);
        let held = held + 8 * all as u64;
        let mut children = [Child::Empty; 8];
        for (i, octant) in octants.into_iter().enumerate().filter(|(_, octant)| !octant.is_empty()) {
            let child = self.refine(tree, octant, cell.child(i), (growth, held))?;
            if occupied == 1 {
                return Some(child);
            }
            children[i] = child;
        }
        Some(tree.add_node(children))
    }

    /// The references of each octant, in their order.
    fn distribute(&self, references: &[u32], cell: Cell) -> [Vec<u32>; 8] {
        let cells: [_; 8] = std::array::from_fn(|i| cell.child(i).bounds());
        let mut octants: [Vec<u32>; 8] = Default::default();
        for &reference in references {
            let separation = Separation::of(self.root, self.triangle(reference));
            for (octant, &bounds) in octants.iter_mut().zip(&cells) {
                if separation.overlaps(bounds) {
                    octant.push(reference);
                }
            }
        }
        octants
    }

    /// Rule 1 of the module.
    fn stays_together(&self, references: &[u32], cell: Cell) -> bool {
        let triangles = references.iter().map(|&r| self.triangle(r));
        if !self.limits.fit(triangles.clone()) {
            return false;
        }
        let Some(first) = triangles.clone().next() else { return true };
        let is_common = |v: &glam::Vec3| triangles.clone().all(|t| t.vertices().iter().any(|w| bits(*w) == bits(*v)));
        let mut common = first.vertices().into_iter().filter(is_common);
        let Some(a) = common.next() else { return false };
        let b = common.next().unwrap_or(a);
        let shared = Triangle { a, b, c: common.next().unwrap_or(b) };
        Separation::of(self.root, &shared).overlaps(cell.bounds())
    }

    /// A cell that is not refined.
    fn leaves(&self, tree: &mut WideTree, references: &[u32], cell: Cell) -> Child {
        let cell = cell.bounds();
        spread(
            tree,
            self.limits,
            references,
            |r| self.triangle(r),
            |r| Separation::of(self.root, self.triangle(r)).bounds().clipped_to(cell),
        )
    }
}
