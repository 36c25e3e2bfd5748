//! Large arrays of words that come straight from the system and go straight back to it.
//!
//! An allocator may keep what is freed, and may keep it apart for each thread; memory that must stay below a bound
//! cannot live with that. An anonymous map costs memory only where it was touched, and nothing once it is dropped.

use std::ops::{Deref, DerefMut};

use memmap2::MmapMut;

use crate::error::{Error, Result};

/// Bytes from which on a map may lie in huge pages, the last of which may be touched in part only. A build bound to little memory has
/// no such map.
#[cfg(target_os = "linux")]
const HUGE: usize = 32 << 20;

/// A fixed number of words, zero at first.
#[derive(Default)]
pub(super) struct Words {
    map: Option<MmapMut>,
    len: usize,
}

impl Words {
    /// `len` zeros. They take up memory when they are touched first.
    pub fn zeroed(len: usize) -> Result<Words> {
        if len == 0 {
            return Ok(Words::default());
        }
        let map = MmapMut::map_anon(4 * len).map_err(Error::io("memory", "reserve address space in"))?;
        #[cfg(target_os = "linux")]
        if map.len() >= HUGE {
            // A page at a time, the system takes as long to hand memory out as it takes to fill it. It may decline.
            let _ = map.advise(memmap2::Advice::HugePage);
        }
        Ok(Words { map: Some(map), len })
    }
}

impl Deref for Words {
    type Target = [u32];

    fn deref(&self) -> &[u32] {
        self.map.as_deref().map_or(&[], |bytes| &bytemuck::cast_slice(bytes)[..self.len])
    }
}

impl DerefMut for Words {
    fn deref_mut(&mut self) -> &mut [u32] {
        let len = self.len;
        self.map.as_deref_mut().map_or(&mut [], |bytes| &mut bytemuck::cast_slice_mut(bytes)[..len])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_are_zero_and_can_be_written() {
        let mut words = Words::zeroed(100_003).unwrap();
        assert!(words.len() == 100_003 && words.iter().all(|&word| word == 0));
        words[100_002] = 7;
        assert_eq!(words.iter().sum::<u32>(), 7);
        assert!(Words::zeroed(0).unwrap().is_empty());
    }
}
