//! `octbench speed` and `octbench tradeoff` as a user runs them: few rays, fake peers, wrong input.

use std::path::PathBuf;
use std::process::{Command, Output};

use serde_json::Value;

/// A folder with a small planet: `planet.obj` and `planet.oct`.
struct Lab(tempfile::TempDir);

impl Lab {
    fn new() -> Lab {
        let lab = Lab(tempfile::tempdir().unwrap());
        lab.done(env!("CARGO_BIN_EXE_octbench"), &["mesh", "-n", "1200", "-o", "planet.obj"]);
        lab.done(env!("CARGO_BIN_EXE_octbuild"), &["planet.obj", "-o", "planet.oct", "-q"]);
        lab
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn json(&self, name: &str) -> Value {
        serde_json::from_slice(&std::fs::read(self.path(name)).unwrap()).unwrap()
    }

    fn run(&self, tool: &str, args: &[&str]) -> Output {
        Command::new(tool).args(args).current_dir(self.0.path()).env("NO_COLOR", "1").output().unwrap()
    }

    fn done(&self, tool: &str, args: &[&str]) -> String {
        let output = self.run(tool, args);
        assert_eq!(output.status.code(), Some(0), "{args:?}: {}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8(output.stdout).unwrap()
    }

    /// octbench, which must succeed; its standard output.
    fn bench(&self, args: &[&str]) -> String {
        self.done(env!("CARGO_BIN_EXE_octbench"), args)
    }

    /// octbench, which must fail with a message; the message.
    fn fails(&self, code: i32, args: &[&str]) -> String {
        let output = self.run(env!("CARGO_BIN_EXE_octbench"), args);
        let told = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(code), "{args:?}: {told}");
        assert!(told.contains("error: ") && !told.contains("panicked"), "{args:?}: {told}");
        told
    }
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("no number: {value}"))
}

/// Answers each request with the same time, and says something else before.
const PEER: &str = r#"echo '{"stage":"build","seconds":1}'; echo '{"peer":"slowpoke"}'; while read what threads path; do test "$threads" = 1 && test -s "$path" || exit 1; echo thinking; echo '{"round":4.0,"cpu":4.0,"hits":7}'; done"#;

#[test]
fn every_set_is_measured_and_the_statistics_say_how() {
    let lab = Lab::new();
    let args = ["speed", "planet.oct", "--size", "40x30", "--chords", "500", "--rounds", "3", "--isa", "all"];
    let table = lab.bench(&[&args[..], &["--stats", "s.json"]].concat());
    let stats = lab.json("s.json");
    assert_eq!((&stats["schema"], &stats["rounds"], &stats["differing"]), (&1.into(), &3.into(), &0.into()));
    let sum: f64 = stats["by_part"].as_object().unwrap().values().map(number).sum();
    assert!((sum - number(&stats["bytes_per_triangle"])).abs() < 1e-9, "{sum}");
    let sets = stats["sets"].as_array().unwrap();
    let names: Vec<_> = sets.iter().map(|s| s["set"].as_str().unwrap()).collect();
    assert_eq!(names, ["whole.primary", "whole.shadow", "whole.mirror", "chords"]);
    assert_eq!((&sets[0]["rays"], &sets[3]["rays"]), (&1200.into(), &500.into()));
    assert_eq!(sets[1]["question"], "any");
    let hits = &sets[0]["kernels"][0]["hits"];
    assert_eq!((&sets[1]["rays"], &sets[2]["rays"]), (hits, hits), "a shadow ray and a mirror ray for each hit");
    assert!(number(hits) > 100.0 && number(hits) < 1200.0, "{hits}");
    let isas = octrace::trace::Isa::available();
    for set in sets {
        assert!(table.contains(set["set"].as_str().unwrap()), "{table}");
        let kernels = set["kernels"].as_array().unwrap();
        assert!(kernels.len() >= isas.len());
        for kernel in kernels {
            assert_eq!(kernel["seconds"].as_array().unwrap().len(), 3);
            for key in ["mrays_per_second", "nodes_per_ray", "leaves_per_ray", "triangles_per_ray", "pages_per_ray"] {
                assert!(number(&kernel[key]) > 0.0, "{key}: {kernel}");
            }
        }
    }
}

#[test]
fn a_peer_is_asked_in_turn_and_the_ratio_told() {
    let lab = Lab::new();
    let args = ["speed", "planet.oct", "--sets", "primary,shadow", "--size", "40x30", "--rounds", "5"];
    let table = lab.bench(&[&args[..], &["--peer-command", PEER, "--stats", "s.json"]].concat());
    assert!(
        table.contains("[1] = slowpoke") && table.contains(" x slowpoke (geometric mean of 2 sets; least"),
        "{table}"
    );
    let stats = lab.json("s.json");
    assert_eq!(stats["peers"][0], "slowpoke");
    let mut ratios = vec![];
    for set in stats["sets"].as_array().unwrap() {
        let (own, peer) = (&set["kernels"][0], &set["peers"][0]);
        assert_eq!((&peer["hits"], &peer["seconds"]), (&7.into(), &serde_json::json!([4.0, 4.0, 4.0, 4.0, 4.0])));
        let mut seconds: Vec<f64> = own["seconds"].as_array().unwrap().iter().map(number).collect();
        seconds.sort_by(f64::total_cmp);
        let ratio = number(&own["ratios"][0]);
        assert!((ratio / (4.0 / seconds[2]) - 1.0).abs() < 1e-9, "{ratio} {seconds:?}");
        ratios.push(ratio);
    }
    let mean = &stats["means"][0];
    assert!((number(&mean["geometric_mean"]) / (ratios[0] * ratios[1]).sqrt() - 1.0).abs() < 1e-9);
    assert_eq!(number(&mean["least"]), ratios[0].min(ratios[1]));
    let figures = lab.bench(&["figures", "s.json", "s.json"]);
    let mean = format!("({:.2})", number(&mean["geometric_mean"]));
    assert!(figures.lines().last().unwrap().contains(&mean), "{figures}");
    assert_eq!(figures.lines().filter(|l| l.starts_with("| planet, whole.")).count(), 4, "{figures}");
    let markdown = lab.bench(&[&args[..], &["--peer-command", PEER, "--markdown", "--clock", "cpu", "-q"]].concat());
    let head = markdown.lines().find(|l| l.starts_with("| rays")).unwrap();
    assert!(head.ends_with("| x slowpoke | cost |"), "{markdown}");
    assert!(markdown.contains("exactness costs"), "{markdown}");
    let cells = |line: &str| line.matches('|').count();
    assert!(markdown.lines().filter(|l| l.starts_with('|')).all(|l| cells(l) == cells(head)), "{markdown}");
}

#[test]
fn files_of_rays_are_traced_and_kept() {
    let lab = Lab::new();
    let made =
        ["speed", "planet.oct", "--size", "20x20", "--sets", "primary,shadow", "--rounds", "1", "--keep-rays", "r"];
    lab.bench(&[&made[..], &["--stats", "a.json"]].concat());
    let read =
        ["speed", "planet.oct", "--rounds", "1", "--rays", "r/whole.primary.rays", "--any-rays", "r/whole.shadow.rays"];
    lab.bench(&[&read[..], &["--stats", "b.json"]].concat());
    let (a, b) = (lab.json("a.json"), lab.json("b.json"));
    assert_eq!(b["sets"].as_array().unwrap().len(), 2);
    for (a, b) in a["sets"].as_array().unwrap().iter().zip(b["sets"].as_array().unwrap()) {
        for key in ["set", "question", "rays"] {
            assert_eq!(a[key], b[key]);
        }
        for key in ["hits", "nodes_per_ray", "triangles_per_ray"] {
            assert_eq!(a["kernels"][0][key], b["kernels"][0][key]);
        }
    }
}

#[test]
fn wrong_usage_and_input_are_refused() {
    let lab = Lab::new();
    std::fs::write(lab.path("cut.rays"), [0; 100]).unwrap();
    std::fs::write(lab.path("none.rays"), []).unwrap();
    let small = ["speed", "planet.oct", "--sets", "chords", "--chords", "10", "--rounds", "1"];
    for (extra, told) in [
        (&["--rays", "cut.rays"][..], "100 bytes are no whole number of records of 32"),
        (&["--rays", "none.rays"], "no rays in it"),
        (&["--rays", "missing.rays"], "missing.rays"),
        (&["--isa", "mmx"], "this processor has auto, all, scalar"),
        (&["--view", "moon"], "planet-close"),
        (&["--kernels", "magic"], "the kernels are single"),
        (&["--clock", "cpu", "--threads", "2"], "one thread"),
        (&["--peer-command", "true"], "the peer `true` failed: it ended without the reply"),
        (&["--peer-command", r#"echo '{"peer":"p"}'; read line; echo nonsense"#], "it ended without the reply"),
        (&["--peer-command", r#"echo '{"peer":"p"}'; read line; echo '{"round":0.0,"hits":1}'"#], "no time"),
        (&["--rounds", "0"], "--rounds"),
    ] {
        let message = lab.fails(2, &[&small[..], extra].concat());
        assert!(message.contains(told), "{extra:?}: {message}");
    }
    lab.fails(2, &["speed", "missing.oct"]);
    lab.fails(2, &["speed", "planet.obj"]);
    lab.fails(2, &["figures", "planet.obj"]);
    lab.fails(2, &["tradeoff", "--rays-file", "cut.rays"]);
    lab.fails(2, &["tradeoff", "--peer", "h.hits"]);
    lab.fails(2, &["tradeoff", "--model", "planet.obj", "--planet", "12", "--rays-file", "cut.rays"]);
}

#[test]
fn errors_are_told_from_other_answers() {
    let lab = Lab::new();
    let args = ["tradeoff", "--model", "planet.obj", "--rays", "2000", "--every-triangle", "500", "--rounds", "1"];
    let args = [&args[..], &["-o", "plot", "--stats", "t.json"]].concat();
    let table = lab.bench(&args);
    assert!(
        table.contains("planet, aimed, 2000 rays") && table.contains("every triangle, f32 (1 ray in 4)"),
        "{table}"
    );
    let stats = lab.json("t.json");
    assert_eq!((&stats["schema"], &stats["meshes"][0]["triangles"]), (&1.into(), &1200.into()));
    let rows = stats["rows"].as_array().unwrap();
    let row = |set: &str, tracer: &str| {
        let is_it = |r: &&Value| r["set"] == set && r["tracer"].as_str().unwrap().starts_with(tracer);
        rows.iter().find(is_it).unwrap_or_else(|| panic!("{set}, {tracer}: {table}"))
    };
    for set in ["planet, aimed", "planet, camera"] {
        let exact = row(set, "octrace, exact");
        assert_eq!((&exact["right"], &exact["t_ulps_most"]), (&exact["rays"], &0.into()));
        for tracer in ["plain octree", "every triangle"] {
            let row = row(set, tracer);
            let kinds = ["right", "missed", "false", "wrong_triangle", "neighbour", "tie"];
            assert_eq!(kinds.map(|k| number(&row[k])).iter().sum::<f64>(), number(&row["rays"]), "{row}");
            assert!(number(&row["mrays_per_second"]) > 0.0 && number(&row["t_ulps_most"]) > 0.0, "{row}");
        }
    }
    let counts = ["plain octree", "every triangle"].map(|tracer| number(&row("planet, aimed", tracer)["rays"]));
    assert_eq!(counts, [2000.0, 500.0]);
    // Rays at edges and vertices are where rounding shows, mostly as the triangle beside.
    let plain = row("planet, aimed", "plain octree");
    assert!(number(&plain["error_rate"]) > 0.001 && number(&plain["neighbour"]) > 20.0, "{plain}");
    let svg = std::fs::read_to_string(lab.path("plot.svg")).unwrap();
    assert!(svg.contains("million rays a second") && svg.contains("planet, camera"));
    let png = std::fs::read(lab.path("plot.png")).unwrap();
    let picture = image::load_from_memory(&png).unwrap();
    assert!(picture.width() >= 1600 && picture.height() >= 800);
}

#[test]
fn hits_of_another_tracer_are_judged() {
    let lab = Lab::new();
    lab.bench(&["speed", "planet.oct", "--size", "30x30", "--sets", "primary", "--rounds", "1", "--keep-rays", "."]);
    let rays = std::fs::File::open(lab.path("whole.primary.rays")).unwrap();
    let hits = std::fs::File::create(lab.path("own.hits")).unwrap();
    let mut trace = Command::new(env!("CARGO_BIN_EXE_octtrace"));
    assert!(trace.arg(lab.path("planet.oct")).stdin(rays).stdout(hits).status().unwrap().success());
    let mut bytes = std::fs::read(lab.path("own.hits")).unwrap();
    let records: Vec<[u8; 16]> = bytes.as_chunks::<16>().0.to_vec();
    let struck = records.iter().position(|r| r[4..8] != [0xff; 4]).unwrap();
    let args = ["tradeoff", "--model", "planet.obj", "--rays-file", "whole.primary.rays", "--rounds", "1"];
    let judged = |name: &str| {
        lab.bench(&[&args[..], &["--peer", name, "--peer-mrays", "2.5", "--stats", "p.json"]].concat());
        let stats = lab.json("p.json");
        stats["rows"].as_array().unwrap().iter().find(|r| r["tracer"] == "peer").unwrap().clone()
    };
    let right = judged("own.hits");
    assert_eq!((&right["right"], &right["mrays_per_second"]), (&900.into(), &2.5.into()));
    // One hit taken away is one ray missed.
    bytes[16 * struck..16 * struck + 8].copy_from_slice(&[0, 0, 0x80, 0x7f, 0xff, 0xff, 0xff, 0xff]);
    std::fs::write(lab.path("less.hits"), &bytes).unwrap();
    let less = judged("less.hits");
    assert_eq!((&less["right"], &less["missed"]), (&899.into(), &1.into()));
    std::fs::write(lab.path("short.hits"), &bytes[..160]).unwrap();
    let message = lab.fails(2, &[&args[..], &["--peer", "short.hits"]].concat());
    assert!(message.contains("10 hits for 900 rays"), "{message}");
}
