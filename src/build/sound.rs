//! Checks of what a killed build left, before any of it is used.
//!
//! Files may rot, be cut short, be another build's, or lie. Checksums tell all but the last: that of the state covers the checksums of the
//! spools and chunks, and what is noted of pages ([`super::page_log`]) names the state that it belongs to. Whoever makes checksums right
//! again could as well write another file; so what is looked at beside them (that every count agrees, that every record is one that a join
//! makes, and lies in the cells of its chunk) is what else would lead astray: to a panic, into memory without end, or to a file that is
//! not sound.

use rayon::prelude::*;
use xxhash_rust::xxh3::Xxh3;

use super::checkpoint::JoinedState;
use super::distribute::Chunk;
use super::grid::{CellCode, Placement, UnitFinder, places};
use super::options::BuildOptions;
use super::record::Layout;
use super::spool::Spool;
use super::subtree::cell_of;
use super::triangles::Mesh;
use super::work::WorkFolder;
use crate::error::Error;
use crate::event::Monitor;
use crate::exact::exactly_degenerate;
use crate::geometry::{Aabb, morton};

/// Why a build does not go on with what was left.
#[derive(Debug)]
pub(super) enum Unfit {
    /// Nothing was left, or it is of another build.
    Other,
    /// A file is not what the killed build wrote: which, and what shows that.
    Damaged(String),
    /// The user asked to stop.
    Interrupted,
}

impl Unfit {
    /// A file of the work folder whose checksum is wrong.
    pub fn checksum(work: &WorkFolder, name: &str) -> Unfit {
        Unfit::Damaged(format!("{}: not what was written (its checksum is wrong)", work.path().join(name).display()))
    }

    /// A file of the work folder that is missing, or shorter than it was.
    pub fn short(work: &WorkFolder, name: &str) -> Unfit {
        Unfit::Damaged(format!("{}: missing or cut short", work.path().join(name).display()))
    }

    /// A file of the work folder that says what no build writes.
    pub fn lies(work: &WorkFolder, name: &str) -> Unfit {
        Unfit::Damaged(format!("{}: not what a build writes", work.path().join(name).display()))
    }
}

impl From<Error> for Unfit {
    fn from(error: Error) -> Unfit {
        match error {
            Error::Interrupted => Unfit::Interrupted,
            error => Unfit::Damaged(error.to_string()),
        }
    }
}

/// What the join and the sorting left, as the state tells it.
pub(super) struct Told<'a> {
    pub options: &'a BuildOptions,
    pub state: &'a JoinedState,
    pub mesh: &'a Mesh,
    /// Whether records stand for parts of triangles.
    pub parts: bool,
    pub monitor: Monitor<'a>,
}

/// What records are, taken together.
struct Seen {
    bounds: Aabb,
    records: u64,
    /// Records that are not of the same triangle as the one before.
    triangles: u64,
    /// The last one's triangle.
    last: Option<u32>,
}

impl Told<'_> {
    fn layout(&self) -> Layout {
        Layout { parts: self.parts, ..self.mesh.layout }
    }

    fn strict(&self) -> bool {
        self.placement().repeats()
    }

    fn placement(&self) -> Placement {
        Placement { root: self.mesh.root, split: self.options.split }
    }

    /// Whether the state's counts and bounds agree with one another.
    pub fn counts_agree(&self) -> bool {
        let Mesh { tally, triangles, .. } = self.mesh;
        let (bounds, dropped) = (tally.bounds, tally.dropped);
        let all = [dropped.degenerate, dropped.non_finite, dropped.bad_index];
        let all = all.iter().try_fold(tally.kept, |sum, &count| sum.checked_add(count));
        let words = self.layout().words() as u64;
        let records = self.state.record_words / words;
        tally.kept >= 1
            && all == Some(*triangles)
            && *triangles <= u64::from(u32::MAX)
            && bounds.min.is_finite()
            && bounds.max.is_finite()
            && bounds.min.cmple(bounds.max).all()
            && tally.longest >= 0.0
            && tally.longest.is_finite()
            && self.state.record_words.is_multiple_of(words)
            && if self.parts { records >= tally.kept && self.may_have_parts() } else { records == tally.kept }
    }

    fn may_have_parts(&self) -> bool {
        self.options.ids && !self.strict()
    }

    /// The spool of records, or of their parts, that was left; all of it is read.
    pub fn records<'w>(&self, work: &'w WorkFolder, name: &'static str) -> Result<Spool<'w>, Unfit> {
        let spool = Spool::reopen(work, name, self.state.record_words).ok_or_else(|| Unfit::short(work, name))?;
        let (mut seen, mut sound) = (Seen::nothing(), true);
        let whole = spool.holds(self.state.record_sum, self.layout().words(), self.monitor, |words| {
            sound = self.look(words, &mut seen);
            sound
        })?;
        // Where a record is none, the sum was not taken to the end.
        if sound && !whole {
            return Err(Unfit::checksum(work, name));
        }
        let agrees = seen.bounds == self.mesh.tally.bounds && seen.triangles == self.mesh.tally.kept;
        if sound && agrees { Ok(spool) } else { Err(Unfit::lies(work, name)) }
    }

    /// The spool of records that were sorted into chunks, likewise.
    pub fn chunks<'w>(&self, work: &'w WorkFolder, name: &'static str, chunks: &[Chunk]) -> Result<Spool<'w>, Unfit> {
        let lies = |sound: bool, name: &str| if sound { Ok(()) } else { Err(Unfit::lies(work, name)) };
        let words = extents_tile(chunks, self.layout().words() as u64);
        lies(words.is_some() && units_follow(chunks, self.options.depth.into()), "state")?;
        let spool = Spool::reopen(work, name, words.unwrap_or(0)).ok_or_else(|| Unfit::short(work, name))?;
        let mut all = Seen::nothing();
        for chunk in chunks {
            let (mut seen, mut counts, mut sum) = (Seen::nothing(), vec![0; chunk.units.len()], 0);
            for extent in &chunk.extents {
                let mut hash = Xxh3::with_seed(sum);
                let mut words = Vec::new();
                let piece = (1 << 18) / self.layout().words() * self.layout().words();
                for at in (0..extent.words).step_by(piece) {
                    self.monitor.check()?;
                    words.resize((extent.words - at).min(piece as u64) as usize, 0);
                    spool.read(extent.at + at, &mut words)?;
                    hash.update(bytemuck::cast_slice(&words));
                    lies(self.look(&words, &mut seen) && self.belong(&words, chunk, &mut counts), name)?;
                }
                sum = hash.digest();
            }
            if sum != chunk.sum {
                return Err(Unfit::checksum(work, name));
            }
            lies(counts.iter().zip(&chunk.units).all(|(&count, unit)| count == unit.triangles), "state")?;
            all.bounds = all.bounds.union(seen.bounds);
            all.records += seen.records;
        }
        let records = self.state.record_words / self.layout().words() as u64;
        let counted = if self.strict() { all.records >= records } else { all.records == records };
        lies(counted && all.bounds == self.mesh.tally.bounds, "state")?;
        Ok(spool)
    }

    /// Whether whole records are such as a join makes, in the source's order.
    fn look(&self, words: &[u32], seen: &mut Seen) -> bool {
        let layout = self.layout();
        let sound = words.par_chunks_exact(layout.words()).with_min_len(1024).all(|record| self.is_sound(record));
        if !sound || !words.len().is_multiple_of(layout.words()) {
            return false;
        }
        words.chunks_exact(layout.words()).all(|record| {
            let id = layout.id(record);
            let again = seen.last == Some(id);
            seen.bounds = seen.bounds.union(Aabb::from(&layout.triangle(record)));
            seen.records += 1;
            seen.triangles += u64::from(!again);
            seen.last.replace(id).is_none_or(|last| last < id || (again && self.parts))
        })
    }

    fn is_sound(&self, record: &[u32]) -> bool {
        let (layout, mesh) = (self.layout(), self.mesh);
        let (triangle, part) = (layout.triangle(record), layout.bounds(record));
        let (bounds, inside) =
            (Aabb::from(&triangle), |a: Aabb, b: Aabb| a.min.cmpge(b.min).all() && a.max.cmple(b.max).all());
        triangle.vertices().iter().all(|v| v.is_finite())
            && inside(bounds, mesh.tally.bounds)
            && inside(part, bounds)
            && part.min.cmple(part.max).all()
            && !exactly_degenerate(&triangle)
            && u64::from(layout.id(record)) < mesh.triangles
            && layout.material(record).is_none_or(|material| material as usize <= mesh.materials.len())
    }

    /// Counts records in the units of their chunk; whether each has one.
    fn belong(&self, words: &[u32], chunk: &Chunk, counts: &mut [u64]) -> bool {
        let (layout, placement) = (self.layout(), self.placement());
        let mut finder = UnitFinder::new(&chunk.units);
        words.chunks_exact(layout.words()).all(|record| {
            let mut found = false;
            if self.strict() {
                places(&chunk.units, &layout.triangle(record), CellCode::ROOT, placement, |unit| {
                    counts[unit] += 1;
                    found = true;
                });
                return found;
            }
            let code = cell_of(placement.root, layout.bounds(record));
            let place = finder.place(code);
            found = chunk.units.get(place).is_some_and(|unit| unit.cell.first() <= code);
            if found {
                counts[place] += 1;
            }
            found
        })
    }
}

impl Seen {
    fn nothing() -> Seen {
        Seen { bounds: Aabb::EMPTY, records: 0, triangles: 0, last: None }
    }
}

/// Words of a spool that the extents of all chunks fill without gap or overlap; `None` if they do not, or not with whole records of
/// so many words.
fn extents_tile(chunks: &[Chunk], record: u64) -> Option<u64> {
    let mut extents: Vec<(u64, u64)> =
        chunks.iter().flat_map(|chunk| &chunk.extents).map(|extent| (extent.at, extent.words)).collect();
    extents.sort_unstable();
    let whole = |words: u64| words > 0 && words.is_multiple_of(record);
    extents.iter().try_fold(0u64, |end, &(at, words)| (at == end && whole(words)).then(|| end.checked_add(words))?)
}

/// Whether the units of all chunks are cells above that depth, one after the other on the curve.
fn units_follow(chunks: &[Chunk], depth: u32) -> bool {
    let mut end = 0;
    chunks.iter().all(|chunk| !chunk.units.is_empty())
        && chunks.iter().flat_map(|chunk| &chunk.units).all(|unit| {
            let CellCode { level, code } = unit.cell;
            let exists = level <= depth.min(morton::BITS) && code < 1 << (3 * level) && unit.triangles > 0;
            let follows = exists && unit.cell.first() >= end;
            if follows {
                end = unit.cell.end();
            }
            follows
        })
}
