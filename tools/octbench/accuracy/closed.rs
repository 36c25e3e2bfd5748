//! `octbench closed`: a closed mesh is crossed an even number of times by every line, and nobody escapes from inside.

use std::collections::HashMap;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

use octrace::build::BuildOptions;
use octrace::event::Monitor;
use octrace::geometry::{Ray, Skip};
use octrace::trace::{OctreeTracer, Tracer, all_hits};
use octrace::{Error, Result};
use rayon::prelude::*;
use serde::Serialize;

use crate::bench::octree;
use crate::families::mesh::Mesh;
use crate::families::{Maker, ray, toward};
use crate::oracle::{Oracle, OracleRay, TierCounts};
use crate::random::Random;

/// What was counted.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct ClosedReport {
    /// Version of this form.
    pub schema: u32,
    /// Triangles of the mesh.
    pub triangles: u64,
    /// Rays, half of them whole lines, half from inside.
    pub rays: u64,
    /// Crossings found.
    pub crossings: u64,
    /// Lines that cross an odd number of times, and rays from inside that cross an even number.
    pub wrong_parity: u64,
    /// Rays from inside that meet nothing.
    pub escapes: u64,
    /// Wall clock.
    pub seconds: f64,
}

impl ClosedReport {
    fn add(self, other: ClosedReport) -> ClosedReport {
        ClosedReport {
            rays: self.rays + other.rays,
            crossings: self.crossings + other.crossings,
            wrong_parity: self.wrong_parity + other.wrong_parity,
            escapes: self.escapes + other.escapes,
            ..self
        }
    }
}

/// Rays a task takes.
const TASK: u64 = 4096;

/// Aims rays at vertices, middles of edges and points of faces. Errors: the mesh is not closed.
pub fn run(mesh: &Mesh, name: &Path, rays: u64, seed: u64, monitor: Monitor<'_>) -> Result<ClosedReport> {
    if !is_closed(mesh) {
        let what = "not closed: some edge lies on an odd number of faces".to_owned();
        return Err(Error::Input { file: name.to_owned(), what });
    }
    monitor.phase("build");
    let tracer = OctreeTracer::new(octree(mesh, &BuildOptions::default())?);
    let inside = points_inside(mesh, seed);
    monitor.phase("closed");
    let started = std::time::Instant::now();
    let done = AtomicU64::new(0);
    let report = (0..rays.div_ceil(TASK))
        .into_par_iter()
        .map(|task| {
            let count = TASK.min(rays - task * TASK);
            let mut maker = maker(mesh, seed ^ (task + 1) << 20);
            let mut report = ClosedReport::default();
            for k in 0..count {
                one(&tracer, &mut maker, mesh, &inside, k, &mut report)?;
            }
            monitor.progress(done.fetch_add(count, Ordering::Relaxed) + count, Some(rays), "rays");
            monitor.check().map(|()| report)
        })
        .try_reduce(ClosedReport::default, |a, b| Ok(a.add(b)))?;
    let (triangles, seconds) = (mesh.faces.len() as u64, started.elapsed().as_secs_f64());
    Ok(ClosedReport { schema: 1, triangles, seconds, ..report })
}

fn maker(mesh: &Mesh, seed: u64) -> Maker<'_> {
    Maker {
        random: Random::new(seed),
        rays: 0,
        size: mesh.faces.len(),
        round: 0,
        model: Some(mesh),
        ball: None,
        turn: 0,
    }
}

/// One ray: a whole line or a ray from inside, in turn.
fn one(
    tracer: &dyn Tracer,
    maker: &mut Maker<'_>,
    mesh: &Mesh,
    inside: &[[f32; 3]],
    k: u64,
    report: &mut ClosedReport,
) -> Result<()> {
    let from_inside = k % 2 == 1 && !inside.is_empty();
    let origin = if from_inside { maker.random.pick(inside) } else { maker.origin(mesh) };
    let mut ray = Ray::new(origin, toward(origin, maker.target(mesh)));
    if !from_inside {
        ray.tmin = f32::NEG_INFINITY;
    }
    if !ray.is_valid() {
        return Ok(());
    }
    let mut crossings = 0;
    for hit in all_hits(tracer, &ray, Skip::NONE) {
        hit?;
        crossings += 1;
    }
    report.rays += 1;
    report.crossings += crossings;
    report.wrong_parity += u64::from((crossings % 2 == 1) != from_inside);
    report.escapes += u64::from(from_inside && crossings == 0);
    Ok(())
}

/// Whether every edge lies on an even number of faces; vertices at the same place are one.
fn is_closed(mesh: &Mesh) -> bool {
    let place = |v: u32| mesh.points[v as usize].map(|x| (x + 0.0).to_bits());
    let mut edges = HashMap::new();
    for f in &mesh.faces {
        for k in 0..3 {
            let (a, b) = (place(f[k]), place(f[(k + 1) % 3]));
            *edges.entry((a.min(b), a.max(b))).or_insert(0u32) += 1;
        }
    }
    edges.values().all(|n| n % 2 == 0)
}

/// Points from which the oracle counts an odd number of crossings, well away from the surface.
fn points_inside(mesh: &Mesh, seed: u64) -> Vec<[f32; 3]> {
    let oracle = Oracle::new(mesh.triangles().enumerate().map(|(i, c)| (i as u32, c)));
    let (low, high) = mesh.bounds();
    let mut random = Random::new(seed);
    let mut inside = |_: usize| {
        let p = [0, 1, 2].map(|i| (low[i] + (high[i] - low[i]) * random.unit()) as f32);
        let d = random.direction().map(|x| x as f32);
        let all = oracle.all(&OracleRay { tmin: f32::MIN, ..ray(p, d) }, &[], &mut TierCounts::default());
        let ahead = all.iter().filter(|a| a.t > 0.0).count();
        let clear = all.iter().all(|a| f64::from(a.t.abs()) > 1e-3 * (high[0] - low[0]));
        (ahead % 2 == 1 && clear).then_some(p)
    };
    (0..1000).filter_map(&mut inside).take(64).collect()
}
