//! `octbench accuracy`: every family of hard cases against the exact oracle.
//!
//! Each family makes rounds of cases: a mesh, aimed rays, and a way to build the octree file (leaf size, split mode and so
//! on vary from round to round). Every answer of the tracer (closest hit, any hit, all hits in order) is held to the oracle,
//! which tests every triangle.

use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use rayon::prelude::*;
use serde::Serialize;

use octrace::build::{BuildOptions, build};
use octrace::event::Monitor;
use octrace::format::SplitMode;
use octrace::geometry::{FaceId, Ray, Skip};
use octrace::map::Octree;
use octrace::mesh::{FaceBatch, MeshSink, SourceInfo, TriangleSource};
use octrace::trace::{OctreeTracer, Tracer, all_hits};

use crate::families::mesh::Mesh;
use crate::families::{self, Ask, Case, Family, Layout, Maker, Probe};
use crate::oracle::{Answer, Oracle, OracleRay, TierCounts};
use crate::random::Random;

/// Triangles wanted in the rounds of a family, in turn: two in ten are of 10^4 and more.
const SIZES: [usize; 10] = [12, 60, 12_000, 300, 12, 1000, 60, 12_000, 3000, 300];

/// Bins of the error of t in units in the last place: exact, rounded correctly, 1, 2-3, 4-15, 16 and more.
pub const ULP_BINS: [&str; 6] = ["0", "half", "1", "2-3", "4-15", "16+"];

/// What a family showed.
#[derive(Clone, Debug, Default, Serialize)]
pub struct FamilyReport {
    /// Number in the list of hard cases.
    pub number: u32,
    /// Its name.
    pub name: String,
    /// Rays traced.
    pub rays: u64,
    /// Rays on meshes of at least 10^4 triangles.
    pub rays_on_large: u64,
    /// Rays that hit something by the oracle.
    pub hits: u64,
    /// Hits the tracer did not report.
    pub missed: u64,
    /// Hits that are none.
    #[serde(rename = "false")]
    pub false_hits: u64,
    /// Another triangle than the oracle's.
    pub wrong_triangle: u64,
    /// Triangles reported more than once by the iterator, or hits out of order or lost there.
    pub doubled: u64,
    /// Unbounded rays from outside that cross a closed mesh an odd number of times.
    pub odd_crossings: u64,
    /// Any-hit answers that differ from the oracle.
    pub wrong_any: u64,
    /// u or v more than one unit in the last place off.
    pub wrong_uv: u64,
    /// Errors of t, in the bins of [`ULP_BINS`].
    pub ulp_histogram: [u64; 6],
    /// Largest error of t in units in the last place.
    pub largest_ulp: u64,
    /// Triangles for which the oracle needed expansions, a ray.
    pub oracle_exact_per_ray: f64,
    /// Millions of rays traced a second (closest hit; on one thread, with the other at work as well).
    pub mrays_per_second: f64,
    /// With no disagreement: the rate of errors is below this with 95 % confidence (3 / N).
    pub bound_95: Option<f64>,
    /// The first few disagreements, as bit patterns that can be replayed.
    pub examples: Vec<String>,
    #[serde(skip)]
    seconds: f64,
    #[serde(skip)]
    oracle_exact: u64,
}

impl FamilyReport {
    /// All that disagrees with the oracle.
    pub fn disagreements(&self) -> u64 {
        let wrong_t: u64 = self.ulp_histogram[2..].iter().sum();
        self.missed
            + self.false_hits
            + self.wrong_triangle
            + self.doubled
            + self.odd_crossings
            + self.wrong_any
            + self.wrong_uv
            + wrong_t
    }

    fn merge(mut self, other: FamilyReport) -> FamilyReport {
        self.rays += other.rays;
        self.rays_on_large += other.rays_on_large;
        self.hits += other.hits;
        self.missed += other.missed;
        self.false_hits += other.false_hits;
        self.wrong_triangle += other.wrong_triangle;
        self.doubled += other.doubled;
        self.odd_crossings += other.odd_crossings;
        self.wrong_any += other.wrong_any;
        self.wrong_uv += other.wrong_uv;
        for (a, b) in self.ulp_histogram.iter_mut().zip(other.ulp_histogram) {
            *a += b;
        }
        self.largest_ulp = self.largest_ulp.max(other.largest_ulp);
        self.seconds += other.seconds;
        self.oracle_exact += other.oracle_exact;
        self.examples.extend(other.examples);
        self.examples.truncate(8);
        self
    }

    fn finish(mut self, family: &Family) -> FamilyReport {
        self.number = family.number;
        self.name = family.name.to_owned();
        self.mrays_per_second = self.rays as f64 / 1e6 / self.seconds.max(1e-9);
        self.oracle_exact_per_ray = self.oracle_exact as f64 / self.rays.max(1) as f64;
        self.bound_95 = (self.disagreements() == 0 && self.rays > 0).then(|| 3.0 / self.rays as f64);
        self
    }
}

/// What to run.
pub struct Plan {
    /// Rays in all, spread evenly over the families.
    pub rays: u64,
    /// Only these families, by number; empty = all.
    pub families: Vec<u32>,
    /// Seed of everything.
    pub seed: u64,
}

/// Runs the plan; `tell` is called with each family's report as it is done.
pub fn run(plan: &Plan, tell: impl Fn(&FamilyReport)) -> octrace::Result<Vec<FamilyReport>> {
    let chosen: Vec<Family> = families::all()
        .into_iter()
        .filter(|f| plan.families.is_empty() || plan.families.contains(&f.number))
        .collect();
    let each = plan.rays.div_ceil(chosen.len().max(1) as u64);
    let mut reports = Vec::new();
    for family in &chosen {
        let report = run_family(family, each, plan.seed)?;
        tell(&report);
        reports.push(report);
    }
    Ok(reports)
}

/// One family: rounds in parallel, each with its own mesh and file.
fn run_family(family: &Family, rays: u64, seed: u64) -> octrace::Result<FamilyReport> {
    let rounds = (rays / 10_000).clamp(SIZES.len() as u64, 5000);
    let per_round = rays.div_ceil(rounds) as usize;
    let folder = tempfile::tempdir().map_err(octrace::Error::io(std::env::temp_dir(), "create"))?;
    let report = (0..rounds as usize)
        .into_par_iter()
        .map(|round| {
            let mut maker = Maker {
                random: Random::new(seed ^ u64::from(family.number) << 32 ^ round as u64),
                rays: per_round,
                size: SIZES[round % SIZES.len()],
                round: round / 2,
            };
            let case = (family.make)(&mut maker);
            run_case(&case, round, &folder.path().join(format!("{round}.oct")))
        })
        .try_reduce(FamilyReport::default, |a, b| Ok(a.merge(b)))?;
    Ok(report.finish(family))
}

/// How round number `round` builds its file.
fn build_options(round: usize, layout: Layout, triangles: usize) -> BuildOptions {
    let mut options = BuildOptions::default();
    options.split = [SplitMode::Sah, SplitMode::Octree, SplitMode::Strict][round % 3];
    options.leaf = [16, 1, 2, 8, 16, 3][round / 3 % 6];
    options.cell = [16, 1, 2, 8, 64, u32::MAX][round / 2 % 6];
    options.depth = [21, 21, 5, 1, 0, 12][round / 5 % 6];
    options.brick = layout.brick.or([None, Some(64), None, Some(1000)][round % 4]);
    if options.split == SplitMode::Strict && triangles > 2000 {
        options.cell = options.cell.max(16);
        options.depth = options.depth.min(9);
    }
    options
}

/// A mesh in memory as a source of triangles.
struct MemorySource<'a>(&'a Mesh);

impl TriangleSource for MemorySource<'_> {
    fn read(&mut self, sink: &mut dyn MeshSink, _: Monitor<'_>) -> octrace::Result<SourceInfo> {
        sink.positions(&self.0.points)?;
        let corners = self.0.faces.iter().flatten().copied().collect();
        sink.faces(&FaceBatch { corners, ..FaceBatch::default() })?;
        Ok(SourceInfo::default())
    }

    fn size_hint(&self) -> Option<u64> {
        None
    }
}

/// Builds a case's file, traces its rays, and compares.
fn run_case(case: &Case, round: usize, path: &Path) -> octrace::Result<FamilyReport> {
    let oracle = Oracle::new(case.mesh.triangles().enumerate().map(|(i, c)| (i as u32, c)));
    let options = build_options(round, case.layout, case.mesh.faces.len());
    build(&mut MemorySource(&case.mesh), path, &options, Monitor::silent())?;
    let octree = Arc::new(Octree::open(path)?);
    let tracer = OctreeTracer::new(octree);
    let started = Instant::now();
    let found: Vec<_> =
        case.probes.iter().map(|p| tracer.closest(&library_ray(&p.ray), skip(p))).collect::<octrace::Result<_>>()?;
    let mut report = FamilyReport { seconds: started.elapsed().as_secs_f64(), ..FamilyReport::default() };
    let mut counts = TierCounts::default();
    for (probe, found) in case.probes.iter().zip(found) {
        let truth = oracle.all(&probe.ray, &probe.skip, &mut counts);
        report.rays += 1;
        report.rays_on_large += u64::from(case.mesh.faces.len() >= 10_000);
        report.hits += u64::from(!truth.is_empty());
        let before = report.disagreements();
        compare_closest(&mut report, truth.first(), found.map(|f| f.hit));
        let any = tracer.any(&library_ray(&probe.ray), skip(probe))?;
        report.wrong_any += u64::from(any == truth.is_empty());
        if probe.ask == Ask::All {
            compare_all(&mut report, case, probe, &truth, &tracer)?;
        }
        if report.disagreements() > before && report.examples.len() < 8 {
            report.examples.push(example(case, probe, &options));
        }
    }
    report.oracle_exact = counts.expansion;
    drop(tracer);
    std::fs::remove_file(path).map_err(octrace::Error::io(path, "remove"))?;
    Ok(report)
}

fn library_ray(ray: &OracleRay) -> Ray {
    Ray { origin: ray.o, direction: ray.d, tmin: ray.tmin, tmax: ray.tmax }
}

fn skip(probe: &Probe) -> Skip {
    Skip(probe.skip.map(FaceId))
}

fn compare_closest(report: &mut FamilyReport, truth: Option<&Answer>, found: Option<octrace::geometry::Hit>) {
    match (truth, found) {
        (None, None) => {}
        (Some(_), None) => report.missed += 1,
        (None, Some(_)) => report.false_hits += 1,
        (Some(truth), Some(found)) => {
            if truth.face != found.face.0 {
                report.wrong_triangle += 1;
                return;
            }
            let ulps = ulps(truth.t, found.t);
            let bin = match ulps {
                0 if truth.t_exact => 0,
                0 => 1,
                1 => 2,
                2..=3 => 3,
                4..=15 => 4,
                _ => 5,
            };
            report.ulp_histogram[bin] += 1;
            report.largest_ulp = report.largest_ulp.max(ulps);
            let off = |exact: f64, got: f32| ulps_f64(exact, got) > 1.0;
            report.wrong_uv += u64::from(off(truth.u, found.u) || off(truth.v, found.v));
        }
    }
}

/// Distance of two f32 in steps.
fn ulps(a: f32, b: f32) -> u64 {
    let ordered = |x: f32| {
        let bits = i64::from(x.to_bits() as i32);
        if bits < 0 { i64::from(i32::MIN) - bits } else { bits }
    };
    ordered(a).abs_diff(ordered(b))
}

/// Distance of an f32 from an exact value in units in the last place of the f32.
fn ulps_f64(exact: f64, got: f32) -> f64 {
    let step = f64::from(got.abs().next_up()) - f64::from(got.abs());
    (exact - f64::from(got)).abs() / step
}

/// The iterator over all hits: the oracle's list, in its order, each once; even in number from outside a closed mesh.
fn compare_all(
    report: &mut FamilyReport,
    case: &Case,
    probe: &Probe,
    truth: &[Answer],
    tracer: &dyn Tracer,
) -> octrace::Result<()> {
    let ray = library_ray(&probe.ray);
    let mut found = Vec::new();
    for hit in all_hits(tracer, &ray, skip(probe)) {
        found.push(hit?.hit.face.0);
        if found.len() > truth.len() {
            break;
        }
    }
    report.doubled += u64::from(!found.iter().eq(truth.iter().map(|a| &a.face)));
    let unbounded = probe.ray.tmin <= 0.0 && probe.ray.tmax == f32::INFINITY && probe.skip == [u32::MAX; 2];
    report.odd_crossings += u64::from(case.closed && unbounded && found.len() % 2 == 1);
    Ok(())
}

/// A disagreement as bit patterns: the ray, and how the file was built; the mesh follows from family, round and seed.
fn example(case: &Case, probe: &Probe, options: &BuildOptions) -> String {
    let bits = |p: &[f32]| p.iter().map(|x| format!("{:08x}", x.to_bits())).collect::<Vec<_>>().join(" ");
    let r = &probe.ray;
    format!(
        "o {} d {} t {} skip {:?} on {} triangles, {:?} leaf {} cell {} depth {} brick {:?}",
        bits(&r.o),
        bits(&r.d),
        bits(&[r.tmin, r.tmax]),
        probe.skip,
        case.mesh.faces.len(),
        options.split,
        options.leaf,
        options.cell,
        options.depth,
        options.brick
    )
}
