//! What a world's pictures depend on, as one number: machines that share a picture compare it.

use std::collections::HashSet;
use std::fmt::Write;
use std::sync::Arc;

use bytemuck::cast_slice;
use xxhash_rust::xxh3::Xxh3;

use super::world::World;
use crate::scene::{MeshFile, Scene};

/// Takes text for the hash.
struct Hashed(Xxh3);

impl Write for Hashed {
    fn write_str(&mut self, text: &str) -> std::fmt::Result {
        self.0.update(text.as_bytes());
        Ok(())
    }
}

impl World {
    /// A hash (XXH3-64) of all that colours depend on: the scene but for its picture's size, samples and depth, which settings replace, each
    /// mesh by the checksums of its octree file, textures by their texels, and the error that level of detail may make.
    ///
    /// Where files lie does not matter. A mesh that is no octree file counts by its bounds alone.
    pub fn fingerprint(&self) -> u64 {
        let nameless = |mesh: &MeshFile| MeshFile { path: Default::default(), ..mesh.clone() };
        let meshes = self.scene.meshes.iter().map(nameless).collect();
        let Scene { output, size, samples, depth, .. } = Scene::default();
        let scene = Scene { output, size, samples, depth, meshes, ..self.scene.clone() };
        // As the compiler derives it, so that no field can be forgotten; numbers are spelt so that they read back the same.
        let mut hash = Hashed(Xxh3::new());
        // Writing to a hash does not fail.
        let _ = write!(hash, "{scene:?}");
        for mesh in &self.meshes {
            let _ = write!(hash, "{:?} {:?}", mesh.pixels, mesh.bounds());
            match mesh.octree() {
                Some(octree) => hash.0.update(&octree.header().checksum.to_le_bytes()),
                None => hash.0.update(b"none"),
            }
            // Materials share textures; each counts once, by the material that has it first.
            let mut known = HashSet::new();
            for (i, texture) in mesh.textures().iter().enumerate() {
                let Some(texture) = texture.as_ref().filter(|texture| known.insert(Arc::as_ptr(texture))) else {
                    continue;
                };
                let _ = write!(hash, "{i} {texture:?}");
                hash.0.update(cast_slice(texture.texels()));
            }
        }
        hash.0.digest()
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::event::Monitor;
    use crate::scene::{Light, ToneMap};

    fn of(scene: Scene) -> u64 {
        World::new(scene, Vec::new(), Monitor::silent()).unwrap().fingerprint()
    }

    #[test]
    fn it_tells_scenes_apart_but_not_what_settings_replace() {
        let plain = of(Scene::default());
        let same = Scene { output: Some("a.png".into()), size: [7, 9], samples: 16, depth: 3, ..Scene::default() };
        assert_eq!(of(same), plain);
        let light = |x| Light::Point { position: DVec3::new(x, 0.0, 0.0), color: DVec3::ONE };
        let lit = |x| of(Scene { lights: vec![light(x)], ..Scene::default() });
        let all = [
            plain,
            of(Scene { tonemap: ToneMap::Srgb, ..Scene::default() }),
            of(Scene { ambient: 0.1f64.next_up(), ..Scene::default() }),
            lit(0.0),
            lit(-0.0),
            lit(f64::from_bits(1)),
        ];
        for (i, a) in all.iter().enumerate() {
            assert!(!all[..i].contains(a), "{i}");
        }
    }
}
