//! Rays against a file of which only some pages are in memory: rays wait for pages, threads do not.
//!
//! Rays start on the walks that are fastest for them: packets, many in flight, short ones together. Those that come to a page that is not in
//! memory are walked one by one from there on, and each is put aside in that page's queue with what it needs to go on (`trip.rs`). The page
//! is asked for, and the thread turns to other rays: first to those whose page has come, the longest queue before others, then to
//! fresh ones. Only when all are waiting and nothing has come does the thread wait too. Since a page stays while a queue holds its ticket, each
//! queue gets on with its page, however small the cache.
//!
//! An answer depends on the triangles alone, so neither order nor budget changes it.

use std::collections::HashMap;
use std::ops::Range;

use glam::Vec3;

use super::arch::{Isa, Job, Kernel};
use super::ask::{Answer, Pause};
use super::batch::{SPACE, Space};
use super::collect::Collector;
use super::flight::{Flight, STACKS};
use super::near::Near;
use super::packet::{self, PACKET};
use super::setup::Scene;
use super::trip::{Halting, Trail};
use super::walk::{File, Start};
use super::{Counters, Found};
use crate::error::Result;
use crate::exact::{Depths, LANES};
use crate::format::PageId;
use crate::geometry::{Hit, Ray, Skip, Triangle};
use crate::map::{Halt, Octree, Ticket, Visit};

/// Rays that are walked during one visit. Pages that a visit may have seen cannot be freed while it is open.
pub(super) const STRETCH: usize = 512;

/// How rays start.
#[derive(Clone, Copy)]
pub(super) enum Fast<'s> {
    Single,
    Packets,
    Flight,
    /// Short rays, with what they leave out; answers are of the kind "whether anything is hit".
    Near(&'s [Skip]),
}

/// A hit of which nothing is known.
const SOMETHING: Found = Found {
    hit: Hit::MISS,
    triangle: Triangle { a: Vec3::ZERO, b: Vec3::ZERO, c: Vec3::ZERO },
    page: PageId(0),
    reference: 0,
};

/// A ray put aside, or not yet begun.
struct Waiting<R> {
    place: u32,
    trail: Trail,
    /// What it has found so far.
    rest: R,
}

/// The rays that wait for a page.
struct Queue<'o, R> {
    ticket: Ticket<'o>,
    rays: Vec<Waiting<R>>,
}

/// What all rays of a batch share.
pub(super) struct Patient<'o, 'w, A: Pause> {
    pub octree: &'o Octree,
    pub scene: &'o Scene,
    pub isa: Isa,
    pub ask: A,
    pub rays: &'w [Ray],
    pub fast: Fast<'w>,
}

impl<A: Pause> Patient<'_, '_, A> {
    /// Answers all rays, on this thread.
    pub fn answer(&self, answers: &mut [A::Answer], counters: &mut Counters) -> Result<()> {
        let mut queues: HashMap<u32, Queue<'_, A::Rest>> = HashMap::new();
        let (mut taken, mut halted) = (Vec::new(), Vec::new());
        let mut next = 0;
        counters.rays += self.rays.len() as u64;
        loop {
            let come = queues.iter().filter(|(_, queue)| queue.ticket.is_ready());
            let come = come.max_by_key(|(page, queue)| (queue.rays.len(), **page)).map(|(&page, _)| page);
            let mut fresh = next..next;
            if let Some(queue) = come.and_then(|page| queues.get_mut(&page)) {
                queue.ticket.check()?;
                taken.extend(queue.rays.drain(queue.rays.len().saturating_sub(STRETCH)..));
            } else if next < self.rays.len() {
                fresh = next..(next + STRETCH).min(self.rays.len());
                next = fresh.end;
            } else if queues.is_empty() {
                return Ok(());
            } else {
                self.octree.wait(queues.values().map(|queue| &queue.ticket));
                continue;
            }
            let outcome = self.visit(fresh, answers, &mut taken, &mut halted, counters);
            // The page may go when its queue is empty.
            if let Some(page) = come
                && queues.get(&page).is_some_and(|queue| queue.rays.is_empty())
            {
                queues.remove(&page);
            }
            outcome?;
            self.put_aside(&mut halted, &mut queues);
        }
    }

    /// Puts rays into the queues of the pages that halted them, and asks for these.
    fn put_aside<'q>(
        &'q self,
        halted: &mut Vec<(u32, Waiting<A::Rest>)>,
        queues: &mut HashMap<u32, Queue<'q, A::Rest>>,
    ) {
        halted.sort_by_key(|x| x.0);
        let mut halted = halted.drain(..).peekable();
        while let Some((page, first)) = halted.next() {
            let mut those = vec![first];
            while let Some((_, ray)) = halted.next_if(|x| x.0 == page) {
                those.push(ray);
            }
            let count = those.len() as u64;
            match queues.get_mut(&page) {
                Some(queue) => {
                    queue.ticket.add(count);
                    queue.rays.append(&mut those);
                }
                None => {
                    let ticket = self.octree.ask(PageId(page), count);
                    queues.insert(page, Queue { ticket, rays: those });
                }
            }
        }
    }

    /// Walks fresh rays and those that were taken from a queue, as far as the pages go that are there.
    fn visit(
        &self,
        fresh: Range<usize>,
        answers: &mut [A::Answer],
        taken: &mut Vec<Waiting<A::Rest>>,
        halted: &mut Vec<(u32, Waiting<A::Rest>)>,
        counters: &mut Counters,
    ) -> Result<()> {
        let visit = self.octree.visit();
        let mut packets = fresh.start..fresh.start;
        match self.fast {
            _ if fresh.is_empty() => {}
            Fast::Packets => packets = fresh,
            Fast::Single => taken.extend(fresh.map(Waiting::fresh)),
            Fast::Flight => self.fly(&visit, fresh, answers, taken, counters)?,
            Fast::Near(skips) => self.meet_near(&visit, skips, fresh, answers, taken, counters)?,
        }
        let file = File::new(&visit, self.scene);
        SPACE.with_borrow_mut(|space| {
            let Patient { ask, rays, .. } = self;
            self.isa.run(Stretch { ask, rays, answers, file, space, counters, packets, taken, halted })
        })
    }

    /// Walks rays many at a time; those that are halted are taken.
    fn fly(
        &self,
        visit: &Visit<'_>,
        fresh: Range<usize>,
        answers: &mut [A::Answer],
        taken: &mut Vec<Waiting<A::Rest>>,
        counters: &mut Counters,
    ) -> Result<()> {
        let (file, count, first) = (File::new(visit, self.scene), counters.rays, fresh.start);
        let (ask, rays, mut left) = (&self.ask, &self.rays[..fresh.end], Vec::new());
        let outcome = STACKS.with_borrow_mut(|stacks| {
            self.isa.run(Flight { ask, rays, first, answers, file, counters, stacks, left: &mut left })
        });
        counters.rays = count;
        match outcome {
            Ok(()) => taken.extend(left.into_iter().map(Waiting::fresh)),
            Err(Halt::Absent(_)) => taken.extend(fresh.map(Waiting::fresh)),
            Err(Halt::Failed(error)) => return Err(error),
        }
        Ok(())
    }

    /// Walks short rays together; those that are halted are taken.
    fn meet_near(
        &self,
        visit: &Visit<'_>,
        skips: &[Skip],
        fresh: Range<usize>,
        answers: &mut [A::Answer],
        taken: &mut Vec<Waiting<A::Rest>>,
        counters: &mut Counters,
    ) -> Result<()> {
        let count = counters.rays;
        for first in fresh.clone().step_by(PACKET) {
            let those = first..(first + PACKET).min(fresh.end);
            let mut blocked = [false; PACKET];
            let (rays, skips) = (&self.rays[those.clone()], &skips[those.clone()]);
            let blocked = &mut blocked[..rays.len()];
            match self.isa.run(Near { visit, rays, skips, blocked, counters }) {
                Ok(()) => {
                    for (answer, &blocked) in answers[those].iter_mut().zip(&*blocked) {
                        *answer = if blocked { A::Answer::of(SOMETHING) } else { A::Answer::NOTHING };
                    }
                }
                Err(Halt::Absent(_)) => taken.extend(those.map(Waiting::fresh)),
                Err(Halt::Failed(error)) => return Err(error),
            }
        }
        counters.rays = count;
        Ok(())
    }
}

impl<R: Default> Waiting<R> {
    fn fresh(place: usize) -> Waiting<R> {
        Waiting { place: place as u32, trail: Trail::default(), rest: R::default() }
    }
}

/// The rays of one visit.
struct Stretch<'a, 'w, A: Pause> {
    ask: &'w A,
    rays: &'w [Ray],
    answers: &'w mut [A::Answer],
    file: File<'a>,
    space: &'w mut Space,
    counters: &'w mut Counters,
    /// Fresh rays that run side by side.
    packets: Range<usize>,
    taken: &'w mut Vec<Waiting<A::Rest>>,
    halted: &'w mut Vec<(u32, Waiting<A::Rest>)>,
}

impl<A: Pause> Job for Stretch<'_, '_, A> {
    type Output = Result<()>;

    #[inline(always)]
    fn run<K: Kernel>(mut self, kernel: K) -> Result<()> {
        let start = match self.file.start() {
            Ok(start) => start,
            Err(Halt::Failed(error)) => return Err(error),
            Err(Halt::Absent(PageId(page))) => {
                let fresh = self.packets.clone().map(Waiting::fresh);
                self.counters.waits += (self.taken.len() + fresh.len()) as u64;
                self.halted.extend(self.taken.drain(..).chain(fresh).map(|ray| (page, ray)));
                return Ok(());
            }
        };
        let mut depths = Depths::BLANK;
        for first in self.packets.clone().step_by(PACKET) {
            let those = first..(first + PACKET).min(self.packets.end);
            let asked = packet::Asked { ask: self.ask, first, rays: &self.rays[those.clone()] };
            let (answers, space) = (&mut self.answers[those.clone()], &mut self.space.packet);
            let alone =
                match packet::walk(kernel, &self.file, &start, asked, answers, space, &mut depths, self.counters) {
                    Ok(alone) => alone,
                    Err(Halt::Absent(_)) => u64::MAX,
                    Err(Halt::Failed(error)) => return Err(error),
                };
            self.taken.extend(those.filter(|i| alone >> (i - first) & 1 != 0).map(Waiting::fresh));
        }
        let mut taken = std::mem::take(self.taken);
        let mut rest = taken.drain(..);
        let mut trip = Halting::new();
        while self.sixteen(kernel, &start, &mut rest, &mut depths, &mut trip)? {}
        drop(rest);
        // Kept, so that the next visit allocates nothing.
        *self.taken = taken;
        Ok(())
    }
}

impl<'a, A: Pause> Stretch<'a, '_, A> {
    /// Walks the next sixteen rays one after the other, as [`super::batch::Batch`] does; false if there are none.
    #[inline(always)]
    fn sixteen<K: Kernel>(
        &mut self,
        kernel: K,
        start: &Start<'a>,
        taken: &mut impl Iterator<Item = Waiting<A::Rest>>,
        depths: &mut Depths,
        trip: &mut Halting,
    ) -> Result<bool> {
        let Stretch { ask, rays, answers, file, space, counters, halted, .. } = self;
        let (mut places, mut trails) = ([0; LANES], [Trail::default(); LANES]);
        let (mut count, mut live) = (0, 0u32);
        let mut those = [Ray::new([0.0; 3], [0.0; 3]); LANES];
        let mut collectors: [A::Collector<'_>; LANES] = std::array::from_fn(|_| A::idle());
        for waiting in taken.take(LANES) {
            let (place, ray, sight) = (waiting.place as usize, &mut those[count], &mut space.crew[count]);
            (*ray, places[count], trails[count]) = (rays[place], place, waiting.trail);
            ask.begin(place, ray, &mut collectors[count]);
            A::resume(waiting.rest, &mut collectors[count]);
            if sight.setup.aim(kernel, ray, file.scene) {
                sight.setup.far = sight.setup.far.min(sight.setup.reach(collectors[count].reach()));
                live |= u32::from(sight.enter(kernel, start)) << count;
                counters.nodes += u64::from(waiting.trail.is_empty());
            }
            count += 1;
        }
        for k in (0..count).filter(|k| live >> k & 1 != 0) {
            let (ray, sight) = (&those[k], &mut space.crew[k]);
            sight.shear = crate::exact::Shear::new(ray, file.scene.bounds);
        }
        let mut done = u32::MAX;
        for k in (0..count).filter(|k| live >> k & 1 != 0) {
            let (ray, sight, collector) = (&those[k], &space.crew[k], &mut collectors[k]);
            trip.begin(trails[k]);
            let outcome = file.walk(kernel, &mut space.levels, start, ray, sight, depths, collector, counters, trip);
            // Work is counted as if the ray had never waited.
            counters.nodes -= trip.again();
            match outcome {
                Ok(()) => {}
                Err(Halt::Absent(PageId(page))) => {
                    done &= !(1 << k);
                    counters.waits += 1;
                    let rest = A::rest(collector, ray);
                    halted.push((page, Waiting { place: places[k] as u32, trail: trip.halted(), rest }));
                }
                Err(Halt::Failed(error)) => return Err(error),
            }
        }
        A::end(kernel, &those[..count], &collectors[..count], |k, answer| {
            if done >> k & 1 != 0 {
                answers[places[k]] = answer;
            }
        });
        Ok(count > 0)
    }
}
