//! A mesh as the shader needs it.

use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

use super::material::Mixed;
use super::texture::Texture;
use crate::error::{Error, Result};
use crate::event::{Event, Monitor};
use crate::format::{Flags, MaterialRecord};
use crate::geometry::{Aabb, Ray, Skip};
use crate::map::Octree;
use crate::scene::{Scene, ToneMap};
use crate::trace::{Counters, Footprint, Found, LinearTracer, Met, OctreeTracer, Tracer};

/// Most bytes of all textures of a scene.
pub(super) const TEXTURE_BYTES: u64 = 4 << 30;

/// Something that answers rays, and where attributes come from.
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

impl Mesh {
    /// Mesh number `i` of a scene, from its opened file. Its textures are opened only if an instance takes its materials, and there is `room`
    /// for them, in bytes.
    pub(super) fn of(
        scene: &Scene,
        i: usize,
        octree: Arc<Octree>,
        room: &mut u64,
        monitor: Monitor<'_>,
    ) -> Result<Mesh> {
        let tracer: Box<dyn Tracer> = match scene.octree {
            true => Box::new(OctreeTracer::new(octree.clone())),
            false => Box::new(LinearTracer::new(&octree)?),
        };
        let textures = match scene.instances.iter().any(|x| x.mesh == i && x.mtl) {
            true => textures(&octree, scene.tonemap, room, monitor),
            false => Vec::new(),
        };
        Ok(Mesh { tracer, octree: Some(octree), pixels: None, mixed: None, textures })
    }

    /// A mesh without attributes.
    pub fn bare(tracer: Box<dyn Tracer>) -> Mesh {
        Mesh { tracer, octree: None, pixels: None, mixed: None, textures: Vec::new() }
    }

    /// Allows for so many pixels of error from now on; 0 is exact. Fails if the file has no level of detail.
    pub(super) fn allow(&mut self, pixels: f64) -> Result<()> {
        let octree = self.octree.as_ref().filter(|_| pixels > 0.0);
        if let Some(octree) = octree
            && octree.detail()?.is_none()
        {
            let what = "has no level of detail; build it again with this octbuild, without --no-lod".into();
            return Err(Error::Input { file: octree.path().to_owned(), what });
        }
        self.mixed = octree.and_then(|octree| Mixed::of(octree.materials(), &self.textures));
        self.pixels = octree.map(|_| pixels);
        Ok(())
    }

    /// Its file, if it is of one.
    pub(super) fn octree(&self) -> Option<&Octree> {
        self.octree.as_deref()
    }

    /// Its textures by material record.
    pub(super) fn textures(&self) -> &[Option<Arc<Texture>>] {
        &self.textures
    }

    /// The width of a ray and the error that is allowed, if it is to be traced with level of detail.
    fn coarse(&self, footprint: impl FnOnce() -> Footprint) -> Option<(Footprint, f64)> {
        let pixels = self.pixels?;
        let footprint = footprint();
        (footprint != Footprint::NONE).then_some((footprint, pixels))
    }

    /// What a ray meets first; with level of detail, if it has a width.
    pub(super) fn meet(
        &self,
        ray: &Ray,
        skip: Skip,
        footprint: impl FnOnce() -> Footprint,
        counters: &mut Counters,
    ) -> Result<Met> {
        let Some((footprint, pixels)) = self.coarse(footprint) else {
            return Ok(self.tracer.closest_counted(ray, skip, counters)?.map_or(Met::Nothing, Met::Triangle));
        };
        let (rays, mut met) = (std::slice::from_ref(ray), [Met::Nothing]);
        self.tracer.closest_coarse(rays, &[footprint], pixels, &mut met, counters)?;
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
        let Some((footprint, pixels)) = self.coarse(footprint) else {
            return self.tracer.any_counted(ray, skip, counters);
        };
        let (rays, mut blocked) = (std::slice::from_ref(ray), [false]);
        self.tracer.any_coarse(rays, &[skip], &[footprint], pixels, &mut blocked, counters)?;
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
