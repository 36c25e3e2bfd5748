//! A ray prepared for the walk, and why the walk never loses a cell.
//!
//! **Far or steep rays.** In root units the ray is p + tau g with p = (o - corner) / side and g = d 2^s, the power of two chosen such that the
//! largest |g_i| is in [1, 2). Then t = tau 2^s side, an exact scaling. The walk starts from p' = p + tau0 g, tau0 being the parameter
//! of the interval's point nearest to the origin within the root: so |p'| is about 1 however far the origin, and all parameters of the node
//! loop, which are relative to tau0, are about 1 too, where f32 is fine.
//!
//! **Plain rays**, whose origin is within 16 root sizes and whose components are all of moderate size (most rays by far), need none of
//! this: p' = p, tau0 = 0, and the parameters are those of the ray itself, t.
//!
//! **Errors of f64**, P = max |p_i|: p, tau0 g and p' are each off by a few 2^-53 (P + 2) in position; `pad` = 2^-46 (P + 2) is more than
//! eight times all of them together. It widens the root's slabs here, every slab below (through `slack`), and the best hit's parameter.
//!
//! **Errors of f32** in the node loop, eps = 2^-24, A = |p'_i|, all in units of |inv_i| = 1 / |g_i|. A plane q of a node has the parameter
//! t0 + q dt. The walk carries t0 less the slack (`begin`); a child's is fl(t0 + fl(low dt)), or fused with one rounding
//! less, its dt the parent's times an exact power of two. The corners of frames lie in 0..1, and low * unit summed over a path is
//! at most 1. So a plane's computed parameter is off by at most
//! - 4 eps (A + 1): t0 of the root or brick, from the corner's distance in f32, inv, their product, and taking off the slack;
//! - eps (A + 1): adding the slack, doubled, again where planes are left;
//! - eps: the rounding of inv itself, on a path's sum of q * dt;
//! - eps: the products' roundings, which add up to those on one path;
//! - eps (A + 1) for each of L levels, and once more at the last plane: the sums' roundings.
//!
//! Together less than eps (L + 8) (A + 3), L being the file's depth. `slack` = |inv| (pad + eps (L + 8) (A + 3)), rounded up, is subtracted from
//! every near and added to every far parameter. A slab that the exact ray touches is therefore never lost, and near
//! parameters are true lower bounds. (Ize 2013 pads relative to t; one number an axis is simpler and about as tight here.)
//!
//! **Small components.** An axis with |g_i| < 2^-100 has no parameter: within the root the ray moves by less than 2^-100 (P + 2) along
//! it, which is below pad 2^-50. Its `inv` is set to 2^100 with g's sign bit, which makes the slab a test of position: inside the
//! slab, or outside by less than that motion, near <= -2^100 (pad / 2) <= -2^52 and far >= 2^52, which bind nothing; outside by
//! more than the slack, near or far lies beyond any parameter of the root and the slab is rejected.
//!
//! **Far origins.** From 2^30 root sizes on, f64 places the root too badly along the ray. The start is then brought near the root in exact
//! steps first ([`approach`]): each leaves 2^-45 of the distance, and the point that it ends at is exact before it is rounded.
//! Only a ray whose steps do not get there visits all boxes (`inv` = 2^-60, infinite slack in effect), and the exact triangle test decides.

use bytemuck::Zeroable;

use super::arch::{Aim, Fit, Kernel, Way};
use crate::exact::Expansion;
use crate::format::Frame;
use crate::geometry::{Aabb, Ray, RootCube, exp2, log2_floor};

/// What all rays of a file share.
#[derive(Clone, Debug)]
pub(super) struct Scene {
    /// Box around all triangles.
    pub bounds: Aabb,
    root: RootCube,
    /// 1 / the root's side, a power of two.
    scale: f64,
    /// What aiming plain rays needs.
    pub fit: Fit,
    /// eps (L + 8).
    rounding: f64,
    /// What turns the direction mask into the order of visits: 0 for near to far, 7 for far to near.
    pub turn: u8,
}

impl Scene {
    /// `depth` is the file's.
    pub fn new(root: RootCube, bounds: Aabb, depth: u32) -> Scene {
        let side = if root.log2_side.abs() <= 40 { exp2(root.log2_side) as f32 } else { f32::INFINITY };
        let (scale, rounding) = (exp2(-root.log2_side), (f64::from(depth) + 8.0) / 16_777_216.0);
        let [x, y, z] = root.corner.to_array();
        let fit = Fit { corner: [x, y, z, 0.0], scale, side, rounding: rounding as f32 };
        Scene { bounds, root, scale, fit, rounding, turn: 0 }
    }
}

/// A ray ready to walk an octree. Made once and aimed at each ray of a batch, as it is too large to hand around.
#[derive(Clone, Copy, Debug, Zeroable)]
#[repr(C)]
pub(super) struct Setup {
    /// For the node test.
    pub way: Way,
    /// For frames.
    pub aim: Aim,
    /// Whether parameters are the ray's own.
    plain: bool,
    /// The parameter (relative to tau0) at which the ray leaves the root or its interval, rounded up.
    pub far: f32,
    /// tau = t * scale.
    scale: f64,
    tau0: f64,
    /// Error bound of a hit's parameter.
    pad: f64,
}

/// Where the walk's set-up starts from.
struct Start {
    /// The point at parameter `tau`, in root units.
    p: [f64; 3],
    /// The ray's interval relative to `tau`, rounded outward.
    enter: f64,
    exit: f64,
    tau: f64,
}

/// The larger; the second if either is NaN.
#[inline(always)]
fn greater(a: f64, b: f64) -> f64 {
    if a > b { a } else { b }
}

/// The lesser; the second if either is NaN.
#[inline(always)]
fn lesser(a: f64, b: f64) -> f64 {
    if a < b { a } else { b }
}

const LEAST_COMPONENT: f64 = 1.0 / (1u128 << 100) as f64;
const PAD: f64 = 1.0 / (1u64 << 46) as f64;
/// From this distance on, in root sizes, the start is brought nearer.
const FAR: f64 = (1u64 << 30) as f64;
/// Then this is `inv`: no parameter matters, yet steps stay normal numbers, as the kernels need.
const BLIND: f64 = 1.0 / (1u64 << 60) as f64;
/// From this pad on the walk visits all boxes.
const PAD_MAX: f64 = 1.0 / 64.0;

/// The largest magnitude.
#[inline(always)]
fn largest(p: [f64; 3]) -> f64 {
    greater(greater(p[0].abs(), p[1].abs()), p[2].abs())
}

/// The part of an interval in which the ray is within the root's slabs, padded by so much on each axis.
#[inline(always)]
fn within_root(p: [f64; 3], inv: [f64; 3], pads: [f64; 3], (mut enter, mut exit): (f64, f64)) -> (f64, f64) {
    for i in 0..3 {
        let (a, b) = ((-pads[i] - p[i]) * inv[i], (1.0 + pads[i] - p[i]) * inv[i]);
        enter = greater(lesser(a, b), enter);
        exit = lesser(greater(a, b), exit);
    }
    (enter, exit)
}

/// Brings a start from far away near the root, in exact steps along the ray; `None` if the ray misses the root.
///
/// Every step is an f64, and tau and the point are kept as exact sums, so that nothing is lost. An axis is padded by the rounding of
/// its own coordinate.
#[cold]
#[inline(never)]
fn approach(ray: &Ray, scene: &Scene, g: [f64; 3], inv: [f64; 3], (first, last): (f64, f64)) -> Option<Start> {
    const STEPS: usize = 12;
    let corner = scene.root.corner.to_array();
    let mut point: [Expansion; 3] = std::array::from_fn(|i| {
        let mut x = Expansion::from(f64::from(ray.origin[i]));
        x.grow(-corner[i]);
        x.scale(scene.scale)
    });
    let mut tau = Expansion::default();
    let mut start = Start { p: [0.0; 3], enter: first, exit: last, tau: 0.0 };
    for _ in 0..STEPS {
        start.p = std::array::from_fn(|i| point[i].estimate());
        start.tau = tau.estimate();
        // Relative to tau, rounded outward; an estimate is good to 2^-50.
        let relative = |t: f64, outward: f64| {
            let exact = (&Expansion::from(t) - &tau).estimate();
            if t.is_infinite() { t } else { exact + outward * exact.abs() * (8.0 * f64::EPSILON) }
        };
        (start.enter, start.exit) = (relative(first, -1.0), relative(last, 1.0));
        let reach = largest(start.p) + 2.0;
        let mut pads = [0.0; 3];
        for i in 0..3 {
            pads[i] = PAD * (start.p[i].abs() + 2.0);
            if g[i].abs() < LEAST_COMPONENT {
                // No parameter: inside or outside, give or take how far the ray moves along the axis on its way.
                pads[i] += 4.0 * g[i].abs() * reach;
                if start.p[i] < -pads[i] || start.p[i] > 1.0 + pads[i] {
                    return None;
                }
                pads[i] = f64::INFINITY;
            }
        }
        let (enter, exit) = within_root(start.p, inv, pads, (start.enter, start.exit));
        if enter > exit {
            return None;
        }
        let step = lesser(greater(0.0, enter), exit);
        if reach < 8.0 || step == 0.0 {
            break;
        }
        tau.grow(step);
        for (x, &g) in point.iter_mut().zip(&g) {
            *x = &*x + &Expansion::from(g).scale(step);
        }
    }
    Some(start)
}

impl Setup {
    /// Prepares a ray; false if it is invalid or found to miss the root cube, and then nothing here is to be used.
    #[inline(always)]
    pub fn aim<K: Kernel>(&mut self, kernel: K, ray: &Ray, scene: &Scene) -> bool {
        // pad is below 2^-41, so far below eps (L + 8) that the kernel's constant 3.01 in place of 3 covers it, and its own roundings.
        if kernel.aim(ray, &scene.fit, &mut self.way, &mut self.aim) {
            // A t that rounds into [tmin, tmax] lies at most one f32 step outside.
            self.way.visit(scene.turn);
            self.way.near = ray.tmin.next_down();
            self.far = ray.tmax.next_up();
            self.plain = true;
            return true;
        }
        ray.is_valid() && self.aim_any(ray, scene)
    }

    /// Prepares any valid ray.
    #[inline(never)]
    fn aim_any(&mut self, ray: &Ray, scene: &Scene) -> bool {
        self.plain = false;
        let corner = scene.root.corner;
        // Scaling by powers of two is exact.
        let p = [
            (f64::from(ray.origin[0]) - corner.x) * scene.scale,
            (f64::from(ray.origin[1]) - corner.y) * scene.scale,
            (f64::from(ray.origin[2]) - corner.z) * scene.scale,
        ];
        let [dx, dy, dz] = [f64::from(ray.direction[0]), f64::from(ray.direction[1]), f64::from(ray.direction[2])];
        let exponent = log2_floor(greater(greater(dx.abs(), dy.abs()), dz.abs()));
        let shrink = exp2(-exponent);
        let g = [dx * shrink, dy * shrink, dz * shrink];
        let scale = exp2(exponent) * scene.scale;
        let mut inv = [0.0; 3];
        for i in 0..3 {
            let component = if g[i].abs() < LEAST_COMPONENT { LEAST_COMPONENT.copysign(g[i]) } else { g[i] };
            inv[i] = 1.0 / component;
        }
        // A t that rounds into [tmin, tmax] lies at most one f32 step outside.
        let enter = f64::from(ray.tmin.next_down()) * scale;
        let exit = f64::from(ray.tmax.next_up()) * scale;
        let distance = largest(p);
        let mut start = Start { p, enter, exit, tau: 0.0 };
        if distance > FAR {
            match approach(ray, scene, g, inv, (enter, exit)) {
                Some(near) => start = near,
                None => return false,
            }
        }
        let p = start.p;
        let pad = PAD * (largest(p) + 2.0);
        let (enter, exit) = within_root(p, inv, [pad; 3], (start.enter, start.exit));
        if enter > exit {
            return false;
        }
        let tau0 = lesser(greater(0.0, enter), exit);
        let way = &mut self.way;
        way.mask = u8::from(inv[0] < 0.0) << 2 | u8::from(inv[1] < 0.0) << 1 | u8::from(inv[2] < 0.0);
        way.visit(scene.turn);
        way.near = ((enter - tau0) as f32).next_down();
        self.far = ((exit - tau0) as f32).next_up();
        (self.scale, self.tau0, self.pad) = (scale, start.tau + tau0, PAD * (distance + 2.0));
        // Too far away for f64 to say anything.
        let blind = pad > PAD_MAX;
        for i in 0..3 {
            let origin = p[i] + tau0 * g[i];
            let position = pad + scene.rounding * (origin.abs() + 3.0);
            let slack = ((inv[i].abs() * position) as f32).next_up();
            let inv = if blind { BLIND } else { inv[i] } as f32;
            let slack = if blind { f32::MAX / 4.0 } else { slack };
            self.aim.origin[i] = if blind { 0.0 } else { origin };
            self.aim.inv[i] = inv;
            self.aim.slack[i] = slack;
            way.slack[i] = 2.0 * slack;
            let least = inv * Frame::LEAST_UNIT as f32;
            (way.least[0][i], way.least[1][i], way.least[2][i], way.least[3][i]) = (least, least, -least, -least);
        }
        true
    }

    /// The parameter that no nearer node may pass, for a hit at most at `t`, rounded up.
    #[inline(always)]
    pub fn reach(&self, t: f32) -> f32 {
        if self.plain {
            return t;
        }
        ((f64::from(t) * self.scale - self.tau0 + self.pad) as f32).next_up()
    }
}
