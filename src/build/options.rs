//! What a caller can choose, and the limits that only tests move.

use std::path::{Path, PathBuf};

use crate::error::{Error, Result};
use crate::format::{LEAF_MAX, SplitMode};
use crate::geometry::morton;

/// How to build. `Default` is what `octbuild` does without flags.
#[derive(Clone, Debug, PartialEq)]
pub struct BuildOptions {
    /// How cells are split.
    pub split: SplitMode,
    /// Most triangles in a page, at least 1; `None`: one page up to 2^18 triangles, beyond that 16384.
    pub brick: Option<u32>,
    /// Most triangles in a leaf record, 1 to 16.
    pub leaf: u8,
    /// Most triangles in a cell of the octree and strict modes before it is refined, at least 1; `u32::MAX` = all.
    pub cell: u32,
    /// Deepest octree level, 0 to 21; the root is level 0.
    pub depth: u8,
    /// Whether face ids are stored. Without them no triangle can be stored twice, so large ones are not cut by spatial splits.
    pub ids: bool,
    /// The origin that the source subtracts from its coordinates, recorded in the header.
    pub origin: [f64; 3],
    /// Folder for temporary files; `None`: the output's.
    pub temp: Option<PathBuf>,
    /// The mesh's name in messages; `None`: "the mesh".
    pub name: Option<PathBuf>,
}

impl Default for BuildOptions {
    fn default() -> Self {
        BuildOptions {
            split: SplitMode::Sah,
            brick: None,
            leaf: LEAF_MAX as u8,
            cell: 16,
            depth: morton::BITS as u8,
            ids: true,
            origin: [0.0; 3],
            temp: None,
            name: None,
        }
    }
}

/// Most triangles of a file of one brick, when the builder chooses.
const ONE_BRICK: u64 = 1 << 18;
/// Most triangles of a brick of a larger file, when the builder chooses.
const MANY_BRICKS: u32 = 16_384;

impl BuildOptions {
    /// [`Error::Option`] for a value out of its range.
    pub(super) fn validate(&self) -> Result<()> {
        let wrong = |what: String| Err(Error::Option(what));
        if !(1..=LEAF_MAX as u8).contains(&self.leaf) {
            return wrong(format!("leaf limit {} is not in 1..{LEAF_MAX}", self.leaf));
        }
        if u32::from(self.depth) > morton::BITS {
            return wrong(format!("depth limit {} is not in 0..{}", self.depth, morton::BITS));
        }
        if self.cell == 0 || self.brick == Some(0) {
            return wrong("cell and brick limits are at least 1".into());
        }
        if !self.ids && self.split == SplitMode::Strict {
            return wrong(
                "a strict octree stores triangles several times and needs their ids: drop --no-ids, or use --split sah"
                    .into(),
            );
        }
        if !self.origin.iter().all(|x| x.is_finite()) {
            return wrong("the origin is not finite".into());
        }
        Ok(())
    }

    /// Most triangles of a brick in a mesh of `triangles`.
    pub(super) fn brick_limit(&self, triangles: u64) -> u32 {
        self.brick.unwrap_or(if triangles <= ONE_BRICK { ONE_BRICK as u32 } else { MANY_BRICKS })
    }

    /// The folder for temporary files of a build that writes `output`.
    pub(super) fn temp_folder(&self, output: &Path) -> PathBuf {
        let beside = || match output.parent() {
            Some(folder) if !folder.as_os_str().is_empty() => folder.to_owned(),
            _ => PathBuf::from("."),
        };
        self.temp.clone().unwrap_or_else(beside)
    }

    /// The mesh's name in messages.
    pub(super) fn source_name(&self) -> PathBuf {
        self.name.clone().unwrap_or_else(|| "the mesh".into())
    }
}

/// Sizes that change memory and traffic, but never the file's bytes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Tuning {
    /// Corners of a block of faces, the unit of work of the join.
    pub block_corners: usize,
    /// Words of the face spool kept in memory.
    pub face_words: usize,
    /// Words of a record spool kept in memory.
    pub record_words: usize,
    /// Triangles of a chunk (never less than the brick limit).
    pub chunk: u64,
    /// Levels of the counting grid.
    pub grid_levels: u32,
    /// Words of write buffers over all chunks while distributing.
    pub buffer_words: usize,
}

impl Default for Tuning {
    fn default() -> Self {
        Tuning {
            block_corners: 1 << 18,
            face_words: 16 << 20,
            record_words: 64 << 20,
            chunk: 4 << 20,
            grid_levels: 7,
            buffer_words: 16 << 20,
        }
    }
}
