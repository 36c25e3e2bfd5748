//! The way of a walk through the top nodes, kept where a page may be missing.
//!
//! A walk that comes to an absent page ends there. What it needs to go on later is its best hit so far, and its *trail*: for each top node
//! on the way down to that page the rank of the slot that was taken, 3 bits each (slots are visited in the order of their ranks). To
//! go on it walks the top again from the root and leaves out, at each node of the trail, the slots of lower rank: these are done.
//! Where the slot of the trail itself is no longer worth a visit, since a hit lies before it, the ones after it are
//! taken and the trail is left. So each page is entered once, whatever comes and goes meanwhile, and one page in
//! memory is enough to get on.

use super::walk::LEVELS;

/// What a walk tells of its way.
pub(super) trait Trip {
    /// A top node is entered, of whose slots, by rank, these are to be visited; those that are left.
    fn enter(&mut self, left: u32) -> u32;
    /// The slot of that rank of a top node is taken.
    fn take(&mut self, rank: u32);
    /// The node under way is put aside at this height of the stack, before a slot of it is taken.
    fn keep(&mut self, height: usize);
    /// The node put aside at this height is come back to.
    fn back(&mut self, height: usize);
}

/// A walk that no page ever halts.
pub(super) struct Straight;

impl Trip for Straight {
    #[inline(always)]
    fn enter(&mut self, left: u32) -> u32 {
        left
    }
    #[inline(always)]
    fn take(&mut self, _: u32) {}
    #[inline(always)]
    fn keep(&mut self, _: usize) {}
    #[inline(always)]
    fn back(&mut self, _: usize) {}
}

/// Ranks from the root on.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Trail {
    /// 21 ranks a word: 63 in all, the most top nodes that a file can have above a page.
    words: [u64; 3],
    length: u8,
}

/// Ranks a word.
const RANKS: usize = 21;

impl Trail {
    /// Whether it is that of a walk that has not begun.
    #[inline]
    pub fn is_empty(&self) -> bool {
        self.length == 0
    }

    #[inline]
    fn get(&self, i: u8) -> Option<u32> {
        let i = usize::from(i);
        let word = self.words.get(i / RANKS).filter(|_| i < usize::from(self.length))?;
        Some((word >> (3 * (i % RANKS))) as u32 & 7)
    }

    #[inline]
    fn push(&mut self, rank: u32) {
        let i = usize::from(self.length);
        if let Some(word) = self.words.get_mut(i / RANKS) {
            let shift = 3 * (i % RANKS);
            *word = *word & !(7 << shift) | u64::from(rank & 7) << shift;
            self.length += 1;
        }
    }
}

/// A walk that an absent page may halt, and that goes on along a trail.
pub(super) struct Halting {
    trail: Trail,
    /// Whether all slots taken so far are those of the trail.
    following: bool,
    /// Nodes entered along the trail, which were entered before; without the root.
    again: u64,
    path: Trail,
    /// The length of the path down to the node at each height of the stack.
    lengths: [u8; LEVELS],
}

impl Halting {
    pub fn new() -> Halting {
        Halting { trail: Trail::default(), following: false, again: 0, path: Trail::default(), lengths: [0; LEVELS] }
    }

    /// Gets ready for a walk along a trail; an empty one for a walk from the beginning.
    #[inline]
    pub fn begin(&mut self, trail: Trail) {
        (self.trail, self.following, self.path.length) = (trail, trail.length > 0, 0);
        self.again = 0;
    }

    /// How many nodes below the root were entered only to come back to where the walk was halted before.
    #[inline]
    pub fn again(&self) -> u64 {
        self.again
    }

    /// Where the walk was halted.
    #[inline]
    pub fn halted(&self) -> Trail {
        self.path
    }
}

impl Trip for Halting {
    #[inline(always)]
    fn enter(&mut self, left: u32) -> u32 {
        if !self.following {
            return left;
        }
        self.trail.get(self.path.length).map_or(left, |rank| left & u32::MAX << rank)
    }

    #[inline(always)]
    fn take(&mut self, rank: u32) {
        self.following &= self.trail.get(self.path.length) == Some(rank);
        self.path.push(rank);
        // The last rank is that of the page that was missing.
        self.again += u64::from(self.following && self.path.length < self.trail.length);
    }

    #[inline(always)]
    fn keep(&mut self, height: usize) {
        self.lengths[height % LEVELS] = self.path.length;
    }

    #[inline(always)]
    fn back(&mut self, height: usize) {
        self.following = false;
        self.path.length = self.lengths[height % LEVELS];
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_trail_is_followed_and_then_left() {
        let mut trip = Halting::new();
        trip.begin(Trail::default());
        assert_eq!(trip.enter(0b1010), 0b1010);
        trip.keep(0);
        trip.take(1);
        assert_eq!(trip.enter(0b110), 0b110);
        trip.keep(1);
        trip.take(2);
        let halted = trip.halted();
        assert_eq!((halted.length, halted.get(0), halted.get(1), halted.get(2)), (2, Some(1), Some(2), None));
        assert_eq!(trip.again(), 0);
        // The same way again: what came before is left out, and the node below the root was entered before.
        trip.begin(halted);
        assert_eq!(trip.enter(0b1011), 0b1010);
        trip.keep(0);
        trip.take(1);
        assert_eq!(trip.enter(0b11_0011), 0b11_0000);
        assert_eq!(trip.again(), 1);
        // The slot of the trail is gone, so another one is taken, and nothing is left out below it.
        trip.take(4);
        assert_eq!(trip.enter(0b11), 0b11);
        trip.back(0);
        trip.take(3);
        assert_eq!((trip.halted().length, trip.halted().get(0), trip.enter(1)), (1, Some(3), 1));
    }

    #[test]
    fn the_longest_trail_fits() {
        let mut trail = Trail::default();
        let rank = |i: u32| i.wrapping_mul(2_654_435_761) >> 29;
        (0..63).for_each(|i| trail.push(rank(i)));
        assert!((0..63u8).all(|i| trail.get(i) == Some(rank(i.into()))));
        assert_eq!(trail.get(63), None);
    }
}
