//! Families 24 to 32: what the builder must survive.

use super::{Case, Family, Layout, Maker, Probe, aimed, mesh, ray, toward};
use crate::families::mesh::Mesh;

pub const FAMILIES: &[Family] = &[
    Family { number: 24, name: "identical triangles, lowest id wins", make: identical },
    Family { number: 25, name: "triangles sharing one vertex", make: one_vertex },
    Family { number: 26, name: "flat, in a line, one point, one triangle", make: flat },
    Family { number: 27, name: "a teapot in a stadium", make: teapot },
    Family { number: 28, name: "one triangle through many leaves", make: giant },
    Family { number: 29, name: "box overlaps a cell, plane an ulp off", make: plane_misses_cell },
    Family { number: 30, name: "found in one leaf, behind a hit in another", make: nearer_elsewhere },
    Family { number: 31, name: "every leaf, cell, depth, split, brick", make: every_layout },
    Family { number: 32, name: "coordinates NaN, infinite, huge, denormal", make: odd_coordinates },
];

fn identical(m: &mut Maker<'_>) -> Case {
    let one: [[f32; 3]; 3] = [0; 3].map(|_| [0; 3].map(|_| m.random.signed() as f32));
    // 2 * capacity + 1 for leaves of 1, 2, 8, 16 and cells of 64.
    let copies = m.random.pick(&[3, 5, 17, 33, 129]);
    let mut mesh = Mesh::soup(vec![one; copies]);
    let around = mesh::soup(m.size.clamp(2, 5000), 0.1, &mut m.random);
    if m.random.chance(0.5) {
        mesh.append(&around);
    }
    let mesh = m.place(mesh);
    m.case(mesh, |m, mesh| {
        let o = m.origin(mesh);
        let k = m.random.below(copies * 3);
        ray(o, toward(o, if m.random.chance(0.3) { mesh.points[k] } else { m.face_point(mesh) }))
    })
}

fn one_vertex(m: &mut Maker<'_>) -> Case {
    let hub = [0.1f32, 0.3, 0.7];
    let n = m.size;
    let mesh = Mesh::soup((0..n).map(|_| {
        let tip = |m: &mut Maker| std::array::from_fn(|i| hub[i] + m.random.direction()[i] as f32);
        [hub, tip(m), tip(m)]
    }));
    let mesh = m.place(mesh);
    m.case(mesh, |m, mesh| {
        let o = m.origin(mesh);
        ray(o, toward(o, if m.random.chance(0.5) { mesh.points[0] } else { m.target(mesh) }))
    })
}

fn flat(m: &mut Maker<'_>) -> Case {
    let n = ((m.size as f64 / 2.0).sqrt().ceil() as usize).max(1);
    let z = m.random.pick(&[0.0, 0.5, 0.1, 1e6]);
    // A mesh of which nothing can be hit is refused by the builder; so one real triangle is always there.
    let mesh = match m.random.below(4) {
        0 => mesh::field(n, 0.0, &mut m.random).placed(1.0, [0.0, 0.0, z]),
        1 => Mesh::soup([[[0.0, 0.0, z], [1.0, 0.0, z], [0.0, 1.0, z]]]),
        2 => {
            // All corners on a line: nothing but one real triangle is left.
            let at = |s: f64| [s as f32, (2.0 * s) as f32, z];
            let mut line = Mesh::soup((0..m.size.clamp(1, 200)).map(|_| [at(0.0), at(1.0), at(0.5)]));
            line.append(&Mesh::soup([[[0.0, 0.0, z], [1.0, 0.0, z], [0.0, 1.0, z]]]));
            line
        }
        _ => {
            let mut point = Mesh::soup(vec![[[0.25, 0.25, z]; 3]; 5]);
            point.append(&Mesh::soup([[[0.0, 0.0, z], [1.0, 0.0, z], [0.0, 1.0, z]]]));
            point
        }
    };
    m.case(mesh, |m, mesh| {
        let mut o = m.origin(mesh);
        if m.random.chance(0.2) {
            o[2] = z;
        }
        ray(o, toward(o, m.target(mesh)))
    })
}

fn teapot(m: &mut Maker<'_>) -> Case {
    // The f32 filter, whose bound grows with the stadium, leaves all of the teapot to f64: a small one will do.
    let levels = ((m.size.min(600) as f64 / 8.0).max(1.0).log2() / 2.0).ceil() as u32;
    // Far from zero f32 leaves little of the teapot.
    let far = m.random.pick(&[0.0, 1.0, 30.0, 5e3]);
    let place = [0; 3].map(|_| (far * m.random.signed()) as f32);
    let mut mesh = mesh::sphere(levels, 0.1, &mut m.random).placed(1e-3, place);
    let small = mesh.faces.len();
    mesh.append(&mesh::cube().placed(1e4, [0.0; 3]));
    m.case(mesh, |m, mesh| {
        let scale = m.random.pick(&[1e-3, 1.0, 1e3]);
        let d = m.random.direction();
        let o = std::array::from_fn(|i| place[i] + (3.0 * scale * d[i]) as f32);
        let corners = mesh.corners(m.random.below(small));
        ray(o, toward(o, corners[m.random.below(3)]))
    })
}

fn giant(m: &mut Maker<'_>) -> Case {
    if m.size >= 10_000 && m.round % 10 == 1 {
        return many_leaves(m);
    }
    let mut mesh = mesh::soup(m.size.max(16), 0.01, &mut m.random);
    let far = [0; 3].map(|_| m.random.pick(&[1.0f32, -1.0]));
    let near = far.map(|x| -x);
    let thin = std::array::from_fn(|i| near[i] + 1e-3 * m.random.signed() as f32);
    mesh.append(&Mesh::soup([[near, far, thin], [[-2.0, -2.0, -1.9], [2.0, -1.7, 2.1], [-1.8, 2.2, 1.6]]]));
    let giants = mesh.points.len() - 6;
    let mesh = m.place(mesh);
    m.case(mesh, |m, mesh| {
        let o = m.origin(mesh);
        let corners = &mesh.points[giants + 3 * m.random.below(2)..][..3];
        let (u, v) = (m.random.unit() * 0.5, m.random.unit() * 0.5);
        let on = |i: usize| {
            let [a, b, c] = [corners[0][i], corners[1][i], corners[2][i]].map(f64::from);
            (a + u * (b - a) + v * (c - a)) as f32
        };
        let target = if m.random.chance(0.3) { m.target(mesh) } else { std::array::from_fn(on) };
        ray(o, toward(o, target))
    })
}

/// One triangle that 120,000 small ones, strewn over it, spread over more than 10^5 leaves of a strict octree.
fn many_leaves(m: &mut Maker<'_>) -> Case {
    let giant: [[f32; 3]; 3] = [[-1.0, -1.0, -0.9], [1.0, -0.8, 1.0], [-0.9, 1.1, 0.8]];
    let strewn = |m: &mut Maker<'_>| {
        let (u, v) = (m.random.unit(), m.random.unit());
        let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
        let at = |i: usize| {
            let [a, b, c] = giant.map(|p| f64::from(p[i]));
            a + u * (b - a) + v * (c - a)
        };
        let middle = [at(0), at(1), at(2)];
        [0; 3].map(|_| middle.map(|x| (x + 1e-4 * m.random.signed()) as f32))
    };
    let mut triangles = vec![giant];
    triangles.extend((0..120_000).map(|_| strewn(m)));
    let mut case = m.case(Mesh::soup(triangles), |m, mesh| {
        let o = m.origin(mesh);
        let target = if m.random.chance(0.5) { m.target(mesh) } else { strewn(m)[0] };
        ray(o, toward(o, target))
    });
    case.layout.strict = Some(2);
    case
}

fn plane_misses_cell(m: &mut Maker<'_>) -> Case {
    // Triangles that cut off the corner of a dyadic cell, or miss it by an ulp.
    let mut mesh = mesh::cube().placed(0.5, [0.5; 3]);
    for _ in 0..m.size.clamp(8, 5000) {
        let corner = [0; 3].map(|_| (1 + m.random.below(15)) as f32 / 16.0);
        let signs = [0; 3].map(|_| m.random.pick(&[1.0 / 32.0, -1.0 / 32.0]));
        let triangle: [[f32; 3]; 3] = std::array::from_fn(|k| {
            let mut p = corner;
            p[k] += signs[k];
            p[(k + 1) % 3] -= signs[(k + 1) % 3];
            p.map(|x| m.random.pick(&[x.next_down(), x, x.next_up()]))
        });
        mesh.append(&Mesh::soup([triangle]));
    }
    m.case(mesh, |m, mesh| {
        let o = m.origin(mesh);
        let target =
            if m.random.chance(0.5) { [0; 3].map(|_| (1 + m.random.below(15)) as f32 / 16.0) } else { m.target(mesh) };
        ray(o, toward(o, target))
    })
}

fn nearer_elsewhere(m: &mut Maker<'_>) -> Case {
    // Long parallel blades, so that a leaf met first holds triangles whose hits lie far behind.
    let mesh = Mesh::soup((0..m.size.clamp(8, 5000)).map(|_| {
        let (y, z) = (m.random.signed() as f32, m.random.signed() as f32);
        let slant = 0.3 * m.random.signed() as f32;
        [[-1.0, y, z], [1.0, y + slant, z + slant], [1.0, y + slant + 0.05, z + slant]]
    }));
    let mesh = m.place(mesh);
    m.case(mesh, aimed)
}

fn every_layout(m: &mut Maker<'_>) -> Case {
    let mesh = m.any_mesh();
    let mut case = m.case(mesh, aimed);
    // Pages of one triangle are for small meshes: each is a file of its own to the builder.
    let least = if m.size < 500 { 1 } else { 64 };
    case.layout = Layout { brick: Some(m.random.pick(&[least, 7.max(least), 64, 4096])), ways: 3, ..Layout::default() };
    case
}

fn odd_coordinates(m: &mut Maker<'_>) -> Case {
    let largest = m.random.pick(&[f32::MAX, 1e37, 1e-38, 1e-42, f32::from_bits(3)]);
    let large = if m.size < 10_000 { 0.5 } else { 0.05 };
    let mut mesh = mesh::soup(m.size.max(4), large, &mut m.random);
    for p in &mut mesh.points {
        *p = p.map(|x| (x / 2.0).clamp(-1.0, 1.0) * largest);
    }
    let whole = mesh.clone();
    for _ in 0..3 {
        let k = m.random.below(mesh.points.len());
        mesh.points[k][m.random.below(3)] = m.random.pick(&[f32::NAN, f32::INFINITY, f32::NEG_INFINITY]);
    }
    let probes = (0..m.rays)
        .map(|_| {
            let o = m.origin(&whole).map(|x| x.clamp(-3e38, 3e38));
            let target = m.target(&whole);
            Probe::closest(ray(o, std::array::from_fn(|i| target[i] / 2.0 - o[i] / 2.0)))
        })
        .collect();
    Case { mesh, probes, ..Case::default() }
}
