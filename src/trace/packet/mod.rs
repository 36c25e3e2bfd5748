//! Packets: up to 64 rays that run side by side go through the tree together.
//!
//! A node is tested once for all of them, by interval arithmetic (Boulos, Wald and Shirley, "Geometric and Arithmetic Culling
//! Methods for Entire Ray Packets", 2006): a plane's parameter lies between those of the extreme origins and directions. Where origins differ,
//! a slot is visited only if one of the rays touches its box too; at a leaf each ray does so by itself, sixteen in SIMD.
//! Then, if many of sixteen rays are left, each triangle is tested against all of them, else each ray against all triangles.
//!
//! Where the f32 filter is in doubt, ray and triangle are decided exactly at once. A ray whose hits lie too close together, or to an end
//! of its interval, for the bounds of t to tell leaves the packet, and is walked alone; so does one whose t, u or v f64 cannot round. So the
//! hits are those of single rays (of a triangle stored several times another copy may be named).
//!
//! Planes are computed in root units, not as parameters: a frame's corner is carried along as f32. That rounds as often as the walk of one ray
//! does (a step each level, the origin, the difference, the product), so that the slack of `setup.rs` holds; as the position
//! behind it, `eps (L + 8) (A + 3)`, it is taken off the planes themselves.

mod assemble;
mod leaf;
mod together;

use bytemuck::Zeroable;
use glam::Vec3;

use super::arch::{Block, Kernel, Rounded, Row, WIDE, Way};
use super::ask::{Answer, Ask};
use super::walk::{BRICK, EMPTY, File, INNER, LEVELS, Start};
use super::{Counters, Found};
use crate::exact::Depths;
use crate::format::{Frame, Node, PageId};
use crate::geometry::{FaceId, Hit, Ray, Skip, Triangle};
use crate::map::Halt;
use assemble::assemble;
use leaf::leaf;

/// Rays of a packet.
pub(super) const PACKET: usize = 64;
/// Sixteen rays each.
const GROUPS: usize = PACKET / WIDE;
/// Fewer rays than this are not worth a packet.
const LEAST: u32 = 8;

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

/// Triangles that f32 left in doubt, and those that f64 did too.
#[derive(Default)]
struct Work {
    doubts: u64,
    exact: u64,
}

/// What becomes of each ray: bits by group.
struct Rays {
    /// Still looking.
    live: [u32; GROUPS],
    /// To be walked alone.
    unsure: [u32; GROUPS],
    /// Beyond this nothing matters to any ray.
    far: f32,
    work: Work,
}

/// Whether neighbours among the rays run side by side, by a few samples.
pub(super) fn promising(rays: &[Ray]) -> bool {
    rays.len() >= LEAST as usize && alike(rays, WIDE - 1, 0.99)
}

/// Whether even the next ray goes elsewhere, by a few samples.
pub(super) fn scattered(rays: &[Ray]) -> bool {
    rays.len() > 1 && !alike(rays, 1, 0.7)
}

/// Whether most rays point where the ray so many places further on does, the cosine between them being greater than that.
fn alike(rays: &[Ray], apart: usize, least: f32) -> bool {
    const SAMPLES: usize = 8;
    let near = |a: &Ray, b: &Ray| {
        let dot = |p: [f32; 3], q: [f32; 3]| p[0] * q[0] + p[1] * q[1] + p[2] * q[2];
        let cosine = dot(a.direction, b.direction);
        let square = least * least * dot(a.direction, a.direction) * dot(b.direction, b.direction);
        cosine > 0.0 && cosine * cosine > square
    };
    let reach = (rays.len() - 1).min(apart);
    let samples = SAMPLES.min(rays.len() / (reach + 1)).max(1);
    let side_by_side = (0..samples).filter(|k| {
        let first = k * (rays.len() / samples);
        rays.get(first + reach).is_some_and(|other| near(&rays[first], other))
    });
    2 * side_by_side.count() >= samples
}

/// Walks up to 64 rays together and gives their answers, but for those rays that must be walked alone: bit i for `rays[i]`. Ends
/// at a page that is not in memory; then no answer holds.
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
) -> Result<u64, Halt> {
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
    counters.doubts += state.work.doubts;
    counters.exact += state.work.exact;
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
            *answer = A::Answer::NOTHING;
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
        *answer = A::Answer::of(Found { hit, triangle, page: PageId(group.page[i]), reference: group.reference[i] });
    }
    alone
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
    for (axis, &[first, last]) in sides.iter().enumerate() {
        let (inv, start) = (kernel.get(&group.inv[axis]), kernel.get(&group.start[axis]));
        enter = kernel.greater(kernel.fused(kernel.all(first), inv, start), enter);
        leave = kernel.lesser(kernel.fused(kernel.all(last), inv, start), leave);
    }
    kernel.at_most(enter, leave)
}
