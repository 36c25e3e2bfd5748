//! What is told: as JSON in these fields; `text` tells it to people.

mod text;

use octrace::map::Octree;
use octrace::trace::Counters;
use octrace::{Monitor, Result};
use serde::Serialize;

use super::measure::{Outcome, Own, Times};
use super::peer::Peer;
use super::sets::{Question, RaySet};
use crate::machine::Machine;
use crate::timing::{Clock, geometric_mean, mrays, ratio};

/// Everything that was found out.
#[derive(Serialize)]
pub struct Report {
    schema: u32,
    model: String,
    triangles: u64,
    bytes: u64,
    bytes_per_triangle: f64,
    /// Bytes a triangle, by part.
    by_part: Parts,
    machine: Machine,
    rounds: u32,
    clock: Clock,
    peers: Vec<String>,
    sets: Vec<Set>,
    /// Geometric means over the sets.
    means: Vec<Mean>,
    /// What exactness costs: geometric means over the sets.
    costs: Vec<Cost>,
    /// Sets and kernels whose answers were not those of the first exact kernel.
    pub differing: u64,
}

#[derive(Serialize)]
struct Parts {
    nodes: f64,
    leaf_vertices: f64,
    leaf_corners: f64,
    ids: f64,
    attributes: f64,
    level_of_detail: f64,
    rest: f64,
}

#[derive(Serialize)]
struct Set {
    set: String,
    question: Question,
    rays: u64,
    kernels: Vec<Row>,
    peers: Vec<PeerRow>,
}

/// One kernel on one set.
#[derive(Serialize)]
struct Row {
    kernel: &'static str,
    isa: &'static str,
    threads: usize,
    hits: u64,
    seconds: Vec<f64>,
    mrays_per_second: f64,
    nodes_per_ray: f64,
    leaves_per_ray: f64,
    triangles_per_ray: f64,
    pages_per_ray: f64,
    doubts_per_ray: f64,
    exact_per_ray: f64,
    /// How many times as fast as each peer with as many threads.
    ratios: Vec<f64>,
    /// By how much slower than the float kernel that does the same, in percent.
    cost_percent: Option<f64>,
    /// Exact, but with other answers than the first exact kernel.
    differs: bool,
}

#[derive(Serialize)]
struct PeerRow {
    peer: usize,
    threads: usize,
    hits: u64,
    seconds: Vec<f64>,
    mrays_per_second: f64,
}

/// A kernel against a peer, over all sets.
#[derive(Serialize)]
struct Mean {
    kernel: &'static str,
    isa: &'static str,
    threads: usize,
    peer: usize,
    sets: usize,
    geometric_mean: f64,
    least: f64,
    least_set: String,
}

/// An exact kernel against the float kernel that does the same, over all sets.
#[derive(Serialize)]
struct Cost {
    kernel: &'static str,
    isa: &'static str,
    threads: usize,
    sets: usize,
    percent: f64,
}

impl Report {
    /// A report without sets; reads the whole file to tell what its bytes are spent on.
    pub fn new(octree: &Octree, rounds: u32, clock: Clock, peers: &[Peer], monitor: Monitor<'_>) -> Result<Report> {
        let (h, p) = (octree.header(), octree.parts(monitor)?);
        let each = |bytes: u64| bytes as f64 / h.triangles.max(1) as f64;
        Ok(Report {
            schema: crate::cli::stats::SCHEMA,
            model: octree.path().file_name().unwrap_or_default().to_string_lossy().into_owned(),
            triangles: h.triangles,
            bytes: h.file_bytes,
            bytes_per_triangle: each(h.file_bytes),
            by_part: Parts {
                nodes: each(p.nodes),
                leaf_vertices: each(p.leaf_vertices),
                leaf_corners: each(p.leaf_corners),
                ids: each(p.ids),
                attributes: each(p.materials + p.normals + p.texcoords),
                level_of_detail: each(p.detail),
                rest: each(p.header + p.top + p.page_headers + p.padding),
            },
            machine: Machine::here(),
            rounds,
            clock,
            peers: peers.iter().map(|p| p.name.clone()).collect(),
            sets: vec![],
            means: vec![],
            costs: vec![],
            differing: 0,
        })
    }

    /// Adds what a set gave.
    pub fn add(&mut self, set: &RaySet, ways: &[Own<'_>], peers: &[Peer], outcome: &Outcome) {
        let rays = set.rays.len() as u64;
        let mut kernels = Vec::new();
        for (number, times) in &outcome.own {
            let way = &ways[*number];
            let threads = way.pool.current_num_threads();
            let of_peer = |peer: usize| {
                let same = |p: &&(usize, usize, Times)| (p.0, p.1) == (peer, threads);
                outcome.peers.iter().find(same).map(|p| ratio(&times.seconds, &p.2.seconds))
            };
            let float = outcome.own.iter().find(|(other, _)| {
                let other = &ways[*other];
                other.kernel.float_of == Some(way.kernel.name)
                    && (other.tracer.isa(), other.pool.current_num_threads()) == (way.tracer.isa(), threads)
            });
            let mut row = Row::new(way, rays, times);
            row.ratios = (0..peers.len()).filter_map(of_peer).collect();
            row.cost_percent = float.map(|(_, float)| cost_percent(ratio(&float.seconds, &times.seconds)));
            row.differs = outcome.differing.contains(number);
            self.differing += u64::from(row.differs);
            kernels.push(row);
        }
        let peer_row = |(peer, threads, times): &(usize, usize, Times)| PeerRow {
            peer: *peer,
            threads: *threads,
            hits: times.hits,
            mrays_per_second: mrays(rays, &times.seconds),
            seconds: times.seconds.clone(),
        };
        let peers = outcome.peers.iter().map(peer_row).collect();
        self.sets.push(Set { set: set.name.clone(), question: set.question, rays, kernels, peers });
    }

    /// Adds up all sets.
    pub fn finish(&mut self) {
        let mut ways: Vec<_> = self.sets.iter().flat_map(|s| s.kernels.iter().map(Row::way)).collect();
        let mut seen = Vec::new();
        ways.retain(|way| {
            !seen.contains(way) && {
                seen.push(*way);
                true
            }
        });
        for way @ (kernel, isa, threads) in ways {
            let rows =
                || self.sets.iter().flat_map(|s| s.kernels.iter().map(move |k| (s, k))).filter(|(_, k)| k.way() == way);
            for peer in 0..self.peers.len() {
                let ratios: Vec<_> = rows().filter_map(|(s, k)| Some((&s.set, *k.ratios.get(peer)?))).collect();
                let Some((set, least)) = ratios.iter().copied().min_by(|a, b| a.1.total_cmp(&b.1)) else { continue };
                let values: Vec<f64> = ratios.iter().map(|r| r.1).collect();
                let geometric_mean = geometric_mean(&values);
                let (sets, least_set) = (ratios.len(), set.clone());
                self.means.push(Mean { kernel, isa, threads, peer, sets, geometric_mean, least, least_set });
            }
            let costs: Vec<f64> = rows().filter_map(|(_, k)| k.cost_percent).collect();
            if !costs.is_empty() {
                let slowdowns: Vec<f64> = costs.iter().map(|c| 1.0 / (1.0 - c / 100.0)).collect();
                let percent = cost_percent(geometric_mean(&slowdowns));
                self.costs.push(Cost { kernel, isa, threads, sets: costs.len(), percent });
            }
        }
    }
}

impl Row {
    fn new(way: &Own<'_>, rays: u64, times: &Times) -> Row {
        let Counters { nodes, leaves, triangles, bricks, doubts, exact, .. } = times.work;
        let each = |n: u64| n as f64 / rays.max(1) as f64;
        Row {
            kernel: way.kernel.name,
            isa: way.tracer.isa().name(),
            threads: way.pool.current_num_threads(),
            hits: times.hits,
            mrays_per_second: mrays(rays, &times.seconds),
            seconds: times.seconds.clone(),
            nodes_per_ray: each(nodes),
            leaves_per_ray: each(leaves),
            triangles_per_ray: each(triangles),
            pages_per_ray: each(bricks),
            doubts_per_ray: each(doubts),
            exact_per_ray: each(exact),
            ratios: vec![],
            cost_percent: None,
            differs: false,
        }
    }

    fn way(&self) -> (&'static str, &'static str, usize) {
        (self.kernel, self.isa, self.threads)
    }
}

/// The share of speed that is lost, in percent, where the float kernel is `slowdown` times as fast as the exact one.
fn cost_percent(slowdown: f64) -> f64 {
    100.0 * (1.0 - 1.0 / slowdown)
}

#[cfg(test)]
mod tests {
    use octrace::build::BuildOptions;
    use octrace::trace::Isa;

    use super::super::kernels::Kernel;
    use super::*;

    const EXACT: Kernel = Kernel { name: "single", float_of: None, closest: None, any: None };
    const FLOAT: Kernel = Kernel { name: "float", float_of: Some("single"), closest: None, any: None };

    #[test]
    fn what_exactness_costs_is_told_by_set_and_over_all() {
        let octree = crate::bench::octree(&crate::planet::mesh(300, 1), &BuildOptions::default()).unwrap();
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        let kernels: [&'static Kernel; 2] = [&EXACT, &FLOAT];
        let ways = kernels.map(|kernel| Own::new(&octree, kernel, Isa::best(), &pool));
        let mut report = Report::new(&octree, 3, Clock::Wall, &[], Monitor::silent()).unwrap();
        // Exact rounds take 1.25 times as long in one set, as long in the other.
        for (name, exact) in [("slow", 1.25), ("even", 1.0)] {
            let set = RaySet { name: name.to_owned(), question: Question::Closest, rays: vec![], file: None };
            let times = |seconds: f64| Times { seconds: vec![seconds; 3], ..Times::default() };
            let outcome = Outcome { own: vec![(0, times(exact)), (1, times(1.0))], peers: vec![], differing: vec![] };
            report.add(&set, &ways, &[], &outcome);
        }
        report.finish();
        let of_set = |i: usize| report.sets[i].kernels[0].cost_percent.unwrap();
        assert!((of_set(0) - 20.0).abs() < 1e-9 && of_set(1).abs() < 1e-9);
        assert!(report.sets.iter().all(|s| s.kernels[1].cost_percent.is_none()));
        assert_eq!(report.costs.len(), 1);
        assert!((report.costs[0].percent - 100.0 * (1.0 - 1.0 / 1.25f64.sqrt())).abs() < 1e-9);
        assert!(report.table().contains("exactness costs 10.6 % (geometric mean of 2 sets)"), "{}", report.table());
        assert!(report.markdown().contains(" 20.0 % |"));
    }
}
