//! Spatial splits: a plane may cut triangles, so that large ones do not make all boxes overlap.
//!
//! After Stich, Friedrich and Dietrich (2009), "Spatial splits in bounding volume hierarchies". On each axis the box of a
//! list is cut into up to 32 slabs; a triangle counts in each slab that its box reaches, with the box of its part there.
//! The best plane between two slabs is taken if it is cheaper than any way to sort whole triangles. A triangle that a
//! plane cuts goes to both sides, or whole to one where that is cheaper (their section 4.2).
//!
//! **Clipped boxes are conservative.** Where an edge meets the plane is found in f64 and rounded outward by more than its
//! error, so for each point p of a triangle inside its primitive's box: p lies in the box of a part (in both if it is on
//! the plane). By induction every point of a triangle lies in some leaf's box, and a ray that meets the triangle there
//! comes to that leaf. Where a part's box would be empty no such point exists, and the part is left out.
//!
//! **Where it is tried.** A box far larger than its fair share of the whole's is *large*. A mesh in which large boxes make
//! up too little of all surface has no use for cuts: that is every scan, which this test is all they pay. Else the room
//! for second places, [`ROOM`] of the triangles, is divided from the root down by the surface of large boxes on each side,
//! and the tree is kept only if its cost is below [`GAIN`] of that without cuts.

use glam::Vec3A;

use super::record::RecordLimits;
use super::sah::{self, Binary, Canonical, Primitive, Span};
use crate::geometry::Triangle;

/// Most slabs an axis.
const SLABS: usize = 32;
/// Second places, in hundredths of the triangles.
const ROOM: usize = 30;
/// A box is large if its surface is this many times its fair share, the whole's surface over the number of triangles.
const LARGE: f64 = 8.0;
/// Large boxes must have this part of the surface of all boxes.
const LARGE_PART: f64 = 0.2;
/// A tree with cuts is kept if it costs no more than this part of the tree without.
const GAIN: f64 = 0.9;

/// The cheaper of the trees with and without cuts, if `repeats` allows them.
pub(super) fn best_tree(triangles: Canonical<'_>, limits: RecordLimits, repeats: bool) -> Binary {
    let plain = sah::build(primitives(triangles), 0, triangles, limits);
    if !repeats {
        return plain;
    }
    let mut list = primitives(triangles);
    if !mark_large(&mut list) {
        return plain;
    }
    let bound = GAIN * plain.cost;
    drop(plain);
    let room = list.len() / 100 * ROOM + list.len() % 100 * ROOM / 100;
    let cut = sah::build(list, room, triangles, limits);
    if cut.cost <= bound { cut } else { sah::build(primitives(triangles), 0, triangles, limits) }
}

/// Every triangle whole, in canonical order.
fn primitives(triangles: Canonical<'_>) -> Vec<Primitive> {
    (0..triangles.order.len() as u32).map(|id| Primitive::new(id, triangles.triangle(id))).collect()
}

/// Marks the large boxes; whether they are worth a try.
fn mark_large(list: &mut [Primitive]) -> bool {
    let whole = list.iter().fold(Span::EMPTY, |all, p| all.union(p.span()));
    let fair = whole.half_area() / list.len() as f64;
    let (mut all, mut large) = (0.0, 0.0);
    for primitive in list {
        let area = primitive.span().half_area();
        primitive.large = u32::from(area > LARGE * fair);
        all += area;
        large += if primitive.large != 0 { area } else { 0.0 };
    }
    large > LARGE_PART * all
}

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

/// A plane through space.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cut {
    axis: usize,
    plane: f32,
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
        let count = if primitives <= 16 { SLABS / 4 } else { SLABS };
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

/// The plane of least cost (area times number, summed over both sides) below `bound` for which `room` is enough.
pub(super) fn best_cut(
    primitives: &[Primitive],
    span: Span,
    room: usize,
    bound: f64,
    triangles: Canonical<'_>,
) -> Option<Cut> {
    let mut best = (bound, None);
    for slabs in (0..3).filter_map(|axis| Slabs::new(span, axis, primitives.len())) {
        let content = Content::of(primitives, &slabs, triangles);
        let (cost, slab) = content.cheapest(&slabs, primitives.len() + room);
        if cost < best.0 {
            best = (cost, Some(Cut { axis: slabs.axis, plane: slabs.planes[slab] }));
        }
    }
    best.1
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
            above[slab] = (span.half_area() * f64::from(count), count);
        }
        let mut best = (f64::INFINITY, 1);
        (span, count) = (Span::EMPTY, 0);
        for slab in 1..slabs.count {
            span = span.union(self.spans[slab - 1]);
            count += self.begin[slab - 1];
            let (cost, beyond) = above[slab];
            let cost = span.half_area() * f64::from(count) + cost;
            if count > 0 && beyond > 0 && (count + beyond) as usize <= most && cost < best.0 {
                best = (cost, slab);
            }
        }
        best
    }
}

impl Cut {
    /// The boxes of the two parts of a triangle's part within `span`; empty where there is none.
    pub fn parts(self, span: Span, triangle: &Triangle) -> (Span, Span) {
        let Cut { axis, plane } = self;
        let corners = triangle.vertices().map(Vec3A::from);
        let (mut low, mut high) = (Span::EMPTY, Span::EMPTY);
        for (v, w) in [(0, 1), (1, 2), (2, 0)].map(|(i, j)| (corners[i], corners[j])) {
            if v[axis] <= plane {
                low = low.around(v, v);
            }
            if v[axis] >= plane {
                high = high.around(v, v);
            }
            if (v[axis] < plane && w[axis] > plane) || (v[axis] > plane && w[axis] < plane) {
                let Span { min, max } = self.crossing(v, w);
                low = low.around(min, max);
                high = high.around(min, max);
            }
        }
        low.max[axis] = low.max[axis].min(plane);
        high.min[axis] = high.min[axis].max(plane);
        (low.common(span), high.common(span))
    }

    /// A box around the point where the edge from v to w, whose ends lie on different sides, meets the plane.
    ///
    /// With t = (p - v) / (w - v) of the cut's axis, v + t (w - v) is off by less than 2^-48 (|v| + |w|): the differences
    /// and the quotient are off by 2^-51 at most relatively, and t is at most 1.
    fn crossing(self, v: Vec3A, w: Vec3A) -> Span {
        const ERROR: f64 = 1.0 / (1u64 << 48) as f64;
        let at = |v: Vec3A, axis: usize| f64::from(v[axis]);
        let from = at(v, self.axis);
        let t = (f64::from(self.plane) - from) / (at(w, self.axis) - from);
        let mut span = Span { min: v.min(w), max: v.max(w) };
        for axis in 0..3 {
            let (a, b) = (at(v, axis), at(w, axis));
            let (x, error) = (a + t * (b - a), ERROR * (a.abs() + b.abs()));
            span.min[axis] = span.min[axis].max(rounded_down(x - error));
            span.max[axis] = span.max[axis].min(-rounded_down(-(x + error)));
        }
        (span.min[self.axis], span.max[self.axis]) = (self.plane, self.plane);
        span
    }
}

/// The greatest f32 that is no greater than x.
fn rounded_down(x: f64) -> f32 {
    let near = x as f32;
    if f64::from(near) > x { near.next_down() } else { near }
}

/// Puts the primitives of a list on their sides of a cut, second places into the room behind the first `count`; the
/// lengths of both sides. `None` if one side would be empty: then nothing is changed.
pub(super) fn apply(cut: Cut, list: &mut [Primitive], count: usize, triangles: Canonical<'_>) -> Option<[usize; 2]> {
    let mut room = list.len() - count;
    let mut sides = [Side::new(), Side::new()];
    let mut crossing = Vec::new();
    for (place, primitive) in list[..count].iter().enumerate() {
        if primitive.max()[cut.axis] <= cut.plane {
            sides[0].add(*primitive);
        } else if primitive.min()[cut.axis] >= cut.plane {
            sides[1].add(*primitive);
        } else {
            crossing.push(place);
        }
    }

    // As if all were cut; then one by one whatever is cheapest of cutting it, and leaving it whole on one side.
    let parts: Vec<(Span, Span)> =
        crossing.iter().map(|&place| cut.parts(list[place].span(), triangles.triangle(list[place].id))).collect();
    let mut spans = sides.each_ref().map(|side| side.span);
    let mut counts = sides.each_ref().map(|side| side.list.len());
    for part in &parts {
        for (side, part) in [part.0, part.1].into_iter().enumerate().filter(|(_, part)| !part.is_empty()) {
            spans[side] = spans[side].union(part);
            counts[side] += 1;
        }
    }
    for (&place, &(low, high)) in crossing.iter().zip(&parts) {
        let primitive = list[place];
        match (low.is_empty(), high.is_empty()) {
            (false, true) => sides[0].add(primitive.within(low)),
            (true, _) => sides[1].add(primitive.within(if high.is_empty() { primitive.span() } else { high })),
            (false, false) => {
                let areas = spans.map(Span::half_area);
                let wholes = spans.map(|span| span.union(primitive.span()));
                let cost =
                    |areas: [f64; 2], counts: [usize; 2]| areas[0] * counts[0] as f64 + areas[1] * counts[1] as f64;
                let both = if room > 0 { cost(areas, counts) } else { f64::INFINITY };
                let first = cost([wholes[0].half_area(), areas[1]], [counts[0], counts[1] - 1]);
                let second = cost([areas[0], wholes[1].half_area()], [counts[0] - 1, counts[1]]);
                if both < first && both < second {
                    sides[0].add(primitive.within(low));
                    sides[1].add(primitive.within(high));
                    room -= 1;
                } else {
                    let side = usize::from(second < first);
                    sides[side].add(primitive);
                    spans[side] = wholes[side];
                    counts[1 - side] -= 1;
                }
            }
        }
    }

    let [low, high] = sides.map(|side| side.list);
    let (first, both) = (low.len(), low.len() + high.len());
    if first == 0 || first == both {
        return None;
    }
    list[..first].copy_from_slice(&low);
    list[first..both].copy_from_slice(&high);
    Some([first, both - first])
}

/// One side of a cut as it fills.
struct Side {
    list: Vec<Primitive>,
    span: Span,
}

impl Side {
    fn new() -> Side {
        Side { list: Vec::new(), span: Span::EMPTY }
    }

    fn add(&mut self, primitive: Primitive) {
        self.span = self.span.union(primitive.span());
        self.list.push(primitive);
    }
}
