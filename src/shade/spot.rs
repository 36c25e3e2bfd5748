//! What is known about the place that a ray met: point, normals, side, surface.

use glam::{DVec3, Vec3};

use super::beam::least_scale;
use super::material::Surface;
use super::object::{Contact, Kind, Part, Placed};
use super::origin;
use super::ray::{Omit, WorldRay};
use super::world::World;
use crate::error::Result;
use crate::exact;
use crate::geometry::{FaceId, Triangle};
use crate::trace::{Approximate, Found};

/// A place on a surface, seen from one of its sides.
#[derive(Clone, Copy, Debug)]
pub(super) struct Spot {
    /// Names the face, so that it can be left out.
    pub omit: Omit,
    /// The point, world space.
    pub point: DVec3,
    /// Unit geometric normal on the side that is seen.
    pub normal: DVec3,
    /// Unit normal to shade with, in the same half space.
    pub shading: DVec3,
    /// Whether the front is seen.
    pub front: bool,
    /// What it looks like.
    pub surface: Surface,
    /// What an origin beside it is certified against.
    pub anchor: Anchor,
}

/// The surface in the object's own space.
#[derive(Clone, Copy, Debug)]
pub(super) enum Anchor {
    /// A triangle and the point on it.
    Triangle { triangle: Triangle, point: DVec3 },
    /// A sphere or plane: the point is the world's.
    Smooth,
    /// A surrogate; distances are the world's.
    Surrogate {
        /// Up to here something may stand out of its plane.
        lift: f64,
        /// Up to here nothing is known.
        clear: f64,
    },
}

impl Spot {
    /// The same place seen from the other side.
    pub fn turned(self) -> Spot {
        Spot { normal: -self.normal, shading: -self.shading, front: !self.front, ..self }
    }

    /// What is seen of it is a surrogate: up to this distance nothing is known.
    pub fn clear(&self) -> Option<f64> {
        if let Anchor::Surrogate { clear, .. } = self.anchor { Some(clear) } else { None }
    }

    /// Turned so that the front is seen or not.
    #[inline]
    fn seen(self, front: bool) -> Spot {
        if front { self } else { self.turned() }
    }
}

impl World {
    /// What `ray` sees where it met `contact`.
    #[inline]
    pub(super) fn spot(&self, contact: &Contact, ray: &WorldRay) -> Result<Spot> {
        let object = &self.objects[contact.object as usize];
        let surface = self.surfaces[object.material];
        match (&object.kind, &contact.part) {
            (Kind::Mesh(placed), Part::Mesh(found)) => self.on_mesh(contact.object, placed, found, ray, surface),
            (Kind::Mesh(placed), Part::Surrogate(met)) => {
                let own = self.meshes[placed.mesh].mixed.as_ref().filter(|_| placed.mtl);
                let surface = own.map_or(surface, |own| surface.standing_for(own, DVec3::from_array(met.color)));
                Ok(on_surrogate(contact.object, placed, met, ray, surface))
            }
            (Kind::Facets(facets), Part::Facet(i, hit)) => {
                let place = Place::of(contact.object, &facets.all()[*i as usize], FaceId(*i), [hit.u, hit.v]);
                Ok(place.spot(None, ray, surface).0)
            }
            (Kind::Ball(ball), Part::Smooth(t)) => {
                let (point, normal) = ball.touch(ray.origin + ray.direction * *t);
                Ok(smooth(contact.object, point, normal, ball.side(ray.origin), ray, surface))
            }
            (Kind::Flat(flat), Part::Smooth(t)) => {
                let point = flat.touch(ray.origin + ray.direction * *t);
                Ok(smooth(contact.object, point, flat.normal, flat.side(ray.origin), ray, surface))
            }
            _ => unreachable!("a contact's part is made by its own object"),
        }
    }

    /// A place on a mesh, with what its attributes say.
    #[inline]
    fn on_mesh(&self, object: u32, placed: &Placed, found: &Found, ray: &WorldRay, surface: Surface) -> Result<Spot> {
        let place = Place::of(object, &found.triangle, found.hit.face, [found.hit.u, found.hit.v]);
        let (mut spot, [u, v]) = place.spot(Some(placed), ray, surface);
        let mesh = &self.meshes[placed.mesh];
        if !(placed.smooth || placed.mtl) {
            return Ok(spot);
        }
        let weights = [1.0 - u - v, u, v];
        if placed.smooth
            && let Some(corners) = mesh.normals(found)?
        {
            let sum: DVec3 = (0..3).map(|i| weights[i] * unit(corners[i])).sum();
            let normal = (placed.normals * sum).normalize_or_zero();
            // The geometric normal decides the side; vertex normals that disagree with it are turned.
            let normal = if normal.dot(spot.normal) < 0.0 { -normal } else { normal };
            spot.shading = if normal == DVec3::ZERO { spot.normal } else { normal };
        }
        if placed.mtl
            && let Some((record, texture)) = mesh.material(found)?
        {
            let uv = match texture {
                None => None,
                Some(_) => mesh.texcoords(found)?.map(|corners| {
                    let along = |axis: usize| (0..3).map(|i| weights[i] * f64::from(corners[i][axis])).sum();
                    [along(0), along(1)]
                }),
            };
            spot.surface = surface.overlaid(record, texture, uv);
        }
        Ok(spot)
    }
}

/// A place on a node that stands for its triangles, of a surface that is made of facets as these are.
fn on_surrogate(object: u32, placed: &Placed, met: &Approximate, ray: &WorldRay, surface: Surface) -> Spot {
    let normal = (placed.normals * DVec3::from_array(met.normal)).normalize_or(DVec3::Y);
    let front = ray.direction.dot(normal) < 0.0;
    let scale = placed.to_local.map_or(1.0, |m| 1.0 / least_scale(&m.matrix3));
    let spot = Spot {
        omit: Omit { object, face: FaceId::NONE },
        point: ray.origin + ray.direction * f64::from(met.t),
        normal,
        shading: normal,
        front: true,
        surface: surface.of_facets(met.agreement),
        anchor: Anchor::Surrogate { lift: met.deviation * scale, clear: met.reach * scale },
    };
    spot.seen(front)
}

/// A vertex normal, of unit length; zero where it is none.
fn unit(normal: [f32; 3]) -> DVec3 {
    Vec3::from_array(normal).as_dvec3().normalize_or_zero()
}

/// A place on a triangle in its object's space.
struct Place<'a> {
    object: u32,
    triangle: &'a Triangle,
    face: FaceId,
    hint: [f64; 2],
}

impl<'a> Place<'a> {
    fn of(object: u32, triangle: &'a Triangle, face: FaceId, hint: [f32; 2]) -> Place<'a> {
        Place { object, triangle, face, hint: hint.map(f64::from) }
    }

    /// The spot and the weights of the second and third corner.
    #[inline]
    fn spot(&self, placed: Option<&Placed>, ray: &WorldRay, surface: Surface) -> (Spot, [f64; 2]) {
        let to_local = placed.and_then(|p| p.to_local.as_ref());
        let local = ray.seen_by(self.object, to_local, ray.tmax);
        let (o, d) = (Vec3::from_array(local.origin), Vec3::from_array(local.direction).as_dvec3());
        let weights = origin::barycentrics(self.triangle, o.as_dvec3(), d, self.hint);
        let point = origin::point_of(self.triangle, weights);
        let outward = origin::normal_of(self.triangle);
        // The side on which the ray's origin lies; from within the plane, the side against the direction.
        let front = match exact::side(self.triangle, local.origin) {
            std::cmp::Ordering::Greater => true,
            std::cmp::Ordering::Less => false,
            std::cmp::Ordering::Equal => d.dot(outward) < 0.0,
        };
        let (world, normal) = match placed {
            Some(p) if to_local.is_some() => (p.to_world.transform_point3(point), (p.normals * outward).normalize()),
            _ => (point, outward),
        };
        let spot = Spot {
            omit: Omit { object: self.object, face: self.face },
            point: world,
            normal,
            shading: normal,
            front: true,
            surface,
            anchor: Anchor::Triangle { triangle: *self.triangle, point },
        };
        (spot.seen(front), weights)
    }
}

/// A place on a sphere or plane, whose front is where `side` of the ray's origin is positive.
fn smooth(object: u32, point: DVec3, normal: DVec3, side: f64, ray: &WorldRay, surface: Surface) -> Spot {
    let front = if side == 0.0 { ray.direction.dot(normal) < 0.0 } else { side > 0.0 };
    let omit = Omit { object, face: FaceId::NONE };
    let spot = Spot { omit, point, normal, shading: normal, front: true, surface, anchor: Anchor::Smooth };
    spot.seen(front)
}
