//! The rays: aimed at edges and vertices, and of a camera.

use octrace::geometry::{Aabb, Ray};

use crate::families::mesh::Mesh;
use crate::families::{Maker, toward};
use crate::random::Random;
use crate::speed::view::View;

/// Rays from within, around and far from the mesh at its vertices and at points of its edges, in turn.
pub fn aimed(mesh: &Mesh, count: u64, seed: u64) -> Vec<Ray> {
    let random = Random::new(seed);
    let mut maker = Maker::on(mesh, random, 0);
    (0..count)
        .map(|i| {
            let o = maker.origin(mesh);
            let target = if i % 2 == 0 { maker.vertex(mesh) } else { maker.edge_point(mesh) };
            Ray::new(o, toward(o, target))
        })
        .collect()
}

/// Rays of a camera that takes in the whole mesh: a square picture of at least so many pixels.
pub fn camera(mesh: &Mesh, count: u64) -> Vec<Ray> {
    let bounds = Aabb::around(mesh.points.iter().map(|p| (*p).into()));
    let side = (count as f64).sqrt().ceil() as u32;
    View::around(bounds).primary([side, side])
}
