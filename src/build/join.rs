//! The second phase: faces get their positions, are cut into triangles, and what no ray can hit is dropped.
//!
//! Blocks of faces are joined in parallel, a wave at a time, and written in order. Dropped triangles use up their ids, so
//! that ids agree with any other program's. A face with an index out of range is dropped as a whole, then one with a vertex
//! that is not finite; of the others, the triangles of exactly zero area.

use std::path::Path;
use std::sync::atomic::{AtomicU32, Ordering};

use rayon::prelude::*;

use crate::error::Result;
use crate::event::Monitor;
use crate::exact::exactly_degenerate;
use crate::format::Dropped;
use crate::geometry::Aabb;
use crate::mesh::{FaceBatch, NO_INDEX};

use super::faces::{FaceView, corners_of, triangles_of};
use super::options::Tuning;
use super::polygon::{self, Cut};
use super::record::{Layout, Record};
use super::report::Polygons;
use super::scan::Scan;
use super::spool::Spool;

/// Counts and bounds of joined faces; those of blocks add up.
#[derive(Clone, Copy, Debug)]
pub(super) struct Tally {
    pub kept: u64,
    pub dropped: Dropped,
    pub polygons: Polygons,
    /// See [`super::BuildReport::merged`].
    pub merged: u64,
    /// Of the kept triangles.
    pub bounds: Aabb,
    /// Of the vertices of all faces that were not dropped as a whole.
    pub all_bounds: Aabb,
}

impl Tally {
    pub fn new() -> Self {
        let (dropped, polygons) = Default::default();
        Tally { kept: 0, dropped, polygons, merged: 0, bounds: Aabb::EMPTY, all_bounds: Aabb::EMPTY }
    }

    fn add(&mut self, other: &Tally) {
        self.kept += other.kept;
        self.dropped.degenerate += other.dropped.degenerate;
        self.dropped.non_finite += other.dropped.non_finite;
        self.dropped.bad_index += other.dropped.bad_index;
        self.polygons += other.polygons;
        self.merged += other.merged;
        self.bounds = self.bounds.union(other.bounds);
        self.all_bounds = self.all_bounds.union(other.all_bounds);
    }
}

/// The triangles of a mesh.
pub(super) struct Joined {
    pub records: Spool,
    pub layout: Layout,
    pub tally: Tally,
    /// Vertices that kept triangles use.
    pub used_vertices: u64,
}

/// Joins all faces of `scan`; records go to a spool in `folder`.
pub(super) fn join(scan: &mut Scan, folder: &Path, tuning: &Tuning, monitor: Monitor<'_>) -> Result<Joined> {
    let layout = Layout {
        materials: scan.faces.has_materials && !scan.info.materials.is_empty(),
        normals: scan.faces.has_normals,
        texcoords: scan.faces.has_texcoords,
    };
    let used = Bits::new(scan.positions.len());
    let mut records = Spool::new(folder, tuning.record_words);
    let mut tally = Tally::new();
    let (blocks, total) = (scan.faces.blocks(), scan.faces.triangles());
    let wave = 4 * rayon::current_num_threads();
    for first in (0..blocks).step_by(wave) {
        monitor.check()?;
        let loaded = (first..blocks.min(first + wave)).map(|i| scan.faces.load(i)).collect::<Result<Vec<_>>>()?;
        let mesh: &Scan = scan;
        let pieces: Vec<Piece> = loaded
            .into_par_iter()
            .map(|block| {
                let mut piece = Piece::new(mesh, layout, &used);
                piece.join(&block.view());
                piece
            })
            .collect();
        for piece in pieces {
            records.append(&piece.words)?;
            tally.add(&piece.tally);
        }
        let done = tally.kept + tally.dropped.degenerate + tally.dropped.non_finite + tally.dropped.bad_index;
        monitor.progress(done, Some(total), "triangles");
    }
    tally.dropped.too_few_corners = scan.info.too_few_corners + scan.faces.too_few_corners;
    Ok(Joined { records, layout, tally, used_vertices: used.count() })
}

/// A block being joined.
struct Piece<'a> {
    scan: &'a Scan,
    layout: Layout,
    used: &'a Bits,
    words: Vec<u32>,
    tally: Tally,
    /// Of the face at hand.
    points: Vec<[f32; 3]>,
    cuts: Vec<[u32; 3]>,
}

/// A face of a block.
struct Face<'a> {
    id: u32,
    material: u32,
    corners: &'a [u32],
    /// Empty or one a corner.
    texcoords: &'a [u32],
    /// Empty or one a corner.
    normals: &'a [u32],
}

impl<'a> Piece<'a> {
    fn new(scan: &'a Scan, layout: Layout, used: &'a Bits) -> Self {
        let (points, cuts) = Default::default();
        Piece { scan, layout, used, words: Vec::new(), tally: Tally::new(), points, cuts }
    }

    fn join(&mut self, view: &FaceView<'_>) {
        let faces = if view.sizes.is_empty() { view.corners.len() / 3 } else { view.sizes.len() };
        self.words.reserve((view.corners.len() / 3) * self.layout.words());
        let (mut id, mut corner) = (view.first_id, 0);
        let (mut material, mut materials) = (0, view.materials.chunks_exact(2).peekable());
        for number in 0..faces {
            while let Some(change) = materials.next_if(|change| change[0] as usize <= number) {
                material = change[1];
            }
            let size = view.sizes.get(number).copied().unwrap_or(3);
            let range = corner..corner + corners_of(size);
            if size & FaceBatch::GAP != 0 {
                self.tally.dropped.bad_index += u64::from(triangles_of(size));
            } else if size >= 3 {
                self.face(&Face {
                    id,
                    material: if material as usize <= self.scan.info.materials.len() { material } else { 0 },
                    corners: &view.corners[range.clone()],
                    texcoords: view.texcoords.get(range.clone()).unwrap_or_default(),
                    normals: view.normals.get(range.clone()).unwrap_or_default(),
                });
            }
            (id, corner) = (id + triangles_of(size), range.end);
        }
    }

    fn face(&mut self, face: &Face<'_>) {
        let triangles = face.corners.len() as u64 - 2;
        if !self.gather(face) {
            self.tally.dropped.bad_index += triangles;
            return;
        }
        if !self.points.as_flattened().iter().all(|x| x.is_finite()) {
            self.tally.dropped.non_finite += triangles;
            return;
        }
        let around = Aabb::around(self.points.iter().map(|&p| p.into()));
        self.tally.all_bounds = self.tally.all_bounds.union(around);
        if face.corners.len() == 3 {
            return self.triangle(face, face.id, [0, 1, 2]);
        }
        let mut cuts = std::mem::take(&mut self.cuts);
        cuts.clear();
        let how = polygon::cut(&self.points, &mut cuts);
        self.tally.polygons.cut += 1;
        self.tally.polygons.clipped += u64::from(how == Cut::Clipped);
        self.tally.polygons.fanned += u64::from(how == Cut::TooLarge);
        for (id, &cut) in (face.id..).zip(&cuts) {
            self.triangle(face, id, cut.map(|i| i as usize));
        }
        self.cuts = cuts;
    }

    /// Takes the positions of a face's corners; false if any number is out of range.
    fn gather(&mut self, face: &Face<'_>) -> bool {
        let scan = self.scan;
        let within = |numbers: &[u32], len: usize| numbers.iter().all(|&i| i == NO_INDEX || (i as usize) < len);
        self.points.clear();
        self.points.extend(face.corners.iter().map_while(|&i| scan.positions.get(i)));
        self.points.len() == face.corners.len()
            && within(face.texcoords, scan.texcoords.len())
            && within(face.normals, scan.normals.len())
    }

    /// One triangle of a face, by places in the face.
    fn triangle(&mut self, face: &Face<'_>, id: u32, places: [usize; 3]) {
        let corners = places.map(|i| self.points[i]);
        if exactly_degenerate(&corners.into()) {
            self.tally.dropped.degenerate += 1;
            self.tally.merged += u64::from(is_merged(corners, places.map(|i| face.corners[i])));
            return;
        }
        places.iter().for_each(|&i| self.used.set(face.corners[i]));
        let record = Record {
            corners,
            id,
            material: face.material,
            normals: places.map(|i| self.attribute(face.normals, i, |n| self.scan.normals.get(n))),
            texcoords: places.map(|i| self.attribute(face.texcoords, i, |n| self.scan.texcoords.get(n))),
        };
        self.layout.write(&record, &mut self.words);
        self.tally.kept += 1;
        self.tally.bounds = self.tally.bounds.union(Aabb::around(corners.map(Into::into)));
    }

    /// A corner's attribute number, none if it is not there or not finite (nothing can be shaded with that).
    fn attribute<const N: usize>(&self, numbers: &[u32], place: usize, get: impl Fn(u32) -> Option<[f32; N]>) -> u32 {
        let number = numbers.get(place).copied().unwrap_or(NO_INDEX);
        let finite = get(number).is_some_and(|value| value.iter().all(|x| x.is_finite()));
        if finite { number } else { NO_INDEX }
    }
}

/// Whether two different vertices of a triangle lie at one place, bit for bit.
fn is_merged(corners: [[f32; 3]; 3], numbers: [u32; 3]) -> bool {
    [(0, 1), (1, 2), (2, 0)]
        .into_iter()
        .any(|(i, j)| numbers[i] != numbers[j] && corners[i].map(f32::to_bits) == corners[j].map(f32::to_bits))
}

/// A set of numbers that threads fill together.
struct Bits(Vec<AtomicU32>);

impl Bits {
    fn new(len: usize) -> Self {
        Bits(std::iter::repeat_with(AtomicU32::default).take(len.div_ceil(32)).collect())
    }

    fn set(&self, number: u32) {
        let (word, bit) = (&self.0[number as usize / 32], 1 << (number % 32));
        // Most are set already; reading first keeps the cache line shared.
        if word.load(Ordering::Relaxed) & bit == 0 {
            word.fetch_or(bit, Ordering::Relaxed);
        }
    }

    fn count(&self) -> u64 {
        self.0.iter().map(|word| u64::from(word.load(Ordering::Relaxed).count_ones())).sum()
    }
}
