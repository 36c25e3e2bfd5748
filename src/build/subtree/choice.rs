//! Which tree a brick gets: the plain one, one that is mended by reinsertion, or one with spatial splits.
//!
//! A box far larger than its fair share of the whole's is *large*. In a mesh of evenly sized triangles, and that is every
//! scan, large boxes make up next to nothing of all surface: it gets the plain tree, and this test is all it pays. Else the
//! mesh is *uneven*, as architecture is:
//!
//! - its plain tree is mended ([`super::reinsert`]);
//! - where triangles may be stored twice, a tree with spatial splits ([`super::spatial`]) is built too. The room for second
//!   places, [`ROOM`] of the triangles, is divided from the root down by the surface of large boxes on each side. The tree
//!   is kept, and mended, only if its cost is below [`GAIN`] of the other's.
//!
//! Trees are built one after the other and again, not kept side by side: memory is what bounds a brick.

use super::primitive::{Primitive, Span};
use super::record::RecordLimits;
use super::reinsert;
use super::sah::{self, Binary, Canonical};

/// Second places, in hundredths of the triangles.
const ROOM: usize = 30;
/// A box is large if its surface is this many times its fair share, the whole's surface over the number of triangles.
const LARGE: f64 = 8.0;
/// Large boxes must have this part of the surface of all boxes.
const LARGE_PART: f64 = 0.2;
/// A tree with cuts is kept if it costs no more than this part of the tree without.
const GAIN: f64 = 0.9;

/// The best tree over the triangles; `repeats`: whether one may be stored several times.
pub(super) fn best_tree(triangles: Canonical<'_>, limits: RecordLimits, repeats: bool) -> Binary {
    let mut list = triangles.primitives();
    if !mark_large(&mut list) {
        return sah::build(list, 0, triangles, limits);
    }
    let room = list.len() / 100 * ROOM + list.len() % 100 * ROOM / 100;
    drop(list);
    let whole = || mended(|| sah::build(triangles.primitives(), 0, triangles, limits), triangles, limits);
    let plain = whole();
    if !repeats {
        return plain;
    }
    let bound = GAIN * plain.cost;
    drop(plain);
    let cut = || {
        let mut list = triangles.primitives();
        mark_large(&mut list);
        sah::build(list, room, triangles, limits)
    };
    if cut().cost <= bound { mended(cut, triangles, limits) } else { whole() }
}

/// The tree that `build` gives, mended; as it is, if mending makes paths too long.
fn mended(build: impl Fn() -> Binary, triangles: Canonical<'_>, limits: RecordLimits) -> Binary {
    let tree = build();
    let Binary { nodes, primitives, .. } = tree;
    match reinsert::optimise(nodes).and_then(|nodes| sah::planned(nodes, primitives, triangles, limits)) {
        Some(tree) => tree,
        None => build(),
    }
}

/// Marks the large boxes; whether the mesh is uneven.
fn mark_large(list: &mut [Primitive]) -> bool {
    let whole = list.iter().fold(Span::EMPTY, |all, p| all.union(p.span()));
    let fair = whole.half_area() / list.len() as f64;
    let (mut all, mut large) = (0.0, 0.0);
    for primitive in list {
        let area = primitive.span().half_area();
        primitive.large = u32::from(area > LARGE * fair);
        all += area;
        large += if primitive.large != 0 { area } else { 0.0 };
    }
    large > LARGE_PART * all
}
