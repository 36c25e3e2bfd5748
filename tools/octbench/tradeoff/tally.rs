//! What is wrong with a tracer's hits: errors, and answers that are merely other ones.

use octrace::geometry::{FaceId, Hit, Ray};
use serde::Serialize;

use crate::accuracy::judge::ulps;
use crate::families::mesh::Mesh;
use crate::oracle::{Answer, Oracle, OracleRay, TierCounts};

/// Another face that meets the right one counts as the same point if t is no further off than this, in ulps.
const SAME_POINT: u64 = 16;

/// A tracer's answers, sorted out. A ray is counted in one of `right`, `missed`, `false_hits`, `wrong_triangle`, `neighbour` and `tie`.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Tally {
    /// Rays.
    pub rays: u64,
    /// The right triangle, or rightly none.
    pub right: u64,
    /// Nothing found where something is.
    pub missed: u64,
    /// Something found where nothing is.
    #[serde(rename = "false")]
    pub false_hits: u64,
    /// A triangle elsewhere.
    pub wrong_triangle: u64,
    /// A triangle that shares a corner with the right one, at the same distance but for rounding: beside the edge, not through it.
    pub neighbour: u64,
    /// A triangle that is hit at exactly the same t, as duplicated faces are: the tie was broken otherwise.
    pub tie: u64,
    /// Distance of t from the correctly rounded one, where the triangle is right, in ulps: 0, 1, 2-3, 4-15, 16 and more.
    pub t_ulps: [u64; 5],
    /// The largest such distance.
    pub t_ulps_most: u64,
}

impl Tally {
    /// Compares hits with the oracle's answers to the rays.
    pub fn new<'a>(mesh: &Mesh, asked: impl Iterator<Item = (&'a Ray, &'a Option<Answer>)>, hits: &[Hit]) -> Tally {
        let mut tally = Tally { rays: hits.len() as u64, ..Tally::default() };
        for ((ray, truth), hit) in asked.zip(hits) {
            match (truth, hit.face != FaceId::NONE) {
                (None, false) => tally.right += 1,
                (None, true) => tally.false_hits += 1,
                (Some(_), false) => tally.missed += 1,
                (Some(t), true) if t.face == hit.face.0 => tally.count_right(ulps(t.t, hit.t)),
                (Some(t), true) if is_tie(mesh, ray, t, hit) => tally.tie += 1,
                (Some(t), true) if is_neighbour(mesh, t, hit) => tally.neighbour += 1,
                _ => tally.wrong_triangle += 1,
            }
        }
        tally
    }

    fn count_right(&mut self, off: u64) {
        self.right += 1;
        let class = match off {
            0 => 0,
            1 => 1,
            2..4 => 2,
            4..16 => 3,
            _ => 4,
        };
        self.t_ulps[class] += 1;
        self.t_ulps_most = self.t_ulps_most.max(off);
    }

    /// Rays whose answer is an error: missed, false, or a triangle elsewhere.
    pub fn errors(&self) -> u64 {
        self.missed + self.false_hits + self.wrong_triangle
    }

    /// Share of rays with an error.
    pub fn error_rate(&self) -> f64 {
        self.errors() as f64 / self.rays.max(1) as f64
    }

    /// The 95 % bound on that share where no error was seen (the rule of three).
    pub fn bound(&self) -> f64 {
        3.0 / self.rays.max(1) as f64
    }

    /// Rays whose t is not the nearest f32, among those with the right triangle.
    pub fn t_off(&self) -> u64 {
        self.t_ulps[1..].iter().sum()
    }

    /// Whether all is as the oracle says, to the last bit of t.
    pub fn is_exact(&self) -> bool {
        self.right == self.rays && self.t_off() == 0
    }

    /// The sum of two.
    pub fn and(&self, other: &Tally) -> Tally {
        Tally {
            rays: self.rays + other.rays,
            right: self.right + other.right,
            missed: self.missed + other.missed,
            false_hits: self.false_hits + other.false_hits,
            wrong_triangle: self.wrong_triangle + other.wrong_triangle,
            neighbour: self.neighbour + other.neighbour,
            tie: self.tie + other.tie,
            t_ulps: std::array::from_fn(|i| self.t_ulps[i] + other.t_ulps[i]),
            t_ulps_most: self.t_ulps_most.max(other.t_ulps_most),
        }
    }
}

/// The oracle's form of a ray.
pub fn oracle_ray(ray: &Ray) -> OracleRay {
    OracleRay { o: ray.origin, d: ray.direction, tmin: ray.tmin, tmax: ray.tmax }
}

/// Whether the hit triangle is hit at exactly the right one's t: then, of the two alone, the oracle takes whichever has the lower number.
fn is_tie(mesh: &Mesh, ray: &Ray, truth: &Answer, hit: &Hit) -> bool {
    let (right, got) = (truth.face as usize, hit.face.0 as usize);
    if got >= mesh.faces.len() {
        return false;
    }
    let first = |a: usize, b: usize| {
        let two = Oracle::new([(0, mesh.corners(a)), (1, mesh.corners(b))]);
        two.closest(&oracle_ray(ray), &[], &mut TierCounts::default()).map(|answer| answer.face)
    };
    first(right, got) == Some(0) && first(got, right) == Some(0)
}

/// Whether the hit triangle shares a corner with the right one, and t is about the same.
fn is_neighbour(mesh: &Mesh, truth: &Answer, hit: &Hit) -> bool {
    let (right, got) = (truth.face as usize, hit.face.0 as usize);
    if got >= mesh.faces.len() || ulps(truth.t, hit.t) > SAME_POINT {
        return false;
    }
    let corners = mesh.corners(right);
    mesh.corners(got).iter().any(|corner| corners.contains(corner))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two triangles with an edge in common, a copy of the first, and one behind.
    fn mesh() -> Mesh {
        let points = vec![
            [0.0, 0.0, 0.0],
            [1.0, 0.0, 0.0],
            [0.0, 1.0, 0.0],
            [1.0, 1.0, 0.0],
            [0.0, 0.0, -1.0],
            [1.0, 0.0, -1.0],
            [0.0, 1.0, -1.0],
        ];
        Mesh::new(points, vec![[0, 1, 2], [1, 3, 2], [0, 1, 2], [4, 5, 6]])
    }

    #[test]
    fn every_kind_of_answer_is_told_apart() {
        let mesh = mesh();
        let down = Ray::new([0.25, 0.25, 1.0], [0.0, 0.0, -1.0]);
        let beside = Ray::new([5.0, 5.0, 1.0], [0.0, 0.0, -1.0]);
        let rays = [down; 8].into_iter().chain([beside; 2]).collect::<Vec<_>>();
        let oracle = Oracle::new(mesh.triangles().enumerate().map(|(i, c)| (i as u32, c)));
        let truths: Vec<_> =
            rays.iter().map(|r| oracle.closest(&oracle_ray(r), &[], &mut TierCounts::default())).collect();
        let hit = |t: f32, face: u32| Hit { t, face: FaceId(face), u: 0.25, v: 0.25 };
        let hits = [
            hit(1.0, 0),
            hit(1.0f32.next_up(), 0),
            hit(1.00001, 0),
            Hit::MISS,
            hit(2.0, 3),
            hit(1.0f32.next_down(), 1),
            hit(1.0, 2),
            hit(1.5, 1),
            Hit::MISS,
            hit(1.0, 0),
        ];
        let tally = Tally::new(&mesh, rays.iter().zip(&truths), &hits);
        let expected = Tally {
            rays: 10,
            right: 4,
            missed: 1,
            false_hits: 1,
            wrong_triangle: 2,
            neighbour: 1,
            tie: 1,
            t_ulps: [1, 1, 0, 0, 1],
            t_ulps_most: 84,
        };
        assert_eq!(tally, expected);
        assert_eq!((tally.errors(), tally.t_off(), tally.is_exact()), (4, 2, false));
        let twice = tally.and(&tally);
        assert_eq!((twice.rays, twice.errors(), twice.t_ulps_most, twice.error_rate()), (20, 8, 84, 0.4));
        assert!(Tally::new(&mesh, rays.iter().zip(&truths), &hits[..1]).is_exact());
    }
}
