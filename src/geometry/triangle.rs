//! A triangle by its three corners.

use bytemuck::{Pod, Zeroable};
use glam::Vec3;

/// A triangle; its corners are exact f32 points, in the source's order.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Triangle {
    /// First corner (weight 1 - u - v).
    pub a: Vec3,
    /// Second corner (weight u).
    pub b: Vec3,
    /// Third corner (weight v).
    pub c: Vec3,
}

impl Triangle {
    /// The three corners.
    pub fn vertices(&self) -> [Vec3; 3] {
        [self.a, self.b, self.c]
    }

    /// Whether every coordinate is finite.
    pub fn is_finite(&self) -> bool {
        self.vertices().iter().all(|v| v.is_finite())
    }
}

impl From<[[f32; 3]; 3]> for Triangle {
    fn from([a, b, c]: [[f32; 3]; 3]) -> Triangle {
        Triangle { a: a.into(), b: b.into(), c: c.into() }
    }
}
