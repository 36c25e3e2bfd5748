//! octinfo: tells what is in an octree file, checks it, and takes meshes out of it.

#[path = "../cli/mod.rs"]
mod cli;
mod extract;
mod map;
mod report;

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::Parser;
use indicatif::HumanCount;
use octrace::map::Octree;
use octrace::{Error, Result};

use cli::args::{Common, Part, is_stdio};
use cli::{Arguments, Session};
use extract::extract;
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
    /// Write all triangles, or those that touch a box, as OBJ (needs -o)
    ///
    /// In the order of their ids. The box is in the file's frame.
    #[arg(long, value_name = "all|X0,Y0,Z0,X1,Y1,Z1", value_parser = cli::args::part, allow_hyphen_values = true)]
    #[arg(requires = "output", help_heading = "Extract")]
    extract: Option<Part>,
    /// The OBJ file to write
    ///
    /// `-` is standard output. Materials go to an MTL file beside it.
    #[arg(short, long, value_name = "PART.obj", requires = "extract", help_heading = "Extract")]
    output: Option<PathBuf>,
    /// Draw a map of the file: what lies on each level of its tree, how full pages and leaves are, what its bytes are for; .png or .svg
    #[arg(long, value_name = "FILE.png")]
    map: Option<PathBuf>,
    #[command(flatten)]
    common: Common,
}

const EXAMPLES: &str = "\
Examples:
  octbench mesh -n 1e5 -o planet.obj                  a mesh to try things with
  octbuild planet.obj -o planet.oct
  octinfo planet.oct                                  counts, bytes by part, bounds, options
  octinfo --json planet.oct                           the same for programs
  octinfo --verify planet.oct                         check all of it: exit code 0, or 3 if it is damaged
  octinfo planet.oct --map map.png                    where its bytes lie and how full it is, as a picture
  octinfo planet.oct --extract all -o back.obj        the whole mesh again
  octinfo planet.oct --extract 0,0,0,1,1,1 -o part.obj
                                                      the triangles that touch a box, in the file's frame
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
    let to_stdout = args.output.as_deref().is_some_and(is_stdio);
    if to_stdout && args.json {
        return Err(Error::Option("--json and -o - would both write to standard output; name a file".into()));
    }
    if let Some(output) = args.output.as_deref().filter(|_| !to_stdout) {
        extract::check(&args.model, output)?;
    }
    if let Some(path) = &args.map {
        map::check(&args.model, path)?;
        if args.output.as_deref().is_some_and(|output| cli::output::same_place(output, path)) {
            return Err(Error::Option(format!(
                "{}: --map and -o would both write it; name another file",
                path.display()
            )));
        }
    }
    let octree = Octree::open(&args.model)?;
    if args.verify {
        octree.verify(session.monitor())?;
    }
    let taken = match (args.extract, &args.output) {
        (Some(part), Some(output)) => Some((extract(&octree, part, output, session.monitor())?, output)),
        _ => None,
    };
    if let Some((taken, output)) = &taken {
        let (triangles, vertices) = (HumanCount(taken.triangles), HumanCount(taken.vertices));
        let place: &Path = if is_stdio(output) { Path::new("<stdout>") } else { output };
        session.say(format!("{}: {triangles} triangles, {vertices} vertices", place.display()));
    }
    if let Some(path) = &args.map {
        map::write(&octree, path, session.monitor())?;
        session.say(format!("{}: a map of {}", path.display(), args.model.display()));
    }
    if args.json || (taken.is_none() && args.map.is_none()) {
        let report = Report::new(&octree, args.verify, session.monitor())?;
        session.finish();
        cli::output::print(&if args.json { report.json()? } else { report.table() })?;
    } else if args.verify {
        session.say(format!("{}: every checksum and every rule holds", args.model.display()));
    }
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
