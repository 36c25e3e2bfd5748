//! How text comes: in long lines, compressed, from files that are none; and how reading it ends.

use std::io::Write;

use super::*;

#[test]
fn lines_of_any_length() {
    let count = 200_000;
    let text = format!("{}f{}\n", "v 0 0 0\n".repeat(10), " 1 2 3 4 5 6 7 8 9 10".repeat(count / 10));
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.obj");
    std::fs::write(&path, text).unwrap();
    let seen = read_file(&path, ReadOptions { block: 1000, ..Default::default() }).unwrap();
    assert_eq!(corners(&seen)[0].len(), count);
}

#[test]
fn other_names_and_files_are_refused() {
    let refused = |name: &str| open(Path::new(name), &ReadOptions::default()).err().unwrap();
    assert!(refused("a.off").to_string().contains("it reads .obj, .ply and .stl"));
    assert!(matches!(refused("/nowhere/a.OBJ"), Error::Io { doing: "open", .. }));
    let folder = tempfile::tempdir().unwrap();
    let inner = folder.path().join("a.obj");
    std::fs::create_dir(&inner).unwrap();
    assert!(refused(inner.to_str().unwrap()).to_string().contains("folder"));
    assert_eq!(refused("/nowhere/a.obj").kind(), crate::Kind::Input);
}

#[test]
fn nul_bytes_are_damage() {
    let text = [FOUR.as_bytes(), b"f 1 2 3\n\0\0\0\0\n"].concat();
    assert!(error(&text).contains("NUL"), "{}", error(&text));
}

fn gzip(text: &[u8]) -> Vec<u8> {
    let mut coder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    coder.write_all(text).unwrap();
    coder.finish().unwrap()
}

#[test]
fn compressed_files_are_whole_or_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, bytes: &[u8]| {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        path
    };
    let faces = b"f 1 2 3\nf 2 3 4\n";
    let zip = |text: &[u8]| zstd::encode_all(text, 3).unwrap();
    let parts = [("gz", gzip(FOUR.as_bytes()), gzip(faces)), ("zst", zip(FOUR.as_bytes()), zip(faces))];
    for (suffix, first, second) in parts {
        let name = format!("a.obj.{suffix}");
        let whole = [&first[..], &second].concat();
        for name in [&name[..], "a.obj"] {
            let seen = read_file(&write(name, &whole), ReadOptions { block: 5, ..Default::default() }).unwrap();
            assert_eq!((seen.mesh.positions.len(), corners(&seen).len()), (4, 2));
        }
        for cut in 0..whole.len() {
            let result = read_file(&write(&name, &whole[..cut]), ReadOptions::default());
            match result {
                // Between the two parts the file is whole, as far as anyone can tell.
                Ok(seen) => assert!(cut == first.len() && corners(&seen).is_empty(), "{name} cut at {cut}"),
                Err(error) => assert!(matches!(error, Error::Input { .. }), "{name} cut at {cut}: {error}"),
            }
        }
        let error = read_file(&write(&name, &whole[..whole.len() - 3]), ReadOptions::default()).err().unwrap();
        assert!(error.to_string().contains("data ends early"), "{error}");
        let error = read_file(&write(&name, FOUR.as_bytes()), ReadOptions::default()).err().unwrap();
        assert!(error.to_string().contains("its name says"), "{error}");
        let bad = [&first[..], &zip(b"f 1 2 0\n")].concat();
        if suffix == "zst" {
            let error = read_file(&write(&name, &bad), ReadOptions::default()).err().unwrap();
            assert!(error.to_string().contains(".obj.zst:5:7: index 0"), "{error}");
        }
    }
}

#[test]
fn a_wish_to_stop_is_heard() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.obj");
    std::fs::write(&path, FOUR.repeat(100)).unwrap();
    let stop = AtomicBool::new(true);
    let options = ReadOptions { block: 10, ..Default::default() };
    let mut mesh = Mesh::default();
    let result = open(&path, &options).unwrap().read(&mut mesh, Monitor::new(&|_| {}, &stop));
    assert!(matches!(result, Err(Error::Interrupted)));
    assert!(mesh.positions.len() < 400);
}

#[test]
fn a_pool_of_one_thread_does_not_wait_for_itself() {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let seen = pool.install(|| read(FOUR.repeat(50)));
    assert_eq!(seen.mesh.positions.len(), 200);
}

#[test]
fn progress_ends_at_the_size_of_the_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.obj.gz");
    let packed = gzip(FOUR.repeat(1000).as_bytes());
    std::fs::write(&path, &packed).unwrap();
    let last = Mutex::new((0, None));
    let note = |event: Event| {
        if let Event::Progress { done, total, unit: "bytes" } = event {
            *last.lock().unwrap() = (done, total);
        }
    };
    let stop = AtomicBool::new(false);
    let mut source = open(&path, &ReadOptions { block: 1000, ..Default::default() }).unwrap();
    let size = packed.len() as u64;
    assert_eq!(source.size_hint(), Some(size));
    source.read(&mut Mesh::default(), Monitor::new(&note, &stop)).unwrap();
    assert_eq!(last.into_inner().unwrap(), (size, Some(size)));
}
