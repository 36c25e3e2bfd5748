//! Positions on a grid: one grid for the whole mesh, so that vertices that lay at one place still do, and no crack opens.

use crate::geometry::Aabb;

/// Which positions are stored.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Positions {
    /// Those of the source, bit for bit.
    Exact,
    /// The nearest multiples of this step on each axis; `None`: of a power of two, at least 2^19 and less than 2^20 of which
    /// make the longest side of the mesh.
    Grid(Option<f64>),
}

/// A grid to snap to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Snap {
    step: f64,
}

impl Snap {
    /// The grid for a mesh whose vertices have these bounds, if positions are to lie on one.
    pub fn new(positions: Positions, bounds: Aabb) -> Option<Snap> {
        match positions {
            Positions::Exact => None,
            Positions::Grid(Some(step)) => Some(Snap { step }),
            Positions::Grid(None) => {
                let extent = (bounds.max.as_dvec3() - bounds.min.as_dvec3()).max_element();
                (extent > 0.0 && extent.is_finite())
                    .then(|| Snap { step: 2f64.powi(extent.log2().floor() as i32 - 19) })
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
        let snap = Snap::new(Positions::Grid(None), bounds).unwrap();
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
    fn odd_grids_are_harmless() {
        assert!(Snap::new(Positions::Exact, Aabb::EMPTY).is_none());
        assert!(Snap::new(Positions::Grid(None), Aabb { min: Vec3::ONE, max: Vec3::ONE }).is_none());
        let snap = Snap::new(Positions::Grid(Some(1e-300)), Aabb::EMPTY).unwrap();
        assert_eq!(snap.point([f32::MAX, 1.0, 0.0]).0[0], f32::MAX);
        let snap = Snap::new(Positions::Grid(Some(10.0)), Aabb::EMPTY).unwrap();
        assert_eq!(snap.point([14.0, -16.0, 5.0]), ([10.0, -20.0, 10.0], 5.0));
    }
}
