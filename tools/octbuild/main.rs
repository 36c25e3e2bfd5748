//! octbuild: turns a mesh into an octree file.

#[path = "../cli/mod.rs"]
mod cli;
mod summary;

use std::io;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;

use clap::{Parser, ValueEnum};
use glam::DVec3;
use octrace::build::{self, BuildOptions};
use octrace::format::SplitMode;
use octrace::mesh::{self, ReadOptions};
use octrace::{Error, Result};

use cli::args::{Common, StatsFile, is_stdio};
use cli::{Arguments, Session};
use summary::Stats;

/// Turns a mesh into an octree file, which octrender, octtrace and octinfo read in place
#[derive(Parser)]
#[command(name = "octbuild", version, after_help = EXAMPLES)]
struct Args {
    /// The mesh: OBJ, also compressed (.obj.gz, .obj.zst); `-` is standard input
    #[arg(value_name = "INPUT")]
    input: PathBuf,
    /// The octree file to write
    #[arg(short, long, value_name = "OUT.oct")]
    output: PathBuf,
    /// Skip faces with a bad index and lines that cannot be read, and count them, instead of stopping there
    #[arg(long, help_heading = "Mesh")]
    lenient: bool,
    /// Subtract this point from all coordinates before they become f32; rays and scenes are then in that frame
    #[arg(long, value_name = "X,Y,Z", value_parser = cli::args::point, allow_hyphen_values = true, help_heading = "Mesh")]
    origin: Option<DVec3>,
    #[command(flatten)]
    tree: Tree,
    #[command(flatten)]
    common: Common,
    #[command(flatten)]
    stats: StatsFile,
}

/// How the tree is cut.
#[derive(clap::Args)]
#[command(next_help_heading = "Tree")]
struct Tree {
    /// How cells are split
    #[arg(long, value_enum, default_value_t = Split::Sah)]
    split: Split,
    /// Most triangles a page, from 1 [default: 16384, or 262144 for a file that fits in one page]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    brick: Option<u32>,
    /// Most triangles in a leaf record, 1 to 16 [default: 16]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(1..=16))]
    leaf: Option<u8>,
    /// With --split octree or strict: refine cells of more triangles than this; `all`: none [default: 16]
    #[arg(long, value_name = "N|all", value_parser = cli::args::count_or_all)]
    cell: Option<u32>,
    /// With --split octree or strict: deepest level of cells, 0 to 21 [default: 21]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(0..=21))]
    depth: Option<u8>,
    /// Leave out face ids: 4 bytes a triangle less, and hits name places in the file instead; large triangles are not cut
    #[arg(long)]
    no_ids: bool,
}

/// The split modes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Split {
    /// Octree cells down to pages, splits by surface area inside; the fastest to trace
    Sah,
    /// Octree cells all the way, each triangle stored once
    Octree,
    /// Octree cells all the way, a triangle stored in every cell it overlaps
    Strict,
}

const EXAMPLES: &str = "\
Examples:
  octbuild bunny.obj -o bunny.oct                     the usual case
  zstdcat big.obj.zst | octbuild - -o big.oct         from standard input
  octbuild city.obj -o city.oct --origin 4.5e5,5.4e6,0
                                                      coordinates too large for f32
  octbuild bunny.obj -o b.oct --split strict --cell 8 the textbook octree, to compare with
";

impl Arguments for Args {
    fn common(&self) -> &Common {
        &self.common
    }
}

impl Tree {
    /// The builder's options.
    fn options(&self) -> Result<BuildOptions> {
        if self.split == Split::Sah && (self.cell.is_some() || self.depth.is_some()) {
            let flag = if self.cell.is_some() { "--cell" } else { "--depth" };
            return Err(Error::Option(format!(
                "{flag} says when octree cells are refined: it needs --split octree or strict"
            )));
        }
        let default = BuildOptions::default();
        Ok(BuildOptions {
            split: match self.split {
                Split::Sah => SplitMode::Sah,
                Split::Octree => SplitMode::Octree,
                Split::Strict => SplitMode::Strict,
            },
            brick: self.brick.or(default.brick),
            leaf: self.leaf.unwrap_or(default.leaf),
            cell: self.cell.unwrap_or(default.cell),
            depth: self.depth.unwrap_or(default.depth),
            ids: !self.no_ids,
            ..default
        })
    }
}

fn main() -> ExitCode {
    cli::run(work)
}

fn work(args: &Args, session: &Session<'_>) -> Result<ExitCode> {
    let start = Instant::now();
    check_output(&args.input, &args.output)?;
    let origin = args.origin.unwrap_or_default().to_array();
    let options = BuildOptions { origin, name: Some(args.input.clone()), ..args.tree.options()? };
    let read = ReadOptions { lenient: args.lenient, origin, ..ReadOptions::default() };
    let mut source = mesh::open(&args.input, &read)?;
    let report = build::build(source.as_mut(), &args.output, &options, session.monitor())?;
    let seconds = start.elapsed().as_secs_f64();
    session.say(summary::line(&args.output, &report, seconds));
    args.stats.write(&Stats::new(&report, seconds))?;
    Ok(ExitCode::SUCCESS)
}

/// Refuses, before any work is done, a place where the finished file could not be put.
fn check_output(input: &Path, output: &Path) -> Result<()> {
    if is_stdio(output) {
        return Err(Error::Option(
            "an octree file cannot be written to standard output, since its header is written last; name a file".into(),
        ));
    }
    cli::output::check(output)?;
    if cli::output::is_special(output) {
        return Err(Error::io(output, "create")(io::Error::other("it is a device or a pipe; name a regular file")));
    }
    if cli::output::same_file(input, output) {
        return Err(Error::Option(format!("{}: input and output are the same file", input.display())));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn the_arguments_are_consistent() {
        Args::command().debug_assert();
    }

    #[test]
    fn without_flags_the_builders_defaults_hold() {
        let args = Args::try_parse_from(["octbuild", "a.obj", "-o", "a.oct"]).unwrap();
        assert_eq!(args.tree.options().unwrap(), BuildOptions::default());
    }

    #[test]
    fn flags_without_effect_are_refused() {
        for flag in [["--cell", "4"], ["--depth", "4"]] {
            let line = ["octbuild", "a.obj", "-o", "a.oct"].into_iter().chain(flag);
            assert!(Args::try_parse_from(line.clone()).unwrap().tree.options().is_err());
            let strict = Args::try_parse_from(line.chain(["--split", "strict"])).unwrap();
            assert!(strict.tree.options().is_ok());
        }
    }
}
