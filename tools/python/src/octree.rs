//! The opened octree file, and rays against it.

use std::path::PathBuf;

use numpy::{IntoPyArray, PyArray1, PyArray2, PyArrayMethods};
use octrace::Error;
use octrace::geometry::{Hit, Ray, Skip};
use octrace::map::{self, Read};
use octrace::trace::{Counters, Found, OctreeTracer, Tracer};
use pyo3::prelude::*;
use rayon::prelude::*;

use crate::arrays::{Arguments, Rays, unwritten};
use crate::errors::raise;
use crate::size::Size;
use crate::threads::pool;

/// Rays that are put together and traced at a time: as many as a tracer gives to a thread, and they and their hits stay in its cache.
const PIECE: usize = 1 << 10;
/// Rays between two looks at whether the user wants to stop.
const STRETCH: usize = 1 << 20;
/// Rays at a time, fewest and most, where rays wait for pages.
const WAITING: [usize; 2] = [1 << 14, 1 << 18];
/// Bytes of a ray, its answer, and what it takes while it waits for a page.
const RAY_BYTES: u64 = 48 + 128;

/// An octree file, opened.
///
/// Its methods may be called from several threads at once; each uses all cores and lets other Python threads run.
#[pyclass(frozen, module = "octrace")]
pub struct Octree {
    /// In a box, as Python aligns its objects to 16 bytes and a tracer needs more.
    tracer: Box<OctreeTracer<map::Octree>>,
    /// Rays between two looks at whether to stop, and rays at a time.
    stretch: usize,
    piece: usize,
    /// Whether the file is of no one else.
    own: Option<Own>,
}

const _: () = assert!(align_of::<Octree>() <= 16, "Python aligns its objects to 16 bytes");

/// A file that goes with its octree.
struct Own {
    /// Its folder, if that cannot go before.
    _folder: Option<tempfile::TempDir>,
}

type Column<'py, T> = Bound<'py, PyArray1<T>>;
/// t, face, u, v.
type Columns<'py> = (Column<'py, f32>, Column<'py, u32>, Column<'py, f32>, Column<'py, f32>);
/// ray, t, face, u, v.
type AllColumns<'py> = (Column<'py, i64>, Column<'py, f32>, Column<'py, u32>, Column<'py, f32>, Column<'py, f32>);

#[pymethods]
impl Octree {
    /// Opens an octree file, which takes the same time whatever its size: pages are read when rays first need them.
    ///
    /// Without `memory` the file is mapped, and memory is the system's care (a packed file gets half of what is free). With it, pages and the
    /// rays that wait for them take at most so many bytes (a number, or text like "512M"), beside the arrays of a call.
    #[staticmethod]
    #[pyo3(signature = (path, *, memory=None))]
    fn open(py: Python<'_>, path: PathBuf, memory: Option<Size>) -> PyResult<Octree> {
        py.detach(|| Octree::opened(&path, memory)).map_err(raise)
    }

    /// The closest hit of each ray: t, face, u, v, each (n,).
    ///
    /// origins, directions: (n, 3), or (3,) for all rays the same; used as float32, and where they lie if they are that. tmin, tmax: the
    /// closed interval of t, for all rays or one each. The hit lies at origin + t * direction = (1 - u - v) a + u b + v c, with the
    /// corners a, b, c of the face. A miss has t = inf and face = NO_FACE.
    #[pyo3(signature = (origins, directions, tmin=None, tmax=None))]
    fn intersect<'py>(
        &self,
        py: Python<'py>,
        origins: &Bound<'py, PyAny>,
        directions: &Bound<'py, PyAny>,
        tmin: Option<&Bound<'py, PyAny>>,
        tmax: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Columns<'py>> {
        let arguments = Arguments::new(origins, directions, tmin, tmax)?;
        let rays = arguments.rays()?;
        let n = rays.len();
        let (t, face, u, v) = (unwritten(py, n)?, unwritten(py, n)?, unwritten(py, n)?, unwritten(py, n)?);
        {
            let (mut t, mut face, mut u, mut v) = (t.readwrite(), face.readwrite(), u.readwrite(), v.readwrite());
            let (t, face) = (t.as_slice_mut()?.chunks_mut(self.stretch), face.as_slice_mut()?.chunks_mut(self.stretch));
            let (u, v) = (u.as_slice_mut()?.chunks_mut(self.stretch), v.as_slice_mut()?.chunks_mut(self.stretch));
            let stretches = t.zip(face).zip(u.zip(v)).map(|((t, face), (u, v))| (t, face, u, v));
            self.in_stretches(py, stretches, |first, hits| self.closest(&rays, first, hits))?;
        }
        Ok((t, face, u, v))
    }

    /// Whether anything lies on each ray between tmin and tmax, (n,): faster than `intersect`.
    ///
    /// The arguments are those of `intersect`.
    #[pyo3(signature = (origins, directions, tmin=None, tmax=None))]
    fn occluded<'py>(
        &self,
        py: Python<'py>,
        origins: &Bound<'py, PyAny>,
        directions: &Bound<'py, PyAny>,
        tmin: Option<&Bound<'py, PyAny>>,
        tmax: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Column<'py, bool>> {
        let arguments = Arguments::new(origins, directions, tmin, tmax)?;
        let rays = arguments.rays()?;
        let blocked = PyArray1::<bool>::zeros(py, rays.len(), false);
        {
            let mut blocked = blocked.readwrite();
            let stretches = blocked.as_slice_mut()?.chunks_mut(self.stretch);
            self.in_stretches(py, stretches, |first, blocked| self.any(&rays, first, blocked))?;
        }
        Ok(blocked)
    }

    /// All hits of each ray, by ray and then by t: ray, t, face, u, v, each (m,).
    ///
    /// Of each ray at most `max_hits`, the nearest. The other arguments are those of `intersect`.
    #[pyo3(signature = (origins, directions, tmin=None, tmax=None, *, max_hits=None))]
    fn intersect_all<'py>(
        &self,
        py: Python<'py>,
        origins: &Bound<'py, PyAny>,
        directions: &Bound<'py, PyAny>,
        tmin: Option<&Bound<'py, PyAny>>,
        tmax: Option<&Bound<'py, PyAny>>,
        max_hits: Option<usize>,
    ) -> PyResult<AllColumns<'py>> {
        let arguments = Arguments::new(origins, directions, tmin, tmax)?;
        let rays = arguments.rays()?;
        let mut all = Met::default();
        let stretches = (0..rays.len()).step_by(self.stretch).map(|first| (first + self.stretch).min(rays.len()));
        self.in_stretches(py, stretches, |first, end| {
            all.append(self.all(&rays, first..end, max_hits.unwrap_or(usize::MAX))?);
            Ok(())
        })?;
        let Met { ray, t, face, u, v } = all;
        Ok((ray.into_pyarray(py), t.into_pyarray(py), face.into_pyarray(py), u.into_pyarray(py), v.into_pyarray(py)))
    }

    /// Lowest and highest corner of all triangles, (2, 3).
    #[getter]
    fn bounds<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let bounds = self.tracer.bounds();
        Ok(PyArray2::from_vec2(py, &[bounds.min.to_array().to_vec(), bounds.max.to_array().to_vec()])?)
    }

    /// The point that was subtracted from the mesh's coordinates when the file was built, (3,): rays are in that frame.
    #[getter]
    fn origin<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        PyArray1::from_slice(py, &self.tracer.octree().header().origin)
    }

    /// The file's path as it was given; None if the octree has a temporary file of its own.
    #[getter]
    fn path(&self) -> Option<PathBuf> {
        self.own.is_none().then(|| self.tracer.octree().path().to_owned())
    }

    /// The number of triangles of the source, those that were left out among them; face numbers are below.
    #[getter]
    fn source_triangles(&self) -> u64 {
        self.tracer.octree().header().source_triangles
    }

    /// The number of triangles.
    fn __len__(&self) -> usize {
        self.tracer.octree().header().triangles as usize
    }

    fn __repr__(&self) -> String {
        let octree = self.tracer.octree();
        let name = if self.own.is_none() { format!("{:?}", octree.path()) } else { "in a temporary file".into() };
        format!("<octrace.Octree {name}: {} triangles>", octree.header().triangles)
    }
}

impl Octree {
    /// Opens a file.
    pub fn opened(path: &std::path::Path, memory: Option<Size>) -> octrace::Result<Octree> {
        let (octree, stretch, piece) = match memory {
            Some(Size(memory)) => {
                let (cache, waiting) = shares(memory, map::Octree::least_cache(path)?)?;
                (map::Octree::open_with(path, Read::Budgeted { cache })?, waiting, waiting)
            }
            None => match map::Octree::open(path)? {
                octree if octree.is_budgeted() => (octree, WAITING[1], WAITING[1]),
                octree => (octree, STRETCH, PIECE),
            },
        };
        Ok(Octree { tracer: Box::new(OctreeTracer::new(octree)), stretch, piece, own: None })
    }

    /// Opens a file in a temporary folder, which goes with it.
    pub fn owning(folder: tempfile::TempDir, path: &std::path::Path) -> octrace::Result<Octree> {
        let octree = Octree::opened(path, None)?;
        // Where a file that is open can be removed, nothing is left behind, however Python ends.
        let folder = if cfg!(unix) { None } else { Some(folder) };
        Ok(Octree { own: Some(Own { _folder: folder }), ..octree })
    }

    /// Does `work`, with the number of its first ray, for each of the stretches, the interpreter free; looks in between whether to stop.
    fn in_stretches<T: Send>(
        &self,
        py: Python<'_>,
        stretches: impl Iterator<Item = T>,
        mut work: impl FnMut(usize, T) -> octrace::Result<()> + Send,
    ) -> PyResult<()> {
        let pool = pool()?;
        for (number, stretch) in stretches.enumerate() {
            py.detach(|| pool.install(|| work(number * self.stretch, stretch))).map_err(raise)?;
            py.check_signals()?;
        }
        Ok(())
    }

    /// The closest hits of a stretch.
    fn closest(&self, rays: &Rays<'_>, first: usize, (t, face, u, v): Answers<'_>) -> octrace::Result<()> {
        let piece = self.piece;
        let (t, face) = (t.par_chunks_mut(piece), face.par_chunks_mut(piece));
        let (u, v) = (u.par_chunks_mut(piece), v.par_chunks_mut(piece));
        (t, face, u, v).into_par_iter().enumerate().try_for_each_init(
            || (Vec::new(), Vec::new()),
            |(some, hits), (number, (t, face, u, v))| {
                rays.gather(first + number * piece, t.len(), some);
                hits.resize(t.len(), Hit::MISS);
                self.tracer.closest_batch(some, hits)?;
                for (hit, (((t, face), u), v)) in hits.iter().zip(t.iter_mut().zip(face).zip(u).zip(v)) {
                    (*t, *face, *u, *v) = (hit.t, hit.face.0, hit.u, hit.v);
                }
                Ok(())
            },
        )
    }

    /// Whether anything is on the rays of a stretch.
    fn any(&self, rays: &Rays<'_>, first: usize, blocked: &mut [bool]) -> octrace::Result<()> {
        blocked.par_chunks_mut(self.piece).enumerate().try_for_each_init(Vec::new, |some, (number, blocked)| {
            rays.gather(first + number * self.piece, blocked.len(), some);
            self.tracer.any_batch(some, blocked).map(|_| ())
        })
    }

    /// All hits of a stretch, at most so many of a ray.
    fn all(&self, rays: &Rays<'_>, range: std::ops::Range<usize>, most: usize) -> octrace::Result<Met> {
        let pieces = range.len().div_ceil(PIECE);
        let met = (0..pieces).into_par_iter().map(|piece| {
            let first = range.start + piece * PIECE;
            let mut some = Vec::new();
            rays.gather(first, PIECE.min(range.end - first), &mut some);
            self.all_of(&some, first, most)
        });
        let pieces: Vec<Met> = met.collect::<octrace::Result<_>>()?;
        let mut all = Met::default();
        pieces.into_iter().for_each(|piece| all.append(piece));
        Ok(all)
    }

    /// All hits of these rays, the first of which has the number `first`: the closest ones together, then what lies behind each.
    fn all_of(&self, rays: &[Ray], first: usize, most: usize) -> octrace::Result<Met> {
        let mut met = Met::default();
        let mut closest = vec![None; rays.len()];
        self.tracer.closest_each(rays, &vec![Skip::NONE; rays.len()], &mut closest, &mut Counters::default())?;
        for (i, closest) in closest.into_iter().enumerate() {
            let (mut left, mut next): (usize, Option<Found>) = (most, closest);
            while let (Some(found), 1..) = (next, left) {
                met.push(first + i, &found.hit);
                left -= 1;
                next = if left > 0 { self.tracer.next(&rays[i], Skip::NONE, &found)? } else { None };
            }
        }
        Ok(met)
    }
}

/// Where the hits of a stretch go: t, face, u, v.
type Answers<'a> = (&'a mut [f32], &'a mut [u32], &'a mut [f32], &'a mut [f32]);

/// Hits in columns.
#[derive(Default)]
struct Met {
    ray: Vec<i64>,
    t: Vec<f32>,
    face: Vec<u32>,
    u: Vec<f32>,
    v: Vec<f32>,
}

impl Met {
    fn push(&mut self, ray: usize, hit: &Hit) {
        self.ray.push(ray as i64);
        self.t.push(hit.t);
        self.face.push(hit.face.0);
        self.u.push(hit.u);
        self.v.push(hit.v);
    }

    fn append(&mut self, mut other: Met) {
        self.ray.append(&mut other.ray);
        self.t.append(&mut other.t);
        self.face.append(&mut other.face);
        self.u.append(&mut other.u);
        self.v.append(&mut other.v);
    }
}

/// How many bytes of the memory pages may take, and how many rays may wait at a time: up to a quarter of it is for rays.
fn shares(memory: u64, least: u64) -> octrace::Result<(u64, usize)> {
    let need = least + WAITING[0] as u64 * RAY_BYTES;
    if memory < need {
        let what = format!("memory is too small for this file: the least is {}M", need.div_ceil(1 << 20));
        return Err(Error::Option(what));
    }
    let mut rays = WAITING[0];
    while rays < WAITING[1] && 2 * rays as u64 * RAY_BYTES <= (memory - least).min(memory / 4) {
        rays *= 2;
    }
    Ok((memory - rays as u64 * RAY_BYTES, rays))
}
