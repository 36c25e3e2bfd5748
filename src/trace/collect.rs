//! What becomes of the hits that a walk finds: the closest is kept, or the first one ends it, or the next after another is sought.

use std::cmp::Ordering;

use super::Found;
use crate::exact::{Crossing, Line};
use crate::format::PageId;
use crate::geometry::{FaceId, Hit, Skip};

/// Where a triangle is stored; its face id is looked up only when it counts.
pub(super) trait Place {
    fn face(&self) -> FaceId;
    fn page(&self) -> PageId;
    fn reference(&self) -> u32;
}

/// What to do after a hit was offered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Next {
    /// Go on as before.
    On,
    /// Go on; [`Collector::reach`] may have become less.
    Nearer,
    /// The answer is known.
    Done,
}

/// Takes the hits of a walk, in any order, the same triangle possibly several times.
pub(super) trait Collector {
    fn offer(&mut self, line: &Line, crossing: Crossing, place: &impl Place) -> Next;

    /// An upper bound of the t of any hit that still matters.
    fn reach(&self) -> f64;
}

/// Keeps the closest hit, after another if one is given.
pub(super) struct Closest {
    skip: Skip,
    after: Option<(Crossing, FaceId)>,
    best: Option<Best>,
}

#[derive(Clone, Copy)]
struct Best {
    crossing: Crossing,
    t: f32,
    face: FaceId,
    page: PageId,
    reference: u32,
}

impl Closest {
    /// The closest of all hits.
    pub fn new(skip: Skip) -> Closest {
        Closest { skip, after: None, best: None }
    }

    /// The closest of those after `last`, a hit of the same line.
    pub fn after(skip: Skip, line: &Line, last: &Found) -> Closest {
        let after = line.accepted(&last.triangle).crossing.map(|crossing| (crossing, last.hit.face));
        Closest { skip, after, best: None }
    }

    /// The answer.
    #[inline]
    pub fn found(&self, line: &Line) -> Option<Found> {
        let Best { crossing, page, reference, .. } = self.best.as_ref()?;
        Some(Found { hit: self.hit(line), triangle: crossing.triangle, page: *page, reference: *reference })
    }

    /// The answer without where it is stored.
    #[inline]
    pub fn hit(&self, line: &Line) -> Hit {
        self.best.as_ref().map_or(Hit::MISS, |best| {
            let [u, v] = best.crossing.uv(line);
            Hit { t: best.t, face: best.face, u, v }
        })
    }
}

/// Order by (exact t, face id).
fn order(line: &Line, a: (&Crossing, FaceId), b: (&Crossing, FaceId)) -> Ordering {
    a.0.cmp(b.0, line).then(a.1.cmp(&b.1))
}

impl Collector for Closest {
    #[inline(always)]
    fn offer(&mut self, line: &Line, crossing: Crossing, place: &impl Place) -> Next {
        if crossing.depth[0] > self.reach() {
            return Next::On;
        }
        let Some(t) = crossing.t_within(line) else { return Next::On };
        let face = place.face();
        if self.skip.has(face) || face == FaceId::NONE {
            return Next::On;
        }
        let this = (&crossing, face);
        if self.best.as_ref().is_some_and(|best| order(line, this, (&best.crossing, best.face)) != Ordering::Less) {
            return Next::On;
        }
        if self.after.as_ref().is_some_and(|(last, id)| order(line, this, (last, *id)) != Ordering::Greater) {
            return Next::On;
        }
        self.best = Some(Best { crossing, t, face, page: place.page(), reference: place.reference() });
        Next::Nearer
    }

    #[inline(always)]
    fn reach(&self) -> f64 {
        self.best.as_ref().map_or(f64::INFINITY, |best| best.crossing.depth[1])
    }
}

/// Ends at the first hit.
pub(super) struct Any {
    skip: Skip,
    pub found: bool,
}

impl Any {
    pub fn new(skip: Skip) -> Any {
        Any { skip, found: false }
    }
}

impl Collector for Any {
    #[inline(always)]
    fn offer(&mut self, line: &Line, crossing: Crossing, place: &impl Place) -> Next {
        if crossing.t_within(line).is_none() {
            return Next::On;
        }
        let face = place.face();
        if self.skip.has(face) || face == FaceId::NONE {
            return Next::On;
        }
        self.found = true;
        Next::Done
    }

    #[inline(always)]
    fn reach(&self) -> f64 {
        f64::INFINITY
    }
}
