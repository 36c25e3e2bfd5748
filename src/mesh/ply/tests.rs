//! PLY files in every coding, against what they say.

use super::*;
use crate::mesh::{FaceBatch, NO_INDEX};

/// What a reader sent.
#[derive(Debug, Default, PartialEq)]
struct Seen {
    positions: Vec<[f32; 3]>,
    normals: Vec<[f32; 3]>,
    texcoords: Vec<[f32; 2]>,
    faces: Vec<FaceBatch>,
    too_few: u64,
    bad: u64,
}

impl MeshSink for Seen {
    fn positions(&mut self, positions: &[[f32; 3]]) -> Result<()> {
        self.positions.extend(positions);
        Ok(())
    }
    fn texcoords(&mut self, texcoords: &[[f32; 2]]) -> Result<()> {
        self.texcoords.extend(texcoords);
        Ok(())
    }
    fn normals(&mut self, normals: &[[f32; 3]]) -> Result<()> {
        self.normals.extend(normals);
        Ok(())
    }
    fn faces(&mut self, faces: &FaceBatch) -> Result<()> {
        self.faces.push(faces.clone());
        Ok(())
    }
}

/// Reads the file in blocks of several sizes, which must not matter.
fn read_with(name: &str, content: &[u8], options: ReadOptions) -> Result<Seen> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    std::fs::write(&path, content).unwrap();
    let read = |block| -> Result<Seen> {
        let mut seen = Seen::default();
        let info = crate::mesh::open(&path, &ReadOptions { block, ..options })?.read(&mut seen, Monitor::silent())?;
        (seen.too_few, seen.bad) = (info.too_few_corners, info.bad_index);
        Ok(seen)
    };
    let whole = read(1 << 20);
    for block in [1, 13] {
        match (&whole, read(block)) {
            (Ok(whole), Ok(cut)) => assert_eq!(whole, &cut),
            (Err(whole), Err(cut)) => assert_eq!(whole.to_string(), cut.to_string()),
            (whole, cut) => panic!("{whole:?} {cut:?}"),
        }
    }
    whole
}

fn read(content: &[u8]) -> Seen {
    read_with("a.ply", content, ReadOptions::default()).unwrap()
}

fn error(content: &[u8]) -> String {
    read_with("a.ply", content, ReadOptions::default()).unwrap_err().to_string()
}

const HEAD: &str = "ply\nformat CODING 1.0\ncomment made by hand\nelement vertex 5\nproperty float x\nproperty uchar red\n\
                    property float y\nproperty double z\nelement face 3\nproperty list uchar int vertex_indices\n\
                    property float quality\nelement edge 1\nproperty short a\nproperty list ushort short b\nend_header\n";

/// The vertices of the example: x, red, y, z.
const VERTICES: [(f32, u8, f32, f64); 5] =
    [(0.1, 1, -0.0, 3.5), (1e-40, 255, 7.25, 0.1), (2.0, 0, 0.3, 1e300), (3.0, 9, 0.0, -1.0), (4.0, 9, 5.0, 0.0)];
const FACES: [&[i32]; 3] = [&[0, 1, 2], &[1, 2, 3, 4], &[2, 3]];

fn binary(big: bool) -> Vec<u8> {
    macro_rules! put {
        ($out:expr, $value:expr) => {
            $out.extend(if big { $value.to_be_bytes() } else { $value.to_le_bytes() })
        };
    }
    let mut out = HEAD.replace("CODING", if big { "binary_big_endian" } else { "binary_little_endian" }).into_bytes();
    for (x, red, y, z) in VERTICES {
        put!(out, x);
        out.push(red);
        put!(out, y);
        put!(out, z);
    }
    for face in FACES {
        out.push(face.len() as u8);
        face.iter().for_each(|corner| put!(out, corner));
        put!(out, 0.5f32);
    }
    put!(out, 1i16);
    put!(out, 2u16);
    put!(out, 3i16);
    put!(out, 4i16);
    out
}

fn text() -> Vec<u8> {
    let mut out = HEAD.replace("CODING", "ascii").replace('\n', "\r\n");
    VERTICES.iter().for_each(|(x, red, y, z)| out += &format!("{x:?} {red} {y:?} {z:?}\r\n"));
    for face in FACES {
        let corners: Vec<String> = face.iter().map(ToString::to_string).collect();
        out += &format!("{} {} 0.5\n", face.len(), corners.join(" "));
    }
    (out + "1 2 3 4").into_bytes()
}

#[test]
fn every_coding_says_the_same() {
    for content in [binary(false), binary(true), text()] {
        let seen = read(&content);
        let expect: Vec<[u32; 3]> = VERTICES.iter().map(|v| [v.0, v.2, v.3 as f32].map(f32::to_bits)).collect();
        assert_eq!(seen.positions.iter().map(|p| p.map(f32::to_bits)).collect::<Vec<_>>(), expect);
        let faces = FaceBatch { sizes: vec![3, 4], corners: vec![0, 1, 2, 1, 2, 3, 4], ..Default::default() };
        assert_eq!((seen.faces, seen.too_few), (vec![faces], 1));
        assert!(seen.normals.is_empty() && seen.texcoords.is_empty());
    }
}

#[test]
fn a_file_cut_short_anywhere_is_told() {
    for content in [binary(false), text()] {
        let end = content.len() - if content.ends_with(b"4") { 1 } else { 0 };
        for cut in (0..end).step_by(3) {
            let message = error(&content[..cut]);
            let told = ["the file ends in the middle", "header", "this is not a PLY file", "makes no sense"];
            // A text may end within a number, which is then another number, or none.
            assert!(told.iter().any(|t| message.contains(t)) || message.contains("not a number"), "{cut}: {message}");
        }
    }
}

#[test]
fn normals_texture_coordinates_and_origin() {
    let content = "ply\nformat ascii 1.0\nelement face 1\nproperty list uchar uint vertex_index\nelement vertex 3\n\
                   property double x\nproperty double y\nproperty double z\nproperty float nx\nproperty float ny\n\
                   property float nz\nproperty float s\nproperty float t\nend_header\n3 0 1 2\n\
                   5000000.125 0 0 0 0 1 .25 .5\n5000001 0 0 0 1 0 1 1\n5000000 1 0 1 0 0 0 0\n";
    let options = ReadOptions { origin: [5e6, 0.0, 0.0], ..Default::default() };
    let seen = read_with("a.ply", content.as_bytes(), options).unwrap();
    assert_eq!(seen.positions, [[0.125, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
    assert_eq!((seen.normals.len(), seen.texcoords[0]), (3, [0.25, 0.5]));
    assert_eq!((&seen.faces[0].normals, &seen.faces[0].texcoords), (&vec![0, 1, 2], &vec![0, 1, 2]));
    assert!(seen.faces[0].corners.iter().all(|&corner| corner != NO_INDEX));
}

#[test]
fn strips_turn_every_other_triangle() {
    let content = "ply\nformat ascii 1.0\nelement vertex 5\nproperty int x\nproperty int y\nproperty int z\n\
                   element tristrips 1\nproperty list int int vertex_indices\nend_header\n\
                   0 0 0\n1 0 0\n0 1 0\n1 1 0\n2 2 2\n8 0 1 2 3 -1 4 3 2\n";
    assert_eq!(read(content.as_bytes()).faces[0].corners, [0, 1, 2, 2, 1, 3, 4, 3, 2]);
}

#[test]
fn wrong_numbers_are_refused_or_skipped() {
    let content = |face: &str| {
        format!(
            "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nelement face 2\n\
             property list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n{face}\n3 0 1 2\n"
        )
    };
    assert!(error(content("4 0 1 2 3").as_bytes()).contains("item 0 of `face` names vertex 3, but there are 3"));
    assert!(error(content("3 0 1 -1").as_bytes()).contains("names vertex -1"));
    assert!(error(content("3 0 x 1").as_bytes()).contains("`x` is not a number"));
    assert!(error(content("-3").as_bytes()).contains("list of -3 numbers"));
    let lenient = ReadOptions { lenient: true, ..Default::default() };
    let seen = read_with("a.ply", content("4 0 1 2 3").as_bytes(), lenient).unwrap();
    assert_eq!(
        (&seen.faces[0].sizes, &seen.faces[0].corners, seen.bad),
        (&vec![FaceBatch::GAP | 2, 3], &vec![0, 1, 2], 2)
    );
    assert!(error(b"solid x").contains("not a PLY file"));
    assert!(error(b"ply\nformat ascii 1.0\nelement vertex x\nend_header\n").contains("line 3 of the header"));
    assert!(error(b"ply\nelement vertex 0\nend_header\n").contains("names no format"));
}

/// A binary STL of so many triangles.
fn stl(count: u32) -> Vec<u8> {
    let mut out = vec![b' '; 80];
    out[..5].copy_from_slice(b"solid");
    out.extend(count.to_le_bytes());
    for i in 0..count {
        (0..12).for_each(|k| out.extend((i as f32 + k as f32 * 0.25).to_le_bytes()));
        out.extend([0; 2]);
    }
    out
}

#[test]
fn both_kinds_of_stl() {
    let seen = read_with("a.stl", &stl(3), ReadOptions::default()).unwrap();
    assert_eq!(seen.positions.len(), 9);
    assert_eq!((seen.positions[0], seen.positions[8]), ([0.75, 1.0, 1.25], [4.25, 4.5, 4.75]));
    assert_eq!(seen.faces, [FaceBatch { corners: (0..9).collect(), ..Default::default() }]);
    let text = b"solid two words\nfacet normal 0 0 1\n outer loop\n  vertex 0 0 0\n  vertex 1e0 0 0\n  vertex 0 .5 0\n \
                 endloop\nendfacet\nfacet normal 0 0 1\nouter loop\nvertex 1 2 3\nvertex 4 5 6\nvertex 7 8 9\nvertex 1 1 1\n\
                 endloop\nendfacet\nendsolid\n";
    let seen = read_with("a.stl", text, ReadOptions::default()).unwrap();
    assert_eq!((seen.positions[2], seen.positions.len()), ([0.0, 0.5, 0.0], 7));
    assert_eq!(seen.faces, [FaceBatch { sizes: vec![3, 4], corners: (0..7).collect(), ..Default::default() }]);
}

#[test]
fn stl_that_is_cut_short_or_wrong_is_told() {
    let error = |content: &[u8]| read_with("a.stl", content, ReadOptions::default()).unwrap_err().to_string();
    assert!(error(&stl(3)[..150]).contains("1 of 3 triangles are there"));
    assert!(error(b"solid\n").contains("shorter than the head"));
    assert!(error(b"solid\nfacet\nouter loop\nvertex 1 2\n").contains("line 4: not three numbers"));
    assert!(error(b"solid\nfacet normal 0 0 1\nouter loop\nvertex 1 2 3\n").contains("endsolid is missing"));
}

#[test]
fn compressed_ply_is_unpacked() {
    let packed = zstd::encode_all(&binary(false)[..], 3).unwrap();
    assert_eq!(read_with("a.ply.zst", &packed, ReadOptions::default()).unwrap(), read(&binary(false)));
}

#[test]
fn items_without_properties_take_no_time() {
    let text = "ply\nformat ascii 1.0\nelement junk 1000000000000000000\nelement vertex 3\nproperty float x\n\
                property float y\nproperty float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n\
                0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n";
    assert_eq!(read(text.as_bytes()).faces[0].corners, [0, 1, 2]);
}
