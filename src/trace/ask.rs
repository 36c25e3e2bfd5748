//! What is asked about a ray: the closest hit, the next one, or whether there is any.

use super::arch::Kernel;
use super::collect::{Any, Closest, Collector, Next, Stored};
use super::walk::{self, Sight};
use super::{Counters, Found};
use crate::exact::{Line, Shear};
use crate::geometry::{Aabb, Hit, Ray, Skip};

/// A question that a walk answers about a ray.
pub(super) trait Ask {
    /// What gathers the hits.
    type Collector<'a>: Leaves<'a>;
    type Answer;
    /// The answer where nothing is hit.
    const NOTHING: Self::Answer;
    fn begin<'a>(&self, ray: &Ray) -> Self::Collector<'a>;
    fn end<K: Kernel>(kernel: K, collector: Self::Collector<'_>, ray: &Ray) -> Self::Answer;
}

/// Tests the triangles of the leaves that a walk comes to, and keeps what it finds.
pub(super) trait Leaves<'a> {
    /// Prepares a ray for [`Leaves::leaf`].
    fn shear(&self, ray: &Ray, bounds: Aabb) -> Shear;
    /// Tests a leaf; lowers `far` where it answers [`Next::Nearer`].
    fn leaf<K: Kernel>(
        &mut self,
        kernel: K,
        stored: &Stored<'a>,
        ray: &Ray,
        sight: &mut Sight,
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
        sight: &mut Sight,
        far: &mut f32,
        counters: &mut Counters,
    ) -> Next {
        walk::leaf(kernel, stored, ray, sight, far, self, counters)
    }
}

/// The closest hit, after `last` if that is given.
pub(super) struct Least<'f> {
    pub skip: Skip,
    pub last: Option<&'f Found>,
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
    fn end<K: Kernel>(kernel: K, collector: Closest<'_>, ray: &Ray) -> Option<Found> {
        collector.found(kernel, ray)
    }
}

/// The closest hit without where it is stored.
pub(super) struct LeastHit;

impl Ask for LeastHit {
    type Collector<'a> = Closest<'a>;
    type Answer = Hit;
    const NOTHING: Hit = Hit::MISS;

    #[inline(always)]
    fn begin<'a>(&self, _: &Ray) -> Closest<'a> {
        Closest::new(Skip::NONE)
    }

    #[inline(always)]
    fn end<K: Kernel>(kernel: K, collector: Closest<'_>, ray: &Ray) -> Hit {
        collector.found(kernel, ray).map_or(Hit::MISS, |found| found.hit)
    }
}

/// Whether anything is hit.
pub(super) struct Whether(pub Skip);

impl Ask for Whether {
    type Collector<'a> = Any<'a>;
    type Answer = bool;
    const NOTHING: bool = false;

    #[inline(always)]
    fn begin<'a>(&self, _: &Ray) -> Any<'a> {
        Any::new(self.0)
    }

    #[inline(always)]
    fn end<K: Kernel>(_: K, collector: Any<'_>, _: &Ray) -> bool {
        collector.found
    }
}
