//! The machine that figures come from.

use std::fmt;

use octrace::trace::Isa;
use serde::Serialize;

/// Processor and cores.
#[derive(Clone, Debug, Serialize)]
pub struct Machine {
    /// The processor's name for itself; its kind where it has none.
    pub processor: String,
    /// Cores that this process may use.
    pub cores: usize,
    /// The best instruction set that the tracer uses here.
    pub isa: &'static str,
}

impl Machine {
    /// This machine.
    pub fn here() -> Machine {
        Machine {
            processor: model_name().unwrap_or_else(|| std::env::consts::ARCH.to_owned()),
            cores: std::thread::available_parallelism().map_or(1, usize::from),
            isa: Isa::best().name(),
        }
    }
}

impl fmt::Display for Machine {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let cores = if self.cores == 1 { "core" } else { "cores" };
        write!(f, "{}, {} {cores}, {}", self.processor, self.cores, self.isa)
    }
}

/// Linux: the first `model name` of `/proc/cpuinfo`.
fn model_name() -> Option<String> {
    let text = std::fs::read_to_string("/proc/cpuinfo").ok()?;
    let (_, name) = text.lines().find(|l| l.starts_with("model name"))?.split_once(':')?;
    Some(name.split_whitespace().collect::<Vec<_>>().join(" "))
}
