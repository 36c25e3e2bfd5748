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
    killed_with(&TINY, events, mesh, folder, options)
}

/// The same of a build with other sizes.
fn killed_with(tuning: &Tuning, events: usize, mesh: &Memory, folder: &Path, options: &BuildOptions) -> bool {
    let left = tempfile::tempdir().unwrap();
    let (stop, seen) = (AtomicBool::new(false), AtomicUsize::new(0));
    let sink = |_: Event| {
        if seen.fetch_add(1, Ordering::Relaxed) + 1 == events {
            copy_all(folder, left.path());
            stop.store(true, Ordering::Relaxed);
        }
    };
    let monitor = Monitor::new(&sink, &stop);
    let result = build_tuned(&mut mesh.clone(), &folder.join("a.oct"), options, tuning, monitor);
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

/// How many events a build sends.
fn events(tuning: &Tuning, mesh: &Memory, options: &BuildOptions) -> usize {
    let folder = tempfile::tempdir().unwrap();
    let (stop, seen) = (AtomicBool::new(false), AtomicUsize::new(0));
    let count = |_: Event| {
        seen.fetch_add(1, Ordering::Relaxed);
    };
    let output = folder.path().join("a.oct");
    build_tuned(&mut mesh.clone(), &output, options, tuning, Monitor::new(&count, &stop)).unwrap();
    seen.into_inner()
}

#[test]
fn a_build_that_had_more_memory_is_taken_up_within_less() {
    let mesh = sheet(15);
    for split in [SplitMode::Sah, SplitMode::Strict] {
        let options = BuildOptions { source: Some("sheet".into()), ..options(split, 20) };
        let (_, _, bytes) = round_trip(&mesh, &options, &TINY);
        let large = Tuning { chunk_bytes: 4 * TINY.chunk_bytes, ..TINY };
        let mut sorted_again = 0;
        for events in 1..events(&large, &mesh, &options) {
            let folder = tempfile::tempdir().unwrap();
            assert!(killed_with(&large, events, &mesh, folder.path(), &options));
            let writes_pages =
                std::fs::read_dir(folder.path()).unwrap().any(|e| e.unwrap().path().join("pages").exists());
            let again = BuildOptions { resume: true, ..options.clone() };
            let report = build_in(folder.path(), &mesh, &again, &TINY).unwrap();
            assert!(std::fs::read(folder.path().join("a.oct")).unwrap() == bytes, "{split:?}, after {events} events");
            let has = |name: &str| report.phases.iter().any(|phase| phase.name == name);
            assert!(!writes_pages || !has("join"));
            sorted_again += usize::from(writes_pages && has("distribute"));
        }
        assert!(sorted_again > 0, "{split:?}: chunks that are too large were not sorted again");
    }
}

#[test]
fn a_scan_is_taken_up_though_a_little_less_memory_is_left() {
    let mesh = sheet(15);
    let options = BuildOptions { source: Some("sheet".into()), ..options(SplitMode::Sah, 40) };
    let mut taken_up = [0; 2];
    for events in 1..events(&TINY, &mesh, &options) {
        for (taken_up, block_corners) in taken_up.iter_mut().zip([46, 30]) {
            let folder = tempfile::tempdir().unwrap();
            assert!(killed_after(events, &mesh, folder.path(), &options));
            let again = BuildOptions { resume: true, ..options.clone() };
            let report = build_in(folder.path(), &mesh, &again, &Tuning { block_corners, ..TINY }).unwrap();
            let has = |name: &str| report.phases.iter().any(|phase| phase.name == name);
            *taken_up += usize::from(!has("scan") && has("join"));
        }
    }
    assert!(taken_up[0] > 0 && taken_up[1] == 0, "{taken_up:?}");
}

#[test]
fn pages_of_another_build_under_the_same_name_are_not_taken_for_its_own() {
    let (mesh, folder) = (sheet(15), tempfile::tempdir().unwrap());
    let temps = ["one", "two"].map(|name| folder.path().join(name));
    temps.iter().for_each(|temp| std::fs::create_dir(temp).unwrap());
    let [one, two] = temps.map(|temp| BuildOptions {
        source: Some("sheet".into()),
        temp: Some(temp),
        ..options(SplitMode::Sah, 40)
    });
    let (_, _, bytes) = round_trip(&mesh, &one, &TINY);
    // The first is killed while it writes pages; so is the second, which makes others, of the same file in another folder.
    let two = BuildOptions { lod: false, leaf: 3, ..two };
    assert!(killed_after(events(&TINY, &mesh, &one) - 3, &mesh, folder.path(), &one));
    assert!(killed_after(events(&TINY, &mesh, &two) - 3, &mesh, folder.path(), &two));
    build_in(folder.path(), &mesh, &BuildOptions { resume: true, ..one }, &TINY).unwrap();
    assert!(std::fs::read(folder.path().join("a.oct")).unwrap() == bytes);
}

#[test]
fn pages_that_are_noted_wrongly_are_told_and_written_anew() {
    let (mesh, folder) = (sheet(15), tempfile::tempdir().unwrap());
    let options = BuildOptions { source: Some("sheet".into()), ..options(SplitMode::Sah, 40) };
    let (_, _, bytes) = round_trip(&mesh, &options, &TINY);
    for damaged in [false, true] {
        assert!(killed_after(events(&TINY, &mesh, &options) - 3, &mesh, folder.path(), &options));
        let work = std::fs::read_dir(folder.path()).unwrap().map(|e| e.unwrap().path()).find(|path| path.is_dir());
        let pages = work.unwrap().join("pages");
        let mut entries = std::fs::read(&pages).unwrap();
        entries[5] ^= u8::from(damaged);
        std::fs::write(&pages, entries).unwrap();
        let (stop, warned) = (AtomicBool::new(false), AtomicUsize::new(0));
        let sink = |event: Event| {
            let told = matches!(event, Event::Warning(text) if text.contains("pages that were written are not whole"));
            warned.fetch_add(usize::from(told), Ordering::Relaxed);
        };
        let (again, output) = (BuildOptions { resume: true, ..options.clone() }, folder.path().join("a.oct"));
        build_tuned(&mut mesh.clone(), &output, &again, &TINY, Monitor::new(&sink, &stop)).unwrap();
        assert_eq!(warned.into_inner(), usize::from(damaged));
        assert!(std::fs::read(&output).unwrap() == bytes);
        std::fs::remove_file(output).unwrap();
    }
}

#[test]
fn the_index_of_a_large_mesh_is_taken_up_and_a_claim_of_one_is_not() {
    let tuning = Tuning::within(64 << 20, 2);
    let blocks = 3 * 300_000_000 / tuning.block_corners as u64;
    assert!(tuning.holds_index(14 * blocks) && !tuning.holds_index(1 << 24) && !tuning.holds_index(u64::MAX));
}

#[test]
fn few_extents_make_few_chunks_and_the_same_bytes() {
    let mesh = sheet(30);
    for split in [SplitMode::Sah, SplitMode::Strict] {
        let options = options(split, 20);
        let (_, _, bytes) = round_trip(&mesh, &options, &TINY);
        let few = Tuning { extents: 40, ..TINY };
        assert!(round_trip(&mesh, &options, &few).2 == bytes, "{split:?}");
    }
}
