//! The fifth phase, second half: a brick becomes a page.

use std::collections::HashMap;

use glam::Vec3;

use crate::error::{Error, Result};
use crate::format::{LeafUnit, PageHeader, PageId, SideArrays, pack};
use crate::geometry::{Aabb, RootCube};
use crate::mesh::NO_INDEX;

use super::chunk::BrickList;
use super::options::BuildOptions;
use super::record::Layout;
use super::subtree::{BrickTriangle, Subtree, SubtreeOptions, TopBrick, build_subtree_within, surrogates};

/// What all bricks of a file share.
pub(super) struct BrickBuilder<'a> {
    pub options: &'a BuildOptions,
    pub layout: Layout,
    pub root: RootCube,
    pub unit: LeafUnit,
    pub wide_materials: bool,
    /// Diffuse colours by material number - 1.
    pub colors: Vec<Vec3>,
}

/// A finished page and what the top needs to know of it.
pub(super) struct BuiltBrick {
    pub page: Vec<u8>,
    /// The page as it is to be stored, if packed.
    pub packed: Option<Vec<u8>>,
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
    /// Builds the page of a brick whose records lie in `words`; `None` if it is a strict one that takes more than `memory` bytes.
    pub fn build(&self, page: PageId, brick: &BrickList, words: &[u32], memory: u64) -> Result<Option<BuiltBrick>> {
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
        let parts: Vec<Aabb> = match self.layout.parts {
            true => brick.records.iter().map(|&place| self.layout.bounds(record(place))).collect(),
            false => Vec::new(),
        };
        let subtree = build_subtree_within(&triangles, &parts, cell, self.root, &self.subtree_options(), memory);
        let Some(subtree) = subtree else { return Ok(None) };
        let mut side = self.side_arrays(subtree.order.iter().map(|&i| record(brick.records[i as usize])));
        if self.options.lod {
            let material = |i: u32| self.layout.material(record(brick.records[i as usize])).unwrap_or(0);
            let color = |i: u32| self.colors.get((material(i) as usize).wrapping_sub(1)).copied().unwrap_or(Vec3::ONE);
            side.surrogates = surrogates(&subtree, self.root, self.unit, color);
        }
        let Subtree { nodes, leaf_bytes, leaves, order, corner, unit, depth, bounds_root } = subtree;
        let references = order.len() as u32;
        let bytes = PageHeader::layout(page, &nodes, &leaf_bytes, leaves, references, &side, self.wide_materials);
        let page = bytes.ok_or_else(|| {
            Error::Option(format!("a page of {references} triangles would pass 4 GiB; give a smaller --brick"))
        })?;
        let packed = self.options.compress.map(|level| pack(&page, level)).transpose();
        Ok(Some(BuiltBrick {
            packed: packed.map_err(Error::io("memory", "pack a page in"))?,
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
        }))
    }

    fn subtree_options(&self) -> SubtreeOptions {
        SubtreeOptions {
            split: self.options.split,
            leaf: self.options.leaf.into(),
            cell: self.options.cell as usize,
            depth: self.options.depth.into(),
            unit: self.unit,
            points: self.options.positions.points(),
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
            normals.push(self.layout.normals(record));
            texcoords.push(self.layout.texcoords(record));
        }
        (side.normal_corners, side.normals) = normals.finish();
        (side.texcoord_corners, side.texcoords) = texcoords.finish();
        side
    }
}

/// Attributes of a page, merged by their bits, in the order of first use.
struct Table<const N: usize> {
    corners: Vec<[u32; 3]>,
    values: Vec<[f32; N]>,
    places: HashMap<[u32; N], u32>,
}

impl<const N: usize> Table<N> {
    fn new() -> Self {
        Table { corners: Vec::new(), values: Vec::new(), places: HashMap::new() }
    }

    /// Adds the corners of a reference; one whose value is not finite has none.
    fn push(&mut self, corners: Option<[[f32; N]; 3]>) {
        let Some(corners) = corners else { return };
        let places = corners.map(|value| {
            if !value.iter().all(|x| x.is_finite()) {
                return NO_INDEX;
            }
            *self.places.entry(value.map(f32::to_bits)).or_insert_with(|| {
                self.values.push(value);
                self.values.len() as u32 - 1
            })
        });
        self.corners.push(places);
    }

    /// The arrays; empty where no corner has a value.
    fn finish(self) -> (Vec<[u32; 3]>, Vec<[f32; N]>) {
        if self.values.is_empty() { Default::default() } else { (self.corners, self.values) }
    }
}
