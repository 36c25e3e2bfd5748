//! Octree files that lie: whole ones changed where it hurts, nine in ten of them with every checksum made right again.

use octrace::format::{HEADER_BYTES, MAGIC, VERSION};

use super::random::Random;

/// Where the header's fields are that this needs; see FORMAT.md.
const FILE_BYTES: usize = 16;
const PAGES: usize = 72;
const FLAGS: usize = 12;
const SECTIONS: usize = 256;
const PACKED: u32 = 1;

fn u32_at(bytes: &[u8], at: usize) -> u32 {
    bytes.get(at..).and_then(|b| b.first_chunk()).map_or(0, |b| u32::from_le_bytes(*b))
}

fn u64_at(bytes: &[u8], at: usize) -> u64 {
    bytes.get(at..).and_then(|b| b.first_chunk()).map_or(0, |b| u64::from_le_bytes(*b))
}

fn put(bytes: &mut [u8], at: usize, value: &[u8]) {
    if let Some(place) = bytes.get_mut(at..).and_then(|b| b.get_mut(..value.len())) {
        place.copy_from_slice(value);
    }
}

fn checksum(bytes: &[u8]) -> u64 {
    xxhash_rust::xxh3::xxh3_64(bytes)
}

/// A section: where its directory entry lies, kind, offset, bytes.
fn sections(bytes: &[u8]) -> Vec<(usize, u32, usize, usize)> {
    let entry = |i: usize| {
        let at = SECTIONS + 32 * i;
        (at, u32_at(bytes, at), u64_at(bytes, at + 8) as usize, u64_at(bytes, at + 16) as usize)
    };
    (0..16).map(entry).filter(|x| x.1 != 0).collect()
}

/// A page: where its record lies, offset, stored bytes.
fn pages(bytes: &[u8]) -> Vec<(usize, usize, usize)> {
    let Some(&(_, _, first, length)) = sections(bytes).iter().find(|x| x.1 == 3) else { return Vec::new() };
    let count = (u32_at(bytes, PAGES) as usize).min(length / 32).min(1 << 16);
    let record = |i: usize| {
        let at = first.saturating_add(32 * i);
        (at, u64_at(bytes, at) as usize, u32_at(bytes, at.saturating_add(16)) as usize)
    };
    (0..count).map(record).collect()
}

/// Makes every checksum right that can be: of pages, sections and header.
pub fn repair(bytes: &mut [u8]) {
    for (record, offset, length) in pages(bytes) {
        let sum = offset.checked_add(length).and_then(|end| bytes.get(offset..end)).map(checksum);
        if let Some(sum) = sum {
            put(bytes, record.saturating_add(8), &sum.to_le_bytes());
        }
    }
    for (entry, _, offset, length) in sections(bytes) {
        let sum = offset.checked_add(length).and_then(|end| bytes.get(offset..end)).map(checksum);
        if let Some(sum) = sum {
            put(bytes, entry + 24, &sum.to_le_bytes());
        }
    }
    if bytes.len() >= HEADER_BYTES {
        let sum = checksum(&bytes[..HEADER_BYTES - 8]);
        put(bytes, HEADER_BYTES - 8, &sum.to_le_bytes());
    }
}

/// Whether magic, version, length and all checksums are right, as far as sections and pages can be found: only checks of content are left.
pub fn passes(bytes: &[u8]) -> bool {
    let right = |offset: usize, length: usize, sum: u64| {
        offset.checked_add(length).and_then(|end| bytes.get(offset..end)).is_some_and(|b| checksum(b) == sum)
    };
    bytes.len() >= HEADER_BYTES
        && bytes[..8] == MAGIC
        && u32_at(bytes, 8) == VERSION
        && u64_at(bytes, FILE_BYTES) == bytes.len() as u64
        && right(0, HEADER_BYTES - 8, u64_at(bytes, HEADER_BYTES - 8))
        && sections(bytes).iter().all(|&(at, _, offset, length)| right(offset, length, u64_at(bytes, at + 24)))
        && pages(bytes).iter().all(|&(at, offset, length)| right(offset, length, u64_at(bytes, at.saturating_add(8))))
}

/// The same file with its pages packed; `bytes` may hold any nonsense in them. `None` where no pages can be found.
pub fn packed(bytes: &[u8]) -> Option<Vec<u8>> {
    if u32_at(bytes, FLAGS) & PACKED != 0 {
        return None;
    }
    let mut file = bytes.get(..HEADER_BYTES)?.to_vec();
    let align = |file: &mut Vec<u8>| file.resize(file.len().next_multiple_of(64), 0);
    let mut places = Vec::new();
    for (_, offset, length) in pages(bytes) {
        let stored = zstd::bulk::compress(bytes.get(offset..offset.checked_add(length)?)?, 1).ok()?;
        align(&mut file);
        places.push((file.len() as u64, stored.len() as u32));
        file.extend(stored);
    }
    let flags = u32_at(bytes, FLAGS) | PACKED;
    put(&mut file, FLAGS, &flags.to_le_bytes());
    for (entry, kind, offset, length) in sections(bytes) {
        align(&mut file);
        let first = file.len();
        file.extend(bytes.get(offset..offset.checked_add(length)?)?);
        put(&mut file, entry + 8, &(first as u64).to_le_bytes());
        for (i, (page, stored)) in places.iter().enumerate() {
            match kind {
                2 => put(&mut file, first + 32 * i, &[0; 4]),
                3 => {
                    put(&mut file, first + 32 * i, &page.to_le_bytes());
                    put(&mut file, first + 32 * i + 16, &stored.to_le_bytes());
                }
                _ => {}
            }
        }
    }
    let length = file.len() as u64;
    put(&mut file, FILE_BYTES, &length.to_le_bytes());
    Some(file)
}

/// All fields, as places and sizes: words of the header and its directory, of all sections, and of the first and the last page.
pub fn fields(bytes: &[u8]) -> Vec<(usize, usize)> {
    let (pages, mut fields) = (pages(bytes), Vec::new());
    let words = |first: usize, length: usize| (first..first + length).step_by(4);
    let mut all: Vec<usize> = words(8, SECTIONS + 32 * 8 - 8).collect();
    sections(bytes).iter().for_each(|&(_, _, offset, length)| all.extend(words(offset, length & !3)));
    for &(_, offset, length) in [pages.first(), pages.last()].into_iter().flatten() {
        all.extend(words(offset, length & !3));
    }
    fields.extend(all.iter().map(|&at| (at, 4)));
    // Offsets and lengths are eight bytes: those of the header, of the directory and of the page records.
    let records = pages.iter().map(|page| page.0);
    let entries = sections(bytes).into_iter().flat_map(|entry| [entry.0 + 8, entry.0 + 16]);
    fields.extend(words(FILE_BYTES, 56).step_by(2).chain(entries).chain(records).map(|at| (at, 8)));
    // Slots and the like are bytes: of the first nodes.
    fields.extend(pages.first().into_iter().flat_map(|page| page.1 + 64..page.1 + 192).map(|at| (at, 1)));
    fields
}

/// What a field is set to: 0, 1, the most, the most and one more that there are, what lies beside what was there, and, where it can hold an
/// offset, where others lie.
pub fn values(bytes: &[u8], at: usize, size: usize) -> Vec<u64> {
    let old = match size {
        1 => bytes[at].into(),
        4 => u32_at(bytes, at).into(),
        _ => u64_at(bytes, at),
    };
    let most = u64::MAX >> (64 - 8 * size);
    let pages = u64::from(u32_at(bytes, PAGES));
    let length = bytes.len() as u64;
    let mut values =
        vec![0, 1, most, most - 1, most / 2 + 1, old.wrapping_add(1), old.wrapping_sub(1), pages, pages + 1];
    if size > 1 {
        values.extend([
            length,
            length + 1,
            length & !63,
            u64::from(f32::NAN.to_bits()),
            u64::from((-1.0f32).to_bits()),
        ]);
    }
    if size == 8 {
        values.extend(sections(bytes).iter().map(|x| x.2 as u64));
        values.extend([self::pages(bytes)[0].1 as u64, u64::MAX - 63, 1 << 63, HEADER_BYTES as u64 - 64]);
    }
    values.iter_mut().for_each(|value| *value &= most);
    values.sort_unstable();
    values.dedup();
    values.retain(|&value| value != old);
    values
}

/// Where header, pages and sections end.
pub fn borders(bytes: &[u8]) -> Vec<usize> {
    let pages = pages(bytes).into_iter().flat_map(|page| [page.1, page.1 + page.2]);
    let sections = sections(bytes).into_iter().flat_map(|x| [x.2, x.2 + x.3]);
    let mut all: Vec<usize> = [8, SECTIONS, HEADER_BYTES].into_iter().chain(pages).chain(sections).collect();
    all.sort_unstable();
    all.dedup();
    all
}

/// Makes the header of a file that was cut say how long it is now, with checksums that are right.
pub fn shorten(bytes: &mut [u8]) {
    let length = bytes.len() as u64;
    put(bytes, FILE_BYTES, &length.to_le_bytes());
    repair(bytes);
}

/// Where in the file something of interest lies: its first byte, its length, and the size of its fields.
fn place(bytes: &[u8], random: &mut Random) -> (usize, usize) {
    let sections = sections(bytes);
    let pages = pages(bytes);
    let within = |first: usize, length: usize| (first.min(bytes.len()), length.min(bytes.len().saturating_sub(first)));
    match random.below(8) {
        0 => within(0, 256),
        1 => within(SECTIONS, 32 * 8),
        2 | 3 if !sections.is_empty() => {
            let &(_, _, first, length) = random.one_of(&sections);
            within(first, length)
        }
        4 | 5 if !pages.is_empty() => within(random.one_of(&pages).1, 64),
        6 if !pages.is_empty() => {
            // Nodes.
            let first = random.one_of(&pages).1;
            within(first.saturating_add(64), 64 * (u32_at(bytes, first.saturating_add(4)) as usize & 0xff_ffff))
        }
        7 if !pages.is_empty() => {
            // Leaves and what follows.
            let &(_, first, length) = random.one_of(&pages);
            let leaves = u32_at(bytes, first.saturating_add(8)) as usize;
            within(first.saturating_add(leaves), length.saturating_sub(leaves))
        }
        _ => (0, bytes.len()),
    }
}

/// A value that breaks things.
fn value(bytes: &[u8], random: &mut Random, old: u64) -> u64 {
    let most = u64::from(u32_at(bytes, PAGES));
    let length = bytes.len() as u64;
    let interesting = [0, 1, 2, 63, 64, 0x7f, 0x80, 0xc0, 0xff, 0x7fff_ffff, 0x8000_0000, 0xffff_ffff, 0xffff_ffc0];
    match random.below(9) {
        0 | 1 => *random.one_of(&interesting),
        2 => old.wrapping_add(1),
        3 => old.wrapping_sub(1),
        4 => *random.one_of(&[
            most,
            most + 1,
            most.wrapping_sub(1),
            length,
            length + 1,
            length - 1,
            length / 64,
            length & !63,
        ]),
        5 => old ^ 1 << random.below(64),
        6 => *random.one_of(&[u64::MAX, u64::MAX - 63, 1 << 63, 1 << 32, (1 << 32) - 64, 1 << 40]),
        7 => u64::from(random.one_of(&[f32::NAN, f32::INFINITY, -1.0, 1e-45, 3.4e38, -0.0, 0.5]).to_bits()),
        _ => random.bits() >> random.below(64),
    }
}

/// Changes a file in one to eight places; `true` if all checksums were made right afterwards.
pub fn mutate(file: &mut Vec<u8>, random: &mut Random) -> bool {
    for _ in 0..1 + random.below(4) + random.below(5) * random.below(2) {
        if file.is_empty() {
            break;
        }
        let (first, length) = place(file, random);
        if length == 0 {
            continue;
        }
        match random.below(12) {
            0 => {
                let at = first + random.below(length);
                file[at] ^= 1 << random.below(8);
            }
            1 => {
                let at = first + random.below(length);
                file[at] = random.bits() as u8;
            }
            2..=5 => {
                let at = (first + random.below(length)) & !3;
                let new = value(file, random, u32_at(file, at).into()) as u32;
                put(file, at, &new.to_le_bytes());
            }
            6 | 7 => {
                let at = (first + random.below(length)) & !7;
                let new = value(file, random, u64_at(file, at));
                put(file, at, &new.to_le_bytes());
            }
            8 | 9 => {
                // One record over another of its kind.
                let size = *random.one_of(&[16, 32, 64, 80]);
                let place = |random: &mut Random| first + random.below(length) / size * size;
                let (from, to) = (place(random), place(random));
                if let Some(record) = file.get(from..from + size).map(<[u8]>::to_vec) {
                    put(file, to, &record);
                }
            }
            10 => {
                let end = first + random.below(length);
                file[first..end].iter_mut().for_each(|b| *b = 0);
            }
            _ => {
                let cut = if random.once_in(2) { first + random.below(length) } else { random.below(file.len()) };
                match random.below(3) {
                    0 => file.truncate(cut),
                    1 => {
                        file.drain(cut..(cut + 64).min(file.len()));
                    }
                    _ => {
                        let extra = file[..cut].iter().rev().take(128).copied().collect::<Vec<_>>();
                        file.splice(cut..cut, extra);
                    }
                }
            }
        }
    }
    let repaired = !random.once_in(10);
    if repaired {
        if random.once_in(4)
            && let Some(packed) = packed(file)
        {
            *file = packed;
        }
        if !random.once_in(16) {
            let length = file.len() as u64;
            put(file, FILE_BYTES, &length.to_le_bytes());
        }
        repair(file);
    }
    repaired
}
