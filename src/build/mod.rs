//! The builder: from a stream of triangles to a finished octree file.
//!
//! Phases, each of them streaming: **scan** takes vertices and faces to tables, in memory while they fit, else in temporary
//! files; **join** gives each face its positions, cuts polygons, drops what no ray can hit and writes triangle records;
//! **split** (in few meshes) cuts triangles that are much larger than their brick: from there on a record stands for a part of one;
//! **count** (done by the join already, as a rule) and **distribute** sort the records into chunks, runs of octree cells
//! that fit in memory, within one temporary file; **chunks** takes them in the order of the curve, cuts each into bricks
//! and writes their pages; **stitch** adds the top of the tree and the header. A mesh that fits in one chunk skips the sorting.
//!
//! Memory is bounded by [`BuildOptions::memory`], of which each phase has its shares (`options.rs`). Only the directory of
//! pages, materials, and a list of face blocks grow with the mesh, by far less than a byte a triangle.
//!
//! A build that was killed leaves its work folder and a partial file; [`BuildOptions::resume`] goes on from there
//! (`checkpoint.rs`, `scanned.rs`, `page_log.rs`), once all of it has been checked (`sound.rs`).
//!
//! The bricks are true octree cells and depend on the mesh and the options only, never on the size of a chunk or the
//! number of threads; so the same input gives the same bytes. Work runs on the current rayon pool.
//!
//! Counting into a grid whose cells are merged into chunks is Potree 2's scheme (Schütz, Ohrhallinger and Wimmer 2020),
//! with triangles for points.

mod answers;
mod blocks;
mod brick;
mod checkpoint;
mod chunk;
mod distribute;
mod early;
mod faces;
mod grid;
mod join;
mod materials;
mod options;
mod origin;
mod page_log;
mod phases;
mod pipeline;
mod polygon;
mod record;
mod report;
mod room;
mod scan;
mod scanned;
mod sketch;
mod snap;
mod sound;
mod spool;
mod steps;
pub(crate) mod subtree;
mod table;
#[cfg(test)]
mod tests;
mod triangles;
mod words;
mod work;

pub use options::BuildOptions;
pub use phases::Phase;
pub use pipeline::{build, build_spilling};
pub use report::{BuildReport, Polygons};
pub use snap::Positions;
