//! Hard cases of secondary rays: closed mirrors, creases, thin sheets, blockers just before a light.

use std::path::PathBuf;

use glam::{DAffine3, DQuat, DVec3, Quat, Vec3};
use proptest::prelude::*;

use super::double::{Brute, cube};
use super::mesh::Mesh;
use super::object::strictly_on;
use super::origin::{normal_of, point_of, step_off, triangle_bound};
use super::ray::{Omit, WorldRay};
use super::wave::Wave;
use super::world::World;
use crate::geometry::Triangle;
use crate::scene::{Color, Geometry, Instance, Light, Material, MeshFile, Scene, Shape};

pub(super) const MIRROR: Material = Material {
    ambient: Color::ONE,
    diffuse: Color::ONE,
    specular: Color::ZERO,
    local: 0.0,
    reflect: 1.0,
    transmit: 0.0,
    ior: 1.0,
    shininess: 40.0,
};

/// A world of one mesh and shapes, all of one material; a ray that leaves it is seen as white.
pub(super) fn world(mesh: Vec<Triangle>, to_world: DAffine3, shapes: Vec<Geometry>, material: Material) -> World {
    let scene = Scene {
        background: Color::ONE,
        materials: vec![material],
        meshes: vec![MeshFile { path: PathBuf::from("mesh"), built: true }],
        instances: vec![Instance { mesh: 0, material: 0, to_world, mtl: false, smooth: false }],
        shapes: shapes.into_iter().map(|geometry| Shape { geometry, material: 0 }).collect(),
        ..Scene::default()
    };
    World::with_meshes(scene, vec![Mesh::bare(Box::new(Brute(mesh)))]).unwrap()
}

/// Directions spread over the sphere, some of them along axes and diagonals.
fn directions(count: u32) -> impl Iterator<Item = DVec3> {
    let special = [DVec3::X, DVec3::NEG_Y, DVec3::Z, DVec3::ONE, DVec3::new(1.0, -1.0, 0.0), DVec3::new(0.0, 1.0, 1.0)];
    let spread = (0..count).map(move |i| {
        let (h, phi) = (1.0 - 2.0 * (f64::from(i) + 0.5) / f64::from(count), 2.399_963 * f64::from(i));
        let r = (1.0 - h * h).sqrt();
        DVec3::new(r * phi.cos(), r * phi.sin(), h)
    });
    special.into_iter().chain(spread)
}

/// Paths of `depth` bounces in a closed box of mirrors whose end was not the last bounce's background but an escape.
fn escapes(world: &World, center: DVec3, paths: u32, depth: u32) -> u64 {
    let mut wave = Wave::new(depth);
    let mut escaped = 0;
    for direction in directions(paths) {
        let before = wave.counts.mirror;
        world.color(WorldRay::new(center, direction), &mut wave).unwrap();
        escaped += u64::from(wave.counts.mirror - before != u64::from(depth));
    }
    escaped
}

#[test]
fn nothing_escapes_a_closed_box_of_mirrors() {
    let box_of = |place: &dyn Fn(Vec3) -> Vec3| world(cube(place), DAffine3::IDENTITY, Vec::new(), MIRROR);
    let turn = Quat::from_euler(glam::EulerRot::XYZ, 0.3, 1.1, -0.7);
    assert_eq!(escapes(&box_of(&|p| p), DVec3::splat(0.1), 60, 1000), 0, "plain");
    assert_eq!(escapes(&box_of(&|p| p), DVec3::ZERO, 60, 300), 0, "from the centre, into edges and corners");
    assert_eq!(escapes(&box_of(&|p| turn * p), DVec3::splat(0.1), 60, 1000), 0, "rotated");
    assert_eq!(escapes(&box_of(&|p| turn * p + 1e6), DVec3::splat(1e6), 60, 300), 0, "far away");
    for scale in [1e-30f32, 1e-3, 1e10, 1e30] {
        let center = DVec3::splat(f64::from(scale) * 0.1);
        assert_eq!(escapes(&box_of(&|p| turn * p * scale), center, 60, 300), 0, "scale {scale}");
    }
}

#[test]
fn nothing_escapes_a_wedge_sharper_than_any_offset() {
    // A long thin prism: mirrors that meet at about 1e-4 radians; rays run deep into the crease.
    let squeeze = |p: Vec3| Vec3::new(p.x, if p.x > 0.0 { p.y * 1e-4 } else { p.y * 1e-7 }, p.z);
    let prism = world(cube(squeeze), DAffine3::IDENTITY, Vec::new(), MIRROR);
    let mut wave = Wave::new(300);
    for i in 0..200 {
        let aim = DVec3::new(-1.0, 1e-4 * f64::from(i) / 200.0, 0.3 - 0.003 * f64::from(i));
        let before = wave.counts.mirror;
        prism.color(WorldRay::new(DVec3::new(0.5, 0.0, 0.0), aim), &mut wave).unwrap();
        assert_eq!(wave.counts.mirror - before, 300, "ray {i}");
    }
}

#[test]
fn nothing_escapes_a_transformed_instance_or_a_box_of_rectangles() {
    let to_world = DAffine3::from_scale_rotation_translation(
        DVec3::new(3.0, 0.2, 7.0),
        DQuat::from_rotation_y(0.4) * DQuat::from_rotation_x(1.3),
        DVec3::new(100.0, -20.0, 3.0),
    );
    let placed = world(cube(|p| p), to_world, Vec::new(), MIRROR);
    assert_eq!(escapes(&placed, to_world.translation, 60, 300), 0);
    let quads = cube(|p| p);
    let rectangles = quads.chunks(2).map(|q| Geometry::Rectangle([q[0].a, q[0].b, q[0].c, q[1].c]));
    let room = world(vec![quads[0]], DAffine3::from_translation(DVec3::splat(50.0)), rectangles.collect(), MIRROR);
    assert_eq!(escapes(&room, DVec3::splat(0.1), 60, 1000), 0);
    assert_eq!(escapes(&room, DVec3::ZERO, 60, 300), 0);
}

#[test]
fn nothing_escapes_a_mirrored_ball_from_inside() {
    let ball = Geometry::Sphere { center: DVec3::new(3.0, 4.0, 5.0), radius: 2.0, to_world: DAffine3::IDENTITY };
    let squashed = DAffine3::from_scale(DVec3::new(2.0, 0.1, 1.0));
    let egg = Geometry::Sphere { center: DVec3::ZERO, radius: 1.0, to_world: squashed };
    let far = DAffine3::from_translation(DVec3::splat(1e9));
    let dummy = || vec![cube(|p| p)[0]];
    assert_eq!(escapes(&world(dummy(), far, vec![ball], MIRROR), DVec3::new(3.5, 4.0, 5.0), 60, 1000), 0);
    assert_eq!(escapes(&world(dummy(), far, vec![egg], MIRROR), DVec3::new(0.5, 0.01, 0.1), 60, 1000), 0);
}

#[test]
fn a_blocker_just_before_the_light_and_a_light_just_before_a_blocker() {
    let floor = Geometry::Rectangle([
        Vec3::new(-1.0, 0.0, 1.0),
        Vec3::new(1.0, 0.0, 1.0),
        Vec3::new(1.0, 0.0, -1.0),
        Vec3::new(-1.0, 0.0, -1.0),
    ]);
    let matte = Material { ambient: Color::ZERO, ..Material::default() };
    let sheet = |y: f32| {
        let corner = |x, z| Vec3::new(x, y, z);
        vec![Triangle { a: corner(-9.0, -9.0), b: corner(9.0, -9.0), c: corner(0.0, 9.0) }]
    };
    let lit = |y: f32| {
        let mut world = world(sheet(y), DAffine3::IDENTITY, vec![floor], matte);
        world.scene.lights = vec![Light::Point { position: DVec3::new(0.0, 2.0, 0.0), color: Color::ONE }];
        let ray = WorldRay::new(DVec3::new(0.2, 1.0, 0.1), DVec3::new(-0.1, -1.0, -0.2));
        world.color(ray, &mut Wave::new(0)).unwrap() != Color::ZERO
    };
    assert!(!lit(2.0f32.next_down()), "one ulp before the light");
    assert!(!lit(2.0 * 0.99995));
    assert!(lit(2.0f32.next_up()), "one ulp behind the light");
    assert!(lit(2.0), "a sheet through the light itself");
}

#[test]
fn the_corner_of_a_room_has_no_dark_specks() {
    // Every hit lies exactly on an edge or the diagonal of walls; each must be lit by a light inside.
    let matte = Material { ambient: Color::ZERO, ..Material::default() };
    let mut room = world(cube(|p| p), DAffine3::IDENTITY, Vec::new(), matte);
    room.scene.lights = vec![Light::Point { position: DVec3::new(0.25, 0.5, -0.125), color: Color::ONE }];
    for i in -7..=7 {
        let x = f64::from(i) / 8.0;
        for aim in [DVec3::new(x, -1.0, -1.0), DVec3::new(x, -1.0, x), DVec3::new(1.0, x, 1.0), DVec3::new(1.0, -x, x)]
        {
            let color = room.color(WorldRay::new(DVec3::ZERO, aim), &mut Wave::new(0)).unwrap();
            assert!(color.x > 0.0, "towards {aim}");
        }
    }
}

#[test]
fn sheets_one_ulp_apart_keep_their_order() {
    // Light above both: the upper sheet is lit, the lower one is not, whichever comes first in the file.
    let sheet =
        |y: f32| Triangle { a: Vec3::new(-9.0, y, -9.0), b: Vec3::new(0.0, y, 9.0), c: Vec3::new(9.0, y, -9.0) };
    for sheets in [[1.0, 1.0f32.next_up()], [1.0f32.next_up(), 1.0]] {
        let matte = Material { ambient: Color::ZERO, ..Material::default() };
        let mut world = world(sheets.map(sheet).to_vec(), DAffine3::IDENTITY, Vec::new(), matte);
        world.scene.lights = vec![Light::Point { position: DVec3::new(0.0, 5.0, 0.0), color: Color::ONE }];
        let seen = |from: f64| {
            let ray = WorldRay::new(DVec3::new(0.3, from, 0.1), DVec3::new(0.0, 1.0 - from, 0.0));
            world.color(ray, &mut Wave::new(0)).unwrap().x
        };
        assert!(seen(3.0) > 0.0);
        assert_eq!(seen(-3.0), 0.0);
    }
}

#[test]
fn the_tree_over_objects_changes_nothing() {
    let turned = |i: i32| {
        DAffine3::from_scale_rotation_translation(
            DVec3::splat(0.3 + 0.02 * f64::from(i)),
            DQuat::from_rotation_x(f64::from(i)),
            DVec3::new(f64::from(i % 5), f64::from(i / 5), f64::from(i % 3)),
        )
    };
    let scene = Scene {
        materials: vec![Material { reflect: 0.5, ..Material::default() }],
        lights: vec![Light::Sun { direction: DVec3::new(-1.0, -2.0, -1.0), color: Color::ONE }],
        meshes: vec![MeshFile { path: PathBuf::from("mesh"), built: true }],
        instances: (0..30)
            .map(|i| Instance { mesh: 0, material: 0, to_world: turned(i), mtl: false, smooth: false })
            .collect(),
        shapes: (0..8)
            .map(|i| Geometry::Sphere { center: DVec3::splat(f64::from(i)), radius: 0.5, to_world: turned(i) })
            .chain([Geometry::Plane { point: DVec3::NEG_Y, normal: DVec3::Y }])
            .map(|geometry| Shape { geometry, material: 0 })
            .collect(),
        ..Scene::default()
    };
    let make = |tree_from| {
        let mut world = World::with_meshes(scene.clone(), vec![Mesh::bare(Box::new(Brute(cube(|p| p))))]).unwrap();
        world.arrange(tree_from);
        world
    };
    let (tree, list) = (make(16), make(usize::MAX));
    let mut met = 0;
    for direction in directions(3000) {
        let ray = WorldRay::new(DVec3::new(2.1, 2.2, 9.0), direction);
        let [a, b] = [&tree, &list].map(|w| w.closest(&ray, Omit::NOTHING).unwrap().map(|c| (c.object, c.t.to_bits())));
        assert_eq!(a, b);
        assert_eq!(tree.any(&ray, Omit::NOTHING).unwrap(), a.is_some());
        let [a, b] = [&tree, &list].map(|w| w.color(ray, &mut Wave::new(5)).unwrap());
        assert_eq!(a, b);
        met += u32::from(a != Color::ZERO);
    }
    assert!(met > 1000, "{met}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    /// An origin is found beside any triangle that is not degenerate, certified, and near.
    #[test]
    fn origins_are_certified_and_near(
        corners in prop::array::uniform9(-1.0f32..1.0),
        weights in prop::array::uniform2(0.0f64..0.5),
        exponent in -30i32..=30,
        offset in prop::sample::select(vec![0.0f32, 1.0, 1e3, 1e6]),
        front: bool,
    ) {
        let scale = 10f32.powi(exponent);
        let at = |i: usize| (Vec3::from_slice(&corners[3 * i..]) + offset) * scale;
        let triangle = Triangle { a: at(0), b: at(1), c: at(2) };
        prop_assume!(triangle.is_finite() && !crate::exact::exactly_degenerate(&triangle));
        let p = point_of(&triangle, weights);
        let normal = if front { normal_of(&triangle) } else { -normal_of(&triangle) };
        let bound = triangle_bound(&triangle, p);
        let o = step_off(p, normal, bound, 1.0, |o| strictly_on(&triangle, o, front));
        let o = o.expect("there is always a point");
        prop_assert!(strictly_on(&triangle, o, front));
        let distance = (o.as_dvec3() - p).length();
        prop_assert!(distance <= 8.0 * bound.length() + 1e-44, "{distance} {bound}");
    }
}
