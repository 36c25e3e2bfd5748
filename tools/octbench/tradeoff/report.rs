//! What is told: a table, Markdown, JSON.

use std::fmt::Write as _;

use serde::Serialize;

use super::lod::{self, Level};
use super::tally::Tally;
use crate::machine::Machine;
use crate::timing::{Clock, geometric_mean};

/// Everything that was found out.
#[derive(Serialize)]
pub struct Report {
    /// Version of this form.
    pub schema: u32,
    /// Where it was measured.
    pub machine: Machine,
    /// Rounds that were timed.
    pub rounds: u32,
    /// What was read.
    pub clock: Clock,
    /// The meshes.
    pub meshes: Vec<MeshNote>,
    /// A row for each set of rays and tracer.
    pub rows: Vec<Row>,
    /// A row for each tracer, over all sets.
    pub summary: Vec<Row>,
    /// A row for each file and level of detail.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub lod: Vec<Level>,
}

/// A mesh and its size.
#[derive(Serialize)]
pub struct MeshNote {
    /// Its name.
    pub mesh: String,
    /// Its triangles.
    pub triangles: u64,
}

/// One tracer on one set of rays.
#[derive(Clone, Serialize)]
pub struct Row {
    /// The mesh and the rays.
    pub set: String,
    /// The tracer.
    pub tracer: String,
    /// Whether it claims to be exact.
    pub exact: bool,
    /// Its speed on one thread; in the summary the geometric mean over the sets.
    pub mrays_per_second: Option<f64>,
    /// Share of rays with an error: missed, false, or a triangle elsewhere.
    pub error_rate: f64,
    /// Its answers.
    #[serde(flatten)]
    pub tally: Tally,
}

impl Report {
    /// Adds up each tracer's rows.
    pub fn sum_up(&mut self) {
        let mut names: Vec<&String> = Vec::new();
        self.rows.iter().for_each(|r| {
            if !names.contains(&&r.tracer) {
                names.push(&r.tracer)
            }
        });
        let sum = |name: &String| {
            let rows = || self.rows.iter().filter(|r| &r.tracer == name);
            let speeds: Vec<f64> = rows().filter_map(|r| r.mrays_per_second).collect();
            let tally = rows().fold(Tally::default(), |sum, r| sum.and(&r.tally));
            Row {
                set: "all".to_owned(),
                tracer: name.clone(),
                exact: rows().all(|r| r.exact),
                mrays_per_second: (!speeds.is_empty()).then(|| geometric_mean(&speeds)),
                error_rate: tally.error_rate(),
                tally,
            }
        };
        self.summary = names.into_iter().map(sum).collect();
    }

    /// Tracers that claim to be exact and were not, with the set.
    pub fn broken(&self) -> Vec<String> {
        let broken = self.rows.iter().filter(|r| r.exact && !r.tally.is_exact());
        broken.map(|r| format!("{} on {}", r.tracer, r.set)).collect()
    }

    /// As a table for people.
    pub fn table(&self) -> String {
        if self.rows.is_empty() {
            return self.lod_heading() + &lod::table(&self.lod);
        }
        let width = self.rows.iter().map(|r| r.tracer.chars().count()).max().unwrap_or(0).max(6);
        let mut text = self.heading();
        let heads = ["Mrays/s", "missed", "false", "wrong", "neighbour", "tie", "error rate", "t off", "most ulps"];
        let heads: String = heads.iter().map(|head| format!(" {head:>10}")).collect();
        let mut set = "";
        for row in self.rows.iter().chain(&self.summary) {
            if row.set != set {
                set = &row.set;
                let _ = write!(text, "\n{set}, {} rays\n{:width$}{heads}\n", row.tally.rays, "tracer");
            }
            let _ = writeln!(
                text,
                "{:width$}{}",
                row.tracer,
                cells(row).iter().map(|cell| format!(" {cell:>10}")).collect::<String>()
            );
        }
        text + &lod::table(&self.lod)
    }

    /// As Markdown: the summary, then all rows.
    pub fn markdown(&self) -> String {
        if self.rows.is_empty() {
            return self.lod_heading() + &lod::markdown(&self.lod);
        }
        let mut text = self.heading() + "\n";
        let head = |first: &str| {
            format!(
                "| {first} | Mrays/s | missed | false | wrong triangle | neighbour | tie | error rate | t not the nearest f32 | most, ulps |\n\
                 | --- |{}\n",
                " ---: |".repeat(9)
            )
        };
        let line = |first: String, row: &Row| format!("| {first} | {} |\n", cells(row).join(" | "));
        text += &head("tracer");
        self.summary.iter().for_each(|row| text += &line(row.tracer.clone(), row));
        text += "\n";
        text += &head("rays, tracer");
        self.rows.iter().for_each(|row| text += &line(format!("{}: {}", row.set, row.tracer), row));
        text + &lod::markdown(&self.lod)
    }

    fn lod_heading(&self) -> String {
        let Report { machine, rounds, clock, .. } = self;
        format!("{machine}; all threads, medians of {rounds} rounds in turn{}.\n", clock.note())
    }

    fn heading(&self) -> String {
        let meshes: Vec<_> = self.meshes.iter().map(|m| format!("{} ({} triangles)", m.mesh, m.triangles)).collect();
        let Report { machine, rounds, clock, .. } = self;
        format!("{}. {machine}; one thread, medians of {rounds} rounds in turn{}.\n", meshes.join(", "), clock.note())
    }
}

/// The numbers of a row, in the order of the heads.
fn cells(row: &Row) -> [String; 9] {
    let t = &row.tally;
    let rate = if t.errors() == 0 { format!("<{:.1e}", t.bound()) } else { format!("{:.1e}", row.error_rate) };
    let hits = t.t_ulps.iter().sum::<u64>().max(1);
    [
        row.mrays_per_second.map_or("-".to_owned(), |x| if x < 0.1 { format!("{x:.5}") } else { format!("{x:.2}") }),
        t.missed.to_string(),
        t.false_hits.to_string(),
        t.wrong_triangle.to_string(),
        t.neighbour.to_string(),
        t.tie.to_string(),
        rate,
        if t.t_off() == 0 { "0".to_owned() } else { format!("{:.1} %", 100.0 * t.t_off() as f64 / hits as f64) },
        t.t_ulps_most.to_string(),
    ]
}
