//! Makes `assets/globe.obj`, `globe.mtl` and `globe_texture.png`: a smooth, textured planet of radius 1.
//!
//! `cargo run --release --example make_globe [FOLDER]`. A sphere in latitude and longitude, raised where the land is; the
//! land, its mountains and its colours come from one noise function. Each vertex has a texture coordinate and a normal,
//! taken from the slope of the displaced surface. Nothing is random: the same files come out every time.

use std::error::Error;
use std::f64::consts::{PI, TAU};
use std::fmt::Write as _;
use std::path::PathBuf;

use glam::DVec3;
use image::{Rgb, RgbImage};

/// Steps of longitude and latitude of the mesh.
const MESH: [usize; 2] = [96, 48];
/// Pixels of the texture.
const TEXTURE: [u32; 2] = [512, 256];
/// Height of the noise at which land begins.
const SEA_LEVEL: f64 = 0.04;
/// How far the highest mountains rise above radius 1.
const RELIEF: f64 = 0.07;

fn main() -> Result<(), Box<dyn Error>> {
    let folder = PathBuf::from(std::env::args_os().nth(1).unwrap_or_else(|| "assets".into()));
    std::fs::write(folder.join("globe.obj"), mesh()?)?;
    std::fs::write(folder.join("globe.mtl"), MATERIAL)?;
    texture().save(folder.join("globe_texture.png"))?;
    println!("wrote globe.obj, globe.mtl and globe_texture.png to {}", folder.display());
    Ok(())
}

const MATERIAL: &str = "\
# Made by examples/make_globe.rs
newmtl globe
Ka 1 1 1
Kd 1 1 1
Ks 0.15 0.15 0.15
Ns 30
illum 2
map_Kd globe_texture.png
";

/// The OBJ file. The seam's vertices and the poles' corners are shared; only their texture coordinates differ.
fn mesh() -> Result<String, std::fmt::Error> {
    let [columns, rows] = MESH;
    let mut obj = String::from("# Made by examples/make_globe.rs\nmtllib globe.mtl\n");
    for p in vertices() {
        let (v, n) = (displaced(p), normal(p));
        writeln!(obj, "v {:.5} {:.5} {:.5}\nvn {:.3} {:.3} {:.3}", v.x, v.y, v.z, n.x, n.y, n.z)?;
    }
    for row in 0..=rows {
        for column in 0..=columns {
            let (u, v) = (column as f64 / columns as f64, 1.0 - row as f64 / rows as f64);
            writeln!(obj, "vt {u:.5} {v:.5}")?;
        }
    }
    obj.push_str("usemtl globe\ns 1\n");
    for row in 0..rows {
        for column in 0..columns {
            writeln!(obj, "f {}", face(row, column))?;
        }
    }
    Ok(obj)
}

/// The unit sphere's grid: the north pole, the rows between, the south pole. Y is up.
fn vertices() -> impl Iterator<Item = DVec3> {
    let [columns, rows] = MESH;
    let between = (1..rows)
        .flat_map(move |r| (0..columns).map(move |c| on_sphere(c as f64 / columns as f64, r as f64 / rows as f64)));
    std::iter::once(DVec3::Y).chain(between).chain(std::iter::once(DVec3::NEG_Y))
}

/// The corners of one grid cell, counterclockwise from outside: a triangle at the poles, else a quadrilateral.
fn face(row: usize, column: usize) -> String {
    let [columns, rows] = MESH;
    let corner = |r: usize, c: usize| {
        let v = match r {
            0 => 1,
            r if r == rows => 2 + (rows - 1) * columns,
            r => 2 + (r - 1) * columns + c % columns,
        };
        format!("{v}/{}/{v}", 1 + r * (columns + 1) + c)
    };
    let (a, b) = (corner(row, column), corner(row + 1, column));
    let (c, d) = (corner(row + 1, column + 1), corner(row, column + 1));
    match row {
        0 => format!("{a} {b} {c}"),
        r if r == rows - 1 => format!("{a} {b} {d}"),
        _ => format!("{a} {b} {c} {d}"),
    }
}

/// The point of the unit sphere at texture coordinate `u` and polar angle `PI * polar`.
fn on_sphere(u: f64, polar: f64) -> DVec3 {
    let (sin, cos) = (PI * polar).sin_cos();
    let (s, c) = (TAU * u).sin_cos();
    DVec3::new(sin * c, cos, -sin * s)
}

/// The surface over a point of the unit sphere.
fn displaced(p: DVec3) -> DVec3 {
    p * (1.0 + RELIEF * (height(p) - SEA_LEVEL).max(0.0))
}

/// The surface's normal there, from two neighbours.
fn normal(p: DVec3) -> DVec3 {
    let (s, t) = p.any_orthonormal_pair();
    let step = 0.02;
    let slope = |d: DVec3| displaced((p + d * step).normalize()) - displaced((p - d * step).normalize());
    let n = slope(s).cross(slope(t)).normalize();
    if n.dot(p) < 0.0 { -n } else { n }
}

/// The texture: sea, beach, green, rock and snow by height; ice towards the poles.
fn texture() -> RgbImage {
    let [width, height] = TEXTURE;
    RgbImage::from_fn(width, height, |x, y| {
        let p = on_sphere((f64::from(x) + 0.5) / f64::from(width), (f64::from(y) + 0.5) / f64::from(height));
        let colour = colour(p) * 255.0;
        Rgb([colour.x.round() as u8, colour.y.round() as u8, colour.z.round() as u8])
    })
}

fn colour(p: DVec3) -> DVec3 {
    let land = height(p) - SEA_LEVEL;
    let ice = ((p.y.abs() - 0.86 + 0.1 * noise(p * 9.0)) * 12.0).clamp(0.0, 1.0);
    let ramp: &[(f64, [f64; 3])] = &[
        (-0.6, [0.02, 0.06, 0.22]),
        (-0.1, [0.04, 0.20, 0.45]),
        (-0.01, [0.16, 0.48, 0.62]),
        (0.0, [0.82, 0.75, 0.52]),
        (0.05, [0.28, 0.50, 0.18]),
        (0.25, [0.20, 0.36, 0.12]),
        (0.45, [0.42, 0.34, 0.24]),
        (0.60, [0.55, 0.52, 0.48]),
        (0.75, [0.95, 0.95, 0.95]),
    ];
    let above = ramp.iter().position(|r| r.0 > land).unwrap_or(ramp.len() - 1).max(1);
    let ((h0, c0), (h1, c1)) = (ramp[above - 1], ramp[above]);
    let t = ((land - h0) / (h1 - h0)).clamp(0.0, 1.0);
    DVec3::from(c0).lerp(DVec3::from(c1), t).lerp(DVec3::new(0.93, 0.96, 0.98), ice)
}

/// Height of the ground, about -1 to 1: six octaves of noise, drawn out so that seas and lands are wide.
fn height(p: DVec3) -> f64 {
    let warped = p + 0.35 * DVec3::new(noise(p * 2.1), noise(p * 2.1 + 7.0), noise(p * 2.1 + 13.0));
    let octave = |k: i32| noise(warped * 1.7 * 2f64.powi(k) + f64::from(k) * 5.3) * 0.52f64.powi(k);
    (0..6).map(octave).sum::<f64>() * 1.1
}

/// Gradient noise after Perlin (2002): zero at lattice points, smooth between them, about -1 to 1.
fn noise(p: DVec3) -> f64 {
    let cell = p.floor();
    let f = p - cell;
    let fade = f * f * f * (f * (f * 6.0 - 15.0) + 10.0);
    let mut sum = 0.0;
    for corner in 0..8 {
        let offset = DVec3::new(f64::from(corner >> 2), f64::from(corner >> 1 & 1), f64::from(corner & 1));
        let weight = (DVec3::ONE - offset) * (DVec3::ONE - fade) + offset * fade;
        sum += weight.x * weight.y * weight.z * gradient(cell + offset).dot(f - offset);
    }
    sum * 1.5
}

/// A pseudo-random direction for each lattice point.
fn gradient(cell: DVec3) -> DVec3 {
    let mut h = 0x9e37_79b9_7f4a_7c15u64;
    for x in cell.to_array() {
        h = (h ^ x as i64 as u64).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        h ^= h >> 29;
    }
    let unit = |bits: u64| (bits & 0xffff) as f64 / 65535.0;
    let (z, angle) = (unit(h) * 2.0 - 1.0, TAU * unit(h >> 20));
    let r = (1.0 - z * z).sqrt();
    DVec3::new(r * angle.cos(), r * angle.sin(), z)
}
