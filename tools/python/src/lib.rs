//! Python bindings: arrays in and out, the interpreter free meanwhile, all threads used.

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};

use numpy::ndarray::ArrayView2;
use numpy::{PyArray1, PyArray2, PyArrayLike1, PyArrayLike2, PyArrayMethods};
use pyo3::create_exception;
use pyo3::exceptions::{PyException, PyKeyboardInterrupt, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use rayon::prelude::*;

use octrace::build::BuildOptions;
use octrace::geometry::{Hit, Ray, Skip};
use octrace::mesh::ReadOptions;
use octrace::trace::{OctreeTracer, Tracer, all_hits};
use octrace::{Event, Kind, Monitor};

/// Rays that are put together and traced at a time: their records stay in the caches.
const CHUNK: usize = 8192;

create_exception!(_octrace, Error, PyException, "Something that octrace cannot do; the base of its other exceptions.");

/// The exceptions with two bases each, which only Python's own `class` can make.
struct Exceptions {
    input: Py<PyAny>,
    damaged: Py<PyAny>,
    machine: Py<PyAny>,
}

static EXCEPTIONS: std::sync::OnceLock<Exceptions> = std::sync::OnceLock::new();

/// An error of the library as an exception.
fn raise(error: octrace::Error) -> PyErr {
    let text = error.to_string();
    let Some(exceptions) = EXCEPTIONS.get() else { return Error::new_err(text) };
    let class = match error.kind() {
        Kind::Input => &exceptions.input,
        Kind::Damaged => &exceptions.damaged,
        Kind::Machine => &exceptions.machine,
        Kind::Interrupted => return PyKeyboardInterrupt::new_err(text),
    };
    Python::attach(|py| match class.bind(py).call1((text,)) {
        Ok(value) => PyErr::from_value(value),
        Err(error) => error,
    })
}

/// An octree file, opened.
#[pyclass(frozen, module = "octrace")]
struct Octree {
    tracer: OctreeTracer<Arc<octrace::map::Octree>>,
    /// Where the file lies, if it goes with this.
    _folder: Option<Folder>,
}

/// A temporary folder, removed in the end.
struct Folder(PathBuf);

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

type Points<'py> = PyArrayLike2<'py, f32, numpy::AllowTypeChange>;
type Ends<'py> = PyArrayLike1<'py, f32, numpy::AllowTypeChange>;

/// One end of all intervals, or one for each ray.
#[derive(FromPyObject)]
enum End<'py> {
    All(f32),
    Each(Ends<'py>),
}

/// Rays in columns.
struct Rays<'a> {
    origins: ArrayView2<'a, f32>,
    directions: ArrayView2<'a, f32>,
    tmin: Interval<'a>,
    tmax: Interval<'a>,
}

/// One end of an interval.
enum Interval<'a> {
    All(f32),
    Each(numpy::ndarray::ArrayView1<'a, f32>),
}

impl Interval<'_> {
    fn at(&self, i: usize) -> f32 {
        match self {
            Interval::All(end) => *end,
            Interval::Each(ends) => ends[i],
        }
    }
}

impl<'a> Rays<'a> {
    fn new(origins: &'a Points<'_>, directions: &'a Points<'_>, tmin: &'a End<'_>, tmax: &'a End<'_>) -> PyResult<Rays<'a>> {
        let (origins, directions) = (origins.as_array(), directions.as_array());
        for (name, array) in [("origins", &origins), ("directions", &directions)] {
            if array.ncols() != 3 {
                return Err(PyValueError::new_err(format!("{name} has the shape {:?}, not (n, 3)", array.shape())));
            }
        }
        if origins.nrows() != directions.nrows() {
            let what = format!("{} origins, but {} directions", origins.nrows(), directions.nrows());
            return Err(PyValueError::new_err(what));
        }
        let end = |name: &str, end: &'a End<'_>| match end {
            End::All(end) => Ok(Interval::All(*end)),
            End::Each(ends) if ends.as_array().len() == origins.nrows() => Ok(Interval::Each(ends.as_array())),
            End::Each(ends) => {
                let what = format!("{name} has {} entries for {} rays", ends.as_array().len(), origins.nrows());
                Err(PyValueError::new_err(what))
            }
        };
        Ok(Rays { origins, directions, tmin: end("tmin", tmin)?, tmax: end("tmax", tmax)? })
    }

    fn len(&self) -> usize {
        self.origins.nrows()
    }

    fn ray(&self, i: usize) -> Ray {
        let row = |array: &ArrayView2<'_, f32>| [array[(i, 0)], array[(i, 1)], array[(i, 2)]];
        Ray { origin: row(&self.origins), direction: row(&self.directions), tmin: self.tmin.at(i), tmax: self.tmax.at(i) }
    }

    /// The rays from `first` on, as many as `rays` has room for.
    fn chunk(&self, first: usize, count: usize) -> Vec<Ray> {
        (first..first + count).map(|i| self.ray(i)).collect()
    }
}

type Columns<'py> = (Bound<'py, PyArray1<f32>>, Bound<'py, PyArray1<u32>>, Bound<'py, PyArray1<f32>>, Bound<'py, PyArray1<f32>>);

#[pymethods]
impl Octree {
    /// Opens an octree file.
    #[staticmethod]
    fn open(py: Python<'_>, path: PathBuf) -> PyResult<Octree> {
        py.detach(|| opened(&path, None)).map_err(raise)
    }

    /// The closest hit of each ray: t, face, u, v.
    #[pyo3(signature = (origins, directions, tmin=End::All(0.0), tmax=End::All(f32::INFINITY)))]
    fn intersect<'py>(
        &self,
        py: Python<'py>,
        origins: Points<'py>,
        directions: Points<'py>,
        tmin: End<'py>,
        tmax: End<'py>,
    ) -> PyResult<Columns<'py>> {
        let rays = Rays::new(&origins, &directions, &tmin, &tmax)?;
        let n = rays.len();
        let (t, face) = (PyArray1::<f32>::zeros(py, n, false), PyArray1::<u32>::zeros(py, n, false));
        let (u, v) = (PyArray1::<f32>::zeros(py, n, false), PyArray1::<f32>::zeros(py, n, false));
        {
            let (mut t, mut face, mut u, mut v) = (t.readwrite(), face.readwrite(), u.readwrite(), v.readwrite());
            let columns = (t.as_slice_mut()?, face.as_slice_mut()?, u.as_slice_mut()?, v.as_slice_mut()?);
            let done = py.detach(|| {
                let (t, face, u, v) = columns;
                let chunks = (t.par_chunks_mut(CHUNK), face.par_chunks_mut(CHUNK), u.par_chunks_mut(CHUNK), v.par_chunks_mut(CHUNK));
                chunks.into_par_iter().enumerate().try_for_each(|(i, (t, face, u, v))| {
                    let mut hits = vec![Hit::MISS; t.len()];
                    self.tracer.closest_batch(&rays.chunk(i * CHUNK, t.len()), &mut hits)?;
                    for (k, hit) in hits.iter().enumerate() {
                        (t[k], face[k], u[k], v[k]) = (hit.t, hit.face.0, hit.u, hit.v);
                    }
                    Ok(())
                })
            });
            done.map_err(raise)?;
        }
        Ok((t, face, u, v))
    }

    /// Whether anything lies on each ray.
    #[pyo3(signature = (origins, directions, tmin=End::All(0.0), tmax=End::All(f32::INFINITY)))]
    fn occluded<'py>(
        &self,
        py: Python<'py>,
        origins: Points<'py>,
        directions: Points<'py>,
        tmin: End<'py>,
        tmax: End<'py>,
    ) -> PyResult<Bound<'py, PyArray1<bool>>> {
        let rays = Rays::new(&origins, &directions, &tmin, &tmax)?;
        let blocked = PyArray1::<bool>::zeros(py, rays.len(), false);
        {
            let mut blocked = blocked.readwrite();
            let blocked = blocked.as_slice_mut()?;
            let done = py.detach(|| {
                blocked.par_chunks_mut(CHUNK).enumerate().try_for_each(|(i, blocked)| {
                    self.tracer.any_batch(&rays.chunk(i * CHUNK, blocked.len()), blocked).map(|_| ())
                })
            });
            done.map_err(raise)?;
        }
        Ok(blocked)
    }

    /// All hits of each ray, by ray and then by t.
    #[pyo3(signature = (origins, directions, tmin=End::All(0.0), tmax=End::All(f32::INFINITY), max_hits=None))]
    #[allow(clippy::type_complexity)]
    fn intersect_all<'py>(
        &self,
        py: Python<'py>,
        origins: Points<'py>,
        directions: Points<'py>,
        tmin: End<'py>,
        tmax: End<'py>,
        max_hits: Option<usize>,
    ) -> PyResult<(Bound<'py, PyArray1<i64>>, Bound<'py, PyArray1<f32>>, Bound<'py, PyArray1<u32>>, Bound<'py, PyArray1<f32>>, Bound<'py, PyArray1<f32>>)>
    {
        let rays = Rays::new(&origins, &directions, &tmin, &tmax)?;
        let most = max_hits.unwrap_or(usize::MAX);
        let found = py.detach(|| {
            let chunks = (0..rays.len().div_ceil(CHUNK)).into_par_iter().map(|chunk| {
                let mut hits = Vec::new();
                for i in chunk * CHUNK..((chunk + 1) * CHUNK).min(rays.len()) {
                    for found in all_hits(&self.tracer, &rays.ray(i), Skip::NONE).take(most) {
                        hits.push((i as i64, found?.hit));
                    }
                }
                Ok(hits)
            });
            chunks.collect::<octrace::Result<Vec<_>>>()
        });
        let hits: Vec<(i64, Hit)> = found.map_err(raise)?.concat();
        let float = |of: fn(&Hit) -> f32| PyArray1::from_iter(py, hits.iter().map(|(_, hit)| of(hit)));
        Ok((
            PyArray1::from_iter(py, hits.iter().map(|(ray, _)| *ray)),
            float(|hit| hit.t),
            PyArray1::from_iter(py, hits.iter().map(|(_, hit)| hit.face.0)),
            float(|hit| hit.u),
            float(|hit| hit.v),
        ))
    }

    /// Lowest and highest corner of all triangles.
    #[getter]
    fn bounds<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let bounds = self.tracer.bounds();
        Ok(PyArray2::from_vec2(py, &[bounds.min.to_array().to_vec(), bounds.max.to_array().to_vec()])?)
    }

    /// The file's path as it was given.
    #[getter]
    fn path(&self) -> PathBuf {
        self.tracer.octree().path().to_owned()
    }

    /// Faces of the source.
    #[getter]
    fn source_triangles(&self) -> u64 {
        self.tracer.octree().header().source_triangles
    }

    fn __len__(&self) -> usize {
        self.tracer.octree().header().triangles as usize
    }

    fn __repr__(&self) -> String {
        let octree = self.tracer.octree();
        format!("<octrace.Octree {:?}: {} triangles>", octree.path(), octree.header().triangles)
    }
}

/// Opens a file that may go with its folder.
fn opened(path: &std::path::Path, folder: Option<Folder>) -> octrace::Result<Octree> {
    let octree = Arc::new(octrace::map::Octree::open(path)?);
    Ok(Octree { tracer: OctreeTracer::new(octree), _folder: folder })
}

/// A size in bytes: a number, or text like 512M.
#[derive(FromPyObject)]
enum Size {
    Bytes(u64),
    Text(String),
}

impl Size {
    fn bytes(&self) -> PyResult<u64> {
        let Size::Text(text) = self else {
            let Size::Bytes(bytes) = self else { unreachable!() };
            return Ok(*bytes);
        };
        let wrong = || PyValueError::new_err(format!("{text:?} is no size; say 512M or 1.5G"));
        let digits = text.find(|c: char| !c.is_ascii_digit() && c != '.').unwrap_or(text.len());
        let number: f64 = text[..digits].parse().map_err(|_| wrong())?;
        let unit = text[digits..].trim().to_ascii_lowercase();
        let shift = match unit.trim_end_matches("ib").trim_end_matches('b') {
            "" => 0,
            "k" => 10,
            "m" => 20,
            "g" => 30,
            "t" => 40,
            _ => return Err(wrong()),
        };
        Ok((number * (1u64 << shift) as f64) as u64)
    }
}

/// Builds an octree file from a mesh file.
#[pyfunction]
#[pyo3(signature = (mesh, octree, *, memory=Size::Bytes(1 << 30), threads=None, compress=None, lenient=false, ids=true, progress=None))]
#[allow(clippy::too_many_arguments)]
fn build<'py>(
    py: Python<'py>,
    mesh: PathBuf,
    octree: PathBuf,
    memory: Size,
    threads: Option<usize>,
    compress: Option<i32>,
    lenient: bool,
    ids: bool,
    progress: Option<Py<PyAny>>,
) -> PyResult<Bound<'py, PyDict>> {
    let options = BuildOptions { memory: memory.bytes()?, compress, ids, name: Some(mesh.clone()), ..BuildOptions::default() };
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads.unwrap_or(0)).build();
    let pool = pool.map_err(|error| PyValueError::new_err(error.to_string()))?;
    let (stop, raised, phase) = (AtomicBool::new(false), Mutex::new(None), Mutex::new("scan"));
    let sink = |event: Event| {
        let share = match event {
            Event::Phase { name } => {
                *phase.lock().unwrap() = name;
                None
            }
            Event::Progress { done, total, .. } => total.map(|total| done as f64 / total.max(1) as f64),
            _ => return,
        };
        Python::attach(|py| {
            let told = progress.as_ref().map_or(Ok(()), |call| call.call1(py, (*phase.lock().unwrap(), share)).map(|_| ()));
            if let Err(error) = told.and_then(|()| py.check_signals()) {
                raised.lock().unwrap().get_or_insert(error);
                stop.store(true, Ordering::Relaxed);
            }
        });
    };
    let report = py.detach(|| {
        pool.install(|| {
            let read = ReadOptions { lenient, most_materials: options.most_materials(), ..ReadOptions::default() };
            let mut source = octrace::mesh::open(&mesh, &read.within(options.reading_memory(), rayon::current_num_threads()))?;
            octrace::build::build(source.as_mut(), &octree, &options, Monitor::new(&sink, &stop))
        })
    });
    if let Some(error) = raised.into_inner().unwrap() {
        return Err(error);
    }
    let report = report.map_err(raise)?;
    let dropped = PyDict::new(py);
    dropped.set_item("degenerate", report.dropped.degenerate)?;
    dropped.set_item("non_finite", report.dropped.non_finite)?;
    dropped.set_item("bad_index", report.dropped.bad_index)?;
    dropped.set_item("too_few_corners", report.dropped.too_few_corners)?;
    let told = PyDict::new(py);
    told.set_item("triangles", report.triangles)?;
    told.set_item("vertices", report.vertices)?;
    told.set_item("dropped", dropped)?;
    told.set_item("bytes", report.bytes)?;
    told.set_item("bytes_per_triangle", report.bytes_per_triangle)?;
    told.set_item("pages", report.pages)?;
    Ok(told)
}

/// Builds an octree from arrays and opens it.
#[pyfunction]
#[pyo3(signature = (vertices, faces, octree=None))]
fn from_arrays(
    py: Python<'_>,
    vertices: Points<'_>,
    faces: PyArrayLike2<'_, i64, numpy::AllowTypeChange>,
    octree: Option<PathBuf>,
) -> PyResult<Octree> {
    let (vertices, faces) = (vertices.as_array(), faces.as_array());
    if vertices.ncols() != 3 || faces.ncols() != 3 {
        let what = format!("vertices and faces have the shapes {:?} and {:?}, not (n, 3)", vertices.shape(), faces.shape());
        return Err(PyValueError::new_err(what));
    }
    let count = vertices.nrows() as i64;
    if let Some(wrong) = faces.iter().find(|&&i| !(0..count).contains(&i)) {
        return Err(PyValueError::new_err(format!("a face names vertex {wrong} of {count}")));
    }
    py.detach(|| {
        let folder = temporary_folder()?;
        let ply = folder.0.join("mesh.ply");
        write_ply(&ply, vertices, faces)?;
        let path = octree.clone().unwrap_or_else(|| folder.0.join("mesh.oct"));
        let mut source = octrace::mesh::open(&ply, &ReadOptions::default())?;
        octrace::build::build(source.as_mut(), &path, &BuildOptions::default(), Monitor::silent())?;
        opened(&path, octree.is_none().then_some(folder))
    })
    .map_err(raise)
}

/// A folder of its own for this process.
fn temporary_folder() -> octrace::Result<Folder> {
    static COUNT: std::sync::atomic::AtomicU64 = std::sync::atomic::AtomicU64::new(0);
    let name = format!("octrace-{}-{}", std::process::id(), COUNT.fetch_add(1, Ordering::Relaxed));
    let path = std::env::temp_dir().join(name);
    std::fs::create_dir(&path).map_err(octrace::Error::io(&path, "create"))?;
    Ok(Folder(path))
}

/// A mesh as binary PLY.
fn write_ply(path: &std::path::Path, vertices: ArrayView2<'_, f32>, faces: ArrayView2<'_, i64>) -> octrace::Result<()> {
    use std::io::Write;
    let write = || -> std::io::Result<()> {
        let mut file = std::io::BufWriter::new(std::fs::File::create(path)?);
        write!(
            file,
            "ply\nformat binary_little_endian 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n\
             element face {}\nproperty list uchar uint vertex_indices\nend_header\n",
            vertices.nrows(),
            faces.nrows()
        )?;
        for row in vertices.rows() {
            row.iter().try_for_each(|x| file.write_all(&x.to_le_bytes()))?;
        }
        for row in faces.rows() {
            file.write_all(&[3])?;
            row.iter().try_for_each(|&i| file.write_all(&(i as u32).to_le_bytes()))?;
        }
        file.flush()
    };
    write().map_err(octrace::Error::io(path, "write"))
}

#[pymodule]
fn _octrace(module: &Bound<'_, PyModule>) -> PyResult<()> {
    let py = module.py();
    let names = PyDict::new(py);
    names.set_item("Error", py.get_type::<Error>())?;
    py.run(
        c"
class InputError(Error, ValueError):
    'Input or an argument is at fault.'
class DamagedError(Error):
    'An octree file is damaged.'
class MachineError(Error, OSError):
    'The machine failed: disk, permission, input or output.'
for error in (InputError, DamagedError, MachineError):
    error.__module__ = 'octrace'
",
        Some(&names),
        None,
    )?;
    let class = |name: &str| -> PyResult<Py<PyAny>> {
        let class = names.get_item(name)?.ok_or_else(|| PyValueError::new_err("no such class"))?;
        module.add(name, &class)?;
        Ok(class.unbind())
    };
    let exceptions = Exceptions { input: class("InputError")?, damaged: class("DamagedError")?, machine: class("MachineError")? };
    let _ = EXCEPTIONS.set(exceptions);
    module.add("Error", py.get_type::<Error>())?;
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add_class::<Octree>()?;
    module.add_function(wrap_pyfunction!(build, module)?)?;
    module.add_function(wrap_pyfunction!(from_arrays, module)?)
}
