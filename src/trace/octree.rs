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

use std::borrow::Borrow;
use std::cell::RefCell;

use bytemuck::Zeroable;

use super::arch::{Isa, Job, Kernel, Planes};
use super::collect::{Any, Closest, Collector, Next, Place};
use super::setup::{Scene, Setup};
use super::{Counters, Found, Tracer, batch};
use crate::error::Result;
use crate::exact::{Decision, Lanes, Line};
use crate::format::{Brick, DEPTH_MAX, Frame, Leaf, Node, PageId};
use crate::geometry::{Aabb, FaceId, Hit, Ray, Skip};
use crate::map::{Octree, Page};

/// Answers rays by walking an octree file. `O` is `&Octree`, `Arc<Octree>`, or `Octree` itself.
pub struct OctreeTracer<O> {
    octree: O,
    scene: Scene,
    isa: Isa,
}

impl<O: Borrow<Octree>> OctreeTracer<O> {
    /// A tracer over an opened file.
    pub fn new(octree: O) -> OctreeTracer<O> {
        let file = octree.borrow();
        let scene = Scene::new(file.root(), file.bounds(), file.header().depth);
        OctreeTracer { octree, scene, isa: Isa::best() }
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

    /// Answers rays one by one, on this thread; adds the work done to `counters`.
    fn ask<A: Ask>(&self, ask: A, rays: &[Ray], answers: &mut [A::Answer], counters: &mut Counters) -> Result<()> {
        let octree = self.octree();
        STACK.with_borrow_mut(|stack| {
            let walk = Walk { octree, unit: octree.leaf_unit().bytes(), stack, counters };
            self.isa.run(Rays { ask, rays, answers, scene: &self.scene, walk })
        })?;
        octree.fault()
    }

    /// Answers one ray.
    fn ask_one<A: Ask>(&self, ask: A, ray: &Ray, counters: &mut Counters) -> Result<A::Answer> {
        let mut answer = [A::NOTHING];
        self.ask(ask, std::slice::from_ref(ray), &mut answer, counters)?;
        let [answer] = answer;
        Ok(answer)
    }
}

impl<O: Borrow<Octree> + Send + Sync> Tracer for OctreeTracer<O> {
    fn closest_counted(&self, ray: &Ray, skip: Skip, counters: &mut Counters) -> Result<Option<Found>> {
        self.ask_one(Least { skip, last: None }, ray, counters)
    }

    fn any_counted(&self, ray: &Ray, skip: Skip, counters: &mut Counters) -> Result<bool> {
        self.ask_one(Whether(skip), ray, counters)
    }

    fn next(&self, ray: &Ray, skip: Skip, last: &Found) -> Result<Option<Found>> {
        self.ask_one(Least { skip, last: Some(last) }, ray, &mut Counters::default())
    }

    fn bounds(&self) -> Aabb {
        self.scene.bounds
    }

    fn closest_batch(&self, rays: &[Ray], hits: &mut [Hit]) -> Result<Counters> {
        batch(rays, hits, |rays, hits, counters| self.ask(LeastHit, rays, hits, counters))
    }

    fn any_batch(&self, rays: &[Ray], blocked: &mut [bool]) -> Result<Counters> {
        batch(rays, blocked, |rays, blocked, counters| self.ask(Whether(Skip::NONE), rays, blocked, counters))
    }
}

/// A question that a walk answers about a ray.
trait Ask {
    /// What gathers the hits.
    type Collector: Collector;
    type Answer;
    /// The answer where nothing is hit.
    const NOTHING: Self::Answer;
    fn begin(&self, line: &Line) -> Self::Collector;
    fn end(collector: Self::Collector, line: &Line) -> Self::Answer;
}

/// The closest hit, after `last` if that is given.
struct Least<'f> {
    skip: Skip,
    last: Option<&'f Found>,
}

impl Ask for Least<'_> {
    type Collector = Closest;
    type Answer = Option<Found>;
    const NOTHING: Option<Found> = None;

    #[inline(always)]
    fn begin(&self, line: &Line) -> Closest {
        self.last.map_or_else(|| Closest::new(self.skip), |last| Closest::after(self.skip, line, last))
    }

    #[inline(always)]
    fn end(collector: Closest, line: &Line) -> Option<Found> {
        collector.found(line)
    }
}

/// The closest hit without where it is stored.
struct LeastHit;

impl Ask for LeastHit {
    type Collector = Closest;
    type Answer = Hit;
    const NOTHING: Hit = Hit::MISS;

    #[inline(always)]
    fn begin(&self, _: &Line) -> Closest {
        Closest::new(Skip::NONE)
    }

    #[inline(always)]
    fn end(collector: Closest, line: &Line) -> Hit {
        collector.hit(line)
    }
}

/// Whether anything is hit.
struct Whether(Skip);

impl Ask for Whether {
    type Collector = Any;
    type Answer = bool;
    const NOTHING: bool = false;

    #[inline(always)]
    fn begin(&self, _: &Line) -> Any {
        Any::new(self.0)
    }

    #[inline(always)]
    fn end(collector: Any, _: &Line) -> bool {
        collector.found
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
    /// Bytes of a unit of leaf offsets.
    unit: usize,
    stack: &'w mut [Level; LEVELS],
    counters: &'w mut Counters,
}

/// Rays and where their answers go, to be walked with whichever kernel is there.
struct Rays<'a, 'w, A: Ask> {
    ask: A,
    rays: &'w [Ray],
    answers: &'w mut [A::Answer],
    scene: &'w Scene,
    walk: Walk<'a, 'w>,
}

impl<A: Ask> Job for Rays<'_, '_, A> {
    type Output = Result<()>;

    #[inline(always)]
    fn run<K: Kernel>(mut self, kernel: K) -> Result<()> {
        self.walk.counters.rays += self.rays.len() as u64;
        let mut setup = Setup::blank();
        let mut start = None;
        for (ray, answer) in self.rays.iter().zip(self.answers) {
            if !(ray.is_valid() && setup.aim(ray, self.scene)) {
                *answer = A::NOTHING;
                continue;
            }
            let start = match &start {
                Some(start) => start,
                None => start.insert(self.walk.start()?),
            };
            let mut collector = self.ask.begin(&setup.line);
            self.walk.run(kernel, start, &setup, &mut collector)?;
            *answer = A::end(collector, &setup.line);
        }
        Ok(())
    }
}

/// Where every ray of a file begins.
struct Start<'a> {
    view: View<'a>,
    frame: Frame,
}

impl<'a> Walk<'a, '_> {
    /// The root of the top, or of the only page.
    fn start(&self) -> Result<Start<'a>> {
        match (self.octree.top_nodes().is_empty(), self.octree.bricks()) {
            (false, _) => Ok(Start { view: self.view(TOP)?, frame: Frame::ROOT }),
            (true, [brick, ..]) => Ok(Start { view: self.view(0)?, frame: brick_frame(brick) }),
            (true, []) => Ok(Start { view: View { nodes: &[], number: TOP, page: None }, frame: Frame::ROOT }),
        }
    }

    #[inline(always)]
    fn run<K: Kernel>(
        &mut self,
        kernel: K,
        start: &Start<'a>,
        setup: &Setup,
        collector: &mut impl Collector,
    ) -> Result<()> {
        let mut view = start.view;
        let mask = usize::from(setup.way.mask & 7);
        // The parameter beyond which nothing matters.
        let mut far = setup.far;
        self.counters.bricks += u64::from(view.page.is_some());
        // The node under way: its frame and the entries of its slots are `stack[top]`, the slots left to visit `left`.
        let (mut top, mut index) = (0, 0);
        let mut node = view.node(index);
        self.stack[top].planes = setup.planes(&start.frame);
        let mut left = self.touch(kernel, top, node, setup, far);
        loop {
            while left == 0 {
                if top == 0 {
                    return Ok(());
                }
                top -= 1;
                let level = &self.stack[top];
                left = level.left & kernel.within(&level.near, far);
                index = level.node;
                if left != 0 && level.page != view.number {
                    view = self.view(level.page)?;
                }
                node = view.node(index);
            }
            let slot = (left.trailing_zeros() & 7) as usize ^ mask;
            left &= left - 1;
            let byte = node.slots[slot];
            if byte < EMPTY {
                match self.leaf(kernel, &view, index, node, byte, setup, &mut far, collector) {
                    Next::On => {}
                    Next::Nearer => left &= kernel.within(&self.stack[top].near, far),
                    Next::Done => return Ok(()),
                }
                continue;
            }
            // The child's level is the next one, or this one where it is not needed again.
            let below = (top + usize::from(left != 0)).min(LEVELS - 1);
            if byte & 0xc0 == INNER && node.first_child != 0 {
                let planes = kernel.child(&self.stack[top].planes, node, slot, &setup.way);
                self.keep(top, index, view.number, left);
                index = index.wrapping_add(node.first_child).wrapping_add(u32::from(byte & 7));
                self.stack[below].planes = planes;
            } else if byte & 0xc0 == BRICK && view.page.is_none() {
                let number = node.first_leaf.wrapping_add(u32::from(byte & 0x3f));
                let Some(brick) = self.octree.bricks().get(number as usize) else { continue };
                self.keep(top, index, view.number, left);
                self.counters.bricks += 1;
                view = self.view(number)?;
                index = 0;
                self.stack[below].planes = setup.planes(&brick_frame(brick));
            } else {
                continue;
            }
            top = below;
            node = view.node(index);
            left = self.touch(kernel, top, node, setup, far);
        }
    }

    /// Notes what is left of a level, to come back to it.
    #[inline(always)]
    fn keep(&mut self, top: usize, node: u32, page: u32, left: u32) {
        let level = &mut self.stack[top];
        (level.node, level.page, level.left) = (node, page, left);
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

    /// Tests the slots of the node whose frame stands in level `top`, where their entries go; the slots touched.
    #[inline(always)]
    fn touch<K: Kernel>(&mut self, kernel: K, top: usize, node: &Node, setup: &Setup, far: f32) -> u32 {
        self.counters.nodes += 1;
        let level = &mut self.stack[top];
        let touched = kernel.touch(node, &level.planes, &setup.way, far);
        level.near = touched.near;
        touched.slots
    }

    /// Tests the triangles of the leaf that slot byte `units` of a node names, and offers the hits.
    #[inline(always)]
    #[expect(clippy::too_many_arguments, reason = "the state of the walk, kept in registers")]
    fn leaf<K: Kernel>(
        &mut self,
        kernel: K,
        view: &View<'a>,
        index: u32,
        node: &Node,
        units: u8,
        setup: &Setup,
        far: &mut f32,
        collector: &mut impl Collector,
    ) -> Next {
        let Some(page) = &view.page else { return Next::On };
        if node.first_leaf == 0 {
            return Next::On;
        }
        let leaf = page.leaf(64 + 64 * index as usize + 16 * node.first_leaf as usize + self.unit * usize::from(units));
        self.counters.leaves += 1;
        self.counters.triangles += leaf.len() as u64;
        let lanes = kernel.classify(&leaf, &setup.shear);
        if lanes.accept | lanes.doubt == 0 {
            return Next::On;
        }
        self.settle(page, PageId(view.number), &leaf, lanes, setup, far, collector)
    }

    /// Decides what the filter left, exactly, and offers the hits.
    #[inline(always)]
    #[expect(clippy::too_many_arguments, reason = "the state of the walk, kept in registers")]
    fn settle(
        &mut self,
        page: &Page<'a>,
        id: PageId,
        leaf: &Leaf<'a>,
        lanes: Lanes,
        setup: &Setup,
        far: &mut f32,
        collector: &mut impl Collector,
    ) -> Next {
        self.counters.doubts += u64::from(lanes.doubt.count_ones());
        let mut left = lanes.accept | lanes.doubt;
        let mut next = Next::On;
        while left != 0 {
            let j = left.trailing_zeros();
            left &= left - 1;
            let triangle = leaf.triangle(j as usize);
            let line = &setup.line;
            let doubted = lanes.doubt >> j & 1 != 0;
            let Decision { crossing, exact } = if doubted { line.meet(&triangle) } else { line.accepted(&triangle) };
            self.counters.exact += u64::from(exact);
            let Some(crossing) = crossing else { continue };
            let place = Reference { page, id, reference: leaf.first().wrapping_add(j) };
            match collector.offer(line, crossing, &place) {
                Next::On => {}
                Next::Nearer => {
                    *far = far.min(setup.reach(collector.reach()));
                    next = Next::Nearer;
                }
                Next::Done => return Next::Done,
            }
        }
        next
    }
}

impl<'a> View<'a> {
    /// A node; an empty one where there is none of that number.
    #[inline(always)]
    fn node(&self, index: u32) -> &'a Node {
        self.nodes.get(index as usize).unwrap_or(&Node::EMPTY)
    }
}

/// A brick's own frame.
#[inline(always)]
fn brick_frame(brick: &Brick) -> Frame {
    Frame { corner: brick.corner.map(f64::from), unit: brick.unit.map(f64::from) }
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
