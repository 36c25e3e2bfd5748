//! Who wants which page, what is in memory, and what goes when room is needed.

use std::collections::{HashMap, VecDeque};
use std::sync::atomic::Ordering;

use super::{Core, Failure};
use crate::map::Figures;

/// By how many waiting rays a request gains on others for each page that is loaded before it.
const AGING: u64 = 16;
/// One part in so many of the budget is kept doomed ahead of need, so that visits have ended by the time that room is needed.
const SPARE: u64 = 8;

/// The bookkeeping, behind one lock.
pub(super) struct Desk {
    wanted: HashMap<u32, Wanted>,
    /// How many of these wait for a loader.
    queued: usize,
    /// Resident pages, in no order but the clock's.
    ring: Vec<u32>,
    hand: usize,
    /// Doomed pages, the oldest first.
    limbo: VecDeque<u32>,
    /// Bytes of memory that pages take, and of these the doomed ones'.
    taken: u64,
    doomed: u64,
    /// Pages loaded so far.
    loads: u64,
    failed: HashMap<u32, Failure>,
    pub(super) figures: Figures,
    /// Whether a loader looks again and again whether room has come.
    pub(super) looking: bool,
    pub(super) stop: bool,
}

/// A page that somebody has a ticket for, or that is being loaded.
struct Wanted {
    tickets: u32,
    rays: u64,
    /// How many pages had been loaded when it was asked for.
    since: u64,
    /// Must come even if it exceeds the budget.
    urgent: bool,
    stage: Stage,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Stage {
    Queued,
    /// In so much room.
    Loading(u64),
    Here,
}

/// A page that was loaded.
pub(super) struct Loaded {
    /// Its bytes as they are stored.
    pub stored: u32,
    /// Whether it was loaded before.
    pub again: bool,
}

/// What a loader is to do next.
pub(super) enum Task {
    Load(u32),
    /// Room is needed that visits still hold.
    Wait,
    Nothing,
}

impl Desk {
    pub(super) fn new() -> Desk {
        Desk {
            wanted: HashMap::new(),
            queued: 0,
            ring: Vec::new(),
            hand: 0,
            limbo: VecDeque::new(),
            taken: 0,
            doomed: 0,
            loads: 0,
            failed: HashMap::new(),
            figures: Figures::default(),
            looking: false,
            stop: false,
        }
    }

    /// Takes a request; whether a loader is needed.
    pub(super) fn ask(&mut self, core: &Core, page: u32, rays: u64) -> bool {
        if let Some(wanted) = self.wanted.get_mut(&page) {
            wanted.tickets += 1;
            wanted.rays += rays;
            return false;
        }
        let here = core.arena.is_resident(page as usize) || self.take_back(core, page);
        let stage = if here { Stage::Here } else { Stage::Queued };
        self.wanted.insert(page, Wanted { tickets: 1, rays, since: self.loads, urgent: false, stage });
        if !here && !self.failed.contains_key(&page) {
            self.queued += 1;
            return true;
        }
        false
    }

    /// More rays wait for a page.
    pub(super) fn weigh(&mut self, page: u32, rays: u64) {
        if let Some(wanted) = self.wanted.get_mut(&page) {
            wanted.rays += rays;
        }
    }

    /// A page must come whatever the budget.
    pub(super) fn urge(&mut self, page: u32) {
        if let Some(wanted) = self.wanted.get_mut(&page) {
            wanted.urgent = true;
        }
    }

    /// Takes a ticket back; whether that was the last.
    pub(super) fn release(&mut self, page: u32) -> bool {
        let Some(wanted) = self.wanted.get_mut(&page) else { return false };
        wanted.tickets -= 1;
        if wanted.tickets > 0 {
            return false;
        }
        match wanted.stage {
            // The loader, when it has done, finds that nobody waits.
            Stage::Loading(_) => return false,
            Stage::Queued => self.queued -= usize::from(!self.failed.contains_key(&page)),
            Stage::Here => {}
        }
        self.wanted.remove(&page);
        true
    }

    /// Whether pages are asked for that no loader has taken up.
    pub(super) fn is_asked(&self) -> bool {
        self.queued > 0
    }

    /// Why a page cannot be had.
    pub(super) fn failed(&self, page: u32) -> Option<&Failure> {
        self.failed.get(&page)
    }

    /// What a loader is to do: the page that most rays wait for, if there is room for it or room can be made.
    pub(super) fn next(&mut self, core: &Core) -> Task {
        if self.queued == 0 {
            return Task::Nothing;
        }
        let waiting =
            self.wanted.iter().filter(|(page, w)| w.stage == Stage::Queued && !self.failed.contains_key(page));
        let loads = self.loads;
        let key = |w: &Wanted| (w.urgent, w.rays + AGING * (loads - w.since));
        let Some((&page, wanted)) = waiting.max_by_key(|(page, w)| (key(w), u32::MAX - **page)) else {
            return Task::Nothing;
        };
        let urgent = wanted.urgent;
        let room = core.room(page);
        if !self.make_room(core, room) && !urgent {
            return Task::Wait;
        }
        self.taken += room;
        self.queued -= 1;
        if let Some(wanted) = self.wanted.get_mut(&page) {
            wanted.stage = Stage::Loading(room);
        }
        Task::Load(page)
    }

    /// A page has been loaded.
    pub(super) fn loaded(&mut self, core: &Core, page: u32, loaded: Loaded) {
        let Loaded { stored, again } = loaded;
        let figures = &mut self.figures;
        figures.read += 1;
        figures.bytes_read += u64::from(stored);
        if again {
            figures.reread += 1;
        } else {
            figures.touched += 1;
            figures.bytes_touched += u64::from(stored);
        }
        self.loads += 1;
        core.used[page as usize].store(false, Ordering::Relaxed);
        self.ring.push(page);
        self.taken += core.room(page);
        self.end_loading(page);
        self.figures.most_bytes = self.figures.most_bytes.max(self.taken);
    }

    /// A page could not be loaded.
    pub(super) fn lost(&mut self, core: &Core, page: u32, failure: Failure) {
        self.failed.insert(page, failure);
        core.failing.store(true, Ordering::Release);
        self.end_loading(page);
    }

    /// Gives back the room that was kept for a page while it was loaded.
    fn end_loading(&mut self, page: u32) {
        let Some(wanted) = self.wanted.get_mut(&page) else { return };
        if let Stage::Loading(room) = std::mem::replace(&mut wanted.stage, Stage::Here) {
            self.taken -= room;
        }
        if wanted.tickets == 0 {
            self.wanted.remove(&page);
        }
    }

    /// Takes a doomed page back that is wanted again; false if it is not doomed.
    fn take_back(&mut self, core: &Core, page: u32) -> bool {
        let Some(place) = self.limbo.iter().position(|&p| p == page) else { return false };
        if !core.arena.revive(page as usize) {
            return false;
        }
        self.limbo.remove(place);
        self.doomed -= core.room(page);
        self.ring.push(page);
        true
    }

    /// Makes room for so many bytes; false while visits, or tickets, hold too much.
    fn make_room(&mut self, core: &Core, room: u64) -> bool {
        let budget = core.budget.load(Ordering::Relaxed);
        while self.taken - self.doomed + room > budget - budget / SPARE {
            if !self.doom_one(core) {
                break;
            }
        }
        self.taken + room <= budget || self.free_down_to(core, budget.saturating_sub(room))
    }

    /// Frees doomed pages until pages take no more than so many bytes; false while visits hold too much.
    fn free_down_to(&mut self, core: &Core, bytes: u64) -> bool {
        let sweep = core.arena.sweep();
        while self.taken > bytes {
            let freed = self.limbo.iter().position(|&page| sweep.free(page as usize));
            let Some(page) = freed.and_then(|place| self.limbo.remove(place)) else { return false };
            self.taken -= core.room(page);
            self.doomed -= core.room(page);
        }
        true
    }

    /// Evicts what nobody waits for or is visiting.
    pub(super) fn forget(&mut self, core: &Core) {
        while self.doom_one(core) {}
        self.free_down_to(core, 0);
    }

    /// Dooms the next page that was not visited since the hand passed it last; false if all are wanted.
    fn doom_one(&mut self, core: &Core) -> bool {
        for _ in 0..2 * self.ring.len() + 1 {
            if self.ring.is_empty() {
                return false;
            }
            self.hand %= self.ring.len();
            let page = self.ring[self.hand];
            let kept = self.wanted.get(&page).is_some_and(|w| w.tickets > 0)
                || core.used[page as usize].swap(false, Ordering::Relaxed);
            if kept || !core.arena.doom(page as usize) {
                self.hand += 1;
                continue;
            }
            self.ring.swap_remove(self.hand);
            self.limbo.push_back(page);
            self.doomed += core.room(page);
            return true;
        }
        false
    }
}
