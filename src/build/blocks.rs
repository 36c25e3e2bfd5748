//! A growing array in fixed blocks: growing never copies and never holds twice what is needed, unlike `Vec`.

/// Elements of a block.
const BLOCK: usize = 1 << 16;

/// An array that only grows.
pub(super) struct Blocks<T> {
    blocks: Vec<Vec<T>>,
}

impl<T: Copy> Blocks<T> {
    pub fn new() -> Self {
        Blocks { blocks: Vec::new() }
    }

    pub fn len(&self) -> usize {
        self.blocks.last().map_or(0, |last| (self.blocks.len() - 1) * BLOCK + last.len())
    }

    pub fn extend(&mut self, mut items: &[T]) {
        while !items.is_empty() {
            if self.blocks.last().is_none_or(|last| last.len() == BLOCK) {
                // The first block grows by doubling, so that a small mesh stays small.
                let capacity = if self.blocks.is_empty() { items.len().min(BLOCK) } else { BLOCK };
                self.blocks.push(Vec::with_capacity(capacity));
            }
            let Some(last) = self.blocks.last_mut() else { return };
            let (now, later) = items.split_at(items.len().min(BLOCK - last.len()));
            last.extend_from_slice(now);
            items = later;
        }
    }

    pub fn get(&self, index: u32) -> Option<T> {
        let index = index as usize;
        self.blocks.get(index / BLOCK)?.get(index % BLOCK).copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reads_what_was_written_across_blocks() {
        let mut blocks = Blocks::new();
        let all: Vec<u32> = (0..3 * BLOCK as u32 + 7).collect();
        for piece in all.chunks(1000) {
            blocks.extend(piece);
        }
        assert_eq!(blocks.len(), all.len());
        assert!(all.iter().all(|&i| blocks.get(i) == Some(i)));
        assert_eq!(blocks.get(all.len() as u32), None);
        blocks.extend(&all);
        assert_eq!((blocks.len(), blocks.get(all.len() as u32 + 5)), (2 * all.len(), Some(5)));
    }
}
