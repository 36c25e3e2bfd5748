//! Leaves: up to 16 triangles over a local vertex table.
//!
//! Neighbouring triangles share vertices, so a leaf of 9 triangles has about 8 of them: a table of distinct vertices with
//! 4-bit corner numbers is a third of the size of the triangles themselves. Corners come in two codings, for up to 16 and up to
//! 32 vertices; vertices as f32, or as steps of 16 bits where these hold the same f32; FORMAT.md, "Leaf", has the bytes. [`Leaf`]
//! reads a record where it lies, [`encode_leaf`](super::encode_leaf) writes one.

use glam::Vec3;

use super::coordinates::{Coordinates, EXPONENTS, WHOLE, decoded};
use crate::geometry::Triangle;

/// Most triangles in a leaf.
pub const LEAF_MAX: usize = 16;

/// The unit of leaf offsets and the alignment of leaves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LeafUnit {
    /// 16 bytes: coding 0 only.
    B16,
    /// 32 bytes: both codings.
    B32,
}

impl LeafUnit {
    /// Bytes of the unit.
    pub fn bytes(self) -> usize {
        match self {
            LeafUnit::B16 => 16,
            LeafUnit::B32 => 32,
        }
    }

    /// Most vertices a leaf may have.
    pub fn vertex_limit(self) -> usize {
        match self {
            LeafUnit::B16 => 16,
            LeafUnit::B32 => 32,
        }
    }
}

/// How the corners of a leaf are stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Coding {
    /// Codings 0 and 2: 4 bits a corner, at most 16 vertices.
    Nibbles,
    /// Codings 1 and 3: a byte a corner, at most 32 vertices.
    Bytes,
}

impl Coding {
    /// Where the vertices begin in the record.
    const fn vertices_at(self) -> usize {
        match self {
            Coding::Nibbles => 32,
            Coding::Bytes => 64,
        }
    }

    /// Most vertices.
    const fn vertex_limit(self) -> usize {
        match self {
            Coding::Nibbles => 16,
            Coding::Bytes => 32,
        }
    }
}

/// How the vertices of a leaf are stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Points {
    /// Codings 0 and 1: f32.
    Floats,
    /// Codings 2 and 3: whole numbers of 16 bits, counted from one of the leaf's own on each axis, times a power of two. They hold
    /// the very same f32.
    Steps,
}

impl Points {
    /// Bytes of what all vertices of a leaf share.
    const fn shared_bytes(self) -> usize {
        match self {
            Points::Floats => 0,
            Points::Steps => 12,
        }
    }

    /// Bytes of one coordinate.
    const fn coordinate_bytes(self) -> usize {
        match self {
            Points::Floats => 4,
            Points::Steps => 2,
        }
    }
}

/// A leaf, read in place.
#[derive(Clone, Copy, Debug)]
pub struct Leaf<'a> {
    /// From the record's first byte to the end of what `parse` or `read` was given; never shorter than the record.
    bytes: &'a [u8],
    coding: Coding,
    points: Points,
    len: u8,
    vertices: u8,
}

/// Zero bytes that lie as a leaf does.
#[repr(align(16))]
struct Zeros([u8; 64]);

const ZEROS: &Zeros = &Zeros([0; 64]);

impl<'a> Leaf<'a> {
    /// A leaf without triangles; stands for bytes that are none.
    pub const EMPTY: Leaf<'static> =
        Leaf { bytes: &ZEROS.0, coding: Coding::Nibbles, points: Points::Floats, len: 0, vertices: 0 };

    /// The leaf at the start of `bytes` (which may go on beyond it), every rule of FORMAT.md's "Leaf" checked.
    ///
    /// `None` if a count, a corner, a coordinate or an unused byte breaks a rule, if `bytes` ends too early, or if they
    /// are not aligned to 4 bytes in memory.
    pub fn parse(bytes: &'a [u8], unit: LeafUnit) -> Option<Leaf<'a>> {
        let leaf = Leaf::read(bytes)?;
        if leaf.vertices() > unit.vertex_limit() || (unit == LeafUnit::B16 && leaf.coding == Coding::Bytes) {
            return None;
        }
        let padding = bytes.get(leaf.end()..leaf.size(unit))?;
        // All parts are looked at, without a branch in between: every leaf of a page passes here when the page is first used.
        let zero = padding.iter().fold(0, |bits, &byte| bits | byte) == 0;
        let sound = (0..3).fold(true, |sound, axis| sound & leaf.is_sound(axis));
        (zero & sound && leaf.corners_are_sound()).then_some(leaf)
    }

    /// The leaf at the start of `bytes` in a page that was checked before: only what keeps the other functions of
    /// this type from reading outside `bytes` is looked at, so this is cheap.
    ///
    /// `None` for zero bytes, as they stand where a mapped file was cut short.
    #[inline]
    pub fn read(bytes: &'a [u8]) -> Option<Leaf<'a>> {
        let head: [u8; 8] = *bytes.first_chunk()?;
        let (coding, points) = match (head[6], head[7]) {
            (0, 0) => (Coding::Nibbles, Points::Floats),
            (1, 0) => (Coding::Bytes, Points::Floats),
            (2, _) => (Coding::Nibbles, Points::Steps),
            (3, _) => (Coding::Bytes, Points::Steps),
            _ => return None,
        };
        let (len, vertices) = (head[4], head[5]);
        let counts = matches!(len, 1..=16) && vertices >= 1 && usize::from(vertices) <= coding.vertex_limit();
        let leaf = Leaf { bytes, coding, points, len, vertices };
        let aligned = bytes.as_ptr().align_offset(align_of::<f32>()) == 0;
        (counts && leaf.end() <= bytes.len() && aligned).then_some(leaf)
    }

    /// First reference within the brick.
    #[inline]
    pub fn first(&self) -> u32 {
        u32::from_le_bytes([self.bytes[0], self.bytes[1], self.bytes[2], self.bytes[3]])
    }

    /// Triangles, 1 to 16 (0 only in [`Leaf::EMPTY`]).
    #[inline]
    pub fn len(&self) -> usize {
        self.len.into()
    }

    /// Whether there is no triangle: only in [`Leaf::EMPTY`].
    #[inline]
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Vertices, 1 to 32.
    #[inline]
    pub fn vertices(&self) -> usize {
        self.vertices.into()
    }

    /// How the corners are stored.
    #[inline]
    pub fn coding(&self) -> Coding {
        self.coding
    }

    /// How the vertices are stored.
    #[inline]
    pub fn points(&self) -> Points {
        self.points
    }

    /// The bytes from the record's start on, and beyond its end as far as they were given: in a page at least 64 bytes
    /// follow the record, so wide loads of coordinates may run over its end.
    #[inline]
    pub fn bytes(&self) -> &'a [u8] {
        self.bytes
    }

    /// Bytes of the record, padded to the unit.
    pub fn size(&self, unit: LeafUnit) -> usize {
        self.end().next_multiple_of(unit.bytes())
    }

    /// Where the vertices begin: behind the corners.
    #[inline(always)]
    pub fn vertices_at(&self) -> usize {
        self.coding.vertices_at()
    }

    /// Where the coordinates begin: x of all vertices, then y, then z. Numbers of [`Leaf::coordinate_bytes`] each.
    #[inline(always)]
    pub fn coordinates_at(&self) -> usize {
        self.coding.vertices_at() + self.points.shared_bytes()
    }

    /// Bytes of one coordinate: 4 or 2.
    #[inline(always)]
    pub fn coordinate_bytes(&self) -> usize {
        self.points.coordinate_bytes()
    }

    /// Bytes of the record without the padding.
    #[inline(always)]
    pub fn end(&self) -> usize {
        self.coordinates_at() + 3 * self.coordinate_bytes() * self.vertices()
    }

    /// How many bytes are read, from the record's start on, where each axis' coordinates are loaded `lanes` at a time.
    #[inline(always)]
    pub fn reach(&self, lanes: usize) -> usize {
        let nv = self.vertices();
        self.coordinates_at() + self.coordinate_bytes() * (2 * nv + nv.next_multiple_of(lanes))
    }

    /// [`Coding::Nibbles`]: the vertex numbers of all corners a, b, c; triangle j's in bits 4j to 4j + 3.
    #[inline(always)]
    pub fn corner_words(&self) -> [u64; 3] {
        [word(self.bytes, 8), word(self.bytes, 16), word(self.bytes, 24)]
    }

    /// [`Coding::Bytes`]: the vertex numbers of all corners a, b, c; triangle j's in byte j. Zero in the other.
    #[inline(always)]
    pub fn corner_bytes(&self) -> [[u8; 16]; 3] {
        match self.coding {
            Coding::Nibbles => [[0; 16]; 3],
            Coding::Bytes => [16, 32, 48].map(|at| std::array::from_fn(|j| self.bytes[at + j])),
        }
    }

    /// Vertex numbers of triangle `j`'s corners, `j` below 16.
    #[inline(always)]
    pub fn corners(&self, j: usize) -> [usize; 3] {
        match self.coding {
            Coding::Nibbles => {
                let [a, b, c] = self.corner_words();
                let at = 4 * (j & 15);
                [(a >> at & 15) as usize, (b >> at & 15) as usize, (c >> at & 15) as usize]
            }
            Coding::Bytes => {
                let (b, j) = (self.bytes, j & 15);
                [usize::from(b[16 + j]), usize::from(b[32 + j]), usize::from(b[48 + j])]
            }
        }
    }

    /// Triangle `j`, `j` below [`Leaf::len`]; its corners in the source's order.
    #[inline(always)]
    pub fn triangle(&self, j: usize) -> Triangle {
        let [a, b, c] = self.corner_points(j).unwrap_or_default().map(Vec3::from_array);
        Triangle { a, b, c }
    }

    /// The corners of triangle `j`, `j` below [`Leaf::len`]; `None` if one is no vertex, which no sound leaf has.
    #[inline(always)]
    pub fn corner_points(&self, j: usize) -> Option<[[f32; 3]; 3]> {
        let (corners, nv) = (self.corners(j), self.vertices());
        if corners.iter().any(|&i| i >= nv) {
            return None;
        }
        let stored = self.bytes.get(self.coordinates_at()..self.end())?;
        Some(match self.points {
            Points::Floats => {
                let stored: &[f32] = bytemuck::cast_slice(stored);
                corners.map(|i| [stored[i], stored[nv + i], stored[2 * nv + i]])
            }
            Points::Steps => {
                let stored: &[u16] = bytemuck::cast_slice(stored);
                let ([x, y, z], scale) = (self.base(), self.scale());
                let at = |base: i32, i: usize| decoded(stored[i], base, scale);
                corners.map(|i| [at(x, i), at(y, nv + i), at(z, 2 * nv + i)])
            }
        })
    }

    /// The coordinates of one axis (0 x, 1 y, 2 z) of all vertices.
    #[inline(always)]
    pub fn coordinates(&self, axis: usize) -> Coordinates<'a> {
        let length = self.coordinate_bytes() * self.vertices();
        let at = self.coordinates_at() + length * axis;
        let stored = &self.bytes[at..at + length];
        match self.points {
            Points::Floats => Coordinates::Floats(bytemuck::cast_slice(stored)),
            Points::Steps => Coordinates::Steps {
                steps: bytemuck::cast_slice(stored),
                base: self.base()[axis.min(2)],
                scale: self.scale(),
            },
        }
    }

    /// The same as a table of N, 16 or 32; behind them anything.
    #[inline(always)]
    pub fn table<const N: usize>(&self, axis: usize) -> [f32; N] {
        let mut table = [0.0; N];
        match self.coordinates(axis) {
            Coordinates::Floats(list) => table.iter_mut().zip(list).for_each(|(to, from)| *to = *from),
            Coordinates::Steps { steps, base, scale } => {
                let at = self.coordinates_at() + 2 * steps.len() * axis;
                for (k, to) in table.chunks_exact_mut(16).enumerate().take(steps.len().div_ceil(16)) {
                    // Sixteen at once where the page goes on long enough behind the leaf.
                    let whole = self.bytes.get(at + 32 * k..).and_then(|rest| rest.first_chunk::<32>());
                    if let Some(Ok(whole)) = whole.map(bytemuck::try_cast_ref::<[u8; 32], [u16; 16]>) {
                        (0..16).for_each(|i| to[i] = decoded(whole[i], base, scale));
                    } else {
                        to.iter_mut().zip(&steps[16 * k..]).for_each(|(to, &step)| *to = decoded(step, base, scale));
                    }
                }
            }
        }
        table
    }

    /// [`Points::Steps`]: the whole numbers from which steps are counted, axes x, y, z. Of no meaning in the other.
    #[inline(always)]
    pub fn base(&self) -> [i32; 3] {
        let at = self.vertices_at();
        let base = |at: usize| self.bytes[at..].first_chunk().map_or(0, |b| i32::from_le_bytes(*b));
        [base(at), base(at + 4), base(at + 8)]
    }

    /// [`Points::Steps`]: the length of a step, 2^-126 to 2^103.
    #[inline(always)]
    pub fn scale(&self) -> f32 {
        // By its bits: in any other file than a sound one some number.
        f32::from_bits(((self.exponent() + 127) as u32) << 23)
    }

    /// log2 of the scale.
    #[inline(always)]
    fn exponent(&self) -> i32 {
        i8::from_le_bytes([self.bytes[7]]).into()
    }

    /// Whether all coordinates of an axis are finite, and where they are steps, exact.
    #[inline(always)]
    fn is_sound(&self, axis: usize) -> bool {
        match self.coordinates(axis) {
            Coordinates::Floats(list) => list.iter().fold(true, |finite, x| finite & x.is_finite()),
            Coordinates::Steps { steps, base, .. } => {
                let most = steps.iter().fold(0, |most, &step| most.max(step));
                let whole = WHOLE.contains(&base) && WHOLE.contains(&base.saturating_add(most.into()));
                whole && EXPONENTS.contains(&self.exponent())
            }
        }
    }

    /// Whether every corner names a vertex and unused corner bits are zero.
    fn corners_are_sound(&self) -> bool {
        let (n, nv) = (self.len(), self.vertices());
        let inside = match self.coding {
            // Two nibbles of each byte at a time: with 128 - nv added, one of nv or more carries into the highest bit. Unused ones are 0.
            Coding::Nibbles => {
                let bytes = |w: u64| [w & 0x0f0f_0f0f_0f0f_0f0f, w >> 4 & 0x0f0f_0f0f_0f0f_0f0f];
                let beyond = |w: u64| bytes(w).map(|b| b + (128 - nv as u64) * 0x0101_0101_0101_0101);
                self.corner_words().map(beyond).as_flattened().iter().all(|b| b & 0x8080_8080_8080_8080 == 0)
            }
            Coding::Bytes => (0..n).all(|j| self.corners(j).iter().all(|&i| i < nv)),
        };
        let unused = match self.coding {
            Coding::Nibbles => n == 16 || self.corner_words().iter().all(|w| w >> (4 * n) == 0),
            Coding::Bytes => {
                word(self.bytes, 8) == 0 && self.corner_bytes().iter().all(|c| c[n..].iter().all(|&b| b == 0))
            }
        };
        inside && unused
    }
}

/// The little-endian u64 at `at`.
#[inline(always)]
fn word(bytes: &[u8], at: usize) -> u64 {
    bytes[at..].first_chunk().map_or(0, |b| u64::from_le_bytes(*b))
}
