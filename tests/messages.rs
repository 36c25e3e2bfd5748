//! docs/MESSAGES.md lists what the tools and the library say when something is wrong. This holds the list to the source, both ways: each
//! literal that reads like a message stands in the list, or among what is named here as no message; and what is listed is in the source.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Text in the source that is no message: parts of reports, headings, what goes into files.
const NO_MESSAGES: [&str; 56] = [
    "Frame requires too much memory for decoding",
    "waits for pages a pixel",
    "share … of … (… tiles),",
    "…: … x … pixels, …… rays, … s; …; … of memory at most",
    "…: … x … pixels from … parts",
    "made by octrace",
    "a picture of",
    "a crop of",
    "samples a pixel",
    "and … more",
    "While it is drawn",
    "…: a map of …",
    "… triangles, … …, … (… bytes a triangle)",
    ", packed; below, bytes are those of unpacked pages",
    "triangles a page, in percent of the most (…)",
    "Bytes on each level of the tree",
    "How full pages are",
    "How full leaves are",
    "triangles a leaf",
    "heads of pages",
    "headers of pages",
    "What the bytes of the file are for",
    "octrace mesh cache",
    "depth, nine tenths of it",
    "nodes and leaves a pixel",
    "pages a pixel",
    "lights kept off",
    "…, format version …",
    "… % of all, … s left",
    ", … of them again",
    "… of … pages, … read… (…)",
    "…: … triangles, … bytes (… a triangle), … s",
    "; moved vertices by up to … on an axis",
    "triangles of zero area",
    "triangles that are not finite",
    "triangles with a bad index",
    "faces with too few corners",
    "# taken out of an octree file by octinfo",
    "# the origin … … … was subtracted from the source and is not added back",
    "…: every checksum and every rule holds",
    "… (… in the top), depth …",
    ", … with vertices of 16 bits an axis",
    "… was subtracted from the source",
    "every checksum and every rule holds, in every page",
    "of zero area",
    "with a bad index",
    "level of detail",
    "level of detail: … hits off by at most … pixels (allowed …), … of … pages used",
    "…: … triangles, … vertices",
    "… (… triangles each)…",
    "… (largest … bytes)",
    ", stored … times",
    "--split sah --brick … --leaf …………",
    "--split … --brick … --leaf … --cell … --depth …………",
    "octtrace [OPTIONS] MODEL.oct < RAYS > HITS",
    // What crate zstd says, and the compiler.
    "octree files are read in place, which needs a little-endian machine",
];

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// All Rust files below a folder, tests and what makes manuals left out.
fn sources(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_str().unwrap();
        if path.is_dir() && name != "tests" {
            sources(&path, found);
        }
        let is_test =
            ["tests.rs", "spec_test.rs", "double.rs", "sample.rs"].contains(&name) || name.ends_with("_tests.rs");
        let is_manual = ["man.rs", "manual.rs"].contains(&name);
        if name.ends_with(".rs") && !is_test && !is_manual {
            found.push(path);
        }
    }
}

/// The string literals of a file up to its tests, each with what stands before it.
fn literals(text: &str) -> Vec<(&str, String)> {
    let text = text.find("#[cfg(test)]\nmod tests {").map_or(text, |at| &text[..at]);
    let (mut found, mut at) = (Vec::new(), 0);
    while let Some(c) = text[at..].chars().next() {
        let rest = &text[at..];
        if rest.starts_with("//") {
            at += rest.find('\n').unwrap_or(rest.len());
        } else if c == '"' {
            let hashes = text[..at].bytes().rev().take_while(|b| *b == b'#').count();
            let raw =
                text[..at - hashes].ends_with('r') && (hashes > 0 || !text[..at - 1].ends_with(char::is_alphanumeric));
            let end = match raw {
                true => rest[1..].find(&format!("\"{}", "#".repeat(hashes))).unwrap() + 1,
                false => closing_quote(rest),
            };
            found.push((&text[..at], rest[1..end].to_owned()));
            at += end + 1;
        } else if c == '\'' {
            // A character, or a lifetime.
            let inner = &rest[1..];
            let length = match inner.strip_prefix('\\') {
                Some(escape) => escape.find('\'').map(|n| n.max(1) + 3),
                None => {
                    inner.chars().next().filter(|c| inner[c.len_utf8()..].starts_with('\'')).map(|c| c.len_utf8() + 2)
                }
            };
            at += length.unwrap_or(1);
        } else {
            at += c.len_utf8();
        }
    }
    found
}

/// Where the string that begins here ends.
fn closing_quote(text: &str) -> usize {
    let mut escaped = false;
    let ends = |&(_, c): &(usize, char)| {
        let ends = c == '"' && !escaped;
        escaped = c == '\\' && !escaped;
        ends
    };
    text.char_indices().skip(1).find(ends).unwrap().0
}

/// A literal as the list has it: what differs is `…`.
fn as_listed(literal: &str) -> String {
    let mut text = String::new();
    let mut rest = literal;
    while let Some(at) = rest.find(['{', '\\']) {
        text += &rest[..at];
        let tail = &rest[at + 1..];
        rest = match rest.as_bytes()[at] {
            b'{' => {
                text.push('…');
                tail.split_once('}').map_or("", |(_, tail)| tail)
            }
            // A line that is continued.
            _ if tail.starts_with('\n') => tail.trim_start(),
            _ if tail.starts_with('n') => {
                text.push(' ');
                &tail[1..]
            }
            _ => {
                text.push_str(&tail[..1]);
                &tail[1..]
            }
        };
    }
    (text + rest).trim().to_owned()
}

/// Whether a literal reads like something that is said to people: two blanks, and two words of letters.
fn is_told(listed: &str, before: &str) -> bool {
    let words = listed.split(|c: char| !c.is_ascii_alphabetic()).filter(|word| word.len() > 1).count();
    let context = &before[before.char_indices().rev().nth(80).map_or(0, |(at, _)| at)..];
    let after = |what: &str| context.rfind(what).is_some_and(|at| !context[at..].contains(';'));
    let for_programmers =
        ["assert!(", "assert_eq!(", "expect(", "panic!(", "unreachable!(", "reason = "].iter().any(|what| after(what));
    let is_drawing = ["<", "fill=", "transform=", "font-"].iter().any(|what| listed.starts_with(what));
    let is_help = listed.contains("Examples:") || listed.starts_with("Copyright");
    listed.matches(' ').count() > 1 && words > 1 && !for_programmers && !is_drawing && !is_help
}

/// The messages of the list: the first code span of each item.
fn list() -> BTreeSet<String> {
    let text = std::fs::read_to_string(root().join("docs/MESSAGES.md")).unwrap();
    let message = |line: &str| {
        let item = line.strip_prefix("- ")?;
        let fence = if item.starts_with("``") { "``" } else { "`" };
        Some(item.strip_prefix(fence)?.split_once(fence)?.0.trim().to_owned())
    };
    text.lines().filter_map(message).collect()
}

fn told_in(folders: &[&str]) -> Vec<(String, PathBuf)> {
    let mut files = Vec::new();
    folders.iter().for_each(|folder| sources(&root().join(folder), &mut files));
    let mut told = Vec::new();
    for file in files {
        let text = std::fs::read_to_string(&file).unwrap();
        for (before, literal) in literals(&text) {
            let listed = as_listed(&literal);
            if is_told(&listed, before) {
                told.push((listed, file.strip_prefix(root()).unwrap().to_owned()));
            }
        }
    }
    told
}

#[test]
fn every_message_is_listed() {
    let list = list();
    let told = told_in(&["src", "tools/cli", "tools/octbuild", "tools/octrender", "tools/octtrace", "tools/octinfo"]);
    let known = |text: &str| list.contains(text) || NO_MESSAGES.contains(&text);
    let missing: Vec<_> = told.iter().filter(|(text, _)| !known(text)).collect();
    assert!(told.len() > 350, "only {} messages are found", told.len());
    assert!(missing.is_empty(), "not in docs/MESSAGES.md (nor in NO_MESSAGES of this test): {missing:#?}");
}

#[test]
fn every_listed_message_is_said() {
    let told: BTreeSet<String> = told_in(&["src", "tools"]).into_iter().map(|told| told.0).collect();
    let gone: Vec<_> = list().into_iter().filter(|text| !told.contains(text)).collect();
    assert!(gone.is_empty(), "in docs/MESSAGES.md, but nothing says so any more: {gone:#?}");
    let gone: Vec<_> = NO_MESSAGES.iter().filter(|text| !told.contains(**text)).collect();
    assert!(gone.is_empty(), "in NO_MESSAGES, but not in the source any more: {gone:#?}");
}
