//! Families 49 to 53: regressions of others, and files in many pages.

use super::{Case, Family, Layout, Maker, aimed, mesh, ray, toward};
use crate::families::mesh::Mesh;

pub const FAMILIES: &[Family] = &[
    Family { number: 49, name: "grid rays on a mesh of 8-bit coordinates", make: eight_bits },
    Family { number: 50, name: "a flat box at 5.7e-39", make: flat_box },
    Family { number: 51, name: "nested cylinders and an unrelated mesh", make: cylinders },
    Family { number: 52, name: "many small pages", make: pages },
    Family { number: 53, name: "a triangle stored in several places", make: stored_twice },
];

fn eight_bits(m: &mut Maker<'_>) -> Case {
    let levels = ((m.size as f64 / 8.0).max(1.0).log2() / 2.0).ceil() as u32;
    let mut mesh = mesh::sphere(levels, 0.05, &mut m.random);
    mesh.points.iter_mut().for_each(|p| *p = p.map(|x| (x * 100.0 + 128.0).round()));
    m.case(mesh, |m, _| {
        let (x, y) = (m.random.below(513) as f32 / 2.0, m.random.below(513) as f32 / 2.0);
        let axis = m.random.below(3);
        let mut o = [0.0; 3];
        (o[(axis + 1) % 3], o[(axis + 2) % 3]) = (x, y);
        o[axis] = -10.0;
        let mut d = [0.0; 3];
        d[axis] = 1.0;
        ray(o, d)
    })
}

fn flat_box(m: &mut Maker<'_>) -> Case {
    let mut mesh = mesh::cube();
    mesh.points.iter_mut().for_each(|p| *p = [p[0], p[1], p[2] * 5.7e-39]);
    let case = |m: &mut Maker<'_>, mesh: &Mesh| {
        let o = if m.random.chance(0.5) {
            m.outside(mesh)
        } else {
            [m.random.signed() as f32, m.random.signed() as f32, 1.0]
        };
        ray(o, toward(o, m.target(mesh)))
    };
    m.case(mesh, case)
}

fn cylinders(m: &mut Maker<'_>) -> Case {
    let n = (m.size / 6).clamp(3, 2000);
    let mut mesh = Mesh::default();
    for radius in [1.0, 0.999, 0.5] {
        let points = (0..2 * n)
            .map(|k| {
                let phi = std::f64::consts::TAU * (k / 2) as f64 / n as f64;
                [(radius * phi.cos()) as f32, (radius * phi.sin()) as f32, (k % 2) as f32 * 2.0 - 1.0]
            })
            .collect();
        let v = |k: usize| (k % (2 * n)) as u32;
        let faces =
            (0..n).flat_map(|k| [[v(2 * k), v(2 * k + 2), v(2 * k + 1)], [v(2 * k + 1), v(2 * k + 2), v(2 * k + 3)]]);
        mesh.append(&Mesh::new(points, faces.collect()));
    }
    if m.random.chance(0.5) {
        mesh.append(&mesh::cube().placed(0.25, [50.0, -20.0, 7.0]));
    }
    m.case(mesh, |m, mesh| {
        let o = [3.0 * m.random.signed() as f32, 3.0 * m.random.signed() as f32, m.random.signed() as f32];
        ray(o, toward(o, m.target(mesh)))
    })
}

fn pages(m: &mut Maker<'_>) -> Case {
    let mesh = m.any_mesh();
    let mut case = m.case(mesh, aimed);
    case.layout = Layout { brick: Some(m.random.pick(&[16, 100])), ..Layout::default() };
    case
}

fn stored_twice(m: &mut Maker<'_>) -> Case {
    let n = ((m.size as f64 / 2.0).sqrt().ceil() as usize).max(1);
    let mut mesh = mesh::field(n, 0.3, &mut m.random);
    mesh.append(&mesh::soup(20, 1.0, &mut m.random));
    let mesh = m.place(mesh);
    let mut case = m.case(mesh, aimed);
    case.probes.iter_mut().for_each(|p| p.ask = super::Ask::All);
    case.layout = Layout { brick: Some(32), ..Layout::default() };
    case
}
