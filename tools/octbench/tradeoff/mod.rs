//! `octbench tradeoff`: speed against error, this tracer and others on the same rays.
//!
//! Rays are aimed at vertices, edges and faces of one mesh. All tracers run on one thread, one ray at a time; errors are counted
//! against the oracle. Writes a table, JSON, and a plot as SVG.

mod plot;

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use octrace::build::BuildOptions;
use octrace::geometry::{FaceId, Hit, Ray, Skip};
use octrace::trace::{Isa, OctreeTracer, Tracer};
use octrace::{Error, Result};
use serde::Serialize;

use crate::accuracy::judge::ulps;
use crate::bench::{load, octree};
use crate::cli::Session;
use crate::cli::args::StatsFile;
use crate::cli::output::{print, write_whole};
use crate::families::mesh::Mesh;
use crate::families::{Maker, toward};
use crate::oracle::{Answer, Oracle, OracleRay, TierCounts};
use crate::planet;
use crate::random::Random;
use crate::yardstick::{self, PlainOctree};

/// What the subcommand takes.
#[derive(clap::Args)]
pub struct Options {
    /// The mesh [default: a planet of 100,000 triangles]
    #[arg(long, value_name = "FILE.obj")]
    model: Option<PathBuf>,
    /// Aimed rays to trace
    #[arg(long, value_name = "N", default_value = "100000", value_parser = crate::count)]
    rays: u64,
    /// Trace these rays (32 bytes each) instead
    #[arg(long, value_name = "FILE")]
    rays_file: Option<PathBuf>,
    /// Hits of another tracer for the rays of --rays-file (16 bytes each)
    #[arg(long, value_name = "FILE", requires = "rays_file")]
    peer: Option<PathBuf>,
    /// Speed of that tracer in Mrays/s, as it was measured beside these
    #[arg(long, value_name = "X", requires = "peer")]
    peer_mrays: Option<f64>,
    /// Write the plot here
    #[arg(short, long, value_name = "FILE.svg")]
    output: Option<PathBuf>,
    /// Seed of planet and rays
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    #[command(flatten)]
    stats: StatsFile,
}

/// One tracer: its speed and its errors.
#[derive(Debug, Serialize)]
pub struct Row {
    tracer: String,
    rays: u64,
    missed: u64,
    #[serde(rename = "false")]
    false_hits: u64,
    wrong_triangle: u64,
    /// Right triangle, but t is not the correctly rounded one.
    wrong_t: u64,
    /// Missed, false and wrong, as a share of the rays.
    error_rate: f64,
    mrays_per_second: Option<f64>,
}

#[derive(Serialize)]
struct Report<'a> {
    schema: u32,
    triangles: u64,
    tracers: &'a [Row],
}

/// Rays that the test of all triangles is given: it is slow.
const FEW: usize = 500;

/// Runs the comparison.
pub fn run(options: &Options, session: &Session<'_>) -> Result<()> {
    let monitor = session.monitor();
    let mesh = match &options.model {
        Some(path) => load(path, monitor)?,
        None => planet::mesh(100_000, options.seed),
    };
    let rays = match &options.rays_file {
        Some(path) => records::<Ray>(path)?,
        None => aimed(&mesh, options.rays, options.seed),
    };
    monitor.phase("oracle");
    let oracle = Oracle::new(mesh.triangles().enumerate().map(|(i, c)| (i as u32, c)));
    let oracle_ray = |r: &Ray| OracleRay { o: r.origin, d: r.direction, tmin: r.tmin, tmax: r.tmax };
    let mut counts = TierCounts::default();
    let truths: Vec<_> = rays.iter().map(|r| oracle.closest(&oracle_ray(r), &[], &mut counts)).collect();
    let mut rows = tracers(&mesh, &rays, &truths, session)?;
    if let Some(path) = &options.peer {
        let hits = records::<Hit>(path)?;
        if hits.len() != rays.len() {
            let what = format!("{} hits for {} rays", hits.len(), rays.len());
            return Err(Error::Input { file: path.clone(), what });
        }
        rows.push(row("peer", &truths, &hits, options.peer_mrays));
    }
    show(&rows, options)?;
    let triangles = mesh.faces.len() as u64;
    options.stats.write(&Report { schema: crate::cli::stats::SCHEMA, triangles, tracers: &rows })?;
    match &options.output {
        Some(path) => write_whole(path, plot::svg(&rows).as_bytes()),
        None => Ok(()),
    }
}

/// Our own tracers and the naive ones.
fn tracers(mesh: &Mesh, rays: &[Ray], truths: &[Option<Answer>], session: &Session<'_>) -> Result<Vec<Row>> {
    session.monitor().phase("trace");
    let file = octree(mesh, &BuildOptions::default())?;
    let mut rows = Vec::new();
    for isa in Isa::available() {
        let tracer = OctreeTracer::new(Arc::clone(&file)).with_isa(isa);
        let found = |r: &Ray| Ok(tracer.closest(r, Skip::NONE)?.map_or(Hit::MISS, |f| f.hit));
        rows.push(timed(&format!("octrace, exact, {}", isa.name()), rays, truths, found)?);
    }
    let corners: Vec<_> = mesh.triangles().collect();
    let few = rays.len().min(FEW);
    let all = |r: &Ray| Ok(plain(yardstick::closest_of_all(&corners, r.origin, r.direction, r.tmin, r.tmax)));
    rows.push(timed("f32, every triangle", &rays[..few], &truths[..few], all)?);
    let tree = PlainOctree::new(corners.clone());
    let walk = |r: &Ray| Ok(plain(tree.closest(r.origin, r.direction, r.tmin, r.tmax)));
    rows.push(timed("f32, plain octree", rays, truths, walk)?);
    Ok(rows)
}

fn plain(hit: Option<yardstick::PlainHit>) -> Hit {
    hit.map_or(Hit::MISS, |h| Hit { t: h.t, face: FaceId(h.face), u: h.u, v: h.v })
}

/// Traces all rays twice, and takes the time of the second pass.
fn timed(name: &str, rays: &[Ray], truths: &[Option<Answer>], found: impl Fn(&Ray) -> Result<Hit>) -> Result<Row> {
    let trace = || rays.iter().map(&found).collect::<Result<Vec<Hit>>>();
    trace()?;
    let started = Instant::now();
    let hits = trace()?;
    let speed = rays.len() as f64 / 1e6 / started.elapsed().as_secs_f64().max(1e-9);
    Ok(row(name, truths, &hits, Some(speed)))
}

/// Counts the errors of one tracer.
fn row(name: &str, truths: &[Option<Answer>], hits: &[Hit], mrays_per_second: Option<f64>) -> Row {
    let mut row = Row {
        tracer: name.to_owned(),
        rays: hits.len() as u64,
        missed: 0,
        false_hits: 0,
        wrong_triangle: 0,
        wrong_t: 0,
        error_rate: 0.0,
        mrays_per_second,
    };
    for (truth, hit) in truths.iter().zip(hits) {
        match (truth, hit.face != FaceId::NONE) {
            (None, false) => {}
            (None, true) => row.false_hits += 1,
            (Some(_), false) => row.missed += 1,
            (Some(t), true) if t.face != hit.face.0 => row.wrong_triangle += 1,
            (Some(t), true) => row.wrong_t += u64::from(ulps(t.t, hit.t) > 0),
        }
    }
    row.error_rate = (row.missed + row.false_hits + row.wrong_triangle) as f64 / row.rays.max(1) as f64;
    row
}

/// Rays from around the mesh at its vertices, edges and faces.
fn aimed(mesh: &Mesh, rays: u64, seed: u64) -> Vec<Ray> {
    let random = Random::new(seed);
    let mut maker = Maker { random, rays: 0, size: mesh.faces.len(), round: 0, model: Some(mesh), ball: None, turn: 0 };
    (0..rays)
        .map(|_| {
            let o = maker.origin(mesh);
            Ray::new(o, toward(o, maker.target(mesh)))
        })
        .collect()
}

/// A file of fixed records.
fn records<T: bytemuck::Pod>(path: &Path) -> Result<Vec<T>> {
    let bytes = std::fs::read(path).map_err(Error::io(path, "open"))?;
    if bytes.len() % size_of::<T>() != 0 {
        let what = format!("{} bytes are no whole number of records of {}", bytes.len(), size_of::<T>());
        return Err(Error::Input { file: path.to_owned(), what });
    }
    let mut list = vec![T::zeroed(); bytes.len() / size_of::<T>()];
    bytemuck::cast_slice_mut(&mut list).copy_from_slice(&bytes);
    Ok(list)
}

fn show(rows: &[Row], options: &Options) -> Result<()> {
    if options.stats.stats.as_deref().is_some_and(crate::cli::args::is_stdio) {
        return Ok(());
    }
    let mut text = format!(
        "{:26} {:>9} {:>8} {:>8} {:>8} {:>8} {:>10} {:>8}\n",
        "tracer", "rays", "missed", "false", "triangle", "t", "error rate", "Mrays/s"
    );
    for r in rows {
        let speed = r.mrays_per_second.map_or("-".to_owned(), |x| format!("{x:.3}"));
        let rate =
            if r.error_rate == 0.0 { format!("<{:.1e}", 3.0 / r.rays as f64) } else { format!("{:.1e}", r.error_rate) };
        text += &format!(
            "{:26} {:9} {:8} {:8} {:8} {:8} {rate:>10} {speed:>8}\n",
            r.tracer, r.rays, r.missed, r.false_hits, r.wrong_triangle, r.wrong_t
        );
    }
    print(&text)
}

impl Row {
    /// Name, speed if known, error rate or the bound on it.
    fn point(&self) -> Option<(&str, f64, f64)> {
        let error = if self.error_rate == 0.0 { 3.0 / self.rays.max(1) as f64 } else { self.error_rate };
        Some((&self.tracer, self.mrays_per_second?, error))
    }

    /// Whether nothing was found wrong.
    fn is_clean(&self) -> bool {
        self.error_rate == 0.0
    }
}
