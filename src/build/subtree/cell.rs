//! Octree cells: which one a triangle belongs to, and which ones it overlaps.
//!
//! A triangle *belongs* to the cell around the centre of its box (sah and octree modes store it once, there). It
//! *overlaps* a cell when the closed triangle meets the closed cube (strict mode stores a reference in each). The
//! overlap test is the separating axis test of Akenine-Möller (2001) in f64 root units, with a tolerance above its own
//! rounding: it may say yes where triangle and cell are 2^-44 of the root apart, and never says no where they touch.

use glam::DVec3;

use super::wide::Bounds;
use crate::geometry::{Aabb, RootCube, Triangle, morton};

/// A cell of the octree: its level (the root cube is level 0, the least cells level 21) and its place on that level's grid.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Cell {
    /// Level, 0..=21.
    pub level: u32,
    /// Coordinates, each below 2^level.
    pub index: [u32; 3],
}

impl Cell {
    /// The root cube.
    #[cfg(test)]
    pub const ROOT: Cell = Cell { level: 0, index: [0; 3] };

    /// The octant 4x + 2y + z of this cell.
    pub fn child(self, octant: usize) -> Cell {
        let [x, y, z] = self.index;
        let bit = |shift: usize| (octant >> shift & 1) as u32;
        Cell { level: self.level + 1, index: [x << 1 | bit(2), y << 1 | bit(1), z << 1 | bit(0)] }
    }

    /// The code of the cell's first point: the 63-bit Morton code (as of [`cell_of`]) of its lowest corner.
    pub fn code(self) -> u64 {
        let shift = morton::BITS - self.level;
        let [x, y, z] = self.index.map(|i| i << shift);
        morton::encode(x, y, z)
    }

    /// Its cube in root units, exactly.
    pub fn bounds(self) -> Bounds {
        let side = 1.0 / f64::from(1u32 << self.level);
        let min = DVec3::from_array(self.index.map(f64::from)) * side;
        Bounds { min, max: min + DVec3::splat(side) }
    }
}

/// The octant 4x + 2y + z that a code of [`cell_of`] falls into within its cell of `level` (below 21).
pub(super) fn octant_of(code: u64, level: u32) -> usize {
    (code >> (3 * (morton::BITS - 1 - level)) & 7) as usize
}

/// The least cell (level 21) that a triangle (or a part of one) with that box belongs to, as a 63-bit Morton code: the one
/// around the centre of the box.
///
/// Its leading 3 * level bits name the cell of that level. Places outside the root cube are drawn to its border.
pub fn cell_of(root: RootCube, bounds: Aabb) -> u64 {
    // Scaling by powers of two is exact, so it is done once, behind the sum. What lies below 0 becomes 0.
    let sum = (bounds.min.as_dvec3() - root.corner) + (bounds.max.as_dvec3() - root.corner);
    let grid = sum * (0.5 * f64::from(1u32 << morton::BITS) / root.side());
    let [x, y, z] = grid.to_array().map(|g| (g as u32).min((1 << morton::BITS) - 1));
    morton::encode(x, y, z)
}

/// Whether the closed triangle meets the closed cell: never no when it does; yes also when it misses by less than
/// about 2^-44 of the root cube's side.
///
/// The cells of a level for which this holds cover every point of the triangle.
pub fn overlaps(root: RootCube, cell: Cell, triangle: &Triangle) -> bool {
    Separation::of(root, triangle).overlaps(cell.bounds())
}

/// Tolerance of every test, relative to the size of the axis: 2^-44, where rounding is at most some 2^-50.
const TOLERANCE: f64 = 1.0 / (1u64 << 44) as f64;

/// A triangle prepared for tests against many cells.
pub(super) struct Separation {
    corners: [DVec3; 3],
    edges: [DVec3; 3],
    normal: DVec3,
    /// |edge 0| |edge 1|, the scale of the normal's rounding (not its length: a needle's may cancel).
    normal_scale: f64,
    bounds: Bounds,
}

impl Separation {
    /// Prepares a triangle. Edges are taken from the source's coordinates, not from root units, so that their error is
    /// relative to their own length even where the triangle is tiny.
    pub fn of(root: RootCube, triangle: &Triangle) -> Separation {
        let [a, b, c] = triangle.vertices().map(|v| v.as_dvec3());
        let edges = [b - a, c - b, a - c].map(|e| e / root.side());
        Separation {
            corners: triangle.vertices().map(|v| root.to_root_units(v)),
            edges,
            normal: edges[0].cross(edges[1]),
            normal_scale: edges[0].length() * edges[1].length(),
            bounds: Bounds::of(Aabb::from(triangle), root),
        }
    }

    /// The triangle's box in root units.
    pub fn bounds(&self) -> Bounds {
        self.bounds
    }

    /// Whether no axis separates the triangle from the box.
    pub fn overlaps(&self, cell: Bounds) -> bool {
        let slack = DVec3::splat(TOLERANCE);
        if (self.bounds.min - slack).cmpgt(cell.max).any() || (self.bounds.max + slack).cmplt(cell.min).any() {
            return false;
        }
        let (centre, half) = (cell.centre(), 0.5 * (cell.max - cell.min));
        let corners = self.corners.map(|p| p - centre);
        !self.plane_separates(corners[0], half) && !self.edges.iter().any(|&e| edge_separates(e, &corners, half))
    }

    /// Whether the triangle's plane passes the box by.
    fn plane_separates(&self, corner: DVec3, half: DVec3) -> bool {
        self.normal.dot(corner).abs() > self.normal.abs().dot(half) + TOLERANCE * self.normal_scale
    }
}

/// Whether one of the three axes `edge x unit vector` separates.
fn edge_separates(edge: DVec3, corners: &[DVec3; 3], half: DVec3) -> bool {
    let axes = [DVec3::new(0.0, -edge.z, edge.y), DVec3::new(edge.z, 0.0, -edge.x), DVec3::new(-edge.y, edge.x, 0.0)];
    let tolerance = TOLERANCE * edge.abs().element_sum();
    axes.into_iter().any(|axis| {
        let radius = axis.abs().dot(half) + tolerance;
        let [a, b, c] = corners.map(|p| axis.dot(p));
        a.min(b).min(c) > radius || a.max(b).max(c) < -radius
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;
    use proptest::prelude::*;

    const ROOT: RootCube = RootCube { corner: DVec3::ZERO, log2_side: 0 };

    #[test]
    fn codes_name_the_cells_around_centres() {
        let point = |p: [f32; 3]| Aabb { min: p.into(), max: p.into() };
        assert_eq!(cell_of(ROOT, point([0.0; 3])), 0);
        let code = cell_of(ROOT, point([0.75, 0.25, 0.5]));
        assert_eq!((octant_of(code, 0), octant_of(code, 1)), (5, 6));
        assert_eq!(cell_of(ROOT, point([9.0; 3])), (1 << 63) - 1);
        assert_eq!(Cell { level: 2, index: [3, 1, 2] }.code(), code);
    }

    #[test]
    fn a_triangle_overlaps_what_it_touches() {
        let t = Triangle { a: Vec3::new(0.1, 0.1, 0.5), b: Vec3::new(0.2, 0.1, 0.5), c: Vec3::new(0.1, 0.2, 0.5) };
        let found: Vec<usize> = (0..8).filter(|&i| overlaps(ROOT, Cell::ROOT.child(i), &t)).collect();
        assert_eq!(found, [0, 1], "a triangle in the plane between two cells is in both");
        // Its box overlaps this cell, its plane does not.
        let t = Triangle { a: Vec3::new(0.9, 0.0, 0.0), b: Vec3::new(0.0, 0.9, 0.0), c: Vec3::new(0.0, 0.0, 0.9) };
        assert!(!overlaps(ROOT, Cell::ROOT.child(7), &t));
        assert!(overlaps(ROOT, Cell::ROOT.child(0), &t));
    }

    proptest! {
        #[test]
        fn cells_cover_every_point(
            p in prop::array::uniform9(0.0f32..0.99), shrink in 0i32..40, u in 0.0f64..1.0, v in 0.0f64..1.0, level in 0u32..=21,
        ) {
            let s = 2f32.powi(-shrink);
            let at = |i: usize| Vec3::new(p[0] + (p[i] - p[0]) * s, p[1] + (p[i + 1] - p[1]) * s, p[2] + (p[i + 2] - p[2]) * s);
            let t = Triangle { a: at(0), b: at(3), c: at(6) };
            let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
            let [a, b, c] = t.vertices().map(|x| x.as_dvec3());
            let point = a + u * (b - a) + v * (c - a);
            let index = (point * f64::from(1u32 << level)).to_array().map(|g| g as u32);
            let cell = Cell { level, index };
            prop_assert!(overlaps(ROOT, cell, &t));
            // A cell well clear of the box is told apart.
            let b = Bounds::of(Aabb::from(&t), ROOT);
            let c = cell.bounds();
            let away = (b.min - 1e-9).cmpgt(c.max).any() || (b.max + 1e-9).cmplt(c.min).any();
            prop_assert!(!away);
        }
    }
}
