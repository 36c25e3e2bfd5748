//! Every kernel against the portable one.

use super::*;
use crate::exact::Line;
use crate::format::{LeafUnit, Points, encode_leaf};
use crate::geometry::{Aabb, Ray, Triangle};
use bytemuck::Zeroable;
use glam::Vec3;
use proptest::prelude::*;

/// A ray aimed at a cell with a node in it, of which every slot's child has another node.
struct Nodes<'a> {
    ray: &'a Ray,
    fit: &'a Fit,
    cell: &'a Cell,
    node: &'a Node,
    below: &'a Node,
    far: f32,
    turn: u8,
}

/// Whether the ray is plain, what its aim is, and the slots touched and where they are entered: of the node, and of each child.
type Seen = (bool, Way, Aim, Vec<(u32, [f32; 8])>);

impl Job for Nodes<'_> {
    type Output = Seen;

    fn run<K: Kernel>(self, kernel: K) -> Seen {
        let (mut way, mut aim) = (Way::default(), Aim::default());
        let plain = kernel.aim(self.ray, self.fit, &mut way, &mut aim);
        way.near = self.ray.tmin;
        way.visit(self.turn);
        let frame = kernel.frame(self.cell, &aim, &way);
        let mut saved = Saved::zeroed();
        let mut touch = |frame, node| {
            let (slots, near) = kernel.touch(node, frame, &way, kernel.ends(way.near, self.far));
            kernel.save(&mut saved, frame, near);
            assert_eq!(kernel.within(kernel.load(&saved).1, f32::INFINITY), 0xff);
            (slots, saved.near)
        };
        let mut touched = vec![touch(frame, self.node)];
        touched.extend((0..8).map(|slot| touch(kernel.child(frame, self.node, slot, &way), self.below)));
        (plain, way, aim, touched)
    }
}

/// A leaf against a ray: the filter's word, the bounds of t, and t, u, v of each lane that is certainly hit.
struct Leaves<'a>(Leaf<'a>, &'a Shear, &'a Ray);

impl Job for Leaves<'_> {
    type Output = (Lanes, Depths, Vec<Option<[f32; 3]>>);

    fn run<K: Kernel>(self, kernel: K) -> Self::Output {
        let Leaves(leaf, shear, ray) = self;
        let mut depths = Depths::BLANK;
        let lanes = kernel.classify(&leaf, shear, [f32::NEG_INFINITY, f32::INFINITY], &mut depths);
        let accepted = (0..16).filter(|j| lanes.accept >> j & 1 != 0);
        let rounded = accepted.map(|j| {
            let (mut block, mut rounded, t) = (Block::zeroed(), Rounded::zeroed(), leaf.triangle(j));
            // In every place of a block.
            let place = j % 16;
            for axis in 0..3 {
                for i in 0..16 {
                    (block.a[axis].0[i], block.b[axis].0[i], block.c[axis].0[i]) = (t.a[axis], t.b[axis], t.c[axis]);
                    (block.origin[axis].0[i], block.direction[axis].0[i]) = (ray.origin[axis], ray.direction[axis]);
                }
            }
            let wanted = 1 << place | 1;
            kernel.rounded(&block, wanted, &mut rounded);
            assert_eq!(rounded.certain & !wanted, 0);
            let certain = rounded.certain >> place & 1 != 0;
            certain.then_some([rounded.t.0[place], rounded.u.0[place], rounded.v.0[place]])
        });
        (lanes, depths, rounded.collect())
    }
}

fn node(boxes: &[[u8; 8]; 6]) -> Node {
    let mut node = Node::EMPTY;
    for axis in 0..3 {
        for (slot, (&a, &b)) in boxes[axis].iter().zip(&boxes[axis + 3]).enumerate() {
            node.low[axis][slot] = a.min(b).min(254);
            node.high[axis][slot] = a.max(b).max(a.min(b).min(254) + 1);
        }
    }
    node
}

proptest! {
    /// Same aim; same slots but where a slot is entered or left within rounding, which the slack covers more than once.
    #[test]
    fn nodes(
        boxes in any::<[[u8; 8]; 6]>(),
        below in any::<[[u8; 8]; 6]>(),
        origin in proptest::array::uniform3(-3f32..3.0),
        direction in proptest::array::uniform3(-2f32..2.0),
        corner in proptest::array::uniform3(0u8..3),
        log2_side in -3i32..4,
        backward: bool
    ) {
        prop_assume!(direction.iter().all(|d| d.abs() > 1e-3));
        let side = (log2_side as f32).exp2();
        let ray = Ray::new(origin.map(|x| x * side), direction);
        let (node, below) = (node(&boxes), node(&below));
        let cell = Cell { corner: corner.map(|c| f32::from(c) / 4.0), unit: [1.0 / 512.0, 1.0 / 1024.0, 1.0 / 512.0] };
        let fit = Fit { corner: [0.0; 4], scale: f64::from(side).recip(), side, rounding: 20.0 / 16_777_216.0 };
        let look = |fit: &Fit, isa: Isa| {
            isa.run(Nodes { ray: &ray, fit, cell: &cell, node: &node, below: &below, far: 1e9, turn: if backward { 7 } else { 0 } })
        };
        let (plain, way, aim, expected) = look(&fit, Isa::SCALAR);
        prop_assert!(plain);
        let generous = Fit { rounding: 8.0 * fit.rounding, ..fit };
        for isa in Isa::available() {
            let (plain, w, a, touched) = look(&fit, isa);
            prop_assert!(plain);
            prop_assert_eq!((w.mask, w.least.map(|l| [l[0], l[1], l[2]]), &w.slack[..3]), (way.mask, way.least.map(|l| [l[0], l[1], l[2]]), &way.slack[..3]));
            prop_assert_eq!((&a.origin[..3], &a.inv[..3], &a.slack[..3]), (&aim.origin[..3], &aim.inv[..3], &aim.slack[..3]));
            let close = 1e-5 * side * aim.inv.iter().take(3).fold(0f32, |m, x| m.max(x.abs()));
            for ((_, near), (_, expected)) in touched.iter().zip(&expected) {
                for (x, y) in near.iter().zip(expected) {
                    prop_assert!((x - y).abs() <= close, "{isa:?} {near:?} {expected:?}");
                }
            }
            // Whatever one kernel touches another must touch when it is generous.
            let (_, _, _, wider) = look(&generous, isa);
            for ((slots, _), (expected, _)) in wider.iter().zip(&expected) {
                prop_assert_eq!(expected & !slots, 0);
            }
        }
    }

    /// The very same masks, bounds of t that hold, and the very same t, u, v.
    #[test]
    fn leaves(
        points in proptest::collection::vec(proptest::array::uniform3(-1f32..1.0), 3..32),
        picks in proptest::collection::vec(any::<[u8; 3]>(), 1..17),
        origin in proptest::array::uniform3(-2f32..2.0),
        aim in (any::<u8>(), 0f32..1.0),
        snap in any::<bool>(),
        steps: bool,
        behind in 0usize..200
    ) {
        let points_as = if steps { Points::Steps } else { Points::Floats };
        let round = |x: f32| if snap { (x * 8.0).round() / 8.0 } else { x };
        let point = |i: u8| Vec3::from_array(points[usize::from(i) % points.len()].map(round));
        let triangles: Vec<Triangle> =
            picks.iter().map(|p| Triangle { a: point(p[0]), b: point(p[1]), c: point(p[2]) }).collect();
        let mut bytes = Vec::new();
        prop_assert!(encode_leaf(&mut bytes, LeafUnit::B32, points_as, 0, &triangles).is_some());
        // Whatever lies behind the leaf must not matter, nor how much of it there is.
        bytes.extend(std::iter::repeat_n(0xff, behind & !3));
        let words: Vec<u64> = bytes.chunks(8).map(|c| {
            let mut w = [0; 8];
            w[..c.len()].copy_from_slice(c);
            u64::from_le_bytes(w)
        }).collect();
        let stored: &[u8] = bytemuck::cast_slice(&words);
        let leaf = Leaf::read(stored).unwrap();
        let t = &triangles[usize::from(aim.0) % triangles.len()];
        let target = t.a + aim.1 * (t.b - t.a);
        let direction = (target - Vec3::from_array(origin)).to_array();
        prop_assume!(direction != [0.0; 3]);
        let bounds = Aabb { min: Vec3::NEG_ONE, max: Vec3::ONE };
        let ray = Ray::new(origin, direction).between(f32::NEG_INFINITY, f32::INFINITY);
        let shear = Shear::new(&ray, bounds);
        let (expected, bounds, answers) = Isa::SCALAR.run(Leaves(leaf, &shear, &ray));
        let line = Line::new(&ray);
        let accepted: Vec<usize> = (0..16).filter(|j| expected.accept >> j & 1 != 0).collect();
        for (&j, answer) in accepted.iter().zip(&answers) {
            let crossing = line.meet(&triangles[j]).crossing.expect("certainly hit");
            prop_assert!(f64::from(bounds.lo[j]) <= crossing.depth[1] && crossing.depth[0] <= f64::from(bounds.hi[j]));
            let [u, v] = crossing.uv(&line);
            let exact = [crossing.t_within(&line).expect("finite"), u, v].map(f32::to_bits);
            prop_assert!(answer.is_none_or(|answer| answer.map(f32::to_bits) == exact));
        }
        for isa in Isa::available() {
            let (lanes, depths, rounded) = isa.run(Leaves(leaf, &shear, &ray));
            prop_assert_eq!(lanes, expected, "{:?}", isa);
            for (i, &j) in accepted.iter().enumerate() {
                prop_assert_eq!([depths.lo[j], depths.hi[j]].map(f32::to_bits), [bounds.lo[j], bounds.hi[j]].map(f32::to_bits));
                let (Some(x), Some(y)) = (rounded[i], answers[i]) else { continue };
                prop_assert_eq!(x.map(f32::to_bits), y.map(f32::to_bits));
            }
        }
    }
}
