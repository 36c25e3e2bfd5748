//! The tracer over an octree file, as a caller holds it.
//!
//! It hands every question on to [`Walker`], which is compiled with the library; what is compiled again for each kind of `O`, in the
//! program that traces rays, is a call a question.

use std::borrow::Borrow;

use super::arch::Isa;
use super::lod::{Footprint, Met};
use super::setup::Scene;
use super::walker::Walker;
use super::{Counters, Found, Tracer};
use crate::error::Result;
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

    /// What walks the file.
    pub(super) fn walker(&self) -> Walker<'_> {
        Walker { octree: self.octree(), scene: &self.scene, isa: self.isa, order: self.order }
    }
}

/// By the methods of the same names of `Walker`, one by one: this is the border behind which nothing is generic.
impl<O: Borrow<Octree> + Send + Sync> Tracer for OctreeTracer<O> {
    fn closest_counted(&self, ray: &Ray, skip: Skip, counters: &mut Counters) -> Result<Option<Found>> {
        self.walker().closest_counted(ray, skip, counters)
    }

    fn any_counted(&self, ray: &Ray, skip: Skip, counters: &mut Counters) -> Result<bool> {
        self.walker().any_counted(ray, skip, counters)
    }

    fn next(&self, ray: &Ray, skip: Skip, last: &Found) -> Result<Option<Found>> {
        self.walker().next(ray, skip, last)
    }

    fn bounds(&self) -> Aabb {
        self.walker().bounds()
    }

    fn closest_each(
        &self,
        rays: &[Ray],
        skips: &[Skip],
        found: &mut [Option<Found>],
        counters: &mut Counters,
    ) -> Result<()> {
        self.walker().closest_each(rays, skips, found, counters)
    }

    fn any_each(&self, rays: &[Ray], skips: &[Skip], blocked: &mut [bool], counters: &mut Counters) -> Result<()> {
        self.walker().any_each(rays, skips, blocked, counters)
    }

    fn any_short(&self, rays: &[Ray], skips: &[Skip], blocked: &mut [bool], counters: &mut Counters) -> Result<()> {
        self.walker().any_short(rays, skips, blocked, counters)
    }

    fn closest_coarse(
        &self,
        rays: &[Ray],
        footprints: &[Footprint],
        pixels: f64,
        met: &mut [Met],
        counters: &mut Counters,
    ) -> Result<()> {
        self.walker().closest_coarse(rays, footprints, pixels, met, counters)
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
        self.walker().any_coarse(rays, skips, footprints, pixels, blocked, counters)
    }

    fn closest_batch(&self, rays: &[Ray], hits: &mut [Hit]) -> Result<Counters> {
        self.walker().closest_batch(rays, hits)
    }

    fn any_batch(&self, rays: &[Ray], blocked: &mut [bool]) -> Result<Counters> {
        self.walker().any_batch(rays, blocked)
    }
}
