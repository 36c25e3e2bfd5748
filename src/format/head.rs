//! Heads: the uppermost nodes of each brick, with surrogates, in a section of their own.
//!
//! A ray that stops high up in a brick needs no more of it than its head, and so not the page. A head repeats what the page has; which
//! of the two is read changes nothing. FORMAT.md, "Heads".

use super::validate::check_boxes;
use super::{Header, Node, PAGE_HEADER_BYTES, PageHeader, Slot, Surrogate};

/// A head as it is made of a page.
#[derive(Clone, Debug, PartialEq)]
pub struct Head {
    /// The brick's root and its inner children, as they are in the page.
    pub nodes: Vec<Node>,
    /// Those of these nodes, then those of their inner children's inner children.
    pub surrogates: Vec<Surrogate>,
}

/// A head, read in place. Looks up through safe code alone: what is not there is an empty node, or no surrogate.
#[derive(Clone, Copy)]
pub struct HeadView<'a> {
    nodes: &'a [Node],
    surrogates: &'a [Surrogate],
}

/// Inner children of a node.
fn inner_children(node: &Node) -> usize {
    let is_inner = |byte: &&u8| matches!(Slot::decode(**byte), Some(Slot::Inner(_)));
    if node.first_child == 0 { 0 } else { node.slots.iter().filter(is_inner).count() }
}

impl Head {
    /// The head of a page, of which `read` gives so many bytes at an offset; it is asked for what is needed only. `None` if the page
    /// has no surrogates.
    pub fn of_page<E>(mut read: impl FnMut(usize, usize) -> Result<Vec<u8>, E>) -> Result<Option<Head>, E> {
        let header = read(0, PAGE_HEADER_BYTES)?;
        let header: PageHeader = header.get(..PAGE_HEADER_BYTES).map_or(PageHeader::NONE, bytemuck::pod_read_unaligned);
        if header.surrogates == 0 || header.nodes == 0 {
            return Ok(None);
        }
        let records = |bytes: Vec<u8>| bytes.chunks_exact(64).map(bytemuck::pod_read_unaligned).collect::<Vec<Node>>();
        let mut nodes = records(read(PAGE_HEADER_BYTES, 64)?);
        let Some(root) = nodes.first() else { return Ok(None) };
        let (first, count) = (root.first_child as usize, inner_children(root));
        nodes.extend(records(read(PAGE_HEADER_BYTES + 64 * first, 64 * count)?));
        let all = read(header.surrogates as usize, 16 * header.nodes as usize)?;
        let all: Vec<Surrogate> = all.chunks_exact(16).map(bytemuck::pod_read_unaligned).collect();
        let mut surrogates = Vec::new();
        surrogates.extend(all.first());
        let mut add = |first: usize, count: usize| surrogates.extend(all.iter().skip(first).take(count));
        add(first, count);
        for (i, child) in nodes.iter().skip(1).enumerate() {
            add(first + i + child.first_child as usize, inner_children(child));
        }
        Ok(Some(Head { nodes, surrogates }))
    }

    /// Appends the head as it is stored: a multiple of 64 bytes.
    pub fn store(&self, out: &mut Vec<u8>) {
        out.extend_from_slice(bytemuck::cast_slice(&self.nodes));
        out.extend_from_slice(bytemuck::cast_slice(&self.surrogates));
        out.resize(out.len().next_multiple_of(64), 0);
    }

    /// The nodes that follow the root in a head, and the surrogates in it.
    fn counts(nodes: &[Node]) -> Option<(usize, usize)> {
        let children = inner_children(nodes.first()?);
        let grandchildren: usize = nodes.get(1..=children)?.iter().map(inner_children).sum();
        Some((children, 1 + children + grandchildren))
    }
}

impl<'a> HeadView<'a> {
    /// The head that begins with the first of these nodes; `None` where there is none.
    #[inline]
    pub fn new(section: &'a [Node]) -> Option<HeadView<'a>> {
        let (children, count) = Head::counts(section)?;
        let (nodes, rest) = section.split_at(1 + children);
        let surrogates: &[Surrogate] = bytemuck::try_cast_slice(rest.get(..count.div_ceil(4))?).ok()?;
        Some(HeadView { nodes, surrogates: &surrogates[..count] })
    }

    /// A node: 0 the root, i its inner child of rank i - 1.
    #[inline]
    pub fn node(&self, i: usize) -> &'a Node {
        self.nodes.get(i).unwrap_or(&Node::EMPTY)
    }

    /// All nodes.
    pub fn nodes(&self) -> &'a [Node] {
        self.nodes
    }

    /// All surrogates.
    pub fn surrogates(&self) -> &'a [Surrogate] {
        self.surrogates
    }

    /// The surrogate of the root.
    #[inline]
    pub fn root(&self) -> Option<&'a Surrogate> {
        self.surrogates.first()
    }

    /// The surrogate of the inner child of that rank of node `i`.
    #[inline]
    pub fn child(&self, i: usize, rank: u8) -> Option<&'a Surrogate> {
        let place = match i {
            0 => 1,
            i => self.nodes.len() + self.nodes.get(1..i)?.iter().map(inner_children).sum::<usize>(),
        };
        self.surrogates.get(place + usize::from(rank))
    }
}

/// Checks the sections of level of detail against a header that was checked: `heads` as nodes, `places` and `tops`. Linear in them.
pub fn validate_heads(header: &Header, heads: &[Node], places: &[u32], tops: &[Surrogate]) -> Result<(), String> {
    if places.len() != header.pages as usize || tops.len() != header.top_nodes as usize {
        return Err("there are not as many heads as pages, or surrogates as top nodes".into());
    }
    let mut next = 0;
    for (i, &place) in places.iter().enumerate() {
        let broken = |what: &str| Err(format!("head {i}: {what}"));
        if place as usize != next {
            return broken("it does not lie where it should");
        }
        let Some(view) = heads.get(next..).and_then(HeadView::new) else {
            return broken("it reaches beyond its section");
        };
        for node in view.nodes {
            let inner = node.slots.iter().filter_map(|&byte| match Slot::decode(byte) {
                Some(Slot::Inner(rank)) => Some(rank),
                _ => None,
            });
            let in_order = inner.enumerate().all(|(at, rank)| at == usize::from(rank) && node.first_child != 0);
            let known =
                node.slots.iter().all(|&b| matches!(Slot::decode(b), Some(slot) if !matches!(slot, Slot::Brick(_))));
            if check_boxes(node).is_err() || !in_order || !known {
                return broken("a node breaks a rule");
            }
        }
        let end = next + view.nodes.len() + view.surrogates.len().div_ceil(4);
        let used = 16 * view.surrogates.len();
        let bytes: &[u8] = bytemuck::cast_slice(&heads[next + view.nodes.len()..end]);
        if bytes[used..].iter().any(|&b| b != 0) {
            return broken("its padding is not zero");
        }
        if view.surrogates.iter().any(|s| s.zero != 0) {
            return broken("the unused byte of a surrogate is not zero");
        }
        next = end;
    }
    match (next == heads.len(), tops.iter().all(|s| s.zero == 0)) {
        (true, true) => Ok(()),
        (false, _) => Err("the heads do not end with their section".into()),
        (_, false) => Err("the unused byte of a surrogate is not zero".into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::format::{PageId, SideArrays};
    use bytemuck::Zeroable;

    /// A page's nodes: the root with two inner children, of which the second has two.
    fn tree() -> (Vec<Node>, Vec<Surrogate>) {
        let with = |count: u8, first_child: u32| {
            let mut node = Node { first_child, ..Node::EMPTY };
            for slot in 0..usize::from(count) {
                node.slots[2 * slot] = 0x80 | slot as u8;
                (0..3).for_each(|axis| (node.low[axis][2 * slot], node.high[axis][2 * slot]) = (1, 9));
            }
            node
        };
        let nodes = vec![with(2, 1), with(0, 0), with(2, 3), Node::EMPTY, Node::EMPTY, with(0, 0), with(0, 0)];
        let surrogates = (0..7).map(|i| Surrogate { deviation: i, ..Surrogate::zeroed() }).collect();
        (nodes, surrogates)
    }

    fn stored() -> Vec<Node> {
        let (nodes, surrogates) = tree();
        let side = SideArrays { surrogates, ..SideArrays::default() };
        let page = PageHeader::layout(PageId(0), &nodes, &[0; 64], 1, 1, &side, false).unwrap();
        let head = Head::of_page(|at, bytes| Ok::<_, ()>(page[at..at + bytes].to_vec())).unwrap().unwrap();
        let mut bytes = Vec::new();
        head.store(&mut bytes);
        let mut section = vec![Node::EMPTY; bytes.len() / 64];
        bytemuck::cast_slice_mut(&mut section).copy_from_slice(&bytes);
        section
    }

    #[test]
    fn heads_read_back() {
        let (nodes, _) = tree();
        let section = stored();
        let view = HeadView::new(&section).unwrap();
        assert_eq!(view.nodes(), &nodes[..3]);
        let number = |s: Option<&Surrogate>| s.map(|s| s.deviation);
        assert_eq!(number(view.root()), Some(0));
        assert_eq!([(0, 0), (0, 1), (2, 0), (2, 1)].map(|(i, r)| number(view.child(i, r))), [1, 2, 5, 6].map(Some));
        assert_eq!(number(view.child(2, 2)), None);
        assert_eq!(view.node(9), &Node::EMPTY);
        assert!(HeadView::new(&section[..3]).is_none() && HeadView::new(&[]).is_none());
    }

    #[test]
    fn every_lie_about_heads_is_told() {
        let header = Header { pages: 1, ..Header::zeroed() };
        let check = |section: &[Node], place: u32| validate_heads(&header, section, &[place], &[]);
        let sound = stored();
        check(&sound, 0).unwrap();
        assert!(check(&sound, 1).is_err() && check(&[], 0).is_err());
        assert!(check(&[&sound[..], &[Node::EMPTY]].concat(), 0).is_err());
        for (at, byte) in [(56, 0x81), (58, 0xc0), (0, 200), (64 * 3 + 15, 1), (64 * sound.len() - 1, 1)] {
            let mut lie = sound.clone();
            bytemuck::cast_slice_mut::<Node, u8>(&mut lie)[at] = byte;
            assert!(check(&lie, 0).is_err(), "byte {at}");
        }
    }
}
