//! The top tree: octree cells over the bricks, 8-wide, slot = octant.
//!
//! Bricks are octree cells that do not overlap, so their Morton order is the order of the tree's leaves, and a cell of
//! the tree is a range of bricks. Cells with a single occupied octant are skipped. A node names its bricks as a run of consecutive
//! numbers; where an inner cell stands between two bricks of a node their numbers are apart, and all but the longest run
//! get a node of their own in between.
//!
//! A cell at the depth limit may be several bricks. Nothing tells where in it they lie, so a range of them is cut into
//! eight even parts, which take the slots in order.

use glam::DVec3;

use super::cell::{Cell, octant_of};
use super::quantise::set_planes;
use super::wide::Bounds;
use crate::format::{Frame, Node, Slot};

/// A brick, as the top tree sees it.
#[derive(Clone, Copy, Debug)]
pub struct TopBrick {
    /// Its octree cell.
    pub cell: Cell,
    /// Lowest and highest corner, in root units, of what it is responsible for.
    pub bounds_root: [[f64; 3]; 2],
}

/// The top tree over bricks in Morton order, whose cells do not overlap; and the most top nodes on a path.
///
/// Nodes lie breadth first; `first_leaf` holds the number of the first brick. No nodes for a single brick.
pub fn build_top(bricks: &[TopBrick]) -> (Vec<Node>, u32) {
    if bricks.len() < 2 {
        return (Vec::new(), 0);
    }
    let top = TopBuilder { bricks, codes: bricks.iter().map(|brick| brick.cell.code()).collect() };
    let mut nodes = vec![Node::EMPTY];
    let mut queue = vec![Place { what: top.cell_of_range(0, bricks.len()), frame: Frame::ROOT, level: 1 }];
    let mut position = 0;
    // Breadth first: a node's place in the queue is its place in the file.
    while position < queue.len() {
        let (node, children) = top.node(&queue[position]);
        nodes[position] = node;
        if !children.is_empty() {
            nodes[position].first_child = (queue.len() - position) as u32;
        }
        queue.extend(children);
        nodes.resize(queue.len(), Node::EMPTY);
        position += 1;
    }
    let depth = queue.iter().map(|place| place.level).max().unwrap_or(0);
    (nodes, depth)
}

/// For each brick, the top nodes on the path down to it.
pub fn top_levels(nodes: &[Node], bricks: usize) -> Vec<u32> {
    let mut of_brick = vec![0; bricks];
    let mut of_node = vec![1; nodes.len()];
    for (i, node) in nodes.iter().enumerate() {
        for slot in node.slots.iter().filter_map(|&byte| Slot::decode(byte)) {
            match slot {
                Slot::Inner(rank) => of_node[i + node.first_child as usize + usize::from(rank)] = of_node[i] + 1,
                Slot::Brick(rank) => of_brick[node.first_leaf as usize + usize::from(rank)] = of_node[i],
                Slot::Leaf(_) | Slot::Empty => {}
            }
        }
    }
    of_brick
}

/// What a top node stands for.
#[derive(Clone, Copy)]
enum What {
    /// The bricks of that range, which lie in different octants of a cell of that level.
    Bricks { first: usize, end: usize, level: u32 },
    /// The bricks of that range, which all have the same cell.
    Same { first: usize, end: usize },
    /// A single brick.
    Single(usize),
}

struct Place {
    what: What,
    frame: Frame,
    level: u32,
}

struct TopBuilder<'a> {
    bricks: &'a [TopBrick],
    codes: Vec<u64>,
}

impl TopBuilder<'_> {
    /// The least cell around at least two bricks.
    fn cell_of_range(&self, first: usize, end: usize) -> What {
        let differing = self.codes[first] ^ self.codes[end - 1];
        if differing == 0 {
            return What::Same { first, end };
        }
        let level = 20 - (63 - differing.leading_zeros()) / 3;
        What::Bricks { first, end, level }
    }

    /// The range of bricks in each octant.
    fn octants(&self, what: What) -> [std::ops::Range<usize>; 8] {
        match what {
            What::Bricks { first, end, level } => {
                let codes = &self.codes[first..end];
                let start = |i: usize| first + codes.partition_point(|&code| octant_of(code, level) < i);
                std::array::from_fn(|i| start(i)..start(i + 1))
            }
            What::Same { first, end } => {
                let start = |i: usize| first + i * (end - first) / 8;
                std::array::from_fn(|i| start(i)..start(i + 1))
            }
            What::Single(brick) => {
                let octant = octant_of(self.codes[brick], self.bricks[brick].cell.level.saturating_sub(1));
                std::array::from_fn(|i| if i == octant { brick..brick + 1 } else { 0..0 })
            }
        }
    }

    /// The node of a place, but for its first child, and its inner children.
    fn node(&self, place: &Place) -> (Node, Vec<Place>) {
        let octants = self.octants(place.what);
        let run = longest_run(&octants);
        let mut node = Node::EMPTY;
        let mut children = Vec::new();
        node.first_leaf = run.start as u32;
        for (slot, range) in octants.into_iter().enumerate().filter(|(_, range)| !range.is_empty()) {
            set_planes(&mut node, slot, &place.frame, self.bounds(&range));
            let content = if range.len() == 1 && run.contains(&range.start) {
                Slot::Brick((range.start - run.start) as u8)
            } else {
                let what = match range.len() {
                    1 => What::Single(range.start),
                    _ => self.cell_of_range(range.start, range.end),
                };
                children.push(Place { what, frame: place.frame.child(&node, slot), level: place.level + 1 });
                Slot::Inner((children.len() - 1) as u8)
            };
            node.slots[slot] = content.encode();
        }
        (node, children)
    }

    /// The box of a range of bricks.
    fn bounds(&self, range: &std::ops::Range<usize>) -> Bounds {
        self.bricks[range.clone()].iter().fold(Bounds::EMPTY, |all, brick| {
            let [min, max] = brick.bounds_root.map(DVec3::from_array);
            all.union(Bounds { min, max })
        })
    }
}

/// The longest run of consecutive bricks that each fill an octant alone; the first of equals.
fn longest_run(octants: &[std::ops::Range<usize>; 8]) -> std::ops::Range<usize> {
    let (mut best, mut run) = (0..0, 0..0);
    for octant in octants.iter().filter(|octant| octant.len() == 1) {
        run = if octant.start == run.end && !run.is_empty() { run.start..octant.end } else { octant.clone() };
        if run.len() > best.len() {
            best = run.clone();
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A brick that fills part of its cell, and a little beside it as bricks of whole triangles do.
    fn brick(cell: Cell) -> TopBrick {
        let Bounds { min, max } = cell.bounds();
        let reach = 0.3 * (max - min);
        let inside = Bounds { min: DVec3::splat(0.01), max: DVec3::splat(0.99) };
        let bounds = Bounds { min: min + reach, max: max + reach }.clipped_to(inside);
        TopBrick { cell, bounds_root: bounds.corners() }
    }

    #[test]
    fn bricks_of_one_cell_lie_side_by_side() {
        let cell = |octants: &[usize]| octants.iter().fold(Cell::ROOT, |cell, &octant| cell.child(octant));
        for count in [2, 8, 9, 65, 700] {
            let mut bricks = vec![brick(cell(&[0; 21]))];
            bricks.extend((0..count).map(|_| brick(cell(&[3; 21]))));
            bricks.push(brick(cell(&[3, 4])));
            check(&bricks);
            check(&bricks[1..=count]);
        }
    }

    /// Cells of an octree, in Morton order: `splits` says at each turn which leaf to split, and which octants live on.
    fn octree(splits: &[(usize, u8)]) -> Vec<TopBrick> {
        let mut cells = vec![Cell::ROOT];
        for &(which, octants) in splits {
            let i = which % cells.len();
            if cells[i].level < 21 && octants != 0 {
                let parent = cells[i];
                cells.splice(i..=i, (0..8).filter(|o| octants >> o & 1 != 0).map(|o| parent.child(o)));
            }
        }
        cells.into_iter().map(brick).collect()
    }

    /// Walks a top tree by the rules of FORMAT.md; the box and level at which each brick is met.
    fn walk(nodes: &[Node], bricks: usize) -> Vec<(Bounds, u32)> {
        let mut met = vec![None; bricks];
        let mut reached = 0;
        let mut stack = vec![(0usize, Frame::ROOT, Bounds { min: DVec3::ZERO, max: DVec3::ONE }, 1)];
        while let Some((i, frame, outer, level)) = stack.pop() {
            reached += 1;
            let node = &nodes[i];
            let (mut inner, mut brick) = (0, 0);
            for slot in 0..8 {
                let plane = |q: &[[u8; 8]; 3]| {
                    DVec3::from_array([0, 1, 2].map(|a| frame.corner[a] + f64::from(q[a][slot]) * frame.unit[a]))
                };
                let bounds = Bounds { min: plane(&node.low).max(outer.min), max: plane(&node.high).min(outer.max) };
                match Slot::decode(node.slots[slot]).unwrap() {
                    Slot::Empty => {}
                    Slot::Inner(rank) => {
                        assert_eq!(rank, inner, "inner children lie side by side in slot order");
                        let child = i + node.first_child as usize + usize::from(rank);
                        stack.push((child, frame.child(node, slot), bounds, level + 1));
                        inner += 1;
                    }
                    Slot::Brick(rank) => {
                        assert_eq!(rank, brick, "bricks lie side by side in slot order");
                        let number = node.first_leaf as usize + usize::from(rank);
                        assert!(met[number].replace((bounds, level)).is_none(), "met once");
                        brick += 1;
                    }
                    Slot::Leaf(_) => panic!("a leaf in the top"),
                }
            }
            assert!(inner + brick > 0);
        }
        assert_eq!(reached, nodes.len());
        met.into_iter().map(|m| m.expect("every brick is met")).collect()
    }

    fn check(bricks: &[TopBrick]) {
        let (nodes, depth) = build_top(bricks);
        if bricks.len() < 2 {
            assert_eq!((nodes.len(), depth), (0, 0));
            return;
        }
        assert!(depth <= 22);
        let met = walk(&nodes, bricks.len());
        assert_eq!(met.iter().map(|m| m.1).max(), Some(depth));
        assert_eq!(top_levels(&nodes, bricks.len()), met.iter().map(|m| m.1).collect::<Vec<_>>());
        for (brick, (bounds, _)) in bricks.iter().zip(met) {
            let [min, max] = brick.bounds_root.map(DVec3::from_array);
            assert!(bounds.min.cmple(min).all() && bounds.max.cmpge(max).all(), "{bounds:?} {brick:?}");
        }
    }

    #[test]
    fn eight_octants_are_one_node_with_octants_as_slots() {
        let bricks = octree(&[(0, 0b1111_1111)]);
        let (nodes, depth) = build_top(&bricks);
        assert_eq!((nodes.len(), depth), (1, 1));
        assert_eq!(nodes[0].slots, std::array::from_fn(|i| 0xc0 | i as u8));
        let (nodes, _) = build_top(&octree(&[(0, 0b1000_0010)]));
        assert_eq!(nodes[0].slots, [0x7f, 0xc0, 0x7f, 0x7f, 0x7f, 0x7f, 0x7f, 0xc1]);
    }

    #[test]
    fn chains_are_skipped() {
        let mut splits = vec![(0, 0b0000_1000); 15];
        splits.push((0, 0b0100_0001));
        let (nodes, depth) = build_top(&octree(&splits));
        assert_eq!((nodes.len(), depth), (1, 1));
        assert_eq!(nodes[0].slots, [0xc0, 0x7f, 0x7f, 0x7f, 0x7f, 0x7f, 0xc1, 0x7f]);
    }

    #[test]
    fn bricks_apart_get_a_node_in_between() {
        // Octants 0, 1 and 7 are bricks, octant 4 is split: bricks 0, 1, (2..10), 10.
        let bricks = octree(&[(0, 0b1001_0011), (2, 0b1111_1111)]);
        let (nodes, depth) = build_top(&bricks);
        assert_eq!((nodes.len(), depth), (3, 2));
        assert_eq!(nodes[0].slots, [0xc0, 0xc1, 0x7f, 0x7f, 0x80, 0x7f, 0x7f, 0x81]);
        assert_eq!(nodes[2].first_leaf, 10);
        check(&bricks);
    }

    #[test]
    fn the_least_cells() {
        let mut splits = vec![(0, 0b0000_0001); 20];
        splits.push((0, 0b1111_1111));
        check(&octree(&splits));
        splits.extend([(7, 1), (3, 255)]);
        check(&octree(&splits));
        // One small and one large neighbour at every level.
        check(&octree(&[(0usize, 0b1000_0001u8); 21]));
        check(&octree(&[(0usize, 0b1001_0101u8); 21]));
        check(&octree(&[]));
    }

    proptest! {
        #[test]
        fn any_octree(splits in prop::collection::vec((any::<usize>(), any::<u8>()), 1..60)) {
            check(&octree(&splits));
        }
    }
}
