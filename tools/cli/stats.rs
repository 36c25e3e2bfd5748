//! Statistics for other programs: peak memory, processor time, and the JSON file.

use std::path::Path;

use indicatif::{BinaryBytes, HumanCount};
use octrace::Error;
use octrace::map::Figures;

use super::args::is_stdio;
use super::output;

/// The `schema` field of every statistics file.
pub const SCHEMA: u32 = 1;

/// What was left out of a mesh.
#[derive(serde::Serialize)]
pub struct Dropped {
    /// Triangles of zero area.
    pub degenerate: u64,
    /// Triangles with a vertex that is not finite.
    pub non_finite: u64,
    /// Triangles of a face with a bad index.
    pub bad_index: u64,
    /// Faces with fewer than three corners.
    pub too_few_corners: u64,
}

impl From<octrace::format::Dropped> for Dropped {
    fn from(d: octrace::format::Dropped) -> Dropped {
        Dropped {
            degenerate: d.degenerate,
            non_finite: d.non_finite,
            bad_index: d.bad_index,
            too_few_corners: d.too_few_corners,
        }
    }
}

/// Pages of all files. In a mapped file each page that is touched is read once, when it is checked.
#[derive(Default, serde::Serialize)]
pub struct Pages {
    pub total: u64,
    pub touched: u64,
    read: u64,
    reread: u64,
    bytes_touched: u64,
    bytes_read: u64,
    /// The share of visits to pages that found them in memory; none where that is not counted, as files are mapped.
    hit_rate: Option<f64>,
    stalls: u64,
    stalled_seconds: f64,
}

impl Pages {
    /// The sums over all files.
    pub fn of(files: impl IntoIterator<Item = Figures>) -> Pages {
        let all: Vec<Figures> = files.into_iter().collect();
        let sum = |count: fn(&Figures) -> u64| all.iter().map(count).sum::<u64>();
        let (entered, read) = (sum(|f| f.entered), sum(|f| f.read));
        Pages {
            total: sum(|f| f.total),
            touched: sum(|f| f.touched),
            read,
            reread: sum(|f| f.reread),
            bytes_touched: sum(|f| f.bytes_touched),
            bytes_read: sum(|f| f.bytes_read),
            hit_rate: (entered > 0).then(|| entered as f64 / (entered + read) as f64),
            stalls: sum(|f| f.stalls),
            stalled_seconds: all.iter().map(|f| f.stalled_seconds).sum(),
        }
    }

    /// What was read, for people.
    pub fn line(&self) -> String {
        let again = match self.reread {
            0 => String::new(),
            again => format!(", {} of them again", HumanCount(again)),
        };
        let [touched, total, read] = [self.touched, self.total, self.read].map(HumanCount);
        format!("{touched} of {total} pages, {read} read{again} ({})", BinaryBytes(self.bytes_read))
    }
}

/// Writes statistics as JSON: to standard output for `-`, else to a file that appears whole or not at all.
pub fn write(path: &Path, stats: &impl serde::Serialize) -> Result<(), Error> {
    let mut text = serde_json::to_string_pretty(stats)
        .map_err(|e| Error::Option(format!("cannot write statistics as JSON: {e}")))?;
    text.push('\n');
    if is_stdio(path) {
        return output::print(&text);
    }
    output::write_whole(path, text.as_bytes())
}

/// Peak resident set of this process in bytes; 0 where the system does not tell.
pub fn peak_rss_bytes() -> u64 {
    high_water_mark().or_else(usage_peak).unwrap_or(0)
}

/// Linux: `VmHWM`, which counts anonymous, mapped and shared pages.
fn high_water_mark() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|l| l.strip_prefix("VmHWM:"))?;
    let kib: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kib * 1024)
}

#[cfg(unix)]
fn usage_peak() -> Option<u64> {
    let peak = nix::sys::resource::getrusage(nix::sys::resource::UsageWho::RUSAGE_SELF).ok()?.max_rss();
    let unit = if cfg!(target_vendor = "apple") { 1 } else { 1024 };
    Some(u64::try_from(peak).ok()? * unit)
}

#[cfg(not(unix))]
fn usage_peak() -> Option<u64> {
    None
}

/// Processor time of this process so far, user and system, in seconds; 0 where the system does not tell.
#[cfg(unix)]
pub fn cpu_seconds() -> f64 {
    let seconds = |t: nix::sys::time::TimeVal| t.tv_sec() as f64 + t.tv_usec() as f64 * 1e-6;
    nix::sys::resource::getrusage(nix::sys::resource::UsageWho::RUSAGE_SELF)
        .map_or(0.0, |u| seconds(u.user_time()) + seconds(u.system_time()))
}

/// Processor time; not known on this system.
#[cfg(not(unix))]
pub fn cpu_seconds() -> f64 {
    0.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_process_has_used_something() {
        let block = vec![1u8; 64 << 20];
        assert_eq!(block.iter().map(|&b| u64::from(b)).sum::<u64>(), 64 << 20);
        if cfg!(target_os = "linux") {
            assert!(peak_rss_bytes() > 64 << 20 && cpu_seconds() > 0.0);
        }
    }
}
