//! From a world to a picture: camera, samples, tiles in parallel, film.
//!
//! [`render`] cuts the picture into tiles and hands them to the threads of the current rayon pool along a Hilbert curve,
//! so that rays traced at about the same time need about the same pages. A pixel's colour depends on the world and its
//! own column and row alone: neither tiles, threads nor a crop change a bit of it.

mod aov;
mod camera;
mod film;
mod hilbert;
mod sampling;
mod tiles;

pub use aov::{Aov, AovKind, Values, aovs};
pub use camera::Eye;
pub use film::Film;
pub use tiles::{Picture, Settings, Statistics, render};
