//! Sets of rays: primary rays of a camera, shadow and mirror rays from where they hit, random chords, and files.

use std::path::{Path, PathBuf};

use glam::{DVec3, Vec3};
use octrace::geometry::{Aabb, Ray, Skip};
use octrace::map::Octree;
use octrace::trace::{OctreeTracer, Tracer};
use octrace::{Error, Monitor, Result};
use serde::Serialize;

use super::view::View;
use crate::random::Random;

/// What is asked about the rays of a set.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Question {
    /// The closest hit.
    Closest,
    /// Whether anything is hit.
    Any,
}

impl Question {
    /// Its name, as a peer is asked.
    pub fn name(self) -> &'static str {
        match self {
            Question::Closest => "closest",
            Question::Any => "any",
        }
    }
}

/// The kinds of rays that are made here.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Kind {
    /// From the camera through each pixel
    Primary,
    /// From each point seen to the light
    Shadow,
    /// From each point seen, mirrored
    Mirror,
    /// Between random points of a sphere around the mesh
    Chords,
}

/// A set of rays.
pub struct RaySet {
    /// Its name: the view and the kind, or the file.
    pub name: String,
    /// What is asked.
    pub question: Question,
    /// The rays.
    pub rays: Vec<Ray>,
    /// The file they were read from.
    pub file: Option<PathBuf>,
}

impl RaySet {
    fn made(name: String, question: Question, rays: Vec<Ray>) -> RaySet {
        RaySet { name, question, rays, file: None }
    }

    /// Reads a file of rays: 8 little-endian f32 each.
    pub fn read(path: &Path, question: Question) -> Result<RaySet> {
        let rays = crate::bench::records::<Ray>(path)?;
        let wrong = |what: &str| Error::Input { file: path.to_owned(), what: what.to_owned() };
        if rays.is_empty() {
            return Err(wrong("no rays in it; name another file"));
        }
        let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let file = Some(path.canonicalize().map_err(Error::io(path, "open"))?);
        Ok(RaySet { name, question, rays, file })
    }
}

/// The sets of one view.
pub fn of_view(
    octree: &Octree,
    view: &View,
    size: [u32; 2],
    kinds: &[Kind],
    monitor: Monitor<'_>,
) -> Result<Vec<RaySet>> {
    let primary = view.primary(size);
    let mut sets = Vec::new();
    let name = |kind: &str| format!("{}.{kind}", view.name);
    if kinds.contains(&Kind::Shadow) || kinds.contains(&Kind::Mirror) {
        monitor.check()?;
        let (shadow, mirror) = secondary(octree, view, &primary)?;
        // Where the camera sees nothing there are none.
        let wanted = |kind, rays: &Vec<Ray>| kinds.contains(&kind) && !rays.is_empty();
        if wanted(Kind::Shadow, &shadow) {
            sets.push(RaySet::made(name("shadow"), Question::Any, shadow));
        }
        if wanted(Kind::Mirror, &mirror) {
            sets.push(RaySet::made(name("mirror"), Question::Closest, mirror));
        }
    }
    if kinds.contains(&Kind::Primary) {
        sets.insert(0, RaySet::made(name("primary"), Question::Closest, primary));
    }
    Ok(sets)
}

/// Shadow and mirror rays from where the primary rays hit: from 1e-5 of the box's diagonal above the surface, on the viewer's
/// side.
fn secondary(octree: &Octree, view: &View, primary: &[Ray]) -> Result<(Vec<Ray>, Vec<Ray>)> {
    let tracer = OctreeTracer::new(octree);
    let offset = 1e-5 * diagonal(octree.bounds());
    let (mut shadow, mut mirror) = (Vec::new(), Vec::new());
    for ray in primary {
        let Some(found) = tracer.closest(ray, Skip::NONE)? else { continue };
        let [a, b, c] = found.triangle.vertices().map(Vec3::as_dvec3);
        let d = Vec3::from(ray.direction).as_dvec3();
        let n = (b - a).cross(c - a).normalize();
        let n = if n.dot(d) > 0.0 { -n } else { n };
        let p = Vec3::from(ray.origin).as_dvec3() + f64::from(found.hit.t) * d + offset * n;
        shadow.push(Ray::new(p.as_vec3(), (view.light - p).as_vec3()).between(0.0, 1.0));
        mirror.push(Ray::new(p.as_vec3(), (d - 2.0 * d.dot(n) * n).normalize().as_vec3()));
    }
    Ok((shadow, mirror))
}

/// Rays between random points of the sphere around the box.
pub fn chords(bounds: Aabb, count: u64) -> RaySet {
    let mut random = Random::new(42);
    let middle = 0.5 * (bounds.min.as_dvec3() + bounds.max.as_dvec3());
    let radius = 0.5 * diagonal(bounds);
    let mut point = || middle + radius * DVec3::from_array(random.direction());
    let rays = (0..count)
        .map(|_| {
            let (from, to) = (point(), point());
            Ray::new(from.as_vec3(), (to - from).normalize().as_vec3())
        })
        .collect();
    RaySet::made("chords".to_owned(), Question::Closest, rays)
}

fn diagonal(bounds: Aabb) -> f64 {
    (bounds.max.as_dvec3() - bounds.min.as_dvec3()).length()
}
