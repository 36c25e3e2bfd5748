//! Tiles sent to a viewer: a listener that decodes tev's packets, and viewers that are absent, die or hang.
//!
//! The packets are those of tev's protocol (<https://github.com/Tom94/tev>, src/Ipc.cpp), little-endian: length, kind, and what follows.

use std::io::Read;
use std::net::{TcpListener, TcpStream};
use std::time::{Duration, Instant};

#[path = "cli_tools/support.rs"]
#[allow(dead_code, unused_macros, unused_imports)]
mod support;

use support::*;

const SCENE: &str = "\
resolution 150 97
lookat 0 1 4  0 0 0  0 1 0
background 0.2 0.3 0.4
light 3 5 4 1
oct ball.oct
";

fn lab() -> Lab {
    let lab = Lab::with_ball();
    lab.write("scene.txt", SCENE);
    lab
}

/// The bytes of a packet, taken from the front.
struct Packet(Vec<u8>);

impl Packet {
    /// The next one; nothing at the end.
    fn read(stream: &mut TcpStream) -> Option<Packet> {
        let mut length = [0; 4];
        stream.read_exact(&mut length).ok()?;
        let mut bytes = vec![0; u32::from_le_bytes(length) as usize - 4];
        stream.read_exact(&mut bytes).unwrap();
        Some(Packet(bytes))
    }

    fn take<const N: usize>(&mut self) -> [u8; N] {
        self.0.drain(..N).collect::<Vec<u8>>().try_into().unwrap()
    }

    fn byte(&mut self) -> u8 {
        self.take::<1>()[0]
    }

    fn u32(&mut self) -> u32 {
        u32::from_le_bytes(self.take())
    }

    fn u64(&mut self) -> u64 {
        u64::from_le_bytes(self.take())
    }

    fn text(&mut self) -> String {
        let end = self.0.iter().position(|&b| b == 0).unwrap();
        let text = self.0.drain(..=end).take(end).collect();
        String::from_utf8(text).unwrap()
    }
}

/// A picture as a viewer has it after all packets; which pixels it was sent, and how often.
fn view(mut stream: TcpStream) -> (String, [u32; 2], Vec<[f32; 3]>, Vec<u32>) {
    let mut create = Packet::read(&mut stream).unwrap();
    assert_eq!(create.byte(), 4, "a picture is created first");
    create.byte();
    let name = create.text();
    let [width, height, channels] = [create.u32(), create.u32(), create.u32()];
    assert_eq!((0..channels).map(|_| create.text()).collect::<Vec<_>>(), ["R", "G", "B"]);
    assert!(create.0.is_empty());
    let count = (width * height) as usize;
    let (mut pixels, mut sent) = (vec![[0.0; 3]; count], vec![0; count]);
    while let Some(mut update) = Packet::read(&mut stream) {
        assert_eq!(update.byte(), 6, "then updated");
        update.byte();
        assert_eq!((update.text(), update.u32()), (name.clone(), 3));
        let channels: Vec<String> = (0..3).map(|_| update.text()).collect();
        let axes: Vec<usize> =
            channels.iter().map(|name| ["R", "G", "B"].iter().position(|c| c == name).unwrap()).collect();
        let [x, y, w, h] = [update.u32(), update.u32(), update.u32(), update.u32()];
        let offsets: Vec<u64> = (0..3).map(|_| update.u64()).collect();
        let strides: Vec<u64> = (0..3).map(|_| update.u64()).collect();
        let data: Vec<f32> = update.0.chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().unwrap())).collect();
        for i in 0..w * h {
            let at = ((y + i / w) * width + x + i % w) as usize;
            sent[at] += 1;
            for (axis, (offset, stride)) in axes.iter().zip(offsets.iter().zip(&strides)) {
                pixels[at][*axis] = data[(offset + stride * u64::from(i)) as usize];
            }
        }
    }
    (name, [width, height], pixels, sent)
}

#[test]
fn a_viewer_has_every_pixel_at_the_end() {
    let lab = lab();
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let host = listener.local_addr().unwrap().to_string();
    let viewer = std::thread::spawn(move || view(listener.accept().unwrap().0));
    lab.done("octrender", &["scene.txt", "-o", "a.exr", "--display", &host]);
    let (name, size, pixels, sent) = viewer.join().unwrap();
    assert_eq!((name.as_str(), size), ("a.exr", [150, 97]));
    assert!(sent.iter().all(|&n| n == 1));
    let picture = image::load_from_memory(&lab.read("a.exr")).unwrap().to_rgb32f();
    assert!(picture.pixels().zip(&pixels).all(|(a, b)| a.0 == *b), "the viewer has another picture");
}

#[test]
fn a_share_sends_its_tiles() {
    let lab = lab();
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let host = listener.local_addr().unwrap().to_string();
    let viewer = std::thread::spawn(move || view(listener.accept().unwrap().0));
    lab.done("octrender", &["scene.txt", "--shard", "1/3", "--display", &host]);
    let (_, size, _, sent) = viewer.join().unwrap();
    assert_eq!(size, [150, 97]);
    let count = sent.iter().sum::<u32>();
    assert!(sent.iter().all(|&n| n <= 1) && (4000..5700).contains(&count), "{count}");
}

#[test]
fn one_that_is_absent_or_dies_is_only_a_warning() {
    let lab = lab();
    lab.done("octrender", &["scene.txt", "-o", "one.png", "-q"]);
    let warned = |host: &str, options: &[&str]| {
        let output = lab.run("octrender", &[&["scene.txt", "-o", "a.png", "--display", host], options].concat());
        assert_eq!(output.status.code(), Some(0), "{}", told(&output));
        let told = told(&output);
        assert!(told.contains("warning: the viewer at") && told.contains("going on without it"), "{told}");
    };
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let host = listener.local_addr().unwrap().to_string();
    drop(listener);
    warned(&host, &[]);
    assert!(lab.read("a.png") == lab.read("one.png"));
    warned("no such host", &[]);
    // One that hangs up after a few bytes, long before the end.
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let host = listener.local_addr().unwrap().to_string();
    let viewer = std::thread::spawn(move || listener.accept().unwrap().0.read_exact(&mut [0; 100]).unwrap());
    warned(&host, &["--size", "800x800", "--samples", "4"]);
    viewer.join().unwrap();
}

#[test]
fn one_that_hangs_does_not_hold_up_the_picture() {
    let lab = lab();
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let host = listener.local_addr().unwrap().to_string();
    let viewer = std::thread::spawn(move || listener.accept().unwrap().0);
    let start = Instant::now();
    // More than what the system keeps for a reader that does not read.
    let output = lab.run("octrender", &["scene.txt", "-o", "a.png", "--size", "1500x1500", "--display", &host]);
    assert_eq!(output.status.code(), Some(0), "{}", told(&output));
    assert!(told(&output).contains("going on without it"), "{}", told(&output));
    assert!(start.elapsed() < Duration::from_secs(60), "{:?}", start.elapsed());
    drop(viewer.join().unwrap());
}
