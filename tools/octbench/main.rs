//! x
#![allow(dead_code)]
mod oracle;
fn main() {}
