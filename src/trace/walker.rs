//! Which walk answers what, for rays of an octree file.

use super::arch::Isa;
use super::ask::{Answer, Ask, Least, LeastHit, Pause, Whether};
use super::batch::{Batch, SPACE};
use super::flight::{Flight, STACKS, WORTHWHILE};
use super::lod::{Approximate, Coarse, Footprint, Held, Met};
use super::near::Near;
use super::octree::Order;
use super::packet::{self, PACKET};
use super::patient::{Fast, Patient, STRETCH};
use super::setup::Scene;
use super::walk::{CACHED, File};
use super::{BATCH, Counters, Found, Tracer, a_ray_each, a_width_each, batch};
use crate::error::{Error, Result};
use crate::geometry::{Aabb, Hit, Ray, Skip};
use crate::map::{Halt, Octree, Visit};

/// A tracer, whatever holds its file.
///
/// Not generic, so that the walks, each of which is made for three instruction sets, are compiled once, with the library, and
/// not again in every program that traces a ray.
pub(super) struct Walker<'a> {
    pub octree: &'a Octree,
    pub scene: &'a Scene,
    pub isa: Isa,
    /// How batches are walked, whatever suits them.
    pub order: Option<Order>,
}

impl Walker<'_> {
    /// Answers one ray.
    fn ask_one<A: Pause>(&self, ask: A, ray: &Ray, counters: &mut Counters) -> Result<A::Answer> {
        let mut answer = [A::Answer::NOTHING];
        let rays = std::slice::from_ref(ray);
        match self.octree.is_budgeted() {
            true => self.patiently(ask, rays, &mut answer, Fast::Single, counters)?,
            false => self.one_by_one::<A, 1>(ask, rays, &mut answer, false, counters)?,
        }
        let [answer] = answer;
        Ok(answer)
    }

    /// Answers rays of a mapped file one after the other, on this thread; adds the work done to `counters`.
    pub(super) fn one_by_one<A: Ask, const N: usize>(
        &self,
        ask: A,
        rays: &[Ray],
        answers: &mut [A::Answer],
        packets: bool,
        counters: &mut Counters,
    ) -> Result<()> {
        self.mapped(|visit| {
            let file = File::new(visit, self.scene);
            SPACE.with_borrow_mut(|space| {
                self.isa.run(Batch::<A, N> { ask, rays, answers, file, counters, space, packets })
            })
        })
    }

    /// Does what needs the pages of a mapped file, none of which is ever absent.
    fn mapped(&self, walk: impl FnOnce(&Visit<'_>) -> Result<(), Halt>) -> Result<()> {
        walk(&self.octree.visit()).map_err(|halt| halt.mapped(self.octree))?;
        self.octree.fault()
    }

    /// Answers rays with widths, on this thread, by what is to be chosen of a ray's hit and the surrogate that it took. One that comes to
    /// a page that is not in memory waits for it.
    fn coarse<A: Pause, T>(
        &self,
        ask: A,
        rays: &[Ray],
        (footprints, pixels): (&[Footprint], f64),
        answers: &mut [T],
        counters: &mut Counters,
        choose: impl Fn(A::Answer, Option<Approximate>) -> T,
    ) -> Result<()> {
        a_width_each(rays, footprints, pixels, answers);
        let mut give = |i: usize, hit, surrogate| answers[i] = choose(hit, surrogate);
        let (octree, scene) = (self.octree, self.scene);
        let Some(detail) = octree.detail()? else {
            let file = octree.path().to_owned();
            return Err(Error::Input { file, what: "has no level of detail; build it again, without --no-lod".into() });
        };
        let stretch = if octree.is_budgeted() { STRETCH } else { rays.len() };
        let (mut next, mut held, mut ticket) = (0, Held::default(), None);
        while next < rays.len() {
            let visit = octree.visit();
            let (ask, give, end) = (&ask, &mut give, (next + stretch).min(rays.len()));
            let (next, held, visit_ref, counters) = (&mut next, &mut held, &visit, &mut *counters);
            let job = Coarse {
                ask,
                rays,
                footprints,
                pixels,
                visit: visit_ref,
                detail,
                scene,
                counters,
                give,
                next,
                end,
                held,
            };
            match self.isa.run(job) {
                Ok(()) => ticket = None,
                Err(Halt::Failed(error)) => return Err(error),
                Err(Halt::Absent(page)) => {
                    drop(visit);
                    counters.waits += 1;
                    // The page before may go now, this one stays until the ray has been through it.
                    drop(ticket.take());
                    let asked = octree.ask(page, 1);
                    octree.wait(std::iter::once(&asked));
                    asked.check()?;
                    ticket = Some(asked);
                }
            }
        }
        octree.fault()
    }

    /// Answers rays of which nothing is known, on this thread, by the walk that is faster for them and for the file.
    fn many<A: Pause>(&self, ask: A, rays: &[Ray], answers: &mut [A::Answer], counters: &mut Counters) -> Result<()> {
        let order = self.order.unwrap_or_else(|| self.order_for(rays));
        if self.octree.is_budgeted() {
            let fast = match order {
                Order::Single => Fast::Single,
                Order::Flight => Fast::Flight,
                Order::Packet => Fast::Packets,
            };
            return self.patiently(ask, rays, answers, fast, counters);
        }
        match order {
            Order::Flight => self.several(ask, rays, answers, counters),
            Order::Single => self.one_by_one::<A, PACKET>(ask, rays, answers, false, counters),
            Order::Packet => self.one_by_one::<A, PACKET>(ask, rays, answers, true, counters),
        }
    }

    /// The order that suits the rays and the file.
    fn order_for(&self, rays: &[Ray]) -> Order {
        let uncached = self.octree.header().file_bytes > CACHED;
        if packet::promising(rays) {
            Order::Packet
        } else if uncached && rays.len() >= WORTHWHILE && packet::scattered(rays) {
            Order::Flight
        } else {
            Order::Single
        }
    }

    /// Answers rays of a mapped file several at a time, on this thread; adds the work done to `counters`.
    fn several<A: Pause>(
        &self,
        ask: A,
        rays: &[Ray],
        answers: &mut [A::Answer],
        counters: &mut Counters,
    ) -> Result<()> {
        self.mapped(|visit| {
            let file = File::new(visit, self.scene);
            // No page is absent, so no ray is left.
            let (ask, left) = (&ask, &mut Vec::new());
            STACKS.with_borrow_mut(|stacks| {
                self.isa.run(Flight { ask, rays, first: 0, answers, file, counters, stacks, left })
            })
        })
    }

    /// Answers rays of a file whose pages come and go, on this thread; adds the work done to `counters`.
    fn patiently<A: Pause>(
        &self,
        ask: A,
        rays: &[Ray],
        answers: &mut [A::Answer],
        fast: Fast<'_>,
        counters: &mut Counters,
    ) -> Result<()> {
        let (octree, scene, isa) = (self.octree, self.scene, self.isa);
        Patient { octree, scene, isa, ask, rays, fast }.answer(answers, counters)?;
        octree.fault()
    }

    /// Rays that one task of a batch takes. Where rays may wait, each thread has many, so that others can go on.
    fn task(&self, rays: usize) -> usize {
        match self.octree.is_budgeted() {
            true => rays.div_ceil(2 * rayon::current_num_threads()).clamp(BATCH, MOST_PATIENT),
            false => BATCH,
        }
    }
}

/// Most rays of a task where rays may wait.
const MOST_PATIENT: usize = 1 << 16;

impl Tracer for Walker<'_> {
    fn closest_counted(&self, ray: &Ray, skip: Skip, counters: &mut Counters) -> Result<Option<Found>> {
        self.ask_one(Least { skips: &[skip], last: None }, ray, counters)
    }

    fn any_counted(&self, ray: &Ray, skip: Skip, counters: &mut Counters) -> Result<bool> {
        self.ask_one(Whether(&[skip]), ray, counters)
    }

    fn next(&self, ray: &Ray, skip: Skip, last: &Found) -> Result<Option<Found>> {
        self.ask_one(Least { skips: &[skip], last: Some(last) }, ray, &mut Counters::default())
    }

    fn bounds(&self) -> Aabb {
        self.scene.bounds
    }

    fn closest_each(
        &self,
        rays: &[Ray],
        skips: &[Skip],
        found: &mut [Option<Found>],
        counters: &mut Counters,
    ) -> Result<()> {
        a_ray_each(rays, skips, found);
        self.many(Least { skips, last: None }, rays, found, counters)
    }

    fn any_each(&self, rays: &[Ray], skips: &[Skip], blocked: &mut [bool], counters: &mut Counters) -> Result<()> {
        a_ray_each(rays, skips, blocked);
        self.many(Whether(skips), rays, blocked, counters)
    }

    fn any_short(&self, rays: &[Ray], skips: &[Skip], blocked: &mut [bool], counters: &mut Counters) -> Result<()> {
        a_ray_each(rays, skips, blocked);
        if self.octree.is_budgeted() {
            return self.patiently(Whether(skips), rays, blocked, Fast::Near(skips), counters);
        }
        self.mapped(|visit| self.isa.run(Near { visit, rays, skips, blocked, counters }))
    }

    fn closest_coarse(
        &self,
        rays: &[Ray],
        footprints: &[Footprint],
        pixels: f64,
        met: &mut [Met],
        counters: &mut Counters,
    ) -> Result<()> {
        let ask = Least { skips: &[], last: None };
        self.coarse(ask, rays, (footprints, pixels), met, counters, |found, surrogate| match (found, surrogate) {
            (Some(found), Some(surrogate)) if surrogate.t < found.hit.t => Met::Surrogate(surrogate),
            (Some(found), _) => Met::Triangle(found),
            (None, Some(surrogate)) => Met::Surrogate(surrogate),
            (None, None) => Met::Nothing,
        })
    }

    fn any_coarse(
        &self,
        rays: &[Ray],
        skips: &[Skip],
        footprints: &[Footprint],
        pixels: f64,
        blocked: &mut [bool],
        counters: &mut Counters,
    ) -> Result<()> {
        a_ray_each(rays, skips, blocked);
        let choose = |found, surrogate: Option<Approximate>| found || surrogate.is_some();
        self.coarse(Whether(skips), rays, (footprints, pixels), blocked, counters, choose)
    }

    fn closest_batch(&self, rays: &[Ray], hits: &mut [Hit]) -> Result<Counters> {
        batch(rays, hits, self.task(rays.len()), |rays, hits, counters| self.many(LeastHit, rays, hits, counters))
    }

    fn any_batch(&self, rays: &[Ray], blocked: &mut [bool]) -> Result<Counters> {
        batch(rays, blocked, self.task(rays.len()), |rays, blocked, counters| {
            self.many(Whether(&[]), rays, blocked, counters)
        })
    }
}
