//! Where to split a list of whole triangles: the best of the borders between bins.
//!
//! After Wald (2007), "On fast construction of SAH-based bounding volume hierarchies": on each axis the centres of the boxes
//! fall into bins, fewer where the list is short. What the borders between bins cost is found in f32; those that may be the
//! cheapest by that, one as a rule, are compared in f64.

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
/// `span` is the box of the primitives.
pub(super) fn best_split(primitives: &[Primitive], span: Span, binning: &Binning, overlap: bool) -> Split {
    // Most lists are short, and then clearing the bins would take longer than filling them.
    match binning.bins {
        FEW => split_in::<FEW>(primitives, span, binning, overlap),
        SOME => split_in::<SOME>(primitives, span, binning, overlap),
        _ => split_in::<BINS>(primitives, span, binning, overlap),
    }
}

/// [`best_split`] with `N` bins.
fn split_in<const N: usize>(primitives: &[Primitive], span: Span, binning: &Binning, overlap: bool) -> Split {
    let mut axes = [const { Bins::<N>::EMPTY }; 3];
    for primitive in primitives {
        let (min, max) = (primitive.min(), primitive.max());
        for (axis, bin) in axes.iter_mut().zip(binning.bin::<N>(primitive)) {
            axis.spans[bin] = axis.spans[bin].around(min, max);
            axis.counts[bin] += 1;
        }
    }
    let rough = axes.each_ref().map(Bins::rough_costs);
    let bound = bound(rough.as_flattened(), span);
    let mut best = Split { axis: 0, bin: 1, below: 0, cost: f64::INFINITY, overlap: 0.0 };
    for (axis, (bins, rough)) in axes.iter().zip(&rough).enumerate() {
        for (bin, &cost) in rough.iter().enumerate().skip(1) {
            if cost <= bound || cost.is_nan() {
                bins.grade(axis, bin, &mut best);
            }
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

    /// What each border costs, named by the bin above it, in f32; infinite where nothing is on one side. Place 0 is no border.
    fn rough_costs(&self) -> [f32; N] {
        let mut costs = [f32::INFINITY; N];
        let (mut span, mut count) = (Span::EMPTY, 0);
        for bin in (1..N).rev() {
            span = span.union(self.spans[bin]);
            count += self.counts[bin];
            costs[bin] = span.rough_half_area() * (count + SIDE) as f32;
        }
        (span, count) = (Span::EMPTY, 0);
        for (cost, bin) in costs[1..].iter_mut().zip(0..N) {
            span = span.union(self.spans[bin]);
            count += self.counts[bin];
            *cost += span.rough_half_area() * (count + SIDE) as f32;
        }
        costs
    }

    /// Takes the border below `bin` if it is cheaper than `best`. A border with nothing on one side does not count.
    fn grade(&self, axis: usize, bin: usize, best: &mut Split) {
        let side = |bins: std::ops::Range<usize>| {
            let span = self.spans[bins.clone()].iter().fold(Span::EMPTY, |all, &span| all.union(span));
            (span, self.counts[bins].iter().sum::<u32>())
        };
        let [(low, below), (high, above)] = [side(0..bin), side(bin..N)];
        let cost = low.half_area() * side_cost(below) + high.half_area() * side_cost(above);
        if below > 0 && above > 0 && cost < best.cost {
            *best = Split { axis, bin, below: below as usize, cost, overlap: 0.0 };
        }
    }
}

/// A border whose rough cost is above this is not the cheapest; infinite where rough costs do not tell.
///
/// A rough cost is the true one but for eight roundings, 2^-21 of it, where nothing overflows and what underflows is negligible
/// beside the least cost. So the cheapest border's is at most 1 + 2^-20 times the least.
fn bound(rough: &[f32], span: Span) -> f32 {
    const MOST: f32 = (1u64 << 40) as f32;
    const LEAST: f32 = 1.0 / (1u128 << 90) as f32;
    const ERROR: f32 = 1.0 / (1 << 18) as f32;
    let least = rough.iter().fold(f32::INFINITY, |least, &cost| if cost < least { cost } else { least });
    let tells = (span.max - span.min).max_element() < MOST && least > LEAST;
    if tells { least * (1.0 + ERROR) } else { f32::INFINITY }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// The axis, bin and cost of the cheapest border, all being compared in f64.
    fn cheapest<const N: usize>(list: &[Primitive], binning: &Binning) -> (usize, usize, f64) {
        let mut best = (0, 1, f64::INFINITY);
        for (axis, bin) in (0..3).flat_map(|axis| (1..N).map(move |bin| (axis, bin))) {
            let (low, high): (Vec<_>, Vec<_>) = list.iter().partition(|p| binning.bin::<N>(p)[axis] < bin);
            let cost = |side: &[&Primitive]| {
                side.iter().fold(Span::EMPTY, |all, p| all.union(p.span())).half_area() * side_cost(side.len() as u32)
            };
            let both = cost(&low) + cost(&high);
            if !low.is_empty() && !high.is_empty() && both < best.2 {
                best = (axis, bin, both);
            }
        }
        best
    }

    proptest! {
        /// What is found roughly first is the cheapest border of all, the lowest of equal ones, whatever the scale.
        #[test]
        fn the_cheapest_border_is_found(
            boxes in prop::collection::vec(prop::array::uniform6(0.0f32..1.0), 2..100), flat in prop::array::uniform3(any::<bool>()),
            exponent in -140i32..124, whole in any::<bool>(),
        ) {
            let scale = glam::DVec3::from_array(flat.map(|flat| if flat { 0.0 } else { 2f64.powi(exponent) }));
            let place = |x: f32| if whole { (4.0 * x).floor() } else { x };
            let list: Vec<Primitive> = (0..).zip(&boxes).map(|(id, &[x, y, z, u, v, w])| {
                let at = |p: [f32; 3]| (Vec3A::from_array(p.map(place)).as_dvec3() * scale).as_vec3().to_array();
                Primitive { min: at([x, y, z]), id, max: at([x + u, y + v, z + w]), large: 0 }
            }).collect();
            let union = |all: Span, p: &Primitive| all.union(p.span());
            let span = list.iter().fold(Span::EMPTY, union);
            let centres = list.iter().fold(Span::EMPTY, |all, p| all.around(p.centre(), p.centre()));
            let Some(binning) = Binning::new(centres, list.len()) else { return Ok(()) };
            let expected = match binning.bins {
                FEW => cheapest::<FEW>(&list, &binning),
                SOME => cheapest::<SOME>(&list, &binning),
                _ => cheapest::<BINS>(&list, &binning),
            };
            let found = best_split(&list, span, &binning, false);
            prop_assert_eq!((found.axis, found.bin, found.cost), expected);
        }
    }
}
