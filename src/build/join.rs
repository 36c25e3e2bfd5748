//! The second phase: faces get their positions, are cut into triangles, and what no ray can hit is dropped.
//!
//! Blocks of faces are joined in parallel, a wave at a time, while the wave before is written, in order. Dropped triangles
//! use up their ids, so that ids agree with any other program's. A face with an index out of range is dropped as a whole,
//! then one with a vertex that is not finite; of the others, the triangles of exactly zero area.
//!
//! A face of very many corners comes as single triangles. That one of its corners is bad may show only when others have
//! been written; then all is joined again with that known. On the way triangles are counted in the grid of the next phase,
//! whose cells are guessed from the bounds of all vertices: nearly always right, else counted again.

use rayon::prelude::*;

use crate::error::Result;
use crate::event::Monitor;
use crate::exact::exactly_degenerate;
use crate::format::Dropped;
use crate::geometry::Aabb;
use crate::mesh::{FaceBatch, NO_INDEX};

use super::blocks::{FaceView, LargeFace, LoadedBlock, corners_of, triangles_of};
use super::grid::{Grid, Placement};
use super::options::Tuning;
use super::polygon::{self, Cut};
use super::record::{Layout, Record};
use super::report::Polygons;
use super::scan::Scan;
use super::sketch::Sketch;
use super::snap::Snap;
use super::spool::Spool;
use super::steps::Steps;
use super::table::View;
use super::work::WorkFolder;

/// Counts and bounds of joined faces; those of blocks add up.
#[derive(Clone, Copy, Debug)]
pub(super) struct Tally {
    pub kept: u64,
    pub dropped: Dropped,
    pub polygons: Polygons,
    /// See [`super::BuildReport::merged`].
    pub merged: u64,
    /// See [`super::BuildReport::largest_shift`].
    pub shift: f64,
    /// The longest side of any kept triangle's box.
    pub longest: f32,
    /// Of the kept triangles.
    pub bounds: Aabb,
    /// Of the vertices of all faces that were not dropped as a whole.
    pub all_bounds: Aabb,
}

impl Tally {
    pub fn new() -> Self {
        let (dropped, polygons) = Default::default();
        let bounds = Aabb::EMPTY;
        Tally { kept: 0, dropped, polygons, merged: 0, shift: 0.0, longest: 0.0, bounds, all_bounds: bounds }
    }

    fn add(&mut self, other: &Tally) {
        self.kept += other.kept;
        self.dropped.degenerate += other.dropped.degenerate;
        self.dropped.non_finite += other.dropped.non_finite;
        self.dropped.bad_index += other.dropped.bad_index;
        self.polygons += other.polygons;
        self.merged += other.merged;
        self.shift = self.shift.max(other.shift);
        self.longest = self.longest.max(other.longest);
        self.bounds = self.bounds.union(other.bounds);
        self.all_bounds = self.all_bounds.union(other.all_bounds);
    }
}

/// The triangles of a mesh.
pub(super) struct Joined<'a> {
    pub records: Spool<'a>,
    pub layout: Layout,
    pub tally: Tally,
    /// Different points that kept triangles have as corners, about.
    pub points: u64,
}

/// What is known of large faces.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
enum Fate {
    /// Nothing bad so far.
    #[default]
    Kept,
    NonFinite,
    BadIndex,
}

/// Joins all faces of `scan`; counts kept triangles in `grid`, if it is given.
pub(super) fn join<'a>(
    scan: &Scan<'_>,
    work: &'a WorkFolder,
    tuning: &Tuning,
    grid: Option<(&mut Grid, Placement)>,
    snap: Option<Snap>,
    monitor: Monitor<'_>,
) -> Result<Joined<'a>> {
    let layout = scan.layout();
    let mut join = Join { scan, layout, fates: vec![Fate::Kept; scan.faces.large.len()], grid, snap };
    loop {
        let records = Spool::new(work, "records", tuning.record_words).summed();
        let mut joined = Joined { records, layout, tally: Tally::new(), points: 0 };
        let fates = join.pass(&mut joined, tuning, monitor)?;
        if fates == join.fates {
            let large = fates.iter().filter(|&&fate| fate == Fate::Kept).count() as u64;
            joined.tally.polygons.cut += large;
            joined.tally.polygons.fanned += large;
            joined.tally.dropped.too_few_corners = scan.info.too_few_corners + scan.faces.too_few_corners;
            return Ok(joined);
        }
        join.fates = fates;
        if let Some((grid, _)) = &mut join.grid {
            grid.clear();
        }
    }
}

struct Join<'a> {
    scan: &'a Scan<'a>,
    layout: Layout,
    /// Of the large faces.
    fates: Vec<Fate>,
    grid: Option<(&'a mut Grid, Placement)>,
    snap: Option<Snap>,
}

impl Join<'_> {
    /// Joins all faces; the fates of the large ones, as far as they showed.
    fn pass(&self, joined: &mut Joined<'_>, tuning: &Tuning, monitor: Monitor<'_>) -> Result<Vec<Fate>> {
        let Scan { positions, texcoords, normals, faces, .. } = self.scan;
        let wave = tuning.wave_blocks();
        // Three tables share what two of them may need at the same time.
        let shares =
            [&positions.spool, &texcoords.spool, &normals.spool].iter().filter(|s| s.memory().is_none()).count();
        let share = tuning.window_words / shares.max(1);
        let ways =
            [positions.way(faces, wave, share), texcoords.way(faces, wave, share), normals.way(faces, wave, share)];
        let mut steps = Steps::new(monitor, faces.triangles(), 1 + ways.iter().map(|way| way.steps()).sum::<u64>());
        let mut positions = positions.reader(ways[0], faces, share, &mut steps)?;
        let mut texcoords = texcoords.reader(ways[1], faces, share, &mut steps)?;
        let mut normals = normals.reader(ways[2], faces, share, &mut steps)?;
        let mut fates = self.fates.clone();
        let mut sketch = Sketch::new();
        let mut waiting: Vec<Piece> = Vec::new();
        for first in (0..faces.blocks()).step_by(wave) {
            let end = faces.blocks().min(first + wave);
            let loaded = (first..end).map(|block| faces.load(block)).collect::<Result<Vec<_>>>()?;
            let views = (
                positions.views(first, &loaded, faces)?,
                texcoords.views(first, &loaded, faces)?,
                normals.views(first, &loaded, faces)?,
            );
            let work = loaded.par_iter().zip(views.0).zip(views.1).zip(views.2);
            let fresh = sketch.fresh();
            let compute = || -> Vec<Piece> {
                let piece = |(((block, positions), texcoords), normals): (((&LoadedBlock, _), _), _)| {
                    Joiner { join: self, positions, texcoords, normals, piece: Piece::new(fresh.clone()) }
                        .run(&block.view())
                };
                work.map(piece).collect()
            };
            let before = std::mem::take(&mut waiting);
            let (pieces, written) = rayon::join(compute, || write(&before, &mut joined.records));
            written?;
            drop(before);
            for piece in &pieces {
                joined.tally.add(&piece.tally);
                sketch.merge(&piece.sketch);
                piece.bad.iter().for_each(|&(large, fate)| fates[large] = fates[large].max(fate));
            }
            waiting = pieces;
            steps.at(end as u64, faces.blocks() as u64)?;
        }
        write(&waiting, &mut joined.records)?;
        joined.points = sketch.estimate();
        Ok(fates)
    }

    /// The large face that a triangle is part of.
    fn large(&self, id: u32) -> Option<usize> {
        let faces = &self.scan.faces.large;
        let after = faces.partition_point(|face| face.first_id <= id);
        let LargeFace { first_id, triangles } = *faces.get(after.checked_sub(1)?)?;
        (id - first_id < triangles).then_some(after - 1)
    }
}

fn write(pieces: &[Piece], records: &mut Spool<'_>) -> Result<()> {
    pieces.iter().try_for_each(|piece| records.append(&piece.words))
}

/// What a block was joined to.
struct Piece {
    words: Vec<u32>,
    tally: Tally,
    sketch: Sketch,
    /// Large faces with something bad in them.
    bad: Vec<(usize, Fate)>,
}

impl Piece {
    fn new(sketch: Sketch) -> Piece {
        Piece { words: Vec::new(), tally: Tally::new(), sketch, bad: Vec::new() }
    }
}

/// A block being joined.
struct Joiner<'a> {
    join: &'a Join<'a>,
    positions: View<'a, 3>,
    texcoords: View<'a, 2>,
    normals: View<'a, 3>,
    piece: Piece,
}

/// A face of a block.
struct Face<'a> {
    id: u32,
    material: u32,
    /// Number of its first corner in the block.
    at: usize,
    corners: &'a [u32],
    /// Empty or one a corner.
    texcoords: &'a [u32],
    /// Empty or one a corner.
    normals: &'a [u32],
}

impl Joiner<'_> {
    fn run(mut self, view: &FaceView<'_>) -> Piece {
        let faces = if view.sizes.is_empty() { view.corners.len() / 3 } else { view.sizes.len() };
        self.piece.words.reserve_exact((view.corners.len() / 3) * self.join.layout.words());
        let (mut id, mut corner) = (view.first_id, 0);
        let (mut material, mut materials) = (0, view.materials.chunks_exact(2).peekable());
        let (mut points, mut cuts) = (Vec::new(), Vec::new());
        let known = self.join.scan.info.materials.len();
        for number in 0..faces {
            while let Some(change) = materials.next_if(|change| change[0] as usize <= number) {
                material = change[1];
            }
            let size = view.sizes.get(number).copied().unwrap_or(3);
            let range = corner..corner + corners_of(size);
            if size & FaceBatch::GAP != 0 {
                self.piece.tally.dropped.bad_index += u64::from(triangles_of(size));
            } else if size >= 3 {
                let face = Face {
                    id,
                    material: if material as usize <= known { material } else { 0 },
                    at: corner,
                    corners: &view.corners[range.clone()],
                    texcoords: view.texcoords.get(range.clone()).unwrap_or_default(),
                    normals: view.normals.get(range.clone()).unwrap_or_default(),
                };
                self.face(&face, &mut points, &mut cuts);
            }
            (id, corner) = (id + triangles_of(size), range.end);
        }
        self.piece
    }

    fn face(&mut self, face: &Face<'_>, points: &mut Vec<[f32; 3]>, cuts: &mut Vec<[u32; 3]>) {
        let triangles = face.corners.len() as u64 - 2;
        let large = self.join.large(face.id);
        let mut fate = self.gather(face, points);
        if let Some(large) = large {
            if fate > self.join.fates[large] {
                self.piece.bad.push((large, fate));
            }
            fate = fate.max(self.join.fates[large]);
        }
        let tally = &mut self.piece.tally;
        match fate {
            Fate::BadIndex => return tally.dropped.bad_index += triangles,
            Fate::NonFinite => return tally.dropped.non_finite += triangles,
            Fate::Kept => {}
        }
        if let Some(snap) = self.join.snap {
            for point in points.iter_mut() {
                let (snapped, shift) = snap.point(*point);
                (*point, tally.shift) = (snapped, tally.shift.max(shift));
            }
        }
        tally.all_bounds = tally.all_bounds.union(Aabb::around(points.iter().map(|&p| p.into())));
        if face.corners.len() == 3 {
            return self.triangle(face, points, face.id, [0, 1, 2]);
        }
        cuts.clear();
        tally.polygons.cut += 1;
        tally.polygons.clipped += u64::from(polygon::cut(points, cuts) == Cut::Clipped);
        for (id, &cut) in (face.id..).zip(cuts.iter()) {
            self.triangle(face, points, id, cut.map(|i| i as usize));
        }
    }

    /// Takes the positions of a face's corners, and says what is wrong with it.
    fn gather(&self, face: &Face<'_>, points: &mut Vec<[f32; 3]>) -> Fate {
        let scan = self.join.scan;
        let within = |numbers: &[u32], len: u64| numbers.iter().all(|&i| i == NO_INDEX || u64::from(i) < len);
        points.clear();
        let whole = face.corners.iter().all(|&i| u64::from(i) < scan.positions.len())
            && within(face.texcoords, scan.texcoords.len())
            && within(face.normals, scan.normals.len());
        if !whole {
            return Fate::BadIndex;
        }
        points.extend((face.at..).zip(face.corners).map(|(corner, &i)| self.positions.get(corner, i)));
        if points.as_flattened().iter().all(|x| x.is_finite()) { Fate::Kept } else { Fate::NonFinite }
    }

    /// One triangle of a face, by places in the face.
    fn triangle(&mut self, face: &Face<'_>, points: &[[f32; 3]], id: u32, places: [usize; 3]) {
        let corners = places.map(|i| points[i]);
        let tally = &mut self.piece.tally;
        if exactly_degenerate(&corners.into()) {
            tally.dropped.degenerate += 1;
            tally.merged += u64::from(is_merged(corners, places.map(|i| face.corners[i])));
            return;
        }
        tally.kept += 1;
        let bounds = Aabb::around(corners.map(Into::into));
        tally.longest = tally.longest.max((bounds.max - bounds.min).max_element());
        tally.bounds = tally.bounds.union(bounds);
        corners.iter().for_each(|&corner| self.piece.sketch.add(corner));
        if let Some((grid, placement)) = &self.join.grid {
            grid.count(&corners.into(), *placement);
        }
        let record = Record {
            corners,
            id,
            material: face.material,
            normals: places.map(|i| attribute(&self.normals, face.normals, face.at, i)),
            texcoords: places.map(|i| attribute(&self.texcoords, face.texcoords, face.at, i)),
        };
        self.join.layout.write(&record, &mut self.piece.words);
    }
}

/// A corner's attribute; NaN if there is none, or it is not finite (nothing can be shaded with that).
fn attribute<const N: usize>(view: &View<'_, N>, numbers: &[u32], at: usize, place: usize) -> [f32; N] {
    const NONE: f32 = f32::from_bits(0x7fc0_0000);
    match numbers.get(place) {
        Some(&number) if number != NO_INDEX => {
            let value = view.get(at + place, number);
            if value.iter().all(|x| x.is_finite()) { value } else { [NONE; N] }
        }
        _ => [NONE; N],
    }
}

/// Whether two different vertices of a triangle lie at one place, bit for bit.
fn is_merged(corners: [[f32; 3]; 3], numbers: [u32; 3]) -> bool {
    [(0, 1), (1, 2), (2, 0)]
        .into_iter()
        .any(|(i, j)| numbers[i] != numbers[j] && corners[i].map(f32::to_bits) == corners[j].map(f32::to_bits))
}
