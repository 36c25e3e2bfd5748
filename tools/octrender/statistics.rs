//! What octrender says when it is done: a line for people, JSON for programs.

use std::sync::Arc;

use indicatif::HumanCount;
use octrace::map::Octree;
use octrace::render::Picture;
use serde::Serialize;

use crate::cli::stats;
use crate::place::Place;

/// The statistics file.
#[derive(Serialize)]
pub struct Stats {
    schema: u32,
    width: u32,
    height: u32,
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

/// Pages of all meshes. In a mapped file each page that is touched is read once, when it is checked.
#[derive(Serialize)]
struct Pages {
    total: u64,
    touched: u64,
    read: u64,
    bytes_read: u64,
}

impl Stats {
    /// The statistics of a picture of these meshes.
    pub fn new(picture: &Picture, trace_cpu_seconds: f64, meshes: &[Arc<Octree>], lod: Option<f64>) -> Stats {
        let (s, rays) = (picture.statistics, picture.statistics.rays);
        let touched: u64 = meshes.iter().map(|m| m.used().count() as u64).sum();
        Stats {
            schema: stats::SCHEMA,
            width: picture.film.width(),
            height: picture.film.height(),
            rays: Rays { primary: rays.primary, shadow: rays.shadow, mirror: rays.mirror, refracted: rays.refracted },
            seconds: s.seconds,
            trace_seconds: s.trace_seconds,
            trace_cpu_seconds,
            cpu_seconds: stats::cpu_seconds(),
            pages: Pages {
                total: meshes.iter().map(|m| u64::from(m.header().pages)).sum(),
                touched,
                read: touched,
                bytes_read: meshes.iter().flat_map(|m| m.used()).map(|page| u64::from(page.stored_bytes)).sum(),
            },
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

    /// The summary: size, rays, seconds.
    pub fn line(&self, place: &Place) -> String {
        let Rays { primary, shadow, mirror, refracted } = self.rays;
        let rays = primary + shadow + mirror + refracted;
        format!("{place}: {} x {} pixels, {} rays, {:.2} s", self.width, self.height, HumanCount(rays), self.seconds)
    }
}
