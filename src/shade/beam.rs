//! How wide rays are, for level of detail: a primary ray as a pixel, one that is mirrored or refracted goes on as it was, one to a light
//! as the ray was that met the surface there.

use glam::DMat3;

use super::object::{Contact, Part, Placed};
use super::ray::WorldRay;
use crate::trace::Footprint;

/// The width of a ray in world space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Beam {
    /// At its origin.
    pub width: f64,
    /// For each unit of distance.
    pub slope: f64,
    /// Whether it starts from a surrogate.
    pub lifted: bool,
}

impl Beam {
    /// A ray as thin as a line, which is always traced exactly.
    pub const LINE: Beam = Beam { width: 0.0, slope: 0.0, lifted: false };

    /// The beam at a contact of its ray.
    pub fn at(ray: &WorldRay, contact: &Contact) -> Beam {
        let distance = f64::from(contact.t) * ray.direction.length();
        let lifted = matches!(contact.part, Part::Surrogate(_));
        Beam { width: ray.beam.width + ray.beam.slope * distance, lifted, ..ray.beam }
    }

    /// That of a ray from there to a light.
    pub fn to_light(self) -> Beam {
        Beam { slope: 0.0, ..self }
    }
}

impl WorldRay {
    /// The same ray as wide as `slope` for each unit of distance from its origin.
    pub fn widening(mut self, slope: f64) -> WorldRay {
        self.beam = Beam { width: 0.0, slope, lifted: false };
        self
    }

    /// The ray's width in a mesh's space.
    pub(super) fn footprint(&self, placed: &Placed) -> Footprint {
        let Beam { width, slope, lifted } = self.beam;
        let scale = placed.to_local.map_or(1.0, |m| least_scale(&m.matrix3));
        Footprint { width: width * scale, spread: slope * scale * self.direction.length(), lifted }
    }
}

/// A lower bound of what a transform makes of a unit vector's length; exact where it scales alike in all directions.
pub(super) fn least_scale(m: &DMat3) -> f64 {
    let columns = [m.x_axis, m.y_axis, m.z_axis];
    let squares = columns.map(|c| c.length_squared());
    let least = squares[0].min(squares[1]).min(squares[2]);
    // Gershgorin's bound of the least eigenvalue of the transposed matrix times the matrix.
    let cross = |i: usize| columns[i].dot(columns[(i + 1) % 3]).abs() + columns[i].dot(columns[(i + 2) % 3]).abs();
    let most = cross(0).max(cross(1)).max(cross(2));
    (least - most).max(0.0).sqrt()
}

/// Surrogates that rays took for their hits.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DetailCounts {
    /// How many.
    pub hits: u64,
    /// The largest error, in pixels.
    pub largest: f64,
    /// How many had an error of up to an eighth, two eighths, ... of what was allowed.
    pub histogram: [u64; 8],
}

impl DetailCounts {
    /// Counts a hit with this error, of at most `allowed`.
    pub(super) fn add(&mut self, error: f64, allowed: f64) {
        self.hits += 1;
        self.largest = self.largest.max(error);
        let bin = (error / allowed * 8.0).ceil() as usize;
        self.histogram[bin.clamp(1, 8) - 1] += 1;
    }
}

impl std::ops::AddAssign for DetailCounts {
    fn add_assign(&mut self, other: DetailCounts) {
        self.hits += other.hits;
        self.largest = self.largest.max(other.largest);
        self.histogram.iter_mut().zip(other.histogram).for_each(|(sum, count)| *sum += count);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DQuat, DVec3};

    #[test]
    fn scales_are_bounded_below() {
        let turn = DMat3::from_quat(DQuat::from_rotation_x(0.7) * DQuat::from_rotation_z(1.9));
        assert!((least_scale(&(turn * 3.0)) - 3.0).abs() < 1e-9);
        let uneven = turn * DMat3::from_diagonal(DVec3::new(1.0, 2.0, 5.0));
        assert!((least_scale(&uneven) - 1.0).abs() < 1e-9);
        let shear = DMat3::from_cols(DVec3::X, DVec3::new(0.9, 0.2, 0.0), DVec3::Z);
        assert!(least_scale(&shear) <= (shear * DVec3::new(0.9, -1.0, 0.0).normalize()).length());
    }

    #[test]
    fn errors_are_counted_by_eighths() {
        let mut counts = DetailCounts::default();
        [0.0, 0.25, 0.26, 2.0].into_iter().for_each(|error| counts.add(error, 2.0));
        assert_eq!((counts.hits, counts.largest, counts.histogram), (4, 2.0, [2, 1, 0, 0, 0, 0, 0, 1]));
    }
}
