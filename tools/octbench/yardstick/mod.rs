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

/// The closest hit by the test of every triangle.
pub fn closest_of_all(triangles: &[Corners], o: [f32; 3], d: [f32; 3], tmin: f32, tmax: f32) -> Option<PlainHit> {
    let mut best: Option<PlainHit> = None;
    for (face, corners) in (0..).zip(triangles) {
        if let Some((t, u, v)) = moller_trumbore::intersect(o, d, corners)
            && (tmin..=tmax).contains(&t)
            && best.is_none_or(|b| t < b.t)
        {
            best = Some(PlainHit { t, face, u, v });
        }
    }
    best
}
