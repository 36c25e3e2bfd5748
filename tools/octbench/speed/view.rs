//! Cameras: named ones for the meshes that are measured most, any other by its numbers, and one that takes in everything.

use glam::DVec3;
use octrace::geometry::{Aabb, Ray};

/// A camera and a lamp.
#[derive(Clone, Debug, PartialEq)]
pub struct View {
    /// Name in tables.
    pub name: String,
    eye: DVec3,
    look: DVec3,
    up: DVec3,
    /// Vertical field of view in degrees.
    fov: f64,
    /// Where shadow rays end.
    pub light: DVec3,
}

/// Name; eye, look, up; field of view; light.
type Named = (&'static str, [[f64; 3]; 3], f64, [f64; 3]);

const NAMED: [Named; 6] = [
    ("bunny-over", [[0.063, 0.14, 0.285], [-0.0168, 0.1102, -0.0015], [0.0, 1.0, 0.0]], 40.0, [0.4, 0.6, 0.3]),
    ("bunny-close", [[0.062, 0.125, 0.035], [-0.02, 0.10, 0.0], [0.0, 1.0, 0.0]], 60.0, [0.4, 0.6, 0.3]),
    ("planet-over", [[2.5, 2.08, 2.6], [0.0, 0.0, 0.0], [0.0, 1.0, 0.0]], 40.0, [8.0, 6.0, -1.0]),
    ("planet-close", [[0.31, 0.25, 1.01], [0.05, -0.02, 0.98], [0.3, 0.2, 0.93]], 60.0, [8.0, 6.0, -1.0]),
    ("kitchen-outside", [[6.5, 4.5, 6.5], [0.8, 1.0, 0.0], [0.0, 1.0, 0.0]], 40.0, [6.0, 8.0, 2.0]),
    ("kitchen-inside", [[2.9, 1.5, 1.9], [0.0, 0.9, -0.8], [0.0, 1.0, 0.0]], 60.0, [1.0, 2.2, 0.3]),
];

impl View {
    /// A named view, or `NAME=EYE/LOOK/UP/FOV/LIGHT`, points as X,Y,Z.
    pub fn parse(text: &str) -> Result<View, String> {
        let Some((name, numbers)) = text.split_once('=') else {
            let found = NAMED.iter().find(|v| v.0 == text);
            return found.map(|v| View::named(*v)).ok_or_else(|| {
                let names = NAMED.map(|v| v.0).join(", ");
                format!("the named views are {names}; give another as NAME=EYE/LOOK/UP/FOV/LIGHT, points as X,Y,Z")
            });
        };
        let parts: Vec<&str> = numbers.split('/').collect();
        let [eye, look, up, fov, light] = parts[..] else {
            return Err("expected NAME=EYE/LOOK/UP/FOV/LIGHT: five parts with / between them".to_owned());
        };
        let [eye, look, up, light] = [eye, look, up, light].map(crate::cli::args::point);
        let view = View {
            name: name.to_owned(),
            eye: eye?,
            look: look?,
            up: up?,
            fov: fov.parse().map_err(|_| "the field of view is no number of degrees".to_owned())?,
            light: light?,
        };
        let sees = (view.look - view.eye).cross(view.up).length() > 0.0 && view.fov > 0.0 && view.fov < 180.0;
        let is_plain = !name.is_empty() && name.chars().all(|c| c.is_ascii_alphanumeric() || "-_".contains(c));
        match (sees, is_plain) {
            (false, _) => Err("this camera sees nothing: the eye is the target, or up points there, or the field of \
                               view is not between 0 and 180 degrees"
                .to_owned()),
            (_, false) => Err("a name is letters, digits, - and _".to_owned()),
            _ => Ok(view),
        }
    }

    fn named((name, [eye, look, up], fov, light): Named) -> View {
        let [eye, look, up, light] = [eye, look, up, light].map(DVec3::from_array);
        View { name: name.to_owned(), eye, look, up, fov, light }
    }

    /// A view of everything in a box.
    pub fn around(bounds: Aabb) -> View {
        let (low, high) = (bounds.min.as_dvec3(), bounds.max.as_dvec3());
        let (middle, diagonal) = (0.5 * (low + high), (high - low).length());
        View {
            name: "whole".to_owned(),
            eye: middle + 1.4 * diagonal * DVec3::new(0.6, 0.5, 0.62).normalize(),
            look: middle,
            up: DVec3::Y,
            fov: 40.0,
            light: middle + diagonal * DVec3::new(-1.0, 2.0, 1.5),
        }
    }

    /// A ray through the middle of each pixel, in tiles of 32 x 32 made of blocks of 4 x 4, so that neighbours stay together.
    pub fn primary(&self, [width, height]: [u32; 2]) -> Vec<Ray> {
        let forward = (self.look - self.eye).normalize();
        let right = forward.cross(self.up).normalize();
        let up = right.cross(forward);
        let (w, h) = (f64::from(width), f64::from(height));
        let tangent = (0.5 * self.fov.to_radians()).tan();
        let through = |[x, y]: [u32; 2]| {
            let sx = (2.0 * (f64::from(x) + 0.5) / w - 1.0) * tangent * w / h;
            let sy = (1.0 - 2.0 * (f64::from(y) + 0.5) / h) * tangent;
            let direction = (forward + sx * right + sy * up).normalize();
            Ray::new(self.eye.as_vec3(), direction.as_vec3())
        };
        blocks([width, height], 32)
            .flat_map(|tile| blocks([tile[2] - tile[0], tile[3] - tile[1]], 4).map(move |b| shifted(b, tile)))
            .flat_map(|[x0, y0, x1, y1]| (y0..y1).flat_map(move |y| (x0..x1).map(move |x| [x, y])))
            .map(through)
            .collect()
    }
}

/// Cuts a rectangle into squares of `side`, the last of a row or column smaller: x0, y0, x1, y1 with the ends left out.
fn blocks([width, height]: [u32; 2], side: u32) -> impl Iterator<Item = [u32; 4]> {
    let starts = move |n: u32| (0..n).step_by(side as usize);
    starts(height).flat_map(move |y| starts(width).map(move |x| [x, y, (x + side).min(width), (y + side).min(height)]))
}

fn shifted([x0, y0, x1, y1]: [u32; 4], [x, y, ..]: [u32; 4]) -> [u32; 4] {
    [x0 + x, y0 + y, x1 + x, y1 + y]
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;

    use glam::Vec3;

    use super::*;

    #[test]
    fn every_pixel_has_a_ray_and_neighbours_stay_together() {
        let view = View::parse("bunny-over").unwrap();
        let rays = view.primary([70, 37]);
        assert_eq!(rays.len(), 70 * 37);
        assert_eq!(rays.iter().map(|r| r.direction.map(f32::to_bits)).collect::<HashSet<_>>().len(), rays.len());
        let block = |k: usize| rays[16 * k..16 * k + 16].iter().map(|r| Vec3::from(r.direction));
        let (low, high) = block(1).fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(l, h), d| (l.min(d), h.max(d)));
        assert!((high - low).max_element() < 5.0 * 0.02, "{low} {high}");
    }

    #[test]
    fn the_middle_of_the_picture_looks_at_the_target() {
        let view = View::parse("a=0,0,5/0,0,0/0,1,0/90/1,2,3").unwrap();
        let rays = view.primary([1, 1]);
        assert_eq!((rays[0].origin, rays[0].direction), ([0.0, 0.0, 5.0], [0.0, 0.0, -1.0]));
        // The upper left pixel of 2 x 2 looks up and left, by half the tangent of 45 degrees.
        let d = view.primary([2, 2])[0].direction;
        assert!((d[0] / d[2] - 0.5).abs() < 1e-6 && (d[1] / d[2] + 0.5).abs() < 1e-6, "{d:?}");
    }

    #[test]
    fn wrong_views_are_refused() {
        for wrong in [
            "moon",
            "a=1,2,3",
            "a=0,0,0/0,0,0/0,1,0/40/1,1,1",
            "a=0,0,5/0,0,0/0,0,1/40/1,1,1",
            "a=0,0,5/0,0,0/0,1,0/180/1,1,1",
            "a b=0,0,5/0,0,0/0,1,0/40/1,1,1",
        ] {
            assert!(View::parse(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn the_view_around_a_box_sees_it() {
        let view = View::around(Aabb { min: Vec3::splat(2.0), max: Vec3::splat(3.0) });
        let ray = view.primary([1, 1])[0];
        let to = Vec3::splat(2.5) - Vec3::from(ray.origin);
        assert!(to.normalize().dot(ray.direction.into()) > 0.999);
    }
}
