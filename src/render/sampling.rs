//! Where in its pixel a sample lies.
//!
//! Samples are stratified: n = k * k cells, one sample each, shifted so that no two share a row or a column of the
//! n x n grid (the canonical arrangement of Chiu, Shirley and Wang, "Multi-jittered sampling", Graphics Gems IV 1994;
//! for n = 4 the rotated grid). An edge that is almost level or upright so gets n steps of colour. Without jitter:
//! every pixel has the same positions, so that a straight edge is not frayed, and tiles and threads change nothing.

/// Sample `s` of `k * k`: offsets within its pixel, each in 0..1.
pub(super) fn position(s: u32, k: u32) -> [f64; 2] {
    if k == 1 {
        return [0.5; 2];
    }
    let (column, row) = (s % k, s / k);
    let (x, y) = (column * k + (k - 1 - row), row * k + column);
    [x, y].map(|i| (f64::from(i) + 0.5) / (f64::from(k) * f64::from(k)))
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
    fn no_two_samples_share_a_row_or_a_column() {
        for k in [2, 3, 8] {
            for axis in [0, 1] {
                let mut steps: Vec<f64> = (0..k * k).map(|s| position(s, k)[axis] * f64::from(k * k)).collect();
                steps.sort_by(f64::total_cmp);
                assert!(steps.iter().enumerate().all(|(i, step)| (step - i as f64 - 0.5).abs() < 1e-9), "{steps:?}");
            }
        }
    }

    #[test]
    fn one_sample_is_the_middle_and_more_lie_each_in_its_cell() {
        assert_eq!(position(0, 1), [0.5, 0.5]);
        for s in 0..16 {
            let [u, v] = position(s, 4);
            assert_eq!([(u * 4.0) as u32, (v * 4.0) as u32], [s % 4, s / 4]);
        }
        assert_eq!((side(1), side(16), side(15), side(0)), (Some(1), Some(4), None, None));
    }
}
