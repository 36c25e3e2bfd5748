//! Exact orientation of f32 points in a plane, and the exact test for triangles of zero area.
//!
//! A determinant of differences is first taken in f64 with Shewchuk's error bound (Adaptive Precision Floating-Point
//! Arithmetic, 1997); in doubt it is expanded into six products of two f32 values, each exact in f64 (48 bits, at
//! least 2^-298 or zero, at most 2^256), whose sum is taken exactly as an expansion. Nothing can overflow or underflow.

use std::cmp::Ordering;

use super::expansion::two_sum;
use super::predicates::drop_axis;
use crate::geometry::Triangle;

/// Bound on the rounding error of the determinant, as a multiple of its permanent: (3 + 16 e) e with e = 2^-53.
const BOUND: f64 = (3.0 + 16.0 * (f64::EPSILON / 2.0)) * (f64::EPSILON / 2.0);

/// Whether the plane points a, b, c turn left (`Greater`), right (`Less`), or lie on a line (`Equal`). Exact for finite
/// coordinates; for points in space drop one axis. Allocates nothing: the builder asks this of every triangle.
pub fn orient2d(a: [f32; 2], b: [f32; 2], c: [f32; 2]) -> Ordering {
    let [[ax, ay], [bx, by], [cx, cy]] = [a, b, c].map(|p| p.map(f64::from));
    let (left, right) = ((bx - ax) * (cy - ay), (by - ay) * (cx - ax));
    let det = left - right;
    if det.abs() > BOUND * (left.abs() + right.abs()) {
        return det.total_cmp(&0.0);
    }
    sum_sign([bx * cy, -(bx * ay), -(ax * cy), -(by * cx), by * ax, ay * cx])
}

/// Whether the triangle has exactly zero area: corners that coincide or lie on one line. No ray can hit it.
pub fn exactly_degenerate(triangle: &Triangle) -> bool {
    let [a, b, c] = triangle.vertices().map(|v| v.to_array());
    (0..3).all(|axis| orient2d(drop_axis(a, axis), drop_axis(b, axis), drop_axis(c, axis)) == Ordering::Equal)
}

/// The sign of an exact sum: terms are added one by one to a non-overlapping expansion (Shewchuk's Grow-Expansion), whose
/// largest non-zero component has the sign of the whole.
fn sum_sign(terms: [f64; 6]) -> Ordering {
    let mut expansion = [0.0f64; 6];
    for (n, term) in terms.into_iter().enumerate() {
        let mut q = term;
        for component in &mut expansion[..n] {
            let (sum, error) = two_sum(q, *component);
            (q, *component) = (sum, error);
        }
        expansion[n] = q;
    }
    let largest = expansion.into_iter().rev().find(|&x| x != 0.0);
    largest.map_or(Ordering::Equal, |x| x.total_cmp(&0.0))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn is_degenerate(corners: [[f32; 3]; 3]) -> bool {
        exactly_degenerate(&corners.into())
    }

    /// The same with whole numbers, for coordinates that are multiples of 2^-20.
    fn whole(a: [i64; 2], b: [i64; 2], c: [i64; 2]) -> Ordering {
        let [[ax, ay], [bx, by], [cx, cy]] = [a, b, c].map(|p| p.map(i128::from));
        ((bx - ax) * (cy - ay)).cmp(&((by - ay) * (cx - ax)))
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]
        #[test]
        fn agrees_with_whole_numbers(p in prop::array::uniform6(-0xff_ffffi64..0xff_ffff), k in 0i64..4, tight in any::<bool>()) {
            let (a, mut b, mut c) = ([p[0], p[1]], [p[2], p[3]], [p[4], p[5]]);
            if tight {
                // Near or on one line: c = a + k (b - a), moved by -1, 0 or 1.
                b = [a[0] + p[2] % 1000, a[1] + p[3] % 1000];
                c = [a[0] + k * (b[0] - a[0]) + p[4] % 2, a[1] + k * (b[1] - a[1])];
            }
            let scaled = [a, b, c].map(|p| p.map(|x| x as f32 / 1_048_576.0));
            prop_assume!([a, b, c].iter().flatten().all(|x| x.abs() < 1 << 24));
            prop_assert_eq!(orient2d(scaled[0], scaled[1], scaled[2]), whole(a, b, c));
        }
    }

    #[test]
    fn no_overflow_and_no_underflow() {
        let (big, tiny) = (f32::MAX, f32::from_bits(1));
        assert_eq!(orient2d([-big, -big], [big, -big], [big, big]), Ordering::Greater);
        assert_eq!(orient2d([0.0, 0.0], [tiny, 0.0], [0.0, tiny]), Ordering::Greater);
        assert_eq!(orient2d([0.0, 0.0], [tiny, tiny], [big, big]), Ordering::Equal);
        assert_eq!(orient2d([0.0, 0.0], [big, big], [tiny, tiny + tiny]), Ordering::Greater);
        // The differences here are no exact f64 values.
        assert_eq!(orient2d([-big, -big], [tiny, 0.0], [big, big]), Ordering::Greater);
        assert_eq!(orient2d([-big, -big], [0.0, tiny], [big, big]), Ordering::Less);
    }

    #[test]
    fn zero_area_only_when_exactly_zero() {
        let a = [0.1f32, 0.2, 0.3];
        assert!(is_degenerate([a, a, [1.0, 2.0, 3.0]]));
        assert!(is_degenerate([[1.0, 1.0, 1.0], [2.0, 2.0, 2.0], [5.0, 5.0, 5.0]]));
        assert!(!is_degenerate([[1.0, 1.0, 1.0], [2.0, 2.0, 2.0], [5.0, 5.0, 5.0f32.next_up()]]));
        let tiny = f32::from_bits(1);
        assert!(!is_degenerate([[0.0; 3], [tiny, 0.0, 0.0], [0.0, 0.0, tiny]]));
    }
}
