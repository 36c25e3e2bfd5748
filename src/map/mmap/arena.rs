//! Memory for pages that come and go, each at an address of its own.
//!
//! One anonymous mapping reserves room for every page of a file, which is virtual space only: a page takes memory from when it is
//! filled until it is freed, and then the system gets it back (`MADV_DONTNEED`). So nothing is ever fragmented or moved.
//!
//! A page is absent, busy (being filled or freed, by one owner), resident, or doomed: still whole, but no longer given out. Readers
//! hold a [`Visit`] while they use pages. A doomed page is freed only when every visit that was open when it was doomed has ended, as
//! in epoch-based reclamation (Fraser, "Practical lock-freedom", 2004, section 5.2.3). Opening a visit costs one exchange and
//! a fence; asking for a page, one load.
//!
//! Why no reader ever sees a page change: opening a visit stores the epoch in a slot, then fences, and only then reads states. Dooming
//! makes the state another one, then fences, then takes the epoch and counts it up. By the order of the two fences a reader
//! that still saw the page resident has its slot seen by whoever frees it, with an epoch no later than the page's, so it is waited for. Whoever frees
//! first takes the epoch, then fences, and only then looks at the slots ([`Sweep`]): pages that were doomed since are as late as that epoch, and left alone.

use std::io;
use std::marker::PhantomData;
use std::sync::atomic::{AtomicU8, AtomicU32, AtomicU64, AtomicUsize, Ordering, fence};

use memmap2::MmapRaw;

use super::{Blank, reserve};

/// States of a page.
const ABSENT: u8 = 0;
const BUSY: u8 = 1;
const RESIDENT: u8 = 2;
const DOOMED: u8 = 3;

/// Visits that can be open at once; more wait.
const SLOTS: usize = 2048;

/// Room for the pages of a file.
pub(crate) struct Arena {
    memory: MmapRaw,
    /// Bytes of a page of the machine's memory.
    machine: usize,
    /// Bytes from one page to the next; a multiple of that.
    stride: usize,
    states: Blank<AtomicU8>,
    /// Bytes of each page since it was filled first; 0 before.
    lengths: Blank<AtomicU32>,
    /// The epoch at which each page was doomed last.
    dates: Blank<AtomicU64>,
    /// From 1 on.
    epoch: AtomicU64,
    /// The epochs of open visits; 0 = none.
    slots: Box<[AtomicU64]>,
}

impl Arena {
    /// Room for so many pages of at most `largest` bytes.
    pub(crate) fn new(pages: usize, largest: usize) -> io::Result<Arena> {
        let machine = machine_page();
        let stride = largest.max(1).next_multiple_of(machine);
        let bytes = pages.max(1).checked_mul(stride).ok_or(io::ErrorKind::OutOfMemory)?;
        let memory = reserve(bytes)?;
        // A huge page would take memory for more than what is filled. Kernels without them refuse, which is as good.
        #[cfg(all(target_os = "linux", not(miri)))]
        let _ = memory.advise(memmap2::Advice::NoHugePage);
        Ok(Arena {
            memory,
            machine,
            stride,
            states: Blank::new(pages)?,
            lengths: Blank::new(pages)?,
            dates: Blank::new(pages)?,
            epoch: AtomicU64::new(1),
            slots: (0..SLOTS).map(|_| AtomicU64::new(0)).collect(),
        })
    }

    /// The most memory that a page of so many bytes takes.
    pub(crate) fn room(&self, bytes: usize) -> usize {
        bytes.next_multiple_of(self.machine).min(self.stride)
    }

    /// Bytes of a page, if it was ever there.
    pub(crate) fn length(&self, page: usize) -> Option<usize> {
        let length = self.lengths.get(page)?.load(Ordering::Relaxed) as usize;
        (length != 0).then_some(length)
    }

    /// Opens a visit: pages it is given stay as they are until it ends.
    pub(crate) fn visit(&self) -> Visit<'_> {
        let home = HOME.with(|home| *home);
        for i in (0..SLOTS).cycle() {
            // Threads begin a cache line apart.
            let slot = (8 * home + i) % SLOTS;
            let epoch = self.epoch.load(Ordering::SeqCst);
            if self.slots[slot].compare_exchange(0, epoch, Ordering::SeqCst, Ordering::Relaxed).is_ok() {
                fence(Ordering::SeqCst);
                return Visit { arena: self, slot, here: PhantomData };
            }
            if i == SLOTS - 1 {
                std::thread::yield_now();
            }
        }
        unreachable!("the cycle has no end")
    }

    /// Whether a page is there to be visited.
    pub(crate) fn is_resident(&self, page: usize) -> bool {
        self.states.get(page).is_some_and(|state| state.load(Ordering::Acquire) == RESIDENT)
    }

    /// Begins to fill an absent page; `None` if it is not absent.
    pub(crate) fn fill(&self, page: usize) -> Option<Filling<'_>> {
        self.change(page, ABSENT, BUSY).then(|| Filling { arena: self, page, filled: None })
    }

    /// Gives a resident page out no longer; false if it is not resident.
    pub(crate) fn doom(&self, page: usize) -> bool {
        if !self.change(page, RESIDENT, BUSY) {
            return false;
        }
        fence(Ordering::SeqCst);
        let epoch = self.epoch.fetch_add(1, Ordering::SeqCst);
        self.dates[page].store(epoch, Ordering::Relaxed);
        self.states[page].store(DOOMED, Ordering::Release);
        true
    }

    /// Gives a doomed page out again; false if it is not doomed.
    pub(crate) fn revive(&self, page: usize) -> bool {
        self.change(page, DOOMED, RESIDENT)
    }

    /// Looks for what visits are open now, to free pages that none of them can be reading.
    pub(crate) fn sweep(&self) -> Sweep<'_> {
        let now = self.epoch.load(Ordering::SeqCst);
        fence(Ordering::SeqCst);
        let open = self.slots.iter().map(|slot| slot.load(Ordering::Acquire)).filter(|&epoch| epoch != 0);
        Sweep { arena: self, before: open.min().unwrap_or(now).min(now) }
    }

    /// Changes a page's state if it is as expected.
    fn change(&self, page: usize, from: u8, to: u8) -> bool {
        let state = self.states.get(page);
        state.is_some_and(|state| state.compare_exchange(from, to, Ordering::SeqCst, Ordering::Acquire).is_ok())
    }

    /// Gives a page's memory back to the system. Only whoever made it busy calls this, and nobody has references into it.
    fn discard(&self, page: usize) {
        #[cfg(all(unix, not(miri)))]
        {
            use memmap2::UncheckedAdvice::DontNeed;
            // SAFETY: the range lies in our mapping (`stride` bytes a page). The page is busy: the caller holds it alone, no `Filling` gives
            // out a reference any longer, and every visit that could have been given a slice has ended. So no reference is alive, and
            // the bytes turn to zeros, which are valid bytes.
            let done = unsafe { self.memory.unchecked_advise_range(DontNeed, page * self.stride, self.stride) };
            debug_assert!(done.is_ok(), "{done:?}");
        }
        // What that amounts to, where advice is not known: whoever has a reference after all is found out.
        #[cfg(miri)]
        // SAFETY: as above.
        unsafe {
            self.memory.as_mut_ptr().add(page * self.stride).write_bytes(0, self.stride);
        }
        #[cfg(not(unix))]
        let _ = page;
    }
}

/// What can be freed: pages that were doomed before any visit was opened that is open.
pub(crate) struct Sweep<'a> {
    arena: &'a Arena,
    /// The epoch of the oldest open visit, or the one at which this was made.
    before: u64,
}

impl Sweep<'_> {
    /// Frees a doomed page and its memory; false if it is not doomed, or if a visit may be open that has seen it.
    pub(crate) fn free(&self, page: usize) -> bool {
        let Sweep { arena, before } = self;
        if !arena.change(page, DOOMED, BUSY) {
            return false;
        }
        if arena.dates[page].load(Ordering::Relaxed) >= *before {
            arena.states[page].store(DOOMED, Ordering::Release);
            return false;
        }
        arena.discard(page);
        arena.states[page].store(ABSENT, Ordering::Release);
        true
    }
}

/// A reader of pages. While it lives, what it was given stays. It stays on its thread, which is counted as one that visits.
pub(crate) struct Visit<'a> {
    arena: &'a Arena,
    slot: usize,
    here: PhantomData<*const ()>,
}

impl Visit<'_> {
    /// The bytes of a page, if it is resident.
    #[inline]
    pub(crate) fn bytes(&self, page: usize) -> Option<&[u8]> {
        let arena = self.arena;
        if arena.states.get(page)?.load(Ordering::Acquire) != RESIDENT {
            return None;
        }
        let length = (arena.lengths[page].load(Ordering::Relaxed) as usize).min(arena.stride);
        // SAFETY: the range lies in our mapping (`stride` bytes a page), which lives as long as the arena. The page was seen resident by an
        // open visit, so it was filled before (acquire) and nobody writes to it or gives its memory back until this visit has ended
        // (see the module), which the borrow of `self` outlives. Anonymous memory is plain bytes, zero where nothing was written.
        Some(unsafe { std::slice::from_raw_parts(arena.memory.as_ptr().add(page * arena.stride), length) })
    }
}

impl Drop for Visit<'_> {
    fn drop(&mut self) {
        self.arena.slots[self.slot].store(0, Ordering::Release);
    }
}

/// A page that is being filled, by its owner alone. Dropped before it is finished, the page is absent again.
pub(crate) struct Filling<'a> {
    arena: &'a Arena,
    page: usize,
    /// Its bytes, once it is whole.
    filled: Option<u32>,
}

impl Filling<'_> {
    /// The page's memory: its first `length` bytes, at most the largest page's; zero at first.
    pub(crate) fn bytes(&mut self, length: usize) -> &mut [u8] {
        let length = length.min(self.arena.stride);
        // SAFETY: the range lies in our mapping. The page is busy and only this value's owner may touch it, once at a time as `self` is
        // borrowed mutably; no visit gives out slices of it. Anonymous memory is initialised with zeros.
        unsafe {
            std::slice::from_raw_parts_mut(self.arena.memory.as_mut_ptr().add(self.page * self.arena.stride), length)
        }
    }

    /// The page is there, its first `length` bytes (1 at least): gives it out to visits.
    pub(crate) fn finish(mut self, length: u32) {
        self.filled = Some(length.max(1));
    }
}

impl Drop for Filling<'_> {
    fn drop(&mut self) {
        match self.filled {
            Some(length) => self.arena.lengths[self.page].store(length, Ordering::Relaxed),
            None => self.arena.discard(self.page),
        }
        let state = if self.filled.is_some() { RESIDENT } else { ABSENT };
        self.arena.states[self.page].store(state, Ordering::Release);
    }
}

static THREADS: AtomicUsize = AtomicUsize::new(0);

thread_local! {
    /// Where this thread looks for a free slot first.
    static HOME: usize = THREADS.fetch_add(1, Ordering::Relaxed);
}

/// Bytes of a page of the machine's memory.
pub(crate) fn machine_page() -> usize {
    #[cfg(unix)]
    // SAFETY: sysconf only reads.
    let bytes = unsafe { libc::sysconf(libc::_SC_PAGESIZE) };
    #[cfg(not(unix))]
    let bytes = 65_536;
    usize::try_from(bytes).unwrap_or(4096).max(4096)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fill(arena: &Arena, page: usize, value: u8) {
        let mut filling = arena.fill(page).unwrap();
        assert!(filling.bytes(5000).iter().all(|&b| b == 0), "memory comes back as zeros");
        filling.bytes(5000).fill(value);
        filling.finish(5000);
    }

    #[test]
    fn a_page_goes_when_its_visitors_have_gone() {
        let arena = Arena::new(3, 5000).unwrap();
        assert_eq!(arena.room(5000), 8192);
        fill(&arena, 1, 7);
        assert!(arena.fill(1).is_none() && !arena.sweep().free(1) && !arena.revive(1));
        assert!(arena.length(1) == Some(5000) && arena.length(0).is_none() && arena.length(3).is_none());
        let before = arena.visit();
        let seen = before.bytes(1).unwrap();
        assert!(before.bytes(0).is_none() && before.bytes(3).is_none() && seen.len() == 5000);
        assert!(arena.doom(1) && !arena.doom(1));
        let after = arena.visit();
        assert!(after.bytes(1).is_none() && before.bytes(1).is_none());
        assert!(!arena.sweep().free(1) && seen.iter().all(|&b| b == 7));
        drop(before);
        // The later visit cannot have seen it.
        assert!(arena.sweep().free(1) && !arena.sweep().free(1));
        fill(&arena, 1, 8);
        assert!(after.bytes(1).is_some_and(|bytes| bytes.len() == 5000 && bytes[0] == 8));
    }

    /// Who looked for visits before a page was doomed knows nothing of those that have seen it.
    #[test]
    fn an_old_sweep_frees_nothing_new() {
        let arena = Arena::new(1, 100).unwrap();
        arena.fill(0).unwrap().finish(100);
        let early = arena.sweep();
        let visit = arena.visit();
        assert!(visit.bytes(0).is_some() && arena.doom(0) && !early.free(0));
        drop(visit);
        assert!(!early.free(0) && arena.sweep().free(0));
    }

    #[test]
    fn a_page_revived_is_dated_anew() {
        let arena = Arena::new(1, 100).unwrap();
        arena.fill(0).unwrap().finish(100);
        assert!(arena.doom(0) && arena.revive(0));
        let visit = arena.visit();
        assert!(visit.bytes(0).is_some() && arena.doom(0) && !arena.sweep().free(0));
        drop(visit);
        assert!(arena.sweep().free(0));
    }

    #[test]
    fn a_filling_given_up_leaves_nothing() {
        let arena = Arena::new(1, 100).unwrap();
        arena.fill(0).unwrap().bytes(100).fill(1);
        assert!(!arena.is_resident(0));
        assert!(arena.fill(0).unwrap().bytes(100).iter().all(|&b| b == 0));
    }

    #[test]
    fn readers_never_see_a_page_change() {
        const PAGES: usize = 4;
        // Miri looks at each access, and takes its time.
        const BYTES: usize = if cfg!(miri) { 32 } else { 4096 };
        const TIMES: usize = if cfg!(miri) { 15 } else { 300 };
        let arena = Arena::new(PAGES, BYTES).unwrap();
        let stop = std::sync::atomic::AtomicBool::new(false);
        let (mut freed, seen) = (0usize, AtomicUsize::new(0));
        std::thread::scope(|scope| {
            for thread in 0..2 {
                let (arena, stop, seen) = (&arena, &stop, &seen);
                scope.spawn(move || {
                    let mut page = thread;
                    while !stop.load(Ordering::Relaxed) {
                        page = (page + 1) % PAGES;
                        let visit = arena.visit();
                        let Some(bytes) = visit.bytes(page) else { continue };
                        seen.fetch_add(1, Ordering::Relaxed);
                        let value = bytes[0];
                        assert!(value != 0 && std::hint::black_box(bytes).iter().all(|&b| b == value));
                    }
                });
            }
            let mut value = 1u8;
            while freed < TIMES || seen.load(Ordering::Relaxed) < TIMES / 3 {
                for page in 0..PAGES {
                    if let Some(mut filling) = arena.fill(page) {
                        value = value % 250 + 1;
                        filling.bytes(BYTES).fill(value);
                        filling.finish(BYTES as u32);
                    } else {
                        arena.doom(page);
                        freed += usize::from(arena.sweep().free(page));
                        std::thread::yield_now();
                    }
                }
            }
            stop.store(true, Ordering::Relaxed);
        });
        assert!(seen.into_inner() > 0);
    }
}
