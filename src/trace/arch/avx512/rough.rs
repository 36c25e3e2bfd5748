//! A leaf in f32 without bounds: sixteen triangles at once.

use std::arch::x86_64::*;

use super::super::{Rough, scalar};
use super::leaf::{bytes, edge, nibbles, pick};
use crate::exact::Shear;
use crate::format::{Coding, Leaf};

/// As [`Kernel::nearest`](super::Kernel::nearest).
///
/// # Safety
/// AVX-512 must be there.
#[inline(always)]
pub(super) unsafe fn nearest(leaf: &Leaf<'_>, shear: &Shear, range: [f32; 2]) -> Option<Rough> {
    if leaf.is_empty() || leaf.bytes().len() < leaf.reach(16) {
        return scalar::rough::nearest(leaf, shear, range);
    }
    // SAFETY: the caller vouches for the instructions; all loads end before the reach, which lies within the leaf's bytes.
    unsafe {
        match leaf.coding() {
            Coding::Nibbles => {
                let (index, table) = nibbles(leaf, shear);
                nearest_of::<false>(index, table, shear, leaf.len(), range)
            }
            Coding::Bytes => {
                let (index, table) = bytes(leaf, shear);
                nearest_of::<true>(index, table, shear, leaf.len(), range)
            }
        }
    }
}

/// The nearest of sixteen triangles.
///
/// # Safety
/// AVX-512 must be there.
#[inline(always)]
unsafe fn nearest_of<const WIDE: bool>(
    [ia, ib, ic]: [__m512i; 3],
    [[x, y, z], [x1, y1, z1]]: [[__m512; 3]; 2],
    shear: &Shear,
    count: usize,
    range: [f32; 2],
) -> Option<Rough> {
    // SAFETY: as the caller vouches.
    unsafe {
        let a = [pick::<WIDE>(x, x1, ia), pick::<WIDE>(y, y1, ia)];
        let b = [pick::<WIDE>(x, x1, ib), pick::<WIDE>(y, y1, ib)];
        let c = [pick::<WIDE>(x, x1, ic), pick::<WIDE>(y, y1, ic)];
        let (u, v, w) = (edge(b, c), edge(c, a), edge(a, b));
        let (least, most) = (_mm512_min_ps(_mm512_min_ps(u, v), w), _mm512_max_ps(_mm512_max_ps(u, v), w));
        let zero = _mm512_setzero_ps();
        let front = _mm512_cmp_ps_mask::<_CMP_GE_OQ>(least, zero);
        let back = _mm512_cmp_ps_mask::<_CMP_LE_OQ>(most, zero);
        let hit = (front | back) & (u16::MAX >> (16 - count.clamp(1, 16)));
        if hit == 0 {
            return None;
        }
        let (za, zb, zc) = (pick::<WIDE>(z, z1, ia), pick::<WIDE>(z, z1, ib), pick::<WIDE>(z, z1, ic));
        // Where all are zero t is NaN, and compares false.
        let share = _mm512_div_ps(_mm512_set1_ps(1.0), _mm512_add_ps(_mm512_add_ps(u, v), w));
        let depth = _mm512_fmadd_ps(u, za, _mm512_fmadd_ps(v, zb, _mm512_mul_ps(w, zc)));
        let t = _mm512_mul_ps(_mm512_mul_ps(depth, share), _mm512_set1_ps(shear.inverse()));
        let hit = _mm512_mask_cmp_ps_mask::<_CMP_GE_OQ>(hit, t, _mm512_set1_ps(range[0]));
        let mut hit = _mm512_mask_cmp_ps_mask::<_CMP_LE_OQ>(hit, t, _mm512_set1_ps(range[1]));
        if hit == 0 {
            return None;
        }
        if hit & (hit - 1) != 0 {
            let nearest = _mm512_mask_reduce_min_ps(hit, t);
            hit = _mm512_mask_cmp_ps_mask::<_CMP_EQ_OQ>(hit, t, _mm512_set1_ps(nearest));
        }
        // The lowest lane that is left comes first.
        let t = _mm512_cvtss_f32(_mm512_maskz_compress_ps(hit, t));
        let u = _mm512_cvtss_f32(_mm512_maskz_compress_ps(hit, _mm512_mul_ps(v, share)));
        let v = _mm512_cvtss_f32(_mm512_maskz_compress_ps(hit, _mm512_mul_ps(w, share)));
        Some(Rough { lane: hit.trailing_zeros(), t, u, v })
    }
}
