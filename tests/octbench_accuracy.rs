//! octbench itself: a million aimed rays against the exact oracle, and the statistics other tools rely on.

use std::process::{Command, Output};

/// Rays of the quick tier; a build without optimisation gets by with fewer.
const RAYS: u64 = if cfg!(debug_assertions) { 20_000 } else { 1_000_000 };

fn octbench(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_octbench")).args(args).output().unwrap()
}

/// Reads the statistics of a run that found nothing wrong.
fn stats(output: &Output) -> serde_json::Value {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

#[test]
fn a_million_aimed_rays_agree_with_the_oracle() {
    let folder = std::path::Path::new(env!("CARGO_TARGET_TMPDIR")).join("accuracy");
    let (rays, kept, file) = (RAYS.to_string(), folder.join("failures"), folder.join("accuracy.json"));
    std::fs::create_dir_all(&folder).unwrap();
    let paths = [&kept, &file].map(|p| p.to_str().unwrap());
    let output = octbench(&["accuracy", "--rays", &rays, "--keep", paths[0], "--stats", paths[1]]);
    // The table names the rays that disagree; the folder has them with their meshes.
    let told = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{told}\n{}\nsee {}", String::from_utf8_lossy(&output.stderr), kept.display());
    let stats: serde_json::Value = serde_json::from_slice(&std::fs::read(&file).unwrap()).unwrap();
    assert_eq!((&stats["schema"], &stats["disagreements"], &stats["complete"]), (&1.into(), &0.into(), &true.into()));
    let rays = stats["rays"].as_u64().unwrap();
    assert!(rays >= RAYS);
    assert!(stats["smallest_share"].as_f64().unwrap() >= 0.005);
    assert!(stats["rays_on_10k"].as_u64().unwrap() * 10 >= rays);
    let families = stats["families"].as_array().unwrap();
    assert_eq!(families.len(), 53);
    for family in families {
        // Every mode has seen every ray, but packets and flight one in eight, and the test of every triangle those on small meshes.
        for mode in family["modes"].as_array().unwrap() {
            let (all, traced) = (family["rays"].as_u64().unwrap(), mode["traced"].as_u64().unwrap());
            let least = match mode["mode"].as_str().unwrap() {
                "linear" => 1,
                "packet" | "flight" => all / 8,
                _ => all,
            };
            assert!(traced >= least, "{family}");
        }
        assert!(family["modes"][0]["mode"] == "scalar" && family["bound_95"].is_number(), "{family}");
    }
}

#[test]
fn single_families_can_be_chosen() {
    let stats = stats(&octbench(&["accuracy", "--rays", "1000", "--families", "1,2,10,38,40", "--stats", "-"]));
    assert_eq!(stats["families"].as_array().unwrap().len(), 5);
    assert!(stats["rays"].as_u64().unwrap() >= 1000);
}

#[test]
fn closed_meshes_are_crossed_evenly() {
    let stats = stats(&octbench(&["closed", "--rays", "2000", "--stats", "-"]));
    assert_eq!((&stats["wrong_parity"], &stats["escapes"]), (&0.into(), &0.into()));
}
