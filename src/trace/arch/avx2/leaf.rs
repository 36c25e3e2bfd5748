//! A leaf's vertices and triangles, eight a register.

use std::arch::x86_64::*;

use crate::exact::{Depths, Lanes, Shear};
use crate::format::{Coding, Leaf, Points};

/// A leaf's vertices, sheared, eight a register, and its corner numbers.
pub(super) struct Table {
    /// Registers in use, 1 to 4.
    pub steps: usize,
    vertices: [[__m256; 3]; 4],
    corners: [[u8; 16]; 3],
}

impl Table {
    /// Shears all vertices.
    ///
    /// # Safety
    /// AVX2 must be there, and the leaf's bytes hold [`Leaf::reach`] for eight lanes.
    #[inline(always)]
    pub unsafe fn of(leaf: &Leaf<'_>, shear: &Shear) -> Table {
        let steps = leaf.vertices().div_ceil(8);
        let corners = match leaf.coding() {
            Coding::Bytes => leaf.corner_bytes(),
            Coding::Nibbles => {
                let [a, b, c] = leaf.corner_words();
                [spread(a), spread(b), spread(c)]
            }
        };
        // SAFETY: as the caller vouches.
        unsafe {
            let begin = leaf.bytes().as_ptr().add(leaf.coordinates_at());
            let axes = shear.axes.map(|axis| axis.min(2));
            let vertices = match leaf.points() {
                Points::Floats => {
                    let stride = 4 * leaf.vertices();
                    all(steps, shear, |k, i| _mm256_loadu_ps(begin.add(stride * axes[k] + 32 * i).cast()))
                }
                Points::Steps => {
                    let (stride, scale) = (2 * leaf.vertices(), _mm256_set1_ps(leaf.scale()));
                    let bases = leaf.bytes().as_ptr().add(leaf.vertices_at());
                    let base = axes.map(|axis| _mm256_set1_epi32(bases.add(4 * axis).cast::<i32>().read_unaligned()));
                    // Exact, each step of it: `format/coordinates.rs`.
                    all(steps, shear, |k, i| {
                        let steps = _mm_loadu_si128(begin.add(stride * axes[k] + 16 * i).cast());
                        let whole = _mm256_add_epi32(_mm256_cvtepu16_epi32(steps), base[k]);
                        _mm256_mul_ps(_mm256_cvtepi32_ps(whole), scale)
                    })
                }
            };
            Table { steps, vertices, corners }
        }
    }

    /// The sheared corner k of triangles 8 h to 8 h + 7.
    ///
    /// # Safety
    /// AVX2 must be there.
    #[inline(always)]
    pub unsafe fn corner(&self, k: usize, h: usize) -> [__m256; 3] {
        // SAFETY: the caller vouches for the instructions; the load is of eight of 16 bytes.
        unsafe {
            let index = _mm256_cvtepu8_epi32(_mm_loadl_epi64(self.corners[k].as_ptr().add(8 * (h & 1)).cast()));
            let low = pick(self.vertices[0], self.vertices[1], index);
            if self.steps <= 2 {
                return low;
            }
            let high = pick(self.vertices[2], self.vertices[3], index);
            let upper = _mm256_castsi256_ps(_mm256_slli_epi32::<27>(index));
            [
                _mm256_blendv_ps(low[0], high[0], upper),
                _mm256_blendv_ps(low[1], high[1], upper),
                _mm256_blendv_ps(low[2], high[2], upper),
            ]
        }
    }

    /// Classifies triangles 8 h to 8 h + 7; the same operations in the same order as [`Shear::classify`].
    ///
    /// # Safety
    /// AVX2 must be there.
    #[inline(always)]
    pub unsafe fn half(&self, h: usize, shear: &Shear, range: [f32; 2], depths: &mut Depths) -> Lanes {
        // SAFETY: as the caller vouches; the stores are of eight of 16 floats.
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
            let doubt = !(miss | hit) & 0xff;
            if hit == 0 {
                return Lanes { accept: 0, doubt };
            }
            let sum = _mm256_add_ps(_mm256_add_ps(u, v), w);
            let share = _mm256_div_ps(_mm256_set1_ps(1.0), sum);
            let of_a = _mm256_mul_ps(_mm256_mul_ps(u, share), a[2]);
            let of_b = _mm256_mul_ps(_mm256_mul_ps(v, share), b[2]);
            let of_c = _mm256_mul_ps(_mm256_mul_ps(w, share), c[2]);
            let depth = _mm256_add_ps(_mm256_add_ps(of_a, of_b), of_c);
            let t = _mm256_mul_ps(depth, _mm256_set1_ps(shear.inverse()));
            let most = _mm256_max_ps(_mm256_max_ps(a[2], b[2]), c[2]);
            let least = _mm256_min_ps(_mm256_min_ps(a[2], b[2]), c[2]);
            let [of_shape, of_depth, constant] = shear.depth_bound();
            let shape = _mm256_mul_ps(_mm256_mul_ps(bound, _mm256_andnot_ps(sign, share)), _mm256_sub_ps(most, least));
            let shape = _mm256_mul_ps(shape, _mm256_set1_ps(of_shape));
            let deepest = _mm256_max_ps(_mm256_andnot_ps(sign, most), _mm256_andnot_ps(sign, least));
            let depth = _mm256_mul_ps(deepest, _mm256_set1_ps(of_depth));
            let h_bound = _mm256_add_ps(_mm256_add_ps(shape, depth), _mm256_set1_ps(constant));
            let (lo, hi) = (_mm256_sub_ps(t, h_bound), _mm256_add_ps(t, h_bound));
            _mm256_storeu_ps(depths.lo.as_mut_ptr().add(8 * (h & 1)), lo);
            _mm256_storeu_ps(depths.hi.as_mut_ptr().add(8 * (h & 1)), hi);
            let later = _mm256_cmp_ps::<_CMP_GT_OQ>(lo, _mm256_set1_ps(range[1]));
            let earlier = _mm256_cmp_ps::<_CMP_LT_OQ>(hi, _mm256_set1_ps(range[0]));
            let beyond = _mm256_movemask_ps(_mm256_or_ps(later, earlier)) as u32;
            Lanes { accept: hit & !beyond, doubt }
        }
    }
}

/// All vertices, sheared: `load` gives coordinate k of vertices 8 i to 8 i + 7, for i below `steps`.
///
/// # Safety
/// AVX2 must be there.
#[inline(always)]
unsafe fn all(steps: usize, shear: &Shear, load: impl Fn(usize, usize) -> __m256) -> [[__m256; 3]; 4] {
    // SAFETY: as the caller vouches.
    unsafe {
        let mut vertices = [sheared(load(0, 0), load(1, 0), load(2, 0), shear); 4];
        let mut i = 1;
        while i < steps.min(4) {
            vertices[i] = sheared(load(0, i), load(1, i), load(2, i), shear);
            i += 1;
        }
        vertices
    }
}

/// Eight sheared vertices and their depths.
///
/// # Safety
/// AVX2 must be there.
#[inline(always)]
unsafe fn sheared(x: __m256, y: __m256, z: __m256, shear: &Shear) -> [__m256; 3] {
    // SAFETY: as the caller vouches.
    unsafe {
        let [ox, oy, oz] = shear.origin();
        let [sx, sy] = shear.slopes();
        // Rounded after each step, never fused: the bound of `exact/filter.rs` counts on it.
        let depth = _mm256_sub_ps(z, _mm256_set1_ps(oz));
        let wide = _mm256_sub_ps(x, _mm256_set1_ps(ox));
        let high = _mm256_sub_ps(y, _mm256_set1_ps(oy));
        [
            _mm256_sub_ps(wide, _mm256_mul_ps(_mm256_set1_ps(sx), depth)),
            _mm256_sub_ps(high, _mm256_mul_ps(_mm256_set1_ps(sy), depth)),
            depth,
        ]
    }
}

/// Entries of a table of sixteen, two registers a coordinate, by the low four bits of each index.
///
/// # Safety
/// AVX2 must be there.
#[inline(always)]
unsafe fn pick(first: [__m256; 3], second: [__m256; 3], index: __m256i) -> [__m256; 3] {
    // SAFETY: as the caller vouches.
    unsafe {
        let upper = _mm256_castsi256_ps(_mm256_slli_epi32::<28>(index));
        let mut out = first;
        let mut k = 0;
        while k < 3 {
            let low = _mm256_permutevar8x32_ps(first[k], index);
            out[k] = _mm256_blendv_ps(low, _mm256_permutevar8x32_ps(second[k], index), upper);
            k += 1;
        }
        out
    }
}

/// An edge function, each step rounded.
///
/// # Safety
/// AVX2 must be there.
#[inline(always)]
pub(super) unsafe fn edge([px, py, _]: [__m256; 3], [qx, qy, _]: [__m256; 3]) -> __m256 {
    // SAFETY: as the caller vouches.
    unsafe { _mm256_sub_ps(_mm256_mul_ps(px, qy), _mm256_mul_ps(py, qx)) }
}

/// The larger magnitude of a point's coordinates.
///
/// # Safety
/// AVX2 must be there.
#[inline(always)]
unsafe fn magnitude([x, y, _]: [__m256; 3]) -> __m256 {
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
