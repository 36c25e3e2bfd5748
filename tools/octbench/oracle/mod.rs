//! The exact oracle: which triangle a ray hits, by brute force over all triangles, in three independent tiers.
//!
//! It shares no line with the library. What it decides is written down in the library's design notes and repeated here:
//!
//! - A ray crosses a triangle when the three edge determinants `det(d, p - o, q - o)` have one sign. A determinant that
//!   is exactly zero takes the sign it has for the direction `d + (e, e^2, e^3)` with an infinitely small positive e.
//! - A ray whose direction lies in the triangle's plane misses.
//! - If the origin lies on the line of an edge, no e decides: a hit at t = 0 where the origin lies in the closed triangle.
//! - t is `n . (a - o) / n . d`, rounded once to f32 and then compared with the closed interval; a t that rounds to
//!   infinity is a miss. The closest hit is the least by exact t, then by face number.
//!
//! Tiers: f64 with a bound ([`bounded`]); where that cannot tell, expansions of f64 ([`expansion`]), or whole numbers where
//! these suffice ([`whole`]); on samples big rationals with a *number* for e (`rational.rs`, in tests), by another route
//! altogether. Before them, for every triangle, a quick "certainly missed" ([`far`]).

mod bounded;
mod expansion;
mod far;
mod number;
#[cfg(test)]
mod rational;
mod whole;

use std::cell::OnceCell;
use std::cmp::Ordering;

use bounded::Bounded;
use expansion::Expansion;
use far::Triangles;
use number::{Crossing, Figure};
#[cfg(test)]
pub use rational::closest as closest_rational;
use whole::{Scaled, Whole};

/// A ray as it stands in a ray file: origin, direction, tmin, tmax.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OracleRay {
    /// Origin.
    pub o: [f32; 3],
    /// Direction.
    pub d: [f32; 3],
    /// Least t.
    pub tmin: f32,
    /// Greatest t.
    pub tmax: f32,
}

impl OracleRay {
    /// Whether the ray can hit anything: finite origin and direction, a direction that is not zero, tmin <= tmax.
    pub fn can_hit(&self) -> bool {
        let finite = (0..3).all(|i| self.o[i].is_finite() && self.d[i].is_finite());
        finite && self.d != [0.0; 3] && self.tmin <= self.tmax
    }
}

/// Three corners.
pub type Corners = [[f32; 3]; 3];

/// The oracle's answer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Answer {
    /// Correctly rounded t.
    pub t: f32,
    /// Whether t is exactly that, without rounding.
    pub t_exact: bool,
    /// The face.
    pub face: u32,
    /// Weight of the second corner, to f64 accuracy.
    pub u: f64,
    /// Weight of the third corner, to f64 accuracy.
    pub v: f64,
}

/// How often each tier was needed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct TierCounts {
    /// Triangles decided in f64, after those that the line stays away from.
    pub quick: u64,
    /// Triangles that needed expansions or whole numbers.
    pub exact: u64,
}

/// A mesh.
pub struct Oracle {
    corners: Vec<Corners>,
    faces: Vec<u32>,
    /// The same triangles, for the quick test.
    quick: Triangles,
}

/// A crossing that counts, kept for ordering: number in the mesh and t, rounded and between bounds.
#[derive(Clone, Copy)]
struct Candidate {
    index: usize,
    on_edge: bool,
    t: f32,
    t_low: f64,
    t_high: f64,
}

/// Ray and triangle in both tiers; the exact one is made only when it is asked.
struct Tiers<'a> {
    ray: &'a OracleRay,
    corners: &'a Corners,
    quick: Figure<Bounded>,
    whole: OnceCell<Scaled>,
    exact: OnceCell<Figure<Expansion>>,
}

impl<'a> Tiers<'a> {
    fn new(ray: &'a OracleRay, corners: &'a Corners) -> Tiers<'a> {
        Tiers { ray, corners, quick: Figure::new(ray, corners), whole: OnceCell::new(), exact: OnceCell::new() }
    }

    fn exact(&self) -> &Figure<Expansion> {
        self.exact.get_or_init(|| Figure::new(self.ray, self.corners))
    }

    fn scaled(&self) -> &Scaled {
        self.whole.get_or_init(|| Scaled::new(self.ray, self.corners))
    }

    fn whole(&self) -> &Figure<Whole> {
        &self.scaled().figure
    }

    fn den_sign(&self) -> Ordering {
        let exact = || self.whole().den_sign().or_else(|| self.exact().den_sign());
        self.quick.den_sign().or_else(exact).expect(TELLS)
    }

    /// The sign that f64 could not tell.
    fn edge_sign_exactly(&self, i: usize) -> Ordering {
        self.whole().edge_sign(i).or_else(|| self.exact().edge_sign(i)).expect(TELLS)
    }

    fn origin_inside(&self) -> bool {
        self.whole().origin_inside().or_else(|| self.exact().origin_inside()).expect(TELLS)
    }

    /// Whether f64 did not suffice.
    fn went_on(&self) -> bool {
        self.whole.get().is_some() || self.exact.get().is_some()
    }

    /// Whether the line crosses the triangle; if so, whether the origin lies on the line of an edge.
    ///
    /// Opposite signs decide, whatever the third: if that is zero the origin lies in the plane, on the wrong side of an edge.
    fn crosses(&self) -> Option<bool> {
        let quick = [0, 1, 2].map(|i| self.quick.edge_sign(i));
        if quick.contains(&Some(Ordering::Less)) && quick.contains(&Some(Ordering::Greater)) {
            return None;
        }
        if self.den_sign() == Ordering::Equal {
            return None;
        }
        let known = quick.into_iter().flatten().find(|sign| sign.is_ne());
        let mut signs = [known.unwrap_or(Ordering::Equal); 3];
        for i in 0..3 {
            signs[i] = quick[i].unwrap_or_else(|| self.edge_sign_exactly(i));
            let against = signs[..i].iter().chain(&known).any(|other| *other == signs[i].reverse());
            if signs[i].is_ne() && against {
                return None;
            }
        }
        if signs.contains(&Ordering::Equal) {
            return self.origin_inside().then_some(true);
        }
        Some(false)
    }
}

/// Why a question to the second tier has an answer.
const TELLS: &str = "expansions always tell";

impl Oracle {
    /// An oracle over triangles with their face numbers; triangles that are not finite are left out.
    pub fn new(triangles: impl IntoIterator<Item = (u32, Corners)>) -> Oracle {
        let finite = |(_, corners): &(u32, Corners)| corners.iter().flatten().all(|x| x.is_finite());
        let (faces, corners): (Vec<u32>, Vec<Corners>) = triangles.into_iter().filter(finite).unzip();
        let mut quick = Triangles::default();
        corners.iter().for_each(|corners| quick.push(corners));
        Oracle { corners, faces, quick }
    }

    /// For each ray the triangles that its line may cross, by their place in the oracle's list.
    pub fn near(&self, rays: &[OracleRay]) -> Vec<Vec<u32>> {
        self.quick.perhaps(rays)
    }

    /// The closest hit among the triangles, leaving out `skip`.
    pub fn closest(&self, ray: &OracleRay, skip: &[u32], counts: &mut TierCounts) -> Option<Answer> {
        self.closest_of(&self.near(std::slice::from_ref(ray))[0], ray, skip, counts)
    }

    /// All hits in order.
    pub fn all(&self, ray: &OracleRay, skip: &[u32], counts: &mut TierCounts) -> Vec<Answer> {
        self.all_of(&self.near(std::slice::from_ref(ray))[0], ray, skip, counts)
    }

    /// The closest hit, given what [`Oracle::near`] says of the ray.
    pub fn closest_of(&self, near: &[u32], ray: &OracleRay, skip: &[u32], counts: &mut TierCounts) -> Option<Answer> {
        let mut best: Option<Candidate> = None;
        for c in self.crossings(near, ray, skip, counts) {
            if best.is_none_or(|b| self.order(ray, &c, &b) == Ordering::Less) {
                best = Some(c);
            }
        }
        best.map(|c| self.answer(ray, &c))
    }

    /// All hits in order, given what [`Oracle::near`] says of the ray.
    pub fn all_of(&self, near: &[u32], ray: &OracleRay, skip: &[u32], counts: &mut TierCounts) -> Vec<Answer> {
        let mut found: Vec<Candidate> = self.crossings(near, ray, skip, counts).collect();
        found.sort_by(|a, b| self.order(ray, a, b));
        found.iter().map(|c| self.answer(ray, c)).collect()
    }

    /// The crossings that count, in no order.
    fn crossings(
        &self,
        near: &[u32],
        ray: &OracleRay,
        skip: &[u32],
        counts: &mut TierCounts,
    ) -> impl Iterator<Item = Candidate> {
        let near = if ray.can_hit() { near } else { &[] };
        let wanted = near.iter().map(|&i| i as usize).filter(|&i| !skip.contains(&self.faces[i]));
        wanted.filter_map(|i| self.test(ray, i, counts))
    }

    /// Tests one triangle: f64 first, expansions where it cannot tell.
    fn test(&self, ray: &OracleRay, index: usize, counts: &mut TierCounts) -> Option<Candidate> {
        let tiers = Tiers::new(ray, &self.corners[index]);
        let crosses = tiers.crosses();
        let candidate = crosses.and_then(|on_edge| {
            let (low, high) = tiers.quick.crossing(on_edge).t_bounds();
            if low as f32 == high as f32 {
                return keep(ray, Candidate { index, on_edge, t: low as f32, t_low: low, t_high: high });
            }
            let crossing = tiers.exact().crossing(on_edge);
            let (t_low, t_high) = crossing.t_bounds();
            keep(ray, Candidate { index, on_edge, t: crossing.t_rounded(), t_low, t_high })
        });
        match tiers.went_on() {
            false => counts.quick += 1,
            true => counts.exact += 1,
        }
        candidate
    }

    fn exactly(&self, ray: &OracleRay, c: &Candidate) -> Crossing<Expansion> {
        Figure::new(ray, &self.corners[c.index]).crossing(c.on_edge)
    }

    /// By exact t, then by face.
    fn order(&self, ray: &OracleRay, a: &Candidate, b: &Candidate) -> Ordering {
        let by_t = if a.t_high < b.t_low {
            Ordering::Less
        } else if b.t_high < a.t_low {
            Ordering::Greater
        } else if self.corners[a.index] == self.corners[b.index] {
            Ordering::Equal
        } else {
            self.exactly(ray, a).compare(&self.exactly(ray, b))
        };
        by_t.then(self.faces[a.index].cmp(&self.faces[b.index]))
    }

    fn answer(&self, ray: &OracleRay, c: &Candidate) -> Answer {
        let tiers = Tiers::new(ray, &self.corners[c.index]);
        let quick = tiers.quick.crossing(c.on_edge);
        let whole = OnceCell::new();
        let whole = || whole.get_or_init(|| tiers.whole().crossing(c.on_edge));
        let exact = OnceCell::new();
        let exact = || exact.get_or_init(|| tiers.exact().crossing(c.on_edge));
        let weights = quick.barycentric().or_else(|| whole().barycentric()).or_else(|| exact().barycentric());
        let (u, v) = weights.expect(TELLS);
        let t_exact = quick.is_exactly(c.t).or_else(|| tiers.scaled().is_exactly(whole(), c.t));
        let t_exact = t_exact.or_else(|| exact().is_exactly(c.t)).expect(TELLS);
        Answer { t: c.t, t_exact, face: self.faces[c.index], u, v }
    }
}

/// Keeps a crossing whose rounded t counts.
fn keep(ray: &OracleRay, c: Candidate) -> Option<Candidate> {
    let t = c.t + 0.0;
    (t.is_finite() && ray.tmin <= t && t <= ray.tmax).then_some(Candidate { t, ..c })
}

#[cfg(test)]
mod tests;
