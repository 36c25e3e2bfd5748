//! The camera, in one of three styles: `eye`, `origin`, `horiz`, `vert`; `lookat` and `fov`; `frame`.
//!
//! A scene keeps to one style; within it, what is said last holds. The camera stands in world space: transforms do not
//! apply to it.

use glam::DVec3;

use super::super::Camera;
use super::super::args::{Args, Limit, unit};
use super::super::diagnose::{Place, Problem, Step};
use super::super::parser::State;
use crate::error::{Diagnostic, Severity};

/// Vertical field of view of `lookat` unless `fov` says another, in degrees.
const DEFAULT_FOV: f64 = 45.0;

/// A sine below this counts as parallel.
const PARALLEL: f64 = 1e-12;

const CLASSIC: [&str; 4] = ["eye", "origin", "horiz", "vert"];

/// What the scene has said about its camera so far.
#[derive(Default)]
pub(in super::super) struct CameraWish {
    style: Option<Chosen>,
    classic: [Option<DVec3>; 4],
    lookat: Option<[DVec3; 3]>,
    frame: Option<DVec3>,
    fov: Option<(f64, Place)>,
}

#[derive(Clone, Copy, PartialEq)]
enum Style {
    Classic,
    LookAt,
    Frame,
}

struct Chosen {
    style: Style,
    command: &'static str,
    place: Place,
}

impl CameraWish {
    /// Settles on a style, or says which one there is already.
    fn choose(&mut self, style: Style, command: &'static str, args: &Args) -> Step<()> {
        match &self.style {
            Some(chosen) if chosen.style != style => {
                let place = chosen.place.describe(args.line.file);
                let message = format!("`{command}` does not go with `{}` ({place})", chosen.command);
                let help = "a scene has one camera: `eye`, `origin`, `horiz` and `vert`; or `lookat`; or `frame`";
                Err(Problem::new(args.command_span(), message).help(help))
            }
            _ => {
                self.style = Some(Chosen { style, command, place: args.place() });
                Ok(())
            }
        }
    }

    /// The camera, and what is wrong with it now that all has been said.
    pub fn finish(self) -> (Camera, Vec<Diagnostic>) {
        let mut told = Vec::new();
        if let (Some((_, place)), None) = (&self.fov, self.lookat) {
            let help = "the other cameras have their own way to say how much they take in";
            told.push(place.diagnostic(Severity::Warning, "`fov` has no effect without `lookat`", help));
        }
        let camera = match (self.lookat, self.frame, &self.style) {
            (Some([eye, at, up]), _, _) => Camera::LookAt { eye, at, up, fov: self.fov.map_or(DEFAULT_FOV, |f| f.0) },
            (_, Some(direction), _) => Camera::Frame(direction),
            (_, _, Some(Chosen { style: Style::Classic, place, .. })) => match rectangle(self.classic) {
                Ok(camera) => camera,
                Err((message, help)) => {
                    told.push(place.diagnostic(Severity::Error, message, help));
                    Camera::Auto
                }
            },
            _ => Camera::Auto,
        };
        (camera, told)
    }
}

/// The classic camera, or what is wrong with it and what to do.
fn rectangle(classic: [Option<DVec3>; 4]) -> Result<Camera, (String, &'static str)> {
    let [Some(eye), Some(origin), Some(horiz), Some(vert)] = classic else {
        let missing: Vec<_> =
            CLASSIC.iter().zip(classic).filter(|(_, v)| v.is_none()).map(|(name, _)| format!("`{name}`")).collect();
        let message = format!("the camera is incomplete without {}", missing.join(", "));
        return Err((message, "give all of `eye`, `origin`, `horiz` and `vert`, or none of them"));
    };
    if parallel(horiz, vert) {
        let message = "the image rectangle has no area: `horiz` and `vert` are parallel, or one of them is zero";
        return Err((message.into(), "`horiz` and `vert` are its full bottom and left edge, as vectors"));
    }
    if parallel_to_plane(origin - eye, horiz, vert) {
        let message = "the eye lies in the plane of the image rectangle, so that it sees nothing of it";
        return Err((message.into(), "move `eye` away from the rectangle that begins at `origin`"));
    }
    Ok(Camera::Rectangle { eye, origin, horiz, vert })
}

/// Whether two vectors span no area, for all that f64 can say.
fn parallel(a: DVec3, b: DVec3) -> bool {
    unit(a).cross(unit(b)).length() <= PARALLEL
}

/// Whether `v` lies in the plane that `a` and `b` span.
fn parallel_to_plane(v: DVec3, a: DVec3, b: DVec3) -> bool {
    let normal = unit(unit(a).cross(unit(b)));
    unit(v).dot(normal).abs() <= PARALLEL
}

fn classic(state: &mut State, args: &mut Args, which: usize) -> Step<()> {
    let value = args.vector(["the eye", "the corner", "the bottom edge", "the left edge"][which])?;
    state.camera.choose(Style::Classic, CLASSIC[which], args)?;
    state.camera.classic[which] = Some(value);
    Ok(())
}

pub(super) fn eye(state: &mut State, args: &mut Args) -> Step<()> {
    classic(state, args, 0)
}

pub(super) fn origin(state: &mut State, args: &mut Args) -> Step<()> {
    classic(state, args, 1)
}

pub(super) fn horiz(state: &mut State, args: &mut Args) -> Step<()> {
    classic(state, args, 2)
}

pub(super) fn vert(state: &mut State, args: &mut Args) -> Step<()> {
    classic(state, args, 3)
}

pub(super) fn lookat(state: &mut State, args: &mut Args) -> Step<()> {
    let (eye, at) = (args.vector("the eye")?, args.vector("the point looked at")?);
    if eye == at {
        return Err(Problem::new(args.span_from(1), "the eye and the point that it looks at are the same"));
    }
    let up = args.direction("the up direction")?;
    if parallel(at - eye, up) {
        let message = "the up direction must not be along the line of sight";
        return Err(
            Problem::new(args.span_from(7), message).help("`0 1 0` is up unless the camera looks straight down")
        );
    }
    state.camera.choose(Style::LookAt, "lookat", args)?;
    state.camera.lookat = Some([eye, at, up]);
    Ok(())
}

pub(super) fn fov(state: &mut State, args: &mut Args) -> Step<()> {
    let fov = args.number("the field of view", &Limit::ANGLE)?;
    state.camera.fov = Some((fov, args.place()));
    Ok(())
}

pub(super) fn frame(state: &mut State, args: &mut Args) -> Step<()> {
    let direction = if args.left() > 0 { Some(args.direction("the direction of view")?) } else { None };
    state.camera.choose(Style::Frame, "frame", args)?;
    state.camera.frame = direction;
    Ok(())
}
