//! What this program is made of: every crate that Cargo.lock names has a licence that deny.toml allows, and comes from the public registry
//! with a checksum. Nothing is fetched; where cargo cannot tell without a network, the test says so and passes. Advisories need
//! `cargo deny check advisories`.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;

fn file(name: &str) -> String {
    std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(name)).unwrap()
}

/// The strings in a text's first list in square brackets.
fn strings(text: &str) -> Vec<String> {
    let list = text.split_once('[').unwrap().1.split_once(']').unwrap().0;
    list.split('"').skip(1).step_by(2).map(str::to_owned).collect()
}

/// What deny.toml allows all crates, and what it allows some besides.
fn allowed() -> (Vec<String>, BTreeMap<String, Vec<String>>) {
    let text = file("deny.toml");
    let lines: Vec<&str> = text.lines().filter(|line| !line.trim_start().starts_with('#')).collect();
    let text = lines.join("\n");
    let all = strings(text.split_once("allow = ").unwrap().1);
    let exceptions = text.lines().filter(|line| line.trim_start().starts_with("{ crate"));
    let exception = |line: &str| {
        let (name, allow) = line.split_once("allow").unwrap();
        (name.split('"').nth(1).unwrap().to_owned(), strings(allow))
    };
    (all, exceptions.map(exception).collect())
}

/// Whether a licence expression (SPDX, `/` for `OR` as crates once wrote it) can be met with licences that are allowed.
fn is_met(expression: &str, allowed: &dyn Fn(&str) -> bool) -> bool {
    let spaced = expression.replace('/', " OR ").replace('(', " ( ").replace(')', " ) ");
    let words: Vec<&str> = spaced.split_whitespace().collect();
    let mut at = 0;
    let met = any(&words, &mut at, allowed);
    met && at == words.len()
}

/// `a OR b`, from the word at `at` on.
fn any(words: &[&str], at: &mut usize, allowed: &dyn Fn(&str) -> bool) -> bool {
    let mut met = all(words, at, allowed);
    while words.get(*at) == Some(&"OR") {
        *at += 1;
        met |= all(words, at, allowed);
    }
    met
}

/// `a AND b`.
fn all(words: &[&str], at: &mut usize, allowed: &dyn Fn(&str) -> bool) -> bool {
    let mut met = one(words, at, allowed);
    while words.get(*at) == Some(&"AND") {
        *at += 1;
        met &= one(words, at, allowed);
    }
    met
}

/// A licence, perhaps `WITH` an exception, or an expression in brackets.
fn one(words: &[&str], at: &mut usize, allowed: &dyn Fn(&str) -> bool) -> bool {
    let word = words.get(*at).copied().unwrap_or("");
    *at += 1;
    if word == "(" {
        let met = any(words, at, allowed);
        *at += 1;
        return met;
    }
    if words.get(*at) == Some(&"WITH") {
        let with = format!("{word} WITH {}", words.get(*at + 1).unwrap_or(&""));
        *at += 2;
        return allowed(&with);
    }
    allowed(word)
}

#[test]
fn expressions_are_understood() {
    let allowed = |name: &str| ["MIT", "A WITH B"].contains(&name);
    for met in ["MIT", "MIT OR GPL-3.0", "GPL-3.0/MIT", "A WITH B", "(X OR MIT) AND A WITH B", "MIT AND (X OR MIT)"] {
        assert!(is_met(met, &allowed), "{met}");
    }
    for unmet in ["", "GPL-3.0", "MIT AND X", "A", "A WITH C", "(X OR MIT) AND Y", "MIT X"] {
        assert!(!is_met(unmet, &allowed), "{unmet}");
    }
}

#[test]
fn every_licence_is_allowed() {
    let manifest = Path::new(env!("CARGO_MANIFEST_DIR")).join("Cargo.toml");
    let mut command = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    command.args(["metadata", "--offline", "--locked", "--format-version", "1", "--manifest-path"]).arg(manifest);
    let output = command.output().unwrap();
    if !output.status.success() {
        println!("skipped: {}", String::from_utf8_lossy(&output.stderr).trim());
        return;
    }
    let metadata: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let (for_all, exceptions) = allowed();
    assert!(for_all.len() > 5 && exceptions.len() > 1);
    let packages = metadata["packages"].as_array().unwrap();
    assert!(packages.len() > 50, "only {} crates", packages.len());
    for package in packages {
        let name = package["name"].as_str().unwrap();
        let licence = package["license"].as_str().unwrap_or("");
        let besides = exceptions.get(name);
        let allowed = |licence: &str| {
            for_all.iter().any(|x| x == licence) || besides.is_some_and(|list| list.iter().any(|x| x == licence))
        };
        assert!(is_met(licence, &allowed), "{name}: deny.toml does not allow its licence, {licence:?}");
    }
    for name in exceptions.keys() {
        assert!(
            packages.iter().any(|p| p["name"] == **name),
            "deny.toml has an exception for {name}, which is not used"
        );
    }
}

#[test]
fn every_crate_comes_from_the_registry_with_a_checksum() {
    let lock = file("Cargo.lock");
    let crates: Vec<&str> = lock.split("[[package]]").skip(1).collect();
    assert!(crates.len() > 50);
    for package in crates {
        if package.contains("name = \"octrace\"") {
            continue;
        }
        let source = "source = \"registry+https://github.com/rust-lang/crates.io-index\"";
        assert!(package.contains(source) && package.contains("checksum = \""), "{package}");
    }
}
