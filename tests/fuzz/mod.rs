//! Hostile input: what it is held against (`targets`), and where it comes from (`seeds`, `oct`, `text`). tests/fuzz/README.md tells how to run it.

pub mod oct;
pub mod random;
pub mod reading;
pub mod seeds;
pub mod targets;
pub mod text;
