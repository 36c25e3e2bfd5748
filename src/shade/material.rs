//! Materials at the moment of shading: the scene's, overlaid by the mesh's own (MTL) where asked for.

use std::collections::HashMap;
use std::sync::Arc;

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
    /// Variance of the angle by which facets too small to be seen lean, in radians squared; 0 but for surrogates.
    pub roughness: f64,
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
            roughness: 0.0,
        }
    }
}

impl Surface {
    /// Made of facets whose normals agree so far with their mean: unit normals have a mean of that length.
    ///
    /// A field of facets of mean area 1 / R above its plane leans by about 1 / R^2 - 1 = tan^2 in the mean. The highlight is widened after Toksvig
    /// ("Mipmapping normal maps", 2005).
    pub fn of_facets(mut self, agreement: f64) -> Surface {
        let r = agreement.clamp(1e-3, 1.0);
        self.roughness = (1.0 / (r * r) - 1.0).min(1.0);
        let shininess = self.shininess * r / (r + self.shininess * (1.0 - r));
        self.specular *= (1.0 + shininess) / (1.0 + self.shininess);
        self.shininess = shininess;
        self
    }

    /// What facets make of diffuse light that comes from `l` and is seen from `v` about the mean normal `n`, all of unit length: the
    /// factor by which a smooth surface's is multiplied (Oren and Nayar, "Generalization of Lambert's reflectance model", 1994,
    /// the qualitative model). It stands for shadows and slopes below the size of a pixel.
    pub fn facets(&self, n: DVec3, l: DVec3, v: DVec3) -> f64 {
        let variance = self.roughness;
        let (cos_l, cos_v) = (n.dot(l).clamp(1e-6, 1.0), n.dot(v).clamp(1e-6, 1.0));
        let along = |x: DVec3, cosine: f64| (x - cosine * n).normalize_or_zero();
        let azimuth = along(l, cos_l).dot(along(v, cos_v)).max(0.0);
        // sin of the larger angle times tan of the lesser.
        let sine = |cosine: f64| (1.0 - cosine * cosine).max(0.0).sqrt();
        let spread = sine(cos_l.min(cos_v)) * sine(cos_l.max(cos_v)) / cos_l.max(cos_v);
        let (a, b) = (1.0 - 0.5 * variance / (variance + 0.33), 0.45 * variance / (variance + 0.09));
        a + b * azimuth * spread
    }

    /// Of a part of a mesh that stands for triangles of such materials, with their mean colour.
    pub fn standing_for(self, own: &Mixed, color: Color) -> Surface {
        let kd = (color * own.tint).as_vec3().to_array();
        self.overlaid(&MaterialRecord { kd, given: own.record.given | given::KD, ..own.record }, None, None)
    }

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

/// What the materials of a mesh have in common but their diffuse colours, for parts of it that stand for triangles of several.
#[derive(Clone, Copy, Debug)]
pub struct Mixed {
    /// What most of them give, the mean of those that do.
    record: MaterialRecord,
    /// The mean colour of their textures; white for those that have none.
    tint: Color,
}

impl Mixed {
    /// Of materials with their textures; `None` if there are none.
    pub fn of(records: &[MaterialRecord], textures: &[Option<Arc<Texture>>]) -> Option<Mixed> {
        if records.is_empty() {
            return None;
        }
        let count = |bit: u32| records.iter().filter(|r| r.given & bit != 0).count();
        let mean = |bit: u32, of: &dyn Fn(&MaterialRecord) -> f32| {
            let sum: f64 = records.iter().filter(|r| r.given & bit != 0).map(|r| f64::from(of(r))).sum();
            (sum / count(bit).max(1) as f64) as f32
        };
        let mirrors = records.iter().filter(|r| r.given & given::ILLUM != 0 && r.illum >= 3).count();
        let bits = [given::KA, given::KS, given::NS, given::ILLUM];
        let record = MaterialRecord {
            ka: std::array::from_fn(|i| mean(given::KA, &|r| r.ka[i])),
            ks: std::array::from_fn(|i| mean(given::KS, &|r| r.ks[i])),
            ns: mean(given::NS, &|r| r.ns),
            illum: if 2 * mirrors > records.len() { 3 } else { 2 },
            given: bits.into_iter().filter(|&bit| 2 * count(bit) > records.len()).sum(),
            ..MaterialRecord::default()
        };
        // Materials share textures; each is looked at once.
        let mut known: HashMap<*const Texture, Color> = HashMap::new();
        let texel = |i: usize| match textures.get(i) {
            Some(Some(texture)) => *known.entry(Arc::as_ptr(texture)).or_insert_with(|| texture.mean()),
            _ => Color::ONE,
        };
        let tint = (0..records.len()).map(texel).sum::<Color>() / records.len() as f64;
        Some(Mixed { record, tint })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn facets_darken_and_flatten() {
        let smooth = Surface::from(&Material { shininess: 50.0, ..Material::default() });
        assert_eq!(smooth.of_facets(1.0), smooth);
        let rough = smooth.of_facets(0.8);
        assert!(rough.shininess < 5.0 && rough.specular.x < 0.2 * smooth.specular.x.max(1.0) && rough.roughness > 0.5);
        let seen = |l: DVec3, v: DVec3| rough.facets(DVec3::Z, l.normalize(), v.normalize());
        // Straight down everything is darker; with the light behind the eye, low over the surface, it is brighter than that.
        let down = seen(DVec3::Z, DVec3::Z);
        assert!((0.5..0.8).contains(&down));
        let low = DVec3::new(1.0, 0.0, 0.3);
        assert!(seen(low, low) > 1.5 * down && seen(low, low * DVec3::new(-1.0, 1.0, 1.0)) == down);
        assert_eq!(smooth.facets(DVec3::Z, DVec3::Z, low.normalize()), 1.0);
    }

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

    /// A surrogate of a mesh with one material looks as its triangles do.
    #[test]
    fn what_stands_for_triangles_has_their_material() {
        let scene = Surface::from(&Material { reflect: 0.5, ..Material::default() });
        let all = given::KA | given::KD | given::KS | given::NS | given::ILLUM;
        let kd = [0.25, 0.5, 0.125];
        let own =
            MaterialRecord { ka: [0.5; 3], kd, ks: [0.75; 3], ns: 9.0, illum: 2, given: all, ..Default::default() };
        let color = DVec3::from_array(kd.map(f64::from));
        let stand_in = |records: &[MaterialRecord], textures: &[Option<Arc<Texture>>]| {
            scene.standing_for(&Mixed::of(records, textures).unwrap(), color)
        };
        assert_eq!(stand_in(&[own; 3], &[]), scene.overlaid(&own, None, None));
        let map = || Texture::new(1, 1, vec![[0, 255, 51]], crate::scene::ToneMap::None);
        let painted = scene.overlaid(&own, Some(&map()), Some([0.5, 0.5]));
        let one = stand_in(&[own], &[Some(Arc::new(map()))]);
        assert!((one.diffuse - painted.diffuse).length() < 1e-6 && (one.ambient - painted.ambient).length() < 1e-6);
        // What few give, the scene does.
        let plain = MaterialRecord { kd, given: given::KD, ..Default::default() };
        assert_eq!(stand_in(&[own, plain, plain], &[]), scene.overlaid(&plain, None, None));
        let mirror = MaterialRecord { illum: 3, ..own };
        assert_eq!(stand_in(&[own, mirror, mirror], &[]).reflect, DVec3::splat(0.75));
        assert!(Mixed::of(&[], &[]).is_none());
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
