//! Surrogates for level of detail: what stands for all triangles of a node, bottom-up.
//!
//! Areas, normals and colours are summed from the leaves up, in f64 and in the order of the nodes, so that nothing depends on threads. The
//! plane of a node of a page then comes from one pass over the corners of all triangles below it (a run of references, since
//! references are numbered depth first): its normal is the mean normal as it is stored, it lies halfway between the
//! outermost corners, and the deviation reaches these. Where a triangle is stored several times (in this page, or parts of it in others), a
//! node is responsible only for what lies in its box; then the plane's slab is cut to what the box allows, and a triangle counts as far
//! as it lies in its leaf's box. Else a floor as large as the mesh would make a closed surface of every page that it touches.
//!
//! Memory: 72 bytes a reference and 150 a node while a page's surrogates are made, when its tree is gone already.
//!
//! Above the bricks no triangle is in reach any more. A top node's slab holds the slabs of its children within their boxes: for a child
//! with normal m, |m.x - h| <= e and box B, and any number k, n.x = k m.x + (n - k m).x <= k h + |k| e + max over B of
//! (n - k m).x; k = 0 (the box alone) and k = n.m are tried, the lesser bound is taken.

use glam::{DVec3, Vec3};

use super::{BrickTriangle, Subtree, TopBrick};
use crate::format::{Brick, Frame, Leaf, LeafUnit, Moments, Node, Patch, RootBox, Slot, Surrogate, cosine_of_sum};
use crate::geometry::RootCube;

/// What a node's surrogate is made from.
#[derive(Clone, Copy)]
struct Gathered {
    moments: Moments,
    /// The run of corners below.
    first: u32,
    end: u32,
    /// The cosine of a cone that holds all normals, about `axis`.
    cone: f64,
    axis: DVec3,
}

/// The surrogates of a brick's nodes. `color` is that of the input's triangles, by their number.
pub fn surrogates(
    subtree: &Subtree,
    triangles: &[BrickTriangle],
    root: RootCube,
    unit: LeafUnit,
    color: impl Fn(u32) -> Vec3,
) -> Vec<Surrogate> {
    let frames = frames(subtree);
    let builder = Pages { subtree, triangles, root, unit, color, frames: &frames };
    let corners = builder.corners();
    let nothing = Gathered { moments: Moments::default(), first: u32::MAX, end: 0, cone: 1.0, axis: DVec3::Z };
    let mut gathered = vec![nothing; subtree.nodes.len()];
    let mut surrogates = vec![bytemuck::Zeroable::zeroed(); subtree.nodes.len()];
    // Children lie behind their parents.
    for i in (0..subtree.nodes.len()).rev() {
        let (frame, bounds) = &frames[i];
        let (moments, first, end) = builder.gather(i, &gathered);
        let (stored, normal) = Surrogate::normal(moments.vector);
        let cone = builder.cone(i, normal, &gathered);
        gathered[i] = Gathered { moments, first, end, cone, axis: normal };
        let along = corners[first as usize..end as usize].iter().map(|&p| normal.dot(p));
        let (low, high) = along.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| (low.min(x), high.max(x)));
        let [least, most] = bounds.support(normal);
        let slab = [low.clamp(least, most), high.clamp(least, most)];
        // Of the root no more is known here than what its triangles take up.
        let seen = match i {
            0 => RootBox { low: subtree.bounds_root[0].into(), high: subtree.bounds_root[1].into() },
            _ => *bounds,
        };
        surrogates[i] = Surrogate::of(stored, slab, frame, &moments.patch(normal, cone, &seen));
    }
    surrogates
}

/// Each node's frame and box; of the root the frame's whole box.
fn frames(subtree: &Subtree) -> Vec<(Frame, RootBox)> {
    let frame = Frame { corner: subtree.corner.map(f64::from), unit: subtree.unit.map(f64::from) };
    let mut frames = vec![(frame, RootBox::of_frame(&frame)); subtree.nodes.len()];
    for (i, node) in subtree.nodes.iter().enumerate() {
        let frame = frames[i].0;
        for (slot, &byte) in node.slots.iter().enumerate() {
            if let Some(Slot::Inner(rank)) = Slot::decode(byte) {
                let child = i + node.first_child as usize + usize::from(rank);
                frames[child] = (frame.child(node, slot), RootBox::of_slot(node, slot, &frame));
            }
        }
    }
    frames
}

/// The nodes of a page, while their surrogates are made.
struct Pages<'a, C> {
    subtree: &'a Subtree,
    triangles: &'a [BrickTriangle],
    root: RootCube,
    unit: LeafUnit,
    color: C,
    /// Each node's frame and box.
    frames: &'a [(Frame, RootBox)],
}

impl<C: Fn(u32) -> Vec3> Pages<'_, C> {
    /// Three corners a reference, in root units.
    fn corners(&self) -> Vec<DVec3> {
        (0..self.subtree.order.len() as u32).flat_map(|reference| self.corners_of(reference)).collect()
    }

    /// The references of the leaves of node `i`, a run each, and the leaf's slot.
    fn leaves(&self, i: usize) -> impl Iterator<Item = (std::ops::Range<u32>, usize)> {
        let node = &self.subtree.nodes[i];
        let first =
            16 * node.first_leaf as usize - 64 * if node.first_leaf == 0 { 0 } else { self.subtree.nodes.len() - i };
        node.slots.iter().enumerate().filter_map(move |(slot, &byte)| match Slot::decode(byte) {
            Some(Slot::Leaf(units)) => {
                let at = first + usize::from(units) * self.unit.bytes();
                let leaf = self.subtree.leaf_bytes.get(at..).and_then(Leaf::read)?;
                Some((leaf.first()..leaf.first() + leaf.len() as u32, slot))
            }
            _ => None,
        })
    }

    /// The inner children of node `i`.
    fn children(&self, i: usize) -> impl Iterator<Item = usize> {
        let node = &self.subtree.nodes[i];
        node.slots.iter().filter_map(move |&byte| match Slot::decode(byte) {
            Some(Slot::Inner(rank)) => Some(i + node.first_child as usize + usize::from(rank)),
            _ => None,
        })
    }

    /// The sums over all triangles of node `i`, and the run of their corners.
    fn gather(&self, i: usize, gathered: &[Gathered]) -> (Moments, u32, u32) {
        let (mut moments, mut first, mut end) = (Moments::default(), u32::MAX, 0);
        for (run, slot) in self.leaves(i) {
            (first, end) = (first.min(3 * run.start), end.max(3 * run.end));
            let bounds = RootBox::of_slot(&self.subtree.nodes[i], slot, &self.frames[i].0);
            for reference in run {
                moments += self.moments(reference).times(inside(self.corners_of(reference), &bounds));
            }
        }
        for child in self.children(i) {
            let child = &gathered[child];
            (first, end) = (first.min(child.first), end.max(child.end));
            moments += child.moments;
        }
        (moments, first, end)
    }

    fn moments(&self, reference: u32) -> Moments {
        Moments::of_triangle(self.corners_of(reference), (self.color)(self.subtree.order[reference as usize]))
    }

    /// The corners of a reference's triangle, in root units.
    fn corners_of(&self, reference: u32) -> [DVec3; 3] {
        let number = self.subtree.order[reference as usize];
        self.triangles[number as usize].triangle.vertices().map(|v| self.root.to_root_units(v))
    }

    /// The cosine of a cone about `axis` that holds the normals of all triangles of node `i`.
    fn cone(&self, i: usize, axis: DVec3, gathered: &[Gathered]) -> f64 {
        let mut cone = 1.0f64;
        for reference in self.leaves(i).flat_map(|(run, _)| run) {
            let normal = self.moments(reference).vector.try_normalize();
            cone = normal.map_or(-1.0, |normal| cone.min(normal.dot(axis)));
        }
        for child in self.children(i) {
            let child = &gathered[child];
            cone = cone.min(cosine_of_sum(child.axis.dot(axis).min(1.0), child.cone));
        }
        cone
    }
}

/// How much of a triangle's area lies in a box, as a part of the whole: 1 for one that the box holds.
///
/// Sutherland and Hodgman (1974), "Reentrant polygon clipping", plane by plane.
fn inside(corners: [DVec3; 3], bounds: &RootBox) -> f64 {
    if corners.iter().all(|p| p.cmpge(bounds.low).all() && p.cmple(bounds.high).all()) {
        return 1.0;
    }
    let area = |polygon: &[DVec3]| match polygon {
        [first, rest @ ..] => {
            rest.windows(2).map(|pair| (pair[0] - first).cross(pair[1] - first)).sum::<DVec3>().length()
        }
        [] => 0.0,
    };
    let (mut polygon, mut clipped) = (corners.to_vec(), Vec::with_capacity(9));
    for (axis, sign, limit) in (0..3).flat_map(|axis| [(axis, 1.0, bounds.high[axis]), (axis, -1.0, -bounds.low[axis])])
    {
        // How far outside a point is.
        let beyond = |p: DVec3| sign * p[axis] - limit;
        for (i, &p) in polygon.iter().enumerate() {
            let q = polygon[(i + 1) % polygon.len()];
            let (a, b) = (beyond(p), beyond(q));
            if a <= 0.0 {
                clipped.push(p);
            }
            if (a < 0.0 && b > 0.0) || (a > 0.0 && b < 0.0) {
                clipped.push(p + (q - p) * (a / (a - b)));
            }
        }
        std::mem::swap(&mut polygon, &mut clipped);
        clipped.clear();
    }
    let whole = area(&corners);
    if whole > 0.0 { (area(&polygon) / whole).min(1.0) } else { 0.0 }
}

/// The surrogates of the top nodes, from those of the roots of all bricks.
pub fn top_surrogates(nodes: &[Node], tops: &[TopBrick], bricks: &[Brick], roots: &[Surrogate]) -> Vec<Surrogate> {
    let mut places = vec![Frame::ROOT; nodes.len()];
    for (i, node) in nodes.iter().enumerate() {
        for (slot, &byte) in node.slots.iter().enumerate() {
            if let Some(Slot::Inner(rank)) = Slot::decode(byte) {
                places[i + node.first_child as usize + usize::from(rank)] = places[i].child(node, slot);
            }
        }
    }
    let brick = |number: usize| {
        let (top, Brick { corner, unit, .. }, root) = (tops.get(number)?, bricks.get(number)?, roots.get(number)?);
        let frame = Frame { corner: corner.map(f64::from), unit: unit.map(f64::from) };
        let [low, high] = top.bounds_root.map(DVec3::from_array);
        Some(Below { patch: root.patch(&frame), bounds: RootBox { low, high } })
    };
    let mut made: Vec<Option<(Surrogate, Below)>> = vec![None; nodes.len()];
    for (i, node) in nodes.iter().enumerate().rev() {
        let below: Vec<Below> = node
            .slots
            .iter()
            .filter_map(|&byte| match Slot::decode(byte)? {
                Slot::Inner(rank) => made[i + node.first_child as usize + usize::from(rank)].map(|made| made.1),
                Slot::Brick(rank) => brick(node.first_leaf as usize + usize::from(rank)),
                Slot::Leaf(_) | Slot::Empty => None,
            })
            .collect();
        made[i] = Some(merged(&below, &places[i]));
    }
    made.into_iter().flatten().map(|made| made.0).collect()
}

/// A brick or top node, as its parent sees it.
#[derive(Clone, Copy)]
struct Below {
    patch: Patch,
    bounds: RootBox,
}

/// The surrogate of a top node with this frame, and how it is seen from above.
fn merged(below: &[Below], frame: &Frame) -> (Surrogate, Below) {
    let empty = RootBox { low: DVec3::INFINITY, high: DVec3::NEG_INFINITY };
    let around = |a: RootBox, b: &Below| RootBox { low: a.low.min(b.bounds.low), high: a.high.max(b.bounds.high) };
    let bounds = below.iter().fold(empty, around);
    let mut moments = Moments::default();
    below.iter().for_each(|child| moments += Moments::of_patch(&child.patch, &child.bounds));
    let (stored, normal) = Surrogate::normal(moments.vector);
    let (mut low, mut high, mut cone) = (f64::INFINITY, f64::NEG_INFINITY, 1.0f64);
    for child in below {
        high = high.max(child.highest(normal));
        low = low.min(-child.highest(-normal));
        cone = cone.min(cosine_of_sum(child.patch.normal.dot(normal).min(1.0), child.patch.cone));
    }
    let patch = moments.patch(normal, cone, &bounds);
    let surrogate = Surrogate::of(stored, [low, high], frame, &patch);
    (surrogate, Below { patch: surrogate.patch(frame), bounds })
}

impl Below {
    /// An upper bound of n.x over what is in the box and the slab.
    fn highest(&self, n: DVec3) -> f64 {
        let Below { patch, bounds } = self;
        let by = |k: f64| k * patch.offset + k.abs() * patch.deviation + bounds.support(n - k * patch.normal)[1];
        by(0.0).min(by(n.dot(patch.normal)))
    }
}

#[cfg(test)]
mod tests;
