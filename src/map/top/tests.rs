//! Opening costs the same whatever the file, and each entry is checked when it is first used.

use std::fs;
use std::path::{Path, PathBuf};

use super::*;
use crate::error::Kind;
use crate::event::Monitor;
use crate::format::{Flags, HEADER_BYTES, PageId, Section, SplitMode};
use crate::map::sample::Sample;
use crate::map::{Page, Read};

/// Both ways to read.
fn ways(path: &Path) -> [Octree; 2] {
    let cache = Octree::least_cache(path).unwrap();
    [Read::Mapped, Read::Budgeted { cache }].map(|read| Octree::open_with(path, read).unwrap())
}

fn sample() -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("sample.oct");
    Sample::new(2000, Flags::IDS | Flags::MATERIALS, 8).write(&path);
    (folder, path)
}

/// Changes what lies so far behind the beginning of a section, and puts the checksums right if asked to.
fn change(path: &Path, kind: SectionKind, behind: usize, value: &[u8], repair: bool) {
    let mut bytes = fs::read(path).unwrap();
    let mut header: Header = bytemuck::pod_read_unaligned(&bytes[..HEADER_BYTES]);
    let section = header.sections.iter_mut().find(|s| s.kind == kind as u32).unwrap();
    let range = section.offset as usize..(section.offset + section.bytes) as usize;
    bytes[range.start + behind..range.start + behind + value.len()].copy_from_slice(value);
    if repair {
        section.checksum = checksum(&bytes[range]);
        header.checksum = checksum(&bytemuck::bytes_of(&header)[..HEADER_BYTES - 8]);
        bytes[..HEADER_BYTES].copy_from_slice(bytemuck::bytes_of(&header));
    }
    fs::write(path, &bytes).unwrap();
}

/// Resident memory of this process, where the system tells.
fn resident_kib() -> Option<u64> {
    let status = fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
    line.trim().strip_suffix("kB")?.trim().parse().ok()
}

/// A header that says of sixteen million pages, in a file that has nothing but the header: whoever reads or keeps anything for each of them
/// reads 1.2 GB, or takes as much memory.
#[test]
fn opening_costs_the_same_whatever_the_file() {
    let (_folder, path) = sample();
    let mut header = *Octree::open(&path).unwrap().header();
    let pages = 1u64 << 24;
    (header.pages, header.top_nodes) = (pages as u32, 1 << 22);
    (header.nodes, header.leaves) = (2 * pages, 4 * pages);
    (header.triangles, header.references, header.source_triangles) = (1 << 30, 1 << 30, 1 << 30);
    header.dropped = Default::default();
    let mut end = HEADER_BYTES as u64 + pages * u64::from(header.largest_page).next_multiple_of(64);
    header.sections = [Section::default(); 16];
    let lengths = [(1, 64 << 22), (2, 32 * pages), (3, 32 * pages), (4, 80 * u64::from(header.materials)), (5, 16)];
    for (section, (kind, bytes)) in header.sections.iter_mut().zip(lengths) {
        *section = Section { kind, offset: end.next_multiple_of(64), bytes, ..Section::default() };
        end = section.offset + bytes;
    }
    (header.file_bytes, header.split) = (end, SplitMode::Sah as u8);
    header.checksum = checksum(&bytemuck::bytes_of(&header)[..HEADER_BYTES - 8]);
    fs::write(&path, bytemuck::bytes_of(&header)).unwrap();
    fs::OpenOptions::new().write(true).open(&path).unwrap().set_len(end).unwrap();
    let before = resident_kib();
    let opened = ways(&path);
    if let (Some(before), Some(after)) = (before, resident_kib()) {
        println!("{} KiB more", after.saturating_sub(before));
        assert!(after < before + (256 << 10), "{before} KiB before, {after} after");
    }
    let [mapped, budgeted] = opened;
    assert_eq!((mapped.header().pages, budgeted.figures().total), (1 << 24, 1 << 24));
    assert_eq!(mapped.figures().touched, 0);
    // The lie is found by who uses it, at the first node.
    let error = mapped.with_page(PageId(5), |_| ()).unwrap_err();
    assert!(error.kind() == Kind::Damaged && error.to_string().contains("top node 0"), "{error}");
}

#[test]
fn an_entry_is_checked_when_its_page_is_used() {
    type Lie = (SectionKind, usize, &'static [u8], &'static str);
    let lies: [Lie; 6] = [
        (SectionKind::Pages, 0, &[0x40, 0xff], "page 5 does not lie where it should"),
        (SectionKind::Pages, 16, &[0, 0, 0, 0xff], "the lengths break a rule"),
        (SectionKind::Pages, 24, &[0, 0, 0, 0], "the references cannot be that many"),
        (SectionKind::Pages, 8, &[1, 2, 3, 4], "its checksum is wrong"),
        (SectionKind::Bricks, 0, &[7], "does not name its page's first node"),
        (SectionKind::Bricks, 4, &[1, 2, 3], "its first reference is not the sum"),
    ];
    for (kind, behind, value, what) in lies {
        let (_folder, path) = sample();
        change(&path, kind, 5 * 32 + behind, value, true);
        for octree in ways(&path) {
            for i in [0, 3, 4, 7, 1] {
                octree.with_page(PageId(i), |page: Page<'_>| assert!(!page.nodes().is_empty())).unwrap();
            }
            for _ in 0..2 {
                let error = octree.with_page(PageId(5), |_| ()).unwrap_err();
                let said = error.to_string();
                assert!(error.kind() == Kind::Damaged && said.contains("page 5") && said.contains(what), "{said}");
            }
            octree.fault().unwrap();
            let error = octree.verify(Monitor::silent()).unwrap_err();
            assert!(error.kind() == Kind::Damaged && error.to_string().contains(what), "{error}");
        }
    }
}

/// Damage that only a checksum shows is no wrong answer.
#[test]
fn damage_in_the_top_is_told_before_any_answer() {
    use crate::geometry::{Ray, Skip};
    use crate::trace::{OctreeTracer, Tracer};
    for (kind, behind) in [(SectionKind::TopNodes, 4), (SectionKind::Bricks, 5 * 32 + 9)] {
        let (_folder, path) = sample();
        let sound = Octree::open(&path).unwrap();
        let byte = match kind {
            SectionKind::TopNodes => bytemuck::cast_slice::<_, u8>(sound.top_nodes())[behind],
            _ => bytemuck::cast_slice::<_, u8>(sound.bricks())[behind],
        };
        drop(sound);
        change(&path, kind, behind, &[byte ^ 1], false);
        for octree in ways(&path) {
            octree.fault().unwrap();
            for _ in 0..2 {
                let ray = Ray::new([0.0, 0.0, 5.0], [0.0, 0.1, -1.0]);
                let error = OctreeTracer::new(&octree).closest(&ray, Skip::NONE).unwrap_err();
                assert!(error.kind() == Kind::Damaged, "{error}");
            }
            assert!(octree.with_page(PageId(2), |_| ()).is_err() && octree.fault().is_err());
            assert!(octree.verify(Monitor::silent()).is_err());
        }
    }
    let (_folder, path) = sample();
    change(&path, SectionKind::Materials, 3, &[0x11], false);
    for octree in ways(&path) {
        octree.with_page(PageId(0), |_| ()).unwrap();
        assert!(octree.materials().is_empty() && octree.string([0, 4]).is_empty());
        assert!(octree.fault().unwrap_err().to_string().contains("the checksum of section 4"));
    }
}

/// Where the file is as long as it was, it is the disk that fails.
#[cfg(unix)]
#[test]
fn a_mapped_file_that_cannot_be_read_is_told_from_one_cut_short() {
    let (_folder, path) = sample();
    let bytes = fs::read(&path).unwrap();
    let octree = Octree::open(&path).unwrap();
    let file = fs::OpenOptions::new().write(true).open(&path).unwrap();
    file.set_len(0).unwrap();
    assert!(octree.with_page(PageId(3), |_| ()).is_err());
    assert!(octree.fault().is_err_and(|e| e.kind() == Kind::Damaged && e.to_string().contains(CUT_SHORT)));
    file.set_len(bytes.len() as u64).unwrap();
    assert!(octree.fault().is_err_and(|e| e.kind() == Kind::Machine));
}
