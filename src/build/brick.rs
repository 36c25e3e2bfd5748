//! The fifth phase, second half: a brick becomes a page.

use std::collections::HashMap;
use std::hash::Hash;

use crate::error::{Error, Result};
use crate::format::{LeafUnit, PageHeader, PageId, SideArrays};
use crate::geometry::RootCube;
use crate::mesh::NO_INDEX;

use super::blocks::Blocks;
use super::chunk::BrickList;
use super::options::BuildOptions;
use super::record::Layout;
use super::subtree::{BrickTriangle, Subtree, SubtreeOptions, TopBrick, build_subtree};

/// What all bricks of a file share.
pub(super) struct BrickBuilder<'a> {
    pub options: &'a BuildOptions,
    pub layout: Layout,
    pub root: RootCube,
    pub unit: LeafUnit,
    pub wide_materials: bool,
    pub normals: &'a Blocks<[f32; 3]>,
    pub texcoords: &'a Blocks<[f32; 2]>,
}

/// A finished page and what the top needs to know of it.
pub(super) struct BuiltBrick {
    pub page: Vec<u8>,
    pub top: TopBrick,
    pub corner: [f32; 3],
    pub unit: [f32; 3],
    pub references: u32,
    pub nodes: u64,
    pub leaves: u32,
    pub depth: u32,
    /// Whether the page has any normals.
    pub normals: bool,
    /// Whether the page has any texture coordinates.
    pub texcoords: bool,
}

impl BrickBuilder<'_> {
    /// Builds the page of a brick whose records lie in `words`.
    pub fn build(&self, page: PageId, brick: &BrickList, words: &[u32]) -> Result<BuiltBrick> {
        let record = |place: u32| {
            let at = place as usize * self.layout.words();
            &words[at..at + self.layout.words()]
        };
        let triangle = |&place: &u32| {
            let record = record(place);
            BrickTriangle { triangle: self.layout.triangle(record), face: self.layout.id(record) }
        };
        let triangles: Vec<BrickTriangle> = brick.records.iter().map(triangle).collect();
        let cell = brick.cell.cell();
        let subtree = build_subtree(&triangles, cell, self.root, &self.subtree_options());
        let side = self.side_arrays(subtree.order.iter().map(|&i| record(brick.records[i as usize])));
        let Subtree { nodes, leaf_bytes, leaves, order, corner, unit, depth, bounds_root } = subtree;
        let references = order.len() as u32;
        let bytes = PageHeader::layout(page, &nodes, &leaf_bytes, leaves, references, &side, self.wide_materials);
        let page = bytes.ok_or_else(|| {
            Error::Option(format!("a page of {references} triangles would pass 4 GiB; give a smaller --brick"))
        })?;
        Ok(BuiltBrick {
            page,
            top: TopBrick { cell, bounds_root },
            corner,
            unit,
            references,
            nodes: nodes.len() as u64,
            leaves,
            depth,
            normals: !side.normal_corners.is_empty(),
            texcoords: !side.texcoord_corners.is_empty(),
        })
    }

    fn subtree_options(&self) -> SubtreeOptions {
        SubtreeOptions {
            split: self.options.split,
            leaf: self.options.leaf.into(),
            cell: self.options.cell as usize,
            depth: self.options.depth.into(),
            unit: self.unit,
            // Without ids a triangle stored twice would be two triangles.
            repeats: self.options.ids,
        }
    }

    /// The side arrays over records in the order of their references.
    fn side_arrays<'r>(&self, records: impl Iterator<Item = &'r [u32]>) -> SideArrays {
        let mut side = SideArrays::default();
        let (mut normals, mut texcoords) = (Table::new(), Table::new());
        for record in records {
            if self.options.ids {
                side.ids.push(self.layout.id(record));
            }
            side.materials.extend(self.layout.material(record));
            normals.push(self.layout.normals(record), |n| self.normals.get(n), |n| n.map(f32::to_bits));
            texcoords.push(self.layout.texcoords(record), |n| self.texcoords.get(n), |t| t.map(f32::to_bits));
        }
        (side.normal_corners, side.normals) = normals.finish();
        (side.texcoord_corners, side.texcoords) = texcoords.finish();
        side
    }
}

/// Attributes of a page, merged by their bits, in the order of first use.
struct Table<T, K> {
    corners: Vec<[u32; 3]>,
    values: Vec<T>,
    places: HashMap<K, u32>,
}

impl<T: Copy, K: Hash + Eq> Table<T, K> {
    fn new() -> Self {
        Table { corners: Vec::new(), values: Vec::new(), places: HashMap::new() }
    }

    /// Adds the corners of a reference.
    fn push(&mut self, numbers: Option<[u32; 3]>, get: impl Fn(u32) -> Option<T>, key: impl Fn(T) -> K) {
        let Some(numbers) = numbers else { return };
        let corners = numbers.map(|number| {
            let Some(value) = get(number) else { return NO_INDEX };
            *self.places.entry(key(value)).or_insert_with(|| {
                self.values.push(value);
                self.values.len() as u32 - 1
            })
        });
        self.corners.push(corners);
    }

    /// The arrays; empty where no corner has a value.
    fn finish(self) -> (Vec<[u32; 3]>, Vec<T>) {
        if self.values.is_empty() { Default::default() } else { (self.corners, self.values) }
    }
}
