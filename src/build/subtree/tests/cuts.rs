//! Large triangles in several leaves.

use super::*;

/// A room of walls, each of two huge triangles, with long diagonal needles through it and small detailed objects in it.
fn room() -> Vec<BrickTriangle> {
    let corner = |i: usize| Vec3::new((i >> 2) as f32, (i >> 1 & 1) as f32, (i & 1) as f32) * 10.0;
    let walls = [[0, 1, 3, 2], [4, 5, 7, 6], [0, 1, 5, 4], [2, 3, 7, 6], [0, 2, 6, 4], [1, 3, 7, 5]];
    let walls = walls.into_iter().flat_map(|q| {
        let [a, b, c, d] = q.map(corner);
        [Triangle { a, b, c }, Triangle { a, b: c, c: d }]
    });
    let needles = (0..200).map(|i| {
        let x = i as f32 * 0.04;
        let end = Vec3::new(9.0 - x, 9.5, 0.5 + 8.0 * (x * 7.0).sin().abs());
        Triangle { a: Vec3::new(x, 0.5, 0.5), b: end, c: end + Vec3::splat(0.02) }
    });
    let objects = (0..8).flat_map(|i| {
        let place = corner(i) * 0.7 + Vec3::ONE;
        sheet(14).into_iter().map(move |t| {
            let [a, b, c] = t.triangle.vertices().map(|v| place + v);
            Triangle { a, b, c }
        })
    });
    numbered(walls.chain(needles).chain(objects))
}

/// The sum of the boxes' surfaces of all leaves: what rays that miss everything visit.
fn leaf_area(subtree: &Subtree) -> f64 {
    let mut boxes: Vec<_> = walk(subtree, LeafUnit::B16).0.iter().map(|s| s.bounds.corners()).collect();
    boxes.dedup();
    let area = |[min, max]: [[f64; 3]; 2]| {
        let d = DVec3::from_array(max) - DVec3::from_array(min);
        d.x * d.y + d.y * d.z + d.z * d.x
    };
    boxes.into_iter().map(area).sum()
}

#[test]
fn large_triangles_are_cut_where_it_pays() {
    let mesh = room();
    let whole_triangles = whole(&mesh, &options(SplitMode::Sah));
    let cut = SubtreeOptions { repeats: true, ..options(SplitMode::Sah) };
    let subtree = whole(&mesh, &cut);
    assert!(subtree.order.len() > mesh.len());
    let (before, after) = (leaf_area(&whole_triangles), leaf_area(&subtree));
    assert!(after < 0.7 * before, "{after} of {before}");
    check(&mesh, root_of(&mesh), &cut, &subtree);
    check_all_modes(&mesh);
    // In no leaf twice.
    let mut rest = &subtree.leaf_bytes[..];
    while !rest.is_empty() {
        let leaf = Leaf::parse(rest, LeafUnit::B16).unwrap();
        let first = leaf.first() as usize;
        let mut faces = subtree.order[first..first + leaf.len()].to_vec();
        faces.sort_unstable();
        faces.dedup();
        assert_eq!(faces.len(), leaf.len());
        rest = &rest[leaf.size(LeafUnit::B16)..];
    }
}

#[test]
fn evenly_sized_triangles_are_not_cut() {
    let mesh = sheet(60);
    let cut = SubtreeOptions { repeats: true, ..options(SplitMode::Sah) };
    assert_eq!(whole(&mesh, &cut), whole(&mesh, &options(SplitMode::Sah)));
}

#[test]
fn order_and_threads_do_not_matter_to_cuts() {
    let mesh = room();
    let mut turned = mesh.clone();
    turned.reverse();
    let cut = SubtreeOptions { repeats: true, ..options(SplitMode::Sah) };
    let pool = |n| rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap();
    let (a, b) = (pool(1).install(|| whole(&mesh, &cut)), pool(3).install(|| whole(&turned, &cut)));
    assert_eq!((a.nodes, a.leaf_bytes), (b.nodes, b.leaf_bytes));
    let faces =
        |mesh: &[BrickTriangle], order: &[u32]| order.iter().map(|&i| mesh[i as usize].face).collect::<Vec<_>>();
    assert_eq!(faces(&mesh, &a.order), faces(&turned, &b.order));
}
