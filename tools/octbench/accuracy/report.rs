//! What was counted, per family and mode, and how it is shown.

use serde::Serialize;

/// Bins of the error of t in units in the last place: exact, rounded correctly, 1, 2-3, 4-15, 16 and more.
pub const ULP_BINS: [&str; 6] = ["0", "half", "1", "2-3", "4-15", "16+"];

/// What one mode (an instruction set, or no tree at all) showed.
#[derive(Clone, Debug, Default, Serialize)]
pub struct ModeReport {
    /// `scalar`, `avx2`, `avx512`; `linear` is the test of all triangles, on small meshes.
    pub mode: &'static str,
    /// Rays traced.
    pub rays: u64,
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
    /// Hits whose bits are not those of the first mode.
    pub differs: u64,
    /// Errors of t, in the bins of [`ULP_BINS`].
    pub ulp_histogram: [u64; 6],
    /// Largest error of t in units in the last place.
    pub largest_ulp: u64,
    /// Rays for which some triangle was in doubt after the f32 filter, as a share.
    pub share_doubt: f64,
    /// Rays that needed expansions, as a share.
    pub share_exact: f64,
    /// Millions of closest hits a second on one thread, while the other threads work as well.
    pub mrays_per_second: f64,
    /// Rays with a doubt, rays with expansions.
    #[serde(skip)]
    pub tiers: [u64; 2],
    /// Time of the closest hits.
    #[serde(skip)]
    pub seconds: f64,
}

impl ModeReport {
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

    fn add(&mut self, other: &ModeReport) {
        self.rays += other.rays;
        self.missed += other.missed;
        self.false_hits += other.false_hits;
        self.wrong_triangle += other.wrong_triangle;
        self.doubled += other.doubled;
        self.odd_crossings += other.odd_crossings;
        self.wrong_any += other.wrong_any;
        self.wrong_uv += other.wrong_uv;
        self.differs += other.differs;
        self.largest_ulp = self.largest_ulp.max(other.largest_ulp);
        self.seconds += other.seconds;
        for (a, b) in self.ulp_histogram.iter_mut().zip(other.ulp_histogram) {
            *a += b;
        }
        for (a, b) in self.tiers.iter_mut().zip(other.tiers) {
            *a += b;
        }
        self.finish();
    }

    fn finish(&mut self) {
        let rays = self.rays.max(1) as f64;
        [self.share_doubt, self.share_exact] = self.tiers.map(|n| n as f64 / rays);
        self.mrays_per_second = self.rays as f64 / 1e6 / self.seconds.max(1e-9);
    }
}

/// What a family showed: the sums over its modes, and each mode.
#[derive(Clone, Debug, Default, Serialize)]
pub struct FamilyReport {
    /// Number in the list of hard cases.
    pub number: u32,
    /// Its name.
    pub name: String,
    /// Rays held to the oracle (each in every mode).
    pub rays: u64,
    /// Rays on meshes of at least 10^4 triangles.
    pub rays_on_large: u64,
    /// Rays that hit something by the oracle.
    pub hits: u64,
    /// Triangles that needed the oracle's expansions, a ray.
    pub oracle_exact_per_ray: f64,
    /// With no disagreement: the rate of errors is below this with 95 % confidence (3 / N).
    pub bound_95: Option<f64>,
    /// Sums over the modes.
    #[serde(flatten)]
    pub total: ModeReport,
    /// Each mode.
    pub modes: Vec<ModeReport>,
    /// The first few disagreements, in words.
    pub examples: Vec<String>,
    /// Triangles for which the oracle needed expansions.
    #[serde(skip)]
    pub oracle_exact: u64,
}

/// The file of statistics.
#[derive(Serialize)]
pub struct Report<'a> {
    /// Version of this form.
    pub schema: u32,
    /// Rays held to the oracle.
    pub rays: u64,
    /// All disagreements.
    pub disagreements: u64,
    /// Rays on meshes of at least 10^4 triangles.
    pub rays_on_large: u64,
    /// Wall clock.
    pub seconds: f64,
    /// Seed of everything.
    pub seed: u64,
    /// Each family.
    pub families: &'a [FamilyReport],
}

impl FamilyReport {
    /// All that disagrees with the oracle.
    pub fn disagreements(&self) -> u64 {
        self.modes.iter().map(ModeReport::disagreements).sum()
    }

    /// Both together.
    pub fn merge(mut self, other: FamilyReport) -> FamilyReport {
        self.rays += other.rays;
        self.rays_on_large += other.rays_on_large;
        self.hits += other.hits;
        self.oracle_exact += other.oracle_exact;
        for mode in &other.modes {
            match self.modes.iter_mut().find(|m| m.mode == mode.mode) {
                Some(ours) => ours.add(mode),
                None => self.modes.push(mode.clone()),
            }
        }
        self.examples.extend(other.examples);
        self.examples.truncate(8);
        self
    }

    /// Names the family and fills in what follows from the counts.
    pub fn finish(mut self, number: u32, name: &str) -> FamilyReport {
        (self.number, self.name) = (number, name.to_owned());
        self.total = ModeReport { mode: "all", ..ModeReport::default() };
        self.modes.iter_mut().for_each(ModeReport::finish);
        self.modes.iter().for_each(|m| self.total.add(m));
        self.total.rays = self.modes.iter().map(|m| m.rays).sum();
        self.oracle_exact_per_ray = self.oracle_exact as f64 / self.rays.max(1) as f64;
        self.bound_95 = (self.disagreements() == 0 && self.rays > 0).then(|| 3.0 / self.rays as f64);
        self
    }

    /// The lines of the table, one a mode, and the examples.
    pub fn lines(&self) -> String {
        let mut text = String::new();
        for (k, m) in self.modes.iter().enumerate() {
            let name = if k == 0 { format!("{:3} {}", self.number, self.name) } else { String::new() };
            let histogram = m.ulp_histogram.map(|n| format!("{n:>9}")).concat();
            let other = m.doubled + m.odd_crossings;
            let rest = m.wrong_any + m.wrong_uv + m.differs;
            let bound =
                if m.disagreements() == 0 { format!("{:8.1e}", 3.0 / m.rays.max(1) as f64) } else { "-".into() };
            text += &format!(
                "{name:46} {:7} {:9} {:6} {:6} {:6} {other:6} {rest:6} {histogram} {:7} {:7.3} {:7.3} {:8.3} {bound:>8}\n",
                m.mode,
                m.rays,
                m.missed,
                m.false_hits,
                m.wrong_triangle,
                m.largest_ulp,
                100.0 * m.share_doubt,
                100.0 * m.share_exact,
                m.mrays_per_second,
            );
        }
        self.examples.iter().for_each(|e| text += &format!("      {e}\n"));
        text
    }
}

/// The table's heading.
pub fn heading() -> String {
    let bins = ULP_BINS.map(|b| format!("{b:>9}")).concat();
    format!(
        "{:46} {:7} {:>9} {:>6} {:>6} {:>6} {:>6} {:>6} {bins} {:>7} {:>7} {:>7} {:>8} {:>8}\n{:85}(double = list of all hits or parity; other = any hit, u, v, modes; then t errors in ulps, their largest)\n",
        "family",
        "mode",
        "rays",
        "missed",
        "false",
        "tri",
        "double",
        "other",
        "largest",
        "doubt%",
        "exact%",
        "Mrays/s",
        "<95%",
        ""
    )
}
