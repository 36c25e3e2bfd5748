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
//! Spatial splits are not made here; they would add a second candidate in [`Splitter::best_split`].

use glam::{DVec3, Vec3A};

use super::collapse::{Costs, Plan};
use super::record::RecordLimits;
use crate::geometry::{Aabb, Triangle};

/// Most bins an axis.
const BINS: usize = 16;
/// Lists up to this length are not split, if one record can hold them.
const TERMINAL: usize = 3;
/// No path of the binary tree, so none of the 8-wide one, is longer: a file allows 64 nodes, of which the top tree may
/// take 22. Over a million triangles this leaves 20 levels more than a balanced tree has.
const DEPTH_LIMIT: u32 = 40;
/// Lists longer than this are built as two parallel tasks.
const PARALLEL: usize = 1 << 14;

/// A triangle's box and its number in canonical order; 32 bytes.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(16))]
pub(super) struct Primitive {
    min: [f32; 3],
    /// Number of the triangle in canonical order.
    pub id: u32,
    max: [f32; 3],
    spare: u32,
}

impl Primitive {
    /// The primitive of the triangle with canonical number `id`.
    pub fn new(id: u32, triangle: &Triangle) -> Primitive {
        let Aabb { min, max } = Aabb::from(triangle);
        Primitive { min: min.to_array(), id, max: max.to_array(), spare: 0 }
    }

    fn min(&self) -> Vec3A {
        Vec3A::from_array(self.min)
    }

    fn max(&self) -> Vec3A {
        Vec3A::from_array(self.max)
    }

    /// Half the centre of the box: no sum of finite coordinates, and no difference of two centres, overflows.
    fn centre(&self) -> Vec3A {
        0.25 * self.min() + 0.25 * self.max()
    }
}

/// A node of the binary tree; 44 bytes. Its left child is the next node.
#[derive(Clone, Debug)]
pub(super) struct BinaryNode {
    /// Lowest corner of its box, in the source's coordinates.
    pub min: [f32; 3],
    /// Highest corner.
    pub max: [f32; 3],
    /// Distance to the right child; 0 = no children.
    pub right: u32,
    /// First of its primitives.
    pub first: u32,
    /// How many there are.
    pub count: u32,
    /// What collapsing does with it.
    pub plan: Plan,
}

/// A box in registers.
#[derive(Clone, Copy, Debug)]
struct Span {
    min: Vec3A,
    max: Vec3A,
}

impl Span {
    const EMPTY: Span = Span { min: Vec3A::INFINITY, max: Vec3A::NEG_INFINITY };

    fn around(self, min: Vec3A, max: Vec3A) -> Span {
        Span { min: self.min.min(min), max: self.max.max(max) }
    }

    fn union(self, other: Span) -> Span {
        self.around(other.min, other.max)
    }

    /// Half the surface, 0 where empty. In f64: extents up to 2 FLT_MAX have finite areas, those of denormals are not 0.
    fn half_area(self) -> f64 {
        let wide = |v: Vec3A| DVec3::new(v.x.into(), v.y.into(), v.z.into());
        let d = (wide(self.max) - wide(self.min)).max(DVec3::ZERO);
        d.x * d.y + d.y * d.z + d.z * d.x
    }
}

/// Builds the tree in preorder; `primitives` end up in the order of its leaves. At least one primitive.
pub(super) fn build(primitives: &mut [Primitive], triangles: Canonical<'_>, limits: RecordLimits) -> Vec<BinaryNode> {
    let mut nodes = Vec::with_capacity(primitives.len());
    Splitter { triangles, limits }.subtree(primitives, 0, 0, &mut nodes);
    nodes
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
}

/// Where to split: below which bin of which axis.
#[derive(Clone, Copy)]
struct Split {
    axis: usize,
    bin: usize,
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
    /// Appends the subtree over `primitives`, the first of which is number `first` of all; returns its costs.
    fn subtree(&self, primitives: &mut [Primitive], first: usize, depth: u32, nodes: &mut Vec<BinaryNode>) -> Costs {
        let count = primitives.len();
        let (span, centres) = spans(primitives);
        let area = span.half_area();
        let here = nodes.len();
        nodes.push(BinaryNode {
            min: span.min.to_array(),
            max: span.max.to_array(),
            right: 0,
            first: first as u32,
            count: count as u32,
            plan: Plan::default(),
        });
        if count <= TERMINAL.min(self.limits.triangles) {
            return Costs::terminal(area);
        }

        let middle = self.partition(primitives, centres, depth);
        let (low, high) = primitives.split_at_mut(middle);
        let (left, right) = if count > PARALLEL {
            let mut other = Vec::with_capacity(high.len());
            let costs = rayon::join(
                || self.subtree(low, first, depth + 1, nodes),
                || self.subtree(high, first + middle, depth + 1, &mut other),
            );
            nodes[here].right = (nodes.len() - here) as u32;
            nodes.append(&mut other);
            costs
        } else {
            let left = self.subtree(low, first, depth + 1, nodes);
            nodes[here].right = (nodes.len() - here) as u32;
            (left, self.subtree(high, first + middle, depth + 1, nodes))
        };

        let is_record = self.limits.fit(primitives.iter().map(|p| self.triangles.triangle(p.id)));
        let (costs, plan) = Costs::of_parent(area, is_record, &left, &right);
        nodes[here].plan = plan;
        costs
    }

    /// Reorders the primitives into two parts, neither empty; the length of the first.
    fn partition(&self, primitives: &mut [Primitive], centres: Span, depth: u32) -> usize {
        let half = primitives.len() / 2;
        let Some(binning) = Binning::new(centres, primitives.len()) else { return half };
        if depth + ceil_log2(primitives.len()) >= DEPTH_LIMIT {
            let extent = (centres.max - centres.min).to_array();
            let axis = (1..3).fold(0, |best, axis| if extent[axis] > extent[best] { axis } else { best });
            let key = |p: &Primitive| p.centre()[axis];
            primitives.select_nth_unstable_by(half, |p, q| key(p).total_cmp(&key(q)).then(p.id.cmp(&q.id)));
            return half;
        }
        let split = self.best_split(primitives, &binning);
        let middle = partition_in_place(primitives, |p| binning.bin_on(split.axis, p) < split.bin);
        if middle == 0 || middle == primitives.len() { half } else { middle }
    }

    /// The split of least cost: area times number of primitives, summed over both sides.
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
        let mut best = (f64::INFINITY, Split { axis: 0, bin: 1 });
        for axis in 0..3 {
            if binning.scale[axis] > 0.0 {
                let (cost, bin) = cheapest_border(&spans[axis], &counts[axis], binning.bins);
                if cost < best.0 {
                    best = (cost, Split { axis, bin });
                }
            }
        }
        best.1
    }
}

/// Levels of a balanced tree over so many.
fn ceil_log2(count: usize) -> u32 {
    count.next_power_of_two().trailing_zeros()
}

/// The box of the primitives and the box of their centres.
fn spans(primitives: &[Primitive]) -> (Span, Span) {
    primitives.iter().fold((Span::EMPTY, Span::EMPTY), |(whole, centres), p| {
        let centre = p.centre();
        (whole.around(p.min(), p.max()), centres.around(centre, centre))
    })
}

/// The cheapest border between bins, named by the bin above it. Borders with nothing on one side do not count.
fn cheapest_border(spans: &[Span; BINS], counts: &[u32; BINS], bins: usize) -> (f64, usize) {
    let mut above = [0.0f64; BINS];
    let (mut span, mut count) = (Span::EMPTY, 0);
    for bin in (1..bins).rev() {
        span = span.union(spans[bin]);
        count += counts[bin];
        above[bin] = if count == 0 { f64::INFINITY } else { span.half_area() * f64::from(count) };
    }
    let mut best = (f64::INFINITY, 1);
    (span, count) = (Span::EMPTY, 0);
    for bin in 1..bins {
        span = span.union(spans[bin - 1]);
        count += counts[bin - 1];
        let cost = span.half_area() * f64::from(count) + above[bin];
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
