//! Lights. The current transform applies to them as to shapes: a lamp moves with what it stands on.

use glam::DVec3;

use super::super::args::{Args, Limit};
use super::super::diagnose::Step;
use super::super::parser::State;
use super::super::{Color, Light};

pub(super) fn amblight(state: &mut State, args: &mut Args) -> Step<()> {
    state.scene.ambient = args.number("the intensity", &Limit::NOT_NEGATIVE)?;
    Ok(())
}

pub(super) fn light(state: &mut State, args: &mut Args) -> Step<()> {
    let position = args.vector("the position")?;
    let color = intensity_and_color(args)?;
    let position = state.placed(position, args)?;
    state.scene.lights.push(Light::Point { position, color });
    Ok(())
}

pub(super) fn sun(state: &mut State, args: &mut Args) -> Step<()> {
    let direction = args.direction("the direction")?;
    let color = intensity_and_color(args)?;
    let direction = state.transform.transform_vector3(direction).normalize();
    state.scene.lights.push(Light::Sun { direction, color });
    Ok(())
}

/// `i [r g b]`, as the product.
fn intensity_and_color(args: &mut Args) -> Step<Color> {
    let intensity = args.number("the intensity", &Limit::NOT_NEGATIVE)?;
    let color = if args.number_is_next() || args.left() >= 3 { args.rgb(&Limit::NOT_NEGATIVE)? } else { DVec3::ONE };
    Ok(intensity * color)
}
