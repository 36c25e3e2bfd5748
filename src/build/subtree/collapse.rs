//! From the binary tree to 8-wide nodes: the cheapest cut, by dynamic programming.
//!
//! After Ylitie, Karras and Laine (2017), section 3.1. C(n, i) is the least cost of representing the subtree of n by at
//! most i children of some node:
//!
//! - C(n, 1) = min(leaf, node), leaf = A(n) * [`LEAF_COST`] where one record holds the subtree, whatever its number of
//!   triangles (the kernel tests 16 at once), node = A(n) * [`NODE_COST`] + D(n, 8);
//! - C(n, i) = min(C(n, i - 1), D(n, i)), where D(n, i) = min over 0 < k < i of C(left, k) + C(right, i - k).
//!
//! Costs travel up while the binary tree is built; only the choices ([`Plan`], 8 bytes a node) are kept for the way down.

use super::primitive::Primitive;
use super::sah::{Binary, BinaryNode};
use super::wide::{Bounds, Child, WideTree};
use crate::geometry::{Aabb, RootCube};

/// Cost of visiting a node, per unit of area.
const NODE_COST: f64 = 1.0;
/// Cost of visiting a leaf.
const LEAF_COST: f64 = 1.0;

/// C(n, i) for i = 1..=7, at place i - 1.
pub(super) struct Costs([f64; 7]);

/// The choices behind the costs. Place i - 1 is for i children: 0 = the same as for i - 1 children, else how many of
/// them go to the left child. Place 0: 0 = a leaf, 1 = a node of its own. Place 7 is for the eight children of that node.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Plan([u8; 8]);

impl Costs {
    /// Of a subtree that is a leaf and is not divided.
    pub fn terminal(area: f64) -> Costs {
        Costs([area * LEAF_COST; 7])
    }

    /// The cost as a single child of some node.
    pub fn as_child(&self) -> f64 {
        self.0[0]
    }

    /// Of a node with two children. `is_record`: whether one leaf record holds the whole subtree.
    pub fn of_parent(area: f64, is_record: bool, left: &Costs, right: &Costs) -> (Costs, Plan) {
        let mut costs = [0.0; 7];
        let mut plan = [0u8; 8];
        let (eight, share) = distribute(left, right, 8);
        plan[7] = share;
        let node = area * NODE_COST + eight;
        let leaf = if is_record { area * LEAF_COST } else { f64::INFINITY };
        (costs[0], plan[0]) = if leaf <= node { (leaf, 0) } else { (node, 1) };
        for i in 2..=7 {
            let (cost, share) = distribute(left, right, i);
            let fewer = costs[i - 2];
            (costs[i - 1], plan[i - 1]) = if cost < fewer { (cost, share) } else { (fewer, 0) };
        }
        (Costs(costs), Plan(plan))
    }
}

/// D(n, i) and the left child's share of the i children.
fn distribute(left: &Costs, right: &Costs, i: usize) -> (f64, u8) {
    let mut best = (f64::INFINITY, 1);
    for k in 1..i {
        let cost = left.0[k - 1] + right.0[i - k - 1];
        if cost < best.0 {
            best = (cost, k as u8);
        }
    }
    best
}

/// The 8-wide tree over a binary tree.
pub(super) fn collapse(binary: &Binary, order: &[u32], root: RootCube) -> WideTree {
    let count = binary.nodes[0].count as usize;
    let mut tree = WideTree {
        references: Vec::with_capacity(count),
        leaves: Vec::with_capacity(count / 8 + 1),
        nodes: Vec::with_capacity(count / 32 + 1),
    };
    let top = Collapse { binary: &binary.nodes, primitives: &binary.primitives, order, root }.child(&mut tree, 0);
    let top = tree.root_of(top);
    debug_assert_eq!(top as usize, tree.nodes.len() - 1, "the root is the last node");
    tree
}

struct Collapse<'a> {
    binary: &'a [BinaryNode],
    primitives: &'a [Primitive],
    order: &'a [u32],
    root: RootCube,
}

impl Collapse<'_> {
    /// The subtree of `node` as a single child: a leaf or an 8-wide node.
    fn child(&self, tree: &mut WideTree, node: usize) -> Child {
        let binary = &self.binary[node];
        if binary.right == 0 || binary.plan.0[0] == 0 {
            let first = tree.references.len();
            self.gather(node, first, &mut tree.references);
            let bounds = Bounds::of(Aabb { min: binary.min.into(), max: binary.max.into() }, self.root);
            return tree.add_leaf(bounds, first as u32, (tree.references.len() - first) as u32);
        }
        let (mut cut, mut len) = ([0; 8], 0);
        self.cut_below(node, 8, &mut cut, &mut len);
        let mut made = [Child::Empty; 8];
        for (child, &n) in made.iter_mut().zip(&cut[..len]) {
            *child = self.child(tree, n);
        }
        tree.add_node_by_place(&made[..len])
    }

    /// Adds the triangles of a subtree that is to be a leaf, whose first is number `first`: parts of one that meet again
    /// in it count once.
    fn gather(&self, node: usize, first: usize, references: &mut Vec<u32>) {
        let binary = &self.binary[node];
        if binary.right != 0 {
            self.gather(node + 1, first, references);
            return self.gather(node + binary.right as usize, first, references);
        }
        let at = binary.first as usize;
        for primitive in &self.primitives[at..at + binary.count as usize] {
            let reference = self.order[primitive.id as usize];
            if !references[first..].contains(&reference) {
                references.push(reference);
            }
        }
    }

    /// The binary nodes that stand for `node` when it may have up to `slots` children of the node above.
    fn cut(&self, node: usize, slots: usize, cut: &mut [usize; 8], len: &mut usize) {
        let binary = &self.binary[node];
        let fewest = (2..=slots).rev().find(|&i| binary.plan.0[i - 1] != 0);
        match fewest {
            Some(i) if binary.right != 0 => self.cut_below(node, i, cut, len),
            _ => {
                cut[*len] = node;
                *len += 1;
            }
        }
    }

    /// The same, divided for certain: by the plan for exactly `slots`.
    fn cut_below(&self, node: usize, slots: usize, cut: &mut [usize; 8], len: &mut usize) {
        let binary = &self.binary[node];
        let share = usize::from(binary.plan.0[slots - 1]);
        self.cut(node + 1, share, cut, len);
        self.cut(node + binary.right as usize, slots - share, cut, len);
    }
}
