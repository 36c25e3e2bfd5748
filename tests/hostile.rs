//! Hostile input, as far as a test has time for: what once failed, and some thousand more. `cargo run --release --example fuzz` goes on from there.

#[path = "fuzz/mod.rs"]
#[allow(dead_code)]
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

/// A small file of several pages.
fn small(folder: &Path) -> Vec<u8> {
    use octrace::build::{BuildOptions, build};
    let (obj, oct) = (folder.join("small.obj"), folder.join("small.oct"));
    std::fs::write(&obj, fuzz::seeds::sheet(5)).unwrap();
    let mut source = octrace::mesh::open(&obj, &octrace::mesh::ReadOptions::default()).unwrap();
    let options = BuildOptions { brick: Some(20), ..BuildOptions::default() };
    build(source.as_mut(), &oct, &options, octrace::Monitor::silent()).unwrap();
    std::fs::read(&oct).unwrap()
}

/// One in how many places is tried: 23, or all of them with OCTRACE_ALL=1.
fn step() -> usize {
    if std::env::var_os("OCTRACE_ALL").is_some() { 1 } else { 23 }
}

#[test]
fn every_field_may_lie() {
    let folder = tempfile::tempdir().unwrap();
    let whole = small(folder.path());
    let places = fuzz::oct::fields(&whole);
    assert!(places.len() > 500, "{} fields", places.len());
    let (mut inputs, mut passed, mut taken) = (0, 0, 0);
    for (i, &(at, size)) in places.iter().enumerate().filter(|(i, _)| i % step() == 0) {
        for value in fuzz::oct::values(&whole, at, size) {
            let mut bytes = whole.clone();
            bytes[at..at + size].copy_from_slice(&value.to_le_bytes()[..size]);
            // The length of the file is among what is tried: it stays as it was made.
            fuzz::oct::repair(&mut bytes);
            inputs += 1;
            passed += u32::from(fuzz::oct::passes(&bytes));
            taken += u32::from((targets::named("oct").run)(&bytes, folder.path()) == Outcome::Taken);
        }
        assert!(i == 0 || inputs > 0);
    }
    println!(
        "{} of {} fields, {inputs} files: header and checksums of {passed} pass, {taken} are taken",
        places.len().div_ceil(step()),
        places.len()
    );
    assert!(2 * passed > inputs && taken < inputs / 2, "{passed} of {inputs} passed, {taken} were taken");
}

#[test]
fn every_byte_and_every_length() {
    let folder = tempfile::tempdir().unwrap();
    let whole = small(folder.path());
    let run = |bytes: &[u8]| (targets::named("oct").run)(bytes, folder.path());
    assert_eq!(run(&whole), Outcome::Taken);
    let mut inputs = 0;
    for at in (0..whole.len()).step_by(step()) {
        let mut bytes = whole.clone();
        bytes[at] ^= 1 << (at / step() % 8);
        assert_eq!(run(&bytes), Outcome::Refused, "byte {at} does not matter");
        // With checksums that are right nothing is expected but an answer.
        fuzz::oct::repair(&mut bytes);
        run(&bytes);
        inputs += 2;
    }
    for border in fuzz::oct::borders(&whole) {
        for length in [border - 1, border, border + 1] {
            if (1..whole.len()).contains(&length) {
                assert_eq!(run(&whole[..length]), Outcome::Refused, "cut to {length}");
                let mut bytes = whole[..length].to_vec();
                fuzz::oct::shorten(&mut bytes);
                assert_eq!(run(&bytes), Outcome::Refused, "cut to {length}, checksums right");
                inputs += 2;
            }
        }
    }
    println!("{inputs} files of {} bytes", whole.len());
}

#[test]
fn leftovers_of_killed_builds_are_gone_on_with() {
    let folder = tempfile::tempdir().unwrap();
    let outcomes = fuzz::resume::unchanged().into_iter().map(|recipe| fuzz::resume::run(&recipe, folder.path()));
    let [mut taken, mut anew] = [0; 2];
    outcomes.for_each(|outcome| *if outcome == Outcome::Taken { &mut taken } else { &mut anew } += 1);
    // Before the scan is done nothing can be.
    assert!(taken > 50 && taken > anew && anew > 0, "{taken} taken up, {anew} begun anew");
}

#[test]
fn leftovers_of_killed_builds_that_lie() {
    let folder = tempfile::tempdir().unwrap();
    let (seeds, inputs) = (Seeds::new(folder.path()), 2 * INPUTS);
    let passed = (0..inputs).filter(|&number| fuzz::resume::passes(&seeds.input("resume", number))).count() as u64;
    // Of those, many are gone on with; the others are told from what the build wrote, and it begins anew.
    let [taken, refused] = run(targets::named("resume"), inputs);
    assert!(2 * passed > inputs && taken > inputs / 10 && refused > inputs / 10, "{passed}, {taken}, {refused}");
}

#[test]
fn meshes_and_scenes() {
    for target in TARGETS.iter().filter(|t| !["oct", "resume"].contains(&t.name)) {
        let [taken, refused] = run(target, INPUTS);
        assert!(taken > 0, "{}: nothing is taken", target.name);
        // Whatever an MTL file says, the mesh is built; any bits are a ray.
        assert!(refused > 0 || ["mtl", "rays"].contains(&target.name), "{}: nothing is refused", target.name);
    }
}
