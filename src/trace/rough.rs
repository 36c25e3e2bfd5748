//! The same walk without exactness: what `octbench speed` holds the exact kernels to.
//!
//! Nodes, leaves, shear and edge functions are those of the exact walk; but a triangle is hit if its edge functions in f32 agree in
//! sign, t is what f32 makes of it, the closest hit is the least of those t (of a tie any), and t, u, v are answered as they are. There is no
//! bound of an error, no second test, no rounding of the answer. So it misses, doubles and confuses what other f32 tracers do, and
//! nothing but the measurement uses it.

use std::borrow::Borrow;
use std::marker::PhantomData;

use super::arch::{Kernel, Rough};
use super::ask::{Ask, Leaves};
use super::collect::{Next, Stored};
use super::walk::Sight;
use super::{Counters, OctreeTracer, batch};
use crate::error::Result;
use crate::exact::Shear;
use crate::geometry::{Aabb, FaceId, Hit, Ray};
use crate::map::Octree;

impl<O: Borrow<Octree> + Send + Sync> OctreeTracer<O> {
    /// The closest hits as f32 alone has them, one ray after the other. To measure what exactness costs.
    #[doc(hidden)]
    pub fn rough_closest_batch(&self, rays: &[Ray], hits: &mut [Hit]) -> Result<Counters> {
        batch(rays, hits, |rays, hits, counters| self.one_by_one(RoughLeast, rays, hits, counters))
    }

    /// Whether anything is hit as f32 alone has it, one ray after the other. To measure what exactness costs.
    #[doc(hidden)]
    pub fn rough_any_batch(&self, rays: &[Ray], blocked: &mut [bool]) -> Result<Counters> {
        batch(rays, blocked, |rays, blocked, counters| self.one_by_one(RoughWhether, rays, blocked, counters))
    }
}

/// The closest hit.
struct RoughLeast;

/// Keeps the nearest.
struct Nearest<'a>(Option<(Stored<'a>, Rough)>);

impl Ask for RoughLeast {
    type Collector<'a> = Nearest<'a>;
    type Answer = Hit;
    const NOTHING: Hit = Hit::MISS;

    #[inline(always)]
    fn begin<'a>(&self, _: &Ray) -> Nearest<'a> {
        Nearest(None)
    }

    #[inline(always)]
    fn end<K: Kernel>(_: K, Nearest(best): Nearest<'_>, _: &Ray) -> Hit {
        let Some((Stored { page, leaf, .. }, Rough { lane, t, u, v })) = best else { return Hit::MISS };
        let face = page.face(leaf.first().wrapping_add(lane));
        if face == FaceId::NONE { Hit::MISS } else { Hit { t, face, u, v } }
    }
}

impl<'a> Leaves<'a> for Nearest<'a> {
    #[inline(always)]
    fn shear(&self, ray: &Ray, _: Aabb) -> Shear {
        Shear::without_bounds(ray)
    }

    #[inline(always)]
    fn leaf<K: Kernel>(
        &mut self,
        kernel: K,
        stored: &Stored<'a>,
        ray: &Ray,
        sight: &mut Sight,
        far: &mut f32,
        _: &mut Counters,
    ) -> Next {
        let last = if let Some((_, best)) = &self.0 { best.t } else { ray.tmax };
        let Some(found) = kernel.nearest(&stored.leaf, &sight.shear, [ray.tmin, last]) else { return Next::On };
        *far = far.min(sight.setup.reach(found.t));
        self.0 = Some((*stored, found));
        Next::Nearer
    }
}

/// Whether anything is hit.
struct RoughWhether;

/// Ends at the first hit.
struct First<'a> {
    found: bool,
    file: PhantomData<&'a ()>,
}

impl Ask for RoughWhether {
    type Collector<'a> = First<'a>;
    type Answer = bool;
    const NOTHING: bool = false;

    #[inline(always)]
    fn begin<'a>(&self, _: &Ray) -> First<'a> {
        First { found: false, file: PhantomData }
    }

    #[inline(always)]
    fn end<K: Kernel>(_: K, collector: First<'_>, _: &Ray) -> bool {
        collector.found
    }
}

impl<'a> Leaves<'a> for First<'a> {
    #[inline(always)]
    fn shear(&self, ray: &Ray, _: Aabb) -> Shear {
        Shear::without_bounds(ray)
    }

    #[inline(always)]
    fn leaf<K: Kernel>(
        &mut self,
        kernel: K,
        stored: &Stored<'a>,
        ray: &Ray,
        sight: &mut Sight,
        _: &mut f32,
        _: &mut Counters,
    ) -> Next {
        match kernel.nearest(&stored.leaf, &sight.shear, [ray.tmin, ray.tmax]) {
            Some(_) => {
                self.found = true;
                Next::Done
            }
            None => Next::On,
        }
    }
}
