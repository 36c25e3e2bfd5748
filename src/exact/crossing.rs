//! Where a line meets a triangle: hit or miss, order along the line, t, u and v; all as in exact arithmetic.
//!
//! With A, B, C the corners seen from the origin o, the line along d passes the triangle iff the three edge determinants
//!
//! ```text
//! U = det(d, B, C)    V = det(d, C, A)    W = det(d, A, B)        (weights of a, b, c; U + V + W = n.d)
//! ```
//!
//! have one sign. Each is taken in f64 with an error bound, then in whole numbers or expansions. A determinant that is exactly zero (the line
//! meets an edge's line) is resolved by perturbing the *direction* symbolically, d + (e, e^2, e^3) for an infinitely small
//! e: its sign is that of the first non-zero component of the edge's cross product (Edelsbrunner and Mücke 1990 call this
//! simulation of simplicity). All triangles see the same perturbed line, and the two triangles at an edge see exactly
//! opposite determinants: so a closed surface is met exactly once at an edge or a vertex, whatever the order of corners.
//!
//! - n.d = 0, all determinants zero: the triangle is seen edge-on (or has no area): a miss.
//! - All three components of an edge's cross product are zero: o lies on that edge's line, where no perturbation of the
//!   direction helps. Then the line meets the triangle's plane in o alone: a hit with t = 0 if o lies on the edge itself (ends
//!   included), for every triangle there; else a miss.
//! - t = n.(a - o) / n.d is an exact quotient. It is kept as an f64 interval; order, and rounding to f32, fall back
//!   to expansions only where the interval does not decide. t, u, v are the correctly rounded exact values of the
//!   *unperturbed* line (u = 0 on the edge ca, and so on), zero is +0.
//! - A t that rounds to infinity is a miss, since t = infinity says "miss".

mod weights;

use std::cmp::Ordering;

use super::expansion::{Expansion, Vector, cross, dot, exact, subtract};
use super::predicates::U;
use super::quotient::Quotient;
use super::whole;
use crate::geometry::{Ray, Triangle};

/// A ray prepared for the exact test: its origin and direction (finite, not zero) as f64.
#[derive(Clone, Copy, Debug)]
pub struct Line {
    /// The ray.
    pub ray: Ray,
    o: [f64; 3],
    d: [f64; 3],
}

/// A line meets a triangle: hit or miss is settled, t is known to f64 accuracy and can be had exactly.
#[derive(Clone, Copy, Debug)]
pub struct Crossing {
    /// The triangle.
    pub triangle: Triangle,
    /// An interval that holds the exact t.
    pub depth: [f64; 2],
}

/// The outcome of a test, and whether it needed exact arithmetic.
#[derive(Clone, Copy, Debug)]
pub struct Decision {
    /// Where the line meets the triangle, if it does (at any t, positive or negative).
    pub crossing: Option<Crossing>,
    /// Whether f64 did not suffice.
    pub exact: bool,
}

/// What f64 says of the sign of an edge determinant: certainly positive, certainly negative, or neither.
#[derive(Clone, Copy)]
struct Sign {
    positive: bool,
    negative: bool,
}

impl Sign {
    /// From a value and the bound of its error.
    #[inline(always)]
    fn of((value, error): (f64, f64)) -> Sign {
        Sign { positive: value > error, negative: value < -error }
    }

    #[inline(always)]
    fn doubt(&self) -> bool {
        !(self.positive | self.negative)
    }
}

/// The edges bc, ca, ab: those opposite to a, b and c.
#[inline(always)]
fn edges(triangle: &Triangle) -> [([f32; 3], [f32; 3]); 3] {
    let [a, b, c] = triangle.vertices().map(|v| v.to_array());
    [(b, c), (c, a), (a, b)]
}

/// The other two axes in cyclic order.
const OTHERS: [(usize, usize); 3] = [(1, 2), (2, 0), (0, 1)];

/// A point as f64.
#[inline]
fn wide(p: [f32; 3]) -> [f64; 3] {
    [f64::from(p[0]), f64::from(p[1]), f64::from(p[2])]
}

/// p - q, rounded.
#[inline]
fn apart(p: [f64; 3], q: [f64; 3]) -> [f64; 3] {
    [p[0] - q[0], p[1] - q[1], p[2] - q[2]]
}

impl Line {
    /// Prepares a ray.
    #[inline(always)]
    pub fn new(ray: &Ray) -> Line {
        Line { ray: *ray, o: wide(ray.origin), d: wide(ray.direction) }
    }

    /// Decides whether the line meets the triangle.
    pub fn meet(&self, triangle: &Triangle) -> Decision {
        let edges = edges(triangle);
        let [u, v, w] = edges.map(|(p, q)| Sign::of(self.determinant(p, q)));
        let (positive, negative) = (u.positive | v.positive | w.positive, u.negative | v.negative | w.negative);
        if positive & negative {
            return Decision { crossing: None, exact: false };
        }
        if [u, v, w].iter().any(|sign| sign.doubt()) {
            return self.meet_exact(triangle, [u, v, w]);
        }
        self.accepted(triangle)
    }

    /// The same where f64 leaves a determinant in doubt, and those that it does not all have one sign.
    #[cold]
    fn meet_exact(&self, triangle: &Triangle, signs: [Sign; 3]) -> Decision {
        let miss = Decision { crossing: None, exact: true };
        if signs.iter().all(Sign::doubt) && self.is_along(triangle) {
            return miss;
        }
        let mut first = signs.iter().find(|sign| !sign.doubt()).map(|sign| sign.positive);
        for ((p, q), sign) in edges(triangle).into_iter().zip(signs) {
            if !sign.doubt() {
                continue;
            }
            match self.edge_exact(p, q) {
                Ordering::Equal => {
                    // The origin is on the edge's line, so on the edge iff within its box.
                    let o = self.ray.origin;
                    let within = (0..3).all(|i| p[i].min(q[i]) <= o[i] && o[i] <= p[i].max(q[i]));
                    return if within { Decision { exact: true, ..self.accepted(triangle) } } else { miss };
                }
                sign if *first.get_or_insert(sign.is_gt()) != sign.is_gt() => return miss,
                _ => {}
            }
        }
        Decision { exact: true, ..self.accepted(triangle) }
    }

    /// Where the line meets a triangle whose three determinants are known to agree in sign: only n.d = 0 can still make it a miss.
    #[inline(always)]
    pub fn accepted(&self, triangle: &Triangle) -> Decision {
        let [a, b, c] = [wide(triangle.a.to_array()), wide(triangle.b.to_array()), wide(triangle.c.to_array())];
        let (mut num, mut num_permanent, mut den, mut den_permanent) = (0.0, 0.0, 0.0, 0.0);
        let (e, f) = (apart(b, a), apart(c, a));
        for (i, (j, k)) in OTHERS.into_iter().enumerate() {
            let (plus, minus) = (e[j] * f[k], e[k] * f[j]);
            let (n, permanent) = (plus - minus, plus.abs() + minus.abs());
            let w = a[i] - self.o[i];
            num += n * w;
            num_permanent += permanent * w.abs();
            den += n * self.d[i];
            den_permanent += permanent * self.d[i].abs();
        }
        // Roundings on a path: edges 1 + 1, product 1, subtraction 1, (w 1,) product 1, sums 2.
        let (num_error, den_error) = (9.0 * U * num_permanent, 8.0 * U * den_permanent);
        if den.abs() <= 2.0 * den_error {
            return self.accepted_exact(triangle);
        }
        // |num / den - t| <= (num_error + |t'| den_error) / |den + an error| <= twice that over |den|; the rest of 2.25 covers the
        // roundings of the error, and 4 U those of t' (two) and of the interval's ends (one). Nothing underflows here.
        let inverse = 1.0 / den;
        let t = num * inverse;
        let error = 2.25 * (num_error + t.abs() * den_error) * inverse.abs() + 4.0 * U * t.abs();
        let depth = [t - error, t + error];
        Decision { crossing: Some(Crossing { triangle: *triangle, depth }), exact: false }
    }

    /// The same where f64 cannot tell n.d from zero.
    #[cold]
    fn accepted_exact(&self, triangle: &Triangle) -> Decision {
        let crossing = (!self.is_along(triangle)).then(|| {
            let depth = self.t(triangle).interval();
            Crossing { triangle: *triangle, depth }
        });
        Decision { crossing, exact: true }
    }

    /// det(d, p - o, q - o) in f64, and a bound of its error.
    ///
    /// It is computed as det(d, p - o, q - p), the same number, whose terms are smaller by the ratio of edge to distance.
    #[inline(always)]
    pub(super) fn determinant(&self, p: [f32; 3], q: [f32; 3]) -> (f64, f64) {
        let (p, q) = (wide(p), wide(q));
        let (p, q) = (apart(p, self.o), apart(q, p));
        let (mut value, mut permanent) = (0.0, 0.0);
        for (i, (j, k)) in OTHERS.into_iter().enumerate() {
            let (plus, minus) = (p[j] * q[k], p[k] * q[j]);
            value += (plus - minus) * self.d[i];
            permanent += (plus.abs() + minus.abs()) * self.d[i].abs();
        }
        // Seven roundings on a path (differences 1 + 1, product 1, subtraction 1, product 1, sums 2), one for the bound's own.
        (value, 8.0 * U * permanent)
    }

    /// The sign of det(d, p - o, q - o), exactly, zeros resolved; `Equal` if o lies on the line through p and q.
    fn edge_exact(&self, p: [f32; 3], q: [f32; 3]) -> Ordering {
        if let Some(found) = whole::determinant(self.ray.direction, self.ray.origin, p, q) {
            return found.perturbed_sign();
        }
        let cross = self.edge_cross(p, q);
        let value = dot(&exact(self.ray.direction), &cross);
        std::iter::once(&value).chain(&cross).map(Expansion::sign).find(|sign| sign.is_ne()).unwrap_or(Ordering::Equal)
    }

    /// Whether n.d is exactly zero: the line runs along the triangle's plane, or the triangle has no area.
    fn is_along(&self, triangle: &Triangle) -> bool {
        let [a, b, c] = triangle.vertices().map(|v| v.to_array());
        match whole::determinant(self.ray.direction, a, b, c) {
            Some(found) => found.value == 0,
            None => self.normal_dot_direction(triangle).is_zero(),
        }
    }

    /// (p - o) x (q - o), exactly.
    pub(super) fn edge_cross(&self, p: [f32; 3], q: [f32; 3]) -> Vector {
        cross(&subtract(p, self.ray.origin), &subtract(q, self.ray.origin))
    }

    /// n = (b - a) x (c - a), exactly.
    fn normal(triangle: &Triangle) -> Vector {
        let [a, b, c] = triangle.vertices().map(|v| v.to_array());
        cross(&subtract(b, a), &subtract(c, a))
    }

    /// n.d, exactly.
    fn normal_dot_direction(&self, triangle: &Triangle) -> Expansion {
        dot(&Line::normal(triangle), &exact(self.ray.direction))
    }

    /// n.(a - o), exactly.
    fn height(&self, triangle: &Triangle) -> Expansion {
        dot(&Line::normal(triangle), &subtract(triangle.a.to_array(), self.ray.origin))
    }

    /// The exact t of a crossing.
    fn t(&self, triangle: &Triangle) -> Quotient {
        Quotient::new(self.height(triangle), self.normal_dot_direction(triangle))
    }
}

impl Crossing {
    /// The exact order of two crossings of one line by t alone.
    #[inline(always)]
    pub fn cmp(&self, other: &Crossing, line: &Line) -> Ordering {
        if self.depth[1] < other.depth[0] {
            Ordering::Less
        } else if other.depth[1] < self.depth[0] {
            Ordering::Greater
        } else {
            self.cmp_exact(other, line)
        }
    }

    #[cold]
    fn cmp_exact(&self, other: &Crossing, line: &Line) -> Ordering {
        if self.triangle == other.triangle {
            return Ordering::Equal;
        }
        let corners = [&self.triangle, &other.triangle].map(|t| t.vertices().map(|v| v.to_array()));
        if let Some(order) = whole::order(line.ray.direction, line.ray.origin, corners) {
            return order;
        }
        line.t(&self.triangle).cmp(&line.t(&other.triangle))
    }

    /// The correctly rounded t, if it lies in the closed interval `[tmin, tmax]` and is finite.
    #[inline(always)]
    pub fn t_within(&self, line: &Line) -> Option<f32> {
        let (lo, hi) = (self.depth[0] as f32, self.depth[1] as f32);
        if hi < line.ray.tmin || lo > line.ray.tmax {
            return None;
        }
        // Adding +0 turns -0 into +0.
        let t = if lo == hi { lo } else { line.t(&self.triangle).round() } + 0.0;
        (line.ray.tmin <= t && t <= line.ray.tmax && t.is_finite()).then_some(t)
    }

    /// The weights of the second and the third corner, correctly rounded.
    #[inline(always)]
    pub fn uv(&self, line: &Line) -> [f32; 2] {
        line.weights(&self.triangle)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn triangle(a: [f32; 3], b: [f32; 3], c: [f32; 3]) -> Triangle {
        Triangle { a: a.into(), b: b.into(), c: c.into() }
    }

    fn hit(ray: &Ray, t: &Triangle) -> Option<(f32, [f32; 2])> {
        let line = Line::new(ray);
        let crossing = line.meet(t).crossing?;
        Some((crossing.t_within(&line)?, crossing.uv(&line)))
    }

    #[test]
    fn plain_hit_and_miss() {
        let t = triangle([0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [0.0, 4.0, 0.0]);
        assert_eq!(hit(&Ray::new([1.0, 2.0, 8.0], [0.0, 0.0, -2.0]), &t), Some((4.0, [0.25, 0.5])));
        assert_eq!(hit(&Ray::new([3.0, 3.0, 8.0], [0.0, 0.0, -2.0]), &t), None);
        assert_eq!(hit(&Ray::new([1.0, 2.0, 8.0], [0.0, 0.0, 2.0]), &t), None);
        assert_eq!(hit(&Ray::new([1.0, 2.0, 8.0], [0.0, 0.0, 2.0]).between(-9.0, 0.0), &t).unwrap().0, -4.0);
    }

    #[test]
    fn edge_is_hit_once_by_its_two_triangles() {
        let (a, b) = ([0.0, 0.0, 0.0], [4.0, 4.0, 0.0]);
        let (left, right) = (triangle(a, b, [0.0, 4.0, 0.0]), triangle(a, b, [4.0, 0.0, 0.0]));
        for d in [[0.0, 0.0, -1.0], [1.0, 1.0, -4.0], [-1.0, 2.0, -4.0]] {
            let o: [f32; 3] = std::array::from_fn(|i| [2.0, 2.0, 0.0][i] - 2.0 * d[i]);
            let ray = Ray::new(o, d);
            let hits: Vec<_> = [&left, &right].into_iter().filter_map(|t| hit(&ray, t)).collect();
            assert_eq!(hits.len(), 1);
            assert_eq!(hits[0], (2.0, [0.5, 0.0]));
        }
    }

    #[test]
    fn coplanar_and_flat_triangles_are_missed() {
        let t = triangle([0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [0.0, 4.0, 0.0]);
        assert_eq!(hit(&Ray::new([-1.0, 1.0, 0.0], [1.0, 0.0, 0.0]), &t), None);
        assert_eq!(hit(&Ray::new([1.0, 1.0, 0.0], [1.0, 0.0, 0.0]), &t), None);
        let flat = triangle([0.0; 3], [1.0, 1.0, 1.0], [2.0, 2.0, 2.0]);
        assert_eq!(hit(&Ray::new([1.0, 1.0, 5.0], [0.0, 0.0, -1.0]), &flat), None);
    }

    #[test]
    fn origin_on_an_edge_or_its_line() {
        let t = triangle([0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [0.0, 4.0, 0.0]);
        let from = |o| hit(&Ray::new(o, [0.5, 0.25, 1.0]), &t);
        assert_eq!(from([1.0, 0.0, 0.0]), Some((0.0, [0.25, 0.0])));
        assert_eq!(from([4.0, 0.0, 0.0]), Some((0.0, [1.0, 0.0])));
        assert_eq!(from([2.0, 2.0, 0.0]), Some((0.0, [0.5, 0.5])));
        assert_eq!(from([5.0, 0.0, 0.0]), None);
        assert_eq!(from([-1.0, 0.0, 0.0]), None);
        assert_eq!(hit(&Ray::new([1.0, 0.0, 0.0], [0.0, 0.0, 1.0]).between(1e-45, 1.0), &t), None);
    }

    #[test]
    fn t_beyond_f32_is_a_miss_and_zero_is_positive() {
        let t = triangle([0.0, 0.0, 3e38], [4.0, 0.0, 3e38], [0.0, 4.0, 3e38]);
        assert_eq!(hit(&Ray::new([1.0, 1.0, 0.0], [0.0, 0.0, 0.5]), &t), None);
        let ground = triangle([0.0; 3], [4.0, 0.0, 0.0], [0.0, 4.0, 0.0]);
        let (zero, _) = hit(&Ray::new([1.0, 1.0, -1e-45], [0.0, 0.0, -4.0]).between(-1.0, 1.0), &ground).unwrap();
        assert_eq!(zero.to_bits(), 0);
    }
}
