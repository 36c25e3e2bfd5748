//! Rays that leave a surface at a grazing angle: their direction is an f32 vector, and yet they leave it.

use std::cmp::Ordering;

use glam::{DAffine3, DQuat, DVec3, Vec3};

use super::object::Kind;
use super::origin::normal_of;
use super::path::Bounce;
use super::ray::{Omit, WorldRay, rounded};
use super::tests::{MIRROR, world};
use super::whitted::mirror;
use super::world::World;
use crate::exact::{exactly_degenerate, heading, side};
use crate::geometry::Triangle;
use crate::scene::Geometry;

/// SplitMix64 (Steele, Lea and Flood 2014).
struct Random(u64);

impl Random {
    /// From -1 to 1.
    fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }

    fn vector(&mut self) -> DVec3 {
        DVec3::new(self.unit(), self.unit(), self.unit())
    }

    fn below(&mut self, n: u32) -> u32 {
        (0.5 * (self.unit() + 1.0) * f64::from(n)) as u32
    }
}

/// A triangle anywhere, in a plane of two axes, or in one at 45 degrees to them; from 1e-30 to 1e30 in size.
fn triangle(random: &mut Random, kind: u32) -> (Triangle, f64) {
    let scale = 10f64.powi(random.below(61) as i32 - 30);
    let offset = [0.0, 1.0, 1e3][random.below(3) as usize];
    let level = random.unit();
    let mut corner = || {
        let mut p = random.vector();
        match kind {
            0 => {}
            1 => p.y = level,
            _ => p.x = p.z,
        }
        ((p + offset) * scale).as_vec3()
    };
    (Triangle { a: corner(), b: corner(), c: corner() }, scale)
}

/// Aims at the triangle from `reach` away, so many radians above its plane.
fn aimed(random: &mut Random, t: &Triangle, angle: f64, reach: f64) -> WorldRay {
    let [a, b, c] = t.vertices().map(|v| v.as_dvec3());
    let (u, v) = (0.5 + 0.5 * random.unit(), 0.5 + 0.5 * random.unit());
    let target = a + (1.0 - v) * u * (b - a) + v * u * (c - a);
    let normal = normal_of(t) * random.unit().signum();
    let about = random.vector();
    let tangent = (about - about.dot(normal) * normal).normalize_or(normal.any_orthonormal_vector());
    let from = target + reach * (angle.cos() * tangent + angle.sin() * normal);
    WorldRay::new(from, (target - from) / reach)
}

/// What became of the rays of a test.
#[derive(Debug, Default)]
struct Tally {
    mirrored: u32,
    /// Directions that the nearest f32 vector would have turned back into the face or along it.
    lifted: u32,
}

/// Mirrors a ray at a world's only triangle; the mirrored ray must leave it, as must what goes on straight through it.
fn check(world: &World, t: &Triangle, ray: WorldRay, tally: &mut Tally) {
    let to_local = match &world.objects[0].kind {
        Kind::Mesh(placed) => placed.to_local,
        _ => panic!("the worlds of these tests are of meshes"),
    };
    let seen_by = |ray: &WorldRay| ray.seen_by(0, to_local.as_ref(), ray.tmax);
    let Some(contact) = world.closest(&ray, Omit::NOTHING).unwrap() else { return };
    let Some(Bounce::Free(next)) = world.mirror_path(ray).bounce().unwrap() else { return };
    let from = side(t, seen_by(&ray).origin);
    let start = side(t, seen_by(&next).origin);
    assert!(start != Ordering::Equal && (from == Ordering::Equal || start == from), "{t:?} {ray:?}");
    assert_eq!(heading(t, seen_by(&next).direction), start, "{t:?} {ray:?}");
    assert!(world.closest(&next, Omit::NOTHING).unwrap().is_none(), "{t:?} {ray:?}");

    let (spot, incoming) = (world.spot(&contact, &ray).unwrap(), ray.direction().normalize());
    let through = WorldRay { direction: world.away(&spot, false, incoming), ..next };
    assert_eq!(heading(t, seen_by(&through).direction), start.reverse(), "{t:?} {ray:?}");

    let exact = mirror(&spot, incoming);
    let (lifted, error) = (next.direction() != rounded(exact), (next.direction() - exact).length());
    assert!(error <= if lifted { 4e-7 } else { 6e-8 }, "{error:e} {t:?} {ray:?}");
    tally.mirrored += 1;
    tally.lifted += u32::from(lifted);
}

#[test]
fn a_mirrored_ray_leaves_the_face_at_whatever_angle_and_scale() {
    let (mut random, mut tally) = (Random(1), Tally::default());
    for k in 0..60_000 {
        let (t, scale) = triangle(&mut random, k % 3);
        if exactly_degenerate(&t) {
            continue;
        }
        let one = world(vec![t], DAffine3::IDENTITY, Vec::new(), MIRROR);
        for power in 0..=8 {
            let reach = scale * [0.1, 1.0, 10.0][random.below(3) as usize];
            check(&one, &t, aimed(&mut random, &t, 10f64.powi(-power), reach), &mut tally);
        }
    }
    assert!(tally.mirrored > 100_000 && tally.lifted > 20, "{tally:?}");
}

/// Corners, origin and direction, bits of f32. Mirrored by the nearest direction these went behind the face further on.
const TURNED_BACK: [[u32; 15]; 6] = [
    [
        0xd1814bd7, 0xd1226ca0, 0x51b6c522, 0xd1280a29, 0xcedf07c7, 0xd0a2e89a, 0x51ae4305, 0xd11ac78e, 0xd18c3266,
        0xd0aaffe5, 0xd0b08db1, 0x4f8ec438, 0xbdcdbbbd, 0x3ee0a3d6, 0xbf649a1c,
    ],
    [
        0x6909984a, 0x685b421e, 0x6809ee4d, 0x6933fa92, 0x6905ca40, 0x68d078c4, 0x6906a001, 0x691cd61a, 0x692fdc22,
        0x690dbe7c, 0x686ba695, 0x68117b4a, 0xbd98431d, 0x3f0f0e0b, 0x3f5371f7,
    ],
    [
        0x36c9771b, 0x378cedbb, 0x36ceb902, 0x3712fe6a, 0x3681b602, 0x36310f1d, 0x378dc448, 0x373fd20b, 0x378510dd,
        0x370520ae, 0x3788e10e, 0x37084386, 0x3f0fe10e, 0xbf4b1da0, 0x3e6f4ad2,
    ],
    [
        0xaea7f909, 0xaea532e9, 0xad99fe08, 0xae17db7a, 0xaeb35cd8, 0x2e059d94, 0xae985c87, 0x2dedbd68, 0xae91dd7a,
        0xaf04dcf7, 0x2e2e9832, 0xaf0ca7a5, 0x3f08b2f2, 0xbeb8c0be, 0x3f43bea2,
    ],
    [
        0x42206204, 0x4214e2ff, 0x4184c9f6, 0x42d5174f, 0x42fc08d1, 0x429cdfcb, 0x423d0217, 0x42cb1504, 0x431fd030,
        0x42645663, 0x42c0b02a, 0x42f67924, 0xbf3ac15f, 0xbf2e9a36, 0x3d521bcc,
    ],
    [
        0xad2ef2fa, 0x2d1c544c, 0x2cb4fd2d, 0xad229f04, 0xac94d185, 0xacebfd8e, 0xac9cb006, 0x2cb980b0, 0xacafdfa7,
        0xad3cc8db, 0x2d337ef6, 0x2cff8edd, 0x3e1235d4, 0xbf29344e, 0xbf3c997f,
    ],
];

#[test]
fn directions_that_were_turned_back() {
    let mut tally = Tally::default();
    for bits in TURNED_BACK {
        let vector =
            |at: usize| Vec3::from_slice(&bits[at..at + 3].iter().map(|&b| f32::from_bits(b)).collect::<Vec<_>>());
        let t = Triangle { a: vector(0), b: vector(3), c: vector(6) };
        let ray = WorldRay::new(vector(9).as_dvec3(), vector(12).as_dvec3());
        check(&world(vec![t], DAffine3::IDENTITY, Vec::new(), MIRROR), &t, ray, &mut tally);
    }
    assert_eq!((tally.mirrored, tally.lifted), (6, 6));
}

#[test]
fn so_it_does_from_an_instance() {
    let (mut random, mut tally) = (Random(2), Tally::default());
    for k in 0..60_000 {
        let (t, _) = triangle(&mut random, k % 3);
        if exactly_degenerate(&t) {
            continue;
        }
        let stretch = DVec3::from_array([0; 3].map(|_| 10f64.powi(random.below(7) as i32 - 3)));
        let turn = DQuat::from_scaled_axis(3.0 * random.vector());
        let size = t.vertices().map(|v| v.as_dvec3().length()).into_iter().fold(0.0, f64::max);
        let move_by = random.vector() * size * [0.0, 1.0, 100.0][random.below(3) as usize];
        let to_world = DAffine3::from_scale_rotation_translation(stretch, turn, move_by);
        let placed = t.vertices().map(|v| to_world.transform_point3(v.as_dvec3()).as_vec3());
        let placed = Triangle { a: placed[0], b: placed[1], c: placed[2] };
        if !placed.vertices().iter().all(|v| v.is_finite()) || exactly_degenerate(&placed) {
            continue;
        }
        let one = world(vec![t], to_world, Vec::new(), MIRROR);
        let extent = (placed.b - placed.a).as_dvec3().length();
        for power in 0..=8 {
            check(&one, &t, aimed(&mut random, &placed, 10f64.powi(-power), extent), &mut tally);
        }
    }
    assert!(tally.mirrored > 100_000 && tally.lifted > 20, "{tally:?}");
}

#[test]
fn so_it_does_from_a_plane() {
    let (mut random, mut lifted) = (Random(3), 0);
    for k in 0..20_000 {
        let normal = if k % 4 == 0 { DVec3::Y } else { random.vector().normalize_or(DVec3::X) };
        let point = random.vector() * 10f64.powi(random.below(13) as i32 - 6);
        let plane = Geometry::Plane { point, normal };
        let far = DAffine3::from_translation(DVec3::splat(1e9));
        let (t, _) = triangle(&mut Random(4), 0);
        let one = world(vec![t], far, vec![plane], MIRROR);
        let about = random.vector();
        let tangent = (about - about.dot(normal) * normal).normalize_or(normal.any_orthonormal_vector());
        let rise = 10f64.powi(-(random.below(9) as i32));
        let ray = WorldRay::new(point + tangent + rise * normal, -tangent - rise * normal);
        let Some(contact) = one.closest(&ray, Omit::NOTHING).unwrap() else { continue };
        let spot = one.spot(&contact, &ray).unwrap();
        let direction = mirror(&spot, ray.direction().normalize());
        let away = one.away(&spot, true, direction);
        assert!(away.dot(spot.normal) > 0.0, "{ray:?} {normal:?}");
        let Some(Bounce::Free(next)) = one.mirror_path(ray).bounce().unwrap() else { panic!("no origin: {ray:?}") };
        assert_eq!(next.direction(), away);
        let again = one.closest(&next, Omit::NOTHING).unwrap();
        assert!(again.is_none_or(|c| c.object != contact.object), "{ray:?} {normal:?}");
        lifted += u32::from(away != rounded(direction));
    }
    assert!(lifted > 20, "{lifted}");
}

#[test]
fn so_it_does_from_a_ball_that_passes_by_the_worlds_origin() {
    // There an origin is closest to the surface, since coordinates are fine.
    let (mut random, mut lifted, mut mirrored) = (Random(6), 0, 0);
    for k in 0..20_000 {
        let outward = random.vector().normalize_or(DVec3::X);
        let radius = [1.0, 1e3, 1e-3][k % 3];
        let shift = random.vector() * radius * 10f64.powi(-(random.below(11) as i32));
        let ball = Geometry::Sphere { center: shift - radius * outward, radius, to_world: DAffine3::IDENTITY };
        let (t, _) = triangle(&mut Random(4), 0);
        let one = world(vec![t], DAffine3::from_translation(DVec3::splat(1e9)), vec![ball], MIRROR);
        let about = random.vector();
        let tangent = (about - about.dot(outward) * outward).normalize_or(outward.any_orthonormal_vector());
        let rise = 10f64.powi(-(random.below(9) as i32));
        let reach = radius * rise.sqrt().min(0.1);
        let ray = WorldRay::new(shift + reach * (tangent + rise * outward), -tangent - rise * outward);
        let Some(contact) = one.closest(&ray, Omit::NOTHING).unwrap() else { continue };
        let spot = one.spot(&contact, &ray).unwrap();
        // Rounding may have put the ray's start inside.
        if !spot.front {
            continue;
        }
        // Flatter than a ray of f32 can be aimed, but not than a path may come to be.
        let aside = (tangent - tangent.dot(spot.normal) * spot.normal).normalize();
        for power in 6..12 {
            let direction = aside + 10f64.powi(-power) * spot.normal;
            let away = one.away(&spot, true, direction);
            assert!(away.dot(spot.normal) > 0.0, "{ray:?} {outward:?}");
            lifted += u32::from(away != rounded(direction));
        }
        let Some(Bounce::Free(next)) = one.mirror_path(ray).bounce().unwrap() else { continue };
        let again = one.closest(&next, Omit::NOTHING).unwrap();
        assert!(again.is_none_or(|c| c.object != contact.object), "{ray:?} {outward:?}");
        mirrored += 1;
    }
    assert!(mirrored > 2000 && lifted > 1000, "{mirrored} {lifted}");
}
