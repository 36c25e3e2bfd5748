//! The first phase: the source is read once; vertex data goes to memory, faces to a spool.

use crate::error::{Error, Result};
use crate::event::Monitor;
use crate::mesh::{FaceBatch, MeshSink, SourceInfo, TriangleSource};

use super::blocks::Blocks;
use super::faces::Faces;

/// All that the source sent.
pub(super) struct Scan {
    pub positions: Blocks<[f32; 3]>,
    pub texcoords: Blocks<[f32; 2]>,
    pub normals: Blocks<[f32; 3]>,
    pub faces: Faces,
    pub info: SourceInfo,
}

/// Reads the whole source; `faces` is where faces go.
pub(super) fn scan(source: &mut dyn TriangleSource, faces: Faces, monitor: Monitor<'_>) -> Result<Scan> {
    let mut sink = Sink {
        scan: Scan {
            positions: Blocks::new(),
            texcoords: Blocks::new(),
            normals: Blocks::new(),
            faces,
            info: SourceInfo::default(),
        },
        monitor,
    };
    let info = source.read(&mut sink, monitor)?;
    let mut scan = sink.scan;
    scan.faces.flush()?;
    scan.info = info;
    Ok(scan)
}

struct Sink<'a> {
    scan: Scan,
    monitor: Monitor<'a>,
}

impl MeshSink for Sink<'_> {
    fn positions(&mut self, positions: &[[f32; 3]]) -> Result<()> {
        append(&mut self.scan.positions, positions, self.monitor, "vertices")
    }

    fn texcoords(&mut self, texcoords: &[[f32; 2]]) -> Result<()> {
        append(&mut self.scan.texcoords, texcoords, self.monitor, "texture coordinates")
    }

    fn normals(&mut self, normals: &[[f32; 3]]) -> Result<()> {
        append(&mut self.scan.normals, normals, self.monitor, "normals")
    }

    fn faces(&mut self, faces: &FaceBatch) -> Result<()> {
        self.monitor.check()?;
        self.scan.faces.append(faces)
    }
}

fn append<T: Copy>(to: &mut Blocks<T>, items: &[T], monitor: Monitor<'_>, what: &str) -> Result<()> {
    monitor.check()?;
    // The last number is taken: it means "none".
    if to.len() + items.len() > u32::MAX as usize {
        return Err(Error::Option(format!("the mesh has more than {} {what}, which is the limit", u32::MAX)));
    }
    to.extend(items);
    Ok(())
}
