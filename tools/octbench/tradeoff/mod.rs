//! `octbench tradeoff`: speed against error, this tracer and others on the same rays.
//!
//! On each mesh two sets of rays are traced, one aimed at edges and vertices and one of a camera: by the library, by naive tracers
//! ([`crate::yardstick`]), and by other programs. Every answer is held to the oracle's; speeds are taken on one thread, in turn. Gives a
//! table, JSON, and a plot as SVG and PNG.

mod contender;
mod lod;
mod lod_plot;
mod plot;
mod rays;
mod report;
mod tally;

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;

use octrace::build::BuildOptions;
use octrace::geometry::{Hit, Ray};
use octrace::map::Octree;
use octrace::output::drawing::Drawing;
use octrace::trace::OctreeTracer;
use octrace::{Error, Monitor, Result};
use rayon::ThreadPool;
use rayon::prelude::*;

use crate::bench::{load, octree, records};
use crate::cli::args::{StatsFile, is_stdio};
use crate::cli::output::{Whole, check, print, write_whole};
use crate::cli::{CHECK_FAILED, Session};
use crate::families::mesh::Mesh;
use crate::machine::Machine;
use crate::oracle::{Answer, Corners, Oracle, TierCounts};
use crate::planet;
use crate::speed::kernels::{self, KERNELS, Kernel};
use crate::speed::peer::Peer;
use crate::timing::{Clock, mrays};
use crate::yardstick::PlainOctree;
use contender::{Contender, Rays};
use report::{MeshNote, Report, Row};
use tally::{Tally, oracle_ray};

/// What the subcommand takes.
#[derive(clap::Args)]
pub struct Options {
    /// A mesh; may be repeated
    #[arg(long = "model", value_name = "FILE.obj")]
    models: Vec<PathBuf>,
    /// A planet of about so many triangles [default: 100,000 where no mesh is given]
    #[arg(long, value_name = "N", value_parser = crate::count)]
    planet: Option<u64>,
    /// Rays in each set: aimed at edges and vertices, and of a camera
    #[arg(long, value_name = "N", default_value = "100000", value_parser = crate::count)]
    rays: u64,
    /// Most rays of a set that the test of every triangle is given, evenly spread: it is slow
    #[arg(long, value_name = "N", default_value = "10000", value_parser = crate::count)]
    every_triangle: u64,
    /// Trace the rays of this file (32 bytes each) instead
    #[arg(long, value_name = "FILE")]
    rays_file: Option<PathBuf>,
    /// Hits of another tracer for the rays of --rays-file (16 bytes each)
    #[arg(long, value_name = "FILE", requires = "rays_file")]
    peer: Option<PathBuf>,
    /// Speed of that tracer in Mrays/s, as it was measured beside these
    #[arg(long, value_name = "X", requires = "peer")]
    peer_mrays: Option<f64>,
    /// A command that runs another tracer on the same rays
    ///
    /// {mesh} in it is the OBJ file's name; tests/peers/README.md tells how it is spoken to. May be repeated.
    #[arg(long = "peer-command", value_name = "CMD")]
    peers: Vec<String>,
    /// Kernels of the library to compare [default: the one for single rays, and the one that does the same with rounding]
    #[arg(long, value_name = "NAME,..", value_delimiter = ',', value_parser = kernels::named)]
    kernels: Vec<&'static Kernel>,
    /// An octree file to draw from afar over `octrender --lod` 0 to 4
    ///
    /// Tells time, what is read, and the picture's error. May be repeated. Without --model, --planet or --rays-file nothing else is compared.
    #[arg(long = "lod", value_name = "FILE.oct")]
    lod: Vec<PathBuf>,
    /// With --lod: width of the mesh in pixels
    #[arg(long, value_name = "N", default_value_t = 64, value_parser = clap::value_parser!(u32).range(1..=8192))]
    lod_across: u32,
    /// Rounds that are timed
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    rounds: u32,
    /// The clock to read
    ///
    /// The time that passed, or the processor's time, on a machine that others work on.
    #[arg(long, value_enum, default_value = "wall")]
    clock: Clock,
    /// Write the plot to NAME.svg and NAME.png
    #[arg(short, long, value_name = "NAME")]
    output: Option<PathBuf>,
    /// Print Markdown instead of a table
    #[arg(long)]
    markdown: bool,
    /// Seed of planet and rays
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    #[command(flatten)]
    stats: StatsFile,
}

/// A mesh with everything that answers rays on it.
struct Subject {
    name: String,
    mesh: Mesh,
    /// As OBJ, for peers.
    obj: PathBuf,
    octree: Arc<Octree>,
    corners: Vec<Corners>,
    plain: PlainOctree,
    oracle: Oracle,
}

/// Runs the comparison. Exit code 1: a tracer that claims to be exact is not.
pub fn run(options: &Options, session: &Session<'_>) -> Result<ExitCode> {
    options.stats.check()?;
    options.output.as_deref().map_or(Ok(()), |name| check(&name.with_extension("svg")))?;
    let monitor = session.monitor();
    let folder = tempfile::tempdir().map_err(Error::io(std::env::temp_dir(), "create"))?;
    let one = rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .build()
        .map_err(|e| Error::Option(format!("cannot start a thread: {e}")))?;
    let mut report = Report {
        schema: crate::cli::stats::SCHEMA,
        machine: Machine::here(),
        rounds: options.rounds,
        clock: options.clock,
        meshes: vec![],
        rows: vec![],
        summary: vec![],
        lod: vec![],
    };
    for path in &options.lod {
        monitor.phase("level of detail");
        report.lod.extend(lod::levels(path, options.lod_across, options.rounds, options.clock, monitor)?);
    }
    let bench = Bench { options, one: &one, folder: folder.path(), monitor };
    for (mesh, obj) in meshes(options, folder.path(), session)? {
        let subject = Subject::new(mesh, obj)?;
        report.meshes.push(MeshNote { mesh: subject.name.clone(), triangles: subject.mesh.faces.len() as u64 });
        let command = |text: &String| text.replace("{mesh}", &quoted(&subject.obj));
        let mut peers = options.peers.iter().map(|text| Peer::start(&command(text))).collect::<Result<Vec<_>>>()?;
        for (name, rays) in sets(options, &subject.mesh)? {
            monitor.phase("compare");
            monitor.check()?;
            report.rows.extend(compare(&bench, &subject, &name, &rays, &mut peers)?);
        }
    }
    report.sum_up();
    session.finish();
    if !options.stats.stats.as_deref().is_some_and(is_stdio) {
        print(&if options.markdown { report.markdown() } else { report.table() })?;
    }
    options.stats.write(&report)?;
    if let Some(name) = &options.output {
        let machine = report.machine.to_string();
        let write = |name: &Path, plot: Drawing| {
            write_whole(&name.with_extension("svg"), plot.svg().as_bytes())?;
            write_whole(&name.with_extension("png"), &plot.png()?)
        };
        if !report.rows.is_empty() {
            write(name, plot::draw(&report.rows, &machine))?;
        }
        if !report.lod.is_empty() {
            let mut text = name.clone().into_os_string();
            text.push("-lod");
            write(Path::new(&text), lod_plot::draw(&report.lod, &machine))?;
        }
    }
    let broken = report.broken();
    if !broken.is_empty() {
        session.say(format!("not exact: {}", broken.join("; ")));
        return Ok(ExitCode::from(CHECK_FAILED));
    }
    Ok(ExitCode::SUCCESS)
}

/// The meshes with their OBJ files; a planet's is written for the peers.
fn meshes(options: &Options, folder: &Path, session: &Session<'_>) -> Result<Vec<(Mesh, PathBuf)>> {
    let monitor = session.monitor();
    monitor.phase("meshes");
    let mut list = Vec::new();
    for path in &options.models {
        list.push((load(path, monitor)?, path.clone()));
    }
    let nothing_else = list.is_empty() && (options.lod.is_empty() || options.rays_file.is_some());
    let planet = options.planet.or(nothing_else.then_some(100_000));
    if let Some(triangles) = planet {
        let path = folder.join("planet.obj");
        let mut out = Whole::create(&path)?;
        planet::Planet::new(triangles, options.seed).write(&mut out, None, monitor)?;
        out.commit()?;
        list.push((planet::mesh(triangles, options.seed), path));
    }
    if options.rays_file.is_some() && list.len() != 1 {
        return Err(Error::Option("--rays-file goes with one mesh".to_owned()));
    }
    Ok(list)
}

/// The sets of rays for a mesh.
fn sets(options: &Options, mesh: &Mesh) -> Result<Vec<(String, Vec<Ray>)>> {
    if let Some(path) = &options.rays_file {
        let rays = records::<Ray>(path)?;
        if rays.is_empty() {
            return Err(Error::Input { file: path.clone(), what: "no rays in it; name another file".to_owned() });
        }
        return Ok(vec![(path.file_stem().unwrap_or_default().to_string_lossy().into_owned(), rays)]);
    }
    let aimed = rays::aimed(mesh, options.rays, options.seed);
    Ok(vec![("aimed".to_owned(), aimed), ("camera".to_owned(), rays::camera(mesh, options.rays))])
}

impl Subject {
    fn new(mesh: Mesh, obj: PathBuf) -> Result<Subject> {
        let corners: Vec<Corners> = mesh.triangles().collect();
        Ok(Subject {
            name: obj.file_stem().unwrap_or_default().to_string_lossy().into_owned(),
            obj: obj.canonicalize().map_err(Error::io(&obj, "open"))?,
            octree: octree(&mesh, &BuildOptions::default())?,
            plain: PlainOctree::new(corners.clone()),
            oracle: Oracle::new((0..).zip(corners.iter().copied())),
            corners,
            mesh,
        })
    }
}

/// What all comparisons share.
struct Bench<'a> {
    options: &'a Options,
    /// A pool of one thread.
    one: &'a ThreadPool,
    /// For files of rays and hits.
    folder: &'a Path,
    monitor: Monitor<'a>,
}

/// All tracers on one set of rays.
fn compare(bench: &Bench<'_>, subject: &Subject, set: &str, rays: &[Ray], peers: &mut [Peer]) -> Result<Vec<Row>> {
    let Bench { options, one, folder, monitor } = *bench;
    // A name of its own: peers keep the rays of the last file.
    let file = folder.join(format!("{set}.rays"));
    write_whole(&file, bytemuck::cast_slice(rays))?;
    let truth = |ray: &Ray| subject.oracle.closest(&oracle_ray(ray), &[], &mut TierCounts::default());
    let truths: Vec<Option<Answer>> = rays.par_iter().map(truth).collect();
    let set = format!("{}, {set}", subject.name);
    let rays = Rays { rays, file: &file };
    let row = |tracer: String, exact: bool, mrays_per_second: Option<f64>, step: usize, hits: &[Hit]| {
        let asked = rays.rays.iter().zip(&truths).step_by(step);
        let tally = Tally::new(&subject.mesh, asked, hits);
        Row { set: set.clone(), tracer, exact, mrays_per_second, error_rate: tally.error_rate(), tally }
    };
    let wanted = if options.rays_file.is_some() { rays.rays.len() as u64 } else { options.rays };
    let step = wanted.div_ceil(options.every_triangle) as usize;
    let mut contenders: Vec<Contender<'_>> = chosen(options)
        .map(|kernel| Contender::Library(kernel, OctreeTracer::new(&*subject.octree)))
        .chain([Contender::Octree(&subject.plain), Contender::Every(&subject.corners, step)])
        .chain(peers.iter_mut().map(Contender::Peer))
        .collect();
    let mut hits = Vec::new();
    for contender in &mut contenders {
        monitor.check()?;
        let found = contender.hits(&rays, &folder.join("tradeoff.hits"))?;
        hits.push(as_many(found, rays.rays.len().div_ceil(contender.step()), Path::new(&contender.name()))?);
    }
    let mut seconds = vec![vec![]; contenders.len()];
    for _ in 0..options.rounds {
        for (contender, seconds) in contenders.iter_mut().zip(&mut seconds) {
            seconds.push(contender.time(&rays, options.clock, one)?);
            monitor.check()?;
        }
    }
    let count = rays.rays.len() as u64;
    let mut rows: Vec<Row> = contenders
        .iter()
        .zip(seconds.iter().zip(&hits))
        .map(|(c, (seconds, hits))| row(c.name(), c.is_exact(), Some(mrays(count, seconds)), c.step(), hits))
        .collect();
    if let Some(path) = &options.peer {
        let found = as_many(records(path)?, rays.rays.len(), path)?;
        rows.push(row("peer".to_owned(), false, options.peer_mrays, 1, &found));
    }
    Ok(rows)
}

/// The kernels to compare.
fn chosen(options: &Options) -> impl Iterator<Item = &'static Kernel> {
    let is_single = |k: &Kernel| k.name == "single" || k.float_of == Some("single");
    let named = options.kernels.clone();
    KERNELS.iter().filter(move |k| {
        let wanted = if named.is_empty() { is_single(k) } else { named.iter().any(|n| n.name == k.name) };
        wanted && k.closest.is_some()
    })
}

/// Hits, one a ray.
fn as_many(hits: Vec<Hit>, rays: usize, file: &Path) -> Result<Vec<Hit>> {
    if hits.len() == rays {
        return Ok(hits);
    }
    let what = format!("{} hits for {rays} rays", hits.len());
    Err(Error::Input { file: file.to_owned(), what })
}

/// A path as one word of the shell.
fn quoted(path: &Path) -> String {
    format!("'{}'", path.display().to_string().replace('\'', "'\\''"))
}
