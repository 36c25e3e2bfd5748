#![no_main]

mod common;

use common::fuzz::{oct, random::Random};

libfuzzer_sys::fuzz_target!(|data: &[u8]| common::run("oct", data));

// Half of the mutations know where the fields are, half are libFuzzer's own. Of both, nine in ten get length and checksums that are
// right before the target sees them: a lie in the content is found behind them alone. What is kept is what was opened.
libfuzzer_sys::fuzz_mutator!(|data: &mut [u8], size: usize, max_size: usize, seed: u32| {
    let mut random = Random(seed.into());
    if random.once_in(2) {
        let mut file = data[..size].to_vec();
        oct::mutate(&mut file, &mut random);
        file.truncate(max_size);
        data[..file.len()].copy_from_slice(&file);
        return file.len();
    }
    let size = libfuzzer_sys::fuzzer_mutate(data, size, max_size);
    if !random.once_in(10) {
        oct::shorten(&mut data[..size]);
    }
    size
});
