//! From the triangles of one brick to its nodes and leaves, and from bricks to the top tree.
//!
//! A brick is an octree cell (or the whole mesh). Its triangles are put into a canonical order (Morton code, then face),
//! so that the result depends on the set of triangles alone. Then one of three ways to split makes an 8-wide tree in
//! exact boxes ([`wide`]): surface-area splits ([`sah`]; mended, with [`spatial`] ones, where triangles are uneven: [`choice`]) and an optimal collapse
//! ([`collapse`]), true octants
//! ([`octree`]), or true octants with a reference in every overlapped cell ([`strict`]). [`emit`] quantises it into the
//! records of FORMAT.md.
//!
//! Memory, sah mode, bytes a triangle: 16 for sorting, freed before 32 (box and number), about 40 (binary nodes) and 20
//! to 25 (wide tree, nodes, leaves), 4 for the order: at most some 110 above the input's 40; where a tree is mended its
//! nodes twice; where spatial splits are tried all of it up to 30 % more, and the lists of a split, 40 a triangle while it is
//! made. Octree mode: 12 instead of the first two;
//! strict mode: per reference, and at most 32 of those a triangle. Where triangles were cut before the brick was made, each record is
//! counted as a triangle, and takes 24 (its box in the input) and 28 (number and box, sorted) more.
//!
//! Not done here: choosing bricks, side arrays, pages.

mod assign;
mod binning;
mod cell;
mod choice;
mod clip;
mod collapse;
mod emit;
mod lod;
mod octree;
mod order;
mod primitive;
mod quantise;
mod record;
mod reinsert;
mod sah;
mod spatial;
mod strict;
#[cfg(test)]
mod tests;
mod top;
mod wide;

pub use cell::{Cell, cell_of, overlaps};
pub use clip::cut_box;
pub use lod::{surrogates, top_surrogates};
pub use top::{TopBrick, build_top, top_levels};
pub(crate) use wide::Bounds;

use crate::format::{LeafUnit, Node, Points, SplitMode};
use crate::geometry::{Aabb, RootCube, Triangle};

/// A triangle of a brick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BrickTriangle {
    /// The triangle; finite.
    pub triangle: Triangle,
    /// Its id in the source.
    pub face: u32,
}

/// How to split.
#[derive(Clone, Copy, Debug)]
pub struct SubtreeOptions {
    /// The way to split.
    pub split: SplitMode,
    /// Most triangles in a leaf record, 1..=16.
    pub leaf: usize,
    /// Octree and strict modes: most triangles in a cell; `usize::MAX` = all.
    pub cell: usize,
    /// Octree and strict modes: depth limit in levels from the root cube, 0..=21.
    pub depth: u32,
    /// Unit of leaf offsets, which decides how many vertices a leaf may have.
    pub unit: LeafUnit,
    /// How vertices are to be stored where they can be.
    pub points: Points,
    /// Sah mode: whether a triangle may be stored in several leaves (spatial splits), each of which covers a part of it.
    pub repeats: bool,
}

/// The nodes and leaves of a brick.
#[derive(Clone, Debug, PartialEq)]
pub struct Subtree {
    /// Nodes, the root first; at least one. `first_leaf` counts on the leaves lying right after the nodes.
    pub nodes: Vec<Node>,
    /// Leaf records.
    pub leaf_bytes: Vec<u8>,
    /// How many leaves.
    pub leaves: u32,
    /// Reference r stands for the input's triangle `order[r]`; repeats in strict mode and with spatial splits.
    pub order: Vec<u32>,
    /// Brick frame: corner in root units.
    pub corner: [f32; 3],
    /// Brick frame: unit in root units.
    pub unit: [f32; 3],
    /// Nodes on the longest path from the brick's root to a leaf.
    pub depth: u32,
    /// Lowest and highest corner, in root units (to 2^-53), of what the brick is responsible for.
    pub bounds_root: [[f64; 3]; 2],
}

/// Builds the nodes and leaves of one brick from at least one triangle.
///
/// In octree and strict modes `cell` is the brick's cell: each triangle must belong to it ([`cell_of`]) or overlap it
/// ([`overlaps`]); in strict mode the brick is responsible for the part inside the cell only. In sah mode the cell does not matter.
/// The result is a function of the set of triangles, not of their order or of the number of threads.
///
/// `parts`, if not empty, has a box for each triangle: then the brick is responsible only for what of the triangle lies in that box.
/// A triangle that was cut may come several times, once for each part. Sah mode only.
///
/// `None` if it would take more than `memory` bytes until its page is written. That is looked at in strict mode alone: in the
/// others it follows from the number of triangles.
///
/// # Panics
/// Without any triangle, with 2^32 and more references, or with parts of some triangles only.
pub fn build_subtree_within(
    triangles: &[BrickTriangle],
    parts: &[Aabb],
    cell: Cell,
    root: RootCube,
    options: &SubtreeOptions,
    memory: u64,
) -> Option<Subtree> {
    assert!(!triangles.is_empty(), "a brick has at least one triangle");
    assert!(u32::try_from(triangles.len()).is_ok(), "a brick has fewer than 2^32 triangles");
    assert!(parts.is_empty() || options.split == SplitMode::Sah, "only splits by surface know parts of triangles");
    assert!(parts.is_empty() || parts.len() == triangles.len(), "all triangles have a part, or none has");
    let (mut order, codes) = order::sort(triangles, root);
    let parts = sah::Part::list(triangles, parts, &mut order);
    let canonical = sah::Canonical { triangles, order: &order, parts: &parts };
    let limits = record::RecordLimits::new(options.leaf, options.unit);
    let depth = options.depth.min(crate::geometry::morton::BITS);
    let limit = options.cell.max(1);
    let tree = match options.split {
        SplitMode::Sah => {
            drop(codes);
            collapse::collapse(&choice::best_tree(canonical, limits, options.repeats), &order, root)
        }
        SplitMode::Octree => {
            let codes: Vec<u64> = order.iter().map(|&number| codes[number as usize]).collect();
            let builder =
                octree::OctreeBuilder { triangles: canonical, codes: &codes, root, limits, cell: limit, depth };
            builder.build(cell.level)
        }
        SplitMode::Strict => {
            drop(codes);
            strict::StrictBuilder { triangles: canonical, root, limits, cell: limit, depth, memory }.build(cell)?
        }
    };
    Some(emit::emit(&tree, triangles, options.unit, options.points))
}

/// The same without a bound.
#[cfg(test)]
pub fn build_subtree(
    triangles: &[BrickTriangle],
    parts: &[Aabb],
    cell: Cell,
    root: RootCube,
    options: &SubtreeOptions,
) -> Subtree {
    build_subtree_within(triangles, parts, cell, root, options, u64::MAX).expect("there is no bound")
}
