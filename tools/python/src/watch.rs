//! Work on a thread of its own, while the thread that asked for it tells Python how far it is.
//!
//! Only Python's main thread learns of Ctrl-C, and callbacks belong to the thread of the caller. So the caller waits here: it hears of
//! a new phase at once, the work waiting meanwhile, and of progress some ten times a second.

use std::collections::VecDeque;
use std::ffi::CString;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Condvar, Mutex, MutexGuard};
use std::time::Duration;

use octrace::{Event, Monitor};
use pyo3::intern;
use pyo3::prelude::*;
use pyo3::types::PyType;

use crate::errors::raise;

/// Time between two looks at how far the work is and whether the user wants to stop.
const LOOK: Duration = Duration::from_millis(100);
/// Warnings that are told; further ones are only counted.
const WARNINGS: u64 = 50;

/// Does `work` on another thread. `progress(phase, share)` is called on this one; what it raises, a warning that is an error, and Ctrl-C end the
/// work, and are the result.
pub fn watched<T: Send>(
    py: Python<'_>,
    progress: Option<&Bound<'_, PyAny>>,
    work: impl FnOnce(Monitor<'_>) -> octrace::Result<T> + Send,
) -> PyResult<T> {
    let board = Board::default();
    let stop = AtomicBool::new(false);
    let sink = |event: Event| board.post(event);
    std::thread::scope(|scope| {
        let worker = scope.spawn(|| {
            let _closes = Closes(&board);
            work(Monitor::new(&sink, &stop))
        });
        let mut raised = None;
        loop {
            let (told, ended) = py.detach(|| board.wait());
            if raised.is_none() {
                raised = tell(py, told, progress).and_then(|()| py.check_signals()).err();
            }
            if raised.is_some() {
                stop.store(true, Ordering::Relaxed);
            }
            board.heard(raised.is_some());
            if ended {
                break;
            }
        }
        let result = py.detach(|| worker.join()).unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        raised.map_or_else(|| result.map_err(raise), Err)
    })
}

/// Tells Python.
fn tell(py: Python<'_>, told: VecDeque<Told>, progress: Option<&Bound<'_, PyAny>>) -> PyResult<()> {
    for told in told {
        match (told, progress) {
            (Told::Progress(phase, share), Some(progress)) => drop(progress.call1((phase, share))?),
            (Told::Progress(..), None) => {}
            (Told::Note(text), _) => {
                let logging = py.import(intern!(py, "logging"))?;
                let log = logging.call_method1(intern!(py, "getLogger"), ("octrace",))?;
                log.call_method1(intern!(py, "info"), ("%s", text))?;
            }
            (Told::Warning(text), _) => {
                let class = py.import("octrace.errors")?.getattr("BuildWarning")?.cast_into::<PyType>()?;
                let text = CString::new(text.replace('\0', " ")).unwrap_or_default();
                PyErr::warn(py, &class, &text, 1)?;
            }
        }
    }
    Ok(())
}

/// Something for Python.
enum Told {
    /// A phase, and how far the whole work is, from 0 to 1.
    Progress(&'static str, f64),
    Note(String),
    Warning(String),
}

/// Where the work writes what Python is to be told.
#[derive(Default)]
struct Board {
    state: Mutex<State>,
    /// There is something that cannot wait.
    news: Condvar,
    /// What there was has been told.
    heard: Condvar,
}

#[derive(Default)]
struct State {
    told: VecDeque<Told>,
    /// Phases that have begun, those of them that were taken to be told, and those that have been told.
    begun: u64,
    taken: u64,
    heard: u64,
    /// The work has ended.
    ended: bool,
    /// Nobody listens any more.
    deaf: bool,
    warnings: u64,
    phase: &'static str,
    /// Which part of the whole the phase is, if that is known, and how far the whole is.
    part: Option<[f64; 2]>,
    share: f64,
}

impl Board {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(|e| e.into_inner())
    }

    /// Takes an event of the work. One that begins a phase returns when Python has been told.
    fn post(&self, event: Event) {
        let mut state = self.lock();
        if state.deaf {
            return;
        }
        match event {
            Event::Phase { name, part } => {
                (state.phase, state.part) = (name, part);
                state.reach(part.map_or(0.0, |[from, _]| from));
                state.begun += 1;
                let this = state.begun;
                self.news.notify_one();
                drop(self.heard.wait_while(state, |state| !state.deaf && state.heard < this));
            }
            Event::Progress { done, total: Some(total), .. } if total > 0 => {
                if let Some([from, to]) = state.part {
                    state.reach(from + (to - from) * (done as f64 / total as f64).min(1.0));
                }
            }
            Event::Note(text) => state.told.push_back(Told::Note(text)),
            Event::Warning(text) => state.warn(|| text),
            Event::Diagnostic(diagnostic) => state.warn(|| diagnostic.to_string()),
            _ => {}
        }
    }

    /// Waits for something to tell, but not long; whether the work has ended.
    fn wait(&self) -> (VecDeque<Told>, bool) {
        let idle = |state: &mut State| !state.ended && state.taken == state.begun;
        let waited = self.news.wait_timeout_while(self.lock(), LOOK, idle);
        let mut state = waited.unwrap_or_else(|e| e.into_inner()).0;
        if state.ended && state.warnings > WARNINGS {
            let text = format!("{} more warnings are not shown", state.warnings - WARNINGS);
            state.told.push_back(Told::Warning(text));
        }
        state.taken = state.begun;
        (std::mem::take(&mut state.told), state.ended)
    }

    /// What was taken has been told; `deaf`: and nothing more will be.
    fn heard(&self, deaf: bool) {
        let mut state = self.lock();
        (state.heard, state.deaf) = (state.taken, deaf);
        if deaf {
            state.told.clear();
        }
        drop(state);
        self.heard.notify_all();
    }
}

impl State {
    /// The whole never goes back. Only the latest of several such news in a row is kept.
    fn reach(&mut self, share: f64) {
        self.share = self.share.max(share);
        let now = Told::Progress(self.phase, self.share);
        match self.told.back_mut() {
            Some(last @ Told::Progress(..)) => *last = now,
            _ => self.told.push_back(now),
        }
    }

    fn warn(&mut self, text: impl FnOnce() -> String) {
        self.warnings += 1;
        if self.warnings <= WARNINGS {
            self.told.push_back(Told::Warning(text()));
        }
    }
}

/// Says that the work has ended, also when it panicked.
struct Closes<'a>(&'a Board);

impl Drop for Closes<'_> {
    fn drop(&mut self) {
        self.0.lock().ended = true;
        self.0.news.notify_one();
    }
}
