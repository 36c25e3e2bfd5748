//! The 64-byte node and the frame its boxes live in.

use bytemuck::{Pod, Zeroable};

/// A node: eight slots with boxes in 8-bit steps of the node's frame. FORMAT.md, "Node".
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
#[repr(C, align(64))]
pub struct Node {
    /// Low planes: `low[axis][slot]`.
    pub low: [[u8; 8]; 3],
    /// High planes: `high[axis][slot]`.
    pub high: [[u8; 8]; 3],
    /// First inner child, in 64-byte units from this node; 0 = none.
    pub first_child: u32,
    /// First leaf, in 16-byte units from this node; 0 = none. In top nodes: number of the first brick.
    pub first_leaf: u32,
    /// One byte a slot, see [`Slot`].
    pub slots: [u8; 8],
}

const _: () = assert!(size_of::<Node>() == 64);

/// Most nodes on a path within the top tree, and within a page.
pub const DEPTH_MAX: u32 = 64;

/// What a slot byte says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Slot {
    /// Nothing.
    Empty,
    /// Inner child of that rank.
    Inner(u8),
    /// Brick that many (0..=63) after the first (top nodes only).
    Brick(u8),
    /// Leaf that many leaf units after the first.
    Leaf(u8),
}

impl Slot {
    /// Reads a slot byte; `None` where FORMAT.md gives it no meaning.
    pub fn decode(byte: u8) -> Option<Slot> {
        match byte {
            0x7f => Some(Slot::Empty),
            0x00..=0x7e => Some(Slot::Leaf(byte)),
            0x80..=0x87 => Some(Slot::Inner(byte & 7)),
            0xc0..=0xff => Some(Slot::Brick(byte & 0x3f)),
            _ => None,
        }
    }

    /// The slot byte.
    pub fn encode(self) -> u8 {
        match self {
            Slot::Empty => 0x7f,
            Slot::Leaf(offset) => offset,
            Slot::Inner(rank) => 0x80 | rank,
            Slot::Brick(rank) => 0xc0 | rank,
        }
    }
}

impl Node {
    /// A node without children: every slot empty.
    pub const EMPTY: Node =
        Node { low: [[255; 8]; 3], high: [[0; 8]; 3], first_child: 0, first_leaf: 0, slots: [0x7f; 8] };
}

/// A node's frame in root units: plane q of axis i lies at `corner[i] + q * unit[i]`, exactly, in f64.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame {
    /// Plane 0 of each axis.
    pub corner: [f64; 3],
    /// Step of each axis, a power of two not below 2^-32.
    pub unit: [f64; 3],
}

impl Frame {
    /// Smallest unit, 2^-32.
    pub const LEAST_UNIT: f64 = 1.0 / 4_294_967_296.0;

    /// The frame of the root of the top tree.
    pub const ROOT: Frame = Frame { corner: [0.0; 3], unit: [1.0 / 256.0; 3] };

    /// The frame of the inner child in `slot`: the rule of FORMAT.md, which builder and kernels replay alike.
    pub fn child(&self, node: &Node, slot: usize) -> Frame {
        let mut frame = *self;
        for axis in 0..3 {
            let (low, high) = (node.low[axis][slot], node.high[axis][slot]);
            frame.corner[axis] += f64::from(low) * self.unit[axis];
            frame.unit[axis] = (self.unit[axis] * Frame::shrink(low, high)).max(Frame::LEAST_UNIT);
        }
        frame
    }

    /// `2^(floor(log2(high - low)) - 7)`, for `high > low`.
    pub fn shrink(low: u8, high: u8) -> f64 {
        let exponent = 31 - u32::from(high.saturating_sub(low).max(1)).leading_zeros();
        f64::from(1u32 << exponent) / 128.0
    }
}
