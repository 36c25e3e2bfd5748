//! Writes an octree file page by page: to a temporary name, synced, then renamed.
//!
//! A killed build therefore leaves nothing that looks whole, and a failed one leaves an older file as it was. What a killed
//! one leaves can be taken up again ([`OctWriter::resume`]). Only the page records are held in memory (32 bytes a page);
//! pages go out as they come.

mod top;

use std::fs::File;
use std::io::{BufWriter, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use super::part::Part;
use super::{
    Brick, Flags, HEADER_BYTES, Header, MAGIC, MaterialRecord, Node, PageHeader, PageId, PageRecord, Surrogate,
    VERSION, checksum,
};
use crate::error::{Error, Result, folder_of};

/// Bytes gathered before they are written.
const BUFFER_BYTES: usize = 1 << 20;

/// An octree file being written.
///
/// Pages are appended in order; [`OctWriter::finish`] writes the top and the header, syncs and renames. Dropped before
/// that, it removes its temporary file and leaves an older file of that name untouched.
pub struct OctWriter {
    /// The name as given, for messages.
    path: PathBuf,
    /// The name with links resolved.
    target: PathBuf,
    file: BufWriter<File>,
    part: Part,
    /// Where the next byte goes.
    position: u64,
    records: Vec<PageRecord>,
}

/// Makes the surrogates of the top nodes from the bricks and the surrogates of their roots.
pub type MakeTop<'a> = dyn FnMut(&[Brick], &[Surrogate]) -> Vec<Surrogate> + 'a;

/// All that is known only when the last page is written.
pub struct Top<'a> {
    /// Top nodes; empty for a file of one page.
    pub nodes: &'a [Node],
    /// Brick frames and first references, one a page; `node` is filled in by the writer.
    pub bricks: &'a mut [Brick],
    /// Materials.
    pub materials: &'a [MaterialRecord],
    /// The strings that the materials name.
    pub strings: &'a [u8],
    /// Makes the surrogates of the top nodes from those of the bricks' roots; asked where pages have surrogates.
    pub surrogates: &'a mut MakeTop<'a>,
}

impl OctWriter {
    /// Begins a file that will be named `path`; the temporary file lies in the same folder.
    pub fn create(path: &Path) -> Result<OctWriter> {
        let mut writer = OctWriter::open(path)?;
        writer.restart(0)?;
        Ok(writer)
    }

    /// The same, but what an earlier writer of this file left when it was killed is kept until [`OctWriter::restart`] or
    /// [`OctWriter::resume`], one of which must be called before all else.
    pub fn open(path: &Path) -> Result<OctWriter> {
        // A link is followed, as when an ordinary file is written.
        let target = path.canonicalize().unwrap_or_else(|_| path.to_owned());
        if target.exists() && !target.is_file() {
            let what = "is not an ordinary file; name a file to write to".into();
            return Err(Error::Input { file: path.to_owned(), what });
        }
        let part = Part::open(&target).map_err(Error::create(path))?;
        let file = part.file.try_clone().map_err(Error::io(path, "write"))?;
        let file = BufWriter::with_capacity(BUFFER_BYTES, file);
        Ok(OctWriter { path: path.to_owned(), target, file, part, position: 0, records: Vec::new() })
    }

    /// Whether no other process writes the same file at this time.
    pub fn is_first(&self) -> bool {
        self.part.is_first
    }

    /// Bytes that an earlier writer left, or that were written and flushed.
    fn left(&self) -> u64 {
        self.part.file.metadata().map_or(0, |data| data.len())
    }

    /// Begins from the start, whatever an earlier writer left. `mark` tells the file from others that are left under its name:
    /// it lies where the header will, which is written last.
    pub fn restart(&mut self, mark: u64) -> Result<()> {
        self.go_to(0)?;
        self.records.clear();
        self.write(&[0; 8])?;
        self.write(&mark.to_le_bytes())?;
        self.write(&[0; HEADER_BYTES - 16])
    }

    /// Goes on after the pages of `records`, which an earlier writer has written and [`OctWriter::flush`]ed. False, and
    /// nothing is changed, if its file is not there, has another `mark`, is too short, or holds a page with another checksum or that
    /// `is_sound`, given its number and its bytes as stored, does not take. All pages are read, one at a time; an error of
    /// `is_sound` ends that.
    pub fn resume(
        &mut self,
        records: Vec<PageRecord>,
        mark: u64,
        is_sound: &mut dyn FnMut(usize, &[u8]) -> Result<bool>,
    ) -> Result<bool> {
        let mut end = HEADER_BYTES as u64;
        let head = [&[0; 8][..], &mark.to_le_bytes(), &[0; HEADER_BYTES - 16]].concat();
        if !self.is_first() || self.left() < end || self.read_back(0, HEADER_BYTES)? != head {
            return Ok(false);
        }
        for (i, record) in records.iter().enumerate() {
            let stop = record.offset.checked_add(record.stored_bytes.into());
            let gap = record.offset.checked_sub(end).filter(|&gap| gap < HEADER_BYTES as u64);
            let (Some(stop), Some(gap)) = (stop.filter(|&stop| stop <= self.left()), gap) else { return Ok(false) };
            let gap = self.read_back(end, gap as usize)?;
            let page = self.read_back(record.offset, record.stored_bytes as usize)?;
            if gap.iter().any(|&byte| byte != 0) || checksum(&page) != record.checksum || !is_sound(i, &page)? {
                return Ok(false);
            }
            end = stop;
        }
        self.go_to(end)?;
        self.records = records;
        Ok(true)
    }

    /// Cuts what was left at `position`, where the next byte goes.
    fn go_to(&mut self, position: u64) -> Result<()> {
        self.part.file.set_len(position).map_err(Error::io(&self.path, "write"))?;
        self.file.seek(SeekFrom::Start(position)).map_err(Error::io(&self.path, "write"))?;
        self.position = position;
        Ok(())
    }

    /// Hands all pages so far to the system, so that they outlive the process.
    pub fn flush(&mut self) -> Result<()> {
        self.file.flush().map_err(Error::io(&self.path, "write"))
    }

    /// Appends a page as laid out by [`super::PageHeader::layout`]; pages come in the order of their numbers.
    pub fn append(&mut self, page: &[u8]) -> Result<PageId> {
        self.append_stored(page, None)
    }

    /// The same, stored as `packed` (see [`super::pack`]). Either all pages of a file are packed, or none.
    pub fn append_packed(&mut self, page: &[u8], packed: &[u8]) -> Result<PageId> {
        self.append_stored(page, Some(packed))
    }

    fn append_stored(&mut self, page: &[u8], packed: Option<&[u8]>) -> Result<PageId> {
        let id = PageId(self.records.len() as u32);
        let header = page.get(..size_of::<PageHeader>()).map(bytemuck::pod_read_unaligned::<PageHeader>);
        let Some(header) = header.filter(|h| h.page == id.0 && page.len().is_multiple_of(64)) else {
            return Err(self.misuse(format!("page {} is not laid out as such", id.0)));
        };
        let stored = packed.unwrap_or(page);
        let (Ok(bytes), Ok(stored_bytes)) = (u32::try_from(page.len()), u32::try_from(stored.len())) else {
            return Err(self.misuse(format!("page {} is larger than 4 GiB; take smaller bricks", id.0)));
        };
        self.align(PageRecord::alignment(header.references, packed.is_some()))?;
        let offset = self.position;
        if u32::try_from(offset / 64 + 1).is_err() {
            return Err(
                self.misuse("the file passes 256 GiB, the most that version 1 can hold; divide the mesh".into())
            );
        }
        self.write(stored)?;
        let checksum = checksum(stored);
        self.records.push(PageRecord { offset, checksum, stored_bytes, bytes, references: header.references, zero: 0 });
        Ok(id)
    }

    /// Pages written so far.
    pub fn records(&self) -> &[PageRecord] {
        &self.records
    }

    /// Writes the top and the header, syncs, renames. The header's sizes, page count, sections and checksums are
    /// filled in here; everything else is taken from `header`. Returns the file's length.
    ///
    /// Filled in: magic, version, file bytes, pages, top nodes, materials, largest page, section directory, checksum.
    pub fn finish(mut self, header: Header, mut top: Top<'_>) -> Result<u64> {
        if top.bricks.len() != self.records.len() {
            return Err(self.misuse(format!("{} bricks for {} pages", top.bricks.len(), self.records.len())));
        }
        for (brick, record) in top.bricks.iter_mut().zip(&self.records) {
            brick.node = if header.flags.has(Flags::PACKED) { 0 } else { (record.offset / 64 + 1) as u32 };
        }
        let records = std::mem::take(&mut self.records);
        let mut header = Header {
            magic: MAGIC,
            version: VERSION,
            pages: records.len() as u32,
            top_nodes: top.nodes.len() as u32,
            materials: top.materials.len() as u32,
            largest_page: records.iter().map(|r| r.bytes).max().unwrap_or(0),
            sections: self.write_top(&mut top, &records, header.flags)?,
            file_bytes: self.position,
            ..header
        };
        header.checksum = checksum(&bytemuck::bytes_of(&header)[..HEADER_BYTES - 8]);
        self.seal(&header)?;
        Ok(header.file_bytes)
    }

    /// Hands what waits to the system and goes to an offset, without cutting anything off.
    fn seek(&mut self, offset: u64) -> Result<()> {
        self.file.seek(SeekFrom::Start(offset)).map_err(Error::io(&self.path, "seek in")).map(|_| ())
    }

    /// Writes the header over its place, syncs, renames, syncs the folder.
    fn seal(self, header: &Header) -> Result<()> {
        let path = self.path;
        let mut file = self.file.into_inner().map_err(|e| Error::io(&path, "write")(e.into_error()))?;
        file.seek(SeekFrom::Start(0)).map_err(Error::io(&path, "write"))?;
        file.write_all(bytemuck::bytes_of(header)).map_err(Error::io(&path, "write"))?;
        file.sync_all().map_err(Error::io(&path, "sync"))?;
        self.part.persist(&self.target).map_err(Error::io(&path, "rename its temporary file to"))?;
        sync_folder(folder_of(&self.target)).map_err(Error::io(&path, "sync the folder of"))
    }

    /// Writes zeros up to the next multiple.
    fn align(&mut self, multiple: u64) -> Result<()> {
        let gap = self.position.next_multiple_of(multiple) - self.position;
        self.write(&[0; HEADER_BYTES][..gap as usize])
    }

    /// Appends bytes.
    fn write(&mut self, bytes: &[u8]) -> Result<()> {
        self.file.write_all(bytes).map_err(Error::io(&self.path, "write"))?;
        self.position += bytes.len() as u64;
        Ok(())
    }

    /// The error for pages that cannot be written.
    fn misuse(&self, what: String) -> Error {
        Error::Input { file: self.path.clone(), what }
    }
}

/// Makes a rename in `folder` last.
fn sync_folder(folder: &Path) -> std::io::Result<()> {
    if cfg!(unix) { File::open(folder)?.sync_all() } else { Ok(()) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error::Kind;
    use crate::format::{Frame, LeafUnit, Points, SideArrays, encode_leaf};
    use crate::geometry::Triangle;
    use glam::Vec3;
    use std::fs;

    /// A page of one triangle. Only its form matters here.
    fn page(number: u32) -> Vec<u8> {
        let mut leaf = Vec::new();
        encode_leaf(&mut leaf, LeafUnit::B16, Points::Floats, 0, &[Triangle { a: Vec3::X, b: Vec3::Y, c: Vec3::Z }])
            .unwrap();
        PageHeader::layout(PageId(number), &[Node::EMPTY], &leaf, 1, 1, &SideArrays::default(), false).unwrap()
    }

    fn brick() -> Brick {
        let (corner, unit) = (Frame::ROOT.corner.map(|x| x as f32), Frame::ROOT.unit.map(|x| x as f32));
        Brick { node: 0, first_reference: 0, corner, unit }
    }

    fn finish(writer: OctWriter, bricks: &mut [Brick]) -> Result<u64> {
        writer.finish(
            bytemuck::Zeroable::zeroed(),
            Top { nodes: &[], bricks, materials: &[], strings: &[], surrogates: &mut |_, _| Vec::new() },
        )
    }

    #[test]
    fn what_is_not_finished_leaves_no_trace() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.oct");
        fs::write(&path, "older").unwrap();
        let mut writer = OctWriter::create(&path).unwrap();
        writer.append(&page(0)).unwrap();
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2);
        drop(writer);
        let writer = OctWriter::create(&path).unwrap();
        assert!(finish(writer, &mut [brick()]).is_err(), "a brick too many");
        assert_eq!(fs::read(&path).unwrap(), b"older");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn what_a_killed_writer_left_is_taken_up() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.oct");
        let whole = {
            let mut writer = OctWriter::create(&path).unwrap();
            for number in 0..3 {
                writer.append(&page(number)).unwrap();
            }
            finish(writer, &mut [brick(); 3]).unwrap();
            fs::read(&path).unwrap()
        };
        let mut writer = OctWriter::open(&path).unwrap();
        writer.restart(77).unwrap();
        for number in 0..2 {
            writer.append(&page(number)).unwrap();
        }
        writer.flush().unwrap();
        let records = writer.records().to_vec();
        // As a kill does: the file stays.
        let part = folder.path().join(".a.oct.part");
        let left = fs::read(&part).unwrap();
        drop(writer);
        fs::write(&part, [&left[..], b"and half of a page"].concat()).unwrap();
        let mut writer = OctWriter::open(&path).unwrap();
        let all = &mut |_: usize, _: &[u8]| Ok(true);
        let far = PageRecord { offset: 1 << 20, ..records[0] };
        let rotten = PageRecord { checksum: 7, ..records[1] };
        assert!(!writer.resume(vec![far], 77, all).unwrap());
        assert!(!writer.resume(vec![records[0], rotten], 77, all).unwrap());
        assert!(!writer.resume(records.clone(), 78, all).unwrap(), "what another writer left");
        assert!(!writer.resume(records.clone(), 77, &mut |i, _| Ok(i == 0)).unwrap(), "the second is not sound");
        let stop = &mut |i: usize, _: &[u8]| if i == 0 { Ok(true) } else { Err(Error::Interrupted) };
        assert!(matches!(writer.resume(records.clone(), 77, stop), Err(Error::Interrupted)));
        assert!(writer.resume(records, 77, &mut |i, stored| Ok(stored == page(i as u32))).unwrap());
        writer.append(&page(2)).unwrap();
        finish(writer, &mut [brick(); 3]).unwrap();
        assert!(fs::read(&path).unwrap() == whole);
    }

    #[test]
    fn pages_come_in_order_and_whole() {
        let folder = tempfile::tempdir().unwrap();
        let mut writer = OctWriter::create(&folder.path().join("a.oct")).unwrap();
        assert!(writer.append(&page(1)).is_err());
        assert!(writer.append(&page(0)[..100]).is_err());
        assert_eq!(writer.append(&page(0)).unwrap(), PageId(0));
        assert_eq!(writer.append(&page(1)).unwrap(), PageId(1));
        let mut bricks = [brick(), brick()];
        let offsets: Vec<_> = writer.records().iter().map(|r| r.offset).collect();
        assert_eq!(offsets, [4096, 4096 + page(0).len() as u64]);
        finish(writer, &mut bricks).unwrap();
        assert_eq!(bricks[1].node as u64 * 64, offsets[1] + 64);
    }

    #[cfg(unix)]
    #[test]
    fn permissions_are_those_of_any_new_file_and_links_are_followed() {
        use std::os::unix::fs::{PermissionsExt, symlink};
        let folder = tempfile::tempdir().unwrap();
        let (ordinary, path) = (folder.path().join("ordinary"), folder.path().join("a.oct"));
        let link = folder.path().join("link.oct");
        fs::write(&ordinary, "").unwrap();
        fs::write(&path, "").unwrap();
        symlink("a.oct", &link).unwrap();
        let mut writer = OctWriter::create(&link).unwrap();
        writer.append(&page(0)).unwrap();
        let length = finish(writer, &mut [brick()]).unwrap();
        let mode = |path: &Path| fs::metadata(path).unwrap().permissions().mode();
        assert_eq!(mode(&path), mode(&ordinary));
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
        assert_eq!(fs::metadata(&path).unwrap().len(), length);
    }

    #[test]
    fn places_that_cannot_be_written_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let kind = |path: &Path| OctWriter::create(path).err().map(|e| (e.kind(), e.to_string()));
        let (found, text) = kind(folder.path()).unwrap();
        assert!(found == Kind::Input && text.contains("not an ordinary file"), "{text}");
        let missing = folder.path().join("none/a.oct");
        let (found, text) = kind(&missing).unwrap();
        assert!(found == Kind::Machine && text.contains("none/a.oct: cannot create"), "{text}");
    }
}
