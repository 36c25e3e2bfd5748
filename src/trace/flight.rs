//! Several rays under way at once on one thread, each by one step in turn.
//!
//! A single walk is one long chain of dependent steps: load a node, test it, pick a child. Between the steps of one ray the processor
//! can work on those of others, if their control flow is known in time. So a step begins with branches on what the step before it
//! found, which by now is known, and ends with what takes long: the test of a node or of a leaf's triangles.

use std::cell::RefCell;

use bytemuck::Zeroable;

use super::Counters;
use super::arch::{Job, Kernel, Saved};
use super::ask::Ask;
use super::collect::{Collector, Next, Stored};
use super::setup::Setup;
use super::walk::{BRICK, EMPTY, File, INNER, LEVELS, Level, Start, TOP, View, cell_of, keep, range, take};
use crate::error::Result;
use crate::exact::{Depths, Lanes, Shear};
use crate::geometry::Ray;

/// Rays under way at once.
const RAYS: usize = 8;

/// A ray's stack. The odd size keeps the stacks of all rays from meeting in the same cache sets.
#[derive(Clone, Copy, Zeroable)]
#[repr(C, align(64))]
pub(super) struct Stack {
    levels: [Level; LEVELS],
    apart: [u8; 320],
}

thread_local! {
    /// Each thread's stacks, kept so that a batch allocates nothing.
    pub(super) static STACKS: RefCell<Box<Stacks>> = RefCell::new(bytemuck::zeroed_box());
}

/// Rays to be walked several at a time, with whichever kernel is there.
pub(super) struct Flight<'a, 'w, A: Ask> {
    pub ask: A,
    pub rays: &'w [Ray],
    pub answers: &'w mut [A::Answer],
    pub file: File<'a>,
    pub counters: &'w mut Counters,
    pub stacks: &'w mut Stacks,
}

/// Stacks for all rays under way.
pub(super) type Stacks = [Stack; RAYS];

/// A ray under way.
#[repr(align(64))]
struct Flying<'a, C> {
    /// The node under way: its frame and the entries of its slots.
    saved: Saved,
    setup: Setup,
    shear: Shear,
    depths: Depths,
    view: View<'a>,
    node: u32,
    /// Slots left to visit.
    left: u32,
    /// Levels put aside.
    top: usize,
    /// The parameter beyond which nothing matters.
    far: f32,
    sheared: bool,
    /// A leaf that was tested, and the filter's word on it.
    leaf: Option<(Stored<'a>, Lanes)>,
    ray: Ray,
    /// The ray's place in the batch.
    place: usize,
    /// Which stack is its own.
    stack: usize,
    collector: C,
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
        if rays.is_empty() {
            return Ok(());
        }
        let start = file.start()?;
        let mut next = 0;
        let mut flying: [Flying<'_, A::Collector<'_>>; RAYS] = std::array::from_fn(|stack| Flying {
            stack,
            saved: Saved::zeroed(),
            setup: Setup::zeroed(),
            shear: Shear::default(),
            depths: Depths::BLANK,
            view: start.view,
            node: 0,
            left: 0,
            top: 0,
            far: 0.0,
            sheared: false,
            leaf: None,
            ray: Ray::new([0.0; 3], [0.0; 3]),
            place: 0,
            collector: ask.begin(0, &rays[0]),
        });
        let mut aloft = 0;
        while aloft < RAYS
            && launch(kernel, &ask, rays, answers, &mut next, &file, &start, &mut flying[aloft], counters)
        {
            aloft += 1;
        }
        while aloft > 0 {
            let mut i = 0;
            while i < aloft {
                let ray = &mut flying[i];
                let stack = &mut stacks[ray.stack % RAYS].levels;
                if step(kernel, &file, ray, stack, counters)? {
                    i += 1;
                    continue;
                }
                let (ended, collector) = (std::slice::from_ref(&ray.ray), std::slice::from_ref(&ray.collector));
                A::end(kernel, ended, collector, |_, answer| answers[ray.place] = answer);
                if !launch(kernel, &ask, rays, answers, &mut next, &file, &start, ray, counters) {
                    // The last one takes this place.
                    aloft -= 1;
                    flying.swap(i, aloft);
                }
            }
        }
        Ok(())
    }
}

/// Takes up the next ray that is worth it; false if there is none left.
#[inline(always)]
#[expect(clippy::too_many_arguments, reason = "the state of a batch")]
fn launch<'a, K: Kernel, A: Ask>(
    kernel: K,
    ask: &A,
    rays: &[Ray],
    answers: &mut [A::Answer],
    next: &mut usize,
    file: &File<'a>,
    start: &Start<'a>,
    flying: &mut Flying<'a, A::Collector<'a>>,
    counters: &mut Counters,
) -> bool {
    while let Some(ray) = rays.get(*next) {
        let place = *next;
        *next += 1;
        if !flying.setup.aim(kernel, ray, file.scene) {
            answers[place] = A::NOTHING;
            continue;
        }
        let setup = &flying.setup;
        let frame = kernel.frame(&start.cell, &setup.aim, &setup.way);
        let (left, near) = kernel.touch(start.view.node(0), frame, &setup.way, setup.far);
        kernel.save(&mut flying.saved, frame, near);
        counters.nodes += 1;
        counters.bricks += u64::from(start.view.page.is_some());
        flying.far = setup.far;
        flying.view = start.view;
        (flying.node, flying.left, flying.top, flying.sheared, flying.leaf) = (0, left, 0, false, None);
        (flying.ray, flying.place, flying.collector) = (*ray, place, ask.begin(place, ray));
        return true;
    }
    false
}

/// One step of a ray; false if it was its last.
#[inline(always)]
fn step<'a, K: Kernel, C: Collector<'a>>(
    kernel: K,
    file: &File<'a>,
    flying: &mut Flying<'a, C>,
    stack: &mut [Level; LEVELS],
    counters: &mut Counters,
) -> Result<bool> {
    let Flying {
        saved, setup, shear, depths, view, node: index, left, top, far, sheared, leaf, ray, collector, ..
    } = flying;
    if let Some((stored, lanes)) = leaf.take() {
        match take(&stored, lanes, ray, setup, depths, far, collector, counters) {
            Next::On => {}
            Next::Nearer => *left &= kernel.within(kernel.load(saved).1, *far),
            Next::Done => return Ok(false),
        }
    }
    while *left == 0 {
        if *top == 0 {
            return Ok(false);
        }
        *top -= 1;
        let level = &stack[*top];
        let (_, near) = kernel.load(&level.saved);
        *left = level.left & kernel.within(near, *far);
        if *left != 0 {
            *saved = level.saved;
            *index = level.node;
            if level.page != view.number {
                *view = file.view(level.page)?;
            }
        }
    }
    let node = view.node(*index);
    let slot = (left.trailing_zeros() & 7) as usize ^ usize::from(setup.way.order & 7);
    *left &= *left - 1;
    let byte = node.slots[slot];
    if byte < EMPTY {
        let Some(stored) = file.stored(view, *index, node, byte, counters) else { return Ok(true) };
        if !*sheared {
            *sheared = true;
            *shear = Shear::new(ray, file.scene.bounds);
        }
        let lanes = kernel.classify(&stored.leaf, shear, range(ray, collector), depths);
        if lanes.accept | lanes.doubt != 0 {
            *leaf = Some((stored, lanes));
        }
        return Ok(true);
    }
    let (frame, near) = kernel.load(saved);
    let frame = if byte & 0xc0 == INNER && node.first_child != 0 {
        if *left != 0 {
            *top = keep(kernel, stack, *top, (frame, near), [*index, view.number, *left]);
        }
        *index = index.wrapping_add(node.first_child).wrapping_add(u32::from(byte & 7));
        kernel.child(frame, node, slot, &setup.way)
    } else if byte & BRICK == BRICK && view.page.is_none() {
        let number = node.first_leaf.wrapping_add(u32::from(byte & 0x3f));
        let Some(brick) = file.brick(number) else { return Ok(true) };
        if *left != 0 {
            *top = keep(kernel, stack, *top, (frame, near), [*index, TOP, *left]);
        }
        counters.bricks += 1;
        *view = file.view(number)?;
        *index = 0;
        kernel.frame(&cell_of(brick), &setup.aim, &setup.way)
    } else {
        return Ok(true);
    };
    counters.nodes += 1;
    let (touched, near) = kernel.touch(view.node(*index), frame, &setup.way, *far);
    *left = touched;
    kernel.save(saved, frame, near);
    Ok(true)
}
