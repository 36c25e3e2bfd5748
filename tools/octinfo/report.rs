//! What octinfo tells about a file, as a table and as JSON.

use std::fmt::Write as _;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};

use octrace::format::{Flags, HEADER_BYTES, Header, PageHeader, SectionKind};
use octrace::map::Octree;
use octrace::{Error, Result};
use serde::Serialize;

use crate::cli::stats::SCHEMA;

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

/// What was left out of the source.
#[derive(Serialize)]
struct Dropped {
    degenerate: u64,
    non_finite: u64,
    bad_index: u64,
    too_few_corners: u64,
}

/// Bytes by part; the sum is the file's length.
#[derive(Default, Serialize)]
struct Parts {
    header: u64,
    top: u64,
    nodes: u64,
    leaves: u64,
    ids: u64,
    material_numbers: u64,
    normals: u64,
    texcoords: u64,
    page_headers_and_padding: u64,
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
}

impl Report {
    /// Reads the file's header, and the headers of all pages.
    pub fn new(octree: &Octree, verified: bool) -> Result<Report> {
        let h = octree.header();
        let d = h.dropped;
        Ok(Report {
            schema: SCHEMA,
            file: octree.path().display().to_string(),
            version: h.version,
            triangles: h.triangles,
            vertices: h.vertices,
            references: h.references,
            source_triangles: h.source_triangles,
            dropped: Dropped {
                degenerate: d.degenerate,
                non_finite: d.non_finite,
                bad_index: d.bad_index,
                too_few_corners: d.too_few_corners,
            },
            nodes: h.nodes,
            leaves: h.leaves,
            pages: h.pages,
            top_nodes: h.top_nodes,
            materials: h.materials,
            depth: h.depth,
            bytes: h.file_bytes,
            bytes_per_triangle: h.file_bytes as f64 / h.triangles.max(1) as f64,
            largest_page: h.largest_page,
            by_part: parts(octree)?,
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
        row("leaves", format!("{} ({fill:.1} triangles each)", grouped(self.leaves)));
        row("pages", format!("{} (largest {} bytes)", grouped(self.pages.into()), grouped(self.largest_page.into())));
        row("materials", grouped(self.materials.into()));
        row("bytes", format!("{} ({:.2} a triangle)", grouped(self.bytes), self.bytes_per_triangle));
        for (name, bytes) in self.by_part.list() {
            if bytes > 0 {
                let share = bytes as f64 / self.triangles.max(1) as f64;
                row(&format!("  {name}"), format!("{:>15}  {share:>7.2} a triangle", grouped(bytes)));
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
        match o.split {
            "sah" => format!("--split sah --brick {} --leaf {}{ids}", o.brick, o.leaf),
            split => format!("--split {split} --brick {} --leaf {} --cell {cell} --depth {}{ids}", o.brick, o.leaf, o.depth),
        }
    }
}

impl Parts {
    fn list(&self) -> [(&'static str, u64); 9] {
        [
            ("nodes", self.nodes),
            ("leaves", self.leaves),
            ("ids", self.ids),
            ("material nos.", self.material_numbers),
            ("normals", self.normals),
            ("texcoords", self.texcoords),
            ("top", self.top),
            ("header", self.header),
            ("page heads, gaps", self.page_headers_and_padding),
        ]
    }
}

/// Sums the parts over the headers of all pages, without reading the pages.
fn parts(octree: &Octree) -> Result<Parts> {
    let h = octree.header();
    let mut parts = Parts { header: HEADER_BYTES as u64, ..Parts::default() };
    for section in h.sections.iter().filter(|s| s.kind != 0) {
        match section.kind == SectionKind::TopNodes as u32 {
            true => parts.nodes += section.bytes,
            false => parts.top += section.bytes,
        }
    }
    let path = octree.path();
    let mut file = File::open(path).map_err(Error::io(path, "open"))?;
    let material_bytes = if h.flags.has(Flags::WIDE_MATERIALS) { 4 } else { 2 };
    for brick in octree.bricks() {
        let page = read_page_header(&mut file, u64::from(brick.node).saturating_sub(1) * 64)
            .map_err(Error::io(path, "read"))?;
        let references = u64::from(page.references);
        let present = |offset: u32, bytes: u64| if offset == 0 { 0 } else { bytes };
        parts.nodes += u64::from(page.nodes) * 64;
        parts.leaves += u64::from(page.leaf_bytes);
        parts.ids += present(page.ids, references * 4);
        parts.material_numbers += present(page.materials, references * material_bytes);
        parts.normals += present(page.normal_corners, references * 12 + u64::from(page.normal_count) * 12);
        parts.texcoords += present(page.texcoord_corners, references * 12 + u64::from(page.texcoord_count) * 8);
    }
    let known: u64 = parts.list().iter().map(|p| p.1).sum();
    parts.page_headers_and_padding = h.file_bytes.saturating_sub(known);
    Ok(parts)
}

/// The first 64 bytes of the page at `offset`. (Packed files, which have no such bytes, do not exist in version 1.)
fn read_page_header(file: &mut File, offset: u64) -> std::io::Result<PageHeader> {
    let mut page = PageHeader::default();
    file.seek(SeekFrom::Start(offset))?;
    file.read_exact(bytemuck::bytes_of_mut(&mut page))?;
    Ok(page)
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
    }
}

/// A number with commas between thousands.
pub fn grouped(n: u64) -> String {
    indicatif::HumanCount(n).to_string()
}

fn point<T: std::fmt::Display>(p: &[T; 3]) -> String {
    format!("({}, {}, {})", p[0], p[1], p[2])
}
