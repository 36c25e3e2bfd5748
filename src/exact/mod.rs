//! Geometric decisions that come out as in exact arithmetic on the stored f32 coordinates.
//!
//! Every predicate is a sign of a polynomial in f32 inputs. It is evaluated in floating point with a proved error bound
//! first, and only where the bound does not settle the sign in expansions (`expansion.rs`: sums of f64 that stand for one
//! exact number; Dekker 1971, Shewchuk 1997). The answers therefore never depend on the order of evaluation, on the
//! instruction set, or on how the triangles are stored.
//!
//! - [`Crossing`]: where a ray meets a triangle: hit or miss, exact order along the ray, correctly rounded t, u, v.
//! - [`Shear`]: the f32 filter in front of it, for the vertices of a whole leaf at once (Woop, Benthin and Wald 2013).
//! - [`side`], [`heading`], [`orient2d`], [`exactly_degenerate`], [`touches_box`]: the other predicates that the library needs.
//!
//! What it does not do: nothing here knows of trees, files or pages.

#[cfg(test)]
mod bounds;
mod crossing;
mod expansion;
mod filter;
mod overlap;
mod plane;
mod predicates;
mod quotient;
mod whole;

pub use crossing::{Crossing, Decision, Line};
pub use expansion::Expansion;
pub use filter::{Depths, LANES, Lanes, Shear};
pub use overlap::touches_box;
pub use plane::{exactly_degenerate, orient2d};
pub(crate) use predicates::U;
pub use predicates::{heading, side};
