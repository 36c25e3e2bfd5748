//! What the file says of a hit's surface beside its geometry.

use super::Found;
use crate::error::Result;
use crate::map::Octree;

/// Surface attributes of a hit.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Attributes {
    /// The interpolated vertex normal, not of unit length, if the triangle has vertex normals.
    pub normal: Option<[f32; 3]>,
    /// The interpolated texture coordinate, if the triangle has texture coordinates.
    pub texcoord: Option<[f32; 2]>,
    /// Material number, 0 = none, k = record k - 1 of [`Octree::materials`].
    pub material: u32,
}

/// The attributes of a hit of this file.
pub fn attributes(octree: &Octree, found: &Found) -> Result<Attributes> {
    let weights = [1.0 - found.hit.u - found.hit.v, found.hit.u, found.hit.v];
    octree.with_page(found.page, |page| Attributes {
        normal: page.normals(found.reference).map(|corners| interpolate(weights, corners)),
        texcoord: page.texcoords(found.reference).map(|corners| interpolate(weights, corners)),
        material: page.material(found.reference),
    })
}

/// The weighted sum of three corners' values.
fn interpolate<const N: usize>(weights: [f32; 3], corners: [[f32; N]; 3]) -> [f32; N] {
    std::array::from_fn(|i| (0..3).map(|k| weights[k] * corners[k][i]).sum())
}
