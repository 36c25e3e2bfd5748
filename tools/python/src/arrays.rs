//! Rays as numpy has them: read where they lie if they are float32, converted to that first if not.

use numpy::ndarray::{ArrayView1, ArrayView2, Axis, Ix1, Ix2, Slice};
use numpy::{Element, PyArray1, PyArrayDyn, PyArrayMethods, PyReadonlyArrayDyn};
use octrace::geometry::Ray;
use pyo3::intern;
use pyo3::prelude::*;

use crate::errors::wrong;

/// A value as an array of `T`, by `numpy.require`: itself if it is one, else a copy.
pub fn array_of<'py, T: Element>(value: &Bound<'py, PyAny>) -> PyResult<PyReadonlyArrayDyn<'py, T>> {
    let py = value.py();
    let numpy = py.import(intern!(py, "numpy"))?;
    let array = numpy.call_method1(intern!(py, "require"), (value, T::get_dtype(py), "A"))?;
    Ok(array.cast_into::<PyArrayDyn<T>>()?.readonly())
}

/// An array for the answers of so many rays, by `numpy.empty`: each is written once, by the thread that finds it.
///
/// Only of numbers, for which whatever lies there is a value.
pub fn unwritten<'py, T: Element + Number>(py: Python<'py>, count: usize) -> PyResult<Bound<'py, PyArray1<T>>> {
    let numpy = py.import(intern!(py, "numpy"))?;
    Ok(numpy.call_method1(intern!(py, "empty"), (count, T::get_dtype(py)))?.cast_into()?)
}

/// Types of which every pattern of bits is a value.
pub trait Number {}
impl Number for f32 {}
impl Number for u32 {}

/// The arguments of a query, converted; [`Rays`] looks into them.
pub struct Arguments<'py> {
    origins: PyReadonlyArrayDyn<'py, f32>,
    directions: PyReadonlyArrayDyn<'py, f32>,
    tmin: Option<PyReadonlyArrayDyn<'py, f32>>,
    tmax: Option<PyReadonlyArrayDyn<'py, f32>>,
}

impl<'py> Arguments<'py> {
    /// Converts what is not float32.
    pub fn new(
        origins: &Bound<'py, PyAny>,
        directions: &Bound<'py, PyAny>,
        tmin: Option<&Bound<'py, PyAny>>,
        tmax: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Arguments<'py>> {
        Ok(Arguments {
            origins: array_of(origins)?,
            directions: array_of(directions)?,
            tmin: tmin.map(array_of).transpose()?,
            tmax: tmax.map(array_of).transpose()?,
        })
    }

    /// The rays. Fails if the shapes do not go together.
    pub fn rays(&self) -> PyResult<Rays<'_>> {
        let (origins, rows) = Points::new("origins", &self.origins)?;
        let (directions, more) = Points::new("directions", &self.directions)?;
        let count = match (rows, more) {
            (Some(a), Some(b)) if a != b => return Err(wrong(format!("{a} origins, but {b} directions"))),
            (a, b) => a.or(b).unwrap_or(1),
        };
        let tmin = Ends::new("tmin", self.tmin.as_ref(), 0.0, count)?;
        let tmax = Ends::new("tmax", self.tmax.as_ref(), f32::INFINITY, count)?;
        Ok(Rays { origins, directions, tmin, tmax, count })
    }
}

/// Rays in columns.
pub struct Rays<'a> {
    origins: Points<'a>,
    directions: Points<'a>,
    tmin: Ends<'a>,
    tmax: Ends<'a>,
    count: usize,
}

impl Rays<'_> {
    /// How many.
    pub fn len(&self) -> usize {
        self.count
    }

    /// Puts the rays from `first` on into `rays`, `count` of them.
    ///
    /// Column by column, each value straight to its place: a whole ray at a time was put together on the stack in parts and read back across
    /// them, for which processors wait until the parts are written (a sixth of the time of rays that are traced together).
    pub fn gather(&self, first: usize, count: usize, rays: &mut Vec<Ray>) {
        let tmin = if let Ends::One(end) = self.tmin { end } else { 0.0 };
        let tmax = if let Ends::One(end) = self.tmax { end } else { 0.0 };
        rays.clear();
        rays.resize(count, Ray { origin: [0.0; 3], direction: [0.0; 3], tmin, tmax });
        self.origins.give(first, rays, |ray, point| ray.origin = point);
        self.directions.give(first, rays, |ray, vector| ray.direction = vector);
        self.tmin.give_each(first, rays, |ray, end| ray.tmin = end);
        self.tmax.give_each(first, rays, |ray, end| ray.tmax = end);
    }
}

/// Points or vectors of three.
enum Points<'a> {
    /// The same for all rays: shape (3,).
    One([f32; 3]),
    /// Shape (n, 3), without gaps.
    Dense(&'a [[f32; 3]]),
    /// Shape (n, 3), as they lie.
    Spread(ArrayView2<'a, f32>),
}

impl<'a> Points<'a> {
    /// The points of an array, and how many if it is a list of them.
    fn new(name: &str, array: &'a PyReadonlyArrayDyn<'_, f32>) -> PyResult<(Points<'a>, Option<usize>)> {
        let view = array.as_array();
        if let (&[3], Some(&[x, y, z])) = (view.shape(), view.to_slice()) {
            return Ok((Points::One([x, y, z]), None));
        }
        if let ([rows, 3], Ok(view)) = (view.shape(), view.clone().into_dimensionality::<Ix2>()) {
            let points = view.to_slice().map_or(Points::Spread(view), |slice| Points::Dense(slice.as_chunks().0));
            return Ok((points, Some(*rows)));
        }
        Err(wrong(format!("{name} has the shape {:?}, not (n, 3) or (3,)", view.shape())))
    }

    /// Gives each ray its own, those from `first` on.
    fn give(&self, first: usize, rays: &mut [Ray], put: impl Fn(&mut Ray, [f32; 3])) {
        match self {
            Points::One(point) => rays.iter_mut().for_each(|ray| put(ray, *point)),
            Points::Dense(points) => rays.iter_mut().zip(&points[first..]).for_each(|(ray, point)| put(ray, *point)),
            Points::Spread(points) => {
                let points = points.slice_axis(Axis(0), Slice::from(first..first + rays.len()));
                rays.iter_mut().zip(points.rows()).for_each(|(ray, point)| put(ray, [point[0], point[1], point[2]]));
            }
        }
    }
}

/// One end of the rays' intervals.
enum Ends<'a> {
    /// The same for all rays.
    One(f32),
    /// One a ray.
    Each(ArrayView1<'a, f32>),
}

impl<'a> Ends<'a> {
    fn new(name: &str, array: Option<&'a PyReadonlyArrayDyn<'_, f32>>, usual: f32, count: usize) -> PyResult<Ends<'a>> {
        let Some(array) = array else { return Ok(Ends::One(usual)) };
        let view = array.as_array();
        if let (&[], Some(end)) = (view.shape(), view.first()) {
            return Ok(Ends::One(*end));
        }
        match view.clone().into_dimensionality::<Ix1>() {
            Ok(ends) if ends.len() == count => Ok(Ends::Each(ends)),
            _ => Err(wrong(format!(
                "{name} has the shape {:?}; for {count} rays that is () or ({count},)",
                view.shape()
            ))),
        }
    }

    /// Gives each ray its own, those from `first` on, if there is one for each.
    fn give_each(&self, first: usize, rays: &mut [Ray], put: impl Fn(&mut Ray, f32)) {
        if let Ends::Each(ends) = self {
            let ends = ends.slice_axis(Axis(0), Slice::from(first..first + rays.len()));
            rays.iter_mut().zip(ends).for_each(|(ray, end)| put(ray, *end));
        }
    }
}
