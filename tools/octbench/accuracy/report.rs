//! What was counted, per family and mode, and how it is shown.

use serde::Serialize;

use crate::oracle::TierCounts;

/// Bins of the error of t in units in the last place: exact, rounded correctly, 1, 2-3, 4-15, 16 and more.
pub const ULP_BINS: [&str; 6] = ["0", "half", "1", "2-3", "4-15", "16+"];

/// Disagreements of a family that are described, at most.
const EXAMPLES: usize = 8;

/// What tracing showed, held to the oracle.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Tally {
    /// Closest hits asked for: one a ray, mode and file.
    pub traced: u64,
    /// Hits the tracer did not report.
    pub missed: u64,
    /// Hits that are none.
    #[serde(rename = "false")]
    pub false_hits: u64,
    /// Another triangle than the oracle's.
    pub wrong_triangle: u64,
    /// Rays whose list of all hits is not the oracle's: a triangle twice, lost, or out of order.
    pub doubled: u64,
    /// Rays from outside that cross a closed mesh an odd number of times.
    pub odd_crossings: u64,
    /// Any-hit answers that differ from the oracle.
    pub wrong_any: u64,
    /// u or v more than one unit in the last place off.
    pub wrong_uv: u64,
    /// Hits whose bits are not those of the first mode and file.
    pub differs: u64,
    /// Errors of t, in the bins of [`ULP_BINS`].
    pub ulp_histogram: [u64; 6],
    /// Largest error of t in units in the last place.
    pub largest_ulp: u64,
    /// Closest hits for which the f32 filter left some triangle to f64.
    pub rays_f64: u64,
    /// Closest hits that needed exact arithmetic.
    pub rays_exact: u64,
    /// The first of the two as a share of `traced`.
    pub share_f64: f64,
    /// The second.
    pub share_exact: f64,
    /// Seconds that the closest hits took, summed over threads.
    pub seconds: f64,
    /// Closest hits a second on one thread, while the other threads work as well.
    pub rays_per_second: f64,
    /// With no disagreement: the rate of errors is below this with 95 % confidence (3 / N).
    pub bound_95: Option<f64>,
}

impl Tally {
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
            + self.differs
            + wrong_t
    }

    fn add(&mut self, other: &Tally) {
        self.traced += other.traced;
        self.missed += other.missed;
        self.false_hits += other.false_hits;
        self.wrong_triangle += other.wrong_triangle;
        self.doubled += other.doubled;
        self.odd_crossings += other.odd_crossings;
        self.wrong_any += other.wrong_any;
        self.wrong_uv += other.wrong_uv;
        self.differs += other.differs;
        self.largest_ulp = self.largest_ulp.max(other.largest_ulp);
        self.rays_f64 += other.rays_f64;
        self.rays_exact += other.rays_exact;
        self.seconds += other.seconds;
        for (a, b) in self.ulp_histogram.iter_mut().zip(other.ulp_histogram) {
            *a += b;
        }
    }

    /// Fills in what follows from the counts; `rays` are those that the bound is about.
    fn finish(&mut self, rays: u64) {
        let traced = self.traced.max(1) as f64;
        (self.share_f64, self.share_exact) = (self.rays_f64 as f64 / traced, self.rays_exact as f64 / traced);
        self.rays_per_second = self.traced as f64 / self.seconds.max(1e-9);
        self.bound_95 = (self.disagreements() == 0 && rays > 0).then(|| 3.0 / rays as f64);
    }

    /// The cells of a line of the table.
    fn cells(&self) -> String {
        let histogram = self.ulp_histogram.map(|n| format!(" {n:>10}")).concat();
        format!(
            "{:>10} {:>6} {:>6} {:>6} {:>6} {:>6}{histogram} {:>7} {:>7.3} {:>7.3} {:>8.3} {:>8}",
            self.traced,
            self.missed,
            self.false_hits,
            self.wrong_triangle,
            self.doubled + self.odd_crossings,
            self.wrong_any + self.wrong_uv + self.differs,
            self.largest_ulp,
            100.0 * self.share_f64,
            100.0 * self.share_exact,
            self.rays_per_second / 1e6,
            self.bound_95.map_or("-".to_owned(), |b| format!("{b:.1e}")),
        )
    }
}

/// What one mode (an instruction set, or no tree at all) showed.
#[derive(Clone, Debug, Default, Serialize)]
pub struct ModeReport {
    /// `scalar`, `avx2`, `avx512`; `linear` is the test of all triangles, on small meshes.
    pub mode: &'static str,
    /// What it showed.
    #[serde(flatten)]
    pub tally: Tally,
}

/// Where the time went, in seconds summed over threads.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct Times {
    /// Making meshes and rays.
    pub make: f64,
    /// Building octree files.
    pub build: f64,
    /// The oracle.
    pub oracle: f64,
    /// Tracing in all modes and comparing.
    pub trace: f64,
}

/// What a family showed.
#[derive(Clone, Debug, Default, Serialize)]
pub struct FamilyReport {
    /// Number in the list of hard cases.
    pub number: u32,
    /// Its name.
    pub name: String,
    /// Rays held to the oracle, each in every mode.
    pub rays: u64,
    /// Those of them on meshes of at least 10^4 triangles.
    pub rays_on_10k: u64,
    /// Those of them on meshes of at least 10^6 triangles.
    pub rays_on_1m: u64,
    /// Rays that hit something by the oracle.
    pub hits: u64,
    /// Triangles that the oracle decided in f64, and exactly.
    pub oracle: TierCounts,
    /// Where the time went.
    pub times: Times,
    /// Sums over the modes; its bound counts each ray once.
    #[serde(flatten)]
    pub total: Tally,
    /// Each mode.
    pub modes: Vec<ModeReport>,
    /// The first few disagreements, in words.
    pub examples: Vec<String>,
}

impl FamilyReport {
    /// All that disagrees with the oracle.
    pub fn disagreements(&self) -> u64 {
        self.modes.iter().map(|m| m.tally.disagreements()).sum()
    }

    /// Adds what a mode showed.
    pub fn add_mode(&mut self, mode: &ModeReport) {
        match self.modes.iter_mut().find(|m| m.mode == mode.mode) {
            Some(ours) => ours.tally.add(&mode.tally),
            None => self.modes.push(mode.clone()),
        }
    }

    /// Adds what other rays showed.
    pub fn merge(&mut self, other: &FamilyReport) {
        self.rays += other.rays;
        self.rays_on_10k += other.rays_on_10k;
        self.rays_on_1m += other.rays_on_1m;
        self.hits += other.hits;
        self.oracle.quick += other.oracle.quick;
        self.oracle.exact += other.oracle.exact;
        self.times.make += other.times.make;
        self.times.build += other.times.build;
        self.times.oracle += other.times.oracle;
        self.times.trace += other.times.trace;
        other.modes.iter().for_each(|mode| self.add_mode(mode));
        self.examples.extend(other.examples.iter().cloned());
        self.examples.truncate(EXAMPLES);
    }

    /// Fills in what follows from the counts.
    fn finish(&mut self) {
        self.total = Tally::default();
        for mode in &mut self.modes {
            self.total.add(&mode.tally);
            mode.tally.finish(mode.tally.traced);
        }
        self.total.finish(self.rays);
    }

    /// The lines of the table, one a mode, and the examples.
    fn lines(&self) -> String {
        let mut text = String::new();
        for (k, m) in self.modes.iter().enumerate() {
            let name = if k == 0 { format!("{:3} {}", self.number, self.name) } else { String::new() };
            text += &format!("{name:48} {:7} {}\n", m.mode, m.tally.cells());
        }
        self.examples.iter().for_each(|e| text += &format!("      {e}\n"));
        text
    }
}

/// The report of a run, and its file of statistics.
#[derive(Serialize)]
pub struct Report {
    /// Version of this form.
    schema: u32,
    /// Whether the run came to its end.
    complete: bool,
    /// Rays held to the oracle.
    pub rays: u64,
    /// All disagreements.
    pub disagreements: u64,
    /// With none: the rate of errors is below this with 95 % confidence.
    bound_95: Option<f64>,
    /// Rays on meshes of at least 10^4 triangles.
    rays_on_10k: u64,
    /// Rays on meshes of at least 10^6 triangles.
    rays_on_1m: u64,
    /// The rays of the smallest family as a share of all.
    smallest_share: f64,
    /// Wall clock.
    seconds: f64,
    /// Rays a second, the oracle, building and all modes included, on all threads.
    rays_per_second: f64,
    /// Seed of everything.
    seed: u64,
    /// Sums over the families.
    #[serde(rename = "total")]
    all: FamilyReport,
    /// Each family.
    families: Vec<FamilyReport>,
}

impl Report {
    /// Sums up the families.
    pub fn new(families: &[FamilyReport], seed: u64, seconds: f64, complete: bool) -> Report {
        let mut families = families.to_vec();
        let mut all = FamilyReport { name: "all".to_owned(), ..FamilyReport::default() };
        for family in &mut families {
            all.merge(family);
            family.finish();
        }
        all.finish();
        let rays = all.rays;
        let least = families.iter().map(|f| f.rays).min().unwrap_or(0);
        Report {
            schema: crate::cli::stats::SCHEMA,
            complete,
            rays,
            disagreements: all.disagreements(),
            bound_95: all.total.bound_95,
            rays_on_10k: all.rays_on_10k,
            rays_on_1m: all.rays_on_1m,
            smallest_share: least as f64 / rays.max(1) as f64,
            seconds,
            rays_per_second: rays as f64 / seconds.max(1e-9),
            seed,
            all,
            families,
        }
    }

    /// The table: a line a family and mode, and sums.
    pub fn table(&self) -> String {
        let bins = ULP_BINS.map(|b| format!(" {b:>10}")).concat();
        let mut text = format!(
            "{:48} {:7} {:>10} {:>6} {:>6} {:>6} {:>6} {:>6}{bins} {:>7} {:>7} {:>7} {:>8} {:>8}\n",
            "family",
            "mode",
            "rays",
            "missed",
            "false",
            "tri",
            "double",
            "other",
            "largest",
            "f64 %",
            "exact %",
            "Mrays/s",
            "<95 %"
        );
        self.families.iter().for_each(|f| text += &f.lines());
        let all = FamilyReport { examples: Vec::new(), ..self.all.clone() };
        text += &all.lines();
        text += "(double: list of all hits or parity; other: any hit, u, v, bits of the modes; 0 to 16+: errors of t in ulps)\n";
        text
    }

    /// A few lines that sum up the run.
    pub fn summary(&self) -> String {
        let share = |n: u64| 100.0 * n as f64 / self.rays.max(1) as f64;
        let times = &self.all.times;
        format!(
            "{} rays on {} families, each in every mode: {} disagreements{}{}\n\
             {:.0} s, {:.0} rays/s; seconds of threads: {:.0} making, {:.0} building, {:.0} oracle, {:.0} tracing\n\
             {:.1} % of the rays on meshes of 10^4 triangles and more, {} on meshes of 10^6; smallest family {:.2} %\n",
            self.rays,
            self.families.len(),
            self.disagreements,
            self.bound_95.map_or(String::new(), |b| format!(" (rate below {b:.1e} with 95 % confidence)")),
            if self.complete { "" } else { "; NOT COMPLETE" },
            self.seconds,
            self.rays_per_second,
            times.make,
            times.build,
            times.oracle,
            times.trace,
            share(self.rays_on_10k),
            self.rays_on_1m,
            100.0 * self.smallest_share,
        )
    }
}
