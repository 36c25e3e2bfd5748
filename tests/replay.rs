//! Cases kept as bit patterns, traced in every mode and held to the oracle: `octbench replay` over tests/data/replay.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use octrace::trace::Isa;

fn replay(files: &[PathBuf]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_octbench")).arg("replay").args(files).args(["--stats", "-"]).output().unwrap()
}

fn stored() -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/replay");
    let mut files: Vec<PathBuf> = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.sort();
    files
}

#[test]
fn every_stored_case_agrees_in_every_mode() {
    let files = stored();
    let output = replay(&files);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let stats: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(stats["disagreements"], 0);
    let cases = stats["families"].as_array().unwrap();
    assert!(cases.len() >= 5 && cases.len() == files.len());
    for case in cases {
        let modes: Vec<&str> = case["modes"].as_array().unwrap().iter().map(|m| m["mode"].as_str().unwrap()).collect();
        assert!(Isa::available().iter().all(|isa| modes.contains(&isa.name())), "{modes:?}");
        assert!(case["hits"].as_u64().unwrap() > 0, "{case}");
    }
}

#[test]
fn a_case_that_disagrees_is_found_and_a_broken_file_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("case.txt");
    let quad = stored().into_iter().find(|path| path.ends_with("quad_diagonal.txt")).unwrap();
    let text = std::fs::read_to_string(quad).unwrap();
    // A quad is not closed: to say so is wrong, since its rays cross it once.
    std::fs::write(&path, format!("{text}closed\n")).unwrap();
    let output = replay(std::slice::from_ref(&path));
    assert_eq!(output.status.code(), Some(1), "{}", String::from_utf8_lossy(&output.stderr));
    let stats: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert!(stats["disagreements"].as_u64().unwrap() > 0);
    for wrong in ["ray 00000000\n", "f 0 1 9\n", "v x y z\n", "nonsense\n"] {
        std::fs::write(&path, format!("{text}{wrong}")).unwrap();
        assert_eq!(replay(std::slice::from_ref(&path)).status.code(), Some(2), "{wrong}");
    }
}
