//! Faces between scan and join: blocks of flat arrays in a spool, with an index of the blocks in memory.
//!
//! Faces may name vertices that come later, so they wait here until the scan is done. A block says by itself which
//! triangle ids and which material its faces have, so that blocks can be joined in any order. Its words are, one array
//! after the other: sizes (unless all faces are triangles), corners, texture coordinate numbers and normal numbers (if
//! any), pairs of face and material number.

use crate::error::{Error, Result};
use crate::mesh::{FaceBatch, NO_INDEX};

use super::spool::Spool;

/// Triangles that the fan of a face has, or would have had if it is a gap.
pub(super) fn triangles_of(size: u32) -> u32 {
    if size & FaceBatch::GAP != 0 { size & !FaceBatch::GAP } else { size.saturating_sub(2) }
}

/// Corners of a face; a gap has none.
pub(super) fn corners_of(size: u32) -> usize {
    if size & FaceBatch::GAP != 0 { 0 } else { size as usize }
}

/// Where a block lies and what is in it.
#[derive(Clone, Copy, Debug)]
struct Block {
    at: u64,
    first_id: u32,
    sizes: usize,
    corners: usize,
    texcoords: usize,
    normals: usize,
    materials: usize,
}

/// A block that has been read back.
pub(super) struct LoadedBlock {
    words: Vec<u32>,
    block: Block,
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

impl LoadedBlock {
    pub fn view(&self) -> FaceView<'_> {
        let Block { first_id, sizes, corners, texcoords, normals, materials, .. } = self.block;
        let mut rest = &self.words[..];
        let mut take = |n: usize| {
            let (head, tail) = rest.split_at(n);
            rest = tail;
            head
        };
        FaceView {
            first_id,
            sizes: take(sizes),
            corners: take(corners),
            texcoords: take(texcoords),
            normals: take(normals),
            materials: take(materials),
        }
    }
}

/// All faces of a mesh.
pub(super) struct Faces {
    spool: Spool,
    blocks: Vec<Block>,
    block_corners: usize,
    pending: FaceBatch,
    pending_faces: u32,
    pending_id: u64,
    material: u32,
    ids: u64,
    /// Whether any face has a material.
    pub has_materials: bool,
    /// Whether any corner has a texture coordinate.
    pub has_texcoords: bool,
    /// Whether any corner has a normal.
    pub has_normals: bool,
    /// Faces of one or two corners; readers drop them, so 0 unless one does not.
    pub too_few_corners: u64,
}

impl Faces {
    pub fn new(spool: Spool, block_corners: usize) -> Self {
        Faces {
            spool,
            blocks: Vec::new(),
            block_corners,
            pending: FaceBatch::default(),
            pending_faces: 0,
            pending_id: 0,
            material: 0,
            ids: 0,
            has_materials: false,
            has_texcoords: false,
            has_normals: false,
            too_few_corners: 0,
        }
    }

    /// Triangles so far, gaps included.
    pub fn triangles(&self) -> u64 {
        self.ids
    }

    pub fn blocks(&self) -> usize {
        self.blocks.len()
    }

    /// Reads a block back.
    pub fn load(&mut self, block: usize) -> Result<LoadedBlock> {
        let block = self.blocks[block];
        let mut words = vec![0; block.sizes + block.corners + block.texcoords + block.normals + block.materials];
        self.spool.read(block.at, &mut words)?;
        Ok(LoadedBlock { words, block })
    }

    /// Takes a batch over, block by block.
    pub fn append(&mut self, batch: &FaceBatch) -> Result<()> {
        check(batch)?;
        let faces = if batch.sizes.is_empty() { batch.corners.len() / 3 } else { batch.sizes.len() };
        let (mut face, mut corner) = (0, 0);
        let mut materials = batch.materials.iter().copied().peekable();
        while face < faces {
            let (taken, corners) = self.fitting(batch, face, faces);
            self.extend(batch, face..face + taken, corner..corner + corners);
            while let Some((at, material)) = materials.next_if(|&(at, _)| (at as usize) < face + taken) {
                self.set_material(
                    (at as usize).saturating_sub(face) as u32 + self.pending_faces - taken as u32,
                    material,
                );
            }
            (face, corner) = (face + taken, corner + corners);
            if self.pending.corners.len() >= self.block_corners || self.pending_faces as usize >= self.block_corners {
                self.flush()?;
            }
        }
        Ok(())
    }

    /// How many faces from `face` on the pending block takes, at least one, and their corners.
    fn fitting(&self, batch: &FaceBatch, face: usize, faces: usize) -> (usize, usize) {
        let room = self.block_corners.saturating_sub(self.pending.corners.len()).max(1);
        if batch.sizes.is_empty() {
            let taken = room.div_ceil(3).min(faces - face);
            return (taken, 3 * taken);
        }
        let (mut taken, mut corners) = (0, 0);
        for &size in batch.sizes[face..].iter().take(self.block_corners) {
            if corners >= room {
                break;
            }
            corners += corners_of(size);
            taken += 1;
        }
        (taken, corners)
    }

    fn extend(&mut self, batch: &FaceBatch, faces: std::ops::Range<usize>, corners: std::ops::Range<usize>) {
        let before = self.pending.corners.len();
        if batch.sizes.is_empty() {
            self.ids += faces.len() as u64;
            if !self.pending.sizes.is_empty() {
                self.pending.sizes.extend(faces.clone().map(|_| 3));
            }
        } else {
            // Until now all pending faces were triangles and said so by having no sizes.
            self.pending.sizes.resize(self.pending_faces as usize, 3);
            let sizes = &batch.sizes[faces.clone()];
            self.ids += sizes.iter().map(|&size| u64::from(triangles_of(size))).sum::<u64>();
            self.too_few_corners += sizes.iter().filter(|&&size| size < 3).count() as u64;
            self.pending.sizes.extend(sizes);
        }
        self.pending.corners.extend(&batch.corners[corners.clone()]);
        let extend = |pending: &mut Vec<u32>, from: &[u32], has: &mut bool| {
            let from = from.get(corners.clone()).unwrap_or_default();
            if from.iter().any(|&index| index != NO_INDEX) {
                *has = true;
                pending.resize(before, NO_INDEX);
                pending.extend(from);
            } else if !pending.is_empty() {
                pending.resize(before + corners.len(), NO_INDEX);
            }
        };
        extend(&mut self.pending.texcoords, &batch.texcoords, &mut self.has_texcoords);
        extend(&mut self.pending.normals, &batch.normals, &mut self.has_normals);
        self.pending_faces += faces.len() as u32;
    }

    /// `material` holds from the pending block's face `face` on.
    fn set_material(&mut self, face: u32, material: u32) {
        self.material = material;
        self.has_materials |= material != 0;
        self.pending.materials.push((face, material));
    }

    /// Writes the pending block and begins the next.
    pub fn flush(&mut self) -> Result<()> {
        if self.ids > u64::from(u32::MAX) {
            return Err(Error::Option(format!("the mesh has more than {} triangles, which is the limit", u32::MAX)));
        }
        if self.pending_faces == 0 {
            return Ok(());
        }
        let mut pending = std::mem::take(&mut self.pending);
        let materials: Vec<u32> = pending.materials.drain(..).flat_map(|(face, material)| [face, material]).collect();
        self.blocks.push(Block {
            at: self.spool.len(),
            first_id: self.pending_id as u32,
            sizes: pending.sizes.len(),
            corners: pending.corners.len(),
            texcoords: pending.texcoords.len(),
            normals: pending.normals.len(),
            materials: materials.len(),
        });
        for array in [&pending.sizes, &pending.corners, &pending.texcoords, &pending.normals, &materials] {
            self.spool.append(array)?;
        }
        // The next block starts with the material that holds now.
        self.pending.materials.push((0, self.material));
        (self.pending_faces, self.pending_id) = (0, self.ids);
        Ok(())
    }
}

/// Refuses a batch whose arrays do not fit together, which only a wrong reader makes.
fn check(batch: &FaceBatch) -> Result<()> {
    let corners = batch.corners.len();
    let whole = match batch.sizes.is_empty() {
        true => corners.is_multiple_of(3),
        false => batch.sizes.iter().map(|&size| corners_of(size)).sum::<usize>() == corners,
    };
    let per_corner = |array: &[u32]| array.is_empty() || array.len() == corners;
    if whole && per_corner(&batch.texcoords) && per_corner(&batch.normals) {
        Ok(())
    } else {
        Err(Error::Option("the triangle source sent a batch of faces whose arrays do not fit together".into()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn faces(block_corners: usize) -> Faces {
        Faces::new(Spool::new(&std::env::temp_dir(), usize::MAX), block_corners)
    }

    /// Id, size, corners, texture coordinate numbers, material.
    type Face = (u32, u32, Vec<u32>, Vec<u32>, u32);

    fn read_all(faces: &mut Faces) -> Vec<Face> {
        faces.flush().unwrap();
        let mut all = vec![];
        for block in 0..faces.blocks() {
            let block = faces.load(block).unwrap();
            let view = block.view();
            let count = if view.sizes.is_empty() { view.corners.len() / 3 } else { view.sizes.len() };
            let (mut id, mut corner) = (view.first_id, 0);
            for face in 0..count {
                let size = view.sizes.get(face).copied().unwrap_or(3);
                let range = corner..corner + corners_of(size);
                let material = view.materials.chunks(2).rfind(|m| m[0] <= face as u32).map_or(0, |m| m[1]);
                let texcoords = view.texcoords.get(range.clone()).unwrap_or_default().to_vec();
                all.push((id, size, view.corners[range.clone()].to_vec(), texcoords, material));
                (id, corner) = (id + triangles_of(size), range.end);
            }
        }
        all
    }

    #[test]
    fn blocks_keep_ids_sizes_materials_and_attributes() {
        let gap = FaceBatch::GAP | 5;
        let batches = [
            FaceBatch { corners: (0..9).collect(), ..Default::default() },
            FaceBatch {
                sizes: vec![4, gap, 3],
                corners: (10..17).collect(),
                texcoords: (20..27).collect(),
                materials: vec![(0, 2), (2, 1)],
                ..Default::default()
            },
            FaceBatch { corners: (30..42).collect(), materials: vec![(0, 1), (3, 7)], ..Default::default() },
        ];
        let mut expected = vec![];
        for limit in [1000, 3, 4, 7] {
            let mut faces = faces(limit);
            batches.iter().for_each(|batch| faces.append(batch).unwrap());
            let mut all = read_all(&mut faces);
            all.iter_mut().for_each(|face| face.3.retain(|&t| t != NO_INDEX));
            assert_eq!(faces.triangles(), 3 + 2 + 5 + 1 + 4);
            assert!(faces.has_materials && faces.has_texcoords && !faces.has_normals);
            assert_eq!(all[3], (3, 4, vec![10, 11, 12, 13], vec![20, 21, 22, 23], 2));
            assert_eq!(all[4], (5, gap, vec![], vec![], 2));
            assert_eq!(all[5], (10, 3, vec![14, 15, 16], vec![24, 25, 26], 1));
            assert_eq!(all.iter().map(|face| face.4).collect::<Vec<_>>(), [0, 0, 0, 2, 2, 1, 1, 1, 1, 7]);
            if expected.is_empty() {
                expected = all.clone();
            }
            assert_eq!(all, expected);
        }
    }

    #[test]
    fn arrays_that_do_not_fit_are_refused() {
        assert!(faces(9).append(&FaceBatch { corners: vec![1, 2], ..Default::default() }).is_err());
        let sizes = vec![4];
        assert!(faces(9).append(&FaceBatch { sizes, corners: vec![1, 2, 3], ..Default::default() }).is_err());
        let normals = vec![1];
        assert!(faces(9).append(&FaceBatch { corners: vec![1, 2, 3], normals, ..Default::default() }).is_err());
    }
}
