//! The f32 filter: edge functions of a whole leaf in the ray's sheared space, with one error bound a ray.
//!
//! Vertices are moved to the ray's origin and sheared so that the ray runs along its major axis z (Woop, Benthin and Wald
//! 2013): x' = (x - ox) - sx (z - oz), sx = dx / dz, likewise y'. The edge functions are then plane cross products, e.g.
//! U = bx' cy' - by' cx', evaluated as multiply, multiply, subtract and never fused.
//!
//! **The bound.** eps = 2^-24, M >= |coordinate - origin| for every vertex. |sx| <= 1, so |x'| <= 2M. To first order x' is off by
//! - eps M: the translation of x, rounded once;
//! - 3 eps M: sx, the translation of z, and their product, each rounded once, on |sx (z - oz)| <= M;
//! - 2 eps M: the last subtraction, a result of at most 2M.
//!
//! With second order terms and underflow, each below 2^-20 of the whole (see below): at most E = 6.01 eps M. With m the largest
//! of a triangle's six |x'|, |y'| *as computed*, an edge function is off by at most
//! - 4 m E + 2 E^2: two products of factors at most m, each off by at most E;
//! - 4.01 eps m^2: two products rounded (eps m^2 each) and their difference (2 eps m^2), and eps m <= 2.01 eps M <= E / 2.99,
//!   so that this is at most 1.35 m E.
//!
//! Together at most 5.35 m E + 2 E^2. The bound in use, b = 5.4 m E + 2.01 E^2, leaves 0.9 % and 0.5 % for its own few roundings and
//! those of E. With q = min(-min(U, V, W), max(U, V, W)): q > b means that two edge functions have certainly different
//! signs, a miss; q < -b that all three have certainly one sign, a hit; else the lane is in doubt. NaN compares false: doubt.
//!
//! A packet shares its axes, so that a ray's slopes may exceed 1, up to S = 1.25. Then |x'| <= (1 + S) M, x' is off by
//! eps M + 3 eps S M + eps (1 + S) M = 7 eps M, E = 7.02 eps M, and eps m <= 2.26 eps M <= E / 3.1: the rest holds as it stands.
//!
//! **Depth.** A lane that is certainly hit meets the ray at t = sum(u_i z_i) / (dz sum(u_i)), u_i being the exact edge functions and z_i the
//! corners' exact depths. With U_i as computed, all of one sign and each off by at most b, with the z_i as computed, Z the largest |z_i|, R
//! their range and D the computed sum of U_i, the quotient of the computed sums is off by
//! - b (sum of |z_i - z|) / |D| <= 2 b R / |D|: the U_i, z being a weighted mean of the z_i and so within their range;
//! - eps Z: the translation of each z_i;
//! - 7.1 eps Z: D, 1 / D, the weights U_i / D, their products with z_i, and the sum (no cancellation in the U_i);
//! - 2 eps Z: 1 / dz and the product with it; eps Z: adding and taking off the bound itself;
//! - underflow of the weights U_i / D and of their products with z_i, and of b / |D|: far below 2^-100 (Z + R + 1).
//!
//! So h = |1 / dz| (2.2 b R / |D| + 12 eps Z + 2^-44) + 2^-126 bounds |t - computed t|, its own roundings and those of R and D included.
//!
//! **Range.** The filter is trusted only for 2^-30 <= M <= 2^60 and 2^-100 <= |dz| <= 2^100. Then products stay below 4 M^2 <= 2^122, and what may
//! underflow (at most 2^-150 each in sx, times M, and in the products) is far below eps M >= 2^-54 and E^2 >= 2^-103. Outside this
//! range every lane is in doubt, which costs time and nothing else.

use crate::geometry::{Aabb, Ray};

/// Most triangles classified at once.
pub const LANES: usize = 16;

const EPS: f32 = 1.0 / 16_777_216.0;

/// The range of M in which the filter is trusted.
const TRUSTED: std::ops::RangeInclusive<f32> = 1.0 / (1u32 << 30) as f32..=(1u64 << 60) as f32;

/// The range of |dz| in which it is.
const STEEP: std::ops::RangeInclusive<f32> = 1.0 / (1u128 << 100) as f32..=(1u128 << 100) as f32;

/// A ray prepared for the filter.
#[derive(Clone, Copy, Debug, Default, bytemuck::Zeroable)]
pub struct Shear {
    /// The axes that play x, y and z; z is the ray's major axis.
    pub axes: [usize; 3],
    origin: [f32; 3],
    sx: f32,
    sy: f32,
    /// 5.4 E.
    linear: f32,
    /// 2.01 E^2; infinite where the filter is not to be trusted.
    constant: f32,
    /// 1 / dz.
    inverse: f32,
    /// Factors of b R / |D|, of Z and of 1 in the bound of t.
    depth: [f32; 3],
}

/// Where the line meets the triangles of a leaf: bounds of the exact t of each lane that is certainly hit.
///
/// Other lanes hold anything. A bound may be NaN where f32 says nothing.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub struct Depths {
    /// Lower bounds.
    pub lo: [f32; LANES],
    /// Upper bounds.
    pub hi: [f32; LANES],
}

impl Depths {
    /// Zeros.
    pub const BLANK: Depths = Depths { lo: [0.0; LANES], hi: [0.0; LANES] };
}

/// What the filter says of each lane, a bit each. A lane in neither is a certain miss.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Lanes {
    /// Certainly hit by the line, at a t that may lie within the range asked for.
    pub accept: u32,
    /// Not decided.
    pub doubt: u32,
}

impl Shear {
    /// The steepest slope that the bound of a packet allows for.
    pub const STEEPEST: f32 = 1.25;

    /// Prepares a valid ray against triangles within `bounds`.
    #[inline(always)]
    pub fn new(ray: &Ray, bounds: Aabb) -> Shear {
        let (d, o) = (ray.direction, ray.origin);
        let axes = axes_of(d);
        // f32 differences are rounded; the factor of 1 + 4 eps covers that.
        let reach = |min: f32, max: f32, o: f32| greater((min - o).abs(), (max - o).abs());
        let (min, max) = (bounds.min, bounds.max);
        let [x, y, z] = [reach(min.x, max.x, o[0]), reach(min.y, max.y, o[1]), reach(min.z, max.z, o[2])];
        let m = greater(greater(x, y), z) * (1.0 + 4.0 * EPS);
        let e = 6.01 * EPS * m;
        let [x, y, z] = axes;
        let trusted = TRUSTED.contains(&m) & STEEP.contains(&d[z].abs());
        let constant = if trusted { 2.01 * e * e } else { f32::INFINITY };
        let inverse = 1.0 / d[z];
        Shear {
            axes,
            origin: [o[x], o[y], o[z]],
            sx: d[x] / d[z],
            sy: d[y] / d[z],
            linear: 5.4 * e,
            constant,
            inverse,
            depth: Shear::depth_factors(inverse),
        }
    }

    /// One of a packet of rays, whose slopes may be steeper than 1 but are at most [`Shear::STEEPEST`], from its parts; `axes` and `bound` are the packet's.
    #[inline(always)]
    pub fn assembled(axes: [usize; 3], origin: [f32; 3], [sx, sy]: [f32; 2], inverse: f32, bound: [f32; 2]) -> Shear {
        let [linear, constant] = bound;
        Shear { axes, origin, sx, sy, linear, constant, inverse, depth: Shear::depth_factors(inverse) }
    }

    /// The [`Shear::bound`] of rays that start between two points, have slopes up to [`Shear::STEEPEST`] and dz within `steep`.
    pub fn bound_of(low: [f32; 3], high: [f32; 3], steep: [f32; 2], bounds: Aabb) -> [f32; 2] {
        let (min, max) = (bounds.min.to_array(), bounds.max.to_array());
        let mut m = 0.0f32;
        for i in 0..3 {
            m = greater(m, greater((min[i] - high[i]).abs(), (max[i] - low[i]).abs()));
        }
        let m = m * (1.0 + 4.0 * EPS);
        let e = 7.02 * EPS * m;
        let trusted = TRUSTED.contains(&m) & STEEP.contains(&steep[0]) & STEEP.contains(&steep[1]);
        [5.4 * e, if trusted { 2.01 * e * e } else { f32::INFINITY }]
    }

    /// Factors of b R / |D|, of Z and of 1 in the bound of t.
    #[inline(always)]
    pub fn depth_factors(inverse: f32) -> [f32; 3] {
        let (scale, underflow) = (inverse.abs(), 1.0 / (1u64 << 44) as f32);
        [2.2 * scale, 12.0 * EPS * scale, scale * underflow + f32::MIN_POSITIVE]
    }

    /// The same without what bounds need: for the tracer without them that exactness is measured against.
    #[doc(hidden)]
    #[inline(always)]
    pub fn without_bounds(ray: &Ray) -> Shear {
        let (d, o, axes) = (ray.direction, ray.origin, axes_of(ray.direction));
        let [x, y, z] = axes;
        let (origin, inverse) = ([o[x], o[y], o[z]], 1.0 / d[z]);
        Shear { axes, origin, sx: d[x] / d[z], sy: d[y] / d[z], inverse, ..Shear::default() }
    }

    /// The origin on `axes`.
    #[inline(always)]
    pub fn origin(&self) -> [f32; 3] {
        self.origin
    }

    /// How far x and y move with z: sx, sy.
    #[inline(always)]
    pub fn slopes(&self) -> [f32; 2] {
        [self.sx, self.sy]
    }

    /// The bound of an edge function: this times m, plus this.
    #[inline(always)]
    pub fn bound(&self) -> [f32; 2] {
        [self.linear, self.constant]
    }

    /// 1 / dz, which turns a depth into a t.
    #[inline(always)]
    pub fn inverse(&self) -> f32 {
        self.inverse
    }

    /// The bound of t: these times b R / |D|, times Z, and times 1, in sum.
    #[inline(always)]
    pub fn depth_bound(&self) -> [f32; 3] {
        self.depth
    }

    /// Classifies the first `count` triangles (at most 16) over a table of N vertices (16 or 32).
    ///
    /// `x`, `y`, `z` are the vertices' coordinates on `axes[0]`, `axes[1]`, `axes[2]`; entries that no triangle names may hold
    /// anything. `corners[k][j]` is the vertex number of corner k of triangle j, taken modulo N. Lanes whose t is certainly below
    /// `range[0]` or above `range[1]` are not accepted; the t of those that are is bounded in `depths`.
    #[inline(always)]
    pub fn classify<const N: usize>(
        &self,
        [x, y, z]: [&[f32; N]; 3],
        corners: &[[u8; LANES]; 3],
        count: usize,
        range: [f32; 2],
        depths: &mut Depths,
    ) -> Lanes {
        let mut sheared = [[0.0f32; 3]; N];
        for i in 0..N {
            let depth = z[i] - self.origin[2];
            sheared[i][0] = (x[i] - self.origin[0]) - self.sx * depth;
            sheared[i][1] = (y[i] - self.origin[1]) - self.sy * depth;
            sheared[i][2] = depth;
        }
        let mut lanes = Lanes::default();
        for j in 0..count.min(LANES) {
            let [ax, ay, az] = sheared[usize::from(corners[0][j]) % N];
            let [bx, by, bz] = sheared[usize::from(corners[1][j]) % N];
            let [cx, cy, cz] = sheared[usize::from(corners[2][j]) % N];
            let u = bx * cy - by * cx;
            let v = cx * ay - cy * ax;
            let w = ax * by - ay * bx;
            let m =
                greater(greater(greater(ax.abs(), ay.abs()), greater(bx.abs(), by.abs())), greater(cx.abs(), cy.abs()));
            let bound = self.linear * m + self.constant;
            let q = lesser(-lesser(lesser(u, v), w), greater(greater(u, v), w));
            let (miss, hit) = (q > bound, q < -bound);
            lanes.doubt |= u32::from(!(miss | hit)) << j;
            if hit {
                let sum = (u + v) + w;
                let share = 1.0 / sum;
                let t = ((u * share * az + v * share * bz) + w * share * cz) * self.inverse;
                let (most, least) = (greater(greater(az, bz), cz), lesser(lesser(az, bz), cz));
                let [of_shape, of_depth, constant] = self.depth;
                let shape = bound * share.abs() * (most - least) * of_shape;
                let h = (shape + greater(most.abs(), least.abs()) * of_depth) + constant;
                (depths.lo[j], depths.hi[j]) = (t - h, t + h);
                // NaN compares false: kept.
                let beyond = (depths.lo[j] > range[1]) | (depths.hi[j] < range[0]);
                lanes.accept |= u32::from(!beyond) << j;
            }
        }
        lanes
    }
}

/// A ray's axes that play x, y and z.
#[inline(always)]
fn axes_of(d: [f32; 3]) -> [usize; 3] {
    let z = match (d[0].abs() > d[1].abs(), d[2].abs() > d[0].abs(), d[2].abs() > d[1].abs()) {
        (true, true, _) | (false, _, true) => 2,
        (true, false, _) => 0,
        (false, _, false) => 1,
    };
    [(z + 1) % 3, (z + 2) % 3, z]
}

#[inline(always)]
fn greater(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

#[inline(always)]
fn lesser(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}
