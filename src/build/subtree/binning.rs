//! Where to split a list of whole triangles: the best of the borders between bins.
//!
//! After Wald (2007), "On fast construction of SAH-based bounding volume hierarchies": on each axis the centres of the boxes
//! fall into bins, fewer where the list is short.

use glam::Vec3A;

use super::primitive::{Primitive, Span};

/// Most bins an axis. From 16 to 32 rays visit 2 % fewer nodes of a scan in one brick; from 32 to 64 another 1 %, at a
/// price of 15 % in building.
const BINS: usize = 32;
/// Bins of short lists.
const SOME: usize = BINS / 2;
/// Bins of very short ones.
const FEW: usize = BINS / 4;
/// So many triangles are added to each side's number where splits are compared: a leaf costs the same for few as for many, so even
/// an all but empty side is not free. Makes about 1 % fewer visits than 0; 2 to 8 measure alike.
const SIDE: u32 = 4;

/// Where to split: below which bin of which axis; what that costs, and how much of both sides' boxes is the same.
#[derive(Clone, Copy)]
pub(super) struct Split {
    pub axis: usize,
    pub bin: usize,
    /// How many centres lie below.
    pub below: usize,
    pub cost: f64,
    pub overlap: f64,
}

/// How centres fall into bins.
#[derive(Clone, Copy)]
pub(super) struct Binning {
    low: Vec3A,
    scale: Vec3A,
    bins: usize,
}

impl Binning {
    /// `None` if all centres are the same.
    pub fn new(centres: Span, count: usize) -> Option<Binning> {
        let extent = centres.max - centres.min;
        let bins = match count {
            ..=16 => FEW,
            17..=64 => SOME,
            _ => BINS,
        };
        // An axis without extent gets scale 0: all in bin 0, no split. One of denormal extent may get an infinite
        // scale: its least centre then gives 0 * inf = NaN, which goes to bin 0.
        let scale = Vec3A::select(extent.cmpgt(Vec3A::ZERO), Vec3A::splat(bins as f32) / extent, Vec3A::ZERO);
        (extent.max_element() > 0.0).then_some(Binning { low: centres.min, scale, bins })
    }

    /// The bins of `N`, which must be as many as the binning has.
    #[inline(always)]
    fn bin<const N: usize>(&self, primitive: &Primitive) -> [usize; 3] {
        // What is added leaves no room for a fraction, so that the low bits hold the nearest whole number, all three axes at
        // once; the one below is wanted. A NaN ends as bin 0, in whatever way the processor takes it through.
        const WHOLE: Vec3A = Vec3A::splat((1 << 23) as f32);
        let place = (primitive.centre() - self.low) * self.scale;
        let place = place.max(Vec3A::ZERO).min(Vec3A::splat((N - 1) as f32));
        let nearest = place + WHOLE;
        let passed = Vec3A::select((nearest - WHOLE).cmpgt(place), Vec3A::ONE, Vec3A::ZERO);
        (nearest - passed).to_array().map(|place| place.to_bits() as usize % N)
    }

    /// Whether a primitive falls into a bin below `bin` (above 0) on an axis: the same operations as for all axes, so the
    /// same bin. NaN is below.
    #[inline(always)]
    pub fn is_below(&self, axis: usize, bin: usize, primitive: &Primitive) -> bool {
        let centre = 0.25 * primitive.min[axis] + 0.25 * primitive.max[axis];
        let place = (centre - self.low[axis]) * self.scale[axis];
        place < bin as f32 || place.is_nan()
    }
}

/// The split of least cost: area times [`side_cost`], summed over both sides; `overlap`: whether to say how much they share.
pub(super) fn best_split(primitives: &[Primitive], binning: &Binning, overlap: bool) -> Split {
    // Most lists are short, and then clearing the bins would take longer than filling them.
    match binning.bins {
        FEW => split_in::<FEW>(primitives, binning, overlap),
        SOME => split_in::<SOME>(primitives, binning, overlap),
        _ => split_in::<BINS>(primitives, binning, overlap),
    }
}

/// [`best_split`] with `N` bins.
fn split_in<const N: usize>(primitives: &[Primitive], binning: &Binning, overlap: bool) -> Split {
    let mut axes = [const { Bins::<N>::EMPTY }; 3];
    for primitive in primitives {
        let (min, max) = (primitive.min(), primitive.max());
        for (axis, bin) in axes.iter_mut().zip(binning.bin::<N>(primitive)) {
            axis.spans[bin] = axis.spans[bin].around(min, max);
            axis.counts[bin] += 1;
        }
    }
    let mut best = Split { axis: 0, bin: 1, below: 0, cost: f64::INFINITY, overlap: 0.0 };
    for (axis, bins) in axes.iter().enumerate() {
        if binning.scale[axis] > 0.0 {
            bins.cheapest_border(axis, &mut best);
        }
    }
    if overlap {
        let union = |spans: &[Span]| spans.iter().fold(Span::EMPTY, |all, &span| all.union(span));
        let (low, high) = axes[best.axis].spans.split_at(best.bin);
        let common = union(low).common(union(high));
        best.overlap = if common.is_empty() { 0.0 } else { common.half_area() };
    }
    best
}

/// What a side of so many costs, per unit of area.
pub(super) fn side_cost(count: u32) -> f64 {
    f64::from(count + SIDE)
}

/// The bins of an axis.
struct Bins<const N: usize> {
    spans: [Span; N],
    counts: [u32; N],
}

impl<const N: usize> Bins<N> {
    const EMPTY: Bins<N> = Bins { spans: [Span::EMPTY; N], counts: [0; N] };

    /// The cheapest border between bins, named by the bin above it, if it is cheaper than `best`. Borders with nothing on
    /// one side do not count, and of those with only empty bins between them the lowest stands for all.
    fn cheapest_border(&self, axis: usize, best: &mut Split) {
        const { assert!(N <= 32 && N.is_power_of_two(), "a bit for each bin") };
        let taken = self.counts.iter().rev().fold(0u32, |bits, &count| bits << 1 | u32::from(count > 0));
        let mut above = [0.0f64; N];
        let (mut span, mut count, mut rest) = (Span::EMPTY, 0, taken);
        while rest & rest.wrapping_sub(1) != 0 {
            let bin = rest.ilog2() as usize;
            rest ^= 1 << bin;
            span = span.union(self.spans[bin]);
            count += self.counts[bin];
            above[bin] = span.half_area() * side_cost(count);
        }
        (span, count, rest) = (Span::EMPTY, 0, taken);
        while rest & rest.wrapping_sub(1) != 0 {
            let bin = rest.trailing_zeros() as usize;
            rest &= rest - 1;
            span = span.union(self.spans[bin]);
            count += self.counts[bin];
            let cost = span.half_area() * side_cost(count) + above[rest.trailing_zeros() as usize];
            if cost < best.cost {
                *best = Split { axis, bin: bin + 1, below: count as usize, cost, overlap: 0.0 };
            }
        }
    }
}
