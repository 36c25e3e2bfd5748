//! octbench: how exact, how fast, and what one costs the other.
//!
//! It carries its own judge: an oracle that shares no line with the library ([`oracle`]), families of rays and meshes that
//! tracers get wrong ([`families`]), and naive tracers to compare with ([`yardstick`]).

mod accuracy;
mod bench;
#[path = "../cli/mod.rs"]
mod cli;
mod families;
mod machine;
mod mirrors;
mod oracle;
mod planet;
mod random;
mod speed;
mod timing;
mod tradeoff;
mod yardstick;

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;

use clap::{Parser, Subcommand};
use octrace::{Error, Result};

use accuracy::report::{FamilyReport, Report};
use accuracy::{Plan, closed, replay};
use cli::args::{Common, StatsFile};
use cli::output::{Whole, print};
use cli::{Arguments, CHECK_FAILED, Session};
use families::mesh::Mesh;

/// Measures accuracy, speed, and the trade between them
#[derive(Parser)]
#[command(name = "octbench", version, after_help = EXAMPLES)]
struct Args {
    #[command(subcommand)]
    command: Command,
    #[command(flatten)]
    common: Common,
}

const EXAMPLES: &str = "\
Examples:
  octbench mesh -n 1e5 -o planet.obj                  a mesh to try things with
  octbuild planet.obj -o planet.oct
  octbench accuracy --rays 1e5 --stats accuracy.json  all families of hard cases; more rays find more
  octbench accuracy --model planet.obj --rays 1e5     a mesh of your own
  octbench closed --rays 1e5
  octbench mirrors --paths 100 --bounces 1000
  octbench speed planet.oct --view planet-over --stats speed.json
  octbench figures speed.json
  octbench tradeoff --model planet.obj -o tradeoff    table, and plots tradeoff.svg and tradeoff.png
";

#[derive(Subcommand)]
enum Command {
    /// Hold the tracer to the exact oracle on the families of hard cases
    Accuracy(Accuracy),
    /// Replay cases kept as bit patterns
    Replay(Replay),
    /// Count crossings of a closed mesh, which must be even, and escapes from inside
    Closed(Closed),
    /// Follow paths through closed boxes of mirrors, which none may leave
    Mirrors(mirrors::Options),
    /// Rays per second by kernel, what a ray costs, and how other tracers do on the same rays
    Speed(speed::Options),
    /// One Markdown table of the statistics that several runs of `speed` wrote
    Figures(Figures),
    /// Speed against error: this tracer and naive ones, on the same rays
    Tradeoff(tradeoff::Options),
    /// Write a closed planet as OBJ
    Mesh(MeshOptions),
}

#[derive(clap::Args)]
struct Accuracy {
    /// Aim at this mesh instead of the families' own
    #[arg(long, value_name = "FILE.obj")]
    model: Option<PathBuf>,
    /// Move its vertices to a grid of a power of two first, so that they take 16 bits in the file
    #[arg(long, requires = "model")]
    grid: bool,
    /// Rays in all, spread over the families (1e6 reads as a million)
    #[arg(long, value_name = "N", default_value = "1e6", value_parser = count)]
    rays: u64,
    /// Only these families, by number
    #[arg(long, value_name = "N,N,..", value_delimiter = ',')]
    families: Vec<u32>,
    /// Seed of everything
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// Keep cases that disagree in this folder, to be replayed
    #[arg(long, value_name = "DIR")]
    keep: Option<PathBuf>,
    #[command(flatten)]
    stats: StatsFile,
}

#[derive(clap::Args)]
struct Replay {
    /// Files of cases
    #[arg(value_name = "FILE", required = true)]
    files: Vec<PathBuf>,
    #[command(flatten)]
    stats: StatsFile,
}

#[derive(clap::Args)]
struct Closed {
    /// A closed mesh [default: a planet of 101,568 triangles]
    #[arg(long, value_name = "FILE.obj")]
    model: Option<PathBuf>,
    /// Move its vertices to a grid of a power of two first, so that they take 16 bits in the file
    #[arg(long)]
    grid: bool,
    /// Rays aimed at vertices, middles of edges and points of faces
    #[arg(long, value_name = "N", default_value = "1e6", value_parser = count)]
    rays: u64,
    /// Seed of everything
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    #[command(flatten)]
    stats: StatsFile,
}

#[derive(clap::Args)]
struct Figures {
    /// Files that `octbench speed --stats` wrote
    #[arg(value_name = "FILE.json", required = true)]
    files: Vec<PathBuf>,
}

#[derive(clap::Args)]
struct MeshOptions {
    /// About so many triangles (12 n^2)
    #[arg(short = 'n', long = "triangles", value_name = "N", default_value = "1e6", value_parser = count)]
    triangles: u64,
    /// Where to write it; `-` is standard output
    #[arg(short, long, value_name = "FILE.obj")]
    output: PathBuf,
    /// Shuffle the faces, the worst case for locality
    #[arg(short = 'r', long)]
    shuffle: bool,
    /// Seed of hills and shuffle
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
}

impl Arguments for Args {
    fn common(&self) -> &Common {
        &self.common
    }
}

/// A count from 1: `1000`, `1e6`, `2.5e7`.
fn count(text: &str) -> std::result::Result<u64, String> {
    let number: f64 = text.parse().map_err(|_| "expected a count such as 1000 or 1e6".to_owned())?;
    let whole = (1.0..=1e15).contains(&number) && number.fract() == 0.0;
    if whole { Ok(number as u64) } else { Err("expected a whole number from 1 to 1e15".to_owned()) }
}

fn main() -> ExitCode {
    cli::run(work)
}

fn work(args: &Args, session: &Session<'_>) -> Result<ExitCode> {
    match &args.command {
        Command::Accuracy(options) => run_accuracy(options, session),
        Command::Replay(options) => run_replay(options, session),
        Command::Closed(options) => run_closed(options, session),
        Command::Mirrors(options) => mirrors::run(options, session).map(verdict),
        Command::Speed(options) => speed::run(options, session),
        Command::Figures(options) => print(&speed::figures::markdown(&options.files)?).map(|()| ExitCode::SUCCESS),
        Command::Tradeoff(options) => tradeoff::run(options, session),
        Command::Mesh(options) => write_mesh(options, session).map(|()| ExitCode::SUCCESS),
    }
}

/// Exit code of a check that found so many errors.
fn verdict(errors: u64) -> ExitCode {
    if errors == 0 { ExitCode::SUCCESS } else { ExitCode::from(CHECK_FAILED) }
}

/// Prints the table unless standard output carries the statistics.
fn table(stats: &StatsFile, text: &str) -> Result<()> {
    if stats_on_stdout(stats) { Ok(()) } else { print(text) }
}

/// Whether standard output carries the statistics.
fn stats_on_stdout(stats: &StatsFile) -> bool {
    stats.stats.as_deref().is_some_and(cli::args::is_stdio)
}

fn run_accuracy(options: &Accuracy, session: &Session<'_>) -> Result<ExitCode> {
    options.stats.check()?;
    let Accuracy { rays, seed, .. } = *options;
    let plan = Plan { rays, families: options.families.clone(), seed, keep: options.keep.clone() };
    if let Some(folder) = &plan.keep {
        std::fs::create_dir_all(folder).map_err(Error::io(folder, "create"))?;
    }
    let started = Instant::now();
    let seconds = || started.elapsed().as_secs_f64();
    let snapshot = |families: &[FamilyReport]| match stats_on_stdout(&options.stats) {
        true => Ok(()),
        false => options.stats.write(&Report::new(families, seed, seconds(), false)),
    };
    let monitor = session.monitor();
    let outcome = match &options.model {
        Some(path) => accuracy::run_model(&plan, &moved(bench::load(path, monitor)?, options.grid), monitor, &snapshot),
        None => accuracy::run(&plan, monitor, &snapshot),
    }?;
    finish(&Report::new(&outcome.families, seed, seconds(), outcome.complete), &options.stats, session)?;
    let errors = outcome.families.iter().map(FamilyReport::disagreements).sum();
    if outcome.complete { Ok(verdict(errors)) } else { Err(Error::Interrupted) }
}

/// The mesh, on a grid if asked for.
fn moved(mesh: Mesh, grid: bool) -> Mesh {
    if grid { mesh.on_grid() } else { mesh }
}

fn run_replay(options: &Replay, session: &Session<'_>) -> Result<ExitCode> {
    let started = Instant::now();
    let mut reports = Vec::new();
    for path in &options.files {
        let name = path.file_stem().unwrap_or_default().to_string_lossy();
        reports.push(replay::read(path)?.run(&name)?);
    }
    let report = Report::new(&reports, 0, started.elapsed().as_secs_f64(), true);
    finish(&report, &options.stats, session)?;
    Ok(verdict(report.disagreements))
}

/// The table, the statistics, and the summary.
fn finish(report: &Report, stats: &StatsFile, session: &Session<'_>) -> Result<()> {
    stats.write(report)?;
    table(stats, &report.table())?;
    session.say(report.summary().trim_end());
    Ok(())
}

fn run_closed(options: &Closed, session: &Session<'_>) -> Result<ExitCode> {
    options.stats.check()?;
    let monitor = session.monitor();
    let (mesh, name) = match &options.model {
        Some(path) => (bench::load(path, monitor)?, path.as_path()),
        None => (planet::mesh(101_568, options.seed), Path::new("planet")),
    };
    let mesh = moved(mesh, options.grid);
    let r = closed::run(&mesh, name, options.rays, options.seed, monitor)?;
    options.stats.write(&r)?;
    session.say(format!(
        "{} rays on {} triangles of {}: {} crossings, {} of wrong parity, {} escapes, {:.0} s",
        r.rays,
        r.triangles,
        name.display(),
        r.crossings,
        r.wrong_parity,
        r.escapes,
        r.seconds
    ));
    Ok(verdict(r.wrong_parity + r.escapes))
}

fn write_mesh(options: &MeshOptions, session: &Session<'_>) -> Result<()> {
    let planet = planet::Planet::new(options.triangles, options.seed);
    let shuffle = options.shuffle.then_some(options.seed);
    if cli::args::is_stdio(&options.output) {
        let mut out = std::io::BufWriter::new(std::io::stdout().lock());
        planet.write(&mut out, shuffle, session.monitor())?;
        return out.flush().map_err(Error::io("<stdout>", "write"));
    }
    let mut out = Whole::create(&options.output)?;
    planet.write(&mut out, shuffle, session.monitor())?;
    out.commit()?;
    session.say(format!("{} vertices, {} triangles", planet.vertices(), planet.triangles()));
    Ok(())
}
