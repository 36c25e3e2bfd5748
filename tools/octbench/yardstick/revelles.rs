//! A pointer octree with references in every leaf, walked as Revelles, Ureña and Lastra (2000) print it.

use super::moller_trumbore::intersect;
use super::{Corners, PlainHit};

/// Most triangles a leaf holds before it is split, and the deepest level.
const CAPACITY: usize = 16;
const DEPTH: u32 = 12;

enum Cell {
    Leaf(Vec<u32>),
    Inner(Box<[Cell; 8]>),
}

/// A plain octree over triangles in memory.
pub struct PlainOctree {
    triangles: Vec<Corners>,
    low: [f32; 3],
    high: [f32; 3],
    root: Cell,
}

/// A ray on its way: mirrored to positive directions, with the mask that undoes it.
struct Walk<'a> {
    o: [f32; 3],
    d: [f32; 3],
    tmin: f32,
    tmax: f32,
    mask: usize,
    tree: &'a PlainOctree,
    best: Option<PlainHit>,
}

impl PlainOctree {
    /// Builds the octree; a triangle's face number is its place.
    pub fn new(triangles: Vec<Corners>) -> PlainOctree {
        let (mut low, mut high) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
        for p in triangles.iter().flatten() {
            for i in 0..3 {
                low[i] = low[i].min(p[i]);
                high[i] = high[i].max(p[i]);
            }
        }
        let all = (0..triangles.len() as u32).collect();
        let root = split(&triangles, all, low, high, 0);
        PlainOctree { triangles, low, high, root }
    }

    /// The closest hit.
    pub fn closest(&self, o: [f32; 3], d: [f32; 3], tmin: f32, tmax: f32) -> Option<PlainHit> {
        let mut walk = Walk { o, d, tmin, tmax, mask: 0, tree: self, best: None };
        let (mut mirrored, mut direction) = (o, d);
        for i in 0..3 {
            if direction[i] == 0.0 {
                direction[i] = 1e-20;
            }
            if direction[i] < 0.0 {
                mirrored[i] = self.low[i] + self.high[i] - mirrored[i];
                direction[i] = -direction[i];
                walk.mask |= 4 >> i;
            }
        }
        let t0 = std::array::from_fn(|i| (self.low[i] - mirrored[i]) / direction[i]);
        let t1 = std::array::from_fn(|i| (self.high[i] - mirrored[i]) / direction[i]);
        if largest(t0) < smallest(t1) {
            walk.visit(&self.root, t0, t1);
        }
        walk.best
    }
}

/// Splits a cell until it is small or deep enough.
fn split(triangles: &[Corners], inside: Vec<u32>, low: [f32; 3], high: [f32; 3], depth: u32) -> Cell {
    if inside.len() <= CAPACITY || depth == DEPTH {
        return Cell::Leaf(inside);
    }
    let middle: [f32; 3] = std::array::from_fn(|i| 0.5 * (low[i] + high[i]));
    let children = std::array::from_fn(|octant| {
        let upper = |i: usize| octant & (4 >> i) != 0;
        let l = std::array::from_fn(|i| if upper(i) { middle[i] } else { low[i] });
        let h = std::array::from_fn(|i| if upper(i) { high[i] } else { middle[i] });
        let touches = |&&k: &&u32| {
            let t = &triangles[k as usize];
            (0..3).all(|i| {
                let (a, b) = (t[0][i].min(t[1][i]).min(t[2][i]), t[0][i].max(t[1][i]).max(t[2][i]));
                a <= h[i] && b >= l[i]
            })
        };
        split(triangles, inside.iter().filter(touches).copied().collect(), l, h, depth + 1)
    });
    Cell::Inner(Box::new(children))
}

fn largest(t: [f32; 3]) -> f32 {
    t[0].max(t[1]).max(t[2])
}

fn smallest(t: [f32; 3]) -> f32 {
    t[0].min(t[1]).min(t[2])
}

/// Table 1: the child that is entered first.
fn first_node(t0: [f32; 3], tm: [f32; 3]) -> usize {
    let mut node = 0;
    if t0[0] > t0[1] && t0[0] > t0[2] {
        node |= if tm[1] < t0[0] { 2 } else { 0 };
        node |= if tm[2] < t0[0] { 1 } else { 0 };
    } else if t0[1] > t0[2] {
        node |= if tm[0] < t0[1] { 4 } else { 0 };
        node |= if tm[2] < t0[1] { 1 } else { 0 };
    } else {
        node |= if tm[0] < t0[2] { 4 } else { 0 };
        node |= if tm[1] < t0[2] { 2 } else { 0 };
    }
    node
}

/// Table 2: the next child, where the cell is left through the plane with the smallest exit; 8 = the parent is left.
fn next_node(exit: [f32; 3], node: usize) -> usize {
    let axis = if exit[0] < exit[1] && exit[0] < exit[2] {
        0
    } else if exit[1] < exit[2] {
        1
    } else {
        2
    };
    let bit = 4 >> axis;
    if node & bit != 0 { 8 } else { node | bit }
}

impl Walk<'_> {
    /// Visits a cell with entry parameters t0 and exit parameters t1; true once the closest hit is found.
    fn visit(&mut self, cell: &Cell, t0: [f32; 3], t1: [f32; 3]) -> bool {
        if smallest(t1) < 0.0 {
            return false;
        }
        match cell {
            Cell::Leaf(inside) => self.test(inside, smallest(t1)),
            Cell::Inner(children) => self.descend(children, t0, t1),
        }
    }

    fn descend(&mut self, children: &[Cell; 8], t0: [f32; 3], t1: [f32; 3]) -> bool {
        let tm: [f32; 3] = std::array::from_fn(|i| 0.5 * (t0[i] + t1[i]));
        let mut node = first_node(t0, tm);
        while node < 8 {
            let upper = |i: usize| node & (4 >> i) != 0;
            let near = std::array::from_fn(|i| if upper(i) { tm[i] } else { t0[i] });
            let far = std::array::from_fn(|i| if upper(i) { t1[i] } else { tm[i] });
            if self.visit(&children[node ^ self.mask], near, far) {
                return true;
            }
            node = next_node(far, node);
        }
        false
    }

    /// Tests a leaf's triangles; a hit within the cell ends the walk.
    fn test(&mut self, inside: &[u32], exit: f32) -> bool {
        for &face in inside {
            if let Some((t, u, v)) = intersect(self.o, self.d, &self.tree.triangles[face as usize]) {
                let nearer = self.best.is_none_or(|b| t < b.t);
                if nearer && t >= self.tmin && t <= self.tmax {
                    self.best = Some(PlainHit { t, face, u, v });
                }
            }
        }
        self.best.is_some_and(|b| b.t <= exit)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hits_what_is_plainly_there() {
        let square = vec![
            [[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.5]],
            [[-1.0, -1.0, 3.0], [1.0, -1.0, 3.0], [1.0, 1.0, 3.0]],
        ];
        let tree = PlainOctree::new(square);
        let hit = tree.closest([0.5, -0.25, 10.0], [0.0, 0.0, -1.0], 0.0, f32::INFINITY).unwrap();
        assert_eq!((hit.face, hit.t), (1, 7.0));
        assert!(tree.closest([-0.5, 0.5, 10.0], [0.0, 0.0, -1.0], 0.0, f32::INFINITY).is_none());
    }
}
