//! Families 15 to 23: planes of the octree.

use super::{Case, Family, Maker, mesh, ray, toward};
use crate::families::mesh::Mesh;
use crate::oracle::OracleRay;

pub const FAMILIES: &[Family] = &[
    Family { number: 15, name: "ray and triangle in a split plane", make: in_split_plane },
    Family { number: 16, name: "origin at corners, centre, faces of cells", make: special_origins },
    Family { number: 17, name: "grazing an edge or corner of the root", make: grazing },
    Family { number: 18, name: "hit on a cell's face, edge, corner, an ulp beside", make: on_cell_border },
    Family { number: 19, name: "a vertex on the root's upper face", make: upper_face },
    Family { number: 20, name: "origin 1 to 10^7 root sizes away", make: far_origin },
    Family { number: 21, name: "the same segment backwards", make: backwards },
    Family { number: 22, name: "root behind the origin, tmax inside the root", make: behind },
    Family { number: 23, name: "root at 1e6, origin near 0", make: root_far },
];

/// A mesh over exactly 0..1 on each axis whose vertices are dyadic, with many triangles in the planes x, y, z = k/8.
fn dyadic(m: &mut Maker<'_>) -> Mesh {
    let mut mesh = mesh::cube().placed(0.5, [0.5; 3]);
    for _ in 0..m.size.clamp(8, 600) {
        let axis = m.random.below(3);
        let plane = m.random.below(9) as f32 / 8.0;
        let corners: [[f32; 3]; 3] = std::array::from_fn(|_| {
            let mut p = [0; 3].map(|_| m.random.below(33) as f32 / 32.0);
            p[axis] = plane;
            p
        });
        mesh.append(&Mesh::soup([corners]));
    }
    mesh
}

fn dyadic_point(m: &mut Maker<'_>, steps: usize) -> [f32; 3] {
    [0; 3].map(|_| m.random.below(steps + 1) as f32 / steps as f32)
}

/// A corner of the root (whose side is 2) or of its octants.
fn root_point(m: &mut Maker<'_>) -> [f32; 3] {
    [0; 3].map(|_| m.random.below(3) as f32)
}

fn in_split_plane(m: &mut Maker<'_>) -> Case {
    let mesh = dyadic(m);
    m.case(mesh, |m, _| {
        let axis = m.random.below(3);
        let mut o = [0; 3].map(|_| (3.0 * m.random.unit() - 1.0) as f32);
        o[axis] = m.random.below(9) as f32 / 8.0;
        let mut d = m.random.direction().map(|x| x as f32);
        d[axis] = m.random.pick(&[0.0, -0.0]);
        ray(o, d)
    })
}

fn special_origins(m: &mut Maker<'_>) -> Case {
    let mesh = dyadic(m);
    m.case(mesh, |m, _| {
        let axis = m.random.below(3);
        let o = match m.random.below(6) {
            // The mesh's centre; the root's, whose side is 2 since its upper face stays free; corners of nodes.
            0 => [0.5; 3],
            1 => [1.0; 3],
            2 => root_point(m),
            3 => dyadic_point(m, 8),
            // On a face of the root or of the mesh, and anywhere within a leaf.
            4 => {
                let mut o = dyadic_point(m, 64);
                o[axis] = m.random.below(3) as f32;
                o
            }
            _ => [0; 3].map(|_| m.random.unit() as f32),
        };
        // Any way: in and out, along a face, toward a corner.
        let d = match m.random.below(4) {
            0 => [0; 3].map(|_| m.random.pick(&[0.0, 1.0, -1.0])),
            1 => toward(o, dyadic_point(m, 8)),
            2 => {
                let mut d = m.random.direction().map(|x| x as f32);
                d[axis] = m.random.pick(&[0.0, -0.0]);
                d
            }
            _ => m.random.direction().map(|x| x as f32),
        };
        ray(o, d)
    })
}

fn grazing(m: &mut Maker<'_>) -> Case {
    let mesh = dyadic(m);
    m.case(mesh, |m, _| {
        // A corner of the mesh's box, or of the root beyond it.
        let mut corner = if m.random.chance(0.5) { dyadic_point(m, 1) } else { root_point(m) };
        if m.random.chance(0.5) {
            corner[m.random.below(3)] = m.random.unit() as f32;
        }
        let nudge = |m: &mut Maker<'_>, x: f32| m.random.pick(&[x.next_down(), x, x.next_up()]);
        let target = corner.map(|x| nudge(m, x));
        let o = std::array::from_fn(|i| (f64::from(corner[i]) + 2.0 * m.random.signed()) as f32);
        ray(o, toward(o, target))
    })
}

fn on_cell_border(m: &mut Maker<'_>) -> Case {
    let mesh = dyadic(m);
    m.case(mesh, |m, _| {
        let target = dyadic_point(m, 16).map(|x| m.random.pick(&[x.next_down(), x, x, x.next_up()]));
        let mut o = [0; 3].map(|_| (3.0 * m.random.unit() - 1.0) as f32);
        if m.random.chance(0.3) {
            let axis = m.random.below(3);
            o[axis] = target[axis];
        }
        ray(o, toward(o, target))
    })
}

fn upper_face(m: &mut Maker<'_>) -> Case {
    let levels = ((m.size as f64 / 8.0).max(1.0).log2() / 2.0).ceil() as u32;
    let mut mesh = mesh::sphere(levels, 0.1, &mut m.random);
    // The box becomes 0 to a whole number of 2^-8 parts of the root; the builder leaves the last of them free, so that 255 is its
    // upper face.
    let (low, high) = mesh.bounds();
    let scale = 2f64.powi(m.random.pick(&[0, 0, 20, -20, 90, -90]));
    let most = scale * m.random.pick(&[255.0 / 256.0, 1.0, 0.5]);
    for p in &mut mesh.points {
        *p = std::array::from_fn(|i| ((f64::from(p[i]) - low[i]) / (high[i] - low[i]) * most) as f32);
    }
    let top = [most as f32; 3];
    let n = mesh.points.len() as u32;
    mesh.points.extend([top, [top[0], mesh.points[0][1], mesh.points[0][2]], mesh.points[0]]);
    mesh.faces.push([n, n + 1, n + 2]);
    m.case(mesh, |m, mesh| {
        let o = m.origin(mesh);
        let mut target = m.next_corner(mesh);
        let axis = m.random.below(3);
        target[axis] = top[axis];
        ray(o, toward(o, if m.random.chance(0.5) { top } else { target }))
    })
}

fn far_origin(m: &mut Maker<'_>) -> Case {
    let mesh = m.any_mesh();
    m.case(mesh, |m, mesh| {
        let (center, radius) = m.ball(mesh);
        let far = 2.0 * radius * m.random.pick(&[1.0, 1e2, 1e4, 1e7]);
        let d = m.random.direction();
        let o = std::array::from_fn(|i| (center[i] + far * d[i]).clamp(-3e38, 3e38) as f32);
        ray(o, toward(o, m.target(mesh)))
    })
}

fn backwards(m: &mut Maker<'_>) -> Case {
    let mesh = m.any_mesh();
    m.case(mesh, |m, mesh| {
        let (a, b) = (m.origin(mesh), m.target(mesh));
        // The far end of a segment through the target, then either way along it.
        let beyond: [f32; 3] = std::array::from_fn(|i| b[i] + (b[i] - a[i]));
        let (from, to) = if m.random.chance(0.5) { (a, beyond) } else { (beyond, a) };
        OracleRay { o: from, d: toward(from, to), tmin: 0.0, tmax: 1.0 }
    })
}

fn behind(m: &mut Maker<'_>) -> Case {
    let mesh = m.any_mesh();
    m.case(mesh, |m, mesh| {
        let o = m.outside(mesh);
        let to = toward(o, m.target(mesh));
        match m.random.below(3) {
            0 => ray(o, to.map(|x| -x)),
            1 => OracleRay { tmin: f32::NEG_INFINITY, tmax: 0.0, ..ray(o, to.map(|x| -x)) },
            _ => OracleRay { tmax: (0.5 + m.random.unit()) as f32, ..ray(o, to) },
        }
    })
}

fn root_far(m: &mut Maker<'_>) -> Case {
    let levels = ((m.size as f64 / 8.0).max(1.0).log2() / 2.0).ceil() as u32;
    let offset = [0; 3].map(|_| m.random.pick(&[1e6, -1e6, 0.0]) as f32);
    let mesh = mesh::sphere(levels, 0.2, &mut m.random).placed(10.0, offset);
    m.case(mesh, |m, mesh| {
        let near_zero = m.random.chance(0.9);
        let o = if near_zero { [0; 3].map(|_| m.random.signed() as f32) } else { m.origin(mesh) };
        ray(o, toward(o, m.target(mesh)))
    })
}
