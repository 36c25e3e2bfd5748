//! Large triangles are cut before the mesh is divided into bricks ("early splits").
//!
//! A triangle belongs to the brick around its box's centre. One that is much larger than its brick makes the brick's box, and all
//! boxes above it, as large as itself: every ray that passes anywhere near enters the brick. So where a triangle
//! reaches out of its brick's cell by more than [`SLACK`] of the cell's side, it is cut along the borders of octree cells, the coarsest
//! first, until each part lies (nearly) within the brick of its own centre. Each part becomes a record of its own, with
//! the box that holds it; from there on a record stands for that part only. Where the brick is divided further, it is
//! [`super::subtree`]'s business.
//!
//! Which cuts are worth their reference: a cut counts as much as the surface that it spares the brick, the reach times
//! the cell's side. All cuts are counted by classes of that (a quarter of an octave each); the best are made, as many classes as fit into
//! [`SHARE`] of the triangles. A part is never cut for a better reason than what it was cut from, so that what is
//! counted is what is made. Then boxes of bricks are compared: unless their surface falls below [`GAIN`] of what it is without
//! cuts, none is made. Only then are records of parts written.
//!
//! All of that is sums of integers and unions of boxes over all triangles, so that it does not depend on memory or threads. Nor does it
//! depend on the order of triangles, but for one thing: of a block of the file's triangles no more than [`BLOCK_CUTS`] cuts are counted, and no class
//! of which one was left out is made. Cells are counted down to a fixed level, whatever the memory.
//!
//! Memory: counts of 1.2 MB; parts of the blocks that are looked at together, within a wave's share; and twice the boxes of all bricks, some
//! 100 bytes each, a quarter of what the directory of so many pages is allowed. A mesh of more bricks than that allows is refused, as it would be later.
//!
//! Boxes of parts come from [`super::subtree::cut_box`], rounded outward: every point of a triangle lies in the box of one of its parts.
//!
//! After Ernst and Greiner (2007), "Early split clipping for bounding volume hierarchies", with the priorities by octree planes of Karras
//! and Aila (2013), "Fast parallel construction of high-quality bounding volume hierarchies", section 5; here for bricks alone.

use std::collections::{BTreeMap, BinaryHeap};

use rayon::prelude::*;

use crate::error::Result;
use crate::event::Monitor;
use crate::format::SplitMode;
use crate::geometry::{Aabb, Triangle, morton};

use super::chunk::BrickRule;
use super::distribute::{Extent, Records};
use super::grid::{CellCode, Grid};
use super::options::Tuning;
use super::record::Layout;
use super::spool::Spool;
use super::subtree::{Bounds, cell_of, cut_box};

/// Most references that cuts may add, in hundredths of the triangles.
const SHARE: u64 = 25;
/// How far a triangle may reach out of its brick's cell, as a part of the cell's side.
const SLACK: f64 = 1.0 / 8.0;
/// Cuts are made if the surface of all bricks falls below this part of what it is without.
const GAIN: f64 = 0.9;
/// The level of the finest cells in which triangles are counted: 2^18 cells, of 16384 triangles each more than any file holds.
const FINEST: u32 = 6;
/// Records that are looked at together.
const BLOCK: usize = 256;
/// Most cuts that are counted, and so made, in a block, lest a heap of huge triangles never ends: those left out are the least.
pub(super) const BLOCK_CUTS: usize = 1 << 14;
/// Bytes that a brick's box takes in [`Boxes`], about.
const BOX_BYTES: usize = 100;
/// Classes of cuts, four from one power of two to the next, of which the last ends at the root's side squared.
const CLASSES: usize = 96;

/// What early splits depend on.
pub(super) struct Early<'a> {
    pub rule: BrickRule,
    pub layout: Layout,
    /// The longest side of any triangle's box.
    pub longest: f32,
    /// Most cuts of a block: [`BLOCK_CUTS`], but for tests.
    pub block_cuts: usize,
    pub tuning: &'a Tuning,
    pub monitor: Monitor<'a>,
}

/// What there is to cut, and how much.
pub(super) struct Cuts<'a> {
    early: &'a Early<'a>,
    grid: Grid,
    /// Cuts of lower classes are not made.
    least: usize,
}

/// A cut of a part, and what it is worth.
struct Chosen {
    class: usize,
    axis: usize,
    plane: f32,
}

impl Early<'_> {
    /// Whether a mesh of so many triangles may have anything to be cut: several bricks, and a triangle that is longer than what
    /// reaches out of the least cell.
    pub fn is_for(&self, triangles: u64) -> bool {
        let finest = FINEST.min(self.rule.depth);
        self.rule.placement.split == SplitMode::Sah
            && triangles > u64::from(self.rule.limit)
            && self.is_longer(SLACK / f64::from(1u32 << finest))
    }

    /// Whether the longest triangle is longer than so many root units, or nearly.
    fn is_longer(&self, length: f64) -> bool {
        f64::from(self.longest) * 1.001 > length * self.rule.placement.root.side()
    }

    /// What is to be cut, and how many parts that makes of all triangles, uncut ones included; `None` if cutting does not pay.
    pub fn find(&self, records: &Spool<'_>) -> Result<Option<(Cuts<'_>, u64)>> {
        let extents = [Extent { at: 0, words: records.len() }];
        let records = Records { spool: records, extents: &extents, layout: self.layout };
        let mut cuts = Cuts { early: self, grid: self.count(records)?, least: CLASSES };
        let deepest = cuts.grid.deepest(self.rule.limit.into());
        if !self.is_longer(SLACK / f64::from(1u32 << deepest)) {
            return Ok(None);
        }
        cuts.least = cuts.lowest_class(records, most_cuts(cuts.grid.held(CellCode::ROOT)))?;
        if cuts.least == CLASSES {
            return Ok(None);
        }
        let parts = cuts.gain(records)?;
        Ok(parts.map(|parts| (cuts, parts)))
    }

    /// The layout of records of parts.
    pub fn with_parts(&self) -> Layout {
        Layout { parts: true, ..self.layout }
    }

    /// Triangles in cells, by the centres of their boxes.
    fn count(&self, records: Records<'_>) -> Result<Grid> {
        let mut grid = Grid::new(CellCode::ROOT, FINEST.min(self.rule.depth));
        records.pieces(self.tuning.piece, self.monitor, |words| {
            words.par_chunks_exact(self.layout.words()).with_min_len(1024).for_each(|record| {
                grid.count_box(self.layout.bounds(record), self.rule.placement.root);
            });
            Ok(())
        })?;
        grid.sum_up();
        Ok(grid)
    }

    /// Calls `work` with blocks of records, in parallel, and `take` with the results in order. Blocks do not depend on the
    /// memory, but how many are worked on at a time does: all parts they may have, together.
    fn blocks<T: Send>(
        &self,
        records: Records<'_>,
        work: impl Fn(&[u32]) -> T + Sync,
        mut take: impl FnMut(T) -> Result<()>,
    ) -> Result<()> {
        let words = self.layout.words();
        // The parts themselves, or their boxes by cells before and after.
        let part_bytes = (4 * self.with_parts().words()).max(2 * BOX_BYTES);
        let wave = (self.tuning.wave_bytes as usize / ((BLOCK + self.block_cuts) * part_bytes)).clamp(1, 256);
        let piece = (self.tuning.piece as usize / BLOCK).max(1) * BLOCK;
        records.pieces(piece as u64, self.monitor, |piece| {
            piece.chunks(wave * BLOCK * words).try_for_each(|blocks| {
                let results: Vec<T> = blocks.par_chunks(BLOCK * words).map(&work).collect();
                results.into_iter().try_for_each(&mut take)
            })
        })
    }
}

/// Most cuts to be made in so many triangles: references are numbered in 32 bits, of which the highest number stands for none.
fn most_cuts(triangles: u64) -> u64 {
    (triangles * SHARE / 100).min(u64::from(u32::MAX - 1).saturating_sub(triangles))
}

/// The class of a cut that spares so much, in units of the root's side, squared.
fn class_of(spared: f64) -> usize {
    // The exponent and two bits more.
    let (quarters, one) = (spared.to_bits() >> 50, 1f64.to_bits() >> 50);
    (CLASSES as u64 + quarters).saturating_sub(one).min(CLASSES as u64 - 1) as usize
}

impl Cuts<'_> {
    /// The brick cell around the centre of a box: one that holds no more than a brick does, or is as fine as cells are counted.
    fn cell(&self, part: Aabb) -> CellCode {
        let code = cell_of(self.early.rule.placement.root, part);
        let at = |level: u32| CellCode { level, code: code >> (3 * (morton::BITS - level)) };
        let is_brick = |&cell: &CellCode| self.grid.held(cell) <= self.early.rule.limit.into();
        (0..self.grid.finest()).map(at).find(is_brick).unwrap_or(at(self.grid.finest()))
    }

    /// How a part is best cut; `None` if it lies within its cell, or nearly.
    fn choose(&self, part: Aabb) -> Option<Chosen> {
        let root = self.early.rule.placement.root;
        let (bounds, cell) = (Bounds::of(part, root), self.cell(part).cell().bounds());
        let reach = (cell.min - bounds.min).max(bounds.max - cell.max).to_array();
        let axis = (1..3).fold(0, |best, axis| if reach[axis] > reach[best] { axis } else { best });
        let side = (cell.max - cell.min).x;
        if reach[axis] <= SLACK * side {
            return None;
        }
        // The coarsest plane that leaves more than a sliver on either side; a border of the cell is one.
        let (low, high) = (bounds.min[axis] + SLACK * side, bounds.max[axis] - SLACK * side);
        let place = (1..=morton::BITS).find_map(|level| {
            let step = 1.0 / f64::from(1u32 << level);
            let place = (low / step).ceil() * step;
            (place <= high).then_some(place)
        })?;
        let plane = (root.corner[axis] + place * root.side()) as f32;
        let class = class_of(reach[axis] * side);
        (part.min[axis] < plane && plane < part.max[axis]).then_some(Chosen { class, axis, plane })
    }

    /// The lowest class of cuts to be made, if there are to be at most `most`; [`CLASSES`] = none.
    fn lowest_class(&self, records: Records<'_>, most: u64) -> Result<usize> {
        let (mut all, mut counted) = ([0u64; CLASSES], 0);
        self.early.blocks(
            records,
            |words| self.worth(words),
            |(counts, from): ([u64; CLASSES], usize)| {
                all.iter_mut().zip(counts).for_each(|(sum, count)| *sum += count);
                counted = counted.max(from);
                Ok(())
            },
        )?;
        let mut sum = 0;
        let fits = |&class: &usize| {
            sum += all[class];
            sum <= most
        };
        Ok((counted..CLASSES).rev().take_while(fits).filter(|&class| all[class] > 0).last().unwrap_or(CLASSES))
    }

    /// The cuts of a block by classes, and the lowest class from which on all are counted.
    fn worth(&self, words: &[u32]) -> ([u64; CLASSES], usize) {
        let (layout, mut counts) = (self.early.layout, [0; CLASSES]);
        let mut heap = BinaryHeap::new();
        // By class; what follows tells parts of a class apart, so that it does not matter how they entered.
        let entry = |class: usize, record: usize, part: Aabb, chosen: Chosen| {
            let bits = [part.min, part.max].map(|corner| corner.to_array().map(f32::to_bits));
            (class.min(chosen.class), record, bits, chosen.axis, chosen.plane.to_bits())
        };
        for (number, record) in words.chunks_exact(layout.words()).enumerate() {
            let part = layout.bounds(record);
            heap.extend(self.choose(part).map(|chosen| entry(CLASSES, number, part, chosen)));
        }
        for _ in 0..self.early.block_cuts {
            let Some((class, record, bits, axis, plane)) = heap.pop() else { return (counts, 0) };
            counts[class] += 1;
            let triangle = layout.triangle(&words[record * layout.words()..]);
            let [min, max] = bits.map(|corner| corner.map(f32::from_bits).into());
            for part in cut_box(&triangle, Aabb { min, max }, axis, f32::from_bits(plane)).into_iter().flatten() {
                heap.extend(self.choose(part).map(|chosen| entry(class, record, part, chosen)));
            }
        }
        (counts, heap.peek().map_or(0, |next| next.0 + 1))
    }

    /// Calls `take` with the parts of a triangle.
    fn parts(&self, triangle: &Triangle, part: Aabb, take: &mut impl FnMut(Aabb)) {
        match self.choose(part) {
            Some(Chosen { class, axis, plane }) if class >= self.least => {
                let parts = cut_box(triangle, part, axis, plane);
                parts.into_iter().flatten().for_each(|part| self.parts(triangle, part, take));
            }
            _ => take(part),
        }
    }

    /// How many parts there would be; `None` if it does not pay.
    fn gain(&self, records: Records<'_>) -> Result<Option<u64>> {
        let (layout, root) = (self.early.layout, self.early.rule.placement.root);
        let (mut before, mut after, mut parts) = (Boxes::default(), Boxes::default(), 0);
        let block = |words: &[u32]| {
            let (mut before, mut after, mut parts) = (Boxes::default(), Boxes::default(), 0);
            for record in words.chunks_exact(layout.words()) {
                let whole = layout.bounds(record);
                before.add(self.cell(whole), Bounds::of(whole, root));
                self.parts(&layout.triangle(record), whole, &mut |part| {
                    after.add(self.cell(part), Bounds::of(part, root));
                    parts += 1;
                });
            }
            (before, after, parts)
        };
        self.early.blocks(records, block, |(more_before, more_after, more)| {
            before.merge(more_before);
            after.merge(more_after);
            parts += more;
            // Each of these is a page at least.
            self.early.tuning.check_pages(before.0.len().max(after.0.len()) as u64)
        })?;
        Ok((after.surface() < GAIN * before.surface()).then_some(parts))
    }

    /// Writes the parts of all triangles, in the order of these, to `spool`.
    pub fn write<'w>(&self, records: &Spool<'_>, mut spool: Spool<'w>) -> Result<Spool<'w>> {
        let (layout, with_parts) = (self.early.layout, self.early.with_parts());
        let extents = [Extent { at: 0, words: records.len() }];
        let records = Records { spool: records, extents: &extents, layout };
        let block = |words: &[u32]| {
            let mut out = Vec::new();
            for record in words.chunks_exact(layout.words()) {
                let mut take = |part| with_parts.write_part(record, part, &mut out);
                self.parts(&layout.triangle(record), layout.bounds(record), &mut take);
            }
            out
        };
        self.early.blocks(records, block, |words| spool.append(&words))?;
        Ok(spool)
    }
}

/// Boxes of bricks, in root units.
#[derive(Default)]
struct Boxes(BTreeMap<(u32, u64), Bounds>);

impl Boxes {
    fn add(&mut self, cell: CellCode, bounds: Bounds) {
        let held = self.0.entry((cell.level, cell.code)).or_insert(Bounds::EMPTY);
        *held = held.union(bounds);
    }

    fn merge(&mut self, other: Boxes) {
        other.0.into_iter().for_each(|((level, code), bounds)| self.add(CellCode { level, code }, bounds));
    }

    /// Half of all their surface. Summed in the order of cells.
    fn surface(&self) -> f64 {
        self.0.values().map(|bounds| bounds.half_area()).sum()
    }
}

#[cfg(test)]
mod tests;
