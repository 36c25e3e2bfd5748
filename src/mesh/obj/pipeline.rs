//! Reads ahead, parses in parallel, hands over in order.

use std::collections::VecDeque;
use std::sync::mpsc::{self, Receiver, RecvTimeoutError, TryRecvError};
use std::thread;
use std::time::Duration;

use super::block::Blocks;
use super::parse::{Parsed, parse_alone};
use crate::error::Result;
use crate::event::Monitor;

/// How often a thread that waits for input looks whether it is to stop.
const PATIENCE: Duration = Duration::from_millis(50);

/// A block's text and what is in it, `None` if it must be looked at again.
type Outcome = (Vec<u8>, Option<Parsed>);

/// Calls `take` for every block, in order.
///
/// At a time there are at most: one block being read, one waiting, and one more being parsed than the pool has threads.
pub(super) fn run(
    blocks: Blocks,
    origin: [f64; 3],
    monitor: Monitor<'_>,
    take: &mut dyn FnMut(Vec<u8>, Option<Parsed>) -> Result<()>,
) -> Result<()> {
    let input = read_ahead(blocks);
    let most = rayon::current_num_threads() + 1;
    rayon::in_place_scope(|scope| {
        let mut flight: VecDeque<Receiver<Outcome>> = VecDeque::with_capacity(most);
        loop {
            while flight.len() < most
                && let Some(text) = next_text(&input, flight.is_empty(), monitor)?
            {
                let (done, outcome) = mpsc::channel();
                scope.spawn(move |_| {
                    let parsed = parse_alone(&text, origin);
                    // Nobody listens after an error: then the result is not wanted.
                    let _ = done.send((text, parsed));
                });
                flight.push_back(outcome);
            }
            let Some(oldest) = flight.pop_front() else { return Ok(()) };
            // If the parsing task panicked there is no outcome, and the scope passes the panic on.
            let Some((text, parsed)) = wait(&oldest) else { return Ok(()) };
            take(text, parsed)?;
            monitor.check()?;
        }
    })
}

/// Reads blocks on a thread of its own. The thread ends with the input, at an error, or when nobody listens; it is not
/// waited for, since a read from a terminal or a pipe may never return.
fn read_ahead(mut blocks: Blocks) -> Receiver<Result<Vec<u8>>> {
    let (sender, receiver) = mpsc::sync_channel(1);
    thread::spawn(move || {
        while let Some(block) = blocks.next_block().transpose() {
            let failed = block.is_err();
            if sender.send(block).is_err() || failed {
                break;
            }
        }
    });
    receiver
}

/// The next block, or `None` at the end and, unless `patient`, when none is there yet.
fn next_text(input: &Receiver<Result<Vec<u8>>>, patient: bool, monitor: Monitor<'_>) -> Result<Option<Vec<u8>>> {
    if !patient {
        return input.try_recv().ok().transpose();
    }
    loop {
        match input.recv_timeout(PATIENCE) {
            Ok(block) => return block.map(Some),
            Err(RecvTimeoutError::Timeout) => monitor.check()?,
            Err(RecvTimeoutError::Disconnected) => return Ok(None),
        }
    }
}

/// Waits for a task of the pool; helps if this thread belongs to the pool, which may have no other.
fn wait<T>(outcome: &Receiver<T>) -> Option<T> {
    loop {
        match outcome.try_recv() {
            Ok(value) => return Some(value),
            Err(TryRecvError::Disconnected) => return None,
            Err(TryRecvError::Empty) => match rayon::yield_now() {
                Some(rayon::Yield::Executed) => {}
                Some(rayon::Yield::Idle) => thread::sleep(Duration::from_micros(100)),
                None => return outcome.recv().ok(),
            },
        }
    }
}
