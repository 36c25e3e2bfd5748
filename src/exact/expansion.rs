//! Expansions: exact numbers as sums of f64.
//!
//! An expansion is a list of f64 terms of growing magnitude whose bits do not overlap (Shewchuk 1997, "Adaptive precision
//! floating-point arithmetic and fast robust geometric predicates"). Its sign is that of its last term. Two-sum is Knuth's,
//! two-product uses a fused multiply-add, which Rust guarantees to be exact (slow where the processor has none; only rare
//! decisions come here).
//!
//! **Range.** All numbers here are polynomials in f32 inputs. The difference of two f32 is a multiple of 2^-149 below
//! 2^129; a product of three such factors is a multiple of 2^-447 below 2^387, of six a multiple of 2^-894 below 2^774;
//! sums of a few of them add a few bits on top. No term can thus underflow (f64 reaches down to 2^-1074) or overflow
//! (up to 2^1023), and every operation is exact.
//!
//! **Storage.** Coordinates of like magnitude give few terms, which stay in the value itself; only numbers of wide range go to the heap.

use std::cmp::Ordering;
use std::ops::{Add, Mul, Neg, Sub};

use smallvec::SmallVec;

/// Terms kept without allocation.
const INLINE: usize = 16;

/// An exact number: the sum of its terms, which grow in magnitude, do not overlap, and are never zero.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Expansion {
    terms: SmallVec<[f64; INLINE]>,
}

/// `a + b` as rounded sum and exact error (Knuth).
pub(super) fn two_sum(a: f64, b: f64) -> (f64, f64) {
    let sum = a + b;
    let b_part = sum - a;
    let a_part = sum - b_part;
    (sum, (a - a_part) + (b - b_part))
}

/// `a * b` as rounded product and exact error.
fn two_product(a: f64, b: f64) -> (f64, f64) {
    let product = a * b;
    (product, a.mul_add(b, -product))
}

impl Expansion {
    /// `a - b`, exactly.
    pub fn difference(a: f32, b: f32) -> Expansion {
        let mut e = Expansion::default();
        e.grow(-f64::from(b));
        e.grow(f64::from(a));
        e
    }

    /// Adds one f64 (Shewchuk's Grow-Expansion with zeros left out). Round-to-even keeps the terms non-adjacent.
    pub fn grow(&mut self, x: f64) {
        let (mut carry, mut kept) = (x, 0);
        for i in 0..self.terms.len() {
            let (sum, error) = two_sum(carry, self.terms[i]);
            if error != 0.0 {
                self.terms[kept] = error;
                kept += 1;
            }
            carry = sum;
        }
        self.terms.truncate(kept);
        if carry != 0.0 {
            self.terms.push(carry);
        }
    }

    /// Adds `a * b`, exactly.
    fn grow_product(&mut self, a: f64, b: f64) {
        let (product, error) = two_product(a, b);
        self.grow(error);
        self.grow(product);
    }

    /// The number times an f64, exactly.
    pub fn scale(&self, factor: f64) -> Expansion {
        let mut out = Expansion::default();
        for &term in &self.terms {
            out.grow_product(term, factor);
        }
        out
    }

    /// How the number compares with zero.
    pub fn sign(&self) -> Ordering {
        // The last term outweighs all others together, since they do not overlap.
        self.terms.last().map_or(Ordering::Equal, |&top| if top > 0.0 { Ordering::Greater } else { Ordering::Less })
    }

    /// Whether the number is exactly zero.
    pub fn is_zero(&self) -> bool {
        self.terms.is_empty()
    }

    /// The number as f64, with a relative error of at most 2^-50 (non-adjacent terms cannot cancel by more than half).
    pub fn estimate(&self) -> f64 {
        self.terms.iter().sum()
    }
}

impl From<f64> for Expansion {
    fn from(x: f64) -> Expansion {
        Expansion { terms: (x != 0.0).then_some(x).into_iter().collect() }
    }
}

impl Add for &Expansion {
    type Output = Expansion;
    fn add(self, other: &Expansion) -> Expansion {
        let mut out = self.clone();
        for &term in &other.terms {
            out.grow(term);
        }
        out
    }
}

impl Sub for &Expansion {
    type Output = Expansion;
    fn sub(self, other: &Expansion) -> Expansion {
        let mut out = self.clone();
        for &term in &other.terms {
            out.grow(-term);
        }
        out
    }
}

impl Mul for &Expansion {
    type Output = Expansion;
    fn mul(self, other: &Expansion) -> Expansion {
        let mut out = Expansion::default();
        for &a in &self.terms {
            for &b in &other.terms {
                out.grow_product(a, b);
            }
        }
        out
    }
}

impl Neg for Expansion {
    type Output = Expansion;
    fn neg(mut self) -> Expansion {
        self.terms.iter_mut().for_each(|term| *term = -*term);
        self
    }
}

/// A vector of exact numbers.
pub(super) type Vector = [Expansion; 3];

/// `p - q`, exactly.
pub(super) fn subtract(p: [f32; 3], q: [f32; 3]) -> Vector {
    std::array::from_fn(|i| Expansion::difference(p[i], q[i]))
}

/// An f32 vector as exact numbers.
pub(super) fn exact(p: [f32; 3]) -> Vector {
    p.map(|x| Expansion::from(f64::from(x)))
}

/// Cross product.
pub(super) fn cross(a: &Vector, b: &Vector) -> Vector {
    std::array::from_fn(|i| {
        let (j, k) = ((i + 1) % 3, (i + 2) % 3);
        &(&a[j] * &b[k]) - &(&a[k] * &b[j])
    })
}

/// Dot product.
pub(super) fn dot(a: &Vector, b: &Vector) -> Expansion {
    &(&(&a[0] * &b[0]) + &(&a[1] * &b[1])) + &(&a[2] * &b[2])
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The number as a multiple of 2^-80; inputs of the tests below keep it an integer below 2^126.
    fn to_integer(e: &Expansion) -> i128 {
        e.terms.iter().map(|t| (t * 2f64.powi(80)) as i128).sum()
    }

    proptest! {
        #[test]
        fn sums_and_products_are_exact(
            a in proptest::array::uniform4(-(1i64 << 40)..1 << 40),
            shift in proptest::array::uniform4(0i32..40)
        ) {
            let value = |i: usize| a[i] as f64 * 2f64.powi(-shift[i]);
            let integer = |i: usize| i128::from(a[i]) << (40 - shift[i]);
            let mut p = Expansion::from(value(0));
            p.grow(value(1));
            let mut q = Expansion::from(value(2));
            q.grow(value(3));
            // (a0 + a1) (a2 + a3) in steps of 2^-80 stays below 2^162; keep the test within i128 by small factors.
            prop_assert_eq!(to_integer(&(&p + &q)) >> 40, integer(0) + integer(1) + integer(2) + integer(3));
            prop_assert_eq!(to_integer(&(&p - &q)) >> 40, integer(0) + integer(1) - integer(2) - integer(3));
            let small = |i: usize| (a[i] >> 20) as f64;
            let (mut p, mut q) = (Expansion::from(small(0)), Expansion::from(small(2)));
            p.grow(small(1) * 2f64.powi(-20));
            q.grow(small(3) * 2f64.powi(-20));
            let whole = |i: usize, j: usize| ((i128::from(a[i]) >> 20) << 20) + (i128::from(a[j]) >> 20);
            prop_assert_eq!(to_integer(&(&p * &q)) >> 40, whole(0, 1) * whole(2, 3));
        }

        #[test]
        fn differences_of_any_f32_are_exact(a in any::<f32>(), b in any::<f32>()) {
            prop_assume!(a.is_finite() && b.is_finite());
            let e = Expansion::difference(a, b);
            let back = &e + &Expansion::from(f64::from(b));
            prop_assert!((&back - &Expansion::from(f64::from(a))).is_zero());
            prop_assert_eq!(e.sign(), a.partial_cmp(&b).unwrap());
        }
    }

    #[test]
    fn extremes_neither_overflow_nor_underflow() {
        let tiny = Expansion::from(f64::from(f32::from_bits(1)));
        let huge = Expansion::difference(f32::MAX, f32::MIN);
        let six = |x: &Expansion| &(&(x * x) * &(x * x)) * &(x * x);
        assert_eq!(six(&tiny).estimate(), 2f64.powi(-894));
        assert!(six(&huge).estimate().is_finite());
        assert_eq!((&(&six(&huge) + &six(&tiny)) - &six(&huge)).estimate(), 2f64.powi(-894));
    }
}
