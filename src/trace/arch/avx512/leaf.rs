//! A leaf's vertices and triangles, sixteen a register.

use std::arch::x86_64::*;

use crate::exact::{Depths, Lanes, Shear};
use crate::format::{Coding, Leaf, Points};

/// Sixteen sheared vertices from number `first` on, and their depths.
///
/// # Safety
/// AVX-512 must be there, and sixteen coordinates from vertex `first` on of each axis.
#[inline(always)]
unsafe fn sheared(leaf: &Leaf<'_>, shear: &Shear, first: usize) -> [__m512; 3] {
    // SAFETY: as the caller vouches.
    unsafe {
        let [x, y, z] = match leaf.points() {
            Points::Floats => {
                let begin = leaf.bytes().as_ptr().add(leaf.coordinates_at() + 4 * first);
                let stride = 4 * leaf.vertices();
                let load = |axis: usize| _mm512_loadu_ps(begin.add(stride * axis.min(2)).cast());
                [load(shear.axes[0]), load(shear.axes[1]), load(shear.axes[2])]
            }
            Points::Steps => {
                let begin = leaf.bytes().as_ptr().add(leaf.coordinates_at() + 2 * first);
                let (stride, scale) = (2 * leaf.vertices(), _mm512_set1_ps(leaf.scale()));
                let bases = leaf.bytes().as_ptr().add(leaf.vertices_at());
                // Exact, each step of it: `format/coordinates.rs`.
                let load = |axis: usize| {
                    let steps = _mm256_loadu_si256(begin.add(stride * axis.min(2)).cast());
                    let base = bases.add(4 * axis.min(2)).cast::<i32>().read_unaligned();
                    let whole = _mm512_add_epi32(_mm512_cvtepu16_epi32(steps), _mm512_set1_epi32(base));
                    _mm512_mul_ps(_mm512_cvtepi32_ps(whole), scale)
                };
                [load(shear.axes[0]), load(shear.axes[1]), load(shear.axes[2])]
            }
        };
        let [ox, oy, oz] = shear.origin();
        let [sx, sy] = shear.slopes();
        let depth = _mm512_sub_ps(z, _mm512_set1_ps(oz));
        // Rounded after each step, never fused: the bound of `exact/filter.rs` counts on it.
        let wide = _mm512_sub_ps(_mm512_sub_ps(x, _mm512_set1_ps(ox)), _mm512_mul_ps(_mm512_set1_ps(sx), depth));
        let high = _mm512_sub_ps(_mm512_sub_ps(y, _mm512_set1_ps(oy)), _mm512_mul_ps(_mm512_set1_ps(sy), depth));
        [wide, high, depth]
    }
}

/// The vertex numbers of corner k of each triangle, in the low four bits of each lane; `head` is the record's first 32 bytes, twice.
///
/// # Safety
/// AVX-512 must be there.
#[inline(always)]
unsafe fn corner_index(head: __m512i, k: i32) -> __m512i {
    // SAFETY: as the caller vouches.
    unsafe {
        // Two words of four bytes a corner, from byte 8 on: the first for triangles 0 to 7.
        let halves = _mm512_setr_epi32(2, 2, 2, 2, 2, 2, 2, 2, 3, 3, 3, 3, 3, 3, 3, 3);
        let words = _mm512_permutexvar_epi32(_mm512_add_epi32(halves, _mm512_set1_epi32(2 * k)), head);
        _mm512_srlv_epi32(words, _mm512_setr_epi32(0, 4, 8, 12, 16, 20, 24, 28, 0, 4, 8, 12, 16, 20, 24, 28))
    }
}

/// The corners of each triangle, as indices of vertices, and the sheared vertices: in a leaf of up to 16 with 4-bit corners.
///
/// # Safety
/// AVX-512 must be there, and all of the leaf's loads within its bytes.
#[inline(always)]
pub(super) unsafe fn nibbles(leaf: &Leaf<'_>, shear: &Shear) -> ([__m512i; 3], [[__m512; 3]; 2]) {
    // SAFETY: as the caller vouches; the corners lie at 8..32 of the record.
    unsafe {
        let table = sheared(leaf, shear, 0);
        let head = _mm512_broadcast_i64x4(_mm256_loadu_si256(leaf.bytes().as_ptr().cast()));
        // The permutation looks at the low four bits of each lane only.
        ([corner_index(head, 0), corner_index(head, 1), corner_index(head, 2)], [table, table])
    }
}

/// The same in a leaf of up to 32 vertices with 8-bit corners.
///
/// # Safety
/// AVX-512 must be there, and all of the leaf's loads within its bytes.
#[inline(always)]
pub(super) unsafe fn bytes(leaf: &Leaf<'_>, shear: &Shear) -> ([__m512i; 3], [[__m512; 3]; 2]) {
    // SAFETY: as the caller vouches; the corner bytes lie at 16..64 of the record.
    unsafe {
        let first = sheared(leaf, shear, 0);
        let second = if leaf.vertices() > 16 { sheared(leaf, shear, 16) } else { first };
        let numbers = leaf.bytes().as_ptr();
        let index = [
            _mm512_cvtepu8_epi32(_mm_loadu_si128(numbers.add(16).cast())),
            _mm512_cvtepu8_epi32(_mm_loadu_si128(numbers.add(32).cast())),
            _mm512_cvtepu8_epi32(_mm_loadu_si128(numbers.add(48).cast())),
        ];
        (index, [first, second])
    }
}

/// An edge function, each step rounded.
///
/// # Safety
/// AVX-512 must be there.
#[inline(always)]
pub(super) unsafe fn edge([px, py]: [__m512; 2], [qx, qy]: [__m512; 2]) -> __m512 {
    // SAFETY: as the caller vouches.
    unsafe { _mm512_sub_ps(_mm512_mul_ps(px, qy), _mm512_mul_ps(py, qx)) }
}

/// The larger magnitude of a point's coordinates.
///
/// # Safety
/// AVX-512 must be there.
#[inline(always)]
unsafe fn magnitude([x, y]: [__m512; 2]) -> __m512 {
    // SAFETY: as the caller vouches.
    unsafe { _mm512_max_ps(_mm512_abs_ps(x), _mm512_abs_ps(y)) }
}

/// Entries of a table of sixteen, or of 32 if `WIDE`.
///
/// # Safety
/// AVX-512 must be there.
#[inline(always)]
pub(super) unsafe fn pick<const WIDE: bool>(first: __m512, second: __m512, at: __m512i) -> __m512 {
    // SAFETY: as the caller vouches.
    unsafe { if WIDE { _mm512_permutex2var_ps(first, at, second) } else { _mm512_permutexvar_ps(at, first) } }
}

/// The filter over a leaf.
///
/// # Safety
/// AVX-512 must be there, and all of the leaf's loads within its bytes.
#[inline(always)]
pub(super) unsafe fn classify(leaf: &Leaf<'_>, shear: &Shear, range: [f32; 2], depths: &mut Depths) -> Lanes {
    // SAFETY: as the caller vouches.
    unsafe {
        match leaf.coding() {
            Coding::Nibbles => {
                let (index, table) = nibbles(leaf, shear);
                classify_of::<false>(index, table, shear, leaf.len(), range, depths)
            }
            Coding::Bytes => {
                let (index, table) = bytes(leaf, shear);
                classify_of::<true>(index, table, shear, leaf.len(), range, depths)
            }
        }
    }
}

/// The filter over sixteen triangles; the same operations in the same order as [`Shear::classify`].
///
/// # Safety
/// AVX-512 must be there.
#[inline(always)]
unsafe fn classify_of<const WIDE: bool>(
    [ia, ib, ic]: [__m512i; 3],
    [[x, y, z], [x1, y1, z1]]: [[__m512; 3]; 2],
    shear: &Shear,
    count: usize,
    range: [f32; 2],
    depths: &mut Depths,
) -> Lanes {
    // SAFETY: as the caller vouches; the stores are of sixteen floats.
    unsafe {
        let a = [pick::<WIDE>(x, x1, ia), pick::<WIDE>(y, y1, ia)];
        let b = [pick::<WIDE>(x, x1, ib), pick::<WIDE>(y, y1, ib)];
        let c = [pick::<WIDE>(x, x1, ic), pick::<WIDE>(y, y1, ic)];
        let (u, v, w) = (edge(b, c), edge(c, a), edge(a, b));
        let m = _mm512_max_ps(_mm512_max_ps(magnitude(a), magnitude(b)), magnitude(c));
        let [linear, constant] = shear.bound();
        let bound = _mm512_add_ps(_mm512_mul_ps(_mm512_set1_ps(linear), m), _mm512_set1_ps(constant));
        let sign = _mm512_set1_ps(-0.0);
        let least = _mm512_min_ps(_mm512_min_ps(u, v), w);
        let most = _mm512_max_ps(_mm512_max_ps(u, v), w);
        let q = _mm512_min_ps(_mm512_xor_ps(least, sign), most);
        let bits = u32::MAX >> (32 - count.clamp(1, 16));
        let miss = u32::from(_mm512_cmp_ps_mask::<_CMP_GT_OQ>(q, bound));
        let hit = u32::from(_mm512_cmp_ps_mask::<_CMP_LT_OQ>(q, _mm512_xor_ps(bound, sign))) & bits;
        let doubt = !(miss | hit) & bits;
        if hit == 0 {
            return Lanes { accept: 0, doubt };
        }
        let (za, zb, zc) = (pick::<WIDE>(z, z1, ia), pick::<WIDE>(z, z1, ib), pick::<WIDE>(z, z1, ic));
        let sum = _mm512_add_ps(_mm512_add_ps(u, v), w);
        let share = _mm512_div_ps(_mm512_set1_ps(1.0), sum);
        let of_a = _mm512_mul_ps(_mm512_mul_ps(u, share), za);
        let of_b = _mm512_mul_ps(_mm512_mul_ps(v, share), zb);
        let of_c = _mm512_mul_ps(_mm512_mul_ps(w, share), zc);
        let t = _mm512_mul_ps(_mm512_add_ps(_mm512_add_ps(of_a, of_b), of_c), _mm512_set1_ps(shear.inverse()));
        let most = _mm512_max_ps(_mm512_max_ps(za, zb), zc);
        let least = _mm512_min_ps(_mm512_min_ps(za, zb), zc);
        let [of_shape, of_depth, constant] = shear.depth_bound();
        let shape = _mm512_mul_ps(_mm512_mul_ps(bound, _mm512_abs_ps(share)), _mm512_sub_ps(most, least));
        let shape = _mm512_mul_ps(shape, _mm512_set1_ps(of_shape));
        let deepest = _mm512_max_ps(_mm512_abs_ps(most), _mm512_abs_ps(least));
        let depth = _mm512_mul_ps(deepest, _mm512_set1_ps(of_depth));
        let h = _mm512_add_ps(_mm512_add_ps(shape, depth), _mm512_set1_ps(constant));
        let (lo, hi) = (_mm512_sub_ps(t, h), _mm512_add_ps(t, h));
        _mm512_storeu_ps(depths.lo.as_mut_ptr(), lo);
        _mm512_storeu_ps(depths.hi.as_mut_ptr(), hi);
        let later = _mm512_cmp_ps_mask::<_CMP_GT_OQ>(lo, _mm512_set1_ps(range[1]));
        let earlier = _mm512_cmp_ps_mask::<_CMP_LT_OQ>(hi, _mm512_set1_ps(range[0]));
        Lanes { accept: hit & !u32::from(later | earlier), doubt }
    }
}
