//! Where secondary rays start: a point that is certainly on the right side of the surface.
//!
//! A hit point p lies on a surface only up to rounding. A ray that starts at the rounded p may start on the wrong side,
//! and leak; the usual cure, a shift by some epsilon, leaks where the epsilon is too small and loses contact where it is
//! too large. Instead (after Wächter and Binder, Ray Tracing Gems 2019, ch. 6, and pbrt, section 6.8, both of whom stop
//! before the proof):
//!
//! 1. p is the point of the *closed* triangle with the barycentrics of the hit, recomputed in f64 and clamped, so that
//!    p's error is that of f64.
//! 2. p is moved along the geometric normal n by its error bound. Per component, with v0 the first corner,
//!    `e = 2^-24 |v0| + 3 * 2^-24 extent + 2^-23 |p|` covers what a hit point in f32 may be off (the rounding of corner,
//!    edges and sum); the plane n.x = n.p moves by at most |n|.e, so the shift along n is |n|.e, and the rounding of the
//!    moved point to f32 (2^-24 |p| a component) is within the bound's last term.
//! 3. The result o' is *certified*: the exact orientation of o' against the triangle must be strictly that of the wanted
//!    side. If it is not, the shift is doubled (at least one ulp) and tried again. For spheres and planes the f64
//!    expression that intersection itself evaluates must have the wanted sign by more than its error bound.
//!
//! A ray that starts strictly outside a plane and leaves it (`heading` sees to that) cannot meet it again, so no self-hit is
//! possible. That nothing else lies between p
//! and o' is checked by tracing that segment, see `leave`.

use glam::{DVec3, Vec3};

use crate::geometry::Triangle;

/// 2^-24: half an ulp of f32, relative.
const U: f64 = 1.0 / 16_777_216.0;

/// Tries of [`step_off`]: doublings from one least f32 step over the whole range of f32.
const MOST_STEPS: u32 = 300;

/// The error bound of a hit point p on a triangle, a component (step 2 of the module's text).
#[inline]
pub(super) fn triangle_bound(triangle: &Triangle, p: DVec3) -> DVec3 {
    let [a, b, c] = triangle.vertices().map(|v| v.as_dvec3());
    let extent = a.max(b).max(c) - a.min(b).min(c);
    U * a.abs() + 3.0 * U * extent + 2.0 * U * p.abs()
}

/// The error bound of a point that f64 arithmetic found on a smooth surface and that is to be rounded to f32.
pub(super) fn point_bound(p: DVec3) -> DVec3 {
    2.0 * U * p.abs()
}

/// Moves p along the unit vector `along` by at least `times` its error bound and onward until `certified` agrees.
///
/// `None` if no f32 point will do (the surface lies at the end of f32's range, or `along` is not finite).
#[inline]
pub(super) fn step_off(
    p: DVec3,
    along: DVec3,
    bound: DVec3,
    times: f64,
    certified: impl Fn(Vec3) -> bool,
) -> Option<Vec3> {
    let mut shift = along.abs().dot(bound).max(f64::from(f32::from_bits(1))) * times;
    for _ in 0..MOST_STEPS {
        let o = away(p, p + along * shift);
        if !o.is_finite() {
            return None;
        }
        if certified(o) {
            return Some(o);
        }
        shift *= 2.0;
    }
    None
}

/// `q` rounded to f32, each component in the direction in which it was moved from `p`.
#[inline]
fn away(p: DVec3, q: DVec3) -> Vec3 {
    // Chosen without a branch: which way a number was rounded, nobody can foresee.
    let component = |p: f64, q: f64| {
        let r = q as f32;
        let below = (q > p) & (f64::from(r) < q);
        let above = (q < p) & (f64::from(r) > q);
        let outward = if below { r.next_up() } else { r.next_down() };
        if below | above { outward } else { r }
    };
    Vec3::new(component(p.x, q.x), component(p.y, q.y), component(p.z, q.z))
}

/// Barycentric weights (of b and c) of the point where the line through `origin` along `direction` meets the triangle,
/// in f64, clamped into the closed triangle. `hint` stands in where the line lies in the triangle's plane.
#[inline]
pub(super) fn barycentrics(triangle: &Triangle, origin: DVec3, direction: DVec3, hint: [f64; 2]) -> [f64; 2] {
    let [a, b, c] = triangle.vertices().map(|v| v.as_dvec3() - origin);
    let scale = a.abs().max(b.abs()).max(c.abs()).max_element();
    let (a, b, c, d) = (a / scale, b / scale, c / scale, direction / direction.abs().max_element());
    let weights = [d.dot(c.cross(b)), d.dot(a.cross(c)), d.dot(b.cross(a))];
    let sum = weights[0] + weights[1] + weights[2];
    let [u, v] = [weights[1] / sum, weights[2] / sum];
    // A line nearly in the plane: cancellation has eaten the digits, the hit's own weights are better.
    let wild = |x: f64, hint: f64| !x.is_finite() || (x - hint).abs() > 1e-3;
    if wild(u, hint[0]) || wild(v, hint[1]) { clamped(hint) } else { clamped([u, v]) }
}

/// Weights moved into the closed triangle.
fn clamped([u, v]: [f64; 2]) -> [f64; 2] {
    let (u, v) = (u.clamp(0.0, 1.0), v.clamp(0.0, 1.0));
    let sum = u + v;
    if sum > 1.0 { [u / sum, v / sum] } else { [u, v] }
}

/// The point with these weights.
pub(super) fn point_of(triangle: &Triangle, [u, v]: [f64; 2]) -> DVec3 {
    let [a, b, c] = triangle.vertices().map(|v| v.as_dvec3());
    a + u * (b - a) + v * (c - a)
}

/// The unit normal by the winding, in f64 (scaled first, so that no size of triangle underflows or overflows).
#[inline]
pub(super) fn normal_of(triangle: &Triangle) -> DVec3 {
    let [a, b, c] = triangle.vertices().map(|v| v.as_dvec3());
    let (e, f) = (b - a, c - a);
    let (e, f) = (e / e.abs().max_element(), f / f.abs().max_element());
    e.cross(f).normalize_or_zero()
}
