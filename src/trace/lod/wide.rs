//! What a ray with a width makes of a node: passes it, takes it for its hit, or enters it.

use glam::DVec3;

use super::{Approximate, Footprint};
use crate::format::{Frame, Patch, RootBox, Surrogate};
use crate::geometry::Ray;
use crate::map::Octree;

/// How much of a box, as the ray sees it, triangles must fill for their surrogate to be taken: where all of them face the ray alike, and
/// where some may not (a silhouette).
const LEAST_COVERAGE: [f64; 2] = [0.25, 0.4];
/// How long the mean of the unit normals must be.
const LEAST_AGREEMENT: f64 = 0.35;
/// The part of the allowed error up to which a node need not look like a surface.
const FINE: f64 = 0.5;
/// Rounding of a point of a ray in root units, by its distance from the root.
const ROUNDING: f64 = 1.0 / (1u64 << 48) as f64;
/// Rays from farther away, in root sizes, are traced exactly: f64 would not tell on which side of a plane they pass.
const FAR: f64 = 4096.0;

/// What to do about a node.
pub(super) enum Verdict {
    /// The ray hits nothing of it.
    Pass,
    Enter,
    Take(Approximate),
}

/// A ray with a width, in root units.
pub(super) struct Wide {
    o: DVec3,
    /// For each unit of t.
    d: DVec3,
    inv: DVec3,
    tmin: f64,
    tmax: f64,
    /// More than rounding can move a point of the ray.
    pad: f64,
    width: f64,
    spread: f64,
    lifted: bool,
    pixels: f64,
    /// The side of the root cube.
    side: f64,
}

impl Wide {
    pub fn new(ray: &Ray, footprint: &Footprint, pixels: f64, octree: &Octree) -> Wide {
        let root = octree.root();
        let side = root.side();
        let o = (DVec3::from_array(ray.origin.map(f64::from)) - root.corner) / side;
        let d = DVec3::from_array(ray.direction.map(f64::from)) / side;
        let distance = o.abs().max_element();
        let near = distance <= FAR;
        Wide {
            o,
            d,
            inv: d.recip(),
            tmin: ray.tmin.into(),
            tmax: ray.tmax.into(),
            pad: ROUNDING * (distance + 2.0),
            width: if near { footprint.width / side } else { 0.0 },
            spread: if near { footprint.spread / side } else { 0.0 },
            lifted: footprint.lifted,
            pixels,
            side,
        }
    }

    /// What to do about a node with this surrogate, frame and box.
    #[inline(always)]
    pub fn judge(&self, surrogate: Option<&Surrogate>, frame: &Frame, bounds: &RootBox) -> Verdict {
        let Some([t0, t1]) = self.within(bounds) else { return Verdict::Pass };
        let width = self.width + self.spread * t0.max(0.0);
        let allowed = (self.pixels * width) * (self.pixels * width);
        // No point of a box is nearer to the corner farthest from it than half of its diagonal.
        if !(bounds.high - bounds.low).length_squared().le(&(4.0 * allowed)) || width <= 0.0 {
            return Verdict::Enter;
        }
        let Some(patch) = surrogate.map(|surrogate| surrogate.patch(frame)) else { return Verdict::Enter };
        let Some((t, crossed)) = self.meet(&patch, [t0, t1]) else { return Verdict::Pass };
        // What a ray leaves is not to stand in its own way: around a triangle it sees the triangles themselves, around a surrogate,
        // where nothing is known, only what it comes to.
        let (starts_within, behind) = (t0 <= self.tmin, crossed < self.tmin);
        if !self.lifted && (starts_within || behind) {
            return Verdict::Enter;
        }
        if starts_within && behind {
            return Verdict::Pass;
        }
        let farthest = bounds.farthest_squared(self.o + t * self.d);
        if farthest > allowed {
            return Verdict::Enter;
        }
        match self.is_surface(&patch, bounds) {
            // It has left this surface behind, but for bumps of it.
            true if behind => return Verdict::Pass,
            false if farthest > allowed * (FINE * FINE) => return Verdict::Enter,
            _ => {}
        }
        let reach = farthest.sqrt();
        Verdict::Take(Approximate {
            t: (t as f32).clamp(self.tmin as f32, self.tmax as f32),
            normal: patch.normal.to_array(),
            color: patch.color,
            agreement: patch.agreement.max(1.0 / 256.0),
            deviation: patch.deviation * self.side,
            reach: reach * self.side,
            error: (reach / width).min(self.pixels),
        })
    }

    /// The parameters between which the ray is in a box.
    #[inline(always)]
    fn within(&self, bounds: &RootBox) -> Option<[f64; 2]> {
        let (mut t0, mut t1) = (self.tmin, self.tmax);
        for axis in 0..3 {
            let (low, high) = (bounds.low[axis] - self.pad - self.o[axis], bounds.high[axis] + self.pad - self.o[axis]);
            if self.d[axis] == 0.0 {
                if low > 0.0 || high < 0.0 {
                    return None;
                }
                continue;
            }
            let (a, b) = (low * self.inv[axis], high * self.inv[axis]);
            (t0, t1) = (t0.max(a.min(b)), t1.min(a.max(b)));
        }
        (t0 <= t1).then_some([t0, t1])
    }

    /// Where the ray meets a patch, if it comes near it between two parameters, and where it crosses its plane.
    #[inline(always)]
    fn meet(&self, patch: &Patch, [t0, t1]: [f64; 2]) -> Option<(f64, f64)> {
        let (rate, height) = (patch.normal.dot(self.d), patch.normal.dot(self.o) - patch.offset);
        let e = patch.deviation + 2.0 * self.pad;
        if rate == 0.0 {
            return (height.abs() <= e).then_some((t0, t0));
        }
        let crossed = -height / rate;
        let half = e / rate.abs();
        let (s0, s1) = (t0.max(crossed - half), t1.min(crossed + half));
        (s0 <= s1).then(|| (crossed.clamp(s0, s1), crossed))
    }

    /// Whether a node looks like a surface to this ray.
    #[inline(always)]
    fn is_surface(&self, patch: &Patch, bounds: &RootBox) -> bool {
        let (d, faces) = (self.d.abs(), bounds.faces());
        let seen = DVec3::from_array(patch.coverage) * faces;
        // The area that the ray sees of triangles that face all ways; and of such as face one.
        let scattered = d.dot(seen);
        let aligned = (self.d * patch.normal.signum()).dot(seen).abs();
        let coverage = aligned.max(scattered * (1.0 - patch.agreement)) / d.dot(faces);
        let facing = patch.normal.dot(self.d).abs() / self.d.length();
        let silhouette = patch.cone <= 0.0 || facing * facing < 1.0 - patch.cone * patch.cone;
        patch.agreement >= LEAST_AGREEMENT && coverage >= LEAST_COVERAGE[usize::from(silhouette)]
    }
}
