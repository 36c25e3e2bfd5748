//! What inputs are made from: small whole files of every kind, and the words that mean something in them.

use std::path::Path;

use octrace::Monitor;
use octrace::build::{BuildOptions, Positions};
use octrace::format::SplitMode;
use octrace::mesh::ReadOptions;

use super::random::Random;
use super::{oct, text};

/// A bumpy sheet of 2 n^2 triangles as OBJ, with normals, texture coordinates and materials.
pub fn sheet(n: usize) -> String {
    let mut text = String::from("mtllib sheet.mtl\n");
    for i in 0..=n {
        for j in 0..=n {
            let [x, y] = [i, j].map(|k| k as f32 / n as f32);
            let z = 0.1 * ((9.0 * x).sin() + (7.0 * y).cos());
            text += &format!("v {x} {y} {z}\nvn {} {} 1\nvt {x} {y}\n", -0.9 * (9.0 * x).cos(), 0.7 * (7.0 * y).sin());
        }
    }
    for i in 0..n {
        text += if i % 3 == 0 { "usemtl red\n" } else { "usemtl glass\n" };
        for j in 0..n {
            let at = |i: usize, j: usize| i * (n + 1) + j + 1;
            let (a, b, c, d) = (at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1));
            text += &format!("f {a}/{a}/{a} {b}/{b}/{b} {c}/{c}/{c}\nf {a}/{a} {c}/{c} {d}/{d}\n");
        }
    }
    text
}

const OBJS: [&str; 4] = [
    "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 3 4\nf -4 -3 -1\nf 2 3 4 1\n",
    "o a\ng b c\ns 1\nv 0 0 0 1\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv .5 .5 1e-3\nvt 0 0\nvt 1 0 0\nvn 0 0 1\nf 1/1/1 2/2/1 \\\n3/1/1 4//1\nusemtl x\nf 1//1 2//1 5//1\n",
    "mtllib a.mtl b.mtl\nv 1e10 1e10 1e10\nv 1e10 2e10 1e10\nv 2e10 1e10 1e10\nf 1 2 3 # one\n\nl 1 2\np 1\nf 1 2 3 1 2\n",
    "v -1 -1 0\nv 3 -1 0\nv 3 3 0\nv 1 0.5 0\nv -1 3 0\nf 1 2 3 4 5\nf 5 4 3 2 1\nf 1 1 2\nf 1 2\n",
];
const MTL: &str = "newmtl red\nKa 1 0 0\nKd .8 .1 .1\nKs 1 1 1\nNs 30\nd 1\nillum 2\nmap_Kd no_such.png\nnewmtl glass\nKd 0 0 0\nNi 1.5\nd 0.2\nTr .8\nillum 7\n";
const PLY: &str = "ply\nformat ascii 1.0\ncomment x\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\nproperty uchar red\nelement face 3\nproperty list uchar int vertex_indices\nend_header\n0 0 0 1\n1 0 0 2\n0 1 0 3\n0 0 1 4\n3 0 1 2\n3 0 2 3\n4 0 1 2 3\n";
const STL: &str = "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid a\n";
const SCENES: [&str; 4] = [
    include_str!("../../scenes/classic.txt"),
    include_str!("../../scenes/glass.txt"),
    "resolution 20 10\nlookat 0 1 5  0 0 0  0 1 0\nfov 40\nbackground .1 .2 .3\namblight .1\nlight 3 5 8 1\nsun -1 -2 -1 .4 .4 .3\nmat diff .8 .3 .2\nmat spec 1 1 1\nshin 20\nreflect .4\nlocal .6\nsphere 0 0 0 1\nplane 0 -1 0 0 1 0\nrectangle -1 -1 -2  2 0 0  0 2 0\ntriangle 0 0 1  1 0 1  0 1 1\npush\ntranslate 1 0 0\nrotate 30 0 1 0\nscale 1 2 1\nsphere 0 0 0 .5\npop\ntransmit .8 1.5\nsphere 0 0 0 .4\n",
    "frame -.2 -.4 -1\ndepth 8\nsamples 4\ntonemap srgb\noct off\noct 1.oct\noct\nsmooth on\nmtl on\nobj model.obj\ninclude other.txt\nmat save a\nmat load a\noutput x.png\noutsize 9\n",
];

const OBJ_WORDS: [&str; 16] =
    ["v", "vt", "vn", "f", "usemtl", "mtllib", "o", "g", "s", "l", "p", "call", "vp", "#", "f 1 2 3", "v 0 0"];
const MTL_WORDS: [&str; 12] =
    ["newmtl", "Ka", "Kd", "Ks", "Ns", "Ni", "d", "Tr", "illum", "map_Kd", "map_Kd -s 1 1 1 a.png", "bump"];
const PLY_WORDS: [&str; 16] = [
    "element",
    "vertex",
    "face",
    "property",
    "list",
    "uchar",
    "int",
    "double",
    "float",
    "format",
    "binary_little_endian",
    "binary_big_endian",
    "ascii",
    "end_header",
    "uint64",
    "comment",
];
const STL_WORDS: [&str; 7] = ["solid", "facet", "normal", "vertex", "outer", "endloop", "endsolid"];
const SCENE_WORDS: [&str; 42] = [
    "output",
    "outsize",
    "background",
    "resolution",
    "samples",
    "depth",
    "tonemap",
    "eye",
    "origin",
    "horiz",
    "vert",
    "lookat",
    "fov",
    "frame",
    "color",
    "mat",
    "amb",
    "diff",
    "spec",
    "save",
    "load",
    "local",
    "reflect",
    "transmit",
    "shin",
    "amblight",
    "light",
    "sun",
    "sphere",
    "triangle",
    "rectangle",
    "plane",
    "obj",
    "oct",
    "mtl",
    "smooth",
    "push",
    "pop",
    "translate",
    "scale",
    "rotate",
    "include",
];

/// Seeds of each kind.
pub struct Seeds {
    octs: Vec<Vec<u8>>,
    pictures: Vec<Vec<u8>>,
}

impl Seeds {
    /// Makes them in a folder.
    pub fn new(folder: &Path) -> Seeds {
        let octs = octs(folder, 16, 70);
        std::fs::write(folder.join("model.obj"), OBJS[0]).unwrap();
        std::fs::write(folder.join("other.txt"), "sphere 0 0 0 1\nmat diff 1 0 0\noct 0.oct\n").unwrap();
        Seeds { pictures: pictures(), octs }
    }

    /// What the inputs of a target are made from, as far as it is stored whole, and small octree files beside it.
    pub fn whole(&self, target: &str, folder: &Path) -> Vec<Vec<u8>> {
        let texts = |all: &[&str]| all.iter().map(|text| text.as_bytes().to_vec()).collect();
        match target {
            "obj" => texts(&OBJS),
            "mtl" => texts(&[MTL]),
            "ply" => texts(&[PLY]),
            "stl" => texts(&[STL]),
            "scene" => texts(&SCENES),
            "texture" => self.pictures.clone(),
            "oct" => octs(folder, 4, 8),
            _ => Vec::new(),
        }
    }

    /// The input of that number for a target: the same for ever.
    pub fn input(&self, target: &str, number: u64) -> Vec<u8> {
        let name = target.bytes().fold(0, |sum, byte| 31 * sum + u64::from(byte));
        let mut random = Random(number.wrapping_mul(0x2545_f491_4f6c_dd1d) ^ name);
        random.bits();
        let text = |seed: &str, words: &[&str], random: &mut Random| {
            let mut text = seed.as_bytes().to_vec();
            text::mutate(&mut text, words, random);
            text
        };
        match target {
            "obj" => {
                let seed = *random.one_of(&OBJS);
                text(seed, &OBJ_WORDS, &mut random)
            }
            "archive" => {
                let seed = *random.one_of(&OBJS);
                let text = text(seed, &OBJ_WORDS, &mut random);
                archive(&text, &mut random)
            }
            "texture" => {
                let mut picture = random.one_of(&self.pictures).clone();
                spoil_picture(&mut picture, &mut random);
                picture
            }
            "mtl" => text(MTL, &MTL_WORDS, &mut random),
            "ply" if random.once_in(2) => binary_ply(&mut random),
            "ply" => text(PLY, &PLY_WORDS, &mut random),
            "stl" if random.once_in(2) => binary_stl(&mut random),
            "stl" => text(STL, &STL_WORDS, &mut random),
            "scene" => {
                let seed = *random.one_of(&SCENES);
                text(seed, &SCENE_WORDS, &mut random)
            }
            "oct" => {
                let mut file = random.one_of(&self.octs).clone();
                oct::mutate(&mut file, &mut random);
                file
            }
            "resume" => super::resume::recipe(&mut random),
            _ => rays(&mut random),
        }
    }
}

/// The words that mean something to a target that reads text, for a dictionary; none for the others.
pub fn words(target: &str) -> &'static [&'static str] {
    match target {
        "obj" => &OBJ_WORDS,
        "mtl" => &MTL_WORDS,
        "ply" => &PLY_WORDS,
        "stl" => &STL_WORDS,
        "scene" => &SCENE_WORDS,
        _ => &[],
    }
}

/// Octree files of a sheet of 2 n^2 triangles, `brick` to a page: one of each kind. They are in the folder afterwards, with their meshes.
fn octs(folder: &Path, n: usize, brick: u32) -> Vec<Vec<u8>> {
    let obj = folder.join("sheet.obj");
    std::fs::write(&obj, sheet(n)).unwrap();
    std::fs::write(folder.join("sheet.mtl"), MTL).unwrap();
    let plain = folder.join("plain.obj");
    let bare: String = sheet(n).lines().filter(|l| l.starts_with("v ") || l.starts_with('f')).map(bare).collect();
    std::fs::write(&plain, bare).unwrap();
    let base = BuildOptions { brick: Some(brick), ..BuildOptions::default() };
    let all = [
        (&obj, base.clone()),
        (&plain, base.clone()),
        (&plain, BuildOptions { ids: false, ..base.clone() }),
        (&plain, BuildOptions { positions: Positions::Grid(None), ..base.clone() }),
        (&plain, BuildOptions { split: SplitMode::Strict, cell: 4, ..base.clone() }),
        (&plain, BuildOptions { split: SplitMode::Octree, brick: None, ..base.clone() }),
        (&obj, BuildOptions { compress: Some(3), ..base.clone() }),
        (&plain, BuildOptions { brick: Some(10), ..base }),
    ];
    let build = |(i, (mesh, options)): (usize, (&std::path::PathBuf, BuildOptions))| {
        let oct = folder.join(format!("{i}.oct"));
        let mut source = octrace::mesh::open(mesh, &ReadOptions::default()).unwrap();
        octrace::build::build(source.as_mut(), &oct, &options, Monitor::silent()).unwrap();
        std::fs::read(&oct).unwrap()
    };
    all.into_iter().enumerate().map(build).collect()
}

/// A line of OBJ without all but positions.
fn bare(line: &str) -> String {
    let words = line.split(' ').map(|word| word.split('/').next().unwrap_or(""));
    words.collect::<Vec<_>>().join(" ") + "\n"
}

/// Changes some bytes.
fn spoil(bytes: &mut Vec<u8>, random: &mut Random) {
    for _ in 0..random.below(6) {
        let at = random.below(bytes.len());
        match random.below(5) {
            0 if random.once_in(3) => bytes.truncate(at.max(1)),
            1 => bytes[at] = *random.one_of(&[0, 1, 0x7f, 0x80, 0xff]),
            2 => bytes.insert(at, random.bits() as u8),
            _ => bytes[at] ^= 1 << random.below(8),
        }
    }
}

/// A text compressed in one to three pieces, which readers take one after the other, and spoiled in one case of two.
fn archive(text: &[u8], random: &mut Random) -> Vec<u8> {
    use std::io::Write;
    let (gzip, mut bytes) = (random.once_in(2), Vec::new());
    for piece in text.chunks((text.len() / (1 + random.below(3))).max(1)) {
        if gzip {
            let mut encoder =
                flate2::write::GzEncoder::new(&mut bytes, flate2::Compression::new(random.below(10) as u32));
            encoder.write_all(piece).unwrap();
            encoder.finish().unwrap();
        } else {
            let mut encoder = zstd::stream::write::Encoder::new(&mut bytes, 1 + random.below(3) as i32).unwrap();
            encoder.include_checksum(random.once_in(2)).unwrap();
            encoder.write_all(piece).unwrap();
            encoder.finish().unwrap();
        }
    }
    if random.once_in(2) && !bytes.is_empty() {
        spoil(&mut bytes, random);
    }
    bytes
}

/// A small picture in every format that is read.
fn pictures() -> Vec<Vec<u8>> {
    use image::{DynamicImage, ImageFormat, Rgb, RgbImage};
    let rgb = DynamicImage::from(RgbImage::from_fn(9, 7, |x, y| Rgb([(20 * x) as u8, (30 * y) as u8, (x * y) as u8])));
    let (grey, deep) = (DynamicImage::from(rgb.to_luma8()), DynamicImage::from(rgb.to_rgba16()));
    let floats = DynamicImage::from(rgb.to_rgb32f());
    let all = [
        (&rgb, ImageFormat::Png),
        (&deep, ImageFormat::Png),
        (&grey, ImageFormat::Png),
        (&rgb, ImageFormat::Jpeg),
        (&grey, ImageFormat::Jpeg),
        (&rgb, ImageFormat::Bmp),
        (&rgb, ImageFormat::Tga),
        (&rgb, ImageFormat::Tiff),
        (&deep, ImageFormat::Tiff),
        (&floats, ImageFormat::Hdr),
        (&floats, ImageFormat::OpenExr),
    ];
    let encode = |(picture, format): (&DynamicImage, ImageFormat)| {
        let mut bytes = std::io::Cursor::new(Vec::new());
        picture.write_to(&mut bytes, format).unwrap();
        bytes.into_inner()
    };
    all.into_iter().map(encode).collect()
}

/// Changes bytes and whole fields; in one case of two a PNG gets its checksums made right again.
fn spoil_picture(bytes: &mut Vec<u8>, random: &mut Random) {
    for _ in 0..random.below(4) {
        let (at, size) = (random.below(bytes.len().min(200)), 1 << random.below(3));
        let field =
            random.one_of(&[0u32, 1, 2, 0x7f, 0xff, 0x7fff, 0x8000, 0xffff, 0x7fff_ffff, u32::MAX]).to_le_bytes();
        if let Some(place) = bytes.get_mut(at..at + size) {
            place.copy_from_slice(&field[..size]);
            if random.once_in(2) {
                place.reverse();
            }
        }
    }
    spoil(bytes, random);
    if !random.once_in(2) {
        repair_png(bytes);
    }
}

/// Makes the checksums of a PNG's chunks right; other formats stay as they are.
pub fn repair_png(bytes: &mut [u8]) {
    if !bytes.starts_with(b"\x89PNG") {
        return;
    }
    let mut at: usize = 8;
    while let Some(length) = bytes.get(at..at.saturating_add(4)).map(|b| u32::from_be_bytes(b.try_into().unwrap())) {
        let end = at + 8 + length as usize;
        let Some(sum) = bytes.get(at + 4..end).map(|chunk| {
            let mut crc = flate2::Crc::new();
            crc.update(chunk);
            crc.sum()
        }) else {
            break;
        };
        if let Some(place) = bytes.get_mut(end..end + 4) {
            place.copy_from_slice(&sum.to_be_bytes());
        }
        at = end + 4;
    }
}

fn binary_ply(random: &mut Random) -> Vec<u8> {
    let big = random.once_in(2);
    let order = if big { "big" } else { "little" };
    let mut bytes = format!(
        "ply\nformat binary_{order}_endian 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
         element face 2\nproperty list uchar uint vertex_indices\nend_header\n"
    )
    .into_bytes();
    let word = |x: u32| if big { x.to_be_bytes() } else { x.to_le_bytes() };
    for x in [0.0f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0] {
        bytes.extend(word(x.to_bits()));
    }
    for face in [[0, 1, 2], [1, 2, 3]] {
        bytes.push(3);
        face.iter().for_each(|&i| bytes.extend(word(i)));
    }
    spoil(&mut bytes, random);
    bytes
}

fn binary_stl(random: &mut Random) -> Vec<u8> {
    let mut bytes = vec![b' '; 80];
    let count = random.below(4) as u32;
    bytes.extend(count.to_le_bytes());
    for _ in 0..count {
        (0..12).for_each(|_| bytes.extend((random.below(5) as f32).to_le_bytes()));
        bytes.extend([0; 2]);
    }
    spoil(&mut bytes, random);
    bytes
}

fn rays(random: &mut Random) -> Vec<u8> {
    let count = 1 + random.below(40);
    let odd = [0.0f32, -0.0, 1.0, -1.0, f32::INFINITY, f32::NEG_INFINITY, f32::NAN, 1e-45, f32::MAX, 1e-38, 0.5, 1e20];
    let mut bytes = Vec::new();
    for _ in 0..count {
        for i in 0..8 {
            let x = match random.below(6) {
                0 => *random.one_of(&odd),
                1 => f32::from_bits(random.bits() as u32),
                _ if i == 6 => 0.0,
                _ if i == 7 => f32::INFINITY,
                _ => (random.bits() >> 40) as f32 / 16_777_216.0 * 3.0 - 1.0,
            };
            bytes.extend(x.to_le_bytes());
        }
    }
    bytes
}
