//! Waves against rays followed one by one, by a recursion of its own: the same colours and counts, bit for bit.

use std::path::PathBuf;

use glam::{DAffine3, DQuat, DVec3, Vec3};

use super::batch::{Batch, Questions};
use super::double::{Brute, cube};
use super::leave::Departure;
use super::mesh::Mesh;
use super::ray::{Omit, Origin, WorldRay};
use super::wave::Wave;
use super::whitted::{AT_LIGHT, Ahead, LEAST_WEIGHT, Meeting, RayCounts, mirror, refract};
use super::world::World;
use crate::geometry::FaceId;
use crate::scene::{Color, Geometry, Instance, Light, Material, MeshFile, Scene, Shape};

/// Meshes as they were modelled and turned, balls, a plane and a rectangle; mirrors, glass, matte; lamps before, behind and on things.
fn mixed(meshes: usize) -> World {
    let materials = vec![
        Material { diffuse: Color::new(0.8, 0.4, 0.2), specular: Color::splat(0.3), ..Material::default() },
        Material { local: 0.3, reflect: 0.7, ..Material::default() },
        Material { local: 0.1, reflect: 0.2, transmit: 0.8, ior: 1.4, ..Material::default() },
        Material { local: 0.0, transmit: 0.9, ior: 1.0, ..Material::default() },
    ];
    let turned = |i: usize| {
        let place = DVec3::new((i % 4) as f64 * 3.0 - 4.0, (i / 4) as f64 * 3.0, -((i % 3) as f64));
        DAffine3::from_scale_rotation_translation(DVec3::new(1.0, 0.8, 1.1), DQuat::from_rotation_y(i as f64), place)
    };
    let instance = |i: usize| {
        let to_world = if i == 0 { DAffine3::IDENTITY } else { turned(i) };
        Instance { mesh: i % 2, material: i % 4, to_world, mtl: false, smooth: false }
    };
    let corners = [[-6.0, -1.0, 4.0], [6.0, -1.0, 4.0], [6.0, 4.0, -6.0], [-6.0, 4.0, -6.0]];
    let ball =
        |x: f64, r: f64| Geometry::Sphere { center: DVec3::new(x, 0.5, 2.5), radius: r, to_world: DAffine3::IDENTITY };
    let shapes = [
        ball(-1.5, 0.7),
        ball(1.6, 0.9),
        Geometry::Plane { point: DVec3::NEG_Y, normal: DVec3::Y },
        Geometry::Rectangle(corners.map(Vec3::from_array)),
    ];
    let scene = Scene {
        background: Color::new(0.3, 0.5, 0.9),
        ambient: 0.1,
        lights: vec![
            Light::Point { position: DVec3::new(4.0, 6.0, 7.0), color: Color::splat(0.7) },
            Light::Sun { direction: DVec3::new(-1.0, -2.0, -1.0), color: Color::splat(0.4) },
            // On a face of the first cube.
            Light::Point { position: DVec3::new(0.25, 0.125, 1.0), color: Color::splat(0.5) },
        ],
        meshes: (0..2).map(|i| MeshFile { path: PathBuf::from(format!("mesh{i}")), built: true }).collect(),
        instances: (0..meshes).map(instance).collect(),
        shapes: (0..).zip(shapes).map(|(i, geometry)| Shape { geometry, material: [2, 1, 0, 3][i] }).collect(),
        materials,
        ..Scene::default()
    };
    let tracers = [cube(|p| p), cube(|p| p * Vec3::new(0.5, 1.5, 0.7))].map(|t| Mesh::bare(Box::new(Brute(t))));
    World::with_meshes(scene, tracers.into()).unwrap()
}

/// Rays from one point into a cone, and some of no use.
fn rays(count: u32) -> Vec<WorldRay> {
    let eye = DVec3::new(0.5, 1.5, 11.0);
    let aim = |i: u32| DVec3::new(f64::from(i % 37) / 37.0 - 0.5, f64::from(i % 41) / 41.0 - 0.6, -1.0);
    let ray = |i: u32| WorldRay::new(eye, if i.is_multiple_of(97) { DVec3::ZERO } else { aim(i) });
    (0..count).map(ray).collect()
}

/// What one ray gathers: first its own surface's light, then that of the mirrored ray and all it gives rise to, then that of the
/// refracted one.
struct Alone<'w> {
    world: &'w World,
    depth: u32,
    counts: RayCounts,
    sum: Color,
}

impl Alone<'_> {
    fn follow(&mut self, ahead: &Ahead, weight: Color, bounces: u32) {
        let background = self.world.scene.background;
        let Some(meeting) = self.world.meet(ahead).unwrap() else {
            self.sum += weight * background;
            return;
        };
        let Meeting { ref spot, incoming, .. } = meeting;
        let surface = &spot.surface;
        let mut color = Color::ZERO;
        if surface.local != 0.0 {
            color += self.local(&meeting) * surface.local;
        }
        let refracted = if surface.transmit == 0.0 { None } else { refract(spot, incoming) };
        let total = Color::splat(if refracted.is_none() { surface.transmit } else { 0.0 });
        let through = refracted.map(|direction| (direction, Color::splat(surface.transmit), false));
        let mirrored = (mirror(spot, incoming), surface.reflect + total, true);
        let mut next = Vec::new();
        for (direction, share, near) in through.into_iter().chain((mirrored.1 != Color::ZERO).then_some(mirrored)) {
            let ends = bounces >= self.depth || (weight * share).abs().max_element() < LEAST_WEIGHT;
            let departure = (!ends).then(|| self.world.leave(spot, near, meeting.path(near)).unwrap());
            match departure.and_then(|d| d.along(self.world.away(spot, near, direction))) {
                None => color += share * background,
                Some(ahead) => {
                    *(if near { &mut self.counts.mirror } else { &mut self.counts.refracted }) += 1;
                    next.push((ahead, weight * share));
                }
            }
        }
        self.sum += weight * color;
        for (ahead, weight) in next.into_iter().rev() {
            self.follow(&ahead, weight, bounces + 1);
        }
    }

    fn local(&mut self, meeting: &Meeting) -> Color {
        let mut color = self.world.scene.ambient * meeting.spot.surface.ambient;
        for light in &self.world.scene.lights {
            let lit = self.world.lit(meeting, light);
            if lit == Color::ZERO {
                continue;
            }
            let departure = self.world.leave(&meeting.spot, true, meeting.path(true)).unwrap();
            if let Departure::Free(origin) = departure {
                self.counts.shadow += 1;
                if self.reaches(&origin, meeting.spot.omit, light) {
                    color += lit;
                }
            }
        }
        color
    }

    /// Whether nothing lies between: first well before the light, then near it.
    fn reaches(&self, origin: &Origin, omit: Omit, light: &Light) -> bool {
        let world = self.world;
        let omit = if omit.face == FaceId::NONE { Omit::NOTHING } else { omit };
        let way = |direction, tmax| WorldRay::from(origin, direction, tmax);
        match *light {
            Light::Sun { direction, .. } => !world.any(&way(-direction, f32::INFINITY), omit).unwrap(),
            Light::Point { position, .. } => {
                let ray = way(position - origin.world, AT_LIGHT[0]);
                let end = world.all(&ray.between(AT_LIGHT[0], AT_LIGHT[1]), omit).unwrap();
                let before = |contact| world.apart(contact, &ray, position).unwrap_or(false);
                !world.any(&ray, omit).unwrap() && !end.iter().any(before)
            }
        }
    }
}

#[test]
fn a_wave_gives_each_ray_what_it_gathers_alone() {
    // Few objects, all in one list; many, in a tree.
    for meshes in [3, 20] {
        let world = mixed(meshes);
        let (rays, depth) = (rays(700), 7);
        let mut alone = Alone { world: &world, depth, counts: RayCounts::default(), sum: Color::ZERO };
        let mut want = Vec::new();
        for ray in &rays {
            alone.sum = Color::ZERO;
            alone.counts.primary += 1;
            alone.follow(&Ahead { ray: *ray, blocker: None }, Color::ONE, 0);
            want.push(alone.sum);
        }
        let RayCounts { shadow, mirror, refracted, .. } = alone.counts;
        assert!(shadow > 700 && mirror > 100 && refracted > 200, "{:?}", alone.counts);
        // All together, in parts, each for itself; the same working space every time.
        let mut wave = Wave::new(depth);
        for part in [rays.len(), 64, 7, 1] {
            wave.counts = RayCounts::default();
            let mut got = Vec::new();
            for rays in rays.chunks(part) {
                wave.clear();
                rays.iter().for_each(|&ray| wave.add(ray));
                while world.follow(&mut wave).unwrap() {}
                got.extend_from_slice(wave.colors());
            }
            let differ = got
                .iter()
                .zip(&want)
                .position(|(a, b)| a.to_array().map(f64::to_bits) != b.to_array().map(f64::to_bits));
            assert_eq!((differ, got.len()), (None, want.len()), "in parts of {part}, {meshes} meshes");
            assert_eq!(wave.counts, alone.counts);
        }
    }
}

#[test]
fn a_wave_that_was_broken_off_leaves_nothing_behind() {
    let (world, rays) = (mixed(3), rays(50));
    let colors = |wave: &mut Wave, rays: &[WorldRay]| {
        wave.clear();
        rays.iter().for_each(|&ray| wave.add(ray));
        while world.follow(wave).unwrap() {}
        wave.colors().to_vec()
    };
    let want = colors(&mut Wave::new(9), &rays[20..]);
    let mut wave = Wave::new(9);
    rays.iter().for_each(|&ray| wave.add(ray));
    assert!(world.follow(&mut wave).unwrap() && world.follow(&mut wave).unwrap());
    assert_eq!(colors(&mut wave, &rays[20..]), want);
}

#[test]
fn batches_answer_as_single_questions_do() {
    for meshes in [2, 20] {
        let world = mixed(meshes);
        let rays = rays(500);
        let (mut contacts, mut batch, mut questions) = (Vec::new(), Batch::default(), Questions::default());
        world.closest_each(&rays, &mut contacts, &mut batch).unwrap();
        let key = |c: &super::Contact| (c.object, c.t.to_bits());
        for (ray, contact) in rays.iter().zip(&contacts) {
            let alone = world.closest(ray, Omit::NOTHING).unwrap();
            assert_eq!(contact.as_ref().map(key), alone.as_ref().map(key));
        }
        // Each ray up to what it meets and beyond, that left out or not.
        questions.clear();
        let mut want = Vec::new();
        for (ray, contact) in rays.iter().zip(&contacts) {
            let Some(contact) = contact else { continue };
            let omit = world.spot(contact, ray).unwrap().omit;
            for tmax in [contact.t.next_down(), contact.t, 2.0 * contact.t] {
                for omit in [omit, Omit::NOTHING] {
                    let ray = ray.between(0.0, tmax);
                    questions.push(ray, omit);
                    want.push(world.any(&ray, omit).unwrap());
                }
            }
        }
        for short in [true, false] {
            world.any_each(&mut questions, short, &mut batch).unwrap();
            assert_eq!(questions.blocked, want);
        }
        assert!(want.iter().filter(|&&b| b).count() > 100 && want.iter().filter(|&&b| !b).count() > 100);
    }
}
