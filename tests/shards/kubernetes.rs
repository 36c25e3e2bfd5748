//! The example for Kubernetes: its container's command, run once for each index, as an indexed job does.

use std::process::Command;

use super::support::*;
use super::{assemble, lab};

const JOB: &str = include_str!("../../examples/farm/kubernetes.yaml");

/// What stands after `key` on its line.
fn value(key: &str) -> &'static str {
    JOB.lines().find_map(|line| line.trim().strip_prefix(key)).unwrap_or_else(|| panic!("{key}")).trim()
}

/// The container's command, word by word.
fn command() -> Vec<&'static str> {
    let words = JOB.lines().map(str::trim).skip_while(|line| *line != "command:").skip(1);
    words.map_while(|line| line.strip_prefix("- ")).collect()
}

#[test]
fn each_index_makes_its_share_and_assembled_they_are_the_picture() {
    let lab = lab();
    let completions: u32 = value("completions:").parse().unwrap();
    assert_eq!((value("kind:"), value("completionMode:")), ("Job", "Indexed"));
    let command = command();
    assert!(
        command[0] == "octrender" && command.contains(&format!("--shard=auto/{completions}").as_str()),
        "{command:?}"
    );
    // What the container has mounted is the folder of the scene.
    let mount = value("- { name: scene, mountPath:").trim_end_matches(" }");
    let folder = lab.path("").to_str().unwrap().to_owned();
    let words: Vec<String> = command.iter().map(|word| word.replacen(&format!("{mount}/"), &folder, 1)).collect();
    assert!(words.iter().filter(|word| word.contains(&folder)).count() == 2, "{words:?}");
    std::fs::create_dir(lab.path("parts")).unwrap();
    let pod = |index: u32| {
        let mut pod = Command::new(tool_path(&words[0]));
        // Of its own it has no more than this; it stands anywhere.
        pod.args(&words[1..]).env_clear().env("JOB_COMPLETION_INDEX", index.to_string()).current_dir("/");
        let output = pod.output().unwrap();
        assert_eq!(output.status.code(), Some(0), "{index}: {}", told(&output));
    };
    // One fails, and is started again with the same index.
    (0..completions).filter(|&index| index != 3).for_each(pod);
    let parts: Vec<String> =
        (0..completions).map(|index| format!("parts/scene.part-{index}-of-{completions}.exr")).collect();
    let some: Vec<&str> = parts.iter().map(String::as_str).filter(|part| lab.path(part).exists()).collect();
    let missing = lab.fails(2, "octrender", &[&["--assemble"], &some[..], &["-o", "many.png"]].concat());
    assert!(missing.contains("1 of 8 shares are missing: 3;"), "{missing}");
    pod(3);
    for image in ["png", "exr"] {
        let [one, many] = ["one", "many"].map(|name| format!("{name}.{image}"));
        lab.done("octrender", &["scene.txt", "-q", "-o", &one]);
        assemble(&lab, &parts, &many);
        assert!(lab.read(&one) == lab.read(&many), "{image}");
    }
}
