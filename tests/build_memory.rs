//! Builds within a bound on memory: the bound holds, and the bytes do not depend on it.
//!
//! What is measured is the most resident memory of the process as the system counted it (VmHWM on Linux). One case runs in a
//! memory cgroup, where the test may make one.

#[path = "cli_tools/support.rs"]
#[allow(dead_code, unused_macros, unused_imports)]
mod support;

#[cfg(target_os = "linux")]
mod cgroup;

use std::fmt::Write as _;

use support::*;

/// Numbers that look random, the same in each run.
struct Random(u64);

impl Random {
    fn below(&mut self, n: u64) -> u64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) % n
    }

    fn shuffle<T>(&mut self, list: &mut [T]) {
        for i in (1..list.len()).rev() {
            list.swap(i, self.below(i as u64 + 1) as usize);
        }
    }
}

fn check(name: &str, obj: String) -> serde_json::Value {
    check_with(name, obj, &[])
}

/// Builds with 64 MiB and with 1 GiB: both stay below, and give the same bytes; the statistics of the first.
fn check_with(name: &str, obj: String, flags: &[&str]) -> serde_json::Value {
    let lab = Lab::new();
    let input = format!("{name}.obj");
    lab.write(&input, obj);
    for (memory, bytes, out) in [("64M", 64u64 << 20, "small.oct"), ("1G", 1 << 30, "large.oct")] {
        let stats = format!("{memory}.json");
        let line = [&input, "-o", out, "--memory", memory, "--threads", "2", "--stats", &stats, "-q"];
        lab.done("octbuild", &[&line, flags].concat());
        let peak = lab.json(&stats)["peak_rss_bytes"].as_u64().unwrap();
        println!("{name}, {memory}: peak {} KiB", peak >> 10);
        assert!(peak <= bytes, "{name}: {peak} bytes are above {memory}");
    }
    assert!(lab.read("small.oct") == lab.read("large.oct"), "{name}: the bytes depend on the memory");
    lab.done("octinfo", &["small.oct", "--verify"]);
    assert_eq!(lab.files().len(), 5, "nothing else is left: {:?}", lab.files());
    lab.json("64M.json")
}

fn phases(stats: &serde_json::Value) -> Vec<&str> {
    stats["phases"].as_array().unwrap().iter().map(|phase| phase["name"].as_str().unwrap()).collect()
}

/// A strip of triangles over `n` vertices, with texture coordinates and normals if asked for; faces as `order` says.
fn strip(n: usize, attributes: bool, order: impl FnOnce(&mut Vec<usize>)) -> String {
    let mut obj = String::new();
    for i in 0..n {
        writeln!(obj, "v {} {} {}", i % 1000, i / 1000, i * 7919 % 13).unwrap();
        if attributes {
            writeln!(obj, "vt 0.{} 0.5\nvn 0 {} 1", i % 977, i % 7).unwrap();
        }
    }
    let mut faces: Vec<usize> = (1..n - 1).collect();
    order(&mut faces);
    for i in faces {
        match attributes {
            true => writeln!(obj, "f {i}/{i}/{i} {0}/{0}/{0} {1}/{1}/{1}", i + 1, i + 2).unwrap(),
            false => writeln!(obj, "f {i} {} {}", i + 1, i + 2).unwrap(),
        }
    }
    obj
}

#[test]
fn faces_shuffled_over_the_whole_file() {
    let stats = check("shuffled", strip(1_600_000, false, |faces| Random(1).shuffle(faces)));
    assert!(phases(&stats).contains(&"distribute"));
}

#[test]
fn faces_in_order_through_a_window_with_attributes() {
    check("attributes", strip(700_000, true, |_| {}));
}

#[test]
fn identical_triangles() {
    let obj = String::from("v 0 0 0\nv 1 0 0\nv 0 1 0\n") + &"f 1 2 3\n".repeat(600_000);
    let stats = check("identical", obj);
    assert_eq!((stats["triangles"].as_u64(), stats["pages"].as_u64()), (Some(600_000), Some(37)));
}

#[test]
fn all_triangles_in_one_cell() {
    let mut random = Random(2);
    let mut obj = String::from("v 9000 9000 9000\nv 9001 9000 9000\nv 9000 9001 9000\nf 1 2 3\n");
    for _ in 0..400_000 {
        let mut number = || random.below(1_000_000) as f64 * 1e-9;
        writeln!(obj, "v {} {} {}", number(), number(), number()).unwrap();
    }
    (4..400_000).for_each(|i| writeln!(obj, "f {i} {} {}", i + 1, i + 2).unwrap());
    check("one_cell", obj);
}

#[test]
fn one_vertex_shared_by_all_and_needles() {
    let mut random = Random(3);
    let mut obj = String::from("v 0 0 5000\n");
    for i in 0..500_000 {
        writeln!(obj, "v {} {} 0", i as f64 * 1e-3, random.below(1000)).unwrap();
    }
    (2..500_000).for_each(|i| writeln!(obj, "f 1 {i} {}", i + 1).unwrap());
    check("fan", obj);
}

#[test]
fn giant_triangles_over_everything() {
    let mut random = Random(4);
    let mut obj = String::new();
    for _ in 0..50_000 {
        let mut number = || random.below(20_001) as f64 * 1e-4 - 1.0;
        writeln!(obj, "v {} {} {}", number(), number(), number()).unwrap();
    }
    let mut corner = || random.below(50_000) + 1;
    (0..400_000).for_each(|_| writeln!(obj, "f {} {} {}", corner(), corner(), corner()).unwrap());
    check("giant", obj);
}

#[test]
fn large_triangles_among_small_ones() {
    // A field of bumps on a ground of two triangles, under wires as long as the field.
    let mut obj = String::new();
    for i in 0..500 * 500 {
        writeln!(obj, "v {} {} 0.{}", i % 500, i / 500, i * 7919 % 13).unwrap();
    }
    for y in 0..499 {
        for at in (1..500).map(|x| x + 500 * y) {
            writeln!(obj, "f {at} {} {}\nf {at} {1} {}", at + 1, at + 501, at + 500).unwrap();
        }
    }
    obj += "v -1 -1 -1\nv 501 -1 -1\nv 501 501 -1\nv -1 501 -1\nf -4 -3 -2\nf -4 -2 -1\n";
    for y in 0..2000 {
        let y = f64::from(y) * 0.25;
        writeln!(obj, "v 0 {y} 9\nv 499 {} 8\nv 499 {} 8.1\nf -3 -2 -1", 499.0 - y, 499.1 - y).unwrap();
    }
    let stats = check("large", obj);
    assert!(phases(&stats).contains(&"split"));
    let count = |name: &str| stats[name].as_u64().unwrap();
    assert_eq!(count("triangles"), 2 * 499 * 499 + 2002);
    assert!(count("references") > count("triangles") + 4000, "{} references", count("references"));
}

#[test]
fn points_given_again_for_each_triangle() {
    let mut obj = String::new();
    for i in 0..400_000 {
        let (x, y) = (i % 632, i / 632);
        writeln!(obj, "v {x} {y} 0\nv {} {y} 0\nv {x} {} 1\nf -3 -2 -1", x + 1, y + 1).unwrap();
    }
    check("soup", obj);
}

#[test]
fn a_face_of_very_many_corners() {
    let mut obj = String::new();
    for i in 0..1000 {
        writeln!(obj, "v {} {} {}", i % 10, i / 10 % 10, i / 100).unwrap();
    }
    obj += "f";
    (0..900_000u64).for_each(|i| write!(obj, " {}", (i * i % 1009 + i) % 1000 + 1).unwrap());
    obj += "\nf 1 2 11\n";
    let stats = check("polygon", obj);
    assert_eq!((stats["source_triangles"].as_u64(), stats["polygons"]["fanned"].as_u64()), (Some(899_999), Some(1)));
}

#[test]
fn a_line_too_long_for_the_memory_is_told() {
    let lab = Lab::new();
    lab.write("a.obj", "v 0 0 0\n".to_owned() + "f" + &" 1".repeat(8 << 20) + "\n");
    let error = lab.fails(2, "octbuild", &["a.obj", "-o", "a.oct", "--memory", "64M"]);
    assert!(error.contains("a.obj") && error.contains("allow more"), "{error}");
    assert_eq!(lab.files(), ["a.obj"]);
}

#[test]
fn packed_with_a_large_window() {
    let lab = Lab::new();
    let obj = strip(500_000, false, |_| {});
    assert!(obj.len() > 16 << 20);
    for (name, log) in [("8.obj.zst", 23), ("16.obj.zst", 24)] {
        let mut encoder = zstd::stream::Encoder::new(Vec::new(), 1).unwrap();
        encoder.window_log(log).unwrap();
        std::io::Write::write_all(&mut encoder, obj.as_bytes()).unwrap();
        lab.write(name, encoder.finish().unwrap());
    }
    let built = |input, memory, bytes: u64| {
        lab.done("octbuild", &[input, "-o", "a.oct", "--memory", memory, "--threads", "2", "--stats", "s.json", "-q"]);
        let peak = lab.json("s.json")["peak_rss_bytes"].as_u64().unwrap();
        assert!(peak <= bytes, "{input}: {peak} bytes are above {memory}");
        lab.read("a.oct")
    };
    let small = built("8.obj.zst", "64M", 64 << 20);
    assert!(built("16.obj.zst", "128M", 128 << 20) == small);
    let error = lab.fails(2, "octbuild", &["16.obj.zst", "-o", "b.oct", "--memory", "64M"]);
    assert!(error.contains("16.obj.zst") && error.contains("window") && error.contains("allow more"), "{error}");
}

#[test]
fn very_many_materials() {
    let lab = Lab::new();
    let mut obj = String::from("mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\n");
    let mut mtl = String::new();
    for i in 0..200_000 {
        writeln!(obj, "usemtl material_{i}\nf 1 2 3").unwrap();
        writeln!(mtl, "newmtl material_{i}\nKd 0.5 0.5 0.{i}\nNs 10\nillum 2").unwrap();
    }
    lab.write("a.obj", obj);
    lab.write("a.mtl", mtl);
    let error = lab.fails(2, "octbuild", &["a.obj", "-o", "a.oct", "--memory", "64M"]);
    assert!(error.contains("materials") && error.contains("allow more (about 1 KiB for each)"), "{error}");
    lab.done("octbuild", &["a.obj", "-o", "a.oct", "--memory", "256M", "--stats", "s.json", "-q"]);
    let peak = lab.json("s.json")["peak_rss_bytes"].as_u64().unwrap();
    assert!(peak <= 256 << 20, "{peak}");
    lab.done("octinfo", &["a.oct", "--verify"]);
}

/// Needles in all directions, some of them long: in a strict octree each is in very many cells.
fn needles(n: usize) -> String {
    let (mut random, mut obj) = (Random(6), String::new());
    for i in 0..n {
        let mut number = |size: f64| (random.below(200_001) as f64 * 1e-5 - 1.0) * size;
        let (x, y, z) = (number(1.0), number(1.0), number(1.0));
        let size = if i % 50 == 0 { 0.5 } else { 0.01 };
        writeln!(obj, "v {x} {y} {z}\nv {} {} {z}", x + size, y + 1e-5).unwrap();
        writeln!(obj, "v {x} {} {}\nf -3 -2 -1", y + number(size), z + number(size)).unwrap();
    }
    obj
}

#[test]
fn strict_octrees() {
    let flags = ["--split", "strict", "--brick", "4096", "--cell"];
    check_with("strict", strip(400_000, false, |faces| Random(7).shuffle(faces)), &[&flags[..], &["4"]].concat());
    check_with("strict_needles", needles(150_000), &[&flags[..], &["16"]].concat());
}

#[test]
fn a_strict_page_too_large_for_the_memory_is_told() {
    let lab = Lab::new();
    lab.write("a.obj", needles(150_000));
    let line = ["a.obj", "-o", "a.oct", "--threads", "2", "--split", "strict", "--cell", "1", "--memory", "64M"];
    let error = lab.fails(2, "octbuild", &line);
    assert!(error.contains("strict octree") && error.contains("allow more"), "{error}");
    assert_eq!(lab.files(), ["a.obj"]);
}

#[test]
fn a_page_too_large_for_the_memory_is_told() {
    let lab = Lab::new();
    lab.write("a.obj", strip(1_500_000, false, |_| {}));
    let line = ["a.obj", "-o", "a.oct", "--memory", "64M", "--brick", "1000000"];
    let error = lab.fails(2, "octbuild", &line);
    assert!(error.contains("--brick"), "{error}");
    assert_eq!(lab.files(), ["a.obj"]);
}

/// A memory cgroup of version 1, removed when dropped.
#[cfg(target_os = "linux")]
#[test]
fn it_is_not_killed_in_a_group_of_a_quarter_more() {
    let Some(group) = cgroup::Group::new(80 << 20) else { return };
    let lab = Lab::new();
    lab.write("a.obj", strip(1_600_000, false, |faces| Random(5).shuffle(faces)));
    let line = format!("{} a.obj -o a.oct --memory 64M --threads 2 -q", env!("CARGO_BIN_EXE_octbuild"));
    let output = group.run(&line, &lab.path(""));
    assert_eq!(output.status.code(), Some(0), "{}", told(&output));
}
