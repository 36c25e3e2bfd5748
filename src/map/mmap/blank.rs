//! Arrays of atomics that begin as zeros and take no memory until they are used, so that a file of any number of pages is opened at once.

use std::io;
use std::marker::PhantomData;
use std::ops::Deref;
use std::sync::atomic::{AtomicBool, AtomicU8, AtomicU32, AtomicU64};

use memmap2::MmapRaw;

/// What an array may hold: zero bytes are a value of it, and sharing it between threads is sound.
pub(crate) trait Atom: Sync + sealed::Sealed {}

mod sealed {
    pub(crate) trait Sealed {}
}

macro_rules! atoms {
    ($($atom:ty),*) => {
        $(impl sealed::Sealed for $atom {}
        impl Atom for $atom {})*
    };
}

atoms!(AtomicBool, AtomicU8, AtomicU32, AtomicU64);

/// An array of so many atomics, zero at first.
pub(crate) struct Blank<T> {
    memory: MmapRaw,
    length: usize,
    of: PhantomData<T>,
}

impl<T: Atom> Blank<T> {
    /// An array of that length. Errors: no room for it among the addresses.
    pub(crate) fn new(length: usize) -> io::Result<Blank<T>> {
        let bytes = length.max(1).checked_mul(size_of::<T>()).ok_or(io::ErrorKind::OutOfMemory)?;
        Ok(Blank { memory: super::reserve(bytes)?, length, of: PhantomData })
    }
}

impl<T: Atom> Deref for Blank<T> {
    type Target = [T];

    #[inline]
    fn deref(&self) -> &[T] {
        // SAFETY: the mapping has `length` times the size of T bytes, lives as long as `self`, and begins at a multiple of the machine's page,
        // so of T's alignment. Anonymous memory is zero at first, which is a value of each `Atom` (the trait is sealed), and is
        // written through these atomics alone. Atomics may be shared.
        unsafe { std::slice::from_raw_parts(self.memory.as_ptr().cast::<T>(), self.length) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::Ordering::Relaxed;

    #[test]
    fn zero_at_first_and_kept_then() {
        let array = Blank::<AtomicU32>::new(5000).unwrap();
        assert!(array.len() == 5000 && array.iter().all(|x| x.load(Relaxed) == 0));
        array[4999].store(7, Relaxed);
        assert!(array[4999].load(Relaxed) == 7 && array.get(5000).is_none());
        assert!(Blank::<AtomicBool>::new(0).unwrap().is_empty());
        assert!(Blank::<AtomicU32>::new(usize::MAX / 2).is_err());
    }
}
