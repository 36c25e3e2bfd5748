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

use super::arch::{Isa, Job, Kernel, Saved};
use super::collect::{Any, Closest, Collector, Next, Place, Stored};
use super::setup::{Scene, Setup};
use super::{Counters, Found, Tracer, batch};
use crate::error::Result;
use crate::exact::{Decision, Depths, Lanes, Line, Shear};
use crate::format::{Brick, DEPTH_MAX, Frame, Node, PageId};
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
    type Collector<'a>: Collector<'a>;
    type Answer;
    /// The answer where nothing is hit.
    const NOTHING: Self::Answer;
    fn begin<'a>(&self, ray: &Ray) -> Self::Collector<'a>;
    fn end(collector: Self::Collector<'_>, ray: &Ray) -> Self::Answer;
}

/// The closest hit, after `last` if that is given.
struct Least<'f> {
    skip: Skip,
    last: Option<&'f Found>,
}

impl Ask for Least<'_> {
    type Collector<'a> = Closest<'a>;
    type Answer = Option<Found>;
    const NOTHING: Option<Found> = None;

    #[inline(always)]
    fn begin<'a>(&self, ray: &Ray) -> Closest<'a> {
        self.last.map_or_else(|| Closest::new(self.skip), |last| Closest::after(self.skip, &Line::new(ray), last))
    }

    #[inline(always)]
    fn end(collector: Closest<'_>, ray: &Ray) -> Option<Found> {
        collector.found(ray)
    }
}

/// The closest hit without where it is stored.
struct LeastHit;

impl Ask for LeastHit {
    type Collector<'a> = Closest<'a>;
    type Answer = Hit;
    const NOTHING: Hit = Hit::MISS;

    #[inline(always)]
    fn begin<'a>(&self, _: &Ray) -> Closest<'a> {
        Closest::new(Skip::NONE)
    }

    #[inline(always)]
    fn end(collector: Closest<'_>, ray: &Ray) -> Hit {
        collector.hit(ray)
    }
}

/// Whether anything is hit.
struct Whether(Skip);

impl Ask for Whether {
    type Collector<'a> = Any<'a>;
    type Answer = bool;
    const NOTHING: bool = false;

    #[inline(always)]
    fn begin<'a>(&self, _: &Ray) -> Any<'a> {
        Any::new(self.0)
    }

    #[inline(always)]
    fn end(collector: Any<'_>, _: &Ray) -> bool {
        collector.found
    }
}

/// Levels that a walk can need: a node of each depth, of the top and of a page.
const LEVELS: usize = 2 * DEPTH_MAX as usize;

thread_local! {
    /// Each thread's stack, kept so that a ray allocates nothing.
    static STACK: RefCell<Box<[Level; LEVELS]>> = RefCell::new(Box::new([Level::zeroed(); LEVELS]));
}

/// A node put aside, with slots left to visit.
#[derive(Clone, Copy, Zeroable)]
#[repr(C, align(32))]
struct Level {
    saved: Saved,
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
        let mut sight = Sight { setup: Setup::blank(), shear: Shear::default(), depths: Depths::BLANK };
        let mut start = None;
        for (ray, answer) in self.rays.iter().zip(self.answers) {
            if !(ray.is_valid() && sight.setup.aim(ray, self.scene)) {
                *answer = A::NOTHING;
                continue;
            }
            let start = match &start {
                Some(start) => start,
                None => start.insert(self.walk.start()?),
            };
            let mut collector = self.ask.begin(ray);
            self.walk.run(kernel, start, ray, self.scene, &mut sight, &mut collector)?;
            *answer = A::end(collector, ray);
        }
        Ok(())
    }
}

/// A ray prepared for nodes, and once it meets a leaf, for triangles. Made once for all rays of a batch.
struct Sight {
    setup: Setup,
    shear: Shear,
    depths: Depths,
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
        ray: &Ray,
        scene: &Scene,
        sight: &mut Sight,
        collector: &mut impl Collector<'a>,
    ) -> Result<()> {
        let mut view = start.view;
        let mask = usize::from(sight.setup.way.mask & 7);
        // The parameter beyond which nothing matters.
        let mut far = sight.setup.far;
        let (mut nodes, mut bricks) = (1, u64::from(view.page.is_some()));
        // The node under way, the frame and the entries of its slots, and those left to visit.
        let (mut top, mut index) = (0, 0);
        let mut node = view.node(index);
        let mut frame = kernel.frame(&sight.setup.planes(&start.frame), &sight.setup.way);
        let (mut left, mut near) = kernel.touch(node, frame, &sight.setup.way, far);
        let mut sheared = false;
        'walk: loop {
            while left == 0 {
                if top == 0 {
                    break 'walk;
                }
                top -= 1;
                let level = &self.stack[top];
                (frame, near) = kernel.load(&level.saved);
                left = level.left & kernel.within(near, far);
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
                let Some(stored) = self.stored(&view, index, node, byte) else { continue };
                if !sheared {
                    sheared = true;
                    sight.shear = Shear::new(ray, scene.bounds);
                }
                match self.leaf(kernel, &stored, ray, sight, &mut far, collector) {
                    Next::On => {}
                    Next::Nearer => left &= kernel.within(near, far),
                    Next::Done => break 'walk,
                }
                continue;
            }
            if byte & 0xc0 == INNER && node.first_child != 0 {
                if left != 0 {
                    top = self.keep(kernel, top, frame, near, index, view.number, left);
                }
                frame = kernel.child(frame, node, slot, &sight.setup.way);
                index = index.wrapping_add(node.first_child).wrapping_add(u32::from(byte & 7));
            } else if byte & 0xc0 == BRICK && view.page.is_none() {
                let number = node.first_leaf.wrapping_add(u32::from(byte & 7));
                let Some(brick) = self.octree.bricks().get(number as usize) else { continue };
                if left != 0 {
                    top = self.keep(kernel, top, frame, near, index, view.number, left);
                }
                bricks += 1;
                view = self.view(number)?;
                index = 0;
                frame = kernel.frame(&sight.setup.planes(&brick_frame(brick)), &sight.setup.way);
            } else {
                continue;
            }
            node = view.node(index);
            nodes += 1;
            (left, near) = kernel.touch(node, frame, &sight.setup.way, far);
        }
        self.counters.nodes += nodes;
        self.counters.bricks += bricks;
        Ok(())
    }

    /// Puts a node aside that has slots left, to come back to it; the number of levels then.
    #[inline(always)]
    #[expect(clippy::too_many_arguments, reason = "the state of the walk, kept in registers")]
    fn keep<K: Kernel>(
        &mut self,
        kernel: K,
        top: usize,
        frame: K::Frame,
        near: K::Near,
        node: u32,
        page: u32,
        left: u32,
    ) -> usize {
        let level = &mut self.stack[top];
        kernel.save(&mut level.saved, frame, near);
        (level.node, level.page, level.left) = (node, page, left);
        (top + 1).min(LEVELS - 1)
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

    /// The leaf that slot byte `units` of node `index` names.
    #[inline(always)]
    fn stored(&mut self, view: &View<'a>, index: u32, node: &Node, units: u8) -> Option<Stored<'a>> {
        let page = view.page?;
        if node.first_leaf == 0 {
            return None;
        }
        let leaf = page.leaf(64 + 64 * index as usize + 16 * node.first_leaf as usize + self.unit * usize::from(units));
        self.counters.leaves += 1;
        self.counters.triangles += leaf.len() as u64;
        Some(Stored { page, id: PageId(view.number), leaf })
    }

    /// Tests the triangles of a leaf, and gives the hits to the collector.
    #[inline(always)]
    fn leaf<K: Kernel>(
        &mut self,
        kernel: K,
        stored: &Stored<'a>,
        ray: &Ray,
        sight: &mut Sight,
        far: &mut f32,
        collector: &mut impl Collector<'a>,
    ) -> Next {
        let reach = collector.reach();
        let range = [ray.tmin, if reach < ray.tmax { reach } else { ray.tmax }];
        let lanes = kernel.classify(&stored.leaf, &sight.shear, range, &mut sight.depths);
        if lanes.accept | lanes.doubt == 0 {
            return Next::On;
        }
        let next = match collector.glance(ray, lanes, &sight.depths, stored) {
            Some(next) => next,
            None => self.settle(stored, lanes, ray, collector),
        };
        if next == Next::Nearer {
            *far = far.min(sight.setup.reach(collector.reach()));
        }
        next
    }

    /// Decides exactly what bounds did not, and offers the hits.
    #[inline(never)]
    fn settle(
        &mut self,
        stored: &Stored<'a>,
        lanes: Lanes,
        ray: &Ray,
        collector: &mut impl Collector<'a>,
    ) -> Next {
        self.counters.doubts += u64::from(lanes.doubt.count_ones());
        let line = Line::new(ray);
        let mut left = lanes.accept | lanes.doubt;
        let mut next = Next::On;
        while left != 0 {
            let j = left.trailing_zeros();
            left &= left - 1;
            let triangle = stored.leaf.triangle(j as usize);
            let doubted = lanes.doubt >> j & 1 != 0;
            let Decision { crossing, exact } = if doubted { line.meet(&triangle) } else { line.accepted(&triangle) };
            self.counters.exact += u64::from(exact);
            let Some(crossing) = crossing else { continue };
            match collector.offer(&line, crossing, &Reference { stored, lane: j }) {
                Next::On => {}
                Next::Nearer => next = Next::Nearer,
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

/// A triangle of a leaf.
struct Reference<'p, 'a> {
    stored: &'p Stored<'a>,
    lane: u32,
}

impl Place for Reference<'_, '_> {
    fn face(&self) -> FaceId {
        self.stored.page.face(self.reference())
    }
    fn page(&self) -> PageId {
        self.stored.id
    }
    fn reference(&self) -> u32 {
        self.stored.leaf.first().wrapping_add(self.lane)
    }
}
