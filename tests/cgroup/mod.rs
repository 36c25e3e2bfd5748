//! Groups of processes with a bound on memory, where a test may make one.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// A memory cgroup, removed when dropped.
pub struct Group(PathBuf);

impl Group {
    /// A group of at most so many bytes; `None`, and said so, where none can be made.
    pub fn new(limit: u64) -> Option<Group> {
        let name = format!("octrace-test-{}", std::process::id());
        // Version 1 has a hierarchy for memory; version 2 has one for all, which must hand memory down.
        for (root, limit_file) in [("/sys/fs/cgroup/memory", "memory.limit_in_bytes"), ("/sys/fs/cgroup", "memory.max")]
        {
            let path = Path::new(root).join(&name);
            if std::fs::create_dir(&path).is_ok() {
                let group = Group(path);
                if std::fs::write(group.0.join(limit_file), limit.to_string()).is_ok() {
                    return Some(group);
                }
            }
        }
        println!("cgroup skipped");
        None
    }

    /// Runs a command line of a shell in a folder, in the group from its start.
    pub fn run(&self, line: &str, folder: &Path) -> Output {
        // The shell joins the group, and the program it becomes stays in it.
        let script = format!("echo $$ > {}/cgroup.procs && exec {line}", self.0.display());
        Command::new("sh").args(["-c", &script]).current_dir(folder).output().expect("a shell")
    }
}

impl Drop for Group {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir(&self.0);
    }
}
