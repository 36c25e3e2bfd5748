//! Joins faces with a table that does not fit in memory, however scattered their numbers are.
//!
//! The table is cut into ranges that fit. One pass over the faces sorts their numbers by range, each range keeping their
//! order; then range after range is loaded and its numbers are answered with their items, in the same order. Whoever
//! goes over the faces again finds each item as the next answer of its range. All reads and writes are sequential:
//! 40 bytes a corner for positions, whatever the order of the faces.

use rayon::prelude::*;

use super::blocks::FaceView;
use super::distribute::Extent;
use super::faces::Faces;
use super::spool::Spool;
use super::steps::Steps;
use super::table::{Kind, Table};
use super::words::Words;
use crate::error::Result;

/// Answers to the numbers of all corners, in the order of faces.
pub(super) struct Answers<'t, const N: usize> {
    spool: Spool<'t>,
    kind: Kind,
    items: u64,
    /// Items of a range.
    range: u64,
    cursors: Vec<Cursor>,
    buffer_words: usize,
}

/// Where a range's answers are read.
struct Cursor {
    at: u64,
    end: u64,
    buffer: Vec<u32>,
    used: usize,
}

impl<'t, const N: usize> Answers<'t, N> {
    /// Sorts and answers all numbers of `faces` with `share` words of memory. That is one of `steps`: half of it to sort them.
    pub fn new(table: &'t Table<'t, N>, faces: &Faces<'_>, share: usize, steps: &mut Steps<'_>) -> Result<Self> {
        let range = (share / 2 / N).max(1) as u64;
        let ranges = table.len().div_ceil(range).max(1) as usize;
        // A buffer holds whole items.
        let buffer_words = (share / 2 / ranges).clamp(64, 1 << 18) / N * N;
        let mut answers = Answers {
            spool: table.spool.beside("answers"),
            kind: table.kind,
            items: table.len(),
            range,
            cursors: Vec::new(),
            buffer_words,
        };
        let (asked, extents) = answers.ask(table, faces, ranges, steps)?;
        for (number, extents) in extents.iter().enumerate() {
            let at = answers.spool.len();
            answers.answer(table, number as u64, &asked, extents, steps)?;
            answers.cursors.push(Cursor { at, end: answers.spool.len(), buffer: Vec::new(), used: 0 });
        }
        steps.next();
        Ok(answers)
    }

    /// Writes all numbers, sorted by range.
    fn ask(
        &self,
        table: &'t Table<'t, N>,
        faces: &Faces<'_>,
        ranges: usize,
        steps: &Steps<'_>,
    ) -> Result<(Spool<'t>, Vec<Vec<Extent>>)> {
        let mut asked = table.spool.beside("numbers");
        let mut buffers: Vec<Vec<u32>> = vec![Vec::with_capacity(self.buffer_words); ranges];
        let mut extents = vec![Vec::new(); ranges];
        let mut flush = |range: usize, buffer: &mut Vec<u32>| {
            extents[range].push(Extent { at: asked.len(), words: buffer.len() as u64 });
            asked.append(buffer)?;
            buffer.clear();
            Ok(())
        };
        for block in 0..faces.blocks() {
            steps.at(block as u64, 2 * faces.blocks() as u64)?;
            let block = faces.load(block)?;
            for &number in block.view().numbers(self.kind) {
                if let Some(range) = self.range_of(number) {
                    buffers[range].push(number);
                    if buffers[range].len() == self.buffer_words {
                        flush(range, &mut buffers[range])?;
                    }
                }
            }
        }
        buffers.iter_mut().enumerate().try_for_each(|(range, buffer)| flush(range, buffer))?;
        Ok((asked, extents))
    }

    /// Appends the items of a range's numbers.
    fn answer(
        &mut self,
        table: &Table<'_, N>,
        number: u64,
        asked: &Spool<'_>,
        extents: &[Extent],
        steps: &Steps<'_>,
    ) -> Result<()> {
        let first = number * self.range;
        let items = self.range.min(self.items.saturating_sub(first));
        let mut words = Words::zeroed(N * items as usize)?;
        table.spool.read(N as u64 * first, &mut words)?;
        let words: &[u32] = &words;
        let (mut numbers, mut found) = (Vec::new(), Vec::new());
        for extent in extents {
            let done = self.spool.len() / N as u64;
            steps.at(asked.len() + done, 2 * asked.len())?;
            numbers.resize(extent.words as usize, 0);
            asked.read(extent.at, &mut numbers)?;
            // A slice at a time, since answers are longer than numbers.
            for numbers in numbers.chunks(self.buffer_words / N) {
                found.resize(N * numbers.len(), 0);
                found.par_chunks_exact_mut(N).with_min_len(4096).zip(numbers).for_each(|(found, &number)| {
                    let at = N * (u64::from(number) - first) as usize;
                    found.copy_from_slice(&words[at..at + N]);
                });
                self.spool.append(&found)?;
            }
        }
        Ok(())
    }

    /// The range of a number, if it is in the table.
    #[inline]
    fn range_of(&self, number: u32) -> Option<usize> {
        (u64::from(number) < self.items).then(|| (u64::from(number) / self.range) as usize)
    }

    /// The items of a block's corners; zeros where a corner names none. Blocks must come in order.
    pub fn of_block(&mut self, view: &FaceView<'_>) -> Result<Vec<[f32; N]>> {
        let numbers = view.numbers(self.kind);
        let mut items = Vec::with_capacity(numbers.len());
        for &number in numbers {
            let item = match self.range_of(number) {
                Some(range) => self.cursors[range].next(&self.spool, self.buffer_words)?,
                None => [0.0; N],
            };
            items.push(item);
        }
        Ok(items)
    }
}

impl Cursor {
    #[inline]
    fn next<const N: usize>(&mut self, spool: &Spool<'_>, buffer_words: usize) -> Result<[f32; N]> {
        if self.used == self.buffer.len() {
            self.buffer.resize((self.end - self.at).min(buffer_words as u64) as usize, 0);
            spool.read(self.at, &mut self.buffer)?;
            (self.at, self.used) = (self.at + self.buffer.len() as u64, 0);
        }
        let item = std::array::from_fn(|i| f32::from_bits(self.buffer[self.used + i]));
        self.used += N;
        Ok(item)
    }
}
