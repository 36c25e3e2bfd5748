//! What each command of the scene language does, through the library.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::AtomicBool;

use glam::{DAffine3, DMat3, DVec3, Vec3};
use octrace::scene::{Camera, Geometry, Light, LoadOptions, Material, Scene, ToneMap};
use octrace::{Diagnostic, Error, Event, Monitor};

const STRICT: LoadOptions = LoadOptions { lenient: false };

/// The scene, and the messages of all warnings.
fn read_in(folder: &Path, text: &str, options: LoadOptions) -> (Result<Scene, Error>, Vec<String>) {
    let told = Mutex::new(Vec::new());
    let sink = |event: Event| match event {
        Event::Diagnostic(diagnostic) => told.lock().unwrap().push(diagnostic.message),
        Event::Warning(text) => told.lock().unwrap().push(text),
        _ => {}
    };
    let stop = AtomicBool::new(false);
    let scene = Scene::parse(text, "scene.txt", folder, options, Monitor::new(&sink, &stop));
    (scene, told.into_inner().unwrap())
}

/// A scene without errors or warnings (but that of an empty scene).
fn read(text: &str) -> Scene {
    let (scene, mut told) = read_in(Path::new(""), text, STRICT);
    told.retain(|message| !message.contains("nothing has been placed"));
    assert_eq!(told, Vec::<String>::new(), "{text}");
    scene.unwrap_or_else(|error| panic!("{text}: {error}"))
}

/// All errors of a scene.
fn errors(text: &str) -> Vec<Diagnostic> {
    match read_in(Path::new(""), text, STRICT).0 {
        Err(Error::Text(errors)) => errors,
        other => panic!("{text}: {other:?}"),
    }
}

/// The message of the only error of a scene.
fn error(text: &str) -> String {
    let errors = errors(text);
    assert_eq!(errors.len(), 1, "{text}: {errors:?}");
    errors[0].message.clone()
}

fn warnings(text: &str) -> Vec<String> {
    let (scene, mut told) = read_in(Path::new(""), text, STRICT);
    scene.unwrap();
    told.retain(|message| !message.contains("nothing has been placed"));
    told
}

fn v(x: f64, y: f64, z: f64) -> DVec3 {
    DVec3::new(x, y, z)
}

fn near(a: DVec3, b: DVec3) -> bool {
    (a - b).length() < 1e-12
}

fn sphere(scene: &Scene, which: usize) -> (DVec3, f64, DAffine3) {
    match scene.shapes[which].geometry {
        Geometry::Sphere { center, radius, to_world } => (center, radius, to_world),
        other => panic!("{other:?}"),
    }
}

/// A folder with files `a.obj`, `b.oct` and `my mesh.obj`.
fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for name in ["a.obj", "b.oct", "my mesh.obj"] {
        fs::write(folder.path().join(name), "").unwrap();
    }
    folder
}

#[test]
fn an_empty_file_has_the_defaults_of_the_language() {
    let (scene, told) = read_in(Path::new(""), "# nothing\n\n", STRICT);
    let scene = scene.unwrap();
    assert_eq!(scene, Scene::default());
    assert_eq!((scene.size, scene.samples, scene.depth, scene.octree), ([512, 512], 1, 10, true));
    assert_eq!((scene.background, scene.ambient, scene.tonemap), (DVec3::ZERO, 0.1, ToneMap::None));
    assert_eq!((scene.camera, scene.output), (Camera::Auto, None));
    assert_eq!(told, ["scene.txt: nothing has been placed, so there is nothing to see"]);
}

#[test]
fn the_picture_is_set() {
    assert_eq!(read("outsize 10 20").size, [20, 10]);
    assert_eq!(read("resolution 10 20").size, [10, 20]);
    assert_eq!(read("outsize 10 20\nresolution 30 40").size, [30, 40]);
    assert_eq!(read("output a.png").output, Some("a.png".into()));
    assert_eq!(read("output \"a b.png\" # yes").output, Some("a b.png".into()));
    assert_eq!(read("background 0 0.5 1").background, v(0.0, 0.5, 1.0));
    assert_eq!(read("samples 16").samples, 16);
    assert_eq!(read("depth 0").depth, 0);
    assert_eq!(read("depth 24").depth, 24);
    assert_eq!(read("tonemap srgb").tonemap, ToneMap::Srgb);
    assert_eq!(read("tonemap srgb\ntonemap none").tonemap, ToneMap::None);
    assert_eq!(read("amblight .25").ambient, 0.25);
}

#[test]
fn ranges_are_named() {
    for (text, says) in [
        ("outsize 0 5", "the number of rows must be a whole number from 1 to 65536"),
        ("resolution 5.5 5", "the width must be a whole number from 1 to 65536"),
        ("resolution 65537 5", "the width must be a whole number from 1 to 65536"),
        ("resolution 65536 65536", "a picture has at most 2147483648 pixels, not 4294967296"),
        ("background 0 0 1.5", "blue of the colour must be between 0 and 1"),
        ("color c 0 -1 0", "green of the colour must be 0 or more"),
        ("mat amb -1 0 0", "red of the colour must be 0 or more"),
        ("samples 5", "the number of samples must be a square: 1, 4, 9, 16, ..."),
        ("samples 1000000", "the number of samples must be a whole number from 1 to 65536"),
        ("depth 10001", "the number of bounces must be a whole number from 0 to 10000"),
        ("depth 1.5", "the number of bounces must be a whole number from 0 to 10000"),
        ("fov 180", "the field of view must be between 0 and 180, both excluded"),
        ("fov 0", "the field of view must be between 0 and 180, both excluded"),
        ("sphere 0 0 0 0", "the radius must be greater than 0"),
        ("sphere 0 0 0 -1", "the radius must be greater than 0"),
        ("light 0 0 0 -1", "the intensity must be 0 or more"),
        ("amblight -1", "the intensity must be 0 or more"),
        ("local -1", "the weight must be 0 or more"),
        ("transmit 1 0", "the index of refraction must be greater than 0"),
        ("shininess -1", "the exponent must be 0 or more"),
        ("scale 0", "the scale must be other than 0"),
        ("scale 1 0 1", "the scale along y must be other than 0"),
        ("rotate 90 0 0 0", "the axis must not be zero"),
        ("sun 0 0 0 1", "the direction must not be zero"),
        ("plane 0 0 0 0 0 0", "the normal must not be zero"),
        ("frame 0 0 0", "the direction of view must not be zero"),
        ("local nan", "the weight must be a finite number, not `nan`"),
        ("local inf", "the weight must be a finite number, not `inf`"),
        ("local -infinity", "the weight must be a finite number, not `-infinity`"),
        ("eye 1e39 0 0", "x of the eye is too large: numbers go up to 3.4e38"),
        ("eye 1e999 0 0", "x of the eye is too large: numbers go up to 3.4e38"),
        ("sphere 1 2 x 4", "z of the centre must be a number, not `x`"),
        ("color 5 1 1 1", "a colour's name must not be a number like `5`"),
        ("smooth yes", "`yes` is not one of `on`, `off`"),
        ("output \"\"", "this is no name of a file"),
    ] {
        assert_eq!(error(text), says, "{text}");
    }
}

#[test]
fn missing_words_are_named() {
    for (text, says) in [
        ("sphere 1 2 3", "`sphere` ends too early: the radius is missing"),
        ("eye 1", "`eye` ends too early: y of the eye is missing"),
        ("mat", "`mat` ends too early: what to set, `amb`, `diff`, `spec`, `save` or `load`, is missing"),
        ("mat amb", "`mat amb` ends too early: a colour is missing"),
        ("mat amb 1 1", "`mat amb` ends too early: blue of the colour is missing"),
        ("mat load", "`mat load` ends too early: the material's name is missing"),
        ("light 0 0 0 1 1", "`light` ends too early: green of the colour is missing"),
        ("scale 1 1", "`scale` ends too early: the scale along z is missing"),
        ("transmit 0.5", "`transmit` ends too early: the index of refraction is missing"),
        ("obj", "`obj` ends too early: the name of a file is missing"),
    ] {
        assert_eq!(error(text), says, "{text}");
    }
}

#[test]
fn superfluous_words_are_only_warnings() {
    assert_eq!(warnings("sphere 0 0 0 1 2"), ["a superfluous word after `sphere`"]);
    assert_eq!(warnings("depth 3 bounces please"), ["2 superfluous words after `depth`"]);
    assert_eq!(warnings("mat save a b"), ["a superfluous word after `mat save`"]);
    assert_eq!(warnings("light 0 0 0 1 white"), ["a superfluous word after `light`"]);
    assert_eq!(warnings("color c 255 0 0").len(), 1);
    assert_eq!(warnings("reflect 2").len(), 1);
    assert_eq!(warnings("triangle 0 0 0 1 1 1 2 2 2").len(), 1);
    assert_eq!(warnings("rectangle 0 0 0 1 0 0 2 0 0").len(), 1);
    assert_eq!(warnings("push").len(), 1);
    assert_eq!(warnings("fov 30").len(), 1);
}

#[test]
fn materials_are_copied_into_shapes() {
    let scene = read(
        "color a 1 0 0\nmat diff a\nsphere 0 0 0 1\nmat save a\nmat diff 0 1 0\nreflect .5\nlocal .25\ntransmit .125 1.5\n\
         shininess 7\nmat amb 0 0 1\nmat spec .5 .5 .5\nsphere 0 0 0 1\nmat load a\nsphere 0 0 0 1",
    );
    let red = Material { diffuse: v(1.0, 0.0, 0.0), ..Material::default() };
    let green = Material {
        ambient: v(0.0, 0.0, 1.0),
        diffuse: v(0.0, 1.0, 0.0),
        specular: DVec3::splat(0.5),
        local: 0.25,
        reflect: 0.5,
        transmit: 0.125,
        ior: 1.5,
        shininess: 7.0,
    };
    assert_eq!(scene.materials, [red, green]);
    assert_eq!(scene.shapes.iter().map(|s| s.material).collect::<Vec<_>>(), [0, 1, 0]);
}

#[test]
fn a_color_may_be_named_anew_without_effect_on_the_past() {
    let scene =
        read("color a 1 0 0\nmat diff a\nsphere 0 0 0 1\ncolor a 0 1 0\nsphere 0 0 0 1\nmat diff a\nsphere 0 0 0 1");
    assert_eq!(scene.shapes.iter().map(|s| s.material).collect::<Vec<_>>(), [0, 0, 1]);
    assert_eq!(scene.materials[1].diffuse, v(0.0, 1.0, 0.0));
}

#[test]
fn transmit_needs_no_index_where_nothing_is_refracted() {
    for text in ["transmit 0", "transmit 0 0", "transmit 0.0 -3", "transmit 1 1.5\ntransmit 0 0"] {
        let scene = read(&format!("{text}\nsphere 0 0 0 1"));
        assert_eq!(scene.materials, [Material::default()], "{text}");
    }
    assert_eq!(error("transmit 0 glass"), "the index of refraction must be a number, not `glass`");
}

#[test]
fn names_are_told_apart_and_unknown_ones_refused() {
    read("color blue 0 0 1\nmat amb blue\nmat save blue\nmat load blue\nmat diff blue");
    let told = errors(
        "color green 0 1 0\nmat amb gren\nmat save leaf\nmat load lef\nmat diff leaf\nmat load nothing\nmat diff sky",
    );
    let said: Vec<_> = told.iter().map(|d| (d.message.as_str(), d.help.as_deref().unwrap_or(""))).collect();
    assert_eq!(
        said,
        [
            ("no colour is called `gren`", "did you mean `green`?"),
            ("no material is called `lef`", "did you mean `leaf`?"),
            ("no colour is called `leaf`", "`leaf` is a material, to be recalled by `mat load`"),
            ("no material is called `nothing`", "`mat save nothing` must come first"),
            ("no colour is called `sky`", "`color NAME R G B` must come first, or give three numbers"),
        ]
    );
}

#[test]
fn shapes_stand_in_order() {
    let scene = read("sphere 1 2 3 4\ntriangle 0 0 0 1 0 0 0 1 0\nrectangle 0 0 0 2 0 0 2 0 -3\nplane 0 1 0 0 2 0");
    assert_eq!(sphere(&scene, 0), (v(1.0, 2.0, 3.0), 4.0, DAffine3::IDENTITY));
    let Geometry::Triangle(triangle) = scene.shapes[1].geometry else { panic!() };
    assert_eq!(triangle.vertices(), [Vec3::ZERO, Vec3::X, Vec3::Y]);
    let corner = |x, z| Vec3::new(x, 0.0, z);
    let rectangle = [corner(0.0, 0.0), corner(2.0, 0.0), corner(2.0, -3.0), corner(0.0, -3.0)];
    assert_eq!(scene.shapes[2].geometry, Geometry::Rectangle(rectangle));
    assert_eq!(scene.shapes[3].geometry, Geometry::Plane { point: v(0.0, 1.0, 0.0), normal: v(0.0, 1.0, 0.0) });
}

#[test]
fn corners_are_rounded_once() {
    // In f32, 0.1 + 0.7 - 0.3 would be rounded three times; 16777217 is not an f32 at all.
    let scene = read("rectangle 0.1 0 0 0.3 0 0 0.7 1 0\ntranslate 1 0 0\ntriangle 16777216 0 0 1 0 0 0 1 0");
    let Geometry::Rectangle(corners) = scene.shapes[0].geometry else { panic!() };
    assert_eq!(corners[3], Vec3::new((0.1f64 + 0.7 - 0.3) as f32, 1.0, 0.0));
    let Geometry::Triangle(triangle) = scene.shapes[1].geometry else { panic!() };
    assert_eq!(triangle.a.x, 16777217.0f64 as f32);
}

#[test]
fn lights_have_a_color_and_move_with_the_transform() {
    let scene = read(
        "light 1 2 3 .5\nlight 1 2 3 2 1 .5 0\nsun 0 -2 0 1\npush\ntranslate 1 0 0\nrotate 90 0 0 1\nlight 1 0 0 1\nsun 1 0 0 1\npop",
    );
    let point = |position, color| Light::Point { position, color };
    assert_eq!(scene.lights[0], point(v(1.0, 2.0, 3.0), DVec3::splat(0.5)));
    assert_eq!(scene.lights[1], point(v(1.0, 2.0, 3.0), v(2.0, 1.0, 0.0)));
    assert_eq!(scene.lights[2], Light::Sun { direction: v(0.0, -1.0, 0.0), color: DVec3::ONE });
    assert_eq!(scene.lights[3], point(v(1.0, 1.0, 0.0), DVec3::ONE));
    assert_eq!(scene.lights[4], Light::Sun { direction: v(0.0, 1.0, 0.0), color: DVec3::ONE });
}

#[test]
fn transforms_compose_from_the_shape_outward() {
    let scene = read(
        "push\ntranslate 10 0 0\nrotate 90 0 0 1\nscale 2\nsphere 1 0 0 1\npop\nsphere 1 0 0 1\n\
         rotate 90 0 0 1\ntranslate 10 0 0\nsphere 1 0 0 1",
    );
    let (center, radius, to_world) = sphere(&scene, 0);
    assert!(near(center, v(10.0, 2.0, 0.0)), "{center}");
    assert!((radius - 2.0).abs() < 1e-12);
    assert_eq!(to_world, DAffine3::IDENTITY);
    assert_eq!(sphere(&scene, 1), (v(1.0, 0.0, 0.0), 1.0, DAffine3::IDENTITY));
    assert!(near(sphere(&scene, 2).0, v(0.0, 11.0, 0.0)));
}

#[test]
fn rotation_is_right_handed_in_degrees() {
    for (text, from, to) in [
        ("rotate 90 1 0 0", v(0.0, 1.0, 0.0), v(0.0, 0.0, 1.0)),
        ("rotate 90 0 1 0", v(0.0, 0.0, 1.0), v(1.0, 0.0, 0.0)),
        ("rotate 90 0 0 5", v(1.0, 0.0, 0.0), v(0.0, 1.0, 0.0)),
        ("rotate 120 1 1 1", v(1.0, 0.0, 0.0), v(0.0, 1.0, 0.0)),
        ("rotate -450 0 0 1", v(0.0, 1.0, 0.0), v(1.0, 0.0, 0.0)),
        ("rotate 30 0 0 1", v(1.0, 0.0, 0.0), v(0.75f64.sqrt(), 0.5, 0.0)),
    ] {
        let scene = read(&format!("{text}\nsphere {} {} {} 1", from.x, from.y, from.z));
        let center = sphere(&scene, 0).0;
        assert!(near(center, to), "{text}: {center}");
    }
    // Quarter turns about the axes of the world are exact.
    let scene = read("rotate 270 0 1 0\nsphere 1 2 3 1");
    assert_eq!(sphere(&scene, 0).0, v(-3.0, 2.0, 1.0));
}

#[test]
fn spheres_stay_spheres_under_similarities_only() {
    let scene = read("rotate 37 1 2 3\nscale -2\ntranslate 1 1 1\nsphere 0 0 0 3\nscale 1 2 1\nsphere 1 2 3 4");
    let (_, radius, to_world) = sphere(&scene, 0);
    assert!((radius - 6.0).abs() < 1e-9 && to_world == DAffine3::IDENTITY);
    let (center, radius, to_world) = sphere(&scene, 1);
    assert_eq!((center, radius), (v(1.0, 2.0, 3.0), 4.0));
    assert!((to_world.matrix3.determinant() + 16.0).abs() < 1e-9);
}

#[test]
fn planes_keep_their_normal_at_right_angles() {
    let scene = read("translate 0 3 0\nscale 1 2 1\nplane 0 1 0 0 1 1");
    let Geometry::Plane { point, normal } = scene.shapes[0].geometry else { panic!() };
    assert_eq!(point, v(0.0, 5.0, 0.0));
    // (1,0,0) and (0,-1,1) lay in the plane; now (0,-2,1) does.
    assert!(normal.dot(v(0.0, -2.0, 1.0)).abs() < 1e-12 && normal.dot(v(1.0, 0.0, 0.0)).abs() < 1e-12);
    assert!(normal.y > 0.0);
}

#[test]
fn transforms_that_lose_something_are_refused() {
    assert_eq!(error("pop"), "there is no `push` that this `pop` could take back");
    let squash = "scale 1e-38\n".repeat(2);
    assert!(error(&squash).contains("squash everything flat"));
    assert!(error("scale 1e38\nsphere 1e38 0 0 1").contains("too far away"));
    assert!(error("translate 3e38 0 0\nlight 3e38 0 0 1").contains("too far away"));
    assert!(
        error("rectangle -3e38 0 0 -3e38 1 0 3e38 0 0\nrectangle 3e38 0 0 -3e38 1 0 3e38 0 0")
            .contains("fourth corner")
    );
}

#[test]
fn cameras_come_in_three_styles() {
    let classic = "eye 0 0 15\norigin -5 -5 8\nhoriz 10 0 0\nvert 0 10 0\n";
    let rectangle = Camera::Rectangle {
        eye: v(0.0, 0.0, 15.0),
        origin: v(-5.0, -5.0, 8.0),
        horiz: v(10.0, 0.0, 0.0),
        vert: v(0.0, 10.0, 0.0),
    };
    assert_eq!(read(classic).camera, rectangle);
    let look = |fov| Camera::LookAt { eye: v(0.0, 1.0, 2.0), at: v(0.0, 0.0, 0.0), up: v(0.0, 1.0, 0.0), fov };
    assert_eq!(read("lookat 0 1 2  0 0 0  0 1 0").camera, look(45.0));
    assert_eq!(read("fov 30\nlookat 0 1 2  0 0 0  0 1 0").camera, look(30.0));
    assert_eq!(read("lookat 9 9 9 0 0 0 0 1 0\nlookat 0 1 2  0 0 0  0 1 0\nfov 20\nfov 30").camera, look(30.0));
    assert_eq!(read("frame").camera, Camera::Auto);
    let Camera::Frame(direction) = read("frame -1e-200 -2e-200 -2e-200").camera else { panic!() };
    assert!(near(direction, v(-1.0, -2.0, -2.0) / 3.0));
    // Transforms do not touch the camera.
    assert_eq!(read(&format!("translate 1 2 3\n{classic}")).camera, rectangle);
}

#[test]
fn cameras_without_sense_are_refused() {
    assert_eq!(error("eye 0 0 1"), "the camera is incomplete without `origin`, `horiz`, `vert`");
    assert_eq!(error("eye 0 0 1\norigin 0 0 0\nhoriz 1 0 0"), "the camera is incomplete without `vert`");
    assert_eq!(
        error("eye 0 0 1\n\nlookat 0 0 1 0 0 0 0 1 0\norigin 0 0 0\nhoriz 1 0 0\nvert 0 1 0"),
        "`lookat` does not go with `eye` (line 1)"
    );
    assert_eq!(error("frame\nlookat 0 0 1 0 0 0 0 1 0"), "`lookat` does not go with `frame` (line 1)");
    assert!(error("eye 0 0 1\norigin 0 0 0\nhoriz 1 2 0\nvert 2 4 0").contains("no area"));
    assert!(error("eye 0 0 1\norigin 0 0 0\nhoriz 1 0 0\nvert 0 0 0").contains("no area"));
    assert!(error("eye 5 5 0\norigin 0 0 0\nhoriz 1 0 0\nvert 0 1 0").contains("plane of the image"));
    assert!(error("lookat 1 1 1 1 1 1 0 1 0").contains("are the same"));
    assert!(error("lookat 0 5 0 0 0 0 0 1 0").contains("line of sight"));
    assert!(error("lookat 0 5 0 0 0 0 0 0 0").contains("must not be zero"));
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
fn lenient_reading_leaves_out_the_lines_at_fault() {
    let text =
        "sphere 0 0 0 1\nspere 0 0 0 1\nmat amb 1 x 1\nobj nowhere.obj\nsamples 5\npop\neye 0 0 1\nsphere 1 1 1 1";
    let (scene, told) = read_in(Path::new("."), text, LoadOptions { lenient: true });
    let scene = scene.unwrap();
    assert_eq!(told.len(), 6, "{told:?}");
    assert_eq!((scene.shapes.len(), scene.samples, scene.camera), (2, 1, Camera::Auto));
    assert_eq!(scene.materials, [Material::default()]);
    assert!(scene.meshes.is_empty());
}

#[test]
fn all_errors_come_at_once_up_to_a_bound() {
    let told = errors("spere\nsphere 0 0 0 1\nbackgroun 1 1 1\neye x y z");
    assert_eq!(told.iter().map(|d| d.line).collect::<Vec<_>>(), [1, 3, 4]);
    let told = errors(&"wrong\n".repeat(5000));
    assert_eq!(told.len(), 1001);
    assert!(told[1000].message.starts_with("more than 1000 errors"));
}

#[test]
fn commands_are_counted() {
    let text = "depth 1\n".repeat(1_000_000);
    assert!(read_in(Path::new(""), &text, STRICT).0.is_ok());
    assert_eq!(error(&(text + "# no command\ndepth 1")), "a scene has at most 1000000 commands");
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
fn the_wish_to_stop_is_heard() {
    let stop = AtomicBool::new(true);
    let text = "depth 1\n".repeat(100_000);
    let read = Scene::parse(&text, "s", Path::new(""), STRICT, Monitor::new(&|_| {}, &stop));
    assert!(matches!(read, Err(Error::Interrupted)));
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
