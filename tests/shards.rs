//! One picture by several machines, and pictures that are seen while they are drawn: the tools as a user runs them.

#[path = "shards/data.rs"]
mod data;
#[path = "shards/hostile.rs"]
mod hostile;
#[cfg(unix)]
#[path = "shards/kubernetes.rs"]
mod kubernetes;
#[path = "shards/live.rs"]
mod live;
#[path = "shards/shares.rs"]
mod shares;
#[path = "cli_tools/support.rs"]
#[allow(dead_code, unused_macros, unused_imports)]
mod support;

use support::Lab;

/// A mirrored ball on a floor, seen by itself.
const SCENE: &str = "\
resolution 150 97
lookat 0 1 4  0 0 0  0 1 0
background 0.2 0.3 0.4
light 3 5 4 1
tonemap srgb
reflect 0.5
include ball.txt
plane 0 -1 0  0 1 0
";

/// A folder with `scene.txt`, `ball.txt`, which it includes, and `ball.oct`.
fn lab() -> Lab {
    let lab = Lab::with_ball();
    lab.write("scene.txt", SCENE);
    lab.write("ball.txt", "oct ball.oct\n");
    lab
}

/// Draws all shares; the names of their parts.
fn parts(lab: &Lab, of: u32, options: &[&str]) -> Vec<String> {
    let one = |index| {
        let share = format!("{index}/{of}");
        lab.done("octrender", &[&["scene.txt", "-q", "--shard", &share], options].concat());
        format!("scene.part-{index}-of-{of}.exr")
    };
    (0..of).map(one).collect()
}

/// Puts parts together.
fn assemble(lab: &Lab, parts: &[String], image: &str) {
    let mut arguments = vec!["--assemble"];
    arguments.extend(parts.iter().map(String::as_str));
    lab.done("octrender", &[&arguments[..], &["-o", image, "-q"]].concat());
}
