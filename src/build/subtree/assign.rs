//! Which slot each child of a node takes, so that `slot XOR direction mask` runs near to far.
//!
//! Slot s stands for the octant whose axes are high where the bits of s are set (4x + 2y + z). The children are matched
//! to the slots so that the sum of (child's centre - node's centre) . signs(s) is the greatest (Ylitie, Karras and
//! Laine 2017, section 3.2, who use an auction). With eight slots the best matching is found outright, by dynamic
//! programming over sets of slots: 1024 steps, the same on every machine.

use super::wide::Bounds;

/// The slot of each of at most eight children. Among equal matchings, children take low slots first.
pub(super) fn assign_slots(children: &[Bounds]) -> impl Iterator<Item = usize> {
    let whole = children.iter().fold(Bounds::EMPTY, |b, &child| b.union(child));
    let gain: Vec<[f64; 8]> = children.iter().map(|child| gains(*child, whole)).collect();

    // best[set]: greatest gain when the first |set| children take exactly the slots of `set`; last[set]: the slot of
    // the last of them.
    let mut best = [f64::NEG_INFINITY; 256];
    let mut last = [0u8; 256];
    best[0] = 0.0;
    for set in 1usize..256 {
        let Some(gain) = gain.get(set.count_ones() as usize - 1) else { continue };
        let mut rest = set;
        while rest != 0 {
            let slot = rest.ilog2() as usize;
            rest ^= 1 << slot;
            let sum = best[set ^ (1 << slot)] + gain[slot];
            if sum > best[set] {
                (best[set], last[set]) = (sum, slot as u8);
            }
        }
    }

    let mut set = (0usize..256)
        .filter(|set| set.count_ones() as usize == children.len())
        .reduce(|a, b| if best[b] > best[a] { b } else { a })
        .unwrap_or(0);
    let mut slots = [0usize; 8];
    for slot in slots[..children.len()].iter_mut().rev() {
        *slot = last[set].into();
        set &= !(1 << *slot);
    }
    slots.into_iter().take(children.len())
}

/// What each slot is worth to a child.
fn gains(child: Bounds, whole: Bounds) -> [f64; 8] {
    let offset = child.centre() - whole.centre();
    std::array::from_fn(|slot| {
        let sign = |bit: usize, x: f64| if slot & bit != 0 { x } else { -x };
        sign(4, offset.x) + sign(2, offset.y) + sign(1, offset.z)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    fn cube(x: f64, y: f64, z: f64) -> Bounds {
        Bounds { min: DVec3::new(x, y, z), max: DVec3::new(x + 0.1, y + 0.1, z + 0.1) }
    }

    #[test]
    fn octants_take_their_own_slots() {
        let mut children: Vec<Bounds> =
            (0..8u8).map(|s| cube(f64::from(s >> 2), f64::from(s >> 1 & 1), f64::from(s & 1))).collect();
        assert_eq!(assign_slots(&children).collect::<Vec<_>>(), [0, 1, 2, 3, 4, 5, 6, 7]);
        children.reverse();
        assert_eq!(assign_slots(&children).collect::<Vec<_>>(), [7, 6, 5, 4, 3, 2, 1, 0]);
    }

    #[test]
    fn two_children_are_told_apart() {
        let slots: Vec<usize> = assign_slots(&[cube(0.9, 0.0, 0.0), cube(0.0, 0.0, 0.0)]).collect();
        assert!(slots[0] & 4 != 0 && slots[1] & 4 == 0, "{slots:?}");
    }

    #[test]
    fn equal_children_take_different_slots() {
        let mut slots: Vec<usize> = assign_slots(&[cube(0.0, 0.0, 0.0); 8]).collect();
        slots.sort_unstable();
        assert_eq!(slots, [0, 1, 2, 3, 4, 5, 6, 7]);
        assert_eq!(assign_slots(&[]).count(), 0);
    }
}
