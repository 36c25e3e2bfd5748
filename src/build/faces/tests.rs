//! Blocks of faces give back what went in.

use super::*;
use crate::build::work::WorkFolder;

fn work() -> WorkFolder {
    WorkFolder::new(&std::env::temp_dir(), "faces_test.oct".as_ref(), true).unwrap()
}

fn faces(work: &WorkFolder, block_corners: usize) -> Faces<'_> {
    Faces::new(Spool::new(work, "faces", 1 << 20), block_corners)
}

/// Id, size, corners, texture coordinate numbers, material.
type Face = (u32, u32, Vec<u32>, Vec<u32>, u32);

fn read_all(faces: &mut Faces<'_>) -> Vec<Face> {
    faces.flush().unwrap();
    let mut all = vec![];
    for block in 0..faces.blocks() {
        let block = faces.load(block).unwrap();
        let view = block.view();
        let count = if view.sizes.is_empty() { view.corners.len() / 3 } else { view.sizes.len() };
        let (mut id, mut corner) = (view.first_id, 0);
        for face in 0..count {
            let size = view.sizes.get(face).copied().unwrap_or(3);
            let range = corner..corner + corners_of(size);
            let material = view.materials.chunks(2).rfind(|m| m[0] <= face as u32).map_or(0, |m| m[1]);
            let texcoords = view.texcoords.get(range.clone()).unwrap_or_default().to_vec();
            all.push((id, size, view.corners[range.clone()].to_vec(), texcoords, material));
            (id, corner) = (id + triangles_of(size), range.end);
        }
    }
    all
}

#[test]
fn blocks_keep_ids_sizes_materials_and_attributes() {
    let gap = FaceBatch::GAP | 5;
    let batches = [
        FaceBatch { corners: (0..9).collect(), ..Default::default() },
        FaceBatch {
            sizes: vec![4, gap, 3],
            corners: (10..17).collect(),
            texcoords: (20..27).collect(),
            materials: vec![(0, 2), (2, 1)],
            ..Default::default()
        },
        FaceBatch { corners: (30..42).collect(), materials: vec![(0, 1), (3, 7)], ..Default::default() },
    ];
    let mut expected = vec![];
    for limit in [1000, 3, 4, 7] {
        let work = work();
        let mut faces = faces(&work, limit);
        batches.iter().for_each(|batch| faces.append(batch).unwrap());
        let mut all = read_all(&mut faces);
        all.iter_mut().for_each(|face| face.3.retain(|&t| t != NO_INDEX));
        assert_eq!(faces.triangles(), 3 + 2 + 5 + 1 + 4);
        assert!(faces.has_materials && faces.has_texcoords && !faces.has_normals);
        assert_eq!(all[3], (3, 4, vec![10, 11, 12, 13], vec![20, 21, 22, 23], 2));
        assert_eq!(all[4], (5, gap, vec![], vec![], 2));
        assert_eq!(all[5], (10, 3, vec![14, 15, 16], vec![24, 25, 26], 1));
        assert_eq!(all.iter().map(|face| face.4).collect::<Vec<_>>(), [0, 0, 0, 2, 2, 1, 1, 1, 1, 7]);
        if expected.is_empty() {
            expected = all.clone();
        }
        assert_eq!(all, expected);
    }
}

#[test]
fn arrays_that_do_not_fit_are_refused() {
    let work = work();
    let mut faces = faces(&work, 9);
    assert!(faces.append(&FaceBatch { corners: vec![1, 2], ..Default::default() }).is_err());
    let sizes = vec![4];
    assert!(faces.append(&FaceBatch { sizes, corners: vec![1, 2, 3], ..Default::default() }).is_err());
    let normals = vec![1];
    assert!(faces.append(&FaceBatch { corners: vec![1, 2, 3], normals, ..Default::default() }).is_err());
}

#[test]
fn large_faces_become_fans_in_small_blocks() {
    let n = CLIP_LIMIT as u32 + 5;
    let batch = FaceBatch {
        sizes: vec![3, n, 4],
        corners: (0..n + 7).collect(),
        normals: (100..n + 107).collect(),
        materials: vec![(0, 1), (1, 2), (2, 3)],
        ..Default::default()
    };
    for limit in [100, 1 << 18] {
        let work = work();
        let mut faces = faces(&work, limit);
        faces.append(&batch).unwrap();
        assert_eq!(faces.large, [LargeFace { first_id: 1, triangles: n - 2 }]);
        assert_eq!((faces.triangles(), faces.corners()), (u64::from(n) + 1, u64::from(3 * (n - 2)) + 7));
        let all = read_all(&mut faces);
        assert_eq!(all.len() as u32, n);
        assert_eq!((all[0].0, &all[0].2, all[0].4), (0, &vec![0, 1, 2], 1));
        for (i, face) in (1..).zip(&all[1..all.len() - 1]) {
            assert_eq!((face.0, face.1, &face.2, face.4), (i, 3, &vec![3, 3 + i, 4 + i], 2));
        }
        let last = &all[all.len() - 1];
        assert_eq!((last.0, last.1, &last.2, last.4), (n - 1, 4, &(n + 3..n + 7).collect(), 3));
        assert!((0..faces.blocks()).all(|block| faces.load(block).unwrap().view().corners.len() < 2 * limit + 6));
    }
}
