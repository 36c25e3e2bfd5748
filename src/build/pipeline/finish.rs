//! The last phase: the top of the tree and the header.

use std::path::Path;

use bytemuck::Zeroable;

use super::super::materials::materials;
use super::super::report::BuildReport;
use super::super::subtree::{build_top, top_levels, top_surrogates};
use super::Build;
use crate::error::{Result, folder_of};
use crate::format::{Brick, Flags, Header, LeafUnit, Node, Points, SplitMode, Surrogate, Top};

impl Build<'_> {
    /// Writes the top and the header, and gives the file its name.
    pub(super) fn finish(mut self, output: &Path) -> Result<BuildReport> {
        self.monitor.check()?;
        let nodes = if self.tops.len() > 1 { build_top(&self.tops).0 } else { Vec::new() };
        // Only named where some face has one: then the file has material numbers too.
        let used: &[_] = if self.layout.materials { &self.mesh.materials } else { &[] };
        let (materials, strings) = materials(used, folder_of(output));
        let header = self.header(&nodes, materials.len());
        (self.report.nodes, self.report.depth) = (header.nodes, header.depth);
        self.report.pages = self.records.len() as u32;
        let tops = &self.tops;
        let surrogates = &mut |bricks: &[Brick], roots: &[Surrogate]| top_surrogates(&nodes, tops, bricks, roots);
        let bricks = &mut self.records;
        let top = Top { nodes: &nodes, bricks, materials: &materials, strings: &strings, surrogates };
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
            root_corner: self.mesh.root.corner.to_array(),
            origin: self.options.origin,
            root_log2_side: self.mesh.root.log2_side,
            bounds_min: self.mesh.tally.bounds.min.to_array(),
            bounds_max: self.mesh.tally.bounds.max.to_array(),
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

    pub(super) fn flags(&self) -> Flags {
        let repeats = self.rule.placement.repeats() || self.report.references > self.report.triangles;
        let flag = |mask: u32, set: bool| if set { mask } else { 0 };
        Flags(
            self.attributes
                | flag(Flags::PACKED, self.options.compress.is_some())
                | flag(Flags::IDS, self.options.ids)
                | flag(Flags::DETAIL, self.options.lod)
                | flag(Flags::MATERIALS, self.layout.materials)
                | flag(Flags::WIDE_MATERIALS, self.layout.materials && self.bricks.wide_materials)
                | flag(Flags::STEPS, self.options.positions.points() == Points::Steps)
                | flag(Flags::LEAF_UNIT_32, self.bricks.unit == LeafUnit::B32)
                | flag(Flags::REPEATS, repeats),
        )
    }
}
