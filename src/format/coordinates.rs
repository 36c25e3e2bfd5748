//! Coordinates of a leaf's vertices: as f32, or as whole numbers of 16 bits that stand for f32.
//!
//! A coordinate x of a leaf in steps is `(base + step) * 2^exponent`, with a base an axis and one exponent a leaf. The sum is a whole
//! number of at most 24 bits and its sign, so that f32 holds it, and the product is neither too small nor too large for
//! f32: every step of the calculation is exact, whatever computes it. So a leaf in steps and its neighbour in f32 have the same corners bit for bit.

use std::ops::RangeInclusive;

use crate::geometry::exp2;

/// The whole numbers a coordinate may be, in steps: those that f32 holds, without a gap.
pub(super) const WHOLE: RangeInclusive<i32> = -(1 << 24)..=1 << 24;

/// log2 of a step: then 1 to 2^24 steps are normal f32.
pub(super) const EXPONENTS: RangeInclusive<i32> = -126..=103;

/// The coordinates of one axis of all vertices of a leaf, where they lie.
#[derive(Clone, Copy, Debug)]
pub enum Coordinates<'a> {
    /// As they are.
    Floats(&'a [f32]),
    /// As `(base + step) * scale`.
    Steps {
        /// One a vertex.
        steps: &'a [u16],
        /// In steps.
        base: i32,
        /// A power of two.
        scale: f32,
    },
}

impl<'a> Coordinates<'a> {
    /// How many there are.
    pub fn len(&self) -> usize {
        match self {
            Coordinates::Floats(list) => list.len(),
            Coordinates::Steps { steps, .. } => steps.len(),
        }
    }

    /// Whether there are none: only in [`Leaf::EMPTY`](super::Leaf::EMPTY).
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// That of vertex `i`.
    #[inline(always)]
    pub fn get(&self, i: usize) -> Option<f32> {
        match *self {
            Coordinates::Floats(list) => list.get(i).copied(),
            Coordinates::Steps { steps, base, scale } => steps.get(i).map(|&step| decoded(step, base, scale)),
        }
    }

    /// All, in order.
    #[inline(always)]
    pub fn iter(self) -> impl Iterator<Item = f32> + 'a {
        (0..self.len()).map(move |i| self.get(i).unwrap_or(0.0))
    }
}

/// The coordinate that a step stands for. Wraps around in files that are not sound.
#[inline(always)]
pub(super) fn decoded(step: u16, base: i32, scale: f32) -> f32 {
    base.wrapping_add(step.into()) as f32 * scale
}

/// What the vertices of a leaf in steps share.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Steps {
    /// The lowest vertex on each axis, in steps.
    pub base: [i32; 3],
    /// log2 of a step.
    pub exponent: i8,
}

impl Steps {
    /// The largest step in which all coordinates (by their bits) are whole, if so they fit.
    ///
    /// `None` where they do not: a leaf too wide for 16 bits, numbers of more than 24 bits, a negative zero.
    pub fn holding(vertices: &[[u32; 3]]) -> Option<Steps> {
        let all = vertices.as_flattened();
        if all.iter().any(|&bits| bits == (-0.0f32).to_bits() || !f32::from_bits(bits).is_finite()) {
            return None;
        }
        let finest = all.iter().filter_map(|&bits| lowest_bit(bits)).min();
        let exponent = finest.unwrap_or(0).min(*EXPONENTS.end());
        if !EXPONENTS.contains(&exponent) {
            return None;
        }
        let (mut low, mut high) = ([i32::MAX; 3], [i32::MIN; 3]);
        for vertex in vertices {
            for axis in 0..3 {
                let n = whole(vertex[axis], exponent)?;
                (low[axis], high[axis]) = (low[axis].min(n), high[axis].max(n));
            }
        }
        let fits = low.iter().zip(&high).all(|(low, high)| high - low <= i32::from(u16::MAX));
        fits.then_some(Steps { base: low, exponent: exponent as i8 })
    }

    /// The step of a coordinate of one of the vertices.
    pub fn step(&self, axis: usize, bits: u32) -> u16 {
        whole(bits, self.exponent.into()).map_or(0, |n| (n - self.base[axis]) as u16)
    }
}

/// How many steps of 2^`exponent` a finite f32 that is a multiple of it is; `None` if they are not [`WHOLE`].
fn whole(bits: u32, exponent: i32) -> Option<i32> {
    // Exact: exponents of f64 go far enough.
    let steps = f64::from(f32::from_bits(bits)) * exp2(-exponent);
    let n = steps as i32;
    (f64::from(n) == steps && WHOLE.contains(&n)).then_some(n)
}

/// log2 of the largest power of two of which a finite f32 is a multiple; of 0 there is none.
fn lowest_bit(bits: u32) -> Option<i32> {
    let (exponent, fraction) = ((bits >> 23 & 0xff) as i32, bits & 0x7f_ffff);
    let digits = if exponent == 0 { fraction } else { fraction | 1 << 23 };
    (digits != 0).then(|| exponent.max(1) - 150 + digits.trailing_zeros() as i32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn steps(list: &[[f32; 3]]) -> Option<Steps> {
        Steps::holding(&list.iter().map(|v| v.map(f32::to_bits)).collect::<Vec<_>>())
    }

    #[test]
    fn the_largest_step_is_taken() {
        assert_eq!(steps(&[[8.0, -4.0, 0.0], [8.5, -3.0, 0.0]]), Some(Steps { base: [16, -8, 0], exponent: -1 }));
        assert_eq!(steps(&[[0.0; 3]]), Some(Steps { base: [0; 3], exponent: 0 }));
        assert_eq!(steps(&[[exp2(127) as f32, 0.0, 0.0]]), Some(Steps { base: [1 << 24, 0, 0], exponent: 103 }));
        assert_eq!(steps(&[[f32::MIN_POSITIVE, 0.0, 0.0]]).unwrap().exponent, -126);
    }

    #[test]
    fn what_does_not_fit_is_left() {
        assert!(steps(&[[0.0; 3], [65535.0, 1.0, 0.0]]).is_some());
        assert_eq!(steps(&[[0.0; 3], [65537.0, 0.0, 0.0]]), None, "too wide");
        assert_eq!(steps(&[[-0.0, 0.0, 0.0]]), None, "another zero");
        assert_eq!(steps(&[[1e-45, 0.0, 0.0]]), None, "a step below those of f32");
        assert!(steps(&[[16_777_216.0, 1.0, 0.0]]).is_some());
        assert_eq!(steps(&[[16_777_218.0, 1.0, 0.0]]), None, "a number beyond 24 bits");
        assert_eq!(steps(&[[f32::MAX, 0.0, 0.0]]), None, "a step beyond the largest");
        assert_eq!(steps(&[[f32::NAN, 0.0, 0.0]]), None);
    }

    proptest! {
        /// Every f32 that is normal is a whole number of its own lowest bit, and comes back.
        #[test]
        fn each_number_comes_back(bits: u32) {
            let x = f32::from_bits(bits);
            prop_assume!(x.is_normal());
            let Some(steps) = steps(&[[x; 3]]) else {
                prop_assert!(!(-126..=103).contains(&lowest_bit(bits).unwrap()));
                return Ok(());
            };
            let scale = exp2(steps.exponent.into()) as f32;
            prop_assert_eq!(decoded(steps.step(1, bits), steps.base[1], scale).to_bits(), bits);
        }
    }
}
