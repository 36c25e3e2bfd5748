//! The tools within a bound on memory: the bound holds, and the answers do not depend on it.
//!
//! What is measured is the most resident memory of the process as the system counted it (VmHWM on Linux). One case runs in a
//! memory cgroup, where the test may make one.

#[path = "cli_tools/support.rs"]
#[allow(dead_code, unused_macros, unused_imports)]
mod support;

#[cfg(target_os = "linux")]
mod cgroup;

use octrace::geometry::Ray;
use support::*;

/// A mirror on a floor, with shadows.
const SCENE: &str = "\
resolution 200 160
lookat 1 2 4  0 0 0  0 1 0
background 0.2 0.3 0.4
light 3 5 4 1
sun -1 -1 -0.5 0.5
reflect 0.4
plane 0 -1 0  0 1 0
reflect 0.3
oct ball.oct
";

/// With a ball of many pages, and the same packed, and scenes of both.
fn lab() -> Lab {
    let lab = Lab::new();
    lab.write("ball.obj", ball(1000, 400));
    lab.done("octbuild", &["ball.obj", "-o", "ball.oct", "--brick", "4096", "-q"]);
    lab.done("octbuild", &["ball.obj", "-o", "packed.oct", "--brick", "4096", "--compress", "zstd:1", "-q"]);
    lab.write("scene.txt", SCENE);
    lab.write("packed.txt", SCENE.replace("ball.oct", "packed.oct"));
    lab
}

/// The least memory, as a tool says that is given too little.
fn least(lab: &Lab, tool: &str, args: &[&str]) -> String {
    let error = lab.fails(2, tool, &[args, &["--memory", "2M"]].concat());
    let (_, least) = error.rsplit_once("the least is ").unwrap_or_else(|| panic!("{error}"));
    least.trim().to_owned()
}

fn mib(size: &str) -> u64 {
    size.strip_suffix('M').unwrap().parse::<u64>().unwrap() << 20
}

#[test]
fn pictures_are_the_same_within_any_memory() {
    let lab = lab();
    lab.done("octrender", &["scene.txt", "-o", "mapped.png", "-q"]);
    let least = ["scene.txt", "packed.txt"].map(|scene| least(&lab, "octrender", &[scene]));
    let pages = std::fs::metadata(lab.path("ball.oct")).unwrap().len();
    for (scene, memory, threads) in [
        ("scene.txt", least[0].as_str(), "1"),
        ("scene.txt", &least[0], "2"),
        ("packed.txt", &least[1], "2"),
        ("scene.txt", "128M", "2"),
        ("packed.txt", "256M", "1"),
    ] {
        let line = [scene, "-o", "a.png", "--memory", memory, "--threads", threads, "--stats", "s.json", "-q"];
        lab.done("octrender", &line);
        assert!(lab.read("a.png") == lab.read("mapped.png"), "{scene}, {memory}, {threads} threads");
        let stats = lab.json("s.json");
        let (peak, read) = (stats["peak_rss_bytes"].as_u64().unwrap(), &stats["pages"]);
        println!("{scene}, {memory}, {threads} threads: peak {} KiB, {read} of {pages} bytes", peak >> 10);
        assert!(peak <= mib(memory), "{scene}: {peak} bytes are above {memory}");
        assert!(read["hit_rate"].as_f64().is_some_and(|rate| rate > 0.5 && rate < 1.0), "{read}");
        assert!(read["read"].as_u64() >= read["touched"].as_u64() && read["touched"].as_u64() > Some(10), "{read}");
    }
    // Packed files need no flag.
    lab.done("octrender", &["packed.txt", "-o", "b.png", "-q"]);
    assert!(lab.read("b.png") == lab.read("mapped.png"));
    lab.done("octrender", &["scene.txt", "-o", "c.png", "--read", "budgeted", "-q"]);
    assert!(lab.read("c.png") == lab.read("mapped.png"));
}

#[test]
fn rays_are_answered_the_same_within_any_memory() {
    let lab = lab();
    let point = |i: i32| (i as f32 * 0.618).fract() * 4.0 - 2.0;
    let rays: Vec<Ray> = (0..20_000)
        .map(|i| Ray::new([point(i), point(7 * i + 1), 3.0], [point(3 * i) - point(i), point(5 * i), -4.0]))
        .collect();
    let bytes: &[u8] = bytemuck::cast_slice(&rays);
    let least = ["ball.oct", "packed.oct"].map(|file| least(&lab, "octtrace", &[file]));
    for any in [&[][..], &["--any"]] {
        let trace = |args: &[&str]| {
            let output = lab.run_with("octtrace", &[any, args].concat(), bytes);
            assert_eq!(output.status.code(), Some(0), "{args:?}: {}", told(&output));
            output.stdout
        };
        let mapped = trace(&["ball.oct"]);
        for (file, least) in ["ball.oct", "packed.oct"].into_iter().zip(&least) {
            assert!(trace(&[file, "--memory", least, "--stats", "s.json"]) == mapped, "{file}");
            let stats = lab.json("s.json");
            assert!(stats["peak_rss_bytes"].as_u64().unwrap() <= mib(least), "{least}: {stats}");
            assert!(stats["pages"]["read"].as_u64() > Some(10), "{stats}");
        }
    }
}

#[test]
fn flags_that_contradict_each_other_are_refused() {
    let lab = Lab::with_ball();
    let error = lab.fails(2, "octrender", &["ball.oct", "--memory", "100M", "--read", "mapped"]);
    assert!(error.contains("--read mapped"), "{error}");
    lab.done("octbuild", &["ball.obj", "-o", "packed.oct", "--compress", "zstd", "-q"]);
    let error = lab.fails(2, "octtrace", &["packed.oct", "--read", "mapped"]);
    assert!(error.contains("packed"), "{error}");
    let output = lab.run("octrender", &["ball.oct", "--read", "sideways"]);
    assert_eq!(output.status.code(), Some(2));
}

#[test]
fn damage_in_the_middle_of_a_picture_names_the_page() {
    let lab = lab();
    let octree = octrace::map::Octree::open(&lab.path("ball.oct")).unwrap();
    // A page on the side that the camera sees.
    lab.done("octrender", &["scene.txt", "-o", "a.png", "-q"]);
    let mut bytes = lab.read("ball.oct");
    for record in octree.records().iter().skip(3).step_by(4) {
        bytes[record.offset as usize + 300] ^= 8;
    }
    drop(octree);
    lab.write("ball.oct", &bytes);
    for args in [&["--memory", "128M"][..], &[]] {
        let line = [&["scene.txt", "-o", "b.png"], args].concat();
        let error = lab.fails(3, "octrender", &line);
        assert!(error.contains("ball.oct: damaged octree file, page ") && error.contains("checksum"), "{error}");
        assert!(!lab.path("b.png").exists());
    }
}

#[test]
fn large_pages_are_warned_of() {
    let lab = Lab::new();
    lab.write("ball.obj", ball(1000, 200));
    lab.done("octbuild", &["ball.obj", "-o", "ball.oct", "--brick", "1000000", "-q"]);
    let output = lab.run("octrender", &["ball.oct", "--size", "32x32", "-o", "a.png", "--memory", "60M", "-q"]);
    assert_eq!(output.status.code(), Some(0), "{}", told(&output));
    assert!(told(&output).contains("an eighth of --memory") && told(&output).contains("--brick"), "{}", told(&output));
}

#[cfg(target_os = "linux")]
#[test]
fn it_is_not_killed_in_a_group_of_a_quarter_more() {
    let lab = lab();
    let memory = least(&lab, "octrender", &["scene.txt"]);
    let Some(group) = cgroup::Group::new(mib(&memory) * 5 / 4) else { return };
    let line = format!("{} scene.txt -o a.png --memory {memory} --threads 2 -q", env!("CARGO_BIN_EXE_octrender"));
    let output = group.run(&line, &lab.path(""));
    assert_eq!(output.status.code(), Some(0), "{}", told(&output));
    lab.done("octrender", &["scene.txt", "-o", "mapped.png", "-q"]);
    assert!(lab.read("a.png") == lab.read("mapped.png"));
}
