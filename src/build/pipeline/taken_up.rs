//! What a killed build wrote of the file: pages, and what it noted of them.

use bytemuck::Zeroable;

use super::super::distribute::Chunk;
use super::super::grid::CellCode;
use super::super::page_log::{PageEntry, PageLog};
use super::super::subtree::Cell;
use super::super::work::WorkFolder;
use super::Build;
use crate::error::Result;
use crate::format::{
    Brick, DEPTH_MAX, Flags, HEADER_BYTES, Header, PageId, PageRecord, most_stored, unpack_into, validate_page,
    validate_tree,
};
use crate::geometry::morton;

impl Build<'_> {
    /// Goes on with the pages that a killed build wrote in the state of that checksum: how many chunks they make.
    pub(super) fn take_up_pages(&mut self, work: &WorkFolder, state: u64, chunks: &[Chunk]) -> Result<usize> {
        self.tuning.check_pages(PageLog::pages(work, state))?;
        let left = PageLog::reopen(work, state);
        let is_damaged = left.is_none() && work.bytes("progress") > 0;
        if let Some((log, done, entries)) = left {
            let records = entries.iter().map(|entry| entry.record).collect();
            let is_sound = self.entries_follow(&entries) && self.are_of(&entries, done, chunks) && {
                let (flags, materials) = (self.flags(), self.mesh.materials.len() as u32);
                let (triangles, monitor) = (self.mesh.triangles, self.monitor);
                self.writer.resume(records, log.mark(), &mut |i, stored| {
                    monitor.check()?;
                    Ok(is_page(i, stored, &entries[i], flags, materials, triangles))
                })?
            };
            if is_sound {
                entries.iter().for_each(|entry| self.count(entry));
                self.log = Some(log);
                return Ok(done as usize);
            }
            self.warn_of_pages(work);
        }
        if is_damaged {
            self.warn_of_pages(work);
        }
        self.begin_pages(work, state)?;
        Ok(0)
    }

    fn warn_of_pages(&self, work: &WorkFolder) {
        self.monitor.warn(format!(
            "{}: the pages that were written are not whole, and are written anew",
            work.path().join("pages").display()
        ));
    }

    /// Begins to note pages, and the file that they go to.
    pub(super) fn begin_pages(&mut self, work: &WorkFolder, state: u64) -> Result<()> {
        let log = PageLog::create(work, state)?;
        self.writer.restart(log.mark())?;
        self.log = Some(log);
        Ok(())
    }

    /// Whether entries are such as a build notes, one after the other.
    fn entries_follow(&self, entries: &[PageEntry]) -> bool {
        let packed = self.options.compress.is_some();
        let (mut end, mut references) = (HEADER_BYTES as u64, 0);
        // The cell of the page before, and the first code behind it.
        let mut before = (None, 0);
        entries.iter().all(|entry| {
            let PageEntry { record: r, bounds_root: [low, high], .. } = *entry;
            let cell = Cell { level: entry.level, index: entry.index };
            let is_cell = cell.level <= self.rule.depth && cell.index.iter().all(|&i| i < 1 << cell.level);
            let alignment = PageRecord::alignment(r.references, packed);
            let most = if packed { most_stored(r.bytes) } else { r.bytes.into() };
            let sound = is_cell
                // A cell at the depth limit may have several pages.
                && (cell.code() >= before.1 || before.0 == Some(cell))
                && end.checked_next_multiple_of(alignment) == Some(r.offset)
                && u64::from(r.stored_bytes) <= most
                && (packed || r.stored_bytes == r.bytes)
                // Both are held while the page is looked at.
                && u64::from(r.bytes) + u64::from(r.stored_bytes) <= self.tuning.alone_bytes()
                && (r.references > 0 && r.zero == 0 && entry.zero == 0)
                && (1..=DEPTH_MAX).contains(&entry.depth)
                && u64::from(entry.brick.first_reference) == references
                && is_frame(entry.brick)
                && (0..3).all(|i| 0.0 <= low[i] && low[i] <= high[i] && high[i] <= 1.0);
            if sound {
                let [x, y, z] = cell.index;
                before = (Some(cell), CellCode { level: cell.level, code: morton::encode(x, y, z) }.end());
                end = r.offset.saturating_add(r.stored_bytes.into());
                references += u64::from(r.references);
            }
            sound && references < u64::from(u32::MAX)
        })
    }

    /// Whether entries can be all those of the first `done` chunks: none behind them, and no triangle missing.
    fn are_of(&self, entries: &[PageEntry], done: u64, chunks: &[Chunk]) -> bool {
        let Some(done) = usize::try_from(done).ok().and_then(|done| chunks.get(..done)) else { return false };
        let Some(last) = done.last().and_then(|chunk| chunk.units.last()) else { return entries.is_empty() };
        let within = entries.iter().all(|entry| {
            let cell = Cell { level: entry.level, index: entry.index };
            cell.code() < last.cell.end()
        });
        let references: u64 = entries.iter().map(|entry| u64::from(entry.record.references)).sum();
        let triangles: u64 = done.iter().map(Chunk::triangles).sum();
        // Large triangles may be stored more than once; without ids none is.
        within && if self.options.ids { references >= triangles } else { references == triangles }
    }
}

/// Whether a brick has a frame that a reader takes.
fn is_frame(brick: Brick) -> bool {
    validate_tree(&Header { pages: 1, ..Header::zeroed() }, &[], &[brick]).is_ok()
}

/// Whether a page as stored is whole, and as its entry says.
fn is_page(i: usize, stored: &[u8], entry: &PageEntry, flags: Flags, materials: u32, triangles: u64) -> bool {
    // Pages are read as words.
    let mut words = vec![0u64; entry.record.bytes.div_ceil(8) as usize];
    let page = &mut bytemuck::cast_slice_mut(&mut words)[..entry.record.bytes as usize];
    if !flags.has(Flags::PACKED) {
        page.copy_from_slice(stored);
    } else if unpack_into(stored, page).is_err() {
        return false;
    }
    let attributes = Flags(flags.0 | entry.attributes & (Flags::NORMALS | Flags::TEXCOORDS));
    let header = validate_page(page, PageId(i as u32), &entry.record, attributes, materials, triangles);
    header.is_ok_and(|header| {
        let flag = |mask: u32, offset: u32| if offset != 0 { mask } else { 0 };
        let held = flag(Flags::NORMALS, header.normal_corners) | flag(Flags::TEXCOORDS, header.texcoord_corners);
        u64::from(header.nodes) == entry.nodes && header.leaves == entry.leaves && held == entry.attributes
    })
}
