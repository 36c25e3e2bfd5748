//! What lies on each level of a file's tree, and how full its pages and leaves are: one pass over the pages.
//!
//! Memory: a byte a page for the level of its root, else nothing that grows with the file.

use octrace::format::{Flags, HEADER_BYTES, LEAF_MAX, Node, PAGE_HEADER_BYTES, PageId, SectionKind, Slot};
use octrace::map::{Octree, Page};
use octrace::{Monitor, Result};

/// What bytes are for.
pub const KINDS: [&str; 7] =
    ["nodes", "leaf corners", "leaf vertices", "ids", "materials", "normals, texture", "level of detail"];
/// Places in [`KINDS`].
const NODES: usize = 0;
const CORNERS: usize = 1;
const VERTICES: usize = 2;
const IDS: usize = 3;
const MATERIALS: usize = 4;
const ATTRIBUTES: usize = 5;
const DETAIL: usize = 6;
/// Parts of the most triangles that a page may have.
pub const FILL_BINS: usize = 20;

/// One level of the tree; the root's is the first.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Level {
    /// Pages whose root lies here.
    pub pages: u64,
    /// Inner nodes.
    pub nodes: u64,
    /// Leaves.
    pub leaves: u64,
    /// Triangles in these, as often as they are stored.
    pub triangles: u64,
    /// Bytes by [`KINDS`]; tables that a page's triangles share are shared out among its leaves.
    pub bytes: [f64; KINDS.len()],
}

/// All that is counted.
#[derive(Clone, Debug, PartialEq)]
pub struct Census {
    /// From the root down.
    pub levels: Vec<Level>,
    /// Pages by how full they are, in [`FILL_BINS`]th parts of the most triangles; fuller ones in the last.
    pub fill: [u64; FILL_BINS],
    /// Leaves of i triangles, at place i.
    pub leaves_by_triangles: [u64; LEAF_MAX + 1],
    /// Bytes that belong to no level.
    pub header: u64,
    /// Brick and page records, materials, strings.
    pub records: u64,
    /// Headers of pages.
    pub page_headers: u64,
    /// Heads: for level of detail, beside the pages.
    pub heads: u64,
    /// Zeros, anywhere.
    pub padding: u64,
}

impl Level {
    /// All its bytes.
    pub fn total(&self) -> f64 {
        self.bytes.iter().sum()
    }
}

impl Census {
    /// Reads every page.
    pub fn of(octree: &Octree, monitor: Monitor<'_>) -> Result<Census> {
        monitor.phase("map");
        let header = octree.header();
        let section =
            |kind: SectionKind| header.sections.iter().filter(|s| s.kind == kind as u32).map(|s| s.bytes).sum::<u64>();
        let sum = |kinds: &[SectionKind]| kinds.iter().map(|&kind| section(kind)).sum::<u64>();
        let mut census = Census {
            levels: Vec::new(),
            fill: [0; FILL_BINS],
            leaves_by_triangles: [0; LEAF_MAX + 1],
            header: HEADER_BYTES as u64,
            records: sum(&[SectionKind::Bricks, SectionKind::Pages, SectionKind::Materials, SectionKind::Strings]),
            page_headers: PAGE_HEADER_BYTES as u64 * u64::from(header.pages),
            heads: sum(&[SectionKind::Heads, SectionKind::HeadPlaces]),
            padding: 0,
        };
        let roots = census.add_top(octree);
        for (i, &root) in (0..header.pages).zip(&roots) {
            monitor.check()?;
            octree.with_page(PageId(i), |page| census.add_page(octree, &page, usize::from(root)))?;
            monitor.progress(u64::from(i) + 1, Some(header.pages.into()), "pages");
        }
        octree.fault()?;
        census.padding = header.file_bytes.saturating_sub(census.known());
        Ok(census)
    }

    /// All bytes but the padding.
    pub fn known(&self) -> u64 {
        let levels = self.levels.iter().map(Level::total).sum::<f64>().round() as u64;
        self.header + self.records + self.page_headers + self.heads + levels
    }

    /// The level of that number, made where it is new.
    fn level(&mut self, number: usize) -> &mut Level {
        if self.levels.len() <= number {
            self.levels.resize(number + 1, Level::default());
        }
        &mut self.levels[number]
    }

    /// Counts the top nodes; the level on which each page has its root.
    fn add_top(&mut self, octree: &Octree) -> Vec<u8> {
        let mut roots = vec![0u8; octree.header().pages as usize];
        let nodes = octree.top_nodes();
        let mut open = vec![(0usize, 0usize)];
        while let Some((i, depth)) = open.pop() {
            let Some(node) = nodes.get(i) else { continue };
            self.add_node(depth, octree.flags());
            for &byte in &node.slots {
                match Slot::decode(byte) {
                    Some(Slot::Inner(rank)) if node.first_child != 0 => open.push((child(i, node, rank), depth + 1)),
                    Some(Slot::Brick(rank)) => {
                        let brick = node.first_leaf as usize + usize::from(rank);
                        roots.get_mut(brick).into_iter().for_each(|root| *root = (depth + 1) as u8);
                    }
                    _ => {}
                }
            }
        }
        roots
    }

    fn add_node(&mut self, depth: usize, flags: Flags) {
        let level = self.level(depth);
        level.nodes += 1;
        level.bytes[NODES] += size_of::<Node>() as f64;
        level.bytes[DETAIL] += if flags.has(Flags::DETAIL) { 16.0 } else { 0.0 };
    }

    /// Counts a page whose root lies on that level. A page is checked before it is given: no path in it is longer than 64 nodes, and each node is on
    /// one path.
    fn add_page(&mut self, octree: &Octree, page: &Page<'_>, root: usize) {
        let (header, flags) = (page.header(), octree.flags());
        let most = u64::from(octree.header().brick_limit).max(1);
        let bin = u64::from(header.references) * FILL_BINS as u64 / most;
        self.fill[(bin as usize).min(FILL_BINS - 1)] += 1;
        self.level(root).pages += 1;
        let there = |offset: u32, bytes: u64| if offset == 0 { 0.0 } else { bytes as f64 };
        // Of what lies beside the leaves, bytes a reference.
        let share = |table: u64| table as f64 / f64::from(header.references.max(1));
        let material = if flags.has(Flags::WIDE_MATERIALS) { 4 } else { 2 };
        let mut beside = [0.0; KINDS.len()];
        beside[IDS] = there(header.ids, 4);
        beside[MATERIALS] = there(header.materials, material);
        beside[ATTRIBUTES] = there(header.normal_corners, 12)
            + there(header.texcoord_corners, 12)
            + share(12 * u64::from(header.normal_count) + 8 * u64::from(header.texcoord_count));
        let nodes = page.nodes();
        let mut open = vec![(0usize, root)];
        while let Some((i, depth)) = open.pop() {
            let Some(node) = nodes.get(i) else { continue };
            self.add_node(depth, flags);
            for &byte in &node.slots {
                match Slot::decode(byte) {
                    Some(Slot::Inner(rank)) if node.first_child != 0 => open.push((child(i, node, rank), depth + 1)),
                    Some(Slot::Leaf(units)) if node.first_leaf != 0 => {
                        let units = 16 * node.first_leaf as usize + usize::from(units) * octree.leaf_unit().bytes();
                        let leaf = page.leaf(PAGE_HEADER_BYTES + size_of::<Node>() * i + units);
                        self.leaves_by_triangles[leaf.len()] += 1;
                        let level = self.level(depth + 1);
                        level.leaves += 1;
                        level.triangles += leaf.len() as u64;
                        beside.iter().zip(&mut level.bytes).for_each(|(each, sum)| *sum += each * leaf.len() as f64);
                        level.bytes[CORNERS] += leaf.vertices_at() as f64;
                        level.bytes[VERTICES] += (leaf.end() - leaf.vertices_at()) as f64;
                    }
                    _ => {}
                }
            }
        }
    }
}

/// Where the inner child of that rank of node `i` lies.
fn child(i: usize, node: &Node, rank: u8) -> usize {
    i + node.first_child as usize + usize::from(rank)
}

#[cfg(test)]
pub mod tests {
    use super::*;
    use octrace::build::{BuildOptions, build};
    use octrace::mesh::{self, ReadOptions};

    /// A file of a sheet of 7200 triangles, in pages of at most `brick`.
    pub fn sheet(brick: u32, lod: bool) -> (tempfile::TempDir, Octree) {
        let folder = tempfile::tempdir().unwrap();
        let (obj, oct) = (folder.path().join("sheet.obj"), folder.path().join("sheet.oct"));
        let n = 60;
        let grid = |n: usize| (0..n).flat_map(move |i| (0..n).map(move |j| (i, j)));
        let point = |(i, j): (usize, usize)| format!("v {i} {j} {}\n", (0.3 * i as f64).sin() + (0.2 * j as f64).cos());
        let corner = |i: usize, j: usize| i * (n + 1) + j + 1;
        let face = |(i, j): (usize, usize)| {
            format!("f {} {} {} {}\n", corner(i, j), corner(i + 1, j), corner(i + 1, j + 1), corner(i, j + 1))
        };
        let text: String = grid(n + 1).map(point).chain(grid(n).map(face)).collect();
        std::fs::write(&obj, text).unwrap();
        let options = BuildOptions { brick: Some(brick), lod, ..BuildOptions::default() };
        let mut source = mesh::open(&obj, &ReadOptions::default()).unwrap();
        build(source.as_mut(), &oct, &options, Monitor::silent()).unwrap();
        let octree = Octree::open(&oct).unwrap();
        (folder, octree)
    }

    #[test]
    fn levels_add_up_to_the_file() {
        for (brick, lod) in [(500, true), (500, false), (1 << 18, true)] {
            let (_folder, octree) = sheet(brick, lod);
            let census = Census::of(&octree, Monitor::silent()).unwrap();
            let (header, parts) = (octree.header(), octree.parts(Monitor::silent()).unwrap());
            let sum = |of: &dyn Fn(&Level) -> u64| census.levels.iter().map(of).sum::<u64>();
            assert_eq!(sum(&|l| l.pages), u64::from(header.pages));
            assert_eq!((sum(&|l| l.nodes), sum(&|l| l.leaves)), (header.nodes, header.leaves));
            assert_eq!((sum(&|l| l.triangles), census.levels.len()), (header.references, header.depth as usize + 1));
            let bytes = |kind: usize| census.levels.iter().map(|l| l.bytes[kind]).sum::<f64>().round() as u64;
            assert_eq!(bytes(CORNERS) + bytes(VERTICES), parts.leaf_corners + parts.leaf_vertices);
            assert_eq!((bytes(IDS), bytes(DETAIL) + census.heads), (parts.ids, parts.detail));
            assert_eq!(bytes(NODES), 64 * header.nodes);
            assert_eq!((census.known() + census.padding, census.padding), (header.file_bytes, parts.padding));
            assert_eq!(census.leaves_by_triangles, parts.leaves_by_triangles);
            assert_eq!(census.fill.iter().sum::<u64>(), u64::from(header.pages));
            // The root's level has the root alone, the last only leaves.
            assert_eq!((census.levels[0].nodes, census.levels[0].leaves), (1, 0));
            assert_eq!(census.levels.last().map(|l| l.nodes), Some(0));
        }
    }
}
