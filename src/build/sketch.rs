//! How many different points there are, without holding them.
//!
//! The least k of all distinct hashes are kept (Bar-Yossef, Jayram, Kumar, Sivakumar and Trevisan 2002): if the k-th
//! of them lies at a share s of the range, there are about (k - 1) / s. Below k the count is exact; above, its standard error
//! is under 1 % for this k. The result does not depend on the order in which points come.

/// Hashes kept.
const K: usize = 1 << 14;

/// A set of points, as far as it takes to count them.
#[derive(Clone, Debug)]
pub(super) struct Sketch {
    /// Hashes from here on are not among the least.
    limit: u64,
    hashes: Vec<u64>,
}

impl Sketch {
    pub fn new() -> Sketch {
        Sketch { limit: u64::MAX, hashes: Vec::new() }
    }

    /// An empty one that takes nothing that `self` would not take.
    pub fn fresh(&self) -> Sketch {
        Sketch { limit: self.limit, hashes: Vec::new() }
    }

    /// Adds a point by its bits.
    #[inline]
    pub fn add(&mut self, point: [f32; 3]) {
        self.add_hash(hash(point.map(f32::to_bits)));
    }

    /// Adds all points of another.
    pub fn merge(&mut self, other: &Sketch) {
        other.hashes.iter().for_each(|&hash| self.add_hash(hash));
    }

    /// About how many points were added, each counted once.
    pub fn estimate(&self) -> u64 {
        let mut all = self.clone();
        all.shrink();
        match all.hashes.last() {
            Some(&last) if all.hashes.len() == K => ((K - 1) as f64 / (last as f64 / u64::MAX as f64)) as u64,
            _ => all.hashes.len() as u64,
        }
    }

    #[inline]
    fn add_hash(&mut self, hash: u64) {
        if hash < self.limit {
            self.hashes.push(hash);
            if self.hashes.len() >= 2 * K {
                self.shrink();
            }
        }
    }

    fn shrink(&mut self) {
        self.hashes.sort_unstable();
        self.hashes.dedup();
        self.hashes.truncate(K);
        if self.hashes.len() == K {
            self.limit = self.hashes[K - 1];
        }
    }
}

/// MurmurHash3's finaliser over both halves.
#[inline]
fn hash([x, y, z]: [u32; 3]) -> u64 {
    let mix = |mut h: u64| {
        h = (h ^ (h >> 33)).wrapping_mul(0xff51_afd7_ed55_8ccd);
        h = (h ^ (h >> 33)).wrapping_mul(0xc4ce_b9fe_1a85_ec53);
        h ^ (h >> 33)
    };
    mix(mix(u64::from(x) << 32 | u64::from(y)) ^ u64::from(z).wrapping_mul(0x9e37_79b9_7f4a_7c15))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn points(count: u32) -> impl Iterator<Item = [f32; 3]> {
        (0..count).map(|i| [(i % 1000) as f32, (i / 1000) as f32, 0.5])
    }

    #[test]
    fn counts_each_point_once() {
        let mut sketch = Sketch::new();
        (0..3).for_each(|_| points(9000).for_each(|p| sketch.add(p)));
        assert_eq!(sketch.estimate(), 9000);
        let mut sketch = Sketch::new();
        (0..3).for_each(|_| points(1_000_000).for_each(|p| sketch.add(p)));
        assert!((970_000..1_030_000).contains(&sketch.estimate()), "{}", sketch.estimate());
    }

    #[test]
    fn order_does_not_matter() {
        let all: Vec<[f32; 3]> = points(200_000).collect();
        let mut one = Sketch::new();
        all.iter().for_each(|&p| one.add(p));
        let mut two = Sketch::new();
        for piece in all.chunks(777).rev() {
            let mut part = two.fresh();
            piece.iter().for_each(|&p| part.add(p));
            two.merge(&part);
        }
        assert_eq!(one.estimate(), two.estimate());
    }
}
