//! Every kernel against the portable one.

use super::*;
use crate::format::{LeafUnit, encode_leaf};
use crate::geometry::{Aabb, Ray, Triangle};
use glam::Vec3;
use proptest::prelude::*;

/// Runs one kernel's three loops.
struct Steps<'a>(&'a Node, &'a Planes, &'a Way, Option<(Leaf<'a>, &'a Shear)>);

impl Job for Steps<'_> {
    type Output = (Touched, Vec<Planes>, Option<Lanes>);

    fn run<K: Kernel>(self, kernel: K) -> Self::Output {
        let Steps(node, planes, way, leaf) = self;
        let children = (0..8).map(|slot| kernel.child(planes, node, slot, way)).collect();
        (kernel.touch(node, planes, way, 3.0), children, leaf.map(|(leaf, shear)| kernel.classify(&leaf, shear)))
    }
}

fn planes(x: [[f32; 3]; 3]) -> Planes {
    let four = |[a, b, c]: [f32; 3]| [a, b, c, 0.0];
    Planes { begin: four(x[0]), end: four(x[1]), dt: four(x[2]) }
}

proptest! {
    /// Same slots but where a slot is entered and left within rounding; same frames within rounding.
    #[test]
    fn nodes(
        boxes in any::<[[u8; 8]; 6]>(),
        corner in any::<[u8; 3]>(),
        dt in proptest::array::uniform3(-0.1f32..0.1),
        slack in 0f32..1e-4,
        backward: bool
    ) {
        let mut node = Node::EMPTY;
        for axis in 0..3 {
            for (slot, (&a, &b)) in boxes[axis].iter().zip(&boxes[axis + 3]).enumerate() {
                node.low[axis][slot] = a.min(b).min(254);
                node.high[axis][slot] = a.max(b).max(a.min(b).min(254) + 1);
            }
        }
        let t0: [f32; 3] = std::array::from_fn(|i| f32::from(corner[i]) * -dt[i]);
        let at = planes([t0.map(|t| t - slack), t0.map(|t| t + slack), dt]);
        let mask = (0..3).fold(0, |m, i| m << 1 | u8::from(dt[i] < 0.0));
        let order = if backward { mask ^ 7 } else { mask };
        let way = Way { least: planes([dt.map(|x| x * 1e-6), dt, dt]).begin, mask, order, near: -1.0 };
        let (expected, frames, _) = Isa::SCALAR.run(Steps(&node, &at, &way, None));
        for isa in Isa::available() {
            let (touched, children, _) = isa.run(Steps(&node, &at, &way, None));
            for i in 0..8 {
                prop_assert!((touched.near[i] - expected.near[i]).abs() < 1e-4, "{isa:?} {touched:?} {expected:?}");
                for axis in 0..3 {
                    prop_assert!((children[i].begin[axis] - frames[i].begin[axis]).abs() < 1e-4);
                    prop_assert!((children[i].end[axis] - frames[i].end[axis]).abs() < 1e-4);
                    prop_assert_eq!(children[i].dt[axis], frames[i].dt[axis]);
                }
            }
            // With generous slack on one side, whatever one kernel touches the other must touch.
            let wide = planes([t0.map(|t| t - slack - 1e-3), t0.map(|t| t + slack + 1e-3), dt]);
            let (wider, _, _) = isa.run(Steps(&node, &wide, &way, None));
            prop_assert_eq!(expected.slots & !wider.slots, 0);
        }
    }

    /// The very same masks.
    #[test]
    fn leaves(
        points in proptest::collection::vec(proptest::array::uniform3(-1f32..1.0), 3..32),
        picks in proptest::collection::vec(any::<[u8; 3]>(), 1..17),
        origin in proptest::array::uniform3(-2f32..2.0),
        aim in (any::<u8>(), 0f32..1.0),
        snap in any::<bool>(),
        behind in 0usize..200
    ) {
        let round = |x: f32| if snap { (x * 8.0).round() / 8.0 } else { x };
        let point = |i: u8| Vec3::from_array(points[usize::from(i) % points.len()].map(round));
        let triangles: Vec<Triangle> =
            picks.iter().map(|p| Triangle { a: point(p[0]), b: point(p[1]), c: point(p[2]) }).collect();
        let mut bytes = Vec::new();
        prop_assert!(encode_leaf(&mut bytes, LeafUnit::B32, 0, &triangles).is_some());
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
        let shear = Shear::new(&Ray::new(origin, direction), bounds);
        let (at, way) = (planes([[0.0; 3]; 3]), Way { least: [0.0; 4], mask: 0, order: 0, near: 0.0 });
        let expected = Isa::SCALAR.run(Steps(&Node::EMPTY, &at, &way, Some((leaf, &shear)))).2;
        for isa in Isa::available() {
            prop_assert_eq!(isa.run(Steps(&Node::EMPTY, &at, &way, Some((leaf, &shear)))).2, expected, "{:?}", isa);
        }
    }
}
