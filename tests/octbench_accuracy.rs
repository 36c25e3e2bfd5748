//! octbench itself, on a small number of rays: no disagreement with the oracle, and the statistics other tools rely on.

use std::process::Command;

/// Runs octbench with `--stats -` and reads what it writes.
fn octbench(args: &[&str]) -> serde_json::Value {
    let output = Command::new(env!("CARGO_BIN_EXE_octbench")).args(args).args(["--stats", "-"]).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

#[test]
fn families_agree_with_the_oracle() {
    let stats = octbench(&["accuracy", "--rays", "1000", "--families", "1,2,10,38,40"]);
    assert_eq!(stats["schema"], 1);
    assert_eq!(stats["disagreements"], 0);
    assert_eq!(stats["families"].as_array().unwrap().len(), 5);
}

#[test]
fn closed_meshes_are_crossed_evenly() {
    let stats = octbench(&["closed", "--rays", "2000"]);
    assert_eq!((&stats["wrong_parity"], &stats["escapes"]), (&0.into(), &0.into()));
}
