//! The inner loops with AVX-512: a leaf's sixteen triangles at once. The node test is that of AVX2, which is as fast.

use std::arch::x86_64::*;

use super::{Job, Kernel, Planes, Touched, Way, avx2, scalar};
use crate::exact::{Lanes, Shear};
use crate::format::{Coding, Leaf, Node};

/// Proof that the processor has AVX-512 (F, BW, DQ, VL) and what [`avx2::Avx2`] stands for.
#[derive(Clone, Copy, Debug)]
pub(super) struct Avx512(());

impl Avx512 {
    /// Asks the processor.
    pub fn detect() -> Option<Avx512> {
        let has = avx2::Avx2::detect().is_some()
            && is_x86_feature_detected!("avx512f")
            && is_x86_feature_detected!("avx512bw")
            && is_x86_feature_detected!("avx512dq")
            && is_x86_feature_detected!("avx512vl");
        has.then_some(Avx512(()))
    }
}

/// Does a job with AVX-512 enabled for all that is inlined into it.
///
/// # Safety
/// [`Avx512::detect`] must have found the instruction set.
#[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl,avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
pub(super) unsafe fn run<J: Job>(job: J) -> J::Output {
    job.run(Avx512(()))
}

impl Kernel for Avx512 {
    #[inline(always)]
    fn touch(self, node: &Node, planes: &Planes, way: &Way, far: f32) -> Touched {
        // SAFETY: `self` is proof.
        unsafe { avx2::touch(node, planes, way, far) }
    }

    #[inline(always)]
    fn within(self, near: &[f32; 8], far: f32) -> u32 {
        // SAFETY: `self` is proof.
        unsafe { avx2::within(near, far) }
    }

    #[inline(always)]
    fn child(self, planes: &Planes, node: &Node, slot: usize, way: &Way) -> Planes {
        // SAFETY: `self` is proof.
        unsafe { avx2::child(planes, node, slot, way) }
    }

    #[inline(always)]
    fn classify(self, leaf: &Leaf<'_>, shear: &Shear) -> Lanes {
        let registers = leaf.vertices().div_ceil(16);
        let reach = leaf.coding().coordinates_at() + 4 * (2 * leaf.vertices() + 16 * registers);
        if leaf.is_empty() || leaf.bytes().len() < reach {
            return scalar::classify(leaf, shear);
        }
        // SAFETY: `self` is proof; all loads end before `reach`, which lies within the leaf's bytes.
        unsafe {
            match leaf.coding() {
                Coding::Nibbles => nibbles(leaf, shear),
                Coding::Bytes => bytes(leaf, shear),
            }
        }
    }
}

/// Sixteen sheared vertices from number `first` on.
///
/// # Safety
/// AVX-512 must be there, and 64 bytes behind vertex `first` of each axis.
#[inline(always)]
unsafe fn sheared(leaf: &Leaf<'_>, shear: &Shear, first: usize) -> [__m512; 2] {
    // SAFETY: as the caller vouches.
    unsafe {
        let begin = leaf.bytes().as_ptr().add(leaf.coding().coordinates_at() + 4 * first);
        let stride = 4 * leaf.vertices();
        let [ox, oy, oz] = shear.origin();
        let [sx, sy] = shear.slopes();
        let x = _mm512_loadu_ps(begin.add(stride * shear.axes[0].min(2)).cast());
        let y = _mm512_loadu_ps(begin.add(stride * shear.axes[1].min(2)).cast());
        let z = _mm512_loadu_ps(begin.add(stride * shear.axes[2].min(2)).cast());
        let depth = _mm512_sub_ps(z, _mm512_set1_ps(oz));
        // Rounded after each step, never fused: the bound of `exact/filter.rs` counts on it.
        let wide = _mm512_sub_ps(_mm512_sub_ps(x, _mm512_set1_ps(ox)), _mm512_mul_ps(_mm512_set1_ps(sx), depth));
        let high = _mm512_sub_ps(_mm512_sub_ps(y, _mm512_set1_ps(oy)), _mm512_mul_ps(_mm512_set1_ps(sy), depth));
        [wide, high]
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

/// A leaf of up to 16 vertices with 4-bit corners.
///
/// # Safety
/// AVX-512 must be there, and all of the leaf's loads within its bytes.
#[inline(always)]
unsafe fn nibbles(leaf: &Leaf<'_>, shear: &Shear) -> Lanes {
    // SAFETY: as the caller vouches.
    unsafe {
        let [x, y] = sheared(leaf, shear, 0);
        let head = _mm512_broadcast_i64x4(_mm256_loadu_si256(leaf.bytes().as_ptr().cast()));
        // The permutation looks at the low four bits of each lane only.
        let (a, b, c) = (corner_index(head, 0), corner_index(head, 1), corner_index(head, 2));
        let corners = [
            [_mm512_permutexvar_ps(a, x), _mm512_permutexvar_ps(a, y)],
            [_mm512_permutexvar_ps(b, x), _mm512_permutexvar_ps(b, y)],
            [_mm512_permutexvar_ps(c, x), _mm512_permutexvar_ps(c, y)],
        ];
        classify(corners, shear, leaf.len())
    }
}

/// A leaf of up to 32 vertices with 8-bit corners.
///
/// # Safety
/// AVX-512 must be there, and all of the leaf's loads within its bytes.
#[inline(always)]
unsafe fn bytes(leaf: &Leaf<'_>, shear: &Shear) -> Lanes {
    // SAFETY: as the caller vouches; the corner bytes lie at 16..64 of the record.
    unsafe {
        let [x0, y0] = sheared(leaf, shear, 0);
        let [x1, y1] = if leaf.vertices() > 16 { sheared(leaf, shear, 16) } else { [x0, y0] };
        let numbers = leaf.bytes().as_ptr();
        let a = _mm512_cvtepu8_epi32(_mm_loadu_si128(numbers.add(16).cast()));
        let b = _mm512_cvtepu8_epi32(_mm_loadu_si128(numbers.add(32).cast()));
        let c = _mm512_cvtepu8_epi32(_mm_loadu_si128(numbers.add(48).cast()));
        let corners = [
            [_mm512_permutex2var_ps(x0, a, x1), _mm512_permutex2var_ps(y0, a, y1)],
            [_mm512_permutex2var_ps(x0, b, x1), _mm512_permutex2var_ps(y0, b, y1)],
            [_mm512_permutex2var_ps(x0, c, x1), _mm512_permutex2var_ps(y0, c, y1)],
        ];
        classify(corners, shear, leaf.len())
    }
}

/// An edge function, each step rounded.
///
/// # Safety
/// AVX-512 must be there.
#[inline(always)]
unsafe fn edge([px, py]: [__m512; 2], [qx, qy]: [__m512; 2]) -> __m512 {
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

/// The filter over sixteen triangles; the same operations in the same order as [`Shear::classify`].
///
/// # Safety
/// AVX-512 must be there.
#[inline(always)]
unsafe fn classify([a, b, c]: [[__m512; 2]; 3], shear: &Shear, count: usize) -> Lanes {
    // SAFETY: as the caller vouches.
    unsafe {
        let (u, v, w) = (edge(b, c), edge(c, a), edge(a, b));
        let m = _mm512_max_ps(_mm512_max_ps(magnitude(a), magnitude(b)), magnitude(c));
        let [linear, constant] = shear.bound();
        let bound = _mm512_add_ps(_mm512_mul_ps(_mm512_set1_ps(linear), m), _mm512_set1_ps(constant));
        let sign = _mm512_set1_ps(-0.0);
        let least = _mm512_min_ps(_mm512_min_ps(u, v), w);
        let most = _mm512_max_ps(_mm512_max_ps(u, v), w);
        let q = _mm512_min_ps(_mm512_xor_ps(least, sign), most);
        let miss = u32::from(_mm512_cmp_ps_mask::<_CMP_GT_OQ>(q, bound));
        let hit = u32::from(_mm512_cmp_ps_mask::<_CMP_LT_OQ>(q, _mm512_xor_ps(bound, sign)));
        let bits = u32::MAX >> (32 - count.clamp(1, 16));
        Lanes { accept: hit & bits, doubt: !(miss | hit) & bits }
    }
}
