//! Every family on samples in big rationals, the oracle's third tier.

use super::*;
use crate::oracle::{Oracle, TierCounts, closest_rational};

fn case(family: &Family, size: usize, rays: usize) -> Case {
    let random = Random::new(u64::from(family.number) << 32 | size as u64);
    (family.make)(&mut Maker::new(random, rays, size))
}

#[test]
fn the_oracle_agrees_with_rationals_on_every_family() {
    for family in all() {
        for (size, rays) in [(3, 30), (12, 10), (40, 4)] {
            let Case { mesh, probes, .. } = case(&family, size, rays);
            let triangles: Vec<_> = mesh.numbered().collect();
            let oracle = Oracle::new(triangles.iter().copied());
            for Probe { ray, skip, .. } in probes.iter().take((1200 / triangles.len()).max(2)) {
                let ours = oracle.closest(ray, skip, &mut TierCounts::default()).map(|a| (a.t, a.face));
                assert_eq!(ours, closest_rational(ray, &triangles, skip), "family {}: {ray:?}", family.number);
            }
        }
    }
}

#[test]
fn every_family_makes_the_rays_it_is_asked_for() {
    for family in all() {
        let Case { mesh, probes, .. } = case(&family, 60, 37);
        assert_eq!(probes.len(), 37, "family {}", family.number);
        assert!(!mesh.faces.is_empty());
    }
    let numbers: Vec<u32> = all().iter().map(|f| f.number).collect();
    assert_eq!(numbers, (1..=53).collect::<Vec<_>>());
}

/// The families whose description promises an exact incidence keep it.
#[test]
fn rays_through_grid_vertices_and_hubs_are_exact() {
    let through = |r: &OracleRay, p: [f32; 3]| {
        let (d, w) = (r.d.map(f64::from), [0, 1, 2].map(|i| f64::from(p[i]) - f64::from(r.o[i])));
        (0..3).all(|i| d[i] * w[(i + 1) % 3] == d[(i + 1) % 3] * w[i])
    };
    let third = all()[2];
    assert_eq!(third.number, 3);
    for size in [12, 60] {
        let Case { mesh, probes, .. } = case(&third, size, 100);
        assert!(probes.iter().all(|p| mesh.points.iter().any(|&v| through(&p.ray, v))));
    }
}
