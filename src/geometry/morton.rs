//! Morton codes: three 21-bit grid coordinates interleaved, x highest, so that three bits are the octant 4x + 2y + z.

/// Bits of one coordinate.
pub const BITS: u32 = 21;

/// Interleaves grid coordinates, each below 2^21.
pub fn encode(x: u32, y: u32, z: u32) -> u64 {
    spread(x) << 2 | spread(y) << 1 | spread(z)
}

/// The grid coordinates of a code.
pub fn decode(code: u64) -> [u32; 3] {
    [gather(code >> 2), gather(code >> 1), gather(code)]
}

/// Spreads the low 21 bits of `x` to every third bit.
fn spread(x: u32) -> u64 {
    let seven = |shift: u32| u64::from(SPREAD[(x >> shift & 127) as usize]);
    seven(0) | seven(7) << 21 | seven(14) << 42
}

/// Seven bits, each spread to every third.
const SPREAD: [u32; 128] = {
    let mut table = [0; 128];
    let mut i = 0;
    while i < 128 {
        let mut bit = 0;
        while bit < 7 {
            table[i] |= (i as u32 >> bit & 1) << (3 * bit);
            bit += 1;
        }
        i += 1;
    }
    table
};

/// The inverse of [`spread`].
fn gather(x: u64) -> u32 {
    let mut x = x & 0x1249_2492_4924_9249;
    x = (x | x >> 2) & 0x10c3_0c30_c30c_30c3;
    x = (x | x >> 4) & 0x100f_00f0_0f00_f00f;
    x = (x | x >> 8) & 0x001f_0000_ff00_00ff;
    x = (x | x >> 16) & 0x001f_0000_0000_ffff;
    ((x | x >> 32) & 0x1f_ffff) as u32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn octant_is_4x_2y_z() {
        assert_eq!(encode(1, 0, 0), 4);
        assert_eq!(encode(0, 1, 0), 2);
        assert_eq!(encode(0, 0, 1), 1);
    }

    #[test]
    fn round_trip() {
        for i in 0..10_000u32 {
            let p = [i.wrapping_mul(0x9e37) & 0x1f_ffff, i.wrapping_mul(0x79b9_7f4a) >> 11, i];
            assert_eq!(decode(encode(p[0], p[1], p[2])), p);
        }
    }
}
