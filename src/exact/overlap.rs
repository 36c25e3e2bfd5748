//! Whether a triangle touches a box, exactly: the separating axis test with exact signs.
//!
//! Two convex polytopes are disjoint iff one of thirteen axes separates them (Akenine-Möller 2001): the three of the box, the
//! triangle's normal, and the nine cross products of box and triangle edges. Each comparison is the sign of a small
//! determinant of f32 differences and is decided exactly; touching counts.

use std::cmp::Ordering;

use super::predicates::{cross2d, drop_axis, side};
use crate::geometry::{Aabb, Triangle};

/// Whether the closed triangle and the closed box share a point, exactly. Finite coordinates; an empty box touches nothing.
pub fn touches_box(triangle: &Triangle, bounds: Aabb) -> bool {
    if bounds.is_empty() || !Aabb::from(triangle).touches(bounds) {
        return false;
    }
    let inside = |p: glam::Vec3| bounds.min.cmple(p).all() && p.cmple(bounds.max).all();
    if triangle.vertices().into_iter().any(inside) {
        return true;
    }
    !separated_by_plane(triangle, bounds) && (0..3).all(|axis| !separated_along(triangle, bounds, axis))
}

/// Whether all corners of the box lie strictly on one side of the triangle's plane.
fn separated_by_plane(triangle: &Triangle, bounds: Aabb) -> bool {
    let ends = [bounds.min.to_array(), bounds.max.to_array()];
    let corner = |i: usize| [ends[i >> 2][0], ends[i >> 1 & 1][1], ends[i & 1][2]];
    let first = side(triangle, corner(0));
    first != Ordering::Equal && (1..8).all(|i| side(triangle, corner(i)) == first)
}

/// Whether one of the axes (box axis x triangle edge) separates: seen along `axis`, the triangle lies between the line of
/// an edge and its parallel through the third corner; the rectangle must lie strictly outside that strip.
fn separated_along(triangle: &Triangle, bounds: Aabb, axis: usize) -> bool {
    let v = triangle.vertices().map(|p| drop_axis(p.to_array(), axis));
    let (lo, hi) = (drop_axis(bounds.min.to_array(), axis), drop_axis(bounds.max.to_array(), axis));
    let corners = [lo, [hi[0], lo[1]], hi, [lo[0], hi[1]]];
    (0..3).any(|i| {
        let (p, q, r) = (v[i], v[(i + 1) % 3], v[(i + 2) % 3]);
        let all = |from: [f32; 2], want: Ordering| corners.iter().all(|&c| cross2d(p, q, from, c) == want);
        match cross2d(p, q, p, r) {
            Ordering::Less => all(p, Ordering::Greater) || all(r, Ordering::Less),
            _ => all(p, Ordering::Less) || all(r, Ordering::Greater),
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    const UNIT: Aabb = Aabb { min: Vec3::ZERO, max: Vec3::ONE };

    fn touches(a: [f32; 3], b: [f32; 3], c: [f32; 3]) -> bool {
        let t = [a, b, c].map(Vec3::from);
        let all: Vec<bool> = [[0, 1, 2], [1, 2, 0], [2, 1, 0]]
            .iter()
            .map(|o| touches_box(&Triangle { a: t[o[0]], b: t[o[1]], c: t[o[2]] }, UNIT))
            .collect();
        assert!(all.iter().all(|&x| x == all[0]), "depends on the order of corners");
        all[0]
    }

    #[test]
    fn corner_cut_exactly_and_one_ulp_off() {
        // The plane x + y + z = 3 touches the box's corner (1, 1, 1) and nothing else.
        let at = |s: f32| touches([s, 0.0, 0.0], [0.0, s, 0.0], [0.0, 0.0, s]);
        assert!(at(3.0) && at(3.0f32.next_down()) && !at(3.0f32.next_up()));
    }

    #[test]
    fn edge_axes_decide() {
        // Seen along z, the line x + y = 2 passes through (1, 1); far corners keep plane and box axes from deciding.
        let at = |s: f32| touches([s, 0.0, -9.0], [0.0, s, 9.0], [9.0, 9.0, 0.3]);
        assert!(at(2.0) && at(2.0f32.next_down()) && !at(2.0f32.next_up()));
    }

    #[test]
    fn through_without_a_corner_inside() {
        assert!(touches([-9.0, 0.5, 0.5], [9.0, 0.4, 0.5], [0.5, 9.0, 0.5]));
        assert!(touches([-9.0, -9.0, 1.0], [9.0, -9.0, 1.0], [0.0, 20.0, 1.0]));
        assert!(!touches([-9.0, -9.0, 1.0f32.next_up()], [9.0, -9.0, 1.0f32.next_up()], [0.0, 20.0, 1.5]));
        assert!(!touches_box(&Triangle { a: Vec3::ZERO, b: Vec3::X, c: Vec3::Y }, Aabb::EMPTY));
    }
}
