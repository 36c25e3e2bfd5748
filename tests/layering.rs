//! The layering rules of ARCHITECTURE.md, checked against the source text.
//!
//! A module may import only what its row of the table names, plus `error`, `event` and `geometry`; the crate root may
//! import all. The library has unsafe code in two places only, never prints, and knows nothing of the tools; its unit
//! tests may import and print what they like. The check
//! reads text, not syntax: comments and strings are blanked out first, then paths are looked for.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// Modules that all may import, and the crate root's own names for their types.
const FOR_ALL: [&str; 3] = ["error", "event", "geometry"];
/// Names that lib.rs exports; they come from `error` and `event`.
const ROOT_TYPES: [&str; 7] = ["Diagnostic", "Error", "Kind", "Result", "Severity", "Event", "Monitor"];
/// Where unsafe code may stand.
const UNSAFE: [&str; 2] = ["map/mmap", "trace/arch/"];

type Table = BTreeMap<String, BTreeSet<String>>;

/// The table "module | what lives there | may import", restricted to modules of the library.
fn table(text: &str) -> Table {
    let rows = text.lines().filter_map(|line| {
        let cells: Vec<&str> = line.trim().strip_prefix('|')?.split('|').map(str::trim).collect();
        let name = cells.first()?.strip_prefix('`')?.strip_suffix("/`")?;
        (cells.len() >= 3).then(|| (name.to_owned(), cells[2].to_owned()))
    });
    let rows: Vec<(String, String)> = rows.collect();
    let names: BTreeSet<&String> = rows.iter().map(|r| &r.0).collect();
    let words = |s: &str| s.split(|c: char| !c.is_alphanumeric() && c != '_').map(str::to_owned).collect::<Vec<_>>();
    let allowed = |text: &str| words(&text.replace("'s", "")).into_iter().filter(|w| names.contains(w)).collect();
    rows.iter().filter(|r| r.0 != "tools").map(|(name, text)| (name.clone(), allowed(text))).collect()
}

/// Blanks out comments, strings and character literals; line numbers stay.
fn code_only(text: &str) -> String {
    let bytes = text.as_bytes();
    let mut out = Vec::with_capacity(bytes.len());
    let mut at = 0;
    while at < bytes.len() {
        let end = blank_end(bytes, at);
        if end > at {
            out.extend(bytes[at..end].iter().map(|&b| if b == b'\n' { b'\n' } else { b' ' }));
            at = end;
        } else {
            out.push(bytes[at]);
            at += 1;
        }
    }
    String::from_utf8_lossy(&out).into_owned()
}

/// Where the comment, string or character literal that begins at `at` ends; `at` itself if none does.
fn blank_end(b: &[u8], at: usize) -> usize {
    let rest = &b[at..];
    let find = |from: usize, what: &[u8]| {
        b[from..].windows(what.len()).position(|w| w == what).map_or(b.len(), |i| from + i + what.len())
    };
    let word_before = at > 0 && (b[at - 1].is_ascii_alphanumeric() || b[at - 1] == b'_');
    if rest.starts_with(b"//") {
        return find(at, b"\n") - usize::from(b[at..].contains(&b'\n'));
    }
    if rest.starts_with(b"/*") {
        return block_comment_end(b, at);
    }
    if rest[0] == b'r' && !word_before {
        let hashes = rest[1..].iter().take_while(|&&c| c == b'#').count();
        if rest.get(1 + hashes) == Some(&b'"') {
            return find(at + 2 + hashes, &[b"\"".as_slice(), &vec![b'#'; hashes]].concat());
        }
    }
    match rest[0] {
        b'"' => quoted_end(b, at, b'"'),
        b'\'' if rest.get(1) == Some(&b'\\') || rest.get(2) == Some(&b'\'') => quoted_end(b, at, b'\''),
        _ => at,
    }
}

fn quoted_end(b: &[u8], at: usize, quote: u8) -> usize {
    let mut i = at + 1;
    while i < b.len() && b[i] != quote {
        i += if b[i] == b'\\' { 2 } else { 1 };
    }
    (i + 1).min(b.len())
}

fn block_comment_end(b: &[u8], at: usize) -> usize {
    let (mut depth, mut i) = (0, at);
    while i < b.len() {
        match b.get(i..i + 2) {
            Some(b"/*") => (depth, i) = (depth + 1, i + 2),
            Some(b"*/") => (depth, i) = (depth - 1, i + 2),
            _ => i += 1,
        }
        if depth == 0 {
            return i;
        }
    }
    b.len()
}

fn is_word(c: char) -> bool {
    c.is_alphanumeric() || c == '_'
}

/// Whether `word` stands at `at` and does not go on to the left or right.
fn stands_alone(code: &str, at: usize, word: &str) -> bool {
    !code[..at].ends_with(is_word) && !code[at + word.len()..].starts_with(is_word)
}

/// The first names after a path's prefix: one, or all of a group `{a::b, c}`.
fn heads(after: &str) -> Vec<String> {
    let after = after.trim_start();
    let name = |s: &str| s.trim_start().chars().take_while(|&c| is_word(c)).collect::<String>();
    let Some(group) = after.strip_prefix('{') else {
        return if after.starts_with('*') { vec!["*".to_owned()] } else { vec![name(after)] };
    };
    let (mut depth, mut start, mut list) = (0, 0, Vec::new());
    for (i, c) in group.char_indices() {
        match c {
            '{' => depth += 1,
            '}' if depth == 0 => {
                list.push(name(&group[start..i]));
                break;
            }
            '}' => depth -= 1,
            ',' if depth == 0 => {
                list.push(name(&group[start..i]));
                start = i + 1;
            }
            _ => {}
        }
    }
    list.retain(|n| !n.is_empty());
    list
}

/// What a file imports from other top modules, with line numbers: through `crate::` and through `super::` chains that
/// lead up to the crate root. Inner modules (`mod tests { .. }`) make such a chain one longer, so a chain counts from
/// the depth of the file on.
fn imports(code: &str, depth: usize, own: &str) -> Vec<(usize, String)> {
    let mut found = Vec::new();
    let line = |at: usize| code[..at].matches('\n').count() + 1;
    for (at, _) in code.match_indices("crate::") {
        if stands_alone(code, at, "crate") {
            found.extend(heads(&code[at + "crate::".len()..]).into_iter().map(|h| (line(at), h)));
        }
    }
    for (at, _) in code.match_indices("super::") {
        if code[..at].ends_with("super::") || !stands_alone(code, at, "super") {
            continue;
        }
        let chain = code[at..].split("super::").take_while(|s| s.is_empty()).count();
        // Indented, `use super::*` stands in an inner module (rustfmt sees to that) and means this file.
        let inner_glob = code[at + chain * "super::".len()..].starts_with('*') && code[..at].ends_with("    use ");
        if chain >= depth && !inner_glob {
            let after = &code[at + chain * "super::".len()..];
            found.extend(heads(after).into_iter().map(|h| (line(at), h)));
        }
    }
    found.retain(|(_, head)| head != own);
    found
}

/// Every violation in one file of the library; `path` is relative to `src/`, with forward slashes.
fn violations(path: &str, text: &str, table: &Table) -> Vec<String> {
    let code = code_only(text);
    let library = without_tests(path, &code);
    let mut wrong = Vec::new();
    let mut complain = |line: usize, what: String| wrong.push(format!("src/{path}:{line}: {what}"));
    let folders: Vec<&str> = path.split('/').collect();
    let module = folders[0].trim_end_matches(".rs");

    // In the crate root (lib.rs, cache.rs) everything may be imported, and so it may by error and event: nothing.
    if folders.len() > 1 {
        match table.get(module) {
            None => complain(1, format!("`{module}` has no row in the table of ARCHITECTURE.md")),
            Some(allowed) => {
                // How many `super` lead from the top level of this file to the crate root.
                let depth = folders.len() - usize::from(folders.last() == Some(&"mod.rs"));
                for (line, head) in imports(library, depth, module) {
                    let fine = FOR_ALL.contains(&&*head) || ROOT_TYPES.contains(&&*head) || allowed.contains(&head);
                    // A name one `super` too far up from inside `mod tests` is a name of this module.
                    if !fine && (table.contains_key(&head) || head == "*" || head == "tools" || is_root_name(&head)) {
                        complain(line, format!("`{module}` may not import `{head}`"));
                    }
                }
            }
        }
    }
    let may_be_unsafe = UNSAFE.iter().any(|place| path.starts_with(place));
    for (number, line) in code.lines().enumerate() {
        let has = |word: &str| line.match_indices(word).any(|(at, _)| stands_alone(line, at, word));
        if has("unsafe") && !may_be_unsafe {
            complain(number + 1, "unsafe code may stand only in map/mmap and trace/arch/".to_owned());
        }
        if line.contains("tools::") || line.contains("tools/") {
            complain(number + 1, "the library may not know the tools".to_owned());
        }
    }
    for (line, name) in prints(library) {
        complain(line, format!("the library may not print (`{name}!`); send an event"));
    }
    wrong
}

/// Functions of the crate root, which only the crate root and the tools may call.
fn is_root_name(head: &str) -> bool {
    matches!(head, "open_or_build" | "cache")
}

/// The code without its tests, which may import and print what they like: a file `tests.rs`, or an inline module that
/// closes its file.
fn without_tests<'a>(path: &str, code: &'a str) -> &'a str {
    if path.ends_with("/tests.rs") || path.contains("/tests/") {
        return "";
    }
    code.split("#[cfg(test)]\nmod tests {").next().unwrap_or(code)
}

/// Printing macros.
fn prints(library: &str) -> Vec<(usize, &'static str)> {
    let mut found = Vec::new();
    for name in ["println", "eprintln", "print", "eprint", "dbg"] {
        let call = format!("{name}!");
        for (at, _) in library.match_indices(&call) {
            if !library[..at].ends_with(is_word) {
                found.push((library[..at].matches('\n').count() + 1, name));
            }
        }
    }
    found
}

fn rust_files(folder: &Path) -> Vec<PathBuf> {
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap_or_else(|e| panic!("{}: {e}", folder.display())) {
        let path = entry.unwrap().path();
        if path.is_dir() {
            files.extend(rust_files(&path));
        } else if path.extension().is_some_and(|e| e == "rs") {
            files.push(path);
        }
    }
    files.sort();
    files
}

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn the_table() -> Table {
    table(&std::fs::read_to_string(root().join("ARCHITECTURE.md")).unwrap())
}

#[test]
fn the_library_keeps_its_layers() {
    let (table, src) = (the_table(), root().join("src"));
    let files = rust_files(&src);
    assert!(files.len() > 20, "only {} files found", files.len());
    let mut wrong = Vec::new();
    for file in files {
        let name = file.strip_prefix(&src).unwrap().to_string_lossy().replace('\\', "/");
        wrong.extend(violations(&name, &std::fs::read_to_string(&file).unwrap(), &table));
    }
    assert!(wrong.is_empty(), "\n{}", wrong.join("\n"));
}

#[test]
fn unsafe_is_denied_at_the_crate_root() {
    let lib = std::fs::read_to_string(root().join("src/lib.rs")).unwrap();
    assert!(code_only(&lib).contains("#![deny(unsafe_code)]"));
}

#[test]
fn the_tools_have_no_unsafe_code() {
    for file in rust_files(&root().join("tools")) {
        let code = code_only(&std::fs::read_to_string(&file).unwrap());
        assert!(!code.match_indices("unsafe").any(|(at, w)| stands_alone(&code, at, w)), "{}", file.display());
    }
}

#[test]
fn the_table_is_read_as_it_is_meant() {
    let table = the_table();
    let row = |name: &str| table[name].iter().map(String::as_str).collect::<Vec<_>>();
    assert_eq!(row("geometry"), Vec::<&str>::new());
    assert_eq!(row("build"), ["exact", "format", "geometry", "mesh"]);
    assert_eq!(row("map"), ["format"]);
    assert_eq!(row("scene"), ["geometry", "mesh"]);
    assert_eq!(row("output"), ["render", "scene"]);
    assert!(!table.contains_key("tools"));
    for entry in std::fs::read_dir(root().join("src")).unwrap().map(|e| e.unwrap().path()).filter(|p| p.is_dir()) {
        let name = entry.file_name().unwrap().to_string_lossy().into_owned();
        assert!(table.contains_key(&name), "{name} has no row");
    }
}

#[test]
fn violations_are_caught() {
    let table = the_table();
    let caught = |path: &str, text: &str| !violations(path, text, &table).is_empty();
    for (path, text) in [
        ("build/mod.rs", "use crate::map::Octree;"),
        ("build/mod.rs", "use crate::{error::Error, format::{Node, Leaf}, trace};"),
        ("build/deep/mod.rs", "use super::super::trace::Tracer;"),
        ("build/part.rs", "fn f() { super::super::map::open() }"),
        ("scene/parse.rs", "fn f() -> crate::trace::Found { todo() }"),
        ("map/mod.rs", "use crate::build as b;"),
        ("map/mod.rs", "use super::build;"),
        ("map/mod.rs", "use crate::*;"),
        ("map/mod.rs", "use super::*;"),
        ("map/mod.rs", "use crate::open_or_build;"),
        ("format/node.rs", "mod tests { use crate::map::Octree; }"),
        ("shade/x.rs", "/* /* nested */ */ use crate::output::save;"),
        ("trace/kernel.rs", "unsafe { *p }"),
        ("map/mod.rs", "unsafe fn f() {}"),
        ("render/mod.rs", "fn f() { println!(\"x\") }"),
        ("render/mod.rs", "let a = '\"'; eprintln!(); let b = '\"';"),
        ("render/mod.rs", "let a = r#\"\"\"#; dbg!(a);"),
        ("render/mod.rs", "use tools::cli;"),
        ("build/mod.rs", "#[cfg(test)]\nmod tests;\nuse crate::map::Octree;"),
        ("build/tests.rs", "fn f() { unsafe { g() } }"),
        ("unknown/mod.rs", ""),
    ] {
        assert!(caught(path, text), "not caught in {path}: {text}");
    }
    for (path, text) in [
        ("build/mod.rs", "use crate::{error::Error, format::{Node, Leaf}, mesh, exact};"),
        ("build/mod.rs", "use crate::{Error, Monitor, Result};"),
        ("build/mod.rs", "// use crate::map::Octree;\n/* crate::trace */ //! [`crate::map`]"),
        ("build/mod.rs", "let s = \"crate::map println! unsafe\";"),
        ("build/part.rs", "use super::map; use super::super::format::Node;"),
        ("map/mod.rs", "mod tests {\n    use super::*;\n}"),
        ("map/mmap.rs", "unsafe { map() }"),
        ("trace/arch/avx2.rs", "unsafe fn f() {}"),
        ("trace/mod.rs", "fn f<'a>(x: &'a str) -> &'a str { x } // it's println!"),
        ("trace/mod.rs", "#[cfg(test)]\nmod tests { fn f() { println!(\"skipped\") } }"),
        ("format/node.rs", "#[cfg(test)]\nmod tests {\n    use crate::map::Octree;\n}"),
        ("build/tests.rs", "use crate::map::Octree;"),
        ("lib.rs", "pub use crate::build::build;"),
    ] {
        assert!(!caught(path, text), "wrongly caught in {path}: {text}: {:?}", violations(path, text, &table));
    }
}
