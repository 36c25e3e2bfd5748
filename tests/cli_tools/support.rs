//! A folder to work in, meshes to work with, and runs of the tools.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

/// A temporary folder, in which tools are run.
pub struct Lab {
    folder: tempfile::TempDir,
}

impl Lab {
    pub fn new() -> Lab {
        Lab { folder: tempfile::tempdir().unwrap() }
    }

    /// With `ball.obj` and, built from it, `ball.oct`.
    pub fn with_ball() -> Lab {
        let lab = Lab::new();
        lab.write("ball.obj", ball(24, 12));
        lab.done("octbuild", &["ball.obj", "-o", "ball.oct", "-q"]);
        lab
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub fn write(&self, name: &str, bytes: impl AsRef<[u8]>) {
        std::fs::write(self.path(name), bytes).unwrap();
    }

    pub fn read(&self, name: &str) -> Vec<u8> {
        std::fs::read(self.path(name)).unwrap_or_else(|e| panic!("{name}: {e}"))
    }

    pub fn text(&self, name: &str) -> String {
        String::from_utf8(self.read(name)).unwrap()
    }

    pub fn json(&self, name: &str) -> serde_json::Value {
        serde_json::from_slice(&self.read(name)).unwrap()
    }

    /// Names of all files, sorted.
    pub fn files(&self) -> Vec<String> {
        let entries = std::fs::read_dir(self.folder.path()).unwrap();
        let mut names: Vec<String> = entries.map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    /// A tool ready to be spawned in the folder, without colours and with a cache folder of its own.
    pub fn command(&self, tool: &str, args: &[&str]) -> Command {
        let mut command = Command::new(tool_path(tool));
        command.args(args).current_dir(self.folder.path()).stdin(Stdio::null());
        command.env("NO_COLOR", "1").env("XDG_CACHE_HOME", self.path("cache")).env_remove("COLUMNS");
        command
    }

    /// Runs a tool to its end.
    pub fn run(&self, tool: &str, args: &[&str]) -> Output {
        self.command(tool, args).output().unwrap()
    }

    /// Runs a tool to its end with bytes on standard input.
    pub fn run_with(&self, tool: &str, args: &[&str], input: &[u8]) -> Output {
        let mut command = assert_cmd::Command::new(tool_path(tool));
        command.args(args).current_dir(self.folder.path()).env("NO_COLOR", "1");
        command.write_stdin(input).timeout(Duration::from_secs(60)).output().unwrap()
    }

    /// Runs a tool that must succeed; its standard output.
    pub fn done(&self, tool: &str, args: &[&str]) -> Vec<u8> {
        let output = self.run(tool, args);
        assert_eq!(output.status.code(), Some(0), "{tool} {args:?}: {}", told(&output));
        output.stdout
    }

    /// Runs a tool that must fail with `code`, with one message and nothing on standard output; the message.
    pub fn fails(&self, code: i32, tool: &str, args: &[&str]) -> String {
        let output = self.run(tool, args);
        let error = told(&output);
        assert_eq!(output.status.code(), Some(code), "{tool} {args:?}: {error}");
        assert!(output.stdout.is_empty(), "{tool} {args:?} printed something");
        assert!(error.contains("error: ") && !error.contains("panicked"), "{tool} {args:?}: {error}");
        error
    }
}

pub fn tool_path(tool: &str) -> &'static Path {
    Path::new(match tool {
        "octbench" => env!("CARGO_BIN_EXE_octbench"),
        "octbuild" => env!("CARGO_BIN_EXE_octbuild"),
        "octinfo" => env!("CARGO_BIN_EXE_octinfo"),
        "octrender" => env!("CARGO_BIN_EXE_octrender"),
        "octtrace" => env!("CARGO_BIN_EXE_octtrace"),
        _ => panic!("no such tool: {tool}"),
    })
}

/// What a tool said on standard error.
pub fn told(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Compares what a tool said with its snapshot, times taken out.
macro_rules! assert_told {
    ($name:literal, $text:expr) => {
        insta::with_settings!({
            filters => vec![(r"\d+\.\d\d s\b", "[seconds] s"), (r" +\n", "\n")],
            snapshot_path => "snapshots",
            prepend_module_to_snapshot => false,
        }, { insta::assert_snapshot!($name, $text) })
    };
}
pub(crate) use assert_told;

/// Sends a signal (`INT`, `KILL`) to a process.
pub fn signal(child: &std::process::Child, name: &str) {
    let status = Command::new("kill").args([&format!("-{name}"), &child.id().to_string()]).status().unwrap();
    assert!(status.success());
}

/// Waits for a process to end, not for ever; its exit code.
pub fn wait(child: &mut std::process::Child) -> Option<i32> {
    let start = Instant::now();
    loop {
        if let Some(status) = child.try_wait().unwrap() {
            return status.code();
        }
        if start.elapsed() > Duration::from_secs(30) {
            child.kill().unwrap();
            panic!("the process does not end");
        }
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// A sphere of radius 1 in longitude and latitude, as quadrilaterals and, at the poles, triangles.
pub fn ball(columns: usize, rows: usize) -> String {
    let mut obj = String::from("v 0 1 0\n");
    for r in 1..rows {
        let (s, c) = (std::f64::consts::PI * r as f64 / rows as f64).sin_cos();
        for k in 0..columns {
            let (x, z) = (std::f64::consts::TAU * k as f64 / columns as f64).sin_cos();
            writeln!(obj, "v {} {c} {}", s * x, s * z).unwrap();
        }
    }
    obj.push_str("v 0 -1 0\n");
    let vertex = |r: usize, k: usize| 2 + (r - 1) * columns + k % columns;
    let last = 2 + (rows - 1) * columns;
    for k in 0..columns {
        writeln!(obj, "f 1 {} {}", vertex(1, k), vertex(1, k + 1)).unwrap();
        for r in 1..rows - 1 {
            let [a, b, c, d] = [vertex(r, k), vertex(r + 1, k), vertex(r + 1, k + 1), vertex(r, k + 1)];
            writeln!(obj, "f {a} {b} {c} {d}").unwrap();
        }
        writeln!(obj, "f {} {last} {}", vertex(rows - 1, k), vertex(rows - 1, k + 1)).unwrap();
    }
    obj
}

/// Triangles of `ball(columns, rows)`.
pub fn ball_triangles(columns: u64, rows: u64) -> u64 {
    2 * columns * (rows - 1)
}

/// A unit square in the plane z = 0, two triangles.
pub const SQUARE: &str = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3\nf 1 3 4\n";
