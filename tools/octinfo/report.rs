//! What octinfo tells about a file, as a table and as JSON.

use std::fmt::Write as _;

use octrace::format::{Flags, Header};
use octrace::map::{self, Octree};
use octrace::{Error, Monitor, Result};
use serde::Serialize;

use crate::cli::stats::{Dropped, SCHEMA};

/// Everything that is told.
#[derive(Serialize)]
pub struct Report {
    schema: u32,
    file: String,
    version: u32,
    triangles: u64,
    vertices: u64,
    references: u64,
    source_triangles: u64,
    dropped: Dropped,
    nodes: u64,
    leaves: u64,
    step_leaves: u64,
    pages: u32,
    top_nodes: u32,
    materials: u32,
    depth: u32,
    bytes: u64,
    bytes_per_triangle: f64,
    largest_page: u32,
    by_part: Parts,
    bounds: Bounds,
    origin: [f64; 3],
    root: Root,
    options: Options,
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    verified: bool,
}

/// Bytes by part; the sum is the file's length.
#[derive(Serialize)]
struct Parts {
    nodes: u64,
    leaf_vertices: u64,
    leaf_corners: u64,
    ids: u64,
    material_numbers: u64,
    normals: u64,
    texcoords: u64,
    level_of_detail: u64,
    top: u64,
    header: u64,
    page_headers: u64,
    padding: u64,
}

#[derive(Serialize)]
struct Bounds {
    min: [f32; 3],
    max: [f32; 3],
}

#[derive(Serialize)]
struct Root {
    corner: [f64; 3],
    log2_side: i32,
}

/// The builder's options that the file remembers; `None` = all.
#[derive(Serialize)]
struct Options {
    split: &'static str,
    brick: u32,
    leaf: u8,
    cell: Option<u32>,
    depth: u8,
    ids: bool,
    lod: bool,
    grid: bool,
}

impl Report {
    /// Adds everything up, which reads every page.
    pub fn new(octree: &Octree, verified: bool, monitor: Monitor<'_>) -> Result<Report> {
        let h = octree.header();
        let parts = octree.parts(monitor)?;
        Ok(Report {
            schema: SCHEMA,
            file: octree.path().display().to_string(),
            version: h.version,
            triangles: h.triangles,
            vertices: h.vertices,
            references: h.references,
            source_triangles: h.source_triangles,
            dropped: h.dropped.into(),
            nodes: h.nodes,
            leaves: h.leaves,
            step_leaves: parts.step_leaves,
            pages: h.pages,
            top_nodes: h.top_nodes,
            materials: h.materials,
            depth: h.depth,
            bytes: h.file_bytes,
            bytes_per_triangle: h.file_bytes as f64 / h.triangles.max(1) as f64,
            largest_page: h.largest_page,
            by_part: Parts::new(&parts),
            bounds: Bounds { min: h.bounds_min, max: h.bounds_max },
            origin: h.origin,
            root: Root { corner: h.root_corner, log2_side: h.root_log2_side },
            options: options(h),
            verified,
        })
    }

    /// As JSON.
    pub fn json(&self) -> Result<String> {
        let text = serde_json::to_string_pretty(self);
        text.map(|t| t + "\n").map_err(|e| Error::Option(format!("cannot write the report as JSON: {e}")))
    }

    /// As a table for people.
    pub fn table(&self) -> String {
        let mut t = String::new();
        let mut row = |name: &str, value: String| {
            let _ = writeln!(t, "{name:<16}{value}");
        };
        row("file", format!("{}, format version {}", self.file, self.version));
        row("triangles", self.triangle_row());
        row("vertices", grouped(self.vertices));
        row("nodes", format!("{} ({} in the top), depth {}", grouped(self.nodes), self.top_nodes, self.depth));
        let fill = self.references as f64 / self.leaves.max(1) as f64;
        let steps = match self.options.grid {
            true => format!(", {} with vertices of 16 bits an axis", grouped(self.step_leaves)),
            false => String::new(),
        };
        row("leaves", format!("{} ({fill:.1} triangles each){steps}", grouped(self.leaves)));
        row("pages", format!("{} (largest {} bytes)", grouped(self.pages.into()), grouped(self.largest_page.into())));
        row("materials", grouped(self.materials.into()));
        row("bytes", format!("{} ({:.2} a triangle)", grouped(self.bytes), self.bytes_per_triangle));
        for (name, bytes) in self.by_part.list() {
            if bytes > 0 {
                let share = bytes as f64 / self.triangles.max(1) as f64;
                // Names that are longer than their column take of the next one.
                let width = 31 - (2 + name.len()).max(16);
                row(&format!("  {name}"), format!("{:>width$}  {share:>7.2} a triangle", grouped(bytes)));
            }
        }
        row("bounds", format!("{} to {}", point(&self.bounds.min), point(&self.bounds.max)));
        if self.origin != [0.0; 3] {
            row("origin", format!("{} was subtracted from the source", point(&self.origin)));
        }
        row("root cube", format!("{}, side 2^{}", point(&self.root.corner), self.root.log2_side));
        row("built with", self.option_row());
        if self.verified {
            row("verified", "every checksum and every rule holds, in every page".to_owned());
        }
        t
    }

    fn triangle_row(&self) -> String {
        let mut text = grouped(self.triangles);
        if self.references != self.triangles {
            let _ = write!(text, ", stored {} times", grouped(self.references));
        }
        let d = &self.dropped;
        let reasons = [
            (d.degenerate, "of zero area"),
            (d.non_finite, "not finite"),
            (d.bad_index, "with a bad index"),
            (d.too_few_corners, "faces with too few corners"),
        ];
        let dropped: Vec<String> =
            reasons.iter().filter(|r| r.0 > 0).map(|(n, why)| format!("{} {why}", grouped(*n))).collect();
        if !dropped.is_empty() {
            let _ = write!(text, " (dropped: {})", dropped.join(", "));
        }
        text
    }

    fn option_row(&self) -> String {
        let o = &self.options;
        let cell = o.cell.map_or("all".to_owned(), |n| n.to_string());
        let ids = if o.ids { "" } else { " --no-ids" };
        let lod = if o.lod { "" } else { " --no-lod" };
        let grid = if o.grid { " --positions grid" } else { "" };
        match o.split {
            "sah" => format!("--split sah --brick {} --leaf {}{ids}{lod}{grid}", o.brick, o.leaf),
            split => {
                let (brick, leaf, depth) = (o.brick, o.leaf, o.depth);
                format!("--split {split} --brick {brick} --leaf {leaf} --cell {cell} --depth {depth}{ids}{lod}{grid}")
            }
        }
    }
}

impl Parts {
    fn new(p: &map::Parts) -> Parts {
        Parts {
            nodes: p.nodes,
            leaf_vertices: p.leaf_vertices,
            leaf_corners: p.leaf_corners,
            ids: p.ids,
            material_numbers: p.materials,
            normals: p.normals,
            texcoords: p.texcoords,
            level_of_detail: p.detail,
            top: p.top,
            header: p.header,
            page_headers: p.page_headers,
            padding: p.padding,
        }
    }

    fn list(&self) -> [(&'static str, u64); 12] {
        [
            ("nodes", self.nodes),
            ("leaf vertices", self.leaf_vertices),
            ("leaf corners", self.leaf_corners),
            ("ids", self.ids),
            ("material nos.", self.material_numbers),
            ("normals", self.normals),
            ("texcoords", self.texcoords),
            ("level of detail", self.level_of_detail),
            ("top", self.top),
            ("header", self.header),
            ("page headers", self.page_headers),
            ("padding", self.padding),
        ]
    }
}

fn options(h: &Header) -> Options {
    Options {
        split: match h.split {
            0 => "sah",
            1 => "octree",
            _ => "strict",
        },
        brick: h.brick_limit,
        leaf: h.leaf_limit,
        cell: (h.cell_limit != u32::MAX).then_some(h.cell_limit),
        depth: h.depth_limit,
        ids: h.flags.has(Flags::IDS),
        lod: h.flags.has(Flags::DETAIL),
        grid: h.flags.has(Flags::STEPS),
    }
}

/// A number with commas between thousands.
fn grouped(n: u64) -> String {
    indicatif::HumanCount(n).to_string()
}

fn point<T: std::fmt::Display>(p: &[T; 3]) -> String {
    format!("({}, {}, {})", p[0], p[1], p[2])
}
