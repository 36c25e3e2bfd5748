//! The map as a drawing: a bar a level, histograms of how full pages and leaves are, and what the whole file's bytes are for.

use indicatif::HumanCount;
use octrace::format::LEAF_MAX;
use octrace::map::Octree;
use octrace::output::drawing::{Anchor, Drawing, Rgb, Text};

use super::census::{Census, FILL_BINS, KINDS, Level};

const SIZE: [f32; 2] = [1200.0, 800.0];
/// The bars of the levels: left, right, top, bottom.
const LEVELS: [f32; 4] = [432.0, 1000.0, 128.0, 462.0];
/// Where the columns before them end: level, pages, nodes, leaves, triangles.
const COLUMNS: [(&str, f32); 5] =
    [("level", 66.0), ("pages", 138.0), ("nodes", 224.0), ("leaves", 310.0), ("triangles", 412.0)];
/// Deepest level with a bar of its own; those below share one.
const DEEPEST: usize = 20;
const KIND_NAMES: f32 = 1052.0;
/// The histograms of pages and of leaves, and the bars of the whole file.
const PAGES: [f32; 4] = [96.0, 400.0, 574.0, 720.0];
const LEAVES: [f32; 4] = [496.0, 780.0, 574.0, 720.0];
const WHOLE: [f32; 4] = [960.0, 1040.0, 562.0, 770.0];

const GRID: Rgb = [0xe4; 3];
const AXIS: Rgb = [0x55; 3];
const BAR: Rgb = [0x56, 0x7d, 0xa6];
/// Of [`KINDS`]: colours that most people can tell apart (Okabe and Ito 2008).
const COLORS: [Rgb; KINDS.len()] = [
    [0x00, 0x72, 0xb2],
    [0xe6, 0x9f, 0x00],
    [0x56, 0xb4, 0xe9],
    [0x00, 0x9e, 0x73],
    [0xcc, 0x79, 0xa7],
    [0xd5, 0x5e, 0x00],
    [0x77, 0x77, 0x77],
];

/// Draws what was counted.
pub fn draw(octree: &Octree, census: &Census) -> Drawing {
    let mut drawing = Drawing::new(SIZE);
    let header = octree.header();
    let name = octree.path().file_name().unwrap_or_default().to_string_lossy().into_owned();
    put(&mut drawing, [40.0, 40.0], &name, 21.0, Anchor::Start);
    let bytes = header.file_bytes;
    let packed = octree.records().iter().any(|record| record.stored_bytes != record.bytes);
    let mut what = format!(
        "{} triangles, {} {}, {} ({:.2} bytes a triangle)",
        HumanCount(header.triangles),
        HumanCount(header.pages.into()),
        if header.pages == 1 { "page" } else { "pages" },
        amount(bytes as f64, bytes as f64),
        bytes as f64 / header.triangles.max(1) as f64
    );
    if packed {
        what += ", packed; below, bytes are those of unpacked pages";
    }
    put(&mut drawing, [40.0, 64.0], &what, 14.0, Anchor::Start);
    levels(&mut drawing, census);
    let most = HumanCount(header.brick_limit.into());
    pages(&mut drawing, census, &format!("triangles a page, in percent of the most ({most})"));
    leaves(&mut drawing, census);
    whole(&mut drawing, census);
    drawing
}

/// Levels as they are shown: the deepest together.
fn shown(census: &Census) -> Vec<(String, Level)> {
    let mut rows: Vec<(String, Level)> = Vec::new();
    for (number, level) in census.levels.iter().enumerate() {
        match rows.get_mut(DEEPEST) {
            None => rows.push(((number + 1).to_string(), *level)),
            Some((name, last)) => {
                *name = format!("{}+", DEEPEST + 1);
                let counts = [&mut last.pages, &mut last.nodes, &mut last.leaves, &mut last.triangles];
                let more = [level.pages, level.nodes, level.leaves, level.triangles];
                counts.into_iter().zip(more).for_each(|(sum, more)| *sum += more);
                last.bytes.iter_mut().zip(level.bytes).for_each(|(sum, more)| *sum += more);
            }
        }
    }
    rows
}

/// A row a level: counts, and a bar of bytes by kind.
fn levels(drawing: &mut Drawing, census: &Census) {
    let [left, right, top, bottom] = LEVELS;
    put(drawing, [left, top - 36.0], "Bytes on each level of the tree", 16.0, Anchor::Start);
    COLUMNS.iter().for_each(|(name, x)| put(drawing, [*x, top - 12.0], name, 13.0, Anchor::End));
    let rows = shown(census);
    let most = rows.iter().map(|row| row.1.total()).fold(1.0, f64::max);
    let step = round_step(most);
    let end = (most / step).ceil() * step;
    let x = |bytes: f64| left + (right - left) * (bytes / end) as f32;
    let height = ((bottom - top) / rows.len().max(1) as f32).min(30.0);
    let foot = top + height * rows.len() as f32;
    for i in 0..=(end / step).round() as u32 {
        let value = f64::from(i) * step;
        drawing.line(&[[x(value), top - 4.0], [x(value), foot]], GRID, 1.0);
        put(drawing, [x(value), foot + 18.0], &amount(value, end), 13.0, Anchor::Middle);
    }
    for (i, (name, level)) in rows.iter().enumerate() {
        let (y, text) = (top + height * i as f32, top + height * (i as f32 + 0.5) + 4.5);
        let counts = [level.pages, level.nodes, level.leaves, level.triangles].map(|n| HumanCount(n).to_string());
        let size = height.clamp(11.0, 13.0);
        for (cell, (_, x)) in std::iter::once(name).chain(&counts).zip(COLUMNS) {
            let cell = if cell == "0" { "–" } else { cell.as_str() };
            put(drawing, [x, text], cell, size, Anchor::End);
        }
        let mut from = 0.0;
        for (bytes, color) in level.bytes.iter().zip(COLORS) {
            drawing.area([[x(from), y + 0.14 * height], [x(from + bytes), y + 0.86 * height]], color);
            from += bytes;
        }
    }
    drawing.line(&[[left, top - 4.0], [left, foot]], AXIS, 1.2);
    let used = |kind: &usize| census.levels.iter().any(|level| level.bytes[*kind] > 0.0);
    for (row, kind) in (0..KINDS.len()).filter(used).enumerate() {
        let y = top + 8.0 + 24.0 * row as f32;
        drawing.area([[KIND_NAMES - 18.0, y - 10.0], [KIND_NAMES - 6.0, y + 1.0]], COLORS[kind]);
        put(drawing, [KIND_NAMES, y], KINDS[kind], 14.0, Anchor::Start);
    }
}

fn pages(drawing: &mut Drawing, census: &Census, below: &str) {
    let label = |i: usize| (i.is_multiple_of(4)).then(|| (i * 100 / FILL_BINS).to_string());
    histogram(drawing, PAGES, ["How full pages are", "pages", below], &census.fill, 0.0, label);
}

fn leaves(drawing: &mut Drawing, census: &Census) {
    // A leaf has one triangle at least.
    let counts = &census.leaves_by_triangles[1..=LEAF_MAX];
    let label = |i: usize| (i.is_multiple_of(3) && i < LEAF_MAX).then(|| (i + 1).to_string());
    histogram(drawing, LEAVES, ["How full leaves are", "leaves", "triangles a leaf"], counts, 0.5, label);
}

/// Bars side by side; `label` names the bar, or the border before it, at `offset` bars from its left end.
fn histogram(
    drawing: &mut Drawing,
    [left, right, top, bottom]: [f32; 4],
    [title, upward, below]: [&str; 3],
    counts: &[u64],
    offset: f32,
    label: impl Fn(usize) -> Option<String>,
) {
    put(drawing, [left, top - 24.0], title, 16.0, Anchor::Start);
    let most = counts.iter().copied().max().unwrap_or(0).max(1) as f64;
    let step = round_step(most).max(1.0);
    let end = (most / step).ceil() * step;
    let y = |value: f64| bottom - (bottom - top) * (value / end) as f32;
    for i in 0..=(end / step).round() as u64 {
        let value = i as f64 * step;
        drawing.line(&[[left, y(value)], [right, y(value)]], GRID, 1.0);
        put(drawing, [left - 8.0, y(value) + 4.5], &HumanCount(value as u64).to_string(), 12.0, Anchor::End);
    }
    let width = (right - left) / counts.len().max(1) as f32;
    for (i, &count) in counts.iter().enumerate() {
        let x = left + width * i as f32;
        if count > 0 {
            // What there is, is seen.
            let high = y(count as f64).min(bottom - 1.0);
            drawing.area([[x + 0.08 * width, high], [x + 0.92 * width, bottom]], BAR);
        }
    }
    for i in 0..=counts.len() {
        if let Some(text) = label(i) {
            put(drawing, [left + width * (i as f32 + offset), bottom + 18.0], &text, 12.0, Anchor::Middle);
        }
    }
    drawing.line(&[[left, top], [left, bottom], [right, bottom]], AXIS, 1.2);
    put(drawing, [0.5 * (left + right), bottom + 40.0], below, 13.0, Anchor::Middle);
    let at = [left - 80.0, 0.5 * (top + bottom)];
    let text = upward.to_owned();
    drawing.text(Text { at, text, exponent: String::new(), size: 13.0, anchor: Anchor::Middle, upward: true });
}

/// What all bytes of the file are for.
fn whole(drawing: &mut Drawing, census: &Census) {
    let [left, right, top, _] = WHOLE;
    let of_kind = |kind: usize| census.levels.iter().map(|level| level.bytes[kind]).sum::<f64>();
    let rest = [
        ("heads of pages", census.heads),
        ("records, strings", census.records),
        ("headers of pages", census.page_headers),
        ("header", census.header),
        ("zeros between", census.padding),
    ];
    let kinds = (0..KINDS.len()).map(|kind| (KINDS[kind], of_kind(kind), COLORS[kind]));
    let rest = rest.into_iter().map(|(name, bytes)| (name, bytes as f64, BAR));
    let rows: Vec<(&str, f64, Rgb)> = kinds.chain(rest).filter(|row| row.1 > 0.0).collect();
    let sum = rows.iter().map(|row| row.1).sum::<f64>().max(1.0);
    put(drawing, [left - 134.0, top - 12.0], "What the bytes of the file are for", 16.0, Anchor::Start);
    let most = rows.iter().map(|row| row.1).fold(1.0, f64::max);
    for (i, (name, bytes, color)) in rows.iter().enumerate() {
        let y = top + 20.0 * i as f32 + 14.0;
        put(drawing, [left - 12.0, y], name, 13.0, Anchor::End);
        let end = left + (right - left) * (bytes / most) as f32;
        drawing.area([[left, y - 10.0], [end.max(left + 1.0), y + 1.0]], *color);
        let text = format!("{}  {:.1} %", amount(*bytes, *bytes), 100.0 * bytes / sum);
        put(drawing, [right + 10.0, y], &text, 13.0, Anchor::Start);
    }
}

fn put(drawing: &mut Drawing, at: [f32; 2], text: &str, size: f32, anchor: Anchor) {
    drawing.text(Text { at, text: text.to_owned(), exponent: String::new(), size, anchor, upward: false });
}

/// 1, 2 or 5 times a power of ten, so that three to six of them reach `most`.
fn round_step(most: f64) -> f64 {
    let power = 10f64.powf((most / 5.0).max(1e-9).log10().floor());
    [1.0, 2.0, 5.0].map(|k| k * power).into_iter().find(|step| step * 5.0 >= most).unwrap_or(10.0 * power)
}

/// Bytes in the unit that suits `scale` (powers of 1000), with the digits that count there.
fn amount(bytes: f64, scale: f64) -> String {
    let units = [(1e12, "TB"), (1e9, "GB"), (1e6, "MB"), (1e3, "kB")];
    let (unit, name) = units.into_iter().find(|(unit, _)| scale >= *unit).unwrap_or((1.0, "B"));
    let value = bytes / unit;
    let digits = if unit == 1.0 || scale / unit >= 100.0 { 0 } else { 1 + usize::from(scale / unit < 10.0) };
    let text = format!("{value:.digits$}");
    let text = if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
    format!("{text} {name}")
}

#[cfg(test)]
mod tests {
    use octrace::Monitor;

    use super::super::census::tests::sheet;
    use super::*;

    #[test]
    fn numbers_are_short() {
        let shown = [0.0, 999.0, 1000.0, 1.5e6, 1.153e9, 381e3].map(|bytes| amount(bytes, bytes));
        assert_eq!(shown, ["0 B", "999 B", "1 kB", "1.5 MB", "1.15 GB", "381 kB"]);
        assert_eq!([0.0, 0.5e9, 2e9].map(|bytes| amount(bytes, 2e9)), ["0 GB", "0.5 GB", "2 GB"]);
        assert_eq!([1.0, 7.0, 60.0, 1e9].map(round_step), [0.2, 2.0, 20.0, 2e8]);
    }

    #[test]
    fn all_that_was_counted_is_shown() {
        let (_folder, octree) = sheet(500, true);
        let census = Census::of(&octree, Monitor::silent()).unwrap();
        let svg = draw(&octree, &census).svg();
        let pages = format!("{} pages", HumanCount(octree.header().pages.into()));
        for text in
            ["sheet.oct", "7,200 triangles", "leaf vertices", "level of detail", "triangles a leaf", pages.as_str()]
        {
            assert!(svg.contains(text), "{text}: {svg}");
        }
        assert!(!svg.contains("NaN") && !svg.contains("inf"));
        let most = census.levels.iter().map(|level| level.triangles).max().unwrap();
        assert!(svg.contains(&format!(">{}<", HumanCount(most))));
        let picture = draw(&octree, &census).picture();
        assert_eq!(picture.dimensions(), (2400, 1600));
    }

    #[test]
    fn the_deepest_levels_share_a_bar() {
        let (_folder, octree) = sheet(500, false);
        let mut census = Census::of(&octree, Monitor::silent()).unwrap();
        let level = Level { leaves: 2, triangles: 3, ..Level::default() };
        census.levels = vec![level; 70];
        let rows = shown(&census);
        assert_eq!((rows.len(), rows[0].0.as_str(), rows[DEEPEST].0.as_str()), (DEEPEST + 1, "1", "21+"));
        assert_eq!((rows[DEEPEST].1.leaves, rows[0].1.leaves), (100, 2));
        assert!(!draw(&octree, &census).svg().contains("NaN"));
    }
}
