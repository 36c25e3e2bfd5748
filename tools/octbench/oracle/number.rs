//! The decision, written once over any kind of number that knows its sign (or knows that it does not).

use std::cmp::Ordering;

use super::{Corners, OracleRay};

/// A number of one of the tiers.
pub trait Number: Clone {
    /// Exact value of an f64.
    fn of(x: f64) -> Self;
    /// Sum.
    fn add(&self, other: &Self) -> Self;
    /// Difference.
    fn sub(&self, other: &Self) -> Self;
    /// Product.
    fn mul(&self, other: &Self) -> Self;
    /// Sign; `None` if this tier cannot tell.
    fn sign(&self) -> Option<Ordering>;
    /// A closed interval that holds the value.
    fn bounds(&self) -> (f64, f64);
}

type Vector<N> = [N; 3];

fn exactly<N: Number>(p: &[f32; 3]) -> Vector<N> {
    p.map(|x| N::of(x.into()))
}

fn minus<N: Number>(p: &Vector<N>, q: &Vector<N>) -> Vector<N> {
    [p[0].sub(&q[0]), p[1].sub(&q[1]), p[2].sub(&q[2])]
}

fn cross<N: Number>(p: &Vector<N>, q: &Vector<N>) -> Vector<N> {
    let minor = |i: usize, j: usize| p[i].mul(&q[j]).sub(&p[j].mul(&q[i]));
    [minor(1, 2), minor(2, 0), minor(0, 1)]
}

fn dot<N: Number>(p: &Vector<N>, q: &Vector<N>) -> N {
    p[0].mul(&q[0]).add(&p[1].mul(&q[1])).add(&p[2].mul(&q[2]))
}

/// A crossing of line and triangle: t = num / den, barycentric weights of a, b, c in proportion to `weights`.
pub struct Crossing<N> {
    num: N,
    den: N,
    weights: Vector<N>,
}

/// Whether the line crosses: `None` = cannot tell, `Some(None)` = no.
pub fn crossing<N: Number>(ray: &OracleRay, corners: &Corners) -> Option<Option<Crossing<N>>> {
    let (o, d) = (exactly::<N>(&ray.o), exactly(&ray.d));
    let p = corners.map(|c| minus(&exactly(&c), &o));
    let normal = cross(&minus(&p[1], &p[0]), &minus(&p[2], &p[0]));
    let den = dot(&normal, &d);
    if den.sign()? == Ordering::Equal {
        return Some(None);
    }
    let faces = [cross(&p[1], &p[2]), cross(&p[2], &p[0]), cross(&p[0], &p[1])];
    let weights = [dot(&d, &faces[0]), dot(&d, &faces[1]), dot(&d, &faces[2])];
    let mut signs = [Ordering::Equal; 3];
    for i in 0..3 {
        signs[i] = perturbed_sign(&weights[i], &faces[i])?;
    }
    let num = dot(&normal, &p[0]);
    let inside = if signs.contains(&Ordering::Equal) {
        in_closed_triangle(&normal, &faces)?
    } else {
        signs[0] == signs[1] && signs[1] == signs[2]
    };
    Some(inside.then_some(Crossing {
        num,
        den,
        weights: if signs.contains(&Ordering::Equal) { along(&normal, &faces)? } else { weights },
    }))
}

/// The sign of `weight = d . face` for the direction d + (e, e^2, e^3); `Equal` only if `face` is zero altogether.
fn perturbed_sign<N: Number>(weight: &N, face: &Vector<N>) -> Option<Ordering> {
    for number in [weight, &face[0], &face[1], &face[2]] {
        match number.sign()? {
            Ordering::Equal => {}
            sign => return Some(sign),
        }
    }
    Some(Ordering::Equal)
}

/// For an origin in the plane: whether it lies in the closed triangle. All `faces` are multiples of the normal then.
fn in_closed_triangle<N: Number>(normal: &Vector<N>, faces: &[Vector<N>; 3]) -> Option<bool> {
    for weight in along(normal, faces)? {
        if weight.sign()? == Ordering::Less {
            return Some(false);
        }
    }
    Some(true)
}

/// The three faces measured along the normal: proportional to the barycentric weights of an origin in the plane.
fn along<N: Number>(normal: &Vector<N>, faces: &[Vector<N>; 3]) -> Option<Vector<N>> {
    Some([dot(normal, &faces[0]), dot(normal, &faces[1]), dot(normal, &faces[2])])
}

impl<N: Number> Crossing<N> {
    /// An interval that holds t.
    pub fn t_bounds(&self) -> (f64, f64) {
        let ((a, b), (c, d)) = (self.num.bounds(), self.den.bounds());
        if c <= 0.0 && d >= 0.0 {
            return (f64::NEG_INFINITY, f64::INFINITY);
        }
        let quotients = [a / c, a / d, b / c, b / d];
        let low = quotients.iter().copied().fold(f64::INFINITY, f64::min);
        let high = quotients.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        (low.next_down(), high.next_up())
    }

    /// t rounded to the nearest f32, ties to even; for tiers that always tell.
    pub fn t_rounded(&self) -> f32 {
        if self.num.sign() == Some(Ordering::Equal) {
            return 0.0;
        }
        let (low, high) = self.t_bounds();
        let mut t = (0.5 * (low + high)) as f32;
        // Walk to the number whose rounding range holds num / den; the start is at most a step or two away.
        loop {
            match (self.beyond_midpoint(t, false), self.beyond_midpoint(t, true)) {
                (true, _) => t = t.next_down(),
                (_, true) => t = t.next_up(),
                _ => return t,
            }
        }
    }

    /// Whether the exact t lies beyond the midpoint of `t` and its neighbour above (or below), so that it rounds elsewhere.
    fn beyond_midpoint(&self, t: f32, above: bool) -> bool {
        if !t.is_finite() {
            return !above && t > 0.0 && self.against_largest() == Ordering::Less
                || above && t < 0.0 && self.against_largest() == Ordering::Greater;
        }
        let other = if above { t.next_up() } else { t.next_down() };
        let neighbour = if other.is_infinite() {
            f64::from(t) * 2.0 - f64::from(if above { t.next_down() } else { t.next_up() })
        } else {
            f64::from(other)
        };
        // Exact: two f32 with the same or neighbouring exponents.
        let middle = 0.5 * (f64::from(t) + neighbour);
        let even = t.to_bits() & 1 == 0;
        match self.against(middle) {
            Ordering::Equal => !even,
            Ordering::Greater => above,
            Ordering::Less => !above,
        }
    }

    /// The exact t against the border beyond which f32 rounds to infinity, of the sign that t has.
    fn against_largest(&self) -> Ordering {
        let border = f64::from(f32::MAX) + (f64::from(f32::MAX) - f64::from(f32::MAX.next_down())) / 2.0;
        let positive = self.num.sign() == self.den.sign();
        self.against(if positive { border } else { -border })
    }

    /// The exact t against an f64.
    fn against(&self, x: f64) -> Ordering {
        let sign = self.num.sub(&self.den.mul(&N::of(x))).sign().expect("an exact tier");
        if self.den.sign() == Some(Ordering::Less) { sign.reverse() } else { sign }
    }

    /// Whether t is exactly `x`, for tiers that always tell.
    pub fn is_exactly(&self, x: f32) -> bool {
        self.against(x.into()) == Ordering::Equal
    }

    /// The order of two exact t, for tiers that always tell.
    pub fn compare(&self, other: &Self) -> Ordering {
        let sign = self.num.mul(&other.den).sub(&other.num.mul(&self.den)).sign().expect("an exact tier");
        if self.den.sign() == other.den.sign() { sign } else { sign.reverse() }
    }

    /// Weights of the second and third corner.
    pub fn barycentric(&self) -> (f64, f64) {
        let middle = |n: &N| {
            let (low, high) = n.bounds();
            0.5 * (low + high)
        };
        let sum = middle(&self.weights[0].add(&self.weights[1]).add(&self.weights[2]));
        (middle(&self.weights[1]) / sum, middle(&self.weights[2]) / sum)
    }
}
