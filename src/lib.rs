//! Exact ray tracing of triangle meshes larger than memory, from an octree file that is traversed in place.
//!
//! See ARCHITECTURE.md for a tour, and [`mod@format`] for the file.
#![deny(unsafe_code)]

pub mod build;
mod cache;
pub mod error;
pub mod event;
pub mod exact;
pub mod format;
pub mod geometry;
pub mod map;
pub mod mesh;
pub mod output;
pub mod render;
pub mod scene;
pub mod shade;
pub mod trace;

pub use cache::{find_or_build, open_or_build};
pub use error::{Diagnostic, Error, Kind, Result, Severity};
pub use event::{Event, Monitor};

// The README's example compiles.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
