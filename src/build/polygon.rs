//! Cuts a face of n corners into n - 2 triangles.
//!
//! Everything is decided in the coordinate plane of the largest projected area, by exact orientations. Convex faces
//! become fans from the first corner. Concave ones are cut by ear clipping (Meisters 1975; ElGindy, Everett and
//! Toussaint 1993 for the bookkeeping): an ear is a corner that turns left and whose closed triangle the rest of the
//! outline does not enter. Outlines that touch themselves, as holes joined by a double edge do, are cut without overlap;
//! those that cross themselves have no right answer, but cutting ends, gives n - 2 triangles, and conserves the signed area.
//! Faces of more than [`CLIP_LIMIT`] corners do not come here: they are made fans as they are read, and overlap where
//! they are concave.

use std::cmp::Ordering;

use crate::exact::orient2d;

/// Most corners of a face that is cut by ear clipping.
pub(super) const CLIP_LIMIT: usize = 4096;

/// How a face was cut.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Cut {
    /// A fan from the first corner.
    Fan,
    /// Ear clipping.
    Clipped,
}

/// Cuts a face (3 to [`CLIP_LIMIT`] corners, finite) and appends the triangles, as places in `corners`, to `out`.
pub(super) fn cut(corners: &[[f32; 3]], out: &mut Vec<[u32; 3]>) -> Cut {
    let outline = project(corners);
    if corners.len() == 3 || is_convex(&outline) {
        fan(corners.len(), out);
        Cut::Fan
    } else {
        Clipper::new(&outline).run(out);
        Cut::Clipped
    }
}

fn fan(corners: usize, out: &mut Vec<[u32; 3]>) {
    out.extend((1..corners as u32 - 1).map(|i| [0, i, i + 1]));
}

/// The corners in the coordinate plane of the largest projected area, mirrored if need be so that the outline runs left.
fn project(corners: &[[f32; 3]]) -> Vec<[f32; 2]> {
    // Twice the area vector, over differences to the first corner, so that it holds far from the origin too.
    let first = corners[0].map(f64::from);
    let mut area = [0.0f64; 3];
    for pair in corners.windows(2) {
        let [p, q] = [pair[0], pair[1]].map(|p| [0, 1, 2].map(|i| f64::from(p[i]) - first[i]));
        for (axis, area) in area.iter_mut().enumerate() {
            let (i, j) = ((axis + 1) % 3, (axis + 2) % 3);
            *area += p[i] * q[j] - p[j] * q[i];
        }
    }
    let axis = (1..3).fold(0, |best, i| if area[i].abs() > area[best].abs() { i } else { best });
    let (i, j) = ((axis + 1) % 3, (axis + 2) % 3);
    if area[axis] < 0.0 {
        corners.iter().map(|p| [p[j], p[i]]).collect()
    } else {
        corners.iter().map(|p| [p[i], p[j]]).collect()
    }
}

/// Whether the outline never turns right and goes round once. Exact; corners that repeat the one before are passed over.
fn is_convex(outline: &[[f32; 2]]) -> bool {
    let mut distinct: Vec<[f32; 2]> = outline.to_vec();
    distinct.dedup();
    while distinct.len() > 1 && distinct.first() == distinct.last() {
        distinct.pop();
    }
    let n = distinct.len();
    // An outline that goes round once changes between rightward and leftward edges (by x, then y) exactly twice.
    let rightward = |i: usize| less(distinct[i % n], distinct[(i + 1) % n]);
    let changes = (0..n).filter(|&i| rightward(i) != rightward(i + 1)).count();
    let left = (0..n).all(|i| orient2d(distinct[i], distinct[(i + 1) % n], distinct[(i + 2) % n]).is_ge());
    changes <= 2 && left
}

fn less(a: [f32; 2], b: [f32; 2]) -> bool {
    a[0] < b[0] || (a[0] == b[0] && a[1] < b[1])
}

/// Ear clipping over a ring of the corners that are left.
struct Clipper<'a> {
    outline: &'a [[f32; 2]],
    next: Vec<u32>,
    previous: Vec<u32>,
    /// Whether a corner is an ear. Clipping changes this only for the neighbours, if the outline does not cross itself.
    ear: Vec<bool>,
    left: usize,
    /// Full looks for ears that may still be made when none is known; outlines that cross themselves use them up.
    looks: u32,
}

impl<'a> Clipper<'a> {
    fn new(outline: &'a [[f32; 2]]) -> Self {
        let n = outline.len() as u32;
        let mut clipper = Clipper {
            outline,
            next: (0..n).map(|i| (i + 1) % n).collect(),
            previous: (0..n).map(|i| (i + n - 1) % n).collect(),
            ear: vec![false; outline.len()],
            left: outline.len(),
            looks: 16,
        };
        clipper.look_everywhere(0);
        clipper
    }

    fn run(mut self, out: &mut Vec<[u32; 3]>) {
        let mut at = 0;
        while self.left > 3 {
            let corner = self.choose(at);
            let (previous, next) = (self.previous[corner as usize], self.next[corner as usize]);
            out.push([previous, corner, next]);
            self.next[previous as usize] = next;
            self.previous[next as usize] = previous;
            self.left -= 1;
            self.ear[previous as usize] = self.is_ear(previous);
            self.ear[next as usize] = self.is_ear(next);
            // Going on beyond the next corner keeps the triangles from gathering around one corner.
            at = self.next[next as usize];
        }
        out.push([self.previous[at as usize], at, self.next[at as usize]]);
    }

    /// The corner to clip, looked for from `at` on: an ear; else one without area (on a straight line, or a spike); else,
    /// where the outline crosses itself, one that turns left; else any.
    fn choose(&mut self, at: u32) -> u32 {
        if let Some(ear) = self.ring(at).find(|&i| self.ear[i as usize]) {
            return ear;
        }
        if let Some(flat) = self.ring(at).find(|&i| self.turn(i) == Ordering::Equal) {
            return flat;
        }
        if self.looks > 0 {
            self.looks -= 1;
            self.look_everywhere(at);
            if let Some(ear) = self.ring(at).find(|&i| self.ear[i as usize]) {
                return ear;
            }
        }
        self.ring(at).find(|&i| self.turn(i) == Ordering::Greater).unwrap_or(at)
    }

    fn look_everywhere(&mut self, at: u32) {
        let ears: Vec<u32> = self.ring(at).filter(|&i| self.is_ear(i)).collect();
        self.ear.fill(false);
        ears.into_iter().for_each(|i| self.ear[i as usize] = true);
    }

    /// The corners that are left, from `at` on.
    fn ring(&self, at: u32) -> impl Iterator<Item = u32> + '_ {
        std::iter::successors(Some(at), |&i| Some(self.next[i as usize])).take(self.left)
    }

    fn point(&self, corner: u32) -> [f32; 2] {
        self.outline[corner as usize]
    }

    /// Its triangle: the corners before, at and after it.
    fn triangle(&self, corner: u32) -> [[f32; 2]; 3] {
        [self.previous[corner as usize], corner, self.next[corner as usize]].map(|i| self.point(i))
    }

    fn turn(&self, corner: u32) -> Ordering {
        let [a, b, c] = self.triangle(corner);
        orient2d(a, b, c)
    }

    /// Whether the corner turns left and the rest of the outline does not enter its triangle.
    fn is_ear(&self, corner: u32) -> bool {
        if self.turn(corner) != Ordering::Greater {
            return false;
        }
        let triangle = self.triangle(corner);
        let after = self.next[corner as usize];
        // All that are left but the triangle's own three.
        self.ring(self.next[after as usize]).take(self.left - 3).all(|i| !self.enters(i, triangle))
    }

    /// Whether the outline at corner `i` lies in the triangle, or on its edge and goes inside from there.
    fn enters(&self, i: u32, [a, b, c]: [[f32; 2]; 3]) -> bool {
        let p = self.point(i);
        let beyond =
            |k: usize| (p[k] < a[k] && p[k] < b[k] && p[k] < c[k]) || (p[k] > a[k] && p[k] > b[k] && p[k] > c[k]);
        if beyond(0) || beyond(1) {
            return false;
        }
        let sides = [orient2d(a, b, p), orient2d(b, c, p), orient2d(c, a, p)];
        if sides.contains(&Ordering::Less) {
            return false;
        }
        let neighbours = [self.previous[i as usize], self.next[i as usize]].map(|i| self.point(i));
        // Sides on which p lies: none = inside, one = on that edge, two = at a corner. A neighbour strictly to the left of
        // these means that the outline runs through the inside.
        let on = sides.map(|side| side == Ordering::Equal);
        let inward = |n: [f32; 2]| {
            [(a, b), (b, c), (c, a)].iter().zip(on).all(|(&(from, to), on)| !on || orient2d(from, to, n).is_gt())
        };
        // A corner inside the new edge from c to a would leave an outline that touches itself there.
        on == [false, false, true] || neighbours.into_iter().any(inward)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn twice_area(points: &[[f32; 2]]) -> f64 {
        let n = points.len();
        (0..n).map(|i| cross(points[i], points[(i + 1) % n])).sum()
    }

    fn cross(p: [f32; 2], q: [f32; 2]) -> f64 {
        f64::from(p[0]) * f64::from(q[1]) - f64::from(p[1]) * f64::from(q[0])
    }

    /// Cuts an outline in the plane z = 0 and gives the triangles and the sums of their signed and absolute areas.
    fn areas(points: &[[f32; 2]]) -> (Vec<[u32; 3]>, Cut, f64, f64) {
        let corners: Vec<[f32; 3]> = points.iter().map(|p| [p[0], p[1], 0.0]).collect();
        let mut out = Vec::new();
        let how = cut(&corners, &mut out);
        let each: Vec<f64> = out.iter().map(|t| twice_area(&t.map(|i| points[i as usize]))).collect();
        (out, how, each.iter().sum(), each.iter().map(|x| x.abs()).sum())
    }

    /// Small whole coordinates, so that areas are exact: simple outlines must be covered once.
    fn covered_once(points: &[[f32; 2]], expect: Cut) {
        let (triangles, how, signed, absolute) = areas(points);
        assert_eq!((triangles.len(), how), (points.len() - 2, expect), "{points:?}");
        assert_eq!(signed, twice_area(points), "{points:?}");
        assert_eq!(absolute, signed.abs(), "{points:?} {triangles:?}");
    }

    #[test]
    fn convex_faces_are_fans() {
        let square = [[0., 0.], [2., 0.], [2., 2.], [0., 2.]];
        covered_once(&square, Cut::Fan);
        assert_eq!(areas(&square).0, [[0, 1, 2], [0, 2, 3]]);
        covered_once(&[[0., 0.], [1., 0.], [2., 0.], [2., 2.], [0., 2.], [0., 2.]], Cut::Fan);
        covered_once(&[[0., 2.], [2., 2.], [2., 0.], [0., 0.]], Cut::Fan);
    }

    #[test]
    fn concave_faces_are_clipped() {
        covered_once(&[[0., 0.], [4., 0.], [1., 1.], [0., 4.]], Cut::Clipped);
        covered_once(&[[0., 0.], [4., 0.], [4., 4.], [3., 4.], [3., 1.], [1., 1.], [1., 4.], [0., 4.]], Cut::Clipped);
        // Straight runs, also beside the concave corner, and a repeated one in it.
        let comb = [[0., 0.], [2., 0.], [4., 0.], [4., 4.], [3., 4.], [2., 4.], [2., 2.], [2., 2.], [2., 1.], [0., 1.]];
        covered_once(&comb, Cut::Clipped);
        let mirrored: Vec<[f32; 2]> = comb.iter().rev().copied().collect();
        covered_once(&mirrored, Cut::Clipped);
    }

    #[test]
    fn a_hole_joined_by_a_double_edge_stays_open() {
        let outline =
            [[0., 0.], [9., 0.], [9., 9.], [0., 9.], [0., 0.], [3., 3.], [3., 6.], [6., 6.], [6., 3.], [3., 3.]];
        covered_once(&outline, Cut::Clipped);
        let two = [
            [0., 0.],
            [9., 0.],
            [9., 9.],
            [0., 9.],
            [0., 0.],
            [1., 1.],
            [1., 2.],
            [2., 2.],
            [2., 1.],
            [1., 1.],
            [0., 0.],
            [6., 1.],
            [6., 3.],
            [8., 3.],
            [8., 1.],
            [6., 1.],
        ];
        covered_once(&two, Cut::Clipped);
    }

    #[test]
    fn nonsense_ends_with_the_right_count() {
        let star: Vec<[f32; 2]> = [[0., 3.], [-2., -3.], [3., 1.], [-3., 1.], [2., -3.]].to_vec();
        let bow = vec![[0., 0.], [2., 2.], [2., 0.], [0., 2.]];
        let line: Vec<[f32; 2]> = (0..9).map(|i| [(i * i % 7) as f32, 0.]).collect();
        let point = vec![[1., 1.]; 12];
        let spike = vec![[0., 0.], [4., 0.], [4., 9.], [4., 0.], [4., 4.], [0., 4.]];
        for points in [star, bow, line, point, spike] {
            let (triangles, _, signed, _) = areas(&points);
            assert_eq!((triangles.len(), signed), (points.len() - 2, twice_area(&points)), "{points:?}");
        }
    }

    /// A band of unit width wound outward; the ears lie at its two ends only.
    fn spiral(corners: usize) -> Vec<[f32; 2]> {
        let turn = |i: usize, inset: f32| {
            let r = (i / 4) as f32 * 4.0 + 8.0 - inset;
            [[r, -r + 4.0], [r, r], [-r, r], [-r, -r]][i % 4]
        };
        let n = corners / 2;
        (0..n).map(|i| turn(i, 0.0)).chain((0..n).rev().map(|i| turn(i, 1.0))).collect()
    }

    #[test]
    fn a_spiral_of_the_largest_size_is_clipped() {
        covered_once(&spiral(64), Cut::Clipped);
        let points = spiral(CLIP_LIMIT);
        covered_once(&points, Cut::Clipped);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(400))]

        /// Star-shaped outlines: corners sorted by angle around the origin, at random distances.
        #[test]
        fn random_simple_outlines_are_covered_once(mut points in prop::collection::vec((-50i32..50, -50i32..50), 4..40), start in 0usize..40) {
            points.retain(|&p| p != (0, 0));
            let angle = |p: &(i32, i32)| f64::from(p.1).atan2(f64::from(p.0));
            points.sort_by(|p, q| angle(p).total_cmp(&angle(q)));
            points.dedup_by(|p, q| (p.0 * q.1 - p.1 * q.0 == 0) && (p.0 * q.0 + p.1 * q.1 > 0));
            // Without a gap of half a turn, so that the origin is inside and the outline simple.
            let n = points.len();
            prop_assume!(n >= 3 && (0..n).all(|i| {
                let (p, q) = (points[i], points[(i + 1) % n]);
                p.0 * q.1 - p.1 * q.0 > 0
            }));
            points.rotate_left(start % n);
            let points: Vec<[f32; 2]> = points.iter().map(|p| [p.0 as f32, p.1 as f32]).collect();
            let (triangles, _, signed, absolute) = areas(&points);
            prop_assert_eq!(triangles.len(), n - 2);
            prop_assert_eq!(signed, twice_area(&points));
            prop_assert_eq!(absolute, signed);
        }

        /// Whatever the corners: the right count, each corner used, the signed area kept.
        #[test]
        fn random_outlines_keep_their_area(points in prop::collection::vec((-5i32..5, -5i32..5), 3..30)) {
            let points: Vec<[f32; 2]> = points.iter().map(|p| [p.0 as f32, p.1 as f32]).collect();
            let (triangles, _, signed, _) = areas(&points);
            prop_assert_eq!(triangles.len(), points.len() - 2);
            prop_assert_eq!(signed, twice_area(&points));
            prop_assert!((0..points.len() as u32).all(|i| triangles.iter().flatten().any(|&j| i == j)));
        }

        /// Planes that lie askew, and far away.
        #[test]
        fn askew_faces_are_clipped(u in prop::array::uniform3(-9i32..9), v in prop::array::uniform3(-9i32..9), far in 0i32..9000) {
            let outline = [[0, 0], [4, 0], [4, 4], [3, 4], [3, 1], [1, 1], [1, 4], [0, 4]];
            let place = |[s, t]: [i32; 2]| [0, 1, 2].map(|i| (far + s * u[i] + t * v[i]) as f32);
            let corners: Vec<[f32; 3]> = outline.into_iter().map(place).collect();
            prop_assume!(!crate::exact::exactly_degenerate(&[corners[0], corners[1], corners[7]].into()));
            let mut out = Vec::new();
            prop_assert_eq!(cut(&corners, &mut out), Cut::Clipped);
            let area = |t: [[i32; 2]; 3]| (t[1][0] - t[0][0]) * (t[2][1] - t[0][1]) - (t[1][1] - t[0][1]) * (t[2][0] - t[0][0]);
            let each: Vec<i32> = out.iter().map(|t| area(t.map(|i| outline[i as usize]))).collect();
            prop_assert_eq!(each.iter().map(|x| x.abs()).sum::<i32>(), 2 * (16 - 6));
        }
    }
}
