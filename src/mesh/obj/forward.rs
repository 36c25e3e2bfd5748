//! Faces that name vertices which come later in the file, or never.
//!
//! Whether a positive index is out of range is known only at the end. A block whose greatest index was beyond the counts
//! at its end is remembered by number; if the final counts do not reach it either, the input is read again up to the
//! first such block, to name the line. What cannot be read again keeps a few places in words instead, and names one of
//! them, though not always the first.

use super::block::Blocks;
use super::parse::{Context, KINDS, NAMES, parse_known};
use super::place::diagnose;
use crate::error::{Diagnostic, Error, Result, Severity};
use crate::mesh::ReadOptions;
use crate::mesh::input::Input;

/// How many places are kept in words.
const KEPT: usize = 512;

/// The blocks that name vertices beyond those read so far.
pub(super) struct Forward {
    repeatable: bool,
    /// Number of the next block.
    block: u64,
    /// The greatest indices of all.
    greatest: [u64; KINDS],
    /// Blocks that raised them: a file has one block per several megabytes, so these are few.
    raised: Vec<Raised>,
    kept: Vec<(usize, u64, Diagnostic)>,
}

/// A block that raised a greatest index beyond the counts at its end.
struct Raised {
    block: u64,
    line: u64,
    before: [u64; KINDS],
    greatest: [u64; KINDS],
}

impl Forward {
    /// None yet.
    pub fn new(repeatable: bool) -> Forward {
        Forward { repeatable, block: 0, greatest: [0; KINDS], raised: Vec::new(), kept: Vec::new() }
    }

    /// Looks at the greatest indices of the next block; `at` is the file and the number of the block's first line.
    pub fn note(
        &mut self,
        text: &[u8],
        greatest: &[u64; KINDS],
        before: [u64; KINDS],
        after: [u64; KINDS],
        at: (&str, u64),
    ) {
        let raises = |kind: usize| greatest[kind] > after[kind].max(self.greatest[kind]);
        let kinds: Vec<usize> = (0..KINDS).filter(|&kind| raises(kind)).collect();
        if !kinds.is_empty() {
            self.raised.push(Raised { block: self.block, line: at.1, before, greatest: *greatest });
            if !self.repeatable {
                kinds.into_iter().for_each(|kind| self.keep(kind, text, greatest[kind], before, after, at));
            }
        }
        self.greatest = std::array::from_fn(|kind| self.greatest[kind].max(greatest[kind]));
        self.block += 1;
    }

    /// Keeps two places in words: the first beyond the counts so far, and the first of the greatest index.
    fn keep(
        &mut self,
        kind: usize,
        text: &[u8],
        greatest: u64,
        before: [u64; KINDS],
        after: [u64; KINDS],
        at: (&str, u64),
    ) {
        if self.kept.len() >= KEPT {
            // Thin out: every place with an index that stays out of range will do, and the greatest is the last.
            let mut keep = false;
            self.kept.retain(|_| {
                keep = !keep;
                keep
            });
        }
        for limit in [after[kind], greatest - 1] {
            let mut limits = [u64::MAX >> 1; KINDS];
            limits[kind] = limit;
            let context = Context::Known { before, limits: Some(limits), lenient: false };
            if let Err(problem) = parse_known(text, [0.0; 3], context, &mut |_| {}) {
                let index = written_index(&text[problem.place.clone()]);
                self.kept.push((kind, index, diagnose(problem, text, at.0.to_owned(), at.1, Severity::Error)));
            }
        }
    }

    /// At the end: fails if a face names what the file does not have.
    pub fn check(&self, input: &mut Input, options: &ReadOptions, counts: [u64; KINDS]) -> Result<()> {
        let beyond = |greatest: &[u64; KINDS]| (0..KINDS).find(|&kind| greatest[kind] > counts[kind]);
        let Some(kind) = beyond(&self.greatest) else { return Ok(()) };
        let found = match self.raised.iter().find(|raised| beyond(&raised.greatest).is_some()) {
            Some(raised) if self.repeatable => look_again(input, options, raised, counts)?,
            _ => self.kept.iter().find(|(kind, index, _)| *index > counts[*kind]).map(|(kind, index, kept)| {
                Diagnostic { message: missing(*kind, *index, counts[*kind]), ..kept.clone() }
            }),
        };
        Err(match found {
            Some(found) => Error::Text(vec![found]),
            // The file has changed since.
            None => Error::Input {
                file: input.error_path(),
                what: format!("a face names {}", missing(kind, self.greatest[kind], counts[kind])),
            },
        })
    }
}

/// What is wrong with an index beyond the final count.
pub(super) fn missing(kind: usize, index: u64, count: u64) -> String {
    let (one, many) = NAMES[kind];
    match count {
        0 => format!("{one} {index} does not exist: the file has no {many}"),
        1 => format!("{one} {index} does not exist: the file has only one"),
        _ => format!("{one} {index} does not exist: the file has only {count} {many}"),
    }
}

/// The positive index that is written here.
fn written_index(word: &[u8]) -> u64 {
    word.iter().filter(|byte| byte.is_ascii_digit()).fold(0, |sum, byte| sum * 10 + (byte - b'0') as u64)
}

/// Reads the input again up to a block, and parses that with the final counts known.
fn look_again(
    input: &mut Input,
    options: &ReadOptions,
    raised: &Raised,
    counts: [u64; KINDS],
) -> Result<Option<Diagnostic>> {
    let stream = input.start(options.window)?;
    let block = options.block_of(stream.is_packed());
    let mut blocks = Blocks::new(stream, block, options.longest_line);
    for _ in 0..raised.block {
        blocks.next_block()?;
    }
    let Some(text) = blocks.next_block()? else { return Ok(None) };
    let context = Context::Known { before: raised.before, limits: Some(counts), lenient: false };
    let problem = parse_known(&text, options.origin, context, &mut |_| {}).err();
    Ok(problem.map(|problem| diagnose(problem, &text, input.name(), raised.line, Severity::Error)))
}
