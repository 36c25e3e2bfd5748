//! Boxes in root units become eight-bit planes of a node's frame.
//!
//! Planes are rounded outward with [`MARGIN`] units to spare. If a node's content keeps that margin to the planes
//! that its parent stores for it, then its own children's planes fit 0..=255 of its frame again: a box of h parent units
//! spans h * 2^(7 - floor(log2 h)) <= 255 of the child's, and the child's margin is not wider than the parent's. So only a root frame
//! needs care. Where a box reaches the border of the root cube itself there is no plane beyond it: planes are then clamped
//! to 0 and 255, and the margin is what the root cube leaves.

use super::wide::Bounds;
use crate::format::{Frame, Node};
use crate::geometry::exp2;

/// Units to spare on each side: the 1/64 that FORMAT.md asks for, and more than the rounding of root units (2^-53, which
/// is 2^-21 of the least unit).
pub(super) const MARGIN: f64 = 1.0 / 64.0 + 1.0 / 1_048_576.0;

/// Stores the planes of a child's box.
pub(super) fn set_planes(node: &mut Node, slot: usize, frame: &Frame, bounds: Bounds) {
    let (min, max) = (bounds.min.to_array(), bounds.max.to_array());
    for axis in 0..3 {
        let place = |x: f64| (x - frame.corner[axis]) / frame.unit[axis];
        let low = (place(min[axis]) - MARGIN).floor().clamp(0.0, 254.0);
        let high = (place(max[axis]) + MARGIN).ceil().clamp(low + 1.0, 255.0);
        node.low[axis][slot] = low as u8;
        node.high[axis][slot] = high as u8;
    }
}

/// The frame of a brick: on each axis the smallest power of two whose 255 steps hold the box, from the next multiple of
/// 2^-24 below it. Exact in f32, as brick records store it.
pub(super) fn brick_frame(bounds: Bounds) -> Frame {
    let (min, max) = (bounds.min.to_array(), bounds.max.to_array());
    let axis_frame = |axis: usize| {
        let at = |exponent: i32| {
            let unit = exp2(exponent);
            let steps = ((min[axis] - MARGIN * unit) * GRID).floor();
            (steps.clamp(0.0, GRID - 1.0) / GRID, unit)
        };
        let holds = |&(corner, unit): &(f64, f64)| (max[axis] - corner) / unit + MARGIN <= 255.0;
        // Steps of 2^-7 span two root units and hold anything.
        (-32..-7).map(at).find(holds).unwrap_or_else(|| at(-7))
    };
    let axes = [0, 1, 2].map(axis_frame);
    Frame { corner: axes.map(|(corner, _)| corner), unit: axes.map(|(_, unit)| unit) }
}

/// Steps of brick corners in a root unit.
const GRID: f64 = 16_777_216.0;

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use proptest::prelude::*;

    fn planes(frame: &Frame, node: &Node, slot: usize) -> Bounds {
        let at = |q: [[u8; 8]; 3]| {
            DVec3::from_array(std::array::from_fn(|i| frame.corner[i] + f64::from(q[i][slot]) * frame.unit[i]))
        };
        Bounds { min: at(node.low), max: at(node.high) }
    }

    proptest! {
        /// Ever smaller boxes inside one another: each stays inside the planes of all levels, with the margin.
        #[test]
        fn boxes_stay_inside_all_the_way_down(
            start in prop::array::uniform3(0.001f64..0.9), size in prop::array::uniform3(0.0f64..0.09),
            steps in prop::collection::vec((prop::array::uniform3(0.0f64..1.0), prop::array::uniform3(0.0f64..1.0)), 1..40),
        ) {
            let (start, size) = (DVec3::from_array(start), DVec3::from_array(size));
            let mut bounds = Bounds { min: start, max: start + size };
            let mut frame = brick_frame(bounds);
            for i in 0..3 {
                prop_assert_eq!(f64::from(frame.corner[i] as f32), frame.corner[i]);
                prop_assert_eq!((frame.corner[i] * GRID).fract(), 0.0);
            }
            for (p, q) in steps {
                let mut node = Node::EMPTY;
                set_planes(&mut node, 3, &frame, bounds);
                let stored = planes(&frame, &node, 3);
                let margin = DVec3::from_array(frame.unit) / 64.0;
                prop_assert!((stored.min + margin).cmple(bounds.min).all(), "{:?} {:?} {:?}", stored, bounds, frame);
                prop_assert!((stored.max - margin).cmpge(bounds.max).all(), "{:?} {:?} {:?}", stored, bounds, frame);
                frame = frame.child(&node, 3);
                let extent = bounds.max - bounds.min;
                let (p, q) = (DVec3::from_array(p), DVec3::from_array(q));
                let inner = Bounds { min: bounds.min + p.min(q) * extent, max: bounds.min + p.max(q) * extent };
                bounds = inner.clipped_to(bounds);
            }
        }
    }

    #[test]
    fn the_whole_root_cube_can_be_a_brick() {
        let bounds = Bounds { min: DVec3::ZERO, max: DVec3::splat(255.0 / 256.0) };
        let frame = brick_frame(bounds);
        let mut node = Node::EMPTY;
        set_planes(&mut node, 0, &frame, bounds);
        let stored = planes(&frame, &node, 0);
        assert_eq!((stored.min, frame.corner), (DVec3::ZERO, [0.0; 3]));
        assert!(stored.max.cmpgt(bounds.max).all());
    }
}
