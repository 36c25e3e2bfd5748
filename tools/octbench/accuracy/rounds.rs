//! How many rounds a family has, with how many rays and how large a mesh each, and how its file is built.

use octrace::build::{BuildOptions, Positions};
use octrace::format::SplitMode;

use crate::families::{self, Family, Layout};

/// Triangles wanted in the rounds of a family, in turn: two in ten are of 10^4 and more.
const SIZES: [usize; 10] = [12, 60, 12_000, 300, 12, 1000, 60, 12_000, 3000, 300];

/// Triangles that share a point in the rounds of a family of hubs.
const HUB_SIZES: [usize; 10] = [3, 30, 10_000, 5, 100, 4, 1000, 12, 300, 8];

/// Rays of a round, about.
const PER_ROUND: u64 = 40_000;

/// A round of a family.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Round {
    /// Its number, from 0.
    pub number: usize,
    /// Rays.
    pub rays: usize,
    /// Triangles wanted, about.
    pub size: usize,
}

/// The rounds of a family.
pub struct Rounds {
    /// Rays in all, at least.
    rays: f64,
    tens: u64,
    hub: bool,
}

impl Rounds {
    /// The rounds of one of the families of a run of `rays` in all.
    ///
    /// A family of costly rays gets 0.3 of another's share.
    pub fn new(family: &Family, all: &[Family], rays: u64) -> Rounds {
        let weight = |f: &Family| if families::DEAR.contains(&f.number) { 0.3 } else { 1.0 };
        let rays = rays as f64 * weight(family) / all.iter().map(weight).sum::<f64>();
        let tens = (rays / (10 * PER_ROUND) as f64).round().max(1.0) as u64;
        Rounds { rays, tens, hub: families::HUBS.contains(&family.number) }
    }

    /// How many: whole tens, so that each size has its part.
    pub fn count(&self) -> usize {
        10 * self.tens as usize
    }

    /// A round by its number. Hubs of more than 300 triangles get fewer rays, in proportion to what each costs.
    pub fn get(&self, number: usize) -> Option<Round> {
        let sizes = if self.hub { HUB_SIZES } else { SIZES };
        let weight = |size: usize| if self.hub { (300.0 / size as f64).min(1.0) } else { 1.0 };
        let size = sizes[number % sizes.len()];
        let all = self.tens as f64 * sizes.into_iter().map(weight).sum::<f64>();
        let rays = (self.rays * weight(size) / all).ceil().max(1.0) as usize;
        (number < self.count()).then_some(Round { number, rays, size })
    }
}

/// How round number `round` builds its file; several ways where the family wants to see them side by side.
pub fn build_options(round: usize, layout: &Layout, triangles: usize) -> Vec<BuildOptions> {
    (0..layout.ways.max(1)).map(|k| one_way(round + 7 * k, layout, triangles)).collect()
}

/// What a build may take: many run at once here beside their oracles, so that the process is large before one begins.
const MEMORY: u64 = 4 << 30;

fn one_way(round: usize, layout: &Layout, triangles: usize) -> BuildOptions {
    if let Some(cell) = layout.strict {
        return BuildOptions { split: SplitMode::Strict, cell, memory: MEMORY, ..BuildOptions::default() };
    }
    let mut options = BuildOptions {
        split: [SplitMode::Sah, SplitMode::Octree, SplitMode::Strict][round % 3],
        leaf: [16, 1, 2, 8, 16, 3][round / 3 % 6],
        cell: [16, 1, 2, 8, 64, u32::MAX][round / 2 % 6],
        depth: [21, 21, 5, 1, 0, 12][round / 5 % 6],
        brick: layout.brick.or([None, Some(64), None, Some(1000)][round % 4]),
        // Where vertices lie on a grid by themselves they then take 16 bits.
        positions: [Positions::Exact, Positions::LOSSLESS][round / 2 % 2],
        memory: MEMORY,
        ..BuildOptions::default()
    };
    if options.split == SplitMode::Strict {
        // Cells along shared edges never get empty, nor do those of sheets that lie on each other, 4^depth of them: what the seed's
        // form costs, and not at issue here.
        let (cell, depth) = if triangles > 2000 { (16, 7) } else { (if triangles > 100 { 8 } else { 2 }, 8) };
        options.cell = options.cell.max(cell);
        options.depth = options.depth.min(depth);
    }
    options
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn never_fewer_rays_than_asked_for_and_no_family_under_half_a_percent() {
        let all = families::all();
        for rays in [1000, 1_000_000, 100_000_000u64] {
            let sums: Vec<u64> = all
                .iter()
                .map(|f| {
                    let rounds = Rounds::new(f, &all, rays);
                    (0..).map_while(|i| rounds.get(i)).map(|r| r.rays as u64).sum()
                })
                .collect();
            let total: u64 = sums.iter().sum();
            assert!((rays..rays + rays / 50 + 600).contains(&total), "{total} for {rays}");
            assert!(sums.iter().all(|&n| 200 * n >= total), "{sums:?}");
        }
    }
}
