//! What the tools do when the machine fails them: each call that reads, writes, syncs, renames or creates a file fails in turn, or the
//! process is killed there. An older output survives, no temporary file is left unnamed, and nothing looks whole that is not.
//!
//! Calls are made to fail by a small library in C that is loaded before all others (`faults/shim.c`); where there is no C compiler, or the
//! system is not Linux, the tests say so and pass.
#![cfg(target_os = "linux")]

#[path = "cli_tools/support.rs"]
#[allow(dead_code, unused_macros, unused_imports)]
mod support;

use std::os::unix::process::ExitStatusExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

use support::*;

const OLD: &[u8] = b"what was there before";
const NO_SPACE: i32 = libc::ENOSPC;
const BROKEN: i32 = libc::EIO;

/// Runs of a tool with faults.
struct Faults {
    lab: Lab,
    shim: PathBuf,
    _folder: tempfile::TempDir,
}

impl Faults {
    fn new() -> Option<Faults> {
        let lab = Lab::new();
        let folder = tempfile::tempdir().unwrap();
        let shim = folder.path().join("shim.so");
        let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/faults/shim.c");
        let compiled =
            Command::new("cc").args(["-shared", "-fPIC", "-O1", "-o"]).arg(&shim).arg(source).arg("-ldl").status();
        if !compiled.is_ok_and(|status| status.success()) {
            println!("skipped: no C compiler");
            return None;
        }
        Some(Faults { lab, shim, _folder: folder })
    }

    fn run(&self, line: &[&str], fault: &str) -> Output {
        let mut command = self.lab.command(line[0], &line[1..]);
        command.env("LD_PRELOAD", &self.shim).env("OCTRACE_FAULT", fault).output().unwrap()
    }

    /// How many calls of each kind a run makes that is left alone.
    fn counts(&self, line: &[&str]) -> Vec<(String, u64)> {
        let (file, mut command) = (self.lab.path("counts"), self.lab.command(line[0], &line[1..]));
        let output = command.env("LD_PRELOAD", &self.shim).env("OCTRACE_FAULT_COUNTS", &file).output().unwrap();
        assert!(output.status.success(), "{}", told(&output));
        let text = std::fs::read_to_string(&file).unwrap();
        std::fs::remove_file(&file).unwrap();
        let count = |line: &str| line.split_once(' ').map(|(kind, n)| (kind.to_owned(), n.parse().unwrap()));
        text.lines().filter_map(count).collect()
    }
}

/// Up to `most` numbers of 1..=n: the first, the last, and some between.
fn some(n: u64, most: u64) -> Vec<u64> {
    let mut numbers: Vec<u64> =
        (0..most).map(|i| 1 + i * n.saturating_sub(1) / most.saturating_sub(1).max(1)).collect();
    numbers.retain(|i| *i <= n);
    numbers.dedup();
    numbers
}

/// At how many moments each kind of call fails: 4, or what OCTRACE_MOMENTS says.
fn moments() -> u64 {
    std::env::var("OCTRACE_MOMENTS").map_or(4, |text| text.parse().expect("OCTRACE_MOMENTS is a number"))
}

/// A sheet of some 300 thousand triangles: too large to be built in 64 MiB without temporary files.
fn sheet(n: usize) -> String {
    let mut text = String::new();
    for i in 0..=n {
        for j in 0..=n {
            text += &format!("v {i} {j} {}\n", (i * 7 + j * 13) % 11);
        }
    }
    for i in 0..n {
        for j in 0..n {
            let at = |i: usize, j: usize| i * (n + 1) + j + 1;
            text += &format!(
                "f {} {} {}\nf {} {} {}\n",
                at(i, j),
                at(i + 1, j),
                at(i + 1, j + 1),
                at(i, j),
                at(i + 1, j + 1),
                at(i, j + 1)
            );
        }
    }
    text
}

const BUILD: [&str; 10] =
    ["octbuild", "sheet.obj", "-o", "out.oct", "-q", "--memory", "64M", "--threads", "2", "--brick=4000"];

#[test]
fn a_build_that_the_machine_fails_leaves_what_was_there() {
    let Some(faults) = Faults::new() else { return };
    let lab = &faults.lab;
    lab.write("sheet.obj", sheet(420));
    let counts = faults.counts(&BUILD);
    let whole = lab.read("out.oct");
    let mut failed = 0;
    for (kind, count) in counts {
        assert!(count > 0, "no call of the kind {kind} is seen");
        for number in some(count, moments()) {
            let error = if kind == "write" && number % 2 == 0 { NO_SPACE } else { BROKEN };
            lab.write("out.oct", OLD);
            let output = faults.run(&BUILD, &format!("{kind}:{number}:{error}"));
            let (code, text) = (output.status.code(), told(&output));
            let place = format!("{kind} {number} of {count}: {code:?} {text}");
            assert_eq!(lab.files(), ["out.oct", "sheet.obj"], "{place}");
            if code == Some(0) {
                // The call did not matter (the folder could not be synced, say): then the file is whole.
                assert!(lab.read("out.oct") == whole, "{place}");
                continue;
            }
            assert_eq!(code, Some(4), "{place}");
            assert!(
                text.contains("error") && (text.contains(".o") || text.contains("temp")),
                "no file is named: {place}"
            );
            assert!(lab.read("out.oct") == OLD, "{place}");
            failed += 1;
        }
    }
    assert!(failed >= 8, "only {failed} runs failed");
}

#[test]
fn a_build_killed_anywhere_can_go_on() {
    let Some(faults) = Faults::new() else { return };
    let lab = &faults.lab;
    lab.write("sheet.obj", sheet(420));
    let counts = faults.counts(&BUILD);
    let whole = lab.read("out.oct");
    let mut killed = 0;
    for (kind, count) in counts {
        for number in some(count, moments()) {
            lab.write("out.oct", OLD);
            let output = faults.run(&BUILD, &format!("{kind}:{number}:kill"));
            if output.status.success() {
                // Threads may share their work otherwise, and make a call fewer.
                assert!(number == count && lab.read("out.oct") == whole, "{kind} {number} of {count} is not met");
                continue;
            }
            assert_eq!(output.status.signal(), Some(libc::SIGKILL), "{kind} {number}: {}", told(&output));
            killed += 1;
            let left = lab.read("out.oct");
            assert!(left == OLD || left == whole, "{kind} {number}: something else has the output's name");
            let named = |name: &String| ["out.oct", "sheet.obj"].contains(&&**name) || name.starts_with(".out.oct");
            assert!(lab.files().iter().all(named), "{kind} {number}: {:?}", lab.files());
            let line: Vec<&str> = BUILD[1..].iter().copied().chain(["--resume"]).collect();
            lab.done("octbuild", &line);
            assert!(lab.read("out.oct") == whole, "{kind} {number}: other bytes after --resume");
            assert_eq!(lab.files(), ["out.oct", "sheet.obj"], "{kind} {number}");
        }
    }
    assert!(killed >= 14, "only {killed} kills");
}

#[test]
fn a_picture_that_cannot_be_written_leaves_what_was_there() {
    let Some(faults) = Faults::new() else { return };
    let lab = &faults.lab;
    lab.write("sheet.obj", sheet(40));
    lab.done("octbuild", &["sheet.obj", "-o", "sheet.oct", "-q"]);
    let line = ["octrender", "sheet.oct", "-o", "out.png", "-q", "--size", "64x48", "--threads", "2"];
    let counts = faults.counts(&line);
    let whole = lab.read("out.png");
    let mut failed = std::collections::BTreeMap::new();
    for (kind, count) in counts.iter().filter(|(kind, _)| kind != "read") {
        for number in some(*count, 5) {
            for fault in [BROKEN.to_string(), NO_SPACE.to_string(), "kill".to_owned()] {
                lab.write("out.png", OLD);
                let output = faults.run(&line, &format!("{kind}:{number}:{fault}"));
                let (left, place) = (lab.read("out.png"), format!("{kind} {number} {fault}: {}", told(&output)));
                match output.status.code() {
                    Some(0) => assert!(left == whole, "{place}"),
                    code => {
                        *failed.entry(kind.clone()).or_insert(0) += 1;
                        assert!(left == OLD, "{place}");
                        assert!(code.is_none() || code == Some(4), "{place}");
                    }
                }
                let stray: Vec<_> = lab.files().into_iter().filter(|f| f.contains("tmp")).collect();
                // A killed process cannot clean up; what it leaves has a name that says whose it is.
                let allowed = |f: &String| output.status.signal().is_some() && f.starts_with(".octrace-");
                assert!(stray.iter().all(allowed), "{place}: {stray:?}");
                stray.iter().for_each(|f| std::fs::remove_file(lab.path(f)).unwrap());
            }
        }
    }
    assert!(["write", "sync", "rename", "open"].iter().all(|kind| failed.contains_key(*kind)), "{failed:?}");
}

/// How often each tool is killed at random moments: 6 and 4, or what OCTRACE_KILLS says and a fifth of that.
fn kills() -> [u64; 2] {
    let given = std::env::var("OCTRACE_KILLS").ok().map(|text| text.parse().expect("OCTRACE_KILLS is a number"));
    given.map_or([6, 4], |kills: u64| [kills, (kills / 5).max(1)])
}

/// Runs a tool and kills it after a share of the time that it takes; false if it had ended before.
fn killed_after(lab: &Lab, line: &[&str], time: Duration) -> bool {
    let mut child = lab.command(line[0], &line[1..]).stderr(Stdio::null()).spawn().unwrap();
    std::thread::sleep(time);
    let killed = child.try_wait().unwrap().is_none();
    child.kill().unwrap();
    child.wait().unwrap();
    killed
}

/// Numbers from 0 to 1 that follow no pattern.
fn share(number: u64) -> f64 {
    let bits = number.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    ((bits ^ bits >> 29).wrapping_mul(0xbf58_476d_1ce4_e5b9) >> 40) as f64 / f64::from(1 << 24)
}

#[test]
fn a_build_killed_at_random_moments_leaves_nothing_that_looks_whole() {
    let lab = Lab::new();
    lab.write("sheet.obj", sheet(420));
    let begin = Instant::now();
    lab.done(BUILD[0], &BUILD[1..]);
    let (whole, mut took) = (lab.read("out.oct"), begin.elapsed());
    let (mut killed, mut resumed) = (0, 0);
    for number in 0..5 * kills()[0] {
        if killed == kills()[0] {
            break;
        }
        // Every other time the output is there already; what the last kill left lies there too.
        match number % 2 {
            0 => lab.write("out.oct", OLD),
            _ => std::fs::remove_file(lab.path("out.oct")).unwrap(),
        }
        let resume: &[&str] = if number % 3 == 2 { &["--resume"] } else { &[] };
        match killed_after(&lab, &[&BUILD, resume].concat(), took.mul_f64(share(number))) {
            true => killed += 1,
            // It is faster than it was.
            false => took = took.mul_f64(0.9),
        }
        if lab.files().contains(&"out.oct".to_owned()) {
            let left = lab.read("out.oct");
            assert!(left == OLD || left == whole, "kill {number}: something else has the output's name");
        }
        let named = |name: &String| ["out.oct", "sheet.obj"].contains(&&**name) || name.starts_with(".out.oct");
        assert!(lab.files().iter().all(named), "kill {number}: {:?}", lab.files());
        if number % 4 == 3 || !lab.files().contains(&"out.oct".to_owned()) {
            lab.done("octbuild", &[&BUILD[1..], &["--resume"]].concat());
            assert!(lab.read("out.oct") == whole, "kill {number}: other bytes after --resume");
            assert_eq!(lab.files(), ["out.oct", "sheet.obj"], "kill {number}");
            resumed += 1;
        }
    }
    println!("octbuild: {killed} kills at random moments of {:.2} s, {resumed} builds taken up", took.as_secs_f64());
    assert!(killed == kills()[0] && resumed > 0, "only {killed} were still at work when they were to be killed");
}

#[test]
fn a_drawing_killed_at_random_moments_leaves_nothing_that_looks_whole() {
    let lab = Lab::new();
    lab.write("sheet.obj", sheet(60));
    // The cache of an OBJ is written by the drawing, too.
    let cached = "sheet.obj.cache.oct";
    let line = ["octrender", "sheet.obj", "-o", "out.png", "-q", "--size", "500x400", "--threads", "2"];
    let begin = Instant::now();
    lab.done(line[0], &line[1..]);
    let (whole, mut took) = (lab.read("out.png"), begin.elapsed());
    let octree = lab.read(cached);
    let mut killed = 0;
    for number in 0..5 * kills()[1] {
        if killed == kills()[1] {
            break;
        }
        lab.write("out.png", OLD);
        if number % 2 == 0 {
            std::fs::remove_file(lab.path(cached)).unwrap();
        }
        match killed_after(&lab, &line, took.mul_f64(share(number))) {
            true => killed += 1,
            false => took = took.mul_f64(0.9),
        }
        let left = lab.read("out.png");
        assert!(left == OLD || left == whole, "kill {number}: something else has the picture's name");
        for name in lab.files().iter().filter(|name| !["out.png", "sheet.obj"].contains(&&***name)) {
            let named =
                [".octrace-", ".sheet.obj.cache.oct", "sheet.obj.cache.oct.key"].iter().any(|x| name.starts_with(x));
            assert!(named || name == cached && lab.read(cached) == octree, "kill {number}: {name}");
        }
        lab.done(line[0], &line[1..]);
        assert!(lab.read("out.png") == whole && lab.read(cached) == octree, "kill {number}");
    }
    println!("octrender: {killed} kills at random moments of {:.2} s", took.as_secs_f64());
    assert!(killed == kills()[1], "only {killed} were still at work when they were to be killed");
}

#[test]
fn a_folder_that_cannot_be_written_is_told() {
    let Some(faults) = Faults::new() else { return };
    let lab = &faults.lab;
    lab.write("sheet.obj", sheet(40));
    lab.done("octbuild", &["sheet.obj", "-o", "sheet.oct", "-q"]);
    // As a read-only file system has it, which the superuser meets as well.
    for (tool, line, named) in [
        ("octbuild", &["sheet.obj", "-o", "out.oct"][..], "out.oct"),
        ("octrender", &["sheet.oct", "-o", "out.png", "--size", "8x8"], "out.png"),
        ("octinfo", &["sheet.oct", "--extract", "all", "-o", "out.obj"], "out.obj"),
        ("octbuild", &["sheet.obj", "-o", "out.oct", "--stats", "out.json"], "out."),
    ] {
        let output = faults.run(&[&[tool], line].concat(), &format!("open:1:{}", libc::EROFS));
        let text = told(&output);
        assert_eq!(output.status.code(), Some(4), "{tool}: {text}");
        assert!(text.contains(named) && text.to_lowercase().contains("read-only"), "{tool}: {text}");
        assert_eq!(lab.files(), ["sheet.obj", "sheet.oct"], "{tool}");
    }
    // The cache of an OBJ goes elsewhere then, or it is told that there is no place.
    let line = ["octrender", "sheet.obj", "-o", "out.png", "--size", "8x8"];
    let output = faults.run(&line, &format!("open:1:{}", libc::EROFS));
    let text = told(&output);
    assert!(matches!(output.status.code(), Some(2 | 4)) && text.contains("sheet.obj"), "{text}");
}

#[test]
fn closed_and_broken_outputs_are_survived() {
    let lab = Lab::new();
    lab.write("sheet.obj", sheet(40));
    lab.done("octbuild", &["sheet.obj", "-o", "sheet.oct", "-q"]);
    lab.write("rays", [0u8; 320_000]);
    let whole = lab.read("sheet.oct");
    for line in [
        "octbuild sheet.obj -o again.oct",
        "octbuild sheet.obj -o again.oct --stats -",
        "octrender sheet.oct -o again.png --size 9x9",
        "octrender sheet.oct -o - --size 300x300",
        "octtrace sheet.oct",
        "octinfo sheet.oct",
        "octinfo sheet.oct --json",
        "octinfo sheet.oct --extract all -o -",
    ] {
        let (tool, arguments) = line.split_once(' ').unwrap();
        let program = lab.command(tool, &[]).get_program().to_str().unwrap().to_owned();
        // Nobody reads; nothing is open; nothing but standard input is open.
        for outputs in ["| true", ">&-", ">&- 2>&-"] {
            let script = format!("set -o pipefail; {program} {arguments} < rays {outputs}");
            let output = Command::new("bash").args(["-c", &script]).current_dir(lab.path("")).output().unwrap();
            assert_eq!(output.status.code(), Some(0), "{line} {outputs}: {}", told(&output));
            assert!(!told(&output).contains("panicked"), "{line} {outputs}: {}", told(&output));
        }
    }
    // What was opened for other things was not taken for standard output.
    assert!(lab.read("again.oct") == whole && lab.read("sheet.oct") == whole);
    assert!(image::open(lab.path("again.png")).is_ok());
}

#[test]
fn a_file_that_cannot_be_read_is_named() {
    let Some(faults) = Faults::new() else { return };
    let lab = &faults.lab;
    lab.write("sheet.obj", sheet(40));
    lab.done("octbuild", &["sheet.obj", "-o", "sheet.oct", "-q"]);
    let line = ["octbuild", "sheet.obj", "-o", "again.oct", "-q"];
    let output = faults.run(&line, &format!("read:1:{BROKEN}"));
    assert_eq!(output.status.code(), Some(4), "{}", told(&output));
    assert!(told(&output).contains("sheet.obj"), "{}", told(&output));
    assert_eq!(lab.files(), ["sheet.obj", "sheet.oct"]);
}
