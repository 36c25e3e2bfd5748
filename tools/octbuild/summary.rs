//! What octbuild says when it is done: a line for people, JSON for programs.

use std::path::Path;

use indicatif::HumanCount;
use octrace::build::BuildReport;
use serde::Serialize;

use crate::cli::stats::{self, Dropped};

/// The statistics file.
#[derive(Serialize)]
pub struct Stats {
    schema: u32,
    triangles: u64,
    vertices: u64,
    references: u64,
    source_triangles: u64,
    dropped: Dropped,
    polygons: Polygons,
    pages: u32,
    nodes: u64,
    leaves: u64,
    depth: u32,
    largest_shift: f64,
    bytes: u64,
    bytes_per_triangle: f64,
    seconds: f64,
    cpu_seconds: f64,
    peak_rss_bytes: u64,
    phases: Vec<Phase>,
}

/// Faces of more than three corners, and how they were cut.
#[derive(Serialize)]
struct Polygons {
    cut: u64,
    clipped: u64,
    fanned: u64,
}

#[derive(Serialize)]
struct Phase {
    name: &'static str,
    seconds: f64,
    cpu_seconds: f64,
    bytes_read: u64,
    bytes_written: u64,
    peak_rss_bytes: u64,
}

impl Stats {
    /// The statistics of a build that took `seconds`.
    pub fn new(report: &BuildReport, seconds: f64) -> Stats {
        let p = report.polygons;
        let phase = |p: &octrace::build::Phase| Phase {
            name: p.name,
            seconds: p.seconds,
            cpu_seconds: p.cpu_seconds,
            bytes_read: p.bytes_read,
            bytes_written: p.bytes_written,
            peak_rss_bytes: p.peak_rss_bytes,
        };
        Stats {
            schema: stats::SCHEMA,
            triangles: report.triangles,
            vertices: report.vertices,
            references: report.references,
            source_triangles: report.source_triangles,
            dropped: report.dropped.into(),
            polygons: Polygons { cut: p.cut, clipped: p.clipped, fanned: p.fanned },
            pages: report.pages,
            nodes: report.nodes,
            leaves: report.leaves,
            depth: report.depth,
            largest_shift: report.largest_shift,
            bytes: report.bytes,
            bytes_per_triangle: report.bytes_per_triangle,
            seconds,
            cpu_seconds: stats::cpu_seconds(),
            peak_rss_bytes: stats::peak_rss_bytes(),
            phases: report.phases.iter().map(phase).collect(),
        }
    }
}

/// The summary: triangles, bytes, bytes a triangle, seconds, and what was dropped and why.
pub fn line(output: &Path, report: &BuildReport, seconds: f64) -> String {
    let mut line = format!(
        "{}: {} triangles, {} bytes ({:.2} a triangle), {seconds:.2} s",
        output.display(),
        HumanCount(report.triangles),
        HumanCount(report.bytes),
        report.bytes_per_triangle,
    );
    if report.largest_shift > 0.0 {
        line += &format!("; moved vertices by up to {:.3e} on an axis", report.largest_shift);
    }
    let d = report.dropped;
    let dropped: Vec<String> = [
        (d.degenerate, "triangles of zero area"),
        (d.non_finite, "triangles that are not finite"),
        (d.bad_index, "triangles with a bad index"),
        (d.too_few_corners, "faces with too few corners"),
    ]
    .iter()
    .filter(|(count, _)| *count > 0)
    .map(|(count, what)| format!("{} {what}", HumanCount(*count)))
    .collect();
    if !dropped.is_empty() {
        line += &format!("; dropped {}", dropped.join(", "));
    }
    line
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_line_names_what_was_dropped() {
        let mut report = BuildReport { triangles: 1234, bytes: 24680, bytes_per_triangle: 20.0, ..Default::default() };
        assert_eq!(
            line("a.oct".as_ref(), &report, 0.5),
            "a.oct: 1,234 triangles, 24,680 bytes (20.00 a triangle), 0.50 s"
        );
        report.dropped.degenerate = 3;
        report.dropped.too_few_corners = 1;
        assert!(
            line("a.oct".as_ref(), &report, 0.5)
                .ends_with("; dropped 3 triangles of zero area, 1 faces with too few corners")
        );
    }
}
