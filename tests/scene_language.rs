//! What each command of the scene language does, through the library.

#[path = "scene_language/files.rs"]
mod files;
#[path = "scene_language/placed.rs"]
mod placed;

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
fn the_wish_to_stop_is_heard() {
    let stop = AtomicBool::new(true);
    let text = "depth 1\n".repeat(100_000);
    let read = Scene::parse(&text, "s", Path::new(""), STRICT, Monitor::new(&|_| {}, &stop));
    assert!(matches!(read, Err(Error::Interrupted)));
}
