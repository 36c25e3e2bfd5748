//! What the tools share: arguments, progress, diagnostics, statistics, interrupts, exit codes.
//!
//! A tool's `main` is one call of [`run`], which parses the arguments, listens for Ctrl-C, calls the tool's body and
//! turns its result into an exit code: 0 done, 1 a check failed, 2 usage or input, 3 damaged octree file, 4 the
//! machine failed, 130 interrupted. Errors are printed once, here. Each tool uses a part of this module.
#![allow(dead_code)]

pub mod args;
pub mod diagnostics;
pub mod interrupt;
mod man;
mod manual;
pub mod output;
pub mod progress;
pub mod reading;
pub mod stats;

use std::process::ExitCode;
use std::sync::atomic::AtomicBool;

use clap::{CommandFactory, FromArgMatches};
use octrace::{Error, Event, Monitor};

use progress::Reporter;

/// The exit code of a check that was carried out and failed.
pub const CHECK_FAILED: u8 = 1;

/// A tool at work: where progress, warnings and results go.
pub struct Session<'a> {
    reporter: &'a Reporter,
    sink: &'a (dyn Fn(Event) + Sync),
    stop: &'a AtomicBool,
}

impl<'a> Session<'a> {
    /// Where the library sends events to, and what tells it to stop.
    pub fn monitor(&self) -> Monitor<'a> {
        Monitor::new(self.sink, self.stop)
    }

    /// The same with another place for the library's events, and another wish to stop than Ctrl-C's.
    pub fn with<'b>(&'b self, sink: &'b (dyn Fn(Event) + Sync), stop: &'b AtomicBool) -> Session<'b> {
        Session { reporter: self.reporter, sink, stop }
    }

    /// Takes the progress bar away, so that standard output and error are free for results.
    pub fn finish(&self) {
        self.reporter.finish();
    }

    /// Whether the user asked for silence.
    pub fn quiet(&self) -> bool {
        self.reporter.quiet()
    }

    /// Prints a line of result on standard error, unless the user asked for silence.
    pub fn say(&self, line: impl std::fmt::Display) {
        self.finish();
        if !self.quiet() {
            diagnostics::say(&line.to_string());
        }
    }
}

/// A tool's arguments, as far as [`run`] needs them.
pub trait Arguments: CommandFactory + FromArgMatches {
    /// The flags that every tool has.
    fn common(&self) -> &args::Common;
}

/// Runs a tool: parses the arguments, sets everything up, calls `body` and turns its result into an exit code.
pub fn run<A: Arguments>(body: impl FnOnce(&A, &Session<'_>) -> Result<ExitCode, Error>) -> ExitCode {
    let command = manual::complete(A::command());
    let name = command.get_name().to_owned();
    let matches = manual::parsing(command, std::env::args_os()).get_matches();
    if let Some(page) = manual::wanted(&matches) {
        return exit_code(output::print_bytes(&manual::page(page, A::command())).map(|()| ExitCode::SUCCESS));
    }
    let parsed = A::from_arg_matches(&matches).unwrap_or_else(|e| e.format(&mut A::command()).exit());
    let reporter = Reporter::new(&name, parsed.common().quiet);
    let sink = |event| reporter.show(event);
    let session = Session { reporter: &reporter, sink: &sink, stop: interrupt::flag() };
    let result = interrupt::listen().and_then(|()| args::use_threads(parsed.common().threads));
    let result = result.and_then(|()| body(&parsed, &session));
    session.finish();
    exit_code(result)
}

/// The exit code of what was done; tells of an error.
fn exit_code(result: Result<ExitCode, Error>) -> ExitCode {
    match result {
        Ok(code) => code,
        Err(error) if is_broken_pipe(&error) => ExitCode::SUCCESS,
        Err(error) => {
            diagnostics::print_error(&error);
            ExitCode::from(error.kind().exit_code())
        }
    }
}

/// Whoever reads our output has had enough: that is no error.
fn is_broken_pipe(error: &Error) -> bool {
    matches!(error, Error::Io { source, .. } if source.kind() == std::io::ErrorKind::BrokenPipe)
}
