//! Streaming reader of PLY, the format of scanners: text or binary of either byte order.
//!
//! Of the element `vertex`, x y z are read, the normal nx ny nz, and texture coordinates s t, u v or texture_u texture_v; of
//! `face`, the list vertex_indices or vertex_index; of `tristrips`, the same list, where -1 ends a strip. Everything else is
//! passed over. Faces may come before the vertices. Floating point numbers are taken bit for bit; double ones have the
//! origin subtracted before they are rounded.
//!
//! Greg Turk, "The PLY Polygon File Format" (1994).

mod body;
mod header;
#[cfg(test)]
mod tests;

use std::sync::atomic::Ordering;

use super::bytes::Bytes;
use super::input::Input;
use super::{MeshSink, ReadOptions, SourceInfo, TriangleSource};
use crate::error::{Error, Result};
use crate::event::Monitor;
use body::Body;
use header::Header;

/// A PLY file that is to be read.
pub(super) struct PlySource {
    input: Input,
    options: ReadOptions,
}

impl PlySource {
    /// The input read with these options.
    pub fn new(input: Input, options: ReadOptions) -> PlySource {
        PlySource { input, options }
    }
}

impl TriangleSource for PlySource {
    fn read(&mut self, sink: &mut dyn MeshSink, monitor: Monitor<'_>) -> Result<SourceInfo> {
        let stream = self.input.start(self.options.window)?;
        let (taken, size) = (stream.taken(), self.input.size());
        let file = self.input.error_path();
        let wrong = |what: String| Error::Input { file: file.clone(), what };
        let block = self.options.block_of(stream.is_packed());
        let mut bytes = Bytes::new(stream, block, monitor);
        let header = Header::read(&mut bytes)?.map_err(wrong)?;
        let progress = || monitor.progress(taken.load(Ordering::Relaxed), size, "bytes");
        let info = Body::new(bytes, &header, self.options, &file, &progress)?.read(sink)?;
        self.input.check_unchanged()?;
        Ok(info)
    }

    fn size_hint(&self) -> Option<u64> {
        self.input.size()
    }

    fn triangles_hint(&self) -> Option<u64> {
        // Half a vertex and a face: 19 bytes, of which half are left when they are packed; of a text 35, and a quarter.
        let (head, packed) = self.input.head(256)?;
        let text = memchr::memmem::find(&head, b"format ascii").is_some();
        let (bytes, ratio) = if text { (35, 4) } else { (19, 2) };
        Some(self.input.size()? * if packed { ratio } else { 1 } / bytes)
    }
}
