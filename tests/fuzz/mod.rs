//! Hostile input: what it is held against (`targets`), and where it comes from (`seeds`, `oct`, `text`, `leftovers`). tests/fuzz/README.md tells how to run it.

pub mod leftovers;
pub mod oct;
#[path = "../trace_common/random.rs"]
pub mod random;
pub mod reading;
pub mod resume;
pub mod seeds;
pub mod targets;
pub mod text;
