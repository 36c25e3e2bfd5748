//! Families 33 to 39: shape and scale of triangles.

use super::{Case, Family, Maker, mesh, ray, toward};
use crate::families::mesh::Mesh;

pub const FAMILIES: &[Family] = &[
    Family { number: 33, name: "zero-area triangles inside a closed mesh", make: zero_area },
    Family { number: 34, name: "needles, caps, slivers", make: needles },
    Family { number: 35, name: "coplanar rays", make: coplanar },
    Family { number: 36, name: "n.d one unit from zero", make: nearly_coplanar },
    Family { number: 37, name: "offsets and scales at the ends of f32", make: extreme },
    Family { number: 38, name: "parallel sheets 1, 2, 3 ulp apart", make: sheets },
    Family { number: 39, name: "coincident triangles, opposite winding", make: coincident },
];

fn zero_area(m: &mut Maker<'_>) -> Case {
    let mut mesh = m.closed_mesh();
    for _ in 0..mesh.faces.len().min(200) {
        let f = mesh.faces[m.random.below(mesh.faces.len())];
        let at = m.random.below(mesh.faces.len() + 1);
        let flat = if m.random.chance(0.5) { [f[0], f[0], f[1]] } else { [f[2], f[1], f[2]] };
        mesh.faces.insert(at, flat);
    }
    let mut case = m.case(mesh, |m, mesh| {
        let o = m.outside(mesh);
        ray(o, toward(o, m.target(mesh)))
    });
    for (k, probe) in case.probes.iter_mut().enumerate() {
        if k % 4 == 0 {
            probe.ask = super::Ask::All;
        }
    }
    case.closed = true;
    case
}

fn needles(m: &mut Maker<'_>) -> Case {
    let made = mesh::slivers(m.size.clamp(3, 3000), &mut m.random);
    let mesh = m.place(made);
    m.case(mesh, |m, mesh| {
        let target = m.target(mesh);
        let (_, radius) = m.ball(mesh);
        let o = if m.random.chance(0.5) {
            m.origin(mesh)
        } else {
            // From within the plane of some needle, half a degree up.
            let [a, b, c] = mesh.corners(m.random.below(mesh.faces.len())).map(|p| p.map(f64::from));
            std::array::from_fn(|i| {
                (a[i] + 2.0 * (b[i] - a[i]) + (c[i] - a[i]) + 0.0087 * radius * m.random.signed()) as f32
            })
        };
        ray(o, toward(o, target))
    })
}

fn coplanar(m: &mut Maker<'_>) -> Case {
    let n = ((m.size as f64 / 2.0).sqrt().ceil() as usize).clamp(1, 100);
    let mesh = mesh::field(n, 0.0, &mut m.random);
    m.case(mesh, |m, mesh| {
        let inside = m.random.chance(0.5);
        let far = if inside { 0.9 } else { 3.0 };
        let mut o = [0; 3].map(|_| (far * m.random.signed()) as f32);
        o[2] = 0.0;
        if m.random.chance(0.3) {
            o = m.edge_point(mesh);
        }
        let mut d = toward(o, m.target(mesh));
        d[2] = m.random.pick(&[0.0, -0.0, 0.0, 1e-30]);
        ray(o, d)
    })
}

fn nearly_coplanar(m: &mut Maker<'_>) -> Case {
    let mesh = m.any_mesh();
    m.case(mesh, |m, mesh| {
        let [a, b, c] = mesh.corners(m.random.below(mesh.faces.len())).map(|p| p.map(f64::from));
        let (s, t, u, v) = (3.0 * m.random.signed(), 3.0 * m.random.signed(), m.random.unit(), m.random.unit());
        let o = std::array::from_fn(|i| (a[i] + s * (b[i] - a[i]) + t * (c[i] - a[i])) as f32);
        let target: [f32; 3] = std::array::from_fn(|i| (a[i] + u * (b[i] - a[i]) + v * (c[i] - a[i])) as f32);
        let mut d = toward(o, target);
        let axis = m.random.below(3);
        d[axis] = m.random.pick(&[d[axis].next_down(), d[axis], d[axis].next_up()]);
        ray(o, d)
    })
}

fn extreme(m: &mut Maker<'_>) -> Case {
    let levels = ((m.size as f64 / 8.0).max(1.0).log2() / 2.0).ceil().min(5.0) as u32;
    let scale = m.random.pick(&[1e-38f32, 1e-35, 1e-25, 1e-18, 1e12, 1e18, 1e25, 1e37]);
    let offset = m.random.pick(&[0.0f32, 1e3, 1e6]);
    let mut mesh = mesh::sphere(levels, 0.1, &mut m.random);
    if m.random.chance(0.2) {
        mesh = mesh.placed(1e25, [m.random.pick(&[1e30, -1e30]); 3]);
    } else {
        mesh = mesh.placed(scale, [(offset * scale).min(1e38), 0.0, 0.0]);
    }
    m.case(mesh, |m, mesh| {
        let o = m.origin(mesh);
        ray(o, toward(o, m.target(mesh)))
    })
}

fn sheets(m: &mut Maker<'_>) -> Case {
    let n = ((m.size as f64 / 8.0).sqrt().ceil() as usize).max(1);
    let base = m.random.pick(&[0.5f32, 1.0, 0.3, 1e5]);
    let up = |x: f32, by: u32| f32::from_bits(x.to_bits() + by);
    let mut order: Vec<u32> = vec![0, 1, 2, 3];
    order.rotate_left(m.random.below(4));
    if m.random.chance(0.5) {
        order.reverse();
    }
    let mut mesh = Mesh::default();
    for by in order {
        let mut sheet = mesh::field(n, 0.0, &mut m.random);
        sheet.points.iter_mut().for_each(|p| p[2] = up(base, by));
        mesh.append(&sheet);
    }
    m.case(mesh, |m, mesh| {
        let side = m.random.pick(&[1.0f32, -1.0]);
        let slant = m.random.pick(&[1.0, 100.0]);
        let o = [slant * m.random.signed() as f32, slant * m.random.signed() as f32, base + side * (1.0 + base.abs())];
        ray(o, toward(o, m.target(mesh)))
    })
}

fn coincident(m: &mut Maker<'_>) -> Case {
    let mut mesh = m.any_mesh();
    let n = mesh.faces.len();
    for i in 0..n.min(2000) {
        let f = mesh.faces[i];
        mesh.faces.push([f[2], f[1], f[0]]);
    }
    m.case(mesh, |m, mesh| {
        let o = m.origin(mesh);
        ray(o, toward(o, m.target(mesh)))
    })
}
