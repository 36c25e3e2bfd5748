//! `octbench mesh`: a closed planet of any size as OBJ, streaming.
//!
//! A cube's six sides, each of n x n squares, pushed out to a sphere and displaced by hills: sums of sines that depend on the
//! place alone, so that a vertex can be made whenever it is wanted and nothing is held in memory. Vertices on the cube's edges
//! and corners are shared, so the surface is closed.

use std::f64::consts::FRAC_PI_4;
use std::io::Write;

use octrace::event::Monitor;
use octrace::{Error, Result};

use crate::families::mesh::Mesh;
use crate::random::Random;

/// A planet of 12 n^2 triangles.
pub struct Planet {
    n: u64,
    hills: Vec<Hill>,
}

/// One wave: wave vector, phase, height.
struct Hill {
    k: [f64; 3],
    phase: f64,
    height: f64,
}

impl Planet {
    /// A planet of about so many triangles (at least 12).
    pub fn new(triangles: u64, seed: u64) -> Planet {
        let n = ((triangles as f64 / 12.0).sqrt().round() as u64).max(1);
        let mut random = Random::new(seed);
        let hills = (0..24)
            .map(|i| {
                // Each octave doubles the frequency and halves the height.
                let octave = f64::from(i / 4 + 1);
                let d = random.direction();
                Hill { k: d.map(|x| x * octave.exp2()), phase: 7.0 * random.unit(), height: 0.05 * (-octave).exp2() }
            })
            .collect();
        Planet { n, hills }
    }

    /// Triangles.
    pub fn triangles(&self) -> u64 {
        12 * self.n * self.n
    }

    /// Vertices.
    pub fn vertices(&self) -> u64 {
        6 * self.n * self.n + 2
    }

    /// Number of the vertex at a grid point of the cube's surface, each coordinate in 0..=n, one of them 0 or n.
    ///
    /// Layers along z: a full square at either end, rings between.
    fn number(&self, [x, y, z]: [u64; 3]) -> u64 {
        let n = self.n;
        let (square, ring) = ((n + 1) * (n + 1), 4 * n);
        if z == 0 {
            return y * (n + 1) + x;
        }
        if z == n {
            return square + (n - 1) * ring + y * (n + 1) + x;
        }
        let around = match (x, y) {
            (x, 0) if x < n => x,
            (x, y) if x == n && y < n => n + y,
            (x, y) if y == n && x > 0 => 3 * n - x,
            (_, y) => 4 * n - y,
        };
        square + (z - 1) * ring + around
    }

    /// The grid point of a vertex: the other way round.
    fn grid(&self, number: u64) -> [u64; 3] {
        let n = self.n;
        let (square, ring) = ((n + 1) * (n + 1), 4 * n);
        if number < square {
            return [number % (n + 1), number / (n + 1), 0];
        }
        let rest = number - square;
        if rest >= (n - 1) * ring {
            let rest = rest - (n - 1) * ring;
            return [rest % (n + 1), rest / (n + 1), n];
        }
        let (z, around) = (1 + rest / ring, rest % ring);
        let k = around % n;
        match around / n {
            0 => [k, 0, z],
            1 => [n, k, z],
            2 => [n - k, n, z],
            _ => [0, n - k, z],
        }
    }

    /// Where a vertex lies.
    pub fn vertex(&self, number: u64) -> [f32; 3] {
        // Equal angles rather than equal steps, so that squares are of similar size.
        let on_cube = self.grid(number).map(|i| (FRAC_PI_4 * (2.0 * i as f64 / self.n as f64 - 1.0)).tan());
        let length = on_cube.iter().map(|x| x * x).sum::<f64>().sqrt();
        let p = on_cube.map(|x| x / length);
        let hill = |h: &Hill| h.height * (h.k[0] * p[0] + h.k[1] * p[1] + h.k[2] * p[2] + h.phase).sin();
        let r = 1.0 + self.hills.iter().map(hill).sum::<f64>();
        p.map(|x| (x * r) as f32)
    }

    /// The corners of a face, seen from outside in turn.
    pub fn face(&self, number: u64) -> [u64; 3] {
        let n = self.n;
        let (square, half) = (number / 2, number % 2);
        let (side, place) = (square / (n * n), square % (n * n));
        let (i, j) = (place % n, place / n);
        let (axis, high) = ((side / 2) as usize, side % 2 == 1);
        let corner = |u: u64, v: u64| {
            let mut p = [0; 3];
            p[axis] = if high { n } else { 0 };
            p[(axis + 1) % 3] = i + u;
            p[(axis + 2) % 3] = j + v;
            self.number(p)
        };
        let [a, b, c] = if half == 0 {
            [corner(0, 0), corner(1, 0), corner(1, 1)]
        } else {
            [corner(0, 0), corner(1, 1), corner(0, 1)]
        };
        if high { [a, b, c] } else { [a, c, b] }
    }

    /// Writes the planet as OBJ; `shuffled`: faces in the order of a pseudorandom permutation.
    pub fn write(&self, out: &mut impl Write, shuffled: Option<u64>, monitor: Monitor<'_>) -> Result<()> {
        let failed = || Error::io("the planet's OBJ", "write");
        let total = self.vertices() + self.triangles();
        let told = |done: u64| {
            if done.is_multiple_of(1 << 16) {
                monitor.progress(done, Some(total), "lines");
                monitor.check()?;
            }
            Ok::<_, Error>(())
        };
        monitor.phase("planet");
        for k in 0..self.vertices() {
            let [x, y, z] = self.vertex(k);
            writeln!(out, "v {x} {y} {z}").map_err(failed())?;
            told(k)?;
        }
        let order = Shuffle::new(self.triangles(), shuffled);
        for k in 0..self.triangles() {
            let [a, b, c] = self.face(order.at(k)).map(|v| v + 1);
            writeln!(out, "f {a} {b} {c}").map_err(failed())?;
            told(self.vertices() + k)?;
        }
        Ok(())
    }
}

/// A permutation of 0..n without a table: a Feistel network over the next power of four, walked until it lands below n.
struct Shuffle {
    n: u64,
    half_bits: u32,
    seed: Option<u64>,
}

impl Shuffle {
    fn new(n: u64, seed: Option<u64>) -> Shuffle {
        let bits = u64::BITS - (n - 1).leading_zeros();
        Shuffle { n, half_bits: bits.div_ceil(2).max(1), seed }
    }

    fn at(&self, k: u64) -> u64 {
        let Some(seed) = self.seed else { return k };
        let mut k = self.once(k, seed);
        while k >= self.n {
            k = self.once(k, seed);
        }
        k
    }

    fn once(&self, k: u64, seed: u64) -> u64 {
        let mask = (1 << self.half_bits) - 1;
        let (mut left, mut right) = (k >> self.half_bits, k & mask);
        for round in 0..4 {
            let mixed = Random::new(seed ^ right << 3 ^ round).bits() & mask;
            (left, right) = (right, left ^ mixed);
        }
        left << self.half_bits | right
    }
}

/// A planet in memory.
pub fn mesh(triangles: u64, seed: u64) -> Mesh {
    let planet = Planet::new(triangles, seed);
    let points = (0..planet.vertices()).map(|k| planet.vertex(k)).collect();
    Mesh::new(points, (0..planet.triangles()).map(|k| planet.face(k).map(|v| v as u32)).collect())
}

#[cfg(test)]
mod tests {
    use std::collections::{HashMap, HashSet};

    use super::*;

    #[test]
    fn closed_and_turned_outward() {
        for triangles in [12, 48, 700] {
            let mesh = mesh(triangles, 3);
            let mut edges = HashMap::new();
            for f in &mesh.faces {
                for k in 0..3 {
                    *edges.entry((f[k], f[(k + 1) % 3])).or_insert(0) += 1;
                }
            }
            assert!(edges.iter().all(|(&(a, b), &n)| n == 1 && edges.get(&(b, a)) == Some(&1)));
            assert_eq!(edges.keys().map(|e| e.0).collect::<HashSet<_>>().len(), mesh.points.len());
            let [a, b, c] = mesh.corners(0).map(glam::Vec3::from);
            assert!((b - a).cross(c - a).dot(a) > 0.0);
        }
    }

    #[test]
    fn numbers_and_grid_points_agree() {
        let planet = Planet::new(12 * 25, 1);
        assert!((0..planet.vertices()).all(|k| planet.number(planet.grid(k)) == k));
    }

    #[test]
    fn a_shuffle_is_a_permutation() {
        for n in [1, 2, 12, 300, 1000] {
            let order = Shuffle::new(n, Some(5));
            assert_eq!((0..n).map(|k| order.at(k)).collect::<HashSet<_>>().len() as u64, n);
        }
    }
}
