//! The order of tiles: along a Hilbert curve.

/// The cells of a `width` x `height` grid in the order of a Hilbert curve over the square around it.
pub(super) fn order(width: u32, height: u32) -> Vec<[u32; 2]> {
    let side = width.max(height).max(1).next_power_of_two();
    let mut cells: Vec<[u32; 2]> = (0..height).flat_map(|y| (0..width).map(move |x| [x, y])).collect();
    cells.sort_by_cached_key(|&[x, y]| distance(side, x, y));
    cells
}

/// How far along the curve over a square of `side` (a power of two) cell (x, y) lies.
fn distance(side: u32, mut x: u32, mut y: u32) -> u64 {
    let (mut sum, mut s) = (0, side / 2);
    while s > 0 {
        let (right, upper) = (u32::from(x & s > 0), u32::from(y & s > 0));
        sum += u64::from(s) * u64::from(s) * u64::from((3 * right) ^ upper);
        if upper == 0 {
            if right == 1 {
                (x, y) = (side - 1 - x, side - 1 - y);
            }
            std::mem::swap(&mut x, &mut y);
        }
        s /= 2;
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_step_goes_to_a_neighbour() {
        let cells = order(16, 16);
        assert_eq!(cells.len(), 256);
        for pair in cells.windows(2) {
            assert_eq!(pair[0][0].abs_diff(pair[1][0]) + pair[0][1].abs_diff(pair[1][1]), 1, "{pair:?}");
        }
    }

    #[test]
    fn covers_any_grid_once() {
        for (w, h) in [(1, 1), (5, 3), (1, 9), (7, 8)] {
            let mut cells = order(w, h);
            cells.sort_unstable();
            cells.dedup();
            assert_eq!(cells.len() as u32, w * h);
        }
        assert!(order(0, 4).is_empty());
    }
}
