//! Level of detail: rays that have a width stop at a node that is smaller than they are wide.
//!
//! A ray that stands for a pixel need not tell triangles apart that lie within a small part of that pixel. It takes the node's
//! [surrogate](crate::format::Surrogate) in their place, if three things hold:
//!
//! 1. **The bound.** Let p be the point at which the ray meets the surrogate's plane within the node's box, and w the ray's width where it
//!    enters the box. The distance from p to the corner of the box farthest from it, in parts of w, is the *error*; it is at most what the caller
//!    allows, in pixels. Since every triangle of the node (its part that the node answers for) lies in the box, the true surface
//!    has a point within that distance of p; and if the ray hits a triangle of the node, that hit is within that distance too.
//! 2. **The slab.** The ray comes as near to the plane, within the box, as the surrogate's deviation. If it does not, it hits nothing of
//!    the node for certain, and passes.
//! 3. **A surface.** The triangles fill enough of the box as the ray sees it, and their normals agree enough for a mean
//!    to mean something (`wide`). Sparse nodes, silhouettes and crumpled ones are entered until the error is at most half
//!    of what is allowed: there they are taken as well.
//!
//! A leaf, which has no surrogate of its own, is judged by its own box and its parent's surrogate: what that says of all triangles below the
//! parent is true of the leaf's.
//!
//! So whatever the tree, a ray that truly hits something at t is given a hit no farther than t plus the error that is allowed: nothing is lost,
//! surfaces only grow, by that at most. The answer is the least t of all surrogates that were taken and all triangles in the nodes that were entered,
//! and whether a node is taken depends on the ray and the node alone: so answers depend neither on the order of visits nor on the kernel.
//!
//! That is so of rays from the eye, and of those that start on a triangle: these see the nodes around their start down to the triangles. A ray that starts
//! from a surrogate has its least t beyond the error of its start, where nothing is known; it passes nodes that it is in there and whose
//! plane it has crossed before, and farther on those surfaces whose plane, drawn out, it has crossed before: bumps of a surface above which it
//! has started may be lost to it, up to the error that is allowed, and what is nearer than three times that.
//!
//! The uppermost nodes of a brick are walked in its head ([`crate::format::HeadView`]): a page is used only where a ray goes below.
//!
//! The walk is that of `walk.rs`, one ray after the other, with boxes and planes in f64 beside it.

mod place;
mod wide;

use bytemuck::Zeroable;

use super::arch::{Job, Kernel, Saved};
use super::ask::{Leaves, Pause};
use super::collect::{Collector, Next};
use super::setup::{Scene, Setup};
use super::walk::{BRICK, EMPTY, File, INNER, LEVELS, Sight, View, cell_of};
use super::{Counters, Found};
use crate::exact::Depths;
use crate::format::{Frame, PageId, RootBox};
use crate::geometry::Ray;
use crate::map::{Detail, Halt, Visit};
use place::{At, Child, bounds_of, page_index, root};
use wide::{Verdict, Wide};

/// How wide a ray is: at its parameter t, `width + spread * t`, in the units of the mesh.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Footprint {
    /// At the origin.
    pub width: f64,
    /// For each unit of t.
    pub spread: f64,
    /// Whether the ray starts from a surrogate: then what it crosses before its least t is passed, for that may be the start itself.
    pub lifted: bool,
}

impl Footprint {
    /// Of a ray that is as thin as a line: it is traced exactly.
    pub const NONE: Footprint = Footprint { width: 0.0, spread: 0.0, lifted: false };
}

/// A surrogate that a ray took for its hit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Approximate {
    /// Where, in units of the direction.
    pub t: f32,
    /// Unit normal by the winding, in the mesh's space.
    pub normal: [f64; 3],
    /// Mean diffuse colour, linear.
    pub color: [f64; 3],
    /// How far the normals agree: the length of the mean of the unit normals, above 0 to 1.
    pub agreement: f64,
    /// How far anything of the node may lie from its plane, in the mesh's space.
    pub deviation: f64,
    /// How far the true surface may be, in the mesh's space.
    pub reach: f64,
    /// The same in the ray's widths: pixels. At most what was allowed.
    pub error: f64,
}

/// What a ray with a width meets.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Met {
    /// Nothing.
    Nothing,
    /// A triangle, exactly.
    Triangle(Found),
    /// A node.
    Surrogate(Approximate),
}

/// Rays with widths, to be answered with whichever kernel is there; `give` gets the number of each, what triangle it hits, and the
/// surrogate that it took if one is nearer.
pub(super) struct Coarse<'a, 'w, A, G, R> {
    pub ask: &'w A,
    pub rays: &'w [Ray],
    pub footprints: &'w [Footprint],
    /// Most error in pixels, above 0.
    pub pixels: f64,
    pub visit: &'a Visit<'a>,
    pub detail: Detail<'a>,
    pub scene: &'a Scene,
    pub counters: &'w mut Counters,
    pub give: G,
    /// Which ray is next, and behind which it ends.
    pub next: &'w mut usize,
    pub end: usize,
    /// What the next ray had found when a page was absent.
    pub held: &'w mut Held<R>,
}

/// A ray put aside at a page that is not in memory.
#[derive(Default)]
pub(super) struct Held<R> {
    /// The pages that it has been through: it walks again from the root and leaves these out. Whether a node is taken depends on the ray and
    /// the node alone, so nothing else changes.
    done: Vec<PageId>,
    /// The page that it walks in.
    under_way: Option<PageId>,
    rest: R,
    best: Option<Approximate>,
}

/// A node put aside, with slots left to visit.
#[derive(Clone, Copy)]
struct Level<'a> {
    saved: Saved,
    at: At<'a>,
    frame: Frame,
    left: u32,
}

impl<A: Pause, G: FnMut(usize, A::Answer, Option<Approximate>)> Job for Coarse<'_, '_, A, G, A::Rest> {
    type Output = Result<(), Halt>;

    #[inline(always)]
    fn run<K: Kernel>(mut self, kernel: K) -> Result<(), Halt> {
        let mut levels = Vec::with_capacity(LEVELS);
        let mut depths = Depths::BLANK;
        let mut sight = Sight::zeroed();
        let mut collector = A::idle();
        while *self.next < self.end {
            let i = *self.next;
            let (ray, footprint) = (&self.rays[i], &self.footprints[i]);
            self.ask.begin(i, ray, &mut collector);
            A::resume(std::mem::take(&mut self.held.rest), &mut collector);
            let mut best = self.held.best.take();
            if sight.setup.aim(kernel, ray, self.scene) {
                sight.shear = collector.shear(ray, self.scene.bounds);
                let line = Wide::new(ray, footprint, self.pixels, self.visit.octree());
                if let Err(halt) =
                    self.walk(kernel, &line, ray, &sight, &mut levels, &mut depths, &mut collector, &mut best)
                {
                    (self.held.rest, self.held.best) = (A::rest(&collector, ray), best);
                    return Err(halt);
                }
            }
            self.held.done.clear();
            self.held.under_way = None;
            self.counters.rays += 1;
            *self.next += 1;
            let give = &mut self.give;
            A::end(kernel, std::slice::from_ref(ray), std::slice::from_ref(&collector), |_, answer| {
                give(i, answer, best);
            });
        }
        Ok(())
    }
}

impl<'a, A: Pause, G> Coarse<'a, '_, A, G, A::Rest> {
    /// Walks one ray to its end, or to a page that is not in memory: gives the triangles to the collector, and the nearest surrogate to `best`.
    #[inline(always)]
    #[expect(clippy::too_many_arguments, reason = "what all rays of a batch share, made once")]
    fn walk<K: Kernel, C: Leaves<'a> + Collector<'a>>(
        &mut self,
        kernel: K,
        line: &Wide,
        ray: &Ray,
        sight: &Sight,
        levels: &mut Vec<Level<'a>>,
        depths: &mut Depths,
        collector: &mut C,
        best: &mut Option<Approximate>,
    ) -> Result<(), Halt> {
        let Setup { way, aim, .. } = &sight.setup;
        let (octree, detail) = (self.visit.octree(), self.detail);
        let file = File::new(self.visit, self.scene);
        let mask = usize::from(way.order & 7);
        // What was found before the ray was put aside.
        let mut far = sight.setup.far.min(sight.setup.reach(collector.reach()));
        if let Some(best) = best {
            far = far.min(sight.setup.reach(best.t));
        }
        let Some((mut at, mut frame, cell, surrogate)) = root(octree, &detail) else { return Ok(()) };
        match line.judge(surrogate, &frame, &bounds_of(octree)) {
            Verdict::Pass => return Ok(()),
            Verdict::Take(taken) => {
                *best = Some(taken);
                return Ok(());
            }
            Verdict::Enter => {}
        }
        levels.clear();
        let mut node = at.node(octree);
        let mut planes = kernel.frame(&cell, aim, way);
        let (mut left, mut near) = kernel.touch(node, planes, way, kernel.ends(way.near, far));
        self.counters.nodes += 1;
        'walk: loop {
            while left == 0 {
                let Some(level) = levels.pop() else { break 'walk };
                (planes, near) = kernel.load(&level.saved);
                left = level.left & kernel.within(near, far);
                (at, frame) = (level.at, level.frame);
                node = at.node(octree);
            }
            let slot = (left.trailing_zeros() & 7) as usize ^ mask;
            let byte = node.slots[slot];
            left &= left - 1;
            let rank = u32::from(byte & 0x3f);
            let (child, child_frame, cell) = if byte < EMPTY && node.first_leaf != 0 {
                (Child::Leaf, frame, None)
            } else if byte & 0xc0 == INNER && node.first_child != 0 {
                (at.child(node, rank & 7), frame.child(node, slot), None)
            } else if byte & BRICK == BRICK && matches!(at, At::Top(_)) {
                let number = node.first_leaf.wrapping_add(rank);
                if self.held.done.contains(&PageId(number)) {
                    continue;
                }
                let (Some(brick), Some(head)) = (file.brick(number), detail.head(PageId(number))) else { continue };
                let cell = cell_of(brick);
                let frame = Frame { corner: cell.corner.map(f64::from), unit: cell.unit.map(f64::from) };
                (Child::At(At::Head(PageId(number), head, 0)), frame, Some(cell))
            } else {
                continue;
            };
            match line.judge(child.surrogate(&at, &detail, rank), &child_frame, &RootBox::of_slot(node, slot, &frame)) {
                Verdict::Pass => continue,
                Verdict::Take(taken) => {
                    // Two leaves may have the same plane, their parent's: then the one with the lesser error.
                    let rank = |a: &Approximate| (a.t, a.reach);
                    if best.as_ref().is_none_or(|best| rank(&taken) < rank(best)) {
                        *best = Some(taken);
                        far = far.min(sight.setup.reach(taken.t));
                        left &= kernel.within(near, far);
                    }
                    if A::FIRST {
                        break 'walk;
                    }
                    continue;
                }
                Verdict::Enter => {}
            }
            if let Child::Leaf = child {
                if let At::Head(brick, head, i) = at {
                    // Leaves are in the page only; the node is the same there.
                    at = At::Page(self.enter(&file, brick)?, page_index(&head, i));
                    node = at.node(octree);
                }
                let At::Page(view, index) = at else { continue };
                let Some(stored) = file.stored(&view, index, node, byte, self.counters) else { continue };
                match collector.leaf(kernel, &stored, ray, sight, depths, &mut far, self.counters) {
                    Next::On => {}
                    Next::Nearer => left &= kernel.within(near, far),
                    Next::Done => break 'walk,
                }
                continue;
            }
            if left != 0 && levels.len() < LEVELS {
                let mut level = Level { saved: Saved::zeroed(), at, frame, left };
                kernel.save(&mut level.saved, planes, near);
                levels.push(level);
            }
            planes = match cell {
                Some(cell) => kernel.frame(&cell, aim, way),
                None => kernel.child(planes, node, slot, way),
            };
            at = match child {
                Child::At(at) => at,
                Child::Below(brick, index) => At::Page(self.enter(&file, brick)?, index),
                Child::Leaf => continue,
            };
            (frame, node) = (child_frame, at.node(octree));
            self.counters.nodes += 1;
            (left, near) = kernel.touch(node, planes, way, kernel.ends(way.near, far));
        }
        Ok(())
    }

    /// A page, which is used from here on. When another is entered, the one before is done with.
    fn enter(&mut self, file: &File<'a>, brick: PageId) -> Result<View<'a>, Halt> {
        if self.held.under_way != Some(brick) {
            self.held.done.extend(self.held.under_way.take());
        }
        let view = file.view(brick.0)?;
        self.held.under_way = Some(brick);
        self.counters.bricks += 1;
        Ok(view)
    }
}
