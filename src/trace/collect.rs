//! What becomes of the hits that a walk finds: the closest is kept, or the first one ends it, or the next after another is sought.

use std::cmp::Ordering;
use std::marker::PhantomData;

use bytemuck::Zeroable;

use super::Found;
use super::arch::{Block, Kernel, Rounded};
use crate::exact::{Crossing, Depths, LANES, Lanes, Line};
use crate::format::{Leaf, PageId};
use crate::geometry::{FaceId, Hit, Ray, Skip};
use crate::map::Page;

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
pub(super) trait Collector<'a> {
    /// Takes the hits of a leaf whose lanes are all certain, from the bounds of their t alone. `None`, and nothing taken,
    /// where these do not decide: then every lane is to be offered.
    fn glance(&mut self, ray: &Ray, lanes: Lanes, depths: &Depths, leaf: &Stored<'a>) -> Option<Next>;

    /// Takes a hit that is settled.
    fn offer(&mut self, line: &Line, crossing: Crossing, place: &impl Place) -> Next;

    /// An upper bound of the t of any hit that still matters.
    fn reach(&self) -> f32;
}

/// A leaf, and where it is.
#[derive(Clone, Copy)]
pub(super) struct Stored<'a> {
    pub page: Page<'a>,
    pub id: PageId,
    pub leaf: Leaf<'a>,
}

impl Stored<'_> {
    /// The face of triangle `lane` of the leaf.
    #[inline(always)]
    pub fn face(&self, lane: u32) -> FaceId {
        self.page.face(self.leaf.first().wrapping_add(lane))
    }

    /// Lanes without those of the triangles to be left out.
    #[inline(always)]
    fn without(&self, skip: Skip, lanes: u32) -> u32 {
        if skip == Skip::NONE {
            return lanes;
        }
        let (mut left, mut kept) = (lanes, lanes);
        while left != 0 {
            let lane = left.trailing_zeros();
            left &= left - 1;
            if skip.has(self.face(lane)) {
                kept &= !(1 << lane);
            }
        }
        kept
    }
}

/// Keeps the closest hit, after another if one is given.
pub(super) struct Closest<'a> {
    skip: Skip,
    after: Option<(Crossing, FaceId)>,
    best: Best<'a>,
}

/// The closest hit so far.
#[derive(Clone, Copy)]
enum Best<'a> {
    None,
    Seen(Seen<'a>),
    Settled(Settled),
}

/// A hit between two t, certainly within the interval; that is all that needs to be known of it before another comes near.
#[derive(Clone, Copy)]
struct Seen<'a> {
    lo: f32,
    hi: f32,
    stored: Stored<'a>,
    lane: u32,
}

#[derive(Clone, Copy)]
struct Settled {
    crossing: Crossing,
    t: f32,
    face: FaceId,
    page: PageId,
    reference: u32,
}

/// The closest hit of a walk that was put aside.
#[derive(Default)]
pub(super) struct Rest(Option<Box<Settled>>);

impl<'a> Seen<'a> {
    /// The triangle's number within the page.
    #[inline(always)]
    fn reference(&self) -> u32 {
        self.stored.leaf.first().wrapping_add(self.lane)
    }

    /// The answer with t, u and v; nothing for a page that turned to zeros.
    #[inline(always)]
    fn found(&self, [t, u, v]: [f32; 3]) -> Option<Found> {
        let (Stored { page, id, leaf }, reference) = (&self.stored, self.reference());
        let face = page.face(reference);
        let (hit, triangle) = (Hit { t, face, u, v }, leaf.triangle(self.lane as usize));
        (face != FaceId::NONE).then_some(Found { hit, triangle, page: *id, reference })
    }

    /// The hit with all that can be known; `None` for a page that turned to zeros.
    #[inline(never)]
    fn settle(&self, line: &Line) -> Option<Settled> {
        let reference = self.reference();
        let crossing = line.accepted(&self.stored.leaf.triangle(self.lane as usize)).crossing?;
        let t = crossing.t_within(line)?;
        let face = self.stored.page.face(reference);
        (face != FaceId::NONE).then_some(Settled { crossing, t, face, page: self.stored.id, reference })
    }
}

/// The t, u and v of up to 16 rays whose walks are over, many at once.
pub(super) struct Rounding {
    block: Block,
    rounded: Rounded,
    /// Which rays of the batch stand in the block, a bit each.
    inside: u32,
}

impl Rounding {
    /// Rounds the hits that were seen.
    #[inline(always)]
    pub fn of<K: Kernel>(kernel: K, rays: &[Ray], collectors: &[Closest<'_>]) -> Rounding {
        let mut this = Rounding { block: Block::zeroed(), rounded: Rounded::zeroed(), inside: 0 };
        let mut count = 0;
        for (i, (ray, collector)) in rays.iter().zip(collectors).enumerate().take(LANES) {
            let Best::Seen(Seen { stored: Stored { leaf, .. }, lane, .. }) = &collector.best else { continue };
            let Some([a, b, c]) = leaf.corner_points(*lane as usize) else { continue };
            let block = &mut this.block;
            for axis in 0..3 {
                (block.a[axis].0[count], block.b[axis].0[count], block.c[axis].0[count]) = (a[axis], b[axis], c[axis]);
                block.origin[axis].0[count] = ray.origin[axis];
                block.direction[axis].0[count] = ray.direction[axis];
            }
            this.inside |= 1 << i;
            count += 1;
        }
        if count > 0 {
            kernel.rounded(&this.block, u32::MAX >> (32 - count), &mut this.rounded);
        }
        this
    }

    /// t, u and v of ray i, if f64 sufficed.
    #[inline(always)]
    pub fn get(&self, i: usize) -> Option<[f32; 3]> {
        let lane = (self.inside & !(u32::MAX << (i & 31))).count_ones() as usize & (LANES - 1);
        let certain = self.inside >> (i & 31) & self.rounded.certain >> lane & 1 != 0;
        certain.then_some([self.rounded.t.0[lane], self.rounded.u.0[lane], self.rounded.v.0[lane]])
    }
}

impl<'a> Closest<'a> {
    /// The closest of all hits.
    #[inline(always)]
    pub fn new(skip: Skip) -> Closest<'a> {
        Closest { skip, after: None, best: Best::None }
    }

    /// Begins anew with another ray. What was there before is marked as gone, not overwritten, since this is made for every ray.
    #[inline(always)]
    pub fn begin(&mut self, skip: Skip) {
        self.skip = skip;
        self.after = None;
        self.best = Best::None;
    }

    /// Leaves out what comes before `last`, a hit of the same line, and that.
    pub fn begin_after(&mut self, line: &Line, last: &Found) {
        self.after = line.accepted(&last.triangle).crossing.map(|crossing| (crossing, last.hit.face));
    }

    #[inline(always)]
    fn settled(&self, line: &Line) -> Option<Settled> {
        match &self.best {
            Best::None => None,
            Best::Seen(seen) => seen.settle(line),
            Best::Settled(settled) => Some(*settled),
        }
    }

    /// What has been found so far, without anything of pages.
    pub fn rest(&self, ray: &Ray) -> Rest {
        match &self.best {
            Best::None => Rest(None),
            _ => Rest(self.settled(&Line::new(ray)).map(Box::new)),
        }
    }

    /// Goes on from what was found before.
    pub fn resume(&mut self, rest: Rest) {
        if let Some(settled) = rest.0 {
            self.best = Best::Settled(*settled);
        }
    }

    /// The answer. `rounded` has t, u and v if f64 sufficed.
    #[inline(always)]
    pub fn found(&self, ray: &Ray, rounded: Option<[f32; 3]>) -> Option<Found> {
        match (&self.best, rounded) {
            (Best::None, _) => None,
            (Best::Seen(seen), Some(rounded)) => seen.found(rounded).or_else(|| self.found_exactly(ray)),
            _ => self.found_exactly(ray),
        }
    }

    /// The hit alone of the answer.
    #[inline(always)]
    pub fn hit(&self, ray: &Ray, rounded: Option<[f32; 3]>) -> Hit {
        if let Best::None = self.best {
            return Hit::MISS;
        }
        if let (Best::Seen(seen), Some([t, u, v])) = (&self.best, rounded) {
            let face = seen.stored.face(seen.lane);
            if face != FaceId::NONE {
                return Hit { t, face, u, v };
            }
        }
        match self.found_exactly(ray) {
            Some(found) => found.hit,
            None => Hit::MISS,
        }
    }

    /// The same where f64 does not suffice, or the hit was settled before.
    #[cold]
    #[inline(never)]
    pub fn found_exactly(&self, ray: &Ray) -> Option<Found> {
        let line = Line::new(ray);
        let Settled { crossing, t, face, page, reference } = self.settled(&line)?;
        let [u, v] = crossing.uv(&line);
        Some(Found { hit: Hit { t, face, u, v }, triangle: crossing.triangle, page, reference })
    }
}

/// Order by (exact t, face id).
fn order(line: &Line, a: (&Crossing, FaceId), b: (&Crossing, FaceId)) -> Ordering {
    a.0.cmp(b.0, line).then(a.1.cmp(&b.1))
}

impl<'a> Collector<'a> for Closest<'a> {
    #[inline(always)]
    fn glance(&mut self, ray: &Ray, lanes: Lanes, depths: &Depths, stored: &Stored<'a>) -> Option<Next> {
        if lanes.doubt != 0 || self.after.is_some() {
            return None;
        }
        let mut left = stored.without(self.skip, lanes.accept);
        if left == 0 {
            return Some(Next::On);
        }
        let mut lane = left.trailing_zeros();
        left &= left - 1;
        let at = |lane: u32| (depths.lo[lane as usize & 15], depths.hi[lane as usize & 15]);
        let (mut lo, mut hi) = at(lane);
        while left != 0 {
            let other = left.trailing_zeros();
            left &= left - 1;
            let (l, h) = at(other);
            let (nearer, farther) = (h < lo, l > hi);
            if nearer {
                (lane, lo, hi) = (other, l, h);
            } else if !farther {
                return None;
            }
        }
        // Each comparison is false for NaN.
        let before = match &self.best {
            Best::None => f32::INFINITY,
            Best::Seen(seen) => seen.lo,
            Best::Settled(best) => (best.crossing.depth[0] as f32).next_down(),
        };
        if !(lo > ray.tmin && hi < ray.tmax && hi < before) {
            return None;
        }
        self.best = Best::Seen(Seen { lo, hi, stored: *stored, lane });
        Some(Next::Nearer)
    }

    #[inline(always)]
    fn offer(&mut self, line: &Line, crossing: Crossing, place: &impl Place) -> Next {
        let best = self.settled(line);
        if best.as_ref().is_some_and(|best| crossing.depth[0] > best.crossing.depth[1]) {
            return Next::On;
        }
        let Some(t) = crossing.t_within(line) else { return Next::On };
        let face = place.face();
        if self.skip.has(face) || face == FaceId::NONE {
            return Next::On;
        }
        let this = (&crossing, face);
        if best.as_ref().is_some_and(|best| order(line, this, (&best.crossing, best.face)) != Ordering::Less) {
            return Next::On;
        }
        if self.after.as_ref().is_some_and(|(last, id)| order(line, this, (last, *id)) != Ordering::Greater) {
            return Next::On;
        }
        self.best = Best::Settled(Settled { crossing, t, face, page: place.page(), reference: place.reference() });
        Next::Nearer
    }

    #[inline(always)]
    fn reach(&self) -> f32 {
        match &self.best {
            Best::None => f32::INFINITY,
            Best::Seen(seen) => seen.hi,
            Best::Settled(best) => (best.crossing.depth[1] as f32).next_up(),
        }
    }
}

/// Ends at the first hit.
pub(super) struct Any<'a> {
    skip: Skip,
    pub found: bool,
    file: PhantomData<&'a ()>,
}

impl Any<'_> {
    #[inline(always)]
    pub fn new(skip: Skip) -> Self {
        Any { skip, found: false, file: PhantomData }
    }
}

impl<'a> Collector<'a> for Any<'a> {
    #[inline(always)]
    fn glance(&mut self, ray: &Ray, lanes: Lanes, depths: &Depths, stored: &Stored<'a>) -> Option<Next> {
        let mut left = stored.without(self.skip, lanes.accept);
        let mut certain = lanes.doubt == 0;
        while left != 0 {
            let lane = left.trailing_zeros() as usize & 15;
            left &= left - 1;
            if depths.lo[lane] > ray.tmin && depths.hi[lane] < ray.tmax {
                self.found = true;
                return Some(Next::Done);
            }
            certain = false;
        }
        certain.then_some(Next::On)
    }

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
    fn reach(&self) -> f32 {
        f32::INFINITY
    }
}
