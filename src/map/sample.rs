//! Small files for tests, made by a builder as plain as can be.
//!
//! Triangles go to up to eight bricks by their number, each brick's tree cuts its list in eight until a leaf holds what
//! is left. The boxes are right, the tree is bad, and every feature of the format can be asked for.

use std::path::Path;

use glam::{DVec3, Vec3};

use crate::format::{
    Brick, Flags, Frame, Header, LeafUnit, MaterialRecord, Node, OctWriter, PageHeader, PageId, SideArrays, Slot,
    Surrogate, Top, encode_leaf,
};
use crate::geometry::{Aabb, RootCube, Triangle};

/// What a file is to hold.
pub(crate) struct Sample {
    pub(crate) triangles: Vec<Triangle>,
    pub(crate) flags: Flags,
    /// 1 to 8.
    pub(crate) bricks: usize,
}

/// Number of materials where the flags ask for them.
pub(crate) const MATERIALS: u32 = 3;

/// A surrogate of which everything is true: its slab is wider than any frame, its cone has all directions.
const ANYTHING: Surrogate = Surrogate {
    normal: [0, 0],
    offset: 64 * 128,
    deviation: 255,
    cone: 1,
    coverage: [255; 3],
    agreement: 0,
    color: [255; 3],
    zero: 0,
};

/// A cheap sequence of numbers that look random.
pub(crate) fn random(state: &mut u64) -> u64 {
    *state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
    let x = *state ^ *state >> 29;
    x.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 11
}

/// Small triangles all over a box.
pub(crate) fn soup(count: usize, seed: u64) -> Vec<Triangle> {
    let mut state = seed;
    let mut number = move |scale: f32| (random(&mut state) % 20_001) as f32 / 10_000.0 * scale - scale;
    let mut point = move |scale: f32| Vec3::new(number(scale), number(scale), number(scale));
    let mut triangle = || {
        let a = point(10.0);
        Triangle { a, b: a + point(0.5), c: a + point(0.5) }
    };
    (0..count).map(|_| triangle()).collect()
}

impl Sample {
    /// `count` triangles of a soup; where leaves may hold steps, nearly all on a grid.
    pub(crate) fn new(count: usize, flags: u32, bricks: usize) -> Sample {
        let mut sample = Sample { triangles: soup(count, 1), flags: Flags(flags), bricks };
        if sample.flags.has(Flags::STEPS) {
            let near = |v: Vec3| (v * 1024.0).round() / 1024.0 + 0.0;
            let round = |t: Triangle| Triangle { a: near(t.a), b: near(t.b), c: near(t.c) };
            sample.triangles.iter_mut().skip(20).for_each(|t| *t = round(*t));
        }
        sample
    }

    /// The numbers of a brick's triangles; where the flags allow it, every seventh is in all bricks.
    pub(crate) fn numbers(&self, brick: usize) -> Vec<u32> {
        let everywhere = |i: u32| self.flags.has(Flags::REPEATS) && i.is_multiple_of(7);
        (0..self.triangles.len() as u32).filter(|&i| i as usize % self.bricks == brick || everywhere(i)).collect()
    }

    /// The material number of a triangle.
    pub(crate) fn material(i: u32) -> u32 {
        i % (MATERIALS + 1)
    }

    /// Vertex normals of a triangle, if it has them.
    pub(crate) fn normals(i: u32) -> Option<[[f32; 3]; 3]> {
        let x = i as f32;
        (!i.is_multiple_of(3)).then_some([[x, 0.0, 1.0], [x, 1.0, 1.0], [-0.0, x, 2.0]])
    }

    /// Texture coordinates of a triangle, if it has them.
    pub(crate) fn texcoords(i: u32) -> Option<[[f32; 2]; 3]> {
        i.is_multiple_of(2).then_some([[i as f32, 0.0], [i as f32, 1.0], [-1.0, 0.5]])
    }

    /// The materials and their strings.
    pub(crate) fn materials(&self) -> (Vec<MaterialRecord>, String) {
        if !self.flags.has(Flags::MATERIALS) {
            return (Vec::new(), String::new());
        }
        let record = |i: u32| MaterialRecord {
            kd: [i as f32, 0.5, 0.25],
            ns: 10.0,
            given: 0b1010,
            name: [0, 4],
            map_kd: [4, 2 * i],
            ..MaterialRecord::default()
        };
        ((0..MATERIALS).map(record).collect(), "Glas\u{e4}.ng".into())
    }

    /// Writes the file.
    pub(crate) fn write(&self, path: &Path) -> u64 {
        let bounds = self.triangles.iter().map(Aabb::from).fold(Aabb::EMPTY, Aabb::union);
        let root = RootCube::around(bounds);
        let mut writer = OctWriter::create(path).unwrap();
        let mut top = Node::EMPTY;
        let (mut bricks, mut leaves, mut nodes, mut depth) = (Vec::new(), 0, 0, 0);
        let mut first_reference = 0;
        for brick in 0..self.bricks {
            let numbers = self.numbers(brick);
            let mut frame = Frame { corner: [0.0; 3], unit: [1.0 / 256.0; 3] };
            if self.bricks > 1 {
                self.enclose(&mut top, brick, &Frame::ROOT, &numbers, root);
                top.slots[brick] = Slot::Brick(brick as u8).encode();
                frame = Frame::ROOT.child(&top, brick);
            }
            let tree = Tree::build(self, root, frame, numbers);
            let id = PageId(brick as u32);
            let mut side = self.side_arrays(&tree.order);
            if self.flags.has(Flags::DETAIL) {
                side.surrogates = vec![ANYTHING; tree.nodes.len()];
            }
            let page = tree.layout(id, &side, self.flags);
            writer.append(&page).unwrap();
            bricks.push(Brick {
                node: 0,
                first_reference,
                corner: frame.corner.map(|x| x as f32),
                unit: frame.unit.map(|x| x as f32),
            });
            first_reference += tree.order.len() as u32;
            (leaves, nodes, depth) = (leaves + tree.leaves, nodes + tree.nodes.len(), depth.max(tree.depth));
        }
        let tops: &[Node] = if self.bricks > 1 { &[top] } else { &[] };
        let (materials, strings) = self.materials();
        let header = Header {
            flags: self.flags,
            triangles: self.triangles.len() as u64,
            references: first_reference.into(),
            source_triangles: self.triangles.len() as u64 + 2,
            dropped: crate::format::Dropped { degenerate: 2, too_few_corners: 7, ..Default::default() },
            vertices: 3 * self.triangles.len() as u64,
            nodes: (nodes + tops.len()) as u64,
            leaves: leaves.into(),
            depth: depth + tops.len() as u32,
            root_corner: root.corner.to_array(),
            root_log2_side: root.log2_side,
            bounds_min: bounds.min.to_array(),
            bounds_max: bounds.max.to_array(),
            leaf_limit: 16,
            depth_limit: 21,
            ..bytemuck::Zeroable::zeroed()
        };
        let top = Top {
            nodes: tops,
            bricks: &mut bricks,
            materials: &materials,
            strings: strings.as_bytes(),
            surrogates: &mut |_, _| vec![ANYTHING],
        };
        writer.finish(header, top).unwrap()
    }

    /// Sets a slot's planes around triangles.
    fn enclose(&self, node: &mut Node, slot: usize, frame: &Frame, numbers: &[u32], root: RootCube) {
        let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for v in numbers.iter().flat_map(|&i| self.triangles[i as usize].vertices()) {
            let v = root.to_root_units(v);
            (low, high) = (low.min(v), high.max(v));
        }
        for axis in 0..3 {
            let step = |x: f64| (x - frame.corner[axis]) / frame.unit[axis];
            node.low[axis][slot] = (step(low[axis]) - 1.0 / 64.0).floor().clamp(0.0, 254.0) as u8;
            node.high[axis][slot] = (step(high[axis]) + 1.0 / 64.0).ceil().clamp(1.0, 255.0) as u8;
        }
    }

    /// The side arrays of a page whose references are those triangles.
    fn side_arrays(&self, order: &[u32]) -> SideArrays {
        let mut side = SideArrays::default();
        for &i in order {
            if self.flags.has(Flags::IDS) {
                side.ids.push(i);
            }
            if self.flags.has(Flags::MATERIALS) {
                side.materials.push(Sample::material(i));
            }
            if self.flags.has(Flags::NORMALS) {
                side.normal_corners.push(place(&mut side.normals, Sample::normals(i)));
            }
            if self.flags.has(Flags::TEXCOORDS) {
                side.texcoord_corners.push(place(&mut side.texcoords, Sample::texcoords(i)));
            }
        }
        side
    }
}

/// Appends three entries to a table and returns their places.
fn place<T>(table: &mut Vec<T>, entries: Option<[T; 3]>) -> [u32; 3] {
    entries.map_or([u32::MAX; 3], |entries| {
        let first = table.len() as u32;
        table.extend(entries);
        [first, first + 1, first + 2]
    })
}

/// A brick's tree.
struct Tree {
    nodes: Vec<Node>,
    leaf_bytes: Vec<u8>,
    leaves: u32,
    depth: u32,
    /// The triangle of each reference.
    order: Vec<u32>,
}

impl Tree {
    fn build(sample: &Sample, root: RootCube, frame: Frame, numbers: Vec<u32>) -> Tree {
        let unit = sample.flags.leaf_unit();
        let most = if unit == LeafUnit::B32 { 10 } else { 5 };
        let mut tree =
            Tree { nodes: vec![Node::EMPTY], leaf_bytes: Vec::new(), leaves: 0, depth: 0, order: Vec::new() };
        let mut queue = std::collections::VecDeque::from([(0, 1, frame, numbers)]);
        while let Some((index, depth, frame, numbers)) = queue.pop_front() {
            tree.depth = tree.depth.max(depth);
            let mut node = Node::EMPTY;
            let mut rank = 0;
            for (slot, part) in numbers.chunks(numbers.len().div_ceil(8)).enumerate() {
                sample.enclose(&mut node, slot, &frame, part, root);
                if part.len() <= most {
                    if node.first_leaf == 0 {
                        // From the region's start for now, in 16-byte units plus one.
                        node.first_leaf = tree.leaf_bytes.len() as u32 / 16 + 1;
                    }
                    let units = (tree.leaf_bytes.len() as u32 / 16 + 1 - node.first_leaf) * 16 / unit.bytes() as u32;
                    node.slots[slot] = Slot::Leaf(units as u8).encode();
                    let list: Vec<_> = part.iter().map(|&i| sample.triangles[i as usize]).collect();
                    encode_leaf(&mut tree.leaf_bytes, unit, sample.flags.points(), tree.order.len() as u32, &list)
                        .unwrap();
                    tree.leaves += 1;
                    tree.order.extend(part);
                } else {
                    if node.first_child == 0 {
                        node.first_child = (tree.nodes.len() - index) as u32;
                    }
                    node.slots[slot] = Slot::Inner(rank).encode();
                    queue.push_back((tree.nodes.len(), depth + 1, frame.child(&node, slot), part.to_vec()));
                    tree.nodes.push(Node::EMPTY);
                    rank += 1;
                }
            }
            tree.nodes[index] = node;
        }
        let count = tree.nodes.len();
        for (i, node) in tree.nodes.iter_mut().enumerate().filter(|(_, node)| node.first_leaf != 0) {
            node.first_leaf += 4 * (count - i) as u32 - 1;
        }
        tree
    }

    fn layout(&self, id: PageId, side: &SideArrays, flags: Flags) -> Vec<u8> {
        let wide = flags.has(Flags::WIDE_MATERIALS);
        let references = self.order.len() as u32;
        PageHeader::layout(id, &self.nodes, &self.leaf_bytes, self.leaves, references, side, wide).unwrap()
    }
}
