//! A search for violations of the f64 bounds: rays aimed next to edges and vertices, at many sizes, distances and scales.

use super::crossing::Line;
use super::expansion::{Expansion, dot, exact, subtract};
use crate::geometry::{Ray, Triangle};

/// SplitMix64 (Steele, Lea and Flood 2014).
struct Random(u64);

impl Random {
    fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    fn below(&mut self, n: u64) -> i32 {
        (self.bits() % n) as i32
    }

    /// From -1 to 1 on each axis.
    fn vector(&mut self) -> [f64; 3] {
        [0; 3].map(|_| (self.bits() >> 11) as f64 / (1u64 << 52) as f64 - 1.0)
    }
}

/// A ray past an edge or a vertex, off it by 2^-30 to 2^-16; triangles of size 2^-14 to 1 at distance 2^-6 to 1, all times a scale.
fn aimed(random: &mut Random) -> (Ray, Triangle) {
    let (size, away) = (2f64.powi(-random.below(15)), 2f64.powi(-random.below(7)));
    let scale = [1.0, 1.0, 1e-30, 1e-12, 1e-3, 1e5, 1e15, 1e30][random.below(8) as usize];
    let (center, from, noise) = (random.vector(), random.vector(), random.vector());
    let far = [0.0, 1.0, 100.0][random.below(3) as usize];
    let corners = [0; 3].map(|_| {
        let p = random.vector();
        [0, 1, 2].map(|i| (scale * (far * center[i] + size * p[i])) as f32)
    });
    let origin = [0, 1, 2].map(|i| (scale * (far * center[i] + away * from[i])) as f32);
    let weight = [0.0, 0.5, 0.3][random.below(3) as usize];
    let off = scale * 2f64.powi(-16 - random.below(15));
    let [a, b, _] = corners.map(|p: [f32; 3]| p.map(f64::from));
    let direction = [0, 1, 2].map(|i| (a[i] + weight * (b[i] - a[i]) + off * noise[i] - f64::from(origin[i])) as f32);
    (Ray::new(origin, direction), corners.into())
}

#[test]
fn edge_functions_keep_their_f64_bound() {
    let mut random = Random(1);
    let (mut largest, mut doubts) = (0.0f64, 0);
    for _ in 0..350_000 {
        let (ray, triangle) = aimed(&mut random);
        let line = Line::new(&ray);
        let [a, b, c] = triangle.vertices().map(|v| v.to_array());
        for (p, q) in [(b, c), (c, a), (a, b)] {
            let (value, bound) = line.determinant(p, q);
            let off = &dot(&exact(ray.direction), &line.edge_cross(p, q)) - &Expansion::from(value);
            let off = off.estimate().abs();
            assert!(off <= bound, "{value} is off by {off}, bound {bound}: {ray:?} {triangle:?}");
            largest = largest.max(off / bound.max(f64::MIN_POSITIVE));
            doubts += u32::from(value.abs() <= bound);
        }
    }
    assert!(
        largest > 0.1 && doubts > 100,
        "largest error {largest} of the bound, {doubts} in doubt: the search is too tame"
    );
}

#[test]
fn depths_keep_their_interval() {
    let mut random = Random(2);
    let (mut largest, mut hits) = (0.0f64, 0);
    for _ in 0..200_000 {
        let (ray, triangle) = aimed(&mut random);
        let line = Line::new(&ray);
        let Some(crossing) = line.meet(&triangle).crossing else { continue };
        let [low, high] = crossing.depth;
        let [a, b, c] = triangle.vertices().map(|v| v.to_array());
        let normal = super::expansion::cross(&subtract(b, a), &subtract(c, a));
        let (num, den) = (dot(&normal, &subtract(a, ray.origin)), dot(&normal, &exact(ray.direction)));
        // num - t den has the sign of (exact t - t) den.
        let beyond = |t: f64| (&num - &den.scale(t)).estimate() / den.estimate();
        assert!(beyond(low) >= 0.0 && beyond(high) <= 0.0, "{low} {high} {ray:?} {triangle:?}");
        let (half, middle) = (0.5 * (high - low), 0.5 * (high + low));
        largest = largest.max(beyond(middle).abs() / half.max(f64::MIN_POSITIVE));
        hits += 1;
    }
    assert!(
        largest > 0.05 && hits > 50_000,
        "largest error {largest} of the bound, {hits} hits: the search is too tame"
    );
}
