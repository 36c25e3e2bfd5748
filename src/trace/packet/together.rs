//! Each triangle of a leaf against sixteen rays of a packet at once.

use super::super::arch::{Kernel, Row, WIDE};
use super::super::ask::Ask;
use super::super::collect::Stored;
use super::leaf::{keep, resolve};
use super::{Common, Group, Work};
use crate::exact::Shear;
use crate::format::Coordinates;

/// Tests each triangle against all rays, much as [`Shear::classify`] does; the rays that were hit nearer, and those in doubt.
#[inline(always)]
#[expect(clippy::too_many_arguments, reason = "the state of a walk")]
pub(super) fn together<K: Kernel, A: Ask>(
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
            note(group, take, j as u32);
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
        note(group, take, j as u32);
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

/// Notes for these rays that triangle `j` of the leaf is the one that they hit.
#[inline(always)]
fn note(group: &mut Group, rays: u32, j: u32) {
    let mut rest = rays;
    while rest != 0 {
        group.which[rest.trailing_zeros() as usize & (WIDE - 1)] = j;
        rest &= rest - 1;
    }
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
