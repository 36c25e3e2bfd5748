//! Meshes, rays and files that the tests of the tracer share.
#![allow(dead_code)]

mod random;

pub use random::Random;

use std::path::Path;

use octrace::build::{BuildOptions, build};
use octrace::event::Monitor;
use octrace::geometry::{Ray, Triangle};
use octrace::map::Octree;
use octrace::mesh::{FaceBatch, MeshSink, SourceInfo, TriangleSource};

/// A mesh as positions and faces.
#[derive(Clone, Debug, Default)]
pub struct Mesh {
    pub positions: Vec<[f32; 3]>,
    pub faces: Vec<[u32; 3]>,
}

impl Mesh {
    pub fn triangles(&self) -> Vec<Triangle> {
        let corner = |i: u32| self.positions[i as usize].into();
        self.faces.iter().map(|&[a, b, c]| Triangle { a: corner(a), b: corner(b), c: corner(c) }).collect()
    }

    /// A sphere: an octahedron, each face cut in four `levels` times. Closed; vertices shared; bumps on request.
    pub fn sphere(levels: u32, bump: f32) -> Mesh {
        let positions = vec![[1., 0., 0.], [-1., 0., 0.], [0., 1., 0.], [0., -1., 0.], [0., 0., 1.], [0., 0., -1.]];
        let faces = vec![[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]];
        let mut mesh = Mesh { positions, faces };
        for _ in 0..levels {
            mesh.refine();
        }
        let mut random = Random(7);
        for p in &mut mesh.positions {
            let scale = 1.0 + bump * random.unit();
            *p = p.map(|x| x * scale);
        }
        mesh
    }

    fn refine(&mut self) {
        let mut middles = std::collections::HashMap::new();
        let mut faces = Vec::new();
        for &[a, b, c] in &self.faces.clone() {
            let mut middle = |i: u32, j: u32| {
                *middles.entry((i.min(j), i.max(j))).or_insert_with(|| {
                    let (p, q) = (self.positions[i as usize], self.positions[j as usize]);
                    let sum: [f32; 3] = std::array::from_fn(|k| p[k] + q[k]);
                    let length = sum.iter().map(|x| x * x).sum::<f32>().sqrt();
                    self.positions.push(sum.map(|x| x / length));
                    self.positions.len() as u32 - 1
                })
            };
            let (ab, bc, ca) = (middle(a, b), middle(b, c), middle(c, a));
            faces.extend([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]);
        }
        self.faces = faces;
    }

    /// The cube from -1 to 1, each side cut into n x n squares of two triangles; all coordinates on a coarse grid.
    pub fn cube(n: u32) -> Mesh {
        let mut mesh = Mesh::default();
        let mut numbers = std::collections::HashMap::new();
        for (axis, side) in (0..6).map(|i| (i / 2, i % 2)) {
            for (i, j) in (0..n * n).map(|k| (k / n, k % n)) {
                let corners = [[i, j], [i + 1, j], [i + 1, j + 1], [i, j + 1]].map(|[u, v]| {
                    let mut p = [0.0; 3];
                    p[axis] = side as f32 * 2.0 - 1.0;
                    p[(axis + 1) % 3] = u as f32 * 2.0 / n as f32 - 1.0;
                    p[(axis + 2) % 3] = v as f32 * 2.0 / n as f32 - 1.0;
                    *numbers.entry(p.map(f32::to_bits)).or_insert_with(|| {
                        mesh.positions.push(p);
                        mesh.positions.len() as u32 - 1
                    })
                });
                mesh.faces.push([corners[0], corners[1], corners[2]]);
                mesh.faces.push([corners[0], corners[2], corners[3]]);
            }
        }
        mesh
    }

    /// Triangles without order: needles, slivers, huge and tiny ones, repeats, shared vertices.
    pub fn soup(count: usize, seed: u64) -> Mesh {
        let mut random = Random(seed);
        let mut mesh = Mesh::default();
        for _ in 0..count {
            let size = random.pick(&[1.0, 1.0, 0.1, 0.01, 1e-4, 1e-7]);
            let base = random.vector();
            for k in 0..3 {
                let p = random.vector();
                let shared = !mesh.positions.is_empty() && random.below(4) == 0;
                let p: [f32; 3] = match shared {
                    true => mesh.positions[random.below(mesh.positions.len())],
                    false if k == 2 && random.below(4) == 0 => base.map(|x| x.next_up()),
                    false => std::array::from_fn(|i| base[i] + size * p[i]),
                };
                mesh.positions.push(p);
            }
            let n = mesh.positions.len() as u32;
            mesh.faces.push([n - 3, n - 2, n - 1]);
            if random.below(16) == 0 {
                mesh.faces.push([n - 2, n - 1, n - 3]);
            }
        }
        mesh
    }

    /// A room of twelve huge triangles with detailed spheres in it and long thin spikes across it; all surfaces closed.
    pub fn room() -> Mesh {
        let mut random = Random(17);
        let mut mesh = Mesh::cube(1).placed(5.0, 0.0);
        for _ in 0..6 {
            let centre = random.vector().map(|x| 4.0 * x);
            mesh.append(Mesh::sphere(3, 0.0), |p| std::array::from_fn(|i| centre[i] + 0.4 * p[i]));
        }
        for _ in 0..60 {
            let (from, to) = (random.vector().map(|x| 4.9 * x), random.vector().map(|x| 4.9 * x));
            let [mut b, mut c] = [from; 2];
            (b[0], c[1]) = (b[0] + 0.02, c[1] + 0.02);
            let spike =
                Mesh { positions: vec![from, b, c, to], faces: vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]] };
            mesh.append(spike, |p| p);
        }
        mesh
    }

    /// Adds another mesh, moved by `place`.
    fn append(&mut self, other: Mesh, place: impl Fn([f32; 3]) -> [f32; 3]) {
        let first = self.positions.len() as u32;
        self.positions.extend(other.positions.into_iter().map(place));
        self.faces.extend(other.faces.into_iter().map(|face| face.map(|i| first + i)));
    }

    /// The mesh scaled, then moved.
    pub fn placed(mut self, scale: f32, offset: f32) -> Mesh {
        self.positions.iter_mut().for_each(|p| *p = p.map(|x| x * scale + offset));
        self
    }

    /// The mesh as builders take it.
    pub fn source(&self) -> impl TriangleSource + '_ {
        Source(self)
    }

    /// Builds a file of this mesh and opens it.
    pub fn octree(&self, options: &BuildOptions) -> Octree {
        let folder = tempfile::tempdir().expect("a folder for temporary files");
        self.octree_at(&folder.path().join("mesh.oct"), options)
    }

    /// The same under a name that stays.
    pub fn octree_at(&self, path: &Path, options: &BuildOptions) -> Octree {
        build(&mut Source(self), path, options, Monitor::silent()).expect("the mesh builds");
        Octree::open(path).expect("the file opens")
    }
}

struct Source<'a>(&'a Mesh);

impl TriangleSource for Source<'_> {
    fn read(&mut self, sink: &mut dyn MeshSink, _: Monitor<'_>) -> octrace::Result<SourceInfo> {
        sink.positions(&self.0.positions)?;
        let corners = self.0.faces.as_flattened().to_vec();
        sink.faces(&FaceBatch { corners, ..FaceBatch::default() })?;
        Ok(SourceInfo::default())
    }

    fn size_hint(&self) -> Option<u64> {
        None
    }
}

/// A ray of a nasty kind, aimed at the mesh.
pub fn nasty_ray(mesh: &Mesh, random: &mut Random) -> Ray {
    let face = random.pick(&mesh.faces);
    let [a, b, c] = face.map(|i| mesh.positions[i as usize]);
    let extent = mesh.positions.iter().flatten().fold(0f32, |m, x| m.max((x - mesh.positions[0][0]).abs())).max(1e-30);
    let target: [f32; 3] = match random.below(4) {
        0 => a,
        1 => std::array::from_fn(|i| a[i] / 2.0 + b[i] / 2.0),
        2 => std::array::from_fn(|i| (a[i] + b[i] + c[i]) / 3.0),
        _ => std::array::from_fn(|i| b[i] + (c[i] - b[i]) * 0.25),
    };
    let mut origin: [f32; 3] = match random.below(6) {
        0 => random.vector().map(|x| x * extent + mesh.positions[0][0]),
        1 => random.vector().map(|x| x * extent * 1e7),
        2 => random.pick(&mesh.positions),
        3 => std::array::from_fn(|i| target[i] + extent * random.pick(&[-2.0, -0.5, 0.0, 0.5, 2.0])),
        4 => target,
        _ => random.vector().map(|x| x * extent * 3.0 + mesh.positions[0][0]),
    };
    if random.below(4) == 0 {
        let axis = random.below(3);
        origin[axis] = target[axis];
    }
    let mut direction: [f32; 3] = std::array::from_fn(|i| target[i] - origin[i]);
    match random.below(8) {
        0 => {
            let axis = random.below(3);
            direction[axis] = random.pick(&[0.0, -0.0, 1e-45, -1e-45, 1e-39, 1e-20, 1e-18, 1.19e-7, -1e-30]);
        }
        1 => direction = random.vector(),
        2 => direction = [0, 1, 2].map(|_| random.pick(&[-1.0, 1.0, 0.0, -0.0])),
        3 => direction = direction.map(|x| x * random.pick(&[1e-30f32, 1e-10, 1e10, 1e30])),
        _ => {}
    }
    let ray = Ray::new(origin, direction);
    match random.below(8) {
        0 => ray.between(-f32::INFINITY, f32::INFINITY),
        1 => ray.between(-1.0, 1.0),
        2 => ray.between(1.0, 1.0),
        3 => ray.between(0.0, 1.0),
        4 => ray.between(random.unit(), random.unit()),
        _ => ray,
    }
}
