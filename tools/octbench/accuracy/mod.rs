//! `octbench accuracy`: every family of hard cases against the exact oracle.
//!
//! Each family makes rounds of cases: a mesh, aimed rays, and a way to build the octree file (leaf size, split mode and so
//! on vary from round to round). Every answer of the tracer (closest hit, any hit, all hits in order), in every mode, is held
//! to the oracle, which knows nothing of trees. A large run adds rays on one mesh of 10^6 triangles.

pub mod closed;
pub mod judge;
pub mod replay;
pub mod report;

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

use octrace::build::BuildOptions;
use octrace::event::Monitor;
use octrace::format::SplitMode;
use octrace::{Error, Result};
use rayon::prelude::*;

use crate::families::mesh::Mesh;
use crate::families::{self, Case, Family, Layout, Maker};
use crate::planet;
use crate::random::Random;
use judge::Bench;
use report::FamilyReport;

/// Triangles wanted in the rounds of a family, in turn: two in ten are of 10^4 and more.
const SIZES: [usize; 10] = [12, 60, 12_000, 300, 12, 1000, 60, 12_000, 3000, 300];

/// Rays of a round, at most; and rounds of a family, at least.
const PER_ROUND: u64 = 10_000;

/// From this many rays on, one in a thousand more is traced on a mesh of 10^6 triangles.
const DEEP: u64 = 10_000_000;

/// What to run.
pub struct Plan {
    /// Rays in all, spread evenly over the families.
    pub rays: u64,
    /// Only these families, by number; empty = all.
    pub families: Vec<u32>,
    /// Seed of everything.
    pub seed: u64,
    /// Where cases that disagree are kept as text.
    pub keep: Option<PathBuf>,
}

/// How far a run has come.
struct Progress<'a> {
    monitor: Monitor<'a>,
    done: AtomicU64,
    total: u64,
}

impl Progress<'_> {
    fn add(&self, rays: u64) -> Result<()> {
        let done = self.done.fetch_add(rays, Ordering::Relaxed) + rays;
        self.monitor.progress(done.min(self.total), Some(self.total), "rays");
        self.monitor.check()
    }
}

/// The families of a plan.
fn chosen(plan: &Plan, among: impl Fn(&Family) -> bool) -> Result<Vec<Family>> {
    let all = families::all();
    if let Some(wrong) = plan.families.iter().find(|n| !all.iter().any(|f| f.number == **n)) {
        return Err(Error::Option(format!("there is no family {wrong}; they go from 1 to 53")));
    }
    let wanted = |f: &Family| (plan.families.is_empty() || plan.families.contains(&f.number)) && among(f);
    Ok(all.into_iter().filter(wanted).collect())
}

/// Runs the plan on the families' own meshes; `tell` is called with each family's report as it is done.
pub fn run(plan: &Plan, monitor: Monitor<'_>, mut tell: impl FnMut(&FamilyReport)) -> Result<Vec<FamilyReport>> {
    let families = chosen(plan, |_| true)?;
    let each = plan.rays.div_ceil(families.len() as u64);
    let progress = Progress { monitor, done: AtomicU64::new(0), total: each * families.len() as u64 };
    monitor.phase("accuracy");
    let mut reports = Vec::new();
    for family in &families {
        let report = run_family(family, each, plan, &progress)?;
        tell(&report);
        reports.push(report);
    }
    if plan.rays >= DEEP && plan.families.is_empty() {
        let mesh = planet::mesh(1_000_000, plan.seed);
        let more = Plan { rays: plan.rays / 1000, families: vec![], seed: plan.seed, keep: plan.keep.clone() };
        let report = run_model(&more, &mesh, monitor, |_| {})?
            .into_iter()
            .fold(FamilyReport::default(), FamilyReport::merge)
            .finish(54, "families aimed at a mesh of 10^6 triangles");
        tell(&report);
        reports.push(report);
    }
    Ok(reports)
}

/// One family: rounds in parallel, each with its own mesh and file.
fn run_family(family: &Family, rays: u64, plan: &Plan, progress: &Progress<'_>) -> Result<FamilyReport> {
    let rounds = rays.div_ceil(PER_ROUND).max(SIZES.len() as u64);
    let per_round = rays.div_ceil(rounds) as usize;
    let report = (0..rounds as usize)
        .into_par_iter()
        .map(|round| {
            let mut maker = Maker {
                random: Random::new(plan.seed ^ u64::from(family.number) << 32 ^ round as u64),
                rays: per_round,
                size: SIZES[round % SIZES.len()],
                round: round / 2,
                model: None,
            };
            let case = (family.make)(&mut maker);
            let options = build_options(round, case.layout, case.mesh.faces.len());
            let report = judge::run_case(&case, &options)?;
            keep(plan, family, round, &case, &options, &report)?;
            progress.add(report.rays)?;
            Ok(report)
        })
        .try_reduce(FamilyReport::default, |a, b| Ok(a.merge(b)))?;
    Ok(report.finish(family.number, family.name))
}

/// Runs the families that aim at any mesh on a given one.
pub fn run_model(
    plan: &Plan,
    mesh: &Mesh,
    monitor: Monitor<'_>,
    mut tell: impl FnMut(&FamilyReport),
) -> Result<Vec<FamilyReport>> {
    let families = chosen(plan, |f| families::ON_ANY_MESH.contains(&f.number))?;
    let each = plan.rays.div_ceil(families.len().max(1) as u64);
    let progress = Progress { monitor, done: AtomicU64::new(0), total: each * families.len() as u64 };
    monitor.phase("build");
    let bench = Bench::new(mesh, &BuildOptions::default())?;
    monitor.phase("accuracy");
    let mut reports = Vec::new();
    for family in &families {
        let case = (family.make)(&mut Maker {
            random: Random::new(plan.seed ^ u64::from(family.number) << 32),
            rays: each as usize,
            size: mesh.faces.len(),
            round: 0,
            model: Some(mesh),
        });
        let report = case
            .probes
            .par_chunks(1000)
            .map(|probes| {
                let report = bench.judge(probes, false)?;
                progress.add(report.rays)?;
                Ok(report)
            })
            .try_reduce(FamilyReport::default, |a, b| Ok(a.merge(b)))?
            .finish(family.number, family.name);
        tell(&report);
        reports.push(report);
    }
    Ok(reports)
}

/// Keeps a case that disagrees: the rays that do, and as few triangles as show it.
fn keep(
    plan: &Plan,
    family: &Family,
    round: usize,
    case: &Case,
    options: &BuildOptions,
    report: &FamilyReport,
) -> Result<()> {
    let Some(folder) = plan.keep.as_deref().filter(|_| report.disagreements() > 0) else { return Ok(()) };
    let title = format!("family {} ({}), round {round}, seed {}", family.number, family.name, plan.seed);
    let path: &Path = &folder.join(format!("family_{}_round_{round}_seed_{}.txt", family.number, plan.seed));
    let text = replay::to_text(&title, &replay::reduced(case, options)?, options);
    std::fs::write(path, text).map_err(Error::io(path, "write"))
}

/// How round number `round` builds its file.
fn build_options(round: usize, layout: Layout, triangles: usize) -> BuildOptions {
    let mut options = BuildOptions {
        split: [SplitMode::Sah, SplitMode::Octree, SplitMode::Strict][round % 3],
        leaf: [16, 1, 2, 8, 16, 3][round / 3 % 6],
        cell: [16, 1, 2, 8, 64, u32::MAX][round / 2 % 6],
        depth: [21, 21, 5, 1, 0, 12][round / 5 % 6],
        brick: layout.brick.or([None, Some(64), None, Some(1000)][round % 4]),
        ..BuildOptions::default()
    };
    if options.split == SplitMode::Strict && triangles > 2000 {
        options.cell = options.cell.max(16);
        options.depth = options.depth.min(9);
    }
    options
}
