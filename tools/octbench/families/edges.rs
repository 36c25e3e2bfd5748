//! Families 1 to 9: edges and vertices.

use super::{Case, Family, Maker, Probe, aimed, mesh, ray, toward};
use crate::families::mesh::Mesh;

pub const FAMILIES: &[Family] = &[
    Family { number: 1, name: "toward a vertex", make: vertex },
    Family { number: 2, name: "toward the middle of an edge", make: edge_middle },
    Family { number: 3, name: "exactly through a vertex", make: exactly_vertex },
    Family { number: 4, name: "axis-parallel through a vertex", make: axis_vertex },
    Family { number: 5, name: "shared diagonal of a quad", make: quad_diagonal },
    Family { number: 6, name: "hub of a fan", make: fan_hub },
    Family { number: 7, name: "silhouette from outside", make: silhouette },
    Family { number: 8, name: "T-junction", make: t_junction },
    Family { number: 9, name: "corners rotated, winding reversed", make: rotated },
];

fn vertex(m: &mut Maker<'_>) -> Case {
    let mesh = m.any_mesh();
    m.case(mesh, |m, mesh| {
        let o = m.origin(mesh);
        let v = m.next_corner(mesh);
        ray(o, toward(o, v))
    })
}

fn edge_middle(m: &mut Maker<'_>) -> Case {
    let mesh = m.any_mesh();
    m.case(mesh, |m, mesh| {
        let o = m.origin(mesh);
        let (a, b) = m.next_edge(mesh);
        // Halves first: the sum of two huge coordinates is no f32.
        ray(o, toward(o, std::array::from_fn(|i| a[i] / 2.0 + b[i] / 2.0)))
    })
}

/// A mesh whose coordinates are multiples of 2^-8.
fn on_grid(mut mesh: Mesh) -> Mesh {
    for p in &mut mesh.points {
        *p = p.map(|x| (x * 256.0).round() / 256.0);
    }
    mesh
}

fn exactly_vertex(m: &mut Maker<'_>) -> Case {
    let levels = ((m.size as f64 / 8.0).max(1.0).log2() / 2.0).ceil() as u32;
    let n = ((m.size as f64 / 2.0).sqrt().ceil() as usize).max(1);
    let mesh = on_grid(match m.random.below(3) {
        0 => mesh::field(n, 0.5, &mut m.random),
        1 => mesh::soup(m.size, 0.3, &mut m.random),
        _ => mesh::sphere(levels, 0.1, &mut m.random),
    });
    // Powers of two keep the grid.
    let scale = 2f32.powi(m.random.pick(&[0, 0, 8, -8, 60, -60, 90, -90]));
    let mesh = mesh.placed(scale, [0.0; 3]);
    m.case(mesh, |m, mesh| {
        let v = m.next_corner(mesh);
        let o = [0; 3].map(|_| scale * (m.random.signed() * 768.0).round() as f32 / 256.0);
        let s = m.random.pick(&[0.25, 0.5, 1.0, 2.0, -1.0]);
        let mut r = ray(o, toward(o, v).map(|x| s * x));
        r.tmin = f32::NEG_INFINITY;
        r
    })
}

fn axis_vertex(m: &mut Maker<'_>) -> Case {
    let mesh = m.any_mesh();
    m.case(mesh, |m, mesh| {
        let mut o = m.next_corner(mesh);
        let axis = m.random.below(3);
        o[axis] = m.outside(mesh)[axis];
        let mut d = [0.0; 3];
        d[axis] = m.random.pick(&[1.0, -1.0]);
        let mut r = ray(o, d);
        r.tmin = f32::NEG_INFINITY;
        r
    })
}

fn quad_diagonal(m: &mut Maker<'_>) -> Case {
    // Quads side by side, the middle one's diagonal through zero.
    let side = (((m.size as f64 / 2.0).sqrt() as usize) | 1).max(1);
    let at = |k: usize| 20.0 * k as f32 - 10.0 * side as f32;
    let points = (0..(side + 1) * (side + 1)).map(|k| [at(k % (side + 1)), at(k / (side + 1)), 0.0]).collect();
    let v = |x: usize, y: usize| (y * (side + 1) + x) as u32;
    let faces = (0..side * side).map(|k| (k % side, k / side));
    let faces = faces
        .flat_map(|(x, y)| [[v(x, y), v(x + 1, y), v(x + 1, y + 1)], [v(x, y), v(x + 1, y + 1), v(x, y + 1)]])
        .collect();
    m.case(Mesh::new(points, faces), |m, _| {
        let d = [0.304_584_47, 0.304_584_47, -0.902_472_5];
        let nudge = m.random.below(5) as i32 - 2;
        let x = f32::from_bits(f32::to_bits(d[0]).wrapping_add_signed(nudge));
        let z = if m.random.chance(0.5) { 10.0 } else { 1.0 + m.random.below(20) as f32 };
        // Another diagonal: both moved by whole quads.
        let far = 20.0 * (m.random.below(side) as f32 - (side / 2) as f32);
        let sign = m.random.pick(&[1.0, -1.0]);
        let [x, y] = if m.random.chance(0.5) { [d[0], d[1]] } else { [x, d[1]] };
        ray([far, far, z], [sign * x, sign * y, d[2]])
    })
}

fn fan_hub(m: &mut Maker<'_>) -> Case {
    let n = m.size.max(3);
    let hub = [0; 3].map(|_| m.random.signed() as f32);
    let made = mesh::fan(n, hub, &mut m.random);
    if m.random.chance(0.5) {
        // Through the hub up to the rounding of the direction.
        let fan = m.place(made);
        return m.case(fan, |m, mesh| {
            let o = m.origin(mesh);
            ray(o, toward(o, mesh.points[0]))
        });
    }
    // Exactly through the hub: hub and origins on a grid.
    let scale = 2f32.powi(m.random.pick(&[0, 10, -10, 90, -90]));
    let fan = on_grid(made).placed(scale, [0.0; 3]);
    m.case(fan, |m, mesh| {
        let o = [0; 3].map(|_| scale * (m.random.signed() * 768.0).round() as f32 / 256.0);
        let s = m.random.pick(&[0.25, 0.5, 1.0, 2.0]);
        ray(o, toward(o, mesh.points[0]).map(|x| s * x))
    })
}

fn silhouette(m: &mut Maker<'_>) -> Case {
    let mesh = m.closed_mesh();
    let edges = silhouette_edges(m, &mesh);
    let probes = (0..m.rays)
        .map(|k| {
            let (o, a, b) = edges[k % edges.len()];
            let s = m.random.pick(&[0.0, 0.5, 1.0, 0.3]);
            Probe::all(ray(o, toward(o, std::array::from_fn(|i| a[i] + s * (b[i] - a[i])))))
        })
        .collect();
    Case { mesh, probes, closed: true, ..Case::default() }
}

/// Edges between a face that looks at the origin and one that looks away, from a few origins.
fn silhouette_edges(m: &mut Maker<'_>, mesh: &Mesh) -> Vec<([f32; 3], [f32; 3], [f32; 3])> {
    let mut found = Vec::new();
    for _ in 0..4 {
        let o = m.outside(mesh);
        let mut sides = std::collections::HashMap::new();
        for (i, f) in mesh.faces.iter().enumerate() {
            let [a, b, c] = mesh.corners(i).map(|p| [0, 1, 2].map(|k| f64::from(p[k]) - f64::from(o[k])));
            let (e, g) = ([0, 1, 2].map(|k| b[k] - a[k]), [0, 1, 2].map(|k| c[k] - a[k]));
            let n = [e[1] * g[2] - e[2] * g[1], e[2] * g[0] - e[0] * g[2], e[0] * g[1] - e[1] * g[0]];
            let front = (0..3).map(|k| n[k] * a[k]).sum::<f64>() < 0.0;
            for k in 0..3 {
                let (p, q) = (f[k].min(f[(k + 1) % 3]), f[k].max(f[(k + 1) % 3]));
                if sides.insert((p, q), front).is_some_and(|other| other != front) {
                    found.push((o, mesh.points[p as usize], mesh.points[q as usize]));
                }
            }
        }
    }
    if found.is_empty() {
        found.push((m.outside(mesh), mesh.points[0], mesh.points[1]));
    }
    // Found in the order of faces, which is fixed; spread the rays over all of them.
    let step = found.len().div_ceil(m.rays.max(1)).max(1);
    found.into_iter().step_by(step).collect()
}

fn t_junction(m: &mut Maker<'_>) -> Case {
    let nudge = |x: f32, by: usize| [x.next_down(), x, x.next_up()][by];
    let mut mesh = Mesh::default();
    for k in 0..(m.size / 3).clamp(1, 500) {
        let base = [k as f32 * 3.0, m.random.signed() as f32, m.random.signed() as f32];
        let at = |x: f32, y: f32| [base[0] + x, base[1] + y, base[2]];
        let mut t = at(0.0, 0.0);
        t[1] = nudge(t[1], m.random.below(3));
        mesh.append(&Mesh::new(
            vec![at(-1.0, 0.0), at(1.0, 0.0), at(0.0, 1.0), t, at(0.0, -1.0)],
            vec![[0, 1, 2], [0, 4, 3], [3, 4, 1]],
        ));
    }
    let mesh = m.place(mesh);
    m.case(mesh, |m, mesh| {
        let junction = m.random.below(mesh.points.len() / 5) * 5;
        let mut target = mesh.points[junction + 3];
        if m.random.chance(0.5) {
            target[0] += (mesh.points[junction + 1][0] - target[0]) * m.random.unit() as f32;
        }
        let o = m.origin(mesh);
        ray(o, toward(o, target))
    })
}

fn rotated(m: &mut Maker<'_>) -> Case {
    let mut mesh = m.any_mesh();
    for f in &mut mesh.faces {
        f.rotate_left(m.random.below(3));
        if m.random.chance(0.5) {
            f.swap(0, 1);
        }
    }
    m.case(mesh, aimed)
}
