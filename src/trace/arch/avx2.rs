//! The inner loops with AVX2: eight slots of a node at once, a leaf in two halves of eight triangles.

mod leaf;
mod rough;

use std::arch::x86_64::*;

use super::{Aim, Block, Cell, Fit, Job, Kernel, MODERATE, NEAR, Rough, Rounded, Saved, Way};
use super::{round, scalar};
use crate::exact::{Depths, Lanes, Shear};
use crate::format::{self, Leaf, Node};
use crate::geometry::Ray;

/// Proof that the processor has AVX2, FMA, BMI and LZCNT.
#[derive(Clone, Copy, Debug)]
pub(super) struct Avx2(());

impl Avx2 {
    /// Asks the processor.
    pub fn detect() -> Option<Avx2> {
        let has = is_x86_feature_detected!("avx2")
            && is_x86_feature_detected!("fma")
            && is_x86_feature_detected!("bmi1")
            && is_x86_feature_detected!("bmi2")
            && is_x86_feature_detected!("lzcnt")
            && is_x86_feature_detected!("popcnt");
        has.then_some(Avx2(()))
    }
}

/// Does a job with AVX2 enabled for all that is inlined into it.
///
/// # Safety
/// [`Avx2::detect`] must have found the instruction set.
#[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
pub(super) unsafe fn run<J: Job>(job: J) -> J::Output {
    job.run(Avx2(()))
}

/// For each order m the shuffle that puts eight bytes in the order of visits: byte i is slot i XOR m. The second half does
/// the same for bytes 8 to 15.
const ORDER: [[u8; 16]; 8] = {
    let mut order = [[0u8; 16]; 8];
    let mut m = 0;
    while m < 8 {
        let mut i = 0;
        while i < 8 {
            order[m][i] = (i ^ m) as u8;
            order[m][i + 8] = (8 + (i ^ m)) as u8;
            i += 1;
        }
        m += 1;
    }
    order
};

/// Eight plane numbers as floats, in the order of visits.
///
/// # Safety
/// AVX2 must be there, and eight bytes at `bytes`.
#[inline(always)]
unsafe fn numbers(bytes: *const u8, order: __m128i) -> __m256 {
    // SAFETY: as the caller vouches.
    unsafe { _mm256_cvtepi32_ps(_mm256_cvtepu8_epi32(_mm_shuffle_epi8(_mm_loadl_epi64(bytes.cast()), order))) }
}

/// [`super::Planes`] in registers.
#[derive(Clone, Copy)]
pub(super) struct Frame {
    begin: __m128,
    dt: __m128,
}

/// One lane of four in all eight.
///
/// # Safety
/// AVX2 must be there.
#[inline(always)]
unsafe fn lane<const I: i32>(x: __m128) -> __m256 {
    // SAFETY: as the caller vouches.
    unsafe {
        match I {
            0 => _mm256_broadcastss_ps(x),
            _ => _mm256_permutevar8x32_ps(_mm256_castps128_ps256(x), _mm256_set1_epi32(I)),
        }
    }
}

/// The parameters at which one axis' planes are entered and left.
///
/// # Safety
/// AVX2 and FMA must be there.
#[inline(always)]
unsafe fn axis<const I: i32>(node: &Node, frame: Frame, way: &Way, order: __m128i) -> [__m256; 2] {
    // SAFETY: the caller vouches for the instructions. Loads stay within the node: 8 bytes at 0..48.
    unsafe {
        let base: *const u8 = std::ptr::from_ref(node).cast();
        // Low planes at 8 * axis, high ones 24 further on; a downward ray enters by the high plane.
        let down = 24 * usize::from(way.mask >> (2 - I) & 1);
        let first = numbers(base.add(8 * I as usize + down), order);
        let second = numbers(base.add(8 * I as usize + 24 - down), order);
        let (begin, dt) = (lane::<I>(frame.begin), lane::<I>(frame.dt));
        let end = _mm256_add_ps(begin, _mm256_broadcast_ss(&way.slack[I as usize]));
        [_mm256_fmadd_ps(first, dt, begin), _mm256_fmadd_ps(second, dt, end)]
    }
}

/// The node test for eight slots.
///
/// # Safety
/// AVX2 and FMA must be there.
#[inline(always)]
unsafe fn touch(node: &Node, frame: Frame, way: &Way, [begin, far]: [f32; 2]) -> (u32, __m256) {
    // SAFETY: the caller vouches for the instructions.
    unsafe {
        let order = _mm_loadl_epi64(ORDER[usize::from(way.order & 7)].as_ptr().cast());
        let [x0, x1] = axis::<0>(node, frame, way, order);
        let [y0, y1] = axis::<1>(node, frame, way, order);
        let [z0, z1] = axis::<2>(node, frame, way, order);
        // Where an operand is NaN the second is the result: at worst a plane binds nothing, and the ray's own ends always do.
        let near = _mm256_max_ps(_mm256_max_ps(y0, z0), _mm256_max_ps(x0, _mm256_set1_ps(begin)));
        let last = _mm256_min_ps(_mm256_min_ps(y1, z1), _mm256_min_ps(x1, _mm256_set1_ps(far)));
        (_mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LE_OQ>(near, last)) as u32, near)
    }
}

/// The entries not beyond `far`, shared with AVX-512.
///
/// # Safety
/// AVX2 must be there.
#[inline(always)]
pub(super) unsafe fn within(near: __m256, far: f32) -> u32 {
    // SAFETY: the caller vouches for the instructions.
    unsafe { _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LE_OQ>(near, _mm256_set1_ps(far))) as u32 }
}

/// Three numbers in a register.
///
/// # Safety
/// AVX2 must be there.
#[inline(always)]
unsafe fn three([x, y, z]: [f32; 3]) -> __m128 {
    // SAFETY: as the caller vouches.
    unsafe { _mm_setr_ps(x, y, z, 0.0) }
}

/// Aims a plain ray, shared with AVX-512; the same as the portable code does.
///
/// # Safety
/// AVX2 and FMA must be there.
#[inline(always)]
pub(super) unsafe fn aim(ray: &Ray, fit: &Fit, way: &mut Way, aim: &mut Aim) -> bool {
    // SAFETY: the caller vouches for the instructions; the arrays are four numbers, and the loads stay within the ray's 32 bytes.
    unsafe {
        let numbers: *const f32 = std::ptr::from_ref(ray).cast();
        let (o, d) = (_mm_loadu_ps(numbers), _mm_loadu_ps(numbers.add(3)));
        let absolute = _mm256_castsi256_pd(_mm256_set1_epi64x(i64::MAX));
        let scale = _mm256_set1_pd(fit.scale);
        let p = _mm256_mul_pd(_mm256_sub_pd(_mm256_cvtps_pd(o), _mm256_loadu_pd(fit.corner.as_ptr())), scale);
        let size = _mm256_and_pd(p, absolute);
        let near = _mm256_movemask_pd(_mm256_cmp_pd::<_CMP_LE_OQ>(size, _mm256_set1_pd(NEAR)));
        let sign = _mm_set1_ps(-0.0);
        let steep = _mm_andnot_ps(sign, d);
        let least = _mm_cmp_ps::<_CMP_GE_OQ>(steep, _mm_set1_ps(MODERATE[0]));
        let most = _mm_cmp_ps::<_CMP_LE_OQ>(steep, _mm_set1_ps(MODERATE[1]));
        let moderate = _mm_movemask_ps(_mm_and_ps(least, most));
        let inv = _mm_div_ps(_mm_set1_ps(fit.side), d);
        let away = _mm_add_ps(_mm256_cvtpd_ps(size), _mm_set1_ps(3.01));
        let slack = _mm_mul_ps(_mm_andnot_ps(sign, inv), _mm_mul_ps(_mm_set1_ps(fit.rounding), away));
        let unit = _mm_mul_ps(inv, _mm_set1_ps(format::Frame::LEAST_UNIT as f32));
        _mm256_storeu_pd(aim.origin.as_mut_ptr(), p);
        _mm_storeu_ps(aim.inv.as_mut_ptr(), inv);
        _mm_storeu_ps(aim.slack.as_mut_ptr(), slack);
        _mm_storeu_ps(way.slack.as_mut_ptr(), _mm_add_ps(slack, slack));
        let less = _mm_xor_ps(unit, sign);
        for (least, unit) in way.least.iter_mut().zip([unit, unit, less, less]) {
            _mm_storeu_ps(least.as_mut_ptr(), unit);
        }
        // Bits x, y, z from the lowest on; the mask has x highest.
        const MIRROR: [u8; 8] = [0, 4, 2, 6, 1, 5, 3, 7];
        way.mask = MIRROR[(_mm_movemask_ps(d) & 7) as usize];
        (near & moderate & 7 == 7) & (ray.tmin <= ray.tmax) & (fit.side < f32::INFINITY)
    }
}

/// The parameters of the root's or a brick's frame, shared with AVX-512: begin and dt.
///
/// # Safety
/// AVX2 and FMA must be there.
#[inline(always)]
pub(super) unsafe fn begin(cell: &Cell, aim: &Aim) -> [__m128; 2] {
    // SAFETY: the caller vouches for the instructions; the arrays are four numbers.
    unsafe {
        let corner = _mm256_sub_pd(_mm256_cvtps_pd(three(cell.corner)), _mm256_loadu_pd(aim.origin.as_ptr()));
        let (inv, slack) = (_mm_loadu_ps(aim.inv.as_ptr()), _mm_loadu_ps(aim.slack.as_ptr()));
        [_mm_fmsub_ps(_mm256_cvtpd_ps(corner), inv, slack), _mm_mul_ps(three(cell.unit), inv)]
    }
}

/// Puts a node aside.
///
/// # Safety
/// AVX2 must be there.
#[inline(always)]
unsafe fn save(saved: &mut Saved, frame: Frame, near: __m256) {
    // SAFETY: the caller vouches for the instructions; the arrays are aligned to 32.
    unsafe {
        _mm256_store_ps(saved.near.as_mut_ptr(), near);
        _mm_store_ps(saved.frame.as_mut_ptr(), frame.begin);
        _mm_store_ps(saved.frame.as_mut_ptr().add(4), frame.dt);
    }
}

/// Takes a node up again.
///
/// # Safety
/// AVX2 must be there.
#[inline(always)]
unsafe fn load(saved: &Saved) -> (Frame, __m256) {
    // SAFETY: as for `save`.
    unsafe {
        let at = saved.frame.as_ptr();
        (Frame { begin: _mm_load_ps(at), dt: _mm_load_ps(at.add(4)) }, _mm256_load_ps(saved.near.as_ptr()))
    }
}

/// The planes of one slot, axis by axis.
///
/// # Safety
/// AVX2 must be there.
#[inline(always)]
unsafe fn slot_planes(planes: &[[u8; 8]; 3], slot: usize) -> __m128i {
    // SAFETY: as the caller vouches.
    unsafe { _mm_setr_epi32(i32::from(planes[0][slot]), i32::from(planes[1][slot]), i32::from(planes[2][slot]), 0) }
}

/// A child's frame from the numbers of its low and high planes.
///
/// # Safety
/// AVX2 and FMA must be there.
#[inline(always)]
unsafe fn child(frame: Frame, low: __m128i, high: __m128i, way: &Way) -> Frame {
    // SAFETY: the caller vouches for the instructions; the array is four floats, aligned to 16.
    unsafe {
        // 2^(floor(log2(high - low)) - 7) by the float's exponent alone; the difference is at least 1.
        let extent = _mm_cvtepi32_ps(_mm_max_epi32(_mm_sub_epi32(high, low), _mm_set1_epi32(1)));
        let power = _mm_and_si128(_mm_castps_si128(extent), _mm_set1_epi32(0x7f80_0000));
        let shrink = _mm_castsi128_ps(_mm_sub_epi32(power, _mm_set1_epi32(7 << 23)));
        let dt = _mm_mul_ps(frame.dt, shrink);
        // The larger magnitude; both have the ray's sign.
        let (least, sign) = (_mm_load_ps(way.least[0].as_ptr()), _mm_set1_ps(-0.0));
        let magnitude = _mm_max_ps(_mm_andnot_ps(sign, dt), _mm_andnot_ps(sign, least));
        let dt = _mm_or_ps(magnitude, _mm_and_ps(sign, least));
        Frame { begin: _mm_fmadd_ps(_mm_cvtepi32_ps(low), frame.dt, frame.begin), dt }
    }
}

impl Kernel for Avx2 {
    type Frame = Frame;
    type Near = __m256;
    type Ends = [f32; 2];

    #[inline(always)]
    fn aim(self, ray: &Ray, fit: &Fit, way: &mut Way, to: &mut Aim) -> bool {
        // SAFETY: `self` is proof.
        unsafe { aim(ray, fit, way, to) }
    }

    #[inline(always)]
    fn frame(self, cell: &Cell, aim: &Aim, _: &Way) -> Frame {
        // SAFETY: `self` is proof.
        let [begin, dt] = unsafe { begin(cell, aim) };
        Frame { begin, dt }
    }

    #[inline(always)]
    fn save(self, saved: &mut Saved, frame: Frame, near: __m256) {
        // SAFETY: `self` is proof.
        unsafe { save(saved, frame, near) }
    }

    #[inline(always)]
    fn load(self, saved: &Saved) -> (Frame, __m256) {
        // SAFETY: `self` is proof.
        unsafe { load(saved) }
    }

    #[inline(always)]
    fn fetch<T>(self, from: &T, bytes: usize) {
        // SAFETY: asking ahead touches nothing, whatever the address.
        unsafe { _mm_prefetch::<_MM_HINT_T0>(std::ptr::from_ref(from).cast::<i8>().wrapping_add(bytes)) }
    }

    #[inline(always)]
    fn ends(self, near: f32, far: f32) -> [f32; 2] {
        [near, far]
    }

    #[inline(always)]
    fn touch(self, node: &Node, frame: Frame, way: &Way, ends: [f32; 2]) -> (u32, __m256) {
        // SAFETY: `self` is proof.
        unsafe { touch(node, frame, way, ends) }
    }

    #[inline(always)]
    fn planes(self, node: &Node, way: &Way) -> [[__m256; 2]; 3] {
        // SAFETY: `self` is proof; each set of planes is eight bytes.
        unsafe {
            let order = _mm_loadl_epi64(ORDER[usize::from(way.order & 7)].as_ptr().cast());
            let mut planes = [[_mm256_setzero_ps(); 2]; 3];
            let mut axis = 0;
            while axis < 3 {
                let down = way.mask & (4 >> axis) != 0;
                let (first, second) = if down { (&node.high, &node.low) } else { (&node.low, &node.high) };
                planes[axis] = [numbers(first[axis].as_ptr(), order), numbers(second[axis].as_ptr(), order)];
                axis += 1;
            }
            planes
        }
    }

    #[inline(always)]
    fn within(self, near: __m256, far: f32) -> u32 {
        // SAFETY: `self` is proof.
        unsafe { within(near, far) }
    }

    #[inline(always)]
    fn child(self, frame: Frame, node: &Node, slot: usize, way: &Way) -> Frame {
        // SAFETY: `self` is proof.
        unsafe { child(frame, slot_planes(&node.low, slot & 7), slot_planes(&node.high, slot & 7), way) }
    }

    #[inline(always)]
    fn classify(self, leaf: &Leaf<'_>, shear: &Shear, range: [f32; 2], depths: &mut Depths) -> Lanes {
        if leaf.is_empty() || leaf.bytes().len() < leaf.reach(8) {
            return scalar::classify(leaf, shear, range, depths);
        }
        let bits = u32::MAX >> (32 - leaf.len().clamp(1, 16));
        // SAFETY: `self` is proof; all loads end before the reach, which lies within the leaf's bytes.
        unsafe {
            let table = leaf::Table::of(leaf, shear);
            let first = table.half(0, shear, range, depths);
            let second = if leaf.len() > 8 { table.half(1, shear, range, depths) } else { Lanes::default() };
            Lanes {
                accept: (first.accept | second.accept << 8) & bits,
                doubt: (first.doubt | second.doubt << 8) & bits,
            }
        }
    }

    #[inline(always)]
    fn rounded(self, block: &Block, wanted: u32, to: &mut Rounded) {
        // SAFETY: `self` is proof.
        unsafe { round::avx2::rounded(block, wanted, to) }
    }

    #[inline(always)]
    fn nearest(self, leaf: &Leaf<'_>, shear: &Shear, range: [f32; 2]) -> Option<Rough> {
        // SAFETY: `self` is proof.
        unsafe { rough::nearest(leaf, shear, range) }
    }
}
