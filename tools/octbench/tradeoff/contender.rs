//! The tracers that are compared, behind one face: time a round, give the hits.

use std::path::Path;

use octrace::Result;
use octrace::geometry::{FaceId, Hit, Ray};
use rayon::ThreadPool;
use rayon::prelude::*;

use crate::bench::records;
use crate::speed::kernels::{Kernel, Measured};
use crate::speed::peer::Peer;
use crate::speed::sets::Question;
use crate::timing::Clock;
use crate::yardstick::{self, Corners, PlainHit, PlainOctree};

/// Rays by which the test of every triangle is timed: it is slow.
const FEW: usize = 100;

/// One tracer.
pub enum Contender<'a> {
    /// A kernel of the library.
    Library(&'static Kernel, Measured<'a>),
    /// The plain octree.
    Octree(&'a PlainOctree),
    /// The plain test of every triangle, for every so many-th ray: it is slow.
    Every(&'a [Corners], usize),
    /// Another program.
    Peer(&'a mut Peer),
}

/// Rays, in memory and in a file.
pub struct Rays<'a> {
    /// The rays.
    pub rays: &'a [Ray],
    /// Where peers find them.
    pub file: &'a Path,
}

impl Contender<'_> {
    /// Its name.
    pub fn name(&self) -> String {
        match self {
            Contender::Library(kernel, _) if kernel.float_of.is_some() => format!("octrace, rounded ({})", kernel.name),
            Contender::Library(kernel, _) => format!("octrace, exact ({})", kernel.name),
            Contender::Octree(_) => "plain octree, f32".to_owned(),
            Contender::Every(_, 1) => "every triangle, f32".to_owned(),
            Contender::Every(_, step) => format!("every triangle, f32 (1 ray in {step})"),
            Contender::Peer(peer) => peer.name.clone(),
        }
    }

    /// Whether it claims to be exact.
    pub fn is_exact(&self) -> bool {
        matches!(self, Contender::Library(kernel, _) if kernel.float_of.is_none())
    }

    /// Traces on one thread; seconds for all rays, for a tracer that is slow reckoned from a part.
    pub fn time(&mut self, rays: &Rays<'_>, clock: Clock, one: &ThreadPool) -> Result<f64> {
        let list = rays.rays;
        let some = &list[..list.len().min(FEW)];
        match self {
            Contender::Library(kernel, tracer) => {
                let mut hits = vec![Hit::MISS; list.len()];
                let trace = || library(kernel, tracer, list, &mut hits);
                Ok(one.install(|| clock.time(trace))?.0)
            }
            Contender::Octree(tree) => Ok(clock.time(|| Ok(walk(tree, list)))?.0),
            Contender::Every(corners, _) => {
                let (seconds, ()) = clock.time(|| {
                    some.iter().for_each(|ray| {
                        std::hint::black_box(every(corners, ray));
                    });
                    Ok(())
                })?;
                Ok(seconds * list.len() as f64 / some.len().max(1) as f64)
            }
            Contender::Peer(peer) => peer.round(Question::Closest, 1, rays.file)?.seconds(clock),
        }
    }

    /// It answers one ray in so many.
    pub fn step(&self) -> usize {
        if let Contender::Every(_, step) = self { *step } else { 1 }
    }

    /// The hits of all rays that it answers; `store` is a file that a peer may write.
    pub fn hits(&mut self, rays: &Rays<'_>, store: &Path) -> Result<Vec<Hit>> {
        match self {
            Contender::Library(kernel, tracer) => {
                let mut hits = vec![Hit::MISS; rays.rays.len()];
                library(kernel, tracer, rays.rays, &mut hits)?;
                Ok(hits)
            }
            Contender::Octree(tree) => Ok(walk(tree, rays.rays)),
            Contender::Every(corners, step) => {
                Ok(rays.rays.par_iter().step_by(*step).map(|ray| every(corners, ray)).collect())
            }
            Contender::Peer(peer) => {
                peer.round(Question::Closest, 1, rays.file)?;
                peer.store(store)?;
                records(store)
            }
        }
    }
}

fn library(kernel: &Kernel, tracer: &Measured<'_>, rays: &[Ray], hits: &mut [Hit]) -> Result<()> {
    let closest = kernel.closest.expect("only kernels that find closest hits are compared");
    closest(tracer, rays, hits).map(|_| ())
}

fn walk(tree: &PlainOctree, rays: &[Ray]) -> Vec<Hit> {
    rays.iter().map(|r| plain(tree.closest(r.origin, r.direction, r.tmin, r.tmax))).collect()
}

fn every(corners: &[Corners], r: &Ray) -> Hit {
    plain(yardstick::closest_of_all(corners, r.origin, r.direction, r.tmin, r.tmax))
}

fn plain(hit: Option<PlainHit>) -> Hit {
    hit.map_or(Hit::MISS, |h| Hit { t: h.t, face: FaceId(h.face), u: h.u, v: h.v })
}
