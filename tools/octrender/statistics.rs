//! What octrender says when it is done: a line for people, JSON for programs.

use std::sync::Arc;

use indicatif::{BinaryBytes, HumanCount};
use octrace::map::Octree;
use octrace::render::{Share, Statistics};
use serde::Serialize;

use crate::cli::stats::{self, Pages};
use crate::place::Place;

/// The statistics file.
#[derive(Serialize)]
pub struct Stats {
    schema: u32,
    width: u32,
    height: u32,
    #[serde(skip_serializing_if = "Option::is_none")]
    share: Option<Part>,
    rays: Rays,
    seconds: f64,
    trace_seconds: f64,
    /// The processor's, of all threads, for `trace_seconds`.
    trace_cpu_seconds: f64,
    cpu_seconds: f64,
    pages: Pages,
    #[serde(skip_serializing_if = "Option::is_none")]
    lod: Option<Lod>,
    peak_rss_bytes: u64,
}

/// A share of the picture, where only that was drawn.
#[derive(Serialize)]
struct Part {
    index: u32,
    of: u32,
    tiles: u64,
}

#[derive(Serialize)]
struct Rays {
    primary: u64,
    shadow: u64,
    mirror: u64,
    refracted: u64,
}

/// Level of detail, where it was asked for.
#[derive(Serialize)]
struct Lod {
    /// The error allowed.
    pixels: f64,
    /// Surrogates that rays took for hits.
    hits: u64,
    /// The largest error of these.
    largest_error_pixels: f64,
    /// How many had an error of up to an eighth of what was allowed, two eighths, and so on.
    histogram: [u64; 8],
    /// Bytes read beside the pages.
    bytes_read: u64,
}

impl Stats {
    /// The statistics of a picture of these meshes, or of a share of it.
    pub fn new(
        [width, height]: [u32; 2],
        s: &Statistics,
        share: Option<Share>,
        trace_cpu_seconds: f64,
        meshes: &[Arc<Octree>],
        lod: Option<f64>,
    ) -> Stats {
        let rays = s.rays;
        Stats {
            schema: stats::SCHEMA,
            width,
            height,
            share: share.map(|share| Part { index: share.index(), of: share.of(), tiles: s.tiles }),
            rays: Rays { primary: rays.primary, shadow: rays.shadow, mirror: rays.mirror, refracted: rays.refracted },
            seconds: s.seconds,
            trace_seconds: s.trace_seconds,
            trace_cpu_seconds,
            cpu_seconds: stats::cpu_seconds(),
            pages: Pages::of(meshes.iter().map(|mesh| mesh.figures())),
            lod: lod.map(|pixels| Lod {
                pixels,
                hits: s.detail.hits,
                largest_error_pixels: s.detail.largest,
                histogram: s.detail.histogram,
                bytes_read: meshes.iter().map(|m| m.detail_bytes()).sum(),
            }),
            peak_rss_bytes: stats::peak_rss_bytes(),
        }
    }

    /// With the most memory that was taken up to now.
    pub fn finished(self) -> Stats {
        Stats { peak_rss_bytes: stats::peak_rss_bytes(), cpu_seconds: stats::cpu_seconds(), ..self }
    }

    /// What level of detail did, if it was asked for.
    pub fn lod_line(&self) -> Option<String> {
        let Lod { pixels, hits, largest_error_pixels, .. } = self.lod.as_ref()?;
        Some(format!(
            "level of detail: {} hits off by at most {largest_error_pixels:.3} pixels (allowed {pixels}), {} of {} pages used",
            HumanCount(*hits),
            HumanCount(self.pages.touched),
            HumanCount(self.pages.total)
        ))
    }

    /// The summary: size, rays, seconds, pages, memory.
    pub fn line(&self, place: &Place) -> String {
        let Rays { primary, shadow, mirror, refracted } = self.rays;
        let (rays, pages) = (HumanCount(primary + shadow + mirror + refracted), self.pages.line());
        let Stats { width, height, share, seconds, peak_rss_bytes, .. } = self;
        let memory = BinaryBytes(*peak_rss_bytes);
        let share = share.as_ref().map(|Part { index, of, tiles }| format!("share {index} of {of} ({tiles} tiles), "));
        let share = share.unwrap_or_default();
        format!(
            "{place}: {width} x {height} pixels, {share}{rays} rays, {seconds:.2} s; {pages}; {memory} of memory at most"
        )
    }
}
