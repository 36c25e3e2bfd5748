//! Secondary rays from scale 1e-30 to 1e30: none meets the surface that it leaves, none leaks through a thin neighbour, and a shadow
//! ray ends at its light, neither before nor behind.

use glam::{DAffine3, DVec3, Vec3};
use proptest::prelude::*;

use super::double::cube;
use super::object::{Contact, Part, strictly_on};
use super::path::Bounce;
use super::ray::{Omit, WorldRay};
use super::tests::{MIRROR, world};
use super::wave::Wave;
use super::world::World;
use crate::exact::{exactly_degenerate, side};
use crate::geometry::Triangle;
use crate::scene::{Color, Geometry, Light, Material};

/// Powers of ten, 1e-30 to 1e30.
fn scales() -> impl Iterator<Item = f32> {
    (-30..=30).step_by(5).map(|k| 10f32.powi(k))
}

/// White, lit by lamps only.
fn matte() -> Material {
    Material { ambient: Color::ZERO, ..Material::default() }
}

fn point_light(position: Vec3) -> Light {
    Light::Point { position: position.as_dvec3(), color: Color::ONE }
}

fn triangle_of(contact: &Contact) -> Triangle {
    match contact.part {
        Part::Mesh(found) => found.triangle,
        _ => panic!("the worlds of these tests are of meshes"),
    }
}

/// x moved by so many steps of f32.
fn steps(x: f32, n: u32) -> f32 {
    (0..n).fold(x, |x, _| x.next_up())
}

/// Follows a path of mirrored rays; how many there are, at most `most`. Every origin is handed to `check`.
fn follow(world: &World, ray: WorldRay, most: usize, check: impl Fn(Vec3)) -> usize {
    let mut path = world.mirror_path(ray);
    for done in 0..most {
        match path.bounce().unwrap() {
            Some(Bounce::Free(ray)) => check(ray.origin().as_vec3()),
            Some(Bounce::Wedged) => {}
            None => return done,
        }
    }
    most
}

/// A tetrahedron wound outward, if its corners make one.
fn tetrahedron(p: [Vec3; 4]) -> Option<Vec<Triangle>> {
    let faces = [[0, 1, 2, 3], [0, 2, 3, 1], [0, 3, 1, 2], [1, 3, 2, 0]];
    let face = |[a, b, c, opposite]: [usize; 4]| {
        let t = Triangle { a: p[a], b: p[b], c: p[c] };
        match side(&t, p[opposite].to_array()) {
            std::cmp::Ordering::Less => Some(t),
            std::cmp::Ordering::Greater => Some(Triangle { a: p[b], b: p[a], c: p[c] }),
            std::cmp::Ordering::Equal => None,
        }
    };
    p.iter().all(|p| p.is_finite()).then(|| faces.into_iter().map(face).collect()).flatten()
}

/// A point of a face: a corner, a point of an edge, within a step of an edge, or anywhere.
fn spot_of(t: &Triangle, kind: u32, [u, v]: [f32; 2]) -> DVec3 {
    let [a, b, c] = t.vertices().map(|p| p.as_dvec3());
    let (u, v) = (f64::from(u), f64::from(v));
    match kind {
        0 => a,
        1 => a + u * (b - a),
        2 => (a + u * (b - a)) * (1.0 - 1e-7) + c * 1e-7,
        _ => a + u * (b - a) + (1.0 - u) * v * (c - a),
    }
}

/// sin of the angle above the surface: steep, flat, 89.999999 degrees from the normal.
const RISES: [f64; 4] = [1.0, 0.1, 1e-4, 1.745e-8];

proptest! {
    #![proptest_config(ProptestConfig::with_cases(6000))]

    /// A ray mirrored at a convex body never meets that body again, and a light above a face of it lights the face: corners,
    /// ridges, grazing angles, at every scale.
    #[test]
    fn a_convex_body_is_met_once_and_lit_by_every_light_above(
        corners in prop::array::uniform12(-1.0f32..1.0),
        (exponent, offset) in (-30i32..=30, prop::sample::select(vec![0.0f32, 1.0, 1e3])),
        (face, kind) in (0usize..4, 0u32..4),
        weights in prop::array::uniform2(0.0f32..1.0),
        (about, reach) in (prop::array::uniform3(-1.0f64..1.0), 0.1f64..10.0),
        rises in (prop::sample::select(RISES.to_vec()), prop::sample::select(RISES.to_vec())),
    ) {
        let scale = 10f32.powi(exponent);
        let p = std::array::from_fn(|i| (Vec3::from_slice(&corners[3 * i..]) + offset) * scale);
        let Some(body) = tetrahedron(p) else { return Ok(()) };
        prop_assume!(!body.iter().any(exactly_degenerate));
        let (target, outward) = (spot_of(&body[face], kind, weights), super::origin::normal_of(&body[face]));
        let about = DVec3::from(about);
        let tangent = (about - about.dot(outward) * outward).normalize_or(outward.any_orthonormal_vector());
        let away = |rise: f64| target + (tangent + rise * outward) * reach * f64::from(scale);
        let mut world = world(body, DAffine3::IDENTITY, Vec::new(), MIRROR);
        let ray = WorldRay::new(away(rises.0), target - away(rises.0));
        let Some(contact) = world.closest(&ray, Omit::NOTHING).unwrap() else { return Ok(()) };
        let met = triangle_of(&contact);
        prop_assume!(strictly_on(&met, ray.origin().as_vec3(), true));
        let mut path = world.mirror_path(ray);
        let Some(Bounce::Free(mirrored)) = path.bounce().unwrap() else { panic!("no origin: {ray:?}") };
        prop_assert!(strictly_on(&met, mirrored.origin().as_vec3(), true));
        prop_assert!(world.closest(&mirrored, Omit::NOTHING).unwrap().is_none(), "{ray:?} {mirrored:?}");

        let light = (target + (rises.1 * outward - tangent) * reach * f64::from(scale)).as_vec3();
        let spot = world.spot(&contact, &ray).unwrap();
        let cosine = spot.normal.dot((light.as_dvec3() - spot.point).normalize());
        if strictly_on(&met, light, true) && cosine > 0.0 {
            world.scene.lights = vec![point_light(light)];
            world.surfaces = vec![(&matte()).into()];
            let color = world.color(ray, &mut Wave::new(0)).unwrap();
            prop_assert!(color.x > 0.0, "dark at {cosine:e}: {ray:?} {light:?}");
        }
    }

    /// A sheet through the light lights, as does one a step behind it; one a step before it, or at 0.99995 of the way, does not.
    #[test]
    fn a_shadow_ray_ends_at_its_light(
        exponent in -30i32..=30,
        light in prop::array::uniform3(0.5f32..4.0),
        (x, z) in (-3.0f32..3.0, -3.0f32..3.0),
        turn in 0usize..3,
    ) {
        let scale = 10f32.powi(exponent);
        let place = |p: [f32; 3]| Vec3::from_array(std::array::from_fn(|i| p[(i + turn) % 3] * scale));
        let sheet = |y: f32| {
            let corner = |x: f32, z: f32| {
                let mut p = place([x, 0.0, z]).to_array();
                p[(4 - turn) % 3] = y;
                Vec3::from_array(p)
            };
            Triangle { a: corner(-40.0, -40.0), b: corner(40.0, -40.0), c: corner(0.0, 40.0) }
        };
        let lamp = place(light);
        let height = lamp.to_array()[(4 - turn) % 3];
        let lit = |y: f32| {
            let mut world = world(vec![sheet(0.0), sheet(y)], DAffine3::IDENTITY, Vec::new(), matte());
            world.scene.lights = vec![point_light(lamp)];
            let eye = place([x * 0.9, 0.25, z * 0.9]).as_dvec3();
            let ray = WorldRay::new(eye, place([x, 0.0, z]).as_dvec3() - eye);
            world.color(ray, &mut Wave::new(0)).unwrap() != Color::ZERO
        };
        prop_assert!(lit(height), "through the light");
        prop_assert!(lit(height.next_up()), "a step behind");
        prop_assert!(!lit(height.next_down()), "a step before");
        prop_assert!(!lit(height * 0.99995));
    }

    /// Stacks of sheets 1 to 3 steps apart, slanted or not, in either order: each is passed once by what goes through, and
    /// none lets light through.
    #[test]
    fn thin_neighbours_are_not_skipped(
        exponent in -30i32..=30,
        heights in prop::array::uniform3(0.5f32..2.0),
        level: bool,
        apart in 1u32..=3,
        (x, z) in (-0.2f32..0.2, -0.2f32..0.2),
        order in prop::sample::select(vec![[0u32, 1, 2, 3], [3, 2, 1, 0], [2, 0, 3, 1]]),
        (below, slant) in (any::<bool>(), -0.9f32..0.9),
    ) {
        let scale = 10f32.powi(exponent);
        let heights = if level { [heights[0]; 3] } else { heights };
        let sheet = |k: u32| {
            let corner = |i: usize, x: f32, z: f32| Vec3::new(x * scale, steps(heights[i] * scale, k * apart), z * scale);
            Triangle { a: corner(0, -9.0, -9.0), b: corner(1, 0.0, 9.0), c: corner(2, 9.0, -9.0) }
        };
        let sheets = order.map(sheet).to_vec();
        let glass = Material { local: 0.0, transmit: 1.0, ..matte() };
        let from = DVec3::new(f64::from(x), if below { -3.0 } else { 6.0 }, f64::from(z)) * f64::from(scale);
        let ray = WorldRay::new(from, DVec3::new(f64::from(slant), if below { 4.0 } else { -4.0 }, 0.1));
        let through = world(sheets.clone(), DAffine3::IDENTITY, Vec::new(), glass);
        let mut wave = Wave::new(100);
        through.color(ray, &mut wave).unwrap();
        prop_assert_eq!(wave.counts.refracted, 4);
        let mirrors = world(sheets.clone(), DAffine3::IDENTITY, Vec::new(), MIRROR);
        prop_assert_eq!(follow(&mirrors, ray, 100, |_| {}), 1);
        let mut lit = world(sheets, DAffine3::IDENTITY, Vec::new(), matte());
        for (light, reaches) in [(from + DVec3::X * f64::from(scale), true), (from * DVec3::new(1.0, -1.0, 1.0), false)] {
            lit.scene.lights = vec![Light::Point { position: light, color: Color::ONE }];
            prop_assert_eq!(lit.color(ray, &mut Wave::new(0)).unwrap() != Color::ZERO, reaches);
        }
    }
}

#[test]
fn nothing_escapes_a_box_a_few_steps_high() {
    for scale in scales() {
        for apart in 2..=3 {
            let [low, high] = [scale, steps(scale, apart)];
            let flat = cube(|p| Vec3::new(p.x * scale, if p.y < 0.0 { low } else { high }, p.z * scale));
            let mirrors = world(flat, DAffine3::IDENTITY, Vec::new(), MIRROR);
            let inside = |o: Vec3| {
                let within = o.x.abs() <= scale && o.z.abs() <= scale && low <= o.y && o.y <= high;
                assert!(within, "{o} at scale {scale}, {apart} steps");
            };
            for k in 0..40 {
                let from = DVec3::new(0.1, 0.0, 0.2) * f64::from(scale) + DVec3::Y * f64::from(low.next_up());
                let rise = [1.0, 1e-3, 1e-7, 1.745e-8][k % 4];
                let (sin, cos) = (k as f64).sin_cos();
                let ray = WorldRay::new(from, DVec3::new(sin, rise, cos));
                assert_eq!(follow(&mirrors, ray, 200, inside), 200, "scale {scale}, {apart} steps, ray {k}");
            }
        }
    }
}

#[test]
fn nothing_escapes_a_crease_or_along_a_wall_at_any_scale() {
    // A prism whose mirrors meet at about 1e-4 radians, and a cube: rays deep into the crease, and along the walls at 89.999999
    // degrees from their normals.
    for scale in scales() {
        let squeeze = |p: Vec3| Vec3::new(p.x, if p.x > 0.0 { p.y * 1e-4 } else { p.y * 1e-7 }, p.z) * scale;
        for (what, mesh) in [("prism", cube(squeeze)), ("cube", cube(|p| p * scale))] {
            let convex = mesh.clone();
            let inside = |o: Vec3| {
                let outside = |t: &Triangle| strictly_on(t, o, true);
                assert!(!convex.iter().any(outside), "{o}, {what} at scale {scale}");
            };
            let mirrors = world(mesh, DAffine3::IDENTITY, Vec::new(), MIRROR);
            for k in 0..30 {
                let share = f64::from(k) / 30.0;
                let into_crease = DVec3::new(-1.0, 1e-4 * share, 0.3 - 0.6 * share);
                let along_wall = DVec3::new(1.0, -1.745e-8, share);
                for aim in [into_crease, along_wall, DVec3::new(along_wall.z, along_wall.x, along_wall.y)] {
                    let ray = WorldRay::new(DVec3::new(0.5, 0.0, 0.0) * f64::from(scale), aim);
                    assert_eq!(follow(&mirrors, ray, 100, inside), 100, "{what} at scale {scale}, ray {k}");
                }
            }
        }
    }
}

#[test]
fn nothing_escapes_between_two_balls() {
    let ball = |radius| Geometry::Sphere { center: DVec3::ZERO, radius, to_world: DAffine3::IDENTITY };
    for scale in scales().map(f64::from) {
        let (inner, outer) = (scale * (1.0 - 4e-5), scale);
        let far = DAffine3::from_translation(DVec3::splat(1e9 * scale));
        let mesh = vec![Triangle { a: Vec3::ZERO, b: Vec3::X * scale as f32, c: Vec3::Y * scale as f32 }];
        let shells = world(mesh, far, vec![ball(inner), ball(outer)], MIRROR);
        let between = |o: Vec3| {
            let r = o.as_dvec3().length();
            assert!(inner < r && r < outer, "{o} at scale {scale}");
        };
        for k in 0..20 {
            let (sin, cos) = f64::from(k).sin_cos();
            let at = DVec3::new(0.6, 0.8 * sin, 0.8 * cos) * (inner + outer) * 0.5;
            let aim = DVec3::new(cos, 0.1 * f64::from(k) - 1.0, sin);
            assert_eq!(follow(&shells, WorldRay::new(at, aim), 500, between), 500, "scale {scale}, ray {k}");
        }
    }
}

#[test]
fn a_light_in_the_plane_or_at_the_point_itself_gives_nothing() {
    for scale in scales() {
        let corner = |x: f32, z: f32| Vec3::new(x * scale, scale, z * scale);
        let floor = vec![Triangle { a: corner(-9.0, -9.0), b: corner(0.0, 9.0), c: corner(9.0, -9.0) }];
        let mut world = world(floor, DAffine3::IDENTITY, Vec::new(), matte());
        let at = Vec3::new(0.25, 1.0, 0.5) * scale;
        let ray = WorldRay::new(at.as_dvec3() + DVec3::Y * f64::from(scale), DVec3::NEG_Y);
        for light in [at, corner(0.5, 0.5), corner(-9.0, -9.0), corner(100.0, 3.0)] {
            world.scene.lights = vec![point_light(light)];
            assert_eq!(world.color(ray, &mut Wave::new(0)).unwrap(), Color::ZERO, "{light} at scale {scale}");
        }
    }
}

/// A box at 1e6, where a step of f32 is 1/16: its faces are rounded, and so are ridges or grooves along their diagonals. Each path once
/// found such a ridge, met beyond the end of the segment, to lie between the face and its origin, and left the box by it.
#[test]
fn flat_ridges_far_away_let_nobody_out() {
    let corner = |i: usize| {
        Vec3::from_array(
            [
                [999902.06, 999977.44, 1000046.75],
                [999939.44, 1000092.7, 1000005.5],
                [999983.9, 1000039.7, 999897.75],
                [999946.44, 999924.44, 999939.06],
                [1000016.1, 999960.3, 1000102.25],
                [1000060.56, 999907.3, 999994.5],
                [1000097.94, 1000022.56, 999953.25],
                [1000053.56, 1000075.56, 1000060.94],
            ][i],
        )
    };
    let faces = [
        [0, 1, 2],
        [0, 2, 3],
        [4, 5, 6],
        [4, 6, 7],
        [0, 3, 5],
        [0, 5, 4],
        [1, 7, 6],
        [1, 6, 2],
        [0, 4, 7],
        [0, 7, 1],
        [3, 2, 6],
        [3, 6, 5],
    ];
    let triangles = faces.map(|[a, b, c]| Triangle { a: corner(a), b: corner(b), c: corner(c) });
    let world = world(triangles.to_vec(), DAffine3::IDENTITY, Vec::new(), MIRROR);
    for ([x, y, z], [u, v, w]) in [
        ([999917.625, 999961.625, 1000010.5], [0.7087795734405518, -0.04459892585873604, 0.704018771648407]),
        ([999971.1875, 999961.625, 1000064.125], [0.14379113912582397, 0.9382317662239075, -0.3147145211696625]),
    ] {
        let ray = WorldRay::new(DVec3::new(x, y, z), DVec3::new(u, v, w));
        let met = follow(&world, ray, 1000, |origin| {
            assert!(triangles.iter().all(|t| (origin - t.a).dot((t.b - t.a).cross(t.c - t.a)) < 0.0), "{origin}");
        });
        assert_eq!(met, 1000);
    }
}
