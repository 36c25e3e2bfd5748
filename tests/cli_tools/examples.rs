//! Every example of the README, of the pages in `docs/` and of `--help` (which is that of the man pages) runs as it is printed.
//!
//! They run in a folder that has what they name, but small: `bunny.obj` is a ball. Where an example asks for much work, it is made to
//! ask for less; nothing else is changed.

use std::fmt::Write as _;
use std::path::Path;
use std::process::{Command, Stdio};

use octrace::geometry::Ray;

use super::support::*;

const TOOLS: [&str; 5] = ["octbuild", "octrender", "octtrace", "octinfo", "octbench"];

/// What is asked for, and what is asked for here; only the first that an example has is replaced.
const LESS: [(&str, &str); 13] = [
    ("octbench accuracy --rays 1e5", "octbench accuracy --families 1,2 --rays 1e2"),
    ("octbench accuracy --rays 1e6", "octbench accuracy --families 1,2 --rays 1e2"),
    ("octbench accuracy --model bunny.obj --rays 1e6", "octbench accuracy --model bunny.obj --rays 1e2"),
    ("octbench closed --rays 1e7", "octbench closed --rays 1e3"),
    ("octbench mirrors --paths 1e6 --bounces 1000", "octbench mirrors --paths 5 --bounces 5"),
    ("octbench speed", "octbench speed --size 16x16 --chords 100 --rounds 1"),
    ("octbench tradeoff --lod", "octbench tradeoff --rounds 1 --lod"),
    ("octbench tradeoff", "octbench tradeoff --rays 100 --every-triangle 5 --rounds 1"),
    ("octbench mesh -n 1e6", "octbench mesh -n 1e3"),
    ("--size 1920x1080 --samples 16", "--size 48x27 --samples 1"),
    ("--samples 64", "--samples 4"),
    ("--repeat 9", "--repeat 2"),
    // It would go on until Ctrl-C.
    ("--watch --preview 2", "--preview 2"),
];

/// Lines of the `sh` blocks of a Markdown page that run a tool, without what a reader has not got (other tracers).
fn of_page(name: &str) -> Vec<String> {
    let text = std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(name)).unwrap();
    let text = text.replace("\\\n", " ");
    let mut in_block = false;
    let mut found = Vec::new();
    for line in text.lines() {
        match line {
            "```sh" => in_block = true,
            "```" => in_block = false,
            _ if in_block && runs_a_tool(line) => found.push(line.to_owned()),
            _ => {}
        }
    }
    found
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
    TOOLS.iter().any(|tool| line.starts_with(&format!("{tool} "))) && !line.contains("--peer-command")
}

/// Everything that the examples read.
fn folder() -> Lab {
    let lab = Lab::new();
    let ball_obj = ball(24, 12);
    lab.write("bunny.obj", &ball_obj);
    lab.write("huge.obj", &ball_obj);
    lab.write("huge.ply", ply());
    lab.write("big.obj.zst", zstd::encode_all(ball_obj.as_bytes(), 3).unwrap());
    let town: String = ball_obj.lines().map(|line| moved(line, [4.5e5, 5.4e6, 0.0]) + "\n").collect();
    lab.write("city.obj", town);
    for name in ["bunny.oct", "planet.oct", "huge.oct"] {
        lab.done("octbuild", &["bunny.obj", "-o", name, "-q"]);
    }
    lab.done("octbuild", &["bunny.obj", "-o", "packed.oct", "--compress", "zstd", "-q"]);
    lab.done("octbuild", &["city.obj", "-o", "city.oct", "--origin", "4.5e5,5.4e6,0", "-q"]);
    let rays: Vec<Ray> = (0..100).map(|i| Ray::new([i as f32 * 0.02 - 1.0, 0.0, -3.0], [0.0, 0.0, 1.0])).collect();
    lab.write("rays.bin", bytemuck::cast_slice::<Ray, u8>(&rays));
    lab.write("scene.txt", "resolution 640 512\nframe 0 -0.3 -1\noct bunny.oct\n");
    std::fs::create_dir_all(lab.path("scenes/parts")).unwrap();
    let scenes = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes");
    for name in ["mirror_room.txt", "parts/checker.txt"] {
        std::fs::copy(scenes.join(name), lab.path("scenes").join(name)).unwrap();
    }
    std::fs::copy(lab.path("bunny.oct"), lab.path("scenes/bunny.oct")).unwrap();
    lab
}

/// A line of an OBJ file whose vertices are moved.
fn moved(line: &str, by: [f64; 3]) -> String {
    let Some(numbers) = line.strip_prefix("v ") else { return line.to_owned() };
    let xyz = numbers.split(' ').zip(by).map(|(word, by)| (word.parse::<f64>().unwrap() + by).to_string());
    format!("v {}", xyz.collect::<Vec<_>>().join(" "))
}

/// A tetrahedron.
fn ply() -> String {
    let mut text = String::from(
        "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
         element face 4\nproperty list uchar int vertex_indices\nend_header\n",
    );
    for vertex in ["0 0 0", "1 0 0", "0 1 0", "0 0 1"] {
        writeln!(text, "{vertex}").unwrap();
    }
    for face in ["0 2 1", "0 1 3", "1 2 3", "0 3 2"] {
        writeln!(text, "3 {face}").unwrap();
    }
    text
}

/// Runs an example by the shell; the files that it names for its outputs must be there then.
fn run(lab: &Lab, example: &str) {
    let example = example.split(" # ").next().unwrap().trim_end();
    let less = LESS.iter().find(|(much, _)| example.contains(much));
    let mut line = less.map_or(example.to_owned(), |(much, less)| example.replacen(much, less, 1));
    // A mesh by itself is drawn with 1024 x 1024 pixels; the scene here is small as it is.
    if line.starts_with("octrender ") && !line.contains("scene") {
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
        let names =
            if plot { vec![format!("{}.svg", pair[1]), format!("{}.png", pair[1])] } else { vec![pair[1].to_owned()] };
        for name in names {
            assert!(std::fs::metadata(lab.path(&name)).is_ok_and(|file| file.len() > 0), "{line}: no {name}");
        }
    }
}

#[cfg(unix)]
#[test]
fn of_the_pages() {
    let lab = folder();
    let mut count = 0;
    for page in ["README.md", "docs/AOVS.md", "docs/LOD.md", "docs/STREAMING.md"] {
        for example in of_page(page) {
            println!("{page}: {example}");
            run(&lab, &example);
            count += 1;
        }
    }
    assert!(count >= 15, "only {count} examples were found");
}

#[cfg(unix)]
#[test]
fn of_the_help() {
    let lab = folder();
    for tool in TOOLS {
        let examples = of_help(&lab, tool);
        assert!(examples.len() >= 4, "{tool}: {examples:?}");
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
