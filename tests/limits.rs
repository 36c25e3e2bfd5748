//! What is small and asks for much: bombs, scenes without end, pictures beyond all measure. Each is refused with the limit named, or done
//! within the memory allowed. SECURITY.md has the table of limits.

#[path = "cli_tools/support.rs"]
#[allow(dead_code, unused_macros, unused_imports)]
mod support;

use std::io::Write;

use octrace::scene::ToneMap;
use octrace::shade::Texture;
use support::*;

const TRIANGLE: &str = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";
/// Bytes that a bomb becomes; more than the memory allowed.
const BURST: usize = 96 << 20;
const MEMORY: [&str; 4] = ["-o", "a.oct", "--memory", "64M"];

/// `BURST` bytes of a text again and again, then a triangle, as gzip.
fn gzip_bomb(text: &[u8]) -> Vec<u8> {
    let piece = text.repeat((1 << 16) / text.len());
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::new(1));
    for _ in 0..BURST / piece.len() {
        encoder.write_all(&piece).unwrap();
    }
    encoder.write_all(TRIANGLE.as_bytes()).unwrap();
    encoder.finish().unwrap()
}

/// The same as zstd.
fn zstd_bomb(text: &[u8]) -> Vec<u8> {
    let piece = text.repeat((1 << 16) / text.len());
    let mut encoder = zstd::stream::Encoder::new(Vec::new(), 1).unwrap();
    for _ in 0..BURST / piece.len() {
        encoder.write_all(&piece).unwrap();
    }
    encoder.write_all(TRIANGLE.as_bytes()).unwrap();
    encoder.finish().unwrap()
}

#[test]
fn compressed_text_that_becomes_much_stays_within_the_memory() {
    let lab = Lab::new();
    for (name, bytes) in [("a.obj.gz", gzip_bomb(b"# nothing\n")), ("a.obj.zst", zstd_bomb(b"# nothing\n"))] {
        assert!(bytes.len() < BURST / 100, "{name} is no bomb: {} bytes", bytes.len());
        lab.write(name, bytes);
        lab.done("octbuild", &[&[name], &MEMORY[..], &["--stats", "s.json", "-q"]].concat());
        let stats = lab.json("s.json");
        assert_eq!(stats["triangles"], 1);
        assert!(stats["peak_rss_bytes"].as_u64().unwrap() <= 64 << 20, "{name}: {}", stats["peak_rss_bytes"]);
    }
}

#[test]
fn compressed_lines_without_end_and_zeros_are_refused() {
    let lab = Lab::new();
    lab.write("line.obj.gz", gzip_bomb(b"v 0 0 0 "));
    lab.write("line.obj.zst", zstd_bomb(b"v 0 0 0 "));
    lab.write("zero.obj.gz", gzip_bomb(&[0]));
    for (name, said) in [("line.obj.gz", "longer than"), ("line.obj.zst", "longer than"), ("zero.obj.gz", "NUL bytes")]
    {
        let error = lab.fails(2, "octbuild", &[&[name], &MEMORY[..]].concat());
        assert!(error.contains(name) && error.contains(said), "{error}");
    }
    assert!(!lab.path("a.oct").exists());
}

/// A zstd frame (RFC 8878, 3.1.1) of one raw block that asks for a window of 2^`log` bytes.
fn frame(log: u8, text: &[u8]) -> Vec<u8> {
    let block = (text.len() as u32) << 3 | 1;
    [&[0x28, 0xb5, 0x2f, 0xfd, 0, (log - 10) << 3][..], &block.to_le_bytes()[..3], text].concat()
}

#[test]
fn zstd_that_refers_back_beyond_the_memory_is_refused() {
    let lab = Lab::new();
    for (log, memory, taken) in [(23, "64M", true), (27, "64M", false), (27, "1G", true), (31, "1G", false)] {
        lab.write("a.obj.zst", frame(log, TRIANGLE.as_bytes()));
        let line = ["a.obj.zst", "-o", "a.oct", "-q", "--memory", memory];
        if taken {
            lab.done("octbuild", &line);
        } else {
            let error = lab.fails(2, "octbuild", &line);
            assert!(error.contains("a.obj.zst: the zstd data was packed with a window"), "{error}");
            assert!(error.contains("allow more"), "{error}");
        }
    }
}

/// A PNG of that size, grey, with hardly any data.
fn png(width: u32, height: u32) -> Vec<u8> {
    let mut bytes = b"\x89PNG\r\n\x1a\n".to_vec();
    let mut chunk = |kind: &[u8; 4], data: &[u8]| {
        let body = [&kind[..], data].concat();
        let mut crc = flate2::Crc::new();
        crc.update(&body);
        bytes.extend((data.len() as u32).to_be_bytes());
        bytes.extend(&body);
        bytes.extend(crc.sum().to_be_bytes());
    };
    chunk(b"IHDR", &[&width.to_be_bytes()[..], &height.to_be_bytes(), &[8, 0, 0, 0, 0]].concat());
    let mut packed = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::fast());
    packed.write_all(&[0; 100]).unwrap();
    chunk(b"IDAT", &packed.finish().unwrap());
    chunk(b"IEND", &[]);
    bytes
}

/// A JPEG whose header says 65535 x 65535.
fn jpeg() -> Vec<u8> {
    let mut bytes = std::io::Cursor::new(Vec::new());
    image::DynamicImage::new_rgb8(8, 8).write_to(&mut bytes, image::ImageFormat::Jpeg).unwrap();
    let mut bytes = bytes.into_inner();
    let frame = bytes.windows(2).position(|pair| pair == [0xff, 0xc0]).unwrap();
    bytes[frame + 5..frame + 9].fill(0xff);
    bytes
}

#[test]
fn textures_beyond_the_limits_are_refused_before_they_are_decoded() {
    let folder = tempfile::tempdir().unwrap();
    for (bytes, said) in [
        (png(40_000, 2), "40000 x 2 pixels (80000 bytes) are too many: at most 32768 on a side"),
        (png(32_768, 32_768), "32768 x 32768 pixels"),
        (png(u32::MAX >> 1, u32::MAX >> 1), ""),
        (jpeg(), "65535 x 65535 pixels"),
    ] {
        let path = folder.path().join("t.png");
        std::fs::write(&path, bytes).unwrap();
        let error = Texture::open(&path, ToneMap::None).unwrap_err().to_string();
        assert!(error.contains("t.png: texture: ") && error.contains(said), "{error}");
    }
}

#[test]
fn many_materials_share_one_texture() {
    let lab = Lab::new();
    image::RgbImage::new(2048, 2048).save(lab.path("t.png")).unwrap();
    let (mut mtl, mut obj) = (String::new(), String::from("mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\n"));
    for i in 0..400 {
        mtl += &format!("newmtl m{i}\nmap_Kd t.png\n");
        obj += &format!("usemtl m{i}\nf 1/1 2/1 3/1\n");
    }
    lab.write("a.mtl", mtl);
    lab.write("a.obj", obj);
    lab.done("octbuild", &["a.obj", "-o", "a.oct", "-q"]);
    lab.done("octrender", &["a.oct", "--size", "8x8", "-q", "--stats", "s.json"]);
    // 12 MiB of it, not 5 GiB.
    assert!(lab.json("s.json")["peak_rss_bytes"].as_u64().unwrap() < 200 << 20, "{}", lab.text("s.json"));
}

#[test]
fn scenes_without_end_are_refused() {
    let lab = Lab::new();
    lab.write("self.txt", "include self.txt\n");
    lab.write("a.txt", "include b.txt\n");
    lab.write("b.txt", "sphere 0 0 0 1\ninclude a.txt\n");
    for i in 0..40 {
        lab.write(&format!("deep{i}.txt"), format!("include deep{}.txt\n", i + 1));
    }
    lab.write("many.txt", "depth 5\n".repeat(1_000_001));
    // What doubles at each level is stopped by the sum, not by the depth.
    for i in 0..30 {
        lab.write(&format!("twice{i}.txt"), format!("include twice{0}.txt\ninclude twice{0}.txt\n", i + 1));
    }
    lab.write("twice30.txt", "depth 5\n".repeat(100));
    std::fs::File::create(lab.path("large.txt")).unwrap().set_len((256 << 20) + 1).unwrap();
    for (scene, said) in [
        ("self.txt", "this file includes itself"),
        ("a.txt", "this file includes itself"),
        ("deep0.txt", "files include each other at most 32 deep"),
        ("many.txt", "a scene has at most 1000000 commands"),
        ("twice0.txt", "a scene has at most 1000000 commands"),
        ("large.txt", "has at most 268435456 bytes"),
    ] {
        let error = lab.fails(2, "octrender", &[scene, "-o", "a.png"]);
        assert!(error.contains(said), "{scene}: {error}");
    }
    assert!(!lab.path("a.png").exists());
}

#[test]
fn pictures_beyond_all_measure_are_refused() {
    let lab = Lab::with_ball();
    for (line, said) in [
        ("resolution 65537 2", "the width must be a whole number from 1 to 65536"),
        ("resolution 65536 65536", "at most 2147483648 pixels"),
        ("outsize 99999999999 1", "from 1 to 65536"),
        ("samples 66049", "from 1 to 65536"),
        ("depth 10001", "from 0 to 10000"),
        ("depth 1e9", "from 0 to 10000"),
    ] {
        lab.write("scene.txt", format!("{line}\nsphere 0 0 0 1\n"));
        let error = lab.fails(2, "octrender", &["scene.txt", "-o", "a.png"]);
        assert!(error.contains(said), "{line}: {error}");
    }
    for (flags, said) in [
        (["--size", "65535x65535"], "at most 2147483648"),
        (["--size", "65537x2"], "from 1 to 65536"),
        (["--samples", "66049"], "up to 65536"),
        (["--samples", "5"], "must be a square"),
        (["--depth", "10001"], "at most 10000"),
        (["--depth", "4294967296"], "4294967296"),
        (["--threads", "100000"], "1024"),
        (["--memory", "1M"], "the least is"),
    ] {
        let error = lab.fails(2, "octrender", &[&["ball.oct", "-o", "a.png"], &flags[..]].concat());
        assert!(error.contains(said), "{flags:?}: {error}");
        let memory = ["--memory", "256M"];
        if flags[0] != "--memory" {
            let error = lab.fails(2, "octrender", &[&["ball.oct", "-o", "a.png"], &flags[..], &memory].concat());
            assert!(error.contains(said), "{flags:?} within memory: {error}");
        }
    }
    assert!(!lab.path("a.png").exists());
}
