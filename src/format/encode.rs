//! How a leaf is written.

use glam::Vec3;

use super::coordinates::Steps;
use super::leaf::{Coding, LEAF_MAX, LeafUnit, Points};
use crate::geometry::Triangle;

/// Appends a leaf to `out` (whose length is a multiple of the unit) and pads it. Vertices are merged by their bits.
///
/// With [`Points::Steps`] vertices are written as steps where these hold them bit for bit, else as f32. `None`, and nothing
/// appended, if there is no triangle, more than [`LEAF_MAX`], or more vertices than the unit allows. Corners take 4 bits whenever 16
/// vertices suffice.
pub fn encode_leaf(
    out: &mut Vec<u8>,
    unit: LeafUnit,
    points: Points,
    first: u32,
    triangles: &[Triangle],
) -> Option<()> {
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
    let vertices = &table.bits[..table.len];
    let steps = if points == Points::Steps { Steps::holding(vertices) } else { None };
    out.extend_from_slice(&first.to_le_bytes());
    let kind = u8::from(coding == Coding::Bytes) | u8::from(steps.is_some()) << 1;
    let exponent = steps.map_or(0, |steps| steps.exponent);
    out.extend_from_slice(&[triangles.len() as u8, table.len as u8, kind, exponent.to_le_bytes()[0]]);
    match coding {
        Coding::Nibbles => corners.iter().for_each(|c| out.extend_from_slice(&nibbles(c).to_le_bytes())),
        Coding::Bytes => {
            out.extend_from_slice(&[0; 8]);
            corners.iter().for_each(|c| out.extend_from_slice(c));
        }
    }
    if let Some(steps) = steps {
        steps.base.iter().for_each(|base| out.extend_from_slice(&base.to_le_bytes()));
    }
    for axis in 0..3 {
        match steps {
            Some(steps) => {
                vertices.iter().for_each(|v| out.extend_from_slice(&steps.step(axis, v[axis]).to_le_bytes()));
            }
            None => vertices.iter().for_each(|v| out.extend_from_slice(&v[axis].to_le_bytes())),
        }
    }
    out.resize(out.len().next_multiple_of(unit.bytes()), 0);
    Some(())
}

/// Packs 16 numbers below 16, 4 bits each, the first lowest.
fn nibbles(numbers: &[u8; LEAF_MAX]) -> u64 {
    numbers.iter().rev().fold(0, |word, &i| word << 4 | u64::from(i))
}

/// The distinct vertices of up to 16 triangles, by their bits (so -0 and 0 are two) and in the order in which they first come.
pub struct VertexTable {
    bits: [[u32; 3]; 3 * LEAF_MAX],
    len: usize,
    /// Open addressing: a vertex's number + 1, or 0. More than twice as many places as there may be vertices.
    places: [u8; VertexTable::PLACES],
}

impl Default for VertexTable {
    fn default() -> Self {
        VertexTable { bits: [[0; 3]; 3 * LEAF_MAX], len: 0, places: [0; VertexTable::PLACES] }
    }
}

impl VertexTable {
    const PLACES: usize = 128;

    /// Adds a triangle's corners; how many vertices there are then. At most 16 triangles may be added.
    #[inline]
    pub fn add_triangle(&mut self, triangle: &Triangle) -> usize {
        triangle.vertices().into_iter().for_each(|vertex| _ = self.number(vertex));
        self.len
    }

    /// The vertex's number; it is appended if it is new.
    #[inline]
    fn number(&mut self, vertex: Vec3) -> u8 {
        let bits = vertex.to_array().map(f32::to_bits);
        // Three products at a time, and the highest bits of their sum.
        let [x, y, z] = bits;
        let product = |bits: u32, factor: u32| (bits ^ bits >> 15).wrapping_mul(factor);
        let mixed = product(x, 0x9e37_79b9).wrapping_add(product(y, 0x85eb_ca6b)).wrapping_add(product(z, 0xc2b2_ae35));
        let mut place = (mixed >> 25) as usize % VertexTable::PLACES;
        loop {
            match self.places[place] {
                0 => break,
                next if self.bits[usize::from(next - 1)] == bits => return next - 1,
                _ => place = (place + 1) % VertexTable::PLACES,
            }
        }
        self.bits[self.len] = bits;
        self.len += 1;
        self.places[place] = self.len as u8;
        self.len as u8 - 1
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::format::Leaf;
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

    /// Vertices anywhere, or on a grid of any step.
    fn pool() -> impl Strategy<Value = Vec<Vec3>> {
        let vertex = || [coordinate(), coordinate(), coordinate()].prop_map(Vec3::from_array);
        let step = (-130i32..105, -70_000i32..70_000);
        let whole = move || prop::collection::vec([0i32..60_000, 0i32..70_000, 0i32..60_000], 1..40);
        let grid = (whole(), step).prop_map(|(list, (exponent, base))| {
            list.iter()
                .map(|n| Vec3::from_array(n.map(|n| ((n + base) as f64 * crate::geometry::exp2(exponent)) as f32)))
                .collect()
        });
        prop_oneof![prop::collection::vec(vertex(), 1..40), grid]
    }

    /// Up to 17 triangles over a pool of up to 40 vertices, so that some leaves are too large.
    fn triangles() -> impl Strategy<Value = Vec<Triangle>> {
        (pool(), prop::collection::vec(any::<[prop::sample::Index; 3]>(), 0..18)).prop_map(|(pool, corners)| {
            let pick = |i: &prop::sample::Index| *i.get(&pool);
            corners.iter().map(|[a, b, c]| Triangle { a: pick(a), b: pick(b), c: pick(c) }).collect()
        })
    }

    proptest! {
        #[test]
        fn what_is_encoded_is_read(list in triangles(), wide in any::<bool>(), steps in any::<bool>(), first in any::<u32>()) {
            let points = if steps { Points::Steps } else { Points::Floats };
            let unit = if wide { LeafUnit::B32 } else { LeafUnit::B16 };
            let mut distinct: Vec<_> = list.iter().flat_map(bits).collect();
            distinct.sort_unstable();
            distinct.dedup();
            let fits = (1..=16).contains(&list.len()) && distinct.len() <= unit.vertex_limit();
            let mut out = vec![0; 64];
            prop_assert_eq!(encode_leaf(&mut out, unit, points, first, &list).is_some(), fits);
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
            prop_assert!(steps || leaf.points() == Points::Floats);
            prop_assert_eq!(leaf.points() == Points::Steps, steps && Steps::holding(&distinct).is_some());
            for (j, t) in list.iter().enumerate() {
                prop_assert_eq!(bits(&leaf.triangle(j)), bits(t));
            }
            for axis in 0..3 {
                let list: Vec<f32> = leaf.coordinates(axis).iter().collect();
                prop_assert_eq!(list.len(), leaf.vertices());
                for j in 0..leaf.len() {
                    let of = |i: usize| list[i].to_bits();
                    prop_assert_eq!(leaf.corners(j).map(of), bits(&leaf.triangle(j)).map(|v| v[axis]));
                }
            }
        }

        #[test]
        fn reading_any_bytes_never_panics(words in prop::collection::vec(any::<u64>(), 1..80), coding in 0u8..5, exponent: u8, n in 0u8..18, nv in 0u8..34) {
            let mut words = words;
            words[0] = u64::from(n) << 32 | u64::from(nv) << 40 | u64::from(coding) << 48 | u64::from(exponent) << 56;
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
        encode_leaf(&mut out, LeafUnit::B16, Points::Floats, 0x0102_0304, &list).unwrap();
        assert_eq!(out[..8], [4, 3, 2, 1, 2, 4, 0, 0]);
        assert_eq!((out[8], out[16], out[24]), (0x20, 0x11, 0x32));
        assert_eq!(out[32..36], 1.0f32.to_le_bytes());
        assert_eq!(out[48..52], 1.25f32.to_le_bytes());
        assert_eq!(out[64..68], 1.5f32.to_le_bytes());
        assert_eq!(out.len(), 80);
        out.clear();
        encode_leaf(&mut out, LeafUnit::B16, Points::Steps, 0x0102_0304, &list).unwrap();
        assert_eq!(out[..8], [4, 3, 2, 1, 2, 4, 2, 0xfe]);
        assert_eq!((out[8], out[16], out[24]), (0x20, 0x11, 0x32));
        assert_eq!(out[32..44], [4, 0, 0, 0, 5, 0, 0, 0, 6, 0, 0, 0]);
        assert_eq!(out[44..52], [0, 0, 4, 0, 8, 0, 12, 0]);
        assert_eq!((&out[52..60], &out[60..68]), (&out[44..52], &out[44..52]));
        assert_eq!(out.len(), 80);
    }

    #[test]
    fn steps_out_of_range_are_refused() {
        let v = |x: f32| Vec3::new(x, -x, 0.0);
        let mut out = Vec::new();
        encode_leaf(&mut out, LeafUnit::B16, Points::Steps, 0, &[Triangle { a: v(1.0), b: v(2.0), c: v(9.0) }])
            .unwrap();
        let parses = |at: usize, bytes: &[u8]| {
            let mut out = out.clone();
            out[at..at + bytes.len()].copy_from_slice(bytes);
            let memory = aligned(&out);
            let leaf = Leaf::parse(bytemuck::cast_slice(&memory), LeafUnit::B16);
            leaf.inspect(|leaf| assert!(leaf.triangle(0).is_finite())).is_some()
        };
        assert!(parses(0, &[]));
        let exponents =
            [(0u8, true), (103, true), (104, false), (127, false), (0x82, true), (0x81, false), (0x80, false)];
        for (exponent, sound) in exponents {
            assert_eq!(parses(7, &[exponent]), sound, "{exponent}");
        }
        // The farthest vertex on x is 8 steps above the base.
        let most = 1 << 24;
        for (base, sound) in [
            (most - 8, true),
            (most - 7, false),
            (i32::MAX, false),
            (-most, true),
            (-most - 1, false),
            (i32::MIN, false),
        ] {
            assert_eq!(parses(32, &i32::to_le_bytes(base)), sound, "{base}");
        }
        assert!(!parses(6, &[4]) && !parses(6, &[1]) && !parses(6, &[3]));
        assert!(!parses(8, &[3]), "a corner that is no vertex");
        assert!(!parses(out.len() - 1, &[1]), "padding");
    }

    #[test]
    fn the_empty_leaf_is_harmless() {
        assert_eq!(Leaf::EMPTY.len(), 0);
        assert!(Leaf::EMPTY.coordinates(2).is_empty());
        assert!(Leaf::EMPTY.corner_points(3).is_none());
        assert_eq!(Leaf::EMPTY.triangle(3).a, Vec3::ZERO);
        assert!(Leaf::read(&[0; 64]).is_none());
    }
}
