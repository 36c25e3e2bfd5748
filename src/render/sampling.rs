//! Where in its pixel a sample lies.
//!
//! Samples are stratified: n = k * k cells, one sample each, jittered by a hash of pixel and sample number, so that a
//! picture is the same however it is cut into tiles and threads.

/// Sample `s` of `k * k` in the pixel at column `x`, row `y`: offsets within the pixel, each in 0..1.
pub(super) fn position(x: u32, y: u32, s: u32, k: u32) -> [f64; 2] {
    if k <= 1 {
        return [0.5, 0.5];
    }
    let bits = hash(u64::from(x) << 32 | u64::from(y), u64::from(s));
    let jitter = [bits >> 32, bits & 0xffff_ffff].map(|b| (b as f64 + 0.5) / 4_294_967_296.0);
    [(f64::from(s % k) + jitter[0]) / f64::from(k), (f64::from(s / k) + jitter[1]) / f64::from(k)]
}

/// SplitMix64's finalizer (Steele, Lea and Flood 2014), over both words.
fn hash(a: u64, b: u64) -> u64 {
    let mix = |mut z: u64| {
        z = (z ^ z >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ z >> 31
    };
    mix(mix(a.wrapping_add(0x9e37_79b9_7f4a_7c15)).wrapping_add(b.wrapping_mul(0x9e37_79b9_7f4a_7c15)))
}

/// The side k of a square number of samples.
pub(super) fn side(samples: u32) -> Option<u32> {
    let k = samples.isqrt();
    (k > 0 && k * k == samples).then_some(k)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_sample_is_the_middle_and_more_lie_each_in_its_cell() {
        assert_eq!(position(7, 9, 0, 1), [0.5, 0.5]);
        for s in 0..16 {
            let [u, v] = position(3, 4, s, 4);
            assert_eq!([(u * 4.0) as u32, (v * 4.0) as u32], [s % 4, s / 4]);
        }
        assert_ne!(position(0, 0, 0, 2), position(1, 0, 0, 2));
        assert_eq!((side(1), side(16), side(15), side(0)), (Some(1), Some(4), None, None));
    }
}
