//! The OBJ reader against the crate tobj, on odd files and on real meshes, and against itself on random meshes printed
//! in random styles.
//!
//! Set `OCTRACE_DATA` to a folder with larger meshes to have these compared too.

use std::fs;
use std::io::{Cursor, Read, Write};
use std::path::{Path, PathBuf};

use octrace::mesh::{self, FaceBatch, MeshSink, NO_INDEX, ReadOptions, SourceInfo};
use octrace::{Monitor, Result};
use proptest::prelude::*;

/// A mesh in memory: bits of the positions, and for each face its corners (position, texture coordinate, normal).
#[derive(Debug, Default, PartialEq)]
struct Mesh {
    positions: Vec<[u32; 3]>,
    faces: Vec<Vec<[Option<u32>; 3]>>,
}

impl MeshSink for Mesh {
    fn positions(&mut self, positions: &[[f32; 3]]) -> Result<()> {
        self.positions.extend(positions.iter().map(|position| position.map(f32::to_bits)));
        Ok(())
    }

    fn texcoords(&mut self, _: &[[f32; 2]]) -> Result<()> {
        Ok(())
    }

    fn normals(&mut self, _: &[[f32; 3]]) -> Result<()> {
        Ok(())
    }

    fn faces(&mut self, batch: &FaceBatch) -> Result<()> {
        let triangles = vec![3; batch.corners.len() / 3];
        let sizes = if batch.sizes.is_empty() { &triangles } else { &batch.sizes };
        let index = |array: &[u32], at: usize| array.get(at).copied().filter(|&index| index != NO_INDEX);
        let mut at = 0;
        for &size in sizes {
            let range = at..at + size as usize;
            at = range.end;
            let corner = |at| [index(&batch.corners, at), index(&batch.texcoords, at), index(&batch.normals, at)];
            self.faces.push(range.map(corner).collect());
        }
        assert_eq!(at, batch.corners.len());
        Ok(())
    }
}

fn read(path: &Path, block: usize) -> (Mesh, SourceInfo) {
    let options = ReadOptions { block, ..Default::default() };
    let mut mesh = Mesh::default();
    let info = mesh::open(path, &options).unwrap().read(&mut mesh, Monitor::silent()).unwrap();
    (mesh, info)
}

/// What tobj makes of the same text: positions of the whole file as it reads them, faces as they are.
///
/// tobj gives every model vertices of its own; compared are therefore the positions of the corners.
fn by_tobj(text: &[u8]) -> Vec<Vec<[u32; 3]>> {
    let options = tobj::LoadOptions { ignore_points: true, ignore_lines: true, ..Default::default() };
    let none = |_: &Path| Ok(Default::default());
    let (models, _) = tobj::load_obj_buf(&mut Cursor::new(text), &options, none).unwrap();
    let mut faces = Vec::new();
    for tobj::Model { mesh, .. } in &models {
        let position = |&index: &u32| -> [u32; 3] {
            std::array::from_fn(|axis| mesh.positions[3 * index as usize + axis].to_bits())
        };
        let triangles = vec![3; mesh.indices.len() / 3];
        let sizes = if mesh.face_arities.is_empty() { &triangles } else { &mesh.face_arities };
        let mut at = 0;
        for &size in sizes {
            faces.push(mesh.indices[at..at + size as usize].iter().map(position).collect());
            at += size as usize;
        }
    }
    faces
}

fn assert_same_as_tobj(path: &Path) {
    let mut text = fs::read(path).unwrap();
    if path.extension().is_some_and(|suffix| suffix == "zst") {
        let packed = std::mem::take(&mut text);
        zstd::Decoder::new(&packed[..]).unwrap().read_to_end(&mut text).unwrap();
    }
    let expect = by_tobj(&text);
    assert!(!expect.is_empty(), "{}", path.display());
    for block in [8 << 20, 10_000] {
        let (mesh, _) = read(path, block);
        let position = |corner: &[Option<u32>; 3]| mesh.positions[corner[0].unwrap() as usize];
        let found: Vec<Vec<_>> = mesh.faces.iter().map(|face| face.iter().map(position).collect()).collect();
        assert_eq!(found.len(), expect.len(), "{}", path.display());
        let differs = found.iter().zip(&expect).position(|(found, expect)| found != expect);
        assert_eq!(differs, None, "{}: first face that differs", path.display());
    }
}

fn small(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/obj").join(name)
}

#[test]
fn odd_files_read_as_tobj_reads_them() {
    for name in ["styles.obj", "crlf.obj"] {
        assert_same_as_tobj(&small(name));
    }
}

#[test]
fn materials_come_from_the_library_beside_the_file() {
    let (_, info) = read(&small("styles.obj"), 8 << 20);
    let names: Vec<_> = info.materials.iter().map(|material| (&material.name[..], material.kd, material.ns)).collect();
    assert_eq!(names, [("red", Some([1.0, 0.0, 0.0]), None), ("blue", Some([0.0, 0.0, 1.0]), Some(20.0))]);
}

#[test]
fn real_meshes_read_as_tobj_reads_them() {
    let Some(folder) = std::env::var_os("OCTRACE_DATA") else {
        println!("skipped: OCTRACE_DATA is not set");
        return;
    };
    for name in ["bunny.obj", "fandisk.obj", "spot.obj", "kitchen.obj", "st_helens.obj.zst"] {
        let path = Path::new(&folder).join(name);
        match path.exists() {
            true => assert_same_as_tobj(&path),
            false => println!("skipped: {}", path.display()),
        }
    }
}

/// Reads `-` in a process of its own: this test, run again with another standard input.
#[test]
fn standard_input_is_read_plain_and_compressed() {
    const CHILD: &str = "OCTRACE_TEST_READS_STDIN";
    if std::env::var_os(CHILD).is_some() {
        let (mut mesh, options) = (Mesh::default(), ReadOptions { block: 64, ..Default::default() });
        let read = mesh::open(Path::new("-"), &options).unwrap().read(&mut mesh, Monitor::silent());
        let end = read.map_or_else(|error| error.to_string(), |_| "read to its end".into());
        println!("{} vertices, {} faces, {end}", mesh.positions.len(), mesh.faces.len());
        return;
    }
    let said = |input: &[u8]| -> String {
        let mut child = assert_cmd::Command::new(std::env::current_exe().unwrap());
        let name = "standard_input_is_read_plain_and_compressed";
        let out = child.args(["--exact", name, "--nocapture"]).env(CHILD, "1").write_stdin(input).output().unwrap();
        String::from_utf8_lossy(&out.stdout)
            .lines()
            .find(|line| line.contains(" vertices, "))
            .unwrap_or("nothing")
            .to_owned()
    };
    let text = fs::read(small("styles.obj")).unwrap();
    let (mesh, _) = read(&small("styles.obj"), 8 << 20);
    let whole = format!("{} vertices, {} faces, read to its end", mesh.positions.len(), mesh.faces.len());
    let mut gzip = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    gzip.write_all(&text).unwrap();
    assert!(said(&text).ends_with(&whole), "{}", said(&text));
    assert!(said(&gzip.finish().unwrap()).ends_with(&whole));
    assert!(said(&zstd::encode_all(&text[..], 1).unwrap()).ends_with(&whole));
    let wrong = "<stdin>:2:3: vertex 4 does not exist: the file has only 3 vertices: `f 4 1 2`";
    let forward = format!("f 1 2 3\nf 4 1 2\n{}v 0 0 0\nv 0 0 0\nv 0 0 0\nf 1 9 3\n", "# comment\n".repeat(20));
    assert!(said(forward.as_bytes()).contains(wrong), "{}", said(forward.as_bytes()));
}

/// How a random mesh is printed; each number picks among the ways where there are several.
fn print(mesh: &Mesh, counts: [u32; 2], mut dice: impl FnMut(u32) -> u32) -> String {
    let mut text = String::new();
    for _ in 0..counts[0] {
        text += "vt 0.5 0.5\n";
    }
    for _ in 0..counts[1] {
        text += "vn 0 0 1\n";
    }
    for position in &mesh.positions {
        text += "v";
        for value in position.map(f32::from_bits) {
            text += ["  ", "\t", " ", " ", " ", " \\\n"][dice(6) as usize];
            text += &match dice(4) {
                0 => format!("{value:e}"),
                1 => format!("{value:.60}"),
                2 => format!("{:E}", value as f64),
                _ => format!("{value}"),
            };
        }
        text += ["\n", "\r\n", " \n", " # x\n", " 1\n", "\n\n", "\n# f 1 2\n"][dice(7) as usize];
    }
    let counts = [mesh.positions.len() as u32, counts[0], counts[1]];
    for face in &mesh.faces {
        text += "f";
        for corner in face {
            text += ["  ", " ", " ", " ", " \\\r\n"][dice(5) as usize];
            let mut written = |kind: usize| match corner[kind] {
                None => String::new(),
                Some(index) if dice(3) == 0 => format!("-{}", counts[kind] - index),
                Some(index) => format!("{}", index + 1),
            };
            text += &written(0);
            match (corner[1], corner[2]) {
                (None, None) => {}
                (_, None) => text += &format!("/{}", written(1)),
                _ => text += &format!("/{}/{}", written(1), written(2)),
            }
        }
        text += ["\n", "\r\n", " \n", "\ng x\n"][dice(4) as usize];
    }
    if dice(2) == 0 {
        text.truncate(text.trim_end().len());
    }
    text
}

fn random_mesh() -> impl Strategy<Value = (Mesh, [u32; 2])> {
    let position = prop::array::uniform3(any::<f32>().prop_map(|value| if value.is_finite() { value } else { -0.0 }));
    let position = position.prop_map(|position| position.map(f32::to_bits));
    (prop::collection::vec(position, 1..40), 1u32..5, 1u32..5).prop_flat_map(|(positions, texcoords, normals)| {
        let corner = (0..positions.len() as u32, prop::option::of(0..texcoords), prop::option::of(0..normals));
        let corner = corner.prop_map(|(a, b, c)| [Some(a), b, c]);
        let faces = prop::collection::vec(prop::collection::vec(corner, 3..7), 0..40);
        faces.prop_map(move |faces| (Mesh { positions: positions.clone(), faces }, [texcoords, normals]))
    })
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn random_meshes_in_random_styles_come_back_bit_for_bit((mesh, counts) in random_mesh(), seed: u64, block in 1usize..2000) {
        let mut state = seed | 1;
        let text = print(&mesh, counts, |sides| {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            (state >> 33) as u32 % sides
        });
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("random.obj");
        fs::write(&path, &text).unwrap();
        prop_assert_eq!(read(&path, block).0, mesh, "{}", text);
    }

    #[test]
    fn no_bytes_make_it_panic(
        pieces in prop::collection::vec(prop_oneof![
            Just("v ".to_owned()), Just("f ".to_owned()), Just("\n".to_owned()), Just(" ".to_owned()), Just("/".to_owned()),
            Just("-1".to_owned()), Just("1".to_owned()), Just("\\\n".to_owned()), Just("usemtl ".to_owned()), Just("vt".to_owned()),
            Just("#".to_owned()), Just("1e".to_owned()), Just("f 1 2 3\n".to_owned()), Just("v 1 2 3\n".to_owned()),
            Just("é".to_owned()), "[ -~]{0,5}", any::<String>(),
        ], 0..60),
        lenient: bool,
        block in 1usize..100,
    ) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("any.obj");
        fs::write(&path, pieces.concat()).unwrap();
        let options = ReadOptions { block, lenient, ..Default::default() };
        let read = |options: &ReadOptions| {
            let mut mesh = Mesh::default();
            let result = mesh::open(&path, options).unwrap().read(&mut Sizes(&mut mesh), Monitor::silent());
            (mesh.positions, result.map(|info| (info.bad_index, info.too_few_corners)).map_err(|error| error.to_string()))
        };
        let (cut, whole) = (read(&options), read(&ReadOptions { block: 8 << 20, ..options }));
        prop_assert_eq!(&cut.1, &whole.1);
        // How much was sent before an error depends on the blocks.
        prop_assert!(cut.1.is_err() || cut.0 == whole.0);
    }
}

/// Takes gaps too, and keeps of the faces only that their arrays fit together.
struct Sizes<'a>(&'a mut Mesh);

impl MeshSink for Sizes<'_> {
    fn positions(&mut self, positions: &[[f32; 3]]) -> Result<()> {
        self.0.positions(positions)
    }

    fn texcoords(&mut self, _: &[[f32; 2]]) -> Result<()> {
        Ok(())
    }

    fn normals(&mut self, _: &[[f32; 3]]) -> Result<()> {
        Ok(())
    }

    fn faces(&mut self, batch: &FaceBatch) -> Result<()> {
        let corners: u64 =
            batch.sizes.iter().filter(|&&size| size & FaceBatch::GAP == 0).map(|&size| size as u64).sum();
        assert!(batch.sizes.is_empty() || corners == batch.corners.len() as u64);
        assert!(batch.texcoords.is_empty() || batch.texcoords.len() == batch.corners.len());
        Ok(())
    }
}
