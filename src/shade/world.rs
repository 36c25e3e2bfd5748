//! The scene made ready to be traced and shaded.

use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

use glam::DVec3;

use super::material::{Mixed, Surface};
use super::object::{Contact, Kind, Object, Part, above};
use super::quadric::Flat;
use super::ray::{Omit, WorldRay};
use super::texture::Texture;
use super::tree::{Item, Tree};
use crate::error::{Error, Result};
use crate::event::{Event, Monitor};
use crate::format::{Flags, MaterialRecord};
use crate::geometry::{Aabb, Ray, Skip};
use crate::map::Octree;
use crate::scene::{Scene, ToneMap};
use crate::trace::{Counters, Footprint, Found, LinearTracer, Met, OctreeTracer, Tracer};

/// More objects than this get a tree over them.
const TREE_FROM: usize = 16;
/// How far below everything the automatic floor lies, in parts of the greatest extent (2^-16): near enough to look like
/// contact, too far to share a coordinate.
const FLOOR_GAP: f64 = 1.0 / 65_536.0;

/// Most bytes of all textures of a scene.
const TEXTURE_BYTES: u64 = 4 << 30;

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

/// A mesh as the shader needs it: something that answers rays, and where attributes come from.
pub struct Mesh {
    pub(super) tracer: Box<dyn Tracer>,
    octree: Option<Arc<Octree>>,
    /// Most error of surrogates, in pixels; `None`: exact.
    pub(super) pixels: Option<f64>,
    /// What its surrogates look like, if it has materials of its own; only with level of detail.
    pub(super) mixed: Option<Mixed>,
    /// Textures by material record.
    textures: Vec<Option<Arc<Texture>>>,
}

impl World {
    /// Makes a scene ready; `meshes[i]` is the opened file of `scene.meshes[i]`.
    ///
    /// A mesh's textures are opened only if an instance takes its materials; one that cannot be read is warned of and
    /// left out. Fails if the linear tracer (`oct off`) meets a damaged page, or if numbers of meshes do not agree.
    pub fn new(scene: Scene, meshes: Vec<Arc<Octree>>, monitor: Monitor<'_>) -> Result<World> {
        let mut room = TEXTURE_BYTES;
        let with_textures = |i: usize| scene.instances.iter().any(|x| x.mesh == i && x.mtl);
        let mesh = |(i, octree): (usize, Arc<Octree>)| -> Result<Mesh> {
            let tracer: Box<dyn Tracer> = if scene.octree {
                Box::new(OctreeTracer::new(octree.clone()))
            } else {
                Box::new(LinearTracer::new(&octree)?)
            };
            let textures = match with_textures(i) {
                true => textures(&octree, scene.tonemap, &mut room, monitor),
                false => Vec::new(),
            };
            Ok(Mesh { tracer, octree: Some(octree), pixels: None, mixed: None, textures })
        };
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
        for mesh in &mut self.meshes {
            let octree = mesh.octree.as_ref().filter(|_| pixels > 0.0);
            if let Some(octree) = octree
                && octree.detail()?.is_none()
            {
                let what = "has no level of detail; build it again with this octbuild, without --no-lod".into();
                return Err(Error::Input { file: octree.path().to_owned(), what });
            }
            mesh.mixed = octree.and_then(|octree| Mixed::of(octree.materials(), &mesh.textures));
            mesh.pixels = octree.map(|_| pixels);
        }
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
        self.meshes.iter().filter_map(|m| m.octree.as_ref()).try_for_each(|octree| octree.fault())
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

impl Mesh {
    /// A mesh without attributes.
    pub fn bare(tracer: Box<dyn Tracer>) -> Mesh {
        Mesh { tracer, octree: None, pixels: None, mixed: None, textures: Vec::new() }
    }

    /// Its file, if it is of one.
    pub(super) fn octree(&self) -> Option<&Octree> {
        self.octree.as_deref()
    }

    /// Its textures by material record.
    pub(super) fn textures(&self) -> &[Option<Arc<Texture>>] {
        &self.textures
    }

    /// What a ray meets first; with level of detail, if it has a width.
    pub(super) fn meet(
        &self,
        ray: &Ray,
        skip: Skip,
        footprint: impl FnOnce() -> Footprint,
        counters: &mut Counters,
    ) -> Result<Met> {
        let footprint = if self.pixels.is_some() { footprint() } else { Footprint::NONE };
        let mut met = [Met::Nothing];
        match self.pixels {
            Some(pixels) if footprint != Footprint::NONE => {
                let rays = std::slice::from_ref(ray);
                self.tracer.closest_coarse(rays, &[footprint], pixels, &mut met, counters)?;
            }
            _ => met = [self.tracer.closest_counted(ray, skip, counters)?.map_or(Met::Nothing, Met::Triangle)],
        }
        Ok(met[0])
    }

    /// Whether a ray meets anything; with level of detail, if it has a width.
    pub(super) fn any(
        &self,
        ray: &Ray,
        skip: Skip,
        footprint: impl FnOnce() -> Footprint,
        counters: &mut Counters,
    ) -> Result<bool> {
        let footprint = if self.pixels.is_some() { footprint() } else { Footprint::NONE };
        let mut blocked = [false];
        match self.pixels {
            Some(pixels) if footprint != Footprint::NONE => {
                let rays = std::slice::from_ref(ray);
                self.tracer.any_coarse(rays, &[skip], &[footprint], pixels, &mut blocked, counters)?;
            }
            _ => blocked = [self.tracer.any_counted(ray, skip, counters)?],
        }
        Ok(blocked[0])
    }

    /// The box around its triangles.
    pub(super) fn bounds(&self) -> Aabb {
        self.tracer.bounds()
    }

    /// The vertex normals of a hit triangle.
    pub(super) fn normals(&self, found: &Found) -> Result<Option<[[f32; 3]; 3]>> {
        match &self.octree {
            Some(octree) if octree.flags().has(Flags::NORMALS) => {
                octree.with_page(found.page, |page| page.normals(found.reference))
            }
            _ => Ok(None),
        }
    }

    /// The texture coordinates of a hit triangle.
    pub(super) fn texcoords(&self, found: &Found) -> Result<Option<[[f32; 2]; 3]>> {
        match &self.octree {
            Some(octree) if octree.flags().has(Flags::TEXCOORDS) => {
                octree.with_page(found.page, |page| page.texcoords(found.reference))
            }
            _ => Ok(None),
        }
    }

    /// How many materials the mesh's file has.
    pub(super) fn materials(&self) -> usize {
        self.octree.as_ref().map_or(0, |octree| octree.materials().len())
    }

    /// The number of a hit triangle's own material in the mesh's file, if it has one.
    pub(super) fn material_number(&self, found: &Found) -> Result<Option<u32>> {
        match &self.octree {
            Some(octree) if octree.flags().has(Flags::MATERIALS) => {
                octree.with_page(found.page, |page| page.material(found.reference).checked_sub(1))
            }
            _ => Ok(None),
        }
    }

    /// The mesh's own material of a hit triangle, if it has one, and its texture.
    pub(super) fn material(&self, found: &Found) -> Result<Option<(&MaterialRecord, Option<&Texture>)>> {
        let (Some(octree), Some(number)) = (&self.octree, self.material_number(found)?) else { return Ok(None) };
        let record = octree.materials().get(number as usize);
        Ok(record.map(|r| (r, self.textures.get(number as usize).and_then(Option::as_deref))))
    }
}

impl std::fmt::Debug for Mesh {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Mesh({:?}, {:?})", self.bounds(), self.textures)
    }
}

/// The textures of a mesh's materials, as far as they can be read and there is `room` for them, in bytes; the rest is warned of, once a
/// file.
fn textures(octree: &Octree, tonemap: ToneMap, room: &mut u64, monitor: Monitor<'_>) -> Vec<Option<Arc<Texture>>> {
    if !octree.flags().has(Flags::TEXCOORDS) {
        return Vec::new();
    }
    let folder = octree.path().parent().unwrap_or(Path::new(""));
    let mut known: HashMap<&str, Option<Arc<Texture>>> = HashMap::new();
    let mut read = |name: &str| {
        let path = folder.join(name);
        monitor.send(Event::File(path.clone()));
        let texture = Texture::open(&path, tonemap).and_then(|texture| {
            *room = room.checked_sub(texture.bytes()).ok_or_else(|| {
                let most = TEXTURE_BYTES >> 20;
                let what =
                    format!("with it the textures of the scene would take more than {most} MiB; make them smaller");
                Error::Input { file: path, what }
            })?;
            Ok(Arc::new(texture))
        });
        texture.map_err(|e| monitor.warn(format!("{e}; going on without this texture"))).ok()
    };
    let mut open = |record: &MaterialRecord| {
        let name = octree.string(record.map_kd);
        if name.is_empty() { None } else { known.entry(name).or_insert_with(|| read(name)).clone() }
    };
    octree.materials().iter().map(&mut open).collect()
}
