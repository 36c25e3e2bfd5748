//! Another tracer, as a process that keeps its mesh and answers requests.
//!
//! Once it is ready it prints a line of JSON with its name, `{"peer": "NAME"}`. Then it reads requests, a line each: `closest` or
//! `any`, the number of threads, and the path of a file of rays (32 bytes each), with blanks between. It traces all rays once and
//! prints a line of JSON, `{"round": SECONDS, "cpu": SECONDS, "hits": N}`, with the seconds that tracing alone took and, if it knows
//! that, the processor's. Asked to `store` at a path it writes the closest hits of the last round there (16 bytes each) and prints
//! `{"stored": N}`. Other lines are passed over. It ends when its input does. `tests/peers/` has one for Embree.

use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

use octrace::{Error, Result};
use serde::Deserialize;

use super::sets::Question;
use crate::timing::Clock;

/// The process.
pub struct Peer {
    command: String,
    /// Its own name for itself.
    pub name: String,
    child: Child,
    requests: Option<ChildStdin>,
    replies: BufReader<ChildStdout>,
}

/// What it tells first.
#[derive(Deserialize)]
struct Ready {
    peer: String,
}

/// What it tells when it has written hits.
#[derive(Deserialize)]
struct Stored {
    #[serde(rename = "stored")]
    _count: u64,
}

/// What it tells of a round.
#[derive(Clone, Copy, Debug, Deserialize)]
pub struct Round {
    /// Seconds of tracing.
    #[serde(rename = "round")]
    wall: f64,
    /// Seconds of processor time.
    cpu: Option<f64>,
    /// Rays that hit.
    pub hits: u64,
}

impl Round {
    /// The seconds by a clock.
    pub fn seconds(&self, clock: Clock) -> Result<f64> {
        let seconds = match clock {
            Clock::Wall => Some(self.wall),
            Clock::Cpu => self.cpu,
        };
        seconds.ok_or_else(|| Error::Option("a peer does not tell its processor time; use --clock wall".to_owned()))
    }
}

impl Peer {
    /// Starts the process, by the shell, and waits until it is ready.
    pub fn start(command: &str) -> Result<Peer> {
        let mut child = Command::new("sh")
            .args(["-c", command])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .map_err(Error::io(command, "start"))?;
        let requests = child.stdin.take();
        let replies = BufReader::new(child.stdout.take().expect("it was piped"));
        let mut peer = Peer { command: command.to_owned(), name: String::new(), child, requests, replies };
        peer.name = peer.reply::<Ready>()?.peer;
        Ok(peer)
    }

    /// Has it trace a file of rays once.
    pub fn round(&mut self, question: Question, threads: usize, rays: &Path) -> Result<Round> {
        self.request(&format!("{} {threads} {}", question.name(), rays.display()))?;
        let round: Round = self.reply()?;
        let is_time = |t: f64| t.is_finite() && t > 0.0;
        if !(is_time(round.wall) && round.cpu.is_none_or(is_time)) {
            return Err(self.failed("a round took no time"));
        }
        Ok(round)
    }

    /// Has it write the hits of the last round to a file, 16 bytes each.
    pub fn store(&mut self, hits: &Path) -> Result<()> {
        self.request(&format!("store {}", hits.display()))?;
        self.reply::<Stored>().map(|_| ())
    }

    fn request(&mut self, line: &str) -> Result<()> {
        let sent = self.requests.as_mut().map(|to| writeln!(to, "{line}").and_then(|()| to.flush()));
        match sent {
            Some(Ok(())) => Ok(()),
            _ => Err(self.failed("it ended and takes no more requests")),
        }
    }

    /// The next line of output that reads as `T`.
    fn reply<T: for<'a> Deserialize<'a>>(&mut self) -> Result<T> {
        let mut line = String::new();
        loop {
            line.clear();
            match self.replies.read_line(&mut line) {
                Ok(0) => return Err(self.failed("it ended without the reply that was due")),
                Ok(_) => {}
                Err(e) => return Err(self.failed(&format!("its output cannot be read: {e}"))),
            }
            if let Ok(reply) = serde_json::from_str(&line) {
                return Ok(reply);
            }
        }
    }

    fn failed(&self, what: &str) -> Error {
        Error::Option(format!("the peer `{}` failed: {what}", self.command))
    }
}

impl Drop for Peer {
    fn drop(&mut self) {
        // The end of its input tells it to end.
        self.requests = None;
        let _ = self.child.wait();
    }
}
