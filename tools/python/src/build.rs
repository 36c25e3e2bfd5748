//! Octree files of mesh files and of arrays.

use std::path::PathBuf;

use numpy::PyUntypedArray;
use numpy::ndarray::{ArrayView2, Ix2};
use numpy::prelude::*;
use octrace::build::{BuildOptions, BuildReport};
use octrace::mesh::{self, ReadOptions};
use octrace::{Error, Monitor};
use pyo3::exceptions::PyTypeError;
use pyo3::intern;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arrays::array_of;
use crate::errors::wrong;
use crate::mesh::Arrays;
use crate::octree::Octree;
use crate::size::Size;
use crate::threads::new_pool;
use crate::watch::watched;

/// Bytes for a build that is not told how many it may take, beside what Python has taken already.
const MEMORY: u64 = 1 << 30;

/// Builds an octree file from an OBJ, PLY or STL file, also .gz and .zst; returns what was built.
///
/// memory: what this process may take in all, in bytes or as text like "512M", at least 64M; if not given, 1G more than it has taken. What does
/// not fit goes to temporary files in `temp` (the output's folder if not given). threads: how many, all cores if not given. resume: go on where a build of the same
/// mesh to the same file was killed. lenient: skip faces with a bad index and lines that cannot be read. origin: a point that is
/// subtracted from all coordinates before they become float32. compress: level, 1 to 22, to pack pages with zstd. ids, lod: False leaves out face
/// numbers, what level of detail needs.
///
/// progress(phase, share) is called as work goes on, share rising from 0 to 1; what it raises ends the build, as Ctrl-C does. The
/// result has triangles, source_triangles, vertices, dropped, bytes, bytes_per_triangle, pages and seconds. Faults of the mesh that do
/// not stop the build are warnings (octrace.BuildWarning).
#[pyfunction]
#[pyo3(signature = (
    mesh, octree, *, memory=None, threads=None, temp=None, resume=false, lenient=false, origin=None, compress=None,
    ids=true, lod=true, progress=None
))]
#[allow(clippy::too_many_arguments)]
pub fn build<'py>(
    py: Python<'py>,
    mesh: PathBuf,
    octree: PathBuf,
    memory: Option<Size>,
    threads: Option<usize>,
    temp: Option<PathBuf>,
    resume: bool,
    lenient: bool,
    origin: Option<[f64; 3]>,
    compress: Option<i32>,
    ids: bool,
    lod: bool,
    progress: Option<Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyDict>> {
    let origin = origin.unwrap_or_default();
    let read = ReadOptions { lenient, origin, ..ReadOptions::default() };
    let options = BuildOptions {
        ids,
        lod,
        compress,
        origin,
        memory: memory_for(memory),
        source: mesh::identity(&mesh, &read),
        resume,
        temp,
        name: Some(mesh.clone()),
        ..BuildOptions::default()
    };
    let report = run(py, threads, progress.as_ref(), |monitor| {
        if same_file(&mesh, &octree) {
            return Err(Error::Option(format!("{}: mesh and octree are the same file", mesh.display())));
        }
        let read = ReadOptions { material_memory: options.material_memory(), ..read };
        let read = read.within(options.reading_memory(), rayon::current_num_threads());
        octrace::build::build(mesh::open(&mesh, &read)?.as_mut(), &octree, &options, monitor)
    })?;
    told(py, &report)
}

/// Builds an octree of a mesh in arrays and opens it.
///
/// vertices: (n, 3), used as float32. faces: (m, 3) integers, from 0 on. octree: the file to write; without it the octree has a
/// temporary file, which goes with it. The other arguments are those of `build`.
#[pyfunction]
#[pyo3(signature = (vertices, faces, octree=None, *, memory=None, threads=None, progress=None))]
pub fn from_arrays(
    py: Python<'_>,
    vertices: &Bound<'_, PyAny>,
    faces: &Bound<'_, PyAny>,
    octree: Option<PathBuf>,
    memory: Option<Size>,
    threads: Option<usize>,
    progress: Option<Bound<'_, PyAny>>,
) -> PyResult<Octree> {
    let (vertices, faces) = (array_of::<f32>(vertices)?, array_of::<i64>(&integers(faces)?)?);
    let (Some(vertices), Some(faces)) = (triples(vertices.as_array()), triples(faces.as_array())) else {
        let what =
            format!("vertices and faces have the shapes {:?} and {:?}, not (n, 3)", vertices.shape(), faces.shape());
        return Err(wrong(what));
    };
    let options =
        BuildOptions { memory: memory_for(memory), name: Some("the arrays".into()), ..BuildOptions::default() };
    run(py, threads, progress.as_ref(), |monitor| {
        let mut mesh = Arrays { vertices, faces };
        if let Some(path) = octree {
            octrace::build::build(&mut mesh, &path, &options, monitor)?;
            return Octree::opened(&path, None);
        }
        let folder = tempfile::Builder::new().prefix("octrace-").tempdir();
        let folder = folder.map_err(Error::create(std::env::temp_dir()))?;
        let path = folder.path().join("arrays.oct");
        octrace::build::build(&mut mesh, &path, &options, monitor)?;
        Octree::owning(folder, &path)
    })
}

/// Runs a build on threads of its own, so many or one a core.
fn run<T: Send>(
    py: Python<'_>,
    threads: Option<usize>,
    progress: Option<&Bound<'_, PyAny>>,
    work: impl FnOnce(Monitor<'_>) -> octrace::Result<T> + Send,
) -> PyResult<T> {
    let pool = new_pool(threads)?;
    watched(py, progress, |monitor| pool.install(|| work(monitor)))
}

/// A report as a dictionary.
fn told<'py>(py: Python<'py>, report: &BuildReport) -> PyResult<Bound<'py, PyDict>> {
    let dropped = PyDict::new(py);
    dropped.set_item("degenerate", report.dropped.degenerate)?;
    dropped.set_item("non_finite", report.dropped.non_finite)?;
    dropped.set_item("bad_index", report.dropped.bad_index)?;
    dropped.set_item("too_few_corners", report.dropped.too_few_corners)?;
    let told = PyDict::new(py);
    told.set_item("triangles", report.triangles)?;
    told.set_item("source_triangles", report.source_triangles)?;
    told.set_item("vertices", report.vertices)?;
    told.set_item("dropped", dropped)?;
    told.set_item("bytes", report.bytes)?;
    told.set_item("bytes_per_triangle", report.bytes_per_triangle)?;
    told.set_item("pages", report.pages)?;
    told.set_item("seconds", report.phases.iter().map(|phase| phase.seconds).sum::<f64>())?;
    Ok(told)
}

/// An array, (n, 3).
fn triples<T>(array: numpy::ndarray::ArrayViewD<'_, T>) -> Option<ArrayView2<'_, T>> {
    array.into_dimensionality::<Ix2>().ok().filter(|array| array.ncols() == 3)
}

/// A value as an array of whole numbers; others are refused rather than cut.
fn integers<'py>(value: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
    let py = value.py();
    let array = py.import(intern!(py, "numpy"))?.call_method1(intern!(py, "asarray"), (value,))?;
    let kind = array.cast::<PyUntypedArray>()?.dtype().kind();
    match kind {
        b'i' | b'u' => Ok(array),
        _ => Err(PyTypeError::new_err("faces are whole numbers: an array of an integer type")),
    }
}

/// The bound on the memory of the whole process.
fn memory_for(size: Option<Size>) -> u64 {
    let resident = || {
        let status = std::fs::read_to_string("/proc/self/status").ok()?;
        let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
        Some(line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()? << 10)
    };
    size.map_or_else(|| MEMORY + resident().unwrap_or(0), |size| size.0)
}

/// Whether both are the same file.
fn same_file(a: &std::path::Path, b: &std::path::Path) -> bool {
    matches!((a.canonicalize(), b.canonicalize()), (Ok(a), Ok(b)) if a == b)
}
