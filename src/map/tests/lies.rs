//! Files whose checksums are right and whose content is not.

use super::*;

/// Changes page 1, which begins at that place of the file's bytes, and puts all checksums right; what is said then.
fn said_of_page(change: impl FnOnce(&mut [u8], usize)) -> String {
    let (_folder, path) = scratch();
    Sample::new(60, ALL, 2).write(&path);
    let mut bytes = fs::read(&path).unwrap();
    let header: Header = bytemuck::pod_read_unaligned(&bytes[..4096]);
    let place = header.section(SectionKind::Pages).unwrap().offset as usize + 32;
    let mut record: PageRecord = bytemuck::pod_read_unaligned(&bytes[place..place + 32]);
    let page = record.offset as usize;
    change(&mut bytes, page);
    record.checksum = checksum(&bytes[page..][..record.bytes as usize]);
    bytes[place..place + 32].copy_from_slice(bytemuck::bytes_of(&record));
    repair(&mut bytes);
    fs::write(&path, &bytes).unwrap();
    fate(&path).unwrap().to_string()
}

#[test]
fn geometry_outside_its_box_is_found() {
    // Slot 2 of page 1's first node becomes half as wide.
    let said = said_of_page(|bytes, page| {
        let node = page + PAGE_HEADER_BYTES;
        bytes[node + 26] = bytes[node + 2] + (bytes[node + 26] - bytes[node + 2]).div_ceil(2);
    });
    assert!(said.contains("page 1: node 0, slot 2: a triangle lies outside"), "{said}");
}

/// Changes a byte of page 1 that lies so far behind `part`; what is said then.
fn lie_in_a_page(part: impl Fn(&PageHeader) -> u32, behind: usize, value: u8) -> String {
    said_of_page(|bytes, page| {
        let begin = part(&bytemuck::pod_read_unaligned(&bytes[page..page + 64])) as usize;
        bytes[page + begin + behind] = value;
    })
}

#[test]
fn lies_about_level_of_detail_are_found() {
    // The color of the root, which its head has otherwise; then a plane at the very corner with all of the brick far from it.
    let said = lie_in_a_page(|h| h.surrogates, 12, 7);
    assert!(said.contains("page 1: its head is not what the page has"), "{said}");
    let (_folder, path) = scratch();
    Sample::new(600, ALL, 2).write(&path);
    let octree = Octree::open(&path).unwrap();
    let visited = octree.visit();
    let (page, detail) = (visited.page(PageId(1)).unwrap(), octree.detail().unwrap().unwrap());
    let head = detail.head(PageId(1)).unwrap();
    assert_eq!((head.nodes().len(), head.surrogates().len()), (9, 9), "{:?}", page.header());
    assert!(detail.top(0).is_some() && detail.top(1).is_none() && detail.head(PageId(2)).is_none());
    // Beyond the head: a slab as thin as a step.
    assert!(page.surrogates().len() >= 9);
    let said = lie_in_a_page(|h| h.surrogates, 6, 0);
    assert!(said.contains("page 1: "), "{said}");
}

#[test]
fn wrong_sums_in_the_header_are_found() {
    let (_folder, path) = scratch();
    Sample::new(60, ALL, 2).write(&path);
    let sound = fs::read(&path).unwrap();
    type Change = (&'static str, fn(&mut Header));
    let changes: [Change; 4] = [
        ("nodes", |h| h.nodes += 1),
        ("leaves", |h| h.leaves -= 1),
        ("levels", |h| h.depth += 1),
        ("bounds", |h| h.bounds_max[1] += 1.0),
    ];
    for (what, change) in changes {
        let mut bytes = sound.clone();
        let mut header: Header = bytemuck::pod_read_unaligned(&bytes[..4096]);
        change(&mut header);
        bytes[..4096].copy_from_slice(bytemuck::bytes_of(&header));
        repair(&mut bytes);
        fs::write(&path, &bytes).unwrap();
        let error = fate(&path).unwrap().to_string();
        assert!(error.contains(what), "{error}");
    }
}
