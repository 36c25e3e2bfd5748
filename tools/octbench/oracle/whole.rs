//! Between the tiers: whole numbers of 128 bits, exact like expansions and quicker, where coordinates lie close enough together.

use std::cmp::Ordering;

use super::number::{Crossing, Figure, Number};
use super::{Corners, OracleRay};

/// A whole number, or nothing once it has outgrown 128 bits.
#[derive(Clone, Copy, Debug)]
pub struct Whole(Option<i128>);

/// Numbers as whole multiples of a power of two: `scale` takes them there.
fn scale<'a>(numbers: impl Iterator<Item = &'a f32>) -> f64 {
    // The least exponent decides; 2^-149 is the unit of the smallest.
    let least = numbers.filter(|x| **x != 0.0).map(|x| x.to_bits() >> 23 & 0xff).min().unwrap_or(1);
    2f64.powi(150 - least.max(1) as i32)
}

/// The number in units of the scale; nothing if it is too large to be worth it.
fn whole(x: f32, scale: f64) -> Whole {
    let number = f64::from(x) * scale;
    Whole((number.abs() < 1e15).then_some(number as i128))
}

/// A figure of whole numbers: direction and corners seen from the origin, each kind in a unit of its own.
pub struct Scaled {
    /// The figure.
    pub figure: Figure<Whole>,
    /// The true t is that of the figure times this power of two.
    unit: f64,
}

impl Scaled {
    /// The figure of a ray and a triangle.
    pub fn new(ray: &OracleRay, corners: &Corners) -> Scaled {
        let (along, at) = (scale(ray.d.iter()), scale(ray.o.iter().chain(corners.iter().flatten())));
        let o = ray.o.map(|x| whole(x, at));
        let p = corners.map(|corner| [0, 1, 2].map(|i: usize| whole(corner[i], at).sub(&o[i])));
        Scaled { figure: Figure::seen(ray.d.map(|x| whole(x, along)), p), unit: along / at }
    }

    /// Whether t is exactly `x`; nothing where the numbers are too large.
    pub fn is_exactly(&self, crossing: &Crossing<Whole>, x: f32) -> Option<bool> {
        // num unit = den x, as whole numbers: both sides times the power of two that makes unit or x whole.
        let t = f64::from(x) / self.unit;
        let shift = 2f64.powi(if t == 0.0 { 0 } else { 23 - t.abs().log2().floor() as i32 }.clamp(-60, 60));
        let (left, right) = if shift >= 1.0 { (shift, t * shift) } else { (1.0, t) };
        let whole = |x: f64| (x.fract() == 0.0 && x.abs() < 2f64.powi(62)).then_some(Whole(Some(x as i128)));
        let difference = crossing.num.mul(&whole(left)?).sub(&crossing.den.mul(&whole(right)?));
        difference.sign().map(Ordering::is_eq)
    }
}

impl Number for Whole {
    fn of(x: f64) -> Self {
        Whole((x.fract() == 0.0 && x.abs() < 1e15).then_some(x as i128))
    }

    fn add(&self, other: &Self) -> Self {
        Whole(self.0.zip(other.0).and_then(|(a, b)| a.checked_add(b)))
    }

    fn sub(&self, other: &Self) -> Self {
        Whole(self.0.zip(other.0).and_then(|(a, b)| a.checked_sub(b)))
    }

    fn mul(&self, other: &Self) -> Self {
        let product = |(a, b): (i128, i128)| match (i64::try_from(a), i64::try_from(b)) {
            (Ok(a), Ok(b)) => Some(i128::from(a) * i128::from(b)),
            _ => a.checked_mul(b),
        };
        Whole(self.0.zip(other.0).and_then(product))
    }

    fn sign(&self) -> Option<Ordering> {
        self.0.map(|n| n.cmp(&0))
    }

    fn bounds(&self) -> (f64, f64) {
        let small = |n: i128| n.unsigned_abs() < 1 << 53;
        match self.0 {
            Some(n) if small(n) => (n as f64, n as f64),
            Some(n) => ((n as f64).next_down(), (n as f64).next_up()),
            None => (f64::NEG_INFINITY, f64::INFINITY),
        }
    }
}
