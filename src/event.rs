//! What the library tells while it works: phases, progress and warnings, and the wish to stop.
//!
//! The library never prints. It sends [`Event`]s to the [`Monitor`] it is given; a tool shows them.

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};

use crate::error::{Diagnostic, Error, Result};

/// Something worth telling the user.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub enum Event {
    /// A new phase of the work begins.
    Phase {
        /// Its name, lower case ("scan", "join", "render").
        name: &'static str,
        /// Where in the whole work it is likely to begin and end, from 0 to 1, by the time that it takes; `None` where that
        /// cannot be told.
        part: Option<[f64; 2]>,
    },
    /// How far the current phase is.
    Progress {
        /// Units done.
        done: u64,
        /// Units in all, if known.
        total: Option<u64>,
        /// What a unit is ("bytes", "triangles", "tiles").
        unit: &'static str,
    },
    /// Something the user may want to know, though all is well.
    Note(String),
    /// Something is not as it should be, but the work goes on.
    Warning(String),
    /// The same, about a place in a text file.
    Diagnostic(Diagnostic),
    /// A file that the result depends on is about to be read; it need not be there.
    File(PathBuf),
}

/// Where events go, and whether the work should stop.
#[derive(Clone, Copy)]
pub struct Monitor<'a> {
    sink: &'a (dyn Fn(Event) + Sync),
    stop: &'a AtomicBool,
}

static NEVER: AtomicBool = AtomicBool::new(false);

impl<'a> Monitor<'a> {
    /// Events go to `sink`; the work stops soon after `stop` becomes true.
    pub fn new(sink: &'a (dyn Fn(Event) + Sync), stop: &'a AtomicBool) -> Self {
        Monitor { sink, stop }
    }

    /// Drops all events and never stops.
    pub fn silent() -> Monitor<'static> {
        Monitor { sink: &|_| {}, stop: &NEVER }
    }

    /// Sends an event.
    pub fn send(&self, event: Event) {
        (self.sink)(event);
    }

    /// Announces a phase.
    pub fn phase(&self, name: &'static str) {
        self.send(Event::Phase { name, part: None });
    }

    /// Announces a phase that is a known part of the whole.
    pub fn phase_of(&self, name: &'static str, part: Option<[f64; 2]>) {
        self.send(Event::Phase { name, part });
    }

    /// Reports progress.
    pub fn progress(&self, done: u64, total: Option<u64>, unit: &'static str) {
        self.send(Event::Progress { done, total, unit });
    }

    /// Tells something.
    pub fn note(&self, text: impl Into<String>) {
        self.send(Event::Note(text.into()));
    }

    /// Warns.
    pub fn warn(&self, text: impl Into<String>) {
        self.send(Event::Warning(text.into()));
    }

    /// Whether the work should stop.
    pub fn stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// [`Error::Interrupted`] if the work should stop.
    pub fn check(&self) -> Result<()> {
        if self.stopped() { Err(Error::Interrupted) } else { Ok(()) }
    }
}
