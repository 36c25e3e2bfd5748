//! The walk: an octree file against one ray, front to back by the direction mask.
//!
//! ```text
//! walk(node, t0, dt):
//!     touched = slots whose padded slabs overlap [near, best]          (arch/: one step for all eight)
//!     for i in 0..8:  slot = i XOR a                                   (Revelles et al. 2000: near to far)
//!         leaf:  f32 filter, exact test of what is left, offer each hit; a nearer one takes what is entered after it
//!                off `touched`, here at once and on the levels above when the walk comes back to them
//!         inner: walk(child, t0 + low * dt, dt * shrink)
//!         brick: walk(root of its page, parameters of the brick's own frame)
//! ```
//!
//! Recursion is a stack of levels. A hit counts wherever it lies, not only within the cell in which it was found; the order of visits
//! is for speed only, and so is every bound: the answer is the least of all hits. Offsets inside a page are checked when the page is
//! first used; here an offset of zero, or one that leads nowhere (a file cut short reads as zeros), is nothing.

use bytemuck::Zeroable;

use super::Counters;
use super::arch::{Cell, Kernel, Saved};
use super::ask::Leaves;
use super::collect::{Next, Stored};
use super::setup::{Scene, Setup};
use super::trip::Trip;
use crate::exact::{Depths, Shear};
use crate::format::{Brick, DEPTH_MAX, Node, PageId};
use crate::geometry::Ray;
use crate::map::{Halt, Octree, Page, Visit};

/// Levels that a walk can need: a node of each depth, of the top and of a page.
pub(super) const LEVELS: usize = 2 * DEPTH_MAX as usize;

/// A node put aside, with slots left to visit.
#[derive(Clone, Copy, Zeroable)]
#[repr(C, align(64))]
pub(super) struct Level {
    pub saved: Saved,
    pub node: u32,
    /// Its page, [`TOP`] for top nodes.
    pub page: u32,
    /// Slots left to visit: bit i stands for slot i XOR a, like entry i of `near`.
    pub left: u32,
}

pub(super) const TOP: u32 = u32::MAX;

/// Slot bytes, see [`crate::format::Slot`]: below `EMPTY` a leaf; the two highest bits of the others.
pub(super) const EMPTY: u8 = 0x7f;
pub(super) const INNER: u8 = 0x80;
pub(super) const BRICK: u8 = 0xc0;

/// The nodes that a level's number counts in.
#[derive(Clone, Copy)]
pub(super) struct View<'a> {
    pub nodes: &'a [Node],
    /// The page's number, [`TOP`] for the top.
    pub number: u32,
    pub page: Option<Page<'a>>,
}

/// Files up to this size mostly stay in a core's caches, where asking ahead and several rays at a time only cost: measured.
pub(super) const CACHED: u64 = 4 << 20;

/// What every walk of a file needs.
#[derive(Clone, Copy)]
pub(super) struct File<'a> {
    visit: &'a Visit<'a>,
    octree: &'a Octree,
    /// The file's top nodes and bricks, looked up once.
    top: &'a [Node],
    bricks: &'a [Brick],
    /// Bytes of a unit of leaf offsets.
    unit: usize,
    /// Whether a single walk asks ahead.
    uncached: bool,
    pub scene: &'a Scene,
}

/// A ray prepared for nodes and for triangles, and the first node: its frame, its slots' entries, and those to visit.
#[derive(Clone, Copy, Zeroable)]
#[repr(C)]
pub(super) struct Sight {
    pub setup: Setup,
    pub shear: Shear,
    pub saved: Saved,
    pub left: u32,
}

/// Where every ray of a file begins.
pub(super) struct Start<'a> {
    pub view: View<'a>,
    pub cell: Cell,
}

impl Sight {
    /// Tests the first node, for a ray whose setup is aimed; whether any of its slots is to be visited.
    #[inline(always)]
    pub fn enter<K: Kernel>(&mut self, kernel: K, start: &Start<'_>) -> bool {
        let Setup { way, aim, far, .. } = &self.setup;
        let frame = kernel.frame(&start.cell, aim, way);
        let (left, near) = kernel.touch(start.view.node(0), frame, way, kernel.ends(way.near, *far));
        kernel.save(&mut self.saved, frame, near);
        self.left = left;
        left != 0
    }
}

impl<'a> File<'a> {
    /// A file and what its rays share.
    pub fn new(visit: &'a Visit<'a>, scene: &'a Scene) -> File<'a> {
        let octree = visit.octree();
        let uncached = octree.header().file_bytes > CACHED;
        let (top, bricks) = (octree.top_nodes(), octree.bricks());
        File { visit, octree, top, bricks, unit: octree.leaf_unit().bytes(), uncached, scene }
    }

    /// The root of the top, or of the only page.
    pub fn start(&self) -> Result<Start<'a>, Halt> {
        match (self.octree.top_nodes().is_empty(), self.octree.bricks()) {
            (false, _) => Ok(Start { view: self.view(TOP)?, cell: ROOT }),
            (true, [brick, ..]) => Ok(Start { view: self.view(0)?, cell: cell_of(brick) }),
            (true, []) => Ok(Start { view: View { nodes: &[], number: TOP, page: None }, cell: ROOT }),
        }
    }

    /// Walks one ray to its end, or to a page that is not in memory: `trip` then knows how to go on.
    #[inline(always)]
    #[expect(clippy::too_many_arguments, reason = "what all rays of a batch share, made once")]
    pub fn walk<K: Kernel>(
        &self,
        kernel: K,
        stack: &mut [Level; LEVELS],
        start: &Start<'a>,
        ray: &Ray,
        sight: &Sight,
        depths: &mut Depths,
        collector: &mut impl Leaves<'a>,
        counters: &mut Counters,
        trip: &mut impl Trip,
    ) -> Result<(), Halt> {
        let mut view = start.view;
        let mask = usize::from(sight.setup.way.order & 7);
        // The parameter beyond which nothing matters.
        let mut far = sight.setup.far;
        let mut ends = kernel.ends(sight.setup.way.near, far);
        let (mut nodes, mut bricks) = (0, u64::from(view.page.is_some()));
        // The node under way, the frame and the entries of its slots, and those left to visit.
        let (mut top, mut index) = (0, 0);
        let mut node = view.node(index);
        let (mut frame, mut near) = kernel.load(&sight.saved);
        let mut left = sight.left;
        if start.view.page.is_none() {
            left = trip.enter(left);
        }
        'walk: loop {
            while left == 0 {
                if top == 0 {
                    break 'walk;
                }
                top -= 1;
                let level = &stack[top];
                (frame, near) = kernel.load(&level.saved);
                left = level.left & kernel.within(near, far);
                index = level.node;
                if left != 0 && level.page != view.number {
                    view = self.view(level.page)?;
                }
                node = view.node(index);
                trip.back(top);
            }
            let rank = left.trailing_zeros() & 7;
            let slot = rank as usize ^ mask;
            left &= left - 1;
            let byte = node.slots[slot];
            if byte < EMPTY {
                let Some(stored) = self.stored(&view, index, node, byte, counters) else { continue };
                match collector.leaf(kernel, &stored, ray, sight, depths, &mut far, counters) {
                    Next::On => {}
                    Next::Nearer => {
                        left &= kernel.within(near, far);
                        ends = kernel.ends(sight.setup.way.near, far);
                    }
                    Next::Done => break 'walk,
                }
                continue;
            }
            if byte & 0xc0 == INNER && node.first_child != 0 {
                if left != 0 {
                    trip.keep(top);
                    top = keep(kernel, stack, top, (frame, near), [index, view.number, left]);
                }
                if view.page.is_none() {
                    trip.take(rank);
                }
                frame = kernel.child(frame, node, slot, &sight.setup.way);
                index = index.wrapping_add(node.first_child).wrapping_add(u32::from(byte & 7));
            } else if byte & BRICK == BRICK && view.page.is_none() {
                let number = node.first_leaf.wrapping_add(u32::from(byte & 0x3f));
                let Some(brick) = self.brick(number) else { continue };
                if left != 0 {
                    trip.keep(top);
                    top = keep(kernel, stack, top, (frame, near), [index, view.number, left]);
                }
                trip.take(rank);
                view = match self.view(number) {
                    Ok(view) => view,
                    Err(halt) => {
                        counters.nodes += nodes;
                        counters.bricks += bricks;
                        return Err(halt);
                    }
                };
                bricks += 1;
                index = 0;
                frame = kernel.frame(&cell_of(brick), &sight.setup.aim, &sight.setup.way);
            } else {
                continue;
            }
            node = view.node(index);
            nodes += 1;
            (left, near) = kernel.touch(node, frame, &sight.setup.way, ends);
            if view.page.is_none() {
                left = trip.enter(left);
            }
            if self.uncached {
                self.ahead(kernel, node, left & left.wrapping_sub(1), mask);
            }
        }
        counters.nodes += nodes;
        counters.bricks += bricks;
        Ok(())
    }

    /// Asks for what the first of the slots that are left names, so that it has come when the walk goes there.
    #[inline(always)]
    pub fn ahead<K: Kernel>(&self, kernel: K, node: &Node, left: u32, order: usize) {
        let byte = node.slots[(left.trailing_zeros() as usize ^ order) & 7];
        let inner = 64 * (node.first_child as usize + usize::from(byte & 7));
        let leaf = 16 * node.first_leaf as usize + self.unit * usize::from(byte);
        let at = if byte < EMPTY { leaf } else { inner };
        kernel.fetch(node, at);
        kernel.fetch(node, at + 64);
    }

    /// The nodes of a page or of the top.
    #[inline(always)]
    pub fn view(&self, number: u32) -> Result<View<'a>, Halt> {
        if number == TOP {
            return Ok(View { nodes: self.top, number, page: None });
        }
        let page = self.visit.page(PageId(number))?;
        Ok(View { nodes: page.nodes(), number, page: Some(page) })
    }

    /// The leaf that slot byte `units` of node `index` names.
    #[inline(always)]
    pub fn stored(
        &self,
        view: &View<'a>,
        index: u32,
        node: &Node,
        units: u8,
        counters: &mut Counters,
    ) -> Option<Stored<'a>> {
        let page = view.page?;
        if node.first_leaf == 0 {
            return None;
        }
        let leaf = page.leaf(64 + 64 * index as usize + 16 * node.first_leaf as usize + self.unit * usize::from(units));
        counters.leaves += 1;
        counters.triangles += leaf.len() as u64;
        Some(Stored { page, id: PageId(view.number), leaf })
    }

    /// The brick of that number among those of a top node.
    #[inline(always)]
    pub fn brick(&self, number: u32) -> Option<&'a Brick> {
        self.bricks.get(number as usize)
    }
}

/// Puts a node aside that has slots left, to come back to it; the number of levels then.
#[inline(always)]
pub(super) fn keep<K: Kernel>(
    kernel: K,
    stack: &mut [Level; LEVELS],
    top: usize,
    (frame, near): (K::Frame, K::Near),
    [node, page, left]: [u32; 3],
) -> usize {
    let level = &mut stack[top];
    kernel.save(&mut level.saved, frame, near);
    (level.node, level.page, level.left) = (node, page, left);
    (top + 1).min(LEVELS - 1)
}

impl<'a> View<'a> {
    /// A node; an empty one where there is none of that number.
    #[inline(always)]
    pub fn node(&self, index: u32) -> &'a Node {
        self.nodes.get(index as usize).unwrap_or(&Node::EMPTY)
    }
}

/// A brick's own frame.
#[inline(always)]
pub(super) fn cell_of(brick: &Brick) -> Cell {
    Cell { corner: brick.corner, unit: brick.unit }
}

/// The root's own frame.
const ROOT: Cell = Cell { corner: [0.0; 3], unit: [1.0 / 256.0; 3] };
