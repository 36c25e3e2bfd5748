//! What the splitters sort: boxes of triangles or of parts of them.

use glam::{DVec3, Vec3A};

use crate::geometry::{Aabb, Triangle};

/// The box of a triangle, or of a part of it, and the triangle's number in canonical order; 32 bytes.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(16))]
pub(super) struct Primitive {
    /// Lowest corner of the box.
    pub min: [f32; 3],
    /// Number of the triangle in canonical order.
    pub id: u32,
    /// Highest corner.
    pub max: [f32; 3],
    /// 1 where the triangle's box is so large that spatial splits are worth a look, else 0.
    pub large: u32,
}

impl Primitive {
    /// What fills the room behind a list.
    pub const NOTHING: Primitive = Primitive { min: [0.0; 3], id: u32::MAX, max: [0.0; 3], large: 0 };

    /// The primitive of the triangle with canonical number `id`.
    pub fn new(id: u32, triangle: &Triangle) -> Primitive {
        let Aabb { min, max } = Aabb::from(triangle);
        Primitive { min: min.to_array(), id, max: max.to_array(), large: 0 }
    }

    /// The part of it inside `span`.
    pub fn within(self, span: Span) -> Primitive {
        Primitive { min: span.min.to_array(), max: span.max.to_array(), ..self }
    }

    /// Lowest corner of its box.
    pub fn min(&self) -> Vec3A {
        Vec3A::from_array(self.min)
    }

    /// Highest corner of its box.
    pub fn max(&self) -> Vec3A {
        Vec3A::from_array(self.max)
    }

    /// Its box.
    pub fn span(&self) -> Span {
        Span { min: self.min(), max: self.max() }
    }

    /// Half the centre of the box: no sum of finite coordinates, and no difference of two centres, overflows.
    pub fn centre(&self) -> Vec3A {
        0.25 * self.min() + 0.25 * self.max()
    }
}

/// A box in registers.
#[derive(Clone, Copy, Debug)]
pub(super) struct Span {
    /// Lowest corner.
    pub min: Vec3A,
    /// Highest corner.
    pub max: Vec3A,
}

impl Span {
    /// The box that holds nothing.
    pub const EMPTY: Span = Span { min: Vec3A::INFINITY, max: Vec3A::NEG_INFINITY };

    /// The smallest box around this one and another.
    pub fn around(self, min: Vec3A, max: Vec3A) -> Span {
        Span { min: self.min.min(min), max: self.max.max(max) }
    }

    /// The same.
    pub fn union(self, other: Span) -> Span {
        self.around(other.min, other.max)
    }

    /// What both have in common; may be empty ([`Span::is_empty`]).
    pub fn common(self, other: Span) -> Span {
        Span { min: self.min.max(other.min), max: self.max.min(other.max) }
    }

    /// Whether no point lies in it.
    pub fn is_empty(self) -> bool {
        self.min.cmpgt(self.max).any()
    }

    /// Half the surface, 0 where empty. In f64: extents up to 2 FLT_MAX have finite areas, those of denormals are not 0.
    pub fn half_area(self) -> f64 {
        let wide = |v: Vec3A| DVec3::new(v.x.into(), v.y.into(), v.z.into());
        let d = (wide(self.max) - wide(self.min)).max(DVec3::ZERO);
        d.x * d.y + d.y * d.z + d.z * d.x
    }
}
