//! From a world to a picture: camera, samples, tiles in parallel, film.
//!
//! [`render`] cuts the picture into tiles and hands them to the threads of the current rayon pool along a Hilbert curve,
//! so that rays traced at about the same time need about the same pages. A pixel's colour depends on the world and its
//! own column and row alone: neither tiles, threads nor a crop change a bit of it. Several machines may each make a share of the tiles ([`render_share`]).

mod aov;
mod camera;
mod film;
mod hilbert;
mod plan;
mod sampling;
mod share;
mod tiles;

pub use aov::{Aov, AovKind, Values, aovs, share_aovs};
pub use camera::Eye;
pub use film::{Film, room_for};
pub use plan::Plan;
pub use share::{Identity, Portion, Share, Tiling, render_share};
pub use tiles::{Picture, Settings, Statistics, Tile, region, render, render_shown};
