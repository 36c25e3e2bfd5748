//! Pages as zstd frames (RFC 8878), for shipping and slow disks.

use super::Node;

/// A page as it is stored in a packed file; `level` as zstd counts, 1 to 22.
pub fn pack(page: &[u8], level: i32) -> std::io::Result<Vec<u8>> {
    zstd::bulk::compress(page, level)
}

/// The page of `bytes` bytes that was packed as `stored`, aligned as a mapped one would be.
pub fn unpack(stored: &[u8], bytes: u32) -> Result<Box<[Node]>, String> {
    let mut page = vec![Node::EMPTY; bytes as usize / size_of::<Node>()].into_boxed_slice();
    match zstd::bulk::decompress_to_buffer(stored, bytemuck::cast_slice_mut(&mut page)) {
        Ok(n) if n == bytes as usize => Ok(page),
        Ok(n) => Err(format!("it unpacks to {n} bytes instead of {bytes}")),
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
            let back = unpack(&stored, 640).unwrap();
            assert!(bytemuck::cast_slice::<Node, u8>(&back) == page);
            assert!(unpack(&stored, 704).unwrap_err().contains("640 bytes instead of 704"));
            assert!(unpack(&stored, 64).is_err() && unpack(&stored[..stored.len() - 1], 640).is_err());
        }
    }
}
