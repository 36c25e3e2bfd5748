//! `octbench closed`: a closed mesh is crossed an even number of times by every line, and nobody escapes from inside.

use std::collections::HashMap;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

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
    /// Edges, all of them between two faces that run along it in opposite directions.
    pub edges: u64,
    /// Rays: half of them from inside, a quarter from outside, a quarter whole lines.
    pub rays: u64,
    /// Crossings found.
    pub crossings: u64,
    /// Lines and rays from outside that cross an odd number of times, and rays from inside that cross an even number.
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

/// Aims rays at vertices, middles and other points of edges, and points of faces. Errors: the mesh is not closed, or no point
/// inside it was found.
pub fn run(mesh: &Mesh, name: &Path, rays: u64, seed: u64, monitor: Monitor<'_>) -> Result<ClosedReport> {
    let wrong = |what: String| Error::Input { file: name.to_owned(), what };
    let edges = edges_of_closed(mesh).map_err(wrong)?;
    monitor.phase("build");
    let tracer = OctreeTracer::new(octree(mesh, &super::lossless())?);
    let origins = Origins { ball: mesh.ball(), inside: points_inside(mesh, seed) };
    if origins.inside.is_empty() {
        return Err(wrong("no point inside was found: it is too thin; name another mesh".to_owned()));
    }
    monitor.phase("closed");
    let started = std::time::Instant::now();
    let done = AtomicU64::new(0);
    let report = (0..rays.div_ceil(TASK))
        .into_par_iter()
        .map(|task| {
            let count = TASK.min(rays - task * TASK);
            let mut maker = Maker::on(mesh, Random::new(seed ^ (task + 1) << 20), 0);
            let mut report = ClosedReport::default();
            for k in 0..count {
                one(&tracer, &mut maker, mesh, &origins, k, &mut report)?;
            }
            monitor.progress(done.fetch_add(count, Ordering::Relaxed) + count, Some(rays), "rays");
            monitor.check().map(|()| report)
        })
        .try_reduce(ClosedReport::default, |a, b| Ok(a.add(b)))?;
    let (triangles, seconds) = (mesh.faces.len() as u64, started.elapsed().as_secs_f64());
    Ok(ClosedReport { schema: 1, triangles, edges, seconds, ..report })
}

/// Where rays start.
struct Origins {
    /// Centre and radius of a ball around the mesh.
    ball: ([f64; 3], f64),
    /// Points inside.
    inside: Vec<[f32; 3]>,
}

/// A ray, and whether it starts inside.
fn aimed(maker: &mut Maker<'_>, mesh: &Mesh, origins: &Origins, k: u64) -> (Ray, bool) {
    let (center, radius) = origins.ball;
    let random = &mut maker.random;
    let mut away = |radii: &[f64]| -> [f32; 3] {
        let (r, d) = (radius * random.pick(radii), random.direction());
        std::array::from_fn(|i| (center[i] + r * d[i]) as f32)
    };
    let (origin, tmin) = match k % 4 {
        0 => (away(&[0.2, 0.9, 3.0, 30.0]), f32::NEG_INFINITY),
        2 => (away(&[1.5, 3.0, 10.0]), 0.0),
        _ => (random.pick(&origins.inside), 0.0),
    };
    loop {
        let ray = Ray::new(origin, toward(origin, maker.target(mesh))).between(tmin, f32::INFINITY);
        if ray.is_valid() {
            return (ray, k % 2 == 1);
        }
    }
}

/// One ray, its crossings counted.
fn one(
    tracer: &dyn Tracer,
    maker: &mut Maker<'_>,
    mesh: &Mesh,
    origins: &Origins,
    k: u64,
    report: &mut ClosedReport,
) -> Result<()> {
    let (ray, from_inside) = aimed(maker, mesh, origins, k);
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

/// The number of edges of a closed surface: each lies on two faces, which run along it in opposite directions. Vertices at the same
/// place are one; faces of which two corners are one are nothing. Else what is wrong.
fn edges_of_closed(mesh: &Mesh) -> std::result::Result<u64, String> {
    let place = |v: u32| mesh.points[v as usize].map(|x| (x + 0.0).to_bits());
    let mut edges = HashMap::new();
    for f in &mesh.faces {
        let corners = f.map(place);
        if (0..3).any(|k| corners[k] == corners[(k + 1) % 3]) {
            continue;
        }
        for k in 0..3 {
            let (a, b) = (corners[k], corners[(k + 1) % 3]);
            let [along, against] = edges.entry((a.min(b), a.max(b))).or_insert([0u32; 2]);
            *(if a < b { along } else { against }) += 1;
        }
    }
    let count = |wrong: fn(&&[u32; 2]) -> bool| edges.values().filter(wrong).count();
    let open = count(|[along, against]| along + against == 1);
    let uneven = count(|[along, against]| along + against != 1 && [along, against] != [&1, &1]);
    match open + uneven {
        0 => Ok(edges.len() as u64),
        _ => Err(format!(
            "not a closed manifold, and only such a mesh can be tested so: of {} edges {open} lie on one face, {uneven} on more than two or \
             on two that disagree; name another mesh, or mend this one",
            edges.len()
        )),
    }
}

/// Where a point lies with regard to a closed surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// A ray from it crosses the surface an odd number of times.
    Inside,
    /// On the surface, exactly.
    OnSurface,
    /// An even number of times.
    Outside,
}

/// Where the oracle finds a point: by the crossings of a line through it in a random direction.
pub fn place(oracle: &Oracle, point: [f32; 3], random: &mut Random) -> Place {
    let line = OracleRay { tmin: f32::NEG_INFINITY, ..ray(point, random.direction().map(|x| x as f32)) };
    let all = oracle.all(&line, &[], &mut TierCounts::default());
    if all.iter().any(|a| a.t == 0.0) {
        Place::OnSurface
    } else if all.iter().filter(|a| a.t > 0.0).count() % 2 == 1 {
        Place::Inside
    } else {
        Place::Outside
    }
}

/// Points that the oracle finds inside.
fn points_inside(mesh: &Mesh, seed: u64) -> Vec<[f32; 3]> {
    let oracle = Oracle::new(mesh.triangles().enumerate().map(|(i, c)| (i as u32, c)));
    let (low, high) = mesh.bounds();
    let mut random = Random::new(seed);
    let mut inside = |_: usize| {
        let p = [0, 1, 2].map(|i| (low[i] + (high[i] - low[i]) * random.unit()) as f32);
        (place(&oracle, p, &mut random) == Place::Inside).then_some(p)
    };
    (0..20_000).filter_map(&mut inside).take(1024).collect()
}
