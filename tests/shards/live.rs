//! Pictures that are renewed: while they are drawn, and when their scene changes.
#![cfg(unix)]

use std::io::{BufRead, BufReader};
use std::process::{Child, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

use super::lab;
use super::support::*;

/// Waits for something, not for ever.
fn until<T>(what: &str, mut there: impl FnMut() -> Option<T>) -> T {
    let start = Instant::now();
    loop {
        if let Some(found) = there() {
            return found;
        }
        assert!(start.elapsed() < Duration::from_secs(60), "{what}");
        std::thread::sleep(Duration::from_millis(20));
    }
}

#[test]
fn a_preview_shows_what_is_done_and_gives_way_to_the_picture() {
    let lab = lab();
    let slow = ["scene.txt", "-q", "-o", "a.png", "--size", "512x512", "--samples", "4", "--threads", "1"];
    let mut child = lab.command("octrender", &[&slow[..], &["--preview", "0.1"]].concat()).spawn().unwrap();
    let black = |bytes: &[u8]| {
        let image = image::load_from_memory(bytes).unwrap().to_rgb8();
        assert_eq!(image.dimensions(), (512, 512));
        image.pixels().filter(|pixel| pixel.0 == [0; 3]).count()
    };
    // Whole files, which fill up.
    let first = until("a preview", || std::fs::read(lab.path("a.png")).ok());
    let first = black(&first);
    assert!(first > 0, "it was done before the first preview");
    let fuller = until("a fuller preview", || Some(black(&lab.read("a.png"))).filter(|&black| black < first));
    assert!(fuller < first);
    assert_eq!(wait(&mut child), Some(0));
    lab.done("octrender", &[&slow[..3], &["b.png"], &slow[4..]].concat());
    assert!(lab.read("a.png") == lab.read("b.png"));
    assert!(lab.files().iter().all(|name| !name.ends_with(".tmp")), "{:?}", lab.files());
    let error = lab.fails(2, "octrender", &["scene.txt", "-o", "-", "--preview", "1"]);
    assert!(error.contains("standard output"), "{error}");
}

/// A tool that runs, and the lines that it says.
fn listen(lab: &Lab, arguments: &[&str]) -> (Child, Receiver<String>) {
    let mut child = lab.command("octrender", arguments).stderr(Stdio::piped()).spawn().unwrap();
    let (said, lines) = channel();
    let errors = BufReader::new(child.stderr.take().unwrap());
    std::thread::spawn(move || errors.lines().map_while(Result::ok).try_for_each(|line| said.send(line)));
    (child, lines)
}

/// Waits for a line that begins so; all lines up to it.
fn line(lines: &Receiver<String>, begin: &str) -> String {
    let mut all = String::new();
    loop {
        let line = lines.recv_timeout(Duration::from_secs(60)).unwrap_or_else(|e| panic!("{begin}: {e}; {all}"));
        all += &line;
        all.push('\n');
        if line.starts_with(begin) {
            return all;
        }
    }
}

#[test]
fn a_watched_scene_is_drawn_again_when_it_changes() {
    let lab = lab();
    let (mut child, lines) = listen(&lab, &["scene.txt", "-o", "a.png", "--watch"]);
    let colour = || image::load_from_memory(&lab.read("a.png")).unwrap().to_rgb8().get_pixel(0, 0).0;
    line(&lines, "watching 3 files");
    let first = colour();
    // The scene itself.
    lab.write("scene.txt", super::SCENE.replace("0.2 0.3 0.4", "0.9 0.3 0.4"));
    line(&lines, "watching");
    assert!(colour()[0] > first[0] + 50, "{first:?} {:?}", colour());
    // A file that it includes, by way of a mistake in it, which is told.
    lab.write("ball.txt", "oct ball.oct\nbackgrund 0 0 0\n");
    let told = line(&lines, "watching");
    assert!(told.contains("unknown command `backgrund`") && told.contains("ball.txt:2"), "{told}");
    lab.write("ball.txt", "oct ball.oct\nbackground 0 0 0\n");
    line(&lines, "watching");
    assert_eq!(colour(), [0; 3]);
    // A mesh that is gone, and comes back as another.
    let before = lab.read("a.png");
    std::fs::remove_file(lab.path("ball.oct")).unwrap();
    let told = line(&lines, "watching");
    assert!(told.contains("cannot open") && told.contains("ball.oct"), "{told}");
    lab.write("flat.obj", SQUARE);
    lab.done("octbuild", &["flat.obj", "-o", "ball.oct", "-q"]);
    line(&lines, "watching");
    assert!(lab.read("a.png") != before);
    signal(&child, "INT");
    assert_eq!(wait(&mut child), Some(0));
    assert!(lines.try_recv().is_err(), "nothing was drawn without a change");
}

#[test]
fn a_change_while_it_draws_stops_the_drawing() {
    let lab = lab();
    lab.write("scene.txt", format!("{}samples 10000\nresolution 4096 4096\n", super::SCENE));
    let (mut child, lines) = listen(&lab, &["scene.txt", "-o", "a.png", "--watch"]);
    std::thread::sleep(Duration::from_millis(500));
    lab.write("scene.txt", super::SCENE);
    line(&lines, "watching 3 files");
    let size = image::load_from_memory(&lab.read("a.png")).unwrap().to_rgb8().dimensions();
    assert_eq!(size, (150, 97));
    assert!(!lab.path("a.partial.png").exists());
    signal(&child, "INT");
    assert_eq!(wait(&mut child), Some(0));
    lab.fails(2, "octrender", &["-", "-o", "a.png", "--watch"]);
    lab.fails(2, "octrender", &["scene.txt", "--watch", "--shard", "0/2"]);
}
