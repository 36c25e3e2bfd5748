//! octbuild that comes to no good end: killed, interrupted, without room, or with an input that changes.

use std::io::Write;
use std::process::Stdio;
use std::time::Duration;

use super::support::*;

/// octbuild in the middle of its input, which never ends.
fn building(lab: &Lab) -> std::process::Child {
    let mut command = lab.command("octbuild", &["-", "-o", "a.oct"]);
    let mut child = command.stdin(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    child.stdin.as_mut().unwrap().write_all(ball(64, 64).as_bytes()).unwrap();
    std::thread::sleep(Duration::from_millis(500));
    assert_eq!(child.try_wait().unwrap(), None, "it should still wait for more");
    child
}

#[cfg(unix)]
#[test]
fn a_killed_build_leaves_nothing_that_looks_whole() {
    let lab = Lab::new();
    let mut child = building(&lab);
    signal(&child, "KILL");
    wait(&mut child);
    assert!(lab.files().iter().all(|name| !name.ends_with(".oct")), "{:?}", lab.files());
    lab.write("a.oct", "older");
    let mut child = building(&lab);
    signal(&child, "KILL");
    wait(&mut child);
    assert_eq!(lab.read("a.oct"), b"older");
}

#[cfg(unix)]
#[test]
fn interrupted_twice_it_ends_at_once() {
    let lab = Lab::new();
    let mut child = building(&lab);
    signal(&child, "INT");
    std::thread::sleep(Duration::from_millis(100));
    // It may already have ended, which is as good.
    if child.try_wait().unwrap().is_none() {
        signal(&child, "INT");
    }
    assert_eq!(wait(&mut child), Some(130));
    assert!(lab.files().iter().all(|name| !name.ends_with(".oct")), "{:?}", lab.files());
}

/// Runs octbuild under a shell's limits.
#[cfg(unix)]
fn limited(lab: &Lab, limits: &str, line: &str) -> std::process::Output {
    let script = format!("{limits}; exec {} {line}", env!("CARGO_BIN_EXE_octbuild"));
    std::process::Command::new("sh").args(["-c", &script]).current_dir(lab.path("")).output().unwrap()
}

#[cfg(unix)]
#[test]
fn a_full_disk_is_told_and_leaves_nothing() {
    let lab = Lab::new();
    lab.write("a.obj", ball(400, 300));
    lab.write("a.oct", "older");
    // The limit on file sizes counts 512 bytes; the output takes some 5 MB.
    for blocks in [20, 2000] {
        let output = limited(&lab, &format!("ulimit -f {blocks}"), "a.obj -o a.oct");
        let error = told(&output);
        assert_eq!(output.status.code(), Some(4), "{error}");
        assert!(error.contains("a.oct: cannot write") && error.contains("too large"), "{error}");
        assert_eq!((lab.files(), lab.read("a.oct")), (vec!["a.obj".into(), "a.oct".into()], b"older".to_vec()));
    }
}

#[test]
fn a_temporary_folder_that_cannot_be_used_is_told() {
    let lab = Lab::new();
    lab.write("a.obj", SQUARE);
    for temp in ["missing", "a.obj"] {
        let error = lab.fails(4, "octbuild", &["a.obj", "-o", "a.oct", "--temp", temp]);
        assert!(error.contains(&format!("{temp}: cannot create a temporary file in this folder")), "{error}");
    }
    assert_eq!(lab.files(), ["a.obj"]);
}

#[test]
fn an_input_cut_short_is_told() {
    let lab = Lab::new();
    let packed = zstd::encode_all(ball(60, 60).as_bytes(), 3).unwrap();
    lab.write("a.obj.zst", &packed[..packed.len() / 2]);
    lab.write("b.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nf 1 2");
    lab.write("c.obj", "v 0 0 0\nv 1 0 0\nv 0 1");
    assert!(lab.fails(2, "octbuild", &["a.obj.zst", "-o", "a.oct"]).contains("cut short"));
    assert!(lab.fails(2, "octbuild", &["c.obj", "-o", "a.oct"]).contains("takes 3 numbers"));
    assert_eq!(lab.files(), ["a.obj.zst", "b.obj", "c.obj"]);
    // Where the cut leaves what may be a face, or one too short, that can only be told.
    let whole = ball(300, 200);
    lab.write("d.obj", &whole[..whole.len() - 2]);
    lab.write("e.obj", whole);
    for (mesh, cut) in [("b.obj", true), ("d.obj", true), ("e.obj", false)] {
        let output = lab.run("octbuild", &[mesh, "-o", "a.oct"]);
        assert_eq!((output.status.code(), told(&output).contains("cut short")), (Some(0), cut), "{}", told(&output));
    }
}

#[cfg(unix)]
#[test]
fn an_input_that_grows_while_it_is_read_is_told() {
    let lab = Lab::new();
    lab.write("a.obj", ball(700, 500));
    // Read through a file that another process holds open: the builder is stopped while it reads, the file grows.
    let mut command = lab.command("octbuild", &["a.obj", "-o", "a.oct", "--memory", "64M", "--threads", "1"]);
    let mut child = command.stderr(Stdio::piped()).spawn().unwrap();
    let mut file = std::fs::OpenOptions::new().append(true).open(lab.path("a.obj")).unwrap();
    writeln!(file, "v 0 0 0").unwrap();
    let code = wait(&mut child);
    // It may have been read to its end before; then it is whole.
    assert!(code == Some(2) || code == Some(0), "{code:?}");
    let changed = code == Some(2);
    assert_eq!(lab.files().len(), if changed { 1 } else { 2 }, "{:?}", lab.files());
}

#[cfg(unix)]
#[test]
fn interrupted_once_it_cleans_up() {
    let lab = Lab::new();
    let mut child = building(&lab);
    signal(&child, "INT");
    assert_eq!(wait(&mut child), Some(130));
    assert_eq!(lab.files(), Vec::<String>::new());
}

#[cfg(unix)]
#[test]
fn nobody_has_to_read_what_it_says() {
    let lab = Lab::new();
    lab.write("a.obj", ball(8, 8));
    let mut child = lab.command("octbuild", &["a.obj", "-o", "a.oct"]).stderr(Stdio::piped()).spawn().unwrap();
    drop(child.stderr.take());
    assert_eq!(wait(&mut child), Some(0));
    assert_eq!(lab.files(), ["a.obj", "a.oct"]);
}

#[cfg(unix)]
#[test]
fn killed_builds_are_resumed_with_the_same_bytes() {
    let lab = Lab::new();
    lab.write("a.obj", ball(1200, 500));
    let line = ["a.obj", "-o", "a.oct", "--memory", "64M", "--threads", "2", "-q", "--resume"];
    let start = std::time::Instant::now();
    lab.done("octbuild", &line[..8]);
    let (whole, took) = (lab.read("a.oct"), start.elapsed());
    let mut kills = 0;
    for share in [3u32, 5, 7, 9, 11, 12, 13, 14] {
        std::fs::remove_file(lab.path("a.oct")).unwrap();
        let mut child = lab.command("octbuild", &line[..8]).spawn().unwrap();
        std::thread::sleep(took * share / 16);
        if child.try_wait().unwrap().is_none() {
            signal(&child, "KILL");
            kills += 1;
        }
        wait(&mut child);
        lab.run("octbuild", &line);
        assert!(lab.read("a.oct") == whole, "killed after {share}/16");
        assert_eq!(lab.files(), ["a.obj", "a.oct"]);
    }
    assert!(kills > 2, "only {kills} were still at work when they were to be killed");
}
