//! What a caller can choose, and the limits that only tests move.

use std::path::{Path, PathBuf};

use crate::error::{Error, Result, folder_of};
use crate::format::{LEAF_MAX, SplitMode};
use crate::geometry::morton;

use super::record::Layout;
use super::snap::Positions;

/// How to build. `Default` is what `octbuild` does without flags.
#[derive(Clone, Debug, PartialEq)]
pub struct BuildOptions {
    /// How cells are split.
    pub split: SplitMode,
    /// Most triangles in a page, at least 1; `None`: one page for up to some 125 thousand triangles (half of that with
    /// attributes), beyond that 16384.
    pub brick: Option<u32>,
    /// Most triangles in a leaf record, 1 to 16.
    pub leaf: u8,
    /// Most triangles in a cell of the octree and strict modes before it is refined, at least 1; `u32::MAX` = all.
    pub cell: u32,
    /// Deepest octree level, 0 to 21; the root is level 0.
    pub depth: u8,
    /// Whether face ids are stored. Without them no triangle can be stored twice, so large ones are not cut by spatial splits, nor before the mesh is divided into pages.
    pub ids: bool,
    /// Whether nodes get surrogates, for level of detail: 0.3 to 0.6 bytes a triangle of a scan.
    pub lod: bool,
    /// Whether positions are stored as they are or moved to a grid, where they take fewer bytes.
    pub positions: Positions,
    /// Level, 1 to 22, at which pages are packed with zstd; `None`: they are not, so that they can be used where they lie.
    pub compress: Option<i32>,
    /// The origin that the source subtracts from its coordinates, recorded in the header.
    pub origin: [f64; 3],
    /// Bound on the resident memory of the process, in bytes, at least [`BuildOptions::LEAST_MEMORY`].
    pub memory: u64,
    /// Which source this is, as text that no other has (see [`crate::mesh::identity`]): then a build that is killed can be
    /// taken up again.
    pub source: Option<String>,
    /// Whether to take up what a killed build of the same source, with the same options, has left. Without that it is
    /// removed.
    pub resume: bool,
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
            lod: true,
            positions: Positions::Exact,
            compress: None,
            origin: [0.0; 3],
            memory: 1 << 30,
            source: None,
            resume: false,
            temp: None,
            name: None,
        }
    }
}

/// Bytes that building a file of one brick may take, when the builder chooses: what the least memory has room for.
const ONE_BRICK: u64 = 32 << 20;
/// Most triangles of a brick of a larger file, when the builder chooses.
const MANY_BRICKS: u32 = 16_384;

impl BuildOptions {
    /// The least memory that a build can be bound to: 64 MiB.
    pub const LEAST_MEMORY: u64 = 64 << 20;

    /// The part of the memory that a source may use: give it to [`crate::mesh::ReadOptions::within`].
    pub fn reading_memory(&self) -> u64 {
        working_memory(self.memory) / 4
    }

    /// The part of the memory that materials may take: give it to [`crate::mesh::ReadOptions::material_memory`].
    pub fn material_memory(&self) -> u64 {
        working_memory(self.memory) / 4
    }

    /// [`Error::Option`] for a value out of its range.
    pub(super) fn validate(&self) -> Result<()> {
        let wrong = |what: String| Err(Error::Option(what));
        if !(1..=LEAF_MAX as u8).contains(&self.leaf) {
            return wrong(format!("leaf limit {}: it is from 1 to {LEAF_MAX}", self.leaf));
        }
        if u32::from(self.depth) > morton::BITS {
            return wrong(format!("depth limit {}: it is from 0 to {}", self.depth, morton::BITS));
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
        if self.compress.is_some_and(|level| !(1..=22).contains(&level)) {
            return wrong("zstd has levels 1 to 22".into());
        }
        if let Positions::Grid(Some(step)) = self.positions
            && !(step > 0.0 && step.is_finite())
        {
            return wrong("the step of the grid is not a positive number".into());
        }
        if self.memory < Self::LEAST_MEMORY {
            return wrong(format!("{} bytes of memory are too few; allow at least 64 MiB (--memory 64M)", self.memory));
        }
        if !self.origin.iter().all(|x| x.is_finite()) {
            return wrong("the origin is not finite".into());
        }
        Ok(())
    }

    /// Most triangles of a brick in a mesh of `triangles`.
    pub(super) fn brick_limit(&self, triangles: u64, layout: Layout) -> u32 {
        // The same for all ways to split, so that they can be compared.
        let one = ONE_BRICK / alone_bytes(layout, SplitMode::Sah);
        self.brick.unwrap_or(if triangles <= one { one as u32 } else { MANY_BRICKS })
    }

    /// The folder for temporary files of a build that writes `output`.
    pub(super) fn temp_folder(&self, output: &Path) -> PathBuf {
        self.temp.clone().unwrap_or_else(|| folder_of(output).to_owned())
    }

    /// The mesh's name in messages.
    pub(super) fn source_name(&self) -> PathBuf {
        self.name.clone().unwrap_or_else(|| "the mesh".into())
    }
}

/// Memory that is left for a build's own data: without the program, its stacks, and what the allocator wastes.
fn working_memory(memory: u64) -> u64 {
    memory.saturating_sub(super::phases::resident() + (8 << 20)).max(40 << 20)
}

/// Bytes held of each page until the end, its share of the top tree included.
const PAGE_BYTES: u64 = 400;

/// Sizes that change memory and traffic, but never the file's bytes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Tuning {
    /// Corners of a block of faces, the unit of work of the join.
    pub block_corners: usize,
    /// Words of vertex data kept in memory.
    pub table_words: usize,
    /// Words of memory for reading vertex data that is not.
    pub window_words: usize,
    /// Words of the face spool kept in memory.
    pub face_words: usize,
    /// Words of the record spool kept in memory.
    pub record_words: usize,
    /// Records that are read at a time while sorting.
    pub piece: u64,
    /// Bytes of a chunk, with all that is needed to cut it into bricks.
    pub chunk_bytes: u64,
    /// Bytes for bricks that are built at the same time.
    pub wave_bytes: u64,
    /// Levels of the counting grid.
    pub grid_levels: u32,
    /// Words of write buffers over all chunks while distributing.
    pub buffer_words: usize,
    /// Extents of all chunks together, about: 16 bytes each until the pages are written.
    pub extents: u64,
    /// Most materials that are noted for a build to be taken up; they are held twice then.
    pub noted_materials: usize,
    /// Bytes of what is held of each page until the end.
    pub top_bytes: u64,
}

impl Tuning {
    /// Sizes so small that nearly all of even a small mesh goes to files, and chunks are divided again and again.
    pub const TINY: Tuning = Tuning {
        block_corners: 50,
        table_words: 0,
        window_words: 1 << 17,
        face_words: 100,
        record_words: 200,
        piece: 100,
        chunk_bytes: 60 * 68,
        wave_bytes: 32 << 20,
        grid_levels: 2,
        buffer_words: 300,
        extents: 1 << 20,
        noted_materials: 1 << 16,
        top_bytes: 4 << 20,
    };

    /// The sizes for `memory` bytes in all.
    ///
    /// Of what there is for the build itself (w), the source's reader takes w/4 while scanning, and materials as much; an
    /// allocator need not give that back, so all else keeps to 3 w/4 at any time, to w/2 while scanning. Tables, faces and records that outgrow their share go to files.
    pub fn within(memory: u64, threads: usize) -> Tuning {
        let w = working_memory(memory);
        let words = |bytes: u64| (bytes / 4) as usize;
        Tuning {
            block_corners: (w as usize / 8 / (2 * threads) / 64).clamp(1 << 10, 1 << 17),
            table_words: words(w / 16 * 5),
            window_words: words(w / 4),
            face_words: words(w / 8),
            record_words: words(w / 5),
            piece: (w / 64 / 104).clamp(1 << 12, 1 << 17),
            chunk_bytes: w / 8 * 3,
            wave_bytes: w / 4,
            grid_levels: if w >= 256 << 20 { 7 } else { 6 },
            buffer_words: words(w / 8),
            extents: w / 32 / 16,
            noted_materials: (w as usize >> 12).min(1 << 16),
            top_bytes: w / 8,
        }
    }

    /// Blocks of faces that are joined at a time.
    pub fn wave_blocks(&self) -> usize {
        2 * rayon::current_num_threads()
    }

    /// The finest level of the first counting grid.
    pub fn first_grid(&self, options: &BuildOptions) -> u32 {
        self.grid_levels.min(options.depth.into())
    }

    /// Most triangles of a chunk.
    pub fn chunk(&self, layout: Layout) -> u64 {
        // A record, its Morton code, and its place in lists that are being split.
        self.chunk_bytes / (4 * layout.words() as u64 + 28)
    }

    /// Bytes for a chunk and a brick that is built alone.
    pub fn alone_bytes(&self) -> u64 {
        self.chunk_bytes + self.wave_bytes + self.wave_bytes / 2
    }

    /// Whether the index of faces that a killed build left fits, so many words of it: it is held, in twice as many bytes and some, where
    /// a source's reader would take its share.
    pub fn holds_index(&self, words: u64) -> bool {
        words.saturating_mul(10) <= 2 * self.top_bytes
    }

    /// Fails if the directory of so many pages does not fit.
    pub fn check_pages(&self, pages: u64) -> Result<()> {
        if pages.saturating_mul(PAGE_BYTES) <= self.top_bytes {
            return Ok(());
        }
        Err(Error::Option(format!(
            "the directory of more than {} pages does not fit in the memory allowed; allow more, or take larger pages \
             (--brick)",
            self.top_bytes / PAGE_BYTES
        )))
    }

    /// Most triangles of bricks that are built at the same time.
    pub fn wave(&self, layout: Layout) -> u64 {
        self.wave_bytes / brick_bytes(layout)
    }
}

/// Bytes a triangle of a brick takes that is built alone, from its record on.
pub(super) fn alone_bytes(layout: Layout, split: SplitMode) -> u64 {
    // Strict bricks hold a triangle several times.
    let repeats = if split == SplitMode::Strict { 6 } else { 1 };
    brick_bytes(layout) * repeats + 4 * layout.words() as u64 + 28
}

/// Bytes a triangle of a brick takes while the brick is built: its copy, the tree (see [`super::subtree`]), the page.
pub(super) fn brick_bytes(layout: Layout) -> u64 {
    200 + 10 * (layout.words() as u64 - 10)
}
