//! The stack of transforms. A new one is applied before those that are there (the nearest to the shape first), as in
//! other graphics languages: `translate` and then `rotate` turns a shape about its own origin and then moves it.

use glam::{DAffine3, DMat3, DQuat, DVec3};

use super::super::args::{Args, Limit};
use super::super::diagnose::{Problem, Step};
use super::super::parser::State;

pub(super) fn push(state: &mut State, args: &mut Args) -> Step<()> {
    state.stack.push((state.transform, args.place()));
    Ok(())
}

pub(super) fn pop(state: &mut State, args: &mut Args) -> Step<()> {
    let Some((transform, _)) = state.stack.pop() else {
        return Err(Problem::new(args.command_span(), "there is no `push` that this `pop` could take back"));
    };
    state.transform = transform;
    Ok(())
}

pub(super) fn translate(state: &mut State, args: &mut Args) -> Step<()> {
    let by = args.vector("the way")?;
    apply(state, args, DAffine3::from_translation(by))
}

pub(super) fn scale(state: &mut State, args: &mut Args) -> Step<()> {
    let x = args.number("the scale", &Limit::NOT_ZERO)?;
    let by = match args.left() > 0 {
        true => DVec3::new(
            x,
            args.number("the scale along y", &Limit::NOT_ZERO)?,
            args.number("the scale along z", &Limit::NOT_ZERO)?,
        ),
        false => DVec3::splat(x),
    };
    apply(state, args, DAffine3::from_scale(by))
}

pub(super) fn rotate(state: &mut State, args: &mut Args) -> Step<()> {
    let angle = args.number("the angle", &Limit::ANY)?;
    let axis = args.direction("the axis")?;
    apply(state, args, DAffine3::from_mat3(rotation(angle, axis)))
}

/// Largest number in a transform and in its inverse: what is computed with them stays well within f64.
const MOST: f64 = 1e60;

/// Right-handed rotation by `angle` degrees about an axis of unit length; whole quarter turns about an axis of the world are exact.
fn rotation(angle: f64, axis: DVec3) -> DMat3 {
    let matrix = DMat3::from_quat(DQuat::from_axis_angle(axis, (angle % 360.0).to_radians()));
    let along_world_axis = axis.to_array().iter().filter(|x| **x != 0.0).count() == 1;
    if angle % 90.0 != 0.0 || !along_world_axis {
        return matrix;
    }
    let round = |v: DVec3| v.round() + 0.0; // -0 becomes 0
    DMat3::from_cols(round(matrix.x_axis), round(matrix.y_axis), round(matrix.z_axis))
}

/// Composes, if the result can still be inverted.
fn apply(state: &mut State, args: &Args, transform: DAffine3) -> Step<()> {
    let both = state.transform * transform;
    let moderate = |m: DMat3| m.to_cols_array().iter().all(|x| x.abs() <= MOST);
    let there = moderate(both.matrix3) && both.translation.abs().max_element() <= MOST;
    let usable = there && both.matrix3.determinant() != 0.0 && moderate(both.matrix3.inverse());
    if !usable {
        let message = "all transforms together leave the range of numbers, or squash everything flat";
        return Err(Problem::new(args.span_from(0), message).help("use scales nearer to 1"));
    }
    state.transform = both;
    Ok(())
}
