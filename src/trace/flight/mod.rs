//! Many rays under way at once on one thread, sorted by the kind of step that each needs next.
//!
//! A single walk is a chain of dependent steps; on a large file, among rays that have nothing to do with each other, each waits for memory. Here
//! each ray stands in the queue of the step that it needs next, what that step will load is asked for when the ray joins the queue, and a
//! round goes over one queue after the other. Within a queue all rays do the same, without a branch, so that many loads are under way.

mod step;

use std::cell::RefCell;

use bytemuck::Zeroable;

use super::Counters;
use super::arch::{Job, Kernel};
use super::ask::{Answer, Pause};
use super::collect::Stored;
use super::setup::Setup;
use super::walk::{File, LEVELS, Level, Start, TOP, View};
use crate::exact::{Depths, LANES, Lanes, Shear};
use crate::format::Node;
use crate::geometry::Ray;
use crate::map::Halt;
use step::{Step, back, descend, enter, find, hit, step, test, touch};

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
pub(super) struct Flight<'a, 'w, A: Pause> {
    pub ask: &'w A,
    pub rays: &'w [Ray],
    /// The first ray to be walked; those before it are left alone.
    pub first: usize,
    pub answers: &'w mut [A::Answer],
    pub file: File<'a>,
    pub counters: &'w mut Counters,
    pub stacks: &'w mut Stacks,
    /// Takes the rays that are not answered, since a page that they need is not in memory.
    pub left: &'w mut Vec<usize>,
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

impl<A: Pause> Job for Flight<'_, '_, A> {
    type Output = Result<(), Halt>;

    #[inline(always)]
    fn run<K: Kernel>(self, kernel: K) -> Result<(), Halt> {
        let Flight { ask, rays, first, answers, file, counters, stacks, left } = self;
        counters.rays += rays.len().saturating_sub(first) as u64;
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
        let mut waiting = Waiting { rays, next: first };
        // Those on the ground, not yet launched.
        let mut ground: [u8; RAYS] = std::array::from_fn(|i| i as u8);
        let mut grounded = RAYS;
        let mut inners = 0;
        loop {
            // Launch what can be launched, up to sixteen at once.
            while grounded > 0 && waiting.next < rays.len() {
                let count = launch(
                    kernel,
                    ask,
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
                let (ray, stack) = at(&mut flying, stacks, i);
                descend(kernel, ray, stack);
            }
            let (entering, bricks) = queues.take(Step::Brick);
            for &i in &entering[..bricks] {
                let (ray, stack) = at(&mut flying, stacks, i);
                match enter(kernel, &file, ray, stack) {
                    Ok(true) => {
                        those[count % RAYS] = i;
                        count += 1;
                        counters.bricks += 1;
                    }
                    Ok(false) => queues.push(Step::Back, i),
                    Err(Halt::Absent(_)) => {
                        left.push(ray.place);
                        ground[grounded % RAYS] = i;
                        grounded += 1;
                    }
                    Err(failed) => return Err(failed),
                }
            }
            inners += count as u64;
            for &i in &those[..count] {
                let (ray, stack) = at(&mut flying, stacks, i);
                queues.push(touch(kernel, &file, ray, stack), i);
            }
            // Leaves likewise.
            let (those, count) = queues.take(Step::Leaf);
            for &i in &those[..count] {
                let (ray, stack) = at(&mut flying, stacks, i);
                find(&file, ray, stack, counters);
            }
            for &i in &those[..count] {
                let (ray, stack) = at(&mut flying, stacks, i);
                queues.push(test(kernel, &file, ray, stack), i);
            }
            let (those, count) = queues.take(Step::Hit);
            for &i in &those[..count] {
                let (ray, stack) = at(&mut flying, stacks, i);
                queues.push(hit(kernel, &file, ray, stack, counters), i);
            }
            let (those, count) = queues.take(Step::Back);
            for &i in &those[..count] {
                let (ray, stack) = at(&mut flying, stacks, i);
                queues.push(back(kernel, &file, top, ray, stack), i);
            }
            let ended = usize::from(queues.counts[Step::End as usize]);
            if ended >= LANES || ended + grounded == RAYS {
                let (those, count) = queues.take(Step::End);
                for those in those[..count].chunks(LANES) {
                    land::<K, A>(kernel, &mut flying, those, answers);
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

/// A ray and its stack.
#[inline(always)]
fn at<'s, F>(flying: &'s mut [F; RAYS], stacks: &'s mut Stacks, i: u8) -> (&'s mut F, &'s mut [Level; DEPTH]) {
    (&mut flying[usize::from(i) % RAYS], &mut stacks[usize::from(i) % RAYS].levels)
}

/// Gives the answers to up to sixteen rays whose walks are over.
#[inline(always)]
fn land<'a, K: Kernel, A: Pause>(
    kernel: K,
    flying: &mut [Flying<'a, K, A::Collector<'a>>; RAYS],
    those: &[u8],
    answers: &mut [A::Answer],
) {
    let (mut places, mut rays) = ([0; LANES], [Ray::new([0.0; 3], [0.0; 3]); LANES]);
    let collectors: [A::Collector<'a>; LANES] = std::array::from_fn(|k| {
        let Some(&i) = those.get(k) else { return A::idle() };
        let ray = &mut flying[usize::from(i) % RAYS];
        (places[k], rays[k]) = (ray.place, ray.ray);
        std::mem::replace(&mut ray.collector, A::idle())
    });
    let count = those.len().min(LANES);
    A::end(kernel, &rays[..count], &collectors[..count], |k, answer| answers[places[k]] = answer);
}

/// Rays not yet launched.
struct Waiting<'w> {
    rays: &'w [Ray],
    next: usize,
}

/// Takes up to sixteen rays from the ground, the last ones of `ground`; how many.
#[inline(always)]
#[expect(clippy::too_many_arguments, reason = "the state of a batch")]
fn launch<'a, K: Kernel, A: Pause>(
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
            answers[place] = A::Answer::NOTHING;
            continue;
        }
        (aloft.ray, aloft.place) = (*ray, place);
        let setup = &aloft.setup;
        let frame = kernel.frame(&start.cell, &setup.aim, &setup.way);
        let (left, near) = kernel.touch(start.view.node(0), frame, &setup.way, kernel.ends(setup.way.near, setup.far));
        counters.nodes += 1;
        counters.bricks += u64::from(start.view.page.is_some());
        if left == 0 {
            answers[place] = A::Answer::NOTHING;
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
