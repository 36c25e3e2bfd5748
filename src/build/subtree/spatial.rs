//! Spatial splits: a plane may cut triangles, so that large ones do not make all boxes overlap.
//!
//! After Stich, Friedrich and Dietrich (2009), "Spatial splits in bounding volume hierarchies". On each axis the box of a
//! list is cut into up to 32 slabs; a triangle counts in each slab that its box reaches, with the box of its part there.
//! The best plane between two slabs is taken if it is cheaper than any way to sort whole triangles. A triangle that a
//! plane cuts goes to both sides, or whole to one where that is cheaper (their section 4.2).
//!
//! Where a part lies is [`super::clip`]'s business; whether cuts are tried at all, and how much room they get, [`super::choice`]'s.

use rayon::prelude::*;

use super::binning::side_cost;
use super::clip::Cut;
use super::primitive::{Primitive, Span};
use super::sah::{self, Canonical};

/// Most slabs an axis.
const SLABS: usize = 32;
/// A list whose primitives cross more planes of an axis than this number and this many times their own number is not cut
/// on that axis: all is large there, and no plane parts it.
const MOST_CUTS: (usize, usize) = (512, 4);

/// How many of `room` places the first of two parts gets: by the surface of the large boxes in each.
pub(super) fn share_of_room(room: usize, low: &[Primitive], high: &[Primitive]) -> usize {
    if room == 0 {
        return 0;
    }
    let weigh =
        |list: &[Primitive]| -> f64 { list.iter().filter(|p| p.large != 0).map(|p| p.span().half_area()).sum() };
    let (low, high) = (weigh(low), weigh(high));
    // Nothing large on either side: 0 / 0, which the cast makes 0. The sides have no use for room then.
    ((room as f64 * (low / (low + high))) as usize).min(room)
}

/// The planes between the slabs of an axis.
struct Slabs {
    axis: usize,
    low: f32,
    scale: f32,
    /// `planes[i]` is the lower border of slab i; the first is -inf.
    planes: [f32; SLABS],
    count: usize,
}

impl Slabs {
    /// `None` where the axis has no two different planes.
    fn new(span: Span, axis: usize, primitives: usize) -> Option<Slabs> {
        let (low, high) = (span.min[axis], span.max[axis]);
        let count = match primitives {
            ..=32 => SLABS / 4,
            33..=256 => SLABS / 2,
            _ => SLABS,
        };
        let width = (0.5 * high - 0.5 * low) / (0.5 * count as f32);
        let mut planes = [f32::NEG_INFINITY; SLABS];
        for (i, plane) in planes.iter_mut().enumerate().take(count).skip(1) {
            *plane = low + width * i as f32;
        }
        let proper = width > 0.0 && width.is_normal() && planes[1] > low && planes[count - 1] < high;
        proper.then_some(Slabs { axis, low, scale: 1.0 / width, planes, count })
    }

    /// The first and the last slab that a box reaches into; one that only touches a plane does not reach beyond it.
    fn reached(&self, span: Span) -> (usize, usize) {
        let (min, max) = (span.min[self.axis], span.max[self.axis]);
        let place = |x: f32| (((x - self.low) * self.scale) as i32 as usize).min(self.count - 1);
        // The product may be rounded to a neighbour's number.
        let mut first = place(min);
        while first + 1 < self.count && self.planes[first + 1] <= min {
            first += 1;
        }
        while first > 0 && self.planes[first] > min {
            first -= 1;
        }
        let mut last = place(max).max(first);
        while last + 1 < self.count && self.planes[last + 1] < max {
            last += 1;
        }
        while last > first && self.planes[last] >= max {
            last -= 1;
        }
        (first, last)
    }
}

/// What the slabs of an axis hold.
struct Content {
    spans: [Span; SLABS],
    /// How many begin, and how many end in a slab.
    begin: [u32; SLABS],
    end: [u32; SLABS],
}

/// The plane of least cost (area times [`side_cost`], summed over both sides) below `bound` for which `room` is enough.
pub(super) fn best_cut(
    primitives: &[Primitive],
    span: Span,
    room: usize,
    bound: f64,
    triangles: Canonical<'_>,
) -> Option<Cut> {
    let grade = |axis: usize| {
        let slabs = Slabs::new(span, axis, primitives.len())?;
        let cuts = primitives.iter().map(|p| slabs.reached(p.span())).map(|(first, last)| last - first).sum::<usize>();
        if cuts > MOST_CUTS.0 + MOST_CUTS.1 * primitives.len() {
            return None;
        }
        let (cost, slab) = Content::of(primitives, &slabs, triangles).cheapest(&slabs, primitives.len() + room);
        Some((cost, Cut { axis, plane: slabs.planes[slab] }))
    };
    let graded = match primitives.len() > sah::PARALLEL {
        true => (0..3).into_par_iter().map(grade).collect(),
        false => Vec::from_iter((0..3).map(grade)),
    };
    let cheaper = |best: (f64, Cut), next: (f64, Cut)| if next.0 < best.0 { next } else { best };
    graded.into_iter().flatten().reduce(cheaper).filter(|best| best.0 < bound).map(|best| best.1)
}

impl Content {
    fn of(primitives: &[Primitive], slabs: &Slabs, triangles: Canonical<'_>) -> Content {
        let mut content = Content { spans: [Span::EMPTY; SLABS], begin: [0; SLABS], end: [0; SLABS] };
        for primitive in primitives {
            let mut rest = primitive.span();
            let (first, last) = slabs.reached(rest);
            content.begin[first] += 1;
            content.end[last] += 1;
            for slab in first..last {
                let cut = Cut { axis: slabs.axis, plane: slabs.planes[slab + 1] };
                let (low, high) = cut.parts(rest, triangles.triangle(primitive.id));
                if !low.is_empty() {
                    content.spans[slab] = content.spans[slab].union(low);
                }
                rest = high;
            }
            if !rest.is_empty() {
                content.spans[last] = content.spans[last].union(rest);
            }
        }
        content
    }

    /// The cheapest plane, named by the slab above it, that puts at most `most` on both sides together.
    fn cheapest(&self, slabs: &Slabs, most: usize) -> (f64, usize) {
        let mut above = [(f64::INFINITY, 0u32); SLABS];
        let (mut span, mut count) = (Span::EMPTY, 0);
        for slab in (1..slabs.count).rev() {
            span = span.union(self.spans[slab]);
            count += self.end[slab];
            above[slab] = (span.half_area() * side_cost(count), count);
        }
        let mut best = (f64::INFINITY, 1);
        (span, count) = (Span::EMPTY, 0);
        for (slab, &(cost, beyond)) in above.iter().enumerate().take(slabs.count).skip(1) {
            span = span.union(self.spans[slab - 1]);
            count += self.begin[slab - 1];
            let cost = span.half_area() * side_cost(count) + cost;
            if count > 0 && beyond > 0 && (count + beyond) as usize <= most && cost < best.0 {
                best = (cost, slab);
            }
        }
        best
    }
}

/// Puts the primitives of a list on their sides of a cut, second places into the room behind the first `count`; the
/// lengths of both sides. `None` if one side would be empty: then nothing is changed.
pub(super) fn apply(cut: Cut, list: &mut [Primitive], count: usize, triangles: Canonical<'_>) -> Option<[usize; 2]> {
    let mut sides = Sides { lists: [Vec::new(), Vec::new()], spans: [Span::EMPTY; 2], counts: [0; 2] };
    let mut crossing = Vec::new();
    for primitive in &list[..count] {
        if primitive.max[cut.axis] <= cut.plane {
            sides.expect(0, primitive.span());
            sides.lists[0].push(*primitive);
        } else if primitive.min[cut.axis] >= cut.plane {
            sides.expect(1, primitive.span());
            sides.lists[1].push(*primitive);
        } else {
            let (low, high) = cut.parts(primitive.span(), triangles.triangle(primitive.id));
            crossing.push((*primitive, [low, high]));
        }
    }
    for (_, parts) in &crossing {
        let parts = parts.iter().enumerate().filter(|(_, part)| !part.is_empty());
        parts.for_each(|(side, &part)| sides.expect(side, part));
    }
    let mut room = list.len() - count;
    for (primitive, parts) in crossing {
        room -= usize::from(sides.settle(primitive, parts, room > 0));
    }

    let [low, high] = sides.lists;
    let (first, both) = (low.len(), low.len() + high.len());
    if first == 0 || first == both {
        return None;
    }
    list[..first].copy_from_slice(&low);
    list[first..both].copy_from_slice(&high);
    Some([first, both - first])
}

/// The two sides of a cut as they fill.
struct Sides {
    /// What has its place.
    lists: [Vec<Primitive>; 2],
    /// The boxes and numbers that the sides will have, if all that is not yet placed is cut in two.
    spans: [Span; 2],
    counts: [u32; 2],
}

impl Sides {
    /// One more is to come to a side.
    fn expect(&mut self, side: usize, span: Span) {
        self.spans[side] = self.spans[side].union(span);
        self.counts[side] += 1;
    }

    /// Places a primitive that the plane cuts in two: both parts, if that is the cheapest and there is `room`, or the
    /// whole on one side. Whether it takes a second place.
    fn settle(&mut self, primitive: Primitive, [low, high]: [Span; 2], room: bool) -> bool {
        if low.is_empty() || high.is_empty() {
            // Nothing of it lies on one side (nor on the other, if both are empty: then any place is good).
            let side = usize::from(low.is_empty());
            let part = if side == 0 { low } else { high };
            self.lists[side].push(if part.is_empty() { primitive } else { primitive.within(part) });
            return false;
        }
        let wholes = self.spans.map(|span| span.union(primitive.span()));
        let cost = |spans: [Span; 2], counts: [u32; 2]| -> f64 {
            spans.into_iter().zip(counts).map(|(span, count)| span.half_area() * side_cost(count)).sum()
        };
        let both = if room { cost(self.spans, self.counts) } else { f64::INFINITY };
        let first = cost([wholes[0], self.spans[1]], [self.counts[0], self.counts[1] - 1]);
        let second = cost([self.spans[0], wholes[1]], [self.counts[0] - 1, self.counts[1]]);
        if both < first && both < second {
            self.lists[0].push(primitive.within(low));
            self.lists[1].push(primitive.within(high));
            return true;
        }
        let side = usize::from(second < first);
        self.lists[side].push(primitive);
        self.spans[side] = wholes[side];
        self.counts[1 - side] -= 1;
        false
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3A;
    use proptest::prelude::*;

    proptest! {
        /// Slabs: what a box reaches is what the planes say.
        #[test]
        fn slabs_are_found(low in -1e3f32..1e3, width in 1e-3f32..1e3, a in 0.0f32..=1.0, b in 0.0f32..=1.0) {
            let span = Span { min: Vec3A::splat(low), max: Vec3A::splat(low + width) };
            let Some(slabs) = Slabs::new(span, 1, 1000) else { return Ok(()) };
            let place = |x: f32| (low + x * width).clamp(low, low + width);
            let (min, max) = (place(a.min(b)), place(a.max(b)));
            let (first, last) = slabs.reached(Span { min: Vec3A::splat(min), max: Vec3A::splat(max) });
            prop_assert!(slabs.planes[first] <= min && (first + 1 == SLABS || min < slabs.planes[first + 1]));
            prop_assert!(last == first || slabs.planes[last] < max);
            prop_assert!(last + 1 == SLABS || max <= slabs.planes[last + 1]);
        }
    }
}
