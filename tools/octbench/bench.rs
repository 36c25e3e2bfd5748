//! A mesh made ready: its octree file, opened, and how it was built.

use std::path::Path;
use std::sync::Arc;

use octrace::build::{BuildOptions, build};
use octrace::event::Monitor;
use octrace::geometry::{FaceId, Ray, Skip};
use octrace::map::Octree;
use octrace::mesh::{FaceBatch, MeshSink, ReadOptions, SourceInfo, TriangleSource};
use octrace::{Error, Result};

use crate::families::mesh::Mesh;
use crate::oracle::OracleRay;

/// A mesh in memory as a source of triangles.
struct MemorySource<'a>(&'a Mesh);

impl TriangleSource for MemorySource<'_> {
    fn read(&mut self, sink: &mut dyn MeshSink, _: Monitor<'_>) -> Result<SourceInfo> {
        sink.positions(&self.0.points)?;
        sink.faces(&FaceBatch { corners: self.0.faces.as_flattened().to_vec(), ..FaceBatch::default() })?;
        Ok(SourceInfo::default())
    }

    fn size_hint(&self) -> Option<u64> {
        None
    }
}

/// Builds a mesh's octree file and opens it; the file's name is gone by then.
pub fn octree(mesh: &Mesh, options: &BuildOptions) -> Result<Arc<Octree>> {
    let folder = tempfile::tempdir().map_err(Error::io(std::env::temp_dir(), "create"))?;
    octree_at(mesh, &folder.path().join("mesh.oct"), options).map(Arc::new)
}

/// The same under a name that stays.
pub fn octree_at(mesh: &Mesh, path: &Path, options: &BuildOptions) -> Result<Octree> {
    build(&mut MemorySource(mesh), path, options, Monitor::silent())?;
    Octree::open(path)
}

/// The library's form of a ray.
pub fn library_ray(ray: &OracleRay) -> Ray {
    Ray { origin: ray.o, direction: ray.d, tmin: ray.tmin, tmax: ray.tmax }
}

/// The library's form of the faces to leave out.
pub fn skip(faces: [u32; 2]) -> Skip {
    Skip(faces.map(FaceId))
}

/// Reads a mesh of triangles into memory.
pub fn load(path: &Path, monitor: Monitor<'_>) -> Result<Mesh> {
    let mut collected = Collected(Mesh::default());
    octrace::mesh::open(path, &ReadOptions::default())?.read(&mut collected, monitor)?;
    let mesh = collected.0;
    let wrong = |what: &str| Error::Input { file: path.to_owned(), what: what.to_owned() };
    if mesh.faces.is_empty() {
        return Err(wrong("no faces"));
    }
    if mesh.faces.iter().flatten().any(|&v| v as usize >= mesh.points.len()) {
        return Err(wrong("a face names a vertex that is not there; export it again"));
    }
    Ok(mesh)
}

/// A file of fixed records.
pub fn records<T: bytemuck::Pod>(path: &Path) -> Result<Vec<T>> {
    let bytes = std::fs::read(path).map_err(Error::io(path, "open"))?;
    if bytes.len() % size_of::<T>() != 0 {
        let what = format!(
            "{} bytes are no whole number of records of {}; the file was cut short, or is of another kind",
            bytes.len(),
            size_of::<T>()
        );
        return Err(Error::Input { file: path.to_owned(), what });
    }
    let mut list = vec![T::zeroed(); bytes.len() / size_of::<T>()];
    bytemuck::cast_slice_mut(&mut list).copy_from_slice(&bytes);
    Ok(list)
}

struct Collected(Mesh);

impl MeshSink for Collected {
    fn positions(&mut self, positions: &[[f32; 3]]) -> Result<()> {
        self.0.points.extend(positions);
        Ok(())
    }

    fn texcoords(&mut self, _: &[[f32; 2]]) -> Result<()> {
        Ok(())
    }

    fn normals(&mut self, _: &[[f32; 3]]) -> Result<()> {
        Ok(())
    }

    fn faces(&mut self, faces: &FaceBatch) -> Result<()> {
        if faces.sizes.iter().any(|&n| n != 3) {
            return Err(Error::Option("octbench takes meshes of triangles only; cut other polygons first".to_owned()));
        }
        self.0.faces.extend(faces.corners.chunks_exact(3).map(|f| [f[0], f[1], f[2]]));
        Ok(())
    }
}
