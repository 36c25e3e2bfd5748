//! Faces between scan and join: blocks of flat arrays in a spool, with an index of the blocks in memory.
//!
//! Faces may name vertices that come later, so they wait here until the scan is done. A block says by itself which
//! triangle ids and which material its faces have, so that blocks can be joined in any order. Its words are, one array
//! after the other: sizes (unless all faces are triangles), corners, texture coordinate numbers and normal numbers (if
//! any), pairs of face and material number.
//!
//! A face of more than [`CLIP_LIMIT`] corners is cut as a fan whatever its shape, so that is done at once: blocks stay
//! small, however many corners a face has. Such faces are listed, since a bad corner drops all of a face.

use serde::{Deserialize, Serialize};
use xxhash_rust::xxh3::Xxh3;

use crate::error::{Error, Result};
use crate::event::Monitor;
use crate::mesh::{FaceBatch, NO_INDEX};

use super::blocks::{self, Block, LargeFace, LoadedBlock, Touched, corners_of, touched, triangles_of};
use super::polygon::CLIP_LIMIT;
use super::spool::Spool;
use super::table::Kind;

/// Counts that a killed build notes of its faces.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct FaceCounts {
    pub blocks: usize,
    pub large: usize,
    /// Corners of a block, as it was set then.
    pub block_corners: usize,
    corners: u64,
    ids: u64,
    too_few_corners: u64,
    has: [bool; 3],
}

impl FaceCounts {
    pub fn too_few_corners(&self) -> u64 {
        self.too_few_corners
    }
}

/// All faces of a mesh.
pub(super) struct Faces<'a> {
    spool: Spool<'a>,
    blocks: Vec<Block>,
    block_corners: usize,
    pending: FaceBatch,
    pending_faces: u32,
    pending_id: u64,
    material: u32,
    ids: u64,
    corners: u64,
    /// Faces that were cut at once, in the order of their ids.
    pub large: Vec<LargeFace>,
    /// Whether any face has a material.
    pub has_materials: bool,
    /// Whether any corner has a texture coordinate.
    pub has_texcoords: bool,
    /// Whether any corner has a normal.
    pub has_normals: bool,
    /// Faces of one or two corners; readers drop them, so 0 unless one does not.
    pub too_few_corners: u64,
}

impl<'a> Faces<'a> {
    pub fn new(spool: Spool<'a>, block_corners: usize) -> Self {
        Faces {
            spool,
            blocks: Vec::new(),
            block_corners,
            pending: FaceBatch::default(),
            pending_faces: 0,
            pending_id: 0,
            material: 0,
            ids: 0,
            corners: 0,
            large: Vec::new(),
            has_materials: false,
            has_texcoords: false,
            has_normals: false,
            too_few_corners: 0,
        }
    }

    /// The faces that a killed build left, all in `spool`; `None` if `index` does not list them.
    pub fn reopen(spool: Spool<'a>, index: &Spool<'_>, counts: &FaceCounts) -> Option<Self> {
        let (blocks, large) = blocks::read(index, counts.blocks, counts.large)?;
        let [has_materials, has_texcoords, has_normals] = counts.has;
        let FaceCounts { corners, ids, too_few_corners, block_corners, .. } = *counts;
        let new = Faces::new(spool, block_corners);
        Some(Faces { blocks, large, corners, ids, too_few_corners, has_materials, has_texcoords, has_normals, ..new })
    }

    /// Counts to be noted once all blocks are written.
    pub fn counts(&self) -> FaceCounts {
        FaceCounts {
            blocks: self.blocks.len(),
            large: self.large.len(),
            block_corners: self.block_corners,
            corners: self.corners,
            ids: self.ids,
            too_few_corners: self.too_few_corners,
            has: [self.has_materials, self.has_texcoords, self.has_normals],
        }
    }

    /// The checksum of all blocks, of faces that a killed build left; `None` if a block, or a large face, is not as any that is
    /// written. All blocks are read.
    pub fn check(&self, counts: &FaceCounts, monitor: Monitor<'_>) -> Result<Option<u64>> {
        let (mut sum, mut at, mut ids, mut corners) = (Xxh3::new(), 0, 0, 0);
        // Each array of a block has less than twice the corners of one and those of a face.
        let most = 16 * (counts.block_corners + CLIP_LIMIT) as u64;
        for (number, block) in self.blocks.iter().enumerate() {
            monitor.check()?;
            let words: u64 = block.lengths.iter().map(|&length| u64::from(length)).sum();
            let follows = block.at == at && u64::from(block.first_id) == ids;
            if !follows || words > most.min(self.spool.len() - at) {
                return Ok(None);
            }
            let loaded = self.load(number)?;
            sum.update(bytemuck::cast_slice(&loaded.words));
            let Some(triangles) = loaded.check(&block.touched) else { return Ok(None) };
            at += words;
            ids += triangles;
            corners += u64::from(block.lengths[1]);
            if ids > u64::from(u32::MAX) {
                return Ok(None);
            }
        }
        let mut end = 0;
        let large = self.large.iter().all(|face| {
            let follows = u64::from(face.first_id) >= end && face.triangles > 0;
            end = u64::from(face.first_id) + u64::from(face.triangles);
            follows && end <= ids
        });
        let whole = large && at == self.spool.len() && ids == self.ids && corners == self.corners;
        Ok(whole.then(|| sum.digest()))
    }

    /// The checksum of what was written.
    pub fn checksum(&self) -> u64 {
        self.spool.checksum()
    }

    /// Writes where the blocks lie to `spool`.
    pub fn write_index(&self, spool: &mut Spool<'_>) -> Result<()> {
        blocks::write(&self.blocks, &self.large, spool)
    }

    /// Triangles so far, gaps included.
    pub fn triangles(&self) -> u64 {
        self.ids
    }

    pub fn blocks(&self) -> usize {
        self.blocks.len()
    }

    /// Whether the blocks are in a file.
    pub fn is_spilled(&self) -> bool {
        self.spool.memory().is_none()
    }

    /// Words of all blocks.
    pub fn words(&self) -> u64 {
        self.spool.len()
    }

    /// Moves all blocks to a file.
    pub fn spill(&mut self) -> Result<()> {
        self.spool.spill()
    }

    /// Corners of all faces.
    pub fn corners(&self) -> u64 {
        self.corners
    }

    /// The parts of a table that a block's faces touch.
    pub fn touched(&self, block: usize, kind: Kind) -> &Touched {
        &self.blocks[block].touched[kind as usize]
    }

    /// Reads a block back.
    pub fn load(&self, block: usize) -> Result<LoadedBlock> {
        let block = &self.blocks[block];
        let mut words = vec![0; block.lengths.iter().map(|&length| length as usize).sum()];
        self.spool.read(block.at, &mut words)?;
        Ok(LoadedBlock { words, first_id: block.first_id, lengths: block.lengths })
    }

    /// Takes a batch over, block by block.
    pub fn append(&mut self, batch: &FaceBatch) -> Result<()> {
        check(batch)?;
        let faces = if batch.sizes.is_empty() { batch.corners.len() / 3 } else { batch.sizes.len() };
        let (mut face, mut corner) = (0, 0);
        let mut materials = batch.materials.iter().copied().peekable();
        while face < faces {
            let large = batch.sizes.get(face).is_some_and(|&size| corners_of(size) > CLIP_LIMIT);
            let (taken, corners) = match large {
                true => (1, corners_of(batch.sizes[face])),
                false => self.fitting(batch, face, faces),
            };
            let before = self.pending_faces;
            if !large {
                self.extend(batch, face..face + taken, corner..corner + corners);
            }
            while let Some((at, material)) = materials.next_if(|&(at, _)| (at as usize) < face + taken) {
                self.set_material((at as usize).saturating_sub(face) as u32 + before, material);
            }
            if large {
                self.fan(batch, corner..corner + corners)?;
            }
            (face, corner) = (face + taken, corner + corners);
            self.flush_if_full()?;
        }
        Ok(())
    }

    fn flush_if_full(&mut self) -> Result<()> {
        let full =
            self.pending.corners.len() >= self.block_corners || self.pending_faces as usize >= self.block_corners;
        if full { self.flush() } else { Ok(()) }
    }

    /// Takes a large face over as a fan of triangles.
    fn fan(&mut self, batch: &FaceBatch, corners: std::ops::Range<usize>) -> Result<()> {
        let triangles = corners.len() as u32 - 2;
        if self.ids + u64::from(triangles) <= u64::from(u32::MAX) {
            self.large.push(LargeFace { first_id: self.ids as u32, triangles });
        }
        let piece = (self.block_corners / 3).max(1);
        for first in (1..corners.len() - 1).step_by(piece) {
            let fan = |array: &[u32]| -> Vec<u32> {
                let Some(array) = array.get(corners.clone()) else { return Vec::new() };
                let end = (first + piece).min(array.len() - 1);
                (first..end).flat_map(|i| [array[0], array[i], array[i + 1]]).collect()
            };
            let part = FaceBatch {
                corners: fan(&batch.corners),
                texcoords: fan(&batch.texcoords),
                normals: fan(&batch.normals),
                ..Default::default()
            };
            self.extend(&part, 0..part.corners.len() / 3, 0..part.corners.len());
            self.flush_if_full()?;
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
            if corners >= room || corners_of(size) > CLIP_LIMIT {
                break;
            }
            corners += corners_of(size);
            taken += 1;
        }
        (taken, corners)
    }

    fn extend(&mut self, batch: &FaceBatch, faces: std::ops::Range<usize>, corners: std::ops::Range<usize>) {
        let before = self.pending.corners.len();
        self.corners += corners.len() as u64;
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
            return Err(Error::Option(format!(
                "the mesh has more than {} triangles, which is the limit; divide it",
                u32::MAX
            )));
        }
        if self.pending_faces == 0 {
            return Ok(());
        }
        let mut pending = std::mem::take(&mut self.pending);
        let materials: Vec<u32> = pending.materials.drain(..).flat_map(|(face, material)| [face, material]).collect();
        let arrays = [&pending.sizes, &pending.corners, &pending.texcoords, &pending.normals, &materials];
        self.blocks.push(Block {
            at: self.spool.len(),
            first_id: self.pending_id as u32,
            lengths: arrays.map(|array| array.len() as u32),
            touched: [&pending.corners, &pending.texcoords, &pending.normals].map(|numbers| touched(numbers)),
        });
        for array in arrays {
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
mod tests;
