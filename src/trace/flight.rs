//! Many rays under way at once on one thread, sorted by the kind of step that each needs next.
//!
//! A single walk is a chain of dependent steps; on a large file, among rays that have nothing to do with each other, each waits for memory. Here
//! each ray stands in the queue of the step that it needs next, what that step will load is asked for when the ray joins the queue, and a
//! round goes over one queue after the other. Within a queue all rays do the same, without a branch, so that many loads are under way.

use std::cell::RefCell;

use bytemuck::Zeroable;

use super::Counters;
use super::arch::{Job, Kernel};
use super::ask::Ask;
use super::collect::{Collector, Next, Stored};
use super::setup::Setup;
use super::walk::{BRICK, EMPTY, File, LEVELS, Level, Start, TOP, View, cell_of, range, take};
use crate::error::Result;
use crate::exact::{Depths, LANES, Lanes, Shear};
use crate::format::Node;
use crate::geometry::Ray;

/// Rays under way at once; a power of two.
const RAYS: usize = 32;

/// From so many rays on a batch is worth preparing for.
pub(super) const WORTHWHILE: usize = 4 * RAYS;

/// A ray's stack; the last level in use is that of the node under way, and the first says that the walk is over. The odd size keeps the
/// stacks of all rays from meeting in the same cache sets.
#[derive(Clone, Copy, Zeroable)]
#[repr(C, align(64))]
pub(super) struct Stack {
    levels: [Level; DEPTH],
    apart: [u8; 320],
}

/// Levels of a stack; a power of two.
const DEPTH: usize = (LEVELS + 2).next_power_of_two();

/// Stacks for all rays under way.
pub(super) type Stacks = [Stack; RAYS];

thread_local! {
    /// Each thread's stacks, kept so that a batch allocates nothing.
    pub(super) static STACKS: RefCell<Box<Stacks>> = RefCell::new(bytemuck::zeroed_box());
}

/// Rays to be walked many at a time, with whichever kernel is there.
pub(super) struct Flight<'a, 'w, A: Ask> {
    pub ask: A,
    pub rays: &'w [Ray],
    pub answers: &'w mut [A::Answer],
    pub file: File<'a>,
    pub counters: &'w mut Counters,
    pub stacks: &'w mut Stacks,
}

/// A ray under way.
#[repr(align(64))]
struct Flying<'a, K: Kernel, C> {
    setup: Setup,
    /// The parameter beyond which nothing matters.
    far: f32,
    ends: K::Ends,
    /// The level of the node under way.
    top: u32,
    /// The nodes of the page or the top that it is in.
    nodes: &'a [Node],
    /// The page entered last; while nodes are those of the top it is not used.
    view: View<'a>,
    shear: Shear,
    depths: Depths,
    /// The leaf that was found last, and the filter's word on its triangles.
    leaf: Option<Stored<'a>>,
    lanes: Lanes,
    ray: Ray,
    /// The ray's place in the batch.
    place: usize,
    collector: C,
}

/// What a ray needs next.
#[derive(Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
enum Step {
    /// Its next slot is an inner node of the same page.
    Inner,
    /// A leaf.
    Leaf,
    /// A page.
    Brick,
    /// Nothing is left of the node, or the slot is empty.
    Back,
    /// Triangles of a leaf may be hit.
    Hit,
    /// The walk is over.
    End,
}

/// The step that a slot byte asks for; behind these 256, where no slot is left.
static STEPS: [Step; 512] = {
    let mut steps = [Step::Back; 512];
    let mut byte = 0;
    while byte < 256 {
        steps[byte] = match byte as u8 {
            EMPTY => Step::Back,
            byte if byte < EMPTY => Step::Leaf,
            byte if byte & BRICK == BRICK => Step::Brick,
            _ => Step::Inner,
        };
        byte += 1;
    }
    steps
};

/// The rays by what they need next.
struct Queues {
    rays: [[u8; RAYS]; 8],
    counts: [u8; 8],
}

impl Queues {
    #[inline(always)]
    fn push(&mut self, step: Step, ray: u8) {
        let count = &mut self.counts[step as usize & 7];
        self.rays[step as usize & 7][usize::from(*count) % RAYS] = ray;
        *count += 1;
    }

    /// Empties a queue.
    #[inline(always)]
    fn take(&mut self, step: Step) -> ([u8; RAYS], usize) {
        let count = std::mem::take(&mut self.counts[step as usize & 7]);
        (self.rays[step as usize & 7], usize::from(count).min(RAYS))
    }
}

impl<A: Ask> Job for Flight<'_, '_, A>
where
    for<'c> A::Collector<'c>: Collector<'c>,
{
    type Output = Result<()>;

    #[inline(always)]
    fn run<K: Kernel>(self, kernel: K) -> Result<()> {
        let Flight { ask, rays, answers, file, counters, stacks } = self;
        counters.rays += rays.len() as u64;
        let start = file.start()?;
        let top = file.view(TOP)?.nodes;
        let mut flying: [Flying<'_, K, A::Collector<'_>>; RAYS] = std::array::from_fn(|_| Flying {
            setup: Setup::zeroed(),
            far: 0.0,
            ends: kernel.ends(0.0, 0.0),
            top: 0,
            nodes: start.view.nodes,
            view: start.view,
            shear: Shear::default(),
            depths: Depths::BLANK,
            leaf: None,
            lanes: Lanes { accept: 0, doubt: 0 },
            ray: Ray::new([0.0; 3], [0.0; 3]),
            place: 0,
            collector: A::idle(),
        });
        let mut queues = Queues { rays: [[0; RAYS]; 8], counts: [0; 8] };
        let mut waiting = Waiting { rays, next: 0 };
        // Those on the ground, not yet launched.
        let mut ground: [u8; RAYS] = std::array::from_fn(|i| i as u8);
        let mut grounded = RAYS;
        let mut inners = 0;
        loop {
            // Launch what can be launched, up to sixteen at once.
            while grounded > 0 && waiting.next < rays.len() {
                let count = launch(
                    kernel,
                    &ask,
                    &mut waiting,
                    answers,
                    &file,
                    &start,
                    &mut flying,
                    stacks,
                    &ground[..grounded],
                    &mut queues,
                    counters,
                );
                grounded -= count;
            }
            if grounded == RAYS {
                break;
            }
            // Into nodes: first where they lie and their frames, then, when they have come, which of their slots the rays touch.
            let (mut those, mut count) = queues.take(Step::Inner);
            for &i in &those[..count] {
                descend(kernel, &mut flying[usize::from(i) % RAYS], &mut stacks[usize::from(i) % RAYS].levels);
            }
            let (entering, bricks) = queues.take(Step::Brick);
            for &i in &entering[..bricks] {
                let (ray, stack) = (&mut flying[usize::from(i) % RAYS], &mut stacks[usize::from(i) % RAYS].levels);
                if enter(kernel, &file, ray, stack)? {
                    those[count % RAYS] = i;
                    count += 1;
                    counters.bricks += 1;
                } else {
                    queues.push(Step::Back, i);
                }
            }
            inners += count as u64;
            for &i in &those[..count] {
                let step =
                    touch(kernel, &file, &mut flying[usize::from(i) % RAYS], &mut stacks[usize::from(i) % RAYS].levels);
                queues.push(step, i);
            }
            // Leaves likewise.
            let (those, count) = queues.take(Step::Leaf);
            for &i in &those[..count] {
                let (ray, stack) = (&mut flying[usize::from(i) % RAYS], &mut stacks[usize::from(i) % RAYS].levels);
                find(&file, ray, stack, counters);
            }
            for &i in &those[..count] {
                let (ray, stack) = (&mut flying[usize::from(i) % RAYS], &mut stacks[usize::from(i) % RAYS].levels);
                let step = test(kernel, &file, ray, stack);
                queues.push(step, i);
            }
            let (those, count) = queues.take(Step::Hit);
            for &i in &those[..count] {
                let (ray, stack) = (&mut flying[usize::from(i) % RAYS], &mut stacks[usize::from(i) % RAYS].levels);
                let step = hit(kernel, &file, ray, stack, counters);
                queues.push(step, i);
            }
            let (those, count) = queues.take(Step::Back);
            for &i in &those[..count] {
                let step = back(
                    kernel,
                    &file,
                    top,
                    &mut flying[usize::from(i) % RAYS],
                    &mut stacks[usize::from(i) % RAYS].levels,
                );
                queues.push(step, i);
            }
            let ended = usize::from(queues.counts[Step::End as usize]);
            if ended >= LANES || ended + grounded == RAYS {
                let (those, count) = queues.take(Step::End);
                for those in those[..count].chunks(LANES) {
                    let mut places = [0; LANES];
                    let mut ended = [Ray::new([0.0; 3], [0.0; 3]); LANES];
                    let collectors: [A::Collector<'_>; LANES] = std::array::from_fn(|k| {
                        let Some(&i) = those.get(k) else { return A::idle() };
                        let ray = &mut flying[usize::from(i) % RAYS];
                        (places[k], ended[k]) = (ray.place, ray.ray);
                        std::mem::replace(&mut ray.collector, A::idle())
                    });
                    let count = those.len();
                    A::end(kernel, &ended[..count], &collectors[..count], |k, answer| answers[places[k]] = answer);
                }
                for &i in &those[..count] {
                    ground[grounded % RAYS] = i;
                    grounded += 1;
                }
            }
        }
        counters.nodes += inners;
        Ok(())
    }
}

/// Rays not yet launched.
struct Waiting<'w> {
    rays: &'w [Ray],
    next: usize,
}

/// Takes up to sixteen rays from the ground, the last ones of `ground`; how many.
#[inline(always)]
#[expect(clippy::too_many_arguments, reason = "the state of a batch")]
fn launch<'a, K: Kernel, A: Ask>(
    kernel: K,
    ask: &A,
    waiting: &mut Waiting<'_>,
    answers: &mut [A::Answer],
    file: &File<'a>,
    start: &Start<'a>,
    flying: &mut [Flying<'a, K, A::Collector<'a>>; RAYS],
    stacks: &mut Stacks,
    ground: &[u8],
    queues: &mut Queues,
    counters: &mut Counters,
) -> usize {
    let mut launched = 0;
    let mut those = [0; LANES];
    while launched < LANES.min(ground.len()) && waiting.next < waiting.rays.len() {
        let place = waiting.next;
        waiting.next += 1;
        let (i, ray) = (ground[ground.len() - 1 - launched], &waiting.rays[place]);
        let aloft = &mut flying[usize::from(i) % RAYS];
        if !aloft.setup.aim(kernel, ray, file.scene) {
            answers[place] = A::NOTHING;
            continue;
        }
        (aloft.ray, aloft.place) = (*ray, place);
        let setup = &aloft.setup;
        let frame = kernel.frame(&start.cell, &setup.aim, &setup.way);
        let (left, near) = kernel.touch(start.view.node(0), frame, &setup.way, kernel.ends(setup.way.near, setup.far));
        counters.nodes += 1;
        counters.bricks += u64::from(start.view.page.is_some());
        if left == 0 {
            answers[place] = A::NOTHING;
            continue;
        }
        let [end, root, ..] = &mut stacks[usize::from(i) % RAYS].levels;
        (end.left, end.page) = (0, start.view.number);
        kernel.save(&mut root.saved, frame, near);
        (root.node, root.page, root.left) = (0, start.view.number, left);
        aloft.ends = kernel.ends(setup.way.near, setup.far);
        (aloft.far, aloft.top, aloft.nodes, aloft.view) = (setup.far, 1, start.view.nodes, start.view);
        queues.push(step(kernel, file, start.view.node(0), left, setup.way.order), i);
        those[launched] = i;
        launched += 1;
    }
    for &i in &those[..launched] {
        let aloft = &mut flying[usize::from(i) % RAYS];
        ask.begin(aloft.place, &aloft.ray, &mut aloft.collector);
        aloft.shear = Shear::new(&aloft.ray, file.scene.bounds);
    }
    launched
}

/// What the first slot that is left of a node needs.
#[inline(always)]
fn step<K: Kernel>(kernel: K, file: &File<'_>, node: &Node, left: u32, order: u8) -> Step {
    file.ahead(kernel, node, left, order.into());
    let slot = (left.trailing_zeros() as u8 ^ order) & 7;
    // By arithmetic alone: as a branch this would be foreseen wrongly at every other node.
    STEPS[usize::from(node.slots[usize::from(slot)]) | usize::from(left == 0) << 8]
}

/// A node; an empty one where there is none of that number.
#[inline(always)]
fn node(nodes: &[Node], index: u32) -> &Node {
    nodes.get(index as usize).unwrap_or(&Node::EMPTY)
}

/// The first slot that is left of a level, which is then no longer left.
#[inline(always)]
fn next_slot(level: &mut Level, order: u8) -> usize {
    let slot = (level.left.trailing_zeros() as u8 ^ order) & 7;
    level.left &= level.left.wrapping_sub(1);
    slot.into()
}

/// Goes into the next slot, an inner node: makes its level, of which only the slots are missing.
#[inline(always)]
fn descend<C, K: Kernel>(kernel: K, aloft: &mut Flying<'_, K, C>, stack: &mut [Level; DEPTH]) {
    let way = &aloft.setup.way;
    let top = aloft.top as usize % DEPTH;
    let level = &mut stack[top];
    let parent = node(aloft.nodes, level.node);
    let slot = next_slot(level, way.order);
    let index = level.node.wrapping_add(parent.first_child).wrapping_add(u32::from(parent.slots[slot] & 7));
    let (frame, near) = kernel.load(&level.saved);
    let frame = kernel.child(frame, parent, slot, way);
    let page = level.page;
    // Where nothing is left the level is not come back to.
    let top = (top + usize::from(level.left != 0)) % DEPTH;
    let level = &mut stack[top];
    kernel.save(&mut level.saved, frame, near);
    (level.node, level.page) = (index, page);
    aloft.top = top as u32;
}

/// Enters the next slot's page likewise; false if there is none.
#[inline(always)]
fn enter<'a, C, K: Kernel>(
    kernel: K,
    file: &File<'a>,
    aloft: &mut Flying<'a, K, C>,
    stack: &mut [Level; DEPTH],
) -> Result<bool> {
    let Setup { way, aim, .. } = &aloft.setup;
    let top = aloft.top as usize % DEPTH;
    let level = &mut stack[top];
    let parent = node(aloft.nodes, level.node);
    let slot = usize::from((level.left.trailing_zeros() as u8 ^ way.order) & 7);
    let number = parent.first_leaf.wrapping_add(u32::from(parent.slots[slot] & 0x3f));
    let (Some(brick), TOP) = (file.brick(number), level.page) else { return Ok(false) };
    level.left &= level.left.wrapping_sub(1);
    let top = (top + usize::from(level.left != 0)) % DEPTH;
    aloft.view = file.view(number)?;
    aloft.nodes = aloft.view.nodes;
    kernel.fetch(node(aloft.nodes, 0), 0);
    let (_, near) = kernel.load(&level.saved);
    let frame = kernel.frame(&cell_of(brick), aim, way);
    let level = &mut stack[top];
    kernel.save(&mut level.saved, frame, near);
    (level.node, level.page) = (0, number);
    aloft.top = top as u32;
    Ok(true)
}

/// Finds the slots that the ray touches of the node that it went into.
#[inline(always)]
fn touch<C, K: Kernel>(kernel: K, file: &File<'_>, aloft: &mut Flying<'_, K, C>, stack: &mut [Level; DEPTH]) -> Step {
    let way = &aloft.setup.way;
    let level = &mut stack[aloft.top as usize % DEPTH];
    let (frame, _) = kernel.load(&level.saved);
    let node = node(aloft.nodes, level.node);
    let (left, near) = kernel.touch(node, frame, way, aloft.ends);
    kernel.save(&mut level.saved, frame, near);
    level.left = left;
    step(kernel, file, node, left, way.order)
}

/// Finds the next slot's leaf.
#[inline(always)]
fn find<'a, C, K: Kernel>(
    file: &File<'a>,
    aloft: &mut Flying<'a, K, C>,
    stack: &mut [Level; DEPTH],
    counters: &mut Counters,
) {
    let level = &mut stack[aloft.top as usize % DEPTH];
    let parent = node(aloft.nodes, level.node);
    let slot = next_slot(level, aloft.setup.way.order);
    aloft.leaf = file.stored(&aloft.view, level.node, parent, parent.slots[slot], counters);
}

/// Tests the triangles of the leaf that was found.
#[inline(always)]
fn test<'a, C: Collector<'a>, K: Kernel>(
    kernel: K,
    file: &File<'a>,
    aloft: &mut Flying<'a, K, C>,
    stack: &[Level; DEPTH],
) -> Step {
    let level = &stack[aloft.top as usize % DEPTH];
    let next = step(kernel, file, node(aloft.nodes, level.node), level.left, aloft.setup.way.order);
    let Some(stored) = &aloft.leaf else { return next };
    let range = range(&aloft.ray, &aloft.collector);
    aloft.lanes = kernel.classify(&stored.leaf, &aloft.shear, range, &mut aloft.depths);
    if aloft.lanes.accept | aloft.lanes.doubt != 0 { Step::Hit } else { next }
}

/// Takes the hits of the leaf that was tested last.
#[inline(always)]
fn hit<'a, C: Collector<'a>, K: Kernel>(
    kernel: K,
    file: &File<'a>,
    aloft: &mut Flying<'a, K, C>,
    stack: &mut [Level; DEPTH],
    counters: &mut Counters,
) -> Step {
    let Flying { setup, far, ends, nodes, depths, leaf, lanes, ray, collector, .. } = aloft;
    let level = &mut stack[aloft.top as usize % DEPTH];
    if let Some(stored) = leaf {
        match take(stored, *lanes, ray, setup, depths, far, collector, counters) {
            Next::On => {}
            Next::Nearer => {
                level.left &= kernel.within(kernel.load(&level.saved).1, *far);
                *ends = kernel.ends(setup.way.near, *far);
            }
            Next::Done => return Step::End,
        }
    }
    step(kernel, file, node(nodes, level.node), level.left, setup.way.order)
}

/// Comes back to a node put aside before, or passes over an empty slot.
#[inline(always)]
fn back<'a, C, K: Kernel>(
    kernel: K,
    file: &File<'a>,
    top_nodes: &'a [Node],
    aloft: &mut Flying<'a, K, C>,
    stack: &mut [Level; DEPTH],
) -> Step {
    let top = aloft.top as usize % DEPTH;
    let rest = stack[top].left & stack[top].left.wrapping_sub(1);
    let top = top.wrapping_sub(usize::from(rest == 0)) % DEPTH;
    let level = &mut stack[top];
    let left = if rest == 0 { level.left } else { rest };
    let (_, near) = kernel.load(&level.saved);
    level.left = left & kernel.within(near, aloft.far);
    // A page's levels follow upon each other, so this one is of the page entered last, or of the top.
    aloft.nodes = if level.page == TOP { top_nodes } else { aloft.view.nodes };
    aloft.top = top as u32;
    let next = step(kernel, file, node(aloft.nodes, level.node), level.left, aloft.setup.way.order);
    if top == 0 { Step::End } else { next }
}
