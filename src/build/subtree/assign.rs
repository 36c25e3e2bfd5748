//! Which slot each child of a node takes, so that `slot XOR direction mask` runs near to far.
//!
//! Slot s stands for the octant whose axes are high where the bits of s are set (4x + 2y + z). So which of two children a ray
//! visits first depends on a single axis: x if their slots differ there, else y, else z. The order is right for all rays if
//! the boxes lie side by side on that axis, for half of them if they reach over the same range of it. The best slots are
//! those with the least sum, over all pairs, of the part of rays that would visit the farther box first, weighted by how often
//! a ray meets both ([`Pairs`]). They are found outright: of the 70 ways to divide eight into four low and four high on x, each
//! four has six ways to be divided on y, and so on; empty slots count as children that nothing is near.
//!
//! Ylitie, Karras and Laine (2017), section 3.2, match children to slots by the sum of (child's centre - node's centre) .
//! signs(slot) instead. In interiors, where boxes overlap, rays visit 5 % more with that, on scans 1 %.

use super::wide::Bounds;

/// The slot of each of at most eight children. Among equal choices, children take low slots first.
pub(super) fn assign_slots(children: &[Bounds]) -> impl Iterator<Item = usize> {
    let pairs = Pairs::of(children);
    let twos = Twos::of(&pairs);
    let fours = FOURS.map(|four| twos.best_four(four));
    // Without what lies across x a cost is too low, if anything. Where that is least the whole is near the least as a rule, so that
    // few others are to be looked at.
    let inner = |low: usize| fours[low].1 + fours[FOURS.len() - 1 - low].1;
    let whole = |low: usize| inner(low) + pairs.across(X, &FOURS[low], &FOURS[FOURS.len() - 1 - low]);
    let least = (1..FOURS.len()).fold(0, |least, low| if inner(low) < inner(least) { low } else { least });
    let bound = whole(least);
    let mut best = (f64::INFINITY, 0);
    for low in (0..FOURS.len()).filter(|&low| inner(low) <= bound) {
        let cost = whole(low);
        if cost < best.0 {
            best = (cost, low);
        }
    }
    let mut slots = [0; 8];
    let halves = [best.1, FOURS.len() - 1 - best.1];
    let order = halves.into_iter().flat_map(|four| fours[four].0).flat_map(|two| pairs.best_two(two).0);
    order.enumerate().for_each(|(slot, child)| slots[usize::from(child)] = slot);
    slots.into_iter().take(children.len())
}

const X: usize = 0;
const Y: usize = 1;
const Z: usize = 2;

/// The sets of four of eight, each in ascending order. As bits they ascend too, so that the i-th from the front and the i-th
/// from the back are each what the other leaves.
const FOURS: [[u8; 4]; 70] = {
    let (mut fours, mut count) = ([[0; 4]; 70], 0);
    let mut bits = 0u32;
    while bits < 256 {
        if bits.count_ones() == 4 {
            let (mut rest, mut i) = (bits, 0);
            while i < 4 {
                fours[count][i] = rest.trailing_zeros() as u8;
                rest &= rest - 1;
                i += 1;
            }
            count += 1;
        }
        bits += 1;
    }
    fours
};

/// Where two of eight stand in a table of all pairs.
fn place(low: u8, high: u8) -> usize {
    usize::from(low & 7) << 3 | usize::from(high & 7)
}

/// What it costs, for two of eight children, that one is on the low side of the other on an axis.
struct Pairs([[f64; 64]; 3]);

impl Pairs {
    /// A pair counts as the geometric mean of its surfaces: measured against the smaller one, the product and the sum, all
    /// within 1 %.
    fn of(children: &[Bounds]) -> Pairs {
        let mut costs = [[0.0; 64]; 3];
        for (i, a) in (0..).zip(children) {
            for (j, b) in (0..i).zip(children) {
                let weight = (a.half_area() * b.half_area()).sqrt();
                let apart = (b.centre() - a.centre()).to_array();
                let reach = (0.5 * ((b.max - b.min) + (a.max - a.min))).to_array();
                for (axis, (apart, reach)) in apart.into_iter().zip(reach).enumerate() {
                    // 1 where b lies wholly above a, -1 where wholly below.
                    let above = if apart == 0.0 { 0.0 } else { (apart / reach).clamp(-1.0, 1.0) };
                    costs[axis][place(i, j)] = weight * (1.0 - above);
                    costs[axis][place(j, i)] = weight * (1.0 + above);
                }
            }
        }
        Pairs(costs)
    }

    fn cost(&self, axis: usize, low: u8, high: u8) -> f64 {
        self.0[axis][place(low, high)]
    }

    /// The costs of all pairs between two groups.
    fn across<const N: usize>(&self, axis: usize, low: &[u8; N], high: &[u8; N]) -> f64 {
        low.iter().map(|&i| high.iter().map(|&j| self.cost(axis, i, j)).sum::<f64>()).sum()
    }

    /// The best order of two that differ on z only, and what it costs.
    fn best_two(&self, [a, b]: [u8; 2]) -> ([u8; 2], f64) {
        let (kept, swapped) = (self.cost(Z, a, b), self.cost(Z, b, a));
        if kept <= swapped { ([a, b], kept) } else { ([b, a], swapped) }
    }
}

/// What pairs of children cost that share their sides of x and y.
struct Twos {
    /// The pair's own cost, by its place.
    own: [f64; 64],
    /// What it costs that a child is on the low side of the pair on y: by the child, then the pair's place.
    below: [[f64; 64]; 8],
}

impl Twos {
    fn of(pairs: &Pairs) -> Twos {
        let mut twos = Twos { own: [0.0; 64], below: [[0.0; 64]; 8] };
        for (a, b) in (0..8).flat_map(|b| (0..b).map(move |a| (a, b))) {
            twos.own[place(a, b)] = pairs.best_two([a, b]).1;
            for (child, below) in (0..).zip(&mut twos.below) {
                below[place(a, b)] = pairs.cost(Y, child, a) + pairs.cost(Y, child, b);
            }
        }
        twos
    }

    /// The best pairs, low and high on y, of four children in ascending order that share their side of x, and what that costs.
    fn best_four(&self, [a, b, c, d]: [u8; 4]) -> ([[u8; 2]; 2], f64) {
        let ways = [
            [[a, b], [c, d]],
            [[a, c], [b, d]],
            [[a, d], [b, c]],
            [[b, c], [a, d]],
            [[b, d], [a, c]],
            [[c, d], [a, b]],
        ];
        let mut best = (ways[0], f64::INFINITY);
        for way in ways {
            let [[low, other], high] = way;
            let high = place(high[0], high[1]);
            let across = self.below[usize::from(low & 7)][high] + self.below[usize::from(other & 7)][high];
            let cost = self.own[place(low, other)] + self.own[high] + across;
            if cost < best.1 {
                best = (way, cost);
            }
        }
        best
    }
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

    /// The pairs that rays with all components positive (and, mirrored, negative) visit in the wrong order.
    fn wrong(children: &[Bounds]) -> usize {
        let slots: Vec<usize> = assign_slots(children).collect();
        let pairs = (0..slots.len()).flat_map(|i| (0..slots.len()).map(move |j| (i, j)));
        let is_wrong = |&(i, j): &(usize, usize)| {
            let axis = 2 - (slots[i] ^ slots[j]).ilog2() as usize;
            children[i].min[axis] > children[j].min[axis]
        };
        pairs.filter(|&(i, j)| slots[i] < slots[j]).filter(is_wrong).count()
    }

    #[test]
    fn a_row_along_any_axis_is_in_order() {
        // Only one axis tells them apart, so slots that differ on another put half of the pairs in the wrong order for half of
        // the rays; no pair must be wrong on the axis that decides it.
        for axis in 0..3 {
            let children: Vec<Bounds> = (0..8)
                .map(|i| {
                    let mut at = [0.0; 3];
                    at[axis] = f64::from((5 * i) % 8);
                    cube(at[0], at[1], at[2])
                })
                .collect();
            assert_eq!(wrong(&children), 0, "{axis}");
            let slots: Vec<usize> = assign_slots(&children).collect();
            let low = |i: usize| slots[i] & (4 >> axis) == 0;
            assert!((0..8).all(|i| low(i) == ((5 * i) % 8 < 4) || axis > 0), "{axis} {slots:?}");
        }
    }

    #[test]
    fn no_exchange_of_two_slots_is_better() {
        let mut seed = 1u64;
        let mut random = || {
            seed = seed.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (seed >> 40) as f64 / f64::from(1 << 24)
        };
        for count in 1..=8 {
            for _ in 0..20 {
                let children: Vec<Bounds> = (0..count)
                    .map(|_| {
                        let min = DVec3::new(random(), random(), random());
                        Bounds { min, max: min + 0.4 * DVec3::new(random(), random(), random()) }
                    })
                    .collect();
                let pairs = Pairs::of(&children);
                let cost = |slots: &[usize]| -> f64 {
                    let pair = |i: usize, j: usize| {
                        let axis = 2 - (slots[i] ^ slots[j]).ilog2() as usize;
                        let (i, j) = (i as u8, j as u8);
                        if slots[usize::from(i)] < slots[usize::from(j)] {
                            pairs.cost(axis, i, j)
                        } else {
                            pairs.cost(axis, j, i)
                        }
                    };
                    (0..count).flat_map(|i| (0..i).map(move |j| (i, j))).map(|(i, j)| pair(i, j)).sum()
                };
                let slots: Vec<usize> = assign_slots(&children).collect();
                let best = cost(&slots);
                for (from, to) in (0..8).flat_map(|from| (0..from).map(move |to| (from, to))) {
                    let swap = |&slot: &usize| {
                        if slot == from {
                            to
                        } else if slot == to {
                            from
                        } else {
                            slot
                        }
                    };
                    let other: Vec<usize> = slots.iter().map(swap).collect();
                    assert!(cost(&other) >= best - 1e-12, "{slots:?} {other:?}");
                }
            }
        }
    }
}
