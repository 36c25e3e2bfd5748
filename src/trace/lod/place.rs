//! Where the nodes of a walk lie: in the top, in the head of a brick, or in its page, with what stands for them.

use crate::format::{Frame, HeadView, Node, PageId, RootBox, Surrogate};
use crate::map::{Detail, Octree};
use crate::trace::arch::Cell;
use crate::trace::walk::{View, cell_of};

/// Where a node is.
#[derive(Clone, Copy)]
pub(super) enum At<'a> {
    Top(u32),
    /// A node of a brick's head.
    Head(PageId, HeadView<'a>, u32),
    /// A node of a page.
    Page(View<'a>, u32),
}

/// A child: a node that is at hand, one of a page that was not needed so far, or a leaf.
pub(super) enum Child<'a> {
    At(At<'a>),
    Below(PageId, u32),
    Leaf,
}

impl<'a> Child<'a> {
    /// Its surrogate; `parent` is the node that names it by rank. Leaves have none: their parent's is true of them too.
    #[inline(always)]
    pub fn surrogate(&self, parent: &At<'a>, detail: &Detail<'a>, rank: u32) -> Option<&'a Surrogate> {
        match (self, parent) {
            (Child::Leaf, At::Head(_, head, 0)) => head.root(),
            (Child::Leaf, At::Head(_, head, i)) => head.child(0, *i as u8 - 1),
            (Child::Leaf, At::Page(view, index)) => view.page?.surrogates().get(*index as usize),
            (Child::At(At::Top(node)), _) => detail.top(*node),
            (Child::At(At::Head(_, head, 0)), At::Top(_)) => head.root(),
            (_, At::Head(_, head, i)) => head.child(*i as usize, rank as u8 & 7),
            (Child::At(At::Page(view, index)), _) => view.page?.surrogates().get(*index as usize),
            _ => None,
        }
    }
}

impl<'a> At<'a> {
    /// The node itself; an empty one where a file was cut short.
    #[inline(always)]
    pub fn node(&self, octree: &'a Octree) -> &'a Node {
        match self {
            At::Top(i) => octree.top_nodes().get(*i as usize).unwrap_or(&Node::EMPTY),
            At::Head(_, head, i) => head.node(*i as usize),
            At::Page(view, i) => view.node(*i),
        }
    }

    /// Its inner child of that rank.
    #[inline(always)]
    pub fn child(&self, node: &Node, rank: u32) -> Child<'a> {
        let below = |i: u32| i.wrapping_add(node.first_child).wrapping_add(rank);
        match *self {
            At::Top(i) => Child::At(At::Top(below(i))),
            At::Head(brick, head, 0) => Child::At(At::Head(brick, head, 1 + rank)),
            At::Head(brick, head, i) => Child::Below(brick, below(page_index(&head, i))),
            At::Page(view, i) => Child::At(At::Page(view, below(i))),
        }
    }
}

/// The number that node `i` of a head has in its page.
pub(super) fn page_index(head: &HeadView<'_>, i: u32) -> u32 {
    if i == 0 { 0 } else { head.node(0).first_child.wrapping_add(i - 1) }
}

/// The root of a file: where it is, its frame, and its surrogate.
pub(super) fn root<'a>(
    octree: &'a Octree,
    detail: &Detail<'a>,
) -> Option<(At<'a>, Frame, Cell, Option<&'a Surrogate>)> {
    if !octree.top_nodes().is_empty() {
        let cell = Cell { corner: [0.0; 3], unit: [1.0 / 256.0; 3] };
        return Some((At::Top(0), Frame::ROOT, cell, detail.top(0)));
    }
    let (brick, head) = (octree.bricks().first()?, detail.head(PageId(0))?);
    let cell = cell_of(brick);
    let frame = Frame { corner: cell.corner.map(f64::from), unit: cell.unit.map(f64::from) };
    Some((At::Head(PageId(0), head, 0), frame, cell, head.root()))
}

/// The box around all triangles in root units.
pub(super) fn bounds_of(octree: &Octree) -> RootBox {
    let (root, bounds) = (octree.root(), octree.bounds());
    RootBox { low: root.to_root_units(bounds.min), high: root.to_root_units(bounds.max) }
}
