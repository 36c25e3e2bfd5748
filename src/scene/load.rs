//! The ways to a [`Scene`]: from a file, from text, or for a mesh alone.

use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};

use glam::{DAffine3, DVec3};

use super::diagnose::Log;
use super::parser::Parser;
use super::source::{MAX_BYTES, take_limited};
use super::{Camera, Color, Instance, Light, Material, MeshFile, Scene, ToneMap};
use crate::error::{Error, Result};
use crate::event::{Event, Monitor};

/// How strictly a scene is read.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LoadOptions {
    /// Errors become warnings, and the line at fault is left out.
    pub lenient: bool,
}

impl Scene {
    /// Reads a scene file; `-` is standard input, whose names are relative to the current folder.
    ///
    /// Fails with [`Error::Text`], which holds all errors of the file and of those that it includes; with [`Error::Io`]
    /// or [`Error::Input`] where the file itself cannot be read. Warnings go to `monitor`.
    pub fn load(path: &Path, options: LoadOptions, monitor: Monitor<'_>) -> Result<Scene> {
        if path == Path::new("-") {
            let input = |what| Error::Input { file: "<stdin>".into(), what };
            let bytes = take_limited(io::stdin().lock(), MAX_BYTES).map_err(input)?;
            return Parser::new(Log::new(options.lenient, monitor)).read(bytes, "<stdin>", Path::new(""), None);
        }
        monitor.send(Event::File(path.to_owned()));
        let input = |what: String| Error::Input { file: path.to_owned(), what };
        let file = File::open(path).map_err(Error::io(path, "open"))?;
        if file.metadata().map_err(Error::io(path, "open"))?.is_dir() {
            return Err(input("this is a folder; name the scene file in it".into()));
        }
        let bytes = take_limited(file, MAX_BYTES).map_err(input)?;
        let folder = path.parent().unwrap_or(Path::new(""));
        let canonical = std::fs::canonicalize(path).ok();
        let parser = Parser::new(Log::new(options.lenient, monitor));
        parser.read(bytes, &path.to_string_lossy(), folder, canonical)
    }

    /// Reads a scene from text: `name` stands for its file in messages, and names of files are relative to `folder`.
    ///
    /// Fails with [`Error::Text`] as [`Scene::load`] does.
    pub fn parse(text: &str, name: &str, folder: &Path, options: LoadOptions, monitor: Monitor<'_>) -> Result<Scene> {
        let parser = Parser::new(Log::new(options.lenient, monitor));
        parser.read(text.as_bytes().to_vec(), name, folder, None)
    }

    /// A scene that shows one mesh, as for `octrender MODEL.oct`: pale clay unless its MTL says otherwise, framed by
    /// itself, on a floor, under a warm sun and a weaker, bluish one. `built`: the file is an octree already.
    ///
    /// The file is not looked at. Up is +y.
    pub fn for_mesh(path: impl Into<PathBuf>, built: bool) -> Scene {
        let gray = |k: f64| Color::splat(k);
        let clay = Material {
            ambient: Color::new(0.80, 0.79, 0.77),
            diffuse: Color::new(0.80, 0.79, 0.77),
            specular: gray(0.04),
            ..Material::default()
        };
        let floor = Material { ambient: gray(0.42), diffuse: gray(0.42), ..Material::default() };
        let sun = |x, y, z, color| Light::Sun { direction: DVec3::new(x, y, z).normalize(), color };
        Scene {
            size: [1024, 1024],
            camera: Camera::Auto,
            background: Color::new(0.55, 0.66, 0.80),
            ambient: 0.22,
            lights: vec![
                sun(-0.55, -1.0, -0.75, Color::new(0.74, 0.71, 0.66)),
                sun(0.90, -0.65, -0.35, Color::new(0.15, 0.18, 0.23)),
            ],
            materials: vec![clay, floor],
            meshes: vec![MeshFile { path: path.into(), built }],
            instances: vec![Instance { mesh: 0, material: 0, to_world: DAffine3::IDENTITY, mtl: true, smooth: true }],
            floor: Some(1),
            samples: 4,
            tonemap: ToneMap::Srgb,
            ..Scene::default()
        }
    }
}
