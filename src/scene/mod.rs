//! The scene: what a scene file says, ready to be shaded. docs/SCENE.md describes the language to its users.
//!
//! [`Scene::load`] reads a file from top to bottom, line by line: `lexer` cuts a line into words, `args` takes the
//! words of one command as numbers and names, `command` holds the table of commands, and `parser` the state that they
//! change. Whatever is wrong becomes a `diagnose::Problem` at a word; the reading goes on with the next line, so that
//! all errors of a file are told in one go. The classic part of the language is that of a small teaching ray tracer.
//!
//! Nothing here opens a mesh beyond seeing that it is there, and nothing needs its bounds: what does (framing, the
//! floor under everything) is left in the [`Scene`] as a wish that the renderer fulfils.

mod args;
mod command;
mod diagnose;
mod lexer;
mod load;
mod parser;
mod source;
mod suggest;

use std::path::PathBuf;

use glam::{DAffine3, DVec3};

pub use load::LoadOptions;

/// Longest side of a picture in pixels, whether a scene or an option asks for it; so with the limits below.
pub const MOST_SIDE: u32 = 1 << 16;
/// Most pixels of a picture.
pub const MOST_PIXELS: u64 = 1 << 31;
/// Most samples a pixel.
pub const MOST_SAMPLES: u32 = 1 << 16;
/// Most bounces.
pub const MOST_DEPTH: u32 = 10_000;

/// Linear RGB, 0..1 for reflectances.
pub type Color = DVec3;

/// A whole scene. Its default is the scene of an empty file.
#[derive(Clone, Debug, PartialEq)]
pub struct Scene {
    /// Image to write, if the scene says.
    pub output: Option<PathBuf>,
    /// Width and height in pixels.
    pub size: [u32; 2],
    /// The camera.
    pub camera: Camera,
    /// Where rays leave the scene.
    pub background: Color,
    /// Ambient intensity.
    pub ambient: f64,
    /// Lights.
    pub lights: Vec<Light>,
    /// Materials that shapes name by index.
    pub materials: Vec<Material>,
    /// Shapes that are not meshes, in scene order, already in world space.
    pub shapes: Vec<Shape>,
    /// Mesh files, each named once.
    pub meshes: Vec<MeshFile>,
    /// Placed meshes, in scene order.
    pub instances: Vec<Instance>,
    /// Material (index into `materials`) of a horizontal floor that the renderer puts under all that has been placed:
    /// a plane with normal +y at the lowest y. Only [`Scene::for_mesh`] asks for one; the language has `plane`.
    pub floor: Option<usize>,
    /// Samples per pixel, a square.
    pub samples: u32,
    /// Bounces.
    pub depth: u32,
    /// Meshes through the octree; else by testing every triangle.
    pub octree: bool,
    /// How linear light becomes stored values.
    pub tonemap: ToneMap,
}

impl Default for Scene {
    fn default() -> Self {
        Scene {
            output: None,
            size: [512, 512],
            camera: Camera::Auto,
            background: Color::ZERO,
            ambient: 0.1,
            lights: Vec::new(),
            materials: Vec::new(),
            shapes: Vec::new(),
            meshes: Vec::new(),
            instances: Vec::new(),
            floor: None,
            samples: 1,
            depth: 10,
            octree: true,
            tonemap: ToneMap::None,
        }
    }
}

/// The camera as the scene describes it, in world space.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum Camera {
    /// Nothing said: frame everything from a direction of our choice.
    #[default]
    Auto,
    /// Look along this direction (of unit length) and take in all that has been placed.
    Frame(DVec3),
    /// Classic: eye, bottom-left corner of the image rectangle, its full bottom and left edge.
    Rectangle {
        /// Eye point.
        eye: DVec3,
        /// Bottom-left corner.
        origin: DVec3,
        /// Bottom edge.
        horiz: DVec3,
        /// Left edge.
        vert: DVec3,
    },
    /// Eye, target, up, vertical field of view in degrees.
    LookAt {
        /// Eye point.
        eye: DVec3,
        /// Point looked at.
        at: DVec3,
        /// Up direction, of unit length, not along the line of sight.
        up: DVec3,
        /// Vertical field of view, degrees.
        fov: f64,
    },
}

/// A light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Light {
    /// Point light.
    Point {
        /// Where.
        position: DVec3,
        /// Intensity times colour.
        color: Color,
    },
    /// Light from infinitely far.
    Sun {
        /// Direction in which its light travels, of unit length.
        direction: DVec3,
        /// Intensity times colour.
        color: Color,
    },
}

/// A material of the scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Material {
    /// Ambient colour.
    pub ambient: Color,
    /// Diffuse colour.
    pub diffuse: Color,
    /// Specular colour.
    pub specular: Color,
    /// Weight of the local term.
    pub local: f64,
    /// Weight of the mirror term.
    pub reflect: f64,
    /// Weight of the refracted term.
    pub transmit: f64,
    /// Index of refraction.
    pub ior: f64,
    /// Blinn-Phong exponent.
    pub shininess: f64,
}

impl Default for Material {
    fn default() -> Self {
        Material {
            ambient: Color::ONE,
            diffuse: Color::ONE,
            specular: Color::ZERO,
            local: 1.0,
            reflect: 0.0,
            transmit: 0.0,
            ior: 1.0,
            shininess: 40.0,
        }
    }
}

/// A shape that is not a mesh.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shape {
    /// Its geometry.
    pub geometry: Geometry,
    /// Index into [`Scene::materials`].
    pub material: usize,
}

/// Geometry of a shape.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Geometry {
    /// A sphere, in its own space (see `to_world`).
    Sphere {
        /// Centre.
        center: DVec3,
        /// Radius, positive.
        radius: f64,
        /// Object to world; identity unless transforms were not a similarity.
        to_world: DAffine3,
    },
    /// An unbounded plane.
    Plane {
        /// A point on it.
        point: DVec3,
        /// Its normal, of unit length.
        normal: DVec3,
    },
    /// A triangle, exact as f32.
    Triangle(crate::geometry::Triangle),
    /// A rectangle: lower-left, lower-right, upper-right, and the fourth corner ll + ur - lr rounded to f32; traced as
    /// the triangles (ll, lr, ur) and (ll, ur, ul).
    Rectangle([glam::Vec3; 4]),
}

/// A mesh file that the scene names.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct MeshFile {
    /// Path, openable from the current folder.
    pub path: PathBuf,
    /// `true`: an octree file; `false`: a mesh to be built first (OBJ).
    pub built: bool,
}

/// A mesh placed in the scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Instance {
    /// Index into [`Scene::meshes`].
    pub mesh: usize,
    /// Index into [`Scene::materials`].
    pub material: usize,
    /// Object to world, invertible.
    pub to_world: DAffine3,
    /// Take materials from the mesh's MTL.
    pub mtl: bool,
    /// Shade with the mesh's vertex normals.
    pub smooth: bool,
}

/// How linear light becomes stored values.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ToneMap {
    /// Clamped and stored as it is.
    #[default]
    None,
    /// sRGB-encoded.
    Srgb,
}
