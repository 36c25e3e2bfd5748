//! Pages as zstd frames (RFC 8878), for shipping and slow disks.

/// A page as it is stored in a packed file; `level` as zstd counts, 1 to 22.
pub fn pack(page: &[u8], level: i32) -> std::io::Result<Vec<u8>> {
    zstd::bulk::compress(page, level)
}

/// Unpacks what was packed as `stored`, which must fill `page`.
pub fn unpack_into(stored: &[u8], page: &mut [u8]) -> Result<(), String> {
    match zstd::bulk::decompress_to_buffer(stored, page) {
        Ok(n) if n == page.len() => Ok(()),
        Ok(n) => Err(format!("it unpacks to {n} bytes instead of {}", page.len())),
        Err(error) => Err(format!("it cannot be unpacked ({error})")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pages_come_back() {
        let page: Vec<u8> = (0..640u32).map(|i| (i / 10) as u8).collect();
        for level in [1, 19] {
            let stored = pack(&page, level).unwrap();
            assert!(stored.len() < page.len());
            let mut back = [0; 640];
            unpack_into(&stored, &mut back).unwrap();
            assert!(back[..] == page);
            assert!(unpack_into(&stored, &mut [0; 704]).unwrap_err().contains("640 bytes instead of 704"));
            assert!(unpack_into(&stored, &mut [0; 64]).is_err());
            assert!(unpack_into(&stored[..stored.len() - 1], &mut back).is_err());
        }
    }
}
