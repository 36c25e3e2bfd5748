//! The walk: an octree file against one ray, front to back by the direction mask.
//!
//! ```text
//! walk(node, t0, dt):
//!     touched = slots whose padded slabs overlap [near, best]          (arch/: one step for all eight)
//!     for i in 0..8:  slot = i XOR a                                   (Revelles et al. 2000: near to far)
//!         skip it if it is entered after the best hit
//!         leaf:  f32 filter, exact test of what is left, offer each hit
//!         inner: walk(child, t0 + low * dt, dt * shrink)
//!         brick: walk(root of its page, parameters of the brick's own frame)
//! ```
//!
//! Recursion is a stack of levels. A hit counts wherever it lies, not only within the cell in which it was found; the order of visits
//! is for speed only, and so is every bound: the answer is the least of all hits. Offsets inside a page are checked when the page is
//! first used; here an offset of zero, or one that leads nowhere (a file cut short reads as zeros), is nothing.

use std::borrow::Borrow;
use std::cell::Cell;

use super::arch::{Planes, scalar};
use super::collect::{Any, Closest, Collector, Next, Place};
use super::setup::Setup;
use super::{Counters, Found, Tracer};
use crate::error::Result;
use crate::exact::Decision;
use crate::format::{Frame, Leaf, Node, PageId, Slot};
use crate::geometry::{Aabb, FaceId, Ray, RootCube, Skip};
use crate::map::{Octree, Page};

/// Answers rays by walking an octree file. `O` is `&Octree`, `Arc<Octree>`, or `Octree` itself.
pub struct OctreeTracer<O> {
    octree: O,
    root: RootCube,
    bounds: Aabb,
    depth: u32,
}

impl<O: Borrow<Octree>> OctreeTracer<O> {
    /// A tracer over an opened file.
    pub fn new(octree: O) -> OctreeTracer<O> {
        let file = octree.borrow();
        let (root, bounds, depth) = (file.root(), file.bounds(), file.header().depth);
        OctreeTracer { octree, root, bounds, depth }
    }

    /// The file.
    pub fn octree(&self) -> &Octree {
        self.octree.borrow()
    }

    /// Walks a ray; `None` if it is invalid or misses the root.
    fn walk<C: Collector>(
        &self,
        ray: &Ray,
        counters: &mut Counters,
        collector: impl FnOnce(&Setup) -> C,
    ) -> Result<Option<(Setup, C)>> {
        counters.rays += 1;
        if !ray.is_valid() {
            return Ok(None);
        }
        let Some(setup) = Setup::new(ray, self.root, self.bounds, self.depth) else { return Ok(None) };
        let mut collector = collector(&setup);
        let mut stack = STACK.take();
        stack.clear();
        let octree = self.octree();
        let walked = Walk { octree, setup: &setup, far: setup.far, stack: &mut stack, counters }.run(&mut collector);
        STACK.set(stack);
        walked?;
        octree.fault()?;
        Ok(Some((setup, collector)))
    }
}

impl<O: Borrow<Octree> + Send + Sync> Tracer for OctreeTracer<O> {
    fn closest_counted(&self, ray: &Ray, skip: Skip, counters: &mut Counters) -> Result<Option<Found>> {
        let walked = self.walk(ray, counters, |_| Closest::new(skip))?;
        Ok(walked.and_then(|(setup, closest)| closest.finish(&setup.line)))
    }

    fn any_counted(&self, ray: &Ray, skip: Skip, counters: &mut Counters) -> Result<bool> {
        Ok(self.walk(ray, counters, |_| Any::new(skip))?.is_some_and(|(_, any)| any.found))
    }

    fn next(&self, ray: &Ray, skip: Skip, last: &Found) -> Result<Option<Found>> {
        let walked = self.walk(ray, &mut Counters::default(), |setup| Closest::after(skip, &setup.line, last))?;
        Ok(walked.and_then(|(setup, closest)| closest.finish(&setup.line)))
    }

    fn bounds(&self) -> Aabb {
        self.bounds
    }
}

thread_local! {
    /// Each thread's stack, kept so that a ray allocates nothing.
    static STACK: Cell<Vec<Level>> = const { Cell::new(Vec::new()) };
}

/// A node under way.
#[derive(Clone, Copy)]
struct Level {
    planes: Planes,
    near: [f32; 8],
    node: u32,
    /// Its page, [`TOP`] for top nodes.
    page: u32,
    /// Slots left to visit: bit i stands for slot i XOR a.
    left: u8,
}

const TOP: u32 = u32::MAX;

/// The nodes that a level's number counts in.
#[derive(Clone, Copy)]
struct View<'a> {
    nodes: &'a [Node],
    page: Option<Page<'a>>,
}

struct Walk<'a, 'w> {
    octree: &'a Octree,
    setup: &'w Setup,
    /// The parameter beyond which nothing matters.
    far: f32,
    stack: &'w mut Vec<Level>,
    counters: &'w mut Counters,
}

/// What a visited slot leads to.
enum Step {
    On,
    Down(Level),
    Done,
}

impl<'a> Walk<'a, '_> {
    fn run(&mut self, collector: &mut impl Collector) -> Result<()> {
        let (mut view, mut level) = match self.octree.top_nodes().first() {
            Some(_) => {
                let view = self.view(TOP)?;
                (view, self.enter(view, TOP, 0, self.planes(&Frame::ROOT)))
            }
            None => match self.enter_brick(0)? {
                Some(entered) => entered,
                None => return Ok(()),
            },
        };
        loop {
            while level.left != 0 {
                let i = level.left.trailing_zeros();
                level.left &= level.left - 1;
                let slot = (i as u8 ^ self.setup.mask) as usize & 7;
                if level.near[slot] > self.far {
                    continue;
                }
                let page = level.page;
                match self.visit(&mut view, &level, slot, collector)? {
                    Step::On => {}
                    Step::Done => return Ok(()),
                    Step::Down(child) => {
                        if level.left != 0 {
                            self.stack.push(Level { page, ..level });
                        }
                        level = child;
                    }
                }
            }
            let Some(up) = self.stack.pop() else { return Ok(()) };
            if up.page != level.page {
                view = self.view(up.page)?;
            }
            level = up;
        }
    }

    /// Visits one slot of a node; `view` changes where that leads into a page.
    #[inline]
    fn visit(
        &mut self,
        view: &mut View<'a>,
        level: &Level,
        slot: usize,
        collector: &mut impl Collector,
    ) -> Result<Step> {
        let Some(node) = view.nodes.get(level.node as usize) else { return Ok(Step::On) };
        let step = match Slot::decode(node.slots[slot]) {
            Some(Slot::Inner(rank)) if node.first_child != 0 => {
                let child = level.node.wrapping_add(node.first_child).wrapping_add(u32::from(rank));
                Step::Down(self.enter(*view, level.page, child, self.shrink(&level.planes, node, slot)))
            }
            Some(Slot::Leaf(units)) if node.first_leaf != 0 => {
                let Some(page) = &view.page else { return Ok(Step::On) };
                let offset = 64
                    + 64 * level.node as usize
                    + 16 * node.first_leaf as usize
                    + self.octree.leaf_unit().bytes() * usize::from(units);
                match self.leaf(page, PageId(level.page), page.leaf(offset), collector) {
                    Next::Done => Step::Done,
                    _ => Step::On,
                }
            }
            Some(Slot::Brick(rank)) if view.page.is_none() => {
                match self.enter_brick(node.first_leaf.wrapping_add(u32::from(rank)))? {
                    Some((inside, level)) => {
                        *view = inside;
                        Step::Down(level)
                    }
                    None => Step::On,
                }
            }
            _ => Step::On,
        };
        Ok(step)
    }

    /// The nodes of a page or of the top.
    fn view(&self, page: u32) -> Result<View<'a>> {
        if page == TOP {
            return Ok(View { nodes: self.octree.top_nodes(), page: None });
        }
        let page = self.octree.page(PageId(page))?;
        Ok(View { nodes: page.nodes(), page: Some(page) })
    }

    /// Enters the root node of a brick by its own frame.
    fn enter_brick(&mut self, number: u32) -> Result<Option<(View<'a>, Level)>> {
        let Some(brick) = self.octree.bricks().get(number as usize) else { return Ok(None) };
        self.counters.bricks += 1;
        let frame = Frame { corner: brick.corner.map(f64::from), unit: brick.unit.map(f64::from) };
        let view = self.view(number)?;
        Ok(Some((view, self.enter(view, number, 0, self.planes(&frame)))))
    }

    /// Tests the slots of a node.
    #[inline]
    fn enter(&mut self, view: View<'a>, page: u32, node: u32, planes: Planes) -> Level {
        self.counters.nodes += 1;
        let record = view.nodes.get(node as usize).unwrap_or(&Node::EMPTY);
        let touched = scalar::touch(record, &planes, self.setup, self.far);
        Level { planes, near: touched.near, node, page, left: permute(touched.slots, self.setup.mask) }
    }

    /// The parameters of a frame, from f64.
    fn planes(&self, frame: &Frame) -> Planes {
        let dt = std::array::from_fn(|i| frame.unit[i] as f32 * self.setup.inv32[i]);
        Planes { t0: self.setup.corner(frame.corner), dt }
    }

    /// The parameters of an inner child's frame; FORMAT.md, "Frame".
    #[inline]
    fn shrink(&self, planes: &Planes, node: &Node, slot: usize) -> Planes {
        const LEAST_UNIT: f32 = Frame::LEAST_UNIT as f32;
        let mut child = *planes;
        for i in 0..3 {
            let (low, high) = (node.low[i][slot], node.high[i][slot]);
            child.t0[i] += f32::from(low) * planes.dt[i];
            // A power of two times dt: exact, as dt is at least 2^-33 in magnitude or zero.
            let exponent = 31 - u32::from(high.saturating_sub(low).max(1)).leading_zeros();
            let dt = planes.dt[i] * f32::from_bits((exponent + 127 - 7) << 23);
            let least = self.setup.inv32[i] * LEAST_UNIT;
            child.dt[i] = if dt.abs() < least.abs() { least } else { dt };
        }
        child
    }

    /// Tests a leaf's triangles and offers the hits.
    #[inline]
    fn leaf(&mut self, page: &Page<'a>, id: PageId, leaf: Leaf<'a>, collector: &mut impl Collector) -> Next {
        self.counters.leaves += 1;
        self.counters.triangles += leaf.len() as u64;
        let lanes = scalar::classify(&leaf, &self.setup.shear);
        self.counters.doubts += u64::from(lanes.doubt.count_ones());
        let mut left = lanes.accept | lanes.doubt;
        while left != 0 {
            let j = left.trailing_zeros();
            left &= left - 1;
            let triangle = leaf.triangle(j as usize);
            let line = &self.setup.line;
            let doubted = lanes.doubt >> j & 1 != 0;
            let Decision { crossing, exact } = if doubted { line.meet(&triangle) } else { line.accepted(&triangle) };
            self.counters.exact += u64::from(exact);
            let Some(crossing) = crossing else { continue };
            let place = Reference { page, id, reference: leaf.first().wrapping_add(j) };
            match collector.offer(line, crossing, &place) {
                Next::On => {}
                Next::Nearer => self.far = self.far.min(self.setup.reach(collector.reach())),
                Next::Done => return Next::Done,
            }
        }
        Next::On
    }
}

/// A reference within a page.
struct Reference<'p, 'a> {
    page: &'p Page<'a>,
    id: PageId,
    reference: u32,
}

impl Place for Reference<'_, '_> {
    fn face(&self) -> FaceId {
        self.page.face(self.reference)
    }
    fn page(&self) -> PageId {
        self.id
    }
    fn reference(&self) -> u32 {
        self.reference
    }
}

/// Moves bit s to bit s XOR a.
#[inline]
fn permute(bits: u8, a: u8) -> u8 {
    let mut b = bits;
    if a & 1 != 0 {
        b = (b & 0x55) << 1 | (b >> 1) & 0x55;
    }
    if a & 2 != 0 {
        b = (b & 0x33) << 2 | (b >> 2) & 0x33;
    }
    if a & 4 != 0 {
        b = b.rotate_left(4);
    }
    b
}

#[cfg(test)]
mod tests {
    use super::permute;

    #[test]
    fn permutes_by_xor() {
        for a in 0..8u8 {
            for s in 0..8u8 {
                assert_eq!(permute(1 << s, a), 1 << (s ^ a));
            }
        }
    }
}
