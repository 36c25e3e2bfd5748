//! Pages that come and go, however small the cache.

use std::fs;
use std::path::PathBuf;

use super::*;
use crate::error::Kind;
use crate::format::{PageId, SectionKind};
use crate::map::sample::{Sample, random};
use crate::map::{Octree, Read};

/// A file of eight pages, and what its pages hold.
fn sample() -> (tempfile::TempDir, PathBuf, Vec<Vec<u8>>) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("sample.oct");
    Sample::new(3000, Flags::IDS, 8).write(&path);
    let octree = Octree::open(&path).unwrap();
    let visit = octree.visit();
    let pages = (0..8).map(|i| visit.page(PageId(i)).unwrap().bytes().to_vec()).collect();
    (folder, path, pages)
}

fn budgeted(path: &std::path::Path, pages: u64) -> Octree {
    let cache = Octree::least_cache(path).unwrap() * pages;
    Octree::open_with(path, Read::Budgeted { cache }).unwrap()
}

#[test]
fn every_page_is_had_with_room_for_one() {
    let (_folder, path, pages) = sample();
    let octree = budgeted(&path, 1);
    for round in 0..3 {
        for i in (0..8).map(|i| (5 * i + round) % 8) {
            let same = octree.with_page(PageId(i), |page| page.bytes() == pages[i as usize]).unwrap();
            assert!(same, "page {i}");
        }
    }
    let figures = octree.figures();
    assert_eq!((figures.total, figures.touched), (8, 8));
    assert!(figures.reread > 0 && figures.read == 8 + figures.reread, "{figures:?}");
    assert!(figures.most_bytes <= Octree::least_cache(&path).unwrap());
    let stored: u64 = octree.records().iter().map(|r| u64::from(r.stored_bytes)).sum();
    assert!(figures.bytes_touched == stored && figures.bytes_read > stored && figures.entered == 24);
}

#[test]
fn threads_share_room_for_two() {
    let (_folder, path, pages) = sample();
    let octree = budgeted(&path, 2);
    std::thread::scope(|scope| {
        for thread in 0..4u64 {
            let (octree, pages) = (&octree, &pages);
            scope.spawn(move || {
                let mut state = thread;
                for _ in 0..300 {
                    let i = random(&mut state) % 8;
                    assert!(octree.with_page(PageId(i as u32), |page| page.bytes() == pages[i as usize]).unwrap());
                }
            });
        }
    });
    let figures = octree.figures();
    assert!(figures.most_bytes <= 2 * Octree::least_cache(&path).unwrap() && figures.entered == 1200, "{figures:?}");
}

/// Whoever visits one page and needs another must get it, though the first cannot go.
#[test]
fn a_page_within_a_page() {
    let (_folder, path, pages) = sample();
    let octree = budgeted(&path, 1);
    for i in 0..8 {
        let other = (i + 3) % 8;
        let both = octree.with_page(PageId(i), |page| {
            let inner = octree.with_page(PageId(other), |page| page.bytes() == pages[other as usize]);
            inner.unwrap() && page.bytes() == pages[i as usize]
        });
        assert!(both.unwrap());
    }
}

#[test]
fn packed_files_are_read_the_same() {
    let (_folder, path, pages) = sample();
    let packed = path.with_file_name("packed.oct");
    pack(&path, &packed);
    let refused = Octree::open_with(&packed, Read::Mapped).err().unwrap();
    assert!(refused.kind() == Kind::Input && refused.to_string().contains("packed"), "{refused}");
    for octree in [Octree::open(&packed).unwrap(), budgeted(&packed, 1)] {
        for i in (0..8).chain(0..8) {
            assert!(octree.with_page(PageId(i), |page| page.bytes() == pages[i as usize]).unwrap());
        }
        octree.verify(crate::event::Monitor::silent()).unwrap();
    }
}

/// Writes a file anew with its pages packed.
fn pack(from: &std::path::Path, to: &std::path::Path) {
    let octree = Octree::open(from).unwrap();
    let mut writer = crate::format::OctWriter::create(to).unwrap();
    let visit = octree.visit();
    for i in 0..8 {
        let page = visit.page(PageId(i)).unwrap();
        writer.append_packed(page.bytes(), &crate::format::pack(page.bytes(), 3).unwrap()).unwrap();
    }
    let header = Header { flags: Flags(octree.flags().0 | Flags::PACKED), ..*octree.header() };
    let mut bricks = octree.bricks().to_vec();
    let tops: Vec<_> = match octree.detail().unwrap() {
        Some(detail) => (0..octree.top_nodes().len()).map(|i| *detail.top(i as u32).unwrap()).collect(),
        None => Vec::new(),
    };
    let nodes = octree.top_nodes();
    let surrogates = &mut |_: &[crate::format::Brick], _: &[crate::format::Surrogate]| tops.clone();
    let top = crate::format::Top { nodes, bricks: &mut bricks, materials: &[], strings: &[], surrogates };
    writer.finish(header, top).unwrap();
}

#[test]
fn too_small_a_cache_is_told_with_the_least() {
    let (_folder, path, _) = sample();
    let least = Octree::least_cache(&path).unwrap();
    let error = Octree::open_with(&path, Read::Budgeted { cache: least - 1 }).err().unwrap();
    assert!(error.kind() == Kind::Input && error.to_string().contains(&least.to_string()), "{error}");
}

#[test]
fn a_damaged_page_is_named_at_every_use() {
    let (_folder, path, pages) = sample();
    let mut bytes = fs::read(&path).unwrap();
    let octree = Octree::open(&path).unwrap();
    bytes[octree.records()[5].offset as usize + 200] ^= 1;
    drop(octree);
    fs::write(&path, &bytes).unwrap();
    let octree = budgeted(&path, 1);
    for _ in 0..2 {
        let error = octree.with_page(PageId(5), |_| ()).unwrap_err();
        assert!(error.kind() == Kind::Damaged && error.to_string().contains("page 5: its checksum"), "{error}");
        assert!(octree.with_page(PageId(4), |page| page.bytes() == pages[4]).unwrap());
    }
    assert!(octree.with_page(PageId(8), |_| ()).is_err_and(|e| e.kind() == Kind::Damaged));
}

#[test]
fn a_file_cut_short_between_two_pages_is_told() {
    let (_folder, path, pages) = sample();
    let octree = budgeted(&path, 1);
    assert!(octree.with_page(PageId(0), |page| page.bytes() == pages[0]).unwrap());
    fs::OpenOptions::new().write(true).open(&path).unwrap().set_len(octree.records()[3].offset + 100).unwrap();
    assert!(octree.with_page(PageId(2), |page| page.bytes() == pages[2]).unwrap());
    let error = octree.with_page(PageId(3), |_| ()).unwrap_err();
    let said = error.to_string();
    assert!(
        error.kind() == Kind::Damaged && said.contains("page 3") && said.contains("cut short while in use"),
        "{said}"
    );
}

#[test]
fn a_read_error_names_the_page() {
    let (_folder, path, _) = sample();
    let octree = Octree::open(&path).unwrap();
    // The system refuses to read from a file that was opened for writing.
    let file = fs::OpenOptions::new().write(true).open(&path).unwrap();
    let cache = Cache::new(path.clone(), file, octree.header(), octree.records(), 1 << 20).unwrap();
    let ticket = cache.ask(6, 1);
    cache.wait(std::iter::once(&ticket));
    let error = ticket.check().unwrap_err();
    assert!(error.kind() == Kind::Machine && error.to_string().contains("page 6: "), "{error}");
    assert!(error.to_string().contains("cannot read"), "{error}");
}

/// Loaders take first what most rays wait for.
#[test]
fn what_more_rays_wait_for_comes_first() {
    let (_folder, path, _) = sample();
    let octree = Octree::open(&path).unwrap();
    let core = {
        let file = File::open(&path).unwrap();
        let mut cache = Cache::new(path, file, octree.header(), octree.records(), 1 << 20).unwrap();
        cache.core.desk().stop = true;
        cache.core.work.notify_all();
        cache.loaders.drain(..).for_each(|loader| loader.join().unwrap());
        cache.core.clone()
    };
    let mut desk = core.desk();
    let mut order = Vec::new();
    assert!(desk.ask(&core, 1, 10) && desk.ask(&core, 2, 30) && desk.ask(&core, 3, 20) && !desk.ask(&core, 1, 15));
    while let desk::Task::Load { page, known } = desk.next(&core) {
        assert!(!known);
        core.arena.fill(page as usize).unwrap().finish();
        desk.loaded(&core, page);
        order.push(page);
        if order.len() == 1 {
            // Younger, with a few rays more than page 3, which has waited longer.
            assert!(desk.ask(&core, 4, 21));
        }
    }
    assert_eq!(order, [2, 1, 3, 4]);
    assert!(octree.header().section(SectionKind::Pages).is_some());
}
