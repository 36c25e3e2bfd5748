//! Cuts a stream of text into blocks of whole logical lines.
//!
//! A block ends after a newline that no backslash precedes, so that it can be parsed by itself. A line that is longer
//! than a block makes the block longer; what has been searched is not searched again.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use memchr::{memchr, memrchr_iter};

use crate::error::{Error, Result};
use crate::mesh::input::Stream;

/// How many bytes at the start are looked at to tell text from other things.
const HEAD: usize = 4096;

/// Reads the stream block by block.
pub(super) struct Blocks {
    stream: Stream,
    size: usize,
    longest_line: usize,
    /// The beginning of a line whose end was not in the last block.
    carry: Vec<u8>,
    /// What was looked at before the first block.
    head: Vec<u8>,
    begun: bool,
    ended: bool,
    /// Whether the input ended without a newline.
    cut: Arc<AtomicBool>,
}

impl Blocks {
    /// Blocks of about `size` bytes, with lines of at most `longest_line`.
    pub fn new(stream: Stream, size: usize, longest_line: usize) -> Blocks {
        Blocks {
            stream,
            size: size.max(1),
            longest_line,
            carry: Vec::new(),
            head: Vec::new(),
            begun: false,
            ended: false,
            cut: Arc::default(),
        }
    }

    /// Whether the last line had no newline, as that of a file has that was cut short; known at the end. Other threads may look at it.
    pub fn cut(&self) -> Arc<AtomicBool> {
        self.cut.clone()
    }

    /// The next block: whole lines, ending with a newline. `None` at the end.
    pub fn next_block(&mut self) -> Result<Option<Vec<u8>>> {
        if !std::mem::replace(&mut self.begun, true) {
            self.begin()?;
        }
        let mut text = std::mem::take(&mut self.carry);
        let mut searched = 0;
        while !self.ended {
            let missing = match searched {
                0 => self.size.saturating_sub(text.len()).max(1),
                _ => (text.len() / 2).max(self.size).min(self.longest_line.saturating_sub(text.len())),
            };
            if missing == 0 {
                return Err(self.too_long());
            }
            self.grow(&mut text, missing)?;
            if let Some(cut) = last_cut(&text, searched) {
                self.carry = text.split_off(cut);
                return Ok(Some(text));
            }
            self.refuse_nul(&text[searched..])?;
            searched = text.len();
        }
        if text.last().is_some_and(|&byte| byte != b'\n') {
            self.cut.store(true, Ordering::Relaxed);
            text.push(b'\n');
        }
        Ok((!text.is_empty()).then_some(text))
    }

    /// The error for a line that would take too much memory.
    fn too_long(&self) -> Error {
        let longest = self.longest_line >> 20;
        let what = format!(
            "one of its lines is longer than {longest} MiB, which does not fit in the memory allowed; allow more (a line may \
             take about a tenth of it)"
        );
        Error::Input { file: self.stream.file().to_owned(), what }
    }

    /// Reads `missing` more bytes, or notes the end.
    fn grow(&mut self, text: &mut Vec<u8>, missing: usize) -> Result<()> {
        text.reserve_exact(missing + 1);
        let from_head = missing.min(self.head.len());
        text.extend(self.head.drain(..from_head));
        let n = self.stream.fill(text, missing - from_head)?;
        self.ended = from_head + n < missing;
        Ok(())
    }

    /// Looks at the first bytes of all: takes a byte-order mark off, refuses what is not text.
    fn begin(&mut self) -> Result<()> {
        let mut text = Vec::new();
        self.stream.fill(&mut text, HEAD)?;
        let utf16 = text.starts_with(&[0xff, 0xfe]) || text.starts_with(&[0xfe, 0xff]) || alternate_nul(&text);
        if utf16 {
            let what = "this is UTF-16 text, and OBJ is read as plain bytes; convert it first, for example with \
                        `iconv -f UTF-16 -t UTF-8`";
            return Err(Error::Input { file: self.stream.file().to_owned(), what: what.into() });
        }
        self.refuse_nul(&text)?;
        if text.starts_with(&[0xef, 0xbb, 0xbf]) {
            text.drain(..3);
        }
        self.head = text;
        Ok(())
    }

    /// Refuses NUL bytes: a file of nothing else has no newline, and would grow one block without end.
    fn refuse_nul(&self, text: &[u8]) -> Result<()> {
        match memchr(0, text) {
            None => Ok(()),
            Some(_) => {
                let what = "this is not an OBJ text: it holds NUL bytes, so it is binary or damaged; fetch it again, or name it after what it is".into();
                Err(Error::Input { file: self.stream.file().to_owned(), what })
            }
        }
    }
}

/// Whether every second byte is NUL, as in UTF-16 without a mark.
fn alternate_nul(text: &[u8]) -> bool {
    let pairs = &text[..text.len().min(64) & !1];
    let nul = |phase: usize| pairs.iter().skip(phase).step_by(2).all(|&byte| byte == 0);
    pairs.len() >= 4 && nul(0) != nul(1)
}

/// The end of the last logical line whose newline lies at or after `from`.
fn last_cut(text: &[u8], from: usize) -> Option<usize> {
    memrchr_iter(b'\n', &text[from..])
        .map(|n| from + n)
        .find(|&n| !text[..n].ends_with(b"\\") && !text[..n].ends_with(b"\\\r"))
        .map(|n| n + 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn blocks(text: &[u8], size: usize) -> Result<Vec<Vec<u8>>> {
        let mut blocks = Blocks::new(Stream::of_bytes(text), size, 1 << 20);
        std::iter::from_fn(|| blocks.next_block().transpose()).collect()
    }

    #[test]
    fn blocks_are_whole_logical_lines() {
        let long = format!("v 1 2 3\n# {}\nf 1 \\\n 2 \\\r\n 3\nlast", "x".repeat(20_000));
        for size in [1, 2, 100, 5000, 1 << 20] {
            let blocks = blocks(long.as_bytes(), size).unwrap();
            assert_eq!(blocks.concat(), [long.as_bytes(), b"\n"].concat(), "block size {size}");
            assert!(blocks.iter().all(|block| block.ends_with(b"\n")));
            assert!(blocks.iter().any(|block| memchr::memmem::find(block, b"f 1 \\\n 2 \\\r\n 3\n").is_some()));
            assert!(size > 5000 || blocks.len() > 1);
        }
    }

    #[test]
    fn a_mark_is_taken_off_and_nothing_stays_nothing() {
        assert_eq!(blocks(b"\xef\xbb\xbfv", 8).unwrap(), [b"v\n"]);
        assert!(blocks(b"", 8).unwrap().is_empty());
        assert!(blocks(b"\xef\xbb\xbf", 8).unwrap().is_empty());
    }

    #[test]
    fn what_is_not_text_is_refused() {
        for text in [&b"\xff\xfev\0 \0"[..], b"\xfe\xff\0v", b"v\0 \x001\0\n\0", b"\0v\0 \x001\0\n"] {
            assert!(blocks(text, 8).unwrap_err().to_string().contains("UTF-16"), "{text:?}");
        }
        for text in [&b"\0\0\0\0\0\0"[..], b"glTF\0\0\x01\n"] {
            assert!(blocks(text, 8).unwrap_err().to_string().contains("NUL"), "{text:?}");
        }
        let late = [&b"v 1 2 3\n".repeat(1000)[..], &[0; 100_000]].concat();
        assert!(blocks(&late, 64).unwrap_err().to_string().contains("NUL"));
    }
}
