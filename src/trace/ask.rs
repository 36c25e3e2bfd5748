//! What is asked about a ray: the closest hit, the next one, or whether there is any.

use super::Found;
use super::arch::Kernel;
use super::collect::{Any, Closest, Collector, Rounding};
use crate::exact::Line;
use crate::geometry::{Hit, Ray, Skip};

/// A question that a walk answers about a ray.
pub(super) trait Ask {
    /// What gathers the hits.
    type Collector<'a>: Collector<'a>;
    type Answer;
    /// The answer where nothing is hit.
    const NOTHING: Self::Answer;
    /// For ray `i` of those that are asked about.
    fn begin<'a>(&self, i: usize, ray: &Ray) -> Self::Collector<'a>;
    /// The answers to up to 16 rays whose walks are over; each slice has as many entries.
    fn end<K: Kernel>(kernel: K, rays: &[Ray], collectors: &[Self::Collector<'_>], answers: &mut [Self::Answer]);
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
    fn begin<'a>(&self, _: usize, ray: &Ray) -> Closest<'a> {
        self.last.map_or_else(|| Closest::new(self.skip), |last| Closest::after(self.skip, &Line::new(ray), last))
    }

    #[inline(always)]
    fn end<K: Kernel>(kernel: K, rays: &[Ray], collectors: &[Closest<'_>], answers: &mut [Option<Found>]) {
        let rounding = Rounding::of(kernel, rays, collectors);
        for (i, ((ray, collector), answer)) in rays.iter().zip(collectors).zip(answers).enumerate() {
            *answer = collector.found(ray, rounding.get(i));
        }
    }
}

/// The closest hit without where it is stored.
pub(super) struct LeastHit;

impl Ask for LeastHit {
    type Collector<'a> = Closest<'a>;
    type Answer = Hit;
    const NOTHING: Hit = Hit::MISS;

    #[inline(always)]
    fn begin<'a>(&self, _: usize, _: &Ray) -> Closest<'a> {
        Closest::new(Skip::NONE)
    }

    #[inline(always)]
    fn end<K: Kernel>(kernel: K, rays: &[Ray], collectors: &[Closest<'_>], answers: &mut [Hit]) {
        let rounding = Rounding::of(kernel, rays, collectors);
        for (i, ((ray, collector), answer)) in rays.iter().zip(collectors).zip(answers).enumerate() {
            *answer = match collector.found(ray, rounding.get(i)) {
                Some(found) => found.hit,
                None => Hit::MISS,
            };
        }
    }
}

/// Whether anything is hit.
pub(super) struct Whether(pub Skip);

impl Ask for Whether {
    type Collector<'a> = Any<'a>;
    type Answer = bool;
    const NOTHING: bool = false;

    #[inline(always)]
    fn begin<'a>(&self, _: usize, _: &Ray) -> Any<'a> {
        Any::new(self.0)
    }

    #[inline(always)]
    fn end<K: Kernel>(_: K, _: &[Ray], collectors: &[Any<'_>], answers: &mut [bool]) {
        for (collector, answer) in collectors.iter().zip(answers) {
            *answer = collector.found;
        }
    }
}
