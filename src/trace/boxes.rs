//! Every stored triangle of a file, or those that touch a box, page by page in the order of storage.

use std::collections::HashSet;

use crate::error::Result;
use crate::exact::touches_box;
use crate::format::{Flags, Frame, Leaf, Node, PageId, Slot};
use crate::geometry::{Aabb, FaceId, Triangle, exp2};
use crate::map::{Octree, Page};

/// A triangle and where it is stored.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stored {
    /// The triangle.
    pub triangle: Triangle,
    /// Its face.
    pub face: FaceId,
    /// Its page.
    pub page: PageId,
    /// Its reference within the brick.
    pub reference: u32,
}

/// Calls `visit` for each triangle that touches the closed box (exactly: sharing one point counts), once each, until it errs.
///
/// Pages come in the order of the file, and only those whose brick touches the box are read; memory is bounded by the
/// answer's ids where the file stores triangles several times, and by a constant elsewhere. `None` means all triangles.
pub fn triangles_in_box(
    octree: &Octree,
    bounds: Option<Aabb>,
    visit: &mut dyn FnMut(Stored) -> Result<()>,
) -> Result<()> {
    // Which pages are left out depends on what the directory says of them.
    octree.check_top()?;
    let mut seen = octree.flags().has(Flags::REPEATS).then(HashSet::new);
    let region = bounds.map(|bounds| Region::new(octree, bounds));
    for number in 0..octree.bricks().len() as u32 {
        let brick = &octree.bricks()[number as usize];
        let frame = Frame { corner: brick.corner.map(f64::from), unit: brick.unit.map(f64::from) };
        if region.as_ref().is_some_and(|r| !r.touches(&frame, [0.0; 3], [256.0; 3])) {
            continue;
        }
        let id = PageId(number);
        octree.with_page(id, |page| {
            each_leaf(octree, &page, frame, region.as_ref(), &mut |leaf| {
                for j in 0..leaf.len() {
                    let reference = leaf.first().wrapping_add(j as u32);
                    let (triangle, face) = (leaf.triangle(j), page.face(reference));
                    let wanted = face != FaceId::NONE && bounds.is_none_or(|b| touches_box(&triangle, b));
                    if wanted && seen.as_mut().is_none_or(|seen| seen.insert(face)) {
                        visit(Stored { triangle, face, page: id, reference })?;
                    }
                }
                Ok(())
            })
        })??;
        octree.fault()?;
    }
    Ok(())
}

/// A box in root units, widened by the rounding of the conversion.
struct Region {
    min: [f64; 3],
    max: [f64; 3],
}

impl Region {
    fn new(octree: &Octree, bounds: Aabb) -> Region {
        let (min, max) = (octree.root().to_root_units(bounds.min), octree.root().to_root_units(bounds.max));
        let widen = |x: f64| (x.abs() + 1.0) * exp2(-48);
        Region { min: min.to_array().map(|x| x - widen(x)), max: max.to_array().map(|x| x + widen(x)) }
    }

    /// Whether the box may touch what lies between two planes of a frame on each axis.
    fn touches(&self, frame: &Frame, low: [f64; 3], high: [f64; 3]) -> bool {
        (0..3).all(|i| {
            let plane = |q: f64| frame.corner[i] + q * frame.unit[i];
            plane(low[i]) <= self.max[i] && self.min[i] <= plane(high[i])
        })
    }
}

/// Calls `visit` for the leaves of a page whose boxes may touch the region, in the order of storage of their nodes.
fn each_leaf<'a>(
    octree: &Octree,
    page: &Page<'a>,
    frame: Frame,
    region: Option<&Region>,
    visit: &mut dyn FnMut(Leaf<'a>) -> Result<()>,
) -> Result<()> {
    let nodes = page.nodes();
    // Children lie behind their parents and side by side, so no node is named twice and the list is bounded.
    let mut open = vec![(0usize, frame)];
    while let Some((number, frame)) = open.pop() {
        let node = nodes.get(number).unwrap_or(&Node::EMPTY);
        let mut inner = Vec::new();
        for slot in 0..8 {
            let plane = |planes: &[[u8; 8]; 3]| planes.map(|axis| f64::from(axis[slot]));
            let apart = region.is_some_and(|r| !r.touches(&frame, plane(&node.low), plane(&node.high)));
            match Slot::decode(node.slots[slot]) {
                _ if apart => {}
                Some(Slot::Inner(rank)) if node.first_child != 0 => {
                    inner.push((number + node.first_child as usize + usize::from(rank), frame.child(node, slot)));
                }
                Some(Slot::Leaf(units)) if node.first_leaf != 0 => {
                    let units = octree.leaf_unit().bytes() * usize::from(units);
                    visit(page.leaf(64 + 64 * number + 16 * node.first_leaf as usize + units))?;
                }
                _ => {}
            }
        }
        open.extend(inner.into_iter().rev());
    }
    Ok(())
}
