//! Files that a scene names, and scenes as files.

use super::*;

/// A folder with files `a.obj`, `b.oct` and `my mesh.obj`.
fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for name in ["a.obj", "b.oct", "my mesh.obj"] {
        fs::write(folder.path().join(name), "").unwrap();
    }
    folder
}

#[test]
fn a_mesh_placed_twice_is_listed_once() {
    let folder = folder();
    fs::create_dir(folder.path().join("sub")).unwrap();
    let text =
        "obj a.obj\ntranslate 1 0 0\nmtl off\nsmooth on\nreflect 1\nobj sub/../a.obj\noct b.oct\nobj \"my mesh.obj\"";
    let (scene, told) = read_in(folder.path(), text, STRICT);
    let scene = scene.unwrap();
    assert_eq!(told, Vec::<String>::new());
    let names: Vec<_> = scene.meshes.iter().map(|m| (m.path.strip_prefix(folder.path()).unwrap(), m.built)).collect();
    assert_eq!(names, [(Path::new("a.obj"), false), (Path::new("b.oct"), true), (Path::new("my mesh.obj"), false)]);
    let placed: Vec<_> = scene.instances.iter().map(|i| (i.mesh, i.material, i.mtl, i.smooth)).collect();
    assert_eq!(placed, [(0, 0, true, false), (0, 1, false, true), (1, 1, false, true), (2, 1, false, true)]);
    assert_eq!(scene.instances[0].to_world, DAffine3::IDENTITY);
    assert_eq!(scene.instances[1].to_world, DAffine3::from_translation(v(1.0, 0.0, 0.0)));
}

#[test]
fn oct_is_a_switch_and_a_command() {
    assert!(read("oct").octree);
    assert!(!read("oct off").octree);
    assert!(read("oct off\noct").octree);
    assert!(read("oct off\noct on").octree);
    let folder = folder();
    fs::write(folder.path().join("off"), "").unwrap();
    let scene = read_in(folder.path(), "oct off\noct \"off\"\noct b.oct", STRICT).0.unwrap();
    assert!(!scene.octree);
    assert_eq!((scene.meshes.len(), scene.instances.len()), (2, 2));
}

#[test]
fn files_that_are_not_there_are_told_at_their_name() {
    let folder = folder();
    let told = |text: &str| match read_in(folder.path(), text, STRICT).0 {
        Err(Error::Text(errors)) => errors[0].clone(),
        other => panic!("{other:?}"),
    };
    let missing = told("# first\nobj b.obj");
    assert_eq!((missing.line, missing.column, &missing.text[missing.span]), (2, 5, "b.obj"));
    assert!(missing.message.ends_with("b.obj`: there is no such file"), "{}", missing.message);
    assert_eq!(missing.help.as_deref(), Some("did you mean `a.obj`?"));
    assert_eq!(told("oct bunny.oct").help.as_deref(), Some("build it first: `octbuild MESH.obj -o bunny.oct`"));
    assert_eq!(told("obj b.oct").help.as_deref(), Some("did you mean `oct b.oct`?"));
    assert_eq!(told("oct a.obj").help.as_deref(), Some("did you mean `obj a.obj`?"));
    assert!(told("obj .").message.ends_with("it is a folder"));
    assert!(told("include nowhere.txt").message.contains("there is no such file"));
}

#[test]
fn included_files_are_read_in_place() {
    let folder = folder();
    fs::create_dir(folder.path().join("sub")).unwrap();
    fs::write(folder.path().join("sub/c.obj"), "").unwrap();
    fs::write(folder.path().join("sub/inner.txt"), "color red 1 0 0\ntranslate 1 0 0\nobj c.obj").unwrap();
    let (scene, told) = read_in(folder.path(), "include sub/inner.txt\nmat diff red\nobj a.obj", STRICT);
    let scene = scene.unwrap();
    assert_eq!(told, Vec::<String>::new());
    let names: Vec<_> = scene.meshes.iter().map(|m| m.path.strip_prefix(folder.path()).unwrap()).collect();
    assert_eq!(names, [Path::new("sub/c.obj"), Path::new("a.obj")]);
    assert_eq!(scene.instances[1].to_world.translation, v(1.0, 0.0, 0.0));
    assert_eq!(scene.materials[1].diffuse, v(1.0, 0.0, 0.0));
}

#[test]
fn including_in_a_circle_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let main = folder.path().join("main.txt");
    fs::write(&main, "include b.txt").unwrap();
    fs::write(folder.path().join("b.txt"), "sphere 0 0 0 1\ninclude main.txt").unwrap();
    let Err(Error::Text(told)) = Scene::load(&main, STRICT, Monitor::silent()) else { panic!() };
    assert_eq!((told.len(), told[0].line, told[0].message.as_str()), (1, 2, "this file includes itself"));
    let help = told[0].help.clone().unwrap().replace(&folder.path().display().to_string(), "");
    assert_eq!(help, "/main.txt includes /b.txt includes /main.txt");
}

#[test]
fn including_too_deep_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    for i in 0..40 {
        fs::write(folder.path().join(format!("{i}.txt")), format!("sphere 0 0 0 1\ninclude {}.txt", i + 1)).unwrap();
    }
    let Err(Error::Text(told)) = Scene::load(&folder.path().join("0.txt"), STRICT, Monitor::silent()) else { panic!() };
    assert_eq!(told[0].message, "files include each other at most 32 deep");
    assert!(told[0].file.ends_with("31.txt"));
    fs::write(folder.path().join("31.txt"), "").unwrap();
    let scene = Scene::load(&folder.path().join("0.txt"), STRICT, Monitor::silent()).unwrap();
    assert_eq!(scene.shapes.len(), 31);
}

#[test]
fn loading_tells_files_from_folders_and_text_from_bytes() {
    let folder = folder();
    let load = |name: &str, lenient| Scene::load(&folder.path().join(name), LoadOptions { lenient }, Monitor::silent());
    assert_eq!(load("nowhere.txt", false).unwrap_err().kind().exit_code(), 2);
    assert!(load("", false).unwrap_err().to_string().contains("a folder"));
    fs::write(folder.path().join("latin.txt"), b"sphere 0 0 0 1 # caf\xE9\nsphere 1 0 0 1").unwrap();
    let Err(Error::Text(told)) = load("latin.txt", false) else { panic!() };
    assert_eq!((told.len(), told[0].column), (1, 21));
    assert_eq!(load("latin.txt", true).unwrap().shapes.len(), 2);
    fs::write(folder.path().join("marked.txt"), "\u{feff}sphere 0 0 0 1\r\n\r\noct\r\n").unwrap();
    assert_eq!(load("marked.txt", false).unwrap().shapes.len(), 1);
}

#[test]
fn a_mesh_alone_makes_a_scene() {
    let scene = Scene::for_mesh("bunny.oct", true);
    assert_eq!(scene.meshes[0].path, PathBuf::from("bunny.oct"));
    assert!(scene.meshes[0].built && !scene.lights.is_empty());
    assert_eq!((scene.camera, scene.instances.len()), (Camera::Auto, 1));
    assert!(scene.materials.len() > scene.instances[0].material && scene.materials.len() > scene.floor.unwrap());
    assert_eq!(scene.instances[0].to_world.matrix3, DMat3::IDENTITY);
}

/// Every file in scenes/ reads without a word of complaint, once the meshes that it names are there.
#[test]
fn the_scenes_of_the_project_read() {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes");
    let folder = tempfile::tempdir().unwrap();
    let scenes = folder.path().join("scenes");
    fs::create_dir_all(scenes.join("parts")).unwrap();
    fs::create_dir_all(folder.path().join("assets")).unwrap();
    for mesh in ["scenes/bunny.oct", "assets/globe.obj"] {
        fs::write(folder.path().join(mesh), "").unwrap();
    }
    for part in fs::read_dir(source.join("parts")).unwrap() {
        let part = part.unwrap();
        fs::copy(part.path(), scenes.join("parts").join(part.file_name())).unwrap();
    }
    let mut count = 0;
    for entry in fs::read_dir(&source).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_none_or(|e| e != "txt") {
            continue;
        }
        let (scene, told) = read_in(&scenes, &fs::read_to_string(&path).unwrap(), STRICT);
        let scene = scene.unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        assert_eq!(told, Vec::<String>::new(), "{}", path.display());
        assert!(!scene.lights.is_empty() && scene.camera != Camera::Auto, "{}", path.display());
        count += 1;
    }
    assert!(count >= 6, "{count} scenes");
}

/// The scene that defines the classic language, where the test data is at hand.
#[test]
fn the_classic_scene_reads() {
    let Some(data) = std::env::var_os("OCTRACE_DATA") else {
        println!("skipped: OCTRACE_DATA is not set");
        return;
    };
    let path = PathBuf::from(data).join("classic_scenes/input.txt");
    let told = Mutex::new(Vec::new());
    let sink = |event: Event| match event {
        Event::File(_) => {}
        event => told.lock().unwrap().push(format!("{event:?}")),
    };
    let stop = AtomicBool::new(false);
    let scene = Scene::load(&path, STRICT, Monitor::new(&sink, &stop)).unwrap();
    assert_eq!(*told.lock().unwrap(), Vec::<String>::new());
    let camera = Camera::Rectangle {
        eye: v(0.0, 0.0, 15.0),
        origin: v(-5.0, -5.0, 8.0),
        horiz: v(10.0, 0.0, 0.0),
        vert: v(0.0, 10.0, 0.0),
    };
    assert_eq!(
        (&scene.camera, scene.size, scene.output.as_deref()),
        (&camera, [512, 512], Some(Path::new("test.png")))
    );
    assert_eq!((scene.shapes.len(), scene.lights.len(), scene.ambient), (5, 3, 0.1));
    let (white, green) = (DVec3::ONE, v(0.0, 1.0, 0.0));
    let green = Material { ambient: green, diffuse: green, specular: white, reflect: 0.2, ..Material::default() };
    let red = v(1.0, 0.0, 0.0);
    let red = Material { ambient: red, diffuse: red, specular: v(0.0, 1.0, 1.0), ..Material::default() };
    let blue = v(0.0, 0.0, 0.8);
    let blue =
        Material { ambient: blue, diffuse: blue, specular: white, local: 0.6, reflect: 1.0, ..Material::default() };
    assert_eq!(scene.materials, [green, red, blue]);
    assert_eq!(scene.shapes.iter().map(|s| s.material).collect::<Vec<_>>(), [0, 1, 1, 1, 2]);
    assert_eq!(sphere(&scene, 2), (v(0.0, 5.0, 0.0), 3.0, DAffine3::IDENTITY));
    assert_eq!(scene.lights[2], Light::Point { position: v(5.0, 8.0, 0.0), color: DVec3::splat(0.3) });
    assert!(scene.octree && scene.meshes.is_empty());
}
