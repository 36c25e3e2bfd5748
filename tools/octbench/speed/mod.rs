//! `octbench speed`: rays per second by kernel, what a ray costs, and other tracers on the same rays.
//!
//! Sets of rays come from cameras, from where those hit, at random, or from files. Every kernel, and every other tracer
//! (`--peer-command`), traces a set in turn, round after round; only tracing is timed. Speeds are medians over the rounds, ratios
//! are medians of the rounds' own ratios.

pub mod figures;
pub mod kernels;
mod measure;
pub mod peer;
mod report;
pub mod sets;
pub mod view;

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use octrace::map::Octree;
use octrace::trace::Isa;
use octrace::{Error, Result};
use rayon::ThreadPool;

use crate::cli::args::{StatsFile, image_size, is_stdio};
use crate::cli::output::{print, write_whole};
use crate::cli::{CHECK_FAILED, Session};
use crate::timing::Clock;
use kernels::{KERNELS, Kernel};
use measure::{Own, Rounds};
use peer::Peer;
use report::Report;
use sets::{Kind, Question, RaySet};
use view::View;

/// What the subcommand takes.
#[derive(clap::Args)]
pub struct Options {
    /// The octree file
    #[arg(value_name = "MODEL.oct")]
    model: PathBuf,
    /// A camera [default: one that takes in everything]
    ///
    /// bunny-over, bunny-close, planet-over, planet-close, kitchen-outside, kitchen-inside, or NAME=EYE/LOOK/UP/FOV/LIGHT with points as
    /// X,Y,Z. May be repeated.
    #[arg(long = "view", value_name = "VIEW", value_parser = View::parse)]
    views: Vec<View>,
    /// Kinds of rays to make [default: all; none where files of rays are given]
    #[arg(long, value_name = "KIND,..", value_delimiter = ',')]
    sets: Vec<Kind>,
    /// Size of the cameras' picture
    #[arg(long, value_name = "WxH", default_value = "1024x1024", value_parser = image_size)]
    size: [u32; 2],
    /// Random chords to make
    #[arg(long, value_name = "N", default_value = "1e6", value_parser = crate::count)]
    chords: u64,
    /// Files of rays (32 bytes each) to find the closest hits of
    #[arg(long, value_name = "FILE", num_args = 1..)]
    rays: Vec<PathBuf>,
    /// Files of rays to ask only whether they hit anything
    #[arg(long, value_name = "FILE", num_args = 1..)]
    any_rays: Vec<PathBuf>,
    /// Write the rays that are made into this folder, NAME.rays
    #[arg(long, value_name = "DIR")]
    keep_rays: Option<PathBuf>,
    /// Kernels to measure [default: all]
    #[arg(long, value_name = "NAME,..", value_delimiter = ',', value_parser = kernels::named)]
    kernels: Vec<&'static Kernel>,
    /// Instruction sets: auto, all, or of scalar, avx2 and avx512
    #[arg(long, value_name = "SET,..", default_value = "auto", value_delimiter = ',')]
    isa: Vec<String>,
    /// Numbers of threads
    #[arg(long, value_name = "N,..", default_value = "1", value_delimiter = ',', value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Vec<u16>,
    /// Rounds that are timed
    #[arg(long, value_name = "N", default_value_t = 7, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    rounds: u32,
    /// The clock to read
    ///
    /// The time that passed, or the processor's time for one thread on a machine that others work on.
    #[arg(long, value_enum, default_value = "wall")]
    clock: Clock,
    /// A command that runs another tracer on the same rays
    ///
    /// tests/peers/README.md tells how it is spoken to. May be repeated.
    #[arg(long = "peer-command", value_name = "CMD")]
    peers: Vec<String>,
    /// Print Markdown instead of a table
    #[arg(long)]
    markdown: bool,
    #[command(flatten)]
    stats: StatsFile,
}

/// Measures and reports. Exit code 1: exact kernels differ in their answers.
pub fn run(options: &Options, session: &Session<'_>) -> Result<ExitCode> {
    options.stats.check()?;
    let monitor = session.monitor();
    if options.clock == Clock::Cpu && options.threads != [1] {
        return Err(Error::Option("--clock cpu measures one thread; leave --threads out".to_owned()));
    }
    let octree = Octree::open(&options.model)?;
    let isas = isas(&options.isa)?;
    let pools = options.threads.iter().map(|&n| pool(n)).collect::<Result<Vec<_>>>()?;
    let threads: Vec<usize> = pools.iter().map(ThreadPool::current_num_threads).collect();
    let kernels = if options.kernels.is_empty() { KERNELS.iter().collect() } else { options.kernels.clone() };
    let mut ways = Vec::new();
    for pool in &pools {
        for &isa in &isas {
            ways.extend(kernels.iter().map(|kernel| Own::new(&octree, kernel, isa, pool)));
        }
    }
    let sets = make_sets(options, &octree, session)?;
    let files = RayFiles::new(options, &sets)?;
    monitor.phase("peers");
    let mut peers = options.peers.iter().map(|command| Peer::start(command)).collect::<Result<Vec<_>>>()?;
    let mut report = Report::new(&octree, options.rounds, options.clock, &peers, monitor)?;
    let rounds = Rounds { count: options.rounds, threads: &threads, clock: options.clock, monitor };
    monitor.phase("trace");
    for (done, set) in sets.iter().enumerate() {
        monitor.progress(done as u64, Some(sets.len() as u64), "sets");
        let file = files.of(set);
        let outcome = measure::measure(set, file.as_deref(), &ways, &mut peers, &rounds)?;
        octree.fault()?;
        report.add(set, &ways, &peers, &outcome);
    }
    report.finish();
    session.finish();
    if !options.stats.stats.as_deref().is_some_and(is_stdio) {
        print(&if options.markdown { report.markdown() } else { report.table() })?;
    }
    options.stats.write(&report)?;
    Ok(if report.differing == 0 { ExitCode::SUCCESS } else { ExitCode::from(CHECK_FAILED) })
}

/// The instruction sets asked for, each once.
fn isas(names: &[String]) -> Result<Vec<Isa>> {
    let mut list = Vec::new();
    for name in names {
        let found = match name.as_str() {
            "auto" => vec![Isa::best()],
            "all" => Isa::available(),
            name => Isa::named(name).into_iter().collect(),
        };
        if found.is_empty() {
            let names: Vec<_> = Isa::available().into_iter().map(Isa::name).collect();
            return Err(Error::Option(format!("--isa {name}: this processor has auto, all, {}", names.join(", "))));
        }
        for isa in found {
            if !list.contains(&isa) {
                list.push(isa);
            }
        }
    }
    Ok(list)
}

fn pool(threads: u16) -> Result<ThreadPool> {
    rayon::ThreadPoolBuilder::new()
        .num_threads(threads.into())
        .build()
        .map_err(|e| Error::Option(format!("cannot start {threads} threads: {e}; ask for fewer")))
}

/// The sets asked for, in the order in which they are measured.
fn make_sets(options: &Options, octree: &Octree, session: &Session<'_>) -> Result<Vec<RaySet>> {
    let monitor = session.monitor();
    monitor.phase("rays");
    let mut sets = Vec::new();
    for (files, question) in [(&options.rays, Question::Closest), (&options.any_rays, Question::Any)] {
        for file in files {
            sets.push(RaySet::read(file, question)?);
        }
    }
    let kinds: &[Kind] = match (&options.sets[..], sets.is_empty() || !options.views.is_empty()) {
        ([], true) => &[Kind::Primary, Kind::Shadow, Kind::Mirror, Kind::Chords],
        (kinds, _) => kinds,
    };
    let whole = [View::around(octree.bounds())];
    let views = if options.views.is_empty() { &whole[..] } else { &options.views };
    if kinds.iter().any(|&k| k != Kind::Chords) {
        for view in views {
            sets.extend(sets::of_view(octree, view, options.size, kinds, monitor)?);
        }
    }
    if kinds.contains(&Kind::Chords) {
        sets.push(sets::chords(octree.bounds(), options.chords));
    }
    for (i, set) in sets.iter().enumerate() {
        if sets[..i].iter().any(|other| other.name == set.name) {
            return Err(Error::Option(format!("two sets of rays are called {}; rename one", set.name)));
        }
    }
    Ok(sets)
}

/// Where peers find the rays: files the user gave, or ones written for them.
struct RayFiles {
    folder: Option<PathBuf>,
    _temporary: Option<tempfile::TempDir>,
}

impl RayFiles {
    /// Writes the sets that were made, if somebody will read them.
    fn new(options: &Options, sets: &[RaySet]) -> Result<RayFiles> {
        let (folder, temporary) = match &options.keep_rays {
            Some(folder) => {
                std::fs::create_dir_all(folder).map_err(Error::io(folder, "create"))?;
                (Some(folder.canonicalize().map_err(Error::io(folder, "open"))?), None)
            }
            None if !options.peers.is_empty() => {
                let folder = tempfile::tempdir().map_err(Error::io(std::env::temp_dir(), "create"))?;
                (Some(folder.path().to_owned()), Some(folder))
            }
            None => (None, None),
        };
        let files = RayFiles { folder, _temporary: temporary };
        for set in sets.iter().filter(|set| set.file.is_none()) {
            if let Some(path) = files.of(set) {
                write_whole(&path, bytemuck::cast_slice(&set.rays))?;
            }
        }
        Ok(files)
    }

    fn of(&self, set: &RaySet) -> Option<PathBuf> {
        let made = |folder: &Path| folder.join(format!("{}.rays", set.name));
        set.file.clone().or_else(|| self.folder.as_deref().map(made))
    }
}
