//! octinfo: tells what is in an octree file, checks it, and takes meshes out of it.

#[path = "../cli/mod.rs"]
mod cli;
mod report;

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Parser;
use octrace::map::Octree;
use octrace::Result;

use cli::args::{Common, Part};
use cli::{Arguments, Session};
use report::Report;

/// Tells what is in an octree file, checks it, and takes the mesh or a part of it out again
#[derive(Parser)]
#[command(name = "octinfo", version, after_help = EXAMPLES)]
struct Args {
    /// The octree file
    #[arg(value_name = "MODEL.oct")]
    model: PathBuf,
    /// Print JSON instead of a table
    #[arg(long)]
    json: bool,
    /// Check every checksum and every rule of the format, in every page
    #[arg(long)]
    verify: bool,
    #[command(flatten)]
    common: Common,
}

const EXAMPLES: &str = "\
Examples:
  octinfo bunny.oct                                   counts, bytes by part, bounds, options
  octinfo --json bunny.oct                            the same for programs
  octinfo --verify bunny.oct                          check all of it: exit code 0, or 3 if it is damaged
";

impl Arguments for Args {
    fn common(&self) -> &Common {
        &self.common
    }
}

fn main() -> ExitCode {
    cli::run(tell)
}

fn tell(args: &Args, session: &Session<'_>) -> Result<ExitCode> {
    let octree = Octree::open(&args.model)?;
    if args.verify {
        octree.verify(session.monitor())?;
    }
    session.finish();
    let report = Report::new(&octree, args.verify)?;
    let text = if args.json { report.json()? } else { report.table() };
    let _ = Part::All;
    cli::output::print(&text)?;
    Ok(ExitCode::SUCCESS)
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    #[test]
    fn the_arguments_are_consistent() {
        super::Args::command().debug_assert();
    }
}
