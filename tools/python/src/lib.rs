//! Python bindings of octrace: numpy arrays in and out, the interpreter free meanwhile, all cores used.
//!
//! `octree.rs` is the opened file and answers rays, `build.rs` makes files, of mesh files and of arrays. `arrays.rs` reads rays where numpy
//! has them, `watch.rs` runs a build on another thread while this one calls Python, `threads.rs` has the threads that trace. The types
//! are told to type checkers in `python/octrace/_octrace.pyi`.

mod arrays;
mod build;
mod errors;
mod mesh;
mod octree;
mod size;
mod threads;
mod watch;

use pyo3::prelude::*;

/// The part of the package octrace that is written in Rust.
#[pymodule]
fn _octrace(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add_class::<octree::Octree>()?;
    module.add_function(wrap_pyfunction!(build::build, module)?)?;
    module.add_function(wrap_pyfunction!(build::from_arrays, module)?)
}
