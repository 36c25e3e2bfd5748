//! Second tier: exact arithmetic by expansions, sums of f64 that do not overlap (Shewchuk 1997, section 2).
//!
//! Products of up to seven f32 differences stay within f64's range (2^-149 * 7 > 2^-1074, 2^130 * 7 < 2^1023 as powers), so
//! nothing is lost.

use std::cmp::Ordering;

use smallvec::{SmallVec, smallvec};

use super::number::Number;

/// Components of increasing magnitude, without zeros; their sum is the value. Few of them need no allocation.
#[derive(Clone, Debug, Default)]
pub struct Expansion(SmallVec<[f64; 20]>);

/// Knuth's sum: rounded result and the exact error.
fn two_sum(a: f64, b: f64) -> (f64, f64) {
    let sum = a + b;
    let b_part = sum - a;
    (sum, (a - (sum - b_part)) + (b - b_part))
}

/// Dekker's product by Veltkamp's splitting at 27 bits.
fn two_product(a: f64, b: f64) -> (f64, f64) {
    let split = |x: f64| {
        let c = 134_217_729.0 * x;
        let high = c - (c - x);
        (high, x - high)
    };
    let product = a * b;
    let ((ah, al), (bh, bl)) = (split(a), split(b));
    (product, ((ah * bh - product) + ah * bl + al * bh) + al * bl)
}

impl Expansion {
    /// Adds one f64 (GROW-EXPANSION), dropping zeros.
    fn grow(&mut self, x: f64) {
        let mut carry = x;
        let mut kept = 0;
        for i in 0..self.0.len() {
            let (sum, error) = two_sum(carry, self.0[i]);
            carry = sum;
            if error != 0.0 {
                self.0[kept] = error;
                kept += 1;
            }
        }
        self.0.truncate(kept);
        if carry != 0.0 {
            self.0.push(carry);
        }
    }

    fn negated(&self) -> Expansion {
        Expansion(self.0.iter().map(|x| -x).collect())
    }
}

impl Number for Expansion {
    fn of(x: f64) -> Self {
        Expansion(if x == 0.0 { smallvec![] } else { smallvec![x] })
    }

    fn add(&self, other: &Self) -> Self {
        let mut sum = self.clone();
        other.0.iter().for_each(|&x| sum.grow(x));
        sum
    }

    fn sub(&self, other: &Self) -> Self {
        self.add(&other.negated())
    }

    fn mul(&self, other: &Self) -> Self {
        let mut result = Expansion::default();
        for &a in &self.0 {
            for &b in &other.0 {
                let (product, error) = two_product(a, b);
                result.grow(error);
                result.grow(product);
            }
        }
        result
    }

    fn sign(&self) -> Option<Ordering> {
        self.0.last().copied().unwrap_or(0.0).partial_cmp(&0.0)
    }

    fn bounds(&self) -> (f64, f64) {
        let sum: f64 = self.0.iter().sum();
        if self.0.len() <= 1 { (sum, sum) } else { (sum.next_down(), sum.next_up()) }
    }
}
