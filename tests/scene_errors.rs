//! Errors of scene files as a user sees them, and input that is no scene at all.

use std::fs;
use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::AtomicBool;

use octrace::scene::{LoadOptions, Scene};
use octrace::{Diagnostic, Error, Event, Monitor, Severity};
use proptest::prelude::*;

/// Message, place, line, caret and help: what every rendering of a diagnostic must say.
fn render(told: &Diagnostic) -> String {
    let severity = match told.severity {
        Severity::Error => "error",
        Severity::Warning => "warning",
    };
    let marked = told.text[told.span.clone()].chars().count().max(1);
    let blank: String = told.text[..told.span.start].chars().map(|c| if c == '\t' { '\t' } else { ' ' }).collect();
    let Diagnostic { message, file, line, column, text, .. } = told;
    let help = told.help.as_ref().map(|help| format!("\n  = help: {help}")).unwrap_or_default();
    format!("{severity}: {message}\n --> {file}:{line}:{column}\n  | {text}\n  | {blank}{}{help}", "^".repeat(marked))
}

/// All that is told about the file `name`, with the folder's own name taken out.
fn told(folder: &Path, name: &str, lenient: bool) -> (Vec<Diagnostic>, Result<Scene, Error>) {
    let warnings = Mutex::new(Vec::new());
    let sink = |event: Event| {
        if let Event::Diagnostic(diagnostic) = event {
            warnings.lock().unwrap().push(diagnostic);
        }
    };
    let stop = AtomicBool::new(false);
    let scene = Scene::load(&folder.join(name), LoadOptions { lenient }, Monitor::new(&sink, &stop));
    let mut all = warnings.into_inner().unwrap();
    if let Err(Error::Text(errors)) = &scene {
        all.extend(errors.clone());
    }
    let here = format!("{}/", folder.display());
    for diagnostic in &mut all {
        diagnostic.file = diagnostic.file.replace(&here, "");
        diagnostic.message = diagnostic.message.replace(&here, "");
        diagnostic.help = diagnostic.help.as_ref().map(|help| help.replace(&here, ""));
    }
    (all, scene)
}

/// What is told about a scene of this text in a folder with a few files, warnings first.
fn rendered(text: &[u8], lenient: bool) -> String {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("bunny.obj"), "").unwrap();
    fs::write(folder.path().join("part.txt"), "# a part\nspher 0 0 0 1\ninclude scene.txt\n").unwrap();
    fs::write(folder.path().join("scene.txt"), text).unwrap();
    let (all, _) = told(folder.path(), "scene.txt", lenient);
    all.iter().map(render).collect::<Vec<_>>().join("\n\n")
}

#[test]
fn misspelt_commands_and_names() {
    let text = b"output a.png\nrectange 0 0 0 1 0 0 1 1 0\nSphere 0 0 0 1\ncolour red 1 0 0\ncolor green 0 1 0\n\
                 mat amb gren\nmat save leaf\nmat load leafs\nmat ambient 1 1 1\nsmooth onn\ntonemap rgb\nfrobnicate 3\n";
    insta::assert_snapshot!(rendered(text, false));
}

#[test]
fn words_that_are_wrong_or_missing() {
    let text = b"sphere 0 0 0\n  light 1 2 three 1\nbackground 0 0 1.5 # too blue\nsamples 10\noutsize 512\neye 1,5 2 3\n\
                 transmit 1\ndepth -1\n\tlocal\tnan\nmat spec 1 1\nlookat 0 0 1 0 0 1 0 1 0\npop\noutput \"a b.png\nrotate 90 0 0 0\n";
    insta::assert_snapshot!(rendered(text, false));
}

#[test]
fn files_that_cannot_be_had() {
    let text = b"obj buny.obj\noct bunny.oct\nobj \"no such mesh.obj\"\noct bunny.obj\nobj a.oct\nobj .\ninclude prat.txt\ninclude part.txt\n";
    insta::assert_snapshot!(rendered(text, false));
}

#[test]
fn cameras_that_contradict_or_lack_something() {
    insta::assert_snapshot!(rendered(b"eye 0 0 5\norigin -1 -1 0\nframe 0 0 -1\nvert 0 2 0\nfov 30\n", false));
}

#[test]
fn warnings_do_not_stop_anything() {
    let text = b"sphere 0 0 0 1 2 3\nobj bunny.obj now\ncolor red 255 0 0\npush\nfov 20\ntriangle 0 0 0 1 1 1 2 2 2\noutput my picture.png\n";
    insta::assert_snapshot!(rendered(text, false));
}

#[test]
fn lenient_reading_tells_the_same_as_warnings() {
    insta::assert_snapshot!(rendered(b"spere 0 0 0 1\nsphere 0 0 0 1\nobj nowhere.obj\neye 0 0 1\n", true));
}

#[test]
fn bytes_that_are_no_text() {
    let latin = rendered(b"sphere 0 0 0 1\nobj caf\xE9.obj\n", false);
    let wide: Vec<u8> = "\u{feff}eye 0\n".encode_utf16().flat_map(u16::to_le_bytes).collect();
    let binary = rendered(b"\x89OCT\r\n\x1a\n\0\0\0\x01", false);
    insta::assert_snapshot!([latin, rendered(&wide, false), binary].join("\n\n"));
}

#[test]
fn long_lines_and_strange_words() {
    let far = format!("sphere {}0 0 0 wrong {}\n", " ".repeat(300), "more ".repeat(100));
    let long = format!("{}\n", "x".repeat(5000));
    let strange = "sph\u{1b}[31mere 1\nmat amb g\u{9b}r\u{200b}ün\n";
    insta::assert_snapshot!(rendered([far.as_str(), &long, strange].concat().as_bytes(), false));
}

#[test]
fn one_line_form() {
    let error = Scene::parse(
        "spere 0 0 0 1\n  samples 5\n",
        "scene.txt",
        Path::new(""),
        LoadOptions::default(),
        Monitor::silent(),
    );
    insta::assert_snapshot!(error.unwrap_err().to_string());
}

/// Spans and columns of `told` are inside of its text.
fn assert_sound(told: &[Diagnostic]) {
    for diagnostic in told {
        assert!(diagnostic.text.get(diagnostic.span.clone()).is_some(), "{diagnostic:?}");
        assert!(diagnostic.line >= 1 && diagnostic.column >= 1);
        assert!(!diagnostic.text.contains(|c: char| c.is_control() && c != '\t'), "{diagnostic:?}");
        assert!(!diagnostic.to_string().contains('\n'));
    }
}

/// Every number of the scene is one that the renderer may be given.
fn assert_usable(scene: &Scene) {
    for instance in &scene.instances {
        assert!(instance.to_world.inverse().is_finite());
    }
    for shape in &scene.shapes {
        assert!(shape.material < scene.materials.len());
        assert!(!format!("{:?}", shape.geometry).contains("NaN") && !format!("{:?}", shape.geometry).contains("inf"));
    }
    for light in &scene.lights {
        assert!(!format!("{light:?}").contains("NaN") && !format!("{light:?}").contains("inf"), "{light:?}");
    }
}

fn parse(text: &str, lenient: bool) -> Result<Scene, Error> {
    let told = Mutex::new(Vec::new());
    let sink = |event: Event| {
        if let Event::Diagnostic(diagnostic) = event {
            told.lock().unwrap().push(diagnostic);
        }
    };
    let stop = AtomicBool::new(false);
    // A folder that is not there, so that no name leads to a file.
    let folder = Path::new("there is no such folder");
    let scene = Scene::parse(text, "s", folder, LoadOptions { lenient }, Monitor::new(&sink, &stop));
    assert_sound(&told.into_inner().unwrap());
    scene
}

const WORDS: [&str; 61] = [
    "output",
    "outsize",
    "eye",
    "origin",
    "horiz",
    "vert",
    "background",
    "color",
    "mat",
    "amb",
    "diff",
    "spec",
    "save",
    "load",
    "local",
    "reflect",
    "transmit",
    "sphere",
    "triangle",
    "rectangle",
    "amblight",
    "light",
    "obj",
    "oct",
    "off",
    "resolution",
    "lookat",
    "fov",
    "frame",
    "shininess",
    "samples",
    "depth",
    "mtl",
    "on",
    "smooth",
    "push",
    "pop",
    "translate",
    "scale",
    "rotate",
    "plane",
    "sun",
    "include",
    "tonemap",
    "none",
    "srgb",
    "name",
    "\"a b\"",
    "\"",
    "#",
    "é",
    "0",
    "1",
    "-1",
    "0.5",
    "1e38",
    "-1e38",
    "1e-38",
    "nan",
    "1e400",
    "4",
];

/// Lines that are likely to make sense: a command and the numbers that it takes.
fn likely_line() -> impl Strategy<Value = String> {
    let command = prop::sample::select(vec![
        ("sphere", 4),
        ("triangle", 9),
        ("rectangle", 9),
        ("plane", 6),
        ("light", 4),
        ("light", 7),
        ("sun", 4),
        ("translate", 3),
        ("scale", 1),
        ("scale", 3),
        ("rotate", 4),
        ("lookat", 9),
        ("eye", 3),
        ("push", 0),
        ("pop", 0),
    ]);
    let number = prop_oneof![-10.0..10.0f64, -3e38..3e38f64, -1e-30..1e-30f64, Just(0.0), Just(1.0)];
    (command, prop::collection::vec(number, 9)).prop_map(|((name, count), numbers)| {
        numbers[..count].iter().fold(name.to_string(), |line, number| format!("{line} {number}"))
    })
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn random_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("s"), bytes).unwrap();
        for lenient in [false, true] {
            assert_sound(&told(folder.path(), "s", lenient).0);
        }
    }

    #[test]
    fn random_text_never_panics(text in "(\\PC|\n|\t|\"|#| ){0,300}") {
        if let Err(Error::Text(errors)) = parse(&text, false) {
            assert_sound(&errors);
        }
    }

    #[test]
    fn random_words_never_panic(
        lines in prop::collection::vec(prop::collection::vec(prop::sample::select(&WORDS[..]), 0..12), 0..20),
        lenient: bool,
    ) {
        let text: String = lines.iter().map(|words| words.join(" ") + "\n").collect();
        match parse(&text, lenient) {
            Ok(scene) => assert_usable(&scene),
            Err(Error::Text(errors)) => {
                prop_assert!(!lenient);
                assert_sound(&errors);
            }
            Err(other) => prop_assert!(false, "{}", other),
        }
    }

    #[test]
    fn likely_scenes_are_usable(lines in prop::collection::vec(likely_line(), 0..40)) {
        assert_usable(&parse(&lines.join("\n"), true).unwrap());
    }
}
