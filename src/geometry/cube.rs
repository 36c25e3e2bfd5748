//! The root cube: a cube whose side is a power of two and whose planes are exact.

use glam::{DVec3, Vec3};

use super::Aabb;

/// The cube around a mesh: side 2^k, corner a multiple of the side's 2^-21 part.
///
/// *Root units* are `(x - corner) / side`; everything inside lies within 0 to 255/256.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RootCube {
    /// Lowest corner, exact in f64.
    pub corner: DVec3,
    /// log2 of the side, -149 to 130.
    pub log2_side: i32,
}

impl RootCube {
    /// The smallest such cube that holds `bounds` (finite, not empty) within root units 0 to 255/256.
    ///
    /// Scaling by powers of two is exact, so every cell plane `corner + i * side / 2^21` is an exact f64.
    pub fn around(bounds: Aabb) -> RootCube {
        let (min, max) = (bounds.min.as_dvec3(), bounds.max.as_dvec3());
        let extent = (max - min).max_element().max(exp2(-149));
        let first = (extent.log2().floor() as i32 - 1).clamp(-149, 130);
        for log2_side in first..130 {
            let step = exp2(log2_side - 21);
            let corner = (min / step).floor() * step;
            if ((max - corner) / exp2(log2_side)).max_element() <= 255.0 / 256.0 {
                return RootCube { corner, log2_side };
            }
        }
        let step = exp2(130 - 21);
        RootCube { corner: (min / step).floor() * step, log2_side: 130 }
    }

    /// The side.
    pub fn side(self) -> f64 {
        exp2(self.log2_side)
    }

    /// A point in root units, to f64 accuracy (relative error at most 2^-53).
    pub fn to_root_units(self, p: Vec3) -> DVec3 {
        // As good as dividing by the side, and far quicker: the inverse is a power of two as well, so both are exact.
        (p.as_dvec3() - self.corner) * exp2(-self.log2_side)
    }

    /// One coordinate in root units, as [`RootCube::to_root_units`] has it. `axis` is 0, 1 or 2.
    pub fn axis_to_root_units(self, axis: usize, x: f32) -> f64 {
        (f64::from(x) - self.corner[axis]) * exp2(-self.log2_side)
    }
}

/// 2^k as f64, exact for every k from -1022 to 1023; what `powi` and `exp2` of the standard library give is nowhere promised.
#[inline(always)]
pub(crate) fn exp2(k: i32) -> f64 {
    f64::from_bits(((k + 1023) as u64) << 52)
}

/// floor(log2(x)) of a normal, positive f64 (every positive f32 is one); -1023 of zero.
#[inline(always)]
pub(crate) fn log2_floor(x: f64) -> i32 {
    (x.to_bits() >> 52) as i32 - 1023
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn holds_its_bounds() {
        for (a, b) in [
            (0.0f32, 1.0f32),
            (-1.0, 1.0),
            (1e6, 1e6 + 1.0),
            (-3e38, 3e38),
            (1e-45, 2e-45),
            (5.0, 5.0),
            (f32::MIN, f32::MAX),
        ] {
            let cube = RootCube::around(Aabb { min: Vec3::splat(a), max: Vec3::new(b, a, a) });
            let (lo, hi) = (cube.to_root_units(Vec3::splat(a)), cube.to_root_units(Vec3::new(b, a, a)));
            assert!(lo.min_element() >= 0.0 && hi.max_element() <= 255.0 / 256.0, "{a} {b} {cube:?} {lo} {hi}");
        }
    }
}
