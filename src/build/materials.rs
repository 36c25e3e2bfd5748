//! Materials as the file stores them: records, and the strings they name.

use std::path::{Component, Path, PathBuf};

use glam::Vec3;

use crate::format::MaterialRecord;
use crate::mesh::MaterialInfo;

/// The records of `materials` and their strings, for a file in `folder`.
pub(super) fn materials(materials: &[MaterialInfo], folder: &Path) -> (Vec<MaterialRecord>, Vec<u8>) {
    let mut strings = Vec::new();
    let mut store = |text: &str| {
        let place = [strings.len() as u32, text.len() as u32];
        strings.extend(text.as_bytes());
        place
    };
    let record = |material: &MaterialInfo| MaterialRecord {
        ka: material.ka.unwrap_or_default(),
        kd: material.kd.unwrap_or_default(),
        ks: material.ks.unwrap_or_default(),
        ns: material.ns.unwrap_or_default(),
        ni: material.ni.unwrap_or_default(),
        d: material.d.unwrap_or_default(),
        illum: material.illum.unwrap_or_default(),
        given: given(material),
        name: store(&material.name),
        map_kd: material.map_kd.as_ref().map_or([0; 2], |path| store(&relative(path, folder).to_string_lossy())),
        zero: [0; 2],
    };
    let records = materials.iter().map(record).collect();
    (records, strings)
}

/// The diffuse colour of a material without its texture, as a picture shows it where the mesh's own materials are taken.
pub(super) fn diffuse(material: &MaterialInfo) -> Vec3 {
    let textured = material.map_kd.is_some();
    let given = material.kd.filter(|kd| !textured || *kd != [0.0; 3]);
    let clean = |x: f32| if x.is_finite() { x.clamp(0.0, 1.0) } else { 0.0 };
    given.map_or(Vec3::ONE, |kd| Vec3::from_array(kd.map(clean)))
}

/// Bit i is set if the i-th value is given; FORMAT.md, "Material".
fn given(material: &MaterialInfo) -> u32 {
    let MaterialInfo { ka, kd, ks, ns, ni, d, illum, .. } = material;
    let all = [ka.is_some(), kd.is_some(), ks.is_some(), ns.is_some(), ni.is_some(), d.is_some(), illum.is_some()];
    all.iter().enumerate().map(|(bit, &is)| u32::from(is) << bit).sum()
}

/// `path` as seen from `folder`, if a way leads there; else absolute.
fn relative(path: &Path, folder: &Path) -> PathBuf {
    let (path, folder) = (resolve(path), resolve(folder));
    let common = path.components().zip(folder.components()).take_while(|(a, b)| a == b).count();
    if common == 0 {
        return path;
    }
    let up = folder.components().skip(common).map(|_| Component::ParentDir);
    up.chain(path.components().skip(common)).collect()
}

/// The absolute path without links, as far as it exists.
fn resolve(path: &Path) -> PathBuf {
    let absolute = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    absolute.canonicalize().unwrap_or_else(|_| match (absolute.parent(), absolute.file_name()) {
        (Some(parent), Some(name)) => resolve(parent).join(name),
        _ => absolute,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn textures_are_named_from_the_files_folder() {
        let folder = tempfile::tempdir().unwrap();
        let (models, textures) = (folder.path().join("models/a"), folder.path().join("textures"));
        std::fs::create_dir_all(&models).unwrap();
        std::fs::create_dir_all(&textures).unwrap();
        std::fs::write(textures.join("wood.png"), b"").unwrap();
        let from_models = Path::new("../../textures/wood.png");
        assert_eq!(relative(&textures.join("wood.png"), &models), from_models);
        assert_eq!(relative(&models.join("../../textures/wood.png"), &models), from_models);
        assert_eq!(relative(&textures.join("wood.png"), folder.path()), Path::new("textures/wood.png"));
        assert_eq!(relative(&folder.path().join("no/such.png"), &textures), Path::new("../no/such.png"));
    }

    #[test]
    fn records_say_what_is_given() {
        let info = MaterialInfo { name: "red".into(), kd: Some([1.0, 0.0, 0.0]), illum: Some(2), ..Default::default() };
        let (records, strings) = materials(&[MaterialInfo::default(), info], Path::new("."));
        assert_eq!((records[0].given, records[1].given), (0, 0b100_0010));
        assert_eq!((records[1].kd, records[1].illum, records[1].name), ([1.0, 0.0, 0.0], 2, [0, 3]));
        assert_eq!(strings, b"red");
    }
}
