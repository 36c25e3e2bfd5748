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
    pub(super) num: N,
    pub(super) den: N,
    weights: Vector<N>,
}

/// Ray and triangle in numbers of one tier, seen from the ray's origin. Each question is answered by itself, so that a
/// costly tier is asked only what a cheap one could not tell.
pub struct Figure<N> {
    d: Vector<N>,
    p: [Vector<N>; 3],
}

impl<N: Number> Figure<N> {
    /// The figure of a ray and a triangle.
    pub fn new(ray: &OracleRay, corners: &Corners) -> Figure<N> {
        let o = exactly(&ray.o);
        Figure { d: exactly(&ray.d), p: corners.map(|c| minus(&exactly(&c), &o)) }
    }

    /// The figure of a direction and of corners seen from the origin; a positive factor of either changes no sign.
    pub fn seen(d: Vector<N>, p: [Vector<N>; 3]) -> Figure<N> {
        Figure { d, p }
    }

    fn normal(&self) -> Vector<N> {
        cross(&minus(&self.p[1], &self.p[0]), &minus(&self.p[2], &self.p[0]))
    }

    /// Normal of the plane through the origin and the edge opposite to corner i.
    fn face(&self, i: usize) -> Vector<N> {
        cross(&self.p[(i + 1) % 3], &self.p[(i + 2) % 3])
    }

    fn faces(&self) -> [Vector<N>; 3] {
        [self.face(0), self.face(1), self.face(2)]
    }

    /// Sign of n . d; zero for a ray along the plane. `None` = cannot tell, here and below.
    pub fn den_sign(&self) -> Option<Ordering> {
        dot(&self.normal(), &self.d).sign()
    }

    /// Perturbed sign of the determinant of the edge opposite to corner i; `Equal` if the origin is on the edge's line.
    pub fn edge_sign(&self, i: usize) -> Option<Ordering> {
        let face = self.face(i);
        perturbed_sign(&dot(&self.d, &face), &face)
    }

    /// For an origin in the plane: whether it lies in the closed triangle. All faces are multiples of the normal then.
    pub fn origin_inside(&self) -> Option<bool> {
        for weight in along(&self.normal(), &self.faces()) {
            if weight.sign()? == Ordering::Less {
                return Some(false);
            }
        }
        Some(true)
    }

    /// The crossing as numbers; `on_edge` where the origin lies on the line of an edge, so that no direction weighs corners.
    pub fn crossing(&self, on_edge: bool) -> Crossing<N> {
        let (normal, faces) = (self.normal(), self.faces());
        let weights = if on_edge { along(&normal, &faces) } else { [0, 1, 2].map(|i: usize| dot(&self.d, &faces[i])) };
        Crossing { num: dot(&normal, &self.p[0]), den: dot(&normal, &self.d), weights }
    }
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

/// The three faces measured along the normal: proportional to the barycentric weights of an origin in the plane.
fn along<N: Number>(normal: &Vector<N>, faces: &[Vector<N>; 3]) -> Vector<N> {
    [dot(normal, &faces[0]), dot(normal, &faces[1]), dot(normal, &faces[2])]
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

    /// Whether t is exactly `x`; `None` = cannot tell.
    pub fn is_exactly(&self, x: f32) -> Option<bool> {
        Some(self.num.sub(&self.den.mul(&N::of(x.into()))).sign()? == Ordering::Equal)
    }

    /// The order of two exact t, for tiers that always tell.
    pub fn compare(&self, other: &Self) -> Ordering {
        let sign = self.num.mul(&other.den).sub(&other.num.mul(&self.den)).sign().expect("an exact tier");
        if self.den.sign() == other.den.sign() { sign } else { sign.reverse() }
    }

    /// Weights of the second and third corner to well below an ulp of f32; `None` = cannot tell.
    pub fn barycentric(&self) -> Option<(f64, f64)> {
        let sum = self.weights[0].add(&self.weights[1]).add(&self.weights[2]);
        let middle = |n: &N| {
            let (low, high) = n.bounds();
            let narrow = low == high || high - low <= 1e-10 * (low.abs() + high.abs()).min(f64::MAX);
            narrow.then_some(0.5 * (low + high))
        };
        let sum = middle(&sum)?;
        Some((middle(&self.weights[1])? / sum, middle(&self.weights[2])? / sum))
    }
}
