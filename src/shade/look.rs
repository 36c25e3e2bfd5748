//! What a ray sees first, as data and not as colour: for pictures of depth, normals, ids and shadows.

use glam::DVec3;

use super::object::{Contact, Kind, Part};
use super::wave::Wave;
use super::world::World;
use crate::error::Result;
use crate::geometry::FaceId;
use crate::scene::{Color, Light};

/// What a ray met first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Look {
    /// How far it lies from the ray's origin, in units of the world.
    pub depth: f64,
    /// The point, world space.
    pub point: DVec3,
    /// The unit normal that it is shaded with, on the side that is seen.
    pub normal: DVec3,
    /// The face of a mesh, or which of a shape's triangles; `FaceId::NONE` for what has none (spheres, planes).
    pub face: FaceId,
    /// The scene's material, counted from 0; those of mesh files, for instances that take these, are counted after the scene's, file by file.
    pub material: u32,
    /// The share of the scene's lights that do not reach the point, 0 to 1: behind the surface, or something stands between. 0 if
    /// it was not asked for, or if there are no lights.
    pub shadow: f32,
}

impl World {
    /// Appends to `looks` what each ray of a fresh wave meets first, sample by sample. Lights are asked only for `shadows`. Then the wave is to be cleared.
    pub fn look(&self, wave: &mut Wave, shadows: bool, looks: &mut Vec<Option<Look>>) -> Result<()> {
        self.strike(wave)?;
        if shadows {
            // What a surface makes of the light, a mirror or a black wall nothing, is not the question here.
            for struck in &mut wave.struck {
                let surface = &mut struck.meeting.spot.surface;
                (surface.local, surface.diffuse) = (1.0, Color::ONE);
            }
            for light in &self.scene.lights {
                let mut light = *light;
                match &mut light {
                    Light::Point { color, .. } | Light::Sun { color, .. } => *color = Color::ONE,
                }
                self.shine(&light, wave)?;
            }
        }
        let first = looks.len();
        looks.resize(first + wave.front.rays.len(), None);
        let lights = self.scene.lights.len() as u32;
        for struck in &wave.struck {
            let i = struck.ray as usize;
            let spot = &struck.meeting.spot;
            let material = match &wave.contacts[i] {
                Some(contact) => self.material_of(contact)?,
                None => continue,
            };
            let unlit = if shadows { lights - struck.lights } else { 0 };
            looks[first + i] = Some(Look {
                depth: (spot.point - wave.front.rays[i].origin).length(),
                point: spot.point,
                normal: spot.shading,
                face: spot.omit.face,
                material,
                shadow: unlit as f32 / lights.max(1) as f32,
            });
        }
        Ok(())
    }

    /// The number of the material at a hit.
    fn material_of(&self, contact: &Contact) -> Result<u32> {
        let object = &self.objects[contact.object as usize];
        let own = object.material as u32;
        let (Kind::Mesh(placed), Part::Mesh(found)) = (&object.kind, &contact.part) else { return Ok(own) };
        if !placed.mtl {
            return Ok(own);
        }
        let before: usize = self.meshes[..placed.mesh].iter().map(|mesh| mesh.materials()).sum();
        let number = self.meshes[placed.mesh].material_number(found)?;
        Ok(number.map_or(own, |number| (self.surfaces.len() + before).wrapping_add(number as usize) as u32))
    }
}
