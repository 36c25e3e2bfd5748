//! What a plane leaves of a triangle on either side, as boxes.
//!
//! Clipped boxes are conservative. Where an edge meets the plane is found in f64 and rounded outward by more than its
//! error, so for each point p of a triangle inside its primitive's box: p lies in the box of a part (in both if it is on
//! the plane). By induction every point of a triangle lies in some leaf's box, and a ray that meets the triangle there
//! comes to that leaf. Where a part's box would be empty no such point exists, and the part is left out.

use glam::Vec3A;

use super::primitive::Span;
use crate::geometry::{Aabb, Triangle};

/// A plane through space.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cut {
    pub axis: usize,
    pub plane: f32,
}

impl Cut {
    /// The boxes of the two parts of a triangle's part within `span`; empty where there is none.
    pub fn parts(self, span: Span, triangle: &Triangle) -> (Span, Span) {
        let Cut { axis, plane } = self;
        let corners = triangle.vertices().map(Vec3A::from);
        let (mut low, mut high) = (Span::EMPTY, Span::EMPTY);
        for (v, w) in [(0, 1), (1, 2), (2, 0)].map(|(i, j)| (corners[i], corners[j])) {
            if v[axis] <= plane {
                low = low.around(v, v);
            }
            if v[axis] >= plane {
                high = high.around(v, v);
            }
            if (v[axis] < plane && w[axis] > plane) || (v[axis] > plane && w[axis] < plane) {
                let Span { min, max } = self.crossing(v, w);
                low = low.around(min, max);
                high = high.around(min, max);
            }
        }
        low.max[axis] = low.max[axis].min(plane);
        high.min[axis] = high.min[axis].max(plane);
        (low.common(span), high.common(span))
    }

    /// A box around the point where the edge from v to w, whose ends lie on different sides, meets the plane.
    ///
    /// With t = (p - v) / (w - v) of the cut's axis, v + t (w - v) is off by less than 2^-48 (|v| + |w|): the differences
    /// and the quotient are off by 2^-51 at most relatively, and t is at most 1.
    fn crossing(self, v: Vec3A, w: Vec3A) -> Span {
        const ERROR: f64 = 1.0 / (1u64 << 48) as f64;
        let at = |v: Vec3A, axis: usize| f64::from(v[axis]);
        let from = at(v, self.axis);
        let t = (f64::from(self.plane) - from) / (at(w, self.axis) - from);
        let mut span = Span { min: v.min(w), max: v.max(w) };
        for axis in 0..3 {
            let (a, b) = (at(v, axis), at(w, axis));
            let (x, error) = (a + t * (b - a), ERROR * (a.abs() + b.abs()));
            span.min[axis] = span.min[axis].max(rounded_down(x - error));
            span.max[axis] = span.max[axis].min(-rounded_down(-(x + error)));
        }
        (span.min[self.axis], span.max[self.axis]) = (self.plane, self.plane);
        span
    }
}

/// What a plane leaves of a triangle's part within `part` on its low and on its high side, each held by a box within
/// `part`; `None` where nothing is. Every point of the triangle in `part` lies in one of the boxes, or in both.
pub fn cut_box(triangle: &Triangle, part: Aabb, axis: usize, plane: f32) -> [Option<Aabb>; 2] {
    let span = Span { min: part.min.into(), max: part.max.into() };
    let (low, high) = Cut { axis, plane }.parts(span, triangle);
    [low, high].map(|span| (!span.is_empty()).then(|| Aabb { min: span.min.into(), max: span.max.into() }))
}

/// The greatest f32 that is no greater than x.
fn rounded_down(x: f64) -> f32 {
    let near = x as f32;
    if f64::from(near) > x { near.next_down() } else { near }
}

#[cfg(test)]
mod tests {
    use super::super::primitive::Primitive;
    use super::*;
    use dashu_ratio::RBig;
    use glam::Vec3;
    use proptest::prelude::*;

    fn exact(x: f32) -> RBig {
        RBig::try_from(x).expect("finite")
    }

    /// The part of a convex polygon on one side of a plane, exactly.
    fn clipped(polygon: &[[RBig; 3]], axis: usize, plane: &RBig, above: bool) -> Vec<[RBig; 3]> {
        let inside = |p: &[RBig; 3]| if above { p[axis] >= *plane } else { p[axis] <= *plane };
        let mut out = Vec::new();
        for (i, p) in polygon.iter().enumerate() {
            let q = &polygon[(i + 1) % polygon.len()];
            if inside(p) {
                out.push(p.clone());
            }
            if inside(p) != inside(q) {
                let t = (plane - &p[axis]) / (&q[axis] - &p[axis]);
                out.push(std::array::from_fn(|k| &p[k] + &t * (&q[k] - &p[k])));
            }
        }
        out
    }

    fn holds(span: Span, p: &[RBig; 3]) -> bool {
        (0..3).all(|k| exact(span.min[k]) <= p[k] && p[k] <= exact(span.max[k]))
    }

    proptest! {
        /// A triangle cut again and again, one of the parts followed: each part's box holds every corner of the exact part, so the
        /// whole of it; and it is not much larger.
        #[test]
        fn boxes_hold_exact_parts(
            p in prop::array::uniform9(-1.0f32..1.0), offset in prop::array::uniform3(-1e3f32..1e3), flat in 0usize..4,
            scale in -130i32..=100, cuts in prop::collection::vec((0usize..3, 0.0f32..=1.0, any::<bool>()), 1..12),
        ) {
            let scale = 2f32.powi(scale);
            let at = |i: usize| {
                let v = Vec3::new(p[i], p[i + 1], p[i + 2]);
                let v = if flat < 3 { v.with_x(if flat == 0 { 0.25 } else { v.x }).with_z(v.z * 1e-7) } else { v };
                (Vec3::from_array(offset) + v) * scale
            };
            let triangle = Triangle { a: at(0), b: at(3), c: at(6) };
            let mut polygon: Vec<[RBig; 3]> = triangle.vertices().iter().map(|v| v.to_array().map(exact)).collect();
            let mut span = Primitive::new(0, &triangle).span();
            for (axis, place, above) in cuts {
                let plane = span.min[axis] + place * (span.max[axis] - span.min[axis]);
                if !(span.min[axis] < plane && plane < span.max[axis]) {
                    continue;
                }
                let (low, high) = Cut { axis, plane }.parts(span, &triangle);
                for (part, above) in [(low, false), (high, true)] {
                    for corner in clipped(&polygon, axis, &exact(plane), above) {
                        prop_assert!(holds(part, &corner), "{part:?} {corner:?}");
                    }
                }
                let next = if above { high } else { low };
                polygon = clipped(&polygon, axis, &exact(plane), above);
                if next.is_empty() {
                    prop_assert!(polygon.is_empty());
                    break;
                }
                prop_assert!(next.min.cmpge(span.min).all() && next.max.cmple(span.max).all());
                span = next;
            }
        }
    }

    #[test]
    fn a_diagonal_is_cut_small() {
        let triangle = Triangle { a: Vec3::ZERO, b: Vec3::ONE, c: Vec3::new(1.0, 1.0, 0.99) };
        let (low, high) = Cut { axis: 0, plane: 0.5 }.parts(Primitive::new(0, &triangle).span(), &triangle);
        for (part, min, max) in [(low, 0.0, 0.5), (high, 0.495, 1.0)] {
            assert!(part.min.cmpge(Vec3A::splat(min - 1e-6)).all(), "{part:?}");
            assert!(part.max.cmple(Vec3A::splat(max + 1e-6)).all(), "{part:?}");
        }
    }
}
