//! Materials as they stand in the file.

use bytemuck::{Pod, Zeroable};

/// A material of the mesh's MTL; FORMAT.md, "Material".
#[derive(Clone, Copy, Debug, PartialEq, Default, Pod, Zeroable)]
#[repr(C)]
pub struct MaterialRecord {
    /// Ambient colour.
    pub ka: [f32; 3],
    /// Diffuse colour.
    pub kd: [f32; 3],
    /// Specular colour.
    pub ks: [f32; 3],
    /// Specular exponent.
    pub ns: f32,
    /// Index of refraction.
    pub ni: f32,
    /// Opacity.
    pub d: f32,
    /// Illumination model.
    pub illum: u32,
    /// Which are given: bit 0 Ka, 1 Kd, 2 Ks, 3 Ns, 4 Ni, 5 d, 6 illum.
    pub given: u32,
    /// Name: offset and length in the strings.
    pub name: [u32; 2],
    /// Path of the diffuse texture, relative to the folder of the file: offset and length; length 0 = none.
    pub map_kd: [u32; 2],
    /// Zero.
    pub zero: [u32; 2],
}

const _: () = assert!(size_of::<MaterialRecord>() == 80);
