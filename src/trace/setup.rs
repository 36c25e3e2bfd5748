//! A ray prepared for the walk, and why the walk never loses a cell.
//!
//! **Parameters.** In root units the ray is p + tau g with p = (o - corner) / side and g = d 2^s, the power of two chosen such that the
//! largest |g_i| is in [1, 2). Then t = tau 2^s side, an exact scaling. The walk starts from p' = p + tau0 g, tau0 being the parameter
//! of the interval's point nearest to the origin within the root: so |p'| is about 1 however far the origin, and all parameters of the node
//! loop, which are relative to tau0, are about 1 too, where f32 is fine.
//!
//! **Errors of f64**, P = max |p_i|: p, tau0 g and p' are each off by a few 2^-53 (P + 2) in position; `pad` = 2^-46 (P + 2) is more than
//! eight times all of them together. It widens the root's slabs here, every slab below (through `slack`), and the best hit's parameter.
//!
//! **Errors of f32** in the node loop, eps = 2^-24, A = |p'_i|, all in units of |inv_i| = 1 / |g_i|. A plane q of a node has the parameter
//! t0 + q dt. The walk carries t0 less the slack and t0 plus the slack (`begin`, `end`); a child's is fl(t0 + fl(low dt)), or fused with one rounding
//! less, its dt the parent's times an exact power of two. The corners of frames lie in 0..1, and low * unit summed over a path is
//! at most 1. So a plane's computed parameter is off by at most
//! - eps (A + 1): t0 of the root or brick, rounded once from f64; twice that for the slack taken off or added there;
//! - eps: the rounding of inv itself, on a path's sum of q * dt;
//! - eps: the products' roundings, which add up to those on one path;
//! - eps (A + 1) for each of L levels, and once more at the last plane: the sums' roundings.
//!
//! Together less than eps (L + 4) (A + 3), L being the file's depth. `slack` = |inv| (pad + eps (L + 4) (A + 3)), rounded up, is subtracted from
//! every near and added to every far parameter. A slab that the exact ray touches is therefore never lost, and near
//! parameters are true lower bounds. (Ize 2013 pads relative to t; one number an axis is simpler and about as tight here.)
//!
//! **Small components.** An axis with |g_i| < 2^-100 has no parameter: within the root the ray moves by less than 2^-100 (P + 2) along
//! it, which is below pad 2^-50. Its `inv` is set to 2^100 with g's sign bit, which makes the slab a test of position: inside the
//! slab, or outside by less than that motion, near <= -2^100 (pad / 2) <= -2^52 and far >= 2^52, which bind nothing; outside by
//! more than the slack, near or far lies beyond any parameter of the root and the slab is rejected.
//!
//! **Extremes.** From 2^40 root sizes on, f64 says too little: the walk then visits all boxes (`inv` = 0, infinite slack in effect) and only the
//! exact triangle test decides. Slow, and right.

use super::arch::{Planes, Way};
use crate::exact::{Line, Shear};
use crate::format::Frame;
use crate::geometry::{Aabb, Ray, RootCube};

/// A ray ready to walk an octree.
#[derive(Clone, Debug)]
pub(super) struct Setup {
    /// For the exact test.
    pub line: Line,
    /// For its f32 filter.
    pub shear: Shear,
    /// For the node test.
    pub way: Way,
    /// p'.
    origin: [f64; 3],
    inv: [f64; 3],
    /// `inv` rounded once; dt of a frame is its unit times this.
    inv32: [f32; 3],
    /// In parameter units, see above.
    slack: [f32; 3],
    /// The parameter (relative to tau0) at which the ray leaves the root or its interval, rounded up.
    pub far: f32,
    /// tau = t * scale.
    scale: f64,
    tau0: f64,
    pad: f64,
}

/// 2^k for -1022 <= k <= 1023.
fn exp2(k: i32) -> f64 {
    f64::from_bits(((k + 1023) as u64) << 52)
}

/// floor(log2(x)) of a normal, positive f64 (every positive f32 is one).
fn log2_floor(x: f64) -> i32 {
    (x.to_bits() >> 52) as i32 - 1023
}

const LEAST_COMPONENT: f64 = 1.0 / (1u128 << 100) as f64;

impl Setup {
    /// Prepares a valid ray; `None` if it misses the root cube. `depth` is the file's.
    pub fn new(ray: &Ray, root: RootCube, bounds: Aabb, depth: u32) -> Option<Setup> {
        let d = ray.direction.map(f64::from);
        let exponent = log2_floor(d[0].abs().max(d[1].abs()).max(d[2].abs()));
        let g = d.map(|x| x * exp2(-exponent));
        let scale = exp2(exponent - root.log2_side);
        let p = root.to_root_units(ray.origin.into()).to_array();
        let pad = 2f64.powi(-46) * (p[0].abs().max(p[1].abs()).max(p[2].abs()) + 2.0);
        let inv = g.map(|x| if x.abs() < LEAST_COMPONENT { (1.0 / LEAST_COMPONENT).copysign(x) } else { 1.0 / x });

        // A t that rounds into [tmin, tmax] lies at most one f32 step outside.
        let mut enter = f64::from(ray.tmin.next_down()) * scale;
        let mut exit = f64::from(ray.tmax.next_up()) * scale;
        for i in 0..3 {
            let (a, b) = ((-pad - p[i]) * inv[i], (1.0 + pad - p[i]) * inv[i]);
            let (near, far) = if inv[i] < 0.0 { (b, a) } else { (a, b) };
            enter = if near > enter { near } else { enter };
            exit = if far < exit { far } else { exit };
        }
        if enter > exit {
            return None;
        }
        let tau0 = 0f64.clamp(enter, exit);
        let mut setup = Setup {
            line: Line::new(ray),
            shear: Shear::new(ray, bounds),
            way: Way {
                least: [0.0; 4],
                mask: (0..3).fold(0, |mask, i| mask << 1 | u8::from(inv[i] < 0.0)),
                near: ((enter - tau0) as f32).next_down(),
            },
            origin: std::array::from_fn(|i| p[i] + tau0 * g[i]),
            inv,
            inv32: inv.map(|x| x as f32),
            slack: [0.0; 3],
            far: ((exit - tau0) as f32).next_up(),
            scale,
            tau0,
            pad,
        };
        setup.widen(depth);
        for i in 0..3 {
            setup.way.least[i] = setup.inv32[i] * Frame::LEAST_UNIT as f32;
        }
        Some(setup)
    }

    /// Computes the slack.
    fn widen(&mut self, depth: u32) {
        if self.pad > 2f64.powi(-6) {
            (self.origin, self.inv, self.inv32, self.slack) = ([0.0; 3], [0.0; 3], [0.0; 3], [f32::MAX / 4.0; 3]);
            return;
        }
        let levels = f64::from(depth) + 4.0;
        self.slack = std::array::from_fn(|i| {
            let position = self.pad + levels * (self.origin[i].abs() + 3.0) / 16_777_216.0;
            ((self.inv[i].abs() * position) as f32).next_up()
        });
    }

    /// The parameters of a brick's or the root's frame: its corner's rounded once, then the slack taken off and added.
    pub fn planes(&self, frame: &Frame) -> Planes {
        let mut planes = Planes { begin: [0.0; 4], end: [0.0; 4], dt: [0.0; 4] };
        for i in 0..3 {
            let corner = ((frame.corner[i] - self.origin[i]) * self.inv[i]) as f32;
            planes.begin[i] = corner - self.slack[i];
            planes.end[i] = corner + self.slack[i];
            planes.dt[i] = frame.unit[i] as f32 * self.inv32[i];
        }
        planes
    }

    /// The parameter that no nearer node may pass, for a hit at most at `t`, rounded up.
    pub fn reach(&self, t: f64) -> f32 {
        ((t * self.scale - self.tau0 + self.pad) as f32).next_up()
    }
}
