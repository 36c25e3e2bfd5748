//! Blocks of faces as they are read back, and their index: where each lies, how much is in it, and which parts of the
//! tables its corners touch.
//!
//! The index stays in memory, some 40 to 800 bytes for each block of thousands of faces, and is written to a file when the scan
//! is done, so that a killed build finds its faces again ([`super::scanned`]).

use super::polygon::CLIP_LIMIT;
use super::spool::Spool;
use super::table::{FEW, Kind, PART};
use crate::error::Result;
use crate::mesh::{FaceBatch, NO_INDEX};

/// Where a block lies and what is in it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Block {
    /// Its first word in the spool.
    pub at: u64,
    pub first_id: u32,
    /// Words of sizes, corners, texture coordinate numbers, normal numbers and materials.
    pub lengths: [u32; 5],
    /// Parts of the tables of positions, texture coordinates and normals that the corners touch.
    pub touched: [Touched; 3],
}

/// Parts of a table.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Touched {
    /// These, in order.
    Few(Box<[u32]>),
    /// So many.
    Many(u32),
}

impl Touched {
    /// How many there are.
    pub fn len(&self) -> u64 {
        match self {
            Touched::Few(parts) => parts.len() as u64,
            Touched::Many(count) => u64::from(*count),
        }
    }
}

/// A face that was cut as it came: the ids of its triangles.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct LargeFace {
    pub first_id: u32,
    pub triangles: u32,
}

/// Triangles that the fan of a face has, or would have had if it is a gap.
pub(super) fn triangles_of(size: u32) -> u32 {
    if size & FaceBatch::GAP != 0 { size & !FaceBatch::GAP } else { size.saturating_sub(2) }
}

/// Corners of a face; a gap has none.
pub(super) fn corners_of(size: u32) -> usize {
    if size & FaceBatch::GAP != 0 { 0 } else { size as usize }
}

/// A block that has been read back.
pub(super) struct LoadedBlock {
    pub words: Vec<u32>,
    pub first_id: u32,
    pub lengths: [u32; 5],
}

/// The arrays of a block; as in [`FaceBatch`], but materials lie flat.
pub(super) struct FaceView<'a> {
    pub first_id: u32,
    pub sizes: &'a [u32],
    pub corners: &'a [u32],
    pub texcoords: &'a [u32],
    pub normals: &'a [u32],
    pub materials: &'a [u32],
}

impl<'a> FaceView<'a> {
    /// The numbers that name items of a table, one a corner; empty if no corner has one.
    pub fn numbers(&self, kind: Kind) -> &'a [u32] {
        match kind {
            Kind::Position => self.corners,
            Kind::Texcoord => self.texcoords,
            Kind::Normal => self.normals,
        }
    }
}

impl LoadedBlock {
    /// The triangles of a block that a killed build left and whose faces touch these parts of the tables; `None` if it is not as any
    /// that is written.
    pub fn check(&self, touches: &[Touched; 3]) -> Option<u64> {
        let view = self.view();
        let corners = view.corners.len();
        let small = |&size: &u32| corners_of(size) <= CLIP_LIMIT;
        let shaped = match view.sizes.is_empty() {
            true => corners.is_multiple_of(3),
            false => {
                view.sizes.iter().all(small) && view.sizes.iter().map(|&s| corners_of(s)).sum::<usize>() == corners
            }
        };
        let per_corner = |array: &[u32]| array.is_empty() || array.len() == corners;
        let sound = shaped
            && per_corner(view.texcoords)
            && per_corner(view.normals)
            && view.materials.len().is_multiple_of(2)
            && [view.corners, view.texcoords, view.normals].map(touched) == *touches;
        let triangles = match view.sizes.is_empty() {
            true => corners as u64 / 3,
            false => view.sizes.iter().map(|&size| u64::from(triangles_of(size))).sum(),
        };
        sound.then_some(triangles)
    }

    pub fn view(&self) -> FaceView<'_> {
        let [sizes, corners, texcoords, normals, materials] = self.lengths.map(|length| length as usize);
        let mut rest = &self.words[..];
        let mut take = |n: usize| {
            let (head, tail) = rest.split_at(n);
            rest = tail;
            head
        };
        FaceView {
            first_id: self.first_id,
            sizes: take(sizes),
            corners: take(corners),
            texcoords: take(texcoords),
            normals: take(normals),
            materials: take(materials),
        }
    }
}

/// The parts of a table that `numbers` touch.
pub(super) fn touched(numbers: &[u32]) -> Touched {
    let mut parts: Vec<u32> = Vec::new();
    let mut last = None;
    for &number in numbers.iter().filter(|&&number| number != NO_INDEX) {
        let part = number >> PART;
        if last.replace(part) != Some(part) && !parts.contains(&part) {
            if parts.len() == FEW {
                return Touched::Many(count_parts(numbers));
            }
            parts.push(part);
        }
    }
    parts.sort_unstable();
    Touched::Few(parts.into())
}

/// How many parts `numbers` touch.
fn count_parts(numbers: &[u32]) -> u32 {
    let parts = || numbers.iter().filter(|&&number| number != NO_INDEX).map(|&number| (number >> PART) as usize);
    let mut seen = vec![0u64; parts().max().unwrap_or(0) / 64 + 1];
    parts().for_each(|part| seen[part / 64] |= 1 << (part % 64));
    seen.iter().map(|word| word.count_ones()).sum()
}

/// Words that are gathered before they are written, or read at a time.
const PIECE: usize = 1 << 14;
/// Stands before the count of parts that are not listed.
const MANY: u32 = u32::MAX;

/// Appends the index to a spool: each block as place (low word first), first id, lengths and three lists, each list after
/// its length, or its length alone; then each large face as first id and number of triangles.
pub(super) fn write(blocks: &[Block], large: &[LargeFace], spool: &mut Spool<'_>) -> Result<()> {
    let mut words = Vec::with_capacity(2 * PIECE);
    for block in blocks {
        words.extend([block.at as u32, (block.at >> 32) as u32, block.first_id]);
        words.extend(block.lengths);
        for touched in &block.touched {
            match touched {
                Touched::Few(parts) => {
                    words.push(parts.len() as u32);
                    words.extend(parts);
                }
                Touched::Many(count) => words.extend([MANY, *count]),
            }
        }
        if words.len() >= PIECE {
            spool.append(&words)?;
            words.clear();
        }
    }
    spool.append(&words)?;
    for faces in large.chunks(PIECE) {
        words.clear();
        words.extend(faces.iter().flat_map(|face| [face.first_id, face.triangles]));
        spool.append(&words)?;
    }
    Ok(())
}

/// Reads back what [`write`] wrote; `None` if the spool does not hold so many blocks and large faces. Takes less than twice the bytes
/// of the spool and some.
pub(super) fn read(spool: &Spool<'_>, blocks: usize, large: usize) -> Option<(Vec<Block>, Vec<LargeFace>)> {
    let mut words = Reader { spool, at: 0, words: Vec::new(), used: 0 };
    let block = |words: &mut Reader<'_, '_>| {
        let [low, high, first_id] = words.array()?;
        let lengths = words.array()?;
        let mut list = || match words.next()? {
            MANY => words.next().map(Touched::Many),
            len if len as usize <= FEW => (0..len).map(|_| words.next()).collect::<Option<_>>().map(Touched::Few),
            _ => None,
        };
        let touched = [list()?, list()?, list()?];
        Some(Block { at: u64::from(high) << 32 | u64::from(low), first_id, lengths, touched })
    };
    let blocks = (0..blocks).map(|_| block(&mut words)).collect::<Option<_>>()?;
    let face = |[first_id, triangles]: [u32; 2]| LargeFace { first_id, triangles };
    let large = (0..large).map(|_| words.array().map(face)).collect::<Option<_>>()?;
    Some((blocks, large))
}

/// Reads a spool word by word.
struct Reader<'s, 'w> {
    spool: &'s Spool<'w>,
    at: u64,
    words: Vec<u32>,
    used: usize,
}

impl Reader<'_, '_> {
    fn next(&mut self) -> Option<u32> {
        if self.used == self.words.len() {
            let rest = self.spool.len() - self.at;
            self.words.resize(rest.min(PIECE as u64) as usize, 0);
            self.spool.read(self.at, &mut self.words).ok()?;
            (self.at, self.used) = (self.at + self.words.len() as u64, 0);
        }
        self.used += 1;
        self.words.get(self.used - 1).copied()
    }

    fn array<const N: usize>(&mut self) -> Option<[u32; N]> {
        let mut array = [0; N];
        for word in &mut array {
            *word = self.next()?;
        }
        Some(array)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::build::work::WorkFolder;

    #[test]
    fn an_index_is_read_back() {
        let folder = tempfile::tempdir().unwrap();
        let work = WorkFolder::new(folder.path(), "a.oct".as_ref(), true).unwrap();
        let block = |i: u32| Block {
            at: u64::from(i) << 30,
            first_id: 7 * i,
            lengths: [i, i + 1, 0, 3, 2],
            touched: [Touched::Few((0..i % 60).collect()), Touched::Many(i + 65), Touched::Few([].into())],
        };
        let blocks: Vec<Block> = (0..3000).map(block).collect();
        let large: Vec<LargeFace> = (0..40_000).map(|i| LargeFace { first_id: 9 * i, triangles: 5000 + i }).collect();
        let mut spool = Spool::new(&work, "index", 0);
        write(&blocks, &large, &mut spool).unwrap();
        assert!(read(&spool, blocks.len(), large.len()) == Some((blocks.clone(), large.clone())));
        assert!(read(&spool, blocks.len(), large.len() + 1).is_none());
        // A list that is longer than any that is written.
        let mut spool = Spool::new(&work, "longer", 0);
        let words: Vec<u32> = [0; 8].into_iter().chain([FEW as u32 + 1]).chain([0; FEW + 3]).collect();
        spool.append(&words).unwrap();
        assert!(read(&spool, 1, 0).is_none());
    }

    #[test]
    fn touched_parts_are_listed_or_counted() {
        assert_eq!(touched(&[9 << PART, 1, NO_INDEX, 2, 9 << PART | 5]), Touched::Few([0, 9].into()));
        assert_eq!(touched(&[]), Touched::Few([].into()));
        let many: Vec<u32> =
            (0..300u32).rev().chain([NO_INDEX - 1, NO_INDEX, 7]).map(|i| i.rotate_right(PART)).collect();
        assert_eq!(touched(&many), Touched::Many(301));
        assert_eq!(touched(&many[..FEW]).len(), FEW as u64);
        assert!(
            matches!(touched(&many[..FEW]), Touched::Few(_)) && touched(&many[..=FEW]) == Touched::Many(FEW as u32 + 1)
        );
    }
}
