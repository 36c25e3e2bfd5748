//! octrender: draws a scene, an octree file or an OBJ file.

mod aovs;
mod assemble;
#[path = "../cli/mod.rs"]
mod cli;
#[cfg(feature = "display")]
mod display;
mod live;
mod place;
mod shard;
mod statistics;
mod watch;

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;

use clap::Parser;
use octrace::build::BuildOptions;
use octrace::map::Octree;
use octrace::mesh::ReadOptions;
use octrace::output::{self, Format};
use octrace::render::{self, AovKind, Picture, Plan, Settings, Share, Statistics, Tile, Tiling};
use octrace::scene::{LoadOptions, MeshFile, Scene};
use octrace::shade::World;
use octrace::{Error, Result, find_or_build};

use aovs::AovFile;
use cli::args::{Common, StatsFile};
use cli::reading::{self, Reading};
use cli::{Arguments, Session};
use live::{Live, Shown};
use place::{InputKind, Place};
use statistics::Stats;

/// Draws a scene file, or a mesh by itself: framed, lit, on a floor
#[derive(Parser)]
#[command(name = "octrender", version, after_help = EXAMPLES)]
struct Args {
    /// What to draw: a scene file (`-`: standard input), an octree file, or a mesh (OBJ, PLY, STL, also .gz and .zst)
    #[arg(value_name = "SCENE.txt|MODEL.oct|MODEL.obj", required_unless_present = "assemble")]
    input: Option<PathBuf>,
    /// The picture: PNG, EXR, HDR and others by suffix
    ///
    /// `-` is PNG on standard output. Not given: what the scene says, or the input's name with .png. With --shard it is the part, or
    /// a folder for it.
    #[arg(short, long, value_name = "IMAGE")]
    output: Option<PathBuf>,
    /// Leave out what is wrong in scene or mesh, and warn of it, instead of stopping there
    #[arg(long)]
    lenient: bool,
    #[command(flatten)]
    picture: PictureArgs,
    #[command(flatten)]
    live: Live,
    #[command(flatten)]
    farm: Farm,
    #[command(flatten)]
    reading: Reading,
    #[command(flatten)]
    common: Common,
    #[command(flatten)]
    stats: StatsFile,
}

/// What the picture is like; each flag wins over the scene.
#[derive(clap::Args)]
#[command(next_help_heading = "Picture")]
struct PictureArgs {
    /// Width and height in pixels
    #[arg(long, value_name = "WxH", value_parser = cli::args::image_size)]
    size: Option<[u32; 2]>,
    /// Samples a pixel: 1, 4, 9, 16, ...
    #[arg(long, value_name = "N")]
    samples: Option<u32>,
    /// Bounces of mirrored and refracted rays
    #[arg(long, value_name = "N")]
    depth: Option<u32>,
    /// Draw only these pixels
    ///
    /// Counted from the top left corner; X1 and Y1 are not included.
    #[arg(long, value_name = "X0,Y0,X1,Y1", value_parser = cli::args::pixels)]
    crop: Option<[u32; 4]>,
    /// Write a picture of data too: depth, normal, position, face, material, shadow, cost, pages or reads
    ///
    /// As .exr (the numbers) or .png (false colours). Cost is the nodes and leaves visited, pages those entered, reads those that were waited for (with --memory). May be
    /// repeated. With --shard give NAME alone: the part takes the data; and NAME=FILE to --assemble.
    #[arg(long, value_name = "NAME=FILE|NAME", value_parser = aovs::parse)]
    aov: Vec<aovs::Wish>,
    /// Let parts of a mesh smaller than so many pixels stand for their triangles [default: 0]
    ///
    /// Faster from afar, fewer pages read, and off by at most that, which is told; 0 is exact.
    #[arg(long, value_name = "PX", value_parser = pixel_error, allow_negative_numbers = true)]
    lod: Option<f64>,
}

/// One picture by several machines.
#[derive(clap::Args)]
#[command(next_help_heading = "Several machines")]
struct Farm {
    /// Draw share I of N, counted from 0, into a part of the picture
    ///
    /// The part is NAME.part-I-of-N.exr. auto/N takes I, and auto takes both, from what the scheduler says: SLURM_ARRAY_TASK_ID and its
    /// like in an array of Slurm, or JOB_COMPLETION_INDEX in an indexed job of Kubernetes, which needs auto/N.
    #[arg(long, value_name = "I/N|auto/N|auto", value_parser = shard::parse)]
    shard: Option<shard::Wish>,
    /// Put the parts of a picture together; the same bytes as drawn by one machine
    ///
    /// With --aov NAME=FILE also the data that the parts have.
    #[arg(long, value_name = "PART", num_args = 1.., requires = "output", conflicts_with_all = ALONE)]
    assemble: Vec<PathBuf>,
}

/// Bytes that writing a pixel takes at most: a copy in the file's format, and the file.
const WRITING: u64 = 24;

/// What makes no sense where nothing is drawn.
const ALONE: [&str; 10] = ["input", "lenient", "size", "samples", "depth", "crop", "lod", "shard", "memory", "stats"];

/// An error in pixels: 0 or more.
fn pixel_error(text: &str) -> std::result::Result<f64, String> {
    let number = text.parse::<f64>().ok().filter(|x| *x >= 0.0 && x.is_finite());
    number.ok_or_else(|| "expected a number of pixels, 0 (exact) or more".to_owned())
}

const EXAMPLES: &str = "\
Ctrl-C writes what is done so far; a second Ctrl-C ends at once.
A mesh is built into an octree file once, which is reused while the mesh does not change.

Examples:
  octbench mesh -n 1e5 -o planet.obj                  a mesh to try things with
  octrender planet.obj                                a picture planet.png, nothing else to say
  octbuild planet.obj -o planet.oct
  octrender planet.oct -o large.png --size 1920x1080 --samples 16
  octrender planet.oct --memory 128M                  a file of any size, never above 128 MiB of memory
  octrender planet.oct --size 64x64 --lod 1 -o far.png
                                                      far away: nodes under a pixel stand for their triangles
  printf 'frame 1 -1 -2\\nsun -1 -2 -1 1\\nmat diff 1 0.8 0.6\\noct planet.oct\\n' > scene.txt
                                                      a scene file; SCENE.md has the language
  octrender scene.txt -o light.exr                    linear light, unclamped
  octrender scene.txt --crop 200,200,300,300 --samples 64 -o detail.png
  octrender scene.txt --aov depth=depth.exr --aov cost=cost.png
  octrender scene.txt --watch --preview 2             again whenever a file of it changes; what is done, every 2 s
  octrender scene.txt --shard 0/2                     the first of two shares: scene.part-0-of-2.exr
  octrender scene.txt --shard 1/2
  octrender --assemble scene.part-*-of-2.exr -o scene.png
  octrender scene.txt --shard 0/1 --aov depth -o part.exr     data of a share goes into its part
  octrender --assemble part.exr -o scene.png --aov depth=depth.exr

Files:
  MODEL.obj.cache.oct  the octree file of a mesh MODEL.obj, beside it or, where that cannot be written, in the user's cache folder
  NAME.partial.png     what was done when Ctrl-C came, beside the picture NAME.png
";

impl Arguments for Args {
    fn common(&self) -> &Common {
        &self.common
    }
}

fn main() -> ExitCode {
    cli::run(work)
}

fn work(args: &Args, session: &Session<'_>) -> Result<ExitCode> {
    args.stats.check()?;
    let Some(input) = &args.input else {
        assemble::assemble(&args.farm.assemble, args.output.as_deref(), &args.picture.aov, session)?;
        return Ok(ExitCode::SUCCESS);
    };
    if !args.live.watch {
        return draw(args, input, session);
    }
    if cli::args::is_stdio(input) || args.output.as_deref().is_some_and(cli::args::is_stdio) {
        return Err(Error::Option(
            "--watch draws from files into files, not by standard input or output: name files".into(),
        ));
    }
    watch::watch(input, session, |session| draw(args, input, session))
}

/// What is drawn, and where it goes.
enum Goal {
    Whole { place: Place, aovs: Vec<AovFile> },
    Share { share: Share, part: PathBuf, data: Vec<AovKind> },
}

impl Goal {
    fn choose(args: &Args, input: &Path, scene: &Scene) -> Result<Goal> {
        let (wish, said) = (args.output.as_deref(), scene.output.as_deref());
        let aovs = &args.picture.aov;
        if let Some(shard) = args.farm.shard {
            let share = shard.share()?;
            let data = aovs::for_part(aovs)?;
            return Ok(Goal::Share { share, part: shard::place(wish, said, input, share)?, data });
        }
        let place = Place::choose(wish, said, input)?;
        if place == Place::Stdout {
            args.stats.not_stdout("the picture")?;
            if args.live.preview.is_some() {
                return Err(Error::Option(
                    "--preview renews a file; standard output cannot be renewed: give -o IMAGE".into(),
                ));
            }
        }
        let aovs = aovs::files(aovs, &place, &[input], "the input")?;
        Ok(Goal::Whole { place, aovs })
    }

    fn place(&self) -> Place {
        match self {
            Goal::Whole { place, .. } => place.clone(),
            Goal::Share { part, .. } => Place::File(part.clone()),
        }
    }

    /// How many pictures of data are made.
    fn aovs(&self) -> usize {
        match self {
            Goal::Whole { aovs, .. } => aovs.len(),
            Goal::Share { data, .. } => data.len(),
        }
    }

    /// Bytes that writing takes beside what a plan provides for, which is that each pixel of one picture is written: a part is written at once, with all
    /// data of its share, and has room for more than its pixels.
    fn written_bytes(&self, size: [u32; 2]) -> Result<u64> {
        match self {
            Goal::Whole { .. } => Ok(0),
            Goal::Share { share, data, .. } => {
                let tiling = Tiling::new(size, *share)?;
                Ok(WRITING * ((1 + data.len()) * tiling.room() - tiling.pixels()) as u64)
            }
        }
    }
}

fn draw(args: &Args, input: &Path, session: &Session<'_>) -> Result<ExitCode> {
    let scene = load(input, args, session)?;
    let goal = Goal::choose(args, input, &scene)?;
    let place = goal.place();
    let tonemap = scene.tonemap;
    let paths = scene.meshes.iter().map(|mesh| find(mesh, args, session)).collect::<Result<Vec<_>>>()?;
    let (meshes, bound) = reading::open(&paths, &args.reading)?;
    let meshes: Vec<Arc<Octree>> = meshes.into_iter().map(Arc::new).collect();
    let PictureArgs { size, samples, depth, crop, lod, .. } = args.picture;
    let lod = lod.filter(|pixels| *pixels > 0.0);
    let world = World::new(scene, meshes.clone(), session.monitor())?.with_lod(lod.unwrap_or(0.0))?;
    let mut settings = Settings { size, samples, depth, crop, ..Settings::default() };
    let [width, height] = render::region(world.scene(), &settings)?;
    if let Some(memory) = bound {
        let shown = args.live.pixel_bytes() * u64::from(width) * u64::from(height);
        let beside = shown + goal.written_bytes([width, height])?;
        let plan = plan(&world, &settings, goal.aovs(), lod.is_some(), beside, memory, &meshes)?;
        (settings.tile, settings.wave) = (plan.tile, plan.wave);
        for mesh in &meshes {
            reading::warning(mesh.path(), mesh.header(), memory)
                .into_iter()
                .for_each(|text| session.monitor().warn(text));
        }
    }
    let before = cli::stats::cpu_seconds();
    let stats = |size, statistics: &Statistics, share| {
        let trace_cpu_seconds = cli::stats::cpu_seconds() - before;
        Stats::new(size, statistics, share, trace_cpu_seconds, &meshes, lod)
    };
    let shown = Shown { place: &place, size: [width, height], tonemap };
    let monitor = session.monitor();
    let stats = match &goal {
        Goal::Share { share, part, data } => {
            let draw =
                |watcher: &(dyn Fn(Tile<'_>) + Sync)| render::render_share(&world, &settings, *share, watcher, monitor);
            let (mut portion, statistics) = args.live.show(shown, monitor, draw)?;
            meshes.iter().try_for_each(|mesh| mesh.fault())?;
            let stats = stats([width, height], &statistics, Some(*share));
            portion.data = aovs::of_share(data, &world, &settings, *share, &meshes, session)?;
            // What pages take is free for writing the part.
            drop((world, meshes));
            monitor.phase("write");
            output::save_part(&portion, part)?;
            stats
        }
        Goal::Whole { place, aovs } => {
            let draw = |watcher: &(dyn Fn(Tile<'_>) + Sync)| render::render_shown(&world, &settings, watcher, monitor);
            let picture = args.live.show(shown, monitor, draw)?;
            meshes.iter().try_for_each(|mesh| mesh.fault())?;
            if !picture.complete {
                return broken_off(&picture, place, tonemap, args.live.watch, session);
            }
            let stats = stats([width, height], &picture.statistics, None);
            let mut drawn = Some((world, meshes));
            if aovs.is_empty() {
                // What pages take is free for writing the picture.
                drawn = None;
            }
            monitor.phase("write");
            match place {
                Place::Stdout => cli::output::print_bytes(&output::encode(&picture.film, Format::PNG, tonemap)?)?,
                Place::File(path) => output::save(&picture.film, path, tonemap)?,
            }
            if let Some((world, meshes)) = &drawn {
                aovs::write(aovs, world, &settings, meshes, session)?;
            }
            stats
        }
    };
    let stats = stats.finished();
    session.say(stats.line(&place));
    stats.lod_line().into_iter().for_each(|line| session.say(line));
    args.stats.write(&stats)?;
    Ok(ExitCode::SUCCESS)
}

/// The scene that the input is, or that shows it.
fn load(input: &Path, args: &Args, session: &Session<'_>) -> Result<Scene> {
    match InputKind::of(input) {
        InputKind::Octree => Ok(Scene::for_mesh(input, true)),
        InputKind::Mesh => Ok(Scene::for_mesh(input, false)),
        InputKind::Scene => Scene::load(input, LoadOptions { lenient: args.lenient }, session.monitor()),
    }
}

/// The octree file of a mesh of the scene; for one that is no octree file yet it is built first, once.
fn find(mesh: &MeshFile, args: &Args, session: &Session<'_>) -> Result<PathBuf> {
    if mesh.built {
        return Ok(mesh.path.clone());
    }
    let read = ReadOptions { lenient: args.lenient, ..ReadOptions::default() };
    let memory = args.reading.memory.unwrap_or(BuildOptions::default().memory);
    find_or_build(&mesh.path, &read, memory, session.monitor())
}

/// Shares the memory that is left out among waves of rays and the pages of all meshes. Each of the pictures of data takes its part too, and
/// what there is for level of detail, if that is asked for, and what shows the picture meanwhile or is written of it (`beside` bytes).
fn plan(
    world: &World,
    settings: &Settings,
    aovs: usize,
    lod: bool,
    beside: u64,
    memory: u64,
    meshes: &[Arc<Octree>],
) -> Result<Plan> {
    let headers: Vec<_> = meshes.iter().map(|mesh| *mesh.header()).collect();
    let leasts: Vec<u64> = meshes.iter().map(|mesh| mesh.least()).collect();
    let least = leasts.iter().sum::<u64>();
    let plan_for = |memory| Plan::new(world.scene(), settings, aovs, rayon::current_num_threads(), memory, least);
    let detail: u64 = if lod { meshes.iter().map(|mesh| mesh.detail_bytes()).sum() } else { 0 };
    let beside = detail + beside;
    let memory = memory.saturating_sub(beside);
    let plan = match reading::left_of(memory, &headers) {
        Err(taken) => Err(taken + plan_for(0)?.err().unwrap_or(0)),
        Ok(left) => plan_for(left)?.map_err(|least| memory - left + least),
    };
    let plan = plan.map_err(|least| reading::too_small(least + beside))?;
    // By what each would take as a whole, or nearly so.
    let whole = |mesh: &Octree| mesh.header().file_bytes;
    let wholes: u64 = meshes.iter().map(|mesh| whole(mesh)).sum();
    for (mesh, own) in meshes.iter().zip(&leasts) {
        let share = (plan.pages - least) as f64 * (whole(mesh) as f64 / wholes as f64);
        mesh.set_cache(own + share as u64);
    }
    Ok(plan)
}

/// Leaves what was drawn before the user stopped it under a name of its own.
fn broken_off(
    picture: &Picture,
    place: &Place,
    tonemap: octrace::scene::ToneMap,
    again: bool,
    session: &Session<'_>,
) -> Result<ExitCode> {
    // What is drawn again and again is of no use half done.
    if let Some(partial) = place.partial().filter(|_| !again) {
        output::save(&picture.film, &partial, tonemap)?;
        session.say(format!("wrote what was done so far to {}", partial.display()));
    }
    Err(Error::Interrupted)
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;
    use octrace::render::{AovKind, Share, Tiling};

    use super::Goal;

    #[test]
    fn what_a_part_has_room_for_is_provided() {
        let share = Share::new(0, 1).unwrap();
        let written = |size, data: &[AovKind]| {
            Goal::Share { share, part: "a.exr".into(), data: data.into() }.written_bytes(size).unwrap()
        };
        // Just its pixels.
        assert_eq!(written([512, 512], &[]), 0);
        assert_eq!(written([1, 65_536], &[]), 0);
        assert_eq!(written([1, 65_536], &[AovKind::Depth, AovKind::Normal]), 2 * 24 * 65_536);
        // Every other tile is a single column of pixels.
        let (narrow, pixels) = ([257, 65_536], 257 * 65_536);
        let room = Tiling::new(narrow, share).unwrap().room() as u64;
        assert!(room > 3 * pixels / 2);
        assert_eq!(written(narrow, &[AovKind::Face]), 24 * (2 * room - pixels));
    }

    #[test]
    fn the_arguments_are_consistent() {
        super::Args::command().debug_assert();
    }
}
