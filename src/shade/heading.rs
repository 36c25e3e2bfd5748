//! Directions that leave a surface: a mirrored or refracted ray's, after rounding, still leads away from the face.
//!
//! A direction is worked out in f64 and rounded to f32, once. At a grazing angle, below some 1e-7, that may turn it into the surface:
//! from its certified origin (see `origin`) the ray would pass the face's plane again further on, and be behind it from there. So the
//! rounded direction is *certified* as well: its product with the exact normal, as the object itself sees the ray, must have the sign
//! of the side on which the ray starts. If it has not, each component is rounded toward that side instead, by less than one step; if
//! that is not enough (an instance rounds again in its own space; f64 was off) the direction is lifted along the normal by 2^-24 of its
//! length, twice that, and so on. A ray that starts strictly on one side of a plane and does not turn toward it stays
//! there: exactly so for triangles, for planes as their own intersection has it. A ball's outside is left by directions that lie above the
//! tangent plane by 2^-40 or more: then both roots are behind the origin, which stands on the normal but for less than that where the ball
//! is much larger than its distance from the world's origin; where it is not, the origin lies above the horizon by far more. Inside, every
//! ray meets the ball again. Twenty lifts reach 1/32, more than any rounding; should none do, the nearest direction is taken.

use std::cmp::Ordering;

use glam::DVec3;

use super::object::Kind;
use super::ray::{Origin, Start, WorldRay, rounded};
use super::spot::{Anchor, Spot};
use super::world::World;
use crate::exact::heading;

/// How far above a ball's tangent plane directions must lie, as a sine.
const ABOVE: f64 = 1.0 / (1u64 << 40) as f64;
/// Lifts that are tried: doublings of 2^-24.
const MOST_LIFTS: i32 = 20;

impl World {
    /// `direction` with its components rounded to f32, such that a ray that leaves `spot` on the side that is seen (`near`) or on the
    /// other does not turn back toward it.
    pub(super) fn away(&self, spot: &Spot, near: bool, direction: DVec3) -> DVec3 {
        let nearest = rounded(direction);
        if self.leaves(spot, near, nearest) {
            return nearest;
        }
        let normal = if near { spot.normal } else { -spot.normal };
        let length = direction.length();
        let lifts = (0..MOST_LIFTS).map(|k| length * (f64::from(k - 24)).exp2());
        std::iter::once(0.0)
            .chain(lifts)
            .map(|lift| rounded_toward(direction + lift * normal, normal))
            .find(|&lifted| self.leaves(spot, near, lifted))
            .unwrap_or(nearest)
    }

    /// Whether a direction of f32 components leads away from the spot's surface.
    fn leaves(&self, spot: &Spot, near: bool, direction: DVec3) -> bool {
        let object = spot.omit.object;
        let front = spot.front == near;
        match (&spot.anchor, &self.objects[object as usize].kind) {
            (Anchor::Triangle { triangle, point }, kind) => {
                let to_local = if let Kind::Mesh(placed) = kind { placed.to_local.as_ref() } else { None };
                let origin = Origin { world: spot.point, start: Start { object, point: point.as_vec3() } };
                let seen = WorldRay::from(&origin, direction, f32::INFINITY).seen_by(object, to_local, f32::INFINITY);
                heading(triangle, seen.direction) == if front { Ordering::Greater } else { Ordering::Less }
            }
            (Anchor::Surrogate { .. }, _) => {
                let product = spot.normal.dot(direction);
                if near { product > 0.0 } else { product < 0.0 }
            }
            (Anchor::Smooth, Kind::Flat(flat)) => {
                let product = flat.normal.dot(direction);
                if front { product > 0.0 } else { product < 0.0 }
            }
            (Anchor::Smooth, _) => {
                let outward = if near { spot.normal } else { -spot.normal };
                !front || outward.dot(direction) > ABOVE * direction.length()
            }
        }
    }
}

/// Each component rounded to f32 in the direction in which the normal's points.
fn rounded_toward(v: DVec3, normal: DVec3) -> DVec3 {
    let component = |x: f64, n: f64| {
        let r = x as f32;
        f64::from(if n > 0.0 && f64::from(r) < x {
            r.next_up()
        } else if n < 0.0 && f64::from(r) > x {
            r.next_down()
        } else {
            r
        })
    };
    DVec3::new(component(v.x, normal.x), component(v.y, normal.y), component(v.z, normal.z))
}
