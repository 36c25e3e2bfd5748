//! Families 40 and 41: the interval of t, and all hits in order.

use super::{Case, Family, Maker, Probe, ray, toward};
use crate::oracle::{Oracle, OracleRay, TierCounts};

pub const FAMILIES: &[Family] = &[
    Family { number: 40, name: "tmin, tmax at the hit and its neighbours", make: borders },
    Family { number: 41, name: "all hits in order, each once", make: all_hits },
];

fn borders(m: &mut Maker<'_>) -> Case {
    // Needs the hits to aim the interval at: a few rays, each used with many intervals.
    m.size = m.size.min(2000);
    let mesh = m.any_mesh();
    let oracle = Oracle::new(mesh.triangles().enumerate().map(|(i, c)| (i as u32, c)));
    let mut probes = Vec::with_capacity(m.rays);
    while probes.len() < m.rays {
        let o = m.origin(&mesh);
        let r = ray(o, toward(o, m.target(&mesh)));
        let hits = oracle.all(&OracleRay { tmin: f32::NEG_INFINITY, ..r }, &[], &mut TierCounts::default());
        let t = if hits.is_empty() { 1.0 } else { hits[m.random.below(hits.len())].t };
        let intervals = [
            (t, t),
            (t.next_down(), t),
            (t, t.next_up()),
            (t.next_up(), f32::INFINITY),
            (0.0, t.next_down()),
            (f32::NEG_INFINITY, t),
            (-0.0, t),
            (t.next_up(), t.next_down()),
            (-1.0, f32::INFINITY),
            (0.0, 0.0),
            (f32::MIN, f32::MAX),
        ];
        for (tmin, tmax) in intervals.into_iter().take(m.rays - probes.len()) {
            probes.push(Probe::closest(OracleRay { tmin, tmax, ..r }));
        }
    }
    Case { mesh, probes, ..Case::default() }
}

fn all_hits(m: &mut Maker<'_>) -> Case {
    let mesh = m.any_mesh();
    let probes = (0..m.rays)
        .map(|_| {
            let o = m.origin(&mesh);
            let tmin = m.random.pick(&[0.0, f32::NEG_INFINITY]);
            Probe::all(OracleRay { tmin, ..ray(o, toward(o, m.target(&mesh))) })
        })
        .collect();
    Case { mesh, probes, ..Case::default() }
}
