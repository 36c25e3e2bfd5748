//! A binary tree by binned surface-area splits, and what it will cost as an 8-wide tree.
//!
//! Splits follow Wald (2007): on each axis the centres of the boxes fall into up to 16 bins, and the best of the borders
//! between them is taken. Splitting goes on to a few triangles, well below what a leaf may hold: which subtrees become
//! leaves, which nodes dissolve into their parents, is decided by the costs of [`super::collapse`], which are summed here
//! on the way up while both children's are at hand.
//!
//! Arithmetic is on the source's coordinates, so nothing is lost to a far-away root cube; boxes and bins in f32, areas in
//! f64, so nothing overflows up to ±FLT_MAX. Where centres coincide (identical triangles), and where an uneven split could
//! lead past [`DEPTH_LIMIT`] (freak meshes only), the list is halved instead.
//!
//! The result depends on the order of `primitives` alone, which the caller makes canonical. Halves of big lists are built
//! in parallel; nodes lie in preorder with relative links, so that joining them is appending.
//!
//! A list may have room behind it: then a split may also cut through space, and a triangle that lies on both sides takes
//! a second place ([`super::spatial`]). Each side gets its part of the room that is left. Without room, and that is every
//! mesh of evenly sized triangles, nothing of that is even looked for.

use glam::Vec3A;

use super::collapse::{Costs, Plan};
use super::primitive::{Primitive, Span};
use super::record::RecordLimits;
use super::spatial;
use crate::geometry::Triangle;

/// Most bins an axis.
const BINS: usize = 16;
/// Lists up to this length are not split, if one record can hold them.
const TERMINAL: usize = 3;
/// So many triangles are added to each side's number where splits are compared: a leaf costs the same for few as for many, so even
/// an all but empty side is not free. Makes about 1 % fewer visits than 0; 2 to 8 measure alike.
const SIDE: u32 = 4;
/// No path of the binary tree, so none of the 8-wide one, is longer: a file allows 64 nodes, of which the top tree may
/// take 22. Over a million triangles this leaves 20 levels more than a balanced tree has.
const DEPTH_LIMIT: u32 = 40;
/// Lists longer than this are built as two parallel tasks.
pub(super) const PARALLEL: usize = 1 << 14;
/// Spatial splits are looked for where the two sides' boxes share more than this part of the whole's surface (Stich,
/// Friedrich and Dietrich 2009, section 4.4).
const OVERLAP: f64 = 1e-5;

/// A node of the binary tree; 44 bytes. Its left child is the next node.
#[derive(Clone, Debug)]
pub(super) struct BinaryNode {
    /// Lowest corner of its box, in the source's coordinates.
    pub min: [f32; 3],
    /// Highest corner.
    pub max: [f32; 3],
    /// Distance to the right child; 0 = no children.
    pub right: u32,
    /// First of its primitives; they lie together only where it has no children.
    pub first: u32,
    /// How many there are at most, those below it included: parts of a triangle that meet again below it count as one.
    pub count: u32,
    /// What collapsing does with it.
    pub plan: Plan,
}

/// A binary tree in preorder, its primitives, and what it costs as an 8-wide tree, in units of area.
pub(super) struct Binary {
    /// Nodes, the root first.
    pub nodes: Vec<BinaryNode>,
    /// The primitives that terminal nodes name; some places may lie unused in between.
    pub primitives: Vec<Primitive>,
    /// The cost.
    pub cost: f64,
}

/// Builds the tree over at least one primitive. `room`: how many places may be added by splitting triangles.
pub(super) fn build(
    mut primitives: Vec<Primitive>,
    room: usize,
    triangles: Canonical<'_>,
    limits: RecordLimits,
) -> Binary {
    let count = primitives.len();
    primitives.resize(count + room, Primitive::NOTHING);
    let mut nodes = Vec::with_capacity(count);
    let root_area = primitives[..count].iter().fold(Span::EMPTY, |all, p| all.union(p.span())).half_area();
    let splitter = Splitter { triangles, limits, root_area, spatial: room > 0 };
    let cost = splitter.subtree(&mut primitives, count, 0, 0, &mut nodes).as_child();
    Binary { nodes, primitives, cost }
}

/// The triangles in canonical order.
#[derive(Clone, Copy)]
pub(super) struct Canonical<'a> {
    /// The triangles as they came.
    pub triangles: &'a [super::BrickTriangle],
    /// Their canonical order.
    pub order: &'a [u32],
}

impl<'a> Canonical<'a> {
    /// The triangle with canonical number `id`.
    pub fn triangle(&self, id: u32) -> &'a Triangle {
        &self.triangles[self.order[id as usize] as usize].triangle
    }
}

#[derive(Clone, Copy)]
struct Splitter<'a> {
    triangles: Canonical<'a>,
    limits: RecordLimits,
    /// Half the surface of the whole.
    root_area: f64,
    /// Whether there is any room, so that spatial splits are to be tried.
    spatial: bool,
}

/// Where to split: below which bin of which axis; what that costs, and how much of both sides' boxes is the same.
#[derive(Clone, Copy)]
struct Split {
    axis: usize,
    bin: usize,
    cost: f64,
    overlap: f64,
}

/// What a list is like.
struct Summary {
    /// The box of the primitives.
    span: Span,
    /// The box of their centres.
    centres: Span,
    /// Whether any is large.
    large: bool,
}

impl Summary {
    fn of(primitives: &[Primitive]) -> Summary {
        let mut sum = Summary { span: Span::EMPTY, centres: Span::EMPTY, large: false };
        for primitive in primitives {
            let centre = primitive.centre();
            sum.span = sum.span.union(primitive.span());
            sum.centres = sum.centres.around(centre, centre);
            sum.large |= primitive.large != 0;
        }
        sum
    }
}

/// How centres fall into bins.
#[derive(Clone, Copy)]
struct Binning {
    low: Vec3A,
    scale: Vec3A,
    bins: usize,
}

impl Binning {
    /// `None` if all centres are the same.
    fn new(centres: Span, count: usize) -> Option<Binning> {
        let extent = centres.max - centres.min;
        let bins = if count <= 16 { BINS / 2 } else { BINS };
        // An axis without extent gets scale 0: all in bin 0, no split. One of denormal extent may get an infinite
        // scale: its least centre then gives 0 * inf = NaN, which the cast to an integer makes bin 0.
        let scale = Vec3A::select(extent.cmpgt(Vec3A::ZERO), Vec3A::splat(bins as f32) / extent, Vec3A::ZERO);
        (extent.max_element() > 0.0).then_some(Binning { low: centres.min, scale, bins })
    }

    fn bin(&self, primitive: &Primitive) -> [usize; 3] {
        let place = (primitive.centre() - self.low) * self.scale;
        place.to_array().map(|p| (p as i32 as usize).min(self.bins - 1))
    }

    /// The same on one axis: the same operations, so the same bin.
    fn bin_on(&self, axis: usize, primitive: &Primitive) -> usize {
        let centre = 0.25 * primitive.min[axis] + 0.25 * primitive.max[axis];
        let place = (centre - self.low[axis]) * self.scale[axis];
        (place as i32 as usize).min(self.bins - 1)
    }
}

impl Splitter<'_> {
    /// Appends the subtree over the first `count` of `list`, whose first place is number `first` of all; returns its
    /// costs. The rest of `list` is room for second places.
    fn subtree(
        &self,
        list: &mut [Primitive],
        count: usize,
        first: usize,
        depth: u32,
        nodes: &mut Vec<BinaryNode>,
    ) -> Costs {
        let sum = Summary::of(&list[..count]);
        let area = sum.span.half_area();
        let here = nodes.len();
        nodes.push(BinaryNode {
            min: sum.span.min.to_array(),
            max: sum.span.max.to_array(),
            right: 0,
            first: first as u32,
            count: count as u32,
            plan: Plan::default(),
        });
        if count <= TERMINAL.min(self.limits.triangles) {
            return Costs::terminal(area);
        }

        let parts = self.partition(list, count, &sum, depth);
        let (low, high) = self.share_room(list, parts);
        let (parallel, second) = (count > PARALLEL, first + low.len());
        let (left, right) = if parallel {
            let mut other = Vec::with_capacity(parts[1]);
            let costs = rayon::join(
                || self.subtree(low, parts[0], first, depth + 1, nodes),
                || self.subtree(high, parts[1], second, depth + 1, &mut other),
            );
            nodes[here].right = (nodes.len() - here) as u32;
            nodes.append(&mut other);
            costs
        } else {
            let left = self.subtree(low, parts[0], first, depth + 1, nodes);
            nodes[here].right = (nodes.len() - here) as u32;
            (left, self.subtree(high, parts[1], second, depth + 1, nodes))
        };

        let is_record = match self.spatial {
            true => self.is_record(&nodes[here + 1..], list, first),
            false => self.limits.fit(list.iter().map(|p| self.triangles.triangle(p.id))),
        };
        let (costs, plan) = Costs::of_parent(area, is_record, &left, &right);
        nodes[here].plan = plan;
        costs
    }

    /// Divides what room is left between two parts, the second of which is moved behind the room of the first.
    fn share_room<'l>(
        &self,
        list: &'l mut [Primitive],
        parts: [usize; 2],
    ) -> (&'l mut [Primitive], &'l mut [Primitive]) {
        let [low, both] = [parts[0], parts[0] + parts[1]];
        let room = list.len() - both;
        let share = spatial::share_of_room(room, &list[..low], &list[low..both]);
        if share > 0 {
            list.copy_within(low..both, low + share);
        }
        list.split_at_mut(low + share)
    }

    /// Whether one record holds all triangles of a subtree, given by the nodes below its root; `first` is the number of
    /// the list's first place. Parts of a triangle that meet again count once.
    fn is_record(&self, below: &[BinaryNode], list: &[Primitive], first: usize) -> bool {
        const MOST: usize = 2 * crate::format::LEAF_MAX;
        let mut ids = [0u32; MOST];
        let mut len = 0;
        for node in below.iter().filter(|node| node.right == 0) {
            let from = node.first as usize - first;
            for primitive in &list[from..from + node.count as usize] {
                if len == MOST {
                    return false;
                }
                ids[len] = primitive.id;
                len += 1;
            }
        }
        let distinct = distinct(&mut ids[..len]);
        self.limits.fit(distinct.iter().map(|&id| self.triangles.triangle(id)))
    }

    /// Reorders the primitives into two parts, neither empty; the lengths of both.
    fn partition(&self, list: &mut [Primitive], count: usize, sum: &Summary, depth: u32) -> [usize; 2] {
        let halves = [count / 2, count - count / 2];
        let (primitives, room) = list.split_at_mut(count);
        let binning = Binning::new(sum.centres, count);
        if depth + ceil_log2(count) >= DEPTH_LIMIT {
            if binning.is_some() {
                let extent = (sum.centres.max - sum.centres.min).to_array();
                let axis = (1..3).fold(0, |best, axis| if extent[axis] > extent[best] { axis } else { best });
                let key = |p: &Primitive| p.centre()[axis];
                primitives.select_nth_unstable_by(count / 2, |p, q| key(p).total_cmp(&key(q)).then(p.id.cmp(&q.id)));
            }
            return halves;
        }
        let split = binning.map(|binning| self.best_split(primitives, &binning));
        if !room.is_empty() && sum.large && split.as_ref().is_none_or(|s| s.overlap > OVERLAP * self.root_area) {
            let bound = split.as_ref().map_or(f64::INFINITY, |s| s.cost);
            let cut = spatial::best_cut(primitives, sum.span, room.len(), bound, self.triangles);
            if let Some(parts) = cut.and_then(|cut| spatial::apply(cut, list, count, self.triangles)) {
                return parts;
            }
        }
        let (Some(binning), Some(split)) = (binning, split) else { return halves };
        let middle = partition_in_place(&mut list[..count], |p| binning.bin_on(split.axis, p) < split.bin);
        if middle == 0 || middle == count { halves } else { [middle, count - middle] }
    }

    /// The split of least cost: area times [`side_cost`], summed over both sides.
    fn best_split(&self, primitives: &[Primitive], binning: &Binning) -> Split {
        let mut spans = [[Span::EMPTY; BINS]; 3];
        let mut counts = [[0u32; BINS]; 3];
        for primitive in primitives {
            let (min, max) = (primitive.min(), primitive.max());
            for (axis, bin) in binning.bin(primitive).into_iter().enumerate() {
                spans[axis][bin] = spans[axis][bin].around(min, max);
                counts[axis][bin] += 1;
            }
        }
        let mut best = Split { axis: 0, bin: 1, cost: f64::INFINITY, overlap: 0.0 };
        for axis in 0..3 {
            if binning.scale[axis] > 0.0 {
                let (cost, bin) = cheapest_border(&spans[axis], &counts[axis], binning.bins);
                if cost < best.cost {
                    best = Split { axis, bin, cost, overlap: 0.0 };
                }
            }
        }
        if self.spatial {
            let union = |spans: &[Span]| spans.iter().fold(Span::EMPTY, |all, &span| all.union(span));
            let (low, high) = spans[best.axis].split_at(best.bin);
            let common = union(low).common(union(high));
            best.overlap = if common.is_empty() { 0.0 } else { common.half_area() };
        }
        best
    }
}

/// The numbers in order, each once.
fn distinct(ids: &mut [u32]) -> &[u32] {
    ids.sort_unstable();
    let mut len = 0;
    for i in 0..ids.len() {
        if i == 0 || ids[i] != ids[i - 1] {
            ids[len] = ids[i];
            len += 1;
        }
    }
    &ids[..len]
}

/// Levels of a balanced tree over so many.
fn ceil_log2(count: usize) -> u32 {
    count.next_power_of_two().trailing_zeros()
}

/// What a side of so many costs, per unit of area.
pub(super) fn side_cost(count: u32) -> f64 {
    f64::from(count + SIDE)
}

/// The cheapest border between bins, named by the bin above it. Borders with nothing on one side do not count.
fn cheapest_border(spans: &[Span; BINS], counts: &[u32; BINS], bins: usize) -> (f64, usize) {
    let mut above = [0.0f64; BINS];
    let (mut span, mut count) = (Span::EMPTY, 0);
    for bin in (1..bins).rev() {
        span = span.union(spans[bin]);
        count += counts[bin];
        above[bin] = if count == 0 { f64::INFINITY } else { span.half_area() * side_cost(count) };
    }
    let mut best = (f64::INFINITY, 1);
    (span, count) = (Span::EMPTY, 0);
    for bin in 1..bins {
        span = span.union(spans[bin - 1]);
        count += counts[bin - 1];
        let cost = span.half_area() * side_cost(count) + above[bin];
        if count > 0 && cost < best.0 {
            best = (cost, bin);
        }
    }
    best
}

/// Moves those for which `is_low` holds to the front, in an order that depends on the input order alone; their number.
fn partition_in_place(primitives: &mut [Primitive], is_low: impl Fn(&Primitive) -> bool) -> usize {
    let (mut low, mut high) = (0, primitives.len());
    loop {
        while low < high && is_low(&primitives[low]) {
            low += 1;
        }
        while low < high && !is_low(&primitives[high - 1]) {
            high -= 1;
        }
        if low >= high {
            return low;
        }
        primitives.swap(low, high - 1);
    }
}
