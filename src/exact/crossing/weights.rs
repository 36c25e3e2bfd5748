//! Where in a triangle a line meets it, and t beside that: correctly rounded.

use super::{Line, OTHERS, wide};
use crate::exact::expansion::{dot, exact};
use crate::exact::predicates::U;
use crate::exact::quotient::Quotient;
use crate::exact::whole;
use crate::geometry::Triangle;

/// p - q in four lanes, rounded.
#[inline(always)]
fn minus(p: [f64; 4], q: [f64; 4]) -> [f64; 4] {
    [p[0] - q[0], p[1] - q[1], p[2] - q[2], p[3] - q[3]]
}

impl Line {
    /// The weights V / n.d and W / n.d of a triangle's second and third corner, correctly rounded.
    #[inline(always)]
    pub(super) fn weights(&self, triangle: &Triangle) -> [f32; 2] {
        let [a, b, c] = triangle.vertices().map(|v| v.to_array());
        let (u, v, w) = (self.determinant(b, c), self.determinant(c, a), self.determinant(a, b));
        let den = u.0 + v.0 + w.0;
        let den_error = u.1 + v.1 + w.1 + 4.0 * U * (u.0.abs() + v.0.abs() + w.0.abs());
        let inverse = 1.0 / den;
        let weight = |(num, num_error): (f64, f64), p, q| {
            let quotient = num * inverse;
            // As in `accepted`.
            let error = 2.25 * (num_error + quotient.abs() * den_error) * inverse.abs() + 4.0 * U * quotient.abs();
            let (lo, hi) = ((quotient - error) as f32, (quotient + error) as f32);
            // Adding +0 turns -0 into +0.
            if den.abs() > 2.0 * den_error && lo == hi { lo + 0.0 } else { self.weight_exact(triangle, p, q) }
        };
        [weight(v, c, a), weight(w, a, b)]
    }

    /// t and the weights of the second and third corner of a triangle that the line is known to hit, all correctly rounded; `None`
    /// where f64 cannot tell how to round one of them.
    ///
    /// All three in four lanes: V, W, U and n.(a - o) are determinants, n.d is the sum of the first three.
    #[inline(always)]
    pub fn rounded(&self, triangle: &Triangle) -> Option<[f32; 3]> {
        let [a, b, c] = [wide(triangle.a.to_array()), wide(triangle.b.to_array()), wide(triangle.c.to_array())];
        let (o, d) = (self.o, self.d);
        let (mut p, mut q, mut r) = ([[0.0; 4]; 3], [[0.0; 4]; 3], [[0.0; 4]; 3]);
        for k in 0..3 {
            p[k] = minus([c[k], a[k], b[k], b[k]], [o[k], o[k], o[k], a[k]]);
            q[k] = minus([a[k], b[k], c[k], c[k]], [c[k], a[k], b[k], a[k]]);
            r[k] = [d[k], d[k], d[k], a[k] - o[k]];
        }
        let (mut value, mut permanent) = ([0.0; 4], [0.0; 4]);
        for (i, (j, k)) in OTHERS.into_iter().enumerate() {
            for l in 0..4 {
                let (plus, less) = (p[j][l] * q[k][l], p[k][l] * q[j][l]);
                value[l] += (plus - less) * r[i][l];
                permanent[l] += (plus.abs() + less.abs()) * r[i][l].abs();
            }
        }
        // Eight roundings on a path (differences 1 + 1 + 1, product 1, subtraction 1, product 1, sums 2), one for the bound's own.
        let error = [0, 1, 2, 3].map(|l| 9.0 * U * permanent[l]);
        let den = value[0] + value[1] + value[2];
        let sizes = value[0].abs() + value[1].abs() + value[2].abs();
        let den_error = error[0] + error[1] + error[2] + 4.0 * U * sizes;
        let inverse = 1.0 / den;
        let (mut low, mut high) = ([0f32; 4], [0f32; 4]);
        for l in 0..4 {
            // As in `accepted`.
            let quotient = value[l] * inverse;
            let bound = 2.25 * (error[l] + quotient.abs() * den_error) * inverse.abs() + 4.0 * U * quotient.abs();
            (low[l], high[l]) = ((quotient - bound) as f32, (quotient + bound) as f32);
        }
        let certain = (den.abs() > 2.0 * den_error) & (low[0] == high[0]) & (low[1] == high[1]) & (low[3] == high[3]);
        // Adding +0 turns -0 into +0.
        certain.then_some([low[3] + 0.0, low[0] + 0.0, low[1] + 0.0])
    }

    /// The weight det(d, p - o, q - o) / n.d, by expansions.
    #[cold]
    fn weight_exact(&self, triangle: &Triangle, p: [f32; 3], q: [f32; 3]) -> f32 {
        // Mostly it is asked for hits on an edge.
        if whole::determinant(self.ray.direction, self.ray.origin, p, q).is_some_and(|found| found.value == 0) {
            return 0.0;
        }
        let num = dot(&exact(self.ray.direction), &self.edge_cross(p, q));
        Quotient::new(num, self.normal_dot_direction(triangle)).round() + 0.0
    }
}
