//! Files written, read back, and damaged in every way.

mod lies;

use std::fs;
use std::path::{Path, PathBuf};

use super::sample::{MATERIALS, Sample, random};
use super::*;
use crate::error::Kind;
use crate::event::Monitor;
use crate::format::{PAGE_HEADER_BYTES, PageHeader, Slot};
use crate::format::{PageRecord, checksum, validate_page};
use crate::geometry::{FaceId, Triangle};

const ALL: u32 = Flags::IDS | Flags::MATERIALS | Flags::NORMALS | Flags::TEXCOORDS | Flags::DETAIL;

/// A folder that goes away, and a file in it.
fn scratch() -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("sample.oct");
    (folder, path)
}

fn bits(t: &Triangle) -> [[u32; 3]; 3] {
    t.vertices().map(|v| v.to_array().map(f32::to_bits))
}

/// Calls `visit` for each triangle that the nodes of a page lead to: with its reference and itself.
fn visit(page: &Page<'_>, unit: LeafUnit, mut visit: impl FnMut(u32, Triangle)) {
    for (i, node) in page.nodes().iter().enumerate().filter(|(_, node)| node.first_leaf != 0) {
        for &byte in &node.slots {
            if let Some(Slot::Leaf(offset)) = Slot::decode(byte) {
                let units = 16 * node.first_leaf as usize + usize::from(offset) * unit.bytes();
                let leaf = page.leaf(PAGE_HEADER_BYTES + 64 * i + units);
                (0..leaf.len()).for_each(|j| visit(leaf.first().wrapping_add(j as u32), leaf.triangle(j)));
            }
        }
    }
}

/// The samples that between them have every feature.
fn samples() -> Vec<Sample> {
    let extra = [
        0,
        Flags::STEPS,
        Flags::STEPS | Flags::LEAF_UNIT_32,
        Flags::LEAF_UNIT_32,
        Flags::WIDE_MATERIALS,
        Flags::WIDE_MATERIALS | Flags::LEAF_UNIT_32,
    ];
    let mut list: Vec<_> = extra.iter().map(|&e| Sample::new(300, ALL | e, 5)).collect();
    list.push(Sample::new(300, ALL | Flags::REPEATS, 3));
    list.extend([1, 2, 7].map(|n| Sample::new(n, ALL, 1)));
    list.extend([Sample::new(64, 0, 1), Sample::new(400, Flags::LEAF_UNIT_32, 8), Sample::new(500, Flags::IDS, 1)]);
    list
}

#[test]
fn everything_written_is_read() {
    for sample in samples() {
        let (_folder, path) = scratch();
        let length = sample.write(&path);
        assert_eq!(fs::metadata(&path).unwrap().len(), length);
        let octree = Octree::open(&path).unwrap();
        let (materials, strings) = sample.materials();
        assert_eq!(octree.header().dropped.too_few_corners, 7);
        assert_eq!(octree.header().file_bytes, length);
        assert_eq!(octree.materials(), &materials[..]);
        assert_eq!(octree.top_nodes().len(), usize::from(sample.bricks > 1));
        if !materials.is_empty() {
            assert_eq!(octree.string(materials[0].name), "Glas");
            assert_eq!(octree.string(materials[2].map_kd), &strings[4..8]);
        }
        let mut met = vec![false; sample.triangles.len()];
        let visited = octree.visit();
        for brick in 0..sample.bricks {
            let page = visited.page(PageId(brick as u32)).unwrap();
            visit(&page, octree.leaf_unit(), |reference, triangle| {
                if !sample.flags.has(Flags::IDS) {
                    met[page.face(reference).0 as usize] = true;
                    return;
                }
                let i = page.face(reference).0;
                assert!(!std::mem::replace(&mut met[i as usize], true) || sample.flags.has(Flags::REPEATS));
                assert_eq!(bits(&triangle), bits(&sample.triangles[i as usize]));
                let given = sample.flags.has(ALL);
                assert_eq!(page.material(reference), if given { Sample::material(i) } else { 0 });
                assert_eq!(page.normals(reference), Sample::normals(i).filter(|_| given));
                assert_eq!(page.texcoords(reference), Sample::texcoords(i).filter(|_| given));
            });
            assert_eq!(page.face(u32::MAX), FaceId::NONE);
        }
        assert!(met.iter().all(|&m| m));
        octree.verify(Monitor::silent()).unwrap();
        let parts = octree.parts(Monitor::silent()).unwrap();
        let count: u64 = parts.leaves_by_triangles.iter().zip(0..).map(|(leaves, n)| leaves * n).sum();
        assert_eq!(count, octree.header().references);
        assert!(parts.padding < length / 2 && parts.leaf_vertices >= 30 * parts.leaves_by_triangles[1]);
    }
}

#[test]
fn pages_of_many_references_are_aligned() {
    let (_folder, path) = scratch();
    Sample::new(40_000, Flags::LEAF_UNIT_32, 2).write(&path);
    let octree = Octree::open(&path).unwrap();
    assert!(octree.records().iter().all(|r| r.offset.is_multiple_of(4096)));
    octree.verify(Monitor::silent()).unwrap();
}

/// Opens and verifies; the error, if there is one.
fn fate(path: &Path) -> Option<Error> {
    Octree::open(path).and_then(|octree| octree.verify(Monitor::silent())).err()
}

#[test]
fn every_flipped_bit_is_noticed() {
    let (_folder, path) = scratch();
    Sample::new(24, ALL, 2).write(&path);
    let sound = fs::read(&path).unwrap();
    assert!(fate(&path).is_none());
    // Of the header's long run of zeros, which one checksum covers, some bytes stand for all.
    for i in (0..sound.len()).filter(|i| !(800..4080).contains(i) || i % 13 == 0) {
        let mut bytes = sound.clone();
        bytes[i] ^= 1 << (i % 8);
        fs::write(&path, &bytes).unwrap();
        let error = fate(&path).unwrap_or_else(|| panic!("byte {i} of {} does not matter", sound.len()));
        assert!(matches!(error.kind(), Kind::Damaged | Kind::Input), "{error}");
        assert!(error.kind() == Kind::Damaged || i < 16, "{i}: {error}");
    }
}

#[test]
fn every_shortened_file_is_noticed() {
    let (_folder, path) = scratch();
    Sample::new(24, ALL, 2).write(&path);
    let sound = fs::read(&path).unwrap();
    for length in (0..64).chain((64..sound.len()).step_by(61)).chain([sound.len() - 1]) {
        fs::write(&path, &sound[..length]).unwrap();
        let error = fate(&path).unwrap();
        assert_eq!(error.kind(), if length < 4 { Kind::Input } else { Kind::Damaged }, "{length}: {error}");
    }
    fs::write(&path, [&sound[..], &[0]].concat()).unwrap();
    assert_eq!(fate(&path).unwrap().kind(), Kind::Damaged);
}

#[test]
fn other_files_are_named_for_what_they_are() {
    let (folder, path) = scratch();
    let message = |bytes: &[u8]| {
        fs::write(&path, bytes).unwrap();
        let error = fate(&path).unwrap();
        (error.kind(), error.to_string())
    };
    let (kind, text) = message(b"v 0 0 0\nf 1 1 1\n");
    assert!(kind == Kind::Input && text.contains("build one with octbuild"), "{text}");
    assert!(message(b"").1.contains("an empty file"));
    assert!(message(b"\x09OCT\n\n and so on").1.contains("as if it were text"));
    Sample::new(3, 0, 1).write(&path);
    let mut newer = fs::read(&path).unwrap();
    newer[8] = 2;
    let (kind, text) = message(&newer);
    assert!(kind == Kind::Input && text.contains("version 2") && text.contains("version 1"), "{text}");
    assert_eq!(Octree::open(folder.path()).err().unwrap().kind(), Kind::Input);
    assert_eq!(Octree::open(&folder.path().join("none.oct")).err().unwrap().kind(), Kind::Input);
}

/// Puts right the checksums of sections and header, so that only the rules themselves stand between damage and use.
fn repair(bytes: &mut [u8]) {
    let mut header: Header = bytemuck::pod_read_unaligned(&bytes[..4096]);
    for section in &mut header.sections {
        let (begin, end) = (section.offset as usize, section.offset.saturating_add(section.bytes) as usize);
        section.checksum = bytes.get(begin..end).filter(|_| section.kind != 0).map_or(0, checksum);
    }
    bytes[..4096].copy_from_slice(bytemuck::bytes_of(&header));
    let sum = checksum(&bytes[..4088]);
    bytes[4088..4096].copy_from_slice(&sum.to_le_bytes());
}

#[test]
fn no_header_or_top_makes_a_reader_panic() {
    let (_folder, path) = scratch();
    Sample::new(60, ALL, 4).write(&path);
    let sound = fs::read(&path).unwrap();
    let header: Header = bytemuck::pod_read_unaligned(&sound[..4096]);
    let top = header.sections[0].offset as usize;
    let mut state = 7;
    let mut opened = 0;
    for _ in 0..4000 {
        let mut bytes = sound.clone();
        for _ in 0..1 + random(&mut state) % 3 {
            let place = match random(&mut state) % 2 {
                0 => random(&mut state) as usize % 420,
                _ => top + random(&mut state) as usize % (sound.len() - top),
            };
            bytes[place] = mutate(bytes[place], &mut state);
        }
        repair(&mut bytes);
        fs::write(&path, &bytes).unwrap();
        if let Ok(octree) = Octree::open(&path) {
            opened += 1;
            let _ = octree.verify(Monitor::silent());
            let _ = octree.parts(Monitor::silent());
        }
    }
    assert!(opened > 100, "{opened}");
}

/// Another value for a byte: a flipped bit, an extreme, a neighbour, anything.
fn mutate(byte: u8, state: &mut u64) -> u8 {
    let other = random(state) as u8;
    match random(state) % 4 {
        0 => byte ^ 1 << (other % 8),
        1 => [0, 0x7f, 0x80, 0xff][usize::from(other % 4)],
        2 => byte.wrapping_add(other % 5).wrapping_sub(2),
        _ => other,
    }
}

#[test]
fn no_page_makes_a_reader_panic() {
    let (_folder, path) = scratch();
    for (flags, rounds) in [
        (ALL, 60_000),
        (ALL | Flags::LEAF_UNIT_32 | Flags::WIDE_MATERIALS, 60_000),
        (Flags::IDS | Flags::STEPS, 60_000),
        (Flags::IDS | Flags::STEPS | Flags::LEAF_UNIT_32, 60_000),
    ] {
        Sample::new(70, flags, 1).write(&path);
        let octree = Octree::open(&path).unwrap();
        let (record, brick) = (octree.records()[0], octree.bricks()[0]);
        let sound: Vec<Node> = bytemuck::cast_slice(octree.visit().page(PageId(0)).unwrap().bytes()).to_vec();
        let (mut state, mut passed) = (3, 0);
        for _ in 0..rounds {
            let mut memory = sound.clone();
            let bytes: &mut [u8] = bytemuck::cast_slice_mut(&mut memory);
            for _ in 0..1 + random(&mut state) % 4 {
                // The header and the nodes are few bytes among many, so they are aimed at.
                let reach =
                    [64, 64 * (1 + octree.header().nodes as usize), bytes.len()][random(&mut state) as usize % 3];
                let place = random(&mut state) as usize % reach;
                bytes[place] = mutate(bytes[place], &mut state);
            }
            let checked = validate_page(bytes, PageId(0), &record, octree.flags(), MATERIALS, 72);
            let page = Page::new(bytes, &brick, octree.flags());
            // Sound or not, reading must not panic; if it is sound, what is read must make sense.
            let mut count = 0;
            visit(&page, octree.leaf_unit(), |reference, triangle| {
                count += 1;
                let (face, material) = (page.face(reference), page.material(reference));
                let _ = (page.normals(reference), page.texcoords(reference), page.surrogates());
                assert!(checked.is_err() || (face.0 < 72 && material <= MATERIALS && triangle.is_finite()));
            });
            assert!(checked.is_err() || count == record.references);
            passed += u32::from(checked.is_ok());
        }
        assert!(passed > rounds / 100 && passed < rounds, "{passed}");
    }
}

#[test]
fn validation_names_the_broken_rule() {
    let (_folder, path) = scratch();
    Sample::new(70, ALL, 1).write(&path);
    let octree = Octree::open(&path).unwrap();
    let record = octree.records()[0];
    let visited = octree.visit();
    let page = visited.page(PageId(0)).unwrap();
    let (h, node) = (*page.header(), PAGE_HEADER_BYTES);
    let complaint = |place: usize, value: &[u8]| {
        let mut memory: Vec<Node> = bytemuck::cast_slice(page.bytes()).to_vec();
        bytemuck::cast_slice_mut::<_, u8>(&mut memory)[place..place + value.len()].copy_from_slice(value);
        let bytes: &[u8] = bytemuck::cast_slice(&memory);
        validate_page(bytes, PageId(0), &record, octree.flags(), MATERIALS, 72).unwrap_err()
    };
    let leaf = h.leaf_offset as usize;
    for (place, value, what) in [
        (0, &[1][..], "another page's number"),
        (4, &[0, 0, 0, 0], "no node"),
        (20, &[1], "leaves hold"),
        (24, &[0, 0, 0, 0], "ids are missing"),
        (60, &[1], "unused bytes"),
        (node, &[255], "node 0: the planes"),
        (node + 48, &[200], "node 0: an inner child"),
        (node + 63, &[0xc0], "node 0: a slot byte"),
        (node + 56, &[0x87], "node 0: an inner child"),
        (leaf, &[9], "is not the sum"),
        (leaf + 4, &[17], "the record breaks a rule"),
        (leaf + 8, &[0xff], "the record breaks a rule"),
        (leaf + 32, &f32::NAN.to_le_bytes(), "the record breaks a rule"),
        (h.leaf_end() as usize + 5, &[1], "padding"),
        (h.ids as usize, &72u32.to_le_bytes(), "a face id"),
        (h.materials as usize, &[4], "names no material"),
        (h.normal_corners as usize, &h.normal_count.to_le_bytes(), "a normal corner"),
        (h.texcoord_corners as usize, &h.texcoord_count.to_le_bytes(), "a texture corner"),
        (56, &[0, 0, 0, 0], "surrogates are missing"),
        (h.surrogates as usize + 31, &[1], "unused byte of a surrogate"),
    ] {
        let said = complaint(place, value);
        assert!(said.contains(what), "byte {place}: {said:?}, not {what:?}");
    }
}

#[cfg(unix)]
#[test]
fn a_file_cut_short_while_mapped_is_an_error() {
    let (_folder, path) = scratch();
    let length = Sample::new(5000, ALL, 4).write(&path);
    let octree = Octree::open(&path).unwrap();
    let visited = octree.visit();
    let checked = visited.page(PageId(1)).unwrap();
    fs::OpenOptions::new().write(true).open(&path).unwrap().set_len(length / 16).unwrap();
    octree.fault().unwrap(); // Not yet noticed.
    let mut count = 0;
    visit(&checked, octree.leaf_unit(), |reference, _| count += u32::from(checked.face(reference) != FaceId::NONE));
    assert!(count < checked.header().references.max(1));
    let said = octree.fault().unwrap_err();
    assert!(said.kind() == Kind::Damaged && said.to_string().contains("cut short while in use"), "{said}");
    for id in (0..5).map(PageId) {
        if let Ok(page) = visited.page(id) {
            visit(&page, octree.leaf_unit(), |reference, _| _ = page.normals(reference));
        }
    }
    assert!(visited.page(PageId(3)).is_err());
    assert!(octree.verify(Monitor::silent()).is_err());
    assert!(octree.parts(Monitor::silent()).is_err());
    // A new mapping begins with a clean slate.
    drop(visited);
    drop(octree);
    Sample::new(50, ALL, 4).write(&path);
    let octree = Octree::open(&path).unwrap();
    octree.verify(Monitor::silent()).unwrap();
    octree.fault().unwrap();
}

#[test]
fn files_without_level_of_detail_say_so() {
    let (_folder, path) = scratch();
    Sample::new(60, ALL & !Flags::DETAIL, 2).write(&path);
    let octree = Octree::open(&path).unwrap();
    assert!(octree.detail().unwrap().is_none() && octree.detail_bytes() == 0);
    assert!(octree.visit().page(PageId(0)).unwrap().surrogates().is_empty());
}

#[test]
fn a_stopped_check_says_so() {
    let (_folder, path) = scratch();
    Sample::new(60, ALL, 2).write(&path);
    let stop = std::sync::atomic::AtomicBool::new(true);
    let outcome = Octree::open(&path).unwrap().verify(Monitor::new(&|_| {}, &stop));
    assert!(matches!(outcome, Err(Error::Interrupted)));
}
