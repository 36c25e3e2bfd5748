//! Meshes for the families: closed and open, even and nasty, at any scale and offset.

use std::collections::HashMap;

use crate::oracle::Corners;
use crate::random::Random;

/// An indexed mesh.
#[derive(Clone, Debug, Default)]
pub struct Mesh {
    /// Vertices.
    pub points: Vec<[f32; 3]>,
    /// Triangles.
    pub faces: Vec<[u32; 3]>,
}

impl Mesh {
    /// A mesh of the given vertices and faces.
    pub fn new(points: Vec<[f32; 3]>, faces: Vec<[u32; 3]>) -> Mesh {
        Mesh { points, faces }
    }

    /// A mesh of triangles that share nothing.
    pub fn soup(triangles: impl IntoIterator<Item = Corners>) -> Mesh {
        let points: Vec<[f32; 3]> = triangles.into_iter().flatten().collect();
        let faces = (0..points.len() as u32 / 3).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
        Mesh { points, faces }
    }

    /// Corners of triangle i.
    pub fn corners(&self, i: usize) -> Corners {
        self.faces[i].map(|v| self.points[v as usize])
    }

    /// All triangles.
    pub fn triangles(&self) -> impl Iterator<Item = Corners> + '_ {
        (0..self.faces.len()).map(|i| self.corners(i))
    }

    /// All triangles with their numbers.
    pub fn numbered(&self) -> impl Iterator<Item = (u32, Corners)> + '_ {
        (0..).zip(self.triangles())
    }

    /// Adds another mesh.
    pub fn append(&mut self, other: &Mesh) {
        let base = self.points.len() as u32;
        self.points.extend(&other.points);
        self.faces.extend(other.faces.iter().map(|f| f.map(|v| v + base)));
    }

    /// Every vertex scaled, then moved, rounded to f32 after each step.
    pub fn placed(mut self, scale: f32, offset: [f32; 3]) -> Mesh {
        for p in &mut self.points {
            *p = std::array::from_fn(|i| p[i] * scale + offset[i]);
        }
        self
    }

    /// The vertices moved to the nearest multiples of a power of two, 2^20 to 2^21 of which make the longest side.
    pub fn on_grid(mut self) -> Mesh {
        let (low, high) = self.bounds();
        let extent = (0..3).map(|i| high[i] - low[i]).fold(0.0, f64::max);
        if extent > 0.0 && extent.is_finite() {
            let step = 2f64.powi(extent.log2().floor() as i32 - 20);
            self.points.iter_mut().flatten().for_each(|x| *x = ((f64::from(*x) / step).round() * step) as f32);
        }
        self
    }

    /// Box of the finite vertices.
    pub fn bounds(&self) -> ([f64; 3], [f64; 3]) {
        let mut low = [f64::INFINITY; 3];
        let mut high = [f64::NEG_INFINITY; 3];
        for p in self.points.iter().filter(|p| p.iter().all(|x| x.is_finite())) {
            for i in 0..3 {
                low[i] = low[i].min(p[i].into());
                high[i] = high[i].max(p[i].into());
            }
        }
        (low, high)
    }

    /// Centre and half diagonal of the box.
    pub fn ball(&self) -> ([f64; 3], f64) {
        let (low, high) = self.bounds();
        let center = std::array::from_fn(|i| 0.5 * (low[i] + high[i]));
        let radius = (0..3).map(|i| (high[i] - low[i]).powi(2)).sum::<f64>().sqrt() / 2.0;
        (center, radius)
    }
}

/// A cube of 12 triangles, from -1 to 1.
pub fn cube() -> Mesh {
    let points = (0..8).map(|i| [i & 1, i >> 1 & 1, i >> 2].map(|b| if b == 0 { -1.0 } else { 1.0 })).collect();
    let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    Mesh::new(points, quads.iter().flat_map(|q| [[q[0], q[1], q[2]], [q[0], q[2], q[3]]]).collect())
}

/// A closed tetrahedron with random corners.
pub fn tetrahedron(random: &mut Random) -> Mesh {
    let points = (0..4).map(|_| [0; 3].map(|_| random.signed() as f32)).collect();
    Mesh::new(points, vec![[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]])
}

/// An octahedron subdivided `levels` times and pushed to the sphere, roughened by `noise`: closed, 8 * 4^levels triangles.
pub fn sphere(levels: u32, noise: f64, random: &mut Random) -> Mesh {
    let mut points: Vec<[f64; 3]> =
        vec![[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0]];
    let mut faces: Vec<[u32; 3]> =
        vec![[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]];
    for _ in 0..levels {
        let mut middles = HashMap::new();
        let mut next = Vec::with_capacity(4 * faces.len());
        for f in &faces {
            let m = [0, 1, 2].map(|k| {
                let (a, b) = (f[k], f[(k + 1) % 3]);
                *middles.entry((a.min(b), a.max(b))).or_insert_with(|| {
                    let p: [f64; 3] = std::array::from_fn(|i| points[a as usize][i] + points[b as usize][i]);
                    let length = p.iter().map(|x| x * x).sum::<f64>().sqrt();
                    points.push(p.map(|x| x / length));
                    points.len() as u32 - 1
                })
            });
            next.extend([[f[0], m[0], m[2]], [m[0], f[1], m[1]], [m[2], m[1], f[2]], m]);
        }
        faces = next;
    }
    let rough = points
        .iter()
        .map(|p| {
            let r = 1.0 + noise * random.signed();
            p.map(|x| (x * r) as f32)
        })
        .collect();
    Mesh::new(rough, faces)
}

/// A height field of n x n cells over -1..1, open, with heights up to `height`; 0 = flat.
pub fn field(n: usize, height: f64, random: &mut Random) -> Mesh {
    let at = |k: usize| (2.0 * k as f64 / n as f64 - 1.0) as f32;
    let points =
        (0..(n + 1) * (n + 1)).map(|k| [at(k % (n + 1)), at(k / (n + 1)), (height * random.signed()) as f32]).collect();
    let v = |x: usize, y: usize| (y * (n + 1) + x) as u32;
    let cells = (0..n * n).map(|k| (k % n, k / n));
    let faces = cells
        .flat_map(|(x, y)| [[v(x, y), v(x + 1, y), v(x + 1, y + 1)], [v(x, y), v(x + 1, y + 1), v(x, y + 1)]])
        .collect();
    Mesh::new(points, faces)
}

/// n triangles around a hub, closed to a ring.
pub fn fan(n: usize, hub: [f32; 3], random: &mut Random) -> Mesh {
    let mut points = vec![hub];
    for k in 0..n {
        let phi = std::f64::consts::TAU * k as f64 / n as f64;
        points.push([hub[0] + phi.cos() as f32, hub[1] + phi.sin() as f32, hub[2] + (0.3 * random.signed()) as f32]);
    }
    let n = n as u32;
    Mesh::new(points, (0..n).map(|k| [0, 1 + k, 1 + (k + 1) % n]).collect())
}

/// Random triangles of about the given size in -1..1.
pub fn soup(n: usize, size: f64, random: &mut Random) -> Mesh {
    Mesh::soup((0..n).map(|_| {
        let c = [0; 3].map(|_| random.signed());
        [0; 3].map(|_| c.map(|x| (x + size * random.signed()) as f32))
    }))
}

/// Needles 1 : 10^7 and caps of an ulp, and slivers seen at half a degree.
pub fn slivers(n: usize, random: &mut Random) -> Mesh {
    Mesh::soup((0..n).map(|k| {
        let a: [f32; 3] = [0; 3].map(|_| random.signed() as f32);
        let along = random.direction();
        let b = std::array::from_fn(|i| a[i] + along[i] as f32);
        let c = match k % 3 {
            0 => std::array::from_fn(|i| a[i] + (1e-7 * random.signed()) as f32),
            1 => {
                let mut c: [f32; 3] = std::array::from_fn(|i| 0.5 * (a[i] + b[i]));
                c[k % 3] = c[k % 3].next_up();
                c
            }
            _ => {
                // Edges in the proportion 11.2 : 9.7 : 1.4, rounded to a tenth (exactly so they would not close).
                let side = random.direction();
                let across = (0..3).map(|i| side[i] * along[i]).sum::<f64>();
                std::array::from_fn(|i| {
                    (f64::from(a[i]) + (9.72 * along[i] + 0.1 * (side[i] - across * along[i])) / 11.16) as f32
                })
            }
        };
        [a, b, c]
    }))
}
