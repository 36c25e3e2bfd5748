//! The inner loops with AVX2: eight slots of a node at once, a leaf in two halves of eight triangles.

use std::arch::x86_64::*;

use super::scalar;
use super::{Job, Kernel, Planes, Touched, Way};
use crate::exact::{Lanes, Shear};
use crate::format::{Coding, Leaf, Node};

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

/// The node test for eight slots, shared with AVX-512.
///
/// # Safety
/// AVX2 and FMA must be there.
#[inline(always)]
pub(super) unsafe fn touch(node: &Node, planes: &Planes, way: &Way, far: f32) -> Touched {
    // SAFETY: the caller vouches for the instructions. Loads stay within the node: 8 bytes at 0..48.
    unsafe {
        let mask = usize::from(way.mask & 7);
        let order = _mm_loadl_epi64(ORDER[usize::from(way.order & 7)].as_ptr().cast());
        let base: *const u8 = std::ptr::from_ref(node).cast();
        let down = [24 * (mask >> 2 & 1), 24 * (mask >> 1 & 1), 24 * (mask & 1)];
        // Low planes at 8 * axis, high ones 24 further on; a downward ray enters by the high plane.
        let enter = |axis: usize| {
            let plane = numbers(base.add(8 * axis + down[axis]), order);
            _mm256_fmadd_ps(plane, _mm256_set1_ps(planes.dt[axis]), _mm256_set1_ps(planes.begin[axis]))
        };
        let leave = |axis: usize| {
            let plane = numbers(base.add(8 * axis + 24 - down[axis]), order);
            _mm256_fmadd_ps(plane, _mm256_set1_ps(planes.dt[axis]), _mm256_set1_ps(planes.end[axis]))
        };
        // Where an operand is NaN the second is the result: at worst a plane binds nothing, and the ray's own ends always do.
        let near = _mm256_max_ps(enter(0), _mm256_set1_ps(way.near));
        let near = _mm256_max_ps(_mm256_max_ps(enter(1), enter(2)), near);
        let last = _mm256_min_ps(leave(0), _mm256_set1_ps(far));
        let last = _mm256_min_ps(_mm256_min_ps(leave(1), leave(2)), last);
        let slots = _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LE_OQ>(near, last)) as u32;
        let mut touched = Touched { near: [0.0; 8], slots };
        _mm256_store_ps(touched.near.as_mut_ptr(), near);
        touched
    }
}

/// The entries not beyond `far`, shared with AVX-512.
///
/// # Safety
/// AVX2 must be there.
#[inline(always)]
pub(super) unsafe fn within(near: &[f32; 8], far: f32) -> u32 {
    // SAFETY: the caller vouches for the instructions; the array is eight floats.
    unsafe {
        let near = _mm256_loadu_ps(near.as_ptr());
        _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LE_OQ>(near, _mm256_set1_ps(far))) as u32
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

/// A child's frame, shared with AVX-512.
///
/// # Safety
/// AVX2 and FMA must be there.
#[inline(always)]
pub(super) unsafe fn child(planes: &Planes, node: &Node, slot: usize, way: &Way) -> Planes {
    // SAFETY: the caller vouches for the instructions; the arrays are four floats, aligned to 16.
    unsafe {
        let (low, high) = (slot_planes(&node.low, slot & 7), slot_planes(&node.high, slot & 7));
        let (begin, end) = (_mm_load_ps(planes.begin.as_ptr()), _mm_load_ps(planes.end.as_ptr()));
        let dt = _mm_load_ps(planes.dt.as_ptr());
        let corner = _mm_cvtepi32_ps(low);
        // 2^floor(log2(high - low)) is the float's exponent alone; at least 1, as high > low.
        let extent = _mm_cvtepi32_ps(_mm_max_epi32(_mm_sub_epi32(high, low), _mm_set1_epi32(1)));
        let power = _mm_and_ps(extent, _mm_castsi128_ps(_mm_set1_epi32(0x7f80_0000)));
        let shrunk = _mm_mul_ps(_mm_mul_ps(dt, power), _mm_set1_ps(1.0 / 128.0));
        let least = _mm_load_ps(way.least.as_ptr());
        let absolute = _mm_castsi128_ps(_mm_set1_epi32(0x7fff_ffff));
        let small = _mm_cmplt_ps(_mm_and_ps(shrunk, absolute), _mm_and_ps(least, absolute));
        let mut child = Planes { begin: [0.0; 4], end: [0.0; 4], dt: [0.0; 4] };
        _mm_store_ps(child.begin.as_mut_ptr(), _mm_fmadd_ps(corner, dt, begin));
        _mm_store_ps(child.end.as_mut_ptr(), _mm_fmadd_ps(corner, dt, end));
        _mm_store_ps(child.dt.as_mut_ptr(), _mm_blendv_ps(shrunk, least, small));
        child
    }
}

impl Kernel for Avx2 {
    #[inline(always)]
    fn touch(self, node: &Node, planes: &Planes, way: &Way, far: f32) -> Touched {
        // SAFETY: `self` is proof.
        unsafe { touch(node, planes, way, far) }
    }

    #[inline(always)]
    fn within(self, near: &[f32; 8], far: f32) -> u32 {
        // SAFETY: `self` is proof.
        unsafe { within(near, far) }
    }

    #[inline(always)]
    fn child(self, planes: &Planes, node: &Node, slot: usize, way: &Way) -> Planes {
        // SAFETY: `self` is proof.
        unsafe { child(planes, node, slot, way) }
    }

    #[inline(always)]
    fn classify(self, leaf: &Leaf<'_>, shear: &Shear) -> Lanes {
        let Some(table) = Table::of(leaf, shear) else { return scalar::classify(leaf, shear) };
        let bits = u32::MAX >> (32 - leaf.len().clamp(1, 16));
        // SAFETY: `self` is proof; `Table::of` checked that all loads lie within the leaf's bytes.
        unsafe {
            let first = table.half(0, shear);
            let second = if leaf.len() > 8 { table.half(1, shear) } else { Lanes::default() };
            Lanes {
                accept: (first.accept | second.accept << 8) & bits,
                doubt: (first.doubt | second.doubt << 8) & bits,
            }
        }
    }
}

/// A leaf's vertices, sheared, and its corner numbers.
struct Table {
    sheared: [[f32; 32]; 2],
    corners: [[u8; 16]; 3],
}

impl Table {
    /// Shears all vertices, eight at a time; `None` where the page ends too early behind the leaf for that.
    #[inline(always)]
    fn of(leaf: &Leaf<'_>, shear: &Shear) -> Option<Table> {
        let (begin, nv) = (leaf.coding().coordinates_at(), leaf.vertices());
        let bytes = leaf.bytes();
        let steps = nv.div_ceil(8);
        if leaf.is_empty() || bytes.len() < begin + 4 * (2 * nv + 8 * steps) {
            return None;
        }
        let mut table = Table { sheared: [[0.0; 32]; 2], corners: [[0; 16]; 3] };
        match leaf.coding() {
            Coding::Bytes => table.corners = leaf.corner_bytes(),
            Coding::Nibbles => {
                let [a, b, c] = leaf.corner_words();
                table.corners = [spread(a), spread(b), spread(c)];
            }
        }
        // SAFETY: only called from the kernel, whose value is proof of the instructions; loads of axis k reach up to
        // begin + 4 * (k * nv + 8 * steps), k <= 2, which was checked.
        unsafe {
            let base = bytes.as_ptr().add(begin);
            let x: *const f32 = base.add(4 * nv * shear.axes[0].min(2)).cast();
            let y: *const f32 = base.add(4 * nv * shear.axes[1].min(2)).cast();
            let z: *const f32 = base.add(4 * nv * shear.axes[2].min(2)).cast();
            let [ox, oy, oz] = shear.origin();
            let [sx, sy] = shear.slopes();
            let mut i = 0;
            while i < 8 * steps {
                let depth = _mm256_sub_ps(_mm256_loadu_ps(z.add(i)), _mm256_set1_ps(oz));
                let wide = _mm256_sub_ps(_mm256_loadu_ps(x.add(i)), _mm256_set1_ps(ox));
                let high = _mm256_sub_ps(_mm256_loadu_ps(y.add(i)), _mm256_set1_ps(oy));
                let wide = _mm256_sub_ps(wide, _mm256_mul_ps(_mm256_set1_ps(sx), depth));
                let high = _mm256_sub_ps(high, _mm256_mul_ps(_mm256_set1_ps(sy), depth));
                _mm256_storeu_ps(table.sheared[0].as_mut_ptr().add(i), wide);
                _mm256_storeu_ps(table.sheared[1].as_mut_ptr().add(i), high);
                i += 8;
            }
        }
        Some(table)
    }

    /// The sheared x and y of corner k of triangles 8 h to 8 h + 7.
    ///
    /// # Safety
    /// AVX2 must be there.
    #[inline(always)]
    unsafe fn corner(&self, k: usize, h: usize) -> [__m256; 2] {
        // SAFETY: the caller vouches for the instructions; gathers stay within 32 entries, as corner numbers are masked.
        unsafe {
            let bytes = _mm_loadl_epi64(self.corners[k].as_ptr().add(8 * (h & 1)).cast());
            let index = _mm256_and_si256(_mm256_cvtepu8_epi32(bytes), _mm256_set1_epi32(31));
            [
                _mm256_i32gather_ps::<4>(self.sheared[0].as_ptr(), index),
                _mm256_i32gather_ps::<4>(self.sheared[1].as_ptr(), index),
            ]
        }
    }

    /// Classifies triangles 8 h to 8 h + 7; the same operations in the same order as [`Shear::classify`].
    ///
    /// # Safety
    /// AVX2 must be there.
    #[inline(always)]
    unsafe fn half(&self, h: usize, shear: &Shear) -> Lanes {
        // SAFETY: as the caller vouches.
        unsafe {
            let (a, b, c) = (self.corner(0, h), self.corner(1, h), self.corner(2, h));
            let (u, v, w) = (edge(b, c), edge(c, a), edge(a, b));
            let m = _mm256_max_ps(_mm256_max_ps(magnitude(a), magnitude(b)), magnitude(c));
            let [linear, constant] = shear.bound();
            let bound = _mm256_add_ps(_mm256_mul_ps(_mm256_set1_ps(linear), m), _mm256_set1_ps(constant));
            let sign = _mm256_set1_ps(-0.0);
            let least = _mm256_min_ps(_mm256_min_ps(u, v), w);
            let most = _mm256_max_ps(_mm256_max_ps(u, v), w);
            let q = _mm256_min_ps(_mm256_xor_ps(least, sign), most);
            let miss = _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_GT_OQ>(q, bound)) as u32;
            let hit = _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LT_OQ>(q, _mm256_xor_ps(bound, sign))) as u32;
            Lanes { accept: hit, doubt: !(miss | hit) & 0xff }
        }
    }
}

/// An edge function, each step rounded.
///
/// # Safety
/// AVX2 must be there.
#[inline(always)]
unsafe fn edge([px, py]: [__m256; 2], [qx, qy]: [__m256; 2]) -> __m256 {
    // SAFETY: as the caller vouches.
    unsafe { _mm256_sub_ps(_mm256_mul_ps(px, qy), _mm256_mul_ps(py, qx)) }
}

/// The larger magnitude of a point's coordinates.
///
/// # Safety
/// AVX2 must be there.
#[inline(always)]
unsafe fn magnitude([x, y]: [__m256; 2]) -> __m256 {
    // SAFETY: as the caller vouches.
    unsafe {
        let sign = _mm256_set1_ps(-0.0);
        _mm256_max_ps(_mm256_andnot_ps(sign, x), _mm256_andnot_ps(sign, y))
    }
}

/// Vertex numbers of 4 bits as bytes.
#[inline(always)]
fn spread(word: u64) -> [u8; 16] {
    bytemuck::cast([spread_half(word & 0xffff_ffff).to_le(), spread_half(word >> 32).to_le()])
}

/// Eight numbers of 4 bits as bytes.
#[inline(always)]
fn spread_half(x: u64) -> u64 {
    let x = (x | x << 16) & 0x0000_ffff_0000_ffff;
    let x = (x | x << 8) & 0x00ff_00ff_00ff_00ff;
    (x | x << 4) & 0x0f0f_0f0f_0f0f_0f0f
}
