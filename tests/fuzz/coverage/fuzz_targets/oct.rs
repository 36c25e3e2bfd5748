#![no_main]

#[path = "../../mod.rs"]
#[allow(dead_code)]
mod fuzz;

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    let mut bytes = data.to_vec();
    // The checks that a lie would not pass are made to pass.
    fuzz::oct::repair(&mut bytes);
    let data = &bytes[..];
    let folder = tempfile::tempdir().unwrap();
    (fuzz::targets::named("oct").run)(data, folder.path());
});
