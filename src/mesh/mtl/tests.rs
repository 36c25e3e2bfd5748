//! Material libraries, good and bad.

use std::sync::Mutex;
use std::sync::atomic::AtomicBool;

use super::*;
use crate::event::Event;

fn watched<T>(work: impl FnOnce(Monitor<'_>) -> T) -> (T, String) {
    let seen = Mutex::new(String::new());
    let note = |event: Event| {
        if let Event::Warning(text) = event {
            *seen.lock().unwrap() += &format!("{text}\n");
        }
    };
    let stop = AtomicBool::new(false);
    let result = work(Monitor::new(&note, &stop));
    (result, seen.into_inner().unwrap())
}

fn load_bytes(bytes: &[u8]) -> (Vec<MaterialInfo>, String) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mtl");
    std::fs::write(&path, bytes).unwrap();
    let (materials, warnings) = watched(|monitor| load(&path, monitor).unwrap());
    (materials, warnings.replace(folder.path().to_str().unwrap(), "DIR"))
}

#[test]
fn all_properties_are_read() {
    let (found, warnings) = load_bytes(
        b"Kd 9 9 9\nnewmtl red one\r\nKa .1 .2 .3\r\nKd 1 0 0 # red\r\n\tKs 1\nNs 10\nNi 1.5\nd 0.5\nillum 2\nKe x\n\
          newmtl glass\nTr 0.75",
    );
    assert_eq!(warnings, "");
    assert_eq!(found.len(), 2);
    let red = MaterialInfo {
        name: "red one".into(),
        ka: Some([0.1, 0.2, 0.3]),
        kd: Some([1.0, 0.0, 0.0]),
        ks: Some([1.0; 3]),
        ns: Some(10.0),
        ni: Some(1.5),
        d: Some(0.5),
        illum: Some(2),
        map_kd: None,
    };
    assert_eq!(found[0], red);
    assert_eq!((found[1].d, &found[1].name[..]), (Some(0.25), "glass"));
}

#[test]
fn what_makes_no_sense_is_a_warning() {
    let (found, warnings) = load_bytes(
        b"newmtl a\nKd 1 x 0\nKd spectral x.rfl\nKs\nd -halo 0.5\nillum 999\nmap_Kd\nNs 5\nnewmtl\nKd 1 1 1\nnewmtl b\xe9\nKd 1\n",
    );
    assert_eq!(warnings, "DIR/a.mtl: these lines make no sense and are ignored: 2, 3, 4, 5, 6, 7, 9\n");
    let names: Vec<&str> = found.iter().map(|material| &material.name[..]).collect();
    assert_eq!(names, ["a", "bé"]);
    assert_eq!((found[0].ns, found[0].kd, found[1].kd), (Some(5.0), None, Some([1.0; 3])));
}

#[test]
fn textures_are_found_behind_options_and_odd_paths() {
    assert_eq!(texture_name("-s 1 1 1 -o -0.5 a b.png"), "a b.png");
    assert_eq!(texture_name("-s 2 c.png"), "c.png");
    assert_eq!(texture_name("-clamp on -mm 0 1 -bm 0.2 d.png"), "d.png");
    assert_eq!(texture_name("-x.png"), "-x.png");
    assert_eq!(texture_name("-clamp"), "");
    let (found, warnings) = load_bytes(b"newmtl a\nmap_Kd -s 1 1 1 maps\\sub\\x y.png\n");
    assert!(found[0].map_kd.as_ref().unwrap().ends_with("maps/sub/x y.png"));
    assert_eq!(warnings, "DIR/maps/sub/x y.png: no such texture, material \"a\" goes without\n");
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("t.png"), "").unwrap();
    assert_eq!(locate(folder.path(), "C:\\Users\\x\\t.png"), folder.path().join("t.png"));
    assert_eq!(locate(folder.path(), "\"t.png\""), folder.path().join("t.png"));
}

#[test]
fn libraries_may_have_blanks_in_their_names_or_be_several() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    std::fs::write(at("a b.mtl"), "newmtl ab\nNs 1").unwrap();
    std::fs::write(at("c.mtl"), "newmtl c\nNs 2\nnewmtl ab\nNs 3").unwrap();
    assert_eq!(library_paths(folder.path(), "a b.mtl"), [at("a b.mtl")]);
    assert_eq!(library_paths(folder.path(), "c.mtl d.mtl"), [at("c.mtl"), at("d.mtl")]);
    assert_eq!(library_paths(folder.path(), "x y.mtl"), [at("x y.mtl")]);
    let names = |all: &[&str]| {
        let mut names = Names::default();
        all.iter().for_each(|name| assert!(names.number(name).is_some()));
        names
    };
    let used = || names(&["c", "ab", "no", "c # blue"]);
    let libraries = names(&["a b.mtl", "c.mtl", "gone.mtl"]);
    let (found, warnings) = watched(|monitor| resolve(("a.obj", folder.path()), &libraries, used(), 10_000, monitor));
    let found = found.unwrap();
    assert_eq!(found.iter().map(|material| material.ns).collect::<Vec<_>>(), [Some(2.0), Some(1.0), None, Some(2.0)]);
    assert_eq!((&found[2].name[..], &found[3].name[..]), ("no", "c # blue"));
    assert!(warnings.contains("gone.mtl: cannot open"), "{warnings}");
    assert!(warnings.contains("no material library defines \"no\": "), "{warnings}");
    // A texture takes memory too.
    let enough = bytes_of(&used());
    let found = |memory| resolve(("a.obj", folder.path()), &libraries, used(), memory, Monitor::silent());
    assert!(found(enough).is_some());
    std::fs::write(at("a b.mtl"), "newmtl ab\nmap_Kd x.png").unwrap();
    assert!(found(enough).is_none() && found(enough + 1000).is_some());
}
