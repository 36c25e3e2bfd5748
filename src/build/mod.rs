//! The builder: from a stream of triangles to a finished octree file.
//!
//! Phases, each of them streaming: **scan** takes the vertices into memory and the faces to a temporary file; **join**
//! gives each face its positions, cuts polygons, drops what no ray can hit and writes triangle records; **count** and
//! **distribute** sort the records into chunks, runs of octree cells that fit in memory, within one temporary file;
//! **chunks** takes them in the order of the curve, cuts each into bricks and writes their pages; **stitch** adds the
//! top of the tree and the header. A mesh that fits in one chunk skips the sorting.
//!
//! The bricks are true octree cells and depend on the mesh and the options only, never on the size of a chunk or the
//! number of threads; so the same input gives the same bytes. Work runs on the current rayon pool.
//!
//! Counting into a grid whose cells are merged into chunks is Potree 2's scheme (Schütz, Ohrhallinger and Wimmer 2020),
//! with triangles for points. Memory is a constant (a few chunks) plus the source's vertex data, 12 bytes a vertex, 8 and
//! 12 more for each texture coordinate and normal where there are any.

mod blocks;
mod brick;
mod chunk;
mod distribute;
mod faces;
mod grid;
mod join;
mod materials;
mod options;
mod origin;
mod phases;
mod pipeline;
mod polygon;
mod record;
mod report;
mod scan;
mod spool;
pub(crate) mod subtree;
#[cfg(test)]
mod tests;

pub use options::BuildOptions;
pub use phases::Phase;
pub use pipeline::build;
pub use report::{BuildReport, Polygons};
