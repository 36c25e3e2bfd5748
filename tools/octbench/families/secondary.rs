//! Families 42 to 48: rays that start on a surface, that end on one, and that leave out a triangle.
//!
//! Here they are held to the oracle ray by ray; whole pictures (mirror rooms, spheres in spheres, shading normals) are
//! tested with the shading code itself.

use super::{Case, Family, Maker, Probe, mesh, ray, toward};
use crate::families::mesh::Mesh;
use crate::oracle::OracleRay;

pub const FAMILIES: &[Family] = &[
    Family { number: 42, name: "mirrored at a grazing angle", make: grazing_mirror },
    Family { number: 43, name: "shadow ray that ends on a triangle", make: ends_on_light },
    Family { number: 44, name: "origin on a light, light in the plane", make: on_light },
    Family { number: 45, name: "shells with a gap of 4e-5", make: shells },
    Family { number: 46, name: "inside a closed box", make: mirror_box },
    Family { number: 47, name: "a mesh in a mirror room", make: mirror_room },
    Family { number: 48, name: "leaving a face on either side", make: either_side },
];

/// A ray from a rounded point of a face, leaving that face out.
fn leaving(m: &mut Maker<'_>, mesh: &Mesh, direction: impl Fn(&mut Maker<'_>, [f64; 3]) -> [f64; 3]) -> Probe {
    let face = m.random.below(mesh.faces.len());
    let [a, b, c] = mesh.corners(face).map(|p| p.map(f64::from));
    let (e, f) = ([0, 1, 2].map(|i| b[i] - a[i]), [0, 1, 2].map(|i| c[i] - a[i]));
    let n = [e[1] * f[2] - e[2] * f[1], e[2] * f[0] - e[0] * f[2], e[0] * f[1] - e[1] * f[0]];
    let largest = n.iter().fold(f64::MIN_POSITIVE, |x, y| x.max(y.abs()));
    let n = n.map(|x| x / largest);
    let length = n.iter().map(|x| x * x).sum::<f64>().sqrt().max(1e-300);
    let near_edge = m.random.pick(&[0.0, 1e-7, 0.3]);
    let (u, v) = (m.random.unit() * (1.0 - near_edge), m.random.unit() * near_edge);
    let o = std::array::from_fn(|i| (a[i] + u * e[i] + v * f[i]) as f32);
    let d = direction(m, n.map(|x| x / length)).map(|x| x as f32);
    let skip = [if m.random.chance(0.8) { face as u32 } else { u32::MAX }, u32::MAX];
    Probe { skip, ..Probe::closest(ray(o, d)) }
}

fn leaving_case(m: &mut Maker<'_>, mesh: Mesh, direction: impl Fn(&mut Maker<'_>, [f64; 3]) -> [f64; 3]) -> Case {
    let probes = (0..m.rays).map(|_| leaving(m, &mesh, &direction)).collect();
    Case { mesh, probes, ..Case::default() }
}

fn grazing_mirror(m: &mut Maker<'_>) -> Case {
    let mesh = if m.model.is_none() && m.random.chance(0.3) { creases(m) } else { m.any_mesh() };
    leaving_case(m, mesh, |m, n| {
        let w = m.random.direction();
        let along = (0..3).map(|i| w[i] * n[i]).sum::<f64>();
        let rise = m.random.pick(&[1.745e-8, 1e-3, 1.0]);
        [0, 1, 2].map(|i| w[i] - along * n[i] + rise * n[i])
    })
}

/// Long roofs side by side: convex ridges and concave creases in turn.
fn creases(m: &mut Maker<'_>) -> Mesh {
    let n = (m.size / 2).max(2);
    let height = m.random.pick(&[1e-4, 0.01, 1.0]);
    let points = (0..2 * (n + 1))
        .map(|k| {
            let (x, up) = ((k / 2) as f32 / n as f32, (k / 2) % 2 == 1);
            [2.0 * x - 1.0, (k % 2) as f32 * 2.0 - 1.0, if up { height / n as f32 } else { 0.0 }]
        })
        .collect();
    let v = |k: usize| k as u32;
    let faces =
        (0..n).flat_map(|k| [[v(2 * k), v(2 * k + 2), v(2 * k + 1)], [v(2 * k + 1), v(2 * k + 2), v(2 * k + 3)]]);
    let mesh = Mesh::new(points, faces.collect());
    m.place(mesh)
}

fn ends_on_light(m: &mut Maker<'_>) -> Case {
    let mut mesh = m.any_mesh();
    // A light of one triangle, and blockers just before it and at 0.99995 of the way.
    let (center, radius) = mesh.ball();
    let height = |s: f64| (center[2] + radius * s).clamp(-3e38, 3e38) as f32;
    let at = |z: f32, k: usize| -> [f32; 3] {
        let [x, y] = [[1.0, 0.0], [-0.5, 0.87], [-0.5, -0.87]][k];
        [(center[0] + radius * x).clamp(-3e38, 3e38) as f32, (center[1] + radius * y).clamp(-3e38, 3e38) as f32, z]
    };
    let light = mesh.faces.len() as u32;
    // One or both blockers, so that each is what decides for some of the rays.
    let blockers = m.random.pick(&[[true, false], [false, true], [true, true], [false, false]]);
    let heights =
        [(height(3.0), true), (height(3.0).next_down(), blockers[0]), (height(1.0 + 2.0 * 0.99995), blockers[1])];
    for (z, _) in heights.into_iter().filter(|(_, there)| *there) {
        mesh.append(&Mesh::soup([[at(z, 0), at(z, 1), at(z, 2)]]));
    }
    let probes = (0..m.rays)
        .map(|_| {
            let o = m.target(&mesh);
            let corners = mesh.corners(light as usize);
            let (u, v) = (m.random.unit() * 0.5, m.random.unit() * 0.5);
            let target = std::array::from_fn(|i| {
                let [a, b, c] = corners.map(|p| f64::from(p[i]));
                (a + u * (b - a) + v * (c - a)) as f32
            });
            let ray = OracleRay { tmax: 1.0, ..ray(o, toward(o, target)) };
            Probe { skip: [light, m.random.pick(&[u32::MAX, 0])], ..Probe::closest(ray) }
        })
        .collect();
    Case { mesh, probes, ..Case::default() }
}

fn on_light(m: &mut Maker<'_>) -> Case {
    let mesh = m.any_mesh();
    m.case(mesh, |m, mesh| {
        let corners = mesh.corners(m.random.below(mesh.faces.len()));
        // From a corner, a point of an edge, or a point of the plane, along the plane or away from it.
        let o = if m.random.chance(0.5) { corners[0] } else { m.edge_point(mesh) };
        let target = if m.random.chance(0.5) { corners[1] } else { m.target(mesh) };
        OracleRay { tmin: m.random.pick(&[0.0, -1.0]), tmax: 1.0, ..ray(o, toward(o, target)) }
    })
}

fn shells(m: &mut Maker<'_>) -> Case {
    let levels = ((m.size as f64 / 16.0).max(1.0).log2() / 2.0).ceil() as u32;
    let outer = mesh::sphere(levels, 0.0, &mut m.random);
    let mut mesh = outer.clone();
    mesh.append(&outer.placed(1.0 - 4e-5, [0.0; 3]));
    let mesh = m.place(mesh);
    leaving_case(m, mesh, |m, n| {
        let w = m.random.direction();
        [0, 1, 2].map(|i| n[i] * m.random.pick(&[1.0, -1.0]) + w[i])
    })
}

fn mirror_box(m: &mut Maker<'_>) -> Case {
    let (s, c) = (0.6f32, 0.8f32);
    let mut mesh = mesh::cube();
    if m.random.chance(0.5) {
        mesh.points.iter_mut().for_each(|p| *p = [c * p[0] - s * p[1], s * p[0] + c * p[1], p[2]]);
    }
    // An offset of 1e6 leaves nothing of a box of 1e-6.
    let (scale, offset) = m.random.pick(&[(1.0, 0.0), (1e-6, 0.0), (1e6, 0.0), (1.0, 1e6), (1e6, 1e6), (1e-6, 1.0)]);
    let mesh = mesh.placed(scale, [offset, 0.0, 0.0]);
    leaving_case(m, mesh, |m, _| m.random.direction())
}

fn mirror_room(m: &mut Maker<'_>) -> Case {
    let inner = m.closed_mesh();
    let (center, radius) = inner.ball();
    let mut mesh = mesh::cube();
    mesh.points.iter_mut().for_each(|p| {
        *p = std::array::from_fn(|i| (center[i] + 2.0 * radius * f64::from(p[i])).clamp(-3e38, 3e38) as f32);
    });
    mesh.append(&inner);
    leaving_case(m, mesh, |m, _| m.random.direction())
}

fn either_side(m: &mut Maker<'_>) -> Case {
    let mesh = m.closed_mesh();
    leaving_case(m, mesh, |m, n| {
        let side = m.random.pick(&[1.0, -1.0]);
        n.map(|x| side * x + 1e-3 * m.random.signed())
    })
}
