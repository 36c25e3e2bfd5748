//! A leaf's triangles against a packet's rays.

use super::super::arch::{Kernel, Row, WIDE, greatest};
use super::super::ask::Ask;
use super::super::collect::Stored;
use super::{Asked, Common, GROUPS, Group, Rays, Work, meets};
use crate::exact::{Crossing, Decision, Depths, Line, Shear};
use crate::format::Coordinates;
use crate::geometry::{FaceId, Ray};

/// Up to so many rays of sixteen are tested one by one at a leaf: measured.
const FEW: u32 = 6;

/// Tests a leaf's triangles; whether anything changed for a ray.
#[inline(always)]
#[expect(clippy::too_many_arguments, reason = "the state of a walk")]
pub(super) fn leaf<K: Kernel, A: Ask>(
    kernel: K,
    common: &Common,
    stored: &Stored<'_>,
    asked: &Asked<'_, A>,
    groups: &mut [Group; GROUPS],
    sides: &[[f32; 2]; 3],
    state: &mut Rays,
    table: &mut [[Row; 4]; 32],
    depths: &mut Depths,
) -> bool {
    let mut changed = false;
    for (g, group) in groups.iter_mut().enumerate() {
        if state.live[g] == 0 {
            continue;
        }
        let active = state.live[g] & meets(kernel, group, sides);
        if active == 0 {
            continue;
        }
        let first = asked.first + WIDE * g;
        let (taken, doubted) = if active.count_ones() <= FEW {
            one_by_one(kernel, common, stored, (asked.ask, first), active, group, depths, &mut state.work)
        } else {
            together(kernel, common, stored, (asked.ask, first), active, group, table, &mut state.work)
        };
        changed |= taken | doubted != 0;
        state.unsure[g] |= doubted;
        if A::FIRST {
            state.live[g] &= !taken;
            state.unsure[g] &= !taken;
        } else {
            state.live[g] &= !doubted;
        }
    }
    if changed {
        let mut far = kernel.all(f32::NEG_INFINITY);
        for (group, &live) in groups.iter().zip(&state.live) {
            far = kernel.choose(live, kernel.greater(kernel.get(&group.far), far), far);
        }
        state.far = greatest(kernel, far);
    }
    changed
}

/// Decides exactly for some of sixteen rays whether they hit triangle `j` of a leaf, and keeps the bounds of those that are hit nearer; these
/// rays, and those for which the bounds do not tell.
#[cold]
#[inline(never)]
fn resolve<A: Ask>(
    stored: &Stored<'_>,
    j: u32,
    doubt: u32,
    (ask, first): (&A, usize),
    group: &mut Group,
    work: &mut Work,
) -> (u32, u32) {
    let triangle = stored.leaf.triangle(j as usize);
    let (mut taken, mut unsure, mut rest) = (0, 0, doubt);
    while rest != 0 {
        let i = rest.trailing_zeros() as usize & (WIDE - 1);
        rest &= rest - 1;
        work.doubts += 1;
        let of = |rows: &[Row; 3]| [rows[0].0[i], rows[1].0[i], rows[2].0[i]];
        let (tmin, tmax) = (group.tmin.0[i], group.tmax.0[i]);
        let ray = Ray { origin: of(&group.block.origin), direction: of(&group.block.direction), tmin, tmax };
        let Decision { crossing, exact } = Line::new(&ray).meet(&triangle);
        work.exact += u64::from(exact);
        let Some(Crossing { depth, .. }) = crossing else { continue };
        if ask.skip(first + i).has(stored.face(j)) {
            continue;
        }
        let (l, h) = ((depth[0] as f32).next_down(), (depth[1] as f32).next_up());
        if h < tmin || l > tmax || l > group.hi.0[i] {
            continue;
        }
        if l > tmin && h < tmax && h < group.lo.0[i] {
            (group.lo.0[i], group.hi.0[i], group.which[i]) = (l, h, j);
            taken |= 1 << i;
        } else {
            unsure |= 1 << i;
        }
    }
    (taken, unsure)
}

/// Tests all triangles against each ray in turn; the rays that were hit nearer, and those in doubt.
#[inline(always)]
#[expect(clippy::too_many_arguments, reason = "the state of a walk")]
fn one_by_one<K: Kernel, A: Ask>(
    kernel: K,
    common: &Common,
    stored: &Stored<'_>,
    (ask, first): (&A, usize),
    active: u32,
    group: &mut Group,
    depths: &mut Depths,
    work: &mut Work,
) -> (u32, u32) {
    let (mut taken, mut doubted) = (0, 0);
    let mut rest = active;
    while rest != 0 {
        let i = (rest.trailing_zeros() as usize) & (WIDE - 1);
        rest &= rest - 1;
        let [x, y, z] = common.axes;
        let origin = &group.block.origin;
        let origin = [origin[x.min(2)].0[i], origin[y.min(2)].0[i], origin[z.min(2)].0[i]];
        let slopes = [group.slopes[0].0[i], group.slopes[1].0[i]];
        let shear = Shear::assembled(common.axes, origin, slopes, group.inverse.0[i], common.bound);
        if !A::EXACT {
            let last = if group.hi.0[i] < group.tmax.0[i] { group.hi.0[i] } else { group.tmax.0[i] };
            if let Some(found) = kernel.nearest(&stored.leaf, &shear, [group.tmin.0[i], last]) {
                (group.lo.0[i], group.hi.0[i], group.which[i]) = (found.t, found.t, found.lane);
                (group.shares[0].0[i], group.shares[1].0[i]) = (found.u, found.v);
                taken |= 1 << i;
            }
            continue;
        }
        let (tmin, tmax, before, reach) = (group.tmin.0[i], group.tmax.0[i], group.lo.0[i], group.hi.0[i]);
        let lanes = kernel.classify(&stored.leaf, &shear, [tmin, if reach < tmax { reach } else { tmax }], depths);
        let mut doubt = false;
        // The nearest, as long as the bounds tell; NaN compares false.
        let (mut lo, mut hi, mut lane) = (f32::INFINITY, f32::INFINITY, None);
        let mut accepted = lanes.accept;
        while accepted != 0 {
            let j = accepted.trailing_zeros() & 15;
            accepted &= accepted - 1;
            if common.skipping && ask.skip(first + i).has(stored.face(j)) {
                continue;
            }
            let (l, h) = (depths.lo[j as usize], depths.hi[j as usize]);
            if l > tmin && h < tmax && h < lo {
                (lo, hi, lane) = (l, h, Some(j));
            } else {
                let behind = l > hi;
                doubt |= !behind;
            }
        }
        if let Some(j) = lane {
            if hi < before {
                (group.lo.0[i], group.hi.0[i], group.which[i]) = (lo, hi, j);
                taken |= 1 << i;
            } else {
                // The same triangle, stored in several leaves, has the same bounds.
                let behind = lo > reach;
                doubt |= !(behind || lo == before && hi == reach && group.face[i] == stored.face(j).0);
            }
        }
        doubted |= u32::from(doubt) << i;
        let mut left = lanes.doubt;
        while left != 0 && doubted >> i & 1 == 0 {
            let j = left.trailing_zeros() & 15;
            left &= left - 1;
            let (hit, unsure) = resolve(stored, j, 1 << i, (ask, first), group, work);
            taken |= hit;
            doubted |= unsure;
        }
    }
    keep::<A>(stored, group, if A::FIRST { 0 } else { taken & !doubted });
    (taken, doubted)
}

/// Keeps the triangles that rays hit.
#[inline(always)]
fn keep<A: Ask>(stored: &Stored<'_>, group: &mut Group, taken: u32) {
    let leaf = &stored.leaf;
    // Once a leaf, not once a hit.
    let floats = match [0, 1, 2].map(|axis| leaf.coordinates(axis)) {
        [Coordinates::Floats(x), Coordinates::Floats(y), Coordinates::Floats(z)] => Some([x, y, z]),
        _ => None,
    };
    let mut last = (u32::MAX, FaceId::NONE);
    let mut rest = taken;
    while rest != 0 {
        let i = rest.trailing_zeros() as usize & (WIDE - 1);
        rest &= rest - 1;
        let j = group.which[i];
        let block = &mut group.block;
        match floats {
            Some([x, y, z]) if A::EXACT => {
                let [a, b, c] = leaf.corners(j as usize);
                for (rows, k) in [(&mut block.a, a), (&mut block.b, b), (&mut block.c, c)] {
                    let (Some(&x), Some(&y), Some(&z)) = (x.get(k), y.get(k), z.get(k)) else { continue };
                    (rows[0].0[i], rows[1].0[i], rows[2].0[i]) = (x, y, z);
                }
            }
            None if A::EXACT => {
                let [a, b, c] = leaf.corner_points(j as usize).unwrap_or_default();
                for axis in 0..3 {
                    (block.a[axis].0[i], block.b[axis].0[i], block.c[axis].0[i]) = (a[axis], b[axis], c[axis]);
                }
            }
            _ => {}
        }
        if j != last.0 {
            last = (j, stored.face(j));
        }
        group.face[i] = last.1.0;
        group.page[i] = stored.id.0;
        group.reference[i] = leaf.first().wrapping_add(j);
        let reach = group.hi.0[i];
        group.far.0[i] = if reach < group.far.0[i] { reach } else { group.far.0[i] };
    }
}

/// Tests each triangle against all rays, much as [`Shear::classify`] does; the rays that were hit nearer, and those in doubt.
#[inline(always)]
#[expect(clippy::too_many_arguments, reason = "the state of a walk")]
fn together<K: Kernel, A: Ask>(
    kernel: K,
    common: &Common,
    stored: &Stored<'_>,
    (ask, first): (&A, usize),
    active: u32,
    group: &mut Group,
    table: &mut [[Row; 4]; 32],
    work: &mut Work,
) -> (u32, u32) {
    let leaf = &stored.leaf;
    let [ax, ay, az] = common.axes.map(|axis| axis.min(2));
    let tables: [[f32; 32]; 3];
    let [xs, ys, zs] = match [ax, ay, az].map(|axis| leaf.coordinates(axis)) {
        [Coordinates::Floats(x), Coordinates::Floats(y), Coordinates::Floats(z)] => [x, y, z],
        _ => {
            tables = [ax, ay, az].map(|axis| leaf.table(axis));
            [0, 1, 2].map(|k| &tables[k][..leaf.vertices()])
        }
    };
    let (ox, oy, oz) =
        (kernel.get(&group.block.origin[ax]), kernel.get(&group.block.origin[ay]), kernel.get(&group.block.origin[az]));
    let (sx, sy) = (kernel.get(&group.slopes[0]), kernel.get(&group.slopes[1]));
    let [x0, y0, z0] = [ax, ay, az].map(|axis| common.origin[axis]);
    for (row, ((&x, &y), &z)) in table.iter_mut().zip(xs.iter().zip(ys).zip(zs)) {
        let (wide, high, depth) = match common.focused {
            true => (kernel.all(x - x0), kernel.all(y - y0), kernel.all(z - z0)),
            false => {
                (kernel.minus(kernel.all(x), ox), kernel.minus(kernel.all(y), oy), kernel.minus(kernel.all(z), oz))
            }
        };
        // Rounded after each step, never fused: the bound of `exact/filter.rs` counts on it.
        let wide = kernel.minus(wide, kernel.times(sx, depth));
        let high = kernel.minus(high, kernel.times(sy, depth));
        kernel.put(wide, &mut row[0]);
        kernel.put(high, &mut row[1]);
        kernel.put(depth, &mut row[2]);
        if A::EXACT {
            kernel.put(kernel.greater(kernel.size(wide), kernel.size(high)), &mut row[3]);
        }
    }
    let (linear, constant) = (kernel.all(common.bound[0]), kernel.all(common.bound[1]));
    let (mut lo, mut hi) = (kernel.get(&group.lo), kernel.get(&group.hi));
    let (tmin, tmax) = (kernel.get(&group.tmin), kernel.get(&group.tmax));
    let (mut going, mut doubtful, mut taken) = (active, 0, 0);
    for j in 0..leaf.len() {
        let [a, b, c] = leaf.corners(j);
        let (a, b, c) = (&table[a & 31], &table[b & 31], &table[c & 31]);
        let (ax, ay) = (kernel.get(&a[0]), kernel.get(&a[1]));
        let (bx, by) = (kernel.get(&b[0]), kernel.get(&b[1]));
        let (cx, cy) = (kernel.get(&c[0]), kernel.get(&c[1]));
        let u = kernel.minus(kernel.times(bx, cy), kernel.times(by, cx));
        let v = kernel.minus(kernel.times(cx, ay), kernel.times(cy, ax));
        let w = kernel.minus(kernel.times(ax, by), kernel.times(ay, bx));
        if !A::EXACT {
            let least = kernel.lesser(kernel.lesser(u, v), w);
            let most = kernel.greater(kernel.greater(u, v), w);
            let hit = kernel.at_most(kernel.lesser(kernel.negative(least), most), kernel.all(0.0)) & going;
            if hit == 0 {
                continue;
            }
            let share = kernel.over(kernel.all(1.0), kernel.plus(kernel.plus(u, v), w));
            let (u, v, w) = (kernel.times(u, share), kernel.times(v, share), kernel.times(w, share));
            let (of_a, of_b) = (kernel.times(u, kernel.get(&a[2])), kernel.times(v, kernel.get(&b[2])));
            let sum = kernel.plus(kernel.plus(of_a, of_b), kernel.times(w, kernel.get(&c[2])));
            let t = kernel.times(sum, kernel.get(&group.inverse));
            let take = hit & kernel.at_most(tmin, t) & kernel.at_most(t, tmax) & kernel.below(t, lo);
            lo = kernel.choose(take, t, lo);
            hi = lo;
            let [old_u, old_v] = [kernel.get(&group.shares[0]), kernel.get(&group.shares[1])];
            kernel.put(kernel.choose(take, v, old_u), &mut group.shares[0]);
            kernel.put(kernel.choose(take, w, old_v), &mut group.shares[1]);
            if A::FIRST {
                going &= !take;
            }
            taken |= take;
            let mut rest = take;
            while rest != 0 {
                group.which[rest.trailing_zeros() as usize & (WIDE - 1)] = j as u32;
                rest &= rest - 1;
            }
            continue;
        }
        let m = kernel.greater(kernel.greater(kernel.get(&a[3]), kernel.get(&b[3])), kernel.get(&c[3]));
        let bound = kernel.fused(linear, m, constant);
        let least = kernel.lesser(kernel.lesser(u, v), w);
        let most = kernel.greater(kernel.greater(u, v), w);
        let q = kernel.lesser(kernel.negative(least), most);
        let miss = kernel.below(bound, q);
        let hit = kernel.below(q, kernel.negative(bound)) & going;
        let doubt = !(miss | hit) & going;
        if hit | doubt == 0 {
            continue;
        }
        let (mut take, mut tied) = (0, 0);
        if hit != 0 {
            let (za, zb, zc) = (kernel.get(&a[2]), kernel.get(&b[2]), kernel.get(&c[2]));
            let share = kernel.over(kernel.all(1.0), kernel.plus(kernel.plus(u, v), w));
            let of_a = kernel.times(kernel.times(u, share), za);
            let of_b = kernel.times(kernel.times(v, share), zb);
            let of_c = kernel.times(kernel.times(w, share), zc);
            let inverse = kernel.get(&group.inverse);
            let t = kernel.times(kernel.plus(kernel.plus(of_a, of_b), of_c), inverse);
            let most = kernel.greater(kernel.greater(za, zb), zc);
            let least = kernel.lesser(kernel.lesser(za, zb), zc);
            let scale = kernel.size(inverse);
            let [of_shape, of_depth, rest] = Shear::depth_factors(1.0);
            let shape = kernel.times(kernel.times(bound, kernel.size(share)), kernel.minus(most, least));
            let deepest = kernel.greater(kernel.size(most), kernel.size(least));
            let h = kernel.plus(kernel.times(shape, kernel.all(of_shape)), kernel.times(deepest, kernel.all(of_depth)));
            let h = kernel.times(kernel.plus(h, kernel.all(rest)), scale);
            let h = kernel.plus(h, kernel.all(f32::MIN_POSITIVE));
            let (l, h) = (kernel.minus(t, h), kernel.plus(t, h));
            let outside = kernel.below(h, tmin) | kernel.below(tmax, l) | kernel.below(hi, l);
            let inside = kernel.below(tmin, l) & kernel.below(h, tmax);
            let mut counts = hit & !outside;
            if common.skipping && counts != 0 {
                counts = without(stored, j, counts, (ask, first));
            }
            take = counts & inside & kernel.below(h, lo);
            tied = counts & !take;
            if tied != 0 {
                // The same triangle, stored in several leaves, has the same bounds. What was taken in this leaf is none of these.
                let twice = kernel.at_most(l, lo) & kernel.at_most(lo, l) & !taken;
                tied &= !(twice & same(stored, j, tied, group));
            }
            lo = kernel.choose(take, l, lo);
            hi = kernel.choose(take, h, hi);
        }
        let mut rest = take;
        while rest != 0 {
            group.which[rest.trailing_zeros() as usize & (WIDE - 1)] = j as u32;
            rest &= rest - 1;
        }
        if doubt != 0 {
            kernel.put(lo, &mut group.lo);
            kernel.put(hi, &mut group.hi);
            let (hit, unsure) = resolve(stored, j as u32, doubt, (ask, first), group, work);
            (lo, hi) = (kernel.get(&group.lo), kernel.get(&group.hi));
            take |= hit;
            tied |= unsure;
        }
        going &= if A::FIRST { !take } else { !tied };
        doubtful |= tied;
        taken |= take;
    }
    kernel.put(lo, &mut group.lo);
    kernel.put(hi, &mut group.hi);
    keep::<A>(stored, group, if A::FIRST { 0 } else { taken & !doubtful });
    (taken, doubtful)
}

/// Rays without those that leave a triangle out.
#[inline(always)]
fn without<A: Ask>(stored: &Stored<'_>, j: usize, bits: u32, (ask, first): (&A, usize)) -> u32 {
    let face = stored.face(j as u32);
    let (mut rest, mut kept) = (bits, bits);
    while rest != 0 {
        let i = rest.trailing_zeros();
        rest &= rest - 1;
        if ask.skip(first + i as usize).has(face) {
            kept &= !(1 << i);
        }
    }
    kept
}

/// Which of the rays have already seen a triangle of that face.
#[inline(never)]
fn same(stored: &Stored<'_>, j: usize, bits: u32, group: &Group) -> u32 {
    let face = stored.face(j as u32);
    let (mut rest, mut same) = (bits, 0);
    while rest != 0 {
        let i = rest.trailing_zeros();
        rest &= rest - 1;
        same |= u32::from(group.face[i as usize & (WIDE - 1)] == face.0) << i;
    }
    same
}
