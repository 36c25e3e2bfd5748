//! The first phase: the source is read once; vertex data goes to tables, faces to blocks.

use glam::Vec3;

use crate::error::{Error, Result};
use crate::event::Monitor;
use crate::format::SplitMode;
use crate::geometry::Aabb;
use crate::mesh::{FaceBatch, MeshSink, SourceInfo, TriangleSource};

use super::faces::Faces;
use super::options::{BuildOptions, Tuning};
use super::record::Layout;
use super::room::Growth;
use super::scanned::SPOOLS;
use super::spool::Spool;
use super::table::{Kind, Table};
use super::work::WorkFolder;

/// All that the source sent.
pub(super) struct Scan<'a> {
    pub positions: Table<'a, 3>,
    pub texcoords: Table<'a, 2>,
    pub normals: Table<'a, 3>,
    pub faces: Faces<'a>,
    pub info: SourceInfo,
    /// Of all vertices that are finite, used or not.
    pub bounds: Aabb,
    /// The index of the faces, if what was found is noted.
    pub index: Option<Spool<'a>>,
}

impl<'a> Scan<'a> {
    /// What the records of its triangles hold.
    pub fn layout(&self) -> Layout {
        Layout {
            materials: self.faces.has_materials && !self.info.materials.is_empty(),
            normals: self.faces.has_normals,
            texcoords: self.faces.has_texcoords,
            parts: false,
        }
    }

    /// The tables.
    pub fn tables(&mut self) -> [&mut Spool<'a>; 3] {
        [&mut self.positions.spool, &mut self.texcoords.spool, &mut self.normals.spool]
    }

    /// Whether some of the vertex data is in a file.
    pub fn is_spilled(&self) -> bool {
        [&self.positions.spool, &self.texcoords.spool, &self.normals.spool].iter().any(|spool| spool.memory().is_none())
    }

    /// Whether triangles will have to be sorted into chunks, so that it pays to count them while they are joined.
    pub fn counts_ahead(&self, options: &BuildOptions, tuning: &Tuning) -> bool {
        let (layout, triangles) = (self.layout(), self.faces.triangles());
        let chunk = tuning.chunk(layout).max(options.brick_limit(triangles, layout).into());
        options.split != SplitMode::Strict && !self.bounds.is_empty() && triangles > chunk
    }
}

/// Reads the whole source. `growth`: asks for room while it grows.
pub(super) fn scan<'a>(
    source: &mut dyn TriangleSource,
    work: &'a WorkFolder,
    tuning: &Tuning,
    growth: Option<Growth>,
    monitor: Monitor<'_>,
) -> Result<Scan<'a>> {
    let share = tuning.table_words;
    let scan = Scan {
        positions: Table::new(Spool::new(work, SPOOLS[0], share).summed(), Kind::Position),
        texcoords: Table::new(Spool::new(work, SPOOLS[1], share).summed(), Kind::Texcoord),
        normals: Table::new(Spool::new(work, SPOOLS[2], share).summed(), Kind::Normal),
        faces: Faces::new(Spool::new(work, SPOOLS[3], tuning.face_words).summed(), tuning.block_corners),
        info: SourceInfo::default(),
        bounds: Aabb::EMPTY,
        index: None,
    };
    let mut sink = Sink { scan, share, growth, monitor };
    let info = source.read(&mut sink, monitor)?;
    let mut scan = sink.scan;
    scan.faces.flush()?;
    scan.info = info;
    Ok(scan)
}

struct Sink<'a, 'm> {
    scan: Scan<'a>,
    /// Words of all tables in memory together.
    share: usize,
    growth: Option<Growth>,
    monitor: Monitor<'m>,
}

impl Sink<'_, '_> {
    /// Moves tables to files, the largest first, until the others fit their share of memory.
    fn make_room(&mut self) -> Result<()> {
        loop {
            let spools = self.scan.tables();
            let held = spools.each_ref().map(|spool| spool.memory().map_or(0, <[u32]>::len));
            if held.iter().sum::<usize>() <= self.share {
                return Ok(());
            }
            if let Some((_, largest)) = held.iter().zip(spools).max_by_key(|(held, _)| **held) {
                largest.spill()?;
            }
        }
    }
}

impl MeshSink for Sink<'_, '_> {
    fn positions(&mut self, positions: &[[f32; 3]]) -> Result<()> {
        let finite = positions.iter().map(|&p| Vec3::from(p)).filter(|p| p.is_finite());
        self.scan.bounds = self.scan.bounds.union(Aabb::around(finite));
        append(&mut self.scan.positions, positions, self.monitor, "vertices")?;
        self.make_room()
    }

    fn texcoords(&mut self, texcoords: &[[f32; 2]]) -> Result<()> {
        append(&mut self.scan.texcoords, texcoords, self.monitor, "texture coordinates")?;
        self.make_room()
    }

    fn normals(&mut self, normals: &[[f32; 3]]) -> Result<()> {
        append(&mut self.scan.normals, normals, self.monitor, "normals")?;
        self.make_room()
    }

    fn faces(&mut self, faces: &FaceBatch) -> Result<()> {
        self.monitor.check()?;
        self.scan.faces.append(faces)?;
        let triangles = self.scan.faces.triangles();
        self.growth.as_mut().map_or(Ok(()), |growth| growth.check(triangles, self.monitor))
    }
}

fn append<const N: usize>(to: &mut Table<'_, N>, items: &[[f32; N]], monitor: Monitor<'_>, what: &str) -> Result<()> {
    monitor.check()?;
    // The last number is taken: it means "none".
    if to.len() + items.len() as u64 > u64::from(u32::MAX) {
        return Err(Error::Option(format!(
            "the mesh has more than {} {what}, which is the limit; divide it",
            u32::MAX
        )));
    }
    to.append(items)
}
