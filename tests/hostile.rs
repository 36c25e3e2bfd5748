//! Hostile input, as far as a test has time for: what once failed, and some thousand more. `cargo run --release --example fuzz` goes on from there.

#[path = "fuzz/mod.rs"]
mod fuzz;

use std::path::Path;

use fuzz::seeds::Seeds;
use fuzz::targets::{self, Outcome, TARGETS, Target};

/// Inputs of each target; octree files get as many as all the others.
const INPUTS: u64 = 150;

fn run(target: &Target, inputs: u64) -> [u64; 2] {
    let folder = tempfile::tempdir().unwrap();
    let seeds = Seeds::new(folder.path());
    let mut counts = [0; 2];
    for number in 0..inputs {
        match (target.run)(&seeds.input(target.name, number), folder.path()) {
            Outcome::Taken => counts[0] += 1,
            Outcome::Refused => counts[1] += 1,
        }
    }
    counts
}

#[test]
fn what_once_failed_is_taken_or_refused() {
    let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fuzz/corpus");
    let mut inputs = 0;
    for target in &TARGETS {
        let Ok(files) = std::fs::read_dir(corpus.join(target.name)) else { continue };
        for file in files {
            let folder = tempfile::tempdir().unwrap();
            (target.run)(&std::fs::read(file.unwrap().path()).unwrap(), folder.path());
            inputs += 1;
        }
    }
    assert!(inputs >= TARGETS.len(), "only {inputs} inputs in the corpus");
}

#[test]
fn octree_files_that_lie() {
    let [taken, refused] = run(targets::named("oct"), 7 * INPUTS);
    // Most lies are found out; some changes are of no consequence.
    assert!(taken > 0 && refused > taken, "{taken} taken, {refused} refused");
}

#[test]
fn meshes_and_scenes() {
    for target in TARGETS.iter().filter(|t| t.name != "oct") {
        let [taken, refused] = run(target, INPUTS);
        assert!(taken > 0, "{}: nothing is taken", target.name);
        // Whatever an MTL file says, the mesh is built; any bits are a ray.
        assert!(refused > 0 || ["mtl", "rays"].contains(&target.name), "{}: nothing is refused", target.name);
    }
}
