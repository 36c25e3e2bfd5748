//! Shares of one picture, put together.

use super::support::*;
use super::{assemble, lab, parts};

#[test]
fn put_together_they_are_the_bytes_of_one_machine() {
    let lab = lab();
    for (of, options) in [
        (1, &[][..]),
        (8, &["--samples", "4", "--threads", "1"]),
        (3, &["--crop", "11,7,130,80", "--depth", "2", "--memory", "128M"]),
        (5, &["--size", "64x300", "--lod", "2", "--threads", "3"]),
    ] {
        let mut parts = parts(&lab, of, options);
        // In any order.
        parts.reverse();
        let half = parts.len() / 2;
        parts.rotate_left(half);
        for suffix in ["png", "exr", "hdr"] {
            let (one, many) = (format!("one.{suffix}"), format!("many.{suffix}"));
            let unbounded: Vec<&str> = options.iter().copied().filter(|o| !["--memory", "128M"].contains(o)).collect();
            lab.done("octrender", &[&["scene.txt", "-q", "-o", &one], &unbounded[..]].concat());
            assemble(&lab, &parts, &many);
            assert!(lab.read(&one) == lab.read(&many), "{of} shares {options:?}: {suffix}");
        }
        parts.iter().for_each(|part| std::fs::remove_file(lab.path(part)).unwrap());
    }
    assert!(lab.files().iter().all(|name| !name.contains(".tmp")), "{:?}", lab.files());
}

#[test]
fn a_share_that_is_made_again_has_the_same_bytes_and_statistics_tell_of_it() {
    let lab = lab();
    lab.done("octrender", &["scene.txt", "--shard", "1/4", "-o", "a.exr", "--threads", "1"]);
    let output = lab.run("octrender", &["scene.txt", "--shard", "1/4", "-o", "b.exr", "--stats", "s.json"]);
    assert!(lab.read("a.exr") == lab.read("b.exr"));
    let stats = lab.json("s.json");
    assert_eq!((&stats["share"]["index"], &stats["share"]["of"]), (&1.into(), &4.into()));
    assert!(stats["rays"]["primary"].as_u64().unwrap() < 150 * 97 / 3);
    assert!(told(&output).contains("share 1 of 4 ("), "{}", told(&output));
}

#[test]
fn what_is_missing_doubled_or_foreign_is_named() {
    let lab = lab();
    let parts = parts(&lab, 5, &[]);
    let refused = |names: &[&str]| {
        let message = lab.fails(2, "octrender", &[&["--assemble"], names, &["-o", "out.png"]].concat());
        assert!(!lab.path("out.png").exists());
        message
    };
    let names: Vec<&str> = parts.iter().map(String::as_str).collect();
    let some = refused(&[names[0], names[2], names[4]]);
    assert!(some.contains("2 of 5 shares are missing: 1, 3; make them with --shard I/5"), "{some}");
    std::fs::copy(lab.path(names[2]), lab.path("copy.exr")).unwrap();
    let twice = refused(&[names[0], names[2], "copy.exr", names[3], names[4]]);
    assert!(twice.contains("share 2/5 is there twice") && twice.contains("copy.exr"), "{twice}");
    assert!(twice.contains("1 of 5 shares are missing: 1;"), "{twice}");

    // Each differs from the others in one thing.
    let foreign = |options: &[&str]| {
        lab.done("octrender", &[&["scene.txt", "-q", "--shard", "1/5", "-o", "x.exr"], options].concat());
        refused(&[names[0], "x.exr", names[2], names[3], names[4]])
    };
    for (options, what) in [
        (&["--samples", "4"][..], "samples a pixel 4, not 1"),
        (&["--depth", "3"], "bounces 3, not 10"),
        (&["--size", "97x150"], "a picture of 97 x 150 pixels, not 150 x 97 pixels"),
        (&["--crop", "0,0,150,96"], "a crop of"),
        (&["--lod", "1"], "another scene, other files in it, or another --lod"),
    ] {
        let message = foreign(options);
        assert!(message.contains("x.exr is of another picture than") && message.contains(what), "{message}");
    }
    lab.done("octrender", &["scene.txt", "-q", "--shard", "1/6", "-o", "x.exr"]);
    let other = refused(&[names[0], "x.exr"]);
    assert!(other.contains("shares 6, not 5"), "{other}");
    // Another mesh of the same name.
    lab.write("other.obj", ball(20, 12));
    lab.done("octbuild", &["other.obj", "-o", "ball.oct", "-q"]);
    assert!(foreign(&[]).contains("other files in it"));
    // All that one machine would draw is still the same.
    lab.done("octbuild", &["ball.obj", "-o", "ball.oct", "-q"]);
    assemble(&lab, &parts, "out.png");
}

#[cfg(target_os = "linux")]
#[test]
fn a_share_of_a_narrow_picture_stays_within_its_memory() {
    let lab = lab();
    let data = ["depth", "normal", "position", "face", "material", "shadow"];
    let wishes: Vec<&str> = data.iter().flat_map(|kind| ["--aov", kind]).collect();
    for (size, of, wishes) in [("1x65536", "0/1", &[][..]), ("1x65536", "0/1", &wishes), ("40000x3", "1/2", &wishes)] {
        let line = ["ball.oct", "--size", size, "--shard", of, "--memory", "64M", "-o", "p.exr", "--stats", "s.json"];
        lab.done("octrender", &[&line[..], wishes].concat());
        let peak = lab.json("s.json")["peak_rss_bytes"].as_u64().unwrap();
        println!("{size}, {} of data: {} KiB", wishes.len() / 2, peak >> 10);
        assert!(peak <= 64 << 20, "{size}, {} of data: {peak} bytes", wishes.len() / 2);
    }
    // Assembled they are the same bytes.
    lab.done("octrender", &["ball.oct", "--size", "40000x3", "--shard", "0/2", "-o", "q.exr", "-q"]);
    lab.done("octrender", &["ball.oct", "--size", "40000x3", "-o", "one.png", "-q"]);
    lab.done("octrender", &["--assemble", "p.exr", "q.exr", "-o", "many.png", "-q"]);
    assert!(lab.read("one.png") == lab.read("many.png"));
}

#[test]
fn schedulers_say_which_share_it_is() {
    let lab = lab();
    let run = |shard: &str, set: &[(&str, &str)]| {
        let mut command = lab.command("octrender", &["scene.txt", "--shard", shard]);
        for name in ["ID", "MIN", "MAX", "COUNT"] {
            command.env_remove(format!("SLURM_ARRAY_TASK_{name}"));
        }
        command.env_remove("JOB_COMPLETION_INDEX").envs(set.iter().copied());
        command.output().unwrap()
    };
    let slurm = [
        ("SLURM_ARRAY_TASK_ID", "2"),
        ("SLURM_ARRAY_TASK_MIN", "0"),
        ("SLURM_ARRAY_TASK_MAX", "3"),
        ("SLURM_ARRAY_TASK_COUNT", "4"),
    ];
    assert_eq!(run("auto", &slurm).status.code(), Some(0));
    assert!(lab.path("scene.part-2-of-4.exr").exists(), "{:?}", lab.files());
    assert_eq!(run("auto/6", &[("JOB_COMPLETION_INDEX", "5")]).status.code(), Some(0));
    assert!(lab.path("scene.part-5-of-6.exr").exists(), "{:?}", lab.files());
    let none = run("auto", &[]);
    assert_eq!(none.status.code(), Some(2));
    assert!(told(&none).contains("SLURM_ARRAY_TASK_ID"), "{}", told(&none));
}

#[test]
fn wrong_wishes_are_refused() {
    let lab = lab();
    for wrong in ["3/3", "a/b", "1"] {
        lab.fails(2, "octrender", &["scene.txt", "--shard", wrong]);
    }
    let many = lab.fails(2, "octrender", &["scene.txt", "--shard", "0/5000"]);
    assert!(many.contains("too few for 5000 shares"), "{many}");
    let suffix = lab.fails(2, "octrender", &["scene.txt", "--shard", "0/2", "-o", "a.png"]);
    assert!(suffix.contains("a part of a picture is an EXR file"), "{suffix}");
    lab.fails(2, "octrender", &["scene.txt", "--shard", "0/2", "--aov", "depth=d.exr"]);
    lab.fails(2, "octrender", &["--assemble", "a.exr"]);
    lab.fails(2, "octrender", &["--assemble", "a.exr", "-o", "b.png", "--samples", "4"]);
    lab.fails(2, "octrender", &["scene.txt", "--assemble", "a.exr", "-o", "b.png"]);
    let over = {
        lab.done("octrender", &["scene.txt", "-q", "--shard", "0/1", "-o", "a.exr"]);
        lab.fails(2, "octrender", &["--assemble", "a.exr", "-o", "a.exr"])
    };
    assert!(over.contains("over a part"), "{over}");
}

#[cfg(unix)]
#[test]
fn a_share_that_is_killed_leaves_no_part() {
    let lab = lab();
    let slow = ["scene.txt", "-q", "--shard", "0/2", "--size", "4096x4096", "--samples", "400"];
    for name in ["KILL", "INT"] {
        let mut child = lab.command("octrender", &slow).spawn().unwrap();
        std::thread::sleep(std::time::Duration::from_millis(300));
        signal(&child, name);
        assert_eq!(wait(&mut child), (name == "INT").then_some(130));
        assert!(lab.files().iter().all(|file| !file.ends_with(".exr")), "{:?}", lab.files());
    }
}
