//! A [`WideTree`] becomes nodes and leaf records.
//!
//! Depth first, with each node's inner children side by side right where its first one is needed: a path to a leaf then
//! reads forward. A node's leaves follow one another in slot order. Frames are replayed with [`Frame::child`], from the
//! planes as stored, exactly as a reader will.

use super::quantise::{brick_frame, set_planes};
use super::wide::{Child, WideTree};
use super::{BrickTriangle, Subtree};
use crate::format::{Frame, LEAF_MAX, LeafUnit, Node, Points, Slot, encode_leaf};
use crate::geometry::Triangle;

/// Writes out the tree from its last node, the root.
pub(super) fn emit(tree: &WideTree, triangles: &[BrickTriangle], unit: LeafUnit, points: Points) -> Subtree {
    let root = tree.nodes.len() - 1;
    let bounds = tree.nodes[root].bounds;
    let frame = brick_frame(bounds);
    let mut emitter = Emitter {
        tree,
        triangles,
        unit,
        points,
        nodes: vec![Node::EMPTY; tree.nodes.len()],
        taken: 1,
        leaf_bytes: Vec::new(),
        order: Vec::with_capacity(tree.references.len()),
        depth: 0,
    };
    let mut waiting = vec![Place { wide: root as u32, position: 0, frame, level: 1 }];
    while let Some(place) = waiting.pop() {
        emitter.node(place, &mut waiting);
    }
    Subtree {
        nodes: emitter.nodes,
        leaf_bytes: emitter.leaf_bytes,
        leaves: tree.leaves.len() as u32,
        order: emitter.order,
        corner: frame.corner.map(|x| x as f32),
        unit: frame.unit.map(|x| x as f32),
        depth: emitter.depth,
        bounds_root: bounds.corners(),
    }
}

/// A node that has its place and waits to be written.
struct Place {
    wide: u32,
    position: usize,
    frame: Frame,
    level: u32,
}

struct Emitter<'a> {
    tree: &'a WideTree,
    triangles: &'a [BrickTriangle],
    unit: LeafUnit,
    points: Points,
    nodes: Vec<Node>,
    /// Places given away.
    taken: usize,
    leaf_bytes: Vec<u8>,
    order: Vec<u32>,
    depth: u32,
}

impl Emitter<'_> {
    /// Writes a node and its leaves; its inner children go onto `waiting`, the first on top.
    fn node(&mut self, place: Place, waiting: &mut Vec<Place>) {
        let wide = &self.tree.nodes[place.wide as usize];
        let (first_child, first_leaf) = (self.taken, self.leaf_bytes.len());
        let mut node = Node::EMPTY;
        for (slot, &child) in wide.children.iter().enumerate().filter(|(_, child)| **child != Child::Empty) {
            set_planes(&mut node, slot, &place.frame, self.tree.bounds(child));
            let content = match child {
                Child::Leaf(leaf) => {
                    let offset = (self.leaf_bytes.len() - first_leaf) / self.unit.bytes();
                    self.leaf(leaf);
                    Slot::Leaf(offset as u8)
                }
                Child::Node(inner) => {
                    let rank = self.taken - first_child;
                    let frame = place.frame.child(&node, slot);
                    waiting.push(Place { wide: inner, position: self.taken, frame, level: place.level + 1 });
                    self.taken += 1;
                    Slot::Inner(rank as u8)
                }
                Child::Empty => Slot::Empty,
            };
            node.slots[slot] = content.encode();
        }
        let inner = self.taken - first_child;
        let older = waiting.len() - inner;
        waiting[older..].reverse();
        if inner > 0 {
            node.first_child = (first_child - place.position) as u32;
        }
        if self.leaf_bytes.len() > first_leaf {
            // In 16-byte units from this node; the leaves begin where the nodes end.
            node.first_leaf = (4 * (self.nodes.len() - place.position) + first_leaf / 16) as u32;
        }
        self.nodes[place.position] = node;
        self.depth = self.depth.max(place.level);
    }

    /// Writes a leaf record and notes its references.
    fn leaf(&mut self, leaf: u32) {
        let leaf = &self.tree.leaves[leaf as usize];
        let (first, count) = (leaf.first as usize, leaf.count as usize);
        let references = &self.tree.references[first..first + count];
        let mut corners = [Triangle { a: glam::Vec3::ZERO, b: glam::Vec3::ZERO, c: glam::Vec3::ZERO }; LEAF_MAX];
        for (corner, &reference) in corners.iter_mut().zip(references) {
            *corner = self.triangles[reference as usize].triangle;
        }
        let number = self.order.len() as u32;
        encode_leaf(&mut self.leaf_bytes, self.unit, self.points, number, &corners[..count])
            .expect("every leaf of a wide tree was made within the record's limits");
        self.order.extend_from_slice(references);
    }
}
