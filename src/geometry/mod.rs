//! Plain geometry that every layer shares: boxes, rays, triangles, Morton codes, the root cube.

mod aabb;
mod cube;
pub mod morton;
mod ray;
mod triangle;

pub use aabb::Aabb;
pub use cube::RootCube;
pub(crate) use cube::{exp2, log2_floor};
pub use ray::{FaceId, Hit, Ray, Skip};
pub use triangle::Triangle;
