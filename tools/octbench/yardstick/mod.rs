//! The naive tracers to compare with: what one writes after reading the papers, in plain f32.
//!
//! They are the honest yardstick of what exactness buys and costs: a Möller-Trumbore test with the usual epsilon, and the
//! parametric octree traversal of Revelles, Ureña and Lastra (2000) just as published, with averaged midpoints, mirrored
//! directions and small numbers in place of zero components. They are not part of the library, and lose rays.

mod moller_trumbore;
mod revelles;

pub use revelles::PlainOctree;

/// A triangle as the yardsticks hold it.
pub type Corners = [[f32; 3]; 3];

/// t, face, u, v of a hit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlainHit {
    /// Distance.
    pub t: f32,
    /// The face.
    pub face: u32,
    /// Weight of the second corner.
    pub u: f32,
    /// Weight of the third corner.
    pub v: f32,
}
