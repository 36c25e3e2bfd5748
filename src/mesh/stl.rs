//! Streaming reader of STL, binary and text.
//!
//! An STL file is a list of triangles that share no vertices: triangle i has the vertices 3i, 3i + 1 and 3i + 2. Its normals
//! are those of the triangles and say nothing new; they, the names of solids and the two spare bytes are passed over.
//!
//! Which of the two forms a file has is told by its length where that is known (80 bytes, a count, 50 bytes for each
//! triangle), else by its first bytes: a binary one may begin with `solid` too.

use std::sync::atomic::Ordering;

use super::bytes::Bytes;
use super::input::Input;
use super::obj::{parse_f32, parse_f64};
use super::{FaceBatch, MeshSink, ReadOptions, SourceInfo, TriangleSource};
use crate::error::{Error, Result};
use crate::event::Monitor;

/// Bytes before the triangles of a binary file.
const HEAD: usize = 84;
/// Bytes of a triangle of a binary file.
const TRIANGLE: usize = 50;
/// Triangles that are sent on at a time.
const BATCH: usize = 1 << 14;

/// An STL file that is to be read.
pub(super) struct StlSource {
    input: Input,
    options: ReadOptions,
}

impl StlSource {
    /// The input read with these options.
    pub fn new(input: Input, options: ReadOptions) -> StlSource {
        StlSource { input, options }
    }
}

impl TriangleSource for StlSource {
    fn read(&mut self, sink: &mut dyn MeshSink, monitor: Monitor<'_>) -> Result<SourceInfo> {
        let stream = self.input.start(self.options.window)?;
        let (taken, size, packed) = (stream.taken(), self.input.size(), stream.is_packed());
        let block = self.options.block_of(packed);
        let mut bytes = Bytes::new(stream, block, monitor);
        while bytes.rest().len() < 512 && bytes.more()? {}
        let plain_size = size.filter(|_| !packed);
        let mut reader = Reader {
            sink,
            options: self.options,
            input: &self.input,
            progress: &|| monitor.progress(taken.load(Ordering::Relaxed), size, "bytes"),
            positions: Vec::new(),
            faces: FaceBatch::default(),
            vertices: 0,
            info: SourceInfo::default(),
        };
        match is_text(bytes.rest(), plain_size) {
            true => reader.text(&mut bytes)?,
            false => reader.binary(&mut bytes)?,
        }
        let info = reader.info;
        self.input.check_unchanged()?;
        Ok(info)
    }

    fn size_hint(&self) -> Option<u64> {
        self.input.size()
    }

    fn triangles_hint(&self) -> Option<u64> {
        // Packed, half is left, and of a text, which takes some 250 bytes a triangle, a sixth.
        let (head, packed) = self.input.head(512)?;
        let text = is_text(&head, self.input.size().filter(|_| !packed));
        let (bytes, ratio) = if text { (250, 6) } else { (TRIANGLE as u64, 2) };
        Some(self.input.size()? * if packed { ratio } else { 1 } / bytes)
    }
}

/// Whether a file that begins with `head` is a text.
fn is_text(head: &[u8], size: Option<u64>) -> bool {
    let count = head.get(80..HEAD).and_then(|count| count.try_into().ok()).map_or(0, u32::from_le_bytes);
    let whole = size.is_some_and(|size| size == HEAD as u64 + TRIANGLE as u64 * u64::from(count));
    let head = &head[..head.len().min(512)];
    let holds = |word: &[u8]| memchr::memmem::find(head, word).is_some();
    !whole
        && head.trim_ascii_start().starts_with(b"solid")
        && (holds(b"facet") || holds(b"endsolid"))
        && !head.contains(&0)
}

struct Reader<'a> {
    sink: &'a mut dyn MeshSink,
    options: ReadOptions,
    input: &'a Input,
    progress: &'a dyn Fn(),
    positions: Vec<[f32; 3]>,
    faces: FaceBatch,
    /// Vertices sent on or waiting.
    vertices: u64,
    info: SourceInfo,
}

impl Reader<'_> {
    fn wrong(&self, what: String) -> Error {
        Error::Input { file: self.input.error_path(), what }
    }

    fn binary(&mut self, bytes: &mut Bytes<'_>) -> Result<()> {
        let Some(head) = bytes.take(HEAD)? else {
            return Err(self.wrong("this is no STL file: it is shorter than the head of one; fetch it again".into()));
        };
        let count = u32::from_le_bytes(head[80..].try_into().unwrap_or_default());
        for triangle in 0..count {
            let Some(record) = bytes.take(TRIANGLE)? else {
                return Err(self.wrong(format!(
                    "the file ends in the middle: {triangle} of {count} triangles are there; it was cut short, fetch it \
                     again"
                )));
            };
            let number = |i: usize| f32::from_le_bytes(record[4 * i..4 * i + 4].try_into().unwrap_or_default());
            for corner in 1..4 {
                let position = [0, 1, 2].map(|axis| number(3 * corner + axis));
                self.positions.push(shifted(position, self.options.origin));
            }
            self.face(3)?;
        }
        self.send()
    }

    fn text(&mut self, bytes: &mut Bytes<'_>) -> Result<()> {
        let (mut size, mut ended) = (0u32, true);
        for line_number in 1u64.. {
            let Some(line) = bytes.line()? else { break };
            let mut words = line.split(u8::is_ascii_whitespace).filter(|word| !word.is_empty());
            match words.next() {
                Some(b"vertex") => {
                    let position = vertex(words, self.options.origin);
                    let Some(position) = position.or(self.options.lenient.then_some([f32::NAN; 3])) else {
                        let line: String = String::from_utf8_lossy(line).chars().take(80).collect();
                        return Err(self.wrong(format!("line {line_number}: not three numbers: `{}`; correct the line, or give --lenient to drop such triangles", line.trim())));
                    };
                    self.positions.push(position);
                    size += 1;
                }
                Some(b"endloop") => self.face(std::mem::take(&mut size))?,
                Some(b"facet" | b"solid") => ended = false,
                Some(b"endsolid") => ended = true,
                _ => {}
            }
        }
        if size > 0 || !ended {
            return Err(
                self.wrong("the file ends in the middle: endsolid is missing; it was cut short, fetch it again".into())
            );
        }
        self.send()
    }

    /// Makes a face of the last `size` vertices.
    fn face(&mut self, size: u32) -> Result<()> {
        let first = self.vertices;
        self.vertices += u64::from(size);
        if self.vertices > u64::from(u32::MAX) {
            return Err(
                self.wrong(format!("more than {} vertices, the most that can be counted; split the mesh", u32::MAX))
            );
        }
        if size < 3 {
            self.info.too_few_corners += 1;
            return Ok(());
        }
        if size != 3 && self.faces.sizes.is_empty() {
            self.faces.sizes = vec![3; self.faces.corners.len() / 3];
        }
        if size != 3 || !self.faces.sizes.is_empty() {
            self.faces.sizes.push(size);
        }
        self.faces.corners.extend(first as u32..self.vertices as u32);
        if self.faces.corners.len() >= 3 * BATCH { self.send() } else { Ok(()) }
    }

    fn send(&mut self) -> Result<()> {
        self.sink.positions(&self.positions)?;
        self.positions.clear();
        if !self.faces.corners.is_empty() {
            self.sink.faces(&self.faces)?;
        }
        self.faces.sizes.clear();
        self.faces.corners.clear();
        (self.progress)();
        Ok(())
    }
}

/// A point with the origin taken off.
fn shifted(position: [f32; 3], origin: [f64; 3]) -> [f32; 3] {
    std::array::from_fn(|i| if origin[i] == 0.0 { position[i] } else { (f64::from(position[i]) - origin[i]) as f32 })
}

/// The three numbers of a vertex line.
fn vertex<'w>(mut words: impl Iterator<Item = &'w [u8]>, origin: [f64; 3]) -> Option<[f32; 3]> {
    let mut position = [0.0; 3];
    for (value, origin) in position.iter_mut().zip(origin) {
        let word = words.next()?;
        *value = if origin == 0.0 { parse_f32(word)? } else { (parse_f64(word)? - origin) as f32 };
    }
    Some(position)
}
