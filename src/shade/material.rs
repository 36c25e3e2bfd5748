//! Materials at the moment of shading: the scene's, overlaid by the mesh's own (MTL) where asked for.

use glam::DVec3;

use super::texture::Texture;
use crate::format::MaterialRecord;
use crate::scene::{Color, Material};

/// Which fields of a [`MaterialRecord`] are given.
mod given {
    pub const KA: u32 = 1;
    pub const KD: u32 = 2;
    pub const KS: u32 = 4;
    pub const NS: u32 = 8;
    pub const ILLUM: u32 = 64;
}

/// What the formula of the module's head needs to know about a point of a surface. Colours are linear.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Surface {
    /// Ambient colour.
    pub ambient: Color,
    /// Diffuse colour.
    pub diffuse: Color,
    /// Specular colour.
    pub specular: Color,
    /// Weight of the local term.
    pub local: f64,
    /// Weight of the mirror term; coloured for a mesh's own material.
    pub reflect: Color,
    /// Weight of the refracted term.
    pub transmit: f64,
    /// Index of refraction.
    pub ior: f64,
    /// Blinn-Phong exponent.
    pub shininess: f64,
}

impl From<&Material> for Surface {
    fn from(m: &Material) -> Surface {
        Surface {
            ambient: m.ambient,
            diffuse: m.diffuse,
            specular: m.specular,
            local: m.local,
            reflect: DVec3::splat(m.reflect),
            transmit: m.transmit,
            ior: m.ior,
            shininess: m.shininess,
        }
    }
}

impl Surface {
    /// Overlaid by a mesh's own material, at a point with these texture coordinates (if it has any).
    ///
    /// What the record does not give stays the scene's. `illum` 3 and higher mirrors with Ks, below it does not mirror.
    /// `map_Kd` multiplies Kd; where Kd is not given or black it is white, since exporters that write a map often leave
    /// Kd empty. The map colours the ambient term as well, and a gray Ka is a share of the diffuse colour: exporters
    /// write `Ka 1 1 1` for whatever they export, and taken for a colour it would cover everything with a gray haze.
    pub fn overlaid(mut self, record: &MaterialRecord, texture: Option<&Texture>, uv: Option<[f64; 2]>) -> Surface {
        let has = |bit| record.given & bit != 0;
        let color = |c: [f32; 3]| DVec3::from_array(c.map(f64::from));
        if has(given::KD) {
            self.diffuse = color(record.kd);
        }
        if has(given::KS) {
            self.specular = color(record.ks);
        }
        if has(given::NS) {
            self.shininess = f64::from(record.ns).max(0.0);
        }
        if has(given::ILLUM) {
            self.reflect = if record.illum >= 3 { self.specular } else { DVec3::ZERO };
            self.transmit = 0.0;
        }
        let texel = texture.zip(uv).map(|(texture, [u, v])| texture.at(u, v));
        if texel.is_some() && (!has(given::KD) || self.diffuse == DVec3::ZERO) {
            self.diffuse = DVec3::ONE;
        }
        if has(given::KA) {
            let ka = color(record.ka);
            let gray = ka == DVec3::splat(ka.x);
            self.ambient = if gray { ka * self.diffuse } else { ka };
        }
        let texel = texel.unwrap_or(DVec3::ONE);
        self.diffuse *= texel;
        self.ambient *= texel;
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn given_fields_win_and_illum_decides_the_mirror() {
        let plain = Surface::from(&Material { reflect: 0.5, ..Material::default() });
        let record = MaterialRecord { kd: [0.5, 0.25, 0.0], given: given::KD, ..Default::default() };
        let s = plain.overlaid(&record, None, None);
        assert_eq!((s.diffuse, s.ambient, s.reflect), (DVec3::new(0.5, 0.25, 0.0), DVec3::ONE, DVec3::splat(0.5)));
        let ks = MaterialRecord { ks: [0.5, 1.0, 0.0], illum: 3, given: given::KS | given::ILLUM, ..record };
        assert_eq!(plain.overlaid(&ks, None, None).reflect, DVec3::new(0.5, 1.0, 0.0));
        let dull = MaterialRecord { illum: 2, ..ks };
        assert_eq!(plain.overlaid(&dull, None, None).reflect, DVec3::ZERO);
    }

    #[test]
    fn a_gray_ka_is_a_share_of_the_diffuse_colour() {
        let plain = Surface::from(&Material::default());
        let black =
            MaterialRecord { ka: [1.0; 3], kd: [0.0, 0.125, 0.0], given: given::KA | given::KD, ..Default::default() };
        assert_eq!(plain.overlaid(&black, None, None).ambient, DVec3::new(0.0, 0.125, 0.0));
        let red = MaterialRecord { ka: [0.5, 0.0, 0.0], ..black };
        assert_eq!(plain.overlaid(&red, None, None).ambient, DVec3::new(0.5, 0.0, 0.0));
        // The map colours both terms.
        let map = Texture::new(1, 1, vec![[0, 255, 0]], crate::scene::ToneMap::None);
        let white = MaterialRecord { kd: [1.0; 3], ka: [0.5; 3], ..black };
        let s = plain.overlaid(&white, Some(&map), Some([0.5, 0.5]));
        assert_eq!((s.diffuse, s.ambient), (DVec3::Y, DVec3::new(0.0, 0.5, 0.0)));
    }
}
