//! The portable inner loops.

pub(super) mod rough;

use glam::Vec3;

use super::{Aim, Block, Cell, Fit, Kernel, MODERATE, NEAR, Planes, Rough, Rounded, Row, Saved, WIDE, Way};
use crate::exact::{Depths, LANES, Lanes, Line, Shear};
use crate::format::{Coding, Frame, Leaf, Node, Points};
use crate::geometry::{Ray, Triangle};

/// Portable code over fixed arrays.
#[derive(Clone, Copy, Debug)]
pub(super) struct Scalar;

impl Kernel for Scalar {
    type Frame = Planes;
    type Near = [f32; 8];
    type Ends = [f32; 2];

    #[inline(always)]
    fn aim(self, ray: &Ray, fit: &Fit, way: &mut Way, aim: &mut Aim) -> bool {
        let mut plain = (ray.tmin <= ray.tmax) & fit.side.is_finite();
        let mut mask = 0;
        for i in 0..3 {
            // Scaling by a power of two is exact.
            let (p, d) = ((f64::from(ray.origin[i]) - fit.corner[i]) * fit.scale, ray.direction[i]);
            plain &= (p.abs() <= NEAR) & (d.abs() >= MODERATE[0]) & (d.abs() <= MODERATE[1]);
            let inv = fit.side / d;
            let slack = inv.abs() * (fit.rounding * (p.abs() as f32 + 3.01));
            (aim.origin[i], aim.inv[i], aim.slack[i]) = (p, inv, slack);
            way.slack[i] = 2.0 * slack;
            let least = inv * Frame::LEAST_UNIT as f32;
            (way.least[0][i], way.least[1][i], way.least[2][i], way.least[3][i]) = (least, least, -least, -least);
            mask = mask << 1 | u8::from(d < 0.0);
        }
        way.mask = mask;
        plain
    }

    #[inline(always)]
    fn frame(self, cell: &Cell, aim: &Aim, _: &Way) -> Planes {
        let mut planes = Planes { begin: [0.0; 4], dt: [0.0; 4] };
        for i in 0..3 {
            let corner = (f64::from(cell.corner[i]) - aim.origin[i]) as f32;
            planes.begin[i] = corner * aim.inv[i] - aim.slack[i];
            planes.dt[i] = cell.unit[i] * aim.inv[i];
        }
        planes
    }

    #[inline(always)]
    fn save(self, saved: &mut Saved, planes: Planes, near: [f32; 8]) {
        saved.near = near;
        saved.frame[..4].copy_from_slice(&planes.begin);
        saved.frame[4..8].copy_from_slice(&planes.dt);
    }

    #[inline(always)]
    fn load(self, saved: &Saved) -> (Planes, [f32; 8]) {
        let four = |at: usize| std::array::from_fn(|i| saved.frame[at + i]);
        (Planes { begin: four(0), dt: four(4) }, saved.near)
    }

    #[inline(always)]
    fn fetch<T>(self, _: &T, _: usize) {}

    #[inline(always)]
    fn ends(self, near: f32, far: f32) -> [f32; 2] {
        [near, far]
    }

    /// Maxima and minima are comparisons that keep the bound in place where a value is NaN.
    #[inline(always)]
    fn touch(self, node: &Node, planes: Planes, way: &Way, [begin, far]: [f32; 2]) -> (u32, [f32; 8]) {
        let mut near = [begin; 8];
        let mut last = [far; 8];
        for axis in 0..3 {
            let down = way.mask & (4 >> axis) != 0;
            let (first, second) = if down { (&node.high, &node.low) } else { (&node.low, &node.high) };
            let (first, second) = (&first[axis], &second[axis]);
            let (dt, begin) = (planes.dt[axis], planes.begin[axis]);
            let end = begin + way.slack[axis];
            for i in 0..8 {
                let slot = i ^ usize::from(way.order & 7);
                let enter = begin + f32::from(first[slot]) * dt;
                let leave = end + f32::from(second[slot]) * dt;
                near[i] = if enter > near[i] { enter } else { near[i] };
                last[i] = if leave < last[i] { leave } else { last[i] };
            }
        }
        let mut slots = 0;
        for i in 0..8 {
            slots |= u32::from(near[i] <= last[i]) << i;
        }
        (slots, near)
    }

    #[inline(always)]
    fn planes(self, node: &Node, way: &Way) -> [[f32; 16]; 3] {
        std::array::from_fn(|axis| {
            let down = way.mask & (4 >> axis) != 0;
            let (first, second) = if down { (&node.high, &node.low) } else { (&node.low, &node.high) };
            std::array::from_fn(|i| {
                let slot = i & 7 ^ usize::from(way.order & 7);
                f32::from(if i < 8 { first[axis][slot] } else { second[axis][slot] })
            })
        })
    }

    #[inline(always)]
    fn within(self, near: [f32; 8], far: f32) -> u32 {
        (0..8).fold(0, |bits, i| bits | u32::from(near[i] <= far) << i)
    }

    #[inline(always)]
    fn child(self, planes: Planes, node: &Node, slot: usize, way: &Way) -> Planes {
        let mut child = planes;
        for axis in 0..3 {
            let (low, high) = (node.low[axis][slot & 7], node.high[axis][slot & 7]);
            child.begin[axis] += f32::from(low) * planes.dt[axis];
            // A power of two times dt: exact.
            let dt = planes.dt[axis] * Frame::shrink(low, high) as f32;
            child.dt[axis] = if dt.abs() < way.least[0][axis].abs() { way.least[0][axis] } else { dt };
        }
        child
    }

    #[inline(always)]
    fn classify(self, leaf: &Leaf<'_>, shear: &Shear, range: [f32; 2], depths: &mut Depths) -> Lanes {
        classify(leaf, shear, range, depths)
    }

    #[inline(always)]
    fn rounded(self, block: &Block, wanted: u32, to: &mut Rounded) {
        to.certain = 0;
        for i in (0..WIDE).filter(|i| wanted >> i & 1 != 0) {
            let of = |points: &[Row; 3]| [points[0].0[i], points[1].0[i], points[2].0[i]];
            let corner = |points| Vec3::from_array(of(points));
            let triangle = Triangle { a: corner(&block.a), b: corner(&block.b), c: corner(&block.c) };
            let line = Line::new(&Ray::new(of(&block.origin), of(&block.direction)));
            if let Some([t, u, v]) = line.rounded(&triangle) {
                to.certain |= 1 << i;
                (to.t.0[i], to.u.0[i], to.v.0[i]) = (t, u, v);
            }
        }
    }

    #[inline(always)]
    fn nearest(self, leaf: &Leaf<'_>, shear: &Shear, range: [f32; 2]) -> Option<Rough> {
        rough::nearest(leaf, shear, range)
    }
}

/// Classifies a leaf's triangles.
#[inline]
pub(super) fn classify(leaf: &Leaf<'_>, shear: &Shear, range: [f32; 2], depths: &mut Depths) -> Lanes {
    match leaf.coding() {
        Coding::Nibbles => classify_over::<16>(leaf, shear, &spread(leaf.corner_words()), range, depths),
        Coding::Bytes => classify_over::<32>(leaf, shear, &leaf.corner_bytes(), range, depths),
    }
}

/// The same over a table of N vertices, read in place where they are f32 and the page goes on long enough behind the leaf.
#[inline]
fn classify_over<const N: usize>(
    leaf: &Leaf<'_>,
    shear: &Shear,
    corners: &[[u8; LANES]; 3],
    range: [f32; 2],
    depths: &mut Depths,
) -> Lanes {
    match shear.axes.map(|axis| coordinates::<N>(leaf, axis)) {
        [Some(x), Some(y), Some(z)] => shear.classify([x, y, z], corners, leaf.len(), range, depths),
        _ => {
            let copies = shear.axes.map(|axis| leaf.table::<N>(axis));
            shear.classify([&copies[0], &copies[1], &copies[2]], corners, leaf.len(), range, depths)
        }
    }
}

/// N coordinates of one axis, the first of them the leaf's.
#[inline]
fn coordinates<'a, const N: usize>(leaf: &Leaf<'a>, axis: usize) -> Option<&'a [f32; N]> {
    if leaf.points() == Points::Steps {
        return None;
    }
    let begin = leaf.coordinates_at() + 4 * leaf.vertices() * axis;
    let bytes = leaf.bytes().get(begin..begin + 4 * N)?;
    bytemuck::try_cast_slice(bytes).ok()?.try_into().ok()
}

/// Vertex numbers of 4 bits as bytes.
#[inline]
fn spread(words: [u64; 3]) -> [[u8; LANES]; 3] {
    words.map(|word| {
        let half = |x: u64| {
            let x = (x | x << 16) & 0x0000_ffff_0000_ffff;
            let x = (x | x << 8) & 0x00ff_00ff_00ff_00ff;
            ((x | x << 4) & 0x0f0f_0f0f_0f0f_0f0f).to_le_bytes()
        };
        let (low, high) = (half(word & 0xffff_ffff), half(word >> 32));
        std::array::from_fn(|j| if j < 8 { low[j] } else { high[j - 8] })
    })
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
