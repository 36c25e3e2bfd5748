//! The tools as a user runs them: processes with arguments, files and pipes; what they write, say and return.

#[path = "cli_tools/build.rs"]
mod build;
#[path = "cli_tools/build_ends.rs"]
mod build_ends;
#[path = "cli_tools/examples.rs"]
mod examples;
#[path = "cli_tools/info.rs"]
mod info;
#[path = "cli_tools/manual.rs"]
mod manual;
#[path = "cli_tools/render.rs"]
mod render;
#[path = "cli_tools/support.rs"]
mod support;
#[path = "cli_tools/trace.rs"]
mod trace;
