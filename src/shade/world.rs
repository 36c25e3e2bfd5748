//! The scene made ready to be traced and shaded.

use std::sync::Arc;

use glam::DVec3;

use super::material::Surface;
use super::mesh::{Mesh, TEXTURE_BYTES};
use super::object::{Contact, Kind, Object, Part, above};
use super::quadric::Flat;
use super::ray::{Omit, WorldRay};
use super::tree::{Item, Tree};
use crate::error::{Error, Result};
use crate::event::Monitor;
use crate::map::Octree;
use crate::scene::Scene;
use crate::trace::Counters;

/// More objects than this get a tree over them.
const TREE_FROM: usize = 16;
/// How far below everything the automatic floor lies, in parts of the greatest extent (2^-16): near enough to look like
/// contact, too far to share a coordinate.
const FLOOR_GAP: f64 = 1.0 / 65_536.0;

/// A scene, ready for rays. Shared by all threads.
#[derive(Debug)]
pub struct World {
    pub(super) scene: Scene,
    pub(super) meshes: Vec<Mesh>,
    /// Shapes, then instances, in scene order; then the automatic floor.
    pub(super) objects: Vec<Object>,
    /// The scene's materials as surfaces.
    pub(super) surfaces: Vec<Surface>,
    /// Objects that every ray asks, in order.
    pub(super) always: Vec<u32>,
    /// Over the rest.
    tree: Option<Tree>,
    /// Around all that has been placed, planes left out.
    bounds: Option<[DVec3; 2]>,
}

impl World {
    /// Makes a scene ready; `meshes[i]` is the opened file of `scene.meshes[i]`.
    ///
    /// A mesh's textures are opened only if an instance takes its materials; one that cannot be read is warned of and
    /// left out. Fails if the linear tracer (`oct off`) meets a damaged page, or if numbers of meshes do not agree.
    pub fn new(scene: Scene, meshes: Vec<Arc<Octree>>, monitor: Monitor<'_>) -> Result<World> {
        let mut room = TEXTURE_BYTES;
        let mesh = |(i, octree)| Mesh::of(&scene, i, octree, &mut room, monitor);
        let meshes = meshes.into_iter().enumerate().map(mesh).collect::<Result<Vec<_>>>()?;
        World::with_meshes(scene, meshes)
    }

    /// The same with any tracers.
    pub fn with_meshes(scene: Scene, meshes: Vec<Mesh>) -> Result<World> {
        let named = |i: &usize| *i < meshes.len();
        if meshes.len() != scene.meshes.len() || !scene.instances.iter().all(|x| named(&x.mesh)) {
            let (have, want) = (meshes.len(), scene.meshes.len());
            return Err(Error::Option(format!("the scene names {want} meshes, but {have} were opened")));
        }
        let surfaces: Vec<Surface> = scene.materials.iter().map(Surface::from).collect();
        let shapes = scene.shapes.iter().map(Object::of_shape);
        let objects: Vec<Object> = shapes.chain(scene.instances.iter().map(Object::of_instance)).collect();
        if objects.iter().any(|o| o.material >= surfaces.len()) || scene.floor.is_some_and(|m| m >= surfaces.len()) {
            return Err(Error::Option("the scene names a material that it does not have".into()));
        }
        let bounds = objects.iter().filter_map(|o| o.bounds(&meshes));
        let bounds = bounds.reduce(|a, b| [a[0].min(b[0]), a[1].max(b[1])]);
        let mut world = World { scene, meshes, objects, surfaces, always: Vec::new(), tree: None, bounds };
        world.add_floor();
        world.arrange(TREE_FROM);
        Ok(world)
    }

    /// The same with level of detail: a node of a mesh may stand for its triangles where the error is at most so many pixels, as
    /// `trace/lod.rs` says. 0 is the exact picture.
    ///
    /// Fails if a mesh was built without what is needed for that, or is not traced through its octree, or if the number is none.
    pub fn with_lod(mut self, pixels: f64) -> Result<World> {
        if !(pixels >= 0.0 && pixels.is_finite()) {
            return Err(Error::Option(format!("level of detail of {pixels} pixels: it is 0 (exact) or more")));
        }
        if pixels > 0.0 && !self.scene.octree {
            return Err(Error::Option(
                "level of detail needs the octree, which the scene turns off: leave out --lod, or `oct off` in the scene"
                    .into(),
            ));
        }
        self.meshes.iter_mut().try_for_each(|mesh| mesh.allow(pixels))?;
        Ok(self)
    }

    /// The scene.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// The error that is allowed of an object's surrogates, in pixels.
    pub(super) fn allowed(&self, object: u32) -> f64 {
        match &self.objects[object as usize].kind {
            Kind::Mesh(placed) => self.meshes[placed.mesh].pixels.unwrap_or(0.0),
            _ => 0.0,
        }
    }

    /// The box around all that has been placed (planes left out), `None` if that is nothing.
    pub fn bounds(&self) -> Option<[DVec3; 2]> {
        self.bounds
    }

    /// An error if a mesh's file was cut short while in use: no colour found since then holds.
    pub fn fault(&self) -> Result<()> {
        self.meshes.iter().filter_map(Mesh::octree).try_for_each(|octree| octree.fault())
    }

    /// Puts the floor that the scene wishes just under everything.
    fn add_floor(&mut self) {
        let Some(material) = self.scene.floor else { return };
        let [lo, hi] = self.bounds.unwrap_or([DVec3::ZERO; 2]);
        let y = lo.y - (hi - lo).max_element() * FLOOR_GAP;
        let kind = Kind::Flat(Flat { point: DVec3::new(0.0, y, 0.0), normal: DVec3::Y });
        self.objects.push(Object { kind, material });
    }

    /// Decides which objects stand in a tree: those with a box, if there are more than `tree_from`.
    pub(super) fn arrange(&mut self, tree_from: usize) {
        let item = |(object, o): (u32, &Object)| {
            let [min, max] = o.bounds(&self.meshes)?;
            let (slack, size) = o.slack(&self.meshes);
            Some(Item { object, min, max, slack, size })
        };
        let items: Vec<Item> = (0..).zip(&self.objects).filter_map(item).collect();
        if items.len() > tree_from {
            self.always =
                (0..).zip(&self.objects).filter(|(_, o)| matches!(o.kind, Kind::Flat(_))).map(|x| x.0).collect();
            self.tree = Some(Tree::new(items));
        } else {
            self.always = (0..).zip(&self.objects).map(|x| x.0).collect();
            self.tree = None;
        }
    }

    /// What the ray meets first: least t, then the object that comes first in the scene.
    pub fn closest(&self, ray: &WorldRay, omit: Omit) -> Result<Option<Contact>> {
        let (mut best, counters) = (None, &mut Counters::default());
        for &object in &self.always {
            self.nearer(object, ray, omit, &mut best, counters)?;
        }
        self.nearer_in_tree(ray, omit, &mut best, counters)?;
        Ok(best)
    }

    /// Puts the hit of an object in the place of `best` if it comes before that; how far the ray still matters then.
    pub(super) fn nearer(
        &self,
        object: u32,
        ray: &WorldRay,
        omit: Omit,
        best: &mut Option<Contact>,
        counters: &mut Counters,
    ) -> Result<f32> {
        let tmax = best.map_or(ray.tmax, |b| b.t);
        let found = self.objects[object as usize].closest(&self.meshes, object, ray, tmax, omit, counters)?;
        if let Some(found) = found
            && best.is_none_or(|b| found.before(&b))
        {
            *best = Some(found);
        }
        Ok(best.map_or(ray.tmax, |b| b.t))
    }

    /// The same for all objects in the tree.
    pub(super) fn nearer_in_tree(
        &self,
        ray: &WorldRay,
        omit: Omit,
        best: &mut Option<Contact>,
        counters: &mut Counters,
    ) -> Result<()> {
        let Some(tree) = &self.tree else { return Ok(()) };
        let far = best.map_or(ray.tmax, |b| b.t);
        tree.visit(ray.origin, ray.direction, ray.tmin, far, |object| self.nearer(object, ray, omit, best, counters))
    }

    /// All that the ray meets, in no order.
    pub(super) fn all(&self, ray: &WorldRay, omit: Omit) -> Result<Vec<Contact>> {
        let mut found = Vec::new();
        for (number, object) in (0..).zip(&self.objects) {
            object.all(&self.meshes, number, ray, omit, &mut found)?;
        }
        Ok(found)
    }

    /// Whether the surface that `ray` meets at `contact` has the ray's origin and `point` strictly on different sides. `None` where
    /// f64 cannot tell on which side the point is: it lies on the surface.
    pub(super) fn apart(&self, contact: &Contact, ray: &WorldRay, point: DVec3) -> Option<bool> {
        let object = &self.objects[contact.object as usize];
        let start = ray.start.object == contact.object;
        match (&object.kind, &contact.part) {
            (Kind::Mesh(placed), Part::Mesh(found)) => {
                let local = |p: DVec3| placed.to_local.map_or(p, |m| m.transform_point3(p));
                let origin = if start { ray.start.point.as_dvec3() } else { local(ray.origin) };
                Some(above(&found.triangle, local(point))? != above(&found.triangle, origin)?)
            }
            (Kind::Facets(facets), Part::Facet(i, _)) => {
                let triangle = &facets.all()[*i as usize];
                Some(above(triangle, point)? != above(triangle, ray.origin)?)
            }
            (Kind::Flat(flat), _) => {
                let (a, b) = (flat.side(ray.origin), flat.side(point));
                (a != 0.0 && b != 0.0).then_some((a > 0.0) != (b > 0.0))
            }
            (Kind::Ball(ball), Part::Smooth(t)) => {
                let (a, b) = (ball.side(ray.origin), ball.side(point));
                // From outside through a ball to the outside: by the root.
                (b != 0.0).then_some((a > 0.0) != (b > 0.0) || *t < 1.0)
            }
            _ => None,
        }
    }

    /// Whether the ray meets anything.
    pub fn any(&self, ray: &WorldRay, omit: Omit) -> Result<bool> {
        let counters = &mut Counters::default();
        for &object in &self.always {
            if self.objects[object as usize].any(&self.meshes, object, ray, omit, counters)? {
                return Ok(true);
            }
        }
        self.any_in_tree(ray, omit, counters)
    }

    /// Whether the ray meets anything in the tree.
    pub(super) fn any_in_tree(&self, ray: &WorldRay, omit: Omit, counters: &mut Counters) -> Result<bool> {
        let Some(tree) = &self.tree else { return Ok(false) };
        let mut met = false;
        tree.visit(ray.origin, ray.direction, ray.tmin, ray.tmax, |object| -> Result<f32> {
            met = self.objects[object as usize].any(&self.meshes, object, ray, omit, counters)?;
            Ok(if met { -1.0 } else { ray.tmax })
        })?;
        Ok(met)
    }

    /// Whether any objects stand in a tree.
    pub(super) fn has_tree(&self) -> bool {
        self.tree.is_some()
    }
}
