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
//! samples big rationals with a *number* for e (`rational.rs`, in tests), by another route altogether.

mod expansion;
mod interval;
mod number;
#[cfg(test)]
mod rational;

use std::cell::OnceCell;
use std::cmp::Ordering;

use expansion::Expansion;
use interval::Interval;
use number::{Crossing, Figure};
#[cfg(test)]
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

/// A mesh, with bounding spheres for a quick and safe "certainly missed": one a triangle, one a block of neighbours.
pub struct Oracle {
    corners: Vec<Corners>,
    faces: Vec<u32>,
    triangles: Spheres,
    blocks: Spheres,
}

/// Triangles a block.
const BLOCK: usize = 16;

/// Spheres, one coordinate after the other so that a loop over many is vectorised.
#[derive(Default)]
struct Spheres {
    center: [Vec<f64>; 3],
    radius2: Vec<f64>,
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

/// The line of a ray, ready for the spheres: the direction scaled to a largest component of 1.
struct FarLine {
    o: [f64; 3],
    d: [f64; 3],
    dd: f64,
}

impl FarLine {
    fn new(ray: &OracleRay) -> FarLine {
        let largest = ray.d.iter().fold(0.0f64, |m, x| m.max(f64::from(x.abs())));
        let d = ray.d.map(|x| f64::from(x) / largest);
        FarLine { o: ray.o.map(f64::from), d, dd: d.iter().map(|x| x * x).sum() }
    }
}

impl Spheres {
    /// Adds a sphere around points, somewhat larger than need be.
    fn push<'a>(&mut self, points: impl Iterator<Item = &'a [f32; 3]> + Clone) {
        let n = points.clone().count() as f64;
        let center: [f64; 3] = std::array::from_fn(|i| points.clone().map(|p| f64::from(p[i]) / n).sum());
        let distance2 = |p: &[f32; 3]| (0..3).map(|i| (f64::from(p[i]) - center[i]).powi(2)).sum::<f64>();
        let radius2 = points.map(distance2).fold(0.0, f64::max);
        for (list, c) in self.center.iter_mut().zip(center) {
            list.push(c);
        }
        self.radius2.push(radius2 * (1.0 + 1e-12) + 1e-300);
    }

    /// Calls `found` with the spheres of a range that the line may touch; never leaves out one that it does.
    ///
    /// `|d x (c - o)|^2 <= r^2 |d|^2`, with slack for the rounding of `c - o` over large distances. |d| is in 1..2,
    /// coordinates are below 2^130, so squares stay below 2^264.
    fn touched(&self, line: &FarLine, range: std::ops::Range<usize>, mut found: impl FnMut(usize)) {
        let [cx, cy, cz] = [0, 1, 2].map(|i: usize| &self.center[i][range.clone()]);
        let radius2 = &self.radius2[range.clone()];
        let FarLine { o, d, dd } = line;
        for start in (0..radius2.len()).step_by(BLOCK) {
            let end = (start + BLOCK).min(radius2.len());
            let mut flags = [false; BLOCK];
            for (k, flag) in flags[..end - start].iter_mut().enumerate() {
                let i = start + k;
                let (x, y, z) = (cx[i] - o[0], cy[i] - o[1], cz[i] - o[2]);
                let (a, b, c) = (d[1] * z - d[2] * y, d[2] * x - d[0] * z, d[0] * y - d[1] * x);
                // The cross product is off by at most a few 2^-53 of |c - o| |d|.
                let slack = (x * x + y * y + z * z) * dd * 1e-28;
                *flag = a * a + b * b + c * c <= 2.0 * (radius2[i] * dd * 1.01 + slack);
            }
            for (k, _) in flags.iter().enumerate().filter(|(_, flag)| **flag) {
                found(range.start + start + k);
            }
        }
    }
}

/// Ray and triangle in both tiers; the exact one is made only when it is asked.
struct Tiers<'a> {
    ray: &'a OracleRay,
    corners: &'a Corners,
    quick: Figure<Interval>,
    exact: OnceCell<Figure<Expansion>>,
}

impl<'a> Tiers<'a> {
    fn new(ray: &'a OracleRay, corners: &'a Corners) -> Tiers<'a> {
        Tiers { ray, corners, quick: Figure::new(ray, corners), exact: OnceCell::new() }
    }

    fn exact(&self) -> &Figure<Expansion> {
        self.exact.get_or_init(|| Figure::new(self.ray, self.corners))
    }

    fn den_sign(&self) -> Ordering {
        self.quick.den_sign().or_else(|| self.exact().den_sign()).expect(TELLS)
    }

    fn edge_sign(&self, i: usize) -> Ordering {
        self.quick.edge_sign(i).or_else(|| self.exact().edge_sign(i)).expect(TELLS)
    }

    /// Whether the line crosses the triangle; if so, whether the origin lies on the line of an edge.
    fn crosses(&self) -> Option<bool> {
        let signs = [self.edge_sign(0), self.edge_sign(1)];
        // Opposite signs decide, whatever the third: if that is zero the origin lies in the plane, on the wrong side of an edge.
        if signs[0] != signs[1] && !signs.contains(&Ordering::Equal) {
            return None;
        }
        let signs = [signs[0], signs[1], self.edge_sign(2)];
        if self.den_sign() == Ordering::Equal {
            return None;
        }
        if signs.contains(&Ordering::Equal) {
            return self.exact().origin_inside().expect(TELLS).then_some(true);
        }
        (signs[0] == signs[1] && signs[1] == signs[2]).then_some(false)
    }
}

/// Why a question to the second tier has an answer.
const TELLS: &str = "expansions always tell";

impl Oracle {
    /// An oracle over triangles with their face numbers; triangles that are not finite are left out.
    pub fn new(triangles: impl IntoIterator<Item = (u32, Corners)>) -> Oracle {
        let finite = |(_, corners): &(u32, Corners)| corners.iter().flatten().all(|x| x.is_finite());
        let mut list: Vec<(u32, Corners)> = triangles.into_iter().filter(finite).collect();
        sort_by_place(&mut list);
        let (mut triangles, mut blocks) = (Spheres::default(), Spheres::default());
        list.iter().for_each(|(_, corners)| triangles.push(corners.iter()));
        list.chunks(BLOCK).for_each(|block| blocks.push(block.iter().flat_map(|(_, corners)| corners)));
        let (faces, corners) = list.into_iter().unzip();
        Oracle { corners, faces, triangles, blocks }
    }

    /// Calls `found` with the numbers of the triangles that the ray's line may touch.
    fn near_line(&self, ray: &OracleRay, skip: &[u32], mut found: impl FnMut(usize)) {
        let line = FarLine::new(ray);
        self.blocks.touched(&line, 0..self.blocks.radius2.len(), |block| {
            let end = (BLOCK * (block + 1)).min(self.faces.len());
            self.triangles.touched(&line, BLOCK * block..end, |i| {
                if !skip.contains(&self.faces[i]) {
                    found(i);
                }
            });
        });
    }

    /// The closest hit among the triangles, leaving out `skip`.
    pub fn closest(&self, ray: &OracleRay, skip: &[u32], counts: &mut TierCounts) -> Option<Answer> {
        if !ray.can_hit() {
            return None;
        }
        let mut best: Option<Candidate> = None;
        self.near_line(ray, skip, |i| {
            let Some(c) = self.test(ray, i, counts) else { return };
            if best.is_none_or(|b| self.order(ray, &c, &b) == Ordering::Less) {
                best = Some(c);
            }
        });
        best.map(|c| self.answer(ray, &c))
    }

    /// All hits in order.
    pub fn all(&self, ray: &OracleRay, skip: &[u32], counts: &mut TierCounts) -> Vec<Answer> {
        if !ray.can_hit() {
            return vec![];
        }
        let mut found = Vec::new();
        self.near_line(ray, skip, |i| found.extend(self.test(ray, i, counts)));
        found.sort_by(|a, b| self.order(ray, a, b));
        found.iter().map(|c| self.answer(ray, c)).collect()
    }

    /// Tests one triangle: intervals first, expansions where they cannot tell.
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
        match tiers.exact.get() {
            None => counts.interval += 1,
            Some(_) => counts.expansion += 1,
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
        } else {
            self.exactly(ray, a).compare(&self.exactly(ray, b))
        };
        by_t.then(self.faces[a.index].cmp(&self.faces[b.index]))
    }

    fn answer(&self, ray: &OracleRay, c: &Candidate) -> Answer {
        let quick = Figure::<Interval>::new(ray, &self.corners[c.index]).crossing(c.on_edge);
        let exact = OnceCell::new();
        let exact = || exact.get_or_init(|| self.exactly(ray, c));
        let (u, v) = quick.barycentric().or_else(|| exact().barycentric()).expect(TELLS);
        let t_exact = quick.is_exactly(c.t).or_else(|| exact().is_exactly(c.t)).expect(TELLS);
        Answer { t: c.t, t_exact, face: self.faces[c.index], u, v }
    }
}

/// Orders triangles along a Morton curve, so that blocks of neighbours in the list are neighbours in space.
fn sort_by_place(list: &mut [(u32, Corners)]) {
    let (mut low, mut high) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for (_, corners) in list.iter() {
        for i in 0..3 {
            low[i] = low[i].min(corners[0][i]);
            high[i] = high[i].max(corners[0][i]);
        }
    }
    list.sort_by_cached_key(|(_, corners)| {
        let step = |i: usize| {
            let share = (f64::from(corners[0][i]) - f64::from(low[i])) / (f64::from(high[i]) - f64::from(low[i]));
            (share * 1023.0) as u32
        };
        let cell = [step(0), step(1), step(2)];
        (0..30).fold(0u32, |code, bit| code << 1 | cell[bit % 3] >> (9 - bit / 3) & 1)
    });
}

/// Keeps a crossing whose rounded t counts.
fn keep(ray: &OracleRay, c: Candidate) -> Option<Candidate> {
    let t = c.t + 0.0;
    (t.is_finite() && ray.tmin <= t && t <= ray.tmax).then_some(Candidate { t, ..c })
}

#[cfg(test)]
mod tests;
