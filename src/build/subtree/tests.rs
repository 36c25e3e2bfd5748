//! Whole bricks: built, laid out as pages, validated, and walked as a reader would.

mod cuts;
mod freaks;

use glam::{DVec3, Vec3};
use proptest::prelude::*;

use super::wide::Bounds;
use super::*;
use crate::format::{Flags, Frame, Leaf, PageHeader, PageId, PageRecord, Points, SideArrays, Slot, validate_page};
use crate::geometry::Aabb;

const MODES: [SplitMode; 3] = [SplitMode::Sah, SplitMode::Octree, SplitMode::Strict];

fn options(split: SplitMode) -> SubtreeOptions {
    SubtreeOptions { split, leaf: 16, cell: 16, depth: 21, unit: LeafUnit::B16, points: Points::Floats, repeats: false }
}

fn numbered(triangles: impl IntoIterator<Item = Triangle>) -> Vec<BrickTriangle> {
    (0..).zip(triangles).map(|(face, triangle)| BrickTriangle { triangle, face }).collect()
}

fn root_of(triangles: &[BrickTriangle]) -> RootCube {
    RootCube::around(Aabb::around(triangles.iter().flat_map(|t| t.triangle.vertices())))
}

/// A whole mesh as one brick.
fn whole(triangles: &[BrickTriangle], options: &SubtreeOptions) -> Subtree {
    build_subtree(triangles, &[], Cell::ROOT, root_of(triangles), options)
}

fn triangle(p: [[f32; 3]; 3]) -> Triangle {
    Triangle { a: p[0].into(), b: p[1].into(), c: p[2].into() }
}

/// A bumpy sheet of 2 n^2 triangles with shared vertices.
fn sheet(n: usize) -> Vec<BrickTriangle> {
    let at = |i: usize, j: usize| {
        let (x, y) = (i as f32 / n as f32, j as f32 / n as f32);
        Vec3::new(x, y, 0.3 * (9.0 * x).sin() * (7.0 * y).cos())
    };
    numbered((0..n * n).flat_map(|k| {
        let (i, j) = (k / n, k % n);
        let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
        [Triangle { a, b, c }, Triangle { a, b: c, c: d }]
    }))
}

/// What a walk sees of a reference: its number, the leaf's planes cut with those of all nodes above, and its level.
struct Seen {
    reference: u32,
    triangle: Triangle,
    bounds: Bounds,
}

/// Walks a subtree as a reader does, with derived frames; every reference, and the most nodes on a path.
fn walk(subtree: &Subtree, unit: LeafUnit) -> (Vec<Seen>, u32) {
    let frame = Frame { corner: subtree.corner.map(f64::from), unit: subtree.unit.map(f64::from) };
    let everywhere = Bounds { min: DVec3::NEG_INFINITY, max: DVec3::INFINITY };
    let mut seen = Vec::new();
    let mut deepest = 0;
    let mut stack = vec![(0usize, frame, everywhere, 1)];
    while let Some((i, frame, outer, level)) = stack.pop() {
        let node = &subtree.nodes[i];
        deepest = deepest.max(level);
        for slot in 0..8 {
            let plane = |q: &[[u8; 8]; 3]| {
                DVec3::from_array([0, 1, 2].map(|a| frame.corner[a] + f64::from(q[a][slot]) * frame.unit[a]))
            };
            let (low, high) = (plane(&node.low), plane(&node.high));
            let bounds = Bounds { min: low.max(outer.min), max: high.min(outer.max) };
            match Slot::decode(node.slots[slot]).unwrap() {
                Slot::Empty => assert!((0..3).all(|a| node.low[a][slot] == 255 && node.high[a][slot] == 0)),
                Slot::Inner(rank) => {
                    assert!(node.first_child > 0);
                    let child = i + node.first_child as usize + usize::from(rank);
                    stack.push((child, frame.child(node, slot), bounds, level + 1));
                }
                Slot::Leaf(offset) => {
                    let nodes_after = 64 * (subtree.nodes.len() - i);
                    let at = 16 * node.first_leaf as usize + unit.bytes() * usize::from(offset) - nodes_after;
                    let leaf = Leaf::parse(&subtree.leaf_bytes[at..], unit).unwrap();
                    seen.extend((0..leaf.len()).map(|j| Seen {
                        reference: leaf.first() + j as u32,
                        triangle: leaf.triangle(j),
                        bounds,
                    }));
                }
                Slot::Brick(_) => panic!("a brick in a page"),
            }
        }
    }
    (seen, deepest)
}

fn same_bits(a: &Triangle, b: &Triangle) -> bool {
    a.vertices().map(record::bits) == b.vertices().map(record::bits)
}

/// Everything that holds of any subtree, and what holds of its split mode.
fn check(triangles: &[BrickTriangle], root: RootCube, options: &SubtreeOptions, subtree: &Subtree) {
    validate(triangles, options, subtree);
    let (seen, deepest) = walk(subtree, options.unit);
    assert_eq!(deepest, subtree.depth);
    assert_eq!(seen.len(), subtree.order.len());
    let mut numbers: Vec<u32> = seen.iter().map(|s| s.reference).collect();
    numbers.sort_unstable();
    assert!(numbers.iter().copied().eq(0..seen.len() as u32));
    for s in &seen {
        let source = &triangles[subtree.order[s.reference as usize] as usize];
        assert!(same_bits(&s.triangle, &source.triangle));
    }
    if options.split == SplitMode::Sah {
        let most = triangles.len() + if options.repeats { triangles.len() * 3 / 10 } else { 0 };
        assert!(subtree.order.len() <= most, "{} places for {} triangles", subtree.order.len(), triangles.len());
    }
    if subtree.order.len() > triangles.len() || options.split == SplitMode::Strict {
        check_coverage(triangles, root, subtree, &seen);
    } else {
        let mut order = subtree.order.clone();
        order.sort_unstable();
        assert!(order.iter().copied().eq(0..triangles.len() as u32), "each triangle once");
        for s in &seen {
            let exact = Bounds::of(Aabb::from(&s.triangle), root);
            assert!(s.bounds.min.cmple(exact.min).all(), "{:?} {exact:?}", s.bounds);
            assert!(s.bounds.max.cmpge(exact.max).all(), "{:?} {exact:?}", s.bounds);
        }
    }
}

/// Triangles in several places: points all over each triangle lie in the box of one of its references, all the way from the root.
fn check_coverage(triangles: &[BrickTriangle], root: RootCube, subtree: &Subtree, seen: &[Seen]) {
    let mut boxes = vec![Vec::new(); triangles.len()];
    for s in seen {
        boxes[subtree.order[s.reference as usize] as usize].push(s.bounds);
    }
    let weights = (0..=6).flat_map(|i| (0..=6 - i).map(move |j| (f64::from(i) / 6.0, f64::from(j) / 6.0)));
    for (t, boxes) in triangles.iter().zip(&boxes) {
        let [a, b, c] = t.triangle.vertices().map(|v| root.to_root_units(v));
        for (u, v) in weights.clone() {
            // The sum is rounded: not out of the triangle's own box.
            let p = (a + u * (b - a) + v * (c - a)).clamp(a.min(b).min(c), a.max(b).max(c));
            let is_in = |b: &Bounds| b.min.cmple(p).all() && b.max.cmpge(p).all();
            assert!(boxes.iter().any(is_in), "face {} at {u} {v}: {p} in none of {}", t.face, boxes.len());
        }
    }
}

/// The subtree as a page obeys FORMAT.md.
fn validate(triangles: &[BrickTriangle], options: &SubtreeOptions, subtree: &Subtree) {
    let ids = subtree.order.iter().map(|&i| triangles[i as usize].face).collect();
    let side = SideArrays { ids, ..Default::default() };
    let references = subtree.order.len() as u32;
    let (nodes, leaves) = (&subtree.nodes, &subtree.leaf_bytes);
    let page = PageHeader::layout(PageId(0), nodes, leaves, subtree.leaves, references, &side, false).unwrap();
    let bytes = page.len() as u32;
    let record = PageRecord { offset: 4096, checksum: 0, stored_bytes: bytes, bytes, references, zero: 0 };
    let mut flags = Flags::IDS;
    if options.points == Points::Steps {
        flags |= Flags::STEPS;
    }
    if options.unit == LeafUnit::B32 {
        flags |= Flags::LEAF_UNIT_32;
    }
    if options.split == SplitMode::Strict || options.repeats {
        flags |= Flags::REPEATS;
    }
    validate_page(&page, PageId(0), &record, Flags(flags), 0, triangles.len() as u64).unwrap();
}

/// Builds and checks in every mode, with a few limits.
fn check_all_modes(triangles: &[BrickTriangle]) {
    let root = root_of(triangles);
    for split in MODES {
        for (leaf, cell, unit) in [(16, 16, LeafUnit::B16), (3, 8, LeafUnit::B32), (1, usize::MAX, LeafUnit::B16)] {
            for repeats in [false, true] {
                let options = SubtreeOptions { leaf, cell, unit, repeats, ..options(split) };
                check(triangles, root, &options, &build_subtree(triangles, &[], Cell::ROOT, root, &options));
            }
        }
    }
}

fn leaf_sizes(subtree: &Subtree, unit: LeafUnit) -> Vec<usize> {
    let mut sizes = Vec::new();
    let mut rest = &subtree.leaf_bytes[..];
    while sizes.len() < subtree.leaves as usize {
        let leaf = Leaf::parse(rest, unit).unwrap();
        sizes.push(leaf.len());
        rest = &rest[leaf.size(unit)..];
    }
    sizes
}

#[test]
fn one_triangle_is_a_node_with_one_leaf() {
    for split in MODES {
        let mesh = numbered([triangle([[0.0, 0.0, 1.0], [1.0, 0.0, 1.0], [0.0, 1.0, 1.0]])]);
        let subtree = whole(&mesh, &options(split));
        assert_eq!((subtree.nodes.len(), subtree.leaves, subtree.depth), (1, 1, 1));
        check(&mesh, root_of(&mesh), &options(split), &subtree);
    }
}

#[test]
fn a_sheet_in_every_mode() {
    check_all_modes(&sheet(30));
}

#[test]
fn leaves_of_a_sheet_are_full_and_small() {
    let mesh = sheet(100);
    let subtree = whole(&mesh, &options(SplitMode::Sah));
    let bytes = (64 * subtree.nodes.len() + subtree.leaf_bytes.len()) as f64 / mesh.len() as f64;
    assert!(bytes < 20.0, "{bytes} bytes a triangle");
}

#[test]
fn limits_are_obeyed() {
    let mesh = sheet(24);
    for split in MODES {
        for leaf in [1, 2, 7, 16] {
            let subtree = whole(&mesh, &SubtreeOptions { leaf, ..options(split) });
            assert!(leaf_sizes(&subtree, LeafUnit::B16).into_iter().all(|n| n <= leaf));
        }
    }
    for cell in [1, 2, 4] {
        // Both triangles of a square of the sheet have the same box, so no depth parts them.
        let subtree = whole(&mesh, &SubtreeOptions { cell, ..options(SplitMode::Octree) });
        assert!(leaf_sizes(&subtree, LeafUnit::B16).into_iter().all(|n| n <= cell.max(2)));
    }
    for depth in [0, 1, 3] {
        let octree = SubtreeOptions { cell: 1, depth, ..options(SplitMode::Octree) };
        let strict = SubtreeOptions { split: SplitMode::Strict, ..octree };
        // Below the depth limit only spreading adds nodes: eights of 1152 triangles in records, at most 4 levels.
        assert!(whole(&mesh, &octree).depth <= depth + 4);
        assert!(whole(&mesh, &strict).depth <= depth + 4);
        assert!(depth > 0 || whole(&mesh, &strict).order.len() == mesh.len(), "depth 0 splits nothing");
    }
}

#[test]
fn octree_slots_are_octants() {
    // One small triangle an octant: the root's slot tells its octant.
    let octants = (0..8u8).map(|i| 1.2 * Vec3::new(f32::from(i >> 2), f32::from(i >> 1 & 1), f32::from(i & 1)));
    let mesh = numbered(octants.map(|p| Triangle { a: p, b: p + 0.1 * Vec3::X, c: p + 0.1 * Vec3::Y }));
    for split in [SplitMode::Octree, SplitMode::Strict] {
        let subtree = whole(&mesh, &SubtreeOptions { cell: 1, ..options(split) });
        assert_eq!(subtree.nodes.len(), 1);
        assert_eq!(subtree.order, [0, 1, 2, 3, 4, 5, 6, 7]);
        assert!(subtree.nodes[0].slots.iter().all(|&s| matches!(Slot::decode(s), Some(Slot::Leaf(_)))));
    }
}

#[test]
fn the_order_of_the_input_does_not_matter() {
    let mesh = sheet(40);
    let mut shuffled = mesh.clone();
    let mut state = 1u64;
    for i in (1..shuffled.len()).rev() {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        shuffled.swap(i, (state >> 33) as usize % (i + 1));
    }
    for split in MODES {
        let (a, b) = (whole(&mesh, &options(split)), whole(&shuffled, &options(split)));
        assert_eq!(a.nodes, b.nodes);
        assert_eq!(a.leaf_bytes, b.leaf_bytes);
        let faces = |mesh: &[BrickTriangle], s: &Subtree| -> Vec<u32> {
            s.order.iter().map(|&i| mesh[i as usize].face).collect()
        };
        assert_eq!(faces(&mesh, &a), faces(&shuffled, &b));
    }
}

#[test]
fn threads_do_not_matter() {
    let mesh = sheet(130);
    let pool = |n| rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap();
    let build = |n| pool(n).install(|| whole(&mesh, &options(SplitMode::Sah)));
    assert_eq!(build(1), build(3));
}

/// The strict octree cut into bricks: the bricks together cover every triangle.
#[test]
fn strict_bricks_cover_together() {
    let mesh = sheet(20);
    let root = root_of(&mesh);
    let options = options(SplitMode::Strict);
    let mut boxes = vec![Vec::new(); mesh.len()];
    for cell in (0..64).map(|i| Cell::ROOT.child(i / 8).child(i % 8)) {
        let inside: Vec<u32> =
            (0..mesh.len() as u32).filter(|&i| overlaps(root, cell, &mesh[i as usize].triangle)).collect();
        if inside.is_empty() {
            continue;
        }
        let brick: Vec<BrickTriangle> = inside.iter().map(|&i| mesh[i as usize]).collect();
        let subtree = build_subtree(&brick, &[], cell, root, &options);
        let [min, max] = subtree.bounds_root.map(DVec3::from_array);
        let Bounds { min: low, max: high } = cell.bounds();
        assert!(min.cmpge(low).all() && max.cmple(high).all(), "a brick answers for its cell alone");
        for s in walk(&subtree, options.unit).0 {
            boxes[inside[subtree.order[s.reference as usize] as usize] as usize].push(s.bounds);
        }
    }
    for (t, boxes) in mesh.iter().zip(&boxes) {
        let [a, b, c] = t.triangle.vertices().map(|v| root.to_root_units(v));
        for (u, v) in (0..=9).flat_map(|i| (0..=9 - i).map(move |j| (f64::from(i) / 9.0, f64::from(j) / 9.0))) {
            let p = (a + u * (b - a) + v * (c - a)).clamp(a.min(b).min(c), a.max(b).max(c));
            assert!(boxes.iter().any(|b: &Bounds| b.min.cmple(p).all() && b.max.cmpge(p).all()));
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, ..ProptestConfig::default() })]

    /// Random soups at many scales, offsets and shapes.
    #[test]
    fn random_meshes(
        places in prop::collection::vec(prop::array::uniform9(-1.0f32..1.0), 1..300),
        size in -40i32..2, scale in -145i32..=116, offset in prop::array::uniform3(-1e3f32..1e3),
        mode in 0usize..3, leaf in 1usize..=16, cell in 1usize..40, depth in 0u32..=21, wide in any::<bool>(), repeats in any::<bool>(),
        steps in any::<bool>(),
    ) {
        let (size, scale, offset) = (2f32.powi(size), 2f32.powi(scale), Vec3::from_array(offset));
        let mesh = numbered(places.into_iter().map(|p| {
            let centre = Vec3::new(p[0], p[1], p[2]);
            let near = |v: Vec3| if steps { (v * 64.0).round() / 64.0 + 0.0 } else { v };
            let at = |i: usize| near(offset + centre + size * Vec3::new(p[i], p[(i + 4) % 9], p[(i + 7) % 9])) * scale;
            Triangle { a: at(0), b: at(3), c: at(5) }
        }));
        let points = if steps { Points::Steps } else { Points::Floats };
        let unit = if wide { LeafUnit::B32 } else { LeafUnit::B16 };
        let options = SubtreeOptions { split: MODES[mode], leaf, cell, depth, unit, points, repeats };
        let root = root_of(&mesh);
        check(&mesh, root, &options, &build_subtree(&mesh, &[], Cell::ROOT, root, &options));
    }
}
