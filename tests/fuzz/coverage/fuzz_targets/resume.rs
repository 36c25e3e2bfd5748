#![no_main]

#[path = "../../mod.rs"]
#[allow(dead_code)]
mod fuzz;

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    let folder = tempfile::tempdir().unwrap();
    (fuzz::targets::named("resume").run)(data, folder.path());
});
