//! Structural checks of a page: after them, no offset in it leads outside and no path loops.
//!
//! One pass over the leaves marks where records begin, one over the nodes ticks each mark and each node off exactly once
//! (children lie after their parents, so walking the nodes in order suffices), one over the side arrays bounds their
//! indices. What only shows with geometry (that boxes hold their triangles) is [`crate::map::Octree::verify`]'s.

use std::fmt;

use super::{
    DEPTH_MAX, Flags, LEAF_PADDING, Leaf, LeafUnit, Node, PAGE_HEADER_BYTES, PageHeader, PageId, PageRecord, Points,
    Slot,
};

/// Checks an unpacked page against FORMAT.md: header, nodes, leaves, side arrays.
///
/// `materials` is the count of material records. The error says which rule is broken, and where. Linear in the page's
/// bytes, allocates a byte a node and a bit a leaf unit. `bytes` must be aligned to 4 bytes in memory.
pub fn validate_page(
    bytes: &[u8],
    id: PageId,
    record: &PageRecord,
    flags: Flags,
    materials: u32,
    source_triangles: u64,
) -> Result<PageHeader, String> {
    let header = read_header(bytes, id, record, flags.leaf_unit())?;
    check_layout(bytes, &header, flags)?;
    let mut starts = mark_leaves(bytes, &header, flags)?;
    check_nodes(bytes, &header, flags.leaf_unit(), &mut starts)?;
    check_side_values(bytes, &header, flags, materials, source_triangles)?;
    Ok(header)
}

impl PageHeader {
    /// Offset of the first byte after the leaves.
    pub(crate) fn leaf_end(&self) -> u64 {
        u64::from(self.leaf_offset) + u64::from(self.leaf_bytes)
    }
}

/// The page's header, its counts and the place of nodes and leaves.
fn read_header(bytes: &[u8], id: PageId, record: &PageRecord, unit: LeafUnit) -> Result<PageHeader, String> {
    let Some(head) = bytes.get(..PAGE_HEADER_BYTES) else { return Err("too short for a header".into()) };
    let h: PageHeader = bytemuck::pod_read_unaligned(head);
    let rules = [
        (bytes.len() as u64 == u64::from(record.bytes), "its length is not that of its record"),
        (h.page == id.0, "it bears another page's number"),
        (h.zero == 0, "unused bytes of its header are not zero"),
        (h.nodes >= 1 && h.leaves >= 1 && h.references >= 1, "it counts no node, leaf or reference"),
        (h.references == record.references, "its references are not as many as its record says"),
        (u64::from(h.leaf_offset) == 64 + 64 * u64::from(h.nodes), "the leaves do not follow the nodes"),
        (u64::from(h.leaf_bytes).is_multiple_of(unit.bytes() as u64), "the leaves' length is not in leaf units"),
        (h.leaf_end() + LEAF_PADDING as u64 <= bytes.len() as u64, "the leaves reach beyond the page"),
    ];
    match rules.iter().find(|(holds, _)| !holds) {
        Some((_, what)) => Err((*what).into()),
        None => Ok(h),
    }
}

/// Side arrays: those that the flags ask for, in order, side by side, zeros between them and to the page's end.
fn check_layout(bytes: &[u8], h: &PageHeader, flags: Flags) -> Result<(), String> {
    let count = u64::from(h.references);
    let material = if flags.has(Flags::WIDE_MATERIALS) { 4 } else { 2 };
    let exactly = |flag| (flags.has(flag), flags.has(flag));
    let perhaps = |flag| (false, flags.has(flag));
    let table = |corners: u32, count: u32| (count != 0, count != 0 && corners != 0);
    // Name, offset, bytes if it is there, (must it be there, may it be there).
    let arrays = [
        ("ids", h.ids, 4 * count, exactly(Flags::IDS)),
        ("material numbers", h.materials, material * count, exactly(Flags::MATERIALS)),
        ("normal corners", h.normal_corners, 12 * count, perhaps(Flags::NORMALS)),
        ("normals", h.normals, 12 * u64::from(h.normal_count), table(h.normal_corners, h.normal_count)),
        ("texture corners", h.texcoord_corners, 12 * count, perhaps(Flags::TEXCOORDS)),
        (
            "texture coordinates",
            h.texcoords,
            8 * u64::from(h.texcoord_count),
            table(h.texcoord_corners, h.texcoord_count),
        ),
        ("surrogates", h.surrogates, 16 * u64::from(h.nodes), exactly(Flags::DETAIL)),
    ];
    let mut end = h.leaf_end();
    let mut next = end + LEAF_PADDING as u64;
    for (name, offset, length, (must, may)) in arrays {
        if (must && offset == 0) || (!may && offset != 0) {
            return Err(format!("the {name} are {}", if must { "missing" } else { "not to be there" }));
        }
        if offset == 0 {
            continue;
        }
        let begin = u64::from(offset);
        if begin != next || begin + length > bytes.len() as u64 {
            return Err(format!("the {name} at {begin} do not lie where they should"));
        }
        check_zeros(bytes, end, begin)?;
        end = begin + length;
        next = end.next_multiple_of(16);
    }
    if next.next_multiple_of(64) != bytes.len() as u64 {
        return Err("its length is not that of its parts".into());
    }
    check_zeros(bytes, end, bytes.len() as u64)
}

/// Padding must be zero.
fn check_zeros(bytes: &[u8], begin: u64, end: u64) -> Result<(), String> {
    let zero = bytes.get(begin as usize..end as usize).is_some_and(|gap| gap.iter().all(|&b| b == 0));
    if zero { Ok(()) } else { Err(format!("the padding from {begin} to {end} is not zero")) }
}

/// Where leaf records begin: a bit for each leaf unit of the page's leaves.
struct LeafStarts {
    bits: Vec<u64>,
    left: u64,
}

impl LeafStarts {
    /// Marks a unit; returns nothing, since records lie side by side and cannot meet.
    fn mark(&mut self, unit: u64) {
        self.bits[(unit / 64) as usize] |= 1 << (unit % 64);
        self.left += 1;
    }

    /// Takes a mark away; false if there is none.
    fn tick(&mut self, unit: u64) -> bool {
        let Some(word) = self.bits.get_mut((unit / 64) as usize) else { return false };
        let found = *word >> (unit % 64) & 1 == 1;
        *word &= !(1 << (unit % 64));
        self.left -= u64::from(found);
        found
    }
}

/// Walks the leaf records, which lie side by side, checks each, and that their references count up.
fn mark_leaves(bytes: &[u8], h: &PageHeader, flags: Flags) -> Result<LeafStarts, String> {
    let unit = flags.leaf_unit();
    let region = &bytes[h.leaf_offset as usize..h.leaf_end() as usize];
    let units = region.len() / unit.bytes();
    let mut starts = LeafStarts { bits: vec![0; units.div_ceil(64)], left: 0 };
    let (mut at, mut references) = (0, 0u64);
    while at < region.len() {
        let broken = |what| Err(format!("leaf at {}: {what}", h.leaf_offset as usize + at));
        let Some(leaf) = Leaf::parse(&region[at..], unit) else { return broken("the record breaks a rule") };
        if leaf.points() == Points::Steps && !flags.has(Flags::STEPS) {
            return broken("its vertices are steps, which the header's flags do not allow");
        }
        if u64::from(leaf.first()) != references {
            return broken("its first reference is not the sum of those before");
        }
        references += leaf.len() as u64;
        starts.mark((at / unit.bytes()) as u64);
        at += leaf.size(unit);
    }
    if references != u64::from(h.references) || starts.left != u64::from(h.leaves) {
        return Err(format!(
            "the leaves hold {references} references in {} leaves, not as the header says",
            starts.left
        ));
    }
    Ok(starts)
}

/// Nodes: a tree from node 0 over all nodes and all leaves.
fn check_nodes(bytes: &[u8], h: &PageHeader, unit: LeafUnit, starts: &mut LeafStarts) -> Result<(), String> {
    // Nodes on the path down to each; 0 = not reached yet.
    let mut depth = vec![0u8; h.nodes as usize];
    depth[0] = 1;
    for (i, node) in bytes[PAGE_HEADER_BYTES..h.leaf_offset as usize].chunks_exact(size_of::<Node>()).enumerate() {
        let node: Node = bytemuck::pod_read_unaligned(node);
        check_node(&node, i, unit, &mut depth, starts).map_err(|fault| format!("node {i}: {fault}"))?;
    }
    if starts.left == 0 { Ok(()) } else { Err(format!("{} leaves are not in the tree", starts.left)) }
}

/// One node of a page.
fn check_node(
    node: &Node,
    i: usize,
    unit: LeafUnit,
    depth: &mut [u8],
    starts: &mut LeafStarts,
) -> Result<(), NodeFault> {
    match u32::from(depth[i]) {
        0 => return Err(NodeFault::NotReached),
        1..=DEPTH_MAX => {}
        _ => return Err(NodeFault::TooDeep),
    }
    check_boxes(node)?;
    check_family(depth, i, node)?;
    // From the first leaf of the page, which lies after the nodes; the node itself lies before it.
    let back = 64 * (depth.len() - i) as u64;
    let first = (16 * u64::from(node.first_leaf)).checked_sub(back);
    let mut leaves = 0;
    for &byte in &node.slots {
        match Slot::decode(byte) {
            Some(Slot::Leaf(offset)) => {
                let bytes = unit.bytes() as u64;
                let at =
                    first.filter(|first| first.is_multiple_of(bytes)).map(|first| first / bytes + u64::from(offset));
                if !at.is_some_and(|at| starts.tick(at)) {
                    return Err(NodeFault::Leaf);
                }
                leaves += 1;
            }
            Some(Slot::Empty | Slot::Inner(_)) => {}
            _ => return Err(NodeFault::Slot),
        }
    }
    if leaves == 0 && node.first_leaf != 0 { Err(NodeFault::Leaf) } else { Ok(()) }
}

/// Which rule a node breaks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum NodeFault {
    NotReached,
    TooDeep,
    Slot,
    Box,
    Child,
    Leaf,
    Brick,
}

impl fmt::Display for NodeFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            NodeFault::NotReached => "no path leads to it",
            NodeFault::TooDeep => "it lies deeper than is allowed",
            NodeFault::Slot => "a slot byte has no meaning there",
            NodeFault::Box => "the planes of a slot break a rule",
            NodeFault::Child => "an inner child is out of place or has two parents",
            NodeFault::Leaf => "a leaf is out of place or has two parents",
            NodeFault::Brick => "a brick is out of place or has two parents",
        })
    }
}

/// Planes: used slots have `high > low` on each axis, empty ones 255 and 0.
pub(super) fn check_boxes(node: &Node) -> Result<(), NodeFault> {
    let mut sound = true;
    for (low, high) in node.low.iter().zip(&node.high) {
        for slot in 0..8 {
            let empty = node.slots[slot] == Slot::Empty.encode();
            let filled = high[slot] > low[slot];
            sound &= if empty { low[slot] == 255 && high[slot] == 0 } else { filled };
        }
    }
    if sound { Ok(()) } else { Err(NodeFault::Box) }
}

/// Inner children of node `i`: side by side in slot order, after it, each reached for the first time. Fills in their depth.
pub(super) fn check_family(depth: &mut [u8], i: usize, node: &Node) -> Result<(), NodeFault> {
    let mut rank = 0u8;
    for &byte in &node.slots {
        if let Some(Slot::Inner(number)) = Slot::decode(byte) {
            if number != rank || node.first_child == 0 {
                return Err(NodeFault::Child);
            }
            let place = i as u64 + u64::from(node.first_child) + u64::from(rank);
            let below = depth[i].saturating_add(1);
            let child = usize::try_from(place).ok().and_then(|place| depth.get_mut(place)).filter(|d| **d == 0);
            *child.ok_or(NodeFault::Child)? = below;
            rank += 1;
        }
    }
    if rank == 0 && node.first_child != 0 { Err(NodeFault::Child) } else { Ok(()) }
}

/// Side arrays: every number in them names something.
fn check_side_values(bytes: &[u8], h: &PageHeader, flags: Flags, materials: u32, source: u64) -> Result<(), String> {
    let count = h.references as usize;
    let words = |offset: u32, n: usize| {
        let place = if offset == 0 { 0..0 } else { offset as usize..offset as usize + 4 * n };
        bytes[place].chunks_exact(4).map(|w| u32::from_le_bytes([w[0], w[1], w[2], w[3]]))
    };
    if !words(h.ids, count).all(|id| u64::from(id) < source) {
        return Err("a face id is not below the count of source triangles".into());
    }
    let known = match flags.has(Flags::WIDE_MATERIALS) {
        true => words(h.materials, count).all(|m| m <= materials),
        false if h.materials == 0 => true,
        false => bytes[h.materials as usize..][..2 * count]
            .chunks_exact(2)
            .all(|m| u32::from(u16::from_le_bytes([m[0], m[1]])) <= materials),
    };
    if !known {
        return Err("a material number names no material".into());
    }
    let surrogates = h.surrogates as usize..h.surrogates as usize + 16 * h.nodes as usize;
    if h.surrogates != 0 && !bytes[surrogates].chunks_exact(16).all(|surrogate| surrogate[15] == 0) {
        return Err("the unused byte of a surrogate is not zero".into());
    }
    let indices = [("normal", h.normal_corners, h.normal_count), ("texture", h.texcoord_corners, h.texcoord_count)];
    for (name, offset, limit) in indices {
        if !words(offset, 3 * count).all(|i| i < limit || i == u32::MAX) {
            return Err(format!("a {name} corner lies outside its table"));
        }
    }
    Ok(())
}
