//! The reader as a whole: every test text is read with large and with tiny blocks, which must make no difference.

mod files;

use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::AtomicBool;

use crate::error::{Error, Result};
use crate::event::{Event, Monitor};
use crate::mesh::{FaceBatch, MeshSink, NO_INDEX, ReadOptions, SourceInfo, open};

/// One corner: position, texture coordinate, normal.
type Corner = (u32, u32, u32);

/// A mesh as it was sent, batches joined.
#[derive(Debug, Default, Clone, PartialEq)]
struct Mesh {
    positions: Vec<[u32; 3]>,
    texcoords: Vec<[f32; 2]>,
    normals: Vec<[f32; 3]>,
    /// Each with its material.
    faces: Vec<(Face, u32)>,
}

/// Corners, or a gap of so many triangles.
type Face = std::result::Result<Vec<Corner>, u32>;

impl MeshSink for Mesh {
    fn positions(&mut self, positions: &[[f32; 3]]) -> Result<()> {
        self.positions.extend(positions.iter().map(|position| position.map(f32::to_bits)));
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

    fn faces(&mut self, batch: &FaceBatch) -> Result<()> {
        let FaceBatch { sizes, corners, texcoords, normals, materials } = batch;
        assert!(texcoords.is_empty() || texcoords.len() == corners.len());
        assert!(normals.is_empty() || normals.len() == corners.len());
        assert!(sizes.is_empty() || sizes.iter().any(|&size| size != 3));
        assert_eq!(materials[0].0, 0);
        assert!(materials.windows(2).all(|pair| pair[0].0 < pair[1].0));
        let all_triangles = vec![3; corners.len() / 3];
        let mut at = 0;
        for (face, &size) in if sizes.is_empty() { &all_triangles } else { sizes }.iter().enumerate() {
            let material = materials.iter().rfind(|&&(from, _)| from as usize <= face).unwrap().1;
            if size & FaceBatch::GAP != 0 {
                self.faces.push((Err(size & !FaceBatch::GAP), material));
                continue;
            }
            let of = |array: &[u32], at: usize| array.get(at).copied().unwrap_or(NO_INDEX);
            let range = at..at + size as usize;
            at = range.end;
            let face: Face = Ok(range.map(|at| (corners[at], of(texcoords, at), of(normals, at))).collect());
            self.faces.push((face, material));
        }
        assert_eq!(at, corners.len());
        Ok(())
    }
}

/// What was read, and what was said meanwhile.
struct Seen {
    mesh: Mesh,
    info: SourceInfo,
    said: String,
}

fn read_file(path: &Path, options: ReadOptions) -> Result<Seen> {
    let said = Mutex::new(String::new());
    let note = |event: Event| {
        let line = match event {
            Event::Warning(text) => text,
            Event::Diagnostic(diagnostic) => diagnostic.to_string(),
            _ => return,
        };
        said.lock().unwrap().push_str(&(line + "\n"));
    };
    let stop = AtomicBool::new(false);
    let mut mesh = Mesh::default();
    let info = open(path, &options)?.read(&mut mesh, Monitor::new(&note, &stop))?;
    Ok(Seen { mesh, info, said: said.into_inner().unwrap() })
}

/// Reads a text with blocks of several sizes, which must not matter; folders in messages become `DIR`.
fn read_with(text: &[u8], options: ReadOptions) -> std::result::Result<Seen, String> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.obj");
    std::fs::write(&path, text).unwrap();
    let clean = |text: String| text.replace(folder.path().to_str().unwrap(), "DIR");
    let read = |block| {
        read_file(&path, ReadOptions { block, ..options })
            .map(|seen| Seen { said: clean(seen.said), ..seen })
            .map_err(|error| clean(error.to_string()))
    };
    let whole = read(8 << 20);
    for block in [1, 7, 64] {
        match (&whole, read(block)) {
            (Ok(whole), Ok(cut)) => {
                assert_eq!(cut.mesh, whole.mesh, "block {block}");
                assert_eq!(cut.said, whole.said, "block {block}");
                assert_eq!(cut.info.materials, whole.info.materials, "block {block}");
                assert_eq!(cut.info.bad_index, whole.info.bad_index, "block {block}");
                assert_eq!(cut.info.too_few_corners, whole.info.too_few_corners, "block {block}");
            }
            (Err(whole), Err(cut)) => assert_eq!(whole, &cut, "block {block}"),
            (whole, cut) => panic!("block {block}: {:?} against {:?}", whole.is_ok(), cut.is_ok()),
        }
    }
    whole
}

fn read(text: impl AsRef<[u8]>) -> Seen {
    read_with(text.as_ref(), ReadOptions::default()).unwrap_or_else(|error| panic!("{error}"))
}

fn lenient(text: impl AsRef<[u8]>) -> Seen {
    read_with(text.as_ref(), ReadOptions { lenient: true, ..Default::default() }).unwrap()
}

/// What is wrong, without what to do where that is said of everything.
fn error(text: impl AsRef<[u8]>) -> String {
    let told = read_with(text.as_ref(), ReadOptions::default()).err().expect("an error");
    told.replace(&format!(" ({})", super::place::SKIP), "")
}

#[test]
fn every_error_says_what_to_do() {
    for line in ["v x 0 0", "vn 0 1", "f 1 2 9", "f 1 2 -9", "f 1 2 0", "f 1 2 1.5", "v 1,5 0 0"] {
        let told = read_with(format!("{FOUR}{line}\n").as_bytes(), ReadOptions::default()).err().expect("an error");
        assert!(told.ends_with(')') && told.contains("` ("), "{told}");
    }
}

/// The vertex numbers of each face.
fn corners(seen: &Seen) -> Vec<Vec<u32>> {
    let of = |face: &Face| face.as_ref().map_or(Vec::new(), |face| face.iter().map(|corner| corner.0).collect());
    seen.mesh.faces.iter().map(|(face, _)| of(face)).collect()
}

fn bits(values: [f32; 3]) -> [u32; 3] {
    values.map(f32::to_bits)
}

const FOUR: &str = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n";

#[test]
fn vertices_in_every_style_are_the_numbers_of_the_file() {
    let seen = read(
        "v 0.1 -2 3e4\r\nv\t1.\t.5   +7 \n  v 1 2 3 0.5\nv 1 2 3 1 0 0 # colour\nv 1e999 nan -inf\nv 1 \\\n2 \\\r\n3",
    );
    let nan = f32::NAN;
    let expect = [
        [0.1, -2.0, 3e4],
        [1.0, 0.5, 7.0],
        [1.0, 2.0, 3.0],
        [1.0, 2.0, 3.0],
        [f32::INFINITY, nan, f32::NEG_INFINITY],
        [1.0, 2.0, 3.0],
    ];
    assert_eq!(seen.mesh.positions.len(), expect.len());
    for (found, expect) in seen.mesh.positions.iter().zip(expect) {
        let found = found.map(f32::from_bits);
        assert!(
            (0..3).all(|i| found[i] == expect[i] || found[i].is_nan() && expect[i].is_nan()),
            "{found:?} {expect:?}"
        );
    }
}

#[test]
fn the_origin_is_taken_off_before_rounding() {
    let options = ReadOptions { origin: [5e6, 0.0, -1.0], ..Default::default() };
    let seen = read_with(b"v 5000000.123 16777217.00000000001 2\nv 5000000.125 1 2 # slow\n", options).unwrap();
    assert_eq!(seen.mesh.positions[0], bits([(5000000.123f64 - 5e6) as f32, 16777218.0, 3.0]));
    assert_eq!(seen.mesh.positions[1], bits([(5000000.125f64 - 5e6) as f32, 1.0, 3.0]));
}

#[test]
fn texture_coordinates_have_one_to_three_numbers_and_normals_three() {
    let seen = read("vt 1\nvt 1 2\nvt 1 2 3\nvt 0.25 0.5 0\nvn 0 0 1\nvn 0  1 0\n");
    assert_eq!(seen.mesh.texcoords, [[1.0, 0.0], [1.0, 2.0], [1.0, 2.0], [0.25, 0.5]]);
    assert_eq!(seen.mesh.normals, [[0.0, 0.0, 1.0], [0.0, 1.0, 0.0]]);
    assert_eq!(error("vn 0 1\n"), "DIR/a.obj:1:1: `vn` takes 3 numbers, here are 2: `vn 0 1`");
}

#[test]
fn faces_in_every_form() {
    let no = NO_INDEX;
    let head = format!("{FOUR}vt 0 0\nvt 1 1\nvn 0 0 1\n");
    let seen = read(
        head + "f 1 2 3\nf 1/2 2/1 3/2\nf 1//1 2//1 3//1\nf 1/1/1 2/2/1 3 4\nf -4/-2/-1 -3/-1/-1 -2\nfo 1 2 3\nf\t1   2 3 \\\n 4 # x\n#4\n",
    );
    let expect: Vec<Vec<Corner>> = vec![
        vec![(0, no, no), (1, no, no), (2, no, no)],
        vec![(0, 1, no), (1, 0, no), (2, 1, no)],
        vec![(0, no, 0), (1, no, 0), (2, no, 0)],
        vec![(0, 0, 0), (1, 1, 0), (2, no, no), (3, no, no)],
        vec![(0, 0, 0), (1, 1, 0), (2, no, no)],
        vec![(0, no, no), (1, no, no), (2, no, no)],
    ];
    let found: Vec<_> = seen.mesh.faces.iter().map(|(face, _)| face.clone().unwrap()).collect();
    assert_eq!(found[..6], expect);
    assert_eq!(found[6].len(), 4);
    assert_eq!(found.len(), 7);
}

#[test]
fn negative_indices_count_back_from_their_line() {
    let seen = read("v 0 0 0\nv 1 0 0\nv 0 1 0\nf -3 -2 -1\nv 0 0 1\nf -3 -2 -1\nf 1 -1 2\nf -4 -1 1 2\n");
    assert_eq!(corners(&seen), [vec![0, 1, 2], vec![1, 2, 3], vec![0, 3, 1], vec![0, 3, 0, 1]]);
    let deep = format!("{}f -3000 -1 -2\n", "v 0 0 0\n".repeat(3000));
    assert_eq!(corners(&read(deep)), [vec![0, 2999, 2998]]);
}

#[test]
fn faces_may_come_before_their_vertices() {
    let seen = read(format!("f 1 2 3\nf 2 3 4\n{FOUR}"));
    assert_eq!(corners(&seen), [vec![0, 1, 2], vec![1, 2, 3]]);
}

#[test]
fn what_is_not_mesh_is_passed_over() {
    let seen = read(format!(
        "\u{feff}# head \\\n{FOUR}g a b\no x\ns off\nl 1 2\np 1\nvp 1 2\ncurv 0 1 \\\n 2 3\nf 1 2 3\n\n   \n\t#\nend"
    ));
    assert_eq!((seen.mesh.positions.len(), corners(&seen)), (4, vec![vec![0, 1, 2]]));
    assert_eq!(seen.said, "");
}

#[test]
fn faces_of_fewer_than_three_corners_are_counted() {
    let seen = read(format!("{FOUR}f 1 2\nf 1\nf\nf 1 2 3\nf -1 -2\nf -1 -2 -3\n"));
    assert_eq!((seen.info.too_few_corners, seen.info.bad_index), (3 + 1, 0));
    assert_eq!(corners(&seen), [vec![0, 1, 2], vec![3, 2, 1]]);
}

#[test]
fn materials_are_numbered_by_first_use() {
    let seen = read(
        [FOUR.as_bytes(), b"f 1 2 3\nusemtl B \xe9\nf 1 2 4\nf 1 2 4\nusemtl A\nusemtl C\nf 1 3 4\nusemtl B \xe9\r\nf 2 3 4\nusemtl\nf 1 2 3\n"]
            .concat(),
    );
    let numbers: Vec<u32> = seen.mesh.faces.iter().map(|face| face.1).collect();
    assert_eq!(numbers, [0, 1, 1, 3, 1, 0]);
    let names: Vec<&str> = seen.info.materials.iter().map(|material| &material.name[..]).collect();
    assert_eq!(names, ["B é", "A", "C"]);
    assert!(seen.said.contains("no material library defines \"B é\", \"A\", \"C\""), "{}", seen.said);
}

#[test]
fn wrong_lines_are_errors_with_their_place() {
    let after = |line: &str| error(format!("{FOUR}# é\r\nf 1 2 \\\n 3\n{line}\nf 1 2 3\nv x\n"));
    assert_eq!(
        after("f 1 2 0"),
        "DIR/a.obj:8:7: index 0: OBJ counts from 1: `f 1 2 0` (write 1 for the first, -1 for the latest)"
    );
    assert_eq!(after("f 1 2 9"), "DIR/a.obj:10:3: not a number: `v x`");
    assert_eq!(
        after("f 1 2 -5"),
        "DIR/a.obj:8:7: vertex -5 does not exist: only 4 vertices come before this line: `f 1 2 -5`"
    );
    assert_eq!(
        after("f 1 2/-1 3"),
        "DIR/a.obj:8:7: texture coordinate -1 does not exist: no texture coordinates come before this line: `f 1 2/-1 3`"
    );
    assert_eq!(after("f 1 \\\n é 3"), "DIR/a.obj:9:2: not a corner of a face: `é 3` (write a, a/b, a//c or a/b/c)");
    for corner in ["1/", "1//", "/1", "//1", "1/2/", "1/1/1/1", "1.0", "1-2", "x", "-", "1/+"] {
        assert!(after(&format!("f 1 2 {corner}")).starts_with("DIR/a.obj:8:7: not a corner of a face"), "{corner}");
    }
    assert_eq!(
        after("v 1 2,5 3"),
        "DIR/a.obj:8:5: not a number: `v 1 2,5 3` (OBJ writes decimals with a point and numbers apart with blanks)"
    );
    assert_eq!(after("v 1 2"), "DIR/a.obj:8:1: `v` takes 3 numbers, here are 2: `v 1 2`");
    assert_eq!(after("vt"), "DIR/a.obj:8:1: `vt` takes 1 numbers, here are 0: `vt`");
    assert_eq!(
        after("f 1 2 4294967296"),
        "DIR/a.obj:8:7: vertex 4294967296 is beyond 4294967295, the most that can be counted: `f 1 2 4294967296`"
    );
    assert!(after("f 1 2 -99999999999999999999").contains("8:7: vertex -"), "saturates");
}

#[test]
fn an_index_beyond_the_end_is_an_error_at_its_first_place() {
    let text = format!("f 1 2 4\nf 1 5 2\nf 6 1 2\n{FOUR}f 1 2 7\n");
    assert_eq!(error(text), "DIR/a.obj:2:5: vertex 5 does not exist: the file has only 4 vertices: `f 1 5 2`");
    let text = format!("{FOUR}vt 0 0\nf 1/1 2/2 3/1\n");
    assert_eq!(
        error(text),
        "DIR/a.obj:6:9: texture coordinate 2 does not exist: the file has only one: `f 1/1 2/2 3/1`"
    );
    let text = format!("{FOUR}f 1//1 2//1 3//1\n");
    assert_eq!(error(text), "DIR/a.obj:5:6: normal 1 does not exist: the file has no normals: `f 1//1 2//1 3//1`");
}

#[test]
fn lenient_skips_and_counts_and_keeps_the_numbering() {
    let seen = lenient(format!(
        "{FOUR}v 1 x 2\nf 1 2 3\nf 1 2 0 4\nf 1 2 y\nf 0 1\nf 1 2 -6\nf 1 2 99\nf 1 2 5\nf 1/7 2/-9 3/1\nf 1 2 3 4\n"
    ));
    let gaps: Vec<_> = seen.mesh.faces.iter().map(|(face, _)| face.as_ref().err().copied()).collect();
    assert_eq!(gaps, [None, Some(2), Some(1), Some(1), None, None, None, None]);
    assert_eq!((seen.info.bad_index, seen.info.too_few_corners), (4, 1));
    assert!(seen.mesh.positions[4].iter().all(|&bits| f32::from_bits(bits).is_nan()));
    assert_eq!(corners(&seen)[4..7], [vec![0, 1, 98], vec![0, 1, 4], vec![0, 1, 2]]);
    assert_eq!(seen.mesh.faces[6].0.as_ref().unwrap()[1], (1, NO_INDEX, NO_INDEX));
    assert!(seen.said.starts_with("DIR/a.obj:5:5: not a number: `v 1 x 2`\nDIR/a.obj:7:7: index 0"), "{}", seen.said);
    assert_eq!(seen.said.lines().count(), 5);
}

#[test]
fn lenient_warns_ten_times_and_then_sums_up() {
    let seen = lenient(format!("{FOUR}{}f 1 2 3\n", "f 0 1 2\nf 1 2 3\n".repeat(25)));
    assert_eq!((seen.info.bad_index, seen.mesh.faces.len(), seen.said.lines().count()), (25, 51, 11));
    assert!(seen.said.ends_with("DIR/a.obj: 15 more bad lines were skipped\n"), "{}", seen.said);
}

#[test]
fn lenient_drops_optional_arrays_that_a_skipped_face_began() {
    let seen = lenient(format!("{FOUR}vt 0 0\nf 1 2 3\nf 1/1 2/1 x\nf 1 2 4\nf -1/-1 -2/-1 x\nf -1/-1 -2 -3\n"));
    assert_eq!(corners(&seen), [vec![0, 1, 2], vec![], vec![0, 1, 3], vec![], vec![3, 2, 1]]);
    assert_eq!(seen.mesh.faces[4].0, Ok(vec![(3, 0, NO_INDEX), (2, NO_INDEX, NO_INDEX), (1, NO_INDEX, NO_INDEX)]));
}
