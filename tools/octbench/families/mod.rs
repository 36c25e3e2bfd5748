//! Families of rays and meshes that a ray tracer gets wrong, each with its number and name in the report.
//!
//! A family makes *cases*: a mesh and the rays to trace on it, aimed. Random rays do not show cracks; aimed ones do.

mod building;
mod directions;
mod edges;
mod interval;
pub mod mesh;
mod planes;
mod secondary;
mod shape;
mod streaming;
#[cfg(test)]
mod tests;

use mesh::Mesh;

use crate::oracle::OracleRay;
use crate::random::Random;

/// What is asked of a ray.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ask {
    /// The closest hit, and whether anything is hit.
    Closest,
    /// All hits in order, each once.
    All,
}

/// A ray to trace, with up to two faces left out.
#[derive(Clone, Copy, Debug)]
pub struct Probe {
    /// The ray.
    pub ray: OracleRay,
    /// Faces left out, `u32::MAX` = none.
    pub skip: [u32; 2],
    /// The question.
    pub ask: Ask,
}

/// How a case's octree file is to be built, where the family minds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Layout {
    /// Most triangles a page; `None`: vary.
    pub brick: Option<u32>,
    /// A strict octree to its full depth, of so many triangles a cell.
    pub strict: Option<u32>,
    /// So many files built in different ways, whose answers must have the same bits; 0 = one.
    pub ways: usize,
}

/// A mesh and its rays.
#[derive(Clone, Debug, Default)]
pub struct Case {
    /// The mesh.
    pub mesh: Mesh,
    /// The rays.
    pub probes: Vec<Probe>,
    /// The mesh is closed: an unbounded ray from outside crosses it an even number of times.
    pub closed: bool,
    /// Wishes about the file.
    pub layout: Layout,
}

/// What a family is given: randomness, how many rays, and how large a mesh to make.
pub struct Maker<'a> {
    /// Randomness, seeded by family and round.
    pub random: Random,
    /// Rays wanted.
    pub rays: usize,
    /// Triangles wanted, about.
    pub size: usize,
    /// Which round of this family this is.
    pub round: usize,
    /// A mesh to aim at instead of one of the family's own.
    pub model: Option<&'a Mesh>,
    /// The ball of the mesh that rays are being aimed at, once it was needed.
    pub ball: Option<Ball>,
    /// Which corner or edge of the mesh had its turn.
    pub turn: usize,
}

/// Centre and radius of a mesh, and which mesh it was.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ball {
    mesh: (usize, usize),
    center: [f64; 3],
    radius: f64,
}

/// Families of triangles around one point, where a ray needs an exact test of every triangle.
pub const HUBS: [u32; 2] = [6, 25];

/// Families whose rays need exact tests of many triangles, ten to a hundred times as costly as others.
pub const DEAR: [u32; 7] = [6, 16, 24, 25, 27, 35, 53];

/// Families that only aim, at whatever mesh.
pub const ON_ANY_MESH: [u32; 16] = [1, 2, 4, 10, 11, 12, 20, 21, 22, 31, 36, 41, 42, 44, 48, 52];

/// A family.
#[derive(Clone, Copy)]
pub struct Family {
    /// Its number in the list of hard cases.
    pub number: u32,
    /// Its name in the report.
    pub name: &'static str,
    /// Makes a case.
    pub make: fn(&mut Maker<'_>) -> Case,
}

/// All families, by number.
pub fn all() -> Vec<Family> {
    [
        edges::FAMILIES,
        directions::FAMILIES,
        planes::FAMILIES,
        building::FAMILIES,
        shape::FAMILIES,
        interval::FAMILIES,
        secondary::FAMILIES,
        streaming::FAMILIES,
    ]
    .concat()
}

/// A ray over t >= 0.
pub fn ray(o: [f32; 3], d: [f32; 3]) -> OracleRay {
    OracleRay { o, d, tmin: 0.0, tmax: f32::INFINITY }
}

/// The rounded difference of two points.
pub fn toward(o: [f32; 3], p: [f32; 3]) -> [f32; 3] {
    std::array::from_fn(|i| p[i] - o[i])
}

/// A ray from about a mesh to a point of it.
fn aimed(m: &mut Maker<'_>, mesh: &Mesh) -> OracleRay {
    let o = m.origin(mesh);
    ray(o, toward(o, m.target(mesh)))
}

impl Probe {
    /// The closest hit of a ray.
    pub fn closest(ray: OracleRay) -> Probe {
        Probe { ray, skip: [u32::MAX; 2], ask: Ask::Closest }
    }

    /// All hits of a ray.
    pub fn all(ray: OracleRay) -> Probe {
        Probe { ray, skip: [u32::MAX; 2], ask: Ask::All }
    }
}

/// Scales at which a mesh is placed: from 1e-30 to 1e30, mostly ordinary.
const SCALES: [f32; 9] = [1.0, 1.0, 1.0, 1e-3, 1e3, 1e-15, 1e15, 1e-30, 1e30];

impl<'a> Maker<'a> {
    /// For meshes of the family's own, in its first round.
    pub fn new(random: Random, rays: usize, size: usize) -> Maker<'a> {
        Maker { random, rays, size, round: 0, model: None, ball: None, turn: 0 }
    }

    /// For a given mesh to aim at.
    pub fn on(mesh: &'a Mesh, random: Random, rays: usize) -> Maker<'a> {
        Maker { model: Some(mesh), ..Maker::new(random, rays, mesh.faces.len()) }
    }

    /// A closed mesh of about the wanted size, at some scale and offset.
    pub fn closed_mesh(&mut self) -> Mesh {
        if let Some(model) = self.model {
            return model.clone();
        }
        let mesh = match (self.size, self.random.below(3)) {
            (0..30, 0) => mesh::cube(),
            (0..30, _) => mesh::tetrahedron(&mut self.random),
            _ => {
                let levels = ((self.size as f64 / 8.0).log2() / 2.0).ceil() as u32;
                let noise = self.random.pick(&[0.0, 0.01, 0.2]);
                mesh::sphere(levels, noise, &mut self.random)
            }
        };
        self.place(mesh)
    }

    /// Any mesh of about the wanted size, closed or not, at some scale and offset.
    pub fn any_mesh(&mut self) -> Mesh {
        if let Some(model) = self.model {
            return model.clone();
        }
        let n = ((self.size as f64 / 2.0).sqrt().ceil() as usize).max(1);
        let mesh = match self.random.below(6) {
            0 => mesh::field(n, 0.1, &mut self.random),
            1 => mesh::field(n, 0.0, &mut self.random),
            2 => mesh::soup(self.size.max(2), self.random.pick(&[0.02, 0.3]), &mut self.random.clone()),
            3 if self.size < 2000 => mesh::slivers(self.size.max(3), &mut self.random),
            _ => return self.closed_mesh(),
        };
        self.place(mesh)
    }

    /// Moves a mesh to a random scale and, sometimes, far from zero.
    pub fn place(&mut self, mesh: Mesh) -> Mesh {
        let scale = SCALES[self.round % SCALES.len()];
        let far = self.random.pick(&[0.0, 0.0, 1.0, 100.0]);
        let offset = [0; 3].map(|_| scale * (far * self.random.signed()) as f32);
        mesh.placed(scale, offset)
    }

    /// Centre and radius of a mesh, looked for once.
    fn ball(&mut self, mesh: &Mesh) -> ([f64; 3], f64) {
        let this = (mesh.points.as_ptr() as usize, mesh.points.len());
        match self.ball {
            Some(Ball { mesh, center, radius }) if mesh == this => (center, radius),
            _ => {
                let (center, radius) = mesh.ball();
                self.ball = Some(Ball { mesh: this, center, radius });
                (center, radius)
            }
        }
    }

    /// An origin about a mesh: inside its ball, around it, or far away.
    pub fn origin(&mut self, mesh: &Mesh) -> [f32; 3] {
        let (center, radius) = self.ball(mesh);
        let far = self.random.pick(&[0.2, 0.9, 1.5, 3.0, 3.0, 30.0]);
        let d = self.random.direction();
        std::array::from_fn(|i| (center[i] + far * radius * d[i]) as f32)
    }

    /// An origin outside the mesh's ball.
    pub fn outside(&mut self, mesh: &Mesh) -> [f32; 3] {
        let (center, radius) = self.ball(mesh);
        let far = self.random.pick(&[1.5, 3.0, 10.0]);
        let d = self.random.direction();
        std::array::from_fn(|i| (center[i] + far * radius * d[i]) as f32)
    }

    /// A vertex that some face uses.
    pub fn vertex(&mut self, mesh: &Mesh) -> [f32; 3] {
        let face = mesh.faces[self.random.below(mesh.faces.len())];
        mesh.points[face[self.random.below(3)] as usize]
    }

    /// The corners of all faces, one after the other; again from the start when all have had their turn.
    pub fn next_corner(&mut self, mesh: &Mesh) -> [f32; 3] {
        self.turn += 1;
        let corner = self.turn % (3 * mesh.faces.len());
        mesh.corners(corner / 3)[corner % 3]
    }

    /// The ends of the edges of all faces, in the same manner.
    pub fn next_edge(&mut self, mesh: &Mesh) -> ([f32; 3], [f32; 3]) {
        let a = self.next_corner(mesh);
        let edge = self.turn % (3 * mesh.faces.len());
        (a, mesh.corners(edge / 3)[(edge + 1) % 3])
    }

    /// The two ends of an edge of some face.
    pub fn edge(&mut self, mesh: &Mesh) -> ([f32; 3], [f32; 3]) {
        let corners = mesh.corners(self.random.below(mesh.faces.len()));
        let k = self.random.below(3);
        (corners[k], corners[(k + 1) % 3])
    }

    /// A point of an edge: its middle, or anywhere on it, rounded.
    pub fn edge_point(&mut self, mesh: &Mesh) -> [f32; 3] {
        let (a, b) = self.edge(mesh);
        let s = if self.random.chance(0.5) { 0.5 } else { self.random.unit() };
        std::array::from_fn(|i| (f64::from(a[i]) + s * (f64::from(b[i]) - f64::from(a[i]))) as f32)
    }

    /// A point within a face, rounded.
    pub fn face_point(&mut self, mesh: &Mesh) -> [f32; 3] {
        let [a, b, c] = mesh.corners(self.random.below(mesh.faces.len())).map(|p| p.map(f64::from));
        let (mut u, mut v) = (self.random.unit(), self.random.unit());
        if u + v > 1.0 {
            (u, v) = (1.0 - u, 1.0 - v);
        }
        std::array::from_fn(|i| (a[i] + u * (b[i] - a[i]) + v * (c[i] - a[i])) as f32)
    }

    /// A vertex, a point of an edge, or a point of a face.
    pub fn target(&mut self, mesh: &Mesh) -> [f32; 3] {
        match self.random.below(3) {
            0 => self.vertex(mesh),
            1 => self.edge_point(mesh),
            _ => self.face_point(mesh),
        }
    }

    /// A case of closest-hit rays, each made from the mesh.
    pub fn case(&mut self, mesh: Mesh, mut make: impl FnMut(&mut Maker<'_>, &Mesh) -> OracleRay) -> Case {
        let probes = (0..self.rays).map(|_| Probe::closest(make(self, &mesh))).collect();
        Case { mesh, probes, ..Case::default() }
    }
}
