//! A tracer for tests: every triangle, exactly; and the scenes of hard cases.

use std::cmp::Ordering;

use glam::Vec3;

use crate::error::Result;
use crate::exact::{Crossing, Line};
use crate::format::PageId;
use crate::geometry::{Aabb, FaceId, Hit, Ray, Skip, Triangle};
use crate::trace::{Counters, Found, Tracer};

/// Tests every triangle.
pub(super) struct Brute(pub Vec<Triangle>);

impl Brute {
    fn nearest(&self, ray: &Ray, skip: Skip) -> Option<Found> {
        if !ray.is_valid() {
            return None;
        }
        let line = Line::new(ray);
        let mut best: Option<(Crossing, Found)> = None;
        for (&triangle, i) in self.0.iter().zip(0u32..).filter(|x| !skip.has(FaceId(x.1))) {
            let Some(crossing) = line.meet(&triangle).crossing else { continue };
            let Some(t) = crossing.t_within(&line) else { continue };
            if best.as_ref().is_none_or(|(b, _)| crossing.cmp(b, &line) == Ordering::Less) {
                let [u, v] = crossing.uv(&line);
                let hit = Hit { t, face: FaceId(i), u, v };
                best = Some((crossing, Found { hit, triangle, page: PageId(0), reference: i }));
            }
        }
        best.map(|b| b.1)
    }
}

impl Tracer for Brute {
    fn closest_counted(&self, ray: &Ray, skip: Skip, _: &mut Counters) -> Result<Option<Found>> {
        Ok(self.nearest(ray, skip))
    }

    fn any_counted(&self, ray: &Ray, skip: Skip, _: &mut Counters) -> Result<bool> {
        Ok(self.nearest(ray, skip).is_some())
    }

    fn next(&self, ray: &Ray, skip: Skip, last: &Found) -> Result<Option<Found>> {
        let line = Line::new(ray);
        let found = |i: usize| Brute(vec![self.0[i]]).nearest(ray, Skip::NONE).map(|f| (f, FaceId(i as u32)));
        let mut all: Vec<(Found, FaceId)> = (0..self.0.len()).filter_map(found).filter(|x| !skip.has(x.1)).collect();
        let key = |f: &Found| line.accepted(&f.triangle).crossing.expect("a hit is a crossing");
        all.sort_by(|a, b| key(&a.0).cmp(&key(&b.0), &line).then(a.1.cmp(&b.1)));
        let at = all.iter().position(|x| x.1 == last.hit.face).map_or(0, |k| k + 1);
        let named =
            |&(found, face): &(Found, FaceId)| Found { hit: Hit { face, ..found.hit }, reference: face.0, ..found };
        Ok(all.get(at).map(named))
    }

    fn bounds(&self) -> Aabb {
        Aabb::around(self.0.iter().flat_map(|t| t.vertices()))
    }
}

/// The twelve triangles of a box, wound outward, its corners moved by `place`.
pub(super) fn cube(place: impl Fn(Vec3) -> Vec3) -> Vec<Triangle> {
    let corner = |i: usize| {
        let sign = |bit: usize| if i & bit > 0 { 1.0 } else { -1.0 };
        place(Vec3::new(sign(4), sign(2), sign(1)))
    };
    let quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]];
    let halves = quads.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]);
    halves.map(|[a, b, c]| Triangle { a: corner(a), b: corner(b), c: corner(c) }).collect()
}
