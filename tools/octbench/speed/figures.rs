//! `octbench figures`: the statistics of several runs of `octbench speed` as one Markdown table, with geometric means over all.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use octrace::{Error, Result};
use serde::Deserialize;

use crate::timing::geometric_mean;

/// What is read of a run's statistics.
#[derive(Deserialize)]
struct Run {
    model: String,
    triangles: u64,
    bytes_per_triangle: f64,
    rounds: u32,
    machine: Processor,
    peers: Vec<String>,
    sets: Vec<Set>,
}

#[derive(Deserialize)]
struct Processor {
    processor: String,
    cores: usize,
}

#[derive(Deserialize)]
struct Set {
    set: String,
    kernels: Vec<Own>,
    peers: Vec<Peer>,
}

#[derive(Deserialize)]
struct Own {
    kernel: String,
    isa: String,
    threads: usize,
    mrays_per_second: f64,
    ratios: Vec<f64>,
    cost_percent: Option<f64>,
}

#[derive(Deserialize)]
struct Peer {
    peer: usize,
    threads: usize,
    mrays_per_second: f64,
}

impl Own {
    fn name(&self) -> String {
        format!("{} {}{}", self.kernel, self.isa, threads(self.threads))
    }
}

/// Reads the runs and makes the table.
pub fn markdown(files: &[PathBuf]) -> Result<String> {
    let runs = files.iter().map(|file| read(file)).collect::<Result<Vec<_>>>()?;
    let Some(first) = runs.first() else { return Ok(String::new()) };
    for (run, file) in runs.iter().zip(files) {
        if run.peers != first.peers {
            let what = format!("measured beside {:?}, the first file beside {:?}", run.peers, first.peers);
            return Err(Error::Input { file: file.clone(), what });
        }
    }
    let mut text = format!(
        "{}, {} cores; medians of {} rounds in turn; Mrays/s, in brackets how many times as fast as each peer.\n\n",
        first.machine.processor, first.machine.cores, first.rounds
    );
    for run in &runs {
        let _ =
            writeln!(text, "- `{}`: {} triangles, {:.2} bytes each", run.model, run.triangles, run.bytes_per_triangle);
    }
    Ok(text + "\n" + &table(&runs, &first.peers))
}

fn read(file: &Path) -> Result<Run> {
    let text = std::fs::read_to_string(file).map_err(Error::io(file, "open"))?;
    serde_json::from_str(&text)
        .map_err(|e| Error::Input { file: file.to_owned(), what: format!("no statistics of octbench speed: {e}") })
}

/// A row a set; a column for each peer and each of our own ways.
fn table(runs: &[Run], names: &[String]) -> String {
    let sets = || runs.iter().flat_map(|run| run.sets.iter().map(move |set| (run, set)));
    let mut peers: Vec<(usize, usize)> =
        sets().flat_map(|(_, s)| s.peers.iter().map(|p| (p.peer, p.threads))).collect();
    peers.sort_by_key(|&(peer, threads)| (threads, peer));
    peers.dedup();
    let mut ways: Vec<String> = Vec::new();
    for way in sets().flat_map(|(_, set)| set.kernels.iter().map(Own::name)) {
        if !ways.contains(&way) {
            ways.push(way);
        }
    }
    let peer_name = |&(peer, n): &(usize, usize)| format!("{}{}", names[peer], threads(n));
    let heads: Vec<String> = peers.iter().map(peer_name).chain(ways.iter().cloned()).collect();
    let mut text = format!("| model, rays | {} |\n| --- |{}\n", heads.join(" | "), " ---: |".repeat(heads.len()));
    for (run, set) in sets() {
        let of_peer = |key: &(usize, usize)| set.peers.iter().find(|p| (p.peer, p.threads) == *key);
        let peer_cells = peers.iter().map(|key| of_peer(key).map(|p| format!("{:.2}", p.mrays_per_second)));
        let own_cells = ways.iter().map(|way| set.kernels.iter().find(|k| k.name() == *way).map(cell));
        let cells: Vec<String> = peer_cells.chain(own_cells).map(Option::unwrap_or_default).collect();
        let model = run.model.trim_end_matches(".oct");
        let _ = writeln!(text, "| {model}, {} | {} |", set.set, cells.join(" | "));
    }
    let mean = |way: &String| {
        let rows: Vec<&Own> = sets().flat_map(|(_, s)| &s.kernels).filter(|k| k.name() == *way).collect();
        let over = |peer| geometric_mean(&rows.iter().filter_map(|k| k.ratios.get(peer).copied()).collect::<Vec<_>>());
        let ratios = (0..names.len()).map(|peer| format!("{:.2}", over(peer))).collect::<Vec<_>>().join(", ");
        let slowdowns: Vec<f64> = rows.iter().filter_map(|k| Some(1.0 / (1.0 - k.cost_percent? / 100.0))).collect();
        let cost = match slowdowns.is_empty() {
            true => String::new(),
            false => format!(", exactness costs {:.1} %", 100.0 * (1.0 - 1.0 / geometric_mean(&slowdowns))),
        };
        if peers.is_empty() { cost.trim_start_matches(", ").to_owned() } else { format!("({ratios}){cost}") }
    };
    let means: Vec<String> = peers.iter().map(|_| String::new()).chain(ways.iter().map(mean)).collect();
    let _ = writeln!(text, "| **geometric mean** | {} |", means.join(" | "));
    text
}

fn cell(own: &Own) -> String {
    let ratios: Vec<String> = own.ratios.iter().map(|r| format!("{r:.2}")).collect();
    let cost = own.cost_percent.map_or(String::new(), |c| format!(", {c:.1} %"));
    let ratios = if ratios.is_empty() { String::new() } else { format!(" ({})", ratios.join(", ")) };
    format!("{:.2}{ratios}{cost}", own.mrays_per_second)
}

fn threads(n: usize) -> String {
    if n == 1 { String::new() } else { format!(", {n} threads") }
}
