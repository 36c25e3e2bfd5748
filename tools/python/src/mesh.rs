//! A mesh that is in arrays, as a source for the builder.

use numpy::ndarray::{ArrayView2, Axis};
use octrace::mesh::{FaceBatch, MeshSink, SourceInfo, TriangleSource};
use octrace::{Error, Monitor, Result};

/// Rows that are sent at a time.
const BATCH: usize = 1 << 16;

/// Vertices and triangles in arrays.
pub struct Arrays<'a> {
    /// Positions, (n, 3).
    pub vertices: ArrayView2<'a, f32>,
    /// Corners, (m, 3), from 0 on.
    pub faces: ArrayView2<'a, i64>,
}

impl TriangleSource for Arrays<'_> {
    fn read(&mut self, sink: &mut dyn MeshSink, monitor: Monitor<'_>) -> Result<SourceInfo> {
        let rows = (self.vertices.nrows() + self.faces.nrows()) as u64;
        let mut done = 0;
        let mut tell = |more: usize| {
            done += more as u64;
            monitor.progress(done, Some(rows), "rows");
            monitor.check()
        };
        for some in self.vertices.axis_chunks_iter(Axis(0), BATCH) {
            let positions: Vec<[f32; 3]> = some.rows().into_iter().map(|row| [row[0], row[1], row[2]]).collect();
            sink.positions(&positions)?;
            tell(positions.len())?;
        }
        for some in self.faces.axis_chunks_iter(Axis(0), BATCH) {
            let corners = some.rows().into_iter().flatten().map(|&corner| self.corner(corner));
            let corners: Vec<u32> = corners.collect::<Result<_>>()?;
            let materials = vec![(0, 0)];
            sink.faces(&FaceBatch { corners, materials, ..FaceBatch::default() })?;
            tell(some.nrows())?;
        }
        Ok(SourceInfo::default())
    }

    fn size_hint(&self) -> Option<u64> {
        None
    }
}

impl Arrays<'_> {
    /// A corner that there is.
    fn corner(&self, corner: i64) -> Result<u32> {
        match u32::try_from(corner) {
            Ok(known) if (known as usize) < self.vertices.nrows() => Ok(known),
            _ => Err(Error::Option(format!("a face names vertex {corner} of {}", self.vertices.nrows()))),
        }
    }
}
