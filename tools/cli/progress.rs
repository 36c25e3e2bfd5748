//! Progress and warnings on standard error: a bar with the time left on a terminal, a plain line now and then elsewhere.

use std::io::IsTerminal;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};
use octrace::{Event, Severity};

use super::diagnostics;

/// Time between plain lines.
const LINE_EVERY: Duration = Duration::from_secs(5);
/// Work shorter than this gets no plain line at all.
const FIRST_LINE: Duration = Duration::from_secs(1);
/// Warnings shown; further ones are only counted.
const WARNINGS_SHOWN: u64 = 50;

/// Shows the events of one run.
pub struct Reporter {
    name: String,
    quiet: bool,
    warnings: AtomicU64,
    whole: Mutex<Whole>,
    display: Display,
}

/// How far the whole work is, where its phases say which parts of it they are.
#[derive(Default)]
struct Whole {
    /// When something was told of such a phase first, and where in the whole: what was done before, by a build that was killed, says
    /// nothing of how long the rest takes.
    begun: Option<(Instant, f64)>,
    /// The part that the current phase is.
    part: Option<[f64; 2]>,
}

enum Display {
    /// `-q`.
    None,
    /// Standard error is a terminal.
    Bar(ProgressBar),
    /// It is not.
    Lines(Mutex<Lines>),
}

/// What the plain lines need to know.
struct Lines {
    phase: &'static str,
    phase_start: Instant,
    next: Instant,
}

impl Reporter {
    /// A reporter for the tool `name`.
    pub fn new(name: &str, quiet: bool) -> Reporter {
        let now = Instant::now();
        let display = if quiet {
            Display::None
        } else if std::io::stderr().is_terminal() {
            Display::Bar(bar())
        } else {
            Display::Lines(Mutex::new(Lines { phase: "", phase_start: now, next: now + FIRST_LINE }))
        };
        Reporter { name: name.to_owned(), quiet, warnings: AtomicU64::new(0), whole: Mutex::default(), display }
    }

    /// Whether the user asked for silence.
    pub fn quiet(&self) -> bool {
        self.quiet
    }

    /// Takes the bar away and says how many warnings were not shown.
    pub fn finish(&self) {
        if let Display::Bar(bar) = &self.display {
            bar.finish_and_clear();
        }
        let hidden = self.warnings.swap(0, Ordering::Relaxed).saturating_sub(WARNINGS_SHOWN);
        if hidden > 0 {
            let text = format!("{hidden} more warnings are not shown");
            diagnostics::say(&diagnostics::render_message(Severity::Warning, &text));
        }
    }

    /// Shows an event.
    pub fn show(&self, event: Event) {
        match event {
            Event::Phase { name, part } => self.phase(name, part),
            Event::Progress { done, total, unit } => self.progress(done, total, unit),
            Event::Note(text) => self.note(&text),
            Event::Warning(text) => self.warn(|| diagnostics::render_message(Severity::Warning, &text)),
            Event::Diagnostic(d) => self.warn(|| diagnostics::render(&d)),
            _ => {}
        }
    }

    fn phase(&self, name: &'static str, part: Option<[f64; 2]>) {
        self.whole.lock().unwrap_or_else(|e| e.into_inner()).part = part;
        match &self.display {
            Display::None => {}
            Display::Bar(bar) => {
                bar.reset();
                bar.unset_length();
                bar.set_style(style(None));
                bar.set_message(name);
            }
            Display::Lines(lines) => {
                let mut lines = lines.lock().unwrap_or_else(|e| e.into_inner());
                let now = Instant::now();
                (lines.phase, lines.phase_start) = (name, now);
                if lines.due(now, LINE_EVERY) {
                    diagnostics::say(&format!("{}: {name}", self.name));
                }
            }
        }
    }

    fn progress(&self, done: u64, total: Option<u64>, unit: &'static str) {
        let share = total.filter(|&total| total > 0).map(|total| done as f64 / total as f64);
        let whole = share
            .and_then(|share| self.whole.lock().unwrap_or_else(|e| e.into_inner()).told(share, Instant::now()))
            .map(|told| format!("; {told}"))
            .unwrap_or_default();
        match &self.display {
            Display::None => {}
            Display::Bar(bar) => {
                if bar.length() != total {
                    total.map_or_else(|| bar.unset_length(), |t| bar.set_length(t));
                    bar.set_style(style(total));
                }
                let left = total.map(|_| format!(", {} s left", bar.eta().as_secs())).unwrap_or_default();
                bar.set_prefix(format!("{unit}, {}{left}{whole}", rate(bar.per_sec(), unit)));
                bar.set_position(done);
            }
            Display::Lines(lines) => {
                // A thread that finds another at it has nothing to add.
                let Ok(mut lines) = lines.try_lock() else { return };
                let now = Instant::now();
                if lines.due(now, LINE_EVERY) {
                    let line = plain_line(lines.phase, done, total, unit, now - lines.phase_start);
                    diagnostics::say(&format!("{}: {line}{whole}", self.name));
                }
            }
        }
    }

    fn note(&self, text: &str) {
        match &self.display {
            Display::None => {}
            Display::Bar(bar) => bar.suspend(|| diagnostics::say(&format!("{}: {text}", self.name))),
            Display::Lines(_) => diagnostics::say(&format!("{}: {text}", self.name)),
        }
    }

    fn warn(&self, text: impl FnOnce() -> String) {
        if self.warnings.fetch_add(1, Ordering::Relaxed) >= WARNINGS_SHOWN {
            return;
        }
        match &self.display {
            Display::Bar(bar) => bar.suspend(|| diagnostics::say(&text())),
            _ => diagnostics::say(&text()),
        }
    }
}

impl Whole {
    /// `68 % of all, 200 s left`, when `share` of the current phase is done.
    fn told(&mut self, share: f64, now: Instant) -> Option<String> {
        let [from, to] = self.part?;
        let at = from + (to - from) * share.min(1.0);
        let (start, first) = *self.begun.get_or_insert((now, at));
        let left = (now - start).as_secs_f64() * (1.0 - at) / (at - first);
        (at > first).then(|| format!("{:.0} % of all, {left:.0} s left", at * 100.0))
    }
}

impl Lines {
    /// Whether a line may be printed now; if so, the next may come after `pause`.
    fn due(&mut self, now: Instant, pause: Duration) -> bool {
        let due = now >= self.next;
        if due {
            self.next = now + pause;
        }
        due
    }
}

/// The bar, which ticks by itself.
fn bar() -> ProgressBar {
    let bar = ProgressBar::no_length().with_style(style(None));
    bar.enable_steady_tick(Duration::from_millis(200));
    bar
}

/// With a total: phase, bar, per cent; without: phase, spinner, count. Then the unit, and with it rate and time left.
fn style(total: Option<u64>) -> ProgressStyle {
    let template = match total {
        Some(_) => "{msg:>10} {wide_bar} {percent:>3} % of {human_len} {prefix}",
        None => "{msg:>10} {spinner} {human_pos} {prefix}",
    };
    ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar())
}

/// A line such as `scan: 12 % of 300 bytes, 8 s left`.
fn plain_line(phase: &str, done: u64, total: Option<u64>, unit: &str, since: Duration) -> String {
    let seconds = since.as_secs_f64();
    let Some(total) = total.filter(|&t| t > 0) else {
        let rate = if seconds > 0.0 { rate(done as f64 / seconds, unit) } else { String::new() };
        return format!("{phase}: {done} {unit}, {rate}");
    };
    let share = done as f64 / total as f64;
    let left = if share > 0.0 && seconds > 0.0 {
        let left = seconds * (1.0 - share).max(0.0) / share;
        format!(", {}, {left:.0} s left", rate(done as f64 / seconds, unit))
    } else {
        String::new()
    };
    format!("{phase}: {:.0} % of {total} {unit}{left}", share * 100.0)
}

/// So many units a second: `12.3 MB/s`, `1.23 M triangles/s`.
fn rate(per_second: f64, unit: &str) -> String {
    match unit {
        "bytes" => format!("{:.1} MB/s", per_second * 1e-6),
        _ if per_second >= 1e5 => format!("{:.2} M {unit}/s", per_second * 1e-6),
        _ => format!("{per_second:.0} {unit}/s"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn plain_lines() {
        let ten = Duration::from_secs(10);
        let line = plain_line("scan", 25_000_000, Some(100_000_000), "bytes", ten);
        assert_eq!(line, "scan: 25 % of 100000000 bytes, 2.5 MB/s, 30 s left");
        let line = plain_line("join", 5_000_000, Some(10_000_000), "triangles", ten);
        assert_eq!(line, "join: 50 % of 10000000 triangles, 0.50 M triangles/s, 10 s left");
        assert_eq!(rate(12.4, "pages"), "12 pages/s");
        assert_eq!(plain_line("scan", 0, Some(100), "bytes", ten), "scan: 0 % of 100 bytes");
        assert_eq!(plain_line("scan", 30, None, "faces", ten), "scan: 30 faces, 3 faces/s");
        assert_eq!(plain_line("scan", 30, Some(0), "faces", ten), "scan: 30 faces, 3 faces/s");
    }

    #[test]
    fn the_whole_goes_on_from_phase_to_phase() {
        let start = Instant::now();
        let after = |seconds| start + Duration::from_secs(seconds);
        let mut whole = Whole::default();
        assert_eq!(whole.told(0.5, after(1)), None);
        // Taken up where a quarter was done: then all has to be judged by what was done since.
        whole.part = Some([0.2, 0.4]);
        assert_eq!(whole.told(0.25, start), None);
        assert_eq!(whole.told(0.5, after(10)).as_deref(), Some("30 % of all, 140 s left"));
        whole.part = Some([0.4, 1.0]);
        assert_eq!(whole.told(0.5, after(45)).as_deref(), Some("70 % of all, 30 s left"));
        whole.part = None;
        assert_eq!(whole.told(0.5, after(70)), None);
    }

    #[test]
    fn lines_keep_their_distance() {
        let now = Instant::now();
        let mut lines = Lines { phase: "", phase_start: now, next: now + FIRST_LINE };
        assert!(!lines.due(now, LINE_EVERY));
        assert!(lines.due(now + FIRST_LINE, LINE_EVERY));
        assert!(!lines.due(now + FIRST_LINE, LINE_EVERY));
    }
}
