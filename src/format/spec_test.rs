//! FORMAT.md is what the records are: its tables against the offsets of the structs.

use std::mem::offset_of;

use super::{Brick, Header, MaterialRecord, Node, PageHeader, PageRecord, Surrogate};

/// The rows of the first table below a heading: the byte offsets of the first column, and the words of the last.
fn rows(heading: &str) -> Vec<(Vec<usize>, String)> {
    let text = include_str!("FORMAT.md");
    let section = text.split("\n## ").find(|s| s.starts_with(heading)).expect("a heading of FORMAT.md");
    let lines = section.lines().skip_while(|l| !l.starts_with('|')).take_while(|l| l.starts_with('|'));
    let row = |line: &str| {
        let cells: Vec<_> = line.trim_matches('|').split('|').map(str::trim).collect();
        let number = |part: &str| part.split('-').next().unwrap().trim().parse().unwrap();
        (cells[0].split(',').map(number).collect(), cells[cells.len() - 1].to_owned())
    };
    lines.skip(2).map(row).collect()
}

/// Each row must begin where the field does that its words name; every row and every field once.
fn compare(heading: &str, fields: &[(usize, &str)]) {
    let mut left = fields.to_vec();
    for (offsets, words) in rows(heading) {
        for offset in offsets {
            let place = left.iter().position(|(at, name)| *at == offset && words.contains(name));
            let place = place.unwrap_or_else(|| panic!("{heading}: byte {offset} ({words}) is no field"));
            left.remove(place);
        }
    }
    assert!(left.is_empty(), "{heading}: not in the table: {left:?}");
}

#[test]
fn header() {
    let dropped = offset_of!(Header, dropped);
    compare(
        "Header page",
        &[
            (offset_of!(Header, magic), "magic"),
            (offset_of!(Header, version), "version"),
            (offset_of!(Header, flags), "flags"),
            (offset_of!(Header, file_bytes), "file bytes"),
            (offset_of!(Header, triangles), "triangles"),
            (offset_of!(Header, references), "references"),
            (offset_of!(Header, source_triangles), "source triangles"),
            (offset_of!(Header, vertices), "vertices"),
            (offset_of!(Header, nodes), "nodes"),
            (offset_of!(Header, leaves), "leaves"),
            (offset_of!(Header, pages), "pages"),
            (offset_of!(Header, top_nodes), "top nodes"),
            (offset_of!(Header, materials), "materials"),
            (offset_of!(Header, depth), "depth"),
            (offset_of!(Header, root_corner), "lowest corner"),
            (offset_of!(Header, origin), "origin"),
            (offset_of!(Header, root_log2_side), "log2 of its side"),
            (offset_of!(Header, bounds_min), "bounds, lowest"),
            (offset_of!(Header, bounds_max), "bounds, highest"),
            (offset_of!(Header, largest_page), "largest page"),
            (offset_of!(Header, brick_limit), "brick limit"),
            (offset_of!(Header, cell_limit), "cell limit"),
            (dropped + offset_of!(super::Dropped, degenerate), "degenerate"),
            (dropped + offset_of!(super::Dropped, non_finite), "not finite"),
            (dropped + offset_of!(super::Dropped, bad_index), "bad index"),
            (dropped + offset_of!(super::Dropped, too_few_corners), "fewer than three"),
            (offset_of!(Header, split), "split mode"),
            (offset_of!(Header, leaf_limit), "leaf limit"),
            (offset_of!(Header, depth_limit), "depth limit"),
            (offset_of!(Header, zero0), "zero"),
            (offset_of!(Header, sections), "section directory"),
            (offset_of!(Header, zero1), "zero"),
            (offset_of!(Header, checksum), "XXH3-64"),
        ],
    );
}

#[test]
fn records() {
    compare(
        "Brick",
        &[
            (offset_of!(Brick, node), "root node"),
            (offset_of!(Brick, first_reference), "first reference"),
            (offset_of!(Brick, corner), "corner"),
            (offset_of!(Brick, unit), "unit"),
        ],
    );
    compare(
        "Page record",
        &[
            (offset_of!(PageRecord, offset), "offset"),
            (offset_of!(PageRecord, checksum), "XXH3-64"),
            (offset_of!(PageRecord, stored_bytes), "stored bytes"),
            (offset_of!(PageRecord, bytes), "unpacked"),
            (offset_of!(PageRecord, references), "references"),
            (offset_of!(PageRecord, zero), "zero"),
        ],
    );
    compare(
        "Material",
        &[
            (offset_of!(MaterialRecord, ka), "Ka"),
            (offset_of!(MaterialRecord, kd), "Kd"),
            (offset_of!(MaterialRecord, ks), "Ks"),
            (offset_of!(MaterialRecord, ns), "Ns"),
            (offset_of!(MaterialRecord, ni), "Ni"),
            (offset_of!(MaterialRecord, d), "d"),
            (offset_of!(MaterialRecord, illum), "illum"),
            (offset_of!(MaterialRecord, given), "given"),
            (offset_of!(MaterialRecord, name), "name"),
            (offset_of!(MaterialRecord, name) + 4, "name"),
            (offset_of!(MaterialRecord, map_kd), "map_Kd"),
            (offset_of!(MaterialRecord, map_kd) + 4, "map_Kd"),
            (offset_of!(MaterialRecord, zero), "zero"),
        ],
    );
}

#[test]
fn surrogate() {
    compare(
        "Surrogate",
        &[
            (offset_of!(Surrogate, normal), "normal"),
            (offset_of!(Surrogate, offset), "plane"),
            (offset_of!(Surrogate, deviation), "deviation"),
            (offset_of!(Surrogate, cone), "cone"),
            (offset_of!(Surrogate, coverage), "coverage"),
            (offset_of!(Surrogate, agreement), "agreement"),
            (offset_of!(Surrogate, color), "colour"),
            (offset_of!(Surrogate, zero), "zero"),
        ],
    );
}

#[test]
fn page_and_node() {
    compare(
        "Page\n",
        &[
            (offset_of!(PageHeader, page), "number"),
            (offset_of!(PageHeader, nodes), "nodes N"),
            (offset_of!(PageHeader, leaf_offset), "offset of the leaves"),
            (offset_of!(PageHeader, leaf_bytes), "bytes of the leaves"),
            (offset_of!(PageHeader, references), "references R"),
            (offset_of!(PageHeader, leaves), "leaves"),
            (offset_of!(PageHeader, ids), "offset of ids"),
            (offset_of!(PageHeader, materials), "material numbers"),
            (offset_of!(PageHeader, normal_corners), "normal corners"),
            (offset_of!(PageHeader, normals), "normal table"),
            (offset_of!(PageHeader, normal_count), "normals"),
            (offset_of!(PageHeader, texcoord_corners), "texture corners"),
            (offset_of!(PageHeader, texcoords), "texture coordinate table"),
            (offset_of!(PageHeader, texcoord_count), "texture coordinates"),
            (offset_of!(PageHeader, surrogates), "surrogates"),
            (offset_of!(PageHeader, zero), "zero"),
        ],
    );
    let (low, high) = (offset_of!(Node, low), offset_of!(Node, high));
    compare(
        "Node",
        &[
            (low, "low plane"),
            (low + 8, "low plane"),
            (low + 16, "low plane"),
            (high, "high plane"),
            (high + 8, "high plane"),
            (high + 16, "high plane"),
            (offset_of!(Node, first_child), "first inner child"),
            (offset_of!(Node, first_leaf), "first leaf"),
            (offset_of!(Node, slots), "a slot"),
        ],
    );
}
