//! octbuild.

use super::support::*;

#[test]
fn says_what_it_built() {
    let lab = Lab::new();
    lab.write("ball.obj", ball(24, 12));
    let output = lab.run("octbuild", &["ball.obj", "-o", "ball.oct", "--stats", "stats.json"]);
    assert_eq!(output.status.code(), Some(0), "{}", told(&output));
    let triangles = ball_triangles(24, 12);
    let stats = lab.json("stats.json");
    let bytes = lab.read("ball.oct").len() as u64;
    assert_eq!(stats["schema"], 1);
    assert_eq!(stats["triangles"], triangles);
    assert_eq!(stats["vertices"], 2 + 24 * 11);
    assert_eq!(stats["bytes"], bytes);
    assert!((stats["bytes_per_triangle"].as_f64().unwrap() - bytes as f64 / triangles as f64).abs() < 1e-9);
    for reason in ["degenerate", "non_finite", "bad_index", "too_few_corners"] {
        assert_eq!(stats["dropped"][reason], 0, "{reason}");
    }
    for number in ["seconds", "cpu_seconds", "peak_rss_bytes"] {
        assert!(stats[number].as_f64().unwrap() > 0.0, "{number}");
    }
    assert!(!stats["phases"].as_array().unwrap().is_empty());
    assert!(output.stdout.is_empty());
    assert!(told(&output).starts_with("ball.oct: 528 triangles, "), "{}", told(&output));
    assert_eq!(lab.files(), ["ball.obj", "ball.oct", "stats.json"]);
}

#[test]
fn statistics_go_to_standard_output_and_quiet_is_quiet() {
    let lab = Lab::new();
    lab.write("a.obj", SQUARE);
    let output = lab.run("octbuild", &["a.obj", "-o", "a.oct", "-q", "--stats", "-"]);
    assert_eq!(told(&output), "");
    let stats: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(stats["triangles"], 2);
}

#[test]
fn reads_standard_input() {
    let lab = Lab::with_ball();
    let output = lab.run_with("octbuild", &["-", "-o", "piped.oct"], ball(24, 12).as_bytes());
    assert_eq!(output.status.code(), Some(0), "{}", told(&output));
    assert_eq!(lab.read("piped.oct"), lab.read("ball.oct"));
}

#[test]
fn threads_do_not_change_a_byte() {
    let lab = Lab::new();
    lab.write("ball.obj", ball(64, 48));
    for split in ["sah", "octree", "strict"] {
        for threads in ["1", "3"] {
            let out = format!("{split}{threads}.oct");
            lab.done("octbuild", &["ball.obj", "-o", &out, "--split", split, "--threads", threads, "--brick", "500"]);
        }
        assert!(lab.read(&format!("{split}1.oct")) == lab.read(&format!("{split}3.oct")), "{split}");
    }
}

#[test]
fn counts_what_it_drops() {
    let lab = Lab::new();
    lab.write("a.obj", format!("{SQUARE}v nan 0 0\nf 1 2 2\nf 1 2\nf 1 2 5\nf 1 2 3 4\n"));
    let output = lab.run("octbuild", &["a.obj", "-o", "a.oct", "--stats", "s.json"]);
    assert_eq!(output.status.code(), Some(0), "{}", told(&output));
    let stats = lab.json("s.json");
    assert_eq!(stats["triangles"], 4);
    assert_eq!(stats["dropped"]["degenerate"], 1);
    assert_eq!(stats["dropped"]["non_finite"], 1);
    assert_eq!(stats["dropped"]["too_few_corners"], 1);
    assert!(told(&output).contains("dropped 1 triangles of zero area, 1 triangles that are not finite"));
}

#[test]
fn positions_on_a_grid_share_their_vertices() {
    let lab = Lab::new();
    lab.write("ball.obj", ball(64, 48));
    let output = lab.run("octbuild", &["ball.obj", "-o", "a.oct", "--positions", "grid:0.01", "--stats", "s.json"]);
    assert!(told(&output).contains("moved vertices by up to"), "{}", told(&output));
    let shift = lab.json("s.json")["largest_shift"].as_f64().unwrap();
    assert!(shift > 0.004 && shift <= 0.005 + 1e-6, "{shift}");
    lab.done("octinfo", &["a.oct", "--extract", "all", "-o", "back.obj"]);
    for line in lab.text("back.obj").lines().filter(|line| line.starts_with("v ")) {
        for number in line[2..].split(' ').map(|word| word.parse::<f64>().unwrap()) {
            assert!((number * 100.0 - (number * 100.0).round()).abs() < 1e-4, "{line}");
        }
    }
    lab.done("octbuild", &["ball.obj", "-o", "b.oct", "--positions", "grid", "--stats", "s.json"]);
    let shift = lab.json("s.json")["largest_shift"].as_f64().unwrap();
    assert!(shift > 0.0 && shift < 1e-5, "{shift}");
    lab.done("octinfo", &["b.oct", "--verify"]);
    let info = |file: &str| {
        lab.write("info.json", lab.done("octinfo", &[file, "--json"]));
        lab.json("info.json")
    };
    let grid = info("b.oct");
    let (steps, leaves) = (grid["step_leaves"].as_u64().unwrap(), grid["leaves"].as_u64().unwrap());
    assert!(4 * steps > 3 * leaves, "{steps} of {leaves}");
    assert_eq!(grid["options"]["grid"], true);
    lab.done("octbuild", &["ball.obj", "-o", "c.oct"]);
    let vertices = |info: serde_json::Value| info["by_part"]["leaf_vertices"].as_f64().unwrap();
    assert!(vertices(grid) < 0.75 * vertices(info("c.oct")));
}

#[test]
fn packed_files_hold_the_same() {
    let lab = Lab::with_ball();
    lab.write("large.obj", ball(120, 90));
    for (mesh, extra) in [("ball.obj", "262144"), ("large.obj", "500")] {
        lab.done("octbuild", &[mesh, "-o", "plain.oct", "--brick", extra]);
        lab.done("octbuild", &[mesh, "-o", "packed.oct", "--brick", extra, "--compress", "zstd:9"]);
        assert!(lab.read("packed.oct").len() < lab.read("plain.oct").len() * 9 / 10);
        lab.done("octinfo", &["packed.oct", "--verify"]);
        for name in ["plain", "packed"] {
            lab.done("octinfo", &[&format!("{name}.oct"), "--extract", "all", "-o", &format!("{name}.obj")]);
        }
        assert!(lab.read("plain.obj") == lab.read("packed.obj"));
    }
    let rays: Vec<u8> = [0.1f32, 0.2, 9.0, 0.01, 0.0, -1.0, 0.0, 100.0].iter().flat_map(|x| x.to_le_bytes()).collect();
    let hits = |file: &str| lab.run_with("octtrace", &[file], &rays).stdout;
    assert!(hits("packed.oct") == hits("plain.oct") && hits("packed.oct").len() == 16);
    let mut bytes = lab.read("packed.oct");
    bytes[5000] ^= 1;
    lab.write("packed.oct", bytes);
    assert!(lab.fails(3, "octinfo", &["packed.oct", "--verify"]).contains("checksum"));
}

#[test]
fn ply_and_stl_are_read_as_the_same_mesh() {
    let lab = Lab::new();
    lab.write("a.obj", "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3\nf 1 3 4\n");
    let head = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
                element face 2\nproperty list uchar int vertex_indices\nend_header\n";
    lab.write("a.ply", format!("{head}0 0 0\n1 0 0\n1 1 0\n0 1 0\n3 0 1 2\n3 0 2 3\n"));
    let facet = |c: [&str; 3]| {
        format!("facet normal 0 0 1\nouter loop\n{}\nendloop\nendfacet\n", c.map(|c| format!("vertex {c}")).join("\n"))
    };
    let facets = facet(["0 0 0", "1 0 0", "1 1 0"]) + &facet(["0 0 0", "1 1 0", "0 1 0"]);
    lab.write("a.stl", format!("solid square\n{facets}endsolid square\n"));
    let extracted = ["a.obj", "a.ply", "a.stl"].map(|mesh| {
        lab.done("octbuild", &[mesh, "-o", "a.oct"]);
        lab.done("octinfo", &["a.oct", "--extract", "all", "-o", "back.obj"]);
        lab.read("back.obj")
    });
    assert!(extracted[0] == extracted[1] && extracted[0] == extracted[2]);
    lab.write("b.ply", format!("{head}0 0 0\n1 0 0\n1 1"));
    let error = lab.fails(2, "octbuild", &["b.ply", "-o", "b.oct"]);
    assert!(error.contains("b.ply") && error.contains("cut short"), "{error}");
}

#[test]
fn lenient_goes_on_where_strict_stops() {
    let lab = Lab::new();
    lab.write("a.obj", format!("{SQUARE}f 1 2 99\n"));
    let error = lab.fails(2, "octbuild", &["a.obj", "-o", "a.oct"]);
    assert!(error.contains("a.obj:7:7") && error.contains("99"), "{error}");
    assert_eq!(lab.files(), ["a.obj"]);
    lab.done("octbuild", &["a.obj", "-o", "a.oct", "--lenient", "--stats", "s.json"]);
    assert_eq!(lab.json("s.json")["dropped"]["bad_index"], 1);
}

#[test]
fn malformed_numbers_are_shown_with_a_caret() {
    let lab = Lab::new();
    lab.write("a.obj", "v 0 0 0\nv 1 zero 0\n");
    assert_told!("octbuild_malformed_number", lab.fails(2, "octbuild", &["a.obj", "-o", "a.oct"]));
}

#[test]
fn wrong_inputs_are_input_errors() {
    let lab = Lab::new();
    lab.write("empty.obj", "");
    lab.write("points.obj", "v 0 0 0\n");
    std::fs::create_dir(lab.path("folder.obj")).unwrap();
    for input in ["missing.obj", "folder.obj", "empty.obj", "points.obj"] {
        let error = lab.fails(2, "octbuild", &[input, "-o", "a.oct"]);
        assert!(error.contains(input), "{error}");
    }
    assert!(!lab.path("a.oct").exists());
}

#[test]
fn wrong_usage_is_refused() {
    let lab = Lab::new();
    lab.write("a.obj", SQUARE);
    for args in [
        &["a.obj"][..],
        &["-o", "a.oct"],
        &["a.obj", "-o", "a.oct", "--leaf", "17"],
        &["a.obj", "-o", "a.oct", "--leaf", "0"],
        &["a.obj", "-o", "a.oct", "--depth", "22", "--split", "strict"],
        &["a.obj", "-o", "a.oct", "--cell", "4"],
        &["a.obj", "-o", "a.oct", "--brick", "0"],
        &["a.obj", "-o", "a.oct", "--split", "bvh"],
        &["a.obj", "-o", "a.oct", "--origin", "1,2"],
        &["a.obj", "-o", "a.oct", "--threads", "0"],
        &["a.obj", "-o", "-"],
        &["a.obj", "-o", "a.obj"],
        &["a.obj", "-o", "a.oct", "--memory", "63M"],
        &["-", "-o", "a.oct", "--resume"],
        &["a.obj", "-o", "a.oct", "--compress", "gzip"],
        &["a.obj", "-o", "a.oct", "--compress", "zstd:23"],
        &["a.obj", "-o", "a.oct", "--positions", "grid:0"],
    ] {
        lab.fails(2, "octbuild", args);
    }
    assert_eq!(lab.files(), ["a.obj"]);
}

#[test]
fn places_that_cannot_be_written_are_the_machines_failure() {
    let lab = Lab::new();
    lab.write("a.obj", SQUARE);
    std::fs::create_dir(lab.path("folder")).unwrap();
    for (place, named) in [("a.obj/a.oct", "a.obj"), ("no/such/a.oct", "no/such"), ("folder", "folder")] {
        let error = lab.fails(4, "octbuild", &["a.obj", "-o", place]);
        assert!(error.contains(&format!("error: {named}")), "{error}");
    }
    lab.fails(4, "octbuild", &["a.obj", "-o", "a.oct", "--stats", "a.obj/s.json"]);
    if cfg!(target_os = "linux") {
        lab.fails(4, "octbuild", &["a.obj", "-o", "/dev/full"]);
        lab.fails(4, "octbuild", &["a.obj", "-o", "b.oct", "--stats", "/dev/full"]);
    }
    assert_eq!(std::fs::read_dir(lab.path("folder")).unwrap().count(), 0);
}

#[test]
fn help_and_version() {
    let lab = Lab::new();
    for tool in ["octbuild", "octinfo", "octrender", "octtrace"] {
        let help = String::from_utf8(lab.done(tool, &["--help"])).unwrap();
        assert!(help.contains("Examples:") && help.contains("--quiet"), "{help}");
        let version = String::from_utf8(lab.done(tool, &["--version"])).unwrap();
        let begin = format!("{tool} {} (octree format 1; instruction sets: ", env!("CARGO_PKG_VERSION"));
        let sets = version
            .strip_prefix(&begin)
            .and_then(|rest| rest.strip_suffix(")\n"))
            .unwrap_or_else(|| panic!("{version}"));
        let (all, best) = sets.split_once(", in use: ").unwrap();
        assert!(all.starts_with("scalar") && all.split(' ').any(|set| set == best), "{version}");
    }
}

#[test]
fn a_missing_folder_is_named_before_any_work() {
    let lab = Lab::with_ball();
    for (tool, args) in [
        ("octbuild", &["ball.obj", "-o", "no/a.oct"][..]),
        ("octrender", &["ball.oct", "-o", "no/a.png", "--size", "60000x60000"]),
        ("octinfo", &["ball.oct", "--extract", "all", "-o", "no/a.obj"]),
        ("octbuild", &["ball.obj", "-o", "a.oct", "--stats", "no/a.json"]),
    ] {
        let error = lab.fails(4, tool, args);
        assert!(error.contains("cannot create: there is no folder no; make it first"), "{error}");
    }
    // Not after hours of building.
    assert!(!lab.path("a.oct").exists());
}

#[test]
fn what_no_mesh_can_be_is_told_by_what_it_is() {
    let lab = Lab::with_ball();
    std::fs::create_dir(lab.path("meshes")).unwrap();
    for (input, told) in [("meshes", "meshes: this is a folder; "), ("ball.oct", "ball.oct: this is an octree file")] {
        let error = lab.fails(2, "octbuild", &[input, "-o", "a.oct"]);
        assert!(error.contains(told), "{error}");
    }
    let error = lab.fails(4, "octbuild", &["ball.obj", "-o", "meshes"]);
    assert!(error.contains("meshes: cannot create: this is a folder; name a file in it"), "{error}");
}

#[test]
fn a_grid_on_which_nothing_is_left_is_told() {
    let lab = Lab::with_ball();
    let error = lab.fails(2, "octbuild", &["ball.obj", "-o", "a.oct", "--positions", "grid:8"]);
    assert!(error.contains("of zero area") && error.contains("the step of the grid may be too large"), "{error}");
}

#[cfg(target_os = "linux")]
#[test]
fn threads_that_cannot_be_had_are_told() {
    let lab = Lab::with_ball();
    let script = format!("ulimit -v 400000; exec {} ball.oct", tool_path("octinfo").display());
    let mut command = std::process::Command::new("sh");
    let output =
        command.args(["-c", &script]).env("RAYON_NUM_THREADS", "1000").current_dir(lab.path("")).output().unwrap();
    let error = told(&output);
    assert_eq!(output.status.code(), Some(2), "{error}");
    assert!(error.contains("cannot start a thread for each processor") && error.contains("--threads"), "{error}");
}

#[test]
fn threads_are_counted_from_1_to_1024() {
    let lab = Lab::with_ball();
    for threads in ["0", "1025", "100000", "-1", "x"] {
        let error = lab.fails(2, "octbuild", &["ball.obj", "-o", "a.oct", &format!("--threads={threads}")]);
        assert!(!error.contains("non-zero type"), "{error}");
    }
}

#[test]
fn what_is_built_and_what_is_dropped_is_what_the_faces_make() {
    let mut obj = String::from("v nan 0 0\n");
    (0..60).for_each(|i| obj += &format!("v {} {} {}\n", i % 7, i / 7, i * i % 5));
    let mut fans = 0;
    for i in 0..400u64 {
        // Corners, 2 to 8 of them; some repeated (no area), some the vertex that is not finite, some out of range.
        let corners = 2 + i % 5;
        let corner = |c: u64| match (i + c) % 41 {
            _ if i % 9 == 0 => 5,
            40 => 999,
            39 => 1,
            k => 2 + (k + i * c * c) % 60,
        };
        let face: Vec<String> = (0..corners + i % 3).map(|c| corner(c).to_string()).collect();
        fans += (face.len() as u64).saturating_sub(2);
        obj += &format!("f {}\n", face.join(" "));
    }
    let lab = Lab::new();
    lab.write("a.obj", obj);
    for split in ["sah", "octree", "strict"] {
        lab.done("octbuild", &["a.obj", "-o", "a.oct", "--lenient", "--split", split, "--stats", "s.json", "-q"]);
        let stats = lab.json("s.json");
        let dropped = |reason: &str| stats["dropped"][reason].as_u64().unwrap();
        let counts = ["degenerate", "non_finite", "bad_index"].map(dropped);
        assert!(counts.iter().all(|&n| n > 0) && dropped("too_few_corners") > 0, "{stats}");
        assert_eq!(stats["triangles"].as_u64().unwrap() + counts.iter().sum::<u64>(), fans, "{stats}");
        assert_eq!(stats["source_triangles"], fans);
    }
}
