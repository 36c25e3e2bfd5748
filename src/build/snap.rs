//! Positions on a grid: one grid for the whole mesh, so that vertices that lay at one place still do, and no crack opens.
//!
//! A vertex on the grid of a power of two takes half the bytes where the leaf is less than 2^16 steps wide. So the default step
//! follows from how large leaves will be: those of a surface of T triangles, some 9 in each, are about 6 / sqrt(T) of the mesh wide.

use crate::format::Points;
use crate::geometry::{Aabb, exp2, log2_floor};

/// Which positions are stored.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Positions {
    /// Those of the source, bit for bit.
    Exact,
    /// The nearest multiples of this step on each axis; `None`: of a power of two, 2^19 to 2^24 of which make the longest side of
    /// the mesh, the more the more triangles it has. Leaves whose vertices fit store them as steps of 16 bits.
    Grid(Option<f64>),
}

/// Steps in the longest side, log2, for a mesh of one triangle: with 2^16 steps a leaf; and between which they are kept.
const STEPS: u32 = 12;
const LEAST_STEPS: u32 = 19;
const MOST_STEPS: u32 = 23;

impl Positions {
    /// As they are, since every f32 is a multiple of this; only that a negative zero becomes positive. Leaves whose vertices lie on
    /// some grid of a power of two all the same store them as steps.
    pub const LOSSLESS: Positions = Positions::Grid(Some(f64::from_bits((1023 - 149) << 52)));

    /// How vertices are stored where they can be.
    pub(super) fn points(self) -> Points {
        if self == Positions::Exact { Points::Floats } else { Points::Steps }
    }
}

/// A grid to snap to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Snap {
    step: f64,
}

impl Snap {
    /// The grid for a mesh of so many triangles whose vertices have these bounds, if positions are to lie on one.
    pub fn new(positions: Positions, bounds: Aabb, triangles: u64) -> Option<Snap> {
        match positions {
            Positions::Exact => None,
            Positions::Grid(Some(step)) => Some(Snap { step }),
            Positions::Grid(None) => {
                let extent = (bounds.max.as_dvec3() - bounds.min.as_dvec3()).max_element();
                let farthest = bounds.max.abs().max(bounds.min.abs()).max_element();
                let steps = (STEPS + triangles.max(1).ilog2() / 2).clamp(LEAST_STEPS, MOST_STEPS);
                let fine = log2_floor(extent) - steps as i32;
                // Numbers of 24 bits, as f32 has; what lies far from zero has no finer digits anyway.
                let least = log2_floor(farthest.into()) - 23;
                (extent > 0.0 && extent.is_finite()).then(|| Snap { step: exp2(fine.max(least)) })
            }
        }
    }

    /// The nearest point of the grid, rounded to f32, and how far it is on the axis where it is farthest.
    pub fn point(self, point: [f32; 3]) -> ([f32; 3], f64) {
        let snapped = point.map(|x| {
            let near = ((f64::from(x) / self.step).round() * self.step) as f32;
            // A step too small for the quotient, or a multiple beyond f32.
            if near.is_finite() { near + 0.0 } else { x }
        });
        let shift = (0..3).map(|i| (f64::from(snapped[i]) - f64::from(point[i])).abs()).fold(0.0, f64::max);
        (snapped, shift)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    #[test]
    fn points_move_by_half_a_step_at_most() {
        let bounds = Aabb { min: Vec3::ZERO, max: Vec3::new(1.5, 0.1, 0.0) };
        let snap = Snap::new(Positions::Grid(None), bounds, 1).unwrap();
        assert_eq!(snap.step, 2f64.powi(-19));
        for x in [0.1f32, -0.7, 1.4999, 1e-30, -0.0, 123456.7] {
            let (snapped, shift) = snap.point([x, 0.0, x]);
            assert!(shift <= snap.step / 2.0 && (f64::from(snapped[0]) / snap.step).fract() == 0.0, "{x}");
            assert_eq!(snapped[0].to_bits(), snapped[2].to_bits());
            assert_eq!(snap.point(snapped), (snapped, 0.0));
        }
        assert_eq!(snap.point([-1e-30, 0.0, 0.0]).0[0].to_bits(), 0);
    }

    #[test]
    fn the_default_is_finer_for_more_triangles_and_coarser_far_away() {
        let log2_step = |triangles, offset: f32| {
            let bounds = Aabb { min: Vec3::splat(offset), max: Vec3::new(offset + 1.0, offset, offset) };
            Snap::new(Positions::Grid(None), bounds, triangles).unwrap().step.log2()
        };
        let steps = [12, 70_000, 1 << 18, 1_000_000, 10_000_000, u64::MAX].map(|n| log2_step(n, 0.0));
        assert_eq!(steps, [-19.0, -20.0, -21.0, -21.0, -23.0, -23.0]);
        assert_eq!([1.0, 7.0, 4096.0].map(|offset| log2_step(10_000_000, offset)), [-22.0, -20.0, -11.0]);
    }

    #[test]
    fn an_extent_just_below_a_power_of_two_is_below_it() {
        // 2^20 - 2^-33 is an f64, whose logarithm is rounded to 20.
        let bounds =
            Aabb { min: Vec3::new(2f32.powi(-33), 0.0, 0.0), max: Vec3::splat(2f32.powi(20)).with_y(0.0).with_z(0.0) };
        assert_eq!(Snap::new(Positions::Grid(None), bounds, 1).unwrap().step, 1.0);
    }

    #[test]
    fn lossless_means_lossless() {
        let snap = Snap::new(Positions::LOSSLESS, Aabb::EMPTY, 1).unwrap();
        for x in [1.0, -0.1, 1e-45, -3e-42, f32::MIN_POSITIVE, f32::MAX, -f32::MAX] {
            assert_eq!(snap.point([x; 3]), ([x; 3], 0.0));
        }
        assert_eq!(snap.point([-0.0; 3]).0.map(f32::to_bits), [0; 3]);
    }

    #[test]
    fn odd_grids_are_harmless() {
        assert!(Snap::new(Positions::Exact, Aabb::EMPTY, 1).is_none());
        assert!(Snap::new(Positions::Grid(None), Aabb { min: Vec3::ONE, max: Vec3::ONE }, 1).is_none());
        let snap = Snap::new(Positions::Grid(Some(1e-300)), Aabb::EMPTY, 1).unwrap();
        assert_eq!(snap.point([f32::MAX, 1.0, 0.0]).0[0], f32::MAX);
        let snap = Snap::new(Positions::Grid(Some(10.0)), Aabb::EMPTY, 1).unwrap();
        assert_eq!(snap.point([14.0, -16.0, 5.0]), ([10.0, -20.0, 10.0], 5.0));
    }
}
