//! Decimal numbers to f32 and f64, each correctly rounded, quickly.
//!
//! Most coordinates have few digits: mantissa and power of ten are exact in floating point, and one multiplication or
//! division rounds once (Clinger 1990, "How to read floating point numbers accurately"). The rest go to the crate
//! fast-float2. Rounding to f64 first and then to f32 is only done where the f64 is not halfway between two f32.

/// A decimal as it is written: (-1)^negative * mantissa * 10^exponent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Decimal {
    mantissa: u64,
    exponent: i32,
    negative: bool,
}

const TENS_F32: [f32; 11] = [1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10];
const TENS_F64: [f64; 23] = [
    1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15, 1e16, 1e17, 1e18, 1e19, 1e20,
    1e21, 1e22,
];

impl Decimal {
    /// Reads a decimal at the start of `text`, and says how many bytes it took.
    ///
    /// `None` for anything but a plain decimal of at most 19 digits (which fill a u64 without overflow).
    #[inline(always)]
    pub fn scan(text: &[u8]) -> Option<(Decimal, usize)> {
        let negative = text.first() == Some(&b'-');
        let start = negative as usize;
        let (mut mantissa, mut at) = digits(text, start, 0);
        let mut count = at - start;
        let mut exponent = 0;
        if text.get(at) == Some(&b'.') {
            let point = at + 1;
            (mantissa, at) = digits(text, point, mantissa);
            count += at - point;
            exponent = -((at - point) as i32);
        }
        if count == 0 || count > 19 {
            return None;
        }
        if let Some(b'e' | b'E') = text.get(at) {
            let (power, end) = power_of_ten(text, at + 1)?;
            (exponent, at) = (exponent + power, end);
        }
        Some((Decimal { mantissa, exponent, negative }, at))
    }

    /// The nearest f32, if this fast way can tell.
    #[inline(always)]
    pub fn to_f32(self) -> Option<f32> {
        let size = if self.mantissa <= 1 << 24 && self.exponent.unsigned_abs() <= 10 {
            let (m, ten) = (self.mantissa as f32, TENS_F32[self.exponent.unsigned_abs() as usize]);
            if self.exponent < 0 { m / ten } else { m * ten }
        } else {
            narrow(self.size_f64()?)?
        };
        Some(if self.negative { -size } else { size })
    }

    /// The nearest f64, if this fast way can tell.
    #[inline(always)]
    pub fn to_f64(self) -> Option<f64> {
        self.size_f64().map(|size| if self.negative { -size } else { size })
    }

    #[inline(always)]
    fn size_f64(self) -> Option<f64> {
        if self.mantissa > 1 << 53 || self.exponent.unsigned_abs() > 22 {
            return None;
        }
        let (m, ten) = (self.mantissa as f64, TENS_F64[self.exponent.unsigned_abs() as usize]);
        Some(if self.exponent < 0 { m / ten } else { m * ten })
    }
}

/// Appends the digits at `at` to `value` (wrapping: the caller counts them), and says where they end.
#[inline(always)]
fn digits(text: &[u8], mut at: usize, mut value: u64) -> (u64, usize) {
    while let Some(digit) = text.get(at).map(|byte| byte.wrapping_sub(b'0')).filter(|&digit| digit < 10) {
        value = value.wrapping_mul(10).wrapping_add(digit as u64);
        at += 1;
    }
    (value, at)
}

/// The signed number after an `e`, of at most four digits.
fn power_of_ten(text: &[u8], at: usize) -> Option<(i32, usize)> {
    let sign = text.get(at).filter(|&&byte| byte == b'-' || byte == b'+');
    let start = at + sign.is_some() as usize;
    let (value, end) = digits(text, start, 0);
    if !(1..=4).contains(&(end - start)) {
        return None;
    }
    Some((if sign == Some(&b'-') { -(value as i32) } else { value as i32 }, end))
}

/// The f32 nearest to the number whose nearest f64 is `value` >= 0, unless the first rounding may have hidden on which
/// side of a border between two f32 it lies. The borders are f64 numbers, and rounding is monotone, so only a `value`
/// that is such a border is in doubt; below the least normal f32 they lie elsewhere.
#[inline(always)]
fn narrow(value: f64) -> Option<f32> {
    let doubt = value.to_bits() & 0x1fff_ffff == 0x1000_0000 || value < f32::MIN_POSITIVE as f64;
    (!doubt).then_some(value as f32)
}

/// A number as a word of its own: any decimal, or an infinity or NaN in the spellings of C libraries.
pub(in crate::mesh) fn parse_f32(word: &[u8]) -> Option<f32> {
    parse(word, Decimal::to_f32)
}

/// The same, as f64.
pub(in crate::mesh) fn parse_f64(word: &[u8]) -> Option<f64> {
    parse(word, Decimal::to_f64)
}

fn parse<T: fast_float2::FastFloat + From<f32>>(word: &[u8], fast: impl Fn(Decimal) -> Option<T>) -> Option<T> {
    let plain = Decimal::scan(word).filter(|&(_, end)| end == word.len());
    if let Some(value) = plain.and_then(|(decimal, _)| fast(decimal)) {
        return Some(value);
    }
    let unsigned = word.strip_prefix(b"+").unwrap_or(word);
    if word.len() != unsigned.len() && matches!(unsigned.first(), Some(b'-' | b'+')) {
        return None;
    }
    fast_float2::parse::<T, _>(unsigned).ok().or_else(|| special(unsigned).map(T::from))
}

/// Infinity and NaN as C libraries print them: `-nan`, `nan(ind)`, `-nan(snan)`, `1.#INF`, `-1.#IND00`, `1.#QNAN`.
fn special(word: &[u8]) -> Option<f32> {
    let negative = word.first() == Some(&b'-');
    let word = word[negative as usize..].to_ascii_lowercase();
    let size = match word.strip_prefix(b"1.#") {
        Some(kind) if kind.starts_with(b"inf") => f32::INFINITY,
        Some(kind) if [&b"ind"[..], b"qnan", b"snan"].iter().any(|nan| kind.starts_with(nan)) => f32::NAN,
        None if word == b"nan" || word.starts_with(b"nan(") && word.ends_with(b")") => f32::NAN,
        None if word == b"inf" || word == b"infinity" => f32::INFINITY,
        _ => return None,
    };
    Some(if negative { -size } else { size })
}

/// N decimals with one space between them and a newline after the last: the plain line that most files consist of.
/// Says how many bytes the line took. `None`: the line is not plain, which need not mean that it is wrong.
#[inline(always)]
pub(super) fn plain_line<const N: usize, T: Copy + Default>(
    text: &[u8],
    convert: impl Fn(usize, Decimal) -> Option<T>,
) -> Option<([T; N], usize)> {
    let mut values = [T::default(); N];
    let mut at = 0;
    for (i, value) in values.iter_mut().enumerate() {
        let (decimal, length) = Decimal::scan(&text[at..])?;
        *value = convert(i, decimal)?;
        at += length + 1;
        match text.get(at - 1)? {
            b' ' if i + 1 < N => {}
            b'\n' if i + 1 == N => {}
            b'\r' if i + 1 == N && text.get(at) == Some(&b'\n') => at += 1,
            _ => return None,
        }
    }
    Some((values, at))
}

/// Three plain unsigned numbers of at most nine digits, spaced like [`plain_line`].
#[inline(always)]
pub(super) fn plain_triangle(text: &[u8]) -> Option<([u32; 3], usize)> {
    let mut values = [0; 3];
    let mut at = 0;
    for (i, value) in values.iter_mut().enumerate() {
        let (number, end) = digits(text, at, 0);
        if !(1..=9).contains(&(end - at)) {
            return None;
        }
        *value = number as u32;
        at = end + 1;
        match text.get(end)? {
            b' ' if i < 2 => {}
            b'\n' if i == 2 => {}
            b'\r' if i == 2 && text.get(at) == Some(&b'\n') => at += 1,
            _ => return None,
        }
    }
    Some((values, at))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn same(word: &str) {
        let expect: f32 = word.parse().unwrap();
        assert_eq!(parse_f32(word.as_bytes()).map(f32::to_bits), Some(expect.to_bits()), "{word}");
        let expect: f64 = word.parse().unwrap();
        assert_eq!(parse_f64(word.as_bytes()).map(f64::to_bits), Some(expect.to_bits()), "{word}");
    }

    #[test]
    fn odd_numbers_are_rounded_as_the_standard_library_rounds_them() {
        for word in [
            "0",
            "-0",
            "-0.0",
            "+1",
            "1.",
            ".5",
            "-.5",
            "1e5",
            "1E+05",
            "1e-45",
            "7e-46",
            "1e-39",
            "1e39",
            "-1e400",
            "1e-400",
            "16777216",
            "16777217",
            "16777219",
            "33554435",
            "9007199254740993",
            "1.00000005960464477539062500000001",
            "1.000000059604644775390625",
            "0.000000000000000000000000000000000000011754943508222875",
            "3.4028235677973366e38",
            "3.4028235677973365e38",
            "1.17549428e-38",
            "12345678901234567890123",
            "0000000000000000000000000001",
            "123.456789012",
            "1e0010",
        ] {
            same(word);
        }
        assert!(parse_f32(b"nan").unwrap().is_nan() && parse_f32(b"-nan(ind)").unwrap().is_nan());
        assert!(parse_f32(b"1.#QNAN").unwrap().is_nan());
        for word in ["inf", "INF", "+Infinity", "1.#INF", "1.#INF00"] {
            assert_eq!(parse_f32(word.as_bytes()), Some(f32::INFINITY), "{word}");
        }
        assert_eq!(parse_f32(b"-1.#INF"), Some(f32::NEG_INFINITY));
    }

    #[test]
    fn what_is_no_number_is_none() {
        for word in
            ["", "-", "+", "+-1", "++1", ".", "e5", "1e", "1e+", "1,5", "0x10", "1.2.3", "1-2", "12a", "nano", "1.#"]
        {
            assert_eq!(parse_f32(word.as_bytes()), None, "{word}");
        }
    }

    proptest! {
        #[test]
        fn every_f32_and_many_decimals_come_back(bits: u32, digits in "-?[0-9]{0,12}\\.[0-9]{1,12}(e-?[0-9]{1,2})?") {
            let value = f32::from_bits(bits);
            if value.is_finite() {
                prop_assert_eq!(parse_f32(format!("{value}").as_bytes()).map(f32::to_bits), Some(bits));
                prop_assert_eq!(parse_f32(format!("{value:e}").as_bytes()).map(f32::to_bits), Some(bits));
                prop_assert_eq!(parse_f32(format!("{value:.9}").as_bytes()), format!("{value:.9}").parse().ok());
            }
            same(&digits);
        }

        #[test]
        fn decimals_near_the_border_between_two_f32_are_rounded_once(bits in 0x0080_0000u32..0x7f00_0000, off in -3i64..4) {
            let low = f32::from_bits(bits) as f64;
            let border = (low + f32::from_bits(bits + 1) as f64) / 2.0;
            let near = f64::from_bits((border.to_bits() as i64 + off) as u64);
            same(&format!("{near}"));
            same(&format!("{near:.17e}"));
        }
    }
}
