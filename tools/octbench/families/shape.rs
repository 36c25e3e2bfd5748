//! Families 33 to 39: shape and scale of triangles.

use super::{Case, Family, Maker, aimed, mesh, ray, toward};
use crate::families::mesh::Mesh;
use crate::oracle::OracleRay;

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
    let made = mesh::slivers(m.size.max(3), &mut m.random);
    let mesh = m.place(made);
    m.case(mesh, |m, mesh| {
        let target = m.target(mesh);
        let (_, radius) = m.ball(mesh);
        if m.random.chance(0.3) {
            return half_a_degree(m, mesh);
        }
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

/// A ray that meets the plane of some triangle at half a degree, within the triangle.
fn half_a_degree(m: &mut Maker<'_>, mesh: &Mesh) -> OracleRay {
    let [a, b, c] = mesh.corners(m.random.below(mesh.faces.len())).map(|p| p.map(f64::from));
    let (e, f) = ([0, 1, 2].map(|i| b[i] - a[i]), [0, 1, 2].map(|i| c[i] - a[i]));
    let unit = |v: [f64; 3]| {
        let largest = v.iter().fold(f64::MIN_POSITIVE, |m, x| m.max(x.abs()));
        let v = v.map(|x| x / largest);
        let length = v.iter().map(|x| x * x).sum::<f64>().sqrt().max(1e-300);
        v.map(|x| x / length)
    };
    let (e1, f1) = (unit(e), unit(f));
    let n = unit([e1[1] * f1[2] - e1[2] * f1[1], e1[2] * f1[0] - e1[0] * f1[2], e1[0] * f1[1] - e1[1] * f1[0]]);
    let (s, t) = (m.random.signed(), m.random.signed());
    let along = unit([0, 1, 2].map(|i| s * e1[i] + t * f1[i]));
    let d = [0, 1, 2].map(|i| along[i] + n[i] * m.random.pick(&[1.0, -1.0]) * 0.5f64.to_radians().tan());
    let (u, v) = (0.5 * m.random.unit(), 0.5 * m.random.unit());
    let far = e.iter().chain(&f).fold(0.0f64, |m, x| m.max(x.abs())) * m.random.pick(&[0.5, 3.0, 30.0]);
    let o = [0, 1, 2].map(|i| (a[i] + u * e[i] + v * f[i] - far * d[i]) as f32);
    ray(o, d.map(|x| x as f32))
}

fn coplanar(m: &mut Maker<'_>) -> Case {
    let n = ((m.size as f64 / 2.0).sqrt().ceil() as usize).clamp(1, 100);
    if m.random.chance(0.3) {
        return coplanar_aslant(m);
    }
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

/// The same in the plane x + y + z = 0, in whole numbers, so that rays are coplanar exactly.
fn coplanar_aslant(m: &mut Maker<'_>) -> Case {
    let scale = 2f32.powi(m.random.pick(&[0, 0, -60, 60]));
    let point = |m: &mut Maker<'_>, far: f64| {
        let (x, y) = ((far * m.random.signed()).round() as f32, (far * m.random.signed()).round() as f32);
        [scale * x, scale * y, scale * -(x + y)]
    };
    let triangles: Vec<_> = (0..m.size.clamp(2, 200)).map(|_| [0; 3].map(|_| point(m, 1000.0))).collect();
    m.case(Mesh::soup(triangles), |m, mesh| {
        let from = m.random.pick(&[500.0, 5000.0]);
        let (o, to) = (point(m, from), point(m, 1000.0));
        let o = if m.random.chance(0.3) { m.vertex(mesh) } else { o };
        ray(o, toward(o, to))
    })
}

/// Whole numbers x, y with x a + y b = gcd(a, b).
fn bezout(a: i64, b: i64) -> (i64, i64, i64) {
    if b == 0 {
        return (a, 1, 0);
    }
    let (g, x, y) = bezout(b, a.rem_euclid(b));
    (g, y, x - a.div_euclid(b) * y)
}

/// Triangles and rays in whole numbers with n.d = 1 or -1 exactly: the least that is not zero.
fn one_unit_off(m: &mut Maker<'_>) -> Case {
    let scale = 2f32.powi(m.random.pick(&[0, 0, -60, 60]));
    let whole = |p: [i64; 3]| p.map(|x| scale * x as f32);
    let (mut triangles, mut aims) = (Vec::new(), Vec::new());
    while triangles.len() < m.size.clamp(2, 12_000) {
        let a = [0; 3].map(|_| m.random.below(2000) as i64 - 1000);
        let (e, f) =
            ([0; 3].map(|_| m.random.below(200) as i64 - 100), [0; 3].map(|_| m.random.below(200) as i64 - 100));
        let n = [e[1] * f[2] - e[2] * f[1], e[2] * f[0] - e[0] * f[2], e[0] * f[1] - e[1] * f[0]];
        // d = s with n.s = gcd(n) = 1, plus any steps along the plane.
        let (g, x, y) = bezout(n[0], n[1]);
        let (h, p, z) = bezout(g, n[2]);
        if h.abs() != 1 {
            continue;
        }
        triangles.push([a, [0, 1, 2].map(|i| a[i] + e[i]), [0, 1, 2].map(|i| a[i] + f[i])].map(whole));
        aims.push((a, e, f, [p * x, p * y, z]));
    }
    m.case(Mesh::soup(triangles), |m, _| {
        let (a, e, f, s) = aims[m.random.below(aims.len())];
        // s may be long; the steps that shorten it most keep it within 24 bits.
        let length = |v: &[i64; 3]| v.iter().map(|x| (x * x) as f64).sum::<f64>();
        let nearest = |v: [i64; 3], w: [i64; 3]| {
            let dot: i64 = (0..3).map(|i| v[i] * w[i]).sum();
            (dot as f64 / length(&w).max(1.0)).round() as i64
        };
        let mut d = s;
        for _ in 0..20 {
            for w in [e, f] {
                let k = nearest(d, w);
                d = [0, 1, 2].map(|i| d[i] - k * w[i]);
            }
        }
        let (k, l) = (m.random.below(5) as i64 - 2, m.random.below(5) as i64 - 2);
        let d = [0, 1, 2].map(|i| d[i] + k * e[i] + l * f[i]);
        let back = m.random.pick(&[0i64, 1, 3, 50]);
        let corner = m.random.pick(&[[0i64, 0, 0], e, f]);
        let o = [0, 1, 2].map(|i| a[i] + corner[i] - back * d[i]);
        // Toward a corner as it is, or from a point beside it.
        let mut o = whole(o);
        if m.random.chance(0.5) {
            let axis = m.random.below(3);
            o[axis] += scale * m.random.pick(&[1.0, -1.0, 0.25, -0.25]);
        }
        OracleRay { tmin: m.random.pick(&[0.0, f32::NEG_INFINITY]), ..ray(o, whole(d)) }
    })
}

fn nearly_coplanar(m: &mut Maker<'_>) -> Case {
    if m.model.is_none() && m.random.chance(0.5) {
        return one_unit_off(m);
    }
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
    m.case(mesh, aimed)
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
    m.case(mesh, aimed)
}
