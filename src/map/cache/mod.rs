//! Pages read into memory within a budget, by threads of their own.
//!
//! Whoever needs a page that is not there asks for it and gets a [`Ticket`]; the loaders read the pages that most rays wait for
//! first, the longer they wait the sooner. A page with tickets out is not evicted, so that whoever waited finds it, however small the
//! budget. Others are evicted by CLOCK (Corbató 1968): first doomed, which is taken back if they are asked for soon after, then freed when
//! room is needed and no visit can still be reading them (`mmap/arena.rs`). The budget counts the memory of pages that are resident, being
//! loaded, or doomed.
//!
//! What the directory says of a page is read when the page is. A page's checksum is checked whenever it is read, its structure, and its entry in
//! the directory, when that is for the first time. What cannot be read, or is damaged, is told to everyone who asks for it.

mod desk;
mod load;
#[cfg(test)]
mod tests;

use std::cell::Cell;
use std::fs::File;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard};
use std::thread::JoinHandle;
use std::time::Instant;

use super::Figures;
use super::failure::Failure;
use super::mmap::{self, Arena, Blank};
use crate::error::Result;
use crate::format::{Flags, Header, most_stored};
use desk::Desk;
pub(super) use load::read_at;

/// Threads that read. They mostly wait for the disk, and several requests at a time keep it busy.
const LOADERS: usize = 3;

thread_local! {
    /// Visits that this thread has open. While there are any, it must not wait for room that only it can give.
    static VISITS: Cell<u32> = const { Cell::new(0) };
}

/// A file's pages, as far as they are in memory. Dropped, it ends its threads.
pub(super) struct Cache {
    core: Arc<Core>,
    loaders: Vec<JoinHandle<()>>,
}

/// What loaders and readers share.
struct Core {
    path: PathBuf,
    file: File,
    header: Header,
    arena: Arena,
    /// Bytes of memory that pages may take.
    budget: AtomicU64,
    /// Which pages were visited since the clock's hand passed them.
    used: Blank<AtomicBool>,
    /// Whether any page could not be had.
    failing: AtomicBool,
    /// Pages entered that were there.
    entered: AtomicU64,
    desk: Mutex<Desk>,
    /// Something to do for loaders.
    work: Condvar,
    /// Something has come for readers.
    came: Condvar,
    /// The page, and one more, at which a loader panics.
    #[cfg(test)]
    trap: std::sync::atomic::AtomicU32,
}

/// A page that was asked for. It stays in memory, once it has come, while the ticket lives.
pub(crate) struct Ticket<'c> {
    core: &'c Core,
    page: u32,
}

/// A reader of pages.
pub(super) struct Reader<'c> {
    core: &'c Core,
    visit: mmap::Visit<'c>,
    entered: Cell<u64>,
}

impl Cache {
    /// A cache of at most `budget` bytes of pages, which must hold the largest page.
    pub(super) fn new(path: PathBuf, file: File, header: &Header, budget: u64) -> std::io::Result<Cache> {
        let pages = header.pages as usize;
        let arena = Arena::new(pages, header.largest_page as usize)?;
        advise_random(&file);
        let core = Arc::new(Core {
            path,
            file,
            header: *header,
            arena,
            budget: AtomicU64::new(budget),
            used: Blank::new(pages)?,
            failing: AtomicBool::new(false),
            entered: AtomicU64::new(0),
            desk: Mutex::new(Desk::new()),
            work: Condvar::new(),
            came: Condvar::new(),
            #[cfg(test)]
            trap: Default::default(),
        });
        let loader = |_| {
            let core = core.clone();
            std::thread::Builder::new()
                .name("octrace-loader".into())
                .stack_size(256 << 10)
                .spawn(move || core.load_all())
        };
        let mut cache = Cache { core: core.clone(), loaders: Vec::new() };
        for i in 0..LOADERS {
            cache.loaders.push(loader(i)?);
        }
        Ok(cache)
    }

    /// Opens a visit.
    pub(super) fn reader(&self) -> Reader<'_> {
        VISITS.with(|visits| visits.set(visits.get() + 1));
        let core = &*self.core;
        Reader { core, visit: core.arena.visit(), entered: Cell::new(0) }
    }

    /// Asks for a page that so many rays need.
    pub(super) fn ask(&self, page: u32, rays: u64) -> Ticket<'_> {
        let core = &*self.core;
        let mut desk = core.desk();
        if desk.ask(core, page, rays) {
            core.work.notify_one();
        }
        Ticket { core, page }
    }

    /// Waits until one of the pages asked for has come, or cannot be had.
    pub(super) fn wait<'t>(&self, tickets: impl Iterator<Item = &'t Ticket<'t>> + Clone) {
        let core = &*self.core;
        let ready = || tickets.clone().any(|ticket| ticket.is_ready());
        if ready() {
            return;
        }
        let mut desk = core.desk();
        if VISITS.with(Cell::get) > 0 {
            // What this thread is visiting cannot be freed while it waits, so room must not depend on that.
            tickets.clone().for_each(|ticket| desk.urge(ticket.page));
            core.work.notify_all();
        }
        let begin = Instant::now();
        while !tickets.clone().any(|ticket| ticket.is_there() || desk.failed(ticket.page).is_some()) {
            desk = core.came.wait(desk).unwrap_or_else(|poison| poison.into_inner());
        }
        desk.figures.stalls += 1;
        desk.figures.stalled_seconds += begin.elapsed().as_secs_f64();
    }

    /// Lets pages take so many bytes from now on.
    pub(super) fn set_budget(&self, bytes: u64) {
        self.core.budget.store(bytes, Ordering::Relaxed);
        self.core.work.notify_all();
    }

    /// Evicts what can be.
    pub(super) fn forget(&self) {
        self.core.desk().forget(&self.core);
    }

    /// What was read so far.
    pub(super) fn figures(&self) -> Figures {
        let figures = self.core.desk().figures;
        Figures { total: self.core.header.pages.into(), entered: self.core.entered.load(Ordering::Relaxed), ..figures }
    }

    /// The file, to read what is no page's.
    pub(super) fn file(&self) -> &File {
        &self.core.file
    }
}

impl Drop for Cache {
    fn drop(&mut self) {
        self.core.desk().stop = true;
        self.core.work.notify_all();
        for loader in self.loaders.drain(..) {
            // A loader that panicked has said so.
            let _ = loader.join();
        }
    }
}

impl Core {
    fn desk(&self) -> MutexGuard<'_, Desk> {
        self.desk.lock().unwrap_or_else(|poison| poison.into_inner())
    }

    /// Memory that a page takes; of one that was never there, the most that any does.
    fn room(&self, page: u32) -> u64 {
        let bytes = self.arena.length(page as usize).unwrap_or(self.header.largest_page as usize);
        self.arena.room(bytes) as u64
    }
}

impl Ticket<'_> {
    /// Whether the page is there, to stay while the ticket lives.
    fn is_there(&self) -> bool {
        self.core.arena.is_resident(self.page as usize)
    }

    /// Whether waiting is over: the page is there, or cannot be had.
    pub(crate) fn is_ready(&self) -> bool {
        self.is_there() || (self.core.failing.load(Ordering::Acquire) && self.core.desk().failed(self.page).is_some())
    }

    /// Why the page cannot be had, if that is so.
    pub(crate) fn check(&self) -> Result<()> {
        if !self.core.failing.load(Ordering::Acquire) {
            return Ok(());
        }
        let desk = self.core.desk();
        desk.failed(self.page).map_or(Ok(()), |failure| Err(failure.error(&self.core.path, Some(self.page))))
    }

    /// More rays need the page.
    pub(crate) fn add(&self, rays: u64) {
        self.core.desk().weigh(self.page, rays);
    }
}

impl Drop for Ticket<'_> {
    fn drop(&mut self) {
        let mut desk = self.core.desk();
        if desk.release(self.page) {
            // Room may be made now.
            self.core.work.notify_one();
        }
    }
}

impl Reader<'_> {
    /// A page's bytes, if it is there.
    #[inline]
    pub(super) fn bytes(&self, page: usize) -> Option<&[u8]> {
        let bytes = self.visit.bytes(page)?;
        let used = &self.core.used[page];
        if !used.load(Ordering::Relaxed) {
            used.store(true, Ordering::Relaxed);
        }
        self.entered.set(self.entered.get() + 1);
        Some(bytes)
    }
}

impl Drop for Reader<'_> {
    fn drop(&mut self) {
        VISITS.with(|visits| visits.set(visits.get() - 1));
        self.core.entered.fetch_add(self.entered.get(), Ordering::Relaxed);
    }
}

/// Memory that loaders take beside the cache, which unpack pages: bytes at most.
pub(super) fn unpacking(header: &Header) -> u64 {
    match header.flags.has(Flags::PACKED) {
        true => LOADERS as u64 * most_stored(header.largest_page),
        false => 0,
    }
}

/// Tells the system not to read beyond what is asked for.
fn advise_random(file: &File) {
    #[cfg(target_os = "linux")]
    {
        use std::os::fd::AsFd;
        // Only advice.
        let _ = nix::fcntl::posix_fadvise(file.as_fd(), 0, 0, nix::fcntl::PosixFadviseAdvice::POSIX_FADV_RANDOM);
    }
    #[cfg(not(target_os = "linux"))]
    let _ = file;
}
