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
//! Tiers: interval arithmetic in f64 ([`interval`]); where that cannot tell, expansions of f64 ([`expansion`]); on
//! samples big rationals with a *number* for e ([`rational`]), by another route altogether.

mod expansion;
mod interval;
mod number;
mod rational;

use std::cmp::Ordering;

use expansion::Expansion;
use interval::Interval;
use number::crossing;
pub use rational::closest as closest_rational;

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
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TierCounts {
    /// Triangles decided by intervals.
    pub interval: u64,
    /// Triangles that needed expansions.
    pub expansion: u64,
}

/// A mesh with a bounding sphere a triangle, for a quick and safe "certainly missed".
pub struct Oracle {
    corners: Vec<Corners>,
    faces: Vec<u32>,
    center: [Vec<f64>; 3],
    radius2: Vec<f64>,
}

/// A crossing that counts, kept for ordering: number in the mesh, t, and the exact ratio where it was needed.
struct Candidate {
    index: usize,
    t: f32,
    t_low: f64,
    t_high: f64,
}

impl Oracle {
    /// An oracle over triangles with their face numbers; triangles that are not finite are left out.
    pub fn new(triangles: impl IntoIterator<Item = (u32, Corners)>) -> Oracle {
        let mut oracle = Oracle { corners: vec![], faces: vec![], center: Default::default(), radius2: vec![] };
        for (face, corners) in triangles {
            if corners.iter().flatten().all(|x| x.is_finite()) {
                oracle.push(face, corners);
            }
        }
        oracle
    }

    fn push(&mut self, face: u32, corners: Corners) {
        let mut center = [0.0f64; 3];
        for (i, c) in center.iter_mut().enumerate() {
            *c = (f64::from(corners[0][i]) + f64::from(corners[1][i]) + f64::from(corners[2][i])) / 3.0;
            self.center[i].push(*c);
        }
        let distance2 = |p: &[f32; 3]| (0..3).map(|i| (f64::from(p[i]) - center[i]).powi(2)).sum::<f64>();
        let radius2 = corners.iter().map(distance2).fold(0.0, f64::max);
        self.radius2.push(radius2 * (1.0 + 1e-12) + 1e-300);
        self.corners.push(corners);
        self.faces.push(face);
    }

    /// Triangles held.
    pub fn len(&self) -> usize {
        self.faces.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.faces.is_empty()
    }

    /// Numbers of the triangles that the ray's line may touch; never leaves out one that it does.
    ///
    /// `|d x (c - o)|^2 <= r^2 |d|^2`, with slack for the rounding of `c - o` over large distances. The direction is
    /// scaled so that nothing overflows: |d| in 1..2, coordinates below 2^130, squares below 2^264.
    fn near_line(&self, ray: &OracleRay, out: &mut Vec<u32>) {
        out.clear();
        let largest = ray.d.iter().fold(0.0f64, |m, x| m.max(f64::from(x.abs())));
        let d = ray.d.map(|x| f64::from(x) / largest);
        let dd = d.iter().map(|x| x * x).sum::<f64>();
        let [ox, oy, oz] = ray.o.map(f64::from);
        let [cx, cy, cz] = [&self.center[0][..], &self.center[1][..], &self.center[2][..]];
        const BLOCK: usize = 64;
        let n = self.faces.len();
        let mut start = 0;
        while start < n {
            let end = (start + BLOCK).min(n);
            let mut flags = [false; BLOCK];
            for (k, flag) in flags[..end - start].iter_mut().enumerate() {
                let i = start + k;
                let (x, y, z) = (cx[i] - ox, cy[i] - oy, cz[i] - oz);
                let (a, b, c) = (d[1] * z - d[2] * y, d[2] * x - d[0] * z, d[0] * y - d[1] * x);
                // The cross product is off by at most a few 2^-53 of |c - o| |d|.
                let slack = (x * x + y * y + z * z) * dd * 1e-28;
                *flag = a * a + b * b + c * c <= 2.0 * (self.radius2[i] * dd * 1.01 + slack);
            }
            out.extend((start..end).filter(|i| flags[i - start]).map(|i| i as u32));
            start = end;
        }
    }

    /// The closest hit among the triangles, leaving out `skip`.
    pub fn closest(&self, ray: &OracleRay, skip: &[u32], counts: &mut TierCounts) -> Option<Answer> {
        self.all(ray, skip, counts).into_iter().next()
    }

    /// Whether anything is hit, leaving out `skip`.
    pub fn any(&self, ray: &OracleRay, skip: &[u32], counts: &mut TierCounts) -> bool {
        self.closest(ray, skip, counts).is_some()
    }

    /// All hits in order.
    pub fn all(&self, ray: &OracleRay, skip: &[u32], counts: &mut TierCounts) -> Vec<Answer> {
        if !ray.can_hit() {
            return vec![];
        }
        let mut near = Vec::new();
        self.near_line(ray, &mut near);
        let mut found: Vec<Candidate> = near
            .iter()
            .filter(|&&i| !skip.contains(&self.faces[i as usize]))
            .filter_map(|&i| self.test(ray, i as usize, counts))
            .collect();
        found.sort_by(|a, b| self.order(ray, a, b));
        found.iter().map(|c| self.answer(ray, c)).collect()
    }

    /// Tests one triangle: intervals first, expansions where they cannot tell.
    fn test(&self, ray: &OracleRay, index: usize, counts: &mut TierCounts) -> Option<Candidate> {
        let corners = &self.corners[index];
        if let Some(decision) = crossing::<Interval>(ray, corners) {
            counts.interval += 1;
            let c = decision?;
            let (low, high) = c.t_bounds();
            if low as f32 == high as f32 {
                return keep(ray, index, low as f32, low, high);
            }
        }
        counts.expansion += 1;
        let c = crossing::<Expansion>(ray, corners).expect("expansions always tell")?;
        let t = c.t_rounded();
        let (low, high) = c.t_bounds();
        keep(ray, index, t, low, high)
    }

    /// By exact t, then by face.
    fn order(&self, ray: &OracleRay, a: &Candidate, b: &Candidate) -> Ordering {
        let by_t = if a.t_high < b.t_low {
            Ordering::Less
        } else if b.t_high < a.t_low {
            Ordering::Greater
        } else {
            let ratio = |c: &Candidate| {
                crossing::<Expansion>(ray, &self.corners[c.index]).flatten().expect("it was a crossing before")
            };
            ratio(a).compare(&ratio(b))
        };
        by_t.then(self.faces[a.index].cmp(&self.faces[b.index]))
    }

    fn answer(&self, ray: &OracleRay, c: &Candidate) -> Answer {
        let crossing = crossing::<Expansion>(ray, &self.corners[c.index]).flatten().expect("it was a crossing before");
        let (u, v) = crossing.barycentric();
        Answer { t: c.t, t_exact: crossing.is_exactly(c.t), face: self.faces[c.index], u, v }
    }
}

/// Keeps a crossing whose rounded t counts.
fn keep(ray: &OracleRay, index: usize, t: f32, t_low: f64, t_high: f64) -> Option<Candidate> {
    let t = t + 0.0;
    (t.is_finite() && ray.tmin <= t && t <= ray.tmax).then_some(Candidate { index, t, t_low, t_high })
}

#[cfg(test)]
mod tests;
