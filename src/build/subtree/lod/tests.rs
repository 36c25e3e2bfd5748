//! Surrogates of bricks, and merged ones.

use super::super::{BrickTriangle, Cell, SubtreeOptions, build_subtree};
use super::*;
use crate::format::{Points, SplitMode};
use crate::geometry::{Aabb, Triangle};

/// A field of hills over x and y, of 2 n^2 triangles.
fn hills(n: usize, height: f32) -> Vec<BrickTriangle> {
    let at = |i: usize, j: usize| {
        let (x, y) = (i as f32 / n as f32, j as f32 / n as f32);
        Vec3::new(x, y, 0.3 + height * ((9.0 * x).sin() * (7.0 * y).cos()))
    };
    let mut list = Vec::new();
    for (i, j) in (0..n).flat_map(|i| (0..n).map(move |j| (i, j))) {
        let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
        for triangle in [Triangle { a, b, c }, Triangle { a, b: c, c: d }] {
            list.push(BrickTriangle { triangle, face: list.len() as u32 });
        }
    }
    list
}

fn root_of(list: &[BrickTriangle]) -> RootCube {
    RootCube::around(list.iter().map(|t| Aabb::from(&t.triangle)).fold(Aabb::EMPTY, Aabb::union))
}

fn built(list: &[BrickTriangle]) -> (Subtree, Vec<Surrogate>) {
    built_of(list, &[])
}

fn built_of(list: &[BrickTriangle], parts: &[Aabb]) -> (Subtree, Vec<Surrogate>) {
    let options = SubtreeOptions {
        split: SplitMode::Sah,
        leaf: 16,
        cell: 16,
        depth: 21,
        unit: LeafUnit::B16,
        points: Points::Floats,
        repeats: false,
    };
    let root = root_of(list);
    let subtree = build_subtree(list, parts, Cell::ROOT, root, &options);
    let surrogates = surrogates(&subtree, root, LeafUnit::B16, |i| if i % 2 == 0 { Vec3::X } else { Vec3::Y });
    (subtree, surrogates)
}

/// Each node's frame and box; of the root the frame's whole box.
fn frames(subtree: &Subtree) -> Vec<(Frame, RootBox)> {
    let frame = root_frame(subtree);
    let mut frames = vec![(frame, RootBox::of_frame(&frame)); subtree.nodes.len()];
    for (i, node) in subtree.nodes.iter().enumerate() {
        let frame = frames[i].0;
        for (child, slot) in children(subtree, i) {
            frames[child] = (frame.child(node, slot), RootBox::of_slot(node, slot, &frame));
        }
    }
    frames
}

#[test]
fn a_flat_field_is_its_plane() {
    let list = hills(40, 0.0);
    let (subtree, surrogates) = built(&list);
    for ((frame, bounds), surrogate) in frames(&subtree).iter().zip(&surrogates) {
        let patch = surrogate.patch(frame);
        assert_eq!(patch.normal, DVec3::Z);
        assert!(patch.cone > 0.99 && patch.agreement == 1.0, "{patch:?}");
        // A step of the frame, and nothing more.
        assert!(patch.deviation <= 1.1 * frame.unit[0].max(frame.unit[1]), "{patch:?} {frame:?}");
        assert!(bounds.low.z <= patch.offset && patch.offset <= bounds.high.z);
        assert_eq!((patch.coverage[0], patch.coverage[1]), (0.0, 0.0));
        assert!(patch.coverage[2] > 0.7, "{patch:?}");
    }
    let patch = surrogates[0].patch(&frames(&subtree)[0].0);
    assert!((patch.color[0] - 0.5).abs() < 0.01 && patch.color[2] == 0.0);
}

#[test]
fn areas_in_boxes() {
    let bounds = RootBox { low: DVec3::ZERO, high: DVec3::ONE };
    let flat = |p: [[f64; 2]; 3]| inside(p.map(|[x, y]| DVec3::new(x, y, 0.5)), &bounds);
    let triangle = [[0.0, 0.0], [2.0, 0.0], [0.0, 2.0]];
    assert_eq!(flat(triangle), 0.5);
    assert_eq!(flat(triangle.map(|[x, y]| [x / 2.0, y / 2.0])), 1.0);
    assert_eq!(flat(triangle.map(|[x, y]| [x - 0.5, y - 0.5])), 0.25);
    assert_eq!(flat([[-10.0, -10.0], [30.0, -10.0], [-10.0, 30.0]]), 1.0 / 800.0);
    assert_eq!(flat(triangle.map(|[x, y]| [x + 1.0, y])), 0.0);
    assert_eq!(inside([DVec3::splat(2.0); 3], &bounds), 0.0);
}

/// A floor far larger than its page, of which a quarter of the page is in a part, among walls.
#[test]
fn a_part_counts_as_far_as_it_lies_in_its_box() {
    let floor = [[-100.0, -100.0, 0.0], [300.0, -100.0, 0.0], [-100.0, 300.0, 0.0]].map(Vec3::from_array);
    let mut list = vec![BrickTriangle { triangle: Triangle { a: floor[0], b: floor[1], c: floor[2] }, face: 0 }];
    let walls = (0..400).map(|i| {
        let a = Vec3::new((i % 20) as f32 / 20.0, (i / 20) as f32 / 20.0, 0.0);
        let triangle = Triangle { a, b: a + Vec3::X / 20.0, c: a + Vec3::Z / 20.0 };
        BrickTriangle { triangle, face: i + 1 }
    });
    list.extend(walls);
    let mut parts: Vec<Aabb> = list.iter().map(|t| Aabb::from(&t.triangle)).collect();
    parts[0] = Aabb { min: Vec3::ZERO, max: Vec3::new(0.5, 0.5, 0.0) };
    let (subtree, surrogates) = built_of(&list, &parts);
    let patch = surrogates[0].patch(&frames(&subtree)[0].0);
    // Walls: 400 of 1 / 800 each, across y, of a box of 1 by 1 by 1 / 20.
    assert!((patch.coverage[2] - 0.25).abs() < 0.05, "{patch:?}");
    assert!(patch.normal.y.abs() > 0.8, "walls make up most: {patch:?}");
    // The floor is red, and every second wall; the others are green.
    assert!((patch.color[0] - 0.5 / 0.75).abs() < 0.05, "{patch:?}");
}

#[test]
fn slabs_and_cones_hold_every_triangle() {
    let list = hills(40, 0.1);
    let (subtree, surrogates) = built(&list);
    let root = root_of(&list);
    let frames = frames(&subtree);
    let mut triangles = 0;
    let mut below: Vec<Vec<u32>> = vec![Vec::new(); subtree.nodes.len()];
    for i in (0..subtree.nodes.len()).rev() {
        let run = |leaf: Leaf<'_>| leaf.first()..leaf.first() + leaf.len() as u32;
        let mut all: Vec<u32> = leaves(&subtree, LeafUnit::B16, i).flat_map(|(leaf, _)| run(leaf)).collect();
        children(&subtree, i).for_each(|(child, _)| all.extend(&below[child]));
        let patch = surrogates[i].patch(&frames[i].0);
        for &reference in &all {
            let corners = list[subtree.order[reference as usize] as usize].triangle.vertices();
            let corners = corners.map(|v| root.to_root_units(v));
            assert!(corners.iter().all(|p| (patch.normal.dot(*p) - patch.offset).abs() <= patch.deviation));
            let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize();
            assert!(normal.dot(patch.normal) >= patch.cone - 1e-6);
        }
        triangles = triangles.max(all.len());
        below[i] = all;
    }
    assert_eq!(triangles, list.len());
}

/// Nested slabs: what a brick's root says of its children's content is true of the merged one as well.
#[test]
fn a_merged_slab_holds_those_below() {
    let list = hills(40, 0.1);
    let (subtree, surrogates) = built(&list);
    let frames = frames(&subtree);
    let root = root_of(&list);
    let below = |i: usize| Below { patch: surrogates[i].patch(&frames[i].0), bounds: frames[i].1 };
    let below: Vec<Below> = children(&subtree, 0).map(|(child, _)| below(child)).collect();
    assert!(below.len() > 1);
    let (merged, seen) = merged(&below, &frames[0].0);
    let exact = surrogates[0].patch(&frames[0].0);
    let patch = merged.patch(&frames[0].0);
    assert!(patch.normal.dot(exact.normal) > 0.99 && patch.deviation < 3.0 * exact.deviation, "{patch:?} {exact:?}");
    for triangle in &list {
        for p in triangle.triangle.vertices().map(|v| root.to_root_units(v)) {
            let inside = p.cmpge(seen.bounds.low).all() && p.cmple(seen.bounds.high).all();
            assert!(!inside || (patch.normal.dot(p) - patch.offset).abs() <= patch.deviation);
        }
    }
}
