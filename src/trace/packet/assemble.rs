//! Reads rays into columns, and finds what they have in common.

use super::super::arch::{Aim, Kernel, MODERATE, NEAR, WIDE, Way, greatest};
use super::super::setup::Scene;
use super::{Common, GROUPS, Group, LEAST, Rays, Work};
use crate::exact::Shear;
use crate::geometry::Ray;

/// How far apart a packet's slopes may be, and its origins in root sizes.
const SPREAD: [f32; 2] = [0.25, 0.03125];

/// Reads the rays and finds what they have in common; `None` where they are no packet.
#[inline(always)]
pub(super) fn assemble<K: Kernel>(
    kernel: K,
    scene: &Scene,
    rays: &[Ray],
    groups: &mut [Group; GROUPS],
) -> Option<(Common, Rays)> {
    let fit = &scene.fit;
    let leader = rays.first()?;
    let (mut way, mut aim) = (Way::default(), Aim::default());
    if rays.len() < LEAST as usize || !kernel.aim(leader, fit, &mut way, &mut aim) {
        return None;
    }
    way.visit(scene.turn);
    let d = leader.direction.map(f32::abs);
    let z = if d[0] > d[1] && d[0] > d[2] {
        0
    } else if d[1] > d[2] {
        1
    } else {
        2
    };
    let axes = [(z + 1) % 3, (z + 2) % 3, z];
    // The root's corner as the sum of two f32: the first difference is rounded by no more than the budget has for the origin.
    let split = [0, 1, 2].map(|i| {
        let high = fit.corner[i] as f32;
        [high, (fit.corner[i] - f64::from(high)) as f32]
    });
    if split.iter().any(|[_, low]| low.abs() > fit.side) {
        return None;
    }
    let mut state = Rays { live: [0; GROUPS], unsure: [0; GROUPS], far: f32::NEG_INFINITY, work: Work::default() };
    let (most, least) = (kernel.all(f32::INFINITY), kernel.all(f32::NEG_INFINITY));
    // Least and greatest origin in root units, origin, inv; slopes; |dz|.
    let mut origins = [[most, least]; 3];
    let mut places = [[most, least]; 3];
    let mut invs = [[most, least]; 3];
    let mut slopes = [[most, least]; 2];
    let mut depth = [most, least];
    let (mut nearest, mut farthest) = (most, least);
    let mut count = 0;
    for (g, sixteen) in rays.chunks(WIDE).enumerate().take(GROUPS) {
        let group = &mut groups[g];
        let present = u32::MAX >> (32 - sixteen.len());
        let columns = match sixteen.first_chunk() {
            Some(sixteen) => kernel.columns(sixteen),
            None => {
                let mut padded = [*leader; WIDE];
                padded[..sixteen.len()].copy_from_slice(sixteen);
                kernel.columns(&padded)
            }
        };
        let [ox, oy, oz, dx, dy, dz, tmin, tmax] = columns;
        let (origin, direction) = ([ox, oy, oz], [dx, dy, dz]);
        kernel.put(ox, &mut group.block.origin[0]);
        kernel.put(oy, &mut group.block.origin[1]);
        kernel.put(oz, &mut group.block.origin[2]);
        kernel.put(dx, &mut group.block.direction[0]);
        kernel.put(dy, &mut group.block.direction[1]);
        kernel.put(dz, &mut group.block.direction[2]);
        kernel.put(tmin, &mut group.tmin);
        kernel.put(tmax, &mut group.tmax);
        let mut ok = present;
        let mut place = [most; 3];
        let mut inv = [most; 3];
        for axis in 0..3 {
            let from = kernel.minus(origin[axis], kernel.all(split[axis][0]));
            let from = kernel.minus(from, kernel.all(split[axis][1]));
            let p = kernel.times(from, kernel.all(fit.scale as f32));
            ok &= kernel.at_most(kernel.size(p), kernel.all(NEAR as f32));
            let steep = kernel.size(direction[axis]);
            ok &= kernel.at_most(kernel.all(MODERATE[0]), steep) & kernel.at_most(steep, kernel.all(MODERATE[1]));
            let down = way.mask & (4 >> axis) != 0;
            let downward = kernel.below(direction[axis], kernel.all(0.0));
            ok &= if down { downward } else { !downward };
            inv[axis] = kernel.over(kernel.all(fit.side), direction[axis]);
            place[axis] = p;
            kernel.put(inv[axis], &mut group.inv[axis]);
            kernel.put(kernel.negative(kernel.times(p, inv[axis])), &mut group.start[axis]);
        }
        let [x, y, z] = axes;
        ok &= kernel.at_most(tmin, tmax);
        let slope = [kernel.over(direction[x], direction[z]), kernel.over(direction[y], direction[z])];
        ok &= kernel.at_most(kernel.size(slope[0]), kernel.all(Shear::STEEPEST));
        ok &= kernel.at_most(kernel.size(slope[1]), kernel.all(Shear::STEEPEST));
        kernel.put(slope[0], &mut group.slopes[0]);
        kernel.put(slope[1], &mut group.slopes[1]);
        kernel.put(kernel.over(kernel.all(1.0), direction[z]), &mut group.inverse);
        // A t that rounds into [tmin, tmax] lies at most one f32 step outside.
        let (a, b) = (kernel.all(1.0 - 2.0 * f32::EPSILON), kernel.all(1.0 + 2.0 * f32::EPSILON));
        let tiny = kernel.all(f32::MIN_POSITIVE);
        let near = kernel.minus(kernel.lesser(kernel.times(tmin, a), kernel.times(tmin, b)), tiny);
        let far = kernel.plus(kernel.greater(kernel.times(tmax, a), kernel.times(tmax, b)), tiny);
        kernel.put(near, &mut group.near);
        kernel.put(far, &mut group.far);
        kernel.put(most, &mut group.lo);
        kernel.put(most, &mut group.hi);
        for axis in 0..3 {
            origins[axis] = widen(kernel, ok, origin[axis], origins[axis]);
            places[axis] = widen(kernel, ok, place[axis], places[axis]);
            invs[axis] = widen(kernel, ok, inv[axis], invs[axis]);
        }
        slopes[0] = widen(kernel, ok, slope[0], slopes[0]);
        slopes[1] = widen(kernel, ok, slope[1], slopes[1]);
        depth = widen(kernel, ok, kernel.size(direction[z]), depth);
        nearest = kernel.choose(ok, kernel.lesser(near, nearest), nearest);
        farthest = kernel.choose(ok, kernel.greater(far, farthest), farthest);
        state.live[g] = ok;
        state.unsure[g] = present & !ok;
        count += ok.count_ones();
    }
    if count < LEAST || 2 * (count as usize) < rays.len() {
        return None;
    }
    for slope in slopes {
        let [low, high] = ends(kernel, slope);
        if high - low > SPREAD[0] {
            return None;
        }
    }
    let mut common = Common {
        way,
        axes,
        bound: [0.0; 2],
        offsets: [[0.0; 2]; 3],
        inv: [[0.0; 2]; 3],
        pad: [0.0; 3],
        near: kernel.least(nearest),
        focused: true,
        origin: leader.origin,
        skipping: false,
    };
    let (mut low, mut high) = ([0.0; 3], [0.0; 3]);
    for axis in 0..3 {
        let [first, last] = ends(kernel, places[axis]);
        if last - first > SPREAD[1] {
            return None;
        }
        [low[axis], high[axis]] = ends(kernel, origins[axis]);
        common.focused &= low[axis] == high[axis];
        common.inv[axis] = ends(kernel, invs[axis]);
        let pad = fit.rounding * ((if first.abs() > last.abs() { first.abs() } else { last.abs() }) + 3.01);
        let (before, beyond) = (-last - pad, pad - first);
        common.offsets[axis] = if way.mask & (4 >> axis) != 0 { [beyond, before] } else { [before, beyond] };
        common.pad[axis] = pad;
    }
    common.origin = low;
    state.far = greatest(kernel, farthest);
    common.bound = Shear::bound_of(low, high, ends(kernel, depth), scene.bounds);
    Some((common, state))
}

/// Least and greatest so far, of those lanes that count.
#[inline(always)]
fn widen<K: Kernel>(kernel: K, bits: u32, x: K::Floats, [low, high]: [K::Floats; 2]) -> [K::Floats; 2] {
    [kernel.choose(bits, kernel.lesser(x, low), low), kernel.choose(bits, kernel.greater(x, high), high)]
}

/// The least and the greatest of all lanes.
#[inline(always)]
fn ends<K: Kernel>(kernel: K, [low, high]: [K::Floats; 2]) -> [f32; 2] {
    [kernel.least(low), greatest(kernel, high)]
}
