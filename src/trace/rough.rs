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
use super::packet::PACKET;
use super::walk::Sight;
use super::walker::Walker;
use super::{BATCH, Counters, OctreeTracer, batch};
use crate::error::{Error, Result};
use crate::exact::{Depths, Shear};
use crate::geometry::{Aabb, FaceId, Hit, Ray};
use crate::map::Octree;

impl<O: Borrow<Octree> + Send + Sync> OctreeTracer<O> {
    /// The closest hits as f32 alone has them, one ray after the other or in packets. To measure what exactness costs; only of mapped files.
    #[doc(hidden)]
    pub fn rough_closest_batch(&self, rays: &[Ray], hits: &mut [Hit], packets: bool) -> Result<Counters> {
        self.walker().rough_closest_batch(rays, hits, packets)
    }

    /// Whether anything is hit as f32 alone has it, one ray after the other or in packets. To measure what exactness costs.
    #[doc(hidden)]
    pub fn rough_any_batch(&self, rays: &[Ray], blocked: &mut [bool], packets: bool) -> Result<Counters> {
        self.walker().rough_any_batch(rays, blocked, packets)
    }
}

impl Walker<'_> {
    fn rough_closest_batch(&self, rays: &[Ray], hits: &mut [Hit], packets: bool) -> Result<Counters> {
        batch(rays, hits, BATCH, |rays, hits, counters| {
            self.mapped_only()?;
            self.one_by_one::<_, PACKET>(RoughLeast, rays, hits, packets, counters)
        })
    }

    fn rough_any_batch(&self, rays: &[Ray], blocked: &mut [bool], packets: bool) -> Result<Counters> {
        batch(rays, blocked, BATCH, |rays, blocked, counters| {
            self.mapped_only()?;
            self.one_by_one::<_, PACKET>(RoughWhether, rays, blocked, packets, counters)
        })
    }

    /// Refuses files whose pages come and go.
    fn mapped_only(&self) -> Result<()> {
        match self.octree.is_budgeted() {
            true => Err(Error::Option(
                "rays can be traced in f32 alone only in a mapped file, not a packed one: build it without --compress"
                    .into(),
            )),
            false => Ok(()),
        }
    }
}

/// The closest hit.
struct RoughLeast;

/// Keeps the nearest.
struct Nearest<'a>(Option<(Stored<'a>, Rough)>);

impl Ask for RoughLeast {
    type Collector<'a> = Nearest<'a>;
    type Answer = Hit;
    const EXACT: bool = false;

    #[inline(always)]
    fn begin(&self, _: usize, _: &Ray, nearest: &mut Nearest<'_>) {
        nearest.0 = None;
    }

    #[inline(always)]
    fn end<K: Kernel>(_: K, _: &[Ray], collectors: &[Nearest<'_>], mut give: impl FnMut(usize, Hit)) {
        for (i, Nearest(best)) in collectors.iter().enumerate() {
            let Some((stored, Rough { lane, t, u, v })) = best else {
                give(i, Hit::MISS);
                continue;
            };
            let face = stored.face(*lane);
            give(i, if face == FaceId::NONE { Hit::MISS } else { Hit { t: *t, face, u: *u, v: *v } });
        }
    }

    #[inline(always)]
    fn idle<'a>() -> Nearest<'a> {
        Nearest(None)
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
        sight: &Sight,
        _: &mut Depths,
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
    const EXACT: bool = false;
    const FIRST: bool = true;

    #[inline(always)]
    fn begin(&self, _: usize, _: &Ray, first: &mut First<'_>) {
        first.found = false;
    }

    #[inline(always)]
    fn end<K: Kernel>(_: K, _: &[Ray], collectors: &[First<'_>], mut give: impl FnMut(usize, bool)) {
        for (i, collector) in collectors.iter().enumerate() {
            give(i, collector.found);
        }
    }

    #[inline(always)]
    fn idle<'a>() -> First<'a> {
        First { found: false, file: PhantomData }
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
        sight: &Sight,
        _: &mut Depths,
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
