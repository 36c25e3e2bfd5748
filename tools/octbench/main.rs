//! octbench: accuracy, speed and their trade.
#![allow(dead_code)]
mod families;
mod oracle;
mod random;

fn main() {
    for f in families::all() {
        for round in 0..20 {
            let mut m = families::Maker {
                random: random::Random::new(f.number as u64 * 1000 + round as u64),
                rays: 50,
                size: [12, 100, 1000][round % 3],
                round,
            };
            let case = (f.make)(&mut m);
            let oracle = oracle::Oracle::new(case.mesh.triangles().enumerate().map(|(i, c)| (i as u32, c)));
            let mut counts = Default::default();
            let hits = case.probes.iter().filter(|p| oracle.closest(&p.ray, &p.skip, &mut counts).is_some()).count();
            if round < 2 {
                println!(
                    "{:3} {:50} tris {:6} rays {} hits {} {:?}",
                    f.number,
                    f.name,
                    oracle.len(),
                    case.probes.len(),
                    hits,
                    counts
                );
            }
        }
    }
}
