//! A small tree over the boxes of many objects.
//!
//! A binary tree split at the median of the widest axis. Its boxes are conservative: they are widened, per ray, by what
//! the rounding of the ray to an object's space may move a hit, so that the tree never changes a picture; only which
//! objects are asked. Planes have no box and stand outside.

use glam::DVec3;

/// Objects without a box worth a node of their own.
const LEAF: usize = 2;
/// 2^-20: sixteen times the rounding of f32, for origin, direction and distance together.
const ROUNDING: f64 = 1.0 / 1_048_576.0;
/// Deeper than any tree over 2^32 objects split at the median.
const STACK: usize = 48;

/// What the tree must know about an object.
#[derive(Clone, Copy, Debug)]
pub(super) struct Item {
    pub object: u32,
    pub min: DVec3,
    pub max: DVec3,
    /// Condition of its transform.
    pub slack: f64,
    /// Size of the coordinates involved.
    pub size: f64,
}

/// The tree.
#[derive(Debug)]
pub(super) struct Tree {
    nodes: Vec<Node>,
    objects: Vec<u32>,
}

#[derive(Clone, Copy, Debug)]
struct Node {
    min: DVec3,
    max: DVec3,
    slack: f64,
    size: f64,
    /// First object of a leaf, or the second child (the first child follows its parent).
    next: u32,
    /// Objects of a leaf, 0 for an inner node.
    count: u32,
}

impl Tree {
    /// A tree over these items.
    pub fn new(mut items: Vec<Item>) -> Tree {
        let mut tree = Tree { nodes: Vec::with_capacity(items.len()), objects: Vec::with_capacity(items.len()) };
        if !items.is_empty() {
            tree.grow(&mut items);
        }
        tree
    }

    fn grow(&mut self, items: &mut [Item]) {
        let number = self.nodes.len();
        let mut node = Node {
            min: DVec3::INFINITY,
            max: DVec3::NEG_INFINITY,
            slack: 0.0,
            size: 0.0,
            next: self.objects.len() as u32,
            count: items.len() as u32,
        };
        let mut centers = [DVec3::INFINITY, DVec3::NEG_INFINITY];
        for i in items.iter() {
            (node.min, node.max) = (node.min.min(i.min), node.max.max(i.max));
            (node.slack, node.size) = (node.slack.max(i.slack), node.size.max(i.size));
            let center = (i.min + i.max) * 0.5;
            centers = [centers[0].min(center), centers[1].max(center)];
        }
        self.nodes.push(node);
        if items.len() <= LEAF {
            self.objects.extend(items.iter().map(|i| i.object));
            return;
        }
        let axis = (centers[1] - centers[0]).max_position();
        let half = items.len() / 2;
        items.select_nth_unstable_by(half, |a, b| {
            (a.min[axis] + a.max[axis]).total_cmp(&(b.min[axis] + b.max[axis])).then(a.object.cmp(&b.object))
        });
        let (left, right) = items.split_at_mut(half);
        self.grow(left);
        let next = self.nodes.len() as u32;
        (self.nodes[number].next, self.nodes[number].count) = (next, 0);
        self.grow(right);
    }

    /// Calls `visit` with every object whose box the ray may meet up to the t that `visit` last returned, near ones
    /// first where that costs nothing; stops when `visit` returns a negative number.
    pub fn visit<E>(
        &self,
        origin: DVec3,
        direction: DVec3,
        tmin: f32,
        tmax: f32,
        mut visit: impl FnMut(u32) -> Result<f32, E>,
    ) -> Result<(), E> {
        let mut far = f64::from(tmax);
        let reach = origin.abs().max_element();
        let enter = |node: &Node, far: f64| node.enter(origin, direction, reach, f64::from(tmin), far);
        let (mut stack, mut height) = ([(0u32, 0.0f64); STACK], 0);
        if let Some(t) = self.nodes.first().and_then(|root| enter(root, far)) {
            (stack[0], height) = ((0, t), 1);
        }
        while height > 0 {
            height -= 1;
            let (number, t) = stack[height];
            if t > far {
                continue;
            }
            let node = &self.nodes[number as usize];
            if node.count > 0 {
                let objects = &self.objects[node.next as usize..][..node.count as usize];
                for &object in objects {
                    far = f64::from(visit(object)?);
                    if far < 0.0 {
                        return Ok(());
                    }
                }
                continue;
            }
            let children = [number + 1, node.next].map(|c| (c, enter(&self.nodes[c as usize], far)));
            let swap = matches!((children[0].1, children[1].1), (Some(a), Some(b)) if a < b);
            for (child, t) in if swap { [children[1], children[0]] } else { children } {
                if let Some(t) = t {
                    stack[height] = (child, t);
                    height += 1;
                }
            }
        }
        Ok(())
    }
}

impl Node {
    /// The parameter, rounded down generously, at which the ray may enter the widened box before `far`.
    fn enter(&self, origin: DVec3, direction: DVec3, reach: f64, tmin: f64, far: f64) -> Option<f64> {
        let pad = DVec3::splat(ROUNDING * self.slack * (reach + self.size));
        let (min, max) = (self.min - pad - origin, self.max + pad - origin);
        let (mut t0, mut t1) = (tmin, far);
        for axis in 0..3 {
            let d = direction[axis];
            if d == 0.0 {
                if min[axis] > 0.0 || max[axis] < 0.0 {
                    return None;
                }
                continue;
            }
            let (a, b) = (min[axis] / d, max[axis] / d);
            t0 = t0.max(a.min(b));
            t1 = t1.min(a.max(b));
        }
        // Padding the planes covers the direction's rounding; t itself is rounded to f32 on both sides.
        let near = t0 - t0.abs() * ROUNDING;
        (near <= t1 + t1.abs() * ROUNDING).then_some(near)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn visits_all_that_is_on_the_way() {
        let items = (0..100u32).map(|i| {
            let p = DVec3::new(f64::from(i % 10), f64::from(i / 10), 0.0);
            Item { object: i, min: p, max: p + 0.5, slack: 1.0, size: 10.0 }
        });
        let tree = Tree::new(items.collect());
        let mut seen = Vec::new();
        let row = |seen: &mut Vec<u32>| {
            tree.visit(DVec3::new(-1.0, 3.25, 0.25), DVec3::X, 0.0, f32::INFINITY, |i| {
                seen.push(i);
                Ok::<_, ()>(f32::INFINITY)
            })
        };
        row(&mut seen).unwrap();
        assert!(seen[0] <= 31, "near ones first: {seen:?}");
        assert!((30..40).all(|i| seen.contains(&i)), "{seen:?}");
        assert!(seen.len() < 30, "neighbours in a leaf are visited, distant ones are not: {seen:?}");
    }

    #[test]
    fn stops_when_told() {
        let item = |object| Item { object, min: DVec3::ZERO, max: DVec3::ONE, slack: 1.0, size: 1.0 };
        let tree = Tree::new((0..40).map(item).collect());
        let mut visits = 0;
        let told = tree.visit(DVec3::splat(-1.0), DVec3::ONE, 0.0, 9.0, |_| {
            visits += 1;
            Ok::<_, ()>(-1.0)
        });
        assert_eq!((told, visits), (Ok(()), 1));
    }
}
