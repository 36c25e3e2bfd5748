//! Rays in world space, and how an object of the scene sees them.

use glam::{DAffine3, DVec3, Vec3};

use super::beam::Beam;
use crate::geometry::{FaceId, Ray};

/// No object.
pub(super) const NOBODY: u32 = u32::MAX;

/// A ray in world space: points `origin + t * direction` with t in the closed interval `[tmin, tmax]`.
///
/// The direction's components are f32 values (rounded once, when the ray was made), so that every object that stands
/// where its mesh was modelled sees the very same ray.
#[derive(Clone, Copy, Debug)]
pub struct WorldRay {
    pub(super) origin: DVec3,
    pub(super) direction: DVec3,
    pub(super) tmin: f32,
    pub(super) tmax: f32,
    /// The object on which the ray starts, and the certified origin in that object's space.
    pub(super) start: Start,
    /// How wide it is.
    pub(super) beam: Beam,
}

/// Where a secondary ray starts, in the space of the object that it leaves.
#[derive(Clone, Copy, Debug)]
pub(super) struct Start {
    pub object: u32,
    pub point: Vec3,
}

/// What a query leaves out: one face of one object (the whole object if it has no faces).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Omit {
    pub(super) object: u32,
    pub(super) face: FaceId,
}

impl Omit {
    /// Leaves nothing out.
    pub const NOTHING: Omit = Omit { object: NOBODY, face: FaceId::NONE };
}

impl WorldRay {
    /// A ray over `t >= 0` from a free point; origin and direction are rounded to f32, once.
    #[inline]
    pub fn new(origin: DVec3, direction: DVec3) -> WorldRay {
        let start = Start { object: NOBODY, point: Vec3::ZERO };
        WorldRay {
            origin: rounded(origin),
            direction: rounded(direction),
            tmin: 0.0,
            tmax: f32::INFINITY,
            start,
            beam: Beam::LINE,
        }
    }

    /// A ray over `[0, tmax]` from a certified origin; the direction is rounded to f32, once.
    pub(super) fn from(origin: &Origin, direction: DVec3, tmax: f32) -> WorldRay {
        WorldRay {
            origin: origin.world,
            direction: rounded(direction),
            tmin: 0.0,
            tmax,
            start: origin.start,
            beam: Beam::LINE,
        }
    }

    /// The same ray over `[tmin, tmax]`.
    pub fn between(self, tmin: f32, tmax: f32) -> WorldRay {
        WorldRay { tmin, tmax, ..self }
    }

    /// The origin. An exact f32 point if the ray starts at an eye or beside a surface that is not transformed.
    pub fn origin(&self) -> DVec3 {
        self.origin
    }

    /// The direction, components exact in f32.
    pub fn direction(&self) -> DVec3 {
        self.direction
    }

    /// The ray as `object` sees it, up to `tmax`: transformed in f64, rounded once; the direction keeps its length's
    /// meaning, so that t is the same number everywhere.
    #[inline(always)]
    pub(super) fn seen_by(&self, object: u32, to_local: Option<&DAffine3>, tmax: f32) -> Ray {
        let (origin, direction) = match to_local {
            None => (self.origin.as_vec3(), self.direction.as_vec3()),
            Some(m) => (m.transform_point3(self.origin).as_vec3(), m.transform_vector3(self.direction).as_vec3()),
        };
        let origin = if self.start.object == object { self.start.point } else { origin };
        Ray { origin: origin.to_array(), direction: direction.to_array(), tmin: self.tmin, tmax }
    }
}

/// A point from which a secondary ray may start.
#[derive(Clone, Copy, Debug)]
pub(super) struct Origin {
    pub world: DVec3,
    pub start: Start,
}

/// Each component rounded to f32.
pub(super) fn rounded(v: DVec3) -> DVec3 {
    v.as_vec3().as_dvec3()
}
