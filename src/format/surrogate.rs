//! What stands for all triangles of a node where it is seen from so far that they are not told apart: FORMAT.md, "Surrogate".

use bytemuck::{Pod, Zeroable};
use glam::{DVec3, Vec3};

use super::Frame;

/// A surrogate as it is stored; FORMAT.md, "Surrogate".
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct Surrogate {
    /// Mean normal, octahedral: two signed fractions of 32767.
    pub normal: [i16; 2],
    /// Plane: its distance from the corner of the node's frame along the normal, in 64ths of the frame's largest unit.
    pub offset: i16,
    /// Largest distance of anything in the node's box from the plane, in largest units, rounded up.
    pub deviation: u8,
    /// Cosine of the angle between the mean normal and the one farthest from it, times 127 and rounded down, plus 128.
    pub cone: u8,
    /// Area of the triangles seen along each axis by that of the box's face, in 255ths; 255 also for more.
    pub coverage: [u8; 3],
    /// Length of the mean of the unit normals by area, in 255ths, rounded down.
    pub agreement: u8,
    /// Mean diffuse colour, linear, in 255ths; white where there are no materials.
    pub color: [u8; 3],
    /// Zero.
    pub zero: u8,
}

const _: () = assert!(size_of::<Surrogate>() == 16);

/// What a surrogate is made of, its plane in root units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Patch {
    /// Mean normal by area and winding, of unit length (to 2^-50).
    pub normal: DVec3,
    /// The plane is n.x = offset.
    pub offset: f64,
    /// Everything in the node's box is at most so far from the plane.
    pub deviation: f64,
    /// The cosine of a cone around the normal that holds all normals.
    pub cone: f64,
    /// Length of the mean of the unit normals by area, 0..=1: how far they agree.
    pub agreement: f64,
    /// Area of the triangles seen along each axis by that of the box's face, 0..=1.
    pub coverage: [f64; 3],
    /// Mean diffuse colour, linear.
    pub color: [f64; 3],
}

/// Steps of an offset in a largest unit.
const STEPS: f64 = 64.0;
/// Added to deviations: more than rounding in root units (2^-45 at most) and less than the least unit by far.
const ROUNDING: f64 = 1.0 / (1u64 << 42) as f64;

impl Surrogate {
    /// The stored form of a mean normal, and the unit vector that it stands for.
    pub fn normal(direction: DVec3) -> ([i16; 2], DVec3) {
        let n = direction / direction.abs().element_sum();
        // Octahedral (Meyer et al., "On floating-point normal vectors", 2010): the lower half is folded over the upper.
        let fold = |a: f64, b: f64| (1.0 - b.abs()).copysign(if a == 0.0 { 1.0 } else { a });
        let (x, y) = if n.z < 0.0 { (fold(n.x, n.y), fold(n.y, n.x)) } else { (n.x, n.y) };
        // A sum of zero, or none: any direction will do.
        let store = |x: f64| (x * 32767.0).round().clamp(-32767.0, 32767.0) as i16;
        let stored = [store(x), store(y)];
        (stored, direction_of(stored))
    }

    /// Stores a patch of a node with this frame; `normal` is from [`Surrogate::normal`], and what lies between `low` and `high` along it
    /// (measured from the origin of root units) is the patch.
    pub fn of(normal: [i16; 2], [low, high]: [f64; 2], frame: &Frame, patch: &Patch) -> Surrogate {
        let base = direction_of(normal).dot(DVec3::from_array(frame.corner));
        let unit = largest_unit(frame);
        let (low, high) = ((low - base) / unit, (high - base) / unit);
        let offset = ((low + high) * 0.5 * STEPS).round().clamp(-32767.0, 32767.0) as i16;
        let middle = f64::from(offset) / STEPS;
        let deviation = ((high - middle).max(middle - low) + ROUNDING / unit).ceil().clamp(0.0, 255.0) as u8;
        let part = |x: f64| (x.clamp(0.0, 1.0) * 255.0).round() as u8;
        Surrogate {
            normal,
            offset,
            deviation,
            cone: ((patch.cone.clamp(-1.0, 1.0) - 1e-9) * 127.0).floor().max(-127.0) as i8 as u8 ^ 0x80,
            coverage: patch.coverage.map(part),
            agreement: (patch.agreement.clamp(0.0, 1.0) * 255.0).floor() as u8,
            color: patch.color.map(part),
            zero: 0,
        }
    }

    /// What is stored, for a node with this frame.
    #[inline]
    pub fn patch(&self, frame: &Frame) -> Patch {
        let normal = direction_of(self.normal);
        let unit = largest_unit(frame);
        let part = |x: u8| f64::from(x) / 255.0;
        Patch {
            normal,
            offset: normal.dot(DVec3::from_array(frame.corner)) + f64::from(self.offset) / STEPS * unit,
            deviation: f64::from(self.deviation) * unit,
            cone: f64::from((self.cone ^ 0x80) as i8) / 127.0,
            agreement: part(self.agreement),
            coverage: self.coverage.map(part),
            color: self.color.map(part),
        }
    }
}

/// The unit vector that a stored normal stands for: in f64, so that all agree on it to the last bit.
#[inline]
fn direction_of([x, y]: [i16; 2]) -> DVec3 {
    let (x, y) = (f64::from(x) / 32767.0, f64::from(y) / 32767.0);
    let z = 1.0 - x.abs() - y.abs();
    let fold = |a: f64, b: f64| if z < 0.0 { (1.0 - b.abs()).copysign(a) } else { a };
    DVec3::new(fold(x, y), fold(y, x), z).normalize_or(DVec3::Z)
}

/// The largest unit of a frame.
#[inline]
fn largest_unit(frame: &Frame) -> f64 {
    frame.unit[0].max(frame.unit[1]).max(frame.unit[2])
}

/// A closed box in root units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RootBox {
    /// Lowest corner.
    pub low: DVec3,
    /// Highest corner.
    pub high: DVec3,
}

impl RootBox {
    /// All that the planes of a node with this frame can name: its own box lies within.
    pub fn of_frame(frame: &Frame) -> RootBox {
        let low = DVec3::from_array(frame.corner);
        RootBox { low, high: low + 256.0 * DVec3::from_array(frame.unit) }
    }

    /// The box of a slot of a node with this frame; exact.
    #[inline]
    pub fn of_slot(node: &super::Node, slot: usize, frame: &Frame) -> RootBox {
        let (corner, unit) = (DVec3::from_array(frame.corner), DVec3::from_array(frame.unit));
        let at = |q: &[[u8; 8]; 3]| corner + unit * DVec3::from_array(q.map(|q| f64::from(q[slot & 7])));
        RootBox { low: at(&node.low), high: at(&node.high) }
    }

    /// The least and greatest n.x of its points, to f64 accuracy.
    #[inline]
    pub fn support(&self, n: DVec3) -> [f64; 2] {
        let (a, b) = (n * self.low, n * self.high);
        [a.min(b).element_sum(), a.max(b).element_sum()]
    }

    /// The squared distance from a point to the corner farthest from it.
    #[inline]
    pub fn farthest_squared(&self, p: DVec3) -> f64 {
        (p - self.low).abs().max((self.high - p).abs()).length_squared()
    }

    /// Areas of its faces across x, y and z.
    #[inline]
    pub fn faces(&self) -> DVec3 {
        let d = self.high - self.low;
        DVec3::new(d.y * d.z, d.z * d.x, d.x * d.y)
    }
}

/// Normals, areas and colours of triangles, summed.
#[derive(Clone, Copy, Debug, Default)]
pub struct Moments {
    /// Sum of the area vectors.
    pub vector: DVec3,
    /// Sum of their components' magnitudes: the areas seen along the axes, repeats counted.
    pub seen: DVec3,
    /// Sum of the areas.
    pub area: f64,
    /// Sum of area times colour.
    pub color: DVec3,
}

impl Moments {
    /// Of one triangle.
    pub fn of_triangle([a, b, c]: [DVec3; 3], color: Vec3) -> Moments {
        let vector = 0.5 * (b - a).cross(c - a);
        let area = vector.length();
        Moments { vector, seen: vector.abs(), area, color: area * color.as_dvec3() }
    }

    /// Those of a part of the area, 0..=1.
    pub fn times(self, part: f64) -> Moments {
        let Moments { vector, seen, area, color } = self;
        Moments { vector: part * vector, seen: part * seen, area: part * area, color: part * color }
    }

    /// Those that a stored surrogate stands for, whose node's box is `bounds`.
    pub fn of_patch(patch: &Patch, bounds: &RootBox) -> Moments {
        let seen = DVec3::from_array(patch.coverage) * bounds.faces();
        let area = seen.length();
        let vector = patch.normal * (area * patch.agreement);
        Moments { vector, seen, area, color: area * DVec3::from_array(patch.color) }
    }

    /// The patch with these moments whose box is `bounds`, but for the plane.
    pub fn patch(&self, normal: DVec3, cone: f64, bounds: &RootBox) -> Patch {
        let by = |a: f64, b: f64, otherwise: f64| if b > 0.0 { a / b } else { otherwise };
        let faces = bounds.faces();
        Patch {
            normal,
            offset: 0.0,
            deviation: 0.0,
            cone,
            agreement: by(self.vector.length(), self.area, 0.0),
            coverage: [0, 1, 2].map(|i| by(self.seen[i], faces[i], f64::from(u8::from(self.seen[i] > 0.0))).min(1.0)),
            color: [0, 1, 2].map(|i| by(self.color[i], self.area, 1.0)),
        }
    }
}

impl std::ops::AddAssign for Moments {
    fn add_assign(&mut self, other: Moments) {
        self.vector += other.vector;
        self.seen += other.seen;
        self.area += other.area;
        self.color += other.color;
    }
}

/// The cosine of the sum of two angles given by their cosines; -1 from 180 degrees on.
pub fn cosine_of_sum(a: f64, b: f64) -> f64 {
    let sine = |c: f64| (1.0 - c * c).max(0.0).sqrt();
    // a + b passes 180 degrees where cos a < cos (180 - b).
    if a <= -b { -1.0 } else { a * b - sine(a) * sine(b) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn normals_come_back(x in -1.0f64..1.0, y in -1.0f64..1.0, z in -1.0f64..1.0) {
            let n = DVec3::new(x, y, z);
            prop_assume!(n.length() > 1e-3);
            let (stored, decoded) = Surrogate::normal(n);
            prop_assert!((decoded.length() - 1.0).abs() < 1e-12);
            prop_assert!(decoded.dot(n.normalize()) > 1.0 - 1e-8, "{:?} {:?}", n, decoded);
            prop_assert_eq!(direction_of(stored), decoded);
        }

        /// The stored slab holds what lies between the two numbers, and is not much wider.
        #[test]
        fn slabs_hold_what_they_should(
            n in prop::array::uniform3(-1.0f64..1.0), corner in prop::array::uniform3(0.0f64..1.0), exponent in -30i32..-8,
            middle in -100.0f64..100.0, half in 0.0f64..200.0, cone in -1.0f64..1.0,
        ) {
            let n = DVec3::from_array(n);
            prop_assume!(n.length() > 1e-3);
            let unit = 2f64.powi(exponent);
            let corner = corner.map(|c| (c * 16_777_216.0).floor() / 16_777_216.0);
            let frame = Frame { corner, unit: [unit, unit / 4.0, unit / 2.0] };
            let (stored, normal) = Surrogate::normal(n);
            let base = normal.dot(DVec3::from_array(corner));
            let [low, high] = [base + (middle - half) * unit, base + (middle + half) * unit];
            let about = Patch { normal, offset: 0.0, deviation: 0.0, cone, agreement: 0.5, coverage: [0.2; 3], color: [1.0; 3] };
            let patch = Surrogate::of(stored, [low, high], &frame, &about).patch(&frame);
            prop_assert!(patch.offset - patch.deviation <= low && patch.offset + patch.deviation >= high);
            prop_assert!(patch.deviation <= (half + 2.0) * unit);
            prop_assert!(patch.cone <= cone && patch.cone > cone - 0.02);
        }

        #[test]
        fn cones_add(a in 0.0f64..3.1, b in 0.0f64..3.1) {
            let sum = (a + b).min(std::f64::consts::PI);
            prop_assert!((cosine_of_sum(a.cos(), b.cos()) - sum.cos()).abs() < 1e-9);
        }
    }

    #[test]
    fn directions_without_length_are_some_direction() {
        for n in [DVec3::ZERO, DVec3::NAN, DVec3::splat(f64::INFINITY)] {
            assert!((Surrogate::normal(n).1.length() - 1.0).abs() < 1e-12);
        }
    }
}
