//! Builds that end before their time: interrupted, or killed and taken up again.

use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use super::early::town;
use super::*;

/// Stops after a number of events.
fn interrupted_after(events: usize, mesh: &Memory, folder: &Path) -> Result<BuildReport> {
    let (stop, seen) = (AtomicBool::new(false), AtomicUsize::new(0));
    let sink = |_: Event| {
        if seen.fetch_add(1, Ordering::Relaxed) + 1 >= events {
            stop.store(true, Ordering::Relaxed);
        }
    };
    let monitor = Monitor::new(&sink, &stop);
    build_tuned(&mut mesh.clone(), &folder.join("a.oct"), &options(SplitMode::Sah, 40), &TINY, monitor)
}

#[test]
fn interrupted_at_any_time_it_leaves_the_older_file_only() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("a.oct"), b"older").unwrap();
    let mesh = sheet(15);
    let mut events = 1;
    while let Err(error) = interrupted_after(events, &mesh, folder.path()) {
        assert!(matches!(error, Error::Interrupted), "{error}");
        assert_eq!(std::fs::read(folder.path().join("a.oct")).unwrap(), b"older");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
        events += 1;
    }
    assert!(events > 20, "{events}");
    assert_eq!(read_back(&folder.path().join("a.oct")).len(), 450);
}

/// Copies all that is in a folder, folders included.
fn copy_all(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).unwrap();
    for entry in std::fs::read_dir(from).unwrap().map(|entry| entry.unwrap()) {
        let goal = to.join(entry.file_name());
        match entry.file_type().unwrap().is_dir() {
            true => copy_all(&entry.path(), &goal),
            false => drop(std::fs::copy(entry.path(), goal).unwrap()),
        }
    }
}

/// Builds until so many events were seen, and leaves the folder as it was then, as a kill would; whether it came to that.
fn killed_after(events: usize, mesh: &Memory, folder: &Path, options: &BuildOptions) -> bool {
    let left = tempfile::tempdir().unwrap();
    let (stop, seen) = (AtomicBool::new(false), AtomicUsize::new(0));
    let sink = |_: Event| {
        if seen.fetch_add(1, Ordering::Relaxed) + 1 == events {
            copy_all(folder, left.path());
            stop.store(true, Ordering::Relaxed);
        }
    };
    let monitor = Monitor::new(&sink, &stop);
    let result = build_tuned(&mut mesh.clone(), &folder.join("a.oct"), options, &TINY, monitor);
    copy_all(left.path(), folder);
    result.is_err()
}

#[test]
fn a_killed_build_is_taken_up_with_the_same_bytes() {
    for (mesh, has_large, compress) in [(sheet(15), false, None), (sheet(15), false, Some(1)), (town(15), true, None)] {
        let options = BuildOptions { source: Some("sheet".into()), compress, ..options(SplitMode::Sah, 40) };
        let (_, _, bytes) = round_trip(&mesh, &options, &TINY);
        let (mut events, mut skipped) = (1, [0; 4]);
        loop {
            let folder = tempfile::tempdir().unwrap();
            if !killed_after(events, &mesh, folder.path(), &options) {
                break;
            }
            let again = BuildOptions { resume: true, ..options.clone() };
            let report = build_in(folder.path(), &mesh, &again, &TINY).unwrap();
            let names: Vec<_> = std::fs::read_dir(folder.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
            assert_eq!(names, ["a.oct"], "after {events} events");
            assert!(std::fs::read(folder.path().join("a.oct")).unwrap() == bytes, "after {events} events");
            let has = |name: &str| report.phases.iter().any(|phase| phase.name == name);
            skipped[0] += usize::from(!has("scan"));
            skipped[1] += usize::from(!has("scan") && !has("split"));
            skipped[2] += usize::from(!has("scan") && !has("distribute"));
            skipped[3] += usize::from(!has("scan") && has("join"));
            events += 1;
        }
        assert!(skipped[0] > skipped[2] && skipped[1] > 10 && skipped[3] > 0, "{skipped:?} of {events}");
        // In a town there is nearly always a chunk that is still to be sorted below its cell.
        assert!(skipped[2] > if has_large { 0 } else { 10 }, "{skipped:?} of {events}");
    }
}

#[test]
fn what_another_build_left_is_not_taken_up() {
    let (mesh, other) = (sheet(15), sheet(14));
    let folder = tempfile::tempdir().unwrap();
    let options = BuildOptions { source: Some("sheet".into()), ..options(SplitMode::Sah, 40) };
    let (_, _, bytes) = round_trip(&other, &options, &TINY);
    // While chunks are written.
    let seen = AtomicUsize::new(0);
    let count = |_: Event| {
        seen.fetch_add(1, Ordering::Relaxed);
    };
    let stop = AtomicBool::new(false);
    let monitor = Monitor::new(&count, &stop);
    build_tuned(&mut mesh.clone(), &folder.path().join("a.oct"), &options, &TINY, monitor).unwrap();
    let events = seen.into_inner() * 3 / 4;
    for again in [
        BuildOptions { source: Some("other".into()), resume: true, ..options.clone() },
        BuildOptions { leaf: 7, resume: true, ..options.clone() },
        options.clone(),
    ] {
        assert!(killed_after(events, &mesh, folder.path(), &options));
        let again_bytes = BuildOptions { resume: false, ..again.clone() };
        build_in(folder.path(), &other, &again, &TINY).unwrap();
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "the finished file only");
        let (_, _, expected) = round_trip(&other, &again_bytes, &TINY);
        assert!(std::fs::read(folder.path().join("a.oct")).unwrap() == expected);
    }
    assert!(std::fs::read(folder.path().join("a.oct")).unwrap() == bytes);
}
