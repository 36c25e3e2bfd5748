//! The tracer over an octree file: which walk answers what.

use std::borrow::Borrow;

use super::arch::Isa;
use super::ask::{Ask, Least, LeastHit, LeastOfEach, Whether, WhetherEach};
use super::batch::{Batch, SPACE};
use super::collect::Collector;
use super::flight::{Flight, STACKS, WORTHWHILE};
use super::lod::{Approximate, Coarse, Footprint, Met};
use super::near::Near;
use super::packet::{self, PACKET};
use super::setup::Scene;
use super::walk::{CACHED, File};
use super::{Counters, Found, Tracer, batch};
use crate::error::{Error, Result};
use crate::geometry::{Aabb, Hit, Ray, Skip};
use crate::map::Octree;

/// Answers rays by walking an octree file. `O` is `&Octree`, `Arc<Octree>`, or `Octree` itself.
#[derive(Clone)]
pub struct OctreeTracer<O> {
    octree: O,
    scene: Scene,
    isa: Isa,
    order: Option<Order>,
}

/// How the rays of a batch are walked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Order {
    /// One ray after the other.
    Single,
    /// Many rays under way at once, sorted by the step that each needs next: for rays that have nothing to do with each other, on large files.
    Flight,
    /// Neighbouring rays that run side by side together.
    Packet,
}

impl<O: Borrow<Octree>> OctreeTracer<O> {
    /// A tracer over an opened file.
    pub fn new(octree: O) -> OctreeTracer<O> {
        let file = octree.borrow();
        let scene = Scene::new(file.root(), file.bounds(), file.header().depth);
        OctreeTracer { octree, scene, isa: Isa::best(), order: None }
    }

    /// The same with a given instruction set; the answers are the same, bit for bit.
    pub fn with_isa(self, isa: Isa) -> OctreeTracer<O> {
        OctreeTracer { isa, ..self }
    }

    /// The same, but batches walked in that order, whatever suits the file and the rays; the answers are the same, bit for bit.
    pub fn with_order(self, order: Order) -> OctreeTracer<O> {
        OctreeTracer { order: Some(order), ..self }
    }

    /// The same, but each node's children far to near: slower, the answers the same, bit for bit. For tests of that.
    #[doc(hidden)]
    pub fn backward(mut self) -> OctreeTracer<O> {
        self.scene.turn = 7;
        self
    }

    /// The instruction set in use.
    pub fn isa(&self) -> Isa {
        self.isa
    }

    /// The file.
    pub fn octree(&self) -> &Octree {
        self.octree.borrow()
    }

    /// Answers one ray.
    fn ask_one<A: Ask>(&self, ask: A, ray: &Ray, counters: &mut Counters) -> Result<A::Answer> {
        let mut answer = [A::NOTHING];
        self.one_by_one::<A, 1>(ask, std::slice::from_ref(ray), &mut answer, false, counters)?;
        let [answer] = answer;
        Ok(answer)
    }

    /// Answers rays one after the other, on this thread; adds the work done to `counters`.
    pub(super) fn one_by_one<A: Ask, const N: usize>(
        &self,
        ask: A,
        rays: &[Ray],
        answers: &mut [A::Answer],
        packets: bool,
        counters: &mut Counters,
    ) -> Result<()> {
        let file = File::new(self.octree(), &self.scene);
        SPACE.with_borrow_mut(|space| {
            self.isa.run(Batch::<A, N> { ask, rays, answers, file, counters, space, packets })
        })?;
        self.octree().fault()
    }

    /// Answers rays with widths, on this thread.
    fn coarse<A: Ask>(
        &self,
        ask: A,
        rays: &[Ray],
        (footprints, pixels): (&[Footprint], f64),
        counters: &mut Counters,
        give: impl FnMut(usize, A::Answer, Option<Approximate>),
    ) -> Result<()> {
        let (octree, scene) = (self.octree(), &self.scene);
        let Some(detail) = octree.detail()? else {
            let file = octree.path().to_owned();
            return Err(Error::Input { file, what: "has no level of detail; build it again, without --no-lod".into() });
        };
        self.isa.run(Coarse { ask, rays, footprints, pixels, octree, detail, scene, counters, give })?;
        octree.fault()
    }

    /// Answers rays of which nothing is known, on this thread, by the walk that is faster for them and for the file.
    fn many<A: Ask>(&self, ask: A, rays: &[Ray], answers: &mut [A::Answer], counters: &mut Counters) -> Result<()>
    where
        for<'c> A::Collector<'c>: Collector<'c>,
    {
        match self.order {
            Some(Order::Flight) => self.several(ask, rays, answers, counters),
            Some(Order::Single) => self.one_by_one::<A, PACKET>(ask, rays, answers, false, counters),
            Some(Order::Packet) => self.one_by_one::<A, PACKET>(ask, rays, answers, true, counters),
            None => match packet::promising(rays) {
                true => self.one_by_one::<A, PACKET>(ask, rays, answers, true, counters),
                false => {
                    let uncached = self.octree().header().file_bytes > CACHED;
                    match uncached && rays.len() >= WORTHWHILE && packet::scattered(rays) {
                        true => self.several(ask, rays, answers, counters),
                        false => self.one_by_one::<A, PACKET>(ask, rays, answers, false, counters),
                    }
                }
            },
        }
    }

    /// Answers rays several at a time, on this thread; adds the work done to `counters`.
    fn several<A: Ask>(&self, ask: A, rays: &[Ray], answers: &mut [A::Answer], counters: &mut Counters) -> Result<()>
    where
        for<'c> A::Collector<'c>: Collector<'c>,
    {
        let file = File::new(self.octree(), &self.scene);
        STACKS.with_borrow_mut(|stacks| self.isa.run(Flight { ask, rays, answers, file, counters, stacks }))?;
        self.octree().fault()
    }
}

impl<O: Borrow<Octree> + Send + Sync> Tracer for OctreeTracer<O> {
    fn closest_counted(&self, ray: &Ray, skip: Skip, counters: &mut Counters) -> Result<Option<Found>> {
        self.ask_one(Least { skip, last: None }, ray, counters)
    }

    fn any_counted(&self, ray: &Ray, skip: Skip, counters: &mut Counters) -> Result<bool> {
        self.ask_one(Whether(skip), ray, counters)
    }

    fn next(&self, ray: &Ray, skip: Skip, last: &Found) -> Result<Option<Found>> {
        self.ask_one(Least { skip, last: Some(last) }, ray, &mut Counters::default())
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
        assert!(rays.len() == skips.len() && rays.len() == found.len(), "a skip and an answer a ray");
        self.many(LeastOfEach(skips), rays, found, counters)
    }

    fn any_each(&self, rays: &[Ray], skips: &[Skip], blocked: &mut [bool], counters: &mut Counters) -> Result<()> {
        assert!(rays.len() == skips.len() && rays.len() == blocked.len(), "a skip and an answer a ray");
        self.many(WhetherEach(skips), rays, blocked, counters)
    }

    fn any_short(&self, rays: &[Ray], skips: &[Skip], blocked: &mut [bool], counters: &mut Counters) -> Result<()> {
        assert!(rays.len() == skips.len() && rays.len() == blocked.len(), "a skip and an answer a ray");
        self.isa.run(Near { octree: self.octree(), rays, skips, blocked, counters })?;
        self.octree().fault()
    }

    fn closest_coarse(
        &self,
        rays: &[Ray],
        footprints: &[Footprint],
        pixels: f64,
        met: &mut [Met],
        counters: &mut Counters,
    ) -> Result<()> {
        assert!(
            rays.len() == footprints.len() && rays.len() == met.len() && pixels > 0.0,
            "a width and an answer a ray"
        );
        let give = |i: usize, found: Option<Found>, surrogate: Option<Approximate>| {
            met[i] = match (found, surrogate) {
                (Some(found), Some(surrogate)) if surrogate.t < found.hit.t => Met::Surrogate(surrogate),
                (Some(found), _) => Met::Triangle(found),
                (None, Some(surrogate)) => Met::Surrogate(surrogate),
                (None, None) => Met::Nothing,
            };
        };
        self.coarse(Least { skip: Skip::NONE, last: None }, rays, (footprints, pixels), counters, give)
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
        assert!(rays.len() == skips.len() && rays.len() == blocked.len(), "a skip and an answer a ray");
        assert!(rays.len() == footprints.len() && pixels > 0.0, "a width a ray");
        let give = |i: usize, found: bool, surrogate: Option<Approximate>| blocked[i] = found || surrogate.is_some();
        self.coarse(WhetherEach(skips), rays, (footprints, pixels), counters, give)
    }

    fn closest_batch(&self, rays: &[Ray], hits: &mut [Hit]) -> Result<Counters> {
        batch(rays, hits, |rays, hits, counters| self.many(LeastHit, rays, hits, counters))
    }

    fn any_batch(&self, rays: &[Ray], blocked: &mut [bool]) -> Result<Counters> {
        batch(rays, blocked, |rays, blocked, counters| self.many(Whether(Skip::NONE), rays, blocked, counters))
    }
}
