//! Many rays on one thread: packets where rays run side by side, the others one after the other.

use std::cell::RefCell;

use bytemuck::Zeroable;

use super::arch::{Job, Kernel};
use super::ask::{Ask, Leaves};
use super::trip::Straight;
use super::walk::{File, LEVELS, Level, Sight};
use super::{Counters, packet};
use crate::exact::{Depths, LANES};
use crate::geometry::Ray;
use crate::map::Halt;

/// Rays to be answered with whichever kernel is there, N (1 to 64) at a time: in a packet where they run side by side, else one
/// after the other. What does not wait for anything, preparing rays and rounding answers, is done for many together, and so goes
/// much faster than between walks.
pub(super) struct Batch<'a, 'w, A: Ask, const N: usize> {
    pub ask: A,
    pub rays: &'w [Ray],
    pub answers: &'w mut [A::Answer],
    pub file: File<'a>,
    pub counters: &'w mut Counters,
    pub space: &'w mut Space,
    /// Whether to look for packets.
    pub packets: bool,
}

/// What a thread keeps, so that rays allocate nothing.
#[derive(Clone, Copy, Zeroable)]
#[repr(C)]
pub(super) struct Space {
    pub(super) levels: [Level; LEVELS],
    pub(super) crew: [Sight; LANES],
    pub(super) packet: packet::Space,
}

thread_local! {
    /// Each thread's own.
    pub(super) static SPACE: RefCell<Box<Space>> = RefCell::new(bytemuck::zeroed_box());
}

impl<A: Ask, const N: usize> Job for Batch<'_, '_, A, N> {
    type Output = Result<(), Halt>;

    #[inline(always)]
    fn run<K: Kernel>(self, kernel: K) -> Result<(), Halt> {
        let Batch { ask, rays, answers, file, counters, space: Space { levels, crew, packet }, packets } = self;
        counters.rays += rays.len() as u64;
        let start = file.start()?;
        let mut depths = Depths::BLANK;
        let mut collectors: [A::Collector<'_>; LANES] = std::array::from_fn(|_| A::idle());
        let mut first = 0;
        for (rays, answers) in rays.chunks(N).zip(answers.chunks_mut(N)) {
            let last = rays.len() - 1;
            let mut alone = u64::MAX >> (63 - last);
            if packets && N > 1 {
                let asked = packet::Asked { ask: &ask, first, rays };
                alone = packet::walk(kernel, &file, &start, asked, answers, packet, &mut depths, counters)?;
            }
            while alone != 0 {
                let (mut places, mut count, mut live) = ([0; LANES], 0, 0u32);
                let mut those = [rays[0]; LANES];
                while alone != 0 && count < LANES {
                    let i = alone.trailing_zeros() as usize % N;
                    alone &= alone - 1;
                    let sight = &mut crew[count];
                    places[count] = i;
                    those[count] = rays[i];
                    if sight.setup.aim(kernel, &those[count], file.scene) {
                        live |= u32::from(sight.enter(kernel, &start)) << count;
                        counters.nodes += 1;
                    }
                    ask.begin(first + i, &those[count], &mut collectors[count]);
                    count += 1;
                }
                let mut left = live;
                while left != 0 {
                    let k = left.trailing_zeros() as usize % LANES;
                    left &= left - 1;
                    crew[k].shear = collectors[k].shear(&those[k], file.scene.bounds);
                }
                let mut left = live;
                while left != 0 {
                    let k = left.trailing_zeros() as usize % LANES;
                    left &= left - 1;
                    let (ray, sight, collector) = (&those[k], &crew[k], &mut collectors[k]);
                    file.walk(kernel, levels, &start, ray, sight, &mut depths, collector, counters, &mut Straight)?;
                }
                A::end(kernel, &those[..count], &collectors[..count], |k, answer| answers[places[k]] = answer);
            }
            first += N;
        }
        Ok(())
    }
}
