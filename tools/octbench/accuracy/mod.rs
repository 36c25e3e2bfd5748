//! `octbench accuracy`: every family of hard cases against the exact oracle.
//!
//! Each family makes rounds of cases: a mesh, aimed rays, and a way to build the octree file (leaf size, split mode and so
//! on vary from round to round). Every answer of the tracer (closest hit, any hit, all hits in order), in every mode, is held
//! to the oracle, which knows nothing of trees. A large run adds rays on one mesh of 10^6 triangles.
//!
//! The rounds of all families make one list, first rounds first, from which the threads help themselves: so no thread waits for a
//! slow family, and a run that is broken off has seen a like part of each.

pub mod closed;
pub mod judge;
pub mod replay;
pub mod report;
mod rounds;

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use octrace::build::{BuildOptions, Positions};
use octrace::event::Monitor;
use octrace::{Error, Result};

use crate::families::mesh::Mesh;
use crate::families::{self, Case, Family, Maker, Probe};
use crate::planet;
use crate::random::Random;
use judge::Bench;
use report::FamilyReport;
use rounds::{Round, Rounds};

/// From this many rays on, one in a thousand more is traced on a mesh of 10^6 triangles.
const DEEP: u64 = 10_000_000;

/// Triangles of that mesh, at least.
const MILLION: u64 = 1_000_000;

/// Rays of a task on a mesh that is given, at most.
const PER_TASK: usize = 500;

/// Time between two looks at what has been found so far.
const SNAPSHOT: Duration = Duration::from_secs(60);

/// What to run.
pub struct Plan {
    /// Rays in all, at least, spread over the families.
    pub rays: u64,
    /// Only these families, by number; empty = all.
    pub families: Vec<u32>,
    /// Seed of everything.
    pub seed: u64,
    /// Where cases that disagree are kept as text.
    pub keep: Option<PathBuf>,
}

/// What a run found.
pub struct Outcome {
    /// Each family.
    pub families: Vec<FamilyReport>,
    /// Whether all rays of the plan were traced; false after Ctrl-C.
    pub complete: bool,
}

/// What a long run has found so far is shown to this.
pub type Snapshot<'a> = &'a (dyn Fn(&[FamilyReport]) -> Result<()> + Sync);

/// Work that one thread does at a time.
enum Task {
    /// A round of the family with this place in the list.
    Round(usize, Round),
    /// Some rays of that family on the given mesh.
    Given(usize, Arc<Bench>, Vec<Probe>),
}

/// The families of a plan.
fn chosen(plan: &Plan, among: impl Fn(&Family) -> bool) -> Result<Vec<Family>> {
    let all = families::all();
    if let Some(wrong) = plan.families.iter().find(|n| !all.iter().any(|f| f.number == **n)) {
        return Err(Error::Option(format!("there is no family {wrong}; they go from 1 to {}", all.len())));
    }
    let wanted = |f: &Family| (plan.families.is_empty() || plan.families.contains(&f.number)) && among(f);
    Ok(all.into_iter().filter(wanted).collect())
}

/// Runs the plan on the families' own meshes.
pub fn run(plan: &Plan, monitor: Monitor<'_>, snapshot: Snapshot<'_>) -> Result<Outcome> {
    let families = chosen(plan, |_| true)?;
    let mut tasks = Vec::new();
    if plan.rays >= DEEP && plan.families.is_empty() {
        let mesh = planet::mesh(MILLION, plan.seed);
        tasks = given(plan.rays / 1000, plan.seed, &mesh, &families, monitor)?;
    }
    let rounds: Vec<Rounds> = families.iter().map(|f| Rounds::new(f, &families, plan.rays)).collect();
    let most = rounds.iter().map(|r| r.count()).max().unwrap_or(0);
    for i in 0..most {
        tasks.extend(rounds.iter().enumerate().filter_map(|(place, r)| Some(Task::Round(place, r.get(i)?))));
    }
    work(plan, &families, &tasks, monitor, snapshot)
}

/// Runs the families that aim at any mesh on a given one.
pub fn run_model(plan: &Plan, mesh: &Mesh, monitor: Monitor<'_>, snapshot: Snapshot<'_>) -> Result<Outcome> {
    let families = chosen(plan, |f| families::ON_ANY_MESH.contains(&f.number))?;
    let tasks = given(plan.rays, plan.seed, mesh, &families, monitor)?;
    work(plan, &families, &tasks, monitor, snapshot)
}

/// How a mesh's file is built that must stay as it is: where vertices lie on a grid they take 16 bits.
fn lossless() -> BuildOptions {
    BuildOptions { positions: Positions::LOSSLESS, ..BuildOptions::default() }
}

/// Aims those of the families that can at a mesh, and builds its file.
fn given(rays: u64, seed: u64, mesh: &Mesh, families: &[Family], monitor: Monitor<'_>) -> Result<Vec<Task>> {
    monitor.phase("build");
    let bench = Arc::new(Bench::new(mesh, &[lossless()])?);
    let aiming: Vec<usize> =
        (0..families.len()).filter(|&i| families::ON_ANY_MESH.contains(&families[i].number)).collect();
    let each = rays.div_ceil(aiming.len().max(1) as u64);
    let mut tasks = Vec::new();
    for place in aiming {
        let family = &families[place];
        let random = Random::new(seed ^ u64::from(family.number) << 32 ^ 1 << 60);
        let case = (family.make)(&mut Maker::on(mesh, random, each as usize));
        tasks
            .extend(case.probes.chunks(PER_TASK).map(|probes| Task::Given(place, Arc::clone(&bench), probes.to_vec())));
    }
    Ok(tasks)
}

impl Task {
    fn family(&self) -> usize {
        match self {
            Task::Round(family, _) | Task::Given(family, ..) => *family,
        }
    }

    fn rays(&self) -> u64 {
        match self {
            Task::Round(_, round) => round.rays as u64,
            Task::Given(_, _, probes) => probes.len() as u64,
        }
    }
}

/// Does the tasks, on all threads, and sums up by family.
fn work(
    plan: &Plan,
    families: &[Family],
    tasks: &[Task],
    monitor: Monitor<'_>,
    snapshot: Snapshot<'_>,
) -> Result<Outcome> {
    let total: u64 = tasks.iter().map(Task::rays).sum();
    let named = |f: &Family| FamilyReport { number: f.number, name: f.name.to_owned(), ..FamilyReport::default() };
    let sums = Mutex::new((families.iter().map(named).collect::<Vec<_>>(), 0u64, Instant::now()));
    let next = AtomicUsize::new(0);
    monitor.phase("accuracy");
    let help = || -> Result<()> {
        while let Some(task) = tasks.get(next.fetch_add(1, Ordering::Relaxed)) {
            monitor.check()?;
            let report = match task {
                Task::Round(place, round) => run_round(plan, &families[*place], round, monitor)?,
                Task::Given(_, bench, probes) => bench.judge(probes, false)?,
            };
            let mut sums = sums.lock().unwrap_or_else(|e| e.into_inner());
            let (reports, done, shown) = &mut *sums;
            *done += report.rays;
            reports[task.family()].merge(&report);
            monitor.progress(*done, Some(total), "rays");
            if shown.elapsed() >= SNAPSHOT {
                *shown = Instant::now();
                snapshot(reports)?;
            }
        }
        Ok(())
    };
    let helped = rayon::broadcast(|_| help().inspect_err(|_| next.store(tasks.len(), Ordering::Relaxed)));
    let mut complete = true;
    for result in helped {
        match result {
            Err(Error::Interrupted) => complete = false,
            other => other?,
        }
    }
    let (reports, ..) = sums.into_inner().unwrap_or_else(|e| e.into_inner());
    Ok(Outcome { families: reports, complete })
}

/// One round of a family: its mesh, its file or files, its rays.
fn run_round(plan: &Plan, family: &Family, round: &Round, monitor: Monitor<'_>) -> Result<FamilyReport> {
    let started = Instant::now();
    let random = Random::new(plan.seed ^ u64::from(family.number) << 32 ^ round.number as u64);
    let mut maker = Maker { round: round.number / 2, ..Maker::new(random, round.rays, round.size) };
    let case = (family.make)(&mut maker);
    let options = rounds::build_options(round.number, &case.layout, case.mesh.faces.len());
    let made = started.elapsed().as_secs_f64();
    let mut report = judge::run_case(&case, &options, monitor)?;
    report.times.make = made;
    keep(plan, family, round.number, &case, &options, &report)?;
    Ok(report)
}

/// Keeps a case that disagrees: the rays that do, and as few triangles as show it.
fn keep(
    plan: &Plan,
    family: &Family,
    round: usize,
    case: &Case,
    options: &[BuildOptions],
    report: &FamilyReport,
) -> Result<()> {
    let Some(folder) = plan.keep.as_deref().filter(|_| report.disagreements() > 0) else { return Ok(()) };
    let title = format!("family {} ({}), round {round}, seed {}", family.number, family.name, plan.seed);
    let path: &Path = &folder.join(format!("family_{}_round_{round}_seed_{}.txt", family.number, plan.seed));
    let text = replay::to_text(&title, &replay::reduced(case, options)?, options);
    std::fs::write(path, text).map_err(Error::io(path, "write"))
}
