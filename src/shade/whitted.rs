//! The light at one surface: what a ray meets, what a lamp gives there, where a ray is mirrored and refracted to. `wave` follows
//! the rays.

use glam::DVec3;

use super::beam::{Beam, Bend};
use super::leave::{Blocker, Departure, Path};
use super::object::Contact;
use super::ray::{Omit, Origin, WorldRay};
use super::spot::Spot;
use super::world::World;
use crate::error::Result;
use crate::scene::{Color, Light};

/// A ray whose colour counts less than this (2^-20, in every channel) is not traced.
pub(super) const LEAST_WEIGHT: f64 = 1.0 / 1_048_576.0;
/// The end of a shadow ray, where the rounding of its direction hides on which side of the light a surface lies: 1 +- 2^-20.
pub(super) const AT_LIGHT: [f32; 2] = [1.0 - 8.0 * f32::EPSILON, 1.0 + 8.0 * f32::EPSILON];

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

/// A ray that is to be followed.
#[derive(Clone, Debug)]
pub(super) struct Ahead {
    pub ray: WorldRay,
    /// What it is known to meet at once.
    pub blocker: Option<Box<Blocker>>,
}

/// Where a ray met a surface, and how.
#[derive(Clone, Copy, Debug)]
pub(super) struct Meeting {
    pub spot: Spot,
    /// The unit direction in which the ray came.
    pub incoming: DVec3,
    /// How far back its way is known to be free.
    reach: f64,
    /// Where it began, if it is free all the way.
    origin: Option<DVec3>,
    /// How wide the ray was here.
    beam: Beam,
    /// How the surface is bent.
    bend: Bend,
}

impl Meeting {
    /// A ray that leaves from here, as wide as that.
    fn onward(&self, ray: WorldRay, beam: Beam) -> WorldRay {
        let tmin = self.spot.clear().map_or(ray.tmin, |clear| (clear / ray.direction.length()) as f32);
        WorldRay { tmin, beam, ..ray }
    }

    /// One that is mirrored.
    pub fn mirrored(&self, ray: WorldRay) -> WorldRay {
        self.onward(ray, self.beam.mirrored(self.bend))
    }

    /// One that is refracted.
    pub fn refracted(&self, ray: WorldRay) -> WorldRay {
        let Spot { ref surface, front, normal, .. } = self.spot;
        let eta = if front { 1.0 / surface.ior } else { surface.ior };
        let cosines = [self.incoming, ray.direction.normalize_or_zero()].map(|d| -d.dot(normal));
        self.onward(ray, self.beam.refracted(self.bend, eta, cosines))
    }

    /// One toward a light, which does not widen.
    pub fn lightward(&self, ray: WorldRay) -> WorldRay {
        self.onward(ray, self.beam.to_light())
    }

    /// The free space on the side from which the ray came (`near`), or behind the surface.
    pub fn path(&self, near: bool) -> Path {
        match near {
            true => Path { direction: -self.incoming, reach: Some(self.reach), origin: self.origin },
            false => Path { direction: self.incoming, reach: None, origin: None },
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

impl World {
    /// What a ray meets.
    pub(super) fn meet(&self, ahead: &Ahead) -> Result<Option<Meeting>> {
        if let Some(blocker) = &ahead.blocker {
            return self.meet_blocker(&ahead.ray, blocker).map(Some);
        }
        let contact = self.closest(&ahead.ray, Omit::NOTHING)?;
        contact.map(|contact| self.meet_contact(&ahead.ray, &contact)).transpose()
    }

    /// Where a ray met what it did.
    #[inline]
    pub(super) fn meet_contact(&self, ray: &WorldRay, contact: &Contact) -> Result<Meeting> {
        let spot = self.spot(contact, ray)?;
        let reach = (spot.point - ray.origin).length();
        Ok(Meeting {
            spot,
            incoming: ray.direction.normalize_or_zero(),
            reach,
            origin: Some(ray.origin),
            beam: Beam::at(ray, contact),
            bend: self.bend(&spot),
        })
    }

    /// Where a ray meets what it is known to meet at once.
    pub(super) fn meet_blocker(&self, ray: &WorldRay, blocker: &Blocker) -> Result<Meeting> {
        let Blocker { contact, segment } = blocker;
        // The segment came from the far side of the blocker, so that its rest lies on this side.
        let spot = self.spot(contact, segment)?.turned();
        let incoming = ray.direction.normalize_or_zero();
        let against = -segment.direction.normalize_or_zero();
        let incoming = if incoming.dot(spot.normal) < 0.0 { incoming } else { against };
        let reach = f64::from(segment.tmax - contact.t).max(0.0) * segment.direction.length();
        Ok(Meeting { spot, incoming, reach, origin: None, beam: ray.beam, bend: Bend::Gathering })
    }

    /// The diffuse and specular light that `light` gives if nothing lies between; zero for one behind the surface.
    pub(super) fn lit(&self, meeting: &Meeting, light: &Light) -> Color {
        let &Meeting { ref spot, incoming, .. } = meeting;
        let surface = &spot.surface;
        let (to_light, intensity) = match *light {
            Light::Point { position, color } => (position - spot.point, color),
            Light::Sun { direction, color } => (-direction, color),
        };
        let l = to_light.normalize_or_zero();
        let cosine = spot.shading.dot(l);
        if cosine <= 0.0 || spot.normal.dot(l) <= 0.0 {
            return Color::ZERO;
        }
        let mut lit = cosine * surface.diffuse;
        if surface.roughness > 0.0 {
            lit *= surface.facets(spot.shading, l, -incoming);
        }
        if surface.specular != Color::ZERO {
            let h = (l - incoming).normalize_or_zero();
            lit += spot.shading.dot(h).max(0.0).powf(surface.shininess) * surface.specular;
        }
        lit * intensity
    }

    /// Whether nothing stands before a point light, where something stands at its very end or before.
    #[cold]
    pub(super) fn reaches_past(&self, ray: &WorldRay, omit: Omit, light: DVec3) -> Result<bool> {
        if self.any(&ray.between(ray.tmin, AT_LIGHT[0]), omit)? {
            return Ok(false);
        }
        // What lies near the end is in the way if it lies before the light; not if the light lies on it.
        let end = ray.between(AT_LIGHT[0], AT_LIGHT[1]);
        Ok(!self.all(&end, omit)?.iter().any(|contact| self.apart(contact, ray, light).unwrap_or(false)))
    }
}

impl Departure {
    /// The ray in this direction; `None` where no point lies there to start from.
    pub(super) fn along(&self, direction: DVec3) -> Option<Ahead> {
        match self {
            Departure::Free(origin) => Some(Ahead::free(WorldRay::from(origin, direction, f32::INFINITY))),
            Departure::Blocked(blocker) => {
                let origin = Origin { world: blocker.segment.origin, start: blocker.segment.start };
                let ray = WorldRay::from(&origin, direction, f32::INFINITY);
                Some(Ahead { ray, blocker: Some(blocker.clone()) })
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
pub(super) fn refract(spot: &Spot, incoming: DVec3) -> Option<DVec3> {
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
    use crate::geometry::FaceId;
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
