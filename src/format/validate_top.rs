//! Checks of the header page, which opening a file relies on, and of the top, of which each part is checked when it is first used.
//!
//! After these checks every page record names bytes of the file, pages and sections fill it without overlap, and the top tree reaches
//! each brick exactly once and cannot loop. Where a page lies can be checked by its own entry and the one before it, so that
//! nobody has to read the whole directory for one page: entries that each follow the one before make a whole that is in order.

use super::validate::{NodeFault, check_boxes, check_family};
use super::{
    Brick, DEPTH_MAX, Flags, HEADER_BYTES, Header, MAGIC, MaterialRecord, Node, PageRecord, Section, SectionKind, Slot,
    VERSION, checksum,
};

/// Why a file cannot be opened.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Refusal {
    /// It is not a file for this program: another kind of file, or a newer version.
    Foreign(String),
    /// It was an octree file, but breaks a rule.
    Damaged(String),
}

/// What the directory says of a page: its record and its brick.
pub type Entry<'a> = (&'a PageRecord, &'a Brick);

/// Reads and checks the header page at the start of `file`, the first bytes of a file of `length` bytes.
pub fn read_header(file: &[u8], length: u64) -> Result<Header, Refusal> {
    check_magic(file)?;
    let Some(page) = file.get(..HEADER_BYTES) else {
        return Err(Refusal::Damaged(format!("cut short: {length} bytes, the header alone has {HEADER_BYTES}")));
    };
    let header: Header = bytemuck::pod_read_unaligned(page);
    if header.version != VERSION {
        let what = format!(
            "an octree file of version {}, but this program reads version {VERSION}; build it again with this octbuild",
            header.version
        );
        return Err(Refusal::Foreign(what));
    }
    if checksum(&page[..HEADER_BYTES - 8]) != header.checksum {
        return Err(Refusal::Damaged("the header's checksum is wrong".into()));
    }
    check_flags(header.flags)?;
    check_header(&header, length).map_err(Refusal::Damaged)?;
    Ok(header)
}

/// Tells other files, and octree files whose line ends were "corrected" on the way, from octree files.
fn check_magic(file: &[u8]) -> Result<(), Refusal> {
    let head = &file[..file.len().min(MAGIC.len())];
    if head == MAGIC {
        Ok(())
    } else if head.len() >= 4 && head[0] & 0x7f == MAGIC[0] & 0x7f && head[1..4] == MAGIC[1..4] {
        let how = if file.len() < MAGIC.len() { "cut short" } else { "changed on the way as if it were text" };
        Err(Refusal::Damaged(format!("its first bytes were {how}")))
    } else {
        Err(Refusal::Foreign("not an octree file (build one with octbuild)".into()))
    }
}

/// Refuses flags that this reader does not know.
fn check_flags(flags: Flags) -> Result<(), Refusal> {
    if flags.0 & !Flags::KNOWN != 0 {
        let what = format!(
            "uses features this program does not know (flags {:#x}); use a newer octrace",
            flags.0 & !Flags::KNOWN
        );
        return Err(Refusal::Foreign(what));
    }
    let pairs = [(Flags::WIDE_MATERIALS, Flags::MATERIALS, 3, 2), (Flags::REPEATS, Flags::IDS, 7, 1)];
    match pairs.iter().find(|(flag, needs, ..)| flags.has(*flag) && !flags.has(*needs)) {
        Some((_, _, bit, needs)) => Err(Refusal::Damaged(format!("flag bit {bit} is set without bit {needs}"))),
        None => Ok(()),
    }
}

/// The header's fields by themselves.
fn check_header(h: &Header, length: u64) -> Result<(), String> {
    if h.file_bytes != length {
        let how = if length < h.file_bytes { "cut short" } else { "too long" };
        return Err(format!("{how}: {length} bytes instead of {}", h.file_bytes));
    }
    let dropped = [h.dropped.degenerate, h.dropped.non_finite, h.dropped.bad_index];
    let sum = dropped.iter().try_fold(h.triangles, |sum, &n| sum.checked_add(n));
    let finite = |list: &[f32]| list.iter().all(|x| x.is_finite());
    let zero = h.zero0.iter().all(|&b| b == 0) && h.zero1.iter().all(|&b| b == 0);
    let rules: &[(bool, &str)] = &[
        (zero, "unused bytes of the header are not zero"),
        (h.triangles >= 1 && h.pages >= 1 && h.leaves >= 1, "the header counts no triangle, leaf or page"),
        (sum == Some(h.source_triangles), "stored and dropped triangles are not the source's in sum"),
        (h.source_triangles < u64::from(u32::MAX), "more source triangles than face ids"),
        (h.references < u64::from(u32::MAX), "more references than numbers for them"),
        (
            h.references == h.triangles || (h.flags.has(Flags::REPEATS) && h.references > h.triangles),
            "triangles and references do not agree",
        ),
        ((h.pages == 1) == (h.top_nodes == 0), "top nodes and pages do not agree"),
        (h.nodes >= u64::from(h.pages) + u64::from(h.top_nodes), "fewer nodes than pages and top nodes"),
        ((1..=DEPTH_MAX).contains(&h.depth), "the depth is out of range"),
        ((-149..=130).contains(&h.root_log2_side), "the root cube's side is out of range"),
        (h.root_corner.iter().chain(&h.origin).all(|x| x.is_finite()), "the root cube or the origin is not finite"),
        (finite(&h.bounds_min) && finite(&h.bounds_max), "the bounds are not finite"),
        ((0..3).all(|i| h.bounds_min[i] <= h.bounds_max[i]), "the bounds are empty"),
        (h.split <= 2, "the split mode is unknown"),
        ((1..=16).contains(&h.leaf_limit) && h.depth_limit <= 21, "the leaf or depth limit is out of range"),
    ];
    match rules.iter().find(|(holds, _)| !holds) {
        Some((_, what)) => Err((*what).into()),
        None => check_directory(h),
    }
}

/// The section directory: the sections of the header's counts, in order, side by side up to the end of the file.
fn check_directory(h: &Header) -> Result<(), String> {
    let mut wanted = h.wanted_sections().into_iter().flatten();
    let mut end: Option<u64> = None;
    for (i, section) in h.sections.iter().enumerate() {
        let Some((kind, bytes)) = wanted.next() else {
            if *section != Section::default() {
                return Err(format!("section {i} is one too many, or its unused bytes are not zero"));
            }
            continue;
        };
        let what = |what| Err(format!("section {i} ({kind:?}) {what}"));
        if section.kind != kind as u32 || section.zero != 0 {
            return what("is not of the kind that should stand there");
        }
        if bytes.is_some_and(|bytes| bytes != section.bytes) {
            return what("has not the length that the header's counts make");
        }
        let begin = end.map_or(section.offset, |end| end.next_multiple_of(64));
        let stop = section.offset.checked_add(section.bytes).filter(|&stop| stop <= h.file_bytes);
        if section.offset != begin
            || section.offset < HEADER_BYTES as u64
            || !section.offset.is_multiple_of(64)
            || stop.is_none()
        {
            return what("does not lie where it should");
        }
        end = stop;
    }
    if end == Some(h.file_bytes) { Ok(()) } else { Err("the sections do not end with the file".into()) }
}

impl Header {
    /// The sections a file with these counts has, in order, with their lengths where the counts give them.
    fn wanted_sections(&self) -> [Option<(SectionKind, Option<u64>)>; SectionKind::COUNT] {
        let detail = self.flags.has(Flags::DETAIL);
        let (tops, pages, materials) = (u64::from(self.top_nodes), u64::from(self.pages), u64::from(self.materials));
        [
            (tops > 0).then_some((SectionKind::TopNodes, Some(64 * tops))),
            Some((SectionKind::Bricks, Some(32 * pages))),
            Some((SectionKind::Pages, Some(32 * pages))),
            (materials > 0).then_some((SectionKind::Materials, Some(80 * materials))),
            (materials > 0).then_some((SectionKind::Strings, None)),
            detail.then_some((SectionKind::Heads, None)),
            detail.then_some((SectionKind::HeadPlaces, Some(4 * pages))),
            (detail && tops > 0).then_some((SectionKind::TopSurrogates, Some(16 * tops))),
        ]
    }

    /// The section of that kind, if there is one.
    pub fn section(&self, kind: SectionKind) -> Option<&Section> {
        self.sections.iter().find(|s| s.kind == kind as u32)
    }
}

/// Checks the top tree and the frames of bricks against a header that was checked. Linear in both, allocates a byte for each.
pub fn validate_tree(header: &Header, nodes: &[Node], bricks: &[Brick]) -> Result<(), String> {
    if nodes.len() != header.top_nodes as usize || bricks.len() != header.pages as usize {
        return Err("the top is not as long as the header says".into());
    }
    validate_top_nodes(header, nodes, bricks.len())?;
    let sound = |b: &Brick| b.corner.iter().all(|&c| is_brick_corner(c)) && b.unit.iter().all(|&u| is_brick_unit(u));
    match bricks.iter().position(|brick| !sound(brick)) {
        Some(i) => Err(format!("brick {i}: its frame breaks a rule")),
        None => Ok(()),
    }
}

/// Checks what the directory says of page `i` by itself and against the entry before it, which is given for every page but the first.
pub fn validate_entry(header: &Header, i: usize, before: Option<Entry<'_>>, entry: Entry<'_>) -> Result<(), String> {
    let (r, brick) = entry;
    let packed = header.flags.has(Flags::PACKED);
    let stored = u64::from(r.stored_bytes);
    if r.zero != 0
        || r.stored_bytes == 0
        || !r.bytes.is_multiple_of(64)
        || !(256..=header.largest_page).contains(&r.bytes)
        || (if packed { stored > most_stored(r.bytes) } else { r.stored_bytes != r.bytes })
    {
        return Err(format!("record of page {i}: the lengths break a rule"));
    }
    // The fullest leaf has 16 references in 48 bytes.
    if r.references == 0 || r.references > r.bytes / 3 {
        return Err(format!("record of page {i}: the references cannot be that many"));
    }
    let begin = before.map_or(Some(HEADER_BYTES as u64), |(r, _)| r.offset.checked_add(r.stored_bytes.into()));
    let begin = begin.and_then(|begin| begin.checked_next_multiple_of(PageRecord::alignment(r.references, packed)));
    if begin != Some(r.offset) {
        return Err(format!("page {i} does not lie where it should"));
    }
    let (end, first_section) = (r.offset.checked_add(stored), header.sections[0].offset);
    if end.is_none_or(|end| end > first_section) {
        return Err(format!("page {i} reaches beyond the pages' end"));
    }
    let is_last = i + 1 == header.pages as usize;
    if is_last && end.is_some_and(|end| end.next_multiple_of(64) != first_section) {
        return Err("the pages do not end where the first section begins".into());
    }
    if u64::from(brick.node) != (if packed { 0 } else { r.offset / 64 + 1 }) {
        return Err(format!("brick {i} does not name its page's first node"));
    }
    let first = before.map_or(0, |(r, brick)| u64::from(brick.first_reference) + u64::from(r.references));
    if u64::from(brick.first_reference) != first {
        return Err(format!("brick {i}: its first reference is not the sum of those before"));
    }
    if is_last && first + u64::from(r.references) != header.references {
        return Err("the pages' references are not the header's in sum".into());
    }
    Ok(())
}

/// The most bytes that a packed page may be stored as: more than zstd ever makes of it, so that a reader knows what memory it needs.
pub fn most_stored(bytes: u32) -> u64 {
    u64::from(bytes) + u64::from(bytes) / 8 + 1024
}

/// Checks the whole directory against a header that was checked: pages side by side from the header page to the first section.
pub fn validate_directory(header: &Header, records: &[PageRecord], bricks: &[Brick]) -> Result<(), String> {
    if records.len() != header.pages as usize || bricks.len() != records.len() {
        return Err("the directory is not as long as the header says".into());
    }
    let mut before = None;
    for (i, entry) in records.iter().zip(bricks).enumerate() {
        validate_entry(header, i, before, entry)?;
        before = Some(entry);
    }
    let largest = records.iter().map(|r| r.bytes).max();
    if largest == Some(header.largest_page) { Ok(()) } else { Err("the largest page is not as the header says".into()) }
}

/// A multiple of 2^-24 in 0..1.
fn is_brick_corner(c: f32) -> bool {
    (0.0..=1.0).contains(&c) && (c * 16_777_216.0).fract() == 0.0 && c.to_bits() != (-0.0f32).to_bits()
}

/// A power of two, 2^-32 to 2^-7.
fn is_brick_unit(u: f32) -> bool {
    let (exponent, fraction) = (u.to_bits() >> 23, u.to_bits() & 0x7f_ffff);
    fraction == 0 && (127 - 32..=127 - 7).contains(&exponent)
}

/// Top nodes: a tree from node 0 over all top nodes and all bricks.
fn validate_top_nodes(header: &Header, nodes: &[Node], bricks: usize) -> Result<(), String> {
    if nodes.is_empty() {
        return Ok(()); // Then there is one brick, which is the root.
    }
    // Nodes on the path down to each; 0 = not reached yet.
    let mut depth = vec![0u8; nodes.len()];
    let mut reached = vec![false; bricks];
    depth[0] = 1;
    for (i, node) in nodes.iter().enumerate() {
        let what = |fault: NodeFault| format!("top node {i}: {fault}");
        if depth[i] == 0 || u32::from(depth[i]) >= header.depth {
            return Err(what(if depth[i] == 0 { NodeFault::NotReached } else { NodeFault::TooDeep }));
        }
        check_boxes(node).map_err(what)?;
        check_family(&mut depth, i, node).map_err(what)?;
        let mut lowest = None;
        for &byte in &node.slots {
            match Slot::decode(byte) {
                Some(Slot::Brick(rank)) => {
                    let brick = node.first_leaf as usize + usize::from(rank);
                    let free = reached.get_mut(brick).filter(|r| !**r).ok_or(NodeFault::Brick).map_err(what)?;
                    *free = true;
                    lowest = Some(lowest.map_or(rank, |lowest: u8| lowest.min(rank)));
                }
                Some(Slot::Empty | Slot::Inner(_)) => {}
                _ => return Err(what(NodeFault::Slot)),
            }
        }
        if lowest.map_or(node.first_leaf != 0, |lowest| lowest != 0) {
            return Err(what(NodeFault::Brick));
        }
    }
    match reached.iter().position(|&r| !r) {
        Some(brick) => Err(format!("brick {brick} is not in the top tree")),
        None => Ok(()),
    }
}

/// Material records: strings inside the section and UTF-8.
pub fn validate_materials(materials: &[MaterialRecord], strings: &[u8]) -> Result<(), String> {
    let strings = std::str::from_utf8(strings).map_err(|_| "the strings are not UTF-8".to_string())?;
    for (i, m) in materials.iter().enumerate() {
        let sound = [m.name, m.map_kd].iter().all(|&place| string_at(strings, place).is_some());
        if !sound || m.given >= 128 || m.zero != [0; 2] {
            return Err(format!("material {} breaks a rule", i + 1));
        }
    }
    Ok(())
}

/// The string at an offset and length, if it is one.
pub(crate) fn string_at(strings: &str, [offset, length]: [u32; 2]) -> Option<&str> {
    strings.get(offset as usize..(offset as usize).checked_add(length as usize)?)
}
