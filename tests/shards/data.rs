//! Pictures of data (`--aov`) of shares, which travel in the parts.

use super::support::*;
use super::{lab, parts};

const ALL: [&str; 9] = ["depth", "normal", "position", "face", "material", "cost", "pages", "reads", "shadow"];

/// `--aov NAME` for each.
fn names<'a>(kinds: &[&'a str]) -> Vec<&'a str> {
    kinds.iter().flat_map(|kind| ["--aov", kind]).collect()
}

/// `--aov NAME=FIRST-NAME.exr` and `.png` for each.
fn files(kinds: &[&str], first: &str) -> Vec<String> {
    let pairs = kinds.iter().flat_map(|kind| ["exr", "png"].map(|suffix| format!("{kind}={first}-{kind}.{suffix}")));
    pairs.flat_map(|pair| ["--aov".to_owned(), pair]).collect()
}

/// Draws as one, and assembles these parts; the picture and all data have to be the same bytes.
fn same(lab: &Lab, parts: &[String], kinds: &[&str], options: &[&str]) {
    let [one, many] = ["one", "many"].map(|first| files(kinds, first));
    let strings = |list: &[String]| list.iter().map(String::clone).collect::<Vec<_>>();
    let run = |arguments: Vec<String>| {
        lab.done("octrender", &arguments.iter().map(String::as_str).collect::<Vec<_>>());
    };
    let owned = |list: &[&str]| list.iter().map(|x| (*x).to_owned()).collect::<Vec<_>>();
    run([owned(&["scene.txt", "-q", "-o", "one.exr"]), owned(options), one].concat());
    run([owned(&["--assemble"]), strings(parts), owned(&["-q", "-o", "many.exr"]), many].concat());
    assert!(lab.read("one.exr") == lab.read("many.exr"), "{options:?}: the picture");
    for kind in kinds {
        for suffix in ["exr", "png"] {
            let name = format!("{kind}.{suffix}");
            let [one, many] = ["one", "many"].map(|first| lab.read(&format!("{first}-{name}")));
            assert!(one == many, "{options:?}: {name}");
        }
    }
}

#[test]
fn put_together_it_is_the_bytes_of_one_machine() {
    let lab = lab();
    for (of, options) in [
        // Wide enough for the scale below.
        (3, &["--size", "200x120", "--samples", "4"][..]),
        (4, &["--samples", "9", "--crop", "11,7,130,80", "--depth", "2"]),
        (1, &["--lod", "2", "--threads", "1"]),
    ] {
        let parts = parts(&lab, of, &[options, &names(&ALL)].concat());
        same(&lab, &parts, &ALL, options);
        // It need not all be asked for, nor any.
        same(&lab, &parts, &["face"], options);
        same(&lab, &parts, &[], options);
        parts.iter().for_each(|part| std::fs::remove_file(lab.path(part)).unwrap());
    }
}

#[test]
fn it_is_the_same_within_a_bound_on_memory() {
    let lab = lab();
    let kinds = ["normal", "depth", "face", "material", "shadow", "position"];
    let parts = parts(&lab, 3, &[&["--samples", "4", "--memory", "128M"], &names(&kinds)[..]].concat());
    same(&lab, &parts, &kinds, &["--samples", "4"]);
    // How often rays wait for pages depends on what was traced before.
    lab.done("octrender", &["scene.txt", "-q", "--shard", "0/1", "--memory", "128M", "--aov", "reads", "-o", "r.exr"]);
    lab.done("octrender", &["--assemble", "r.exr", "-q", "-o", "a.png", "--aov", "reads=reads.exr"]);
    assert!(lab.path("reads.exr").exists());
}

#[test]
fn a_share_that_is_made_again_has_the_same_bytes_in_whatever_order_data_is_asked_for() {
    let lab = lab();
    let draw = |output: &str, kinds: &[&str]| {
        lab.done("octrender", &[&["scene.txt", "-q", "--shard", "1/4", "-o", output], &names(kinds)[..]].concat());
        lab.read(output)
    };
    let first = draw("a.exr", &["shadow", "depth", "cost"]);
    assert!(first == draw("b.exr", &["cost", "depth", "shadow", "depth"]));
    assert!(first != draw("c.exr", &["cost", "depth"]));
}

#[test]
fn parts_without_it_are_named() {
    let lab = lab();
    let with = parts(&lab, 3, &["--aov", "depth", "--aov", "normal"]);
    lab.done("octrender", &["scene.txt", "-q", "--shard", "1/3", "--aov", "normal"]);
    let assemble = |options: &[&str]| {
        let names: Vec<&str> = with.iter().map(String::as_str).collect();
        [&["--assemble"], &names[..], &["-o", "out.png", "-q"], options]
            .concat()
            .iter()
            .map(|x| (*x).to_owned())
            .collect()
    };
    let run = |arguments: &Vec<String>| {
        let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
        lab.run("octrender", &arguments)
    };
    let wanted: Vec<String> = assemble(&["--aov", "depth=d.exr", "--aov", "depth=d.png", "--aov", "normal=n.exr"]);
    let refused = run(&wanted);
    let message = told(&refused);
    assert_eq!(refused.status.code(), Some(2), "{message}");
    let expected = "scene.part-1-of-3.exr was made without --aov depth: make share 1/3 again with it";
    assert!(message.contains(expected), "{message}");
    assert!(!message.contains("part-0") && !message.contains("part-2"), "{message}");
    assert!(!lab.files().iter().any(|name| ["out.png", "d.exr", "n.exr"].contains(&name.as_str())));
    // The picture is there without it; and made again, so is the data.
    assert_eq!(run(&assemble(&["--aov", "normal=n.exr"])).status.code(), Some(0));
    lab.done("octrender", &["scene.txt", "-q", "--shard", "1/3", "--aov", "depth", "--aov", "normal"]);
    assert_eq!(run(&wanted).status.code(), Some(0));
    same(&lab, &with, &["depth", "normal"], &[]);
}

#[test]
fn wrong_wishes_are_refused() {
    let lab = lab();
    let file = lab.fails(2, "octrender", &["scene.txt", "--shard", "0/2", "--aov", "depth=d.exr"]);
    assert!(file.contains("give --aov depth, and --aov depth=d.exr to --assemble"), "{file}");
    let none = lab.fails(2, "octrender", &["scene.txt", "-o", "a.png", "--aov", "depth"]);
    assert!(none.contains("--aov depth=FILE"), "{none}");
    assert!(!lab.path("a.png").exists());
    lab.done("octrender", &["scene.txt", "-q", "--shard", "0/1", "-o", "p.exr", "--aov", "depth"]);
    for (wish, what) in [
        ("depth=p.exr", "over a part"),
        ("depth=a.exr", "over the picture"),
        ("depth=d.jpg", ".exr (the numbers)"),
        ("depth", "--aov depth=FILE"),
        ("face=f.exr", "made without --aov face"),
    ] {
        let told = lab.fails(2, "octrender", &["--assemble", "p.exr", "-o", "a.exr", "--aov", wish]);
        assert!(told.contains(what), "{wish}: {told}");
        assert!(!lab.path("a.exr").exists(), "{wish}");
    }
}
