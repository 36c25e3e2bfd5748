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
use std::cell::RefCell;

use bytemuck::Zeroable;

use super::arch::{Isa, Job, Kernel, Planes};
use super::collect::{Any, Closest, Collector, Next, Place};
use super::setup::Setup;
use super::{Counters, Found, Tracer};
use crate::error::Result;
use crate::exact::{Decision, Lanes, Line};
use crate::format::{DEPTH_MAX, Frame, Leaf, Node, PageId};
use crate::geometry::{Aabb, FaceId, Ray, RootCube, Skip};
use crate::map::{Octree, Page};

/// Answers rays by walking an octree file. `O` is `&Octree`, `Arc<Octree>`, or `Octree` itself.
pub struct OctreeTracer<O> {
    octree: O,
    root: RootCube,
    bounds: Aabb,
    depth: u32,
    isa: Isa,
}

impl<O: Borrow<Octree>> OctreeTracer<O> {
    /// A tracer over an opened file.
    pub fn new(octree: O) -> OctreeTracer<O> {
        let file = octree.borrow();
        let (root, bounds, depth) = (file.root(), file.bounds(), file.header().depth);
        OctreeTracer { octree, root, bounds, depth, isa: Isa::best() }
    }

    /// The same with a given instruction set; the answers are the same, bit for bit.
    pub fn with_isa(self, isa: Isa) -> OctreeTracer<O> {
        OctreeTracer { isa, ..self }
    }

    /// The instruction set in use.
    pub fn isa(&self) -> Isa {
        self.isa
    }

    /// The file.
    pub fn octree(&self) -> &Octree {
        self.octree.borrow()
    }

    /// Walks a ray with a collector; what `finish` makes of it, or `None` if the ray is invalid or misses the root.
    #[inline]
    fn walk<C: Collector, R>(
        &self,
        ray: &Ray,
        counters: &mut Counters,
        begin: impl FnOnce(&Line) -> C,
        finish: impl FnOnce(C, &Line) -> Option<R>,
    ) -> Result<Option<R>> {
        counters.rays += 1;
        if !ray.is_valid() {
            return Ok(None);
        }
        let Some(setup) = Setup::new(ray, self.root, self.bounds, self.depth) else { return Ok(None) };
        let mut collector = begin(&setup.line);
        let octree = self.octree();
        STACK.with_borrow_mut(|stack| {
            let walk = Walk { octree, setup: &setup, far: setup.far, stack, counters };
            self.isa.run(OneRay { walk, collector: &mut collector })
        })?;
        octree.fault()?;
        Ok(finish(collector, &setup.line))
    }
}

impl<O: Borrow<Octree> + Send + Sync> Tracer for OctreeTracer<O> {
    fn closest_counted(&self, ray: &Ray, skip: Skip, counters: &mut Counters) -> Result<Option<Found>> {
        self.walk(ray, counters, |_| Closest::new(skip), Closest::finish)
    }

    fn any_counted(&self, ray: &Ray, skip: Skip, counters: &mut Counters) -> Result<bool> {
        let found = self.walk(ray, counters, |_| Any::new(skip), |any, _| any.found.then_some(()))?;
        Ok(found.is_some())
    }

    fn next(&self, ray: &Ray, skip: Skip, last: &Found) -> Result<Option<Found>> {
        self.walk(ray, &mut Counters::default(), |line| Closest::after(skip, line, last), Closest::finish)
    }

    fn bounds(&self) -> Aabb {
        self.bounds
    }
}

/// Levels that a walk can need: a node of each depth, of the top and of a page.
const LEVELS: usize = 2 * DEPTH_MAX as usize;

thread_local! {
    /// Each thread's stack, kept so that a ray allocates nothing.
    static STACK: RefCell<Box<[Level; LEVELS]>> = RefCell::new(Box::new([Level::zeroed(); LEVELS]));
}

/// A node under way. Written and read in place: a copy would wait for its own stores.
#[derive(Clone, Copy, Zeroable)]
#[repr(C, align(32))]
struct Level {
    near: [f32; 8],
    planes: Planes,
    node: u32,
    /// Its page, [`TOP`] for top nodes.
    page: u32,
    /// Slots left to visit: bit i stands for slot i XOR a, like entry i of `near`.
    left: u32,
}

const TOP: u32 = u32::MAX;

/// Slot bytes, see [`crate::format::Slot`]: below `EMPTY` a leaf; the two highest bits of the others.
const EMPTY: u8 = 0x7f;
const INNER: u8 = 0x80;
const BRICK: u8 = 0xc0;

/// The nodes that a level's number counts in.
#[derive(Clone, Copy)]
struct View<'a> {
    nodes: &'a [Node],
    /// The page's number, [`TOP`] for the top.
    number: u32,
    page: Option<Page<'a>>,
}

struct Walk<'a, 'w> {
    octree: &'a Octree,
    setup: &'w Setup,
    /// The parameter beyond which nothing matters.
    far: f32,
    stack: &'w mut [Level; LEVELS],
    counters: &'w mut Counters,
}

/// The walk of one ray, to be done with whichever kernel is there.
struct OneRay<'a, 'w, C> {
    walk: Walk<'a, 'w>,
    collector: &'w mut C,
}

impl<C: Collector> Job for OneRay<'_, '_, C> {
    type Output = Result<()>;

    #[inline(always)]
    fn run<K: Kernel>(mut self, kernel: K) -> Result<()> {
        self.walk.run(kernel, self.collector)
    }
}

impl<'a> Walk<'a, '_> {
    #[inline(always)]
    fn run<K: Kernel>(&mut self, kernel: K, collector: &mut impl Collector) -> Result<()> {
        let mut view = match self.octree.top_nodes().is_empty() {
            false => {
                let view = self.view(TOP)?;
                self.enter(kernel, &view, 0, 0, self.setup.planes(&Frame::ROOT));
                view
            }
            true => match self.brick(0)? {
                Some((view, planes)) => {
                    self.enter(kernel, &view, 0, 0, planes);
                    view
                }
                None => return Ok(()),
            },
        };
        let mask = usize::from(self.setup.way.mask & 7);
        let mut top = 0;
        loop {
            let level = &mut self.stack[top];
            if level.left == 0 {
                if top == 0 {
                    return Ok(());
                }
                top -= 1;
                if self.stack[top].page != view.number {
                    view = self.view(self.stack[top].page)?;
                }
                continue;
            }
            let i = (level.left.trailing_zeros() & 7) as usize;
            level.left &= level.left - 1;
            if level.near[i] > self.far {
                continue;
            }
            let slot = i ^ mask;
            // A level with nothing left is not needed again.
            let below = (top + usize::from(level.left != 0)).min(LEVELS - 1);
            let index = level.node;
            let Some(node) = view.nodes.get(index as usize) else { continue };
            let byte = node.slots[slot & 7];
            if byte < EMPTY {
                if node.first_leaf != 0 && self.leaf(kernel, &view, index, node, byte, collector) == Next::Done {
                    return Ok(());
                }
            } else if byte & 0xc0 == INNER && node.first_child != 0 {
                let child = index.wrapping_add(node.first_child).wrapping_add(u32::from(byte & 7));
                let planes = kernel.child(&level.planes, node, slot, &self.setup.way);
                self.enter(kernel, &view, below, child, planes);
                top = below;
            } else if byte & 0xc0 == BRICK && view.page.is_none() {
                let Some((inside, planes)) = self.brick(node.first_leaf.wrapping_add(u32::from(byte & 7)))? else {
                    continue;
                };
                view = inside;
                self.enter(kernel, &view, below, 0, planes);
                top = below;
            }
        }
    }

    /// The nodes of a page or of the top.
    #[inline(always)]
    fn view(&self, number: u32) -> Result<View<'a>> {
        if number == TOP {
            return Ok(View { nodes: self.octree.top_nodes(), number, page: None });
        }
        let page = self.octree.page(PageId(number))?;
        Ok(View { nodes: page.nodes(), number, page: Some(page) })
    }

    /// A brick's page and its own frame.
    #[inline(always)]
    fn brick(&mut self, number: u32) -> Result<Option<(View<'a>, Planes)>> {
        let Some(brick) = self.octree.bricks().get(number as usize) else { return Ok(None) };
        self.counters.bricks += 1;
        let frame = Frame { corner: brick.corner.map(f64::from), unit: brick.unit.map(f64::from) };
        Ok(Some((self.view(number)?, self.setup.planes(&frame))))
    }

    /// Tests the slots of a node, which becomes a level of the stack.
    #[inline(always)]
    fn enter<K: Kernel>(&mut self, kernel: K, view: &View<'a>, level: usize, node: u32, planes: Planes) {
        self.counters.nodes += 1;
        let record = view.nodes.get(node as usize).unwrap_or(&Node::EMPTY);
        let touched = kernel.touch(record, &planes, &self.setup.way, self.far);
        let level = &mut self.stack[level];
        level.near = touched.near;
        level.planes = planes;
        level.node = node;
        level.page = view.number;
        level.left = u32::from(touched.slots);
    }

    /// Tests the triangles of the leaf that slot byte `units` of a node names, and offers the hits.
    #[inline(always)]
    fn leaf<K: Kernel>(
        &mut self,
        kernel: K,
        view: &View<'a>,
        index: u32,
        node: &Node,
        units: u8,
        collector: &mut impl Collector,
    ) -> Next {
        let Some(page) = &view.page else { return Next::On };
        let offset = 64
            + 64 * index as usize
            + 16 * node.first_leaf as usize
            + self.octree.leaf_unit().bytes() * usize::from(units);
        let leaf = page.leaf(offset);
        self.counters.leaves += 1;
        self.counters.triangles += leaf.len() as u64;
        let lanes = kernel.classify(&leaf, &self.setup.shear);
        if lanes.accept | lanes.doubt == 0 {
            return Next::On;
        }
        self.settle(page, PageId(view.number), &leaf, lanes, collector)
    }

    /// Decides what the filter left, exactly, and offers the hits.
    #[inline(never)]
    fn settle(
        &mut self,
        page: &Page<'a>,
        id: PageId,
        leaf: &Leaf<'a>,
        lanes: Lanes,
        collector: &mut impl Collector,
    ) -> Next {
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
