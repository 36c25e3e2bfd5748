//! Checks all of a file: every page, and what only shows over all pages or needs geometry.
//!
//! Opening and first use of a page check whatever could lead a reader astray. This adds what could only lead to wrong
//! pictures: that every triangle lies inside the boxes on the path down to it, that counts, bounds and depth are those
//! the header states, that no face is missing or stored twice, that gaps are zero.

use glam::DVec3;
use rayon::prelude::*;

use super::{Octree, Page};
use crate::error::Result;
use crate::event::Monitor;
use crate::format::{Flags, Frame, HEADER_BYTES, Node, PAGE_HEADER_BYTES, PageId, Slot};
use crate::geometry::{Aabb, FaceId, Triangle};

/// Pages that are checked in parallel before their facts are added up in order.
const BATCH: usize = 64;

/// A box in root units, exact.
#[derive(Clone, Copy)]
struct Cell {
    low: DVec3,
    high: DVec3,
}

/// A place in the tree: the frame of a node, and the box that all boxes on the path down to it share.
#[derive(Clone, Copy)]
struct Place {
    node: usize,
    /// Nodes on the path, this one included.
    depth: u32,
    frame: Frame,
    cell: Cell,
}

/// What the pages hold, added up.
struct Facts {
    nodes: u64,
    leaves: u64,
    depth: u32,
    bounds: Aabb,
}

impl Octree {
    /// Checks everything: every page, and what only shows over all pages (counts, depth, bounds, ids).
    ///
    /// Needs a bit for each source triangle where the file has face ids. Progress counts pages.
    pub fn verify(&self, monitor: Monitor<'_>) -> Result<()> {
        monitor.phase("verify");
        self.check_top()?;
        self.check_gaps()?;
        self.check_detail()?;
        let entries = self.brick_entries();
        let pages = self.header.pages as usize;
        let mut faces = Faces::new(self);
        let mut sum = Facts { nodes: u64::from(self.header.top_nodes), leaves: 0, depth: 0, bounds: Aabb::EMPTY };
        for begin in (0..pages).step_by(BATCH) {
            monitor.check()?;
            let batch = begin..(begin + BATCH).min(pages);
            let end = batch.end;
            let facts: Vec<_> = batch.clone().into_par_iter().map(|i| self.check_contents(i, &entries[i])).collect();
            for (i, facts) in batch.zip(facts) {
                sum = sum.and(facts?);
                faces.mark(self, PageId(i as u32))?;
            }
            monitor.progress(end as u64, Some(pages as u64), "pages");
        }
        self.check_sums(&sum, &faces)?;
        self.fault()
    }

    /// Compares what the pages hold with what the header says.
    fn check_sums(&self, sum: &Facts, faces: &Faces) -> Result<()> {
        let h = &self.header;
        let rules = [
            (sum.nodes == h.nodes, "nodes", sum.nodes, h.nodes),
            (sum.leaves == h.leaves, "leaves", sum.leaves, h.leaves),
            (faces.distinct == h.triangles, "distinct triangles", faces.distinct, h.triangles),
            (sum.depth == h.depth, "levels", u64::from(sum.depth), u64::from(h.depth)),
        ];
        if let Some((_, what, found, said)) = rules.iter().find(|(holds, ..)| !holds) {
            return Err(self.damaged(None, format!("the file holds {found} {what}, not {said} as the header says")));
        }
        if sum.bounds != self.bounds() {
            return Err(self.damaged(None, "the header's bounds are not those of the triangles".into()));
        }
        Ok(())
    }

    /// Bytes between pages and sections must be zero.
    fn check_gaps(&self) -> Result<()> {
        let pages = self.records().iter().map(|r| (r.offset, u64::from(r.stored_bytes)));
        let sections = self.header.sections.iter().filter(|s| s.kind != 0).map(|s| (s.offset, s.bytes));
        let mut end = HEADER_BYTES as u64;
        for (offset, bytes) in pages.chain(sections) {
            let gap = self.gap(end..offset)?;
            if gap.iter().any(|&b| b != 0) {
                return Err(self.damaged(None, format!("the gap before byte {offset} is not zero")));
            }
            end = offset + bytes;
        }
        Ok(())
    }

    /// Where the top tree enters each brick; `frame` is that of the brick record.
    fn brick_entries(&self) -> Vec<Place> {
        let whole = Cell { low: DVec3::ZERO, high: DVec3::ONE };
        let root = Place { node: 0, depth: 1, frame: Frame::ROOT, cell: whole };
        let bricks = self.bricks();
        let mut entries: Vec<Place> = bricks.iter().map(|b| Place { frame: brick_frame(b), ..root }).collect();
        walk(self.top_nodes(), root, |node, slot, place| {
            if let Some(Slot::Brick(rank)) = Slot::decode(node.slots[slot])
                && let Some(entry) = entries.get_mut(node.first_leaf as usize + usize::from(rank))
            {
                *entry = Place { frame: entry.frame, node: 0, depth: place.depth + 1, cell: place.cell };
            }
            Ok::<(), ()>(())
        })
        .unwrap_or(());
        entries
    }

    /// Checks a page and that each of its triangles lies inside the boxes on the path down to it.
    fn check_contents(&self, i: usize, entry: &Place) -> Result<Facts> {
        self.with_page(PageId(i as u32), |page| self.check_page(i, &page, entry))?
    }

    fn check_page(&self, i: usize, page: &Page<'_>, entry: &Place) -> Result<Facts> {
        let header = page.header();
        let mut facts =
            Facts { nodes: header.nodes.into(), leaves: header.leaves.into(), depth: entry.depth, bounds: Aabb::EMPTY };
        walk(page.nodes(), *entry, |node, slot, place| {
            facts.depth = facts.depth.max(place.depth);
            let Some(Slot::Leaf(offset)) = Slot::decode(node.slots[slot]) else { return Ok(()) };
            let units = 16 * node.first_leaf as usize + usize::from(offset) * self.leaf_unit().bytes();
            let leaf = page.leaf(PAGE_HEADER_BYTES + size_of::<Node>() * place.node + units);
            for triangle in (0..leaf.len()).map(|j| leaf.triangle(j)) {
                facts.bounds = facts.bounds.union(Aabb::from(&triangle));
                if !self.belongs(&triangle, &place.cell) {
                    return Err(format!("node {}, slot {slot}: a triangle lies outside the box", place.node));
                }
            }
            Ok(())
        })
        .map_err(|what| self.damaged(Some(i as u32), what))?;
        self.check_surrogates(i, page)?;
        Ok(facts)
    }

    /// Whether a triangle lies in a cell; where triangles are stored several times, whether it has a part there.
    ///
    /// Rounding to root units is monotone and planes are exact, so no triangle that is inside is taken for outside.
    fn belongs(&self, triangle: &Triangle, cell: &Cell) -> bool {
        let root = self.root();
        let [a, b, c] = triangle.vertices().map(|v| root.to_root_units(v));
        let (low, high) = (a.min(b).min(c), a.max(b).max(c));
        match self.flags().has(Flags::REPEATS) {
            true => low.cmple(cell.high).all() && cell.low.cmple(high).all(),
            false => cell.low.cmple(low).all() && high.cmple(cell.high).all(),
        }
    }
}

impl Facts {
    /// Both together.
    fn and(self, other: Facts) -> Facts {
        Facts {
            nodes: self.nodes + other.nodes,
            leaves: self.leaves + other.leaves,
            depth: self.depth.max(other.depth),
            bounds: self.bounds.union(other.bounds),
        }
    }
}

/// Calls `visit` for every used slot below `root` with its node, slot, and the node's place with the cell narrowed to the slot's box.
fn walk<E>(nodes: &[Node], root: Place, mut visit: impl FnMut(&Node, usize, &Place) -> Result<(), E>) -> Result<(), E> {
    let mut stack = vec![root];
    while let Some(place) = stack.pop() {
        let Some(node) = nodes.get(place.node) else { continue };
        for (slot, &byte) in node.slots.iter().enumerate() {
            let inside = Place { cell: place.cell.narrow(node, slot, &place.frame), ..place };
            match Slot::decode(byte) {
                Some(Slot::Inner(rank)) if node.first_child != 0 => stack.push(Place {
                    node: place.node + node.first_child as usize + usize::from(rank),
                    depth: place.depth + 1,
                    frame: place.frame.child(node, slot),
                    cell: inside.cell,
                }),
                Some(Slot::Leaf(_)) if node.first_leaf == 0 => {}
                Some(Slot::Brick(_) | Slot::Leaf(_)) => visit(node, slot, &inside)?,
                _ => {}
            }
        }
    }
    Ok(())
}

impl Cell {
    /// The part of the cell inside a slot's box.
    fn narrow(&self, node: &Node, slot: usize, frame: &Frame) -> Cell {
        let corner = DVec3::from_array(frame.corner);
        let unit = DVec3::from_array(frame.unit);
        let plane = |planes: &[[u8; 8]; 3]| corner + unit * DVec3::from_array(planes.map(|p| f64::from(p[slot])));
        Cell { low: self.low.max(plane(&node.low)), high: self.high.min(plane(&node.high)) }
    }
}

/// The frame of a brick's root.
pub(super) fn brick_frame(brick: &crate::format::Brick) -> Frame {
    Frame { corner: brick.corner.map(f64::from), unit: brick.unit.map(f64::from) }
}

/// Which faces were met.
struct Faces {
    /// A bit a source triangle; empty where the file has no ids.
    seen: Vec<u64>,
    distinct: u64,
}

impl Faces {
    fn new(octree: &Octree) -> Faces {
        let words = octree.header.source_triangles.div_ceil(64) as usize;
        Faces { seen: vec![0; if octree.flags().has(Flags::IDS) { words } else { 0 }], distinct: 0 }
    }

    /// Marks the faces of a page that was checked. A face met twice is an error unless the flags allow it.
    fn mark(&mut self, octree: &Octree, id: PageId) -> Result<()> {
        octree.with_page(id, |page| self.mark_page(octree, id, &page))?
    }

    fn mark_page(&mut self, octree: &Octree, id: PageId, page: &Page<'_>) -> Result<()> {
        let references = page.header().references;
        if self.seen.is_empty() {
            self.distinct += u64::from(references); // Numbers in the file, distinct by themselves.
            return Ok(());
        }
        for FaceId(face) in (0..references).map(|r| page.face(r)) {
            let Some(word) = self.seen.get_mut(face as usize / 64) else { continue };
            let fresh = *word >> (face % 64) & 1 == 0;
            *word |= 1 << (face % 64);
            self.distinct += u64::from(fresh);
            if !fresh && !octree.flags().has(Flags::REPEATS) {
                return Err(octree.damaged(Some(id.0), format!("face {face} is stored twice")));
            }
        }
        Ok(())
    }
}
