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

impl Plan {
    /// Without regard to costs: as equal shares as can be.
    pub const BALANCED: Plan = Plan([1, 1, 1, 2, 2, 3, 3, 4]);
}

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
        let (cut, len) = children(self.binary, node);
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
        let below = &self.primitives[at..at + binary.count as usize];
        let numbers = below.iter().map(|primitive| self.order[primitive.id as usize]);
        // As many primitives as triangles: all are whole.
        if self.primitives.len() == self.order.len() {
            return references.extend(numbers);
        }
        for reference in numbers {
            if !references[first..].contains(&reference) {
                references.push(reference);
            }
        }
    }
}

/// Nodes on the longest path of the 8-wide tree over a binary one.
pub(super) fn levels(nodes: &[BinaryNode]) -> u32 {
    let (mut deepest, mut stack) = (1, vec![(0, 1)]);
    while let Some((node, level)) = stack.pop() {
        if nodes[node].right == 0 || nodes[node].plan.0[0] == 0 {
            continue;
        }
        deepest = deepest.max(level);
        let (cut, len) = children(nodes, node);
        stack.extend(cut[..len].iter().map(|&child| (child, level + 1)));
    }
    deepest
}

impl Linked for BinaryNode {
    fn link(&self) -> (usize, &Plan) {
        (self.right as usize, &self.plan)
    }
}

/// A node of a binary tree in preorder.
pub(super) trait Linked {
    /// The distance to its right child (the left one is next; 0 = none), and its plan.
    fn link(&self) -> (usize, &Plan);
}

/// The nodes of a binary tree that become the children of an 8-wide node in place of `node`, which has children.
pub(super) fn children<N: Linked>(tree: &[N], node: usize) -> ([usize; 8], usize) {
    let (mut cut, mut len) = ([0; 8], 0);
    cut_below(tree, node, 8, &mut cut, &mut len);
    (cut, len)
}

/// The nodes that stand for `node` when it may have up to `slots` children of the node above.
fn cut<N: Linked>(tree: &[N], node: usize, slots: usize, taken: &mut [usize; 8], len: &mut usize) {
    let (right, plan) = tree[node].link();
    let fewest = (2..=slots).rev().find(|&i| plan.0[i - 1] != 0);
    match fewest {
        Some(i) if right != 0 => cut_below(tree, node, i, taken, len),
        _ => {
            taken[*len] = node;
            *len += 1;
        }
    }
}

/// The same, divided for certain: by the plan for exactly `slots`.
fn cut_below<N: Linked>(tree: &[N], node: usize, slots: usize, taken: &mut [usize; 8], len: &mut usize) {
    let (right, plan) = tree[node].link();
    let share = usize::from(plan.0[slots - 1]);
    cut(tree, node + 1, share, taken, len);
    cut(tree, node + right, slots - share, taken, len);
}
