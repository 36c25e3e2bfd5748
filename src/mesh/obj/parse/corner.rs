//! Corners of faces: what an index means, and whether it can.

use std::ops::Range;

use super::super::forward::missing;
use super::super::line::Words;
use super::{Context, KINDS, NAMES, Parser, Problem};
use crate::mesh::{FaceBatch, NO_INDEX};

/// An index that has been read.
#[derive(Clone, Copy)]
struct Number {
    /// Counted from 0.
    value: u32,
    /// Whether the count before the block is still to be added.
    relative: bool,
}

impl Parser<'_> {
    /// Reads the corners of a face.
    pub(super) fn face(&mut self, words: &mut Words) -> Result<(), Problem> {
        let start = self.out.faces.corners.len();
        let mut size = 0usize;
        while let Some(place) = words.next_word() {
            let written = self.corner(place.clone());
            let indices = written.inspect_err(|_| self.forget_from(start))?;
            self.push_corner(indices);
            size += 1;
            if size >= FaceBatch::GAP as usize {
                self.forget_from(start);
                return Err(Problem::new(place, "a face with more than 2147483647 corners", ""));
            }
        }
        if size < 3 {
            self.forget_from(start);
            self.out.too_few += 1;
        } else {
            self.end_face(size as u32);
        }
        Ok(())
    }

    /// Reads one corner: `a`, `a/b`, `a//c` or `a/b/c`.
    fn corner(&mut self, place: Range<usize>) -> Result<[Option<Number>; KINDS], Problem> {
        let mut indices = [None; KINDS];
        let mut at = place.start;
        for (kind, index) in indices.iter_mut().enumerate() {
            let rest = &self.text[at..place.end];
            let end = at + memchr::memchr(b'/', rest).unwrap_or(rest.len());
            let absent = end == at && kind == 1 && end < place.end;
            if !absent {
                *index = self.index(kind, at..end, &place)?;
            }
            if end == place.end {
                return Ok(indices);
            }
            at = end + 1;
        }
        Err(malformed_corner(&self.text[place.clone()], place))
    }

    /// Reads one index.
    fn index(&mut self, kind: usize, place: Range<usize>, corner: &Range<usize>) -> Result<Option<Number>, Problem> {
        let Some(written) = integer(&self.text[place.clone()]) else {
            return Err(malformed_corner(&self.text[corner.clone()], corner.clone()));
        };
        match written {
            0 => Err(Problem::new(place, "index 0: OBJ counts from 1", "write 1 for the first, -1 for the latest")),
            1.. => self.absolute(kind, written, place),
            _ => self.relative(kind, written, place),
        }
    }

    /// A positive index, counted from 1.
    fn absolute(&mut self, kind: usize, written: i64, place: Range<usize>) -> Result<Option<Number>, Problem> {
        let most = match self.context {
            Context::Known { limits: Some(limits), .. } => limits[kind] as i64,
            _ => NO_INDEX as i64,
        };
        if written > most {
            if kind > 0 && self.is_lenient() {
                return Ok(None);
            }
            let message = match most == NO_INDEX as i64 {
                true => format!("{} {written} is beyond {most}, the most that can be counted", NAMES[kind].0),
                false => missing(kind, written as u64, most as u64),
            };
            return Err(Problem::new(place, message, ""));
        }
        self.out.greatest[kind] = self.out.greatest[kind].max(written as u64);
        Ok(Some(Number { value: (written - 1) as u32, relative: false }))
    }

    /// A negative index, counted back from the latest.
    fn relative(&mut self, kind: usize, written: i64, place: Range<usize>) -> Result<Option<Number>, Problem> {
        let local = written.saturating_add(self.local(kind) as i64);
        let Context::Known { before, .. } = self.context else {
            self.out.least[kind] = self.out.least[kind].min(local);
            return Ok(Some(Number { value: local as u32, relative: true }));
        };
        let value = local.saturating_add(before[kind] as i64);
        if value >= 0 {
            // A value past the most that can be counted means that the count is, which the reader refuses.
            return Ok(Some(Number { value: value as u32, relative: false }));
        }
        if kind > 0 && self.is_lenient() {
            return Ok(None);
        }
        let (one, many) = NAMES[kind];
        let message = match before[kind] + self.local(kind) as u64 {
            0 => format!("{one} {written} does not exist: no {many} come before this line"),
            n => format!(
                "{one} {written} does not exist: only {n} {} before this line",
                if n == 1 { format!("{one} comes") } else { format!("{many} come") }
            ),
        };
        Err(Problem::new(place, message, ""))
    }

    /// How many of a kind this block holds so far.
    fn local(&self, kind: usize) -> usize {
        [self.out.positions.len(), self.out.texcoords.len(), self.out.normals.len()][kind]
    }

    fn is_lenient(&self) -> bool {
        matches!(self.context, Context::Known { lenient: true, .. })
    }

    /// Appends a corner, to the optional arrays only if they have begun or begin here.
    fn push_corner(&mut self, indices: [Option<Number>; KINDS]) {
        let at = self.out.faces.corners.len();
        let faces = &mut self.out.faces;
        for (kind, array) in [&mut faces.corners, &mut faces.texcoords, &mut faces.normals].into_iter().enumerate() {
            if kind > 0 && indices[kind].is_none() && array.is_empty() {
                continue;
            }
            array.resize(at, NO_INDEX);
            array.push(indices[kind].map_or(NO_INDEX, |number| number.value));
            if indices[kind].is_some_and(|number| number.relative) {
                match self.out.relative[kind].last_mut() {
                    Some(run) if run.end == at => run.end += 1,
                    _ => self.out.relative[kind].push(at..at + 1),
                }
            }
        }
    }

    /// Takes back the corners from `start` on.
    fn forget_from(&mut self, start: usize) {
        let faces = &mut self.out.faces;
        for (kind, array) in [&mut faces.corners, &mut faces.texcoords, &mut faces.normals].into_iter().enumerate() {
            array.truncate(start);
            let runs = &mut self.out.relative[kind];
            while runs.last().is_some_and(|run| run.start >= start) {
                runs.pop();
            }
            if let Some(run) = runs.last_mut() {
                run.end = run.end.min(start);
            }
        }
    }
}

/// A whole number with an optional sign; beyond i64 it stays at its end.
fn integer(word: &[u8]) -> Option<i64> {
    let negative = word.first() == Some(&b'-');
    let digits = word.strip_prefix(b"-").or_else(|| word.strip_prefix(b"+")).unwrap_or(word);
    if digits.is_empty() || !digits.iter().all(u8::is_ascii_digit) {
        return None;
    }
    let size = digits.iter().fold(0i64, |sum, byte| sum.saturating_mul(10).saturating_add((byte - b'0') as i64));
    Some(if negative { -size } else { size })
}

fn malformed_corner(word: &[u8], place: Range<usize>) -> Problem {
    let help =
        if memchr::memchr(b'.', word).is_some() { "indices are whole numbers" } else { "write a, a/b, a//c or a/b/c" };
    Problem::new(place, "not a corner of a face", help)
}
