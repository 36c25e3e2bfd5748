//! Shapes. They take a copy of the current material and stand where the current transform puts them.
//!
//! Corners are transformed in f64 and rounded to f32 once; from then on they are exact.

use glam::{DAffine3, DMat3, DVec3, Vec3};

use super::super::args::{Args, Limit};
use super::super::diagnose::{Problem, Step};
use super::super::parser::State;
use super::super::{Geometry, Shape};
use crate::geometry::Triangle;

/// Relative deviation up to which a matrix counts as a rotation times a scale.
const SIMILAR: f64 = 1e-12;

fn add(state: &mut State, geometry: Geometry) {
    let material = state.material_index();
    state.scene.shapes.push(Shape { geometry, material });
}

pub(super) fn sphere(state: &mut State, args: &mut Args) -> Step<()> {
    let center = args.vector("the centre")?;
    let radius = args.number("the radius", &Limit::POSITIVE)?;
    let geometry = match similarity(state.transform.matrix3) {
        Some(scale) => {
            let center = state.placed(center, args)?;
            let radius = radius * scale;
            if !(radius > 0.0 && radius <= f64::from(f32::MAX)) {
                return Err(Problem::new(args.last_span(), "the radius leaves the range of numbers when scaled"));
            }
            Geometry::Sphere { center, radius, to_world: DAffine3::IDENTITY }
        }
        None => Geometry::Sphere { center, radius, to_world: state.transform },
    };
    add(state, geometry);
    Ok(())
}

/// The factor by which `m` scales all lengths alike, if it does.
fn similarity(m: DMat3) -> Option<f64> {
    let gram = m.transpose() * m;
    let square = (gram.x_axis.x + gram.y_axis.y + gram.z_axis.z) / 3.0;
    let rest = gram - DMat3::from_diagonal(DVec3::splat(square));
    rest.abs_diff_eq(DMat3::ZERO, SIMILAR * square).then(|| square.sqrt())
}

pub(super) fn plane(state: &mut State, args: &mut Args) -> Step<()> {
    let point = args.vector("the point")?;
    let normal = args.direction("the normal")?;
    let point = state.placed(point, args)?;
    // Normals go with the inverse transpose; its scale is of no matter.
    let normal = (state.transform.matrix3.inverse().transpose() * normal).normalize();
    add(state, Geometry::Plane { point, normal });
    Ok(())
}

pub(super) fn triangle(state: &mut State, args: &mut Args) -> Step<()> {
    let [a, b, c] = corners(state, args, ["the first corner", "the second corner", "the third corner"])?;
    let triangle = Triangle { a: a.as_vec3(), b: b.as_vec3(), c: c.as_vec3() };
    if flat(triangle.vertices()) {
        warn_flat(args, "triangle");
    }
    add(state, Geometry::Triangle(triangle));
    Ok(())
}

pub(super) fn rectangle(state: &mut State, args: &mut Args) -> Step<()> {
    let names = ["the lower-left corner", "the lower-right corner", "the upper-right corner"];
    let [ll, lr, ur] = corners(state, args, names)?;
    let ul = within_f32(ll + ur - lr, args)?;
    let rounded = [ll, lr, ur, ul].map(|corner| corner.as_vec3());
    let [ll, lr, ur, ul] = rounded;
    if flat([ll, lr, ur]) && flat([ll, ur, ul]) {
        warn_flat(args, "rectangle");
    }
    add(state, Geometry::Rectangle(rounded));
    Ok(())
}

/// Three corners, in world space.
fn corners(state: &State, args: &mut Args, names: [&str; 3]) -> Step<[DVec3; 3]> {
    let corners = [args.vector(names[0])?, args.vector(names[1])?, args.vector(names[2])?];
    Ok([state.placed(corners[0], args)?, state.placed(corners[1], args)?, state.placed(corners[2], args)?])
}

fn within_f32(corner: DVec3, args: &Args) -> Step<DVec3> {
    match corner.as_vec3().is_finite() {
        true => Ok(corner),
        false => Err(Problem::new(args.span_from(1), "the fourth corner is too large: numbers go up to 3.4e38")),
    }
}

/// Whether a triangle has no area, as far as f64 can see.
fn flat([a, b, c]: [Vec3; 3]) -> bool {
    let (ab, ac) = (b.as_dvec3() - a.as_dvec3(), c.as_dvec3() - a.as_dvec3());
    ab.cross(ac) == DVec3::ZERO
}

fn warn_flat(args: &mut Args, what: &str) {
    let span = args.span_from(1);
    args.warn(span, format!("this {what} has no area and cannot be seen"), "its corners lie on one line");
}
