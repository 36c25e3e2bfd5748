//! octrender.

use std::process::Stdio;
use std::time::Duration;

use super::support::*;

/// A ball on a floor, seen by itself.
const SCENE: &str = "\
resolution 64 48
lookat 0 1 4  0 0 0  0 1 0
background 0.2 0.3 0.4
light 3 5 4 1
oct ball.oct
plane 0 -1 0  0 1 0
";

fn image(lab: &Lab, name: &str) -> image::RgbImage {
    image::load_from_memory(&lab.read(name)).unwrap_or_else(|e| panic!("{name}: {e}")).to_rgb8()
}

#[test]
fn draws_a_scene() {
    let lab = Lab::with_ball();
    lab.write("scene.txt", SCENE);
    let output = lab.run("octrender", &["scene.txt", "--stats", "stats.json"]);
    assert_eq!(output.status.code(), Some(0), "{}", told(&output));
    assert!(output.stdout.is_empty());
    assert!(told(&output).starts_with("scene.png: 64 x 48 pixels, "), "{}", told(&output));
    let picture = image(&lab, "scene.png");
    assert_eq!(picture.dimensions(), (64, 48));
    // The sky in the corner, the ball in the middle.
    assert_eq!(picture.get_pixel(0, 0).0, [51, 77, 102]);
    assert_ne!(picture.get_pixel(32, 24).0, [51, 77, 102]);

    let stats = lab.json("stats.json");
    assert_eq!((&stats["schema"], &stats["width"], &stats["height"]), (&1.into(), &64.into(), &48.into()));
    assert_eq!(stats["rays"]["primary"], 64 * 48);
    assert!(stats["rays"]["shadow"].as_u64().unwrap() > 0);
    assert_eq!((&stats["rays"]["mirror"], &stats["rays"]["refracted"]), (&0.into(), &0.into()));
    assert_eq!((&stats["pages"]["total"], &stats["pages"]["touched"]), (&1.into(), &1.into()));
    for number in ["seconds", "trace_seconds", "peak_rss_bytes"] {
        assert!(stats[number].as_f64().unwrap() > 0.0, "{number}");
    }
}

#[test]
fn flags_win_over_the_scene() {
    let lab = Lab::with_ball();
    lab.write("scene.txt", format!("{SCENE}output said.png\n"));
    lab.done("octrender", &["scene.txt", "-q"]);
    lab.done("octrender", &["scene.txt", "-o", "flag.png", "--size", "32x16", "--samples", "4", "--depth", "1"]);
    assert_eq!(image(&lab, "said.png").dimensions(), (64, 48));
    assert_eq!(image(&lab, "flag.png").dimensions(), (32, 16));
}

#[test]
fn threads_and_crops_do_not_change_a_pixel() {
    let lab = Lab::with_ball();
    lab.write("scene.txt", SCENE);
    lab.done("octrender", &["scene.txt", "-o", "a.png", "--threads", "1"]);
    lab.done("octrender", &["scene.txt", "-o", "b.png", "--threads", "3"]);
    assert!(lab.read("a.png") == lab.read("b.png"));
    lab.done("octrender", &["scene.txt", "-o", "part.png", "--crop", "10,20,40,45"]);
    let part = image::imageops::crop_imm(&image(&lab, "a.png"), 10, 20, 30, 25).to_image();
    assert_eq!(image(&lab, "part.png"), part);
}

#[cfg(unix)]
#[test]
fn a_picture_beyond_the_limit_on_file_sizes_is_an_error() {
    let lab = Lab::with_ball();
    let line = "ulimit -f 1; exec \"$0\" ball.oct -q --size 200x200 -o a.tif";
    let mut command = std::process::Command::new("sh");
    command.args(["-c", line]).arg(tool_path("octrender")).current_dir(lab.path(""));
    let output = command.output().unwrap();
    assert_eq!(output.status.code(), Some(4), "{output:?}");
    assert!(told(&output).contains("a.tif: cannot write: File too large"), "{}", told(&output));
    assert_eq!(lab.files(), ["ball.obj", "ball.oct"]);
}

#[test]
fn a_packed_file_that_is_to_be_mapped_is_named() {
    let lab = Lab::with_ball();
    lab.done("octbuild", &["ball.obj", "-o", "packed.oct", "--compress", "zstd", "-q"]);
    let error = lab.fails(2, "octrender", &["packed.oct", "--read", "mapped"]);
    assert!(error.contains("packed.oct: its pages are packed") && error.contains("leave out --read mapped"), "{error}");
}

#[test]
fn meshes_of_all_formats_are_drawn() {
    let lab = Lab::new();
    let stl = "solid\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid\n";
    lab.write("corner.stl", stl);
    lab.write("corner.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
    for name in ["corner.stl", "corner.obj"] {
        lab.done("octrender", &[name, "-q", "--size", "16x16"]);
        std::fs::rename(lab.path("corner.png"), lab.path(&format!("{name}.png"))).unwrap();
    }
    assert!(lab.read("corner.stl.png") == lab.read("corner.obj.png"));
}

#[test]
fn draws_a_mesh_by_itself() {
    let lab = Lab::with_ball();
    lab.done("octrender", &["ball.oct", "-o", "oct.png", "--size", "40x30"]);
    assert_eq!(lab.files(), ["ball.obj", "ball.oct", "oct.png"]);
    lab.done("octrender", &["ball.obj", "-o", "obj.png", "--size", "40x30"]);
    assert!(lab.path("ball.obj.cache.oct").exists(), "{:?}", lab.files());
    assert!(lab.read("oct.png") == lab.read("obj.png"));
    let built = std::fs::metadata(lab.path("ball.obj.cache.oct")).unwrap().modified().unwrap();
    lab.done("octrender", &["ball.obj", "-o", "again.png", "--size", "40x30"]);
    assert_eq!(std::fs::metadata(lab.path("ball.obj.cache.oct")).unwrap().modified().unwrap(), built);
    let colours: std::collections::BTreeSet<[u8; 3]> = image(&lab, "oct.png").pixels().map(|p| p.0).collect();
    assert!(colours.len() > 50, "a picture of {} colours", colours.len());
}

#[test]
fn writes_png_to_standard_output() {
    let lab = Lab::with_ball();
    lab.done("octrender", &["ball.oct", "-o", "a.png", "--size", "20x20"]);
    let piped = lab.done("octrender", &["ball.oct", "-o", "-", "--size", "20x20"]);
    assert!(piped == lab.read("a.png"));
    lab.fails(2, "octrender", &["ball.oct", "-o", "-", "--stats", "-"]);
}

#[test]
fn reads_a_scene_from_standard_input() {
    let lab = Lab::with_ball();
    let output = lab.run_with("octrender", &["-", "-o", "a.png"], SCENE.as_bytes());
    assert_eq!(output.status.code(), Some(0), "{}", told(&output));
    assert_eq!(image(&lab, "a.png").dimensions(), (64, 48));
    assert_eq!(lab.run_with("octrender", &["-"], SCENE.as_bytes()).status.code(), Some(2));
}

#[test]
fn suffixes_choose_the_format() {
    let lab = Lab::with_ball();
    for name in ["a.exr", "a.hdr", "a.jpg"] {
        lab.done("octrender", &["ball.oct", "-o", name, "--size", "20x20"]);
        assert_eq!(image(&lab, name).dimensions(), (20, 20));
    }
    let error = lab.fails(2, "octrender", &["ball.oct", "-o", "a.xyz"]);
    assert!(error.contains("a.xyz") && error.contains("exr"), "{error}");
}

#[test]
fn errors_of_a_scene_are_shown_in_one_go() {
    let lab = Lab::new();
    lab.write("scene.txt", "resolution 64 48\nrectangel 0 0 0 1 0 0 1 1 0\nsphere 0 0 zero 1\noct missing.oct\n");
    assert_told!("octrender_scene_errors", lab.fails(2, "octrender", &["scene.txt"]));
    assert_eq!(lab.files(), ["scene.txt"]);
}

#[test]
fn lenient_draws_what_it_understands() {
    let lab = Lab::with_ball();
    lab.write("scene.txt", format!("rectangel 1 2 3\n{SCENE}"));
    lab.fails(2, "octrender", &["scene.txt"]);
    let output = lab.run("octrender", &["scene.txt", "--lenient"]);
    assert_eq!(output.status.code(), Some(0), "{}", told(&output));
    assert!(told(&output).contains("warning: "), "{}", told(&output));
}

#[test]
fn wrong_usage_and_inputs_are_refused() {
    let lab = Lab::with_ball();
    std::fs::create_dir(lab.path("folder")).unwrap();
    for args in [
        &[][..],
        &["missing.txt"],
        &["missing.oct"],
        &["missing.obj"],
        &["folder"],
        &["ball.oct", "--size", "64"],
        &["ball.oct", "--samples", "3"],
        &["ball.oct", "--lod", "-1"],
        &["ball.oct", "--lod", "nan"],
        &["ball.oct", "--crop", "5,5,5,9"],
        &["ball.oct", "--crop", "0,0,9000,9"],
        &["ball.oct", "--memory", "1K"],
        &["ball.oct", "--read", "twice"],
        &["ball.oct", "--aov", "heat=d.exr"],
        &["ball.oct", "--aov", "depth=d.jpg"],
        &["ball.oct", "--aov", "depth=./ball.png", "-o", "ball.png"],
    ] {
        lab.fails(2, "octrender", args);
    }
    assert_eq!(lab.files(), ["ball.obj", "ball.oct", "folder"]);
}

#[test]
fn pictures_of_data_are_written_beside_the_picture() {
    let lab = Lab::with_ball();
    lab.done("octrender", &["ball.oct", "--size", "8x8", "-q", "--aov", "depth=d.exr", "--aov", "cost=c.png"]);
    assert_eq!(lab.files(), ["ball.obj", "ball.oct", "ball.png", "c.png", "d.exr"]);
    assert_eq!(lab.read("d.exr")[..4], [0x76, 0x2f, 0x31, 0x01]);
}

#[test]
fn level_of_detail_is_told_and_checked() {
    let lab = Lab::with_ball();
    lab.done("octbuild", &["ball.obj", "-o", "plain.oct", "--no-lod"]);
    assert!(lab.read("plain.oct").len() < lab.read("ball.oct").len());
    lab.fails(2, "octrender", &["plain.oct", "--lod", "1", "-o", "a.png"]);
    let draw = |input: &str, lod: &str, name: &str| {
        lab.done("octrender", &[input, "--size", "24x24", "--lod", lod, "-o", name, "--stats", "s.json"]);
        (lab.read(name), serde_json::from_slice::<serde_json::Value>(&lab.read("s.json")).unwrap())
    };
    let (exact, stats) = draw("plain.oct", "0", "a.png");
    assert!(stats.get("lod").is_none());
    assert!(draw("ball.oct", "0", "b.png").0 == exact);
    let (_, stats) = draw("ball.oct", "20", "c.png");
    let lod = &stats["lod"];
    assert!(lod["pixels"] == 20.0 && lod["hits"].as_u64().unwrap() > 0, "{lod}");
    assert!(lod["largest_error_pixels"].as_f64().unwrap() <= 20.0);
    let counts: u64 = lod["histogram"].as_array().unwrap().iter().map(|n| n.as_u64().unwrap()).sum();
    assert_eq!(counts, lod["hits"].as_u64().unwrap());
    // What is for level of detail is damaged: the exact picture comes all the same.
    let mut bytes = lab.read("ball.oct");
    let end = bytes.len() - 80;
    bytes[end] ^= 1;
    lab.write("bad.oct", &bytes);
    assert!(draw("bad.oct", "0", "d.png").0 == exact);
    lab.fails(3, "octrender", &["bad.oct", "--lod", "1", "-o", "e.png"]);
    lab.fails(3, "octinfo", &["bad.oct", "--verify"]);
}

#[test]
fn a_damaged_file_gives_no_picture() {
    let lab = Lab::with_ball();
    let mut bytes = lab.read("ball.oct");
    bytes[4096 + 64 + 10] ^= 1;
    lab.write("bad.oct", &bytes);
    lab.fails(3, "octrender", &["bad.oct", "-o", "a.png"]);
    assert!(!lab.path("a.png").exists());
}

#[test]
fn places_that_cannot_be_written_are_the_machines_failure() {
    let lab = Lab::with_ball();
    std::fs::create_dir(lab.path("folder")).unwrap();
    for place in ["ball.obj/a.png", "no/such/a.png", "folder"] {
        lab.fails(4, "octrender", &["ball.oct", "--size", "8x8", "-o", place]);
    }
    if cfg!(target_os = "linux") {
        lab.fails(4, "octrender", &["ball.oct", "--size", "8x8", "-o", "/dev/full"]);
    }
}

#[cfg(unix)]
#[test]
fn interrupted_it_leaves_a_partial_picture() {
    let lab = Lab::with_ball();
    let args = ["ball.oct", "-o", "a.png", "--size", "3000x3000", "--samples", "10000"];
    let mut child = lab.command("octrender", &args).stderr(Stdio::piped()).spawn().unwrap();
    std::thread::sleep(Duration::from_millis(1500));
    signal(&child, "INT");
    assert_eq!(wait(&mut child), Some(130));
    assert_eq!(lab.files(), ["a.partial.png", "ball.obj", "ball.oct"]);
    assert_eq!(image(&lab, "a.partial.png").dimensions(), (3000, 3000));
}
