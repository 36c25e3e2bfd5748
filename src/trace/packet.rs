//! Packets: up to 64 rays that run side by side go through the tree together.
//!
//! A node is tested once for all of them, by interval arithmetic (Boulos, Wald and Shirley, "Geometric and Arithmetic Culling
//! Methods for Entire Ray Packets", 2006): a plane's parameter lies between those of the extreme origins and directions. Where origins differ,
//! a slot is visited only if one of the rays touches its box too; at a leaf each ray does so by itself, sixteen in SIMD.
//! Then, if many of sixteen rays are left, each triangle is tested against all of them, else each ray against all triangles.
//!
//! The f32 filter decides here or not at all: a ray for which it is in doubt leaves the packet, and is walked alone. So
//! the answers are those of single rays.
//!
//! Planes are computed in root units, not as parameters: a frame's corner is carried along as f32. That rounds as often as the walk of one ray
//! does (a step each level, the origin, the difference, the product), so that the slack of `setup.rs` holds; as the position
//! behind it, `eps (L + 8) (A + 3)`, it is taken off the planes themselves.

use bytemuck::Zeroable;

use glam::Vec3;

use super::arch::{Aim, Block, Kernel, MODERATE, NEAR, Rounded, Row, WIDE, Way, greatest};
use super::ask::Ask;
use super::collect::Stored;
use super::setup::Scene;
use super::walk::{BRICK, EMPTY, File, INNER, LEVELS, Start};
use super::{Counters, Found};
use crate::error::Result;
use crate::exact::{Depths, Shear};
use crate::format::{Frame, Node, PageId};
use crate::geometry::{FaceId, Hit, Ray, Skip, Triangle};

/// Rays of a packet.
pub(super) const PACKET: usize = 64;
/// Sixteen rays each.
const GROUPS: usize = PACKET / WIDE;
/// Fewer rays than this are not worth a packet.
const LEAST: u32 = 8;
/// Up to so many rays of sixteen are tested one by one at a leaf: measured.
const FEW: u32 = 6;
/// How far apart a packet's slopes may be, and its origins in root sizes.
const SPREAD: [f32; 2] = [0.25, 0.03125];

/// Sixteen rays.
#[derive(Clone, Copy, Zeroable)]
#[repr(C)]
struct Group {
    /// Origins and directions, and the triangles that were hit; axes x, y, z.
    block: Block,
    /// Root side / direction.
    inv: [Row; 3],
    /// -(origin in root units) * inv.
    start: [Row; 3],
    /// dx / dz and dy / dz on the packet's axes.
    slopes: [Row; 2],
    /// 1 / dz.
    inverse: Row,
    tmin: Row,
    tmax: Row,
    /// A parameter below tmin, and the one beyond which nothing matters.
    near: Row,
    far: Row,
    /// Bounds of the t of what was hit.
    lo: Row,
    hi: Row,
    /// u and v where they are not rounded from the triangle.
    shares: [Row; 2],
    /// What was hit: its face, its page, its number there; and meanwhile, in a leaf.
    face: [u32; WIDE],
    page: [u32; WIDE],
    reference: [u32; WIDE],
    which: [u32; WIDE],
}

/// A node put aside.
#[derive(Clone, Copy, Zeroable)]
#[repr(C)]
struct Level {
    /// Where slots are entered at the earliest, in the order of visits.
    bounds: Row,
    corner: [f32; 3],
    unit: [f32; 3],
    node: u32,
    page: u32,
    left: u32,
    unused: u32,
}

/// What a thread keeps for packets.
#[derive(Clone, Copy, Zeroable)]
#[repr(C)]
pub(super) struct Space {
    groups: [Group; GROUPS],
    /// A leaf's vertices as sixteen rays see them: x, y, z and the larger of |x| and |y|.
    table: [[Row; 4]; 32],
    levels: [Level; LEVELS],
}

/// What all rays of a packet have in common.
struct Common {
    way: Way,
    /// Which ray axes play x, y, z in the sheared space.
    axes: [usize; 3],
    bound: [f32; 2],
    /// Added to a corner: by which a slot is entered, and by which it is left.
    offsets: [[f32; 2]; 3],
    /// The extremes of inv.
    inv: [[f32; 2]; 3],
    /// By how much planes are moved outward.
    pad: [f32; 3],
    near: f32,
    /// Whether all start at one point, and that point.
    focused: bool,
    origin: [f32; 3],
    /// Whether some ray leaves out a face.
    skipping: bool,
}

/// Rays and what is asked about them.
pub(super) struct Asked<'r, A> {
    pub ask: &'r A,
    /// The number of the first of the rays among those that `ask` knows.
    pub first: usize,
    pub rays: &'r [Ray],
}

/// What becomes of each ray: bits by group.
struct Rays {
    /// Still looking.
    live: [u32; GROUPS],
    /// To be walked alone.
    unsure: [u32; GROUPS],
    /// Beyond this nothing matters to any ray.
    far: f32,
}

/// Whether neighbours among the rays run side by side, by a few samples.
pub(super) fn promising(rays: &[Ray]) -> bool {
    const SAMPLES: usize = 8;
    let near = |a: &Ray, b: &Ray| {
        let dot = |p: [f32; 3], q: [f32; 3]| p[0] * q[0] + p[1] * q[1] + p[2] * q[2];
        let cosine = dot(a.direction, b.direction);
        cosine > 0.0 && cosine * cosine > 0.98 * dot(a.direction, a.direction) * dot(b.direction, b.direction)
    };
    if rays.len() < LEAST as usize {
        return false;
    }
    let reach = (rays.len() - 1).min(WIDE - 1);
    let samples = SAMPLES.min(rays.len() / (reach + 1)).max(1);
    let side_by_side = (0..samples).filter(|k| {
        let first = k * (rays.len() / samples);
        rays.get(first + reach).is_some_and(|other| near(&rays[first], other))
    });
    2 * side_by_side.count() >= samples
}

/// Walks up to 64 rays together and gives their answers, but for those rays that must be walked alone: bit i for `rays[i]`.
#[inline(always)]
#[expect(clippy::too_many_arguments, reason = "the state of a batch")]
pub(super) fn walk<K: Kernel, A: Ask>(
    kernel: K,
    file: &File<'_>,
    start: &Start<'_>,
    asked: Asked<'_, A>,
    answers: &mut [A::Answer],
    space: &mut Space,
    depths: &mut Depths,
    counters: &mut Counters,
) -> Result<u64> {
    let rays = asked.rays;
    let all = u64::MAX >> (64 - rays.len().clamp(1, PACKET));
    let Space { groups, table, levels } = space;
    let Some((common, mut state)) = assemble(kernel, file.scene, rays, groups) else { return Ok(all) };
    let mut common = common;
    common.skipping = (0..rays.len()).any(|i| asked.ask.skip(asked.first + i) != Skip::NONE);
    let mask = usize::from(common.way.order & 7);
    let mut view = start.view;
    let (mut corner, mut unit) = (start.cell.corner, start.cell.unit);
    let (mut top, mut index) = (0usize, 0u32);
    let mut node = view.node(index);
    let mut bounds = touch(kernel, &common, node, corner, unit, state.far);
    let mut left = kernel.overlap(bounds);
    let (mut nodes, mut bricks) = (1, u64::from(view.page.is_some()));
    'walk: loop {
        while left == 0 {
            if top == 0 {
                break 'walk;
            }
            top -= 1;
            let level = &levels[top];
            bounds = kernel.get(&level.bounds);
            left = level.left & kernel.at_most(bounds, kernel.all(state.far));
            (corner, unit, index) = (level.corner, level.unit, level.node);
            if left != 0 && level.page != view.number {
                view = file.view(level.page)?;
            }
            node = view.node(index);
        }
        let slot = (left.trailing_zeros() & 7) as usize ^ mask;
        left &= left - 1;
        let byte = node.slots[slot];
        if byte < EMPTY {
            let Some(stored) = file.stored(&view, index, node, byte, counters) else { continue };
            let sides = sides(&common, node, slot, corner, unit);
            if leaf(kernel, &common, &stored, &asked, groups, &sides, &mut state, table, depths) {
                if state.live == [0; GROUPS] {
                    break 'walk;
                }
                left &= kernel.at_most(bounds, kernel.all(state.far));
            }
            continue;
        }
        let inner = byte & 0xc0 == INNER && node.first_child != 0;
        let brick = byte & BRICK == BRICK && view.page.is_none();
        if !(inner || brick) {
            continue;
        }
        if !common.focused {
            let sides = sides(&common, node, slot, corner, unit);
            let mut touched = 0;
            for (group, live) in groups.iter().zip(state.live) {
                if live != 0 {
                    touched |= live & meets(kernel, group, &sides);
                }
            }
            if touched == 0 {
                continue;
            }
        }
        if left != 0 {
            let level = &mut levels[top];
            kernel.put(bounds, &mut level.bounds);
            (level.corner, level.unit, level.node, level.page, level.left) = (corner, unit, index, view.number, left);
            top = (top + 1).min(LEVELS - 1);
        }
        if inner {
            for axis in 0..3 {
                let (low, high) = (node.low[axis][slot], node.high[axis][slot]);
                corner[axis] += f32::from(low) * unit[axis];
                let smaller = unit[axis] * Frame::shrink(low, high) as f32;
                unit[axis] = if smaller < Frame::LEAST_UNIT as f32 { Frame::LEAST_UNIT as f32 } else { smaller };
            }
            index = index.wrapping_add(node.first_child).wrapping_add(u32::from(byte & 7));
        } else {
            let number = node.first_leaf.wrapping_add(u32::from(byte & 0x3f));
            let Some(brick) = file.brick(number) else {
                left = 0;
                continue;
            };
            bricks += 1;
            view = file.view(number)?;
            (index, corner, unit) = (0, brick.corner, brick.unit);
        }
        node = view.node(index);
        nodes += 1;
        bounds = touch(kernel, &common, node, corner, unit, state.far);
        left = kernel.overlap(bounds);
    }
    counters.nodes += nodes;
    counters.bricks += bricks;
    let mut alone = 0;
    for (g, answers) in answers.chunks_mut(WIDE).enumerate().take(GROUPS) {
        let unsure = state.unsure[g] | conclude::<K, A>(kernel, &groups[g], !state.unsure[g], answers);
        alone |= u64::from(unsure) << (WIDE * g);
    }
    Ok(alone & all)
}

/// Gives the answers to those of sixteen rays whose bit is set; the rays which f64 does not suffice for.
#[inline(always)]
fn conclude<K: Kernel, A: Ask>(kernel: K, group: &Group, done: u32, answers: &mut [A::Answer]) -> u32 {
    // A ray that hit nothing still has its bounds at infinity.
    let hit = done & kernel.below(kernel.get(&group.lo), kernel.all(f32::INFINITY));
    let mut rounded = Rounded::zeroed();
    let block = &group.block;
    if !A::EXACT {
        rounded = Rounded { t: group.lo, u: group.shares[0], v: group.shares[1], certain: hit };
    } else if !A::FIRST && hit != 0 {
        kernel.rounded(block, hit, &mut rounded);
    }
    let mut alone = 0;
    for (i, answer) in answers.iter_mut().enumerate().take(WIDE) {
        if done >> i & 1 == 0 {
            continue;
        }
        if hit >> i & 1 == 0 {
            *answer = A::NOTHING;
            continue;
        }
        // A page that turned to zeros has no faces.
        if !A::FIRST && (rounded.certain >> i & 1 == 0 || group.face[i] == FaceId::NONE.0) {
            alone |= 1 << i;
            continue;
        }
        let face = FaceId(group.face[i]);
        let hit = Hit { t: rounded.t.0[i], face, u: rounded.u.0[i], v: rounded.v.0[i] };
        let corner = |rows: &[Row; 3]| Vec3::new(rows[0].0[i], rows[1].0[i], rows[2].0[i]);
        let triangle = Triangle { a: corner(&block.a), b: corner(&block.b), c: corner(&block.c) };
        *answer = A::answer(Found { hit, triangle, page: PageId(group.page[i]), reference: group.reference[i] });
    }
    alone
}

/// Reads the rays and finds what they have in common; `None` where they are no packet.
#[inline(always)]
fn assemble<K: Kernel>(kernel: K, scene: &Scene, rays: &[Ray], groups: &mut [Group; GROUPS]) -> Option<(Common, Rays)> {
    let fit = &scene.fit;
    let leader = rays.first()?;
    let (mut way, mut aim) = (Way::default(), Aim::default());
    if rays.len() < LEAST as usize || !kernel.aim(leader, fit, &mut way, &mut aim) {
        return None;
    }
    way.order = way.mask ^ scene.turn;
    let d = leader.direction.map(f32::abs);
    let z = if d[0] > d[1] && d[0] > d[2] {
        0
    } else if d[1] > d[2] {
        1
    } else {
        2
    };
    let axes = [(z + 1) % 3, (z + 2) % 3, z];
    // The root's corner as the sum of two f32: the first difference is exact where it matters.
    let split = [0, 1, 2].map(|i| {
        let high = fit.corner[i] as f32;
        [high, (fit.corner[i] - f64::from(high)) as f32]
    });
    if split.iter().any(|[_, low]| low.abs() > fit.side) {
        return None;
    }
    let mut state = Rays { live: [0; GROUPS], unsure: [0; GROUPS], far: f32::NEG_INFINITY };
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

/// For each entry of a node a lower bound of the parameters at which rays enter its slot, and behind these eight the negated upper bounds of
/// those at which they leave it.
#[inline(always)]
fn touch<K: Kernel>(kernel: K, common: &Common, node: &Node, corner: [f32; 3], unit: [f32; 3], far: f32) -> K::Floats {
    let planes = kernel.planes(node, &common.way);
    let mut bounds = kernel.halves(common.near, -far);
    for axis in 0..3 {
        let [enter, leave] = common.offsets[axis];
        let base = kernel.halves(corner[axis] + enter, corner[axis] + leave);
        let plane = kernel.fused(planes[axis], kernel.all(unit[axis]), base);
        let [a, b] = common.inv[axis];
        let t = kernel.lesser(kernel.times(plane, kernel.halves(a, -a)), kernel.times(plane, kernel.halves(b, -b)));
        bounds = kernel.greater(t, bounds);
    }
    bounds
}

/// The planes by which a slot is entered and left, padded.
#[inline(always)]
fn sides(common: &Common, node: &Node, slot: usize, corner: [f32; 3], unit: [f32; 3]) -> [[f32; 2]; 3] {
    let mut sides = [[0.0; 2]; 3];
    for axis in 0..3 {
        let low = corner[axis] + f32::from(node.low[axis][slot & 7]) * unit[axis] - common.pad[axis];
        let high = corner[axis] + f32::from(node.high[axis][slot & 7]) * unit[axis] + common.pad[axis];
        sides[axis] = if common.way.mask & (4 >> axis) != 0 { [high, low] } else { [low, high] };
    }
    sides
}

/// Which of sixteen rays touch a box.
#[inline(always)]
fn meets<K: Kernel>(kernel: K, group: &Group, sides: &[[f32; 2]; 3]) -> u32 {
    let (mut enter, mut leave) = (kernel.get(&group.near), kernel.get(&group.far));
    for axis in 0..3 {
        let (inv, start) = (kernel.get(&group.inv[axis]), kernel.get(&group.start[axis]));
        let [first, last] = sides[axis];
        enter = kernel.greater(kernel.fused(kernel.all(first), inv, start), enter);
        leave = kernel.lesser(kernel.fused(kernel.all(last), inv, start), leave);
    }
    kernel.at_most(enter, leave)
}

/// Tests a leaf's triangles; whether anything changed for a ray.
#[inline(always)]
#[expect(clippy::too_many_arguments, reason = "the state of a walk")]
fn leaf<K: Kernel, A: Ask>(
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
    for g in 0..GROUPS {
        if state.live[g] == 0 {
            continue;
        }
        let group = &mut groups[g];
        let active = state.live[g] & meets(kernel, group, sides);
        if active == 0 {
            continue;
        }
        let first = asked.first + WIDE * g;
        let (taken, doubted) = if active.count_ones() <= FEW {
            one_by_one(kernel, common, stored, (asked.ask, first), active, group, depths)
        } else {
            together(kernel, common, stored, (asked.ask, first), active, group, table)
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

/// Tests all triangles against each ray in turn; the rays that were hit nearer, and those in doubt.
#[inline(always)]
fn one_by_one<K: Kernel, A: Ask>(
    kernel: K,
    common: &Common,
    stored: &Stored<'_>,
    (ask, first): (&A, usize),
    active: u32,
    group: &mut Group,
    depths: &mut Depths,
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
        let mut doubt = lanes.doubt != 0;
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
            } else if !(l > hi) {
                doubt = true;
            }
        }
        if let Some(j) = lane {
            if hi < before {
                (group.lo.0[i], group.hi.0[i], group.which[i]) = (lo, hi, j);
                taken |= 1 << i;
            } else if !(lo > reach) {
                // The same triangle, stored in several leaves, has the same bounds.
                doubt |= !(lo == before && hi == reach && group.face[i] == stored.face(j).0);
            }
        }
        doubted |= u32::from(doubt) << i;
    }
    keep::<A>(stored, group, if A::FIRST { 0 } else { taken & !doubted });
    (taken, doubted)
}

/// Keeps the triangles that rays hit.
#[inline(always)]
fn keep<A: Ask>(stored: &Stored<'_>, group: &mut Group, taken: u32) {
    let leaf = &stored.leaf;
    let (x, y, z) = (leaf.coordinates(0), leaf.coordinates(1), leaf.coordinates(2));
    let mut last = (u32::MAX, FaceId::NONE);
    let mut rest = taken;
    while rest != 0 {
        let i = rest.trailing_zeros() as usize & (WIDE - 1);
        rest &= rest - 1;
        let j = group.which[i];
        let [a, b, c] = leaf.corners(j as usize);
        let corners = if A::EXACT { 3 } else { 0 };
        for (rows, k) in
            [(&mut group.block.a, a), (&mut group.block.b, b), (&mut group.block.c, c)].into_iter().take(corners)
        {
            let (Some(&x), Some(&y), Some(&z)) = (x.get(k), y.get(k), z.get(k)) else { continue };
            (rows[0].0[i], rows[1].0[i], rows[2].0[i]) = (x, y, z);
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
fn together<K: Kernel, A: Ask>(
    kernel: K,
    common: &Common,
    stored: &Stored<'_>,
    (ask, first): (&A, usize),
    active: u32,
    group: &mut Group,
    table: &mut [[Row; 4]; 32],
) -> (u32, u32) {
    let leaf = &stored.leaf;
    let [ax, ay, az] = common.axes.map(|axis| axis.min(2));
    let (xs, ys, zs) = (leaf.coordinates(ax), leaf.coordinates(ay), leaf.coordinates(az));
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
        let mut doubt = !(miss | hit) & going;
        if hit | doubt == 0 {
            continue;
        }
        let mut take = 0;
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
            let mut tied = counts & !take;
            if tied != 0 {
                // The same triangle, stored in several leaves, has the same bounds. What was taken in this leaf is none of these.
                let twice = kernel.at_most(l, lo) & kernel.at_most(lo, l) & !taken;
                tied &= !(twice & same(stored, j, tied, group));
            }
            doubt |= tied;
            lo = kernel.choose(take, l, lo);
            hi = kernel.choose(take, h, hi);
        }
        if A::FIRST {
            going &= !take;
        } else {
            going &= !doubt;
        }
        doubtful |= doubt;
        taken |= take;
        let mut rest = take;
        while rest != 0 {
            group.which[rest.trailing_zeros() as usize & (WIDE - 1)] = j as u32;
            rest &= rest - 1;
        }
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
