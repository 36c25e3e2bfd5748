//! A leaf's triangles against a packet's rays: each ray in turn against all of them, or `together.rs`.

use super::super::arch::{Kernel, Row, WIDE, greatest};
use super::super::ask::Ask;
use super::super::collect::Stored;
use super::together::together;
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
pub(super) fn resolve<A: Ask>(
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
pub(super) fn keep<A: Ask>(stored: &Stored<'_>, group: &mut Group, taken: u32) {
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
