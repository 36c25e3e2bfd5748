//! The tiers against each other.

use super::*;

/// SplitMix64.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// A coordinate from a coarse grid, so that rays meet edges and vertices exactly, at a scale of 2^k.
    fn grid(&mut self, k: i32) -> f32 {
        ((self.next() % 9) as f32 - 4.0) * 2f32.powi(k)
    }

    /// Any finite f32.
    fn any(&mut self) -> f32 {
        loop {
            let x = f32::from_bits(self.next() as u32);
            if x.is_finite() {
                return x;
            }
        }
    }

    fn point(&mut self, mut coordinate: impl FnMut(&mut Self) -> f32) -> [f32; 3] {
        [coordinate(self), coordinate(self), coordinate(self)]
    }
}

/// The tiered oracle and the rationals agree on face and t.
fn agree(triangles: &[(u32, Corners)], ray: OracleRay) {
    let oracle = Oracle::new(triangles.iter().copied());
    let mut counts = TierCounts::default();
    let ours = oracle.closest(&ray, &[], &mut counts).map(|a| (a.t, a.face));
    assert_eq!(ours, closest_rational(&ray, triangles, &[]), "{triangles:?} {ray:?}");
}

#[test]
fn tiers_agree_on_grids() {
    let mut random = Random(1);
    for round in 0..3000 {
        let k = [0, -149 + 3, -60, 60, 120][round % 5];
        let triangles: Vec<_> = (0..4).map(|i| (i, [0; 3].map(|_| random.point(|r| r.grid(k))))).collect();
        let ray = OracleRay {
            o: random.point(|r| r.grid(k)),
            d: random.point(|r| r.grid(0)),
            tmin: f32::NEG_INFINITY,
            tmax: f32::INFINITY,
        };
        agree(&triangles, ray);
    }
}

#[test]
fn tiers_agree_on_any_bits() {
    let mut random = Random(2);
    for _ in 0..2000 {
        let triangles: Vec<_> = (0..4).map(|i| (i, [0; 3].map(|_| random.point(Random::any)))).collect();
        let ray =
            OracleRay { o: random.point(Random::any), d: random.point(Random::any), tmin: 0.0, tmax: f32::INFINITY };
        agree(&triangles, ray);
    }
}

#[test]
fn shared_edge_is_hit_once() {
    // The diagonal of a quad, and the ray that several tracers lose there.
    let quad = [
        (0, [[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0]]),
        (1, [[-1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]]),
    ];
    let oracle = Oracle::new(quad);
    let ray = OracleRay { o: [0.0, 0.0, 10.0], d: [0.0, 0.0, -1.0], tmin: 0.0, tmax: f32::INFINITY };
    assert_eq!(oracle.all(&ray, &[], &mut TierCounts::default()).len(), 1);
}

#[test]
fn origin_on_an_edge_is_a_hit_at_zero() {
    let triangle = [(7, [[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0]])];
    let oracle = Oracle::new(triangle);
    let ray = |o| OracleRay { o, d: [0.1, 0.2, 1.0], tmin: 0.0, tmax: 1.0 };
    let hit = oracle.closest(&ray([1.0, 0.0, 0.0]), &[], &mut TierCounts::default()).unwrap();
    assert_eq!((hit.t, hit.face, hit.u, hit.v), (0.0, 7, 0.5, 0.0));
    assert!(oracle.closest(&ray([3.0, 0.0, 0.0]), &[], &mut TierCounts::default()).is_none());
}
