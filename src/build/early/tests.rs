//! Cuts alone; whole builds with cuts are in the builder's tests.

use dashu_ratio::RBig;
use glam::Vec3;
use proptest::prelude::*;

use super::super::grid::Placement;
use super::super::record::Record;
use super::super::tests::{TINY, roomy};
use super::super::work::WorkFolder;
use super::*;
use crate::geometry::RootCube;

#[test]
fn classes_rise_with_what_is_spared() {
    assert_eq!([1.0, 0.99, 0.5, 0.49, 0.25].map(class_of), [95, 95, 92, 91, 88]);
    // The least cut of all: what reaches out of the least cell by the slack.
    let least = SLACK * 4f64.powi(-(FINEST as i32));
    assert!(class_of(least) > 0 && class_of(0.0) == 0);
}

#[test]
fn references_stay_below_the_highest_number() {
    assert_eq!([0, 400, 1 << 30].map(most_cuts), [0, 100, 1 << 28]);
    let most = u64::from(u32::MAX - 1);
    assert_eq!([most - 5, most, most + 1].map(most_cuts), [5, 0, 0]);
}

fn early(root: RootCube, limit: u32, block_cuts: usize, tuning: &Tuning) -> Early<'_> {
    let placement = Placement { root, split: SplitMode::Sah };
    Early {
        rule: BrickRule { placement, limit, depth: morton::BITS },
        layout: Layout::default(),
        longest: f32::MAX,
        block_cuts,
        tuning,
        monitor: Monitor::silent(),
    }
}

/// 256 triangles of falling size, which make up a block, and then small ones all over their cube.
fn giants_and_grains() -> (Vec<Triangle>, RootCube) {
    let giant = |i: usize| {
        let (size, z) = (0.93f32.powi(i as i32), i as f32 / 256.0);
        let corner = Vec3::new(0.1 * z, 0.2 * (1.0 - z), z);
        Triangle {
            a: corner,
            b: corner + size * Vec3::new(0.8, 0.05, 0.0),
            c: corner + size * Vec3::new(0.3, 0.7, 0.01),
        }
    };
    let grain = |i: usize| {
        let corner = [i % 16, i / 16 % 16, i / 256].map(|x| (x as f32 + 0.3) / 16.0).into();
        Triangle { a: corner, b: corner + Vec3::X / 64.0, c: corner + Vec3::Y / 64.0 }
    };
    let cube = Aabb { min: Vec3::ZERO, max: Vec3::ONE };
    ((0..256).map(giant).chain((0..4096).map(grain)).collect(), RootCube::around(cube))
}

/// Records of triangles in a spool.
fn spooled<'w>(triangles: &[Triangle], work: &'w WorkFolder) -> Spool<'w> {
    let mut words = Vec::new();
    for (id, triangle) in (0..).zip(triangles) {
        let corners = triangle.vertices().map(|v| v.to_array());
        let record = Record { corners, id, material: 0, normals: [[f32::NAN; 3]; 3], texcoords: [[f32::NAN; 2]; 3] };
        Layout::default().write(&record, &mut words);
    }
    let mut spool = Spool::new(work, "records", words.len());
    spool.append(&words).unwrap();
    spool
}

#[test]
fn of_a_block_with_too_many_cuts_whole_classes_are_made() {
    let folder = tempfile::tempdir().unwrap();
    let work = WorkFolder::new(folder.path(), "a.oct".as_ref(), true).unwrap();
    let (triangles, root) = giants_and_grains();
    let spool = spooled(&triangles, &work);
    let extents = [Extent { at: 0, words: spool.len() }];
    let records = Records { spool: &spool, extents: &extents, layout: Layout::default() };
    let made = |tuning: &Tuning, block_cuts: usize| {
        let early = early(root, 16, block_cuts, tuning);
        let mut cuts = Cuts { early: &early, grid: early.count(records).unwrap(), least: CLASSES };
        cuts.least = cuts.lowest_class(records, u64::MAX).unwrap();
        let parts = cuts.write(&spool, Spool::new(&work, "parts", 0)).unwrap();
        let mut words = vec![0; parts.len() as usize];
        parts.read(0, &mut words).unwrap();
        let (counts, from) = cuts.worth(&spool.memory().unwrap()[..256 * Layout::default().words()]);
        (cuts.least, counts, from, words)
    };
    let (least, counts, from, words) = made(&roomy(), 8);
    let (all_least, all, all_from, _) = made(&roomy(), BLOCK_CUTS);
    assert!(all_from == 0 && all_least < least, "all cuts are counted: from {all_from}, {all_least} against {least}");
    assert!(
        from > 0 && least >= from && least < CLASSES && counts.iter().sum::<u64>() == 8,
        "{least} {from} {counts:?}"
    );
    assert_eq!(counts[from..], all[from..], "classes that are counted are counted to the end");
    let parts = words.len() / Layout { parts: true, ..Layout::default() }.words();
    assert_eq!((parts - triangles.len()) as u64, all[least..].iter().sum::<u64>(), "and made to the end");
    assert!(words == made(&TINY, 8).3, "whatever the memory");
}

fn exact(x: f32) -> RBig {
    RBig::try_from(x).expect("finite")
}

/// i, j and k 256ths of the corners, exactly.
fn point(triangle: &Triangle, [i, j]: [u16; 2]) -> [RBig; 3] {
    let weights = [i, j, 256 - i - j].map(RBig::from);
    let [a, b, c] = triangle.vertices().map(|v| v.to_array().map(exact));
    std::array::from_fn(|k| (&weights[0] * &a[k] + &weights[1] * &b[k] + &weights[2] * &c[k]) / RBig::from(256u16))
}

fn holds(part: &Aabb, p: &[RBig; 3]) -> bool {
    (0..3).all(|k| exact(part.min[k]) <= p[k] && p[k] <= exact(part.max[k]))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(96))]

    /// Whatever is cut: every point of a triangle lies in the box of one of its parts, and these in the box of the whole.
    #[test]
    fn parts_cover_their_triangle(
        p in prop::array::uniform9(0.0f32..1.0), place in prop::sample::select(vec![(0.0, 1.0), (1e6, 100.0), (-1e6, 1.0), (0.0, 1e-30), (0.0, 1e30)]),
        flat in any::<bool>(), grains in prop::collection::vec(prop::array::uniform3(0.0f32..1.0), 0..60),
        limit in 1u32..4, depth in 2u32..6, least in prop::sample::select(vec![0usize, 60, 80, 88]),
        points in prop::collection::vec((0u16..=256, 0u16..=256), 12),
    ) {
        let (offset, scale) = place;
        let at = |p: [f32; 3]| scale * Vec3::from(p) + Vec3::splat(offset);
        let corner = |i: usize| at([p[i], p[i + 1], if flat { 0.5 } else { p[i + 2] }]);
        let triangle = Triangle { a: corner(0), b: corner(3), c: corner(6) };
        let root = RootCube::around(Aabb { min: at([0.0; 3]), max: at([1.0; 3]) });
        let tuning = roomy();
        let early = early(root, limit, BLOCK_CUTS, &tuning);
        let mut grid = Grid::new(CellCode::ROOT, depth);
        grains.iter().map(|&p| Aabb { min: at(p), max: at(p) }).for_each(|grain| grid.count_box(grain, root));
        grid.sum_up();
        let whole = Aabb::from(&triangle);
        let mut parts = Vec::new();
        Cuts { early: &early, grid, least }.parts(&triangle, whole, &mut |part| parts.push(part));
        for part in &parts {
            prop_assert!(whole.min.cmple(part.min).all() && part.min.cmple(part.max).all() && part.max.cmple(whole.max).all());
        }
        let corners = [[256, 0], [0, 256], [0, 0]];
        for weights in corners.into_iter().chain(points.into_iter().map(|(i, j)| [i, j * (256 - i) / 256])) {
            let p = point(&triangle, weights);
            prop_assert!(parts.iter().any(|part| holds(part, &p)), "{weights:?} of {triangle:?} is in none of {} parts", parts.len());
        }
    }
}
