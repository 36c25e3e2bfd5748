//! Triangle records: what travels through the temporary files after the join.

use crate::geometry::Triangle;

/// What a record holds; only what the mesh has.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Layout {
    /// A material number.
    pub materials: bool,
    /// Three places in the source's normals.
    pub normals: bool,
    /// Three places in the source's texture coordinates.
    pub texcoords: bool,
}

/// One triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Record {
    pub corners: [[f32; 3]; 3],
    pub id: u32,
    /// 0 = none.
    pub material: u32,
    /// [`crate::mesh::NO_INDEX`] = none.
    pub normals: [u32; 3],
    /// [`crate::mesh::NO_INDEX`] = none.
    pub texcoords: [u32; 3],
}

/// Words of the corners and the id.
const PLAIN: usize = 10;

impl Layout {
    /// Words of a record.
    pub fn words(self) -> usize {
        PLAIN + usize::from(self.materials) + 3 * usize::from(self.normals) + 3 * usize::from(self.texcoords)
    }

    /// Appends a record.
    pub fn write(self, record: &Record, out: &mut Vec<u32>) {
        out.extend(record.corners.as_flattened().iter().map(|x| x.to_bits()));
        out.push(record.id);
        if self.materials {
            out.push(record.material);
        }
        if self.normals {
            out.extend(record.normals);
        }
        if self.texcoords {
            out.extend(record.texcoords);
        }
    }

    /// The triangle of a record.
    pub fn triangle(self, record: &[u32]) -> Triangle {
        let corner = |i: usize| [record[i], record[i + 1], record[i + 2]].map(f32::from_bits).into();
        Triangle { a: corner(0), b: corner(3), c: corner(6) }
    }

    /// The face id of a record.
    pub fn id(self, record: &[u32]) -> u32 {
        record[9]
    }

    /// The material number, if records hold one.
    pub fn material(self, record: &[u32]) -> Option<u32> {
        self.materials.then(|| record[PLAIN])
    }

    /// The places of the corners' normals, if records hold them.
    pub fn normals(self, record: &[u32]) -> Option<[u32; 3]> {
        let at = PLAIN + usize::from(self.materials);
        self.normals.then(|| [record[at], record[at + 1], record[at + 2]])
    }

    /// The places of the corners' texture coordinates, if records hold them.
    pub fn texcoords(self, record: &[u32]) -> Option<[u32; 3]> {
        let at = PLAIN + usize::from(self.materials) + 3 * usize::from(self.normals);
        self.texcoords.then(|| [record[at], record[at + 1], record[at + 2]])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_layout_reads_back() {
        for bits in 0..8 {
            let layout = Layout { materials: bits & 1 > 0, normals: bits & 2 > 0, texcoords: bits & 4 > 0 };
            let record = Record {
                corners: [[1.0, -0.0, 3.0], [4.0, 5.0, 6.0], [7.0, 8.0, 9.0]],
                id: 10,
                material: 11,
                normals: [12, 13, 14],
                texcoords: [15, 16, 17],
            };
            let mut words = vec![];
            layout.write(&record, &mut words);
            assert_eq!(words.len(), layout.words());
            let triangle = layout.triangle(&words);
            assert_eq!(triangle.vertices().map(|v| v.to_array()), record.corners);
            assert_eq!(layout.id(&words), 10);
            assert_eq!(layout.material(&words), layout.materials.then_some(11));
            assert_eq!(layout.normals(&words), layout.normals.then_some([12, 13, 14]));
            assert_eq!(layout.texcoords(&words), layout.texcoords.then_some([15, 16, 17]));
        }
    }
}
