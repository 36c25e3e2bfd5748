//! The portable inner loops.

use super::{Planes, Touched};
use crate::exact::{LANES, Lanes, Shear};
use crate::format::{Coding, Leaf, Node};
use crate::trace::setup::Setup;

/// Which slots of a node the ray touches between the setup's near parameter and `far`.
///
/// Maxima and minima are comparisons that keep the bound in place where a value is NaN. Empty slots are left to the caller.
#[inline]
pub fn touch(node: &Node, planes: &Planes, setup: &Setup, far: f32) -> Touched {
    let mut near = [setup.near; 8];
    let mut last = [far; 8];
    for axis in 0..3 {
        let down = setup.mask & (4 >> axis) != 0;
        let (first, second) = if down { (&node.high, &node.low) } else { (&node.low, &node.high) };
        let (first, second) = (&first[axis], &second[axis]);
        let (dt, t0) = (planes.dt[axis], planes.t0[axis]);
        let (begin, end) = (t0 - setup.slack[axis], t0 + setup.slack[axis]);
        for slot in 0..8 {
            let enter = begin + f32::from(first[slot]) * dt;
            let leave = end + f32::from(second[slot]) * dt;
            near[slot] = if enter > near[slot] { enter } else { near[slot] };
            last[slot] = if leave < last[slot] { leave } else { last[slot] };
        }
    }
    let mut slots = 0;
    for slot in 0..8 {
        slots |= u8::from(near[slot] <= last[slot]) << slot;
    }
    Touched { near, slots }
}

/// Classifies a leaf's triangles.
#[inline]
pub fn classify(leaf: &Leaf<'_>, shear: &Shear) -> Lanes {
    match leaf.coding() {
        Coding::Nibbles => classify_over::<16>(leaf, shear, &spread(leaf.corner_words())),
        Coding::Bytes => classify_over::<32>(leaf, shear, &leaf.corner_bytes()),
    }
}

/// The same over a table of N vertices, read in place where the page goes on long enough behind the leaf.
#[inline]
fn classify_over<const N: usize>(leaf: &Leaf<'_>, shear: &Shear, corners: &[[u8; LANES]; 3]) -> Lanes {
    match shear.axes.map(|axis| coordinates::<N>(leaf, axis)) {
        [Some(x), Some(y), Some(z)] => shear.classify([x, y, z], corners, leaf.len()),
        _ => {
            let copies = shear.axes.map(|axis| {
                let mut copy = [0.0; N];
                copy.iter_mut().zip(leaf.coordinates(axis)).for_each(|(to, from)| *to = *from);
                copy
            });
            shear.classify([&copies[0], &copies[1], &copies[2]], corners, leaf.len())
        }
    }
}

/// N coordinates of one axis, the first of them the leaf's.
#[inline]
fn coordinates<'a, const N: usize>(leaf: &Leaf<'a>, axis: usize) -> Option<&'a [f32; N]> {
    let begin = leaf.coding().coordinates_at() + 4 * leaf.vertices() * axis;
    let bytes = leaf.bytes().get(begin..begin + 4 * N)?;
    bytemuck::try_cast_slice(bytes).ok()?.try_into().ok()
}

/// Vertex numbers of 4 bits as bytes.
#[inline]
fn spread(words: [u64; 3]) -> [[u8; LANES]; 3] {
    [spread_word(words[0]), spread_word(words[1]), spread_word(words[2])]
}

/// The same for one corner: each step doubles the distance between the halves of what it has.
#[inline]
fn spread_word(word: u64) -> [u8; LANES] {
    let half = |x: u64| {
        let x = (x | x << 16) & 0x0000_ffff_0000_ffff;
        let x = (x | x << 8) & 0x00ff_00ff_00ff_00ff;
        u128::from((x | x << 4) & 0x0f0f_0f0f_0f0f_0f0f)
    };
    (half(word & 0xffff_ffff) | half(word >> 32) << 64).to_le_bytes()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nibbles_spread_in_order() {
        let bytes = spread([0xfedc_ba98_7654_3210, 0, u64::MAX]);
        assert_eq!(bytes[0], std::array::from_fn(|j| j as u8));
        assert_eq!((bytes[1], bytes[2]), ([0; 16], [15; 16]));
    }
}
