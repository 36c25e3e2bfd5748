//! The tracer over an octree file: which walk answers what.

use std::borrow::Borrow;

use super::arch::Isa;
use super::ask::{Ask, Least, LeastHit, Whether};
use super::flight::{Flight, STACKS};
use super::near::Near;
use super::setup::Scene;
use super::walk::{File, OneByOne, STACK};
use super::{Counters, Found, Tracer, batch};
use crate::error::Result;
use crate::geometry::{Aabb, Hit, Ray, Skip};
use crate::map::Octree;

/// Batches on files up to this size, which mostly stay in the processor's caches, are walked one ray after the other: measured.
const CACHED: u64 = 64 << 20;

/// Answers rays by walking an octree file. `O` is `&Octree`, `Arc<Octree>`, or `Octree` itself.
#[derive(Clone)]
pub struct OctreeTracer<O> {
    octree: O,
    scene: Scene,
    isa: Isa,
    in_flight: bool,
}

impl<O: Borrow<Octree>> OctreeTracer<O> {
    /// A tracer over an opened file.
    pub fn new(octree: O) -> OctreeTracer<O> {
        let file = octree.borrow();
        let scene = Scene::new(file.root(), file.bounds(), file.header().depth);
        let in_flight = file.header().file_bytes > CACHED;
        OctreeTracer { octree, scene, isa: Isa::best(), in_flight }
    }

    /// The same with a given instruction set; the answers are the same, bit for bit.
    pub fn with_isa(self, isa: Isa) -> OctreeTracer<O> {
        OctreeTracer { isa, ..self }
    }

    /// The same, but batches walked several rays at a time or one ray after the other, whatever the file's size; the answers are the
    /// same, bit for bit.
    pub fn with_flight(self, in_flight: bool) -> OctreeTracer<O> {
        OctreeTracer { in_flight, ..self }
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
        self.one_by_one(ask, std::slice::from_ref(ray), &mut answer, counters)?;
        let [answer] = answer;
        Ok(answer)
    }

    /// Answers rays one after the other, on this thread; adds the work done to `counters`.
    fn one_by_one<A: Ask>(
        &self,
        ask: A,
        rays: &[Ray],
        answers: &mut [A::Answer],
        counters: &mut Counters,
    ) -> Result<()> {
        let file = File::new(self.octree(), &self.scene);
        STACK.with_borrow_mut(|stack| self.isa.run(OneByOne { ask, rays, answers, file, counters, stack }))?;
        self.octree().fault()
    }

    /// Answers rays of which nothing is known, on this thread, by the walk that is faster for the file.
    fn many<A: Ask>(&self, ask: A, rays: &[Ray], answers: &mut [A::Answer], counters: &mut Counters) -> Result<()> {
        if self.in_flight {
            self.several(ask, rays, answers, counters)
        } else {
            self.one_by_one(ask, rays, answers, counters)
        }
    }

    /// Answers rays several at a time, on this thread; adds the work done to `counters`.
    fn several<A: Ask>(&self, ask: A, rays: &[Ray], answers: &mut [A::Answer], counters: &mut Counters) -> Result<()> {
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

    fn any_short(&self, rays: &[Ray], skips: &[Skip], blocked: &mut [bool], counters: &mut Counters) -> Result<()> {
        self.isa.run(Near { octree: self.octree(), rays, skips, blocked, counters })?;
        self.octree().fault()
    }

    fn closest_batch(&self, rays: &[Ray], hits: &mut [Hit]) -> Result<Counters> {
        batch(rays, hits, |rays, hits, counters| self.many(LeastHit, rays, hits, counters))
    }

    fn any_batch(&self, rays: &[Ray], blocked: &mut [bool]) -> Result<Counters> {
        batch(rays, blocked, |rays, blocked, counters| self.many(Whether(Skip::NONE), rays, blocked, counters))
    }
}
