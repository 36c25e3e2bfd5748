//! Rays as numpy has them: read where they lie if they are float32, converted to that first if not.

use numpy::ndarray::{ArrayView1, ArrayView2, Ix1, Ix2};
use numpy::{Element, PyArrayDyn, PyArrayMethods, PyReadonlyArrayDyn};
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
    pub fn gather(&self, first: usize, count: usize, rays: &mut Vec<Ray>) {
        rays.clear();
        rays.extend((first..first + count).map(|i| Ray {
            origin: self.origins.at(i),
            direction: self.directions.at(i),
            tmin: self.tmin.at(i),
            tmax: self.tmax.at(i),
        }));
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

    #[inline]
    fn at(&self, i: usize) -> [f32; 3] {
        match self {
            Points::One(point) => *point,
            Points::Dense(points) => points[i],
            Points::Spread(points) => [points[(i, 0)], points[(i, 1)], points[(i, 2)]],
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

    #[inline]
    fn at(&self, i: usize) -> f32 {
        match self {
            Ends::One(end) => *end,
            Ends::Each(ends) => ends[i],
        }
    }
}
