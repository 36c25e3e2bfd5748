//! The threads that trace: one a core, or as many as the environment's `RAYON_NUM_THREADS` says.

use std::sync::Mutex;

use pyo3::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};

use crate::errors::wrong;

/// Threads, and the process that they are in.
static POOL: Mutex<Option<(u32, &'static ThreadPool)>> = Mutex::new(None);

/// The threads of this process.
///
/// A process that was forked has none of its parent's threads, only what was known of them, and would wait for them without end;
/// so it gets its own. What it has of the old ones is left alone.
pub fn pool() -> PyResult<&'static ThreadPool> {
    let mut known = POOL.lock().unwrap_or_else(|e| e.into_inner());
    match *known {
        Some((process, pool)) if process == std::process::id() => Ok(pool),
        _ => {
            let pool: &'static ThreadPool = Box::leak(Box::new(new_pool(None)?));
            *known = Some((std::process::id(), pool));
            Ok(pool)
        }
    }
}

/// New threads: so many, or the usual number.
pub fn new_pool(threads: Option<usize>) -> PyResult<ThreadPool> {
    let builder = ThreadPoolBuilder::new().num_threads(threads.unwrap_or(0)).thread_name(|i| format!("octrace {i}"));
    builder.build().map_err(|error| wrong(error.to_string()))
}
