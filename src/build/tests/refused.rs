//! What cannot be built, and what is warned of.

use super::*;

#[test]
fn folders_that_are_not_there_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let missing = folder.path().join("missing");
    let temp = BuildOptions { temp: Some(missing.clone()), ..Default::default() };
    for (place, options) in [(missing.as_path(), BuildOptions::default()), (folder.path(), temp)] {
        let error = build_in(place, &sheet(2), &options, &roomy()).unwrap_err();
        assert!(error.to_string().contains("missing") && error.kind() == crate::Kind::Machine, "{error}");
    }
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn nothing_to_build_is_an_error_that_says_why() {
    let folder = tempfile::tempdir().unwrap();
    let mut mesh = sheet(1);
    mesh.positions.iter_mut().for_each(|p| *p = [p[0], 0.0, 0.0]);
    let error = build_in(folder.path(), &mesh, &BuildOptions::default(), &roomy()).unwrap_err();
    assert!(error.to_string().contains("holds no triangles that can be hit (dropped: 2 of zero area"), "{error}");
    let error = build_in(folder.path(), &Memory::default(), &BuildOptions::default(), &roomy()).unwrap_err();
    assert_eq!(error.to_string(), "the mesh: holds no triangles; name a mesh that has faces");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn options_out_of_range_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let default = BuildOptions::default;
    for wrong in [
        BuildOptions { leaf: 0, ..default() },
        BuildOptions { leaf: 17, ..default() },
        BuildOptions { depth: 22, ..default() },
        BuildOptions { cell: 0, ..default() },
        BuildOptions { brick: Some(0), ..default() },
        BuildOptions { origin: [f64::NAN, 0.0, 0.0], ..default() },
    ] {
        let error = build_in(folder.path(), &sheet(1), &wrong, &roomy()).unwrap_err();
        assert!(matches!(error, Error::Option(_)), "{wrong:?}");
    }
}

#[test]
fn far_meshes_are_told_an_origin() {
    let mut mesh = sheet(4);
    mesh.positions.iter_mut().for_each(|p| p[0] = p[0] / 8.0 + 4_000_000.0);
    let warnings = std::sync::Mutex::new(Vec::new());
    let sink = |event: Event| {
        if let Event::Warning(text) = event {
            warnings.lock().unwrap().push(text);
        }
    };
    // In f32 there are four numbers in each unit here: vertices at eighths fall together.
    let stop = AtomicBool::new(false);
    let folder = tempfile::tempdir().unwrap();
    mesh.positions.iter_mut().for_each(|p| (p[1], p[2]) = (p[1] / 8.0, 0.0));
    let monitor = Monitor::new(&sink, &stop);
    let report = build(&mut mesh.clone(), &folder.path().join("a.oct"), &BuildOptions::default(), monitor).unwrap();
    assert!(report.merged > 0 && report.merged <= report.dropped.degenerate);
    let warnings = warnings.into_inner().unwrap();
    assert!(warnings.len() == 1 && warnings[0].contains("--origin 4000000"), "{warnings:?}");
}
