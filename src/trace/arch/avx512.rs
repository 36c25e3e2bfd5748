//! The inner loops with AVX-512: both ends of a node's eight slots at once, or a leaf's sixteen triangles.

mod leaf;
mod rough;

use std::arch::asm;
use std::arch::x86_64::*;

use super::{Aim, Block, Cell, Fit, Job, Kernel, Rough, Rounded, Saved, Way, avx2, round, scalar};
use crate::exact::{Depths, Lanes, Shear};
use crate::format::{Leaf, Node};
use crate::geometry::Ray;

/// Proof that the processor has AVX-512 (F, BW, DQ, VL, CD, VBMI: Ice Lake, Zen 4 and later) and what [`avx2::Avx2`] stands for.
#[derive(Clone, Copy, Debug)]
pub(super) struct Avx512(());

impl Avx512 {
    /// Asks the processor.
    pub fn detect() -> Option<Avx512> {
        let has = avx2::Avx2::detect().is_some()
            && is_x86_feature_detected!("avx512f")
            && is_x86_feature_detected!("avx512bw")
            && is_x86_feature_detected!("avx512dq")
            && is_x86_feature_detected!("avx512vl")
            && is_x86_feature_detected!("avx512vbmi")
            && is_x86_feature_detected!("avx512cd");
        has.then_some(Avx512(()))
    }
}

/// Does a job with AVX-512 enabled for all that is inlined into it.
///
/// # Safety
/// [`Avx512::detect`] must have found the instruction set.
#[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl,avx512vbmi,avx512cd,avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
pub(super) unsafe fn run<J: Job>(job: J) -> J::Output {
    job.run(Avx512(()))
}

/// For each direction mask m (near to far, then far to near, where the order is its complement) and axis the bytes of a node that the
/// node test takes: in lane i the plane by which slot i XOR order is entered, in lane 8 + i the one by which it is left; only the
/// first byte of a lane's four counts.
static ORDER: [[Index; 3]; 16] = {
    let mut order = [[Index([0; 64]); 3]; 16];
    let mut m = 0;
    while m < 16 {
        let visit = if m < 8 { m } else { (m - 8) ^ 7 };
        let mut axis = 0;
        while axis < 3 {
            // Low planes at 8 * axis, high ones 24 further on; a downward ray enters by the high plane.
            let down = if m >> (2 - axis) & 1 != 0 { 24 } else { 0 };
            let mut i = 0;
            while i < 8 {
                order[m][axis].0[4 * i] = (8 * axis + down + (i ^ visit)) as u8;
                order[m][axis].0[4 * (8 + i)] = (8 * axis + 24 - down + (i ^ visit)) as u8;
                i += 1;
            }
            axis += 1;
        }
        m += 1;
    }
    order
};

#[derive(Clone, Copy)]
#[repr(C, align(64))]
struct Index([u8; 64]);

/// The first byte of each lane.
const FIRST: u64 = 0x1111_1111_1111_1111;

/// [`super::Planes`] in one register: begin, dt, -end, -dt; so that one axis' sixteen parameters, those of leaving negated, are one
/// multiplication and addition.
type Frame = __m512;

/// The lanes of a frame that hold dt and -dt.
const STEPS: u16 = 0xf0f0;

/// A constant index whose value the compiler does not see: it would make two shuffles of a permutation by it.
///
/// # Safety
/// AVX-512 must be there.
#[inline]
#[target_feature(enable = "avx512f")]
unsafe fn opaque(mut index: __m512i) -> __m512i {
    // SAFETY: no instruction at all.
    unsafe { asm!("/* {} */", inout(zmm_reg) index, options(pure, nomem, nostack, preserves_flags)) };
    index
}

/// A constant mask likewise: it would take the bytes first and clear the others after.
///
/// # Safety
/// AVX-512 must be there.
#[inline]
#[target_feature(enable = "avx512bw")]
unsafe fn opaque_mask(mut mask: u64) -> u64 {
    // SAFETY: no instruction at all.
    unsafe { asm!("/* {} */", inout(kreg) mask, options(pure, nomem, nostack, preserves_flags)) };
    mask
}

/// The planes of one axis by which slots are entered, and those by which they are left.
///
/// # Safety
/// AVX-512 must be there.
#[inline(always)]
unsafe fn planes<const I: i32>(node: __m512i, way: &Way) -> __m512 {
    // SAFETY: the caller vouches for the instructions; the index is 64 bytes, aligned.
    unsafe {
        let order = _mm512_load_si512(ORDER[usize::from(way.row & 15)][I as usize].0.as_ptr().cast());
        _mm512_cvtepi32_ps(_mm512_maskz_permutexvar_epi8(opaque_mask(FIRST), order, node))
    }
}

/// The parameters of one axis, those at which slots are left negated.
///
/// # Safety
/// AVX-512 must be there.
#[inline(always)]
unsafe fn axis<const I: i32>(node: __m512i, frame: Frame, way: &Way) -> __m512 {
    // SAFETY: as the caller vouches.
    unsafe {
        let plane = planes::<I>(node, way);
        let begin = _mm512_mask_mov_epi32(_mm512_set1_epi32(I), 0xff00, _mm512_set1_epi32(8 + I));
        let dt = _mm512_mask_mov_epi32(_mm512_set1_epi32(4 + I), 0xff00, _mm512_set1_epi32(12 + I));
        _mm512_fmadd_ps(plane, _mm512_permutexvar_ps(opaque(dt), frame), _mm512_permutexvar_ps(opaque(begin), frame))
    }
}

impl Kernel for Avx512 {
    type Frame = Frame;
    type Near = __m256;
    /// Eight times near, then eight times -far.
    type Ends = __m512;

    #[inline(always)]
    fn fetch<T>(self, from: &T, bytes: usize) {
        // SAFETY: asking ahead touches nothing, whatever the address.
        unsafe { _mm_prefetch::<_MM_HINT_T0>(std::ptr::from_ref(from).cast::<i8>().wrapping_add(bytes)) }
    }

    #[inline(always)]
    fn ends(self, near: f32, far: f32) -> __m512 {
        // SAFETY: `self` is proof.
        unsafe { _mm512_mask_mov_ps(_mm512_set1_ps(near), 0xff00, _mm512_set1_ps(-far)) }
    }

    #[inline(always)]
    fn aim(self, ray: &Ray, fit: &Fit, way: &mut Way, aim: &mut Aim) -> bool {
        // SAFETY: `self` is proof.
        unsafe { avx2::aim(ray, fit, way, aim) }
    }

    #[inline(always)]
    fn frame(self, cell: &Cell, aim: &Aim, way: &Way) -> Frame {
        // SAFETY: `self` is proof; the array is four floats.
        unsafe {
            let [begin, dt] = avx2::begin(cell, aim);
            let (end, sign) = (_mm_add_ps(begin, _mm_loadu_ps(way.slack.as_ptr())), _mm256_set1_ps(-0.0));
            let (enter, leave) = (_mm256_set_m128(dt, begin), _mm256_xor_ps(_mm256_set_m128(dt, end), sign));
            _mm512_insertf32x8::<1>(_mm512_castps256_ps512(enter), leave)
        }
    }

    #[inline(always)]
    fn save(self, saved: &mut Saved, frame: Frame, near: __m256) {
        // SAFETY: `self` is proof; the arrays are of eight and sixteen floats.
        unsafe {
            _mm256_storeu_ps(saved.near.as_mut_ptr(), near);
            _mm512_storeu_ps(saved.frame.as_mut_ptr(), frame);
        }
    }

    #[inline(always)]
    fn load(self, saved: &Saved) -> (Frame, __m256) {
        // SAFETY: as for `save`.
        unsafe { (_mm512_loadu_ps(saved.frame.as_ptr()), _mm256_loadu_ps(saved.near.as_ptr())) }
    }

    #[inline(always)]
    fn touch(self, node: &Node, frame: Frame, way: &Way, ends: __m512) -> (u32, __m256) {
        // SAFETY: `self` is proof. A node is 64 bytes.
        unsafe {
            let node = _mm512_loadu_si512(std::ptr::from_ref(node).cast());
            let (x, y, z) = (axis::<0>(node, frame, way), axis::<1>(node, frame, way), axis::<2>(node, frame, way));
            // Where an operand is NaN the second is the result: at worst a plane binds nothing, and the ray's own ends always do.
            let bounds = _mm512_max_ps(_mm512_max_ps(y, z), _mm512_max_ps(x, ends));
            let near = _mm512_castps512_ps256(bounds);
            let last = _mm256_xor_ps(_mm512_extractf32x8_ps::<1>(bounds), _mm256_set1_ps(-0.0));
            (u32::from(_mm256_cmp_ps_mask::<_CMP_LE_OQ>(near, last)), near)
        }
    }

    #[inline(always)]
    fn planes(self, node: &Node, way: &Way) -> [__m512; 3] {
        // SAFETY: `self` is proof. A node is 64 bytes.
        unsafe {
            let node = _mm512_loadu_si512(std::ptr::from_ref(node).cast());
            [planes::<0>(node, way), planes::<1>(node, way), planes::<2>(node, way)]
        }
    }

    #[inline(always)]
    fn within(self, near: __m256, far: f32) -> u32 {
        // SAFETY: `self` is proof.
        unsafe { u32::from(_mm256_cmp_ps_mask::<_CMP_LE_OQ>(near, _mm256_set1_ps(far))) }
    }

    #[inline(always)]
    fn child(self, frame: Frame, node: &Node, slot: usize, way: &Way) -> Frame {
        // SAFETY: `self` is proof. A node is 64 bytes.
        unsafe {
            let bytes = _mm512_loadu_si512(std::ptr::from_ref(node).cast());
            // Bytes slot, 8 + slot, 16 + slot of the low planes, each in a lane of its own; the high ones are 24 further on.
            let low = _mm512_broadcast_i32x4(_mm_setr_epi32(0, 8, 16, 0));
            let low = _mm512_add_epi8(low, _mm512_set1_epi8(slot as i8 & 7));
            let high = _mm512_add_epi8(low, _mm512_set1_epi8(24));
            const XYZ: u64 = 0x0111_0111_0111_0111;
            let mask = opaque_mask(XYZ);
            let low = _mm512_maskz_permutexvar_epi8(mask, low, bytes);
            let high = _mm512_maskz_permutexvar_epi8(mask, high, bytes);
            // dt times 2^(floor(log2(high - low)) - 7), by its exponent: dt is normal, and so is 2^-7 of the smallest. floor(log2(x)) is 31
            // less the leading zeros.
            let zeros = _mm512_slli_epi32::<23>(_mm512_lzcnt_epi32(_mm512_sub_epi32(high, low)));
            let step = _mm512_add_epi32(_mm512_castps_si512(frame), _mm512_set1_epi32(24 << 23));
            // The larger magnitude: signs agree.
            let least = _mm512_loadu_si512(way.least.as_ptr().cast());
            let step = _mm512_castsi512_ps(_mm512_max_epu32(_mm512_sub_epi32(step, zeros), least));
            // dt beside begin, -dt beside -end.
            let dt = _mm512_shuffle_f32x4::<0b11_11_01_01>(frame, frame);
            let moved = _mm512_fmadd_ps(_mm512_cvtepi32_ps(low), dt, frame);
            _mm512_mask_mov_ps(moved, STEPS, step)
        }
    }

    #[inline(always)]
    fn classify(self, leaf: &Leaf<'_>, shear: &Shear, range: [f32; 2], depths: &mut Depths) -> Lanes {
        if leaf.is_empty() || leaf.bytes().len() < leaf.reach(16) {
            return scalar::classify(leaf, shear, range, depths);
        }
        // SAFETY: `self` is proof; all loads end before the reach, which lies within the leaf's bytes.
        unsafe { leaf::classify(leaf, shear, range, depths) }
    }

    #[inline(always)]
    fn rounded(self, block: &Block, wanted: u32, to: &mut Rounded) {
        // SAFETY: `self` is proof.
        unsafe { round::avx512::rounded(block, wanted, to) }
    }

    #[inline(always)]
    fn nearest(self, leaf: &Leaf<'_>, shear: &Shear, range: [f32; 2]) -> Option<Rough> {
        // SAFETY: `self` is proof.
        unsafe { rough::nearest(leaf, shear, range) }
    }
}
