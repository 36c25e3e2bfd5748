//! Large triangles are cut before the mesh is divided into pages.

use std::sync::Mutex;

use super::*;

/// A bumpy sheet that stands on a ground of two triangles and is crossed by a road and by long needles, up and across.
pub(super) fn town(n: u32) -> Memory {
    let mut mesh = sheet(n);
    let size = n as f32;
    let mut add = |corners: [[f32; 3]; 3]| {
        let at = mesh.positions.len() as u32;
        mesh.positions.extend(corners);
        // First in the file, so that ids of the sheet move.
        mesh.batches.insert(0, FaceBatch { corners: vec![at, at + 1, at + 2], ..Default::default() });
    };
    let ground =
        [[-1.0, -1.0, -0.1], [size + 1.0, -1.0, -0.1], [size + 1.0, size + 1.0, -0.1], [-1.0, size + 1.0, -0.1]];
    add([ground[0], ground[1], ground[2]]);
    add([ground[0], ground[2], ground[3]]);
    add([[0.0, 3.0, 0.7], [size, 3.2, 0.7], [size, 3.6, 0.7]]);
    for i in 0..10 {
        let x = size * (i as f32 + 0.3) / 10.0;
        add([[x, 0.1, 0.2], [size - x, size - 0.3, 9.0], [size - x, size - 0.2, 9.1]]);
    }
    mesh
}

#[test]
fn large_triangles_are_cut_before_bricks_are_made() {
    let mesh = town(40);
    let (report, stored, bytes) = round_trip(&mesh, &options(SplitMode::Sah, 60), &roomy());
    assert!(report.phases.iter().any(|phase| phase.name == "split") && report.pages > 40);
    assert_eq!(report.triangles, 3213);
    let ground = stored.iter().filter(|s| s.face == 11 || s.face == 12).count();
    assert!(ground > 40, "the ground is in {ground} leaves of {} pages", report.pages);
    let most = 3213 * (100 + 25) / 100;
    assert!((3213 + 40..=most * 130 / 100).contains(&report.references), "{} references", report.references);
    let mut distinct = stored;
    distinct.dedup();
    assert_eq!(distinct, expected(&mesh));
    for threads in [1, 2] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        assert!(
            bytes == pool.install(|| round_trip(&mesh, &options(SplitMode::Sah, 60), &TINY)).2,
            "{threads} threads"
        );
    }
    // One page, no ids, or another way to split: nothing is cut.
    let one = options(SplitMode::Sah, 4000);
    let no_ids = BuildOptions { ids: false, ..options(SplitMode::Sah, 60) };
    for options in [one, no_ids, options(SplitMode::Octree, 60)] {
        let (report, ..) = round_trip(&mesh, &options, &TINY);
        assert!(report.phases.iter().all(|phase| phase.name != "split"));
    }
    // A sheet without large triangles: looked at, as its cells are large, and left as it is.
    let (report, ..) = round_trip(&sheet(40), &options(SplitMode::Sah, 60), &TINY);
    assert_eq!(report.references, report.triangles);
}

/// What is seen from outside of a build's phases.
struct Watched {
    phases: Vec<&'static str>,
    /// Whether a file of parts was there at any time.
    parts: bool,
    result: Result<BuildReport>,
}

fn watched(mesh: &Memory, options: &BuildOptions, tuning: &Tuning) -> Watched {
    let folder = tempfile::tempdir().unwrap();
    let seen = Mutex::new((Vec::new(), false));
    let has_parts = || {
        let mut folders = std::fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().path());
        folders.any(|folder| folder.join("parts").exists())
    };
    let sink = |event: Event| {
        let mut seen = seen.lock().unwrap();
        seen.1 |= has_parts();
        if let Event::Phase { name, .. } = event {
            seen.0.push(name);
        }
    };
    let stop = AtomicBool::new(false);
    let output = folder.path().join("a.oct");
    let result = build_tuned(&mut mesh.clone(), &output, options, tuning, Monitor::new(&sink, &stop));
    let (phases, parts) = seen.into_inner().unwrap();
    Watched { phases, parts, result }
}

/// Triangles as large as the whole, of which a few cuts spare no page much.
fn thicket() -> Memory {
    let corner = |i: u32| [i * 37 % 101, i * 53 % 97, i * 71 % 89].map(|x| x as f32);
    let batch = FaceBatch { corners: (0..3000).collect(), ..Default::default() };
    Memory { positions: (0..3000).map(corner).collect(), batches: vec![batch], ..Default::default() }
}

#[test]
fn parts_are_written_only_where_they_pay() {
    let options = options(SplitMode::Sah, 60);
    for (mesh, pays) in [(town(40), true), (thicket(), false)] {
        let Watched { phases, parts, result } = watched(&mesh, &options, &TINY);
        assert!(phases.contains(&"split") && parts == pays && result.is_ok(), "{phases:?}, parts: {parts}");
    }
}

#[test]
fn a_page_too_large_for_the_memory_is_told_before_anything_is_cut() {
    let options = options(SplitMode::Sah, 60);
    // A page of 60 takes 60 * 268 bytes of whole triangles, 60 * 352 of parts; there are 4080 and 3 / 2 of these.
    let tuning = |wave_bytes| Tuning { wave_bytes, ..TINY };
    for (wave_bytes, looked_at) in [(7_000, false), (9_000, true)] {
        let Watched { phases, parts, result } = watched(&town(40), &options, &tuning(wave_bytes));
        let error = result.unwrap_err();
        assert!(matches!(error, Error::Option(_)) && error.to_string().contains("--brick"), "{error}");
        assert!(phases.contains(&"split") == looked_at && !parts, "{phases:?}, parts: {parts}");
    }
    assert!(watched(&town(40), &options, &tuning(12_000)).result.is_ok());
}

#[test]
fn a_directory_too_large_for_the_memory_is_told_before_anything_is_cut() {
    let tuning = Tuning { top_bytes: 20 * 400, ..TINY };
    let Watched { phases, parts, result } = watched(&town(40), &options(SplitMode::Sah, 60), &tuning);
    let error = result.unwrap_err().to_string();
    assert!(error.contains("the directory of more than 20 pages"), "{error}");
    assert!(phases.last() == Some(&"split") && !parts, "{phases:?}, parts: {parts}");
}

#[test]
fn surrogates_of_pages_with_parts_hold() {
    let (mesh, folder) = (town(40), tempfile::tempdir().unwrap());
    let report = build_in(folder.path(), &mesh, &options(SplitMode::Sah, 60), &roomy()).unwrap();
    assert!(report.references > report.triangles);
    let octree = Octree::open(&folder.path().join("a.oct")).unwrap();
    assert!(octree.flags().has(Flags::DETAIL | Flags::REPEATS));
    // Slabs against triangles, heads against pages, the top against heads.
    octree.verify(Monitor::silent()).unwrap();
}
