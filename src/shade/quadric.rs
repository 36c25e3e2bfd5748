//! Spheres and planes, in f64.
//!
//! The sphere's roots are those of Haines, Günther and Akenine-Möller ("Precision improvements for ray/sphere
//! intersection", Ray Tracing Gems 2019, ch. 7): the discriminant from the line's distance to the centre, and the second
//! root from the product of both. [`Ball::side`] is the very expression `c` whose sign decides that product's sign, so an
//! origin certified to be outside, with a ray that leaves, has two negative roots: no epsilon.

use glam::{DAffine3, DVec3};

/// 2^-53.
const U: f64 = f64::EPSILON / 2.0;

/// A sphere, or an ellipsoid by its transform.
#[derive(Clone, Debug)]
pub(super) struct Ball {
    pub center: DVec3,
    pub radius: f64,
    /// World to the sphere's space; `None` = the same.
    pub to_local: Option<DAffine3>,
    pub to_world: DAffine3,
}

/// An unbounded plane.
#[derive(Clone, Debug)]
pub(super) struct Flat {
    pub point: DVec3,
    /// Unit normal.
    pub normal: DVec3,
}

impl Ball {
    fn local(&self, p: DVec3) -> DVec3 {
        self.to_local.map_or(p, |m| m.transform_point3(p)) - self.center
    }

    /// Positive where `p` (world) is outside, negative inside, 0 where the error bound cannot tell.
    pub fn side(&self, p: DVec3) -> f64 {
        let f = self.local(p);
        let (square, radius) = (f.length_squared(), self.radius * self.radius);
        let c = square - radius;
        if c.abs() <= 8.0 * U * (square + radius) { 0.0 } else { c }
    }

    /// The least root in `[tmin, tmax]`, compared as rounded to f32.
    pub fn root(&self, origin: DVec3, direction: DVec3, tmin: f32, tmax: f32) -> Option<f64> {
        let f = self.local(origin);
        let d = self.to_local.map_or(direction, |m| m.transform_vector3(direction));
        let a = d.length_squared();
        let b = -f.dot(d);
        let nearest = f + d * (b / a);
        let discriminant = self.radius * self.radius - nearest.length_squared();
        // A NaN (zero direction) is a miss as well.
        if discriminant.is_nan() || discriminant < 0.0 {
            return None;
        }
        let c = f.length_squared() - self.radius * self.radius;
        let q = b + (a * discriminant).sqrt().copysign(b);
        let (first, second) = (c / q, q / a);
        let (near, far) = if second < first { (second, first) } else { (first, second) };
        [near, far].into_iter().find(|&t| within(t, tmin, tmax))
    }

    /// The point of the surface nearest to the computed `p`, and the unit normal there, outward; both in world space.
    pub fn touch(&self, p: DVec3) -> (DVec3, DVec3) {
        let outward = self.local(p).normalize_or(DVec3::X);
        let local = self.center + outward * self.radius;
        match &self.to_local {
            None => (local, outward),
            Some(m) => {
                let normal = m.matrix3.transpose() * outward;
                (self.to_world.transform_point3(local), normal.normalize_or(outward))
            }
        }
    }
}

impl Flat {
    /// Positive on the side to which the normal points, 0 where the error bound cannot tell.
    pub fn side(&self, p: DVec3) -> f64 {
        let s = self.normal.dot(p - self.point);
        let bound = 4.0 * U * self.normal.abs().dot(p.abs() + self.point.abs());
        if s.abs() <= bound { 0.0 } else { s }
    }

    /// The root, if it lies in `[tmin, tmax]` as rounded to f32; a parallel ray misses.
    pub fn root(&self, origin: DVec3, direction: DVec3, tmin: f32, tmax: f32) -> Option<f64> {
        let t = -self.normal.dot(origin - self.point) / self.normal.dot(direction);
        (t.is_finite() && within(t, tmin, tmax)).then_some(t)
    }

    /// The point of the plane nearest to `p`.
    pub fn touch(&self, p: DVec3) -> DVec3 {
        p - self.normal * self.normal.dot(p - self.point)
    }
}

/// Whether the rounded t lies in the closed interval; false for a NaN.
fn within(t: f64, tmin: f32, tmax: f32) -> bool {
    let t = t as f32;
    t >= tmin && t <= tmax
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ball(center: DVec3, radius: f64) -> Ball {
        Ball { center, radius, to_local: None, to_world: DAffine3::IDENTITY }
    }

    #[test]
    fn small_far_sphere_keeps_its_digits() {
        // The textbook formula loses the discriminant here: distance 1e7, radius 1e-2.
        let b = ball(DVec3::new(0.0, 0.0, 1e7), 1e-2);
        let t = b.root(DVec3::ZERO, DVec3::new(0.0, 0.0, 1.0), 0.0, f32::INFINITY).unwrap();
        assert!((t - (1e7 - 1e-2)).abs() < 1e-8, "{t}");
        assert!(b.root(DVec3::ZERO, DVec3::new(1.1e-9, 0.0, 1.0), 0.0, f32::INFINITY).is_none());
        assert!(b.root(DVec3::ZERO, DVec3::new(0.9e-9, 0.0, 1.0), 0.0, f32::INFINITY).is_some());
    }

    #[test]
    fn leaving_rays_do_not_come_back() {
        let b = ball(DVec3::ZERO, 1.0);
        let o = DVec3::new(0.0, 1.0 + 1e-7, 0.0);
        assert!(b.side(o) > 0.0);
        for d in [DVec3::Y, DVec3::new(1.0, 1e-9, 0.0), DVec3::new(-3.0, 0.1, 2.0)] {
            assert_eq!(b.root(o, d, 0.0, f32::INFINITY), None);
        }
        let inside = DVec3::new(0.0, 1.0 - 1e-7, 0.0);
        assert!(b.side(inside) < 0.0);
        let t = b.root(inside, DVec3::NEG_Y, 0.0, f32::INFINITY).unwrap();
        assert!((t - 2.0).abs() < 1e-6);
        assert_eq!(b.side(DVec3::Y), 0.0);
    }

    #[test]
    fn plane_is_met_once_and_never_when_parallel() {
        let p = Flat { point: DVec3::new(5.0, 1.0, 7.0), normal: DVec3::Y };
        assert_eq!(p.root(DVec3::ZERO, DVec3::Y, 0.0, f32::INFINITY), Some(1.0));
        assert_eq!(p.root(DVec3::ZERO, DVec3::X, 0.0, f32::INFINITY), None);
        assert_eq!(p.root(DVec3::Y, DVec3::X, 0.0, f32::INFINITY), None);
        assert_eq!(p.root(DVec3::ZERO, DVec3::NEG_Y, 0.0, f32::INFINITY), None);
        assert!(p.side(DVec3::ZERO) < 0.0);
    }
}
