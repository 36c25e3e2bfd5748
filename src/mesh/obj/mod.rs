//! Streaming reader of Wavefront OBJ.
//!
//! A thread reads (and decompresses) the input in large blocks cut at line ends ([`block`]); the rayon pool parses
//! several at a time, each by itself ([`parse`]); the calling thread takes the results in file order, adds what came
//! before (counts for negative indices, line numbers, the current material) and sends them on. The number of blocks in
//! the air is bounded, so memory is too, whatever the size of the file.
//!
//! Not read: curves and surfaces, points and lines, groups and smoothing groups; these are passed over in silence, like
//! every unknown keyword.

mod block;
mod forward;
mod line;
mod number;
mod parse;
mod pipeline;
mod place;
mod sequel;

#[cfg(test)]
mod tests;

use std::sync::atomic::Ordering;

pub(super) use number::{parse_f32, parse_f64};

use super::input::Input;
use super::{MeshSink, ReadOptions, SourceInfo, TriangleSource, mtl};
use crate::error::Result;
use crate::event::Monitor;
use block::Blocks;
use sequel::Sequel;

/// An input of so many bytes was written by a program.
const WRITTEN: u64 = 1 << 20;

/// An OBJ file, or standard input, that is to be read.
pub(super) struct ObjSource {
    input: Input,
    options: ReadOptions,
}

impl ObjSource {
    /// The input read with these options.
    pub fn new(input: Input, options: ReadOptions) -> ObjSource {
        ObjSource { input, options }
    }
}

impl TriangleSource for ObjSource {
    fn read(&mut self, sink: &mut dyn MeshSink, monitor: Monitor<'_>) -> Result<SourceInfo> {
        let stream = self.input.start(self.options.window)?;
        let (taken, size) = (stream.taken(), self.input.size());
        let block = self.options.block_of(stream.is_packed());
        let mut sequel = Sequel::new(&self.input, self.options);
        let blocks = Blocks::new(stream, block, self.options.longest_line);
        let cut = blocks.cut();
        pipeline::run(blocks, self.options.origin, monitor, &mut |text, parsed| {
            sequel.take(text, parsed, sink, monitor)?;
            monitor.progress(taken.load(Ordering::Relaxed), size, "bytes");
            Ok(())
        })?;
        let end = sequel.finish(monitor);
        self.input.check_unchanged()?;
        // What is written by hand often ends so; what a program wrote does not.
        if cut.load(Ordering::Relaxed) && (end.too_few > 0 || taken.load(Ordering::Relaxed) >= WRITTEN) {
            let name = self.input.name();
            monitor.warn(format!("{name}: its last line has no end; if the file was cut short, fetch it again"));
        }
        end.forward.check(&mut self.input, &self.options, end.counts)?;
        let count = end.materials.len();
        let (folder, memory) = (self.input.folder(), self.options.material_memory);
        let name = self.input.name().to_string();
        let materials = mtl::resolve((&name, &folder), &end.libraries, end.materials, memory, monitor)
            .ok_or_else(|| sequel::too_many_materials(self.input.error_path(), count))?;
        let files = mtl::library_files(&folder, &end.libraries);
        Ok(SourceInfo { materials, too_few_corners: end.too_few, bad_index: end.bad, files })
    }

    fn size_hint(&self) -> Option<u64> {
        self.input.size()
    }

    fn triangles_hint(&self) -> Option<u64> {
        // Texts pack to a quarter, about.
        let (_, packed) = self.input.head(4)?;
        Some(self.input.size()? * if packed { 4 } else { 1 } / 40)
    }
}
