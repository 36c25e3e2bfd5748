//! Determinants in whole numbers of 128 bits: the quick exact path.
//!
//! Coordinates whose exponents lie close together are small multiples of one power of two, and so are determinants of them. This
//! settles most of what f64 leaves in doubt (rays through vertices and edges, rays in a triangle's plane, crossings equally far
//! away) in a few dozen multiplications; where the exponents lie too far apart, expansions take over. Signs are exact either way.

use std::cmp::Ordering;

/// Bits of the significand of an f32.
const SIGNIFICAND: u32 = 24;

/// det(d, p - o, q - o) and (p - o) x (q - o), each up to a positive factor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Determinant {
    /// The determinant.
    pub value: i128,
    /// The cross product.
    pub cross: [i128; 3],
}

/// The unit in which some f32 are whole numbers, and how large these numbers are.
#[derive(Clone, Copy)]
struct Grid {
    /// Biased exponent of the least of the numbers.
    low: u32,
    /// All of them are below 2^bits.
    bits: u32,
}

/// The exponent field; that of the smallest normal numbers for subnormal ones, which share their unit.
fn exponent(x: f32) -> u32 {
    (x.to_bits() >> 23 & 0xff).max(1)
}

impl Grid {
    /// The finest grid that the numbers need; zeros fit any.
    fn of<'a>(numbers: impl IntoIterator<Item = &'a f32>) -> Grid {
        let (mut low, mut high) = (u32::MAX, 0);
        for &x in numbers {
            if x != 0.0 {
                (low, high) = (low.min(exponent(x)), high.max(exponent(x)));
            }
        }
        Grid { low, bits: if low <= high { high - low + SIGNIFICAND } else { 0 } }
    }

    /// A number in units of the grid. The grid has at most 62 bits.
    fn whole(self, x: f32) -> i64 {
        if x == 0.0 {
            return 0;
        }
        let hidden = u32::from(x.to_bits() >> 23 & 0xff != 0) << 23;
        let magnitude = i64::from(x.to_bits() & 0x7f_ffff | hidden) << (exponent(x) - self.low);
        if x.is_sign_negative() { -magnitude } else { magnitude }
    }
}

/// The determinant for finite input; `None` where it may need more than 127 bits.
pub(super) fn determinant(d: [f32; 3], o: [f32; 3], p: [f32; 3], q: [f32; 3]) -> Option<Determinant> {
    let (points, along) = (Grid::of(o.iter().chain(&p).chain(&q)), Grid::of(&d));
    // Differences have a bit more than points; a minor twice that and one; the sum of three products two more.
    if points.bits > 60 || along.bits > 60 || 2 * (points.bits + 1) + 1 + along.bits + 2 > 127 {
        return None;
    }
    let apart = |p: [f32; 3]| [0, 1, 2].map(|i: usize| i128::from(points.whole(p[i]) - points.whole(o[i])));
    let (p, q) = (apart(p), apart(q));
    let cross = [p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]];
    let value = (0..3).map(|i| cross[i] * i128::from(along.whole(d[i]))).sum();
    Some(Determinant { value, cross })
}

impl Determinant {
    /// The sign of the determinant for the direction d + (e, e^2, e^3); `Equal` if all of the cross product is zero.
    pub fn perturbed_sign(&self) -> Ordering {
        let [x, y, z] = self.cross;
        [self.value, x, y, z].into_iter().map(|n| n.cmp(&0)).find(|sign| sign.is_ne()).unwrap_or(Ordering::Equal)
    }
}

/// t of the line's crossing with a plane as num / den, up to a factor that is the same for all planes of one grid.
struct Parameter {
    num: i128,
    den: i128,
}

/// The order along a line of its crossings with the planes of two triangles that it is not parallel to; `None` where a number may
/// need more than 127 bits.
pub(super) fn order(d: [f32; 3], o: [f32; 3], triangles: [[[f32; 3]; 3]; 2]) -> Option<Ordering> {
    let points = Grid::of(o.iter().chain(triangles.as_flattened().as_flattened()));
    let along = Grid::of(&d);
    // Three differences, the difference of two products, a sum of three: of points for num, and of two and a direction for den.
    let most = (3 * (points.bits + 1)).max(2 * (points.bits + 1) + along.bits);
    if points.bits > 60 || along.bits > 60 || most + 1 + 2 > 127 {
        return None;
    }
    let d = d.map(|x| i128::from(along.whole(x)));
    let parameter = |[a, b, c]: [[f32; 3]; 3]| {
        let apart =
            |p: [f32; 3], q: [f32; 3]| [0, 1, 2].map(|i: usize| i128::from(points.whole(p[i]) - points.whole(q[i])));
        let (a, e, f) = (apart(a, o), apart(b, a), apart(c, a));
        let normal = [e[1] * f[2] - e[2] * f[1], e[2] * f[0] - e[0] * f[2], e[0] * f[1] - e[1] * f[0]];
        let dot = |v: [i128; 3]| normal[0] * v[0] + normal[1] * v[1] + normal[2] * v[2];
        let (num, den) = (dot(a), dot(d));
        if den < 0 { Parameter { num: -num, den: -den } } else { Parameter { num, den } }
    };
    let [first, second] = triangles.map(parameter);
    Some(first.cmp(&second))
}

impl Parameter {
    /// The order of two quotients of positive denominators.
    fn cmp(&self, other: &Parameter) -> Ordering {
        if self.num.signum() != other.num.signum() {
            return self.num.cmp(&other.num);
        }
        let crosswise = |a: &Parameter, b: &Parameter| wide(a.num.unsigned_abs(), b.den.unsigned_abs());
        let order = crosswise(self, other).cmp(&crosswise(other, self));
        if self.num < 0 { order.reverse() } else { order }
    }
}

/// The product of two numbers in 256 bits: the upper half, then the lower.
fn wide(a: u128, b: u128) -> (u128, u128) {
    let halves = |x: u128| (x >> 64, x & u128::from(u64::MAX));
    let ((a1, a0), (b1, b0)) = (halves(a), halves(b));
    let ((c1, c0), (m1, m0), (n1, n0)) = (halves(a0 * b0), halves(a1 * b0), halves(a0 * b1));
    let (carry, middle) = halves(c1 + m0 + n0);
    (a1 * b1 + m1 + n1 + carry, middle << 64 | c0)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::expansion::{cross, dot, exact, subtract};
    use super::super::quotient::Quotient;
    use super::*;

    /// The same order by expansions; `None` where a plane runs along the line.
    fn order_by_expansions(d: [f32; 3], o: [f32; 3], triangles: [[[f32; 3]; 3]; 2]) -> Option<Ordering> {
        let quotient = |[a, b, c]: [[f32; 3]; 3]| {
            let normal = cross(&subtract(b, a), &subtract(c, a));
            let den = dot(&normal, &exact(d));
            (!den.is_zero()).then(|| Quotient::new(dot(&normal, &subtract(a, o)), den))
        };
        let [first, second] = triangles.map(quotient);
        Some(first?.cmp(&second?))
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(20_000))]
        #[test]
        fn agrees_with_expansions(
            n in proptest::array::uniform12(-40i32..40),
            exponents in proptest::array::uniform12(0i32..11),
            unit in -149i32..80,
        ) {
            // Small whole numbers, so that zeros of all kinds are frequent, and larger ones beside them.
            let number = |i: usize| {
                let shift = if exponents[i] < 6 { 0 } else { exponents[i] };
                ((n[i] / 8 * (1 << shift)) as f64 * 2f64.powi(unit)) as f32
            };
            let [d, o, p, q] = [0, 3, 6, 9].map(|k| [number(k), number(k + 1), number(k + 2)]);
            let expected = cross(&subtract(p, o), &subtract(q, o));
            let value = dot(&exact(d), &expected);
            let found = determinant(d, o, p, q).expect("close exponents");
            prop_assert_eq!(found.value.cmp(&0), value.sign());
            prop_assert_eq!(found.cross.map(|x| x.cmp(&0)), expected.each_ref().map(|x| x.sign()));
        }

        #[test]
        fn any_bits_agree_or_are_left(bits in proptest::array::uniform12(any::<u32>()), like in any::<bool>()) {
            // Any significand; exponents any, or close together.
            let number = |i: usize| {
                let exponent = if like { 120 + (bits[i] >> 23) % 12 } else { bits[i] >> 23 & 0xff };
                f32::from_bits(bits[i] & 0x807f_ffff | exponent << 23)
            };
            let [d, o, p, q] = [0, 3, 6, 9].map(|k| [number(k), number(k + 1), number(k + 2)]);
            prop_assume!([d, o, p, q].iter().flatten().all(|x| x.is_finite()));
            let found = determinant(d, o, p, q);
            prop_assert!(found.is_some() || !like);
            if let Some(found) = found {
                let value = dot(&exact(d), &cross(&subtract(p, o), &subtract(q, o)));
                prop_assert_eq!(found.value.cmp(&0), value.sign());
            }
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(20_000))]
        #[test]
        fn order_agrees_with_expansions(
            n in proptest::array::uniform24(-64i32..64),
            far in 0i32..10,
            unit in -149i32..80,
            alike in 0..3,
            nudge in -1i32..2,
        ) {
            // Coordinates of up to 17 bits. The second triangle may lie in the first one's plane, or a unit off.
            let fine = |i: usize| n[i] * (1 << ((i as i32 * far) % 10)) + n[(i + 7) % 24] / 8;
            let number = |whole: i32| (f64::from(whole) * 2f64.powi(unit)) as f32;
            let point = |i: usize| [fine(i), fine(i + 1), fine(i + 2)];
            let (d, o, a, b, c) = (point(0), point(3), point(6), point(9), point(12));
            let mut second = [point(15), point(18), point(21)];
            if alike > 0 {
                let along = |p: [i32; 3], k: i32, l: i32| [0, 1, 2].map(|i: usize| p[i] + k * (b[i] - a[i]) + l * (c[i] - a[i]));
                second = [along(a, 1, 1), along(b, -1, 1), along(c, 1, 0)];
                second[0][0] += nudge * (alike - 1);
            }
            let floats = |p: [i32; 3]| p.map(number);
            let triangles = [[a, b, c].map(floats), second.map(floats)];
            if let Some(expected) = order_by_expansions(floats(d), floats(o), triangles) {
                prop_assert_eq!(order(floats(d), floats(o), triangles), Some(expected));
            }
        }

        #[test]
        fn wide_products(a in any::<u128>(), b in any::<u128>()) {
            // Modulo 2^64 - 1 and 2^64, which together see every bit.
            let m = u128::from(u64::MAX);
            let (high, low) = wide(a, b);
            let residue = |x: u128| ((x >> 64) + (x & m)) % m;
            prop_assert_eq!(residue(residue(high) + residue(low)), residue(residue(a) * residue(b)));
            prop_assert_eq!(low, a.wrapping_mul(b));
        }
    }

    #[test]
    fn the_largest_numbers_fit() {
        // 39 bits of points and 44 of direction use all that is allowed; opposite signs make every sum grow.
        let (large, small) = (2f32.powi(15) - 2f32.powi(-9), 2f32.powi(0));
        let far = 2f32.powi(20) - 2f32.powi(-4);
        let d = [far, -far, 1.0];
        let o = [-large, large, -small];
        let (p, q) = ([large, -large, small], [large, large, -large]);
        let found = determinant(d, o, p, q).expect("fits");
        let value = dot(&exact(d), &cross(&subtract(p, o), &subtract(q, o)));
        assert_eq!(found.value.cmp(&0), value.sign());
        assert!(determinant([1.0, 1e-30, 0.0], o, p, q).is_none());
    }
}
