//! The bytes of an input, read ahead on a thread of its own, for readers that go through them one after another.

use std::sync::mpsc::{self, Receiver, RecvTimeoutError};
use std::thread;
use std::time::Duration;

use super::input::Stream;
use crate::error::Result;
use crate::event::Monitor;

/// How often a reader that waits for input looks whether it is to stop.
const PATIENCE: Duration = Duration::from_millis(50);

/// A window that moves over the input.
pub(super) struct Bytes<'m> {
    blocks: Receiver<Result<Vec<u8>>>,
    monitor: Monitor<'m>,
    held: Vec<u8>,
    at: usize,
    /// Where `held` begins in the input.
    start: u64,
}

impl<'m> Bytes<'m> {
    /// Reads `block` bytes at a time.
    pub fn new(mut stream: Stream, block: usize, monitor: Monitor<'m>) -> Bytes<'m> {
        let (sender, blocks) = mpsc::sync_channel(1);
        // Not waited for: a read from a pipe may never return.
        thread::spawn(move || {
            loop {
                let mut bytes = Vec::with_capacity(block + 1);
                let read = stream.fill(&mut bytes, block);
                let more = matches!(read, Ok(n) if n == block);
                if sender.send(read.map(|_| bytes)).is_err() || !more {
                    return;
                }
            }
        });
        Bytes { blocks, monitor, held: Vec::new(), at: 0, start: 0 }
    }

    /// What is held and not yet used.
    #[inline]
    pub fn rest(&self) -> &[u8] {
        &self.held[self.at..]
    }

    /// The next `n` bytes; `None` if the input ends before.
    #[inline]
    pub fn take(&mut self, n: usize) -> Result<Option<&[u8]>> {
        while self.held.len() - self.at < n {
            if !self.more()? {
                return Ok(None);
            }
        }
        self.at += n;
        Ok(Some(&self.held[self.at - n..self.at]))
    }

    /// The next word between blanks; `None` at the end.
    pub fn word(&mut self) -> Result<Option<&[u8]>> {
        loop {
            let blanks = self.rest().iter().take_while(|byte| byte.is_ascii_whitespace()).count();
            self.at += blanks;
            if !self.rest().is_empty() || !self.more()? {
                break;
            }
        }
        let mut length = 0;
        loop {
            length += self.rest()[length..].iter().take_while(|byte| !byte.is_ascii_whitespace()).count();
            if length < self.rest().len() || length > LONGEST || !self.more()? {
                break;
            }
        }
        self.at += length;
        Ok((length > 0).then(|| &self.held[self.at - length..self.at]))
    }

    /// The next line, without its end; `None` at the end. A very long one comes in pieces.
    pub fn line(&mut self) -> Result<Option<&[u8]>> {
        let mut searched = 0;
        let (length, end) = loop {
            if let Some(n) = memchr::memchr(b'\n', &self.rest()[searched..]) {
                break (searched + n, 1);
            }
            searched = self.rest().len();
            if searched > LONGEST || !self.more()? {
                break (searched, 0);
            }
        };
        if length + end == 0 {
            return Ok(None);
        }
        self.at += length + end;
        let line = &self.held[self.at - length - end..self.at - end];
        Ok(Some(line.strip_suffix(b"\r").unwrap_or(line)))
    }

    /// Bytes used so far.
    pub fn position(&self) -> u64 {
        self.start + self.at as u64
    }

    /// Waits for the next block; false at the end.
    #[cold]
    pub fn more(&mut self) -> Result<bool> {
        loop {
            self.monitor.check()?;
            match self.blocks.recv_timeout(PATIENCE) {
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return Ok(false),
                Ok(block) => {
                    let block = block?;
                    self.start += self.at as u64;
                    self.held.drain(..self.at);
                    self.at = 0;
                    if self.held.is_empty() {
                        self.held = block;
                    } else {
                        self.held.extend_from_slice(&block);
                    }
                    return Ok(true);
                }
            }
        }
    }
}

/// Words and lines of more bytes than this are no numbers.
const LONGEST: usize = 1 << 16;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_lines_and_bytes_reach_over_blocks() {
        for block in [1, 2, 3, 7, 100] {
            let mut bytes = Bytes::new(Stream::of_bytes(b"ply\r\n a 12 \n\nxyz12"), block, Monitor::silent());
            assert_eq!(bytes.line().unwrap().unwrap(), b"ply");
            assert_eq!(bytes.word().unwrap().unwrap(), b"a");
            assert_eq!(bytes.word().unwrap().unwrap(), b"12");
            assert_eq!(bytes.line().unwrap().unwrap(), b" ");
            assert_eq!(bytes.line().unwrap().unwrap(), b"");
            assert_eq!(bytes.position(), 13);
            assert_eq!(bytes.take(3).unwrap().unwrap(), b"xyz");
            assert!(bytes.take(3).unwrap().is_none());
            assert_eq!(bytes.word().unwrap().unwrap(), b"12");
            assert!(bytes.word().unwrap().is_none() && bytes.line().unwrap().is_none());
        }
    }
}
