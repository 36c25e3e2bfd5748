//! The canonical order of a brick's triangles, so that what is built depends on the set of them alone.

use super::BrickTriangle;
use super::cell::cell_of;
use super::record::bits;
use crate::geometry::{Aabb, RootCube};

/// The numbers of the triangles in canonical order: by Morton code, then face; by their bits where even that is the same. And the
/// codes, by number.
pub(super) fn sort(triangles: &[BrickTriangle], root: RootCube) -> (Vec<u32>, Vec<u64>) {
    let codes: Vec<u64> = triangles.iter().map(|t| cell_of(root, Aabb::from(&t.triangle))).collect();
    // Code and number in one word each. In a brick most leading bits of codes are the same, so that few of the last
    // ones, if any, find no room; what is the same without those is put in order afterwards.
    let differing = codes.iter().fold(0, |bits, code| bits | code ^ codes[0]);
    let code_bits = u64::BITS - differing.leading_zeros();
    let number_bits = usize::BITS - (triangles.len() - 1).leading_zeros();
    let dropped = (code_bits + number_bits).saturating_sub(u64::BITS);
    let leading = |code: u64| (code & ((1 << code_bits) - 1)) >> dropped << number_bits;
    let mut keys: Vec<u64> = (0u64..).zip(&codes).map(|(number, &code)| leading(code) | number).collect();
    keys.sort_unstable();
    let mut order: Vec<u32> = keys.iter().map(|key| (key & ((1 << number_bits) - 1)) as u32).collect();
    let corners = |t: &BrickTriangle| t.triangle.vertices().map(bits);
    let compare = |a: &u32, b: &u32| {
        let [(code, t), (other, u)] = [a, b].map(|&i| (codes[i as usize], &triangles[i as usize]));
        (code, t.face).cmp(&(other, u.face)).then_with(|| corners(t).cmp(&corners(u))).then(a.cmp(b))
    };
    let mut rest = &mut order[..];
    for run in keys.chunk_by(|a, b| a >> number_bits == b >> number_bits) {
        let (same, after) = std::mem::take(&mut rest).split_at_mut(run.len());
        if same.len() > 1 {
            same.sort_unstable_by(compare);
        }
        rest = after;
    }
    (order, codes)
}

#[cfg(test)]
mod tests {
    use glam::Vec3;
    use proptest::prelude::*;

    use super::*;
    use crate::geometry::Triangle;

    proptest! {
        /// Few places, so that much is the same; and coordinates of any fineness, so that codes differ in any bits.
        #[test]
        fn triangles_stand_by_code_then_face_then_bits(
            list in prop::collection::vec((any::<prop::sample::Index>(), 0u32..4, any::<bool>()), 1..300),
            places in prop::collection::vec(prop::array::uniform3(0.0f32..1.0), 1..40),
            exponent in 0i32..22,
        ) {
            let triangle = |(place, face, turned): &(prop::sample::Index, u32, bool)| {
                let a = Vec3::from_array(*place.get(&places)) * 2f32.powi(-exponent);
                let (b, c) = (a + Vec3::X * 1e-9, a + Vec3::Y * 1e-9);
                let triangle = if *turned { Triangle { a: b, b: c, c: a } } else { Triangle { a, b, c } };
                BrickTriangle { triangle, face: *face }
            };
            let list: Vec<BrickTriangle> = list.iter().map(triangle).collect();
            let root = RootCube::around(Aabb { min: Vec3::ZERO, max: Vec3::ONE });
            let key = |i: u32| {
                let t = &list[i as usize];
                (cell_of(root, Aabb::from(&t.triangle)), t.face, t.triangle.vertices().map(bits), i)
            };
            let (order, codes) = sort(&list, root);
            prop_assert!((0u32..).zip(&codes).all(|(i, &code)| code == key(i).0));
            let mut expected: Vec<u32> = (0..list.len() as u32).collect();
            expected.sort_by_key(|&i| key(i));
            prop_assert_eq!(order, expected);
        }
    }
}
