//! Short rays, up to 64 of them together: whether anything lies in the way of each.
//!
//! The box around a ray that is short beside the triangles touches hardly more than one box a level, and those of its neighbours touch
//! the same ones. So their boxes go through the tree together, each node being read and unpacked once for all that touch
//! it, and only at a leaf does each ray whose box touches the leaf's meet the triangles, as in the walk of one ray.
//!
//! Boxes are those of the ray's whole interval, in root units: computed in f64, within 2^-50 of the numbers involved, then rounded to f32 and widened
//! by 2^-22 of these, which covers the rounding of a node's planes to f32 (two of 2^-25) as well. A hit lies in the box of a
//! leaf that stores its triangle, and in the ray's: so no hit is lost, and what decides it is the triangle's own test.

use super::Counters;
use super::arch::{Job, Kernel, Row, WIDE};
use crate::exact::{Decision, Depths, Line, Shear};
use crate::format::{Frame, Leaf, Node, PageId, Slot};
use crate::geometry::{FaceId, Ray, RootCube, Skip};
use crate::map::{Halt, Page, Visit};

/// Rays that go together.
const GROUP: usize = 64;
/// 2^-22.
const WIDEN: f64 = 1.0 / 4_194_304.0;
/// In place of a page: the top.
const TOP: u32 = u32::MAX;

/// Short rays to be answered with whichever kernel is there.
pub(super) struct Near<'a, 'w> {
    pub visit: &'a Visit<'a>,
    pub rays: &'w [Ray],
    pub skips: &'w [Skip],
    pub blocked: &'w mut [bool],
    pub counters: &'w mut Counters,
}

/// A node to be visited, and the rays whose boxes touch it.
struct Open {
    /// Its page, or [`TOP`].
    page: u32,
    node: u32,
    frame: Frame,
    rays: u64,
}

impl Job for Near<'_, '_> {
    type Output = Result<(), Halt>;

    #[inline(always)]
    fn run<K: Kernel>(self, kernel: K) -> Result<(), Halt> {
        let Near { visit, rays, skips, blocked, counters } = self;
        let mut group = Group::default();
        let mut open = Vec::new();
        for ((rays, skips), blocked) in rays.chunks(GROUP).zip(skips.chunks(GROUP)).zip(blocked.chunks_mut(GROUP)) {
            counters.rays += rays.len() as u64;
            group.enclose(rays, visit.octree().root());
            let met = group.walk(kernel, visit, rays, skips, &mut open, counters)?;
            for (i, blocked) in blocked.iter_mut().enumerate() {
                *blocked = met >> i & 1 != 0;
            }
        }
        Ok(())
    }
}

/// The boxes of rays; axes x, y, z. Those of no ray touch nothing.
struct Group {
    low: [[Row; GROUP / WIDE]; 3],
    high: [[Row; GROUP / WIDE]; 3],
    /// Rays prepared for the filter, as far as they have met a leaf.
    shears: [Shear; GROUP],
}

impl Default for Group {
    fn default() -> Self {
        Group {
            low: [[Row([f32::INFINITY; WIDE]); GROUP / WIDE]; 3],
            high: [[Row([f32::NEG_INFINITY; WIDE]); GROUP / WIDE]; 3],
            shears: [Shear::default(); GROUP],
        }
    }
}

impl Group {
    /// Makes the boxes.
    #[inline(always)]
    fn enclose(&mut self, rays: &[Ray], root: RootCube) {
        for i in 0..GROUP {
            let ray = rays.get(i).filter(|ray| ray.is_valid());
            for (axis, (lows, highs)) in self.low.iter_mut().zip(&mut self.high).enumerate() {
                let [low, high] = ray.map_or([f32::INFINITY, f32::NEG_INFINITY], |ray| extent(ray, axis, root));
                (lows[i / WIDE].0[i % WIDE], highs[i / WIDE].0[i % WIDE]) = (low, high);
            }
        }
    }

    /// Which of some rays' boxes touch a slot's box.
    #[inline(always)]
    fn touching<K: Kernel>(&self, kernel: K, rays: u64, planes: &Planes, slot: usize) -> u64 {
        let low = [0, 1, 2].map(|axis| kernel.all(planes.low[axis][slot]));
        let high = [0, 1, 2].map(|axis| kernel.all(planes.high[axis][slot]));
        let mut all = 0;
        for row in 0..GROUP / WIDE {
            if rays >> (row * WIDE) & 0xffff == 0 {
                continue;
            }
            let mut touch = 0xffff;
            for axis in 0..3 {
                touch &= kernel.at_most(kernel.get(&self.low[axis][row]), high[axis]);
                touch &= kernel.at_most(low[axis], kernel.get(&self.high[axis][row]));
            }
            all |= u64::from(touch) << (row * WIDE);
        }
        all & rays
    }

    /// Which of the rays meet anything, a bit each.
    #[inline(always)]
    fn walk<K: Kernel>(
        &mut self,
        kernel: K,
        visit: &Visit<'_>,
        rays: &[Ray],
        skips: &[Skip],
        open: &mut Vec<Open>,
        counters: &mut Counters,
    ) -> Result<u64, Halt> {
        let octree = visit.octree();
        let every = u64::MAX >> (GROUP - rays.len());
        let brick = |number: usize| {
            let brick = octree.bricks().get(number)?;
            Some(Frame { corner: brick.corner.map(f64::from), unit: brick.unit.map(f64::from) })
        };
        open.clear();
        match (octree.top_nodes().is_empty(), brick(0)) {
            (false, _) => open.push(Open { page: TOP, node: 0, frame: Frame::ROOT, rays: every }),
            (true, Some(frame)) => open.push(Open { page: 0, node: 0, frame, rays: every }),
            (true, None) => {}
        }
        let bounds = octree.bounds();
        let (mut met, mut sheared) = (0u64, 0u64);
        let mut depths = Depths::BLANK;
        let mut current: Option<(u32, Page<'_>)> = None;
        while let Some(Open { page: number, node: index, frame, rays: those }) = open.pop() {
            let those = those & !met;
            if those == 0 {
                continue;
            }
            let page = match current {
                Some((n, page)) if n == number => Some(page),
                _ if number == TOP => None,
                _ => {
                    let page = visit.page(PageId(number))?;
                    current = Some((number, page));
                    Some(page)
                }
            };
            let nodes = page.map_or_else(|| octree.top_nodes(), |page| page.nodes());
            let node = nodes.get(index as usize).unwrap_or(&Node::EMPTY);
            counters.nodes += 1;
            let planes = Planes::new(node, &frame);
            for slot in 0..8 {
                let those = self.touching(kernel, those & !met, &planes, slot);
                if those == 0 {
                    continue;
                }
                match (Slot::decode(node.slots[slot]), page) {
                    (Some(Slot::Inner(rank)), _) if node.first_child != 0 => {
                        let node_index = index.wrapping_add(node.first_child).wrapping_add(u32::from(rank));
                        let frame = frame.child(node, slot);
                        open.push(Open { page: number, node: node_index, frame, rays: those });
                    }
                    (Some(Slot::Brick(rank)), None) => {
                        let page = node.first_leaf.wrapping_add(u32::from(rank));
                        let Some(frame) = brick(page as usize) else { continue };
                        counters.bricks += 1;
                        open.push(Open { page, node: 0, frame, rays: those });
                    }
                    (Some(Slot::Leaf(units)), Some(page)) if node.first_leaf != 0 => {
                        let units = octree.leaf_unit().bytes() * usize::from(units);
                        let leaf = page.leaf(64 + 64 * index as usize + 16 * node.first_leaf as usize + units);
                        let mut left = those;
                        while left != 0 {
                            let i = left.trailing_zeros() as usize;
                            left &= left - 1;
                            if sheared >> i & 1 == 0 {
                                sheared |= 1 << i;
                                self.shears[i] = Shear::new(&rays[i], bounds);
                            }
                            counters.leaves += 1;
                            counters.triangles += leaf.len() as u64;
                            let lanes =
                                kernel.classify(&leaf, &self.shears[i], [rays[i].tmin, rays[i].tmax], &mut depths);
                            if lanes.accept | lanes.doubt == 0 {
                                continue;
                            }
                            let crossed = Crossed { leaf, page, ray: &rays[i], skip: skips[i] };
                            met |= u64::from(crossed.any(lanes.accept, lanes.doubt, &depths, counters)) << i;
                        }
                    }
                    _ => {}
                }
            }
        }
        Ok(met)
    }
}

/// What a ray's interval covers of an axis, in root units, widened.
#[inline(always)]
fn extent(ray: &Ray, axis: usize, root: RootCube) -> [f32; 2] {
    let scale = 1.0 / root.side();
    let origin = (f64::from(ray.origin[axis]) - root.corner[axis]) * scale;
    let step = f64::from(ray.direction[axis]) * scale;
    // A t that rounds into [tmin, tmax] lies at most one f32 step outside. Zero times infinity is passed over by min and max.
    let [a, b] = [ray.tmin.next_down(), ray.tmax.next_up()].map(|t| origin + step * f64::from(t));
    let widen = |x: f64| (1.0 + origin.abs() + x.abs()) * WIDEN;
    let (low, high) = ((a.min(b) - widen(a.min(b))) as f32, (a.max(b) + widen(a.max(b))) as f32);
    [if low.is_nan() { f32::NEG_INFINITY } else { low }, if high.is_nan() { f32::INFINITY } else { high }]
}

/// A node's planes in root units, in f32; axes x, y, z, and an entry a slot.
struct Planes {
    low: [[f32; 8]; 3],
    high: [[f32; 8]; 3],
}

impl Planes {
    #[inline(always)]
    fn new(node: &Node, frame: &Frame) -> Planes {
        let mut planes = Planes { low: [[0.0; 8]; 3], high: [[0.0; 8]; 3] };
        for axis in 0..3 {
            // A step times a byte is exact, so two roundings in all.
            let (corner, unit) = (frame.corner[axis] as f32, frame.unit[axis] as f32);
            for (to, from) in [(&mut planes.low, &node.low), (&mut planes.high, &node.high)] {
                for (plane, &q) in to[axis].iter_mut().zip(&from[axis]) {
                    *plane = f32::from(q);
                }
                for plane in &mut to[axis] {
                    *plane = corner + *plane * unit;
                }
            }
        }
        planes
    }
}

/// A leaf, some of whose triangles the filter could not leave out, and the ray.
struct Crossed<'p, 'a> {
    leaf: Leaf<'a>,
    page: Page<'a>,
    ray: &'p Ray,
    skip: Skip,
}

impl Crossed<'_, '_> {
    /// Whether the ray hits one of them.
    #[inline(never)]
    fn any(&self, accept: u32, doubt: u32, depths: &Depths, counters: &mut Counters) -> bool {
        let Crossed { leaf, page, ray, skip } = self;
        let mut left = accept | doubt;
        while left != 0 {
            let lane = left.trailing_zeros();
            left &= left - 1;
            let face = page.face(leaf.first().wrapping_add(lane));
            if skip.has(face) || face == FaceId::NONE {
                continue;
            }
            let (j, doubted) = (lane as usize & 15, doubt >> lane & 1 != 0);
            if !doubted && depths.lo[j] > ray.tmin && depths.hi[j] < ray.tmax {
                return true;
            }
            let line = Line::new(ray);
            let triangle = leaf.triangle(j);
            let Decision { crossing, exact } = if doubted { line.meet(&triangle) } else { line.accepted(&triangle) };
            counters.doubts += u64::from(doubted);
            counters.exact += u64::from(exact);
            if crossing.is_some_and(|crossing| crossing.t_within(&line).is_some()) {
                return true;
            }
        }
        false
    }
}
