//! The memory maps of the library: of files, with the guard that keeps a file cut short from killing the process, and, in
//! `arena`, of memory for pages that are read; `blank` are arrays that cost nothing until they are used.
//!
//! Reading a mapped page that lies beyond the end of its file raises SIGBUS. A handler, installed once, looks the address
//! up in a registry of our mappings; if it is one of ours, it maps a page of zeros over the fault, marks the mapping
//! and lets the read go on; any other fault goes to the handler that was there before. Readers treat zeros as "nothing
//! here" and ask [`Mapping::faulted`] before they trust a result.
//!
//! Not covered: a file that another process overwrites in place while it is mapped. Files are replaced by renaming, so
//! only a deliberate act does that; what is read is then unspecified bytes, bounded by the checks of safe code.
#![allow(unsafe_code)]

mod arena;
mod blank;

use std::fs::File;
use std::io;

use memmap2::{Mmap, MmapOptions, MmapRaw};

pub(crate) use arena::{Arena, Visit, machine_page};
pub(crate) use blank::Blank;

/// Zeros at addresses of their own, which take memory when they are used first. Errors: no room for so many bytes.
fn reserve(bytes: usize) -> io::Result<MmapRaw> {
    let mut options = MmapOptions::new();
    options.len(bytes);
    // Miri knows no maps but the plainest.
    if !cfg!(miri) {
        options.no_reserve_swap();
    }
    Ok(options.map_anon()?.into())
}

/// A file mapped for reading.
pub(crate) struct Mapping {
    map: Mmap,
    #[cfg(unix)]
    entry: &'static guard::Entry,
}

impl Mapping {
    /// Maps the whole of `file`, which must not be empty.
    pub(crate) fn new(file: &File) -> io::Result<Mapping> {
        // SAFETY: the map is private to this value and read-only. That the file is not written in place meanwhile cannot
        // be promised; every record is read as plain old data, for which any bytes are valid, and through checked
        // indices. Truncation is caught by the guard below.
        let map = unsafe { Mmap::map(file)? };
        #[cfg(unix)]
        let entry = guard::register(map.as_ptr() as usize, map.len())?;
        Ok(Mapping {
            map,
            #[cfg(unix)]
            entry,
        })
    }

    /// The file's bytes; their address is a multiple of the machine's page size.
    #[inline]
    pub(crate) fn bytes(&self) -> &[u8] {
        &self.map
    }

    /// Tells the system that these bytes will be read at once, so that it fetches them together.
    pub(crate) fn fetch(&self, begin: usize, length: usize) {
        #[cfg(unix)]
        // Only advice; a range that does not lie in the file is refused.
        let _ = self.map.advise_range(memmap2::Advice::WillNeed, begin, length);
        #[cfg(not(unix))]
        let _ = (begin, length);
    }

    /// Whether the file proved shorter than it was when it was mapped. Once true, it stays so.
    #[inline]
    pub(crate) fn faulted(&self) -> bool {
        #[cfg(unix)]
        let faulted = self.entry.faulted();
        #[cfg(not(unix))]
        let faulted = false;
        faulted
    }
}

#[cfg(unix)]
impl Drop for Mapping {
    fn drop(&mut self) {
        // Runs before the field `map` is dropped, so no entry ever names memory that is unmapped.
        self.entry.release();
    }
}

/// The SIGBUS handler and the registry it reads.
#[cfg(unix)]
mod guard {
    use std::io;
    use std::ptr;
    use std::sync::OnceLock;
    use std::sync::atomic::{AtomicBool, AtomicPtr, AtomicUsize, Ordering, fence};

    /// One mapping of the registry. Entries are never freed but used again, so the handler may walk the list at any
    /// moment without a lock.
    pub(super) struct Entry {
        /// Whether some mapping owns this entry.
        taken: AtomicBool,
        /// Odd while the range is being changed; the handler then passes by, since the fault cannot be here.
        version: AtomicUsize,
        start: AtomicUsize,
        end: AtomicUsize,
        faulted: AtomicBool,
        next: AtomicPtr<Entry>,
    }

    static FIRST: AtomicPtr<Entry> = AtomicPtr::new(ptr::null_mut());
    static PREVIOUS: OnceLock<libc::sigaction> = OnceLock::new();
    static PAGE_BYTES: AtomicUsize = AtomicUsize::new(0);

    impl Entry {
        /// Whether a fault was met in the mapping.
        pub(super) fn faulted(&self) -> bool {
            self.faulted.load(Ordering::Acquire)
        }

        /// Gives the entry back.
        pub(super) fn release(&self) {
            self.set_range(0, 0);
            self.taken.store(false, Ordering::Release);
        }

        /// Changes the range such that the handler never sees half of it. Only the owner calls this.
        fn set_range(&self, start: usize, end: usize) {
            self.version.fetch_add(1, Ordering::AcqRel);
            fence(Ordering::Release);
            self.start.store(start, Ordering::Relaxed);
            self.end.store(end, Ordering::Relaxed);
            self.version.fetch_add(1, Ordering::Release);
        }

        /// Whether the range holds `address`; false while it is being changed.
        fn holds(&self, address: usize) -> bool {
            let before = self.version.load(Ordering::Acquire);
            let (start, end) = (self.start.load(Ordering::Relaxed), self.end.load(Ordering::Relaxed));
            fence(Ordering::Acquire);
            let after = self.version.load(Ordering::Relaxed);
            before == after && before.is_multiple_of(2) && (start..end).contains(&address)
        }
    }

    /// All entries, newest first.
    fn entries() -> impl Iterator<Item = &'static Entry> {
        let follow = |pointer: &AtomicPtr<Entry>| {
            // SAFETY: the list holds only entries that were leaked, so they live for ever, and are shared, never mutable.
            unsafe { pointer.load(Ordering::Acquire).as_ref::<'static>() }
        };
        std::iter::successors(follow(&FIRST), move |entry| follow(&entry.next))
    }

    /// How many entries there are, taken or not.
    #[cfg(test)]
    pub(super) fn count() -> usize {
        entries().count()
    }

    /// Puts a mapping into the registry, and the handler in place if it is the first.
    pub(super) fn register(start: usize, bytes: usize) -> io::Result<&'static Entry> {
        install()?;
        let free = entries().find(|e| !e.taken.swap(true, Ordering::AcqRel));
        let entry = free.unwrap_or_else(append);
        entry.faulted.store(false, Ordering::Release);
        // The last page of the map reaches beyond the file's end to the end of the machine's page.
        entry.set_range(start, start + bytes);
        Ok(entry)
    }

    /// A new entry, already taken.
    fn append() -> &'static Entry {
        let entry: &'static Entry = Box::leak(Box::new(Entry {
            taken: AtomicBool::new(true),
            version: AtomicUsize::new(0),
            start: AtomicUsize::new(0),
            end: AtomicUsize::new(0),
            faulted: AtomicBool::new(false),
            next: AtomicPtr::new(ptr::null_mut()),
        }));
        let pointer = ptr::from_ref(entry).cast_mut();
        let mut head = FIRST.load(Ordering::Acquire);
        loop {
            entry.next.store(head, Ordering::Relaxed);
            match FIRST.compare_exchange_weak(head, pointer, Ordering::AcqRel, Ordering::Acquire) {
                Ok(_) => return entry,
                Err(now) => head = now,
            }
        }
    }

    /// Installs the handler at the first call.
    fn install() -> io::Result<()> {
        static DONE: OnceLock<Option<i32>> = OnceLock::new();
        match DONE.get_or_init(|| install_now().err().map(|e| e.raw_os_error().unwrap_or(0))) {
            None => Ok(()),
            Some(code) => Err(io::Error::from_raw_os_error(*code)),
        }
    }

    fn install_now() -> io::Result<()> {
        // SAFETY: sysconf only reads; sigaction gets valid pointers to values that live through the call, of which
        // all-zero bytes are a valid initial state; the handler keeps to async-signal-safe calls.
        unsafe {
            PAGE_BYTES.store(usize::try_from(libc::sysconf(libc::_SC_PAGESIZE)).unwrap_or(4096), Ordering::Release);
            // The previous handler is remembered before ours can run.
            let mut previous: libc::sigaction = std::mem::zeroed();
            if libc::sigaction(libc::SIGBUS, ptr::null(), &mut previous) != 0 {
                return Err(io::Error::last_os_error());
            }
            let _ = PREVIOUS.set(previous);
            let mut ours: libc::sigaction = std::mem::zeroed();
            ours.sa_sigaction = on_sigbus as extern "C" fn(_, _, _) as usize;
            ours.sa_flags = libc::SA_SIGINFO | libc::SA_ONSTACK;
            libc::sigemptyset(&mut ours.sa_mask);
            if libc::sigaction(libc::SIGBUS, &ours, ptr::null_mut()) != 0 {
                return Err(io::Error::last_os_error());
            }
        }
        Ok(())
    }

    /// The handler. Calls nothing but mmap and sigaction, which are plain system calls, and touches only atomics.
    extern "C" fn on_sigbus(signal: i32, info: *mut libc::siginfo_t, context: *mut libc::c_void) {
        // SAFETY: with SA_SIGINFO the kernel passes a valid siginfo, whose address field is set for SIGBUS.
        let address = unsafe { (*info).si_addr() } as usize;
        let entry = entries().find(|e| e.holds(address));
        if !entry.is_some_and(|entry| patch(entry, address)) {
            forward(signal, info, context);
        }
    }

    /// Maps a page of zeros over the fault.
    fn patch(entry: &Entry, address: usize) -> bool {
        let bytes = PAGE_BYTES.load(Ordering::Acquire).max(1);
        let page = (address - address % bytes) as *mut libc::c_void;
        // Marked first: whoever reads one of the zeros must find the mark.
        entry.faulted.store(true, Ordering::Release);
        let flags = libc::MAP_PRIVATE | libc::MAP_ANONYMOUS | libc::MAP_FIXED;
        // SAFETY: the page belongs to a mapping of ours that is alive, since a thread has just read from it; nothing else
        // is replaced, and readers only ever held shared references to plain bytes there.
        unsafe { libc::mmap(page, bytes, libc::PROT_READ, flags, -1, 0) != libc::MAP_FAILED }
    }

    /// Hands a fault that is not ours to whoever was there before.
    fn forward(signal: i32, info: *mut libc::siginfo_t, context: *mut libc::c_void) {
        let previous = PREVIOUS.get();
        let handler = previous.map_or(libc::SIG_DFL, |p| p.sa_sigaction);
        // SAFETY: a handler that is neither default nor ignored is a function of the form its flags say; it gets what the
        // kernel gave us. Otherwise the default action is restored, and the fault, met again on return, ends the process.
        unsafe {
            if handler == libc::SIG_DFL || handler == libc::SIG_IGN {
                let mut default: libc::sigaction = std::mem::zeroed();
                default.sa_sigaction = libc::SIG_DFL;
                libc::sigaction(signal, &default, ptr::null_mut());
            } else if previous.is_some_and(|p| p.sa_flags & libc::SA_SIGINFO != 0) {
                let call: extern "C" fn(i32, *mut libc::siginfo_t, *mut libc::c_void) = std::mem::transmute(handler);
                call(signal, info, context);
            } else {
                let call: extern "C" fn(i32) = std::mem::transmute(handler);
                call(signal);
            }
        }
    }
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;
    use std::os::unix::process::ExitStatusExt;
    use std::process::Command;

    const ROLE: &str = "OCTRACE_TEST_FOREIGN_FAULT";

    /// Reads beyond the end of a map that is not ours, while one of ours exists. Does not return.
    fn fault_elsewhere() {
        let (ours, theirs) = (tempfile::tempfile().unwrap(), tempfile::tempfile().unwrap());
        ours.set_len(100).unwrap();
        theirs.set_len(10_000).unwrap();
        let _ours = Mapping::new(&ours).unwrap();
        // SAFETY: read as bytes only; that it is cut short is the very point, and happens in a process of its own.
        let map = unsafe { Mmap::map(&theirs).unwrap() };
        theirs.set_len(0).unwrap();
        std::hint::black_box(map[5000]);
    }

    // Miri maps no files.
    #[test]
    #[cfg_attr(miri, ignore)]
    fn faults_elsewhere_still_end_the_process() {
        if std::env::var_os(ROLE).is_some() {
            return fault_elsewhere();
        }
        let name = "map::mmap::tests::faults_elsewhere_still_end_the_process";
        let mut child = Command::new(std::env::current_exe().unwrap());
        let status = child.args(["--exact", name]).env(ROLE, "1").output().unwrap().status;
        assert_eq!(status.signal(), Some(libc::SIGBUS), "{status}");
    }

    // Miri maps no files.
    #[test]
    #[cfg_attr(miri, ignore)]
    fn entries_are_used_again_and_faults_stay_apart() {
        let file = |bytes| {
            let file = tempfile::tempfile().unwrap();
            file.set_len(bytes).unwrap();
            file
        };
        for _ in 0..50 {
            let (short, whole) = (file(40_000), file(40_000));
            let (a, b) = (Mapping::new(&short).unwrap(), Mapping::new(&whole).unwrap());
            short.set_len(0).unwrap();
            assert_eq!(std::hint::black_box(a.bytes())[39_999], 0);
            assert_eq!(std::hint::black_box(b.bytes())[39_999], 0);
            assert!(a.faulted() && !b.faulted());
        }
        assert!(guard::count() < 50, "{}", guard::count());
    }
}
