//! The colour of a ray, and of the rays it gives rise to (Whitted, "An improved illumination model for shaded display",
//! 1980), with an explicit stack.

use glam::DVec3;

use super::leave::{Departure, Path};
use super::object::Contact;
use super::ray::{Omit, Origin, WorldRay};
use super::spot::Spot;
use super::world::World;
use crate::error::Result;
use crate::geometry::FaceId;
use crate::scene::{Color, Light};

/// A ray whose colour counts less than this (2^-20, in every channel) is not traced.
const LEAST_WEIGHT: f64 = 1.0 / 1_048_576.0;
/// The end of a shadow ray, where the rounding of its direction hides on which side of the light a surface lies: 1 +- 2^-20.
const AT_LIGHT: [f32; 2] = [1.0 - 8.0 * f32::EPSILON, 1.0 + 8.0 * f32::EPSILON];

/// Rays by what they are for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RayCounts {
    /// From the eye.
    pub primary: u64,
    /// Toward a light.
    pub shadow: u64,
    /// Mirrored, total reflection included.
    pub mirror: u64,
    /// Refracted.
    pub refracted: u64,
}

impl std::ops::AddAssign for RayCounts {
    fn add_assign(&mut self, other: RayCounts) {
        self.primary += other.primary;
        self.shadow += other.shadow;
        self.mirror += other.mirror;
        self.refracted += other.refracted;
    }
}

/// Working space of one thread, and what it has counted.
#[derive(Debug)]
pub struct Scratch {
    stack: Vec<Pending>,
    /// Most bounces.
    depth: u32,
    /// Rays traced.
    pub rays: RayCounts,
}

impl Scratch {
    /// For rays of at most `depth` bounces.
    pub fn new(depth: u32) -> Scratch {
        Scratch { stack: Vec::new(), depth, rays: RayCounts::default() }
    }
}

/// A ray that is to be followed.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ahead {
    pub ray: WorldRay,
    /// What the ray is known to meet at once, and the segment that met it from behind.
    blocker: Option<(Contact, WorldRay)>,
}

/// Where a ray met a surface, and how.
#[derive(Clone, Copy, Debug)]
pub(super) struct Meeting {
    pub spot: Spot,
    /// The unit direction in which the ray came.
    pub incoming: DVec3,
    /// How far back its way is known to be free.
    reach: f64,
}

impl Meeting {
    /// The free space on the side from which the ray came (`near`), or behind the surface.
    pub fn path(&self, near: bool) -> Path {
        match near {
            true => Path { direction: -self.incoming, reach: Some(self.reach) },
            false => Path { direction: self.incoming, reach: None },
        }
    }
}

impl Ahead {
    /// A ray that may meet anything.
    pub fn free(ray: WorldRay) -> Ahead {
        Ahead { ray, blocker: None }
    }

    /// Whether it is not known yet what the ray meets.
    pub fn is_free(&self) -> bool {
        self.blocker.is_none()
    }
}

/// A ray that is still to be followed, and what its colour counts.
#[derive(Debug)]
struct Pending {
    ahead: Ahead,
    weight: Color,
    bounces: u32,
}

impl World {
    /// The colour along a ray from the eye, linear.
    pub fn color(&self, ray: WorldRay, scratch: &mut Scratch) -> Result<Color> {
        scratch.rays.primary += 1;
        scratch.stack.clear();
        scratch.stack.push(Pending { ahead: Ahead::free(ray), weight: Color::ONE, bounces: 0 });
        let mut sum = Color::ZERO;
        while let Some(pending) = scratch.stack.pop() {
            sum += match self.meet(&pending.ahead)? {
                None => pending.weight * self.scene.background,
                Some(meeting) => self.shade(&meeting, &pending, scratch)?,
            };
        }
        Ok(sum)
    }

    /// What a ray meets.
    pub(super) fn meet(&self, ahead: &Ahead) -> Result<Option<Meeting>> {
        let along = |ray: &WorldRay| ray.direction.normalize_or_zero();
        let Some((contact, segment)) = &ahead.blocker else {
            let Some(contact) = self.closest(&ahead.ray, Omit::NOTHING)? else { return Ok(None) };
            let spot = self.spot(&contact, &ahead.ray)?;
            let reach = (spot.point - ahead.ray.origin).length();
            return Ok(Some(Meeting { spot, incoming: along(&ahead.ray), reach }));
        };
        // The segment came from the far side of the blocker, so that its rest lies on this side.
        let spot = self.spot(contact, segment)?.turned();
        let incoming = along(&ahead.ray);
        let incoming = if incoming.dot(spot.normal) < 0.0 { incoming } else { -along(segment) };
        let reach = f64::from(segment.tmax - contact.t).max(0.0) * segment.direction.length();
        Ok(Some(Meeting { spot, incoming, reach }))
    }

    /// The light that leaves `spot` against `incoming`, weighted, but for the rays that it puts on the stack.
    fn shade(&self, meeting: &Meeting, pending: &Pending, scratch: &mut Scratch) -> Result<Color> {
        let &Meeting { ref spot, incoming, .. } = meeting;
        let surface = &spot.surface;
        let mut near = None;
        let mut color = Color::ZERO;
        if surface.local != 0.0 {
            color += self.local(meeting, &mut near, scratch)? * surface.local;
        }
        let refracted = if surface.transmit == 0.0 { None } else { refract(spot, incoming) };
        let mut mirrored = surface.reflect;
        match refracted {
            Some(direction) => {
                let weight = Color::splat(surface.transmit);
                color += self.secondary(meeting, direction, weight, false, &mut None, pending, scratch)?;
            }
            // Total reflection: the transmitted part is mirrored too.
            None => mirrored += Color::splat(surface.transmit),
        }
        if mirrored != Color::ZERO {
            let direction = mirror(spot, incoming);
            color += self.secondary(meeting, direction, mirrored, true, &mut near, pending, scratch)?;
        }
        Ok(pending.weight * color)
    }

    /// Ambient, diffuse and specular light.
    fn local(&self, meeting: &Meeting, near: &mut Option<Departure>, scratch: &mut Scratch) -> Result<Color> {
        let &Meeting { ref spot, incoming, .. } = meeting;
        let surface = &spot.surface;
        let mut color = self.scene.ambient * surface.ambient;
        for light in &self.scene.lights {
            let (to_light, intensity) = match *light {
                Light::Point { position, color } => (position - spot.point, color),
                Light::Sun { direction, color } => (-direction, color),
            };
            let l = to_light.normalize_or_zero();
            let cosine = spot.shading.dot(l);
            if cosine <= 0.0 || spot.normal.dot(l) <= 0.0 {
                continue;
            }
            let mut lit = cosine * surface.diffuse;
            if surface.specular != Color::ZERO {
                let h = (l - incoming).normalize_or_zero();
                lit += spot.shading.dot(h).max(0.0).powf(surface.shininess) * surface.specular;
            }
            let lit = lit * intensity;
            if lit != Color::ZERO && self.reaches(meeting, light, near, scratch)? {
                color += lit;
            }
        }
        Ok(color)
    }

    /// Whether nothing stands between the spot and the light.
    fn reaches(
        &self,
        meeting: &Meeting,
        light: &Light,
        near: &mut Option<Departure>,
        scratch: &mut Scratch,
    ) -> Result<bool> {
        let Departure::Free(origin) = self.departure(meeting, true, near)? else { return Ok(false) };
        // The light lies above the face, so the face itself is not in its way; a ball may be in its own.
        let omit = if meeting.spot.omit.face == FaceId::NONE { Omit::NOTHING } else { meeting.spot.omit };
        scratch.rays.shadow += 1;
        match *light {
            Light::Sun { direction, .. } => Ok(!self.any(&WorldRay::from(origin, -direction, f32::INFINITY), omit)?),
            Light::Point { position, .. } => {
                let ray = WorldRay::from(origin, position - origin.world, AT_LIGHT[0]);
                if self.any(&ray, omit)? {
                    return Ok(false);
                }
                let end = ray.between(AT_LIGHT[0], AT_LIGHT[1]);
                Ok(!self.any(&end, omit)? || !self.all(&end, omit)?.iter().any(|c| self.before(c, &ray, position)))
            }
        }
    }

    /// Whether what a shadow ray meets near its end lies before the light; not if the light lies on it.
    fn before(&self, contact: &Contact, ray: &WorldRay, light: DVec3) -> bool {
        self.apart(contact, ray, light).unwrap_or(false)
    }

    /// Puts a mirrored (`near`) or refracted ray on the stack, or returns what it counts without being traced.
    #[allow(clippy::too_many_arguments)]
    fn secondary(
        &self,
        meeting: &Meeting,
        direction: DVec3,
        weight: Color,
        near: bool,
        departure: &mut Option<Departure>,
        pending: &Pending,
        scratch: &mut Scratch,
    ) -> Result<Color> {
        let total = pending.weight * weight;
        if pending.bounces >= scratch.depth || total.abs().max_element() < LEAST_WEIGHT {
            return Ok(weight * self.scene.background);
        }
        let direction = self.away(&meeting.spot, near, direction);
        let Some(ahead) = self.departure(meeting, near, departure)?.along(direction) else {
            return Ok(weight * self.scene.background);
        };
        *(if near { &mut scratch.rays.mirror } else { &mut scratch.rays.refracted }) += 1;
        scratch.stack.push(Pending { ahead, weight: total, bounces: pending.bounces + 1 });
        Ok(Color::ZERO)
    }

    /// The departure from one side of a spot, found once.
    fn departure<'d>(&self, meeting: &Meeting, near: bool, known: &'d mut Option<Departure>) -> Result<&'d Departure> {
        if known.is_none() {
            *known = Some(self.leave(&meeting.spot, near, meeting.path(near))?);
        }
        Ok(known.as_ref().unwrap_or(&Departure::Nowhere))
    }
}

impl Departure {
    /// The ray in this direction; `None` where no point lies there to start from.
    pub(super) fn along(&self, direction: DVec3) -> Option<Ahead> {
        match self {
            Departure::Free(origin) => Some(Ahead::free(WorldRay::from(origin, direction, f32::INFINITY))),
            Departure::Blocked(contact, segment) => {
                let origin = Origin { world: segment.origin, start: segment.start };
                let ray = WorldRay::from(&origin, direction, f32::INFINITY);
                Some(Ahead { ray, blocker: Some((*contact, *segment)) })
            }
            Departure::Nowhere => None,
        }
    }
}

/// The mirrored direction; about the geometric normal where the shading normal would send it below the surface.
pub(super) fn mirror(spot: &Spot, incoming: DVec3) -> DVec3 {
    let about = |n: DVec3| incoming - 2.0 * incoming.dot(n) * n;
    let direction = about(spot.shading);
    if direction.dot(spot.normal) > 0.0 { direction } else { about(spot.normal) }
}

/// The refracted direction by Snell's law, `None` at total reflection.
fn refract(spot: &Spot, incoming: DVec3) -> Option<DVec3> {
    let ior = spot.surface.ior;
    let eta = if spot.front { 1.0 / ior } else { ior };
    let about = |n: DVec3| {
        let cosine = -incoming.dot(n);
        let square = 1.0 - eta * eta * (1.0 - cosine * cosine);
        // Also `None` for an index of refraction that is zero or no number.
        (square >= 0.0 && eta.is_finite()).then(|| eta * incoming + (eta * cosine - square.sqrt()) * n)
    };
    // About the geometric normal where the shading normal would send the ray back above the surface.
    let shaded = if incoming.dot(spot.shading) < 0.0 { about(spot.shading)? } else { DVec3::ZERO };
    if shaded.dot(spot.normal) < 0.0 { Some(shaded) } else { about(spot.normal) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shade::Surface;
    use crate::shade::spot::Anchor;

    fn glass(front: bool) -> Spot {
        let material = crate::scene::Material { transmit: 1.0, ior: 1.5, ..Default::default() };
        Spot {
            omit: Omit { object: 0, face: FaceId(0) },
            point: DVec3::ZERO,
            normal: DVec3::Y,
            shading: DVec3::Y,
            front,
            surface: Surface::from(&material),
            anchor: Anchor::Smooth,
        }
    }

    #[test]
    fn snell() {
        let incoming = DVec3::new(0.6, -0.8, 0.0);
        let inside = refract(&glass(true), incoming).unwrap();
        assert!((inside.length() - 1.0).abs() < 1e-12 && (inside.x - 0.4).abs() < 1e-12 && inside.y < 0.0);
        // Back out by the same angle.
        let out = refract(&glass(false), inside).unwrap();
        assert!((out - incoming).length() < 1e-12);
        // A shading normal leaning toward the ray sends it up again: the geometric one decides.
        let mut leaning = glass(true);
        leaning.shading = DVec3::new(-1.0, 0.01, 0.0).normalize();
        let grazing = DVec3::new(1.0, -0.01, 0.0).normalize();
        assert!(refract(&leaning, grazing).unwrap().dot(DVec3::Y) < 0.0);
        leaning.shading = DVec3::new(-0.2, 1.0, 0.0).normalize();
        assert!(refract(&leaning, incoming).unwrap().dot(DVec3::Y) < 0.0);
        // sin = 0.8 > 1/1.5.
        assert_eq!(refract(&glass(false), DVec3::new(0.8, -0.6, 0.0)), None);
    }

    #[test]
    fn mirror_stays_above_the_surface() {
        let mut spot = glass(true);
        let incoming = DVec3::new(1.0, -0.1, 0.0).normalize();
        assert!((mirror(&spot, incoming) - DVec3::new(1.0, 0.1, 0.0).normalize()).length() < 1e-12);
        spot.shading = DVec3::new(0.5, 1.0, 0.0).normalize();
        assert!(mirror(&spot, incoming).dot(DVec3::Y) > 0.0);
        spot.shading = DVec3::new(-0.9, 0.1, 0.0).normalize();
        assert!(mirror(&spot, incoming).dot(DVec3::Y) > 0.0);
    }
}
