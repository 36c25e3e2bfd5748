//! What follows the pages: the sections of the top, and for level of detail the heads of the pages.

use std::io::Read;

use super::{BUFFER_BYTES, OctWriter, Top};
use crate::error::{Error, Result};
use crate::format::{Flags, Head, PageRecord, Section, SectionKind, Surrogate, checksum, unpack_into};

impl OctWriter {
    /// Writes the sections and returns their directory.
    pub(super) fn write_top(
        &mut self,
        top: &mut Top<'_>,
        records: &[PageRecord],
        flags: Flags,
    ) -> Result<[Section; 16]> {
        let sections: [(SectionKind, bool, &[u8]); 5] = [
            (SectionKind::TopNodes, !top.nodes.is_empty(), bytemuck::cast_slice(top.nodes)),
            (SectionKind::Bricks, true, bytemuck::cast_slice(top.bricks)),
            (SectionKind::Pages, true, bytemuck::cast_slice(records)),
            (SectionKind::Materials, !top.materials.is_empty(), bytemuck::cast_slice(top.materials)),
            (SectionKind::Strings, !top.materials.is_empty(), top.strings),
        ];
        let mut directory = Vec::with_capacity(SectionKind::COUNT);
        for (kind, _, bytes) in sections.into_iter().filter(|(_, wanted, _)| *wanted) {
            directory.push(self.section(kind, bytes)?);
        }
        if flags.has(Flags::DETAIL) {
            let (heads, places, roots) = self.write_heads(records, flags)?;
            let tops = (top.surrogates)(top.bricks, &roots);
            directory.extend([heads, self.section(SectionKind::HeadPlaces, bytemuck::cast_slice(&places))?]);
            if !top.nodes.is_empty() {
                directory.push(self.section(SectionKind::TopSurrogates, bytemuck::cast_slice(&tops))?);
            }
        }
        directory.resize(16, Section::default());
        Ok(std::array::from_fn(|i| directory[i]))
    }

    /// Writes a section.
    fn section(&mut self, kind: SectionKind, bytes: &[u8]) -> Result<Section> {
        self.align(64)?;
        let (offset, bytes_long) = (self.position, bytes.len() as u64);
        self.write(bytes)?;
        Ok(Section { kind: kind as u32, zero: 0, offset, bytes: bytes_long, checksum: checksum(bytes) })
    }

    /// Writes the heads of all pages, which are read back for that: their section, their places in it, and the bricks' surrogates.
    fn write_heads(&mut self, records: &[PageRecord], flags: Flags) -> Result<(Section, Vec<u32>, Vec<Surrogate>)> {
        self.align(64)?;
        let (offset, mut hash) = (self.position, xxhash_rust::xxh3::Xxh3::new());
        let (mut places, mut roots) = (Vec::with_capacity(records.len()), Vec::with_capacity(records.len()));
        let mut waiting = Vec::new();
        for (i, record) in records.iter().enumerate() {
            let written = self.position - offset + waiting.len() as u64;
            places.push((written / 64) as u32);
            let head = self.head(record, flags)?;
            let head = head.filter(|head| !head.surrogates.is_empty());
            let head = head.ok_or_else(|| self.misuse(format!("page {i} has no surrogates")))?;
            roots.push(head.surrogates[0]);
            head.store(&mut waiting);
            if waiting.len() >= BUFFER_BYTES || i + 1 == records.len() {
                hash.update(&waiting);
                self.seek(self.position)?;
                self.write(&waiting)?;
                waiting.clear();
            }
        }
        let bytes = self.position - offset;
        let section = Section { kind: SectionKind::Heads as u32, zero: 0, offset, bytes, checksum: hash.digest() };
        Ok((section, places, roots))
    }

    /// The head of a page that was written.
    fn head(&mut self, record: &PageRecord, flags: Flags) -> Result<Option<Head>> {
        if !flags.has(Flags::PACKED) {
            return Head::of_page(|at, bytes| self.read_back(record.offset + at as u64, bytes));
        }
        let stored = self.read_back(record.offset, record.stored_bytes as usize)?;
        let mut page = vec![0; record.bytes as usize];
        unpack_into(&stored, &mut page).map_err(|what| self.misuse(what))?;
        Head::of_page(|at, bytes| Ok(page.get(at..at + bytes).unwrap_or_default().to_vec()))
    }

    /// Reads what was written. The next byte to be written then has to be sought again.
    pub(super) fn read_back(&mut self, offset: u64, bytes: usize) -> Result<Vec<u8>> {
        self.seek(offset)?;
        let mut read = vec![0; bytes];
        self.part.file.read_exact(&mut read).map_err(Error::io(&self.path, "read back"))?;
        Ok(read)
    }
}
