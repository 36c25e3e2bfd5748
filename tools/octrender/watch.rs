//! `--watch`: draws again whenever a file changes that the picture depends on.
//!
//! Files are looked at a few times a second: notices of the system are cheaper, but do not tell of changes that other machines make on a shared file
//! system.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, SystemTime};

use octrace::{Error, Event, Result};

use crate::cli::{Session, diagnostics, interrupt};

/// Time between looks.
const LOOK_EVERY: Duration = Duration::from_millis(200);

/// What is seen of a file without reading it; nothing if it is not there.
type Look = Option<(u64, Option<SystemTime>, u64)>;

/// Files, and how each was when it was about to be read.
type Files = BTreeMap<PathBuf, Look>;

fn look(path: &Path) -> Look {
    let metadata = std::fs::metadata(path).ok()?;
    #[cfg(unix)]
    let number = std::os::unix::fs::MetadataExt::ino(&metadata);
    #[cfg(not(unix))]
    let number = 0;
    Some((metadata.len(), metadata.modified().ok(), number))
}

fn changed(files: &Files) -> bool {
    files.iter().any(|(path, before)| look(path) != *before)
}

fn ctrl_c() -> bool {
    interrupt::flag().load(Ordering::Relaxed)
}

/// Calls `draw` again and again, each time that `input` or a file of which it told has changed. A change while it draws stops it.
///
/// Ctrl-C while waiting is the end, and while drawing [`Error::Interrupted`]. Other errors are printed, and the next change awaited.
pub fn watch(input: &Path, session: &Session<'_>, draw: impl Fn(&Session<'_>) -> Result<ExitCode>) -> Result<ExitCode> {
    let mut before = Files::new();
    loop {
        let (result, files) = once(input, session, &draw);
        match result {
            _ if ctrl_c() => return Err(Error::Interrupted),
            Ok(_) => before = files,
            Err(error) => {
                session.finish();
                if !matches!(error, Error::Interrupted) {
                    diagnostics::print_error(&error);
                }
                // Where it ended early, files that it has not come to matter still.
                before.extend(files);
            }
        }
        if !changed(&before) {
            session.say(format!("watching {} files; Ctrl-C ends", before.len()));
        }
        while !changed(&before) {
            if ctrl_c() {
                return Ok(ExitCode::SUCCESS);
            }
            std::thread::sleep(LOOK_EVERY);
        }
        settle(&before);
    }
}

/// Draws, unless a file changes meanwhile; which files it has read.
fn once(
    input: &Path,
    session: &Session<'_>,
    draw: &impl Fn(&Session<'_>) -> Result<ExitCode>,
) -> (Result<ExitCode>, Files) {
    let files = Mutex::new(Files::from([(input.to_owned(), look(input))]));
    let (stop, over) = (AtomicBool::new(false), AtomicBool::new(false));
    let lock = || files.lock().unwrap_or_else(|poison| poison.into_inner());
    let sink = |event: Event| {
        if let Event::File(path) = &event {
            lock().entry(path.clone()).or_insert_with(|| look(path));
        }
        session.monitor().send(event);
    };
    let watched = session.with(&sink, &stop);
    let result = std::thread::scope(|scope| {
        let looking = scope.spawn(|| {
            while !over.load(Ordering::Relaxed) {
                if ctrl_c() || changed(&lock()) {
                    stop.store(true, Ordering::Relaxed);
                    return;
                }
                std::thread::park_timeout(LOOK_EVERY);
            }
        });
        let result = draw(&watched);
        over.store(true, Ordering::Relaxed);
        looking.thread().unpark();
        result
    });
    (result, files.into_inner().unwrap_or_else(|poison| poison.into_inner()))
}

/// Waits until files change no more: an editor may write several, and each in several steps.
fn settle(files: &Files) {
    let looks = || files.keys().map(|path| look(path)).collect::<Vec<_>>();
    let mut before = looks();
    while !ctrl_c() {
        std::thread::sleep(LOOK_EVERY);
        let now = looks();
        if now == before {
            return;
        }
        before = now;
    }
}
