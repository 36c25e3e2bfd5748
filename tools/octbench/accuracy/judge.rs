//! One case: the octree file of its mesh, the oracle's word on each ray, and the tracer's in every mode.

use std::sync::Arc;
use std::time::Instant;

use octrace::Result;
use octrace::build::BuildOptions;
use octrace::event::Monitor;
use octrace::geometry::{Aabb, Hit, Ray, Skip};
use octrace::map::Octree;
use octrace::trace::{Counters, Found, Isa, LinearTracer, OctreeTracer, Order, Tracer, all_hits};

use super::report::{FamilyReport, ModeReport, Tally};
use crate::bench::{library_ray, octree, skip};
use crate::families::mesh::Mesh;
use crate::families::{Ask, Case, Probe};
use crate::oracle::{Answer, Oracle, TierCounts};

/// Meshes up to this size are traced by the linear tracer too.
const LINEAR: usize = 100;

/// Meshes from this size on count as large.
const LARGE: usize = 10_000;

/// And from this size on as very large.
const MILLION: usize = 1_000_000;

/// Rays that the oracle takes together through a mesh.
const TOGETHER: usize = 100;

/// Rays between two looks at whether the user wants to stop.
const PORTION: usize = 2000;

/// So few probes are all asked in every mode.
const HANDFUL: usize = 100;

/// Disagreements described, at most.
const EXAMPLES: usize = 8;

/// A mesh with everything that answers rays on it.
pub struct Bench {
    oracle: Oracle,
    files: Vec<File>,
    triangles: usize,
    /// Time to build the files.
    seconds: f64,
}

/// One way to build the mesh's file, with the tracers over it.
struct File {
    options: BuildOptions,
    modes: Vec<Mode>,
}

/// A way to trace.
struct Mode {
    name: &'static str,
    tracer: Box<dyn Tracer>,
    /// Of so many probes one is asked: what is much slower than the others gets fewer.
    every: usize,
}

/// What the oracle says of a probe.
struct Truth {
    closest: Option<Answer>,
    all: Option<Vec<Answer>>,
}

impl Bench {
    /// Builds the files and all tracers over them.
    pub fn new(mesh: &Mesh, options: &[BuildOptions]) -> Result<Bench> {
        let started = Instant::now();
        let open = |options: &BuildOptions| -> Result<File> {
            let file = octree(mesh, options)?;
            let mut modes = octree_modes(&file, mesh.faces.len() + usize::from(options.leaf));
            if mesh.faces.len() <= LINEAR {
                modes.push(Mode { name: "linear", tracer: Box::new(LinearTracer::new(&file)?), every: 1 });
            }
            Ok(File { options: options.clone(), modes })
        };
        let files = options.iter().map(open).collect::<Result<_>>()?;
        let seconds = started.elapsed().as_secs_f64();
        let oracle = Oracle::new(mesh.numbered());
        Ok(Bench { oracle, files, triangles: mesh.faces.len(), seconds })
    }

    /// Traces the probes in every mode and compares. `closed`: all crossings of rays from outside must be even in number.
    pub fn judge(&self, probes: &[Probe], closed: bool) -> Result<FamilyReport> {
        let mut report = FamilyReport { rays: probes.len() as u64, ..FamilyReport::default() };
        let on = |least: usize| if self.triangles >= least { report.rays } else { 0 };
        (report.rays_on_10k, report.rays_on_1m) = (on(LARGE), on(MILLION));
        let started = Instant::now();
        let mut counts = TierCounts::default();
        let mut truths: Vec<Truth> = Vec::with_capacity(probes.len());
        for some in probes.chunks(TOGETHER) {
            let near = self.oracle.near(&some.iter().map(|p| p.ray).collect::<Vec<_>>());
            truths.extend(some.iter().zip(&near).map(|(p, near)| self.truth(p, near, &mut counts)));
        }
        report.hits = truths.iter().filter(|t| t.closest.is_some()).count() as u64;
        report.oracle = counts;
        report.times.oracle = started.elapsed().as_secs_f64();
        let started = Instant::now();
        let mut first: Option<Vec<Option<Found>>> = None;
        for file in &self.files {
            for Mode { name, tracer, every } in &file.modes {
                // Of a handful all.
                let every = if probes.len() <= HANDFUL { &1 } else { every };
                let mut mode = ModeReport { mode: name, ..ModeReport::default() };
                let found = closest(tracer.as_ref(), probes, *every, &mut mode)?;
                let tally = &mut mode.tally;
                for (&this, (k, (probe, truth))) in
                    found.iter().zip(probes.iter().zip(&truths).enumerate().step_by(*every))
                {
                    let before = tally.disagreements();
                    compare_closest(tally, truth.closest.as_ref(), this.map(|f| f.hit));
                    let same = |f: &Vec<Option<Found>>| bits(f[k]) == bits(this);
                    tally.differs += u64::from(!first.as_ref().is_none_or(same));
                    let any = tracer.any(&library_ray(&probe.ray), skip(probe.skip))?;
                    tally.wrong_any += u64::from(any != truth.closest.is_some());
                    if let Some(all) = &truth.all {
                        compare_all(tally, probe, closed, all, tracer.as_ref())?;
                    }
                    if tally.disagreements() > before && report.examples.len() < EXAMPLES {
                        report.examples.push(self.example(name, probe, &file.options));
                    }
                }
                first.get_or_insert(found);
                report.add_mode(&mode);
            }
        }
        report.times.trace = started.elapsed().as_secs_f64();
        Ok(report)
    }

    fn truth(&self, probe: &Probe, near: &[u32], counts: &mut TierCounts) -> Truth {
        match probe.ask {
            Ask::Closest => Truth { closest: self.oracle.closest_of(near, &probe.ray, &probe.skip, counts), all: None },
            Ask::All => {
                let all = self.oracle.all_of(near, &probe.ray, &probe.skip, counts);
                Truth { closest: all.first().copied(), all: Some(all) }
            }
        }
    }

    /// A disagreement in words: the ray's bits, and how the file was built.
    fn example(&self, mode: &str, probe: &Probe, o: &BuildOptions) -> String {
        format!(
            "{mode}: ray {} on {} triangles, {:?} leaf {} cell {} depth {} brick {:?}",
            super::replay::probe_line(probe),
            self.triangles,
            o.split,
            o.leaf,
            o.cell,
            o.depth,
            o.brick
        )
    }
}

/// Builds a case's files, traces its rays, and compares. [`octrace::Error::Interrupted`] soon after the user asks to stop.
pub fn run_case(case: &Case, options: &[BuildOptions], monitor: Monitor<'_>) -> Result<FamilyReport> {
    let bench = Bench::new(&case.mesh, options)?;
    let mut report = FamilyReport::default();
    report.times.build = bench.seconds;
    for probes in case.probes.chunks(PORTION) {
        monitor.check()?;
        report.merge(&bench.judge(probes, case.closed)?);
    }
    Ok(report)
}

/// A tracer for each instruction set of this processor, one that walks rays in packets, and one that keeps many under way; with which
/// sets depends on `turn`.
fn octree_modes(file: &Arc<Octree>, turn: usize) -> Vec<Mode> {
    let tracer = |isa: Isa| OctreeTracer::new(Arc::clone(file)).with_isa(isa);
    let sets = Isa::available();
    let sets_of_turn = [sets[turn % sets.len()], sets[(turn + 1) % sets.len()]];
    let mode = |isa: Isa| Mode { name: isa.name(), tracer: Box::new(tracer(isa)), every: 1 };
    let mut modes: Vec<Mode> = sets.into_iter().map(mode).collect();
    for (k, (name, order)) in [("packet", Order::Packet), ("flight", Order::Flight)].into_iter().enumerate() {
        let together = Together(tracer(sets_of_turn[k]).with_order(order));
        modes.push(Mode { name, tracer: Box::new(together), every: GROUP });
    }
    modes
}

/// Asks every ray in the midst of others that run beside it.
struct Together(OctreeTracer<Arc<Octree>>);

/// Rays asked at once.
const GROUP: usize = 8;

impl Together {
    /// The ray's companions, from the same point or close by in nearly the same direction, and its place among them.
    fn group(ray: &Ray) -> ([Ray; GROUP], usize) {
        let place = ray.direction[0].to_bits() as usize % GROUP;
        let nudged = |i: usize| {
            // From the last bit up to a thousandth.
            let step = (1u32 << (i % 14)) as f32 * f32::EPSILON * [1.0, -1.0][i % 2];
            let mut other = *ray;
            if ray.origin[1].to_bits() & 1 != 0 {
                // Around the point.
                let axis = (i + 1) % 3;
                other.origin[axis] += step * ray.origin[axis];
            }
            other.direction[i % 3] += step * ray.direction[(i + 1) % 3];
            if i == place { *ray } else { other }
        };
        (std::array::from_fn(nudged), place)
    }
}

impl Tracer for Together {
    fn closest_counted(&self, ray: &Ray, skip: Skip, counters: &mut Counters) -> Result<Option<Found>> {
        let (rays, place) = Together::group(ray);
        let mut found = [None; GROUP];
        self.0.closest_each(&rays, &[skip; GROUP], &mut found, counters)?;
        Ok(found[place])
    }

    fn any_counted(&self, ray: &Ray, skip: Skip, counters: &mut Counters) -> Result<bool> {
        let (rays, place) = Together::group(ray);
        let mut blocked = [false; GROUP];
        self.0.any_each(&rays, &[skip; GROUP], &mut blocked, counters)?;
        Ok(blocked[place])
    }

    fn next(&self, ray: &Ray, skip: Skip, last: &Found) -> Result<Option<Found>> {
        self.0.next(ray, skip, last)
    }

    fn bounds(&self) -> Aabb {
        self.0.bounds()
    }
}

/// The closest hits of one of so many probes, timed, with the tiers that each ray needed.
fn closest(tracer: &dyn Tracer, probes: &[Probe], every: usize, mode: &mut ModeReport) -> Result<Vec<Option<Found>>> {
    let mut found = Vec::with_capacity(probes.len());
    let started = Instant::now();
    for probe in probes.iter().step_by(every) {
        let mut counters = Counters::default();
        found.push(tracer.closest_counted(&library_ray(&probe.ray), skip(probe.skip), &mut counters)?);
        mode.tally.rays_f64 += u64::from(counters.doubts > 0);
        mode.tally.rays_exact += u64::from(counters.exact > 0);
    }
    mode.tally.seconds = started.elapsed().as_secs_f64();
    mode.tally.traced = found.len() as u64;
    Ok(found)
}

fn bits(found: Option<Found>) -> [u32; 4] {
    let hit = found.map_or(Hit::MISS, |f| f.hit);
    [hit.t.to_bits(), hit.face.0, hit.u.to_bits(), hit.v.to_bits()]
}

fn compare_closest(mode: &mut Tally, truth: Option<&Answer>, found: Option<Hit>) {
    match (truth, found) {
        (None, None) => {}
        (Some(_), None) => mode.missed += 1,
        (None, Some(_)) => mode.false_hits += 1,
        (Some(truth), Some(found)) if truth.face != found.face.0 => mode.wrong_triangle += 1,
        (Some(truth), Some(found)) => {
            let ulps = ulps(truth.t, found.t);
            let bin = match ulps {
                0 if truth.t_exact => 0,
                0 => 1,
                1 => 2,
                2..=3 => 3,
                4..=15 => 4,
                _ => 5,
            };
            mode.ulp_histogram[bin] += 1;
            mode.largest_ulp = mode.largest_ulp.max(ulps);
            let off = |exact: f64, got: f32| ulps_f64(exact, got) > 1.0;
            mode.wrong_uv += u64::from(off(truth.u, found.u) || off(truth.v, found.v));
        }
    }
}

/// Distance of two f32 in steps.
pub fn ulps(a: f32, b: f32) -> u64 {
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
fn compare_all(mode: &mut Tally, probe: &Probe, closed: bool, truth: &[Answer], tracer: &dyn Tracer) -> Result<()> {
    let mut found = Vec::new();
    for hit in all_hits(tracer, &library_ray(&probe.ray), skip(probe.skip)) {
        found.push(hit?.hit.face.0);
        if found.len() > truth.len() {
            break;
        }
    }
    mode.doubled += u64::from(!found.iter().eq(truth.iter().map(|a| &a.face)));
    let unbounded = probe.ray.tmin <= 0.0 && probe.ray.tmax == f32::INFINITY && probe.skip == [u32::MAX; 2];
    mode.odd_crossings += u64::from(closed && unbounded && found.len() % 2 == 1);
    Ok(())
}
