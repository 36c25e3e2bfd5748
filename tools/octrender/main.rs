//! octrender: draws a scene, an octree file or an OBJ file.

mod aovs;
#[path = "../cli/mod.rs"]
mod cli;
mod place;
mod statistics;

use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;

use clap::Parser;
use octrace::map::Octree;
use octrace::mesh::ReadOptions;
use octrace::output::{self, Format};
use octrace::render::{self, Picture, Settings};
use octrace::scene::{LoadOptions, MeshFile, Scene};
use octrace::shade::World;
use octrace::{Error, Result, open_or_build};

use aovs::AovFile;
use cli::args::{Common, StatsFile};
use cli::{Arguments, Session};
use place::{InputKind, Place};
use statistics::Stats;

/// Draws a scene file, or a mesh by itself: framed, lit, on a floor
#[derive(Parser)]
#[command(name = "octrender", version, after_help = EXAMPLES)]
struct Args {
    /// What to draw: a scene file (`-`: standard input), an octree file, or an OBJ file
    #[arg(value_name = "SCENE.txt|MODEL.oct|MODEL.obj")]
    input: PathBuf,
    /// The picture: PNG, EXR, HDR and others by suffix; `-` is PNG on standard output [default: what the scene says, or
    /// the input's name with .png]
    #[arg(short, long, value_name = "IMAGE")]
    output: Option<PathBuf>,
    /// Leave out lines of a scene, and faces of a mesh, that are wrong, and warn of them, instead of stopping there
    #[arg(long)]
    lenient: bool,
    #[command(flatten)]
    picture: PictureArgs,
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
    /// Draw only these pixels, counted from the top left corner; X1 and Y1 are not included
    #[arg(long, value_name = "X0,Y0,X1,Y1", value_parser = cli::args::pixels)]
    crop: Option<[u32; 4]>,
    /// Write a picture of data too, as .exr (the numbers) or .png (false colours); NAME is depth, normal, position, face,
    /// material, shadow, cost (nodes and leaves visited) or pages (entered); may be repeated
    #[arg(long, value_name = "NAME=FILE", value_parser = aovs::parse)]
    aov: Vec<AovFile>,
}

const EXAMPLES: &str = "\
Ctrl-C writes what is done so far as NAME.partial.png; a second Ctrl-C ends at once.
An OBJ file is built into an octree file once, MODEL.obj.cache.oct beside it, and reused while it does not change.

Examples:
  octrender bunny.oct                                 a picture bunny.png, nothing else to say
  octrender scenes/mirror_room.txt -o room.png --size 1920x1080 --samples 16
  octrender scene.txt -o light.exr                    linear light, unclamped
  octrender scene.txt --crop 400,300,500,400 --samples 64 -o detail.png
  octrender scene.txt --aov depth=depth.exr --aov cost=cost.png
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
    let scene = load(args, session)?;
    let place = Place::choose(args.output.as_deref(), scene.output.as_deref(), &args.input)?;
    if place == Place::Stdout {
        args.stats.not_stdout("the picture")?;
    }
    aovs::check(&args.picture.aov, &place, &args.input)?;
    let tonemap = scene.tonemap;
    let meshes = scene.meshes.iter().map(|mesh| open(mesh, args, session)).collect::<Result<Vec<_>>>()?;
    let world = World::new(scene, meshes.clone(), session.monitor())?;
    let PictureArgs { size, samples, depth, crop, ref aov } = args.picture;
    let settings = Settings { size, samples, depth, crop, ..Settings::default() };
    let before = cli::stats::cpu_seconds();
    let picture = render::render(&world, &settings, session.monitor())?;
    let trace_cpu_seconds = cli::stats::cpu_seconds() - before;
    meshes.iter().try_for_each(|mesh| mesh.fault())?;
    if !picture.complete {
        return broken_off(&picture, &place, tonemap, session);
    }
    session.monitor().phase("write");
    match &place {
        Place::Stdout => cli::output::print_bytes(&output::encode(&picture.film, Format::PNG, tonemap)?)?,
        Place::File(path) => output::save(&picture.film, path, tonemap)?,
    }
    aovs::write(aov, &world, &settings, session)?;
    let stats = Stats::new(&picture, trace_cpu_seconds, &meshes);
    session.say(stats.line(&place));
    args.stats.write(&stats)?;
    Ok(ExitCode::SUCCESS)
}

/// The scene that the input is, or that shows it.
fn load(args: &Args, session: &Session<'_>) -> Result<Scene> {
    match InputKind::of(&args.input) {
        InputKind::Octree => Ok(Scene::for_mesh(&args.input, true)),
        InputKind::Mesh => Ok(Scene::for_mesh(&args.input, false)),
        InputKind::Scene => Scene::load(&args.input, LoadOptions { lenient: args.lenient }, session.monitor()),
    }
}

/// Opens a mesh of the scene; one that is no octree file yet is built first, once.
fn open(mesh: &MeshFile, args: &Args, session: &Session<'_>) -> Result<Arc<Octree>> {
    if mesh.built {
        return Octree::open(&mesh.path).map(Arc::new);
    }
    let read = ReadOptions { lenient: args.lenient, ..ReadOptions::default() };
    open_or_build(&mesh.path, &read, session.monitor()).map(Arc::new)
}

/// Leaves what was drawn before the user stopped it under a name of its own.
fn broken_off(
    picture: &Picture,
    place: &Place,
    tonemap: octrace::scene::ToneMap,
    session: &Session<'_>,
) -> Result<ExitCode> {
    if let Some(partial) = place.partial() {
        output::save(&picture.film, &partial, tonemap)?;
        session.say(format!("wrote what was done so far to {}", partial.display()));
    }
    Err(Error::Interrupted)
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    #[test]
    fn the_arguments_are_consistent() {
        super::Args::command().debug_assert();
    }
}
