//! t, u and v of many hits at once, correctly rounded where f64 suffices: [`Line::rounded`](crate::exact::Line::rounded) in SIMD.

use std::arch::x86_64::*;

use super::{Block, Rounded, Row, WIDE};
use crate::exact::U;

/// Makes the function for one kind of register, in a module of its own; `load`, `size`, `exceeds` and `narrow` are what differs in form.
macro_rules! rounding {
    ($floats:ty, $lanes:literal, $all:ident, $add:ident, $sub:ident, $mul:ident, $div:ident, $fused:ident) => {
        /// Rounds those hits of a block whose bit is set in `wanted`.
        ///
        /// # Safety
        /// The instruction set of the module must be there.
        #[inline(always)]
        pub(in crate::trace::arch) unsafe fn rounded(block: &Block, wanted: u32, rounded: &mut Rounded) {
            rounded.certain = 0;
            let mut first = 0;
            while first < WIDE {
                if wanted >> first & ((1 << $lanes) - 1) == 0 {
                    first += $lanes;
                    continue;
                }
                // SAFETY: the caller vouches for the instructions; `first` is a multiple of the lanes below 16.
                unsafe {
                    let (a, b, c) = (points(&block.a, first), points(&block.b, first), points(&block.c, first));
                    let (o, d) = (points(&block.origin, first), points(&block.direction, first));
                    let (ao, ab, ca) = (minus(a, o), minus(b, a), minus(a, c));
                    let (v, v_size) = determinant(minus(c, o), ca, d);
                    let (w, w_size) = determinant(ao, ab, d);
                    let (u, u_size) = determinant(minus(b, o), minus(c, b), d);
                    let (t, t_size) = determinant(ca, ab, ao);
                    let (few, nine) = ($all(4.0 * U), $all(9.0 * U));
                    let sizes = $add($add(size(u), size(v)), size(w));
                    let permanents = $add($add(u_size, v_size), w_size);
                    let den = $add($add(v, w), u);
                    let den_error = $fused(permanents, nine, $mul(sizes, few));
                    let inverse = $div($all(1.0), den);
                    let mut certain = exceeds(size(den), $add(den_error, den_error));
                    certain &=
                        share([t, $mul(t_size, nine)], [inverse, den_error], rounded.t.0.as_mut_ptr().add(first));
                    certain &=
                        share([v, $mul(v_size, nine)], [inverse, den_error], rounded.u.0.as_mut_ptr().add(first));
                    certain &=
                        share([w, $mul(w_size, nine)], [inverse, den_error], rounded.v.0.as_mut_ptr().add(first));
                    rounded.certain |= certain << first;
                }
                first += $lanes;
            }
            rounded.certain &= wanted;
        }

        /// Points of a block, from number `first` on.
        ///
        /// # Safety
        /// As for `rounded`, and a register of points from `first` on.
        #[inline(always)]
        unsafe fn points(points: &[Row; 3], first: usize) -> [$floats; 3] {
            // SAFETY: as the caller vouches.
            unsafe {
                let [x, y, z] = points;
                [load(x.0.as_ptr().add(first)), load(y.0.as_ptr().add(first)), load(z.0.as_ptr().add(first))]
            }
        }

        /// Differences.
        ///
        /// # Safety
        /// As for `rounded`.
        #[inline(always)]
        unsafe fn minus(p: [$floats; 3], q: [$floats; 3]) -> [$floats; 3] {
            // SAFETY: as the caller vouches.
            unsafe { [$sub(p[0], q[0]), $sub(p[1], q[1]), $sub(p[2], q[2])] }
        }

        /// (p x q) . r, and its permanent.
        ///
        /// # Safety
        /// As for `rounded`.
        #[inline(always)]
        unsafe fn determinant(p: [$floats; 3], q: [$floats; 3], r: [$floats; 3]) -> ($floats, $floats) {
            // SAFETY: as the caller vouches.
            unsafe {
                let (mut value, mut permanent) = ($all(0.0), $all(0.0));
                let mut i = 0;
                while i < 3 {
                    let (j, k) = ((i + 1) % 3, (i + 2) % 3);
                    let (plus, less) = ($mul(p[j], q[k]), $mul(p[k], q[j]));
                    value = $fused($sub(plus, less), r[i], value);
                    permanent = $fused($add(size(plus), size(less)), size(r[i]), permanent);
                    i += 1;
                }
                (value, permanent)
            }
        }

        /// Quotients rounded, and which of them are certain; `error` bounds that of `value`, `den_error` that of the divisor.
        ///
        /// # Safety
        /// As for `rounded`, and a register of floats at `to`.
        #[inline(always)]
        unsafe fn share([value, error]: [$floats; 2], [inverse, den_error]: [$floats; 2], to: *mut f32) -> u32 {
            // SAFETY: as the caller vouches.
            unsafe {
                let quotient = $mul(value, inverse);
                let magnitude = size(quotient);
                let bound = $mul($fused(magnitude, den_error, error), size(inverse));
                let bound = $fused(bound, $all(2.25), $mul(magnitude, $all(4.0 * U)));
                narrow([$sub(quotient, bound), $add(quotient, bound)], to)
            }
        }
    };
}

pub(super) mod avx2 {
    use super::*;

    rounding!(__m256d, 4, _mm256_set1_pd, _mm256_add_pd, _mm256_sub_pd, _mm256_mul_pd, _mm256_div_pd, _mm256_fmadd_pd);

    /// Floats as doubles.
    ///
    /// # Safety
    /// AVX must be there, and four floats at `at`.
    #[inline(always)]
    unsafe fn load(at: *const f32) -> __m256d {
        // SAFETY: as the caller vouches.
        unsafe { _mm256_cvtps_pd(_mm_loadu_ps(at)) }
    }

    /// Magnitudes.
    ///
    /// # Safety
    /// AVX must be there.
    #[inline(always)]
    unsafe fn size(x: __m256d) -> __m256d {
        // SAFETY: as the caller vouches.
        unsafe { _mm256_andnot_pd(_mm256_set1_pd(-0.0), x) }
    }

    /// Where a > b.
    ///
    /// # Safety
    /// AVX must be there.
    #[inline(always)]
    unsafe fn exceeds(a: __m256d, b: __m256d) -> u32 {
        // SAFETY: as the caller vouches.
        unsafe { _mm256_movemask_pd(_mm256_cmp_pd::<_CMP_GT_OQ>(a, b)) as u32 }
    }

    /// Stores what the lower numbers round to, and tells where the upper ones round to the same. +0 stands for -0.
    ///
    /// # Safety
    /// AVX must be there, and room for four floats at `to`.
    #[inline(always)]
    unsafe fn narrow([low, high]: [__m256d; 2], to: *mut f32) -> u32 {
        // SAFETY: as the caller vouches.
        unsafe {
            let (low, high) = (_mm256_cvtpd_ps(low), _mm256_cvtpd_ps(high));
            _mm_storeu_ps(to, _mm_add_ps(low, _mm_setzero_ps()));
            _mm_movemask_ps(_mm_cmp_ps::<_CMP_EQ_OQ>(low, high)) as u32
        }
    }
}

pub(super) mod avx512 {
    use super::*;

    rounding!(__m512d, 8, _mm512_set1_pd, _mm512_add_pd, _mm512_sub_pd, _mm512_mul_pd, _mm512_div_pd, _mm512_fmadd_pd);

    /// Floats as doubles.
    ///
    /// # Safety
    /// AVX-512 must be there, and eight floats at `at`.
    #[inline(always)]
    unsafe fn load(at: *const f32) -> __m512d {
        // SAFETY: as the caller vouches.
        unsafe { _mm512_cvtps_pd(_mm256_loadu_ps(at)) }
    }

    /// Magnitudes.
    ///
    /// # Safety
    /// AVX-512 must be there.
    #[inline(always)]
    unsafe fn size(x: __m512d) -> __m512d {
        // SAFETY: as the caller vouches.
        unsafe { _mm512_abs_pd(x) }
    }

    /// Where a > b.
    ///
    /// # Safety
    /// AVX-512 must be there.
    #[inline(always)]
    unsafe fn exceeds(a: __m512d, b: __m512d) -> u32 {
        // SAFETY: as the caller vouches.
        unsafe { u32::from(_mm512_cmp_pd_mask::<_CMP_GT_OQ>(a, b)) }
    }

    /// Stores what the lower numbers round to, and tells where the upper ones round to the same. +0 stands for -0.
    ///
    /// # Safety
    /// AVX-512 must be there, and room for eight floats at `to`.
    #[inline(always)]
    unsafe fn narrow([low, high]: [__m512d; 2], to: *mut f32) -> u32 {
        // SAFETY: as the caller vouches.
        unsafe {
            let (low, high) = (_mm512_cvtpd_ps(low), _mm512_cvtpd_ps(high));
            _mm256_storeu_ps(to, _mm256_add_ps(low, _mm256_setzero_ps()));
            u32::from(_mm256_cmp_ps_mask::<_CMP_EQ_OQ>(low, high))
        }
    }
}
