//! The tree between building and writing: 8-wide nodes over leaf spans, boxes still exact in root units.
//!
//! Every way to split ([`super::sah`], [`super::octree`], [`super::strict`]) ends in a [`WideTree`]; [`super::emit`]
//! quantises it. The tree costs 112 bytes a node and 56 a leaf, so 10 to 20 bytes a triangle with full leaves.

use glam::DVec3;

use crate::geometry::{Aabb, RootCube};

/// A closed box in root units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Bounds {
    /// Lowest corner.
    pub min: DVec3,
    /// Highest corner.
    pub max: DVec3,
}

impl Bounds {
    /// The box that holds nothing.
    pub const EMPTY: Bounds = Bounds { min: DVec3::INFINITY, max: DVec3::NEG_INFINITY };

    /// A box of the source in root units; each plane is off by at most 2^-53, which the quantisation's margin covers.
    pub fn of(aabb: Aabb, root: RootCube) -> Bounds {
        Bounds { min: root.to_root_units(aabb.min), max: root.to_root_units(aabb.max) }
    }

    /// The smallest box around both.
    pub fn union(self, other: Bounds) -> Bounds {
        Bounds { min: self.min.min(other.min), max: self.max.max(other.max) }
    }

    /// The part inside `cell`. Where the two do not touch, the nearest face of the cell: never an inverted box.
    pub fn clipped_to(self, cell: Bounds) -> Bounds {
        Bounds { min: self.min.clamp(cell.min, cell.max), max: self.max.clamp(cell.min, cell.max) }
    }

    /// Half the surface.
    pub fn half_area(self) -> f64 {
        let d = self.max - self.min;
        d.x * d.y + d.y * d.z + d.z * d.x
    }

    /// The middle.
    pub fn centre(self) -> DVec3 {
        0.5 * (self.min + self.max)
    }

    /// Lowest and highest corner as arrays.
    pub fn corners(self) -> [[f64; 3]; 2] {
        [self.min.to_array(), self.max.to_array()]
    }
}

/// What a slot holds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Child {
    /// Nothing.
    Empty,
    /// The node of that number.
    Node(u32),
    /// The leaf of that number.
    Leaf(u32),
}

/// A node: its box and its eight slots.
#[derive(Clone, Debug)]
pub(super) struct WideNode {
    /// Box around all children.
    pub bounds: Bounds,
    /// Children by slot.
    pub children: [Child; 8],
}

/// A leaf: a run of [`WideTree::references`] that fits one record.
#[derive(Clone, Debug)]
pub(super) struct WideLeaf {
    /// Box of what the leaf is responsible for.
    pub bounds: Bounds,
    /// Its first reference.
    pub first: u32,
    /// How many references, 1..=16.
    pub count: u32,
}

/// An 8-wide tree.
#[derive(Debug, Default)]
pub(super) struct WideTree {
    /// Nodes in no particular order.
    pub nodes: Vec<WideNode>,
    /// Leaves in no particular order.
    pub leaves: Vec<WideLeaf>,
    /// The leaves' triangles, by their numbers in the input.
    pub references: Vec<u32>,
}

impl WideTree {
    /// The box of a child.
    pub fn bounds(&self, child: Child) -> Bounds {
        match child {
            Child::Empty => Bounds::EMPTY,
            Child::Node(node) => self.nodes[node as usize].bounds,
            Child::Leaf(leaf) => self.leaves[leaf as usize].bounds,
        }
    }

    /// Adds a leaf.
    pub fn add_leaf(&mut self, bounds: Bounds, first: u32, count: u32) -> Child {
        self.leaves.push(WideLeaf { bounds, first, count });
        Child::Leaf((self.leaves.len() - 1) as u32)
    }

    /// Adds a node whose children stand in their slots already.
    pub fn add_node(&mut self, children: [Child; 8]) -> Child {
        let bounds = children.iter().fold(Bounds::EMPTY, |b, &child| b.union(self.bounds(child)));
        self.nodes.push(WideNode { bounds, children });
        Child::Node((self.nodes.len() - 1) as u32)
    }

    /// Adds a node over at most eight children, each in the slot that suits its place.
    pub fn add_node_by_place(&mut self, children: &[Child]) -> Child {
        let mut boxes = [Bounds::EMPTY; 8];
        for (bounds, &child) in boxes.iter_mut().zip(children) {
            *bounds = self.bounds(child);
        }
        let mut slots = [Child::Empty; 8];
        for (&child, slot) in children.iter().zip(super::assign::assign_slots(&boxes[..children.len()])) {
            slots[slot] = child;
        }
        self.add_node(slots)
    }

    /// The root's number: a tree that is one leaf gets a node above it.
    pub fn root_of(&mut self, child: Child) -> u32 {
        match child {
            Child::Node(node) => node,
            _ => match self.add_node_by_place(&[child]) {
                Child::Node(node) => node,
                _ => unreachable!("add_node_by_place returns a node"),
            },
        }
    }
}
