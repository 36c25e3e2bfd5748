//! The readers of meshes alone, without what is built from what they read: a hundred inputs in the time of one. What a mesh says must
//! not depend on how many pieces it is read in.

use std::path::Path;

use octrace::mesh::{FaceBatch, MeshSink, NO_INDEX, ReadOptions};
use octrace::{Monitor, Result};

/// Longest line and most memory for hostile meshes.
pub fn options(lenient: bool) -> ReadOptions {
    ReadOptions { lenient, block: 64 << 10, longest_line: 1 << 20, material_memory: 1 << 20, ..ReadOptions::default() }
}

/// Reads a mesh strictly and leniently, each in one piece and in three: both must give the same, be it an error.
pub fn check(path: &Path) {
    let bytes = std::fs::metadata(path).unwrap().len() as usize;
    for lenient in [false, true] {
        let whole = options(lenient);
        let pieces = ReadOptions { block: bytes / 3 + 1, ..whole };
        let [whole, pieces] = [whole, pieces].map(|options| read(path, &options).map_err(|error| error.to_string()));
        assert!(whole == pieces, "in one piece {whole:?}, in three {pieces:?}");
    }
}

fn read(path: &Path, options: &ReadOptions) -> Result<Heard> {
    let mut heard = Heard::default();
    let info = octrace::mesh::open(path, options)?.read(&mut heard, Monitor::silent())?;
    heard.counts = [info.too_few_corners, info.bad_index];
    heard.names = info.materials.into_iter().map(|material| material.name).collect();
    let most = heard.names.len() as u32;
    assert!(heard.materials.iter().all(|&material| material <= most), "a material without a name");
    Ok(heard)
}

/// All that a reader says, numbers as their bits.
#[derive(Debug, Default, PartialEq, Eq)]
struct Heard {
    positions: Vec<[u32; 3]>,
    texcoords: Vec<[u32; 2]>,
    normals: Vec<[u32; 3]>,
    /// Of each face, gaps included: corners, material.
    sizes: Vec<u32>,
    materials: Vec<u32>,
    /// Of each corner: vertex, texture coordinate, normal.
    corners: Vec<[u32; 3]>,
    counts: [u64; 2],
    names: Vec<String>,
}

impl MeshSink for Heard {
    fn positions(&mut self, positions: &[[f32; 3]]) -> Result<()> {
        self.positions.extend(positions.iter().map(|p| p.map(f32::to_bits)));
        Ok(())
    }

    fn texcoords(&mut self, texcoords: &[[f32; 2]]) -> Result<()> {
        self.texcoords.extend(texcoords.iter().map(|p| p.map(f32::to_bits)));
        Ok(())
    }

    fn normals(&mut self, normals: &[[f32; 3]]) -> Result<()> {
        self.normals.extend(normals.iter().map(|p| p.map(f32::to_bits)));
        Ok(())
    }

    fn faces(&mut self, batch: &FaceBatch) -> Result<()> {
        let corners = batch.corners.len();
        let sizes = if batch.sizes.is_empty() { vec![3; corners / 3] } else { batch.sizes.clone() };
        let told: usize = sizes.iter().filter(|&&size| size & FaceBatch::GAP == 0).map(|&size| size as usize).sum();
        assert!(told == corners, "{corners} corners of faces that have {told}");
        for numbers in [&batch.texcoords, &batch.normals] {
            assert!(numbers.is_empty() || numbers.len() == corners, "{} of {corners} corners", numbers.len());
        }
        let number = |numbers: &[u32], corner: usize| numbers.get(corner).copied().unwrap_or(NO_INDEX);
        let corner = |i: usize| [batch.corners[i], number(&batch.texcoords, i), number(&batch.normals, i)];
        self.corners.extend((0..corners).map(corner));
        let mut from = batch.materials.iter().peekable();
        let mut material = 0;
        for face in 0..sizes.len() as u32 {
            while let Some(&(_, next)) = from.next_if(|&&(first, _)| first <= face) {
                material = next;
            }
            self.materials.push(material);
        }
        self.sizes.extend(sizes);
        Ok(())
    }
}
