//! Pages that come and go, however small the cache.

use std::fs;
use std::path::PathBuf;

use super::*;
use crate::error::Kind;
use crate::format::{PageId, SectionKind};
use crate::map::sample::{Sample, random};
use crate::map::{Octree, Pages, Read};

/// A file of eight pages, and what its pages hold.
fn sample() -> (tempfile::TempDir, PathBuf, Vec<Vec<u8>>) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("sample.oct");
    Sample::new(if cfg!(miri) { 100 } else { 3000 }, Flags::IDS, 8).write(&path);
    // Miri maps no files.
    let octree = if cfg!(miri) { budgeted(&path, 8) } else { Octree::open(&path).unwrap() };
    let pages = (0..8).map(|i| octree.with_page(PageId(i), |page| page.bytes().to_vec()).unwrap()).collect();
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
    const TIMES: u64 = if cfg!(miri) { 10 } else { 300 };
    std::thread::scope(|scope| {
        for thread in 0..4u64 {
            let (octree, pages) = (&octree, &pages);
            scope.spawn(move || {
                let mut state = thread;
                for _ in 0..TIMES {
                    let i = random(&mut state) % 8;
                    assert!(octree.with_page(PageId(i as u32), |page| page.bytes() == pages[i as usize]).unwrap());
                }
            });
        }
    });
    let figures = octree.figures();
    assert!(
        figures.most_bytes <= 2 * Octree::least_cache(&path).unwrap() && figures.entered == 4 * TIMES,
        "{figures:?}"
    );
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
    let cut = octree.records()[3].offset + 100;
    fs::OpenOptions::new().write(true).open(&path).unwrap().set_len(cut).unwrap();
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
    let cache = Cache::new(path.clone(), file, octree.header(), 1 << 20).unwrap();
    let ticket = cache.ask(6, 1);
    cache.wait(std::iter::once(&ticket));
    let error = ticket.check().unwrap_err();
    assert!(error.kind() == Kind::Machine && error.to_string().contains("page 6: "), "{error}");
    assert!(error.to_string().contains("cannot read"), "{error}");
}

/// A loader that breaks down tells those who wait, and goes on with other pages.
#[test]
fn nobody_waits_for_ever_for_a_loader_that_broke_down() {
    let (_folder, path, pages) = sample();
    let octree = budgeted(&path, 1);
    let Pages::Cached(cache) = &octree.pages else { unreachable!() };
    cache.core.trap.store(2 + 1, Ordering::Relaxed);
    let error = octree.with_page(PageId(2), |_| ()).unwrap_err().to_string();
    assert!(error.contains("page 2: checking it failed"), "{error}");
    for i in [1, 3, 4, 5] {
        assert!(octree.with_page(PageId(i), |page| page.bytes() == pages[i as usize]).unwrap());
    }
}

/// What a packed page says that it is stored as must not make a loader take more memory than there is.
#[cfg(unix)]
#[test]
fn a_packed_page_that_would_take_a_gigabyte_is_refused() {
    let (_folder, path, _) = sample();
    let packed = path.with_file_name("packed.oct");
    pack(&path, &packed);
    let mut bytes = fs::read(&packed).unwrap();
    let mut header: Header = bytemuck::pod_read_unaligned(&bytes[..4096]);
    // The last page, and all behind it, lies a gigabyte further on.
    let octree = Octree::open(&packed).unwrap();
    let mut records = octree.records().to_vec();
    drop(octree);
    let (top, last) = (header.sections[0].offset, records.len() - 1);
    let moved = (1u64 << 30) - (top - records[last].offset);
    records[last].stored_bytes += moved as u32 / 64 * 64;
    let end = (records[last].offset + u64::from(records[last].stored_bytes)).next_multiple_of(64);
    let mut tail = bytes.split_off(top as usize);
    let mut place = header.section(SectionKind::Pages).unwrap().offset - top;
    for record in &records {
        tail[place as usize..place as usize + 32].copy_from_slice(bytemuck::bytes_of(record));
        place += 32;
    }
    header.sections.iter_mut().filter(|s| s.kind != 0).for_each(|section| {
        let begin = (section.offset - top) as usize;
        section.checksum = crate::format::checksum(&tail[begin..begin + section.bytes as usize]);
        section.offset += end - top;
    });
    header.file_bytes += end - top;
    header.checksum = crate::format::checksum(&bytemuck::bytes_of(&header)[..4088]);
    bytes[..4096].copy_from_slice(bytemuck::bytes_of(&header));
    fs::write(&packed, &bytes).unwrap();
    let file = fs::OpenOptions::new().write(true).open(&packed).unwrap();
    file.set_len(end).unwrap();
    std::os::unix::fs::FileExt::write_all_at(&file, &tail, end).unwrap();
    let octree = budgeted(&packed, 1);
    let error = octree.with_page(PageId(last as u32), |_| ()).unwrap_err().to_string();
    assert!(error.contains("the lengths break a rule"), "{error}");
    assert!(octree.with_page(PageId(0), |_| ()).is_ok() && octree.verify(crate::event::Monitor::silent()).is_err());
}

/// Loaders take first what most rays wait for.
#[test]
fn what_more_rays_wait_for_comes_first() {
    let (_folder, path, _) = sample();
    let octree = Octree::open(&path).unwrap();
    let core = {
        let file = File::open(&path).unwrap();
        let mut cache = Cache::new(path, file, octree.header(), 1 << 20).unwrap();
        cache.core.desk().stop = true;
        cache.core.work.notify_all();
        cache.loaders.drain(..).for_each(|loader| loader.join().unwrap());
        cache.core.clone()
    };
    let mut desk = core.desk();
    let mut order = Vec::new();
    assert!(desk.ask(&core, 1, 10) && desk.ask(&core, 2, 30) && desk.ask(&core, 3, 20) && !desk.ask(&core, 1, 15));
    while let desk::Task::Load(page) = desk.next(&core) {
        core.arena.fill(page as usize).unwrap().finish(64);
        desk.loaded(&core, page, desk::Loaded { stored: 64, again: false });
        order.push(page);
        if order.len() == 1 {
            // Younger, with a few rays more than page 3, which has waited longer.
            assert!(desk.ask(&core, 4, 21));
        }
    }
    assert_eq!(order, [2, 1, 3, 4]);
    assert!(octree.header().section(SectionKind::Pages).is_some());
}
