//! Closed surfaces: crossed evenly by every line, left by nobody. A small version of `octbench closed` and `octbench mirrors`.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

fn octbench(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_octbench")).args(args).args(["--stats", "-"]).output().unwrap()
}

/// The statistics of a run that must find nothing wrong.
fn clean(args: &[&str]) -> serde_json::Value {
    let output = octbench(args);
    assert!(output.status.success(), "{args:?}: {}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

fn is_crossed_evenly(model: &[&str]) {
    let stats = clean(&[&["closed", "--rays", "1e5"], model].concat());
    assert_eq!((&stats["rays"], &stats["wrong_parity"], &stats["escapes"]), (&100_000.into(), &0.into(), &0.into()));
    // Rays were aimed at the mesh: nearly all meet it, those from outside twice.
    assert!(stats["crossings"].as_u64().unwrap() > 120_000, "{stats}");
    let triangles = stats["triangles"].as_u64().unwrap();
    assert_eq!(stats["edges"].as_u64().unwrap() * 2, triangles * 3);
}

#[test]
fn a_planet() {
    is_crossed_evenly(&[]);
}

#[test]
fn a_planet_on_a_grid() {
    is_crossed_evenly(&["--grid"]);
}

#[test]
fn meshes_of_the_data_folder() {
    let Some(folder) = std::env::var_os("OCTRACE_DATA").map(PathBuf::from) else {
        eprintln!("OCTRACE_DATA is not set: fandisk and spot skipped");
        return;
    };
    for name in ["fandisk.obj", "spot.obj"] {
        let path = folder.join(name);
        if path.exists() {
            is_crossed_evenly(&["--model", path.to_str().unwrap()]);
        } else {
            eprintln!("{} is not there: skipped", path.display());
        }
    }
}

#[test]
fn an_open_mesh_is_refused() {
    let bunny = Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/bunny.obj");
    let output = octbench(&["closed", "--model", bunny.to_str().unwrap()]);
    let told = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{told}");
    assert!(told.contains("223 lie on one face"), "{told}");
}

#[test]
fn nobody_leaves_a_box_of_mirrors() {
    let stats = clean(&["mirrors", "--paths", "1000", "--bounces", "1000"]);
    assert_eq!(stats["escapes"], 0);
    let boxes = stats["boxes"].as_array().unwrap();
    assert_eq!(boxes.len(), 7);
    for b in boxes {
        assert_eq!((&b["paths"], &b["rays"]), (&1000.into(), &1_000_000.into()), "{b}");
        assert_eq!((&b["lost"], &b["outside"]), (&0.into(), &0.into()), "{b}");
        assert!(b["checked"].as_u64().unwrap() >= 4000, "{b}");
    }
    let output = octbench(&["mirrors", "--boxes", "round"]);
    assert_eq!(output.status.code(), Some(2));
}
