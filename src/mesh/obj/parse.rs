//! Parses one block of text into vertices and faces.
//!
//! A block is first parsed by itself, on any thread, without knowing what came before it: negative indices stay
//! relative to the block's beginning, and the first thing that is wrong ends the attempt. Only then, and only for such
//! a block, is it parsed again with the counts before it known ([`Context::Known`]), to say what is wrong, and where,
//! or to skip it. So the common way carries no line numbers and builds no messages.
//!
//! The plain forms of the frequent lines have a fast way of their own; whatever is not plain takes the general way,
//! which understands everything.

mod corner;

use std::ops::Range;

use super::line::Words;
use super::number::{self, Decimal};
use crate::mesh::{FaceBatch, NO_INDEX};

/// Positions, texture coordinates and normals, in the order in which a corner names them.
pub(super) const KINDS: usize = 3;

/// What is known of the file when a block is parsed.
#[derive(Clone, Copy, Debug)]
pub(super) enum Context {
    /// Nothing: negative indices stay relative, the first problem ends the block.
    Alone,
    /// The counts of `v`, `vt` and `vn` before the block.
    Known {
        /// These counts.
        before: [u64; KINDS],
        /// The counts at the end of the file, to be held against positive indices.
        limits: Option<[u64; KINDS]>,
        /// Whether to skip what is wrong.
        lenient: bool,
    },
}

/// Something wrong in a block, at a place in its text.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Problem {
    /// Bytes of the block.
    pub place: Range<usize>,
    /// What is wrong.
    pub message: String,
    /// What to do about it.
    pub help: Option<String>,
}

impl Problem {
    fn new(place: Range<usize>, message: impl Into<String>, help: &str) -> Problem {
        Problem { place, message: message.into(), help: (!help.is_empty()).then(|| help.to_owned()) }
    }
}

/// What a block holds.
#[derive(Debug, Default)]
pub(super) struct Parsed {
    pub positions: Vec<[f32; 3]>,
    pub texcoords: Vec<[f32; 2]>,
    pub normals: Vec<[f32; 3]>,
    /// The faces; `materials` stays empty, since only [`Parsed::uses`] are known.
    pub faces: FaceBatch,
    /// How many faces, gaps included.
    pub count: usize,
    /// `usemtl`: from which face on, and where the name stands.
    pub uses: Vec<(usize, Range<usize>)>,
    /// `mtllib`: where the names stand.
    pub libraries: Vec<Range<usize>>,
    /// Runs of corners whose number is relative to the block's beginning (modulo 2^32).
    pub relative: [Vec<Range<usize>>; KINDS],
    /// The least such number, or 0: reaching back further than the block's beginning makes it negative.
    pub least: [i64; KINDS],
    /// The greatest positive index, counted from 1.
    pub greatest: [u64; KINDS],
    /// Faces with fewer than three corners.
    pub too_few: u64,
    /// Triangles of skipped faces.
    pub bad: u64,
    /// Newlines in the text.
    pub lines: u64,
}

/// Parses a block by itself; `None` if something may be wrong with it.
pub(super) fn parse_alone(text: &[u8], origin: [f64; 3]) -> Option<Parsed> {
    Parser::new(text, origin, Context::Alone).run(&mut |_| {}).ok()
}

/// Parses a block whose predecessors are known. What is skipped (when lenient) is told to `skipped`.
pub(super) fn parse_known(
    text: &[u8],
    origin: [f64; 3],
    context: Context,
    skipped: &mut dyn FnMut(Problem),
) -> Result<Parsed, Problem> {
    Parser::new(text, origin, context).run(skipped)
}

struct Parser<'a> {
    text: &'a [u8],
    origin: [f64; 3],
    context: Context,
    out: Parsed,
}

impl<'a> Parser<'a> {
    fn new(text: &'a [u8], origin: [f64; 3], context: Context) -> Self {
        Parser { text, origin, context, out: Parsed::default() }
    }

    fn run(mut self, skipped: &mut dyn FnMut(Problem)) -> Result<Parsed, Problem> {
        let lenient = matches!(self.context, Context::Known { lenient: true, .. });
        let mut at = 0;
        while at < self.text.len() {
            at = match self.plain(at) {
                Some(next) => next,
                None => match self.line(at) {
                    Err(problem) if lenient => {
                        skipped(problem);
                        self.skip(at)
                    }
                    result => result?,
                },
            };
        }
        self.out.lines = memchr::memchr_iter(b'\n', self.text).count() as u64;
        self.complete_corners();
        Ok(self.out)
    }

    /// Makes the optional arrays as long as the corners, or empty if there is nothing in them.
    fn complete_corners(&mut self) {
        let FaceBatch { corners, texcoords, normals, .. } = &mut self.out.faces;
        for (array, runs) in [texcoords, normals].into_iter().zip(&self.out.relative[1..]) {
            // A relative number may look like none as long as the count before the block is not added.
            match runs.is_empty() && array.iter().all(|&index| index == NO_INDEX) {
                true => array.clear(),
                false => array.resize(corners.len(), NO_INDEX),
            }
        }
    }

    /// Reads the line at `at` if it is one of the frequent plain ones, and says where the next begins.
    #[inline(always)]
    fn plain(&mut self, at: usize) -> Option<usize> {
        let origin = self.origin;
        match self.text[at..] {
            [b'v', b' ', ref rest @ ..] => {
                let (position, used) = number::plain_line(rest, |axis, decimal| shifted(decimal, origin[axis]))?;
                self.out.positions.push(position);
                Some(at + 2 + used)
            }
            [b'f', b' ', ref rest @ ..] => {
                let (corners, used) = number::plain_triangle(rest)?;
                self.plain_triangle(corners).then_some(at + 2 + used)
            }
            [b'v', b'n', b' ', ref rest @ ..] => {
                let (normal, used) = number::plain_line(rest, |_, decimal| decimal.to_f32())?;
                self.out.normals.push(normal);
                Some(at + 3 + used)
            }
            [b'v', b't', b' ', ref rest @ ..] => {
                let (texcoord, used) = number::plain_line(rest, |_, decimal| decimal.to_f32())?;
                self.out.texcoords.push(texcoord);
                Some(at + 3 + used)
            }
            _ => None,
        }
    }

    /// Takes a triangle of positions alone, unless an index is wrong.
    #[inline(always)]
    fn plain_triangle(&mut self, [a, b, c]: [u32; 3]) -> bool {
        let most = a.max(b).max(c);
        let known_limit = matches!(self.context, Context::Known { limits: Some(_), .. });
        if a.min(b).min(c) == 0 || known_limit {
            return false;
        }
        self.out.greatest[0] = self.out.greatest[0].max(most as u64);
        self.out.faces.corners.extend_from_slice(&[a - 1, b - 1, c - 1]);
        self.end_face(3);
        true
    }

    /// Reads the logical line at `at`, whatever it is, and says where the next begins.
    fn line(&mut self, at: usize) -> Result<usize, Problem> {
        let mut words = Words::new(self.text, at);
        let Some(keyword) = words.next_word() else { return Ok(words.finish()) };
        match &self.text[keyword.clone()] {
            b"v" => {
                let position = self.numbers(keyword, &mut words, 3, 3)?;
                self.out.positions.push(position);
            }
            b"vt" => {
                let [u, v, _] = self.numbers(keyword, &mut words, 1, 2)?;
                self.out.texcoords.push([u, v]);
            }
            b"vn" => {
                let normal = self.numbers(keyword, &mut words, 3, 3)?;
                self.out.normals.push(normal);
            }
            b"f" | b"fo" => self.face(&mut words)?,
            b"usemtl" => self.use_material(words.rest()),
            b"mtllib" => self.out.libraries.push(words.rest()),
            other if memchr::memchr(0, other).is_some() => {
                return Err(Problem::new(
                    keyword,
                    "NUL bytes in the text",
                    "the file is damaged or binary from here on; fetch it again",
                ));
            }
            _ => {}
        }
        Ok(words.finish())
    }

    /// Up to `most` numbers, at least `least`, the absent ones 0. Positions are shifted by the origin.
    fn numbers(
        &self,
        keyword: Range<usize>,
        words: &mut Words,
        least: usize,
        most: usize,
    ) -> Result<[f32; 3], Problem> {
        let is_position = keyword.len() == 1;
        let mut values = [0.0; 3];
        for (i, value) in values.iter_mut().enumerate().take(most) {
            let Some(place) = words.next_word() else {
                if i < least {
                    let name = String::from_utf8_lossy(&self.text[keyword.clone()]);
                    return Err(Problem::new(keyword, format!("`{name}` takes {least} numbers, here are {i}"), ""));
                }
                break;
            };
            let word = &self.text[place.clone()];
            let read = match self.origin[i] {
                origin if is_position && origin != 0.0 => number::parse_f64(word).map(|value| (value - origin) as f32),
                _ => number::parse_f32(word),
            };
            *value = read.ok_or_else(|| not_a_number(place, word))?;
        }
        Ok(values)
    }

    /// Counts a face of `size` corners, which have been appended, or a gap.
    #[inline(always)]
    fn end_face(&mut self, size: u32) {
        let faces = &mut self.out.faces;
        if size != 3 || !faces.sizes.is_empty() {
            faces.sizes.resize(self.out.count, 3);
            faces.sizes.push(size);
        }
        self.out.count += 1;
    }

    fn use_material(&mut self, name: Range<usize>) {
        match self.out.uses.last_mut() {
            // Nothing lies between: but the earlier name still takes a number, so it is kept.
            Some((face, last)) if *face == self.out.count && self.text[last.clone()] == self.text[name.clone()] => {}
            _ => self.out.uses.push((self.out.count, name)),
        }
    }

    /// Puts something in the place of the wrong line at `at` so that later numbers stay right: a vertex that is not
    /// a number, or a gap. Says where the next line begins.
    fn skip(&mut self, at: usize) -> usize {
        let mut words = Words::new(self.text, at);
        if let Some(keyword) = words.next_word() {
            match &self.text[keyword] {
                b"v" => self.out.positions.push([f32::NAN; 3]),
                b"vt" => self.out.texcoords.push([0.0; 2]),
                b"vn" => self.out.normals.push([0.0; 3]),
                b"f" | b"fo" => match words.count_rest() {
                    0..3 => self.out.too_few += 1,
                    n => {
                        let triangles = (n - 2).min(FaceBatch::GAP as u64 - 1);
                        self.out.bad += triangles;
                        self.end_face(FaceBatch::GAP | triangles as u32);
                    }
                },
                _ => {}
            }
        }
        words.finish()
    }
}

/// What the kinds are called, one and many.
pub(super) const NAMES: [(&str, &str); KINDS] =
    [("vertex", "vertices"), ("texture coordinate", "texture coordinates"), ("normal", "normals")];

/// A coordinate minus its origin, as the nearest f32.
#[inline(always)]
fn shifted(decimal: Decimal, origin: f64) -> Option<f32> {
    if origin == 0.0 { decimal.to_f32() } else { decimal.to_f64().map(|value| (value - origin) as f32) }
}

fn not_a_number(place: Range<usize>, word: &[u8]) -> Problem {
    let help = match word {
        _ if memchr::memchr(0, word).is_some() => "the file is damaged or binary from here on; fetch it again",
        _ if memchr::memchr(b',', word).is_some() => "OBJ writes decimals with a point and numbers apart with blanks",
        _ => "",
    };
    Problem::new(place, "not a number", help)
}
