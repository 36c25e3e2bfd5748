//! The top tree: octree cells over the bricks, collapsed into 8-wide nodes.
//!
//! Bricks are octree cells that do not overlap, in Morton order. Halving the range of their codes bit by bit makes a binary
//! tree of boxes that do not overlap but for what triangles reach over; the cheapest 8-wide tree over it ([`super::collapse`])
//! skips cells that divide little, as where a mesh is a little longer than a cell. Slots are assigned by place as in
//! pages. A node names its bricks by their distance from the first of them, at most [`REACH`]; one farther off gets a
//! node of its own in between.

use glam::DVec3;

use super::assign::assign_slots;
use super::cell::Cell;
use super::collapse::{Costs, Linked, Plan, children};
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

/// Greatest distance of a brick from the first brick of its node.
const REACH: u32 = 63;
/// Most top nodes on a path; with [`super::sah`]'s limit below it a path stays within the 64 that a file allows.
const LEVELS: u32 = 22;

/// The top tree over bricks in Morton order, whose cells do not overlap; and the most top nodes on a path.
///
/// Nodes lie breadth first; `first_leaf` holds the number of the first brick. No nodes for a single brick.
pub fn build_top(bricks: &[TopBrick]) -> (Vec<Node>, u32) {
    if bricks.len() < 2 {
        return (Vec::new(), 0);
    }
    let mut top = TopBuilder { bricks, cells: Vec::with_capacity(2 * bricks.len()) };
    top.halve(0, bricks.len());
    let cheapest = top.emit();
    if cheapest.1 <= LEVELS {
        return cheapest;
    }
    // Freak meshes only: what is near the root in the binary tree then is so in the 8-wide one.
    top.cells.iter_mut().for_each(|cell| cell.plan = Plan::BALANCED);
    top.emit()
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

/// A cell of the binary tree over the bricks; its left half is the next one.
struct BinaryCell {
    /// Its first brick.
    first: usize,
    bounds: Bounds,
    /// Distance to the right half; 0 for a single brick.
    right: usize,
    plan: Plan,
}

impl Linked for BinaryCell {
    fn link(&self) -> (usize, &Plan) {
        (self.right, &self.plan)
    }
}

/// A node that has its place and waits to be written.
struct Place {
    /// The cell it divides, or the single brick it leads to.
    cell: usize,
    frame: Frame,
    level: u32,
}

struct TopBuilder<'a> {
    bricks: &'a [TopBrick],
    cells: Vec<BinaryCell>,
}

impl TopBuilder<'_> {
    /// Adds the cell of a range of bricks and all below it; its box and costs.
    fn halve(&mut self, first: usize, end: usize) -> (Bounds, Costs) {
        let here = self.cells.len();
        let [min, max] = self.bricks[first].bounds_root.map(DVec3::from_array);
        self.cells.push(BinaryCell { first, bounds: Bounds { min, max }, right: 0, plan: Plan::default() });
        if end - first == 1 {
            // A brick costs the same wherever it hangs.
            return (self.cells[here].bounds, Costs::terminal(0.0));
        }
        let code = |brick: usize| self.bricks[brick].cell.code();
        let middle = match (code(first) ^ code(end - 1)).checked_ilog2() {
            Some(bit) => first + self.bricks[first..end].partition_point(|brick| brick.cell.code() >> bit & 1 == 0),
            // Bricks of one and the same cell.
            None => (first + end) / 2,
        };
        let (left, left_costs) = self.halve(first, middle);
        self.cells[here].right = self.cells.len() - here;
        let (right, right_costs) = self.halve(middle, end);
        let bounds = left.union(right);
        let (costs, plan) = Costs::of_parent(bounds.half_area(), false, &left_costs, &right_costs);
        (self.cells[here].bounds, self.cells[here].plan) = (bounds, plan);
        (bounds, costs)
    }

    /// The nodes by the cells' plans, and the most on a path.
    fn emit(&self) -> (Vec<Node>, u32) {
        let mut nodes = vec![Node::EMPTY];
        let mut queue = vec![Place { cell: 0, frame: Frame::ROOT, level: 1 }];
        let mut position = 0;
        // Breadth first: a node's place in the queue is its place in the file.
        while position < queue.len() {
            let (node, below) = self.node(&queue[position]);
            nodes[position] = node;
            if !below.is_empty() {
                nodes[position].first_child = (queue.len() - position) as u32;
            }
            queue.extend(below);
            nodes.resize(queue.len(), Node::EMPTY);
            position += 1;
        }
        let depth = queue.iter().map(|place| place.level).max().unwrap_or(0);
        (nodes, depth)
    }

    /// The node of a place, but for its first child, and its inner children.
    fn node(&self, place: &Place) -> (Node, Vec<Place>) {
        let (cut, len) = match self.cells[place.cell].right {
            0 => ([place.cell; 8], 1),
            _ => children(&self.cells, place.cell),
        };
        let cells = cut.map(|cell| &self.cells[cell]);
        let boxes = cells.map(|cell| cell.bounds);
        let slots: Vec<usize> = assign_slots(&boxes[..len]).collect();
        let bricks = cells[..len].iter().filter(|cell| cell.right == 0).map(|cell| cell.first as u32);
        let first = best_first(&bricks.collect::<Vec<_>>());

        let mut node = Node::EMPTY;
        let mut below = Vec::new();
        node.first_leaf = first.unwrap_or(0);
        let mut in_order: Vec<usize> = (0..len).collect();
        in_order.sort_by_key(|&child| slots[child]);
        for child in in_order {
            let (cell, slot) = (cells[child], slots[child]);
            set_planes(&mut node, slot, &place.frame, cell.bounds);
            let rank = (cell.first as u32).wrapping_sub(node.first_leaf);
            let content = if cell.right == 0 && rank <= REACH {
                Slot::Brick(rank as u8)
            } else {
                below.push(Place { cell: cut[child], frame: place.frame.child(&node, slot), level: place.level + 1 });
                Slot::Inner((below.len() - 1) as u8)
            };
            node.slots[slot] = content.encode();
        }
        (node, below)
    }
}

/// The one of a few bricks (in order) that has the most of the others within reach.
fn best_first(bricks: &[u32]) -> Option<u32> {
    let within = |first: u32| bricks.iter().filter(|&&brick| brick >= first && brick - first <= REACH).count();
    bricks.iter().copied().reduce(|best, next| if within(next) > within(best) { next } else { best })
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
        // Both lie at high z, and x and y part them alike: they take the lowest slots that differ on one of these.
        assert_eq!(nodes[0].slots, [0xc0, 0x7f, 0xc1, 0x7f, 0x7f, 0x7f, 0x7f, 0x7f]);
    }

    #[test]
    fn chains_are_skipped() {
        let mut splits = vec![(0, 0b1000_0000)];
        splits.extend([(0, 0b0000_0001); 14]);
        splits.push((0, 0b0100_0001));
        let (nodes, depth) = build_top(&octree(&splits));
        assert_eq!((nodes.len(), depth), (1, 1));
        assert_eq!(nodes[0].slots, [0xc0, 0x7f, 0xc1, 0x7f, 0x7f, 0x7f, 0x7f, 0x7f]);
    }

    #[test]
    fn bricks_out_of_reach_get_a_node_in_between() {
        // Octants 0, 1 and 7 are bricks, octant 4 is 8 or 64 of them in between: bricks 0, 1, (2..10 or 66), the last.
        let mut splits = vec![(0, 0b1001_0011), (2, 0b1111_1111)];
        let few = octree(&splits);
        let (nodes, depth) = build_top(&few);
        assert_eq!((nodes.len(), depth), (2, 2));
        assert!(nodes[0].slots.contains(&(0xc0 | 10)), "{:?}", nodes[0].slots);
        check(&few);
        splits.extend((0..8).map(|i| (2 + 8 * i, 0b1111_1111)));
        let many = octree(&splits);
        let (nodes, _) = build_top(&many);
        let alone = nodes.iter().filter(|node| node.slots.iter().filter(|&&slot| slot != 0x7f).count() == 1);
        assert_eq!(alone.map(|node| node.first_leaf).collect::<Vec<_>>(), [66]);
        check(&many);
    }

    #[test]
    fn a_cell_that_divides_little_is_skipped() {
        // Octant 0 is nearly all, the others hold one sliver each; its own octants hang at the root with them where they can.
        let bricks = octree(&[(0, 0b0000_1001), (0, 0b1111_1101)]);
        let (nodes, depth) = build_top(&bricks);
        assert_eq!((nodes.len(), depth), (1, 1), "{bricks:?}");
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
