//! The phases of a build, timed.

use std::time::Instant;

use crate::event::Monitor;

/// What a phase took.
#[derive(Clone, Debug, PartialEq)]
pub struct Phase {
    /// Its name: "scan", "join", "split", "count", "distribute", "chunks" or "stitch".
    pub name: &'static str,
    /// Seconds by the clock.
    pub seconds: f64,
    /// Processor seconds of the whole process; 0 where the system does not tell.
    pub cpu_seconds: f64,
    /// Bytes that the process read: from files, pipes and the input, cached or not; 0 where the system does not tell.
    pub bytes_read: u64,
    /// Bytes that it wrote, likewise.
    pub bytes_written: u64,
    /// Most bytes of the process that were resident until the phase ended; 0 where the system does not tell.
    pub peak_rss_bytes: u64,
}

/// The phases in order, and what time each takes, about: of a hundred for a scan of ten million triangles on two cores, which has
/// nothing to split and is counted by the join.
const USUAL: [(&str, f64); 7] = [
    ("scan", 10.0),
    ("join", 14.0),
    ("split", 8.0),
    ("count", 2.0),
    (SORTING, 10.0),
    ("chunks", 65.0),
    ("stitch", 1.0),
];
/// The phase that a mesh skips whose triangles fit in memory.
const SORTING: &str = "distribute";
/// Phases that are needed now and then only, which shows when they begin.
const SELDOM: [&str; 2] = ["split", "count"];

/// Times phases; a name that comes again adds to its first entry.
pub(super) struct Phases<'a> {
    memory: u64,
    monitor: Monitor<'a>,
    /// Whether it was told already that memory passes its bound, or had passed it before.
    told: bool,
    /// Whether triangles are likely to be sorted.
    sorts: bool,
    /// The phase that is farthest in the order, by its place there, and where in the whole it begins and ends.
    farthest: Option<(usize, [f64; 2])>,
    done: Vec<Phase>,
    current: Option<(&'static str, Instant, f64, [u64; 2])>,
}

impl<'a> Phases<'a> {
    pub fn new(memory: u64, monitor: Monitor<'a>) -> Self {
        Phases { memory, monitor, told: peak() > memory, sorts: false, farthest: None, done: Vec::new(), current: None }
    }

    /// Ends the current phase and begins another.
    pub fn begin(&mut self, name: &'static str) {
        self.end();
        let part = self.part(name);
        self.monitor.phase_of(name, part);
        self.current = Some((name, Instant::now(), cpu_seconds(), transferred()));
    }

    /// Where in the whole a phase that begins now begins and ends; `None` if a later one has begun, within which it goes on.
    ///
    /// What is left of the whole is shared by the phases to come, so that one that was not expected moves no other back.
    fn part(&mut self, name: &str) -> Option<[f64; 2]> {
        let place = USUAL.iter().position(|phase| phase.0 == name)?;
        let is_expected = |name: &str| !SELDOM.contains(&name) && (self.sorts || name != SORTING);
        let time = |(name, time): &(&str, f64)| if is_expected(name) { *time } else { 0.0 };
        let after: f64 = USUAL[place + 1..].iter().map(time).sum();
        let left = USUAL[place].1 + after;
        let from = match self.farthest {
            Some((farthest, _)) if farthest > place => return None,
            Some((farthest, part)) if farthest == place => return Some(part),
            Some((_, [_, to])) => to,
            None => {
                let before: f64 = USUAL[..place].iter().map(time).sum();
                before / (before + left)
            }
        };
        let part = [from, from + (1.0 - from) * USUAL[place].1 / left];
        self.farthest = Some((place, part));
        Some(part)
    }

    /// Says whether triangles are likely to be sorted into chunks: the phases to come take other parts of the whole then.
    pub fn expect_sorting(&mut self, sorts: bool) {
        self.sorts = sorts;
    }

    /// Ends the last phase.
    pub fn finish(mut self) -> Vec<Phase> {
        self.end();
        self.done
    }

    fn end(&mut self) {
        let Some((name, start, cpu, before)) = self.current.take() else { return };
        let now = transferred();
        let [bytes_read, bytes_written] = [0, 1].map(|i| now[i].saturating_sub(before[i]));
        let peak_rss_bytes = peak();
        if peak_rss_bytes > self.memory && !std::mem::replace(&mut self.told, true) {
            let (peak, memory) = (peak_rss_bytes >> 10, self.memory >> 10);
            self.monitor.warn(format!("the phase {name} took {peak} KiB of memory, more than the {memory} allowed; the file is right, but please report this"));
        }
        let (seconds, cpu_seconds) = (start.elapsed().as_secs_f64(), cpu_seconds() - cpu);
        match self.done.iter_mut().find(|phase| phase.name == name) {
            Some(phase) => {
                phase.seconds += seconds;
                phase.cpu_seconds += cpu_seconds;
                phase.bytes_read += bytes_read;
                phase.bytes_written += bytes_written;
                phase.peak_rss_bytes = peak_rss_bytes;
            }
            None => self.done.push(Phase { name, seconds, cpu_seconds, bytes_read, bytes_written, peak_rss_bytes }),
        }
    }
}

/// Bytes of the process's memory that are resident now; 0 where the system does not tell.
pub(super) fn resident() -> u64 {
    status("VmRSS:")
}

/// Most bytes that were ever resident; 0 where the system does not tell.
pub(super) fn peak() -> u64 {
    status("VmHWM:")
}

/// Bytes read and written so far: `rchar` and `wchar` of Linux's /proc/self/io (proc_pid_io(5)).
fn transferred() -> [u64; 2] {
    let io = std::fs::read_to_string("/proc/self/io").unwrap_or_default();
    let count = |key: &str| io.lines().find_map(|line| line.strip_prefix(key)?.trim().parse().ok()).unwrap_or(0);
    [count("rchar:"), count("wchar:")]
}

/// A line of Linux's /proc/self/status (proc_pid_status(5)) that counts KiB.
fn status(key: &str) -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix(key));
    let kib = line.and_then(|line| line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok());
    1024 * kib.unwrap_or(0)
}

/// User and system time of the process so far, in steps of 10 ms, from Linux's /proc (proc_pid_stat(5), fields 14, 15).
fn cpu_seconds() -> f64 {
    // Linux counts these in USER_HZ, which is 100 on every architecture that Rust supports.
    const TICKS: f64 = 100.0;
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    // The second field is the program's name in brackets and may hold anything, so count from its end.
    let fields = stat.rsplit(')').next().unwrap_or_default().split_whitespace();
    fields.skip(11).take(2).filter_map(|ticks| ticks.parse::<f64>().ok()).sum::<f64>() / TICKS
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::event::Event;
    use std::sync::Mutex;
    use std::sync::atomic::AtomicBool;

    /// The parts that phases are told to be, when they begin in this order.
    fn parts(sorts: bool, names: &[&'static str]) -> Vec<Option<[f64; 2]>> {
        let told = Mutex::new(Vec::new());
        let sink = |event: Event| {
            if let Event::Phase { part, .. } = event {
                told.lock().unwrap().push(part);
            }
        };
        let stop = AtomicBool::new(false);
        let mut phases = Phases::new(u64::MAX, Monitor::new(&sink, &stop));
        phases.expect_sorting(sorts);
        names.iter().for_each(|name| phases.begin(name));
        assert!(phases.finish().iter().all(|phase| names.contains(&phase.name)));
        told.into_inner().unwrap()
    }

    #[test]
    fn phases_fill_the_whole_one_after_the_other() {
        for (sorts, names) in [
            (false, &["scan", "join", "chunks", "stitch"][..]),
            (true, &["scan", "join", "distribute", "chunks", "stitch"]),
            (true, &["scan", "join", "split", "count", "distribute", "chunks", "stitch"]),
            // Sorting shows only when it begins.
            (false, &["scan", "join", "count", "distribute", "chunks", "stitch"]),
        ] {
            let mut end = 0.0;
            for part in parts(sorts, names) {
                let [from, to] = part.unwrap();
                assert!((from - end).abs() < 1e-9 && to > from + 1e-3, "{names:?}: {from} {to}");
                end = to;
            }
            assert!((end - 1.0).abs() < 1e-9);
        }
        // A build that goes on begins where the one before was.
        let [from, to] = parts(true, &["chunks"])[0].unwrap();
        assert!((from - 0.34).abs() < 1e-9 && (to - 0.99).abs() < 1e-9);
    }

    #[test]
    fn what_is_sorted_again_is_no_part_of_its_own() {
        let names = ["scan", "join", "distribute", "chunks", "count", "distribute", "chunks", "stitch"];
        let parts = parts(true, &names);
        let told: Vec<bool> = parts.iter().map(Option::is_some).collect();
        assert_eq!(told, [true, true, true, true, false, false, true, true]);
        assert_eq!(parts[3], parts[6]);
    }
}
