//! What the fuzz targets share: each holds one of tests/fuzz/targets.rs against the bytes as libFuzzer has them, so that what it
//! keeps is an input that the tests on a stable toolchain take as it is.

use std::sync::{LazyLock, Once};

#[path = "../../mod.rs"]
#[allow(dead_code)]
pub mod fuzz;

/// A folder for all inputs of the process. With files that inputs may name: model.obj, other.txt, sheet.mtl, 0.oct to 7.oct.
pub static FOLDER: LazyLock<tempfile::TempDir> = LazyLock::new(|| {
    let folder = tempfile::Builder::new().prefix("octrace-fuzz-").tempdir().unwrap();
    fuzz::seeds::Seeds::new(folder.path());
    folder
});

/// Holds a target against an input. A mesh is built and traced in one case of sixteen, and only read in the others: that takes a hundredth
/// of the time, and it is the readers that the bytes meet.
pub fn run(name: &str, data: &[u8]) {
    static POOL: Once = Once::new();
    // This thread does all that a pool would: then an input reaches the same code each time, and nobody waits for anybody.
    POOL.call_once(|| rayon::ThreadPoolBuilder::new().num_threads(1).use_current_thread().build_global().unwrap());
    let whole = xxhash_rust::xxh3::xxh3_64(data).is_multiple_of(16);
    if whole || !fuzz::targets::only_read(name, data, FOLDER.path()) {
        (fuzz::targets::named(name).run)(data, FOLDER.path());
    }
}
