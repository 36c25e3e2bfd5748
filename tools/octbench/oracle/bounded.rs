//! First tier: f64 with a bound, each number carrying how far rounding may have led it astray.

use std::cmp::Ordering;

use super::number::Number;

/// A value, and a bound on its distance from the true number.
#[derive(Clone, Copy, Debug)]
pub struct Bounded {
    value: f64,
    error: f64,
}

/// Half an ulp of 1: what rounding may add, as a share of the result.
const HALF: f64 = f64::EPSILON / 2.0;

/// Covers the roundings of an error's own sum of up to four terms (at most seven, each of at most 2^-53).
const UP: f64 = 1.0 + 16.0 * HALF;

impl Number for Bounded {
    fn of(x: f64) -> Self {
        Bounded { value: x, error: 0.0 }
    }

    fn add(&self, other: &Self) -> Self {
        let value = self.value + other.value;
        Bounded { value, error: (self.error + other.error + HALF * value.abs()) * UP }
    }

    fn sub(&self, other: &Self) -> Self {
        self.add(&Bounded { value: -other.value, ..*other })
    }

    /// Underflow cannot happen: values are multiples of 2^-149 per factor, of which there are at most seven.
    fn mul(&self, other: &Self) -> Self {
        let value = self.value * other.value;
        let error = self.error * other.value.abs() + other.error * (self.value.abs() + self.error);
        Bounded { value, error: (error + HALF * value.abs()) * UP }
    }

    fn sign(&self) -> Option<Ordering> {
        if self.value > self.error {
            Some(Ordering::Greater)
        } else if self.value < -self.error {
            Some(Ordering::Less)
        } else {
            (self.value == 0.0 && self.error == 0.0).then_some(Ordering::Equal)
        }
    }

    fn bounds(&self) -> (f64, f64) {
        ((self.value - self.error).next_down(), (self.value + self.error).next_up())
    }
}
