//! The things of a scene, each with its own way to be met by a ray: placed meshes, spheres, planes, triangles.

use std::cmp::Ordering;

use glam::{DAffine3, DMat3, DVec3, Vec3};

use super::mesh::Mesh;
use super::quadric::{Ball, Flat};
use super::ray::{Omit, WorldRay};
use crate::error::Result;
use crate::exact::{self, Crossing, Line};
use crate::geometry::{Aabb, FaceId, Hit, Ray, Skip, Triangle};
use crate::scene;
use crate::trace::{Approximate, Counters, Found, Met, all_hits};

/// One thing of the scene.
#[derive(Debug)]
pub(super) struct Object {
    pub kind: Kind,
    /// Index into the scene's materials.
    pub material: usize,
}

/// What it is.
#[derive(Debug)]
pub(super) enum Kind {
    Mesh(Placed),
    Ball(Ball),
    Flat(Flat),
    Facets(Facets),
}

/// A mesh and where it stands.
#[derive(Debug)]
pub(super) struct Placed {
    pub mesh: usize,
    pub to_world: DAffine3,
    /// World to the mesh's space; `None` = the same, and rays stay as they are.
    pub to_local: Option<DAffine3>,
    /// Normals to world: the inverse transpose.
    pub normals: DMat3,
    /// Materials of the mesh's own.
    pub mtl: bool,
    /// Vertex normals.
    pub smooth: bool,
}

/// One triangle, or a rectangle's two.
#[derive(Clone, Debug)]
pub(super) struct Facets {
    triangles: [Triangle; 2],
    count: usize,
}

/// Something that a ray met, before anything about the surface is known.
#[derive(Clone, Copy, Debug)]
pub struct Contact {
    /// Distance in units of the ray's direction.
    pub t: f32,
    /// The object's number.
    pub(super) object: u32,
    pub(super) part: Part,
}

/// Where on the object.
#[derive(Clone, Copy, Debug)]
pub(super) enum Part {
    /// On this triangle of a mesh.
    Mesh(Found),
    /// On a node of a mesh that stands for its triangles.
    Surrogate(Approximate),
    /// On this triangle of the shape.
    Facet(u32, Hit),
    /// On a smooth surface, at this t.
    Smooth(f64),
}

impl Contact {
    /// Whether this comes before `other`: by t, then by the objects' order in the scene.
    pub(super) fn before(&self, other: &Contact) -> bool {
        self.t < other.t || (self.t == other.t && self.object < other.object)
    }
}

impl Object {
    /// A shape of the scene.
    pub fn of_shape(shape: &scene::Shape) -> Object {
        let kind = match shape.geometry {
            scene::Geometry::Sphere { center, radius, to_world } => {
                let to_local = (to_world != DAffine3::IDENTITY).then(|| to_world.inverse());
                Kind::Ball(Ball { center, radius, to_local, to_world })
            }
            scene::Geometry::Plane { point, normal } => {
                let scaled = normal / normal.abs().max_element();
                Kind::Flat(Flat { point, normal: scaled.normalize_or(DVec3::Y) })
            }
            scene::Geometry::Triangle(triangle) => Kind::Facets(Facets { triangles: [triangle; 2], count: 1 }),
            scene::Geometry::Rectangle([ll, lr, ur, ul]) => {
                let halves = [Triangle { a: ll, b: lr, c: ur }, Triangle { a: ll, b: ur, c: ul }];
                Kind::Facets(Facets { triangles: halves, count: 2 })
            }
        };
        Object { kind, material: shape.material }
    }

    /// A placed mesh.
    pub fn of_instance(instance: &scene::Instance) -> Object {
        let to_world = instance.to_world;
        let to_local = (to_world != DAffine3::IDENTITY).then(|| to_world.inverse());
        let normals = to_local.map_or(DMat3::IDENTITY, |m| m.matrix3.transpose());
        let &scene::Instance { mesh, mtl, smooth, .. } = instance;
        Object {
            kind: Kind::Mesh(Placed { mesh, to_world, to_local, normals, mtl, smooth }),
            material: instance.material,
        }
    }

    /// Lowest and highest corner of the box around the object, in f64 and not padded; `None` for a plane (unbounded)
    /// and for an empty mesh.
    pub fn bounds(&self, meshes: &[Mesh]) -> Option<[DVec3; 2]> {
        match &self.kind {
            Kind::Flat(_) => None,
            Kind::Mesh(placed) => {
                let bounds = meshes[placed.mesh].bounds();
                (!bounds.is_empty()).then(|| transformed(bounds, &placed.to_world))
            }
            Kind::Facets(facets) => {
                let bounds = Aabb::around(facets.all().iter().flat_map(|t| t.vertices()));
                Some([bounds.min.as_dvec3(), bounds.max.as_dvec3()])
            }
            Kind::Ball(ball) => {
                let m = ball.to_world.matrix3.transpose();
                let reach = DVec3::new(m.x_axis.length(), m.y_axis.length(), m.z_axis.length()) * ball.radius;
                let center = ball.to_world.transform_point3(ball.center);
                Some([center - reach, center + reach])
            }
        }
    }

    /// By how much rounding in the object's space may move a hit in world space, relative to the coordinates involved,
    /// and those coordinates' size as far as the ray has no part in it. Generous.
    pub fn slack(&self, meshes: &[Mesh]) -> (f64, f64) {
        let size = |b: Option<[DVec3; 2]>| b.map_or(0.0, |[lo, hi]| lo.abs().max(hi.abs()).max_element());
        let (to_world, to_local) = match &self.kind {
            Kind::Mesh(Placed { to_world, to_local: Some(to_local), .. }) => (to_world, to_local),
            Kind::Ball(Ball { to_world, to_local: Some(to_local), .. }) => (to_world, to_local),
            _ => return (1.0, size(self.bounds(meshes))),
        };
        let norm = |m: &DMat3| m.to_cols_array().iter().map(|x| x * x).sum::<f64>().sqrt();
        let condition = norm(&to_world.matrix3) * norm(&to_local.matrix3);
        (condition, size(self.bounds(meshes)) + to_world.translation.abs().max_element())
    }

    /// The nearest hit in `[tmin, tmax]`.
    pub fn closest(
        &self,
        meshes: &[Mesh],
        number: u32,
        ray: &WorldRay,
        tmax: f32,
        omit: Omit,
        counters: &mut Counters,
    ) -> Result<Option<Contact>> {
        let omitted = omit.object == number;
        let contact = |t, part| Some(Contact { t, object: number, part });
        Ok(match &self.kind {
            Kind::Mesh(placed) => {
                let skip = if omitted { Skip::one(omit.face) } else { Skip::NONE };
                let local = ray.seen_by(number, placed.to_local.as_ref(), tmax);
                match meshes[placed.mesh].meet(&local, skip, || ray.footprint(placed), counters)? {
                    Met::Nothing => None,
                    Met::Triangle(f) => contact(f.hit.t, Part::Mesh(f)),
                    Met::Surrogate(s) => contact(s.t, Part::Surrogate(s)),
                }
            }
            Kind::Facets(facets) => {
                let skip = if omitted { omit.face } else { FaceId::NONE };
                let local = ray.seen_by(number, None, tmax);
                facets.closest(local, skip).and_then(|(i, hit)| contact(hit.t, Part::Facet(i, hit)))
            }
            Kind::Ball(_) | Kind::Flat(_) if omitted => None,
            Kind::Ball(ball) => {
                ball.root(ray.origin, ray.direction, ray.tmin, tmax).and_then(|t| contact(t as f32, Part::Smooth(t)))
            }
            Kind::Flat(flat) => {
                flat.root(ray.origin, ray.direction, ray.tmin, tmax).and_then(|t| contact(t as f32, Part::Smooth(t)))
            }
        })
    }

    /// All hits in `[tmin, tmax]`; of a ball the nearest only.
    pub fn all(
        &self,
        meshes: &[Mesh],
        number: u32,
        ray: &WorldRay,
        omit: Omit,
        found: &mut Vec<Contact>,
    ) -> Result<()> {
        match &self.kind {
            Kind::Mesh(placed) => {
                let skip = if omit.object == number { Skip::one(omit.face) } else { Skip::NONE };
                let local = ray.seen_by(number, placed.to_local.as_ref(), ray.tmax);
                for hit in all_hits(meshes[placed.mesh].tracer.as_ref(), &local, skip) {
                    let hit = hit?;
                    found.push(Contact { t: hit.hit.t, object: number, part: Part::Mesh(hit) });
                }
            }
            Kind::Facets(facets) => {
                let local = ray.seen_by(number, None, ray.tmax);
                for i in (0..facets.count as u32).filter(|&i| omit != Omit { object: number, face: FaceId(i) }) {
                    let one = Facets { triangles: [facets.triangles[i as usize]; 2], count: 1 };
                    let hit = one.closest(local, FaceId::NONE);
                    found.extend(hit.map(|(_, hit)| Contact { t: hit.t, object: number, part: Part::Facet(i, hit) }));
                }
            }
            Kind::Ball(_) | Kind::Flat(_) => {
                found.extend(self.closest(meshes, number, ray, ray.tmax, omit, &mut Counters::default())?)
            }
        }
        Ok(())
    }

    /// Whether anything lies in `[tmin, tmax]`.
    pub fn any(
        &self,
        meshes: &[Mesh],
        number: u32,
        ray: &WorldRay,
        omit: Omit,
        counters: &mut Counters,
    ) -> Result<bool> {
        match &self.kind {
            Kind::Mesh(placed) => {
                let skip = if omit.object == number { Skip::one(omit.face) } else { Skip::NONE };
                let local = ray.seen_by(number, placed.to_local.as_ref(), ray.tmax);
                meshes[placed.mesh].any(&local, skip, || ray.footprint(placed), counters)
            }
            _ => Ok(self.closest(meshes, number, ray, ray.tmax, omit, counters)?.is_some()),
        }
    }
}

impl Facets {
    /// The triangles.
    pub fn all(&self) -> &[Triangle] {
        &self.triangles[..self.count]
    }

    /// The nearest hit by exact t, then by number.
    fn closest(&self, ray: Ray, skip: FaceId) -> Option<(u32, Hit)> {
        if !ray.is_valid() {
            return None;
        }
        let line = Line::new(&ray);
        let mut best: Option<(Crossing, u32, f32)> = None;
        for (triangle, i) in self.all().iter().zip(0u32..).filter(|&(_, i)| FaceId(i) != skip) {
            let Some(crossing) = line.meet(triangle).crossing else { continue };
            let Some(t) = crossing.t_within(&line) else { continue };
            if best.as_ref().is_none_or(|(b, ..)| crossing.cmp(b, &line) == Ordering::Less) {
                best = Some((crossing, i, t));
            }
        }
        best.map(|(crossing, i, t)| {
            let [u, v] = crossing.uv(&line);
            (i, Hit { t, face: FaceId(i), u, v })
        })
    }
}

/// Whether `point` lies strictly on the front of the triangle (counter-clockwise seen from there) or strictly behind it.
#[inline]
pub(super) fn strictly_on(triangle: &Triangle, point: Vec3, front: bool) -> bool {
    exact::side(triangle, point.to_array()) == if front { Ordering::Greater } else { Ordering::Less }
}

/// Whether `point` lies on the front of the triangle's plane; `None` where f64 cannot tell.
pub(super) fn above(triangle: &Triangle, point: DVec3) -> Option<bool> {
    let [a, b, c] = triangle.vertices().map(|v| v.as_dvec3());
    let (e, f, w) = (b - a, c - a, point - a);
    let mut value = 0.0;
    let mut bound = 0.0;
    for (i, j, k) in [(0, 1, 2), (1, 2, 0), (2, 0, 1)] {
        let (plus, minus) = (e[j] * f[k], e[k] * f[j]);
        value += (plus - minus) * w[i];
        // The point's own error, of the order of an f64 step of the coordinates, counts here too.
        bound += (plus.abs() + minus.abs()) * (w[i].abs() + point[i].abs() + a[i].abs());
    }
    (value.abs() > 32.0 * f64::EPSILON * bound).then_some(value > 0.0)
}

/// The box around a transformed box.
fn transformed(bounds: Aabb, to_world: &DAffine3) -> [DVec3; 2] {
    let (min, max) = (bounds.min.as_dvec3(), bounds.max.as_dvec3());
    if *to_world == DAffine3::IDENTITY {
        return [min, max];
    }
    let pick = |bit: bool, a: f64, b: f64| if bit { b } else { a };
    (0..8).fold([DVec3::INFINITY, DVec3::NEG_INFINITY], |[lo, hi], i| {
        let corner =
            DVec3::new(pick(i & 4 > 0, min.x, max.x), pick(i & 2 > 0, min.y, max.y), pick(i & 1 > 0, min.z, max.z));
        let p = to_world.transform_point3(corner);
        [lo.min(p), hi.max(p)]
    })
}
