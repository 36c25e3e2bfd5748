//! A quick and safe "certainly missed" for every triangle, in f64, many at once: its bounding sphere against the ray's line, then
//! the signs of its edge determinants.

use pulp::{Arch, Simd, WithSimd};

use super::{Corners, OracleRay};

/// Triangles and their bounding spheres, one coordinate after the other so that a loop over many is vectorised.
#[derive(Default)]
pub struct Triangles {
    center: [Vec<f64>; 3],
    /// Squared radius, somewhat larger than need be.
    radius2: Vec<f64>,
    /// Coordinate i of corner k is number 3 k + i.
    corners: [Vec<f64>; 9],
}

/// Triangles looked at together.
const BLOCK: usize = 64;

/// The line of a ray: its origin, and its direction scaled to a largest component of 1.
struct Line {
    o: [f64; 3],
    d: [f64; 3],
}

impl Triangles {
    /// Adds a triangle.
    pub fn push(&mut self, corners: &Corners) {
        let center: [f64; 3] = std::array::from_fn(|i| corners.iter().map(|p| f64::from(p[i])).sum::<f64>() / 3.0);
        let distance2 = |p: &[f32; 3]| (0..3).map(|i| (f64::from(p[i]) - center[i]).powi(2)).sum::<f64>();
        let radius2 = corners.iter().map(distance2).fold(0.0, f64::max);
        self.center.iter_mut().zip(center).for_each(|(list, x)| list.push(x));
        self.radius2.push(radius2 * 1.002 + 1e-300);
        self.corners.iter_mut().zip(corners.as_flattened()).for_each(|(list, &x)| list.push(x.into()));
    }

    /// For each ray the numbers of all triangles that its line may cross; never leaves out one that it does.
    pub fn perhaps(&self, rays: &[OracleRay]) -> Vec<Vec<u32>> {
        Arch::new().dispatch(Search { triangles: self, rays })
    }
}

/// The search, compiled for each instruction set.
struct Search<'a> {
    triangles: &'a Triangles,
    rays: &'a [OracleRay],
}

impl WithSimd for Search<'_> {
    type Output = Vec<Vec<u32>>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> Vec<Vec<u32>> {
        let Search { triangles, rays } = self;
        let lines: Vec<Line> = rays.iter().map(Line::new).collect();
        let mut found = vec![Vec::new(); rays.len()];
        // Each block of triangles is fetched once and meets all rays.
        for start in (0..triangles.radius2.len()).step_by(BLOCK) {
            let range = start..(start + BLOCK).min(triangles.radius2.len());
            let center = triangles.center.each_ref().map(|list| &list[range.clone()]);
            let radius2 = &triangles.radius2[range.clone()];
            for (line, found) in lines.iter().zip(&mut found) {
                let mut gaps = [f64::INFINITY; BLOCK];
                if !line.gaps(center, radius2, &mut gaps[..range.len()]) {
                    continue;
                }
                let touched = |gap: &f64| *gap <= 0.0;
                let first = gaps.iter().position(touched).unwrap_or(0);
                let last = gaps.iter().rposition(touched).unwrap_or(0);
                let mut missed = [0.0; BLOCK];
                let corners = triangles.corners.each_ref().map(|list| &list[start + first..=start + last]);
                line.missed(&corners, &mut missed[first..=last]);
                for i in first..=last {
                    if gaps[i] <= 0.0 && missed[i] == 0.0 {
                        found.push((start + i) as u32);
                    }
                }
            }
        }
        found
    }
}

impl Line {
    fn new(ray: &OracleRay) -> Line {
        let largest = ray.d.iter().fold(0.0f64, |m, x| m.max(f64::from(x.abs())));
        Line { o: ray.o.map(f64::from), d: ray.d.map(|x| f64::from(x) / largest) }
    }

    /// How far, squared, the line passes outside of each sphere; whether it touches one.
    ///
    /// The line touches a sphere if `|d x (c - o)| <= r |d|`. The computed cross product is off by at most e = 2^-50 |c - o| |d|, so
    /// it is compared with `(r |d| + e)^2 <= (1.001 r^2 + 1001 * 2^-100 |c - o|^2) |d|^2`; the radius comes with that factor and more.
    /// Coordinates are below 2^129, so squares of products stay below 2^520.
    #[inline(always)]
    fn gaps(&self, [cx, cy, cz]: [&[f64]; 3], radius2: &[f64], gaps: &mut [f64]) -> bool {
        let Line { o, d } = self;
        let dd = d[0] * d[0] + d[1] * d[1] + d[2] * d[2];
        let n = gaps.len();
        let (cx, cy, cz, radius2) = (&cx[..n], &cy[..n], &cz[..n], &radius2[..n]);
        let mut touched = 0u64;
        for i in 0..n {
            let (x, y, z) = (cx[i] - o[0], cy[i] - o[1], cz[i] - o[2]);
            let (a, b, c) = (d[1] * z - d[2] * y, d[2] * x - d[0] * z, d[0] * y - d[1] * x);
            let limit = (radius2[i] + 1e-27 * (x * x + y * y + z * z)) * dd;
            let gap = a * a + b * b + c * c - limit;
            gaps[i] = gap;
            touched |= u64::from(gap <= 0.0);
        }
        touched != 0
    }

    /// Sets an entry to 1 where two edge determinants `det(d, p - o, q - o)` certainly have opposite signs.
    ///
    /// With M the largest |component of a corner - o| and |d_i| <= 1, a determinant is a sum of six products of at most M^2. Each
    /// carries at most eight roundings of 2^-53 (d, two differences, two products, three sums): 48 * 2^-53 M^2 in all, and less than
    /// 64 * 2^-53 M^2 with the roundings of the bound and terms of second order. Nothing underflows that matters: M^2 >= 2^-298.
    #[inline(always)]
    fn missed(&self, corners: &[&[f64]; 9], missed: &mut [f64]) {
        let Line { o, d } = self;
        let n = missed.len();
        let [ax, ay, az, bx, by, bz, cx, cy, cz] = corners.map(|list| &list[..n]);
        for i in 0..n {
            let a = [ax[i] - o[0], ay[i] - o[1], az[i] - o[2]];
            let b = [bx[i] - o[0], by[i] - o[1], bz[i] - o[2]];
            let c = [cx[i] - o[0], cy[i] - o[1], cz[i] - o[2]];
            let mut m = 0.0;
            for x in [a[0], a[1], a[2], b[0], b[1], b[2], c[0], c[1], c[2]] {
                m = if x.abs() > m { x.abs() } else { m };
            }
            let bound = m * m * (64.0 / 9_007_199_254_740_992.0);
            let det = |p: [f64; 3], q: [f64; 3]| {
                d[0] * (p[1] * q[2] - p[2] * q[1])
                    + d[1] * (p[2] * q[0] - p[0] * q[2])
                    + d[2] * (p[0] * q[1] - p[1] * q[0])
            };
            let (u, v, w) = (det(b, c), det(c, a), det(a, b));
            let low = if u < v { u } else { v };
            let low = if w < low { w } else { low };
            let high = if u > v { u } else { v };
            let high = if w > high { w } else { high };
            missed[i] = if (low < -bound) & (high > bound) { 1.0 } else { 0.0 };
        }
    }
}
