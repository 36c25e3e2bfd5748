//! Third tier: big rationals, by another route: intersect the plane, then look where the point lies in the triangle.
//!
//! The infinitely small e of the perturbation is a number here, 2^-3000. That is small enough: edge determinants and
//! their coefficients are multiples of 2^-447 below 2^400, so no power of e can overtake a term before it.

use dashu_int::ops::BitTest;
use dashu_int::{IBig, UBig};
use dashu_ratio::Relaxed;

use super::{Corners, OracleRay};

type Point = [Relaxed; 3];

fn exact(p: &[f32; 3]) -> Point {
    p.map(|x| Relaxed::try_from(x).expect("finite"))
}

fn subtract(p: &Point, q: &Point) -> Point {
    std::array::from_fn(|i| &p[i] - &q[i])
}

fn dot(p: &Point, q: &Point) -> Relaxed {
    &p[0] * &q[0] + &p[1] * &q[1] + &p[2] * &q[2]
}

fn cross(p: &Point, q: &Point) -> Point {
    std::array::from_fn(|i| {
        let (j, k) = ((i + 1) % 3, (i + 2) % 3);
        &p[j] * &q[k] - &p[k] * &q[j]
    })
}

/// Barycentric weights of a point of the triangle's plane, by Cramer's rule without the axis `drop`.
fn weights(p: &Point, corners: &[Point; 3], drop: usize) -> [Relaxed; 3] {
    let (i, j) = ((drop + 1) % 3, (drop + 2) % 3);
    let (e, f, g) = (subtract(&corners[1], &corners[0]), subtract(&corners[2], &corners[0]), subtract(p, &corners[0]));
    let area = &e[i] * &f[j] - &e[j] * &f[i];
    let v = (&g[i] * &f[j] - &g[j] * &f[i]) / &area;
    let w = (&e[i] * &g[j] - &e[j] * &g[i]) / &area;
    [Relaxed::ONE - &v - &w, v, w]
}

/// The exact t where the ray meets the triangle, if the oracle's rules call it a crossing.
fn crossing(ray: &OracleRay, corners: &Corners) -> Option<Relaxed> {
    let (o, d) = (exact(&ray.o), exact(&ray.d));
    let corners: [Point; 3] = std::array::from_fn(|i| exact(&corners[i]));
    let normal = cross(&subtract(&corners[1], &corners[0]), &subtract(&corners[2], &corners[0]));
    let den = dot(&normal, &d);
    if den == Relaxed::ZERO {
        return None;
    }
    let drop = (0..3).find(|&i| normal[i] != Relaxed::ZERO)?;
    let num = dot(&normal, &subtract(&corners[0], &o));
    if num == Relaxed::ZERO {
        let w = weights(&o, &corners, drop);
        return w.iter().all(|x| *x >= Relaxed::ZERO).then_some(Relaxed::ZERO);
    }
    let e = Relaxed::from_parts(IBig::ONE, UBig::ONE << 3000);
    let moved = [&d[0] + &e, &d[1] + &e * &e, &d[2] + &e * &e * &e];
    let t = &num / dot(&normal, &moved);
    let point = std::array::from_fn(|i| &o[i] + &t * &moved[i]);
    let inside = weights(&point, &corners, drop).iter().all(|x| *x > Relaxed::ZERO);
    inside.then(|| num / den)
}

/// The nearest f32, ties to even, infinite beyond the range: by integer division, from first principles.
fn to_f32(x: &Relaxed) -> f32 {
    let (numerator, denominator) = (x.numerator().clone(), x.denominator().clone());
    let negative = numerator < IBig::ZERO;
    let magnitude = UBig::try_from(if negative { -numerator } else { numerator }).expect("not negative");
    if magnitude == UBig::ZERO {
        return 0.0;
    }
    // A first guess of the exponent, then the quantum of f32 there.
    let bits = |n: &UBig| n.bit_len() as i64;
    let mut exponent = bits(&magnitude) - bits(&denominator);
    let below = |e: i64| {
        if e >= 0 { magnitude < (&denominator << e as usize) } else { (&magnitude << (-e) as usize) < denominator }
    };
    if below(exponent) {
        exponent -= 1;
    }
    let quantum = (exponent - 23).max(-149);
    let (n, m) = if quantum >= 0 {
        (magnitude, denominator << quantum as usize)
    } else {
        (magnitude << (-quantum) as usize, denominator)
    };
    let (mut quotient, rest) = (&n / &m, &n % &m);
    let twice = rest << 1usize;
    if twice > m || (twice == m && &quotient % 2u8 == 1) {
        quotient += UBig::ONE;
    }
    let steps = u64::try_from(quotient).expect("at most 25 bits") as f64;
    let value = if quantum > 104 { f64::INFINITY } else { steps * 2f64.powi(quantum as i32) };
    let value = if value > f64::from(f32::MAX) { f32::INFINITY } else { value as f32 };
    if negative { -value } else { value }
}

/// The closest hit among the triangles by brute force: rounded t and face.
pub fn closest(ray: &OracleRay, triangles: &[(u32, Corners)], skip: &[u32]) -> Option<(f32, u32)> {
    if !ray.can_hit() {
        return None;
    }
    let mut best: Option<(Relaxed, f32, u32)> = None;
    for (face, corners) in triangles {
        if skip.contains(face) || !corners.iter().flatten().all(|x| x.is_finite()) {
            continue;
        }
        let Some(exact_t) = crossing(ray, corners) else { continue };
        let t = to_f32(&exact_t) + 0.0;
        let counts = t.is_finite() && ray.tmin <= t && t <= ray.tmax;
        let better = best.as_ref().is_none_or(|(b, _, f)| (&exact_t, face) < (b, f));
        if counts && better {
            best = Some((exact_t, t, *face));
        }
    }
    best.map(|(_, t, face)| (t, face))
}
