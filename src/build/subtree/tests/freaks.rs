//! Meshes that nobody would draw.

use super::*;

#[test]
fn identical_triangles_end() {
    let t = triangle([[0.0, 0.0, 0.1], [1.0, 0.2, 0.3], [0.3, 1.0, 0.7]]);
    for n in [17, 33, 5000] {
        check_all_modes(&numbered(vec![t; n]));
    }
}

#[test]
fn stacks_and_books_do_not_explode() {
    // A stack of all but identical triangles, and the pages of a book around one spine.
    let stack = numbered((0..2000).map(|i| {
        let z = 0.5 + i as f32 * 1e-6;
        triangle([[0.0, 0.0, z], [1.0, 0.0, z], [0.0, 1.0, z]])
    }));
    let book = numbered((0..2000).map(|i| {
        let angle = i as f32 * 1e-3;
        triangle([[0.1, 0.1, 0.0], [0.1, 0.1, 1.0], [0.1 + angle.cos(), 0.1 + angle.sin(), 0.5]])
    }));
    for mesh in [stack, book] {
        let strict = SubtreeOptions { cell: 1, ..options(SplitMode::Strict) };
        let subtree = whole(&mesh, &strict);
        assert!(subtree.order.len() <= 32 * mesh.len());
        check(&mesh, root_of(&mesh), &strict, &subtree);
        check_all_modes(&mesh);
    }
}

#[test]
fn a_fan_around_one_vertex() {
    let spoke = |i: u32| {
        let angle = i as f32 * std::f32::consts::TAU / 3000.0;
        [0.3 + angle.cos(), 0.3 + angle.sin(), 0.1 * (5.0 * angle).sin()]
    };
    let mesh = numbered((0..3000).map(|i| triangle([[0.3, 0.3, 0.7], spoke(i), spoke(i + 1)])));
    check_all_modes(&mesh);
    let strict = whole(&mesh, &SubtreeOptions { cell: 1, ..options(SplitMode::Strict) });
    assert!(strict.order.len() <= 32 * mesh.len());
}

#[test]
fn extreme_coordinates() {
    let (m, d) = (f32::MAX, 1e-45f32);
    let huge = [
        triangle([[-m, -m, 0.0], [m, -m, 0.0], [0.0, m, m]]),
        triangle([[-m, m, -m], [m, m, -m], [0.0, -m, m]]),
        triangle([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, d]]),
        triangle([[d, 0.0, 0.0], [0.0, d, 0.0], [0.0, 0.0, d]]),
    ];
    check_all_modes(&numbered(huge.into_iter().cycle().take(100)));
    let denormal = (0..60u32).map(|i| {
        let x = f32::from_bits(i);
        triangle([[x, 0.0, 0.0], [f32::from_bits(i + 1), f32::from_bits(3 * i), d], [x, 5.0 * d, d]])
    });
    check_all_modes(&numbered(denormal));
    // Flat, far from the origin, with a side that is nothing beside its place.
    let far = (0..60u32)
        .map(|i| triangle([[1e30, f32::from_bits(i), 0.0], [1e30, f32::from_bits(i + 2), 0.0], [1e30, 0.0, d]]));
    check_all_modes(&numbered(far));
}

#[test]
fn needles_giants_and_dust_together() {
    let dust = sheet(12).into_iter().map(|t| Triangle {
        a: t.triangle.a * 1e-4 + Vec3::splat(0.37),
        b: t.triangle.b * 1e-4 + Vec3::splat(0.37),
        c: t.triangle.c * 1e-4 + Vec3::splat(0.37),
    });
    let needles = (0..40).map(|i| {
        let x = i as f32 * 0.02;
        triangle([[x, 0.0, 0.0], [x + 1e-7, 0.0, 0.0], [1.0 - x, 1.0, 1.0]])
    });
    let giants = (0..30).map(|i| {
        let x = i as f32 * 10.0;
        triangle([[-1e4, x, -1e4], [1e4, -x, -1e4], [0.0, 0.5, 1e4]])
    });
    check_all_modes(&numbered(dust.chain(needles).chain(giants)));
}

#[test]
fn growing_triangles_stay_shallow() {
    // Each twice as large and as far away as the one before: splits peel them off one by one.
    let mesh = numbered((0..240).map(|i| {
        let s = 2f32.powi(i - 120);
        triangle([[s, 0.0, 0.0], [2.0 * s, 0.0, 0.0], [s, s, s]])
    }));
    let subtree = whole(&mesh, &SubtreeOptions { leaf: 1, ..options(SplitMode::Sah) });
    assert!(subtree.depth <= 40, "{}", subtree.depth);
    check_all_modes(&mesh);
}
