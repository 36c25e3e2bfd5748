//! `octbench mirrors`: closed boxes of perfect mirrors, in which no path may see the light outside.
//!
//! The paths are the pixels of a picture made by the renderer itself. The mirrors lose nothing and all light is outside, so that
//! a pixel which is not black is a path that escaped.

use glam::{DMat3, DVec3, Vec3};
use octrace::Result;
use octrace::event::Monitor;
use octrace::render::{Settings, render};
use octrace::scene::{Camera, Color, Geometry, Material, Scene, Shape};
use octrace::shade::World;
use serde::Serialize;

use crate::random::Random;

/// What was counted.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct MirrorReport {
    /// Version of this form.
    pub schema: u32,
    /// Boxes.
    pub boxes: u64,
    /// Paths.
    pub paths: u64,
    /// Bounces of a path, at most.
    pub bounces: u64,
    /// Mirror rays in all.
    pub mirror_rays: u64,
    /// Paths that saw the outside.
    pub escapes: u64,
    /// Wall clock.
    pub seconds: f64,
}

/// Half size of a box, and its distance from zero.
const BOXES: [(f64, f64); 5] = [(1.0, 0.0), (1e-6, 0.0), (1e6, 0.0), (1.0, 1e6), (1e6, 1e6)];

/// Follows paths in all boxes, straight and turned, from the middle and from near a corner.
pub fn run(paths: u64, bounces: u64, seed: u64, monitor: Monitor<'_>) -> Result<MirrorReport> {
    let boxes = 2 * BOXES.len() as u64;
    let side = ((paths.div_ceil(boxes) as f64).sqrt().ceil() as u32).clamp(1, 1 << 12);
    let mut report = MirrorReport { schema: 1, boxes, bounces, ..MirrorReport::default() };
    let mut random = Random::new(seed);
    let started = std::time::Instant::now();
    for (k, (half, far)) in BOXES.into_iter().enumerate() {
        for turned in [false, true] {
            let at = 0.9 * f64::from(k as u32 % 2);
            let scene = room(half, far, turned, at, &mut random);
            let world = World::new(scene, Vec::new(), monitor)?;
            let settings = Settings {
                size: Some([side; 2]),
                samples: Some(1),
                depth: Some(u32::try_from(bounces).unwrap_or(u32::MAX)),
                ..Settings::default()
            };
            let picture = render(&world, &settings, monitor)?;
            report.paths += u64::from(side) * u64::from(side);
            report.mirror_rays += picture.statistics.rays.mirror;
            report.escapes += picture.film.pixels().iter().filter(|p| p.iter().any(|x| *x != 0.0)).count() as u64;
        }
    }
    Ok(MirrorReport { seconds: started.elapsed().as_secs_f64(), ..report })
}

/// A box of mirrors of half size `half` at distance `far`, with a camera at `at` of the way to a corner.
fn room(half: f64, far: f64, turned: bool, at: f64, random: &mut Random) -> Scene {
    let angle = if turned { 1.0 } else { 0.0 };
    let turn = DMat3::from_axis_angle(DVec3::from(random.direction()), angle);
    let center = DVec3::splat(far);
    let place = |p: DVec3| center + half * (turn * p);
    let corner = |i: usize| -> Vec3 {
        let sign = |bit: usize| if i >> bit & 1 == 1 { 1.0 } else { -1.0 };
        place(DVec3::new(sign(2), sign(1), sign(0))).as_vec3()
    };
    let quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]];
    let shape = |q: [usize; 4]| Shape { geometry: Geometry::Rectangle(q.map(corner)), material: 0 };
    let black = Color::ZERO;
    let mirror =
        Material { ambient: black, diffuse: black, specular: black, local: 0.0, reflect: 1.0, ..Material::default() };
    let eye = place(DVec3::splat(at));
    Scene {
        camera: Camera::LookAt { eye, at: eye + turn * DVec3::new(0.3, 0.5, -0.8) * half, up: DVec3::Y, fov: 120.0 },
        shapes: quads.map(shape).to_vec(),
        materials: vec![mirror],
        background: Color::splat(1.0),
        ..Scene::default()
    }
}
