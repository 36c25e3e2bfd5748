//! First tier: interval arithmetic in f64, each result widened by one step on both sides.

use std::cmp::Ordering;

use super::number::Number;

/// A closed interval that holds the true value.
#[derive(Clone, Copy, Debug)]
pub struct Interval {
    low: f64,
    high: f64,
}

/// An interval around two rounded ends.
fn widened(low: f64, high: f64) -> Interval {
    Interval { low: low.next_down(), high: high.next_up() }
}

impl Number for Interval {
    fn of(x: f64) -> Self {
        Interval { low: x, high: x }
    }

    fn add(&self, other: &Self) -> Self {
        widened(self.low + other.low, self.high + other.high)
    }

    fn sub(&self, other: &Self) -> Self {
        widened(self.low - other.high, self.high - other.low)
    }

    fn mul(&self, other: &Self) -> Self {
        let products = [self.low * other.low, self.low * other.high, self.high * other.low, self.high * other.high];
        widened(
            products.into_iter().fold(f64::INFINITY, f64::min),
            products.into_iter().fold(f64::NEG_INFINITY, f64::max),
        )
    }

    fn sign(&self) -> Option<Ordering> {
        if self.low > 0.0 {
            Some(Ordering::Greater)
        } else if self.high < 0.0 {
            Some(Ordering::Less)
        } else {
            None
        }
    }

    fn bounds(&self) -> (f64, f64) {
        (self.low, self.high)
    }
}
