//! Mends a binary tree: each node is taken out and put where it adds least surface.
//!
//! After Meister and Bittner (2018), "Parallel reinsertion for bounding volume hierarchy optimization", but one node at a
//! time, so that the result depends on the tree alone. Splitting from the root down cannot part a few huge triangles from
//! the many small ones that they lie among; here a wall that makes a deep node large moves up to where only walls are.
//!
//! Where a node would go is found by branch and bound: from its parent up, and down each sibling as long as what is gained
//! so far exceeds the node's own surface, which it adds wherever it goes. A search ends after [`SEARCH`] nodes, so that time
//! grows with the number of nodes only, whatever the mesh; mending ends where the boxes of long paths take [`REFITS`] steps a
//! node to make fit.

use glam::Vec3A;

use super::primitive::Span;
use super::sah::BinaryNode;

/// How often all nodes are tried. Two rounds make the tree of an interior some 20 % cheaper to walk, four 1 % more.
const ROUNDS: usize = 2;
/// Most nodes that are looked at to find one node's place.
const SEARCH: usize = 1024;
/// Steps up the tree, for each node, that boxes may be made to fit in; a mesh whose moves need more is left as it is then.
const REFITS: usize = 64;
/// A move must gain more than this part of the surface of the node's parent: none for the sake of rounding.
const LEAST: f64 = 1e-6;
/// Longest path of a tree that is returned: far more than that of any but a freak mesh.
const LONGEST: usize = 200;

/// The nodes of the mended tree, in preorder as they were, but without plans; `None` if a path became too long.
pub(super) fn optimise(nodes: Vec<BinaryNode>) -> Option<Vec<BinaryNode>> {
    let mut tree = Tree::of(nodes);
    tree.mend();
    tree.in_preorder()
}

/// What stands for the root's parent.
const NONE: u32 = u32::MAX;

/// A tree whose nodes stay where they are. In an inner node `first` and `right` are the numbers of its children; no child is
/// number 0, the root, so that `right` = 0 still marks a terminal node.
struct Tree {
    nodes: Vec<BinaryNode>,
    parents: Vec<u32>,
    /// Steps that were taken to make boxes fit.
    refits: usize,
}

impl Tree {
    fn of(mut nodes: Vec<BinaryNode>) -> Tree {
        let mut parents = vec![NONE; nodes.len()];
        for (i, node) in (0u32..).zip(&mut nodes).filter(|(_, node)| node.right != 0) {
            (node.first, node.right) = (i + 1, i + node.right);
            parents[node.first as usize] = i;
            parents[node.right as usize] = i;
        }
        Tree { nodes, parents, refits: 0 }
    }

    /// Moves nodes to better places.
    fn mend(&mut self) {
        let mut order: Vec<u32> = (1..self.nodes.len() as u32).collect();
        for _ in 0..ROUNDS {
            // The largest first: they have most to gain.
            order.sort_unstable_by(|&a, &b| self.area(b).total_cmp(&self.area(a)).then(a.cmp(&b)));
            for &node in &order {
                if self.refits > REFITS * self.nodes.len() {
                    return;
                }
                if let Some(to) = self.best_place(node) {
                    self.reinsert(node, to);
                }
            }
        }
    }

    fn span(&self, node: u32) -> Span {
        let node = &self.nodes[node as usize];
        Span { min: Vec3A::from_array(node.min), max: Vec3A::from_array(node.max) }
    }

    fn area(&self, node: u32) -> f64 {
        self.span(node).half_area()
    }

    fn parent(&self, node: u32) -> u32 {
        self.parents[node as usize]
    }

    fn children(&self, node: u32) -> Option<[u32; 2]> {
        let node = &self.nodes[node as usize];
        (node.right != 0).then_some([node.first, node.right])
    }

    /// The other child of a node's parent. Not for the root.
    fn sibling(&self, node: u32) -> u32 {
        let parent = &self.nodes[self.parent(node) as usize];
        if parent.first == node { parent.right } else { parent.first }
    }

    /// The node that is best to have as sibling, if that is another than now: what is gained is the surface that leaves
    /// the tree with the node's parent, and with what the boxes above lose, less that of the new parent and of what the
    /// boxes above it grow by.
    fn best_place(&self, node: u32) -> Option<u32> {
        let parent = self.parent(node);
        if self.parent(parent) == NONE {
            return None;
        }
        let (span, area) = (self.span(node), self.area(node));
        let brother = self.sibling(node);
        let mut gain = self.area(parent);
        let mut best = (LEAST * gain, brother);
        let (mut pivot, mut sibling, mut below) = (parent, brother, self.span(brother));
        let mut looked = 0;
        let mut stack = Vec::new();
        loop {
            stack.push((gain, sibling));
            while let Some((gain, at)) = stack.pop() {
                looked += 1;
                if looked > SEARCH {
                    break;
                }
                if gain - area <= best.0 {
                    continue;
                }
                let left = gain - self.span(at).union(span).half_area();
                if left > best.0 && at != brother {
                    best = (left, at);
                }
                if let Some(children) = self.children(at) {
                    let gain = left + self.area(at);
                    stack.extend(children.map(|child| (gain, child)));
                }
            }
            if pivot != parent {
                below = below.union(self.span(sibling));
                gain += self.area(pivot) - below.half_area();
            }
            if self.parent(pivot) == NONE || looked > SEARCH {
                return (best.1 != brother).then_some(best.1);
            }
            (sibling, pivot) = (self.sibling(pivot), self.parent(pivot));
        }
    }

    /// Takes a node out and makes it the sibling of `to`; its old parent becomes the parent of both.
    fn reinsert(&mut self, node: u32, to: u32) {
        let (parent, brother) = (self.parent(node), self.sibling(node));
        let old = self.parent(parent);
        self.replace(old, parent, brother);
        let above = self.parent(to);
        self.replace(above, to, parent);
        let place = &mut self.nodes[parent as usize];
        (place.first, place.right) = (to, node);
        self.parents[to as usize] = parent;
        self.refit(parent);
        self.refit(above);
        self.refit(old);
    }

    fn replace(&mut self, above: u32, child: u32, by: u32) {
        let node = &mut self.nodes[above as usize];
        let place = if node.first == child { &mut node.first } else { &mut node.right };
        *place = by;
        self.parents[by as usize] = above;
    }

    /// Makes the boxes fit from a node up, as far as they change.
    fn refit(&mut self, mut at: u32) {
        while let Some([first, second]) = self.children(at) {
            self.refits += 1;
            let span = self.span(first).union(self.span(second));
            let node = &mut self.nodes[at as usize];
            let (min, max) = (span.min.to_array(), span.max.to_array());
            if (node.min, node.max) == (min, max) || self.parents[at as usize] == NONE {
                return;
            }
            (node.min, node.max) = (min, max);
            at = self.parents[at as usize];
        }
    }

    /// The nodes in preorder, linked as [`BinaryNode`] says.
    fn in_preorder(&self) -> Option<Vec<BinaryNode>> {
        let mut nodes: Vec<BinaryNode> = Vec::with_capacity(self.nodes.len());
        // A node, the one whose right child it is, and its level.
        let mut stack: Vec<(u32, Option<usize>, usize)> = vec![(0, None, 0)];
        while let Some((at, right_of, level)) = stack.pop() {
            let here = nodes.len();
            if let Some(parent) = right_of {
                nodes[parent].right = (here - parent) as u32;
            }
            nodes.push(BinaryNode { right: 0, ..self.nodes[at as usize].clone() });
            if let Some([first, second]) = self.children(at) {
                stack.push((second, Some(here), level + 1));
                stack.push((first, None, level + 1));
            }
            if level > LONGEST {
                return None;
            }
        }
        for i in (0..nodes.len()).rev() {
            if nodes[i].right != 0 {
                let second = i + nodes[i].right as usize;
                (nodes[i].first, nodes[i].count) = (nodes[i + 1].first, nodes[i + 1].count + nodes[second].count);
            }
        }
        Some(nodes)
    }
}

#[cfg(test)]
mod tests {
    use super::super::collapse::Plan;
    use super::*;
    use proptest::prelude::*;

    /// A tree over boxes, halved without regard to where they lie: there is much to mend.
    fn halved(boxes: &[[f32; 6]], first: u32, nodes: &mut Vec<BinaryNode>) -> Span {
        let here = nodes.len();
        let [x, y, z, u, v, w] = boxes[0];
        let (min, max) = ([x, y, z], [x + u, y + v, z + w]);
        nodes.push(BinaryNode { min, max, right: 0, first, count: boxes.len() as u32, plan: Plan::default() });
        let mut span = Span { min: min.into(), max: max.into() };
        if boxes.len() > 1 {
            let (low, high) = boxes.split_at(boxes.len() / 2);
            span = halved(low, first, nodes);
            nodes[here].right = (nodes.len() - here) as u32;
            span = span.union(halved(high, first + low.len() as u32, nodes));
        }
        (nodes[here].min, nodes[here].max) = (span.min.to_array(), span.max.to_array());
        span
    }

    /// Checks links, counts and boxes below a node; its terminal nodes by `first`, and the sum of all surfaces.
    fn check(nodes: &[BinaryNode], at: usize, terminals: &mut Vec<u32>) -> (usize, f64) {
        let node = &nodes[at];
        let span = |node: &BinaryNode| Span { min: node.min.into(), max: node.max.into() };
        let area = span(node).half_area();
        if node.right == 0 {
            terminals.push(node.first);
            return (at + 1, area);
        }
        let right = at + node.right as usize;
        let (end, low) = check(nodes, at + 1, terminals);
        assert_eq!(end, right);
        let (end, high) = check(nodes, right, terminals);
        let both = span(&nodes[at + 1]).union(span(&nodes[right]));
        assert_eq!((both.min.to_array(), both.max.to_array()), (node.min, node.max));
        assert_eq!(node.count, nodes[at + 1].count + nodes[right].count);
        (end, area + low + high)
    }

    proptest! {
        /// Every terminal node is kept, every box fits, and the tree is no larger than it was.
        #[test]
        fn trees_stay_whole_and_shrink(boxes in prop::collection::vec(prop::array::uniform6(0.0f32..1.0), 1..200)) {
            let mut nodes = Vec::new();
            halved(&boxes, 0, &mut nodes);
            let (_, before) = check(&nodes, 0, &mut Vec::new());
            let mended = optimise(nodes.clone()).expect("short paths");
            let mut terminals = Vec::new();
            let (end, after) = check(&mended, 0, &mut terminals);
            prop_assert_eq!(end, nodes.len());
            terminals.sort_unstable();
            prop_assert_eq!(terminals, (0..boxes.len() as u32).collect::<Vec<_>>());
            prop_assert!(after <= before * (1.0 + 1e-9), "{after} of {before}");
        }
    }

    /// Dust along a line with a wall in the midst of each eighth.
    fn dust_and_walls() -> Vec<BinaryNode> {
        let boxes: Vec<[f32; 6]> = (0..64)
            .map(|i| match i % 8 {
                3 => [0.0, 0.0, 0.0, 64.0, 64.0, 0.1],
                _ => [i as f32, 0.0, 0.0, 0.5, 0.5, 0.5],
            })
            .collect();
        let mut nodes = Vec::new();
        halved(&boxes, 0, &mut nodes);
        nodes
    }

    #[test]
    fn a_wall_leaves_the_dust() {
        // The walls end up together, away from the dust.
        let nodes = dust_and_walls();
        let (_, before) = check(&nodes, 0, &mut Vec::new());
        let mended = optimise(nodes).expect("short paths");
        let (_, after) = check(&mended, 0, &mut Vec::new());
        let walls = 64.0 * 64.0 + 2.0 * 6.4;
        assert!(before > 30.0 * walls && after < 24.0 * walls, "{before} {after} {walls}");
    }

    /// No mesh was found that takes [`REFITS`] steps a node (lists of thousands of boxes took 15), so most of them are taken in advance.
    #[test]
    fn mending_ends_where_the_steps_are_used_up() {
        let mended = |taken: usize| {
            let mut tree = Tree::of(dust_and_walls());
            tree.refits = taken;
            tree.mend();
            let nodes = tree.in_preorder().expect("short paths");
            (check(&nodes, 0, &mut Vec::new()).1, tree.refits - taken)
        };
        let all = REFITS * dust_and_walls().len();
        let (_, unmended) = check(&dust_and_walls(), 0, &mut Vec::new());
        let (whole, steps) = mended(0);
        assert!(steps > 100 && steps < all, "{steps} steps");
        // The last move may take three paths more than there were, and they are short here.
        let (part, some) = mended(all - 50);
        assert!(some > 50 && some < 100, "{some} steps");
        assert!(whole < part && part < unmended, "{whole} {part} {unmended}");
        assert_eq!(mended(all + 1), (unmended, 0));
    }

    #[test]
    fn long_paths_are_refused() {
        assert!(list(150).in_preorder().is_some());
        assert!(list(250).in_preorder().is_none());
    }

    /// A tree that is a list of `count` boxes.
    fn list(count: u32) -> Tree {
        let places: Vec<f32> = std::iter::successors(Some(1.0), |x| Some(1.3 * x)).take(count as usize + 1).collect();
        let node = |first: u32, last: u32, right: u32| {
            let x = places[last as usize];
            let (min, max) = ([places[first as usize], 0.0, 0.0], [1.01 * x, 0.01 * x, 0.01 * x]);
            BinaryNode { min, max, right, first, count: last - first + 1, plan: Plan::default() }
        };
        let inner = (2..=count).rev().map(|k| node(1, k, 2 * k - 2));
        let nodes: Vec<BinaryNode> = inner.chain((1..=count).map(|k| node(k, k, 0))).collect();
        check(&nodes, 0, &mut Vec::new());
        Tree::of(nodes)
    }
}
