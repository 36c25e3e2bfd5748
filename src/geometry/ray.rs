//! Rays, hits and face numbers, in the byte layout that octtrace reads and writes.

use bytemuck::{Pod, Zeroable};

/// The number of a triangle in its source: faces in order, polygons counted as fans.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Pod, Zeroable)]
#[repr(transparent)]
pub struct FaceId(pub u32);

impl FaceId {
    /// No face.
    pub const NONE: FaceId = FaceId(u32::MAX);
}

/// A ray: points `origin + t * direction` with t in the closed interval `[tmin, tmax]`; 32 bytes.
///
/// The direction need not be of unit length. Negative `tmin` and infinite `tmax` are legal. A ray with a NaN, an
/// infinite origin or direction, a zero direction, or `tmin > tmax` hits nothing.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Ray {
    /// Origin.
    pub origin: [f32; 3],
    /// Direction, any length.
    pub direction: [f32; 3],
    /// Least t.
    pub tmin: f32,
    /// Greatest t.
    pub tmax: f32,
}

impl Ray {
    /// A ray over `t >= 0`.
    pub fn new(origin: impl Into<[f32; 3]>, direction: impl Into<[f32; 3]>) -> Ray {
        Ray { origin: origin.into(), direction: direction.into(), tmin: 0.0, tmax: f32::INFINITY }
    }

    /// The same ray over `[tmin, tmax]`.
    pub fn between(self, tmin: f32, tmax: f32) -> Ray {
        Ray { tmin, tmax, ..self }
    }

    /// Whether the ray can hit anything at all (see the type's documentation).
    #[inline]
    pub fn is_valid(&self) -> bool {
        // All parts are looked at, without a branch in between.
        let finite = |v: [f32; 3]| v[0].is_finite() & v[1].is_finite() & v[2].is_finite();
        let [x, y, z] = self.direction;
        let direction = (x != 0.0) | (y != 0.0) | (z != 0.0);
        finite(self.origin) & finite(self.direction) & direction & (self.tmin <= self.tmax)
    }
}

/// What a ray hit; 16 bytes. The point is `(1 - u - v) a + u b + v c`.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Hit {
    /// Distance in units of the direction's length; infinite for a miss.
    pub t: f32,
    /// The face, [`FaceId::NONE`] for a miss.
    pub face: FaceId,
    /// Weight of the second corner.
    pub u: f32,
    /// Weight of the third corner.
    pub v: f32,
}

impl Hit {
    /// Nothing was hit.
    pub const MISS: Hit = Hit { t: f32::INFINITY, face: FaceId::NONE, u: 0.0, v: 0.0 };

    /// Whether something was hit.
    pub fn is_hit(&self) -> bool {
        self.face != FaceId::NONE
    }
}

/// Up to two triangles that a ray leaves out: the one it starts on, the one it ends on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Skip(pub [FaceId; 2]);

impl Skip {
    /// Leaves nothing out.
    pub const NONE: Skip = Skip([FaceId::NONE; 2]);

    /// Leaves one triangle out.
    pub fn one(face: FaceId) -> Skip {
        Skip([face, FaceId::NONE])
    }

    /// Whether `face` is left out.
    pub fn has(&self, face: FaceId) -> bool {
        self.0[0] == face || self.0[1] == face
    }
}
