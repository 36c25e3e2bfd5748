//! The steps of a ray in flight, each as much as can be done without waiting for what it loads.

use super::{DEPTH, Flying};
use crate::format::Node;
use crate::map::Halt;
use crate::trace::Counters;
use crate::trace::arch::Kernel;
use crate::trace::collect::{Collector, Next};
use crate::trace::settle::{range, take};
use crate::trace::setup::Setup;
use crate::trace::walk::{BRICK, EMPTY, File, Level, TOP, cell_of};

/// What a ray needs next.
#[derive(Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub(super) enum Step {
    /// Its next slot is an inner node of the same page.
    Inner,
    /// A leaf.
    Leaf,
    /// A page.
    Brick,
    /// Nothing is left of the node, or the slot is empty.
    Back,
    /// Triangles of a leaf may be hit.
    Hit,
    /// The walk is over.
    End,
}

/// The step that a slot byte asks for; behind these 256, where no slot is left.
static STEPS: [Step; 512] = {
    let mut steps = [Step::Back; 512];
    let mut byte = 0;
    while byte < 256 {
        steps[byte] = match byte as u8 {
            EMPTY => Step::Back,
            byte if byte < EMPTY => Step::Leaf,
            byte if byte & BRICK == BRICK => Step::Brick,
            _ => Step::Inner,
        };
        byte += 1;
    }
    steps
};

/// What the first slot that is left of a node needs.
#[inline(always)]
pub(super) fn step<K: Kernel>(kernel: K, file: &File<'_>, node: &Node, left: u32, order: u8) -> Step {
    file.ahead(kernel, node, left, order.into());
    let slot = (left.trailing_zeros() as u8 ^ order) & 7;
    // By arithmetic alone: as a branch this would be foreseen wrongly at every other node.
    STEPS[usize::from(node.slots[usize::from(slot)]) | usize::from(left == 0) << 8]
}

/// A node; an empty one where there is none of that number.
#[inline(always)]
fn node(nodes: &[Node], index: u32) -> &Node {
    nodes.get(index as usize).unwrap_or(&Node::EMPTY)
}

/// The first slot that is left of a level, which is then no longer left.
#[inline(always)]
fn next_slot(level: &mut Level, order: u8) -> usize {
    let slot = (level.left.trailing_zeros() as u8 ^ order) & 7;
    level.left &= level.left.wrapping_sub(1);
    slot.into()
}

/// Goes into the next slot, an inner node: makes its level, of which only the slots are missing. Children lie behind their parent: bytes that
/// say otherwise, as no sound page has them, must not lead back to it.
#[inline(always)]
pub(super) fn descend<C, K: Kernel>(kernel: K, aloft: &mut Flying<'_, K, C>, stack: &mut [Level; DEPTH]) {
    let way = &aloft.setup.way;
    let top = aloft.top as usize % DEPTH;
    let level = &mut stack[top];
    let parent = node(aloft.nodes, level.node);
    let slot = next_slot(level, way.order);
    let index = level.node.wrapping_add(parent.first_child.max(1)).wrapping_add(u32::from(parent.slots[slot] & 7));
    let (frame, near) = kernel.load(&level.saved);
    let frame = kernel.child(frame, parent, slot, way);
    let page = level.page;
    // Where nothing is left the level is not come back to.
    let top = (top + usize::from(level.left != 0)) % DEPTH;
    let level = &mut stack[top];
    kernel.save(&mut level.saved, frame, near);
    (level.node, level.page) = (index, page);
    aloft.top = top as u32;
}

/// Enters the next slot's page likewise; false if there is none.
#[inline(always)]
pub(super) fn enter<'a, C, K: Kernel>(
    kernel: K,
    file: &File<'a>,
    aloft: &mut Flying<'a, K, C>,
    stack: &mut [Level; DEPTH],
) -> Result<bool, Halt> {
    let Setup { way, aim, .. } = &aloft.setup;
    let top = aloft.top as usize % DEPTH;
    let level = &mut stack[top];
    let parent = node(aloft.nodes, level.node);
    let slot = usize::from((level.left.trailing_zeros() as u8 ^ way.order) & 7);
    let number = parent.first_leaf.wrapping_add(u32::from(parent.slots[slot] & 0x3f));
    let (Some(brick), TOP) = (file.brick(number), level.page) else { return Ok(false) };
    level.left &= level.left.wrapping_sub(1);
    let top = (top + usize::from(level.left != 0)) % DEPTH;
    aloft.view = file.view(number)?;
    aloft.nodes = aloft.view.nodes;
    kernel.fetch(node(aloft.nodes, 0), 0);
    let (_, near) = kernel.load(&level.saved);
    let frame = kernel.frame(&cell_of(brick), aim, way);
    let level = &mut stack[top];
    kernel.save(&mut level.saved, frame, near);
    (level.node, level.page) = (0, number);
    aloft.top = top as u32;
    Ok(true)
}

/// Finds the slots that the ray touches of the node that it went into.
#[inline(always)]
pub(super) fn touch<C, K: Kernel>(
    kernel: K,
    file: &File<'_>,
    aloft: &mut Flying<'_, K, C>,
    stack: &mut [Level; DEPTH],
) -> Step {
    let way = &aloft.setup.way;
    let level = &mut stack[aloft.top as usize % DEPTH];
    let (frame, _) = kernel.load(&level.saved);
    let node = node(aloft.nodes, level.node);
    let (left, near) = kernel.touch(node, frame, way, aloft.ends);
    kernel.save(&mut level.saved, frame, near);
    level.left = left;
    step(kernel, file, node, left, way.order)
}

/// Finds the next slot's leaf.
#[inline(always)]
pub(super) fn find<'a, C, K: Kernel>(
    file: &File<'a>,
    aloft: &mut Flying<'a, K, C>,
    stack: &mut [Level; DEPTH],
    counters: &mut Counters,
) {
    let level = &mut stack[aloft.top as usize % DEPTH];
    let parent = node(aloft.nodes, level.node);
    let slot = next_slot(level, aloft.setup.way.order);
    // The top has no leaves; a slot there that seems to name one is of a file cut short.
    aloft.leaf = match level.page == aloft.view.number {
        true => file.stored(&aloft.view, level.node, parent, parent.slots[slot], counters),
        false => None,
    };
}

/// Tests the triangles of the leaf that was found.
#[inline(always)]
pub(super) fn test<'a, C: Collector<'a>, K: Kernel>(
    kernel: K,
    file: &File<'a>,
    aloft: &mut Flying<'a, K, C>,
    stack: &[Level; DEPTH],
) -> Step {
    let level = &stack[aloft.top as usize % DEPTH];
    let next = step(kernel, file, node(aloft.nodes, level.node), level.left, aloft.setup.way.order);
    let Some(stored) = &aloft.leaf else { return next };
    let range = range(&aloft.ray, &aloft.collector);
    aloft.lanes = kernel.classify(&stored.leaf, &aloft.shear, range, &mut aloft.depths);
    if aloft.lanes.accept | aloft.lanes.doubt != 0 { Step::Hit } else { next }
}

/// Takes the hits of the leaf that was tested last.
#[inline(always)]
pub(super) fn hit<'a, C: Collector<'a>, K: Kernel>(
    kernel: K,
    file: &File<'a>,
    aloft: &mut Flying<'a, K, C>,
    stack: &mut [Level; DEPTH],
    counters: &mut Counters,
) -> Step {
    let Flying { setup, far, ends, nodes, depths, leaf, lanes, ray, collector, .. } = aloft;
    let level = &mut stack[aloft.top as usize % DEPTH];
    if let Some(stored) = leaf {
        match take(stored, *lanes, ray, setup, depths, far, collector, counters) {
            Next::On => {}
            Next::Nearer => {
                level.left &= kernel.within(kernel.load(&level.saved).1, *far);
                *ends = kernel.ends(setup.way.near, *far);
            }
            Next::Done => return Step::End,
        }
    }
    step(kernel, file, node(nodes, level.node), level.left, setup.way.order)
}

/// Comes back to a node put aside before, or passes over an empty slot.
#[inline(always)]
pub(super) fn back<'a, C, K: Kernel>(
    kernel: K,
    file: &File<'a>,
    top_nodes: &'a [Node],
    aloft: &mut Flying<'a, K, C>,
    stack: &mut [Level; DEPTH],
) -> Step {
    let top = aloft.top as usize % DEPTH;
    let rest = stack[top].left & stack[top].left.wrapping_sub(1);
    let top = top.wrapping_sub(usize::from(rest == 0)) % DEPTH;
    let level = &mut stack[top];
    let left = if rest == 0 { level.left } else { rest };
    let (_, near) = kernel.load(&level.saved);
    level.left = left & kernel.within(near, aloft.far);
    // A page's levels follow upon each other, so this one is of the page entered last, or of the top.
    aloft.nodes = if level.page == TOP { top_nodes } else { aloft.view.nodes };
    aloft.top = top as u32;
    let next = step(kernel, file, node(aloft.nodes, level.node), level.left, aloft.setup.way.order);
    if top == 0 { Step::End } else { next }
}
