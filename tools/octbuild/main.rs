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
use octrace::build::{self, BuildOptions, Positions};
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
    /// The mesh: OBJ, PLY or STL, also compressed (.obj.gz, .ply.zst); `-` is OBJ on standard input
    #[arg(value_name = "INPUT")]
    input: PathBuf,
    /// The octree file to write
    #[arg(short, long, value_name = "OUT.oct")]
    output: PathBuf,
    /// Leave out what is wrong in the mesh instead of stopping there
    ///
    /// Faces with a bad index and lines that cannot be read are skipped and counted.
    #[arg(long, help_heading = "Mesh")]
    lenient: bool,
    /// Subtract this point from all coordinates before they become f32
    ///
    /// For coordinates too large for f32 (maps, cities). Rays and scenes are then in that frame.
    #[arg(long, value_name = "X,Y,Z", value_parser = cli::args::point, allow_hyphen_values = true, help_heading = "Mesh")]
    origin: Option<DVec3>,
    #[command(flatten)]
    tree: Tree,
    #[command(flatten)]
    content: Content,
    #[command(flatten)]
    resources: Resources,
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
    /// Most triangles a page, from 1 [default: 16384; a mesh of up to some 125000 is one page]
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
    /// Leave out face ids: 4 bytes a triangle less
    ///
    /// Hits then name places in the file instead, and large triangles are not cut.
    #[arg(long)]
    no_ids: bool,
    /// Leave out what octrender's --lod needs: 0.3 to 0.6 bytes a triangle of a scan less
    #[arg(long)]
    no_lod: bool,
}

/// What is stored, and how.
#[derive(clap::Args)]
#[command(next_help_heading = "Content")]
struct Content {
    /// Positions as they are, or moved to a grid where they take half the bytes
    ///
    /// The grid is one for all; its step should be a power of two. Without a step it is 2^-19 to 2^-23 of the mesh's size.
    #[arg(long, value_name = "exact|grid[:STEP]", value_parser = positions, default_value = "exact")]
    positions: Positions,
    /// Pack pages, for shipping and slow disks
    ///
    /// They are unpacked into memory when they are used. The level is 1 to 22, 3 if not given.
    #[arg(long, value_name = "none|zstd[:LEVEL]", value_parser = compression, default_value = "none")]
    compress: Compression,
}

/// `exact`, `grid` or `grid:STEP`.
fn positions(text: &str) -> std::result::Result<Positions, String> {
    let step = |text: &str| text.parse::<f64>().ok().filter(|step| *step > 0.0 && step.is_finite());
    match (text, text.strip_prefix("grid:").and_then(step)) {
        ("exact", _) => Ok(Positions::Exact),
        ("grid", _) => Ok(Positions::Grid(None)),
        (_, Some(step)) => Ok(Positions::Grid(Some(step))),
        _ => Err("expected exact, grid, or grid:STEP with a positive number".into()),
    }
}

/// How pages are packed.
#[derive(Clone, Copy, Debug)]
struct Compression(Option<i32>);

/// `none`, `zstd` or `zstd:LEVEL`.
fn compression(text: &str) -> std::result::Result<Compression, String> {
    let level = match text {
        "none" => None,
        "zstd" => Some(3),
        _ => text.strip_prefix("zstd:").and_then(|level| level.parse().ok()).filter(|level| (1..=22).contains(level)),
    };
    match (text, level) {
        ("none", _) | (_, Some(_)) => Ok(Compression(level)),
        _ => Err("expected none, zstd, or zstd:LEVEL with a level from 1 to 22".into()),
    }
}

/// What a build may use.
#[derive(clap::Args)]
#[command(next_help_heading = "Resources")]
struct Resources {
    /// Bound on resident memory, at least 64M; what does not fit goes to temporary files [default: 1G]
    #[arg(long, value_name = "SIZE", value_parser = cli::args::size)]
    memory: Option<u64>,
    /// Folder for temporary files [default: the output's]
    #[arg(long, value_name = "DIR")]
    temp: Option<PathBuf>,
    /// Go on where a build of the same mesh to the same file was killed
    #[arg(long)]
    resume: bool,
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
  octbench mesh -n 1e5 -o planet.obj                  a mesh to try things with
  octbuild planet.obj -o planet.oct                   the usual case
  gzip -c planet.obj | octbuild - -o planet.oct       from standard input, packed or not
  octbuild planet.obj -o planet.oct --memory 128M     never above 128 MiB, whatever the size of the mesh
  octbuild planet.obj -o moved.oct --origin 4,2,0     another point as the origin, where coordinates are too large for f32
  octbuild planet.obj -o strict.oct --split strict --cell 8
                                                      the textbook octree, to compare with
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
            lod: !self.no_lod,
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
    args.stats.check()?;
    let origin = args.origin.unwrap_or_default().to_array();
    let tree = args.tree.options()?;
    let options = BuildOptions {
        origin,
        positions: args.content.positions,
        compress: args.content.compress.0,
        name: Some(args.input.clone()),
        memory: args.resources.memory.unwrap_or(tree.memory),
        temp: args.resources.temp.clone(),
        resume: args.resources.resume,
        source: mesh::identity(&args.input, &ReadOptions { lenient: args.lenient, ..Default::default() }),
        ..tree
    };
    if options.resume && options.source.is_none() && !args.input.exists() {
        return Err(Error::Option("--resume needs a mesh file that can be read again, not standard input".into()));
    }
    let material_memory = options.material_memory();
    let read = ReadOptions { lenient: args.lenient, origin, material_memory, ..ReadOptions::default() };
    let read = read.within(options.reading_memory(), rayon::current_num_threads());
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
        return Err(Error::Option(format!(
            "{}: input and output are the same file; name another output",
            input.display()
        )));
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
