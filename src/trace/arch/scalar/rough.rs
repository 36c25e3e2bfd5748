//! A leaf in f32 without bounds, in portable code: [`Shear::classify`] less all that makes it certain.

use super::super::Rough;
use super::{coordinates, spread};
use crate::exact::{LANES, Shear};
use crate::format::{Coding, Leaf};

/// As [`Kernel::nearest`](super::Kernel::nearest).
#[inline]
pub(in super::super) fn nearest(leaf: &Leaf<'_>, shear: &Shear, range: [f32; 2]) -> Option<Rough> {
    match leaf.coding() {
        Coding::Nibbles => nearest_over::<16>(leaf, shear, &spread(leaf.corner_words()), range),
        Coding::Bytes => nearest_over::<32>(leaf, shear, &leaf.corner_bytes(), range),
    }
}

/// The same over a table of N vertices, read in place where they are f32 and the page goes on long enough behind the leaf.
#[inline]
fn nearest_over<const N: usize>(
    leaf: &Leaf<'_>,
    shear: &Shear,
    corners: &[[u8; LANES]; 3],
    range: [f32; 2],
) -> Option<Rough> {
    match shear.axes.map(|axis| coordinates::<N>(leaf, axis)) {
        [Some(x), Some(y), Some(z)] => nearest_of([x, y, z], shear, corners, leaf.len(), range),
        _ => {
            let copies = shear.axes.map(|axis| leaf.table::<N>(axis));
            nearest_of([&copies[0], &copies[1], &copies[2]], shear, corners, leaf.len(), range)
        }
    }
}

#[inline(always)]
fn nearest_of<const N: usize>(
    [x, y, z]: [&[f32; N]; 3],
    shear: &Shear,
    corners: &[[u8; LANES]; 3],
    count: usize,
    [first, mut last]: [f32; 2],
) -> Option<Rough> {
    let ([ox, oy, oz], [sx, sy]) = (shear.origin(), shear.slopes());
    let mut sheared = [[0.0f32; 3]; N];
    for i in 0..N {
        let depth = z[i] - oz;
        sheared[i] = [(x[i] - ox) - sx * depth, (y[i] - oy) - sy * depth, depth];
    }
    let mut best = None;
    for j in 0..count.min(LANES) {
        let [ax, ay, az] = sheared[usize::from(corners[0][j]) % N];
        let [bx, by, bz] = sheared[usize::from(corners[1][j]) % N];
        let [cx, cy, cz] = sheared[usize::from(corners[2][j]) % N];
        let u = bx * cy - by * cx;
        let v = cx * ay - cy * ax;
        let w = ax * by - ay * bx;
        if (u >= 0.0) & (v >= 0.0) & (w >= 0.0) | (u <= 0.0) & (v <= 0.0) & (w <= 0.0) {
            // Where all are zero t is NaN, and compares false.
            let share = 1.0 / ((u + v) + w);
            let t = ((u * az + v * bz) + w * cz) * share * shear.inverse();
            if t >= first && t <= last {
                last = t;
                best = Some(Rough { lane: j as u32, t, u: v * share, v: w * share });
            }
        }
    }
    best
}
