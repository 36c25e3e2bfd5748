//! Families 10 to 14: directions.

use super::{Case, Family, Maker, aimed, mesh, ray, toward};

pub const FAMILIES: &[Family] = &[
    Family { number: 10, name: "zero components, both signs of zero", make: zeros },
    Family { number: 11, name: "tiny components", make: tiny },
    Family { number: 12, name: "direction lengths 1e-30 to 1e30", make: lengths },
    Family { number: 13, name: "diagonals through cell corners", make: diagonals },
    Family { number: 14, name: "rays that hit nothing by definition", make: invalid },
];

fn zeros(m: &mut Maker<'_>) -> Case {
    let mesh = m.any_mesh();
    m.case(mesh, |m, mesh| {
        let target = m.target(mesh);
        let mut o = m.origin(mesh);
        let count = 1 + m.random.below(2);
        let first = m.random.below(3);
        for k in 0..count {
            o[(first + k) % 3] = target[(first + k) % 3];
        }
        let mut d = toward(o, target);
        for x in &mut d {
            if *x == 0.0 {
                *x = m.random.pick(&[0.0, -0.0]);
            }
        }
        ray(o, d)
    })
}

fn tiny(m: &mut Maker<'_>) -> Case {
    let mesh = m.any_mesh();
    m.case(mesh, |m, mesh| {
        let target = m.target(mesh);
        let mut o = m.origin(mesh);
        let first = m.random.below(3);
        let count = 1 + m.random.below(2);
        for k in 0..count {
            o[(first + k) % 3] = target[(first + k) % 3];
        }
        let mut d = toward(o, target);
        for x in &mut d {
            if *x == 0.0 {
                let size = m.random.pick(&[1e-45f32, 1e-39, 1e-20, 1e-18, 1.19e-7]);
                let nudged = m.random.pick(&[size.next_down(), size, size.next_up()]);
                *x = m.random.pick(&[1.0, -1.0]) * nudged;
            }
        }
        ray(o, d)
    })
}

fn lengths(m: &mut Maker<'_>) -> Case {
    let mesh = m.any_mesh();
    m.case(mesh, |m, mesh| {
        let o = m.origin(mesh);
        let d = toward(o, m.target(mesh));
        let largest = d.iter().fold(0.0f32, |a, x| a.max(x.abs()));
        let exponent = m.random.below(200) as i32 - 100;
        // Powers of two keep the direction exactly; 1e±30 rounds it.
        let wanted = if m.random.chance(0.5) { 2f64.powi(exponent) } else { m.random.pick(&[1e-30, 1e30]) };
        let factor = wanted / f64::from(largest.max(f32::MIN_POSITIVE));
        let factor = if m.random.chance(0.5) { 2f64.powf(factor.log2().round()) } else { factor };
        ray(o, d.map(|x| (f64::from(x) * factor) as f32))
    })
}

fn diagonals(m: &mut Maker<'_>) -> Case {
    let levels = ((m.size as f64 / 8.0).max(1.0).log2() / 2.0).ceil() as u32;
    let mesh = mesh::sphere(levels, 0.1, &mut m.random).placed(0.5, [0.5; 3]);
    m.case(mesh, |m, _| {
        // Corners of dyadic cells; the ray passes corner after corner.
        let level = m.random.below(8) as i32;
        let steps = 1i32 << level;
        let corner = [0; 3].map(|_| m.random.below(2 * steps as usize + 1) as f32 / steps as f32 - 0.5);
        let d = [0; 3].map(|_| m.random.pick(&[1.0f32, -1.0]));
        let back = m.random.pick(&[0.0, 1.0, 2.0, 4.0]);
        ray(std::array::from_fn(|i| corner[i] - back * d[i]), d)
    })
}

fn invalid(m: &mut Maker<'_>) -> Case {
    let mesh = m.any_mesh();
    m.case(mesh, |m, mesh| {
        let mut r = aimed(m, mesh);
        let odd = m.random.pick(&[f32::NAN, f32::INFINITY, f32::NEG_INFINITY]);
        let axis = m.random.below(3);
        match m.random.below(6) {
            0 => r.o[axis] = odd,
            1 => r.d[axis] = odd,
            2 => r.d = [0; 3].map(|_| m.random.pick(&[0.0, -0.0])),
            3 => (r.tmin, r.tmax) = (1.0, 0.5),
            4 => r.tmin = f32::NAN,
            _ => r.tmax = f32::NAN,
        }
        r
    })
}
