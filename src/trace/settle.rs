//! The triangles of a leaf: the f32 filter says what may be hit, and what bounds do not decide is settled exactly.

use super::Counters;
use super::arch::Kernel;
use super::collect::{Collector, Next, Place, Stored};
use super::setup::Setup;
use super::walk::Sight;
use crate::exact::{Decision, Depths, Lanes, Line};
use crate::format::PageId;
use crate::geometry::{FaceId, Ray};

/// Tests the triangles of a leaf, and gives the hits to the collector.
#[inline(always)]
#[expect(clippy::too_many_arguments, reason = "the state of a walk")]
pub(super) fn leaf<'a, K: Kernel>(
    kernel: K,
    stored: &Stored<'a>,
    ray: &Ray,
    sight: &Sight,
    depths: &mut Depths,
    far: &mut f32,
    collector: &mut impl Collector<'a>,
    counters: &mut Counters,
) -> Next {
    let lanes = kernel.classify(&stored.leaf, &sight.shear, range(ray, collector), depths);
    if lanes.accept | lanes.doubt == 0 {
        return Next::On;
    }
    take(stored, lanes, ray, &sight.setup, depths, far, collector, counters)
}

/// The t that still matter.
#[inline(always)]
pub(super) fn range<'a>(ray: &Ray, collector: &impl Collector<'a>) -> [f32; 2] {
    let reach = collector.reach();
    [ray.tmin, if reach < ray.tmax { reach } else { ray.tmax }]
}

/// Gives what the filter left of a leaf to the collector.
#[inline(always)]
#[expect(clippy::too_many_arguments, reason = "the state of a walk")]
pub(super) fn take<'a>(
    stored: &Stored<'a>,
    lanes: Lanes,
    ray: &Ray,
    setup: &Setup,
    depths: &Depths,
    far: &mut f32,
    collector: &mut impl Collector<'a>,
    counters: &mut Counters,
) -> Next {
    let next = match collector.glance(ray, lanes, depths, stored) {
        Some(next) => next,
        None => settle(stored, lanes, ray, collector, counters),
    };
    if next == Next::Nearer {
        *far = far.min(setup.reach(collector.reach()));
    }
    next
}

/// Decides exactly what bounds did not, and offers the hits.
#[inline(never)]
fn settle<'a>(
    stored: &Stored<'a>,
    lanes: Lanes,
    ray: &Ray,
    collector: &mut impl Collector<'a>,
    counters: &mut Counters,
) -> Next {
    counters.doubts += u64::from(lanes.doubt.count_ones());
    let line = Line::new(ray);
    let mut left = lanes.accept | lanes.doubt;
    let mut next = Next::On;
    while left != 0 {
        let j = left.trailing_zeros();
        left &= left - 1;
        let triangle = stored.leaf.triangle(j as usize);
        let doubted = lanes.doubt >> j & 1 != 0;
        let Decision { crossing, exact } = if doubted { line.meet(&triangle) } else { line.accepted(&triangle) };
        counters.exact += u64::from(exact);
        let Some(crossing) = crossing else { continue };
        match collector.offer(&line, crossing, &Reference { stored, lane: j }) {
            Next::On => {}
            Next::Nearer => next = Next::Nearer,
            Next::Done => return Next::Done,
        }
    }
    next
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
