//! Rays against an octree file: closest hit, any hit, all hits in order, and the triangles that touch a box.
//!
//! [`OctreeTracer`] walks the file's own bytes: the parametric octree traversal of Revelles, Ureña and Lastra (2000) in a form that
//! never loses a cell, over nodes and leaves as FORMAT.md has them. `setup.rs` has the argument, `walk.rs` the walk of one ray, `settle.rs`
//! what becomes of a leaf on it, `flight/` the walk of several under way at once, `packet/` that of rays side by side, `near.rs` that of short rays;
//! `walker.rs` says which of them answers what;
//! `patient.rs` lets rays wait where pages are read within a budget, and `trip.rs` is how a walk is put aside there;
//! `rough.rs` measures what exactness costs. A triangle is tested by the f32 filter of [`crate::exact`] first and exactly where that is in doubt. [`LinearTracer`] tests every triangle
//! exactly and is the reference. `arch/` holds the inner loops.
//!
//! Answers depend on the set of triangles alone: closest means least by (exact t, face id). What this module does not do:
//! shading, instances, analytic shapes.

mod arch;
mod ask;
mod attributes;
mod batch;
mod boxes;
mod collect;
mod flight;
mod linear;
mod lod;
mod near;
mod octree;
mod packet;
mod patient;
mod rough;
mod settle;
mod setup;
mod trip;
mod walk;
mod walker;

use rayon::prelude::*;

use crate::error::Result;
use crate::format::PageId;
use crate::geometry::{Aabb, Hit, Ray, Skip, Triangle};

pub use arch::Isa;
pub use attributes::{Attributes, attributes};
pub use boxes::{Stored, triangles_in_box};
pub use linear::LinearTracer;
pub use lod::{Approximate, Footprint, Met};
pub use octree::{OctreeTracer, Order};

/// Rays that one task of a batch takes.
const BATCH: usize = 1024;

/// A hit with where it is stored, so that attributes can be fetched.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Found {
    /// The hit as a caller sees it.
    pub hit: Hit,
    /// The triangle.
    pub triangle: Triangle,
    /// Its page.
    pub page: PageId,
    /// Its reference within the brick.
    pub reference: u32,
}

/// Something that answers rays exactly: the octree, or the linear reference.
///
/// Closest: the hit least by (exact t, face id) with the correctly rounded t in `[tmin, tmax]`. All answers depend on the set of
/// triangles alone, never on how they are stored or walked. Invalid rays ([`Ray::is_valid`]) hit nothing. Errors: a page
/// that is damaged, or a file cut short while in use.
pub trait Tracer: Send + Sync {
    /// The closest hit, leaving out `skip`; adds the work done to `counters`.
    fn closest_counted(&self, ray: &Ray, skip: Skip, counters: &mut Counters) -> Result<Option<Found>>;

    /// Whether anything is hit, leaving out `skip`; adds the work done to `counters`.
    fn any_counted(&self, ray: &Ray, skip: Skip, counters: &mut Counters) -> Result<bool>;

    /// The first hit after `last` (a hit of the same ray) by (exact t, face id), leaving out `skip`.
    fn next(&self, ray: &Ray, skip: Skip, last: &Found) -> Result<Option<Found>>;

    /// Box around all triangles.
    fn bounds(&self) -> Aabb;

    /// The closest hit, leaving out `skip`.
    fn closest(&self, ray: &Ray, skip: Skip) -> Result<Option<Found>> {
        self.closest_counted(ray, skip, &mut Counters::default())
    }

    /// Whether anything is hit, leaving out `skip`.
    fn any(&self, ray: &Ray, skip: Skip) -> Result<bool> {
        self.any_counted(ray, skip, &mut Counters::default())
    }

    /// The closest hits of rays on this thread, each leaving out its own `skips[i]`; `found[i]` answers `rays[i]`. Adds the
    /// work done to `counters`.
    ///
    /// # Panics
    /// If the slices differ in length.
    fn closest_each(
        &self,
        rays: &[Ray],
        skips: &[Skip],
        found: &mut [Option<Found>],
        counters: &mut Counters,
    ) -> Result<()> {
        a_ray_each(rays, skips, found);
        for ((ray, skip), found) in rays.iter().zip(skips).zip(found) {
            *found = self.closest_counted(ray, *skip, counters)?;
        }
        Ok(())
    }

    /// Whether each of the rays hits anything, on this thread, each leaving out its own `skips[i]`; `blocked[i]` answers `rays[i]`.
    /// Adds the work done to `counters`.
    ///
    /// # Panics
    /// If the slices differ in length.
    fn any_each(&self, rays: &[Ray], skips: &[Skip], blocked: &mut [bool], counters: &mut Counters) -> Result<()> {
        a_ray_each(rays, skips, blocked);
        for ((ray, skip), blocked) in rays.iter().zip(skips).zip(blocked) {
            *blocked = self.any_counted(ray, *skip, counters)?;
        }
        Ok(())
    }

    /// The same answers as [`Tracer::any_each`]'s, for rays that are short beside the triangles and come with their neighbours: much
    /// faster for these, much slower for long ones.
    ///
    /// # Panics
    /// If the slices differ in length.
    fn any_short(&self, rays: &[Ray], skips: &[Skip], blocked: &mut [bool], counters: &mut Counters) -> Result<()> {
        self.any_each(rays, skips, blocked, counters)
    }

    /// What rays with widths meet first, on this thread: nodes whose error is at most `pixels` widths stand for their triangles. `met[i]` answers
    /// `rays[i]`, whose width is `footprints[i]`. See `lod.rs` for what holds of the answers. A tracer without level of detail answers exactly.
    ///
    /// # Panics
    /// If the slices differ in length.
    fn closest_coarse(
        &self,
        rays: &[Ray],
        footprints: &[Footprint],
        pixels: f64,
        met: &mut [Met],
        counters: &mut Counters,
    ) -> Result<()> {
        a_width_each(rays, footprints, pixels, met);
        for (ray, met) in rays.iter().zip(met) {
            *met = self.closest_counted(ray, Skip::NONE, counters)?.map_or(Met::Nothing, Met::Triangle);
        }
        Ok(())
    }

    /// Whether rays with widths meet anything, likewise, each leaving out its own `skips[i]` of the triangles.
    ///
    /// # Panics
    /// If the slices differ in length.
    fn any_coarse(
        &self,
        rays: &[Ray],
        skips: &[Skip],
        footprints: &[Footprint],
        pixels: f64,
        blocked: &mut [bool],
        counters: &mut Counters,
    ) -> Result<()> {
        a_width_each(rays, footprints, pixels, blocked);
        self.any_each(rays, skips, blocked, counters)
    }

    /// The closest hits of many rays, in parallel on rayon's current pool; `hits[i]` answers `rays[i]`.
    ///
    /// # Panics
    /// If the slices differ in length.
    fn closest_batch(&self, rays: &[Ray], hits: &mut [Hit]) -> Result<Counters> {
        batch(rays, hits, BATCH, |rays, hits, counters| {
            for (ray, hit) in rays.iter().zip(hits) {
                *hit = self.closest_counted(ray, Skip::NONE, counters)?.map_or(Hit::MISS, |found| found.hit);
            }
            Ok(())
        })
    }

    /// Whether each of many rays hits anything, in parallel; `blocked[i]` answers `rays[i]`.
    ///
    /// # Panics
    /// If the slices differ in length.
    fn any_batch(&self, rays: &[Ray], blocked: &mut [bool]) -> Result<Counters> {
        batch(rays, blocked, BATCH, |rays, blocked, counters| {
            for (ray, blocked) in rays.iter().zip(blocked) {
                *blocked = self.any_counted(ray, Skip::NONE, counters)?;
            }
            Ok(())
        })
    }
}

/// Panics if there is not one of each for a ray: what is given with it, and a place for its answer.
fn a_ray_each<G, A>(rays: &[Ray], given: &[G], answers: &[A]) {
    assert_eq!(rays.len(), given.len(), "one of what is given for each ray");
    assert_eq!(rays.len(), answers.len(), "one answer a ray");
}

/// Panics if there is not a width and a place for an answer a ray, or nothing that a width may be measured against.
fn a_width_each<A>(rays: &[Ray], footprints: &[Footprint], pixels: f64, answers: &[A]) {
    a_ray_each(rays, footprints, answers);
    assert!(pixels > 0.0, "an error of {pixels} pixels is asked for");
}

/// All hits of a ray in the order of (exact t, face id), each triangle once.
pub fn all_hits<'a, T: Tracer + ?Sized>(tracer: &'a T, ray: &Ray, skip: Skip) -> AllHits<'a, T> {
    AllHits { tracer, ray: *ray, skip, state: State::Fresh }
}

/// The iterator of [`all_hits`]. Ends after an error.
pub struct AllHits<'a, T: ?Sized> {
    tracer: &'a T,
    ray: Ray,
    skip: Skip,
    state: State,
}

enum State {
    Fresh,
    After(Found),
    Ended,
}

impl<T: Tracer + ?Sized> Iterator for AllHits<'_, T> {
    type Item = Result<Found>;

    fn next(&mut self) -> Option<Result<Found>> {
        let step = match &self.state {
            State::Fresh => self.tracer.closest(&self.ray, self.skip),
            State::After(last) => self.tracer.next(&self.ray, self.skip, last),
            State::Ended => return None,
        };
        self.state = match &step {
            Ok(Some(found)) => State::After(*found),
            _ => State::Ended,
        };
        step.transpose()
    }
}

/// Answers rays in parallel, in chunks of `size`, and sums the work.
fn batch<A: Send>(
    rays: &[Ray],
    answers: &mut [A],
    size: usize,
    answer: impl Fn(&[Ray], &mut [A], &mut Counters) -> Result<()> + Sync,
) -> Result<Counters> {
    assert_eq!(rays.len(), answers.len(), "one answer a ray");
    rays.par_chunks(size)
        .zip(answers.par_chunks_mut(size))
        .map(|(rays, answers)| {
            let mut counters = Counters::default();
            answer(rays, answers, &mut counters)?;
            Ok(counters)
        })
        .try_reduce(Counters::default, |a, b| Ok(a + b))
}

/// Work done, summed over rays; explains times. What a packet does for all of its rays at once counts once.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Rays traced.
    pub rays: u64,
    /// Nodes visited.
    pub nodes: u64,
    /// Leaves visited.
    pub leaves: u64,
    /// Triangles tested.
    pub triangles: u64,
    /// Bricks entered.
    pub bricks: u64,
    /// Triangles whose f32 test was in doubt and went to f64.
    pub doubts: u64,
    /// Triangles that needed expansions to decide whether they are hit.
    pub exact: u64,
    /// How often a ray came to a page that was not in memory, and had to wait. Depends on what was traced before, unlike all else.
    pub waits: u64,
}

impl std::ops::Add for Counters {
    type Output = Counters;
    fn add(self, other: Counters) -> Counters {
        Counters {
            rays: self.rays + other.rays,
            nodes: self.nodes + other.nodes,
            leaves: self.leaves + other.leaves,
            triangles: self.triangles + other.triangles,
            bricks: self.bricks + other.bricks,
            doubts: self.doubts + other.doubts,
            exact: self.exact + other.exact,
            waits: self.waits + other.waits,
        }
    }
}
