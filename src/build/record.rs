//! Triangle records: what travels through the temporary files after the join.

use glam::Vec3;

use crate::geometry::{Aabb, Triangle};

/// What a record holds; only what the mesh has.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Layout {
    /// A material number.
    pub materials: bool,
    /// Three normals.
    pub normals: bool,
    /// Three texture coordinates.
    pub texcoords: bool,
    /// The box of the part of the triangle that the record stands for, behind all else ([`super::early`]).
    pub parts: bool,
}

/// One triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Record {
    pub corners: [[f32; 3]; 3],
    pub id: u32,
    /// 0 = none.
    pub material: u32,
    /// Not finite = none.
    pub normals: [[f32; 3]; 3],
    /// Not finite = none.
    pub texcoords: [[f32; 2]; 3],
}

/// Words of the corners and the id.
const PLAIN: usize = 10;
/// Words of a box.
const BOX: usize = 6;

impl Layout {
    /// Words of a record.
    pub fn words(self) -> usize {
        self.whole_words() + BOX * usize::from(self.parts)
    }

    /// Words of a record without the box of its part.
    fn whole_words(self) -> usize {
        PLAIN + usize::from(self.materials) + 9 * usize::from(self.normals) + 6 * usize::from(self.texcoords)
    }

    /// Appends a record.
    pub fn write(self, record: &Record, out: &mut Vec<u32>) {
        let [x, y, z, u, v, w, p, q, r] = bytemuck::cast::<_, [u32; 9]>(record.corners);
        out.extend_from_slice(&[x, y, z, u, v, w, p, q, r, record.id]);
        if self.materials {
            out.push(record.material);
        }
        if self.normals {
            out.extend(record.normals.as_flattened().iter().map(|x| x.to_bits()));
        }
        if self.texcoords {
            out.extend(record.texcoords.as_flattened().iter().map(|x| x.to_bits()));
        }
    }

    /// The triangle of a record.
    pub fn triangle(self, record: &[u32]) -> Triangle {
        let [x, y, z, u, v, w, p, q, r, _] = record.first_chunk::<PLAIN>().expect("a whole record").map(f32::from_bits);
        Triangle { a: Vec3::new(x, y, z), b: Vec3::new(u, v, w), c: Vec3::new(p, q, r) }
    }

    /// Appends what stands for a part of a triangle: `whole`, the record of the triangle in the layout without parts, and
    /// the part's box.
    pub fn write_part(self, whole: &[u32], part: Aabb, out: &mut Vec<u32>) {
        debug_assert!(self.parts && whole.len() == self.whole_words());
        out.extend_from_slice(whole);
        out.extend([part.min, part.max].iter().flat_map(|corner| corner.to_array()).map(f32::to_bits));
    }

    /// The box of what a record stands for: its part, or the whole triangle.
    pub fn bounds(self, record: &[u32]) -> Aabb {
        if !self.parts {
            return Aabb::from(&self.triangle(record));
        }
        let at = self.whole_words();
        let corner = |i: usize| [record[i], record[i + 1], record[i + 2]].map(f32::from_bits).into();
        Aabb { min: corner(at), max: corner(at + 3) }
    }

    /// The face id of a record.
    pub fn id(self, record: &[u32]) -> u32 {
        record[9]
    }

    /// The material number, if records hold one.
    pub fn material(self, record: &[u32]) -> Option<u32> {
        self.materials.then(|| record[PLAIN])
    }

    /// The corners' normals, if records hold them; not finite = none.
    pub fn normals(self, record: &[u32]) -> Option<[[f32; 3]; 3]> {
        let at = PLAIN + usize::from(self.materials);
        self.normals.then(|| corners(record, at))
    }

    /// The corners' texture coordinates, if records hold them; not finite = none.
    pub fn texcoords(self, record: &[u32]) -> Option<[[f32; 2]; 3]> {
        let at = PLAIN + usize::from(self.materials) + 9 * usize::from(self.normals);
        self.texcoords.then(|| corners(record, at))
    }
}

/// Three times `N` f32 from word `at` on.
fn corners<const N: usize>(record: &[u32], at: usize) -> [[f32; N]; 3] {
    std::array::from_fn(|corner| std::array::from_fn(|i| f32::from_bits(record[at + N * corner + i])))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_layout_reads_back() {
        for bits in 0..8 {
            let (materials, normals, texcoords) = (bits & 1 > 0, bits & 2 > 0, bits & 4 > 0);
            let layout = Layout { materials, normals, texcoords, parts: false };
            let record = Record {
                corners: [[1.0, -0.0, 3.0], [4.0, 5.0, 6.0], [7.0, 8.0, 9.0]],
                id: 10,
                material: 11,
                normals: [[12.0, 13.0, 14.0], [15.0, -0.0, 17.0], [18.0, 19.0, 20.0]],
                texcoords: [[21.0, 22.0], [23.0, 24.0], [25.0, -26.0]],
            };
            let mut words = vec![];
            layout.write(&record, &mut words);
            assert_eq!(words.len(), layout.words());
            let triangle = layout.triangle(&words);
            assert_eq!(triangle.vertices().map(|v| v.to_array()), record.corners);
            assert_eq!(layout.id(&words), 10);
            assert_eq!(layout.material(&words), layout.materials.then_some(11));
            assert_eq!(layout.normals(&words), layout.normals.then_some(record.normals));
            assert_eq!(layout.texcoords(&words), layout.texcoords.then_some(record.texcoords));
            let part = Aabb { min: [1.0, -0.5, 3.0].into(), max: [2.0, 0.5, 4.0].into() };
            let (with_part, mut more) = (Layout { parts: true, ..layout }, vec![]);
            with_part.write_part(&words, part, &mut more);
            assert_eq!((more.len(), &more[..words.len()]), (with_part.words(), &words[..]));
            assert_eq!(with_part.bounds(&more), part);
            assert_eq!(layout.bounds(&words), Aabb::from(&triangle));
        }
    }
}
