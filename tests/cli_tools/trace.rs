//! octtrace.

use std::process::Stdio;

use octrace::geometry::{FaceId, Hit, Ray};

use super::support::*;

/// A square at z = 0 in `a.oct`.
fn square() -> Lab {
    let lab = Lab::new();
    lab.write("a.obj", SQUARE);
    lab.done("octbuild", &["a.obj", "-o", "a.oct", "-q"]);
    lab
}

/// Rays along +z from z = -1 through a grid of points, half of which lie in the unit square.
fn grid(n: usize) -> Vec<Ray> {
    let point = |i: usize| [(i % n) as f32 / n as f32 * 2.0 + 0.003, (i / n) as f32 / n as f32 + 0.001, -1.0];
    (0..n * n).map(|i| Ray::new(point(i), [0.0, 0.0, 2.0])).collect()
}

fn trace(lab: &Lab, args: &[&str], rays: &[u8]) -> Vec<u8> {
    let output = lab.run_with("octtrace", args, rays);
    assert_eq!(output.status.code(), Some(0), "{}", told(&output));
    output.stdout
}

#[test]
fn answers_rays() {
    let lab = square();
    let hit_below = Ray::new([0.75, 0.25, -1.0], [0.0, 0.0, 2.0]);
    let rays = [
        hit_below,
        Ray::new([0.25, 0.75, 1.0], [0.0, 0.0, -1.0]),
        Ray::new([2.0, 0.5, -1.0], [0.0, 0.0, 1.0]),
        hit_below.between(0.0, 0.25),
        Ray::new([f32::NAN, 0.5, -1.0], [0.0, 0.0, 1.0]),
    ];
    let bytes = bytemuck::cast_slice(&rays);
    let out = trace(&lab, &["a.oct"], bytes);
    let hits: Vec<Hit> = bytemuck::pod_collect_to_vec(&out);
    let first = Hit { t: 0.5, face: FaceId(0), u: 0.5, v: 0.25 };
    let second = Hit { t: 1.0, face: FaceId(1), u: 0.25, v: 0.5 };
    assert_eq!(hits, [first, second, Hit::MISS, Hit::MISS, Hit::MISS]);
    assert_eq!(trace(&lab, &["a.oct", "--any"], bytes), [1, 1, 0, 0, 0]);
}

#[test]
fn many_rays_keep_their_order_and_repeats_are_written_once() {
    let lab = square();
    let rays = grid(600);
    let bytes: &[u8] = bytemuck::cast_slice(&rays);
    let once = trace(&lab, &["a.oct", "--threads", "1", "--stats", "one.json"], bytes);
    let hits: Vec<Hit> = bytemuck::pod_collect_to_vec(&once);
    assert_eq!(hits.len(), rays.len());
    for (ray, hit) in rays.iter().zip(&hits) {
        assert_eq!(hit.is_hit(), ray.origin[0] < 1.0, "{ray:?} {hit:?}");
    }
    let repeated = trace(&lab, &["a.oct", "--repeat", "3", "--threads", "2", "--stats", "three.json"], bytes);
    assert!(repeated == once);

    let expected = hits.iter().filter(|h| h.is_hit()).count();
    for (name, repeats) in [("one.json", 1), ("three.json", 3)] {
        let stats = lab.json(name);
        assert_eq!(stats["schema"], 1);
        assert_eq!(stats["rays"], rays.len());
        assert_eq!(stats["hits"], expected);
        let seconds: Vec<f64> = serde_json::from_value(stats["trace_seconds"].clone()).unwrap();
        assert!(seconds.len() == repeats && seconds.iter().all(|&s| s > 0.0), "{seconds:?}");
        for number in ["mrays_per_second", "nodes_per_ray", "triangles_per_ray", "peak_rss_bytes"] {
            assert!(stats[number].as_f64().unwrap() > 0.0, "{name} {number}");
        }
    }
}

#[test]
fn no_rays_no_hits() {
    let lab = square();
    assert!(trace(&lab, &["a.oct"], &[]).is_empty());
    assert!(trace(&lab, &["a.oct", "--repeat", "2"], &[]).is_empty());
}

#[test]
fn a_ray_that_is_cut_short_is_named() {
    let lab = square();
    let rays = grid(2);
    let bytes: &[u8] = bytemuck::cast_slice(&rays);
    for repeat in ["1", "2"] {
        let output = lab.run_with("octtrace", &["a.oct", "--repeat", repeat], &bytes[..100]);
        assert_eq!(output.status.code(), Some(2));
        assert_told!("octtrace_cut_short", told(&output));
    }
}

#[test]
fn wrong_usage_and_inputs_are_refused() {
    let lab = square();
    for args in [
        &[][..],
        &["a.oct", "--repeat", "0"],
        &["a.oct", "--stats", "-"],
        &["a.oct", "--memory", "1K"],
        &["missing.oct"],
        &["a.obj"],
    ] {
        lab.fails(2, "octtrace", args);
    }
    lab.fails(4, "octtrace", &["a.oct", "--stats", "a.obj/s.json"]);
}

#[test]
fn a_damaged_page_is_found_when_it_is_used() {
    let lab = square();
    let mut bytes = lab.read("a.oct");
    bytes[4096 + 64 + 10] ^= 1;
    lab.write("bad.oct", &bytes);
    let rays = grid(10);
    let output = lab.run_with("octtrace", &["bad.oct"], bytemuck::cast_slice(&rays));
    assert_eq!(output.status.code(), Some(3), "{}", told(&output));
    assert!(output.stdout.is_empty() && told(&output).contains("bad.oct"));
}

#[test]
fn a_broken_pipe_is_no_error() {
    let lab = square();
    let rays = grid(300);
    lab.write("rays", bytemuck::cast_slice::<Ray, u8>(&rays));
    let mut command = lab.command("octtrace", &["a.oct"]);
    command.stdin(std::fs::File::open(lab.path("rays")).unwrap());
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    drop(child.stdout.take());
    let output = child.wait_with_output().unwrap();
    assert_eq!((output.status.code(), told(&output).as_str()), (Some(0), ""));
}

#[test]
fn a_full_disk_is_the_machines_failure() {
    if !cfg!(target_os = "linux") {
        return;
    }
    let lab = square();
    let rays = grid(300);
    lab.write("rays", bytemuck::cast_slice::<Ray, u8>(&rays));
    let mut command = lab.command("octtrace", &["a.oct"]);
    command.stdin(std::fs::File::open(lab.path("rays")).unwrap());
    command.stdout(std::fs::OpenOptions::new().write(true).open("/dev/full").unwrap());
    assert_eq!(command.stderr(Stdio::null()).status().unwrap().code(), Some(4));
}

#[test]
fn every_instruction_set_gives_the_same_bytes() {
    let lab = square();
    let rays = grid(100);
    let bytes: &[u8] = bytemuck::cast_slice(&rays);
    let expected = trace(&lab, &["a.oct"], bytes);
    for isa in octrace::trace::Isa::available() {
        assert!(trace(&lab, &["a.oct", "--isa", isa.name()], bytes) == expected, "{isa:?}");
    }
    let output = lab.run_with("octtrace", &["a.oct", "--isa", "mmx"], bytes);
    assert_eq!(output.status.code(), Some(2), "{}", told(&output));
    assert!(told(&output).contains("mmx"));
}
