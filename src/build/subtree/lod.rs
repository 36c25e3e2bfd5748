//! Surrogates for level of detail: what stands for all triangles of a node, bottom-up.
//!
//! Areas, normals and colours are summed from the leaves up, in f64 and in the order of the slots, so that nothing depends on threads. The
//! plane of a node of a page then comes from one pass over the vertices of all leaves below it (which lie together, as the page is gone
//! through depth first): its normal is the mean normal as it is stored, it lies halfway between the
//! outermost vertices, and the deviation reaches these. Where a triangle is stored several times (in this page, or parts of it in others), a
//! node is responsible only for what lies in its box; then the plane's slab is cut to what the box allows, and a triangle counts as far
//! as it lies in its leaf's box. Else a floor as large as the mesh would make a closed surface of every page that it touches.
//!
//! Memory: 24 bytes a vertex of a leaf, so 72 a reference at most, while a page's surrogates are made, when its tree is gone already.
//!
//! Above the bricks no triangle is in reach any more. A top node's slab holds the slabs of its children within their boxes: for a child
//! with normal m, |m.x - h| <= e and box B, and any number k, n.x = k m.x + (n - k m).x <= k h + |k| e + max over B of
//! (n - k m).x; k = 0 (the box alone) and k = n.m are tried, the lesser bound is taken.

use glam::{DVec3, Vec3};
use smallvec::SmallVec;

use super::{Subtree, TopBrick};
use crate::format::{Brick, Frame, Leaf, LeafUnit, Moments, Node, Patch, RootBox, Slot, Surrogate, cosine_of_sum};
use crate::geometry::RootCube;

/// What the node above needs to know of a node.
#[derive(Clone, Copy)]
struct Gathered {
    moments: Moments,
    /// The cosine of a cone that holds all normals, about `axis`.
    cone: f64,
    axis: DVec3,
}

/// The surrogates of a brick's nodes. `color` is that of the input's triangles, by their number.
pub fn surrogates(subtree: &Subtree, root: RootCube, unit: LeafUnit, color: impl Fn(u32) -> Vec3) -> Vec<Surrogate> {
    let vertices = Vertices::with_capacity(subtree.order.len());
    let surrogates = vec![bytemuck::Zeroable::zeroed(); subtree.nodes.len()];
    let mut page = Page { subtree, root, unit, color, vertices, normals: Vec::new(), surrogates };
    let frame = root_frame(subtree);
    page.node(0, &frame, &RootBox::of_frame(&frame));
    page.surrogates
}

/// The frame of the root of a brick; its box is the frame's whole box.
fn root_frame(subtree: &Subtree) -> Frame {
    Frame { corner: subtree.corner.map(f64::from), unit: subtree.unit.map(f64::from) }
}

/// The leaves of node `i`, each with its slot.
fn leaves(subtree: &Subtree, unit: LeafUnit, i: usize) -> impl Iterator<Item = (Leaf<'_>, usize)> {
    let node = &subtree.nodes[i];
    let first = 16 * node.first_leaf as usize - 64 * if node.first_leaf == 0 { 0 } else { subtree.nodes.len() - i };
    node.slots.iter().enumerate().filter_map(move |(slot, &byte)| match Slot::decode(byte) {
        Some(Slot::Leaf(units)) => {
            let at = first + usize::from(units) * unit.bytes();
            subtree.leaf_bytes.get(at..).and_then(Leaf::read).map(|leaf| (leaf, slot))
        }
        _ => None,
    })
}

/// The inner children of node `i`, each with its slot.
fn children(subtree: &Subtree, i: usize) -> impl Iterator<Item = (usize, usize)> {
    let node = &subtree.nodes[i];
    node.slots.iter().enumerate().filter_map(move |(slot, &byte)| match Slot::decode(byte) {
        Some(Slot::Inner(rank)) => Some((i + node.first_child as usize + usize::from(rank), slot)),
        _ => None,
    })
}

/// A page, while its surrogates are made.
struct Page<'a, C> {
    subtree: &'a Subtree,
    root: RootCube,
    unit: LeafUnit,
    color: C,
    /// Those of the leaves that were come to.
    vertices: Vertices,
    /// The unit normals of the triangles in the leaves of the nodes on the way down; none where a triangle is too small to have one.
    normals: Vec<Option<DVec3>>,
    /// Of all nodes.
    surrogates: Vec<Surrogate>,
}

impl<C: Fn(u32) -> Vec3> Page<'_, C> {
    /// Makes the surrogates of node `i` and of those below it.
    fn node(&mut self, i: usize, frame: &Frame, bounds: &RootBox) -> Gathered {
        let (subtree, node) = (self.subtree, &self.subtree.nodes[i]);
        let (first_vertex, first_normal) = (self.vertices.len(), self.normals.len());
        let mut moments = Moments::default();
        for (leaf, slot) in leaves(subtree, self.unit, i) {
            self.leaf(&leaf, &RootBox::of_slot(node, slot, frame), &mut moments);
        }
        let mut below = SmallVec::<[Gathered; 8]>::new();
        for (child, slot) in children(subtree, i) {
            let gathered = self.node(child, &frame.child(node, slot), &RootBox::of_slot(node, slot, frame));
            moments += gathered.moments;
            below.push(gathered);
        }

        let (stored, normal) = Surrogate::normal(moments.vector);
        let cone = cone(normal, &self.normals[first_normal..], &below);
        self.normals.truncate(first_normal);
        let [low, high] = self.vertices.reach(first_vertex, normal);
        let [least, most] = bounds.support(normal);
        let slab = [low.clamp(least, most), high.clamp(least, most)];
        // Of the root no more is known here than what its triangles take up.
        let seen = match i {
            0 => RootBox { low: subtree.bounds_root[0].into(), high: subtree.bounds_root[1].into() },
            _ => *bounds,
        };
        self.surrogates[i] = Surrogate::of(stored, slab, frame, &moments.patch(normal, cone, &seen));
        Gathered { moments, cone, axis: normal }
    }

    /// Adds the triangles of a leaf with that box to `moments`, its vertices and normals to the lists.
    fn leaf(&mut self, leaf: &Leaf<'_>, bounds: &RootBox, moments: &mut Moments) {
        let first = self.vertices.len();
        let whole = self.vertices.append(leaf, self.root, bounds);
        for (j, &number) in self.subtree.order[leaf.first() as usize..][..leaf.len()].iter().enumerate() {
            let corners = leaf.corners(j).map(|vertex| self.vertices.get(first + vertex));
            let triangle = Moments::of_triangle(corners, (self.color)(number));
            self.normals.push(triangle.vector.try_normalize());
            *moments += if whole { triangle } else { triangle.times(inside(corners, bounds)) };
        }
    }
}

/// The cosine of a cone about `axis` that holds all these normals, and the cones of the children.
fn cone(axis: DVec3, normals: &[Option<DVec3>], below: &[Gathered]) -> f64 {
    let normals = normals.iter().fold(1.0f64, |cone, normal| normal.map_or(-1.0, |normal| cone.min(normal.dot(axis))));
    let wider = |cone: f64, child: &Gathered| cone.min(cosine_of_sum(child.axis.dot(axis).min(1.0), child.cone));
    below.iter().fold(normals, wider)
}

/// Vertices in root units, axis by axis: those of a node lie together with those of all below it.
struct Vertices([Vec<f64>; 3]);

impl Vertices {
    fn with_capacity(capacity: usize) -> Vertices {
        Vertices([0; 3].map(|_| Vec::with_capacity(capacity)))
    }

    fn len(&self) -> usize {
        self.0[0].len()
    }

    fn get(&self, vertex: usize) -> DVec3 {
        DVec3::from_array(self.0.each_ref().map(|axis| axis[vertex]))
    }

    /// Adds those of a leaf; whether all of them lie in `bounds`.
    fn append(&mut self, leaf: &Leaf<'_>, root: RootCube, bounds: &RootBox) -> bool {
        let first = self.len();
        let (low, high) = (bounds.low.to_array(), bounds.high.to_array());
        let mut within = true;
        for (axis, list) in self.0.iter_mut().enumerate() {
            list.extend(leaf.coordinates(axis).iter().map(|x| root.axis_to_root_units(axis, x)));
            within &= list[first..].iter().fold(true, |all, &x| all & (x >= low[axis]) & (x <= high[axis]));
        }
        within
    }

    /// The least and the greatest n.x of the vertices from `first` on.
    fn reach(&self, first: usize, n: DVec3) -> [f64; 2] {
        // Several side by side, and no minimum that would have to know NaN: so that this is done in vectors.
        const LANES: usize = 4;
        let (mut low, mut high) = ([f64::INFINITY; LANES], [f64::NEG_INFINITY; LANES]);
        let mut take = |lane: usize, x: f64, y: f64, z: f64| {
            let along = n.x * x + n.y * y + n.z * z;
            low[lane] = if along < low[lane] { along } else { low[lane] };
            high[lane] = if along > high[lane] { along } else { high[lane] };
        };
        let [(x, xs), (y, ys), (z, zs)] = self.0.each_ref().map(|axis| axis[first..].as_chunks::<LANES>());
        for ((x, y), z) in x.iter().zip(y).zip(z) {
            (0..LANES).for_each(|lane| take(lane, x[lane], y[lane], z[lane]));
        }
        for ((&x, &y), &z) in xs.iter().zip(ys).zip(zs) {
            take(0, x, y, z);
        }
        [low.into_iter().fold(f64::INFINITY, f64::min), high.into_iter().fold(f64::NEG_INFINITY, f64::max)]
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
