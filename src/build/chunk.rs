//! The fifth phase, first half: a chunk in memory is cut into the triangle lists of its bricks.
//!
//! A brick is an octree cell of at most the brick limit of triangles whose parent has more. A cell at the depth limit that
//! has more is several bricks: runs of its triangles in the source's order.

use rayon::prelude::*;

use crate::geometry::{Triangle, morton};

use super::grid::{CellCode, Placement, Unit, UnitFinder, places};
use super::record::Layout;
use super::subtree::{cell_of, overlaps};

/// A brick to be built: its cell and the places of its records in the chunk, in the source's order.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct BrickList {
    pub cell: CellCode,
    pub records: Vec<u32>,
}

/// What decides where bricks end.
#[derive(Clone, Copy, Debug)]
pub(super) struct BrickRule {
    pub placement: Placement,
    /// Most triangles of a brick.
    pub limit: u32,
    /// Level of the deepest cells.
    pub depth: u32,
}

/// A chunk in memory.
struct Loaded<'a> {
    words: &'a [u32],
    layout: Layout,
    rule: BrickRule,
    /// The Morton code of each record; empty where triangles repeat.
    codes: Vec<u64>,
}

/// The bricks of a chunk's units, in the order of the curve. All records belong to some unit.
pub(super) fn bricks(words: &[u32], layout: Layout, units: &[Unit], rule: BrickRule) -> Vec<BrickList> {
    let codes = if rule.placement.repeats() {
        Vec::new()
    } else {
        let record = |record| cell_of(rule.placement.root, layout.bounds(record));
        words.par_chunks_exact(layout.words()).with_min_len(1024).map(record).collect()
    };
    let chunk = Loaded { words, layout, rule, codes };
    let lists = chunk.unit_lists(units);
    let split = |(unit, records): (&Unit, Vec<u32>)| chunk.split(unit.cell, records);
    units.par_iter().zip(lists).flat_map_iter(split).collect()
}

impl Loaded<'_> {
    fn triangle(&self, record: u32) -> Triangle {
        let at = record as usize * self.layout.words();
        self.layout.triangle(&self.words[at..at + self.layout.words()])
    }

    /// The records of each unit.
    fn unit_lists(&self, units: &[Unit]) -> Vec<Vec<u32>> {
        let records = (self.words.len() / self.layout.words()) as u32;
        if let [Unit { cell: CellCode::ROOT, .. }] = units {
            return vec![(0..records).collect()];
        }
        let (mut lists, mut finder) = (vec![Vec::new(); units.len()], UnitFinder::new(units));
        for record in 0..records {
            if let Some(&code) = self.codes.get(record as usize) {
                lists[finder.place(code)].push(record);
            } else {
                let triangle = self.triangle(record);
                places(units, &triangle, CellCode::ROOT, self.rule.placement, |unit| lists[unit].push(record));
            }
        }
        lists
    }

    /// Splits a cell until bricks are reached.
    fn split(&self, cell: CellCode, records: Vec<u32>) -> Vec<BrickList> {
        if records.is_empty() {
            return Vec::new();
        }
        let limit = self.rule.limit as usize;
        if records.len() <= limit {
            return vec![BrickList { cell, records }];
        }
        if cell.level >= self.rule.depth {
            return records.chunks(limit).map(|run| BrickList { cell, records: run.to_vec() }).collect();
        }
        let octants = self.octants(cell, &records);
        drop(records);
        let child = |(octant, records)| self.split(cell.octant(octant as u64), records);
        octants.into_par_iter().enumerate().flat_map_iter(child).collect()
    }

    /// The records of each child.
    fn octants(&self, cell: CellCode, records: &[u32]) -> [Vec<u32>; 8] {
        let mut octants: [Vec<u32>; 8] = Default::default();
        if self.rule.placement.repeats() {
            octants.par_iter_mut().enumerate().for_each(|(octant, list)| {
                let child = cell.octant(octant as u64).cell();
                let inside = |&record: &u32| overlaps(self.rule.placement.root, child, &self.triangle(record));
                *list = records.iter().copied().filter(inside).collect();
            });
        } else {
            let shift = 3 * (morton::BITS - 1 - cell.level);
            for &record in records {
                octants[(self.codes[record as usize] >> shift & 7) as usize].push(record);
            }
        }
        octants
    }
}
