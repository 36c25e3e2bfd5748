//! Whole builds: from a source in memory, or real OBJ text, to a file that is opened and read back.

use std::path::Path;
use std::sync::atomic::AtomicBool;

use proptest::prelude::*;

use super::options::Tuning;
use super::pipeline::build_tuned;
use super::*;
use crate::error::{Error, Result};
use crate::event::{Event, Monitor};
use crate::format::{Dropped, Flags, PageId, SplitMode};
use crate::map::Octree;
use crate::mesh::{FaceBatch, MaterialInfo, MeshSink, NO_INDEX, SourceInfo, TriangleSource};

mod early;
mod ends;
mod refused;

/// A mesh in memory.
#[derive(Clone, Debug, Default)]
struct Memory {
    positions: Vec<[f32; 3]>,
    texcoords: Vec<[f32; 2]>,
    normals: Vec<[f32; 3]>,
    batches: Vec<FaceBatch>,
    info: SourceInfo,
}

impl TriangleSource for Memory {
    fn read(&mut self, sink: &mut dyn MeshSink, _: Monitor<'_>) -> Result<SourceInfo> {
        // Faces first: they may come before their vertices.
        self.batches.iter().try_for_each(|batch| sink.faces(batch))?;
        self.positions.chunks(1000).try_for_each(|positions| sink.positions(positions))?;
        sink.texcoords(&self.texcoords)?;
        sink.normals(&self.normals)?;
        Ok(self.info.clone())
    }

    fn size_hint(&self) -> Option<u64> {
        None
    }
}

/// A triangle as the file gives it back; floats by their bits.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Stored {
    face: u32,
    corners: [[u32; 3]; 3],
    material: u32,
    normals: Option<[[u32; 3]; 3]>,
    texcoords: Option<[[u32; 2]; 3]>,
}

fn bits<const N: usize, const M: usize>(values: [[f32; N]; M]) -> [[u32; N]; M] {
    values.map(|value| value.map(f32::to_bits))
}

/// All references of a file in the order of face ids, after the file has been verified.
fn read_back(path: &Path) -> Vec<Stored> {
    let octree = Octree::open(path).unwrap();
    octree.verify(Monitor::silent()).unwrap();
    let mut all = Vec::new();
    let visit = octree.visit();
    for page in (0..octree.header().pages).map(|page| visit.page(PageId(page)).unwrap()) {
        let header = page.header();
        let mut at = header.leaf_offset as usize;
        while at < (header.leaf_offset + header.leaf_bytes) as usize {
            let leaf = page.leaf(at);
            for lane in 0..leaf.len() {
                let reference = leaf.first() + lane as u32;
                all.push(Stored {
                    face: page.face(reference).0,
                    corners: bits(leaf.triangle(lane).vertices().map(|v| v.to_array())),
                    material: page.material(reference),
                    normals: page.normals(reference).map(bits),
                    texcoords: page.texcoords(reference).map(bits),
                });
            }
            at += leaf.size(octree.leaf_unit());
        }
    }
    all.sort();
    all
}

fn build_in(folder: &Path, mesh: &Memory, options: &BuildOptions, tuning: &Tuning) -> Result<BuildReport> {
    build_tuned(&mut mesh.clone(), &folder.join("a.oct"), options, tuning, Monitor::silent())
}

/// Builds, checks that no temporary file stays, and reads back.
fn round_trip(mesh: &Memory, options: &BuildOptions, tuning: &Tuning) -> (BuildReport, Vec<Stored>, Vec<u8>) {
    let folder = tempfile::tempdir().unwrap();
    let report = build_in(folder.path(), mesh, options, tuning).unwrap();
    let files: Vec<_> = std::fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    assert_eq!(files, ["a.oct"]);
    let path = folder.path().join("a.oct");
    let bytes = std::fs::read(&path).unwrap();
    assert_eq!(report.bytes, bytes.len() as u64);
    (report, read_back(&path), bytes)
}

/// A bumpy sheet of 2 n^2 triangles, every second row in another batch.
fn sheet(n: u32) -> Memory {
    let height = |x: u32, y: u32| ((x * x + 7 * y) % 11) as f32 * 0.05;
    let positions = (0..=n).flat_map(|y| (0..=n).map(move |x| [x as f32, y as f32, height(x, y)])).collect();
    let square = |x: u32, y: u32| {
        let at = y * (n + 1) + x;
        [at, at + 1, at + n + 2, at, at + n + 2, at + n + 1]
    };
    let row = |y: u32| FaceBatch { corners: (0..n).flat_map(|x| square(x, y)).collect(), ..Default::default() };
    Memory { positions, batches: (0..n).map(row).collect(), ..Default::default() }
}

/// What a mesh of triangles without attributes must give back.
fn expected(mesh: &Memory) -> Vec<Stored> {
    let corners = mesh.batches.iter().flat_map(|batch| &batch.corners).copied().collect::<Vec<_>>();
    let stored = |(face, c): (usize, &[u32])| Stored {
        face: face as u32,
        corners: bits([c[0], c[1], c[2]].map(|i| mesh.positions[i as usize])),
        material: 0,
        normals: None,
        texcoords: None,
    };
    corners.chunks(3).enumerate().map(stored).collect()
}

/// Sizes so small that everything spills, is answered range by range, and chunks are divided again and again.
pub(super) const TINY: Tuning = Tuning { window_words: 300, wave_bytes: 1 << 30, top_bytes: 1 << 30, ..Tuning::TINY };

/// Sizes of a build that has room.
pub(super) fn roomy() -> Tuning {
    Tuning::within(1 << 30, 2)
}

fn options(split: SplitMode, brick: u32) -> BuildOptions {
    BuildOptions { split, brick: Some(brick), ..Default::default() }
}

#[test]
fn every_triangle_comes_back() {
    let mesh = sheet(20);
    for (split, brick) in [(SplitMode::Sah, 1000), (SplitMode::Sah, 50), (SplitMode::Octree, 50)] {
        let (report, stored, _) = round_trip(&mesh, &options(split, brick), &roomy());
        assert_eq!((report.triangles, report.references, report.vertices), (800, 800, 441));
        assert_eq!(report.pages > 1, brick == 50);
        assert_eq!(stored, expected(&mesh));
    }
    let (report, mut stored, _) = round_trip(&mesh, &options(SplitMode::Strict, 50), &roomy());
    assert!(report.references > 800 && stored.len() as u64 == report.references);
    stored.dedup();
    assert_eq!(stored, expected(&mesh));
}

#[test]
fn chunks_and_threads_do_not_change_the_bytes() {
    let mesh = sheet(30);
    for split in [SplitMode::Sah, SplitMode::Octree, SplitMode::Strict] {
        for depth in [21, 3] {
            let options = BuildOptions { depth, ..options(split, 40) };
            let (report, _, bytes) = round_trip(&mesh, &options, &roomy());
            assert!(report.pages > 10);
            for threads in [1, 2] {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
                let (tiny, _, again) = pool.install(|| round_trip(&mesh, &options, &TINY));
                assert!(bytes == again, "{split:?}, depth {depth}, {threads} threads");
                assert!(tiny.phases.iter().any(|phase| phase.name == "distribute"));
            }
        }
    }
}

#[test]
fn a_heap_of_equal_triangles_ends_at_the_depth_limit() {
    let mut mesh = sheet(1);
    mesh.batches = vec![mesh.batches[0].clone(); 200];
    let (report, stored, bytes) = round_trip(&mesh, &options(SplitMode::Sah, 16), &TINY);
    assert_eq!((report.triangles, stored.len()), (400, 400));
    assert!(bytes == round_trip(&mesh, &options(SplitMode::Sah, 16), &roomy()).2);
}

#[test]
fn what_is_dropped_is_counted_and_uses_up_its_ids() {
    let mesh = Memory {
        positions: vec![
            [0., 0., 0.],
            [1., 0., 0.],
            [1., 1., 0.],
            [0., 1., 0.],
            [2., 2., 0.],
            [f32::NAN, 0., 0.],
            [0.; 3],
        ],
        batches: vec![FaceBatch {
            //          square  gap of 2           NaN  diagonal  out of range  pentagon, one cut without area  good
            sizes: vec![4, FaceBatch::GAP | 2, 4, 3, 5, 5, 3],
            corners: [&[0, 1, 2, 3][..], &[0, 1, 2, 5], &[0, 2, 4], &[0, 1, 2, 3, 99], &[0, 6, 1, 2, 3], &[1, 2, 4]]
                .concat(),
            ..Default::default()
        }],
        info: SourceInfo { too_few_corners: 3, bad_index: 2, ..Default::default() },
        ..Default::default()
    };
    let (report, stored, _) = round_trip(&mesh, &BuildOptions::default(), &roomy());
    let dropped = Dropped { degenerate: 2, non_finite: 2, bad_index: 5, too_few_corners: 3 };
    assert_eq!((report.dropped, report.triangles, report.source_triangles), (dropped, 5, 14));
    assert_eq!(stored.iter().map(|s| s.face).collect::<Vec<_>>(), [0, 1, 11, 12, 13]);
    assert_eq!((report.polygons.cut, report.polygons.clipped, report.merged), (2, 0, 1));
}

#[test]
fn attributes_and_materials_come_back() {
    let mut mesh = sheet(8);
    mesh.normals = vec![[0., 0., 1.], [0., 1., 0.], [0., 0., 1.], [f32::NAN; 3]];
    mesh.texcoords = (0..5).map(|i| [i as f32, 0.5]).collect();
    for (row, batch) in mesh.batches.iter_mut().enumerate() {
        let n = batch.corners.len() as u32;
        batch.materials = vec![(0, row as u32 % 3)];
        if row % 2 == 0 {
            batch.normals = (0..n).map(|i| if i / 3 == 1 { NO_INDEX } else { i % 3 }).collect();
        }
        if row == 3 {
            batch.texcoords = (0..n).map(|i| i % 5).collect();
            batch.normals = vec![3; n as usize];
        }
    }
    let material = |name: &str, texture: Option<&str>| MaterialInfo {
        name: name.into(),
        kd: Some([0.5; 3]),
        map_kd: texture.map(Into::into),
        ..Default::default()
    };
    mesh.info.materials = vec![material("stone", None), material("wood", Some("/textures/wood.png"))];
    let mut expected = expected(&mesh);
    let row = |batch: &FaceBatch, face: usize| {
        let corners = |numbers: &[u32]| numbers.get(3 * face..3 * face + 3).map(|c| [c[0], c[1], c[2]]);
        let normals = corners(&batch.normals).filter(|c| c.iter().all(|&n| n < 3));
        let texcoords = corners(&batch.texcoords);
        (
            batch.materials[0].1,
            normals.map(|c| bits(c.map(|n| mesh.normals[n as usize]))),
            texcoords.map(|c| bits(c.map(|n| mesh.texcoords[n as usize]))),
        )
    };
    for (number, stored) in expected.iter_mut().enumerate() {
        (stored.material, stored.normals, stored.texcoords) = row(&mesh.batches[number / 16], number % 16);
    }
    for tuning in [roomy(), TINY] {
        let (_, stored, bytes) = round_trip(&mesh, &options(SplitMode::Sah, 30), &tuning);
        assert_eq!(stored, expected);
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("b.oct"), bytes).unwrap();
        let octree = Octree::open(&folder.path().join("b.oct")).unwrap();
        assert!(octree.flags().has(Flags::MATERIALS | Flags::NORMALS | Flags::TEXCOORDS | Flags::IDS));
        assert_eq!(octree.string(octree.materials()[1].name), "wood");
        assert!(octree.string(octree.materials()[1].map_kd).ends_with("textures/wood.png"));
    }
}

#[test]
fn without_ids_the_storage_number_stands_in() {
    let options = BuildOptions { ids: false, ..options(SplitMode::Sah, 40) };
    let (_, stored, _) = round_trip(&sheet(10), &options, &roomy());
    assert!(stored.iter().map(|s| s.face).eq(0..200));
}

#[test]
fn a_bad_corner_drops_all_of_a_large_face() {
    let mut mesh = sheet(100);
    let n = 5000u32;
    let large = |first: u32, last: u32| [(first..first + n - 1).collect::<Vec<_>>(), vec![last]].concat();
    mesh.positions[9000] = [f32::INFINITY, 0.0, 0.0];
    mesh.batches = vec![FaceBatch {
        sizes: vec![n, 3, n, n, 3],
        corners: [&large(0, 5100)[..], &[1, 2, 105], &large(10, 9000), &large(20, 99_999), &[3, 4, 107]].concat(),
        ..Default::default()
    }];
    let (tiny, stored, bytes) = round_trip(&mesh, &options(SplitMode::Sah, 900), &TINY);
    let (roomy, _, same) = round_trip(&mesh, &options(SplitMode::Sah, 900), &roomy());
    let fan = u64::from(n) - 2;
    for report in [tiny, roomy] {
        assert_eq!((report.dropped.non_finite, report.dropped.bad_index), (fan, fan));
        assert_eq!((report.polygons.fanned, report.polygons.cut, report.source_triangles), (1, 1, 3 * fan + 2));
        assert_eq!(report.triangles + report.dropped.degenerate, fan + 2);
    }
    assert!(bytes == same);
    assert!(stored.iter().all(|s| u64::from(s.face) <= fan || u64::from(s.face) == 3 * fan + 1));
}

#[test]
fn obj_text_comes_back() {
    let folder = tempfile::tempdir().unwrap();
    let (obj, oct) = (folder.path().join("a.obj"), folder.path().join("a.oct"));
    let text = "v 0 0 0\nv 4 0 0\nv 1 1 0\nv 0 4 0\nv 0 0 4\nvn 0 0 1\n\
                f 1//1 2//1 3//1 4//1\nf 1 1 2\nf -5 -4 -1\n";
    std::fs::write(&obj, text).unwrap();
    let mut source = crate::mesh::open(&obj, &Default::default()).unwrap();
    let report = build(source.as_mut(), &oct, &BuildOptions::default(), Monitor::silent()).unwrap();
    let stored = read_back(&oct);
    assert_eq!((report.polygons.clipped, report.dropped.degenerate), (1, 1));
    assert_eq!(stored.iter().map(|s| s.face).collect::<Vec<_>>(), [0, 1, 3]);
    assert!(stored[0].normals.is_some() && stored[2].normals.is_none());
    assert_eq!(stored[2].corners, bits([[0., 0., 0.], [4., 0., 0.], [0., 0., 4.]]));
}

#[test]
fn real_meshes_build() {
    let Some(data) = std::env::var_os("OCTRACE_DATA") else {
        println!("OCTRACE_DATA is not set: skipped");
        return;
    };
    for name in ["bunny.obj", "fandisk.obj", "spot.obj", "kitchen.obj", "st_helens.obj.zst"] {
        let obj = Path::new(&data).join(name);
        if !obj.exists() {
            println!("{name} is not there: skipped");
            continue;
        }
        let folder = tempfile::tempdir().unwrap();
        let oct = folder.path().join("a.oct");
        let mut source = crate::mesh::open(&obj, &Default::default()).unwrap();
        let start = std::time::Instant::now();
        let report = build(source.as_mut(), &oct, &BuildOptions::default(), Monitor::silent()).unwrap();
        println!("{name}: {:.3} s {report:?}", start.elapsed().as_secs_f64());
        let mut stored = read_back(&oct);
        assert_eq!(stored.len() as u64, report.references);
        stored.dedup();
        assert!(stored.windows(2).all(|pair| pair[0].face < pair[1].face));
        assert_eq!(stored.len() as u64, report.triangles);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    /// Random soups: what comes back is what is not degenerate, and tiny chunks give the same bytes.
    #[test]
    fn random_meshes_come_back(
        positions in prop::collection::vec(prop::array::uniform3(-4i8..4), 3..40),
        corners in prop::collection::vec(0usize..1000, 3..300),
        brick in 1u32..40,
        split in prop::sample::select(vec![SplitMode::Sah, SplitMode::Octree, SplitMode::Strict]),
    ) {
        let n = positions.len();
        let corners: Vec<u32> = corners.chunks_exact(3).flatten().map(|&c| (c % n) as u32).collect();
        let positions = positions.into_iter().map(|p| p.map(f32::from)).collect();
        let mesh = Memory { positions, batches: vec![FaceBatch { corners, ..Default::default() }], ..Default::default() };
        let mut expected = expected(&mesh);
        expected.retain(|s| !crate::exact::exactly_degenerate(&s.corners.map(|c| c.map(f32::from_bits)).into()));
        prop_assume!(!expected.is_empty());
        let options = BuildOptions { depth: 6, ..options(split, brick) };
        let (report, mut stored, bytes) = round_trip(&mesh, &options, &roomy());
        stored.dedup();
        prop_assert_eq!(stored, expected);
        prop_assert_eq!(report.dropped.degenerate + report.triangles, report.source_triangles);
        prop_assert!(bytes == round_trip(&mesh, &options, &TINY).2);
    }
}
