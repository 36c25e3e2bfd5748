//! The exact ray-triangle decision against an oracle in whole numbers that shares nothing with it.
//!
//! Every finite f32 is a whole multiple of 2^-149. Taken as such whole numbers, all determinants are whole numbers, and t, u, v,
//! being quotients of equal degree, do not notice the scaling.

#[path = "trace_common/random.rs"]
mod random;

use std::cmp::Ordering;

use dashu_int::IBig;
use octrace::exact::{Depths, Lanes, Line, Shear};
use octrace::geometry::{Aabb, Ray, Triangle};
use random::Random;

/// x * 2^149.
fn whole(x: f32) -> IBig {
    let bits = x.to_bits();
    let (exponent, fraction) = ((bits >> 23 & 0xff) as usize, bits & 0x7f_ffff);
    let magnitude = match exponent {
        0 => IBig::from(fraction),
        255 => IBig::from(1) << (128 + 149), // where rounding puts infinity
        _ => IBig::from(fraction | 0x80_0000) << (exponent - 1),
    };
    if x.is_sign_negative() { -magnitude } else { magnitude }
}

type V = [IBig; 3];

fn minus(a: &V, b: &V) -> V {
    std::array::from_fn(|i| &a[i] - &b[i])
}

fn cross(a: &V, b: &V) -> V {
    [&a[1] * &b[2] - &a[2] * &b[1], &a[2] * &b[0] - &a[0] * &b[2], &a[0] * &b[1] - &a[1] * &b[0]]
}

fn dot(a: &V, b: &V) -> IBig {
    &a[0] * &b[0] + &a[1] * &b[1] + &a[2] * &b[2]
}

/// t, u and v as numerators over one positive denominator.
struct Exact {
    t: IBig,
    u: IBig,
    v: IBig,
    den: IBig,
}

fn oracle(ray: &Ray, corners: [[f32; 3]; 3]) -> Option<Exact> {
    let zero = IBig::from(0);
    let (o, d) = (ray.origin.map(whole), ray.direction.map(whole));
    let p = corners.map(|p| minus(&p.map(whole), &o));
    let normal = cross(&minus(&p[1], &p[0]), &minus(&p[2], &p[0]));
    let den = dot(&normal, &d);
    if den == zero {
        return None;
    }
    let edges = [0, 1, 2].map(|k| cross(&p[(k + 1) % 3], &p[(k + 2) % 3]));
    let weights = edges.each_ref().map(|edge| dot(edge, &d));
    let positive = den > zero;
    let on_line: Vec<usize> = (0..3).filter(|&k| edges[k].iter().all(|x| *x == zero)).collect();
    let hit = if on_line.is_empty() {
        // The perturbed weight as a polynomial in an infinitely small e: the first coefficient that is not zero decides.
        (0..3).all(|k| {
            let first = std::iter::once(&weights[k]).chain(&edges[k]).find(|x| **x != zero).unwrap();
            (*first > zero) == positive
        })
    } else {
        // The origin is in the closed triangle iff its own weights there all have one sign.
        weights.iter().all(|w| *w == zero || (*w > zero) == positive)
    };
    let sign = IBig::from(if positive { 1 } else { -1 });
    let [_, u, v] = weights;
    hit.then(|| Exact { t: dot(&normal, &p[0]) * &sign, u: u * &sign, v: v * &sign, den: den * &sign })
}

/// Whether `x` is the f32 nearest to num / den, ties to even.
fn is_nearest(x: f32, num: &IBig, den: &IBig) -> bool {
    let twice = (num * IBig::from(2)) << 149;
    let side = |neighbour: f32| twice.cmp(&((whole(x) + whole(neighbour)) * den));
    let even = x.to_bits() & 1 == 0;
    let below = x == f32::NEG_INFINITY
        || matches!((side(x.next_down()), even), (Ordering::Greater, _) | (Ordering::Equal, true));
    let above =
        x == f32::INFINITY || matches!((side(x.next_up()), even), (Ordering::Less, _) | (Ordering::Equal, true));
    below && above
}

/// A coordinate of a nasty kind.
fn coordinate(random: &mut Random, scale: f32) -> f32 {
    match random.below(8) {
        0 => 0.0,
        1 => random.pick(&[-1.0, 1.0, 0.5, -0.25]) * scale,
        2 => ((random.below(17) as f32) - 8.0) * scale,
        3 => (random.pick(&[1.0f32, -1.0, 0.5]) * scale).next_up(),
        4 => random.pick(&[1e-45, -1e-45, 1e-40, 1e-38]),
        _ => random.unit() * scale,
    }
}

fn case(random: &mut Random) -> (Ray, [[f32; 3]; 3]) {
    let scale = random.pick(&[1.0, 1.0, 1.0, 1e-38, 1e-20, 1e6, 1e20, 1.5e37, 1e-44]);
    let mut p = [0; 3].map(|_| [0; 3].map(|_| coordinate(random, scale)));
    if random.below(8) == 0 {
        p[2] = p[0].map(|x| if random.below(2) == 0 { x.next_up() } else { x });
    }
    let length = random.pick(&[1.0, 1.0, 1e-30, 1e30]);
    let d = [0; 3].map(|_| coordinate(random, length));
    let k = random.pick(&[0.5f32, 1.0, 2.0, 0.0, -1.0]);
    // Mostly aimed: a corner, the middle of an edge, a point inside, moved back along the direction.
    let at: [f32; 3] = match random.below(5) {
        0 => p[0],
        1 => std::array::from_fn(|i| p[1][i] / 2.0 + p[2][i] / 2.0),
        2 => std::array::from_fn(|i| p[0][i] / 2.0 + p[1][i] / 4.0 + p[2][i] / 4.0),
        3 => std::array::from_fn(|i| 2.0 * p[0][i] - p[1][i]),
        _ => [0; 3].map(|_| coordinate(random, scale)),
    };
    let o = std::array::from_fn(|i| (at[i] - k * d[i] * scale).clamp(-f32::MAX, f32::MAX));
    let d = if random.below(3) == 0 { std::array::from_fn(|i| at[i] - o[i]) } else { d };
    (Ray::new(o, d).between(f32::NEG_INFINITY, f32::INFINITY), p)
}

fn triangle(p: [[f32; 3]; 3], order: [usize; 3]) -> Triangle {
    Triangle { a: p[order[0]].into(), b: p[order[1]].into(), c: p[order[2]].into() }
}

#[test]
fn decisions_and_values_are_exact() {
    let mut random = Random(1);
    let (mut hits, mut expanded) = (0, 0);
    for _ in 0..100_000 {
        let (ray, p) = case(&mut random);
        if !ray.is_valid() || p.iter().flatten().any(|x| !x.is_finite()) {
            continue;
        }
        let line = Line::new(&ray);
        let decision = line.meet(&triangle(p, [0, 1, 2]));
        let expected = oracle(&ray, p);
        expanded += usize::from(decision.exact);
        assert_eq!(decision.crossing.is_some(), expected.is_some(), "{ray:?} {p:?}");
        for order in [[1, 2, 0], [2, 0, 1], [0, 2, 1], [2, 1, 0]] {
            assert_eq!(
                line.meet(&triangle(p, order)).crossing.is_some(),
                expected.is_some(),
                "{ray:?} {p:?} {order:?}"
            );
        }
        let (Some(crossing), Some(Exact { t, u, v, den })) = (decision.crossing, expected) else { continue };
        hits += 1;
        let [low, high] = crossing.depth;
        assert!(low <= high);
        match crossing.t_within(&line) {
            Some(rounded) => assert!(is_nearest(rounded, &t, &den), "t {rounded} {ray:?} {p:?}"),
            None => {
                assert!(is_nearest(f32::INFINITY, &t, &den) || is_nearest(f32::NEG_INFINITY, &t, &den), "{ray:?} {p:?}")
            }
        }
        let [cu, cv] = crossing.uv(&line);
        assert!(is_nearest(cu, &u, &den) && is_nearest(cv, &v, &den), "{cu} {cv} {ray:?} {p:?}");
        assert!(cu.is_sign_positive() && cv.is_sign_positive());
    }
    assert!(hits > 10_000 && expanded > 5_000, "{hits} hits, {expanded} in expansions: the cases test little");
}

#[test]
fn order_along_the_ray_is_exact() {
    let mut random = Random(2);
    let mut close = 0;
    for _ in 0..60_000 {
        let (ray, p) = case(&mut random);
        let mut q = p;
        for _ in 0..random.below(3) {
            let (k, i) = (random.below(3), random.below(3));
            q[k][i] = if random.below(2) == 0 { q[k][i].next_up() } else { q[k][i].next_down() };
        }
        q.rotate_left(random.below(3));
        if !ray.is_valid() || p.iter().chain(&q).flatten().any(|x| !x.is_finite()) {
            continue;
        }
        let line = Line::new(&ray);
        let [a, b] = [p, q].map(|p| line.meet(&triangle(p, [0, 1, 2])).crossing);
        let (Some(a), Some(b), Some(x), Some(y)) = (a, b, oracle(&ray, p), oracle(&ray, q)) else { continue };
        close += usize::from(a.depth[1] >= b.depth[0] && b.depth[1] >= a.depth[0]);
        let expected = (&x.t * &y.den).cmp(&(&y.t * &x.den));
        assert_eq!(a.cmp(&b, &line), expected, "{ray:?} {p:?} {q:?}");
        assert_eq!(b.cmp(&a, &line), expected.reverse());
    }
    assert!(close > 3_000, "{close} pairs needed the exact order");
}

/// The bound of the f32 filter, searched with 1.1 million aimed lanes: one that it accepts or rejects is never decided otherwise
/// exactly.
#[test]
fn the_filter_is_never_wrong() {
    let mut random = Random(3);
    let (mut accepted, mut rejected, mut doubted, mut narrow) = (0u32, 0u32, 0u32, 0u32);
    for _ in 0..70_000 {
        let size = 2f32.powi(-(random.below(15) as i32));
        let away = 2f32.powi(-(random.below(7) as i32));
        let scale = random.pick(&[1.0, 1.0, 1e-6, 1e9, 1e15]);
        let centre = random.vector();
        let vertices: [[f32; 3]; 16] = [0; 16].map(|_| {
            let p = random.vector();
            std::array::from_fn(|i| scale * (centre[i] + size * p[i]))
        });
        // All triangles share the edge 0-1, in any place and direction.
        let triangles = [0; 16].map(|_| {
            let mut corners = [0, 1, 2 + random.below(14) as u8];
            corners.rotate_left(random.below(3));
            if random.below(2) == 0 {
                corners.swap(0, 1);
            }
            corners
        });
        let corners = [0, 1, 2].map(|k| triangles.map(|t| t[k]));
        let from = random.vector();
        let origin: [f32; 3] = std::array::from_fn(|i| scale * (centre[i] + away * from[i]));
        // Toward a point next to that edge or its end, off it by 2^-30 to 2^-16.
        let [a, b] = [vertices[0], vertices[1]];
        let off = scale * 2f32.powi(-16 - random.below(15) as i32);
        let weight = random.pick(&[0.0, 0.5, 0.3]);
        let noise = random.vector();
        let direction: [f32; 3] = std::array::from_fn(|i| a[i] + weight * (b[i] - a[i]) + off * noise[i] - origin[i]);
        let ray = Ray::new(origin, direction);
        let shear = Shear::new(&ray, Aabb::around(vertices.map(Into::into)));
        let axes = shear.axes.map(|axis| vertices.map(|p| p[axis]));
        let (range, mut depths) = ([f32::NEG_INFINITY, f32::INFINITY], Depths::BLANK);
        let Lanes { accept, doubt } = shear.classify([&axes[0], &axes[1], &axes[2]], &corners, 16, range, &mut depths);
        let line = Line::new(&ray);
        for j in 0..16 {
            let p = corners.map(|c| vertices[usize::from(c[j])]);
            let crossing = line.meet(&triangle(p, [0, 1, 2])).crossing;
            let hit = crossing.is_some();
            if let (Some(crossing), true) = (crossing, accept >> j & 1 != 0) {
                let (lo, hi) = (f64::from(depths.lo[j]), f64::from(depths.hi[j]));
                assert!(lo <= crossing.depth[1] && crossing.depth[0] <= hi, "{ray:?} {p:?}");
                narrow += u32::from(hi - lo < 1e-3 * (lo.abs() + hi.abs()));
            }
            if doubt >> j & 1 != 0 {
                doubted += 1;
            } else {
                assert_eq!(accept >> j & 1 != 0, hit, "{ray:?} {p:?}");
                if hit { accepted += 1 } else { rejected += 1 }
            }
        }
    }
    assert!(accepted > 20_000 && rejected > 100_000 && doubted > 10_000, "{accepted} {rejected} {doubted}");
    assert!(narrow > accepted / 2, "{narrow} of {accepted}");
}
