//! The phases of a build, timed.

use std::time::Instant;

use crate::event::Monitor;

/// What a phase took.
#[derive(Clone, Debug, PartialEq)]
pub struct Phase {
    /// Its name: "scan", "join", "count", "distribute", "chunks" or "stitch".
    pub name: &'static str,
    /// Seconds by the clock.
    pub seconds: f64,
    /// Processor seconds of the whole process; 0 where the system does not tell.
    pub cpu_seconds: f64,
}

/// Times phases; a name that comes again adds to its first entry.
pub(super) struct Phases<'a> {
    monitor: Monitor<'a>,
    done: Vec<Phase>,
    current: Option<(&'static str, Instant, f64)>,
}

impl<'a> Phases<'a> {
    pub fn new(monitor: Monitor<'a>) -> Self {
        Phases { monitor, done: Vec::new(), current: None }
    }

    /// Ends the current phase and begins another.
    pub fn begin(&mut self, name: &'static str) {
        self.end();
        self.monitor.phase(name);
        self.current = Some((name, Instant::now(), cpu_seconds()));
    }

    /// Ends the last phase.
    pub fn finish(mut self) -> Vec<Phase> {
        self.end();
        self.done
    }

    fn end(&mut self) {
        let Some((name, start, cpu)) = self.current.take() else { return };
        let (seconds, cpu_seconds) = (start.elapsed().as_secs_f64(), cpu_seconds() - cpu);
        match self.done.iter_mut().find(|phase| phase.name == name) {
            Some(phase) => {
                phase.seconds += seconds;
                phase.cpu_seconds += cpu_seconds;
            }
            None => self.done.push(Phase { name, seconds, cpu_seconds }),
        }
    }
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
