#![no_main]

mod common;

use common::fuzz::{random::Random, seeds};

libfuzzer_sys::fuzz_target!(|data: &[u8]| common::run("texture", data));

// Nine in ten PNGs get the checksums of their chunks made right again.
libfuzzer_sys::fuzz_mutator!(|data: &mut [u8], size: usize, max_size: usize, seed: u32| {
    let size = libfuzzer_sys::fuzzer_mutate(data, size, max_size);
    if !Random(seed.into()).once_in(10) {
        seeds::repair_png(&mut data[..size]);
    }
    size
});
