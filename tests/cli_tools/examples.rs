//! Every example of the README, of the pages in `docs/` and of `--help` (which is that of the man pages) runs as it is printed.
//!
//! As for a reader, each tool's examples begin in an empty folder and make what they need. So do those of the README, whose scene is put
//! where it says; the pages begin with what the README has made. Where an example asks for much work, it is made to ask for less;
//! nothing else is changed.

use std::path::Path;
use std::process::{Command, Stdio};

use super::support::*;

const TOOLS: [&str; 5] = ["octbuild", "octrender", "octtrace", "octinfo", "octbench"];

/// What is asked for, and what is asked for here; only the first that an example has is replaced.
const LESS: [(&str, &str); 15] = [
    ("octbench accuracy --rays 1e5", "octbench accuracy --families 1,2 --rays 1e2"),
    ("octbench accuracy --model planet.obj --rays 1e5", "octbench accuracy --model planet.obj --rays 1e2"),
    ("octbench closed --rays 1e5", "octbench closed --rays 1e3"),
    ("octbench mirrors --paths 100 --bounces 1000", "octbench mirrors --paths 5 --bounces 5"),
    (
        "octbench speed planet.oct --view planet-over",
        "octbench speed planet.oct --view planet-over --size 16x16 --chords 100 --rounds 1",
    ),
    ("octbench speed planet.oct --rounds 1", "octbench speed planet.oct --size 16x16 --chords 100 --rounds 1"),
    ("octbench speed", "octbench speed --size 16x16 --chords 100 --rounds 1"),
    ("octbench tradeoff", "octbench tradeoff --rays 100 --every-triangle 5 --rounds 1"),
    ("octbench mesh -n 1e5", "octbench mesh -n 1e3"),
    ("octbench mesh -n 1e6", "octbench mesh -n 1e3"),
    ("octbench mesh -n 5e7", "octbench mesh -n 1e3"),
    ("--size 1920x1080 --samples 16", "--size 48x27 --samples 1"),
    ("--samples 64", "--samples 4"),
    ("--repeat 9", "--repeat 2"),
    // It would go on until Ctrl-C.
    ("--watch --preview 2", "--preview 2"),
];

/// What a reader of a page does.
enum Step {
    /// Puts a text into a file: a `text` block whose first line is `# NAME.txt`.
    Write(String, String),
    /// A line of an `sh` block that runs a tool, but for those that need other tracers.
    Run(String),
}

fn of_page(name: &str) -> Vec<Step> {
    let text = std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(name)).unwrap();
    let text = text.replace("\\\n", " ");
    let mut steps = Vec::new();
    for block in text.split("\n```").skip(1).step_by(2) {
        let (kind, body) = block.split_once('\n').unwrap();
        let file = body.lines().next().and_then(|line| line.strip_prefix("# ")).filter(|name| name.ends_with(".txt"));
        match (kind, file) {
            ("text", Some(file)) => steps.push(Step::Write(file.to_owned(), body.to_owned())),
            ("sh", _) => {
                let runs = body.lines().filter(|line| runs_a_tool(line));
                steps.extend(runs.map(|line| Step::Run(line.to_owned())));
            }
            _ => {}
        }
    }
    steps
}

/// The examples of a tool's help.
fn of_help(lab: &Lab, tool: &str) -> Vec<String> {
    let help = String::from_utf8(lab.done(tool, &["--help"])).unwrap();
    let examples = &help[help.find("\nExamples:\n").expect(tool) + 11..];
    let examples = &examples[..examples.find("\n\n").unwrap_or(examples.len())];
    let line = |line: &str| line.strip_prefix("  ").filter(|line| !line.starts_with(' ')).map(str::to_owned);
    examples.lines().filter_map(line).collect()
}

fn runs_a_tool(line: &str) -> bool {
    let begins = TOOLS.iter().chain(&["mkdir"]).any(|word| line.starts_with(&format!("{word} ")));
    (begins || line.starts_with("for ") && line.contains("; do ")) && !line.contains("--peer-command")
}

/// Runs an example by the shell; the files that it names for its outputs must be there then.
fn run(lab: &Lab, example: &str) {
    let example = example.split(" # ").next().unwrap().trim_end();
    let less = LESS.iter().find(|(much, _)| example.contains(much));
    let mut line = less.map_or(example.to_owned(), |(much, less)| example.replacen(much, less, 1));
    // A mesh by itself is drawn with 1024 x 1024 pixels.
    if line.starts_with("octrender ") && !["scene", "--size", "--assemble"].iter().any(|word| line.contains(word)) {
        line = line.replacen("octrender ", "octrender --size 64x48 ", 1);
    }
    let tools = tool_path("octbuild").parent().unwrap();
    let path = std::env::join_paths(
        std::iter::once(tools.to_owned()).chain(std::env::split_paths(&std::env::var_os("PATH").unwrap())),
    );
    let mut command = Command::new("sh");
    command.args(["-c", &format!("set -e; {line}")]).current_dir(lab.path("")).stdin(Stdio::null());
    command.env("PATH", path.unwrap()).env("NO_COLOR", "1").env("XDG_CACHE_HOME", lab.path("cache"));
    let output = command.output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{line}\n{}", told(&output));
    let words: Vec<&str> = line.split_whitespace().collect();
    for pair in words.windows(2).filter(|pair| ["-o", ">"].contains(&pair[0]) && pair[1] != "-") {
        let plot = line.starts_with("octbench tradeoff");
        let name = pair[1].trim_end_matches(';');
        let names = if plot { vec![format!("{name}.svg"), format!("{name}.png")] } else { vec![name.to_owned()] };
        for name in names {
            assert!(std::fs::metadata(lab.path(&name)).is_ok_and(|file| file.len() > 0), "{line}: no {name}");
        }
    }
}

#[cfg(unix)]
#[test]
fn of_the_pages() {
    let lab = Lab::new();
    let mut count = 0;
    // The README first: the other pages begin with its files.
    for page in ["README.md", "docs/AOVS.md", "docs/LOD.md", "docs/STREAMING.md", "docs/FARM.md"] {
        for step in of_page(page) {
            match step {
                Step::Write(name, text) => lab.write(&name, text.replace("resolution 800 600", "resolution 160 120")),
                Step::Run(example) => {
                    println!("{page}: {example}");
                    run(&lab, &example);
                    count += 1;
                }
            }
        }
    }
    assert!(count >= 30, "only {count} examples were found");
    assert!(lab.read("planet.oct") == lab.read("small.oct"));
}

#[cfg(unix)]
#[test]
fn of_the_help() {
    for tool in TOOLS {
        let lab = Lab::new();
        let examples = of_help(&lab, tool);
        assert!(examples.len() >= 6, "{tool}: {examples:?}");
        for example in examples {
            let first = example.split(' ').next().unwrap();
            if !TOOLS.contains(&first) && Command::new(first).arg("--version").output().is_err() {
                println!("skipped, since {first} is not installed: {example}");
                continue;
            }
            println!("{example}");
            run(&lab, &example);
        }
    }
}
