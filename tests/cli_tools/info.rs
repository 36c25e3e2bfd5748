//! octinfo.

use std::collections::BTreeMap;
use std::process::Stdio;

use super::support::*;

#[test]
fn tells_what_is_in_a_file() {
    let lab = Lab::with_ball();
    let table = String::from_utf8(lab.done("octinfo", &["ball.oct"])).unwrap();
    assert!(table.contains("triangles       528\n") && table.contains("--split sah"), "{table}");
    assert!(!table.contains("verified"), "{table}");

    let json: serde_json::Value = serde_json::from_slice(&lab.done("octinfo", &["ball.oct", "--json"])).unwrap();
    assert_eq!(json["schema"], 1);
    assert_eq!(json["version"], 1);
    assert_eq!(json["triangles"], 528);
    assert_eq!(json["vertices"], 266);
    assert_eq!(json["pages"], 1);
    assert_eq!(json["bounds"]["max"][1], 1.0);
    let bytes = lab.read("ball.oct").len() as u64;
    assert_eq!(json["bytes"], bytes);
    let parts: BTreeMap<String, u64> = serde_json::from_value(json["by_part"].clone()).unwrap();
    assert_eq!(parts.values().sum::<u64>(), bytes, "{parts:?}");
    assert_eq!(parts["ids"], 528 * 4);
    for count in ["nodes", "leaves", "depth"] {
        assert!(json[count].as_u64().unwrap() > 0, "{count}");
    }
}

#[test]
fn verifies() {
    let lab = Lab::with_ball();
    let table = String::from_utf8(lab.done("octinfo", &["ball.oct", "--verify"])).unwrap();
    assert!(table.contains("verified"), "{table}");
    let json: serde_json::Value =
        serde_json::from_slice(&lab.done("octinfo", &["ball.oct", "--verify", "--json"])).unwrap();
    assert_eq!(json["verified"], true);
}

#[test]
fn damage_is_found_wherever_it_is() {
    let lab = Lab::with_ball();
    let whole = lab.read("ball.oct");
    let places = (8..whole.len()).step_by(whole.len() / 40).chain([8, 100, 4095, 4096, whole.len() - 1]);
    for place in places {
        let mut bytes = whole.clone();
        bytes[place] ^= 0x20;
        lab.write("bad.oct", &bytes);
        let output = lab.run("octinfo", &["bad.oct", "--verify"]);
        let error = told(&output);
        // A changed version number may as well mean a file of the future.
        let codes: &[i32] = if (8..12).contains(&place) { &[2, 3] } else { &[3] };
        // Between pages and sections may lie bytes that mean nothing, but they must be zero.
        assert!(codes.contains(&output.status.code().unwrap()), "byte {place}: {:?} {error}", output.status);
        assert!(error.contains("bad.oct") && !error.contains("panicked"), "byte {place}: {error}");
    }
    for length in [1, 100, 4095, 4096, 5000, whole.len() - 1] {
        lab.write("bad.oct", &whole[..length]);
        let output = lab.run("octinfo", &["bad.oct"]);
        let code = output.status.code().unwrap();
        assert!(code == 3 || (code == 2 && length < 4096), "length {length}: {code} {}", told(&output));
    }
}

#[test]
fn wrong_inputs_are_input_errors() {
    let lab = Lab::new();
    lab.write("a.obj", SQUARE);
    lab.write("empty.oct", "");
    std::fs::create_dir(lab.path("folder.oct")).unwrap();
    for input in ["missing.oct", "a.obj", "empty.oct", "folder.oct"] {
        let error = lab.fails(2, "octinfo", &[input]);
        assert!(error.contains(input), "{error}");
    }
    assert_told!("octinfo_missing_file", lab.fails(2, "octinfo", &["missing.oct"]));
}

#[test]
fn wrong_usage_is_refused() {
    let lab = Lab::with_ball();
    for args in [
        &[][..],
        &["ball.oct", "--extract", "all"],
        &["ball.oct", "-o", "part.obj"],
        &["ball.oct", "--extract", "everything", "-o", "part.obj"],
        &["ball.oct", "--extract", "1,1,1,0,0,0", "-o", "part.obj"],
        &["ball.oct", "--extract", "all", "-o", "-", "--json"],
    ] {
        lab.fails(2, "octinfo", args);
    }
    lab.fails(4, "octinfo", &["ball.oct", "--extract", "all", "-o", "ball.obj/part.obj"]);
    assert_eq!(lab.files(), ["ball.obj", "ball.oct"]);
}

/// The triangles of an OBJ text, each by the bits of its corners, polygons cut as fans.
fn triangles(obj: &str) -> Vec<[[u32; 3]; 3]> {
    let mut vertices = Vec::new();
    let mut triangles = Vec::new();
    for line in obj.lines() {
        let words: Vec<&str> = line.split_whitespace().collect();
        match words.first() {
            Some(&"v") => {
                let xyz: Vec<f32> = words[1..4].iter().map(|w| w.parse().unwrap()).collect();
                vertices.push([xyz[0].to_bits(), xyz[1].to_bits(), xyz[2].to_bits()]);
            }
            Some(&"f") => {
                let corner = |w: &&str| vertices[w.split('/').next().unwrap().parse::<usize>().unwrap() - 1];
                let corners: Vec<_> = words[1..].iter().map(corner).collect();
                triangles.extend((1..corners.len() - 1).map(|i| [corners[0], corners[i], corners[i + 1]]));
            }
            _ => {}
        }
    }
    triangles
}

#[test]
fn a_mesh_comes_back_as_it_went_in() {
    let lab = Lab::new();
    lab.write("ball.obj", ball(40, 30));
    for flags in [&[][..], &["--split", "strict", "--cell", "2"], &["--brick", "100", "--leaf", "3"]] {
        lab.done("octbuild", &[&["ball.obj", "-o", "ball.oct"], flags].concat());
        lab.done("octinfo", &["ball.oct", "--extract", "all", "-o", "back.obj"]);
        assert!(triangles(&lab.text("back.obj")) == triangles(&lab.text("ball.obj")), "{flags:?}");
        let vertices = lab.text("back.obj").lines().filter(|l| l.starts_with("v ")).count();
        assert_eq!(vertices, 2 + 40 * 29, "every vertex once");
        assert!(!lab.path("back.mtl").exists());
    }
    let once = lab.text("back.obj");
    lab.done("octbuild", &["back.obj", "-o", "back.oct"]);
    let twice = lab.done("octinfo", &["back.oct", "--extract", "all", "-o", "-"]);
    assert!(String::from_utf8(twice).unwrap() == once);
}

#[test]
fn odd_floats_come_back_bit_for_bit() {
    let lab = Lab::new();
    lab.write("a.obj", "v 1e-45 -0 3.4e38\nv 0.1 16777217 -1e-38\nv 1e20 2.5 0.30000001\nf 1 2 3\n");
    lab.done("octbuild", &["a.obj", "-o", "a.oct"]);
    lab.done("octinfo", &["a.oct", "--extract", "all", "-o", "b.obj"]);
    assert_eq!(triangles(&lab.text("b.obj")), triangles(&lab.text("a.obj")));
}

#[test]
fn a_box_takes_what_touches_it() {
    let lab = Lab::new();
    // A row of ten squares with gaps between them: square k spans k to k + 0.5.
    let square = |k: usize| {
        let (a, b) = (k as f64, k as f64 + 0.5);
        let v = 4 * k + 1;
        format!("v {a} 0 0\nv {b} 0 0\nv {b} 1 0\nv {a} 1 0\nf {v} {} {} {}\n", v + 1, v + 2, v + 3)
    };
    lab.write("row.obj", (0..10).map(square).collect::<String>());
    lab.done("octbuild", &["row.obj", "-o", "row.oct", "--brick", "4"]);
    let all = triangles(&lab.text("row.obj"));
    for (part, squares) in [
        ("-9,-9,-9,99,99,99", 0..10),
        ("2.1,0.1,-1,4.2,0.9,1", 2..5),
        ("3.5,0,0,4,1,0", 3..5),
        ("3.6,0,0,3.9,1,0", 0..0),
        ("0,0,0.5,9,1,1", 0..0),
    ] {
        lab.done("octinfo", &["row.oct", "--extract", part, "-o", "part.obj"]);
        let found = triangles(&lab.text("part.obj"));
        let expected = &all[2 * squares.start..2 * squares.end];
        if part == "3.5,0,0,4,1,0" {
            // Only sides touch: of square 3 the triangles at x = 3.5, of square 4 those at x = 4.
            assert_eq!(found, expected);
        } else {
            assert_eq!(found, expected, "{part}");
        }
    }
}

#[test]
fn materials_normals_and_texture_coordinates_come_back() {
    let lab = Lab::new();
    let mtl = "newmtl red\nKd 1 0 0.25\nNs 12\nillum 2\nnewmtl blue\nKd 0 0 1\nmap_Kd sky.png\n";
    let obj = "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 0.5\nvn 0 0 1\nvn 0 1 0\n\
               usemtl red\nf 1/1/1 2/2/1 3/3/2\nusemtl blue\nf 1/1/1 3/3/2 4/2/1\n";
    lab.write("a.mtl", mtl);
    lab.write("a.obj", obj);
    lab.done("octbuild", &["a.obj", "-o", "a.oct"]);
    lab.done("octinfo", &["a.oct", "--extract", "all", "-o", "b.obj"]);
    let text = lab.text("b.obj");
    let lines: Vec<&str> = text.lines().filter(|l| l.starts_with(['f', 'u', 'm'])).collect();
    let expected = ["mtllib b.mtl", "usemtl red", "f 1/1/1 2/2/1 3/3/2", "usemtl blue", "f 1/1/1 3/3/2 4/2/1"];
    assert_eq!(lines, expected);
    for line in ["vt 1 0.5", "vn 0 1 0"] {
        assert_eq!(text.lines().filter(|&l| l == line).count(), 1, "{text}");
    }
    let back = lab.text("b.mtl");
    for line in ["newmtl red", "Kd 1 0 0.25", "Ns 12", "illum 2", "newmtl blue", "map_Kd sky.png"] {
        assert!(back.lines().any(|l| l == line), "{line} is missing in {back}");
    }
}

#[test]
fn a_broken_pipe_is_no_error() {
    let lab = Lab::new();
    lab.write("ball.obj", ball(100, 100));
    lab.done("octbuild", &["ball.obj", "-o", "ball.oct", "-q"]);
    let mut command = lab.command("octinfo", &["ball.oct", "--extract", "all", "-o", "-"]);
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    drop(child.stdout.take());
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", told(&output));
    assert_eq!(told(&output), "");
}

#[test]
fn the_model_is_never_overwritten() {
    let lab = Lab::with_ball();
    let model = lab.read("ball.oct");
    for output in ["ball.oct", "./ball.oct"] {
        let error = lab.fails(2, "octinfo", &["ball.oct", "--extract", "all", "-o", output]);
        assert!(error.contains("input and output are the same file"), "{error}");
    }
    // Nor by the materials, which go beside the OBJ.
    std::fs::copy(lab.path("ball.oct"), lab.path("ball.mtl")).unwrap();
    lab.fails(2, "octinfo", &["ball.mtl", "--extract", "all", "-o", "ball.obj"]);
    let error = lab.fails(2, "octinfo", &["ball.oct", "--extract", "all", "-o", "part.mtl"]);
    assert!(error.contains("name an .obj file"), "{error}");
    assert!(lab.read("ball.oct") == model && lab.read("ball.mtl") == model);
}

#[cfg(target_os = "linux")]
#[test]
fn statistics_may_go_to_dev_stdout_even_if_that_is_a_file() {
    let lab = Lab::new();
    lab.write("a.obj", SQUARE);
    lab.write("log.txt", "before\n");
    let log = std::fs::OpenOptions::new().append(true).open(lab.path("log.txt")).unwrap();
    let mut command = lab.command("octbuild", &["a.obj", "-o", "a.oct", "--stats", "/dev/stdout"]);
    assert!(command.stdout(log).status().unwrap().success());
    assert!(std::fs::symlink_metadata("/dev/stdout").unwrap().is_symlink());
    let text = lab.text("log.txt");
    assert!(text.starts_with("before\n{") && text.contains("\"triangles\": 2"), "{text}");
}

#[test]
fn a_map_is_drawn() {
    let lab = Lab::with_ball();
    assert!(lab.done("octinfo", &["ball.oct", "--map", "ball.png"]).is_empty());
    let picture = image::load_from_memory(&lab.read("ball.png")).unwrap().into_rgb8();
    assert_eq!(picture.dimensions(), (2400, 1600));
    assert!(picture.pixels().any(|p| p.0 != [255; 3]));
    // With --json the numbers come too.
    let json: serde_json::Value =
        serde_json::from_slice(&lab.done("octinfo", &["ball.oct", "--map", "ball.SVG", "--json"])).unwrap();
    assert_eq!(json["triangles"], 528);
    assert!(lab.text("ball.SVG").contains("528 triangles"));
    let error = lab.fails(2, "octinfo", &["ball.oct", "--map", "ball.gif"]);
    assert!(error.contains("ball.gif") && error.contains(".png"), "{error}");
    lab.write("model.png", lab.read("ball.oct"));
    let error = lab.fails(2, "octinfo", &["model.png", "--map", "./model.png"]);
    assert!(error.contains("write over"), "{error}");
    assert!(lab.read("model.png") == lab.read("ball.oct"));
    // A damaged page ends it, and leaves nothing behind.
    let mut bytes = lab.read("ball.oct");
    bytes[4096 + 200] ^= 1;
    lab.write("bad.oct", &bytes);
    lab.fails(3, "octinfo", &["bad.oct", "--map", "bad.png"]);
    assert!(!lab.files().iter().any(|name| name.contains("bad.png")), "{:?}", lab.files());
}
