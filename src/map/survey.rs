//! What a file's bytes are spent on.

use super::{Octree, Page};
use crate::error::Result;
use crate::event::Monitor;
use crate::format::{Flags, LEAF_MAX, Leaf, PAGE_HEADER_BYTES, PageId, Points, SectionKind};

/// Bytes of a file by what they are; they add up to the file's length, or, for a packed file, to what it would be unpacked, without
/// the zeros between pages.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Parts {
    /// The header page.
    pub header: u64,
    /// Top nodes, brick, page and material records, strings.
    pub top: u64,
    /// Headers of pages.
    pub page_headers: u64,
    /// Nodes in pages.
    pub nodes: u64,
    /// Heads and corners of leaves.
    pub leaf_corners: u64,
    /// Vertices of leaves.
    pub leaf_vertices: u64,
    /// How many leaves hold their vertices as steps.
    pub step_leaves: u64,
    /// Face ids.
    pub ids: u64,
    /// Material numbers.
    pub materials: u64,
    /// Normals and their corners.
    pub normals: u64,
    /// Texture coordinates and their corners.
    pub texcoords: u64,
    /// Surrogates and heads, for level of detail.
    pub detail: u64,
    /// Zeros, anywhere.
    pub padding: u64,
    /// How many leaves have i triangles, at place i.
    pub leaves_by_triangles: [u64; LEAF_MAX + 1],
}

impl Octree {
    /// Adds up what the file's bytes are spent on; reads every page. Progress counts pages.
    pub fn parts(&self, monitor: Monitor<'_>) -> Result<Parts> {
        monitor.phase("survey");
        let sections = self.header.sections.iter().filter(|s| s.kind != 0);
        let mut parts = Parts {
            header: crate::format::HEADER_BYTES as u64,
            top: sections.clone().filter(|s| s.kind < SectionKind::Heads as u32).map(|s| s.bytes).sum(),
            detail: sections.filter(|s| s.kind >= SectionKind::Heads as u32).map(|s| s.bytes).sum(),
            ..Parts::default()
        };
        self.check_top()?;
        for i in 0..self.header.pages {
            monitor.check()?;
            self.with_page(PageId(i), |page| parts.add_page(self, &page))?;
            monitor.progress(u64::from(i) + 1, Some(self.header.pages.into()), "pages");
        }
        self.fault()?;
        parts.padding = self.header.file_bytes.saturating_sub(parts.known());
        Ok(parts)
    }
}

impl Parts {
    /// All but the padding.
    fn known(&self) -> u64 {
        let pages = self.page_headers + self.nodes + self.leaf_corners + self.leaf_vertices;
        self.header + self.top + pages + self.ids + self.materials + self.normals + self.texcoords + self.detail
    }

    fn add_page(&mut self, octree: &Octree, page: &Page<'_>) {
        let h = page.header();
        let references = u64::from(h.references);
        let there = |offset: u32, bytes: u64| if offset == 0 { 0 } else { bytes * references };
        self.page_headers += PAGE_HEADER_BYTES as u64;
        self.nodes += size_of_val(page.nodes()) as u64;
        self.ids += there(h.ids, 4);
        self.materials += there(h.materials, if octree.flags().has(Flags::WIDE_MATERIALS) { 4 } else { 2 });
        self.normals += there(h.normal_corners, 12) + 12 * u64::from(h.normal_count);
        self.texcoords += there(h.texcoord_corners, 12) + 8 * u64::from(h.texcoord_count);
        self.detail += size_of_val(page.surrogates()) as u64;
        for leaf in leaves(octree, page) {
            self.leaf_corners += leaf.vertices_at() as u64;
            self.leaf_vertices += (leaf.end() - leaf.vertices_at()) as u64;
            self.step_leaves += u64::from(leaf.points() == Points::Steps);
            self.leaves_by_triangles[leaf.len()] += 1;
        }
    }
}

/// The leaves of a page as they lie.
fn leaves<'a>(octree: &Octree, page: &Page<'a>) -> impl Iterator<Item = Leaf<'a>> + use<'a> {
    let (page, unit) = (*page, octree.leaf_unit());
    let mut at = page.header().leaf_offset as usize;
    std::iter::from_fn(move || {
        let leaf = page.leaf(at);
        at += leaf.size(unit);
        (!leaf.is_empty()).then_some(leaf)
    })
}
