//! The builder as a whole: the phases in order, and what passes from one to the next.

use std::path::Path;

use bytemuck::Zeroable;
use rayon::prelude::*;

use crate::error::{Error, Result};
use crate::event::Monitor;
use crate::format::{Brick, Flags, Header, LeafUnit, Node, OctWriter, PageId, SplitMode, Top};
use crate::geometry::RootCube;
use crate::mesh::TriangleSource;

use super::brick::{BrickBuilder, BuiltBrick};
use super::chunk::{BrickList, BrickRule, bricks};
use super::distribute::{Chunk, Extent, Records, Sorting};
use super::faces::Faces;
use super::grid::{CellCode, Placement, Unit};
use super::join::{Joined, join};
use super::materials::materials;
use super::options::{BuildOptions, Tuning};
use super::origin::{suggestion, warn_if_merged};
use super::phases::Phases;
use super::polygon::CLIP_LIMIT;
use super::record::Layout;
use super::report::BuildReport;
use super::scan::{Scan, scan};
use super::spool::{Spool, temporary};
use super::subtree::{TopBrick, build_top, top_levels};

/// Builds the octree file `output` from `source`.
///
/// The file is written under a temporary name, synced and renamed: on any error, and when `monitor` says stop
/// ([`Error::Interrupted`]), nothing is left behind and an older `output` stays as it was. The work runs on the current
/// rayon pool; the bytes written do not depend on it. Errors: options out of range, a source without triangles
/// ([`Error::Input`]), whatever the source reports, and [`Error::Io`].
pub fn build(
    source: &mut dyn TriangleSource,
    output: &Path,
    options: &BuildOptions,
    monitor: Monitor<'_>,
) -> Result<BuildReport> {
    build_tuned(source, output, options, &Tuning::default(), monitor)
}

/// [`build`] with sizes that only tests change.
pub(super) fn build_tuned(
    source: &mut dyn TriangleSource,
    output: &Path,
    options: &BuildOptions,
    tuning: &Tuning,
    monitor: Monitor<'_>,
) -> Result<BuildReport> {
    options.validate()?;
    let folder = options.temp_folder(output);
    // Both at once, so that a folder that cannot be written is told before a long scan.
    temporary(&folder)?;
    let writer = OctWriter::create(output)?;
    let mut phases = Phases::new(monitor);

    phases.begin("scan");
    let faces = Faces::new(Spool::new(&folder, tuning.face_words), tuning.block_corners);
    let mut scan = scan(source, faces, monitor)?;
    phases.begin("join");
    let joined = join(&mut scan, &folder, tuning, monitor)?;
    check_joined(&joined, options, monitor)?;

    let source = Source::of(scan, &joined);
    let mut build = Build::new(&source, &joined, options, writer, monitor);
    build.run(joined.records, &folder, tuning, &mut phases)?;
    phases.begin("stitch");
    let mut report = build.finish(output)?;
    report.phases = phases.finish();
    Ok(report)
}

/// Says what the join dropped or could not do well; fails if nothing is left.
fn check_joined(joined: &Joined, options: &BuildOptions, monitor: Monitor<'_>) -> Result<()> {
    let (tally, dropped) = (&joined.tally, joined.tally.dropped);
    if tally.kept == 0 {
        let mut what = String::from("holds no triangles");
        if dropped != Default::default() {
            what += &format!(
                " that can be hit (dropped: {} of zero area, {} with a vertex that is not finite, {} with a bad index; \
                 {} faces with too few corners)",
                dropped.degenerate, dropped.non_finite, dropped.bad_index, dropped.too_few_corners
            );
        }
        if let Some(origin) = suggestion(tally, options) {
            what += &format!("; it lies far from zero, where single precision merges vertices: try --origin {origin}");
        }
        return Err(Error::Input { file: options.source_name(), what });
    }
    warn_if_merged(tally, options, monitor);
    if tally.polygons.fanned > 0 {
        monitor.warn(format!(
            "{} concave faces have more than {CLIP_LIMIT} corners and were cut as fans, which may overlap",
            tally.polygons.fanned
        ));
    }
    Ok(())
}

/// What is still needed of the scan after the join: positions and faces are gone.
struct Source {
    texcoords: super::blocks::Blocks<[f32; 2]>,
    normals: super::blocks::Blocks<[f32; 3]>,
    materials: Vec<crate::mesh::MaterialInfo>,
    vertices: u64,
    triangles: u64,
    root: RootCube,
}

impl Source {
    fn of(scan: Scan, joined: &Joined) -> Source {
        Source {
            vertices: scan.positions.len() as u64,
            triangles: scan.faces.triangles(),
            texcoords: scan.texcoords,
            normals: scan.normals,
            materials: scan.info.materials,
            root: RootCube::around(joined.tally.bounds),
        }
    }
}

/// A file being built, from the join on.
struct Build<'a> {
    source: &'a Source,
    options: &'a BuildOptions,
    monitor: Monitor<'a>,
    layout: Layout,
    bricks: BrickBuilder<'a>,
    rule: BrickRule,
    writer: OctWriter,
    records: Vec<Brick>,
    tops: Vec<TopBrick>,
    depths: Vec<u32>,
    report: BuildReport,
    bounds: crate::geometry::Aabb,
    attributes: u32,
}

impl<'a> Build<'a> {
    fn new(
        source: &'a Source,
        joined: &Joined,
        options: &'a BuildOptions,
        writer: OctWriter,
        monitor: Monitor<'a>,
    ) -> Self {
        let (tally, layout, root) = (joined.tally, joined.layout, source.root);
        // Where few vertices are shared, 16 triangles have more than 16 of them.
        let shares_few = joined.used_vertices as f64 > 0.75 * tally.kept as f64;
        let placement = Placement { root, split: options.split };
        Build {
            bricks: BrickBuilder {
                options,
                layout,
                root,
                unit: if shares_few { LeafUnit::B32 } else { LeafUnit::B16 },
                wide_materials: source.materials.len() > usize::from(u16::MAX),
                normals: &source.normals,
                texcoords: &source.texcoords,
            },
            rule: BrickRule { placement, limit: options.brick_limit(tally.kept), depth: options.depth.into() },
            report: BuildReport {
                triangles: tally.kept,
                source_triangles: source.triangles,
                vertices: source.vertices,
                dropped: tally.dropped,
                polygons: tally.polygons,
                merged: tally.merged,
                ..Default::default()
            },
            bounds: tally.bounds,
            attributes: 0,
            records: Vec::new(),
            tops: Vec::new(),
            depths: Vec::new(),
            source,
            options,
            monitor,
            layout,
            writer,
        }
    }

    /// Sorts the records into chunks if there are more than one, and writes all pages.
    fn run(&mut self, mut records: Spool, folder: &Path, tuning: &Tuning, phases: &mut Phases<'_>) -> Result<()> {
        let sorting = Sorting {
            folder,
            tuning,
            placement: self.rule.placement,
            limit: tuning.chunk.max(self.rule.limit.into()),
            depth: self.rule.depth,
            monitor: self.monitor,
        };
        let root = Unit { cell: CellCode::ROOT, triangles: self.report.triangles };
        let extents = vec![Extent { at: 0, words: records.len() }];
        let whole = Chunk { units: vec![root], extents };
        if self.is_small(&whole, sorting) {
            phases.begin("chunks");
            return match records.memory() {
                Some(words) => self.chunk(words, &whole.units),
                None => self.load(&mut records, &whole),
            };
        }
        let (mut spool, chunks) = self.sort(&mut records, &whole, sorting, phases)?;
        drop(records);
        phases.begin("chunks");
        self.chunks(&mut spool, &chunks, sorting, phases)
    }

    /// Whether a chunk is to be taken into memory as it is: it is small, or cannot be divided.
    fn is_small(&self, chunk: &Chunk, sorting: Sorting<'_>) -> bool {
        chunk.triangles() <= sorting.limit || chunk.units.len() > 1 || chunk.units[0].cell.level >= self.rule.depth
    }

    /// Sorts an overfull chunk (of one cell) into smaller ones.
    fn sort(
        &self,
        spool: &mut Spool,
        chunk: &Chunk,
        sorting: Sorting<'_>,
        phases: &mut Phases<'_>,
    ) -> Result<(Spool, Vec<Chunk>)> {
        let cell = chunk.units[0].cell;
        let mut records = Records { spool, extents: &chunk.extents, layout: self.layout };
        phases.begin("count");
        let units = sorting.count(&mut records, cell)?;
        phases.begin("distribute");
        sorting.distribute(&mut records, cell, &units)
    }

    /// Writes the pages of all chunks; one that is still overfull is sorted again, below its own cell.
    fn chunks(
        &mut self,
        spool: &mut Spool,
        chunks: &[Chunk],
        sorting: Sorting<'_>,
        phases: &mut Phases<'_>,
    ) -> Result<()> {
        for chunk in chunks {
            if self.is_small(chunk, sorting) {
                self.load(spool, chunk)?;
                continue;
            }
            let (mut spool, chunks) = self.sort(spool, chunk, sorting, phases)?;
            phases.begin("chunks");
            self.chunks(&mut spool, &chunks, sorting, phases)?;
        }
        Ok(())
    }

    fn load(&mut self, spool: &mut Spool, chunk: &Chunk) -> Result<()> {
        self.monitor.check()?;
        let words = Records { spool, extents: &chunk.extents, layout: self.layout }.load()?;
        self.chunk(&words, &chunk.units)
    }

    /// Writes the pages of a chunk in memory, built in parallel in waves of bounded size.
    fn chunk(&mut self, words: &[u32], units: &[Unit]) -> Result<()> {
        const WAVE: usize = 1 << 19;
        let lists = bricks(words, self.layout, units, self.rule);
        let mut rest = &lists[..];
        while !rest.is_empty() {
            self.monitor.check()?;
            let mut sum = 0;
            let fits = |list: &&BrickList| {
                sum += list.records.len();
                sum <= WAVE
            };
            let wave = rest.iter().take_while(fits).count().max(1);
            self.wave(&rest[..wave], words)?;
            rest = &rest[wave..];
        }
        Ok(())
    }

    fn wave(&mut self, lists: &[BrickList], words: &[u32]) -> Result<()> {
        let first = self.records.len() as u32;
        let (bricks, monitor) = (&self.bricks, self.monitor);
        let build = |(number, list): (u32, &BrickList)| {
            monitor.check()?;
            bricks.build(PageId(number), list, words)
        };
        let numbers = first..first + lists.len() as u32;
        let built: Vec<BuiltBrick> = numbers.into_par_iter().zip(lists).map(build).collect::<Result<_>>()?;
        built.into_iter().try_for_each(|brick| self.append(brick))?;
        // In strict mode triangles repeat, so that this is only near enough for a bar.
        let done = self.report.references.min(self.report.triangles);
        self.monitor.progress(done, Some(self.report.triangles), "triangles");
        Ok(())
    }

    fn append(&mut self, brick: BuiltBrick) -> Result<()> {
        let first = u32::try_from(self.report.references);
        let fits = self.report.references + u64::from(brick.references) <= u64::from(u32::MAX);
        let (Ok(first_reference), true) = (first, fits) else {
            return Err(Error::Option(format!(
                "the tree would hold more than {} references, which is the limit; use --split sah or a larger --cell",
                u32::MAX
            )));
        };
        self.writer.append(&brick.page)?;
        self.records.push(Brick { node: 0, first_reference, corner: brick.corner, unit: brick.unit });
        self.tops.push(brick.top);
        self.depths.push(brick.depth);
        self.report.references += u64::from(brick.references);
        self.report.nodes += brick.nodes;
        self.report.leaves += u64::from(brick.leaves);
        self.attributes |= if brick.normals { Flags::NORMALS } else { 0 };
        self.attributes |= if brick.texcoords { Flags::TEXCOORDS } else { 0 };
        Ok(())
    }

    /// Writes the top and the header, and gives the file its name.
    fn finish(mut self, output: &Path) -> Result<BuildReport> {
        self.monitor.check()?;
        let nodes = if self.tops.len() > 1 { build_top(&self.tops).0 } else { Vec::new() };
        let folder = output.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        // Only named where some face has one: then the file has material numbers too.
        let used: &[_] = if self.layout.materials { &self.source.materials } else { &[] };
        let (materials, strings) = materials(used, folder);
        let header = self.header(&nodes, materials.len());
        (self.report.nodes, self.report.depth) = (header.nodes, header.depth);
        self.report.pages = self.records.len() as u32;
        let top = Top { nodes: &nodes, bricks: &mut self.records, materials: &materials, strings: &strings };
        self.report.bytes = self.writer.finish(header, top)?;
        self.report.bytes_per_triangle = self.report.bytes as f64 / self.report.triangles as f64;
        Ok(self.report)
    }

    /// The header, but for what the writer fills in.
    fn header(&self, top: &[Node], materials: usize) -> Header {
        let report = &self.report;
        Header {
            flags: self.flags(),
            triangles: report.triangles,
            references: report.references,
            source_triangles: report.source_triangles,
            vertices: report.vertices,
            nodes: report.nodes + top.len() as u64,
            leaves: report.leaves,
            pages: self.records.len() as u32,
            top_nodes: top.len() as u32,
            materials: materials as u32,
            depth: self.depth(top),
            root_corner: self.source.root.corner.to_array(),
            origin: self.options.origin,
            root_log2_side: self.source.root.log2_side,
            bounds_min: self.bounds.min.to_array(),
            bounds_max: self.bounds.max.to_array(),
            brick_limit: self.rule.limit,
            cell_limit: self.options.cell,
            dropped: report.dropped,
            split: match self.options.split {
                SplitMode::Sah => 0,
                SplitMode::Octree => 1,
                SplitMode::Strict => 2,
            },
            leaf_limit: self.options.leaf,
            depth_limit: self.options.depth,
            ..Header::zeroed()
        }
    }

    /// Nodes on the longest path from the root down to a leaf.
    fn depth(&self, top: &[Node]) -> u32 {
        let above = top_levels(top, self.depths.len());
        above.iter().zip(&self.depths).map(|(above, below)| above + below).max().unwrap_or(0)
    }

    fn flags(&self) -> Flags {
        let repeats = self.rule.placement.repeats() || self.report.references > self.report.triangles;
        let flag = |mask: u32, set: bool| if set { mask } else { 0 };
        Flags(
            self.attributes
                | flag(Flags::IDS, self.options.ids)
                | flag(Flags::MATERIALS, self.layout.materials)
                | flag(Flags::WIDE_MATERIALS, self.layout.materials && self.bricks.wide_materials)
                | flag(Flags::LEAF_UNIT_32, self.bricks.unit == LeafUnit::B32)
                | flag(Flags::REPEATS, repeats),
        )
    }
}
