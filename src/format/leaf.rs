//! Leaves: up to 16 triangles over a local vertex table.
//!
//! Neighbouring triangles share vertices, so a leaf of 9 triangles has about 8 of them: a table of distinct vertices with
//! 4-bit corner numbers is a third of the size of the triangles themselves. Two codings exist, for up to 16 and up to
//! 32 vertices; FORMAT.md, "Leaf", has their bytes. [`Leaf`] reads a record where it lies, [`encode_leaf`] writes one.

use glam::Vec3;

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
    /// Coding 0: 4 bits a corner, at most 16 vertices.
    Nibbles,
    /// Coding 1: a byte a corner, at most 32 vertices.
    Bytes,
}

impl Coding {
    /// Where the coordinates begin in the record.
    pub const fn coordinates_at(self) -> usize {
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

/// A leaf, read in place.
#[derive(Clone, Copy, Debug)]
pub struct Leaf<'a> {
    /// From the record's first byte to the end of what `parse` or `read` was given; never shorter than the record.
    bytes: &'a [u8],
    coding: Coding,
    len: u8,
    vertices: u8,
}

/// Zero bytes that lie as a leaf does.
#[repr(align(16))]
struct Zeros([u8; 64]);

const ZEROS: &Zeros = &Zeros([0; 64]);

impl<'a> Leaf<'a> {
    /// A leaf without triangles; stands for bytes that are none.
    pub const EMPTY: Leaf<'static> = Leaf { bytes: &ZEROS.0, coding: Coding::Nibbles, len: 0, vertices: 0 };

    /// The leaf at the start of `bytes` (which may go on beyond it), every rule of FORMAT.md's "Leaf" checked.
    ///
    /// `None` if a count, a corner, a coordinate or an unused byte breaks a rule, if `bytes` ends too early, or if they
    /// are not aligned to 4 bytes in memory.
    pub fn parse(bytes: &'a [u8], unit: LeafUnit) -> Option<Leaf<'a>> {
        let leaf = Leaf::read(bytes)?;
        if leaf.vertices() > unit.vertex_limit() || (unit == LeafUnit::B16 && leaf.coding == Coding::Bytes) {
            return None;
        }
        let end = leaf.coding.coordinates_at() + 12 * leaf.vertices();
        let padding = bytes.get(end..leaf.size(unit))?;
        // All parts are looked at, without a branch in between: every leaf of a page passes here when the page is first used.
        let zero = padding.iter().fold(0, |bits, &byte| bits | byte) == 0;
        let coordinates: &[f32] = bytemuck::cast_slice(&bytes[leaf.coding.coordinates_at()..end]);
        let finite = coordinates.iter().fold(true, |finite, x| finite & x.is_finite());
        (zero & finite && leaf.corners_are_sound()).then_some(leaf)
    }

    /// The leaf at the start of `bytes` in a page that was checked before: only what keeps the other functions of
    /// this type from reading outside `bytes` is looked at, so this is cheap.
    ///
    /// `None` for zero bytes, as they stand where a mapped file was cut short.
    #[inline]
    pub fn read(bytes: &'a [u8]) -> Option<Leaf<'a>> {
        let head: [u8; 8] = *bytes.first_chunk()?;
        let coding = match (head[6], head[7]) {
            (0, 0) => Coding::Nibbles,
            (1, 0) => Coding::Bytes,
            _ => return None,
        };
        let (len, vertices) = (head[4], head[5]);
        let counts = matches!(len, 1..=16) && vertices >= 1 && usize::from(vertices) <= coding.vertex_limit();
        let end = coding.coordinates_at() + 12 * usize::from(vertices);
        let aligned = bytes.as_ptr().align_offset(align_of::<f32>()) == 0;
        (counts && end <= bytes.len() && aligned).then_some(Leaf { bytes, coding, len, vertices })
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

    /// The bytes from the record's start on, and beyond its end as far as they were given: in a page at least 64 bytes
    /// follow the record, so wide loads of coordinates may run over its end.
    #[inline]
    pub fn bytes(&self) -> &'a [u8] {
        self.bytes
    }

    /// Bytes of the record, padded to the unit.
    pub fn size(&self, unit: LeafUnit) -> usize {
        (self.coding.coordinates_at() + 12 * self.vertices()).next_multiple_of(unit.bytes())
    }

    /// Coding 0: the vertex numbers of all corners a, b, c; triangle j's in bits 4j to 4j + 3.
    #[inline(always)]
    pub fn corner_words(&self) -> [u64; 3] {
        [word(self.bytes, 8), word(self.bytes, 16), word(self.bytes, 24)]
    }

    /// Coding 1: the vertex numbers of all corners a, b, c; triangle j's in byte j. Zero in coding 0.
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
        let [a, b, c] = self.corners(j).map(|i| self.vertex(i));
        Triangle { a, b, c }
    }

    /// Vertex `i`; the origin if there is none of that number.
    #[inline(always)]
    pub fn vertex(&self, i: usize) -> Vec3 {
        Vec3::from_array([0, 1, 2].map(|axis| self.coordinates(axis).get(i).copied().unwrap_or(0.0)))
    }

    /// The coordinates of one axis (0 x, 1 y, 2 z) of all vertices.
    #[inline(always)]
    pub fn coordinates(&self, axis: usize) -> &'a [f32] {
        let nv = self.vertices();
        let at = self.coding.coordinates_at() + 4 * nv * axis;
        bytemuck::cast_slice(&self.bytes[at..at + 4 * nv])
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

/// Appends a leaf to `out` (whose length is a multiple of the unit) and pads it. Vertices are merged by their bits.
///
/// `None`, and nothing appended, if there is no triangle, more than [`LEAF_MAX`], or more vertices than the unit allows.
/// Coding 0 is taken whenever 16 vertices suffice.
pub fn encode_leaf(out: &mut Vec<u8>, unit: LeafUnit, first: u32, triangles: &[Triangle]) -> Option<()> {
    if triangles.is_empty() || triangles.len() > LEAF_MAX {
        return None;
    }
    let mut table = VertexTable::default();
    let mut corners = [[0u8; LEAF_MAX]; 3];
    for (j, triangle) in triangles.iter().enumerate() {
        for (corner, vertex) in corners.iter_mut().zip(triangle.vertices()) {
            corner[j] = table.number(vertex);
        }
    }
    if table.len > unit.vertex_limit() {
        return None;
    }
    let coding = if table.len <= 16 { Coding::Nibbles } else { Coding::Bytes };
    out.extend_from_slice(&first.to_le_bytes());
    out.extend_from_slice(&[triangles.len() as u8, table.len as u8, u8::from(coding == Coding::Bytes), 0]);
    match coding {
        Coding::Nibbles => corners.iter().for_each(|c| out.extend_from_slice(&nibbles(c).to_le_bytes())),
        Coding::Bytes => {
            out.extend_from_slice(&[0; 8]);
            corners.iter().for_each(|c| out.extend_from_slice(c));
        }
    }
    for axis in 0..3 {
        table.bits[..table.len].iter().for_each(|v| out.extend_from_slice(&v[axis].to_le_bytes()));
    }
    out.resize(out.len().next_multiple_of(unit.bytes()), 0);
    Some(())
}

/// Packs 16 numbers below 16, 4 bits each, the first lowest.
fn nibbles(numbers: &[u8; LEAF_MAX]) -> u64 {
    numbers.iter().rev().fold(0, |word, &i| word << 4 | u64::from(i))
}

/// The distinct vertices of up to 16 triangles, by their bits and in the order in which they first come.
struct VertexTable {
    bits: [[u32; 3]; 3 * LEAF_MAX],
    len: usize,
}

impl Default for VertexTable {
    fn default() -> Self {
        VertexTable { bits: [[0; 3]; 3 * LEAF_MAX], len: 0 }
    }
}

impl VertexTable {
    /// The vertex's number; it is appended if it is new.
    fn number(&mut self, vertex: Vec3) -> u8 {
        let bits = vertex.to_array().map(f32::to_bits);
        let found = self.bits[..self.len].iter().position(|b| *b == bits);
        let number = found.unwrap_or_else(|| {
            self.bits[self.len] = bits;
            self.len += 1;
            self.len - 1
        });
        number as u8
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The bytes in memory aligned as a page's are.
    fn aligned(bytes: &[u8]) -> Vec<u64> {
        bytes.chunks(8).map(|c| u64::from_le_bytes(std::array::from_fn(|i| c.get(i).copied().unwrap_or(0)))).collect()
    }

    fn bits(t: &Triangle) -> [[u32; 3]; 3] {
        t.vertices().map(|v| v.to_array().map(f32::to_bits))
    }

    /// Finite coordinates by their bits: both zeros, denormals and the largest among them.
    fn coordinate() -> impl Strategy<Value = f32> {
        let special =
            prop::sample::select(vec![0.0, -0.0, 1.0, -1.0, 1e-45, -1e-45, f32::MIN_POSITIVE, f32::MAX, f32::MIN]);
        prop_oneof![1 => special, 3 => any::<u32>().prop_map(f32::from_bits).prop_filter("finite", |x| x.is_finite())]
    }

    /// Up to 17 triangles over a pool of up to 40 vertices, so that some leaves are too large.
    fn triangles() -> impl Strategy<Value = Vec<Triangle>> {
        let vertex = [coordinate(), coordinate(), coordinate()].prop_map(Vec3::from_array);
        (prop::collection::vec(vertex, 1..40), prop::collection::vec(any::<[prop::sample::Index; 3]>(), 0..18))
            .prop_map(|(pool, corners)| {
                let pick = |i: &prop::sample::Index| *i.get(&pool);
                corners.iter().map(|[a, b, c]| Triangle { a: pick(a), b: pick(b), c: pick(c) }).collect()
            })
    }

    proptest! {
        #[test]
        fn what_is_encoded_is_read(list in triangles(), wide in any::<bool>(), first in any::<u32>()) {
            let unit = if wide { LeafUnit::B32 } else { LeafUnit::B16 };
            let mut distinct: Vec<_> = list.iter().flat_map(bits).collect();
            distinct.sort_unstable();
            distinct.dedup();
            let fits = (1..=16).contains(&list.len()) && distinct.len() <= unit.vertex_limit();
            let mut out = vec![0; 64];
            prop_assert_eq!(encode_leaf(&mut out, unit, first, &list).is_some(), fits);
            if !fits {
                prop_assert_eq!(out.len(), 64);
                return Ok(());
            }
            prop_assert_eq!(out.len() % unit.bytes(), 0);
            let memory = aligned(&out[64..]);
            let leaf = Leaf::parse(bytemuck::cast_slice(&memory), unit).expect("just encoded");
            prop_assert_eq!(leaf.first(), first);
            prop_assert_eq!(leaf.len(), list.len());
            prop_assert_eq!(leaf.vertices(), distinct.len());
            prop_assert_eq!(leaf.size(unit), out.len() - 64);
            prop_assert_eq!(leaf.coding() == Coding::Nibbles, distinct.len() <= 16);
            for (j, t) in list.iter().enumerate() {
                prop_assert_eq!(bits(&leaf.triangle(j)), bits(t));
            }
        }

        #[test]
        fn reading_any_bytes_never_panics(words in prop::collection::vec(any::<u64>(), 1..80), coding in 0u8..3, n in 0u8..18, nv in 0u8..34) {
            let mut words = words;
            words[0] = u64::from(n) << 32 | u64::from(nv) << 40 | u64::from(coding) << 48;
            let bytes = bytemuck::cast_slice(&words);
            if let Some(leaf) = Leaf::read(bytes) {
                (0..leaf.len()).for_each(|j| _ = leaf.triangle(j));
                prop_assert_eq!(leaf.coordinates(2).len(), leaf.vertices());
            }
            if let Some(leaf) = Leaf::parse(bytes, LeafUnit::B32) {
                prop_assert!((0..leaf.len()).all(|j| leaf.triangle(j).is_finite()));
                prop_assert!((0..leaf.len()).all(|j| leaf.corners(j).iter().all(|&i| i < leaf.vertices())));
            }
        }
    }

    #[test]
    fn bytes_are_as_the_specification_says() {
        let v = |x: f32| Vec3::new(x, x + 0.25, x + 0.5);
        let list = [Triangle { a: v(1.0), b: v(2.0), c: v(3.0) }, Triangle { a: v(3.0), b: v(2.0), c: v(4.0) }];
        let mut out = Vec::new();
        encode_leaf(&mut out, LeafUnit::B16, 0x0102_0304, &list).unwrap();
        assert_eq!(out[..8], [4, 3, 2, 1, 2, 4, 0, 0]);
        assert_eq!((out[8], out[16], out[24]), (0x20, 0x11, 0x32));
        assert_eq!(out[32..36], 1.0f32.to_le_bytes());
        assert_eq!(out[48..52], 1.25f32.to_le_bytes());
        assert_eq!(out[64..68], 1.5f32.to_le_bytes());
        assert_eq!(out.len(), 80);
    }

    #[test]
    fn the_empty_leaf_is_harmless() {
        assert_eq!(Leaf::EMPTY.len(), 0);
        assert!(Leaf::EMPTY.coordinates(2).is_empty());
        assert_eq!(Leaf::EMPTY.vertex(3), Vec3::ZERO);
        assert!(Leaf::read(&[0; 64]).is_none());
    }
}
