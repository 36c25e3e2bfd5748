//! A binary tree by binned surface-area splits, and what it will cost as an 8-wide tree.
//!
//! Lists are split at the best border between bins ([`super::binning`]). Splitting goes on to a few triangles, well below what a leaf may hold: which subtrees become
//! leaves, which nodes dissolve into their parents, is decided by the costs of [`super::collapse`], which are summed here
//! on the way up while both children's are at hand.
//!
//! Arithmetic is on the source's coordinates, so nothing is lost to a far-away root cube; boxes and bins in f32, areas in
//! f64, so nothing overflows up to ±FLT_MAX. Where centres coincide (identical triangles), and where an uneven split could
//! lead past [`DEPTH_LIMIT`] (freak meshes only), the list is halved instead.
//!
//! The result depends on the order of `primitives` alone, which the caller makes canonical. Halves of big lists are built
//! in parallel; nodes lie in preorder with relative links, so that joining them is appending.
//!
//! A list may have room behind it: then a split may also cut through space, and a triangle that lies on both sides takes
//! a second place ([`super::spatial`]). Each side gets its part of the room that is left. Without room, and that is every
//! mesh of evenly sized triangles, nothing of that is even looked for.

use super::binning::{Binning, best_split};
use super::collapse::{Costs, Plan, levels};
use super::primitive::{Primitive, Span};
use super::record::RecordLimits;
use super::spatial;
use crate::geometry::{Aabb, Triangle};

/// Lists up to this length are not split, if one record can hold them.
const TERMINAL: usize = 3;
/// No path of the binary tree, so none of the 8-wide one, is longer: a file allows 64 nodes, of which the top tree may
/// take 22. Over a million triangles this leaves 20 levels more than a balanced tree has.
const DEPTH_LIMIT: u32 = 40;
/// Lists longer than this are built as two parallel tasks.
pub(super) const PARALLEL: usize = 1 << 14;
/// Spatial splits are looked for where the two sides' boxes share more than this part of the whole's surface (Stich,
/// Friedrich and Dietrich 2009, section 4.4).
const OVERLAP: f64 = 1e-5;

/// A node of the binary tree; 44 bytes. Its left child is the next node.
#[derive(Clone, Debug)]
pub(super) struct BinaryNode {
    /// Lowest corner of its box, in the source's coordinates.
    pub min: [f32; 3],
    /// Highest corner.
    pub max: [f32; 3],
    /// Distance to the right child; 0 = no children.
    pub right: u32,
    /// First of its primitives, if it has no children.
    pub first: u32,
    /// How many there are at most, those below it included: parts of a triangle that meet again below it count as one.
    pub count: u32,
    /// What collapsing does with it.
    pub plan: Plan,
}

/// A binary tree in preorder, its primitives, and what it costs as an 8-wide tree, in units of area.
pub(super) struct Binary {
    /// Nodes, the root first.
    pub nodes: Vec<BinaryNode>,
    /// The primitives that terminal nodes name; some places may lie unused in between.
    pub primitives: Vec<Primitive>,
    /// The cost.
    pub cost: f64,
}

/// Builds the tree over at least one primitive. `room`: how many places may be added by splitting triangles.
pub(super) fn build(
    mut primitives: Vec<Primitive>,
    room: usize,
    triangles: Canonical<'_>,
    limits: RecordLimits,
) -> Binary {
    let count = primitives.len();
    primitives.resize(count + room, Primitive::NOTHING);
    let mut nodes = Vec::with_capacity(count);
    let root_area = primitives[..count].iter().fold(Span::EMPTY, |all, p| all.union(p.span())).half_area();
    let splitter = Splitter { triangles, limits, root_area, spatial: room > 0 || !triangles.parts.is_empty() };
    let cost = splitter.subtree(&mut primitives, count, 0, 0, &mut nodes).0.as_child();
    Binary { nodes, primitives, cost }
}

/// A tree of given nodes, planned anew; `None` if a path of the 8-wide tree would be too long. The nodes' paths are short
/// enough for recursion.
pub(super) fn planned(
    nodes: Vec<BinaryNode>,
    primitives: Vec<Primitive>,
    triangles: Canonical<'_>,
    limits: RecordLimits,
) -> Option<Binary> {
    let splitter = Splitter { triangles, limits, root_area: 0.0, spatial: false };
    let mut tree = Binary { nodes, primitives, cost: 0.0 };
    tree.cost = splitter.plan(&mut tree.nodes, &tree.primitives, 0).0.as_child();
    (levels(&tree.nodes) <= DEPTH_LIMIT).then_some(tree)
}

/// The triangles in canonical order.
#[derive(Clone, Copy)]
pub(super) struct Canonical<'a> {
    /// The triangles as they came.
    pub triangles: &'a [super::BrickTriangle],
    /// Their canonical order, each once.
    pub order: &'a [u32],
    /// The parts that the brick is responsible for, by canonical numbers; empty if all triangles are whole.
    pub parts: &'a [Part],
}

/// A part of a triangle that was cut before the brick was made.
pub(super) struct Part {
    /// The triangle's canonical number.
    id: u32,
    /// The box that holds the part.
    bounds: Aabb,
}

impl Part {
    /// The parts of sorted triangles, whose boxes are `boxes` (all or none); drops from `order` triangles that come again.
    pub fn list(triangles: &[super::BrickTriangle], boxes: &[Aabb], order: &mut Vec<u32>) -> Vec<Part> {
        if boxes.is_empty() {
            return Vec::new();
        }
        let mut parts: Vec<Part> = Vec::with_capacity(order.len());
        let mut distinct = 0;
        for place in 0..order.len() {
            let index = order[place];
            let again = distinct > 0 && triangles[order[distinct - 1] as usize] == triangles[index as usize];
            if !again {
                order[distinct] = index;
                distinct += 1;
            }
            parts.push(Part { id: distinct as u32 - 1, bounds: boxes[index as usize] });
        }
        order.truncate(distinct);
        // Parts of a triangle stand as the input had them; which comes first must not matter.
        let place = |part: &Part| (part.id, [part.bounds.min, part.bounds.max].map(super::record::bits));
        parts.sort_unstable_by_key(place);
        parts
    }
}

impl<'a> Canonical<'a> {
    /// The triangle with canonical number `id`.
    pub fn triangle(&self, id: u32) -> &'a Triangle {
        &self.triangles[self.order[id as usize] as usize].triangle
    }

    /// What is to be built: every triangle, or every part, in canonical order.
    pub fn primitives(&self) -> Vec<Primitive> {
        let whole = |id: u32| Primitive::new(id, self.triangle(id));
        if self.parts.is_empty() {
            return (0..self.order.len() as u32).map(whole).collect();
        }
        let part =
            |&Part { id, bounds }: &Part| whole(id).within(Span { min: bounds.min.into(), max: bounds.max.into() });
        self.parts.iter().map(part).collect()
    }
}

#[derive(Clone, Copy)]
struct Splitter<'a> {
    triangles: Canonical<'a>,
    limits: RecordLimits,
    /// Half the surface of the whole.
    root_area: f64,
    /// Whether there is any room, so that spatial splits are to be tried, or there are parts already.
    spatial: bool,
}

/// What a list is like.
struct Summary {
    /// The box of the primitives.
    span: Span,
    /// The box of their centres.
    centres: Span,
    /// Whether any is large.
    large: bool,
}

impl Summary {
    fn of(primitives: &[Primitive]) -> Summary {
        let mut sum = Summary { span: Span::EMPTY, centres: Span::EMPTY, large: false };
        for primitive in primitives {
            let centre = primitive.centre();
            sum.span = sum.span.union(primitive.span());
            sum.centres = sum.centres.around(centre, centre);
            sum.large |= primitive.large != 0;
        }
        sum
    }

    /// The box alone: all that is wanted of a list that is not split.
    fn of_terminal(primitives: &[Primitive]) -> Summary {
        let span = primitives.iter().fold(Span::EMPTY, |all, p| all.union(p.span()));
        Summary { span, centres: Span::EMPTY, large: false }
    }
}

impl Splitter<'_> {
    /// Appends the subtree over the first `count` of `list`, whose first place is number `first` of all; returns its
    /// costs. The rest of `list` is room for second places.
    fn subtree(
        &self,
        list: &mut [Primitive],
        count: usize,
        first: usize,
        depth: u32,
        nodes: &mut Vec<BinaryNode>,
    ) -> (Costs, bool) {
        let is_terminal = count <= TERMINAL.min(self.limits.triangles);
        let sum = if is_terminal { Summary::of_terminal(&list[..count]) } else { Summary::of(&list[..count]) };
        let area = sum.span.half_area();
        let here = nodes.len();
        nodes.push(BinaryNode {
            min: sum.span.min.to_array(),
            max: sum.span.max.to_array(),
            right: 0,
            first: first as u32,
            count: count as u32,
            plan: Plan::default(),
        });
        if is_terminal {
            return (Costs::terminal(area), true);
        }

        let parts = self.partition(list, count, &sum, depth);
        let (low, high) = self.share_room(list, parts);
        let (parallel, second) = (count > PARALLEL, first + low.len());
        let (left, right) = if parallel {
            let mut other = Vec::with_capacity(parts[1]);
            let costs = rayon::join(
                || self.subtree(low, parts[0], first, depth + 1, nodes),
                || self.subtree(high, parts[1], second, depth + 1, &mut other),
            );
            nodes[here].right = (nodes.len() - here) as u32;
            nodes.append(&mut other);
            costs
        } else {
            let left = self.subtree(low, parts[0], first, depth + 1, nodes);
            nodes[here].right = (nodes.len() - here) as u32;
            (left, self.subtree(high, parts[1], second, depth + 1, nodes))
        };

        let is_record = match self.spatial {
            true => self.is_record(&nodes[here + 1..], list, first),
            // What holds too much for a record is part of no record.
            false => left.1 && right.1 && self.limits.fit(list.iter().map(|p| self.triangles.triangle(p.id))),
        };
        let (costs, plan) = Costs::of_parent(area, is_record, &left.0, &right.0);
        nodes[here].plan = plan;
        (costs, is_record)
    }

    /// Plans the subtree of a node; its costs, and the number of the node after the last below it.
    fn plan(&self, nodes: &mut [BinaryNode], primitives: &[Primitive], here: usize) -> (Costs, usize) {
        let BinaryNode { min, max, right, .. } = nodes[here];
        let area = Span { min: min.into(), max: max.into() }.half_area();
        if right == 0 {
            return (Costs::terminal(area), here + 1);
        }
        let (left, second) = self.plan(nodes, primitives, here + 1);
        let (right, end) = self.plan(nodes, primitives, second);
        let is_record = self.is_record(&nodes[here + 1..end], primitives, 0);
        let (costs, plan) = Costs::of_parent(area, is_record, &left, &right);
        nodes[here].plan = plan;
        (costs, end)
    }

    /// Divides what room is left between two parts, the second of which is moved behind the room of the first.
    fn share_room<'l>(
        &self,
        list: &'l mut [Primitive],
        parts: [usize; 2],
    ) -> (&'l mut [Primitive], &'l mut [Primitive]) {
        let [low, both] = [parts[0], parts[0] + parts[1]];
        let room = list.len() - both;
        let share = spatial::share_of_room(room, &list[..low], &list[low..both]);
        if share > 0 {
            list.copy_within(low..both, low + share);
        }
        list.split_at_mut(low + share)
    }

    /// Whether one record holds all triangles of a subtree, given by the nodes below its root; `first` is the number of
    /// the list's first place. Parts of a triangle that meet again count once.
    fn is_record(&self, below: &[BinaryNode], list: &[Primitive], first: usize) -> bool {
        const MOST: usize = 2 * crate::format::LEAF_MAX;
        let mut ids = [0u32; MOST];
        let mut len = 0;
        for node in below.iter().filter(|node| node.right == 0) {
            let from = node.first as usize - first;
            for primitive in &list[from..from + node.count as usize] {
                if len == MOST {
                    return false;
                }
                ids[len] = primitive.id;
                len += 1;
            }
        }
        let distinct = distinct(&mut ids[..len]);
        self.limits.fit(distinct.iter().map(|&id| self.triangles.triangle(id)))
    }

    /// Reorders the primitives into two parts, neither empty; the lengths of both.
    fn partition(&self, list: &mut [Primitive], count: usize, sum: &Summary, depth: u32) -> [usize; 2] {
        let halves = [count / 2, count - count / 2];
        let (primitives, room) = list.split_at_mut(count);
        let binning = Binning::new(sum.centres, count);
        if depth + ceil_log2(count) >= DEPTH_LIMIT {
            if binning.is_some() {
                let extent = (sum.centres.max - sum.centres.min).to_array();
                let axis = (1..3).fold(0, |best, axis| if extent[axis] > extent[best] { axis } else { best });
                let key = |p: &Primitive| p.centre()[axis];
                primitives.select_nth_unstable_by(count / 2, |p, q| key(p).total_cmp(&key(q)).then(p.id.cmp(&q.id)));
            }
            return halves;
        }
        let split = binning.map(|binning| best_split(primitives, &binning, self.spatial));
        if !room.is_empty() && sum.large && split.as_ref().is_none_or(|s| s.overlap > OVERLAP * self.root_area) {
            let bound = split.as_ref().map_or(f64::INFINITY, |s| s.cost);
            let cut = spatial::best_cut(primitives, sum.span, room.len(), bound, self.triangles);
            if let Some(parts) = cut.and_then(|cut| spatial::apply(cut, list, count, self.triangles)) {
                return parts;
            }
        }
        let (Some(binning), Some(split)) = (binning, split) else { return halves };
        if split.below == 0 || split.below == count {
            return halves;
        }
        let (low, high) = list[..count].split_at_mut(split.below);
        exchange(low, high, |p| binning.is_below(split.axis, split.bin, p));
        [split.below, count - split.below]
    }
}

/// The numbers in order, each once.
fn distinct(ids: &mut [u32]) -> &[u32] {
    ids.sort_unstable();
    let mut len = 0;
    for i in 0..ids.len() {
        if i == 0 || ids[i] != ids[i - 1] {
            ids[len] = ids[i];
            len += 1;
        }
    }
    &ids[..len]
}

/// Levels of a balanced tree over so many.
fn ceil_log2(count: usize) -> u32 {
    count.next_power_of_two().trailing_zeros()
}

/// Exchanges those in `low` for which `is_low` does not hold with those in `high` for which it does, and which are as many:
/// the first with the last, and so on, as Hoare's partition does.
///
/// Which ones these are is noted a block at a time, without a branch that no processor could predict (Edelkamp and Weiß
/// 2016, "BlockQuicksort: avoiding branch mispredictions in quicksort").
fn exchange(low: &mut [Primitive], high: &mut [Primitive], is_low: impl Fn(&Primitive) -> bool) {
    const BLOCK: usize = 64;
    let (mut from_low, mut from_high) = ([0u8; BLOCK], [0u8; BLOCK]);
    // What is noted of the last block and not yet exchanged, and where the blocks begin that come next.
    let (mut lows, mut highs) = (0..0, 0..0);
    let (mut low_at, mut high_at) = (0, 0);
    let (mut low_next, mut high_end) = (0, high.len());
    loop {
        while lows.is_empty() && low_next < low.len() {
            let block = &low[low_next..low.len().min(low_next + BLOCK)];
            let mut noted = 0;
            for (place, primitive) in block.iter().enumerate() {
                from_low[noted % BLOCK] = place as u8;
                noted += usize::from(!is_low(primitive));
            }
            (lows, low_at, low_next) = (0..noted, low_next, low_next + block.len());
        }
        while highs.is_empty() && high_end > 0 {
            high_at = high_end.saturating_sub(BLOCK);
            let mut noted = 0;
            for (place, primitive) in high[high_at..high_end].iter().enumerate().rev() {
                from_high[noted % BLOCK] = place as u8;
                noted += usize::from(is_low(primitive));
            }
            (highs, high_end) = (0..noted, high_at);
        }
        let pairs = lows.len().min(highs.len());
        if pairs == 0 {
            return;
        }
        for (i, j) in lows.by_ref().zip(highs.by_ref()).take(pairs) {
            let (i, j) = (low_at + usize::from(from_low[i]), high_at + usize::from(from_high[j]));
            std::mem::swap(&mut low[i], &mut high[j]);
        }
    }
}
