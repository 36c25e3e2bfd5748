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
    let (mut order, codes) = sort(triangles, root);
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

/// The numbers of the triangles in canonical order: by Morton code, then face; by their bits where even that is the same. And the
/// codes, by number.
fn sort(triangles: &[BrickTriangle], root: RootCube) -> (Vec<u32>, Vec<u64>) {
    let codes: Vec<u64> = triangles.iter().map(|t| cell_of(root, Aabb::from(&t.triangle))).collect();
    // Code and number in one word each. In a brick most leading bits of codes are the same, so that few of the last
    // ones, if any, find no room; what is the same without those is put in order afterwards.
    let differing = codes.iter().fold(0, |bits, code| bits | code ^ codes[0]);
    let code_bits = u64::BITS - differing.leading_zeros();
    let number_bits = usize::BITS - (triangles.len() - 1).leading_zeros();
    let dropped = (code_bits + number_bits).saturating_sub(u64::BITS);
    let leading = |code: u64| (code & ((1 << code_bits) - 1)) >> dropped << number_bits;
    let mut keys: Vec<u64> = (0u64..).zip(&codes).map(|(number, &code)| leading(code) | number).collect();
    keys.sort_unstable();
    let mut order: Vec<u32> = keys.iter().map(|key| (key & ((1 << number_bits) - 1)) as u32).collect();
    let corners = |t: &BrickTriangle| t.triangle.vertices().map(record::bits);
    let compare = |a: &u32, b: &u32| {
        let [(code, t), (other, u)] = [a, b].map(|&i| (codes[i as usize], &triangles[i as usize]));
        (code, t.face).cmp(&(other, u.face)).then_with(|| corners(t).cmp(&corners(u))).then(a.cmp(b))
    };
    let mut rest = &mut order[..];
    for run in keys.chunk_by(|a, b| a >> number_bits == b >> number_bits) {
        let (same, after) = std::mem::take(&mut rest).split_at_mut(run.len());
        if same.len() > 1 {
            same.sort_unstable_by(compare);
        }
        rest = after;
    }
    (order, codes)
}
