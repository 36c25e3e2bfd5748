//! `octbench mirrors`: closed boxes of perfect mirrors, which no path may leave.
//!
//! A path is followed by the shading code itself ([`octrace::shade::MirrorPath`]): its own origins, its own mirrored directions. Three
//! things count as an escape: a ray that meets nothing, a mirror beside which no origin was found, and an origin that lies
//! outside, by the oracle's parity of crossings, which is asked every [`CHECK`] bounces and at the end of each path. A path that
//! is still inside after its last bounce has not escaped.

use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use glam::{DQuat, DVec3, EulerRot};
use octrace::Result;
use octrace::build::BuildOptions;
use octrace::event::Monitor;
use octrace::scene::{Instance, Material, MeshFile, Scene};
use octrace::shade::{Bounce, Mesh as ShadedMesh, World, WorldRay};
use octrace::trace::OctreeTracer;
use rayon::prelude::*;
use serde::Serialize;

use crate::accuracy::closed::{Place, place};
use crate::bench::octree;
use crate::cli::Session;
use crate::cli::args::StatsFile;
use crate::families::mesh::{self, Mesh};
use crate::oracle::Oracle;
use crate::random::Random;

/// What the subcommand takes.
#[derive(clap::Args)]
pub struct Options {
    /// Paths in each box
    #[arg(long, value_name = "N", default_value = "1e4", value_parser = crate::count)]
    paths: u64,
    /// Bounces of each path
    #[arg(long, value_name = "N", default_value = "1000", value_parser = crate::count)]
    bounces: u64,
    /// Only these boxes, by name
    #[arg(long, value_name = "NAME,..", value_delimiter = ',')]
    boxes: Vec<String>,
    /// Seed of everything
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    #[command(flatten)]
    stats: StatsFile,
}

/// A box: made in f64 from -half to half, turned, moved by `offset` along each axis, its corners then rounded to f32.
struct MirrorBox {
    name: &'static str,
    half: f64,
    turned: bool,
    offset: f64,
    /// Whether a sphere mesh of 512 triangles hangs in it.
    with_sphere: bool,
}

/// At 1e6 the step of f32 is 1/16: the small box there is 32 steps wide, the large one 2048.
const BOXES: [MirrorBox; 7] = [
    MirrorBox { name: "plain", half: 1.0, turned: false, offset: 0.0, with_sphere: false },
    MirrorBox { name: "rotated", half: 1.0, turned: true, offset: 0.0, with_sphere: false },
    MirrorBox { name: "small", half: 1e-6, turned: true, offset: 0.0, with_sphere: false },
    MirrorBox { name: "large", half: 1e6, turned: true, offset: 0.0, with_sphere: false },
    MirrorBox { name: "far", half: 64.0, turned: true, offset: 1e6, with_sphere: false },
    MirrorBox { name: "far-coarse", half: 1.0, turned: false, offset: 1e6, with_sphere: false },
    MirrorBox { name: "sphere", half: 1.0, turned: true, offset: 0.0, with_sphere: true },
];

/// Bounces between two questions to the oracle.
const CHECK: u64 = 250;

/// Paths a task takes.
const TASK: u64 = 256;

/// What was counted in one box.
#[derive(Clone, Debug, Default, Serialize)]
struct BoxReport {
    /// Its name.
    name: &'static str,
    /// Half its side.
    half: f64,
    /// Where its middle lies along each axis.
    offset: f64,
    /// Triangles.
    triangles: u64,
    /// Paths.
    paths: u64,
    /// Rays traced to find the next mirror; each origin takes one more.
    rays: u64,
    /// Paths of which a ray met nothing, or beside whose mirror no origin lies.
    lost: u64,
    /// Origins that the oracle finds outside.
    outside: u64,
    /// Origins that lie exactly on the surface.
    on_surface: u64,
    /// Bounces between surfaces so near each other that no f32 point lies between.
    wedged: u64,
    /// Origins that the oracle was asked about.
    checked: u64,
    /// Wall clock.
    seconds: f64,
}

/// What was counted.
#[derive(Serialize)]
struct Report<'a> {
    schema: u32,
    bounces: u64,
    escapes: u64,
    boxes: &'a [BoxReport],
}

impl BoxReport {
    fn escapes(&self) -> u64 {
        self.lost + self.outside
    }

    fn add(self, other: BoxReport) -> BoxReport {
        BoxReport {
            paths: self.paths + other.paths,
            rays: self.rays + other.rays,
            lost: self.lost + other.lost,
            outside: self.outside + other.outside,
            on_surface: self.on_surface + other.on_surface,
            wedged: self.wedged + other.wedged,
            checked: self.checked + other.checked,
            ..self
        }
    }

    fn line(&self) -> String {
        format!(
            "{:10} {:9} {:11} {:13} {:6} {:8} {:10} {:7} {:10} {:8.1} {:8.3}\n",
            self.name,
            self.triangles,
            self.paths,
            self.rays,
            self.lost,
            self.outside,
            self.on_surface,
            self.wedged,
            self.checked,
            self.seconds,
            self.rays as f64 / 1e6 / self.seconds.max(1e-9),
        )
    }
}

/// Follows paths in each box; the number of escapes.
pub fn run(options: &Options, session: &Session<'_>) -> Result<u64> {
    options.stats.check()?;
    let known = |name: &String| BOXES.iter().any(|b| b.name == name);
    if let Some(name) = options.boxes.iter().find(|name| !known(name)) {
        let names = BOXES.map(|b| b.name).join(", ");
        return Err(octrace::Error::Option(format!("no box is called {name}: there are {names}")));
    }
    crate::table(
        &options.stats,
        &format!(
            "{:10} {:>9} {:>11} {:>13} {:>6} {:>8} {:>10} {:>7} {:>10} {:>8} {:>8}\n",
            "box",
            "triangles",
            "paths",
            "rays",
            "lost",
            "outside",
            "on surface",
            "wedged",
            "checked",
            "seconds",
            "Mrays/s"
        ),
    )?;
    let mut reports = Vec::new();
    for b in BOXES.iter().filter(|b| options.boxes.is_empty() || options.boxes.iter().any(|n| n == b.name)) {
        let report = b.run(options, session.monitor())?;
        crate::table(&options.stats, &report.line())?;
        reports.push(report);
    }
    let escapes = reports.iter().map(BoxReport::escapes).sum();
    options.stats.write(&Report { schema: 1, bounces: options.bounces, escapes, boxes: &reports })?;
    let paths: u64 = reports.iter().map(|r| r.paths).sum();
    session.say(format!("{paths} paths of {} bounces: {escapes} escapes", options.bounces));
    Ok(escapes)
}

impl MirrorBox {
    /// From the box's own space, in which it reaches from -1 to 1, to where it stands.
    fn place(&self, p: DVec3) -> DVec3 {
        let turn = if self.turned { DQuat::from_euler(EulerRot::XYZ, 0.3, 1.1, -0.7) } else { DQuat::IDENTITY };
        turn * (self.half * p) + self.offset
    }

    fn mesh(&self, random: &mut Random) -> Mesh {
        let mut mesh = mesh::cube();
        if self.with_sphere {
            mesh.append(&mesh::sphere(3, 0.0, random).placed(0.4, [0.3, -0.2, 0.1]));
        }
        for p in &mut mesh.points {
            *p = self.place(DVec3::from(p.map(f64::from))).as_vec3().to_array();
        }
        mesh
    }

    fn run(&self, options: &Options, monitor: Monitor<'_>) -> Result<BoxReport> {
        let mesh = self.mesh(&mut Random::new(options.seed));
        let oracle = Oracle::new(mesh.triangles().enumerate().map(|(i, c)| (i as u32, c)));
        let world = world(&mesh)?;
        monitor.phase(self.name);
        let (started, done) = (Instant::now(), AtomicU64::new(0));
        let report = (0..options.paths.div_ceil(TASK))
            .into_par_iter()
            .map(|task| {
                let mut random = Random::new(options.seed ^ (task + 1) << 20);
                let count = TASK.min(options.paths - task * TASK);
                let mut report = BoxReport::default();
                for _ in 0..count {
                    let ray = self.first_ray(&mesh, &oracle, &mut random);
                    follow(&world, ray, options.bounces, &oracle, &mut random, &mut report)?;
                    monitor.check()?;
                }
                monitor.progress(done.fetch_add(count, Ordering::Relaxed) + count, Some(options.paths), "paths");
                Ok(report)
            })
            .try_reduce(BoxReport::default, |a, b| Ok(a.add(b)))?;
        Ok(BoxReport {
            name: self.name,
            half: self.half,
            offset: self.offset,
            triangles: mesh.faces.len() as u64,
            seconds: started.elapsed().as_secs_f64(),
            ..report
        })
    }

    /// A ray from a random place inside; one in four aims at a corner, one in four at the middle of an edge.
    fn first_ray(&self, mesh: &Mesh, oracle: &Oracle, random: &mut Random) -> WorldRay {
        let origin = loop {
            let p = self.place(0.95 * DVec3::from([0; 3].map(|_| random.signed()))).as_vec3();
            if place(oracle, p.to_array(), random) == Place::Inside {
                break p.as_dvec3();
            }
        };
        let corners = mesh.corners(random.below(mesh.faces.len())).map(|p| DVec3::from(p.map(f64::from)));
        let direction = match random.below(4) {
            0 => corners[0] - origin,
            1 => 0.5 * (corners[0] + corners[1]) - origin,
            _ => DVec3::from(random.direction()),
        };
        WorldRay::new(origin, direction)
    }
}

/// Follows one path.
fn follow(
    world: &World,
    ray: WorldRay,
    bounces: u64,
    oracle: &Oracle,
    random: &mut Random,
    report: &mut BoxReport,
) -> Result<()> {
    report.paths += 1;
    let mut path = world.mirror_path(ray);
    for bounce in 1..=bounces {
        report.rays += 1;
        let ray = match path.bounce()? {
            Some(Bounce::Free(ray)) => ray,
            Some(Bounce::Wedged) => {
                report.wedged += 1;
                continue;
            }
            None => {
                report.lost += 1;
                return Ok(());
            }
        };
        if bounce % CHECK == 0 || bounce == bounces {
            report.checked += 1;
            match place(oracle, ray.origin().as_vec3().to_array(), random) {
                Place::Inside => {}
                Place::OnSurface => report.on_surface += 1,
                Place::Outside => {
                    report.outside += 1;
                    return Ok(());
                }
            }
        }
    }
    Ok(())
}

/// The mesh as a scene of one mirror.
fn world(mesh: &Mesh) -> Result<World> {
    let tracer = OctreeTracer::new(octree(mesh, &BuildOptions::default())?);
    let scene = Scene {
        materials: vec![Material { local: 0.0, reflect: 1.0, ..Material::default() }],
        meshes: vec![MeshFile { path: PathBuf::from("mirrors"), built: true }],
        instances: vec![Instance { mesh: 0, material: 0, to_world: Default::default(), mtl: false, smooth: false }],
        ..Scene::default()
    };
    World::with_meshes(scene, vec![ShadedMesh::bare(Box::new(tracer))])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Without it the counts above could be zero for want of eyes.
    #[test]
    fn a_hole_is_found() {
        for b in &BOXES {
            let mut random = Random::new(1);
            let whole = b.mesh(&mut random);
            let oracle = Oracle::new(whole.triangles().enumerate().map(|(i, c)| (i as u32, c)));
            let mut broken = whole.clone();
            broken.faces.remove(5);
            let world = world(&broken).unwrap();
            let mut report = BoxReport::default();
            for _ in 0..50 {
                let ray = b.first_ray(&whole, &oracle, &mut random);
                follow(&world, ray, 1000, &oracle, &mut random, &mut report).unwrap();
            }
            assert!(report.lost + report.outside > 25, "{}: {report:?}", b.name);
        }
    }

    #[test]
    fn the_oracle_knows_inside_from_outside() {
        for b in &BOXES {
            let mut random = Random::new(2);
            let mesh = b.mesh(&mut random);
            let oracle = Oracle::new(mesh.triangles().enumerate().map(|(i, c)| (i as u32, c)));
            let mut at = |p: [f64; 3]| place(&oracle, b.place(DVec3::from(p)).as_vec3().to_array(), &mut random);
            assert_eq!(at([-0.8, 0.7, -0.6]), Place::Inside, "{}", b.name);
            assert_eq!(at([-0.8, 1.4, -0.6]), Place::Outside, "{}", b.name);
            assert_eq!(at([0.3, -0.2, 0.1]), if b.with_sphere { Place::Outside } else { Place::Inside }, "{}", b.name);
        }
        let cube = mesh::cube();
        let oracle = Oracle::new(cube.triangles().enumerate().map(|(i, c)| (i as u32, c)));
        assert_eq!(place(&oracle, [1.0, 0.25, 0.125], &mut Random::new(3)), Place::OnSurface);
    }
}
