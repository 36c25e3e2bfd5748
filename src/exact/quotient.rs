//! Quotients of exact numbers: order, and the nearest f32.

use std::cmp::Ordering;

use super::expansion::Expansion;
use crate::geometry::exp2;

/// `num / den` with `den` not zero, exactly.
#[derive(Clone, Debug)]
pub(super) struct Quotient {
    num: Expansion,
    den: Expansion,
}

impl Quotient {
    /// The quotient; the denominator is made positive.
    pub fn new(num: Expansion, den: Expansion) -> Quotient {
        match den.sign() {
            Ordering::Less => Quotient { num: -num, den: -den },
            _ => Quotient { num, den },
        }
    }

    /// Exact order of two quotients.
    pub fn cmp(&self, other: &Quotient) -> Ordering {
        (&(&self.num * &other.den) - &(&other.num * &self.den)).sign()
    }

    /// Exact order against an f64 (a rounding boundary: at most 26 bits, so that nothing under- or overflows).
    fn cmp_f64(&self, x: f64) -> Ordering {
        (&self.num - &self.den.scale(x)).sign()
    }

    /// An f64 interval that holds the quotient.
    pub fn interval(&self) -> [f64; 2] {
        // Two estimates within 2^-50 each and one division: 2^-48 covers them and the roundings here.
        let q = self.num.estimate() / self.den.estimate();
        let slack = q.abs() * exp2(-48);
        [q - slack, q + slack]
    }

    /// The nearest f32, ties to even, overflow to infinity.
    pub fn round(&self) -> f32 {
        let [lo, hi] = self.interval();
        let mut nearest = lo as f32;
        // At most one step: the interval is far narrower than an f32 ulp.
        while nearest < hi as f32 {
            let above = nearest.next_up();
            match self.cmp_f64(boundary(nearest, above)) {
                Ordering::Less => break,
                Ordering::Equal if nearest.to_bits() & 1 == 0 => break,
                _ => nearest = above,
            }
        }
        nearest
    }
}

/// The point half-way between two neighbouring f32, where infinity stands for 2^128 as rounding has it.
fn boundary(a: f32, b: f32) -> f64 {
    let value = |x: f32| if x.is_infinite() { f64::from(x.signum()) * 2f64.powi(128) } else { f64::from(x) };
    (value(a) + value(b)) / 2.0
}

#[cfg(test)]
mod tests {
    use super::*;

    fn quotient(num: f64, den: f64) -> Quotient {
        Quotient::new(Expansion::from(num), Expansion::from(den))
    }

    #[test]
    fn rounds_ties_to_even_and_near_ties_exactly() {
        let one = 1.0f64;
        let half_ulp = 2f64.powi(-24);
        assert_eq!(quotient(one + half_ulp, 1.0).round(), 1.0);
        assert_eq!(quotient(one + 3.0 * half_ulp, 1.0).round(), 1.0 + 4.0 * half_ulp as f32);
        let mut above = Expansion::from(one + half_ulp);
        above.grow(2f64.powi(-400));
        assert_eq!(Quotient::new(above.clone(), Expansion::from(1.0)).round(), 1.0f32.next_up());
        assert_eq!(Quotient::new(-above, Expansion::from(1.0)).round(), -(1.0f32.next_up()));
        assert_eq!(quotient(1.0, 3.0).round(), 1.0 / 3.0);
        assert_eq!(quotient(1.0, -3.0).round(), -1.0 / 3.0);
    }

    #[test]
    fn rounds_at_the_ends_of_the_range() {
        let most = f64::from(f32::MAX);
        let tie = 2f64.powi(128) - 2f64.powi(103);
        assert_eq!(quotient(most, 1.0).round(), f32::MAX);
        assert_eq!(quotient(tie, 1.0).round(), f32::INFINITY);
        assert_eq!(quotient(-tie, 1.0).round(), f32::NEG_INFINITY);
        let mut below = Expansion::from(tie);
        below.grow(-1.0);
        assert_eq!(Quotient::new(below, Expansion::from(1.0)).round(), f32::MAX);
        assert_eq!(quotient(2f64.powi(-150), 1.0).round(), 0.0);
        assert_eq!(quotient(2f64.powi(-150) * 1.5, 1.0).round(), f32::from_bits(1));
        assert_eq!(quotient(0.0, 1.0).round(), 0.0);
    }
}
