//! Rays against an octree file: closest hit, any hit, and the triangles that touch a box.

use crate::error::Result;
use crate::format::PageId;
use crate::geometry::{Aabb, FaceId, Hit, Ray, Skip, Triangle};

/// A hit with where it is stored, so that attributes can be fetched.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Found {
    /// The hit as a caller sees it.
    pub hit: Hit,
    /// The triangle.
    pub triangle: Triangle,
    /// Its page.
    pub page: PageId,
    /// Its reference within the brick.
    pub reference: u32,
}

/// Something that answers rays exactly: the octree, or the linear reference.
///
/// Closest: the hit least by (exact t, face id) with the correctly rounded t in `[tmin, tmax]`. Both answers depend on the set of
/// triangles alone, never on how they are stored or walked.
pub trait Tracer: Send + Sync {
    /// The closest hit, leaving out `skip`.
    fn closest(&self, ray: &Ray, skip: Skip) -> Result<Option<Found>>;
    /// Whether anything is hit, leaving out `skip`.
    fn any(&self, ray: &Ray, skip: Skip) -> Result<bool>;
    /// Box around all triangles.
    fn bounds(&self) -> Aabb;
}

/// Work done, summed over rays; explains times.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Rays traced.
    pub rays: u64,
    /// Nodes visited.
    pub nodes: u64,
    /// Leaves visited.
    pub leaves: u64,
    /// Triangles tested.
    pub triangles: u64,
    /// Bricks entered.
    pub bricks: u64,
    /// Triangles whose f32 test was in doubt and went to f64.
    pub doubts: u64,
    /// Triangles that needed expansions.
    pub exact: u64,
}

#[doc(hidden)]
pub fn _unused(_: FaceId) {}
