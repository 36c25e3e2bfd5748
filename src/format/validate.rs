//! Structural checks of a page: after them, no offset in it leads outside and no path loops.

use super::{Flags, PageHeader, PageId, PageRecord};

/// Checks an unpacked page against FORMAT.md: header, nodes, leaves, side arrays.
///
/// `materials` is the count of material records. The error says which rule is broken, and where. Linear in the page's
/// bytes, allocates at most a bit a leaf unit.
pub fn validate_page(
    bytes: &[u8],
    id: PageId,
    record: &PageRecord,
    flags: Flags,
    materials: u32,
    source_triangles: u64,
) -> Result<PageHeader, String> {
    let _ = (bytes, id, record, flags, materials, source_triangles);
    todo!()
}
