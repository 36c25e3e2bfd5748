//! Sixteen numbers at once, for what packets of rays do alike on every instruction set.

#[cfg(target_arch = "x86_64")]
use std::arch::x86_64::*;

use super::scalar::Scalar;
#[cfg(target_arch = "x86_64")]
use super::{avx2::Avx2, avx512::Avx512};
use crate::geometry::Ray;

/// Lanes.
pub(in crate::trace) const WIDE: usize = 16;

/// Sixteen numbers in memory.
#[derive(Clone, Copy, Debug, bytemuck::Zeroable)]
#[repr(C, align(64))]
pub(in crate::trace) struct Row(pub [f32; WIDE]);

/// Arithmetic on sixteen f32, each operation rounded as IEEE has it. Comparisons give a bit a lane, 0 where an operand is NaN.
pub(in crate::trace) trait Wide: Copy {
    /// Sixteen numbers in registers.
    type Floats: Copy;

    fn all(self, x: f32) -> Self::Floats;
    fn get(self, row: &Row) -> Self::Floats;
    fn put(self, x: Self::Floats, row: &mut Row);
    fn plus(self, a: Self::Floats, b: Self::Floats) -> Self::Floats;
    fn minus(self, a: Self::Floats, b: Self::Floats) -> Self::Floats;
    fn times(self, a: Self::Floats, b: Self::Floats) -> Self::Floats;
    fn over(self, a: Self::Floats, b: Self::Floats) -> Self::Floats;
    /// a b + c, rounded once or twice.
    fn fused(self, a: Self::Floats, b: Self::Floats, c: Self::Floats) -> Self::Floats;
    /// The lesser; `b` if either is NaN.
    fn lesser(self, a: Self::Floats, b: Self::Floats) -> Self::Floats;
    /// The greater; `b` if either is NaN.
    fn greater(self, a: Self::Floats, b: Self::Floats) -> Self::Floats;
    fn size(self, x: Self::Floats) -> Self::Floats;
    fn negative(self, x: Self::Floats) -> Self::Floats;
    /// a < b.
    fn below(self, a: Self::Floats, b: Self::Floats) -> u32;
    /// a <= b.
    fn at_most(self, a: Self::Floats, b: Self::Floats) -> u32;
    /// Lanes of `a` where the bit is set, of `b` elsewhere.
    fn choose(self, bits: u32, a: Self::Floats, b: Self::Floats) -> Self::Floats;
    /// For lane i of the lower eight: lane i <= -(lane 8 + i).
    fn overlap(self, x: Self::Floats) -> u32;
    /// `a` in the lower eight lanes, `b` in the upper.
    fn halves(self, a: f32, b: f32) -> Self::Floats;
    /// Component k of all rays in entry k: origin, direction, tmin, tmax.
    fn columns(self, rays: &[Ray; WIDE]) -> [Self::Floats; 8];
    /// The least of all lanes, none of them NaN.
    fn least(self, x: Self::Floats) -> f32;
}

/// The least of all lanes, and the greatest.
#[inline(always)]
pub(in crate::trace) fn greatest<K: Wide>(kernel: K, x: K::Floats) -> f32 {
    -kernel.least(kernel.negative(x))
}

impl Wide for Scalar {
    type Floats = [f32; WIDE];

    #[inline(always)]
    fn all(self, x: f32) -> [f32; WIDE] {
        [x; WIDE]
    }
    #[inline(always)]
    fn get(self, row: &Row) -> [f32; WIDE] {
        row.0
    }
    #[inline(always)]
    fn put(self, x: [f32; WIDE], row: &mut Row) {
        row.0 = x;
    }
    #[inline(always)]
    fn plus(self, a: [f32; WIDE], b: [f32; WIDE]) -> [f32; WIDE] {
        std::array::from_fn(|i| a[i] + b[i])
    }
    #[inline(always)]
    fn minus(self, a: [f32; WIDE], b: [f32; WIDE]) -> [f32; WIDE] {
        std::array::from_fn(|i| a[i] - b[i])
    }
    #[inline(always)]
    fn times(self, a: [f32; WIDE], b: [f32; WIDE]) -> [f32; WIDE] {
        std::array::from_fn(|i| a[i] * b[i])
    }
    #[inline(always)]
    fn over(self, a: [f32; WIDE], b: [f32; WIDE]) -> [f32; WIDE] {
        std::array::from_fn(|i| a[i] / b[i])
    }
    #[inline(always)]
    fn fused(self, a: [f32; WIDE], b: [f32; WIDE], c: [f32; WIDE]) -> [f32; WIDE] {
        std::array::from_fn(|i| a[i] * b[i] + c[i])
    }
    #[inline(always)]
    fn lesser(self, a: [f32; WIDE], b: [f32; WIDE]) -> [f32; WIDE] {
        std::array::from_fn(|i| if a[i] < b[i] { a[i] } else { b[i] })
    }
    #[inline(always)]
    fn greater(self, a: [f32; WIDE], b: [f32; WIDE]) -> [f32; WIDE] {
        std::array::from_fn(|i| if a[i] > b[i] { a[i] } else { b[i] })
    }
    #[inline(always)]
    fn size(self, x: [f32; WIDE]) -> [f32; WIDE] {
        x.map(f32::abs)
    }
    #[inline(always)]
    fn negative(self, x: [f32; WIDE]) -> [f32; WIDE] {
        x.map(|x| -x)
    }
    #[inline(always)]
    fn below(self, a: [f32; WIDE], b: [f32; WIDE]) -> u32 {
        (0..WIDE).fold(0, |bits, i| bits | u32::from(a[i] < b[i]) << i)
    }
    #[inline(always)]
    fn at_most(self, a: [f32; WIDE], b: [f32; WIDE]) -> u32 {
        (0..WIDE).fold(0, |bits, i| bits | u32::from(a[i] <= b[i]) << i)
    }
    #[inline(always)]
    fn choose(self, bits: u32, a: [f32; WIDE], b: [f32; WIDE]) -> [f32; WIDE] {
        std::array::from_fn(|i| if bits >> i & 1 != 0 { a[i] } else { b[i] })
    }
    #[inline(always)]
    fn overlap(self, x: [f32; WIDE]) -> u32 {
        (0..8).fold(0, |bits, i| bits | u32::from(x[i] <= -x[8 + i]) << i)
    }
    #[inline(always)]
    fn halves(self, a: f32, b: f32) -> [f32; WIDE] {
        std::array::from_fn(|i| if i < 8 { a } else { b })
    }
    #[inline(always)]
    fn columns(self, rays: &[Ray; WIDE]) -> [[f32; WIDE]; 8] {
        let mut columns = [[0.0; WIDE]; 8];
        for (i, ray) in rays.iter().enumerate() {
            let numbers: &[f32; 8] = bytemuck::cast_ref(ray);
            for k in 0..8 {
                columns[k][i] = numbers[k];
            }
        }
        columns
    }
    #[inline(always)]
    fn least(self, x: [f32; WIDE]) -> f32 {
        x.iter().fold(f32::INFINITY, |least, &x| if x < least { x } else { least })
    }
}

/// A [`Wide`] for one kind of register: each method is the expression given, `self` being proof that the processor has it.
#[cfg(target_arch = "x86_64")]
macro_rules! wide {
    ($kernel:ty, $floats:ty, $(fn $name:ident($($arg:ident: $type:ty),*) -> $out:ty $body:block)*) => {
        impl Wide for $kernel {
            type Floats = $floats;
            $(
                #[inline(always)]
                fn $name(self, $($arg: $type),*) -> $out {
                    // SAFETY: `self` is proof; rows are sixteen floats, aligned to 64.
                    unsafe { $body }
                }
            )*
        }
    };
}

#[cfg(target_arch = "x86_64")]
wide! { Avx512, __m512,
    fn all(x: f32) -> __m512 { _mm512_set1_ps(x) }
    fn get(row: &Row) -> __m512 { _mm512_load_ps(row.0.as_ptr()) }
    fn put(x: __m512, row: &mut Row) -> () { _mm512_store_ps(row.0.as_mut_ptr(), x) }
    fn plus(a: __m512, b: __m512) -> __m512 { _mm512_add_ps(a, b) }
    fn minus(a: __m512, b: __m512) -> __m512 { _mm512_sub_ps(a, b) }
    fn times(a: __m512, b: __m512) -> __m512 { _mm512_mul_ps(a, b) }
    fn over(a: __m512, b: __m512) -> __m512 { _mm512_div_ps(a, b) }
    fn fused(a: __m512, b: __m512, c: __m512) -> __m512 { _mm512_fmadd_ps(a, b, c) }
    fn lesser(a: __m512, b: __m512) -> __m512 { _mm512_min_ps(a, b) }
    fn greater(a: __m512, b: __m512) -> __m512 { _mm512_max_ps(a, b) }
    fn size(x: __m512) -> __m512 { _mm512_abs_ps(x) }
    fn negative(x: __m512) -> __m512 { _mm512_xor_ps(x, _mm512_set1_ps(-0.0)) }
    fn below(a: __m512, b: __m512) -> u32 { u32::from(_mm512_cmp_ps_mask::<_CMP_LT_OQ>(a, b)) }
    fn at_most(a: __m512, b: __m512) -> u32 { u32::from(_mm512_cmp_ps_mask::<_CMP_LE_OQ>(a, b)) }
    fn choose(bits: u32, a: __m512, b: __m512) -> __m512 { _mm512_mask_blend_ps(bits as u16, b, a) }
    fn overlap(x: __m512) -> u32 {
        let last = _mm256_xor_ps(_mm512_extractf32x8_ps::<1>(x), _mm256_set1_ps(-0.0));
        u32::from(_mm256_cmp_ps_mask::<_CMP_LE_OQ>(_mm512_castps512_ps256(x), last))
    }
    fn halves(a: f32, b: f32) -> __m512 { _mm512_mask_mov_ps(_mm512_set1_ps(a), 0xff00, _mm512_set1_ps(b)) }
    fn columns(rays: &[Ray; 16]) -> [__m512; 8] {
        let (low, high) = (transposed(rays.as_ptr().cast()), transposed(rays.as_ptr().add(8).cast()));
        let mut columns = [_mm512_setzero_ps(); 8];
        let mut k = 0;
        while k < 8 {
            columns[k] = _mm512_insertf32x8::<1>(_mm512_castps256_ps512(low[k]), high[k]);
            k += 1;
        }
        columns
    }
    fn least(x: __m512) -> f32 { _mm512_reduce_min_ps(x) }
}

#[cfg(target_arch = "x86_64")]
wide! { Avx2, [__m256; 2],
    fn all(x: f32) -> [__m256; 2] { [_mm256_set1_ps(x); 2] }
    fn get(row: &Row) -> [__m256; 2] { [_mm256_load_ps(row.0.as_ptr()), _mm256_load_ps(row.0.as_ptr().add(8))] }
    fn put(x: [__m256; 2], row: &mut Row) -> () {
        _mm256_store_ps(row.0.as_mut_ptr(), x[0]);
        _mm256_store_ps(row.0.as_mut_ptr().add(8), x[1]);
    }
    fn plus(a: [__m256; 2], b: [__m256; 2]) -> [__m256; 2] { [_mm256_add_ps(a[0], b[0]), _mm256_add_ps(a[1], b[1])] }
    fn minus(a: [__m256; 2], b: [__m256; 2]) -> [__m256; 2] { [_mm256_sub_ps(a[0], b[0]), _mm256_sub_ps(a[1], b[1])] }
    fn times(a: [__m256; 2], b: [__m256; 2]) -> [__m256; 2] { [_mm256_mul_ps(a[0], b[0]), _mm256_mul_ps(a[1], b[1])] }
    fn over(a: [__m256; 2], b: [__m256; 2]) -> [__m256; 2] { [_mm256_div_ps(a[0], b[0]), _mm256_div_ps(a[1], b[1])] }
    fn fused(a: [__m256; 2], b: [__m256; 2], c: [__m256; 2]) -> [__m256; 2] {
        [_mm256_fmadd_ps(a[0], b[0], c[0]), _mm256_fmadd_ps(a[1], b[1], c[1])]
    }
    fn lesser(a: [__m256; 2], b: [__m256; 2]) -> [__m256; 2] { [_mm256_min_ps(a[0], b[0]), _mm256_min_ps(a[1], b[1])] }
    fn greater(a: [__m256; 2], b: [__m256; 2]) -> [__m256; 2] { [_mm256_max_ps(a[0], b[0]), _mm256_max_ps(a[1], b[1])] }
    fn size(x: [__m256; 2]) -> [__m256; 2] {
        let sign = _mm256_set1_ps(-0.0);
        [_mm256_andnot_ps(sign, x[0]), _mm256_andnot_ps(sign, x[1])]
    }
    fn negative(x: [__m256; 2]) -> [__m256; 2] {
        let sign = _mm256_set1_ps(-0.0);
        [_mm256_xor_ps(sign, x[0]), _mm256_xor_ps(sign, x[1])]
    }
    fn below(a: [__m256; 2], b: [__m256; 2]) -> u32 {
        let low = _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LT_OQ>(a[0], b[0]));
        (low | _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LT_OQ>(a[1], b[1])) << 8) as u32
    }
    fn at_most(a: [__m256; 2], b: [__m256; 2]) -> u32 {
        let low = _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LE_OQ>(a[0], b[0]));
        (low | _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LE_OQ>(a[1], b[1])) << 8) as u32
    }
    fn choose(bits: u32, a: [__m256; 2], b: [__m256; 2]) -> [__m256; 2] {
        let one = _mm256_setr_epi32(1, 2, 4, 8, 16, 32, 64, 128);
        let low = _mm256_cmpeq_epi32(_mm256_and_si256(_mm256_set1_epi32(bits as i32), one), one);
        let high = _mm256_cmpeq_epi32(_mm256_and_si256(_mm256_set1_epi32((bits >> 8) as i32), one), one);
        [_mm256_blendv_ps(b[0], a[0], _mm256_castsi256_ps(low)), _mm256_blendv_ps(b[1], a[1], _mm256_castsi256_ps(high))]
    }
    fn overlap(x: [__m256; 2]) -> u32 {
        let last = _mm256_xor_ps(x[1], _mm256_set1_ps(-0.0));
        _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LE_OQ>(x[0], last)) as u32
    }
    fn halves(a: f32, b: f32) -> [__m256; 2] { [_mm256_set1_ps(a), _mm256_set1_ps(b)] }
    fn columns(rays: &[Ray; 16]) -> [[__m256; 2]; 8] {
        let (low, high) = (transposed(rays.as_ptr().cast()), transposed(rays.as_ptr().add(8).cast()));
        let mut columns = [[_mm256_setzero_ps(); 2]; 8];
        let mut k = 0;
        while k < 8 {
            columns[k] = [low[k], high[k]];
            k += 1;
        }
        columns
    }
    fn least(x: [__m256; 2]) -> f32 {
        let four = _mm256_min_ps(x[0], x[1]);
        let four = _mm_min_ps(_mm256_castps256_ps128(four), _mm256_extractf128_ps::<1>(four));
        let two = _mm_min_ps(four, _mm_movehl_ps(four, four));
        _mm_cvtss_f32(_mm_min_ss(two, _mm_shuffle_ps::<1>(two, two)))
    }
}

/// Eight rows of eight floats as columns.
///
/// # Safety
/// AVX must be there, and 64 floats behind `rows`.
#[cfg(target_arch = "x86_64")]
#[inline(always)]
unsafe fn transposed(rows: *const f32) -> [__m256; 8] {
    // SAFETY: as the caller vouches.
    unsafe {
        let mut r = [_mm256_setzero_ps(); 8];
        let mut i = 0;
        while i < 8 {
            r[i] = _mm256_loadu_ps(rows.add(8 * i));
            i += 1;
        }
        let (a, b) = (_mm256_unpacklo_ps(r[0], r[1]), _mm256_unpackhi_ps(r[0], r[1]));
        let (c, d) = (_mm256_unpacklo_ps(r[2], r[3]), _mm256_unpackhi_ps(r[2], r[3]));
        let (e, f) = (_mm256_unpacklo_ps(r[4], r[5]), _mm256_unpackhi_ps(r[4], r[5]));
        let (g, h) = (_mm256_unpacklo_ps(r[6], r[7]), _mm256_unpackhi_ps(r[6], r[7]));
        const LOW: i32 = 0b01_00_01_00;
        const HIGH: i32 = 0b11_10_11_10;
        let (a, c) = (_mm256_shuffle_ps::<LOW>(a, c), _mm256_shuffle_ps::<HIGH>(a, c));
        let (b, d) = (_mm256_shuffle_ps::<LOW>(b, d), _mm256_shuffle_ps::<HIGH>(b, d));
        let (e, g) = (_mm256_shuffle_ps::<LOW>(e, g), _mm256_shuffle_ps::<HIGH>(e, g));
        let (f, h) = (_mm256_shuffle_ps::<LOW>(f, h), _mm256_shuffle_ps::<HIGH>(f, h));
        [
            _mm256_permute2f128_ps::<0x20>(a, e),
            _mm256_permute2f128_ps::<0x20>(c, g),
            _mm256_permute2f128_ps::<0x20>(b, f),
            _mm256_permute2f128_ps::<0x20>(d, h),
            _mm256_permute2f128_ps::<0x31>(a, e),
            _mm256_permute2f128_ps::<0x31>(c, g),
            _mm256_permute2f128_ps::<0x31>(b, f),
            _mm256_permute2f128_ps::<0x31>(d, h),
        ]
    }
}
