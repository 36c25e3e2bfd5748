//! Leaving a surface: from the point that a ray met to a certified origin beside it.
//!
//! `origin` gives a point strictly on the wanted side of the surface itself. This file sees that no *other* surface lies
//! between: the segment from the origin back to the point is traced through the whole scene, leaving out the surface that
//! is left. It is traced backward because the origin is an exact f32 point and the other end then errs by 2^-24 of the
//! segment only, which itself is a few ulps long.
//!
//! The segment does not end in the point itself but a little way up the path, which is free: it is where the ray came from (or,
//! for a very little way, where it goes on to, through glass). A point on an edge is on neither side of the neighbour there, and
//! a segment to it from behind the neighbour would pass it by as often as not.
//!
//! A surface met toward the end of the segment may pass through the point (an edge, the other half of a rectangle, a twin
//! face), as far as f64 can tell. It separates the origin from the ray's path if the origin and the path lie on different sides
//! of it. The point itself may well lie behind it: on a ridge so flat (two triangles of a face whose corners were rounded) that the
//! segment's rounding decides which of the two it passes. In a crease that is sharper than the
//! origin's distance the way along the normal is blocked; then the origin is looked for along the path instead. Where
//! that is blocked too (sheets one ulp apart), the blocker is what the secondary ray meets first.

use glam::DVec3;

use super::object::{Contact, Kind, Part, strictly_on};
use super::origin::{normal_of, point_bound, step_off, triangle_bound};
use super::ray::{Origin, Start, WorldRay};
use super::spot::{Anchor, Spot};
use super::world::World;
use crate::error::Result;

/// How far up the path the segment ends, in parts of the origin's distance from the point: where the path is known to be free,
/// and where it is not.
const UP_THE_PATH: [f64; 2] = [1.0 / 1024.0, 1.0 / (1 << 18) as f64];
/// The last part of the segment, in parts of its length, in which a surface may pass through the point; it is traced as far beyond its end
/// too, since rounding moves what is met there.
const END: f64 = 1.0 / 256.0;
/// Segments shorter than this (2^-60) have their direction scaled up, so that f32 holds it with all its digits.
const SHORT: f64 = 1.0 / (1u64 << 60) as f64;
/// Most surfaces looked at on one segment.
const MOST_SHEETS: usize = 64;
/// Distances tried along the path, in error bounds.
const ALONG_PATH: [f64; 4] = [1.0, 4.0, 16.0, 64.0];

/// The free space at a spot: a direction of unit length that points from the spot into it, and how far it is known to be free,
/// if it is.
#[derive(Clone, Copy, Debug)]
pub(super) struct Path {
    pub direction: DVec3,
    pub reach: Option<f64>,
    /// Where the ray came from, if that is where it is free up to: an exact point.
    pub origin: Option<DVec3>,
}

/// How a surface is left.
pub(super) enum Departure {
    /// From this origin.
    Free(Origin),
    /// Not at all: something is met at once.
    Blocked(Box<Blocker>),
    /// Not at all: no f32 point lies there.
    Nowhere,
}

/// What a ray meets at once: it, and the segment that met it, traced from the far side of it.
#[derive(Clone, Debug)]
pub(super) struct Blocker {
    pub contact: Contact,
    pub segment: WorldRay,
}

/// One side of a surface.
pub(super) struct Side<'s> {
    spot: &'s Spot,
    /// Unit geometric normal on this side.
    normal: DVec3,
    /// Whether this is the front.
    front: bool,
}

impl Spot {
    /// The side that is seen (`near`), or the other.
    pub(super) fn side(&self, near: bool) -> Side<'_> {
        Side { spot: self, normal: if near { self.normal } else { -self.normal }, front: self.front == near }
    }
}

impl World {
    /// An origin on the side of `spot` that is seen (`near`) or on the other; `path` leads from the spot into the free space of
    /// that side, along the ray that met it.
    pub(super) fn leave(&self, spot: &Spot, near: bool, path: Path) -> Result<Departure> {
        let side = spot.side(near);
        let Some((origin, segment)) = self.first_origin(&side, path) else { return Ok(Departure::Nowhere) };
        if spot.clear().is_some() {
            return Ok(Departure::Free(origin));
        }
        match self.any(&segment, spot.omit)? {
            false => Ok(Departure::Free(origin)),
            true => self.leave_past(&side, origin, path),
        }
    }

    /// The origin that is tried first, and the segment on which nothing may lie; `None` if there is no f32 point.
    ///
    /// The shift leans from the normal toward the path: along the normal alone an origin beside an edge would stay in the
    /// plane of a neighbour at a right angle.
    #[inline]
    pub(super) fn first_origin(&self, side: &Side<'_>, path: Path) -> Option<(Origin, WorldRay)> {
        let origin = self.beside(side, side.normal + path.direction, 1.0)?;
        let Segment { ray: segment, .. } = segment(side, &origin, path);
        Some((origin, segment))
    }

    /// The departure where something lies on the segment of the origin tried first.
    #[cold]
    pub(super) fn leave_past(&self, side: &Side<'_>, first: Origin, path: Path) -> Result<Departure> {
        let Some(blocker) = self.blocker(side, &first, path)? else { return Ok(Departure::Free(first)) };
        for times in ALONG_PATH {
            if let Some(origin) = self.beside(side, path.direction, times)
                && self.blocker(side, &origin, path)?.is_none()
            {
                return Ok(Departure::Free(origin));
            }
        }
        Ok(Departure::Blocked(Box::new(blocker)))
    }

    /// A point certified to lie strictly on the side that is left, from the spot's point along `along` (world space).
    #[inline]
    fn beside(&self, side: &Side<'_>, along: DVec3, times: f64) -> Option<Origin> {
        let Side { spot, front, .. } = *side;
        let object = spot.omit.object;
        let free = |world| Origin { world, start: Start { object, point: world.as_vec3() } };
        let along = along.try_normalize()?;
        match (&spot.anchor, &self.objects[object as usize].kind) {
            (Anchor::Triangle { triangle, point }, kind) => {
                let placed = match kind {
                    Kind::Mesh(placed) if placed.to_local.is_some() => Some(placed),
                    _ => None,
                };
                let along = placed.and_then(|p| p.to_local).map_or(along, |m| m.transform_vector3(along));
                let along = along.try_normalize()?;
                let certified = |o| strictly_on(triangle, o, front);
                let o = step_off(*point, along, triangle_bound(triangle, *point), times, certified)?;
                let world = placed.map_or(o.as_dvec3(), |p| p.to_world.transform_point3(o.as_dvec3()));
                Some(Origin { world, start: Start { object, point: o } })
            }
            (&Anchor::Surrogate { lift, .. }, _) => {
                // Above all that it stands for, and by no less than the point may be off.
                let bound = point_bound(spot.point).length();
                Some(free(super::ray::rounded(spot.point + side.normal * (lift + 4.0 * bound))))
            }
            (Anchor::Smooth, kind) => {
                let certified = |o: glam::Vec3| {
                    let side = match kind {
                        Kind::Ball(ball) => ball.side(o.as_dvec3()),
                        Kind::Flat(flat) => flat.side(o.as_dvec3()),
                        _ => 0.0,
                    };
                    if front { side > 0.0 } else { side < 0.0 }
                };
                step_off(spot.point, along, point_bound(spot.point), times, certified).map(|o| free(o.as_dvec3()))
            }
        }
    }

    /// The surface nearest to the spot that lies between it and `origin`, and the segment that found it.
    fn blocker(&self, side: &Side<'_>, origin: &Origin, path: Path) -> Result<Option<Blocker>> {
        let Segment { ray: whole, end, target } = segment(side, origin, path);
        // Where a ray came all the way up to here, the segment's end is known to be on the right side of everything.
        let free = if path.origin.is_some() { target } else { side.spot.point };
        let (mut left, mut blocker) = (whole, None);
        for _ in 0..MOST_SHEETS {
            let Some(contact) = self.closest(&left, side.spot.omit)? else { break };
            let at_end = f64::from(contact.t) >= (1.0 - END) * end;
            if !at_end || self.separates(&contact, &whole, free, side.spot.point, path.direction)? {
                blocker = Some(Blocker { contact, segment: whole });
            }
            left.tmin = contact.t.next_up();
        }
        Ok(blocker)
    }

    /// Whether the surface at `contact` lies between the segment's origin and `free`; if it passes through that, whether
    /// between the origin and what lies along `path` from the spot's point.
    fn separates(&self, contact: &Contact, segment: &WorldRay, free: DVec3, point: DVec3, path: DVec3) -> Result<bool> {
        if let Some(apart) = self.apart(contact, segment, free) {
            return Ok(apart);
        }
        let (a, b) = (segment.origin - point, path);
        let normal = match (&contact.part, &self.objects[contact.object as usize].kind) {
            (Part::Mesh(found), Kind::Mesh(placed)) => placed.normals * normal_of(&found.triangle),
            _ => self.spot(contact, segment)?.normal,
        };
        Ok(normal.dot(a) * normal.dot(b) < 0.0)
    }
}

/// The segment from an origin back to the spot and a little way up the path.
struct Segment {
    ray: WorldRay,
    /// The parameter of its end.
    end: f64,
    /// The point there, before rounding.
    target: DVec3,
}

#[inline]
fn segment(side: &Side<'_>, origin: &Origin, path: Path) -> Segment {
    let point = side.spot.point;
    let distance = (point - origin.world).length();
    let target = match path {
        // So short a way leads to a point that rounding would move past its neighbours; where it began is exact.
        Path { reach: Some(reach), origin: Some(from), .. } if reach / 2.0 < distance * UP_THE_PATH[0] => from,
        Path { reach: Some(reach), .. } => point + path.direction * (distance * UP_THE_PATH[0]).min(reach / 2.0),
        Path { reach: None, .. } => point + path.direction * (distance * UP_THE_PATH[1]),
    };
    let back = target - origin.world;
    let scale = if back.abs().max_element() < SHORT { (1u64 << 60) as f64 } else { 1.0 };
    let end = 1.0 / scale;
    Segment { ray: WorldRay::from(origin, back * scale, ((1.0 + END) * end) as f32), end, target }
}
