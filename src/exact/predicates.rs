//! Signs of small determinants: which side of a plane or a line a point lies on, whether a triangle has an area.

use std::cmp::Ordering;

use super::expansion::{Expansion, cross, dot, exact, subtract};
use crate::geometry::Triangle;

/// f64's unit roundoff.
pub(crate) const U: f64 = 1.0 / 9_007_199_254_740_992.0;

/// The side of the triangle's plane on which `point` lies: `Greater` where (b - a) x (c - a) points, `Equal` on the plane
/// (always, for a triangle without area). Exact for finite coordinates.
#[inline]
pub fn side(triangle: &Triangle, point: [f32; 3]) -> Ordering {
    let a = triangle.a.to_array();
    along_normal(triangle, std::array::from_fn(|i| f64::from(point[i]) - f64::from(a[i])))
        .unwrap_or_else(|| dot(&exact_normal(triangle), &subtract(point, a)).sign())
}

/// The side of the triangle's plane to which `direction` leads: `Greater` where (b - a) x (c - a) points, `Equal` along the
/// plane. Exact for finite coordinates.
pub fn heading(triangle: &Triangle, direction: [f32; 3]) -> Ordering {
    along_normal(triangle, direction.map(f64::from))
        .unwrap_or_else(|| dot(&exact_normal(triangle), &exact(direction)).sign())
}

/// The sign of ((b - a) x (c - a)) . w, if it is certain; each component of w is off by at most one rounding.
fn along_normal(triangle: &Triangle, w: [f64; 3]) -> Option<Ordering> {
    let [a, b, c] = triangle.vertices().map(|v| v.to_array().map(f64::from));
    let difference = |p: [f64; 3], q: [f64; 3]| -> [f64; 3] { std::array::from_fn(|i| p[i] - q[i]) };
    let (e, f) = (difference(b, a), difference(c, a));
    let (mut value, mut permanent) = (0.0, 0.0);
    for (i, w) in w.into_iter().enumerate() {
        let (j, k) = ((i + 1) % 3, (i + 2) % 3);
        let (plus, minus) = (e[j] * f[k], e[k] * f[j]);
        value += (plus - minus) * w;
        permanent += (plus.abs() + minus.abs()) * w.abs();
    }
    // Roundings on a path: three differences, two products, one subtraction, two sums.
    let certain = value.abs() > 9.0 * U * permanent;
    certain.then_some(if value > 0.0 { Ordering::Greater } else { Ordering::Less })
}

/// (b - a) x (c - a).
fn exact_normal(triangle: &Triangle) -> [Expansion; 3] {
    let [a, b, c] = triangle.vertices().map(|v| v.to_array());
    cross(&subtract(b, a), &subtract(c, a))
}

/// The sign of the cross product (b - a) x (d - c) of plane vectors, exactly.
pub(super) fn cross2d(a: [f32; 2], b: [f32; 2], c: [f32; 2], d: [f32; 2]) -> Ordering {
    let difference = |p: [f32; 2], q: [f32; 2]| [f64::from(p[0]) - f64::from(q[0]), f64::from(p[1]) - f64::from(q[1])];
    let (e, f) = (difference(b, a), difference(d, c));
    let (plus, minus) = (e[0] * f[1], e[1] * f[0]);
    let value = plus - minus;
    // Roundings on a path: two differences, one product, one subtraction; one more for the bound's own.
    if value.abs() > 5.0 * U * (plus.abs() + minus.abs()) {
        return if value > 0.0 { Ordering::Greater } else { Ordering::Less };
    }
    let exact = |p: [f32; 2], q: [f32; 2], i: usize| Expansion::difference(p[i], q[i]);
    (&(&exact(b, a, 0) * &exact(d, c, 1)) - &(&exact(b, a, 1) * &exact(d, c, 0))).sign()
}

/// A point without its coordinate `axis`: the other two in cyclic order.
pub(super) fn drop_axis(p: [f32; 3], axis: usize) -> [f32; 2] {
    [p[(axis + 1) % 3], p[(axis + 2) % 3]]
}

#[cfg(test)]
mod tests {
    use super::super::plane::{exactly_degenerate, orient2d};
    use super::*;
    use glam::Vec3;

    fn triangle(a: [f32; 3], b: [f32; 3], c: [f32; 3]) -> Triangle {
        Triangle { a: a.into(), b: b.into(), c: c.into() }
    }

    #[test]
    fn sides_of_a_plane_one_ulp_apart() {
        let t = triangle([0.1, 0.2, 0.3], [1.1, 0.2, 0.3], [0.1, 1.7, 0.3]);
        for z in [0.3f32, 0.3f32.next_up(), 0.3f32.next_down()] {
            assert_eq!(side(&t, [1e6, -1e6, z]), z.partial_cmp(&0.3).unwrap());
        }
        let flipped = Triangle { a: t.b, b: t.a, c: t.c };
        assert_eq!(side(&flipped, [0.0, 0.0, 1.0]), Ordering::Less);
    }

    #[test]
    fn tiny_and_huge_points() {
        for s in [1e-45f32, 1e-38, 1e38] {
            let t = triangle([0.0; 3], [s, 0.0, 0.0], [0.0, s, 0.0]);
            assert_eq!(side(&t, [0.0, 0.0, f32::from_bits(1)]), Ordering::Greater);
            assert_eq!(side(&t, [s, s, 0.0]), Ordering::Equal);
            assert!(!exactly_degenerate(&t));
        }
    }

    #[test]
    fn heading_is_the_side_of_where_it_leads_from_the_corner() {
        // From a corner at the origin a direction is the point that it leads to.
        let (b, c) = ([0.1, 0.7, -0.3], [1e-12, 3e5, 0.7]);
        let t = triangle([0.0; 3], b, c);
        let mut seen = [0; 3];
        for i in -300..300 {
            // About b + c and b - c, in and beside the plane.
            let mut d = std::array::from_fn(|k| if i % 2 == 0 { b[k] + c[k] } else { b[k] * 0.5 });
            d[0] = f32::from_bits((d[0].to_bits() as i32 + i / 4) as u32);
            assert_eq!(heading(&t, d), side(&t, d), "{d:?}");
            assert_eq!(heading(&t, d.map(|x| -x)), side(&t, d).reverse());
            seen[(heading(&t, d) as i8 + 1) as usize] += 1;
        }
        assert!(seen.iter().filter(|&&n| n > 10).count() >= 2, "{seen:?}");
        // Along an edge: neither. Moved off all axes, the same.
        assert_eq!(heading(&t, b), Ordering::Equal);
        assert_eq!(heading(&triangle([8.0; 3], [8.5, 9.0, 8.0], [9.0, 8.0, 8.0]), [1.0, -7.0, 0.0]), Ordering::Equal);
        assert_eq!(heading(&triangle([8.0; 3], [8.5, 9.0, 8.0], [9.0, 8.0, 8.0]), [1.0, -7.0, 1e-45]), Ordering::Less);
    }

    #[test]
    fn degenerate_only_where_exactly_so() {
        let p = Vec3::new(0.1, 0.3, 0.7);
        assert!(exactly_degenerate(&Triangle { a: p, b: p, c: Vec3::ZERO }));
        assert!(exactly_degenerate(&Triangle { a: p, b: 2.0 * p, c: 4.0 * p }));
        let off = Vec3::new(4.0 * p.x, 4.0 * p.y, (4.0 * p.z).next_up());
        assert!(!exactly_degenerate(&Triangle { a: p, b: 2.0 * p, c: off }));
    }

    #[test]
    fn orientation_of_nearly_collinear_points() {
        let (a, b) = ([0.5f32, 0.5], [12.0f32, 12.0]);
        assert_eq!(orient2d(a, b, [24.0, 24.0]), Ordering::Equal);
        assert_eq!(orient2d(a, b, [24.0, 24.0f32.next_up()]), Ordering::Greater);
        assert_eq!(orient2d(a, b, [24.0, 24.0f32.next_down()]), Ordering::Less);
    }
}
