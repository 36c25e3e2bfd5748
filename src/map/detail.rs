//! Level of detail: the surrogates of an opened file, those of pages apart.
//!
//! Heads and the surrogates of the top are checked when they are first asked for: nobody pays for them who does not use them. What only
//! geometry shows (that surrogates hold what they stand for, heads repeat their pages) is part of [`Octree::verify`].

use glam::DVec3;

use super::verify::brick_frame;
use super::{Octree, Page, cut};
use crate::error::Result;
use crate::format::{
    Flags, Frame, HeadView, Node, PageId, Patch, RootBox, SectionKind, Slot, Surrogate, checksum, validate_heads,
};

/// What a file has for level of detail, checked.
#[derive(Clone, Copy)]
pub struct Detail<'a> {
    heads: &'a [Node],
    places: &'a [u32],
    tops: &'a [Surrogate],
}

impl<'a> Detail<'a> {
    /// The head of a brick; `None` if there is no such brick, or where the file was cut short while in use.
    #[inline]
    pub fn head(&self, brick: PageId) -> Option<HeadView<'a>> {
        let place = *self.places.get(brick.0 as usize)?;
        HeadView::new(self.heads.get(place as usize..)?)
    }

    /// The surrogate of a top node.
    #[inline]
    pub fn top(&self, node: u32) -> Option<&'a Surrogate> {
        self.tops.get(node as usize)
    }
}

impl Octree {
    /// What the file has for level of detail, checked at its first use; `None` if it was built without.
    pub fn detail(&self) -> Result<Option<Detail<'_>>> {
        if !self.flags().has(Flags::DETAIL) {
            return Ok(None);
        }
        let bytes = self.heads_bytes()?;
        let detail = Detail {
            heads: cut(&self.sections, bytes, SectionKind::Heads),
            places: cut(&self.sections, bytes, SectionKind::HeadPlaces),
            tops: cut(&self.sections, bytes, SectionKind::TopSurrogates),
        };
        match self.detail.get_or_init(|| self.validate_detail(&detail, bytes)) {
            Ok(()) => Ok(Some(detail)),
            Err(what) => {
                // Zeros in place of lost bytes fail the checks; say what really happened.
                self.fault()?;
                Err(self.damaged(None, what.clone()))
            }
        }
    }

    /// Bytes that [`Octree::detail`] reads.
    pub fn detail_bytes(&self) -> u64 {
        self.header.sections.iter().filter(|s| s.kind >= SectionKind::Heads as u32).map(|s| s.bytes).sum()
    }

    /// Checksums and structure.
    fn validate_detail(&self, detail: &Detail<'_>, bytes: &[u8]) -> Result<(), String> {
        for section in self.header.sections.iter().filter(|s| s.kind >= SectionKind::Heads as u32) {
            let bytes = bytes.get(self.sections[section.kind as usize - 1].clone()).unwrap_or(&[]);
            if checksum(bytes) != section.checksum {
                return Err(format!("the checksum of section {} is wrong", section.kind));
            }
        }
        validate_heads(&self.header, detail.heads, detail.places, detail.tops)
    }

    /// Checks the sections, and that the surrogates of the top hold those below them.
    pub(super) fn check_detail(&self) -> Result<()> {
        let Some(detail) = self.detail()? else { return Ok(()) };
        let mut open = vec![(0usize, Frame::ROOT)];
        while let Some((i, frame)) = open.pop() {
            let Some(node) = self.top_nodes().get(i) else { continue };
            let Some(above) = detail.top(i as u32).map(|s| s.patch(&frame)) else { continue };
            for (slot, &byte) in node.slots.iter().enumerate() {
                let (below, bounds) = match Slot::decode(byte) {
                    Some(Slot::Inner(rank)) => {
                        let child = i + node.first_child as usize + usize::from(rank);
                        let frame_of_child = frame.child(node, slot);
                        open.push((child, frame_of_child));
                        (
                            detail.top(child as u32).map(|s| s.patch(&frame_of_child)),
                            RootBox::of_slot(node, slot, &frame),
                        )
                    }
                    Some(Slot::Brick(rank)) => {
                        let brick = node.first_leaf as usize + usize::from(rank);
                        let root = detail.head(PageId(brick as u32)).and_then(|head| head.root().copied());
                        let patch = self.bricks().get(brick).zip(root).map(|(b, s)| s.patch(&brick_frame(b)));
                        (patch, RootBox::of_slot(node, slot, &frame))
                    }
                    _ => continue,
                };
                if below.is_some_and(|below| !could_hold(&above, &below, &bounds)) {
                    let what = format!("the surrogate of top node {i} has no room for what lies in slot {slot}");
                    return Err(self.damaged(None, what));
                }
            }
        }
        Ok(())
    }

    /// Checks a page's surrogates against its triangles, and its head against the page.
    pub(super) fn check_surrogates(&self, i: usize, page: &Page<'_>) -> Result<()> {
        let Some(detail) = self.detail()? else { return Ok(()) };
        let damaged = |what: String| self.damaged(Some(i as u32), what);
        let (nodes, surrogates) = (page.nodes(), page.surrogates());
        let frame = self.bricks().get(i).map_or(Frame::ROOT, brick_frame);
        self.check_head(detail.head(PageId(i as u32)), nodes, surrogates).map_err(damaged)?;
        // The slabs and boxes of the nodes on the path.
        let mut path: Vec<(usize, Patch, RootBox)> = Vec::new();
        let mut open = vec![(0usize, frame, RootBox::of_frame(&frame), 0usize)];
        while let Some((node_index, frame, bounds, depth)) = open.pop() {
            let (Some(node), Some(surrogate)) = (nodes.get(node_index), surrogates.get(node_index)) else { continue };
            path.truncate(depth);
            path.push((node_index, surrogate.patch(&frame), bounds));
            for (slot, &byte) in node.slots.iter().enumerate() {
                match Slot::decode(byte) {
                    Some(Slot::Inner(rank)) if node.first_child != 0 => {
                        let child = node_index + node.first_child as usize + usize::from(rank);
                        open.push((child, frame.child(node, slot), RootBox::of_slot(node, slot, &frame), depth + 1));
                    }
                    Some(Slot::Leaf(units)) if node.first_leaf != 0 => {
                        let units = 16 * node.first_leaf as usize + usize::from(units) * self.leaf_unit().bytes();
                        let leaf = page.leaf(64 + 64 * node_index + units);
                        let vertices = (0..leaf.len()).flat_map(|j| leaf.triangle(j).vertices());
                        let vertices: Vec<DVec3> = vertices.map(|v| self.root().to_root_units(v)).collect();
                        let outside = path.iter().find(|(_, patch, bounds)| !holds(patch, bounds, &vertices));
                        if let Some((above, ..)) = outside {
                            return Err(damaged(format!("a triangle lies outside the slab of node {above}")));
                        }
                    }
                    _ => {}
                }
            }
        }
        Ok(())
    }

    /// Whether a head repeats its page.
    fn check_head(&self, head: Option<HeadView<'_>>, nodes: &[Node], surrogates: &[Surrogate]) -> Result<(), String> {
        let same = head.is_some_and(|head| {
            let Some(first) = nodes.first().map(|root| root.first_child as usize) else { return false };
            let children = head.nodes().len() - 1;
            let alike = head.node(0) == &nodes[0] && nodes.get(first..first + children) == head.nodes().get(1..);
            let root = head.root() == surrogates.first();
            let below =
                head.nodes().iter().zip(std::iter::once(0).chain(first..)).enumerate().all(|(i, (node, at))| {
                    let ranks = node.slots.iter().filter_map(|&byte| match Slot::decode(byte) {
                        Some(Slot::Inner(rank)) => Some(rank),
                        _ => None,
                    });
                    ranks.into_iter().all(|rank| {
                        let place = at + node.first_child as usize + usize::from(rank);
                        head.child(i, rank).is_some() && head.child(i, rank) == surrogates.get(place)
                    })
                });
            alike && root && below
        });
        if same { Ok(()) } else { Err("its head is not what the page has".into()) }
    }
}

/// Whether a slab holds what lies in the box of triangles with these corners: the whole of them, or the part that their range along the
/// normal leaves within the box.
fn holds(patch: &Patch, bounds: &RootBox, vertices: &[DVec3]) -> bool {
    let along = vertices.iter().map(|v| patch.normal.dot(*v));
    let (low, high) = along.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| (low.min(x), high.max(x)));
    let [least, most] = bounds.support(patch.normal);
    low.max(least) >= patch.offset - patch.deviation && high.min(most) <= patch.offset + patch.deviation
}

/// Whether the slab of a node overlaps that of a child at all within the child's box, as it must.
fn could_hold(above: &Patch, below: &Patch, bounds: &RootBox) -> bool {
    let overlaps = |patch: &Patch| {
        let [least, most] = bounds.support(patch.normal);
        least <= patch.offset + patch.deviation && most >= patch.offset - patch.deviation
    };
    overlaps(above) && overlaps(below)
}
