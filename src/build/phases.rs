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

/// Times phases; a name that comes again adds to its first entry.
pub(super) struct Phases<'a> {
    memory: u64,
    monitor: Monitor<'a>,
    /// Whether it was told already that memory passes its bound, or had passed it before.
    told: bool,
    done: Vec<Phase>,
    current: Option<(&'static str, Instant, f64, [u64; 2])>,
}

impl<'a> Phases<'a> {
    pub fn new(memory: u64, monitor: Monitor<'a>) -> Self {
        Phases { memory, monitor, told: peak() > memory, done: Vec::new(), current: None }
    }

    /// Ends the current phase and begins another.
    pub fn begin(&mut self, name: &'static str) {
        self.end();
        self.monitor.phase(name);
        self.current = Some((name, Instant::now(), cpu_seconds(), transferred()));
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
            self.monitor.warn(format!("the phase {name} took {peak} KiB of memory, more than the {memory} allowed"));
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
