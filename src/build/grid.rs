//! The third phase: triangles are counted in a grid of octree cells, and cells are merged into chunks.
//!
//! A *unit* is an octree cell of at most a chunk's triangles whose parent has more (or a cell at the grid's finest level).
//! A *chunk* is a run of units, one after the other on the Morton curve, that fit in memory together. Since every cell above a
//! unit holds more than a chunk, and so more than a brick, may, bricks never reach across units.

use std::ops::Range;
use std::sync::atomic::{AtomicU32, Ordering};

use crate::format::SplitMode;
use crate::geometry::{Aabb, RootCube, Triangle, morton};

use super::subtree::{Cell, cell_of, overlaps};

/// An octree cell as a level and its number on the level's Morton curve.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct CellCode {
    pub level: u32,
    pub code: u64,
}

impl CellCode {
    pub const ROOT: CellCode = CellCode { level: 0, code: 0 };

    pub fn cell(self) -> Cell {
        Cell { level: self.level, index: morton::decode(self.code) }
    }

    pub fn octant(self, octant: u64) -> CellCode {
        CellCode { level: self.level + 1, code: self.code << 3 | octant }
    }

    /// The first code of the finest level in the cell.
    pub fn first(self) -> u64 {
        self.code << (3 * (morton::BITS - self.level))
    }

    /// The code after the last of the finest level in the cell.
    pub fn end(self) -> u64 {
        (self.code + 1) << (3 * (morton::BITS - self.level))
    }
}

/// How triangles belong to cells: by the centre of their box (or of their part's), or in every cell they overlap.
#[derive(Clone, Copy, Debug)]
pub(super) struct Placement {
    pub root: RootCube,
    pub split: SplitMode,
}

impl Placement {
    /// Whether a triangle may belong to several cells.
    pub fn repeats(self) -> bool {
        self.split == SplitMode::Strict
    }

    /// Where triangles repeat: calls `visit` for `from` and the cells below it that the triangle overlaps, parents first; a cell is
    /// gone into if `visit` says so. The triangle must overlap `from`.
    fn descend(self, triangle: &Triangle, from: CellCode, visit: &mut impl FnMut(CellCode) -> bool) {
        debug_assert!(self.repeats(), "elsewhere a triangle, or a part of one, is in one cell of each level");
        if !visit(from) || from.level == morton::BITS {
            return;
        }
        for child in (0..8).map(|octant| from.octant(octant)) {
            if overlaps(self.root, child.cell(), triangle) {
                self.descend(triangle, child, visit);
            }
        }
    }
}

/// Counts of triangles in all cells of a few levels below a cell. Threads count together.
pub(super) struct Grid {
    from: CellCode,
    /// `levels[l]` has 8^l counts.
    levels: Vec<Vec<AtomicU32>>,
}

impl Grid {
    /// All zero, from the level of `from` down to `finest`.
    pub fn new(from: CellCode, finest: u32) -> Grid {
        let zeros = |level: u32| std::iter::repeat_with(AtomicU32::default).take(1 << (3 * level)).collect();
        Grid { from, levels: (0..=finest - from.level).map(zeros).collect() }
    }

    /// Counts a whole triangle in every cell it belongs to, or in the finest alone where there is one of each level.
    pub fn count(&self, triangle: &Triangle, placement: Placement) {
        if !placement.repeats() {
            return self.count_box(Aabb::from(triangle), placement.root);
        }
        let finest = self.finest();
        placement.descend(triangle, self.from, &mut |cell| {
            self.counter(cell).fetch_add(1, Ordering::Relaxed);
            cell.level < finest
        });
    }

    /// Counts what has that box in the finest cell around its centre.
    pub fn count_box(&self, bounds: Aabb, root: RootCube) {
        let level = self.finest();
        let code = cell_of(root, bounds) >> (3 * (morton::BITS - level));
        self.counter(CellCode { level, code }).fetch_add(1, Ordering::Relaxed);
    }

    /// The level of the finest cells.
    pub fn finest(&self) -> u32 {
        self.from.level + self.levels.len() as u32 - 1
    }

    /// What a cell holds, once all is [summed up](Grid::sum_up).
    pub fn held(&self, cell: CellCode) -> u64 {
        self.counter(cell).load(Ordering::Relaxed).into()
    }

    /// The deepest level, at most the finest, of a cell within one that holds more than `limit`, once all is summed up.
    pub fn deepest(&self, limit: u64) -> u32 {
        let is_divided =
            |level: &&Vec<AtomicU32>| level.iter().any(|count| u64::from(count.load(Ordering::Relaxed)) > limit);
        let divided = self.levels.iter().take_while(is_divided).count() as u32;
        (self.from.level + divided).min(self.finest())
    }

    fn counter(&self, cell: CellCode) -> &AtomicU32 {
        let depth = cell.level - self.from.level;
        &self.levels[depth as usize][(cell.code & ((1 << (3 * depth)) - 1)) as usize]
    }

    /// All zero again.
    pub fn clear(&mut self) {
        self.levels.iter_mut().flatten().for_each(|count| *count.get_mut() = 0);
    }

    /// The units, in the order of the curve, for chunks of at most `limit` triangles.
    pub fn units(mut self, limit: u64, placement: Placement) -> Vec<Unit> {
        if !placement.repeats() {
            self.sum_up();
        }
        let mut units = Vec::new();
        self.collect(self.from, limit, &mut units);
        units
    }

    /// Counts in each cell what its octants hold, where only the finest were counted.
    pub fn sum_up(&mut self) {
        for level in (1..self.levels.len()).rev() {
            let (above, below) = self.levels.split_at_mut(level);
            for (sum, octants) in above[level - 1].iter_mut().zip(below[0].chunks_exact_mut(8)) {
                *sum.get_mut() = octants.iter_mut().map(|count| *count.get_mut()).sum();
            }
        }
    }

    fn collect(&self, cell: CellCode, limit: u64, units: &mut Vec<Unit>) {
        let triangles = self.held(cell);
        let finest = cell.level == self.finest();
        if triangles == 0 {
        } else if triangles <= limit || finest {
            units.push(Unit { cell, triangles });
        } else {
            (0..8).for_each(|octant| self.collect(cell.octant(octant), limit, units));
        }
    }
}

/// A cell with its count of triangles; see the module.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Unit {
    pub cell: CellCode,
    pub triangles: u64,
}

/// Finds the units (disjoint, in curve order) in which codes lie.
pub(super) struct UnitFinder<'a> {
    units: &'a [Unit],
    /// The place of the one found last, and the codes in it.
    last: usize,
    codes: Range<u64>,
}

impl<'a> UnitFinder<'a> {
    pub fn new(units: &'a [Unit]) -> Self {
        UnitFinder { units, last: 0, codes: 0..0 }
    }

    /// The place of the first unit that does not end before `code`.
    #[inline]
    pub fn place(&mut self, code: u64) -> usize {
        // Neighbours in a mesh's file are mostly neighbours in space.
        if !self.codes.contains(&code) {
            self.last = self.units.partition_point(|unit| unit.cell.end() <= code);
            self.codes = self.units.get(self.last).map_or(0..0, |unit| unit.cell.first()..unit.cell.end());
        }
        self.last
    }
}

/// Ends (exclusive) of the runs of units that make chunks of at most `limit` triangles; a unit beyond that is alone.
pub(super) fn merge(units: &[Unit], limit: u64) -> Vec<usize> {
    let (mut ends, mut sum) = (Vec::new(), 0);
    for (i, unit) in units.iter().enumerate() {
        if sum > 0 && sum + unit.triangles > limit {
            ends.push(i);
            sum = 0;
        }
        sum += unit.triangles;
    }
    ends.push(units.len());
    ends
}

/// Where triangles repeat: the places in `units` (disjoint, in curve order) of those that the triangle overlaps, given that it overlaps `from`.
pub(super) fn places(
    units: &[Unit],
    triangle: &Triangle,
    from: CellCode,
    placement: Placement,
    mut found: impl FnMut(usize),
) {
    placement.descend(triangle, from, &mut |cell| {
        let first = units.partition_point(|unit| unit.cell.end() <= cell.first());
        match units.get(first) {
            Some(unit) if unit.cell == cell => {
                found(first);
                false
            }
            // Go on only where units lie below.
            Some(unit) => unit.cell.first() < cell.end(),
            None => false,
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Aabb;

    fn placement(split: SplitMode) -> Placement {
        let bounds = Aabb { min: glam::Vec3::ZERO, max: glam::Vec3::splat(8.0) };
        Placement { root: RootCube::around(bounds), split }
    }

    /// Small triangles along the diagonal.
    fn triangles() -> Vec<Triangle> {
        let corner = |i: u32, j: f32| glam::Vec3::new(i as f32 / 13.0 + 0.01 * j, i as f32 / 13.0, 0.3 * j);
        (0..100).map(|i| Triangle { a: corner(i, 0.0), b: corner(i, 1.0), c: corner(i, 2.0) }).collect()
    }

    #[test]
    fn units_cover_each_triangle() {
        for split in [SplitMode::Sah, SplitMode::Strict] {
            let placement = placement(split);
            let grid = Grid::new(CellCode::ROOT, 4);
            triangles().iter().for_each(|t| grid.count(t, placement));
            let units = grid.units(10, placement);
            assert!(units.len() > 5 && units.windows(2).all(|pair| pair[0].cell.end() <= pair[1].cell.first()));
            let (mut counts, mut finder) = (vec![0; units.len()], UnitFinder::new(&units));
            for triangle in triangles() {
                let before: u64 = counts.iter().sum();
                if placement.repeats() {
                    places(&units, &triangle, CellCode::ROOT, placement, |unit| counts[unit] += 1);
                } else {
                    let code = cell_of(placement.root, Aabb::from(&triangle));
                    counts[finder.place(code)] += 1;
                }
                assert!(counts.iter().sum::<u64>() > before);
            }
            assert_eq!(counts, units.iter().map(|unit| unit.triangles).collect::<Vec<_>>());
            if split == SplitMode::Sah {
                assert_eq!(counts.iter().sum::<u64>(), 100);
            }
        }
    }

    #[test]
    fn runs_of_units_keep_the_limit() {
        let unit = |code, triangles| Unit { cell: CellCode { level: 2, code }, triangles };
        let units = [unit(0, 3), unit(1, 4), unit(3, 9), unit(4, 2), unit(9, 50), unit(10, 1)];
        assert_eq!(merge(&units, 10), [2, 3, 4, 5, 6]);
        assert_eq!(merge(&units, 11), [2, 4, 5, 6]);
    }
}
