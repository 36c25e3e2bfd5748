//! A leaf in f32 without bounds, in two halves of eight triangles.

use std::arch::x86_64::*;

use super::super::{Rough, scalar};
use super::leaf::{Table, edge};
use crate::exact::Shear;
use crate::format::Leaf;

/// As [`Kernel::nearest`](super::Kernel::nearest).
///
/// # Safety
/// AVX2 and FMA must be there.
#[inline(always)]
pub(super) unsafe fn nearest(leaf: &Leaf<'_>, shear: &Shear, range: [f32; 2]) -> Option<Rough> {
    if leaf.is_empty() || leaf.bytes().len() < leaf.reach(8) {
        return scalar::rough::nearest(leaf, shear, range);
    }
    // SAFETY: the caller vouches for the instructions; all loads end before the reach, which lies within the leaf's bytes.
    unsafe {
        let table = Table::of(leaf, shear);
        let first = half(&table, 0, leaf.len(), shear, range);
        if leaf.len() <= 8 {
            return first;
        }
        let last = if let Some(found) = &first { found.t } else { range[1] };
        let second = half(&table, 1, leaf.len() - 8, shear, [range[0], last]);
        if second.is_some() { second } else { first }
    }
}

/// The nearest of triangles 8 h to 8 h + 7, of which there are `count`.
///
/// # Safety
/// AVX2 and FMA must be there.
#[inline(always)]
unsafe fn half(table: &Table, h: usize, count: usize, shear: &Shear, range: [f32; 2]) -> Option<Rough> {
    // SAFETY: as the caller vouches; the store is of eight floats.
    unsafe {
        let (a, b, c) = (table.corner(0, h), table.corner(1, h), table.corner(2, h));
        let (u, v, w) = (edge(b, c), edge(c, a), edge(a, b));
        let (least, most) = (_mm256_min_ps(_mm256_min_ps(u, v), w), _mm256_max_ps(_mm256_max_ps(u, v), w));
        let zero = _mm256_setzero_ps();
        let front = _mm256_cmp_ps::<_CMP_GE_OQ>(least, zero);
        let hit = _mm256_or_ps(front, _mm256_cmp_ps::<_CMP_LE_OQ>(most, zero));
        let bits = u32::MAX >> (32 - count.clamp(1, 8));
        if _mm256_movemask_ps(hit) as u32 & bits == 0 {
            return None;
        }
        // Where all are zero t is NaN, and compares false.
        let share = _mm256_div_ps(_mm256_set1_ps(1.0), _mm256_add_ps(_mm256_add_ps(u, v), w));
        let depth = _mm256_fmadd_ps(u, a[2], _mm256_fmadd_ps(v, b[2], _mm256_mul_ps(w, c[2])));
        let t = _mm256_mul_ps(_mm256_mul_ps(depth, share), _mm256_set1_ps(shear.inverse()));
        let from = _mm256_cmp_ps::<_CMP_GE_OQ>(t, _mm256_set1_ps(range[0]));
        let to = _mm256_cmp_ps::<_CMP_LE_OQ>(t, _mm256_set1_ps(range[1]));
        let mut left = _mm256_movemask_ps(_mm256_and_ps(hit, _mm256_and_ps(from, to))) as u32 & bits;
        if left == 0 {
            return None;
        }
        let mut lane = left.trailing_zeros();
        left &= left - 1;
        if left != 0 {
            let mut all = [0.0f32; 8];
            _mm256_storeu_ps(all.as_mut_ptr(), t);
            while left != 0 {
                let other = left.trailing_zeros();
                left &= left - 1;
                lane = if all[other as usize & 7] < all[lane as usize & 7] { other } else { lane };
            }
        }
        let at = _mm256_set1_epi32(lane as i32);
        let t = _mm256_cvtss_f32(_mm256_permutevar8x32_ps(t, at));
        let u = _mm256_cvtss_f32(_mm256_permutevar8x32_ps(_mm256_mul_ps(v, share), at));
        let v = _mm256_cvtss_f32(_mm256_permutevar8x32_ps(_mm256_mul_ps(w, share), at));
        Some(Rough { lane: 8 * h as u32 + lane, t, u, v })
    }
}
