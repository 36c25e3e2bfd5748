//! How wide rays are, for level of detail: a primary ray as a pixel, one to a light as the ray was that met the surface there.
//!
//! A ray that is mirrored or refracted is as wide as what a pixel shows there, or less, never more: else an error of one of its widths would be more than a pixel
//! in the picture. A flat mirror changes nothing, a bulging one only spreads rays further. A flat boundary narrows them by Snell's law (Igehy,
//! "Tracing ray differentials", 1999; here the lesser of the two directions across the ray). Where rays may be gathered, in a lens, a hollow mirror, or by vertex normals, they go
//! on as lines, which are traced exactly.

use glam::DMat3;

use super::object::{Contact, Kind, Part, Placed};
use super::ray::WorldRay;
use super::spot::{Anchor, Spot};
use super::world::World;
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

    /// After a mirror of that bend.
    pub fn mirrored(self, bend: Bend) -> Beam {
        match bend {
            Bend::Flat | Bend::Bulging => self,
            Bend::Gathering => Beam::LINE,
        }
    }

    /// Behind a boundary of that bend, where light goes `eta` times as fast as before, or less: it came with the cosine `incoming` to the normal
    /// and goes on with `outgoing`.
    pub fn refracted(self, bend: Bend, eta: f64, [incoming, outgoing]: [f64; 2]) -> Beam {
        if bend != Bend::Flat || !(eta > 0.0 && incoming > 0.0 && outgoing > 0.0) {
            return Beam::LINE;
        }
        // In the plane of both rays angles change by eta incoming / outgoing, across it by eta; widths by outgoing / incoming, and not at all.
        let ratio = outgoing / incoming;
        Beam { width: self.width * ratio.min(1.0), slope: self.slope * eta * (1.0 / ratio).min(1.0), ..self }
    }
}

/// How a surface is bent where a ray meets it, as far as the width of rays goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Bend {
    /// Not at all: a triangle, a plane; or it counts as such: a surrogate.
    Flat,
    /// Toward the ray.
    Bulging,
    /// It may gather rays.
    Gathering,
}

impl World {
    /// How the surface is bent that a ray met.
    pub(super) fn bend(&self, spot: &Spot) -> Bend {
        match (&spot.anchor, &self.objects[spot.omit.object as usize].kind) {
            (Anchor::Smooth, Kind::Ball(_)) if spot.front => Bend::Bulging,
            (Anchor::Smooth, Kind::Ball(_)) => Bend::Gathering,
            // Normals that are made up between vertices.
            (Anchor::Triangle { .. }, _) if spot.shading != spot.normal => Bend::Gathering,
            _ => Bend::Flat,
        }
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

    /// A narrow beam is followed through a flat boundary ray by ray.
    #[test]
    fn refracted_rays_are_no_wider_than_they_should_be() {
        // From (0, 1, 0) at unit distance, down through the plane y = 0, then as far as `way`: where it is.
        let follow = |direction: DVec3, eta: f64| {
            let at = DVec3::Y - direction * (1.0 / direction.y);
            let (d, n) = (direction.normalize(), DVec3::Y);
            let cosine = -d.dot(n);
            let out = eta * d + (eta * cosine - (1.0 - eta * eta * (1.0 - cosine * cosine)).sqrt()) * n;
            (at, out)
        };
        let step = 1e-6;
        for (eta, way) in [1.0 / 1.5, 1.5, 1.0, 1.0 / 2.4].into_iter().flat_map(|eta| [(eta, 0.01), (eta, 3.0)]) {
            for lean in [0.0, 0.2, 0.6, 0.82] {
                let ahead = DVec3::new(lean, -1.0, 0.0);
                let (at, out) = follow(ahead, eta);
                let distance = (at - DVec3::Y).length();
                let beam = Beam { width: distance * step, slope: step, lifted: false };
                let cosines = [-ahead.normalize().y, -out.y];
                let claimed = beam.refracted(Bend::Flat, eta, cosines);
                let claimed = claimed.width + claimed.slope * way;
                // Rays a step away, in both directions across, where they pass the plane that stands on the ray there.
                let widths = [DVec3::new(1.0, lean, 0.0), DVec3::Z].map(|across| {
                    let (from, along) = follow(ahead + across.normalize() * step * ahead.length(), eta);
                    let p = at + out * way;
                    (from + along * ((p - from).dot(out) / along.dot(out)) - p).length()
                });
                let least = widths[0].min(widths[1]);
                assert!(claimed <= least * 1.0001, "{eta}, {lean}, {way}: {claimed} of {widths:?}");
                assert!(claimed >= least * 0.3, "{eta}, {lean}, {way}: {claimed} of {widths:?}");
            }
        }
        assert_eq!(Beam { slope: 1.0, ..Beam::LINE }.refracted(Bend::Bulging, 0.7, [1.0; 2]), Beam::LINE);
    }

    #[test]
    fn errors_are_counted_by_eighths() {
        let mut counts = DetailCounts::default();
        [0.0, 0.25, 0.26, 2.0].into_iter().for_each(|error| counts.add(error, 2.0));
        assert_eq!((counts.hits, counts.largest, counts.histogram), (4, 2.0, [2, 1, 0, 0, 0, 0, 0, 1]));
    }
}
