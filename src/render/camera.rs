//! The camera: eye, image rectangle, and framing of what has been placed.

use glam::DVec3;

use crate::error::{Error, Result};
use crate::scene::Camera;
use crate::shade::{World, WorldRay};

/// Vertical field of view of a camera that frames by itself, degrees.
const FRAMING_FOV: f64 = 40.0;
/// Room around what is framed.
const MARGIN: f64 = 1.08;
/// Where a camera looks that nobody told where to look: slightly down, from the front right.
const LOOK: DVec3 = DVec3::new(-0.35, -0.32, -0.88);

/// A camera made ready: the eye and the image rectangle that its rays pass through.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Eye {
    eye: DVec3,
    /// From the eye to the bottom-left corner.
    corner: DVec3,
    /// Bottom edge divided by columns.
    column: DVec3,
    /// Left edge divided by rows.
    row: DVec3,
    /// Unit normal of the image plane.
    ahead: DVec3,
}

impl Eye {
    /// The camera of a world for a picture of `width` x `height` pixels.
    ///
    /// Fails if the camera's rectangle, directions or angle make no picture (zero, not finite).
    pub fn new(world: &World, [width, height]: [u32; 2]) -> Result<Eye> {
        let aspect = f64::from(width) / f64::from(height);
        let bounds = world.bounds().unwrap_or([DVec3::splat(-1.0), DVec3::ONE]);
        let (eye, origin, horiz, vert) = match world.scene().camera {
            Camera::Rectangle { eye, origin, horiz, vert } => (eye, origin, horiz, vert),
            Camera::LookAt { eye, at, up, fov } => look(eye, at - eye, up, fov, aspect),
            Camera::Frame(direction) => frame(bounds, direction, aspect),
            Camera::Auto => frame(bounds, LOOK, aspect),
        };
        let (column, row) = (horiz / f64::from(width), vert / f64::from(height));
        let ahead = horiz.cross(vert).normalize_or_zero();
        let ready = Eye { eye, corner: origin - eye, column, row, ahead };
        let middle = ready.corner + (horiz + vert) * 0.5;
        let all = [eye, ready.corner, horiz, vert];
        if !all.iter().all(|v| v.is_finite()) || middle == DVec3::ZERO || horiz.cross(vert) == DVec3::ZERO {
            let what = "the camera sees nothing: its image rectangle has no area, or its directions are zero or parallel; give it others";
            return Err(Error::Option(what.into()));
        }
        Ok(ready)
    }

    /// The ray through (x, y) in pixels from the bottom-left corner.
    pub fn ray(&self, x: f64, y: f64) -> WorldRay {
        let direction = self.corner + self.column * x + self.row * y;
        // At distance s a pixel's side is s / |direction| times its side on the image plane. A shift across the ray by the cosine of the angle to the axis
        // times that much moves its image by up to one pixel.
        let side = self.column.length().min(self.row.length());
        let slope = side * self.ahead.dot(direction).abs() / direction.length_squared();
        WorldRay::new(self.eye, direction).widening(slope)
    }
}

/// Right, up and forward, of unit length; NaN where the directions make no frame.
fn basis(forward: DVec3, up: DVec3) -> [DVec3; 3] {
    let forward = (forward / forward.abs().max_element()).normalize();
    let right = forward.cross(up / up.abs().max_element()).normalize();
    [right, right.cross(forward), forward]
}

/// Eye and rectangle (at distance 1) of a camera by direction and vertical field of view in degrees.
fn look(eye: DVec3, forward: DVec3, up: DVec3, fov: f64, aspect: f64) -> (DVec3, DVec3, DVec3, DVec3) {
    let [right, up, forward] = basis(forward, up);
    let height = 2.0 * (fov.to_radians() * 0.5).tan();
    let (horiz, vert) = (right * height * aspect, up * height);
    (eye, eye + forward - (horiz + vert) * 0.5, horiz, vert)
}

/// A camera that looks along `forward` and takes in the box: as near as its eight corners allow.
fn frame([lo, hi]: [DVec3; 2], forward: DVec3, aspect: f64) -> (DVec3, DVec3, DVec3, DVec3) {
    let upright = forward.x.hypot(forward.z) > 1e-6 * forward.length();
    let world_up = if upright { DVec3::Y } else { DVec3::NEG_Z * forward.y.signum() };
    let [right, up, ahead] = basis(forward, world_up);
    let (center, half) = ((lo + hi) * 0.5, (hi - lo) * 0.5);
    let tan = (FRAMING_FOV.to_radians() * 0.5).tan() / MARGIN;
    let distance = (0..8)
        .map(|i| {
            let sign = |bit: i32| if i & bit != 0 { 1.0 } else { -1.0 };
            let corner = half * DVec3::new(sign(4), sign(2), sign(1));
            let (x, y, z) = (corner.dot(right).abs(), corner.dot(up).abs(), corner.dot(ahead));
            (x / (tan * aspect)).max(y / tan) - z
        })
        .fold(0.0, f64::max);
    // A box that is a point is looked at from one unit, or from as far as its coordinates can tell.
    let least = if half == DVec3::ZERO { 1.0 } else { 0.0 } + center.abs().max_element() * 1e-5;
    look(center - ahead * distance.max(least), ahead, up, FRAMING_FOV, aspect)
}
