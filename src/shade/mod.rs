//! What a ray sees: Blinn-Phong surfaces, hard shadows, mirrors and glass over meshes and simple shapes.
//!
//! A [`World`] is a [`Scene`](crate::scene::Scene) made ready: every mesh has its tracer, every shape its inverse
//! transform, many things have a small tree over them. [`World::follow`] follows many rays together and what they give rise to
//! (Whitted 1980), each with a stack of its own, so that any number of bounces fits.
//!
//! The colour of a hit with unit normal n, direction v to the eye, l_j to light j and h_j halfway between them is
//! `local * (ambient * amb + sum_j I_j V_j (max(n.l_j, 0) diff + max(n.h_j, 0)^shininess spec)) + reflect R + transmit T`.
//! What the formula leaves open is decided so:
//! - Surfaces have two sides: n is turned to the side from which the ray comes, which the *geometric* normal decides,
//!   whatever a vertex normal says. A light on the other side gives nothing, the specular term included.
//! - V_j is 0 if anything at all lies between: transmissive things cast full shadows, as the classic programs have it.
//! - Refraction follows Snell's law: from the front of a surface (its winding, the outside of a sphere, the side to which
//!   a plane's normal points) a ray enters with 1/ior, from the back it leaves with ior; total reflection adds the weight
//!   to the mirrored ray. So a transmissive open surface bends rays as if its back were inside.
//! - A term of weight zero traces no ray. A ray beyond the last bounce, or of a weight below 2^-20, has the
//!   background's colour.
//!
//! With level of detail ([`World::with_lod`], `beam`) a mesh may give a surrogate in place of a triangle: its plane, mean normal and colour,
//! shaded as the rough surface that its normals make it.
//! Rays that leave one start above all that it stands for, and see nothing nearer than its error.
//!
//! Otherwise nothing here shifts a ray by an epsilon: see `origin` for where secondary rays start, `heading` for how their directions are rounded. Soft shadows, glossy
//! reflection and attenuation are not modelled.

mod batch;
mod beam;
#[cfg(test)]
mod double;
mod fingerprint;
#[cfg(test)]
mod grazing_tests;
mod heading;
mod leave;
mod look;
mod material;
mod mesh;
mod object;
mod origin;
mod path;
mod quadric;
mod ray;
#[cfg(test)]
mod secondary_tests;
mod spot;
#[cfg(test)]
mod tests;
mod texture;
mod tree;
mod wave;
#[cfg(test)]
mod wave_tests;
mod whitted;
mod world;

pub use beam::DetailCounts;
pub use look::Look;
pub use material::Surface;
pub use mesh::Mesh;
pub use object::Contact;
pub use path::{Bounce, MirrorPath};
pub use ray::{Omit, WorldRay};
pub use texture::Texture;
pub use wave::Wave;
pub use whitted::RayCounts;
pub use world::World;
