//! What is asked about a ray: the closest hit, the next one, or whether there is any.

use super::arch::Kernel;
use super::collect::{Any, Closest, Collector, Next, Rest, Rounding, Stored};
use super::settle;
use super::walk::Sight;
use super::{Counters, Found};
use crate::exact::{Depths, Line, Shear};
use crate::geometry::{Aabb, Hit, Ray, Skip};

/// A question that a walk answers about a ray.
pub(super) trait Ask {
    /// What gathers the hits.
    type Collector<'a>: Leaves<'a>;
    type Answer: Answer;
    /// Makes a collector ready for ray `i` of those that are asked about.
    fn begin(&self, i: usize, ray: &Ray, collector: &mut Self::Collector<'_>);
    /// Whether packets answer exactly; if not, as f32 alone has it, to measure what that costs.
    const EXACT: bool = true;
    /// Whether any hit will do.
    const FIRST: bool = false;
    /// What ray `i` leaves out.
    #[inline(always)]
    fn skip(&self, _i: usize) -> Skip {
        Skip::NONE
    }
    /// Gives the answers to up to 16 rays whose walks are over, each with its number among `rays` and `collectors`.
    fn end<K: Kernel>(
        kernel: K,
        rays: &[Ray],
        collectors: &[Self::Collector<'_>],
        give: impl FnMut(usize, Self::Answer),
    );
    /// One that is never asked.
    fn idle<'a>() -> Self::Collector<'a>;
}

/// What a question is answered with.
pub(super) trait Answer {
    /// Where nothing is hit.
    const NOTHING: Self;
    /// Where a packet made a hit; with [`Ask::FIRST`] it is enough that there is one.
    fn of(found: Found) -> Self;
}

impl Answer for Option<Found> {
    const NOTHING: Option<Found> = None;

    #[inline(always)]
    fn of(found: Found) -> Option<Found> {
        Some(found)
    }
}

impl Answer for Hit {
    const NOTHING: Hit = Hit::MISS;

    #[inline(always)]
    fn of(found: Found) -> Hit {
        found.hit
    }
}

impl Answer for bool {
    const NOTHING: bool = false;

    #[inline(always)]
    fn of(_: Found) -> bool {
        true
    }
}

/// A question whose walk can be put aside, and gone on with when pages have come and gone.
pub(super) trait Pause: for<'c> Ask<Collector<'c>: Collector<'c>> {
    /// What a walk has found so far, without anything of pages.
    type Rest: Default;
    /// Takes it from a collector.
    fn rest(collector: &Self::Collector<'_>, ray: &Ray) -> Self::Rest;
    /// Gives it to a collector that was made ready.
    fn resume(rest: Self::Rest, collector: &mut Self::Collector<'_>);
}

/// Tests the triangles of the leaves that a walk comes to, and keeps what it finds.
pub(super) trait Leaves<'a> {
    /// Prepares a ray for [`Leaves::leaf`].
    fn shear(&self, ray: &Ray, bounds: Aabb) -> Shear;
    /// Tests a leaf; lowers `far` where it answers [`Next::Nearer`].
    #[expect(clippy::too_many_arguments, reason = "the state of a walk")]
    fn leaf<K: Kernel>(
        &mut self,
        kernel: K,
        stored: &Stored<'a>,
        ray: &Ray,
        sight: &Sight,
        depths: &mut Depths,
        far: &mut f32,
        counters: &mut Counters,
    ) -> Next;
}

/// Exactly.
impl<'a, C: Collector<'a>> Leaves<'a> for C {
    #[inline(always)]
    fn shear(&self, ray: &Ray, bounds: Aabb) -> Shear {
        Shear::new(ray, bounds)
    }

    #[inline(always)]
    fn leaf<K: Kernel>(
        &mut self,
        kernel: K,
        stored: &Stored<'a>,
        ray: &Ray,
        sight: &Sight,
        depths: &mut Depths,
        far: &mut f32,
        counters: &mut Counters,
    ) -> Next {
        settle::leaf(kernel, stored, ray, sight, depths, far, self, counters)
    }
}

/// The closest hits, each ray leaving out its own of `skips` (the rays beyond them nothing), after `last` if that is given.
pub(super) struct Least<'s> {
    pub skips: &'s [Skip],
    pub last: Option<&'s Found>,
}

impl Ask for Least<'_> {
    type Collector<'a> = Closest<'a>;
    type Answer = Option<Found>;

    #[inline(always)]
    fn begin(&self, i: usize, ray: &Ray, closest: &mut Closest<'_>) {
        closest.begin(self.skip(i));
        if let Some(last) = self.last {
            closest.begin_after(&Line::new(ray), last);
        }
    }

    #[inline(always)]
    fn idle<'a>() -> Closest<'a> {
        Closest::new(Skip::NONE)
    }

    #[inline(always)]
    fn skip(&self, i: usize) -> Skip {
        self.skips.get(i).copied().unwrap_or(Skip::NONE)
    }

    #[inline(always)]
    fn end<K: Kernel>(kernel: K, rays: &[Ray], collectors: &[Closest<'_>], mut give: impl FnMut(usize, Option<Found>)) {
        let rounding = Rounding::of(kernel, rays, collectors);
        for (i, (ray, collector)) in rays.iter().zip(collectors).enumerate() {
            give(i, collector.found(ray, rounding.get(i)));
        }
    }
}

/// The closest hit without where it is stored.
pub(super) struct LeastHit;

impl Ask for LeastHit {
    type Collector<'a> = Closest<'a>;
    type Answer = Hit;

    #[inline(always)]
    fn begin(&self, _: usize, _: &Ray, closest: &mut Closest<'_>) {
        closest.begin(Skip::NONE);
    }

    #[inline(always)]
    fn idle<'a>() -> Closest<'a> {
        Closest::new(Skip::NONE)
    }

    #[inline(always)]
    fn end<K: Kernel>(kernel: K, rays: &[Ray], collectors: &[Closest<'_>], mut give: impl FnMut(usize, Hit)) {
        let rounding = Rounding::of(kernel, rays, collectors);
        for (i, (ray, collector)) in rays.iter().zip(collectors).enumerate() {
            give(i, collector.hit(ray, rounding.get(i)));
        }
    }
}

/// Whether anything is hit, each ray leaving out its own of these (the rays beyond them nothing).
pub(super) struct Whether<'s>(pub &'s [Skip]);

impl Ask for Whether<'_> {
    type Collector<'a> = Any<'a>;
    type Answer = bool;
    const FIRST: bool = true;

    #[inline(always)]
    fn begin(&self, i: usize, _: &Ray, any: &mut Any<'_>) {
        *any = Any::new(self.skip(i));
    }

    #[inline(always)]
    fn idle<'a>() -> Any<'a> {
        Any::new(Skip::NONE)
    }

    #[inline(always)]
    fn skip(&self, i: usize) -> Skip {
        self.0.get(i).copied().unwrap_or(Skip::NONE)
    }

    #[inline(always)]
    fn end<K: Kernel>(_: K, _: &[Ray], collectors: &[Any<'_>], mut give: impl FnMut(usize, bool)) {
        for (i, collector) in collectors.iter().enumerate() {
            give(i, collector.found);
        }
    }
}

impl Pause for Least<'_> {
    type Rest = Rest;

    fn rest(closest: &Closest<'_>, ray: &Ray) -> Rest {
        closest.rest(ray)
    }

    fn resume(rest: Rest, closest: &mut Closest<'_>) {
        closest.resume(rest);
    }
}

impl Pause for LeastHit {
    type Rest = Rest;

    fn rest(closest: &Closest<'_>, ray: &Ray) -> Rest {
        closest.rest(ray)
    }

    fn resume(rest: Rest, closest: &mut Closest<'_>) {
        closest.resume(rest);
    }
}

impl Pause for Whether<'_> {
    type Rest = ();

    fn rest(_: &Any<'_>, _: &Ray) {}

    fn resume(_: (), _: &mut Any<'_>) {}
}
