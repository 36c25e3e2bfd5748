//! The reference: every triangle of a file tested exactly against every ray, with no tree and no filter.

use super::boxes::{Stored, triangles_in_box};
use super::collect::{Any, Closest, Collector, Next, Place};
use super::{Counters, Found, Tracer};
use crate::error::Result;
use crate::exact::Line;
use crate::format::PageId;
use crate::geometry::{Aabb, FaceId, Ray, Skip};
use crate::map::Octree;

/// Answers rays by testing all triangles, each once; holds them in memory (48 bytes each).
pub struct LinearTracer {
    triangles: Vec<Stored>,
    bounds: Aabb,
}

impl LinearTracer {
    /// Reads all triangles of a file. Errors: a damaged page.
    pub fn new(octree: &Octree) -> Result<LinearTracer> {
        let mut triangles = Vec::new();
        triangles_in_box(octree, None, &mut |stored| {
            triangles.push(stored);
            Ok(())
        })?;
        Ok(LinearTracer { triangles, bounds: octree.bounds() })
    }

    /// The triangles, each once.
    pub fn triangles(&self) -> &[Stored] {
        &self.triangles
    }

    /// Offers the hits of all triangles until the collector has enough.
    fn test<'a>(&self, line: &Line, collector: &mut impl Collector<'a>, counters: &mut Counters) {
        for stored in &self.triangles {
            counters.triangles += 1;
            let decision = line.meet(&stored.triangle);
            counters.exact += u64::from(decision.exact);
            let Some(crossing) = decision.crossing else { continue };
            if collector.offer(line, crossing, stored) == Next::Done {
                return;
            }
        }
    }
}

impl Tracer for LinearTracer {
    fn closest_counted(&self, ray: &Ray, skip: Skip, counters: &mut Counters) -> Result<Option<Found>> {
        counters.rays += 1;
        if !ray.is_valid() {
            return Ok(None);
        }
        let (line, mut closest) = (Line::new(ray), Closest::new(skip));
        self.test(&line, &mut closest, counters);
        Ok(closest.found_exactly(ray))
    }

    fn any_counted(&self, ray: &Ray, skip: Skip, counters: &mut Counters) -> Result<bool> {
        counters.rays += 1;
        let mut any = Any::new(skip);
        if ray.is_valid() {
            self.test(&Line::new(ray), &mut any, counters);
        }
        Ok(any.found)
    }

    fn next(&self, ray: &Ray, skip: Skip, last: &Found) -> Result<Option<Found>> {
        if !ray.is_valid() {
            return Ok(None);
        }
        let line = Line::new(ray);
        let mut closest = Closest::new(skip);
        closest.begin_after(&line, last);
        self.test(&line, &mut closest, &mut Counters::default());
        Ok(closest.found_exactly(ray))
    }

    fn bounds(&self) -> Aabb {
        self.bounds
    }
}

impl Place for Stored {
    fn face(&self) -> FaceId {
        self.face
    }
    fn page(&self) -> PageId {
        self.page
    }
    fn reference(&self) -> u32 {
        self.reference
    }
}
