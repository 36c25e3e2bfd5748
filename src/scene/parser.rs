//! The state machine that reads a scene from top to bottom.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::rc::Rc;

use glam::{DAffine3, DVec3};

use super::args::Args;
use super::command::{self, COMMANDS, CameraWish};
use super::diagnose::{Line, Log, Place, Problem, Step, quote};
use super::source::decode;
use super::suggest::did_you_mean;
use super::{Color, Material, Scene, lexer};
use crate::error::{Result, Severity};
use crate::event::Event;

/// Most commands of a scene with all that it includes.
pub(super) const MOST_COMMANDS: u64 = 1_000_000;

/// How deep files may include each other, the scene file itself counted.
pub(super) const MOST_INCLUDES: usize = 32;

/// How often the wish to stop is looked at, in lines.
const CHECK_LINES: u64 = 1 << 12;

/// What commands read and change.
pub(super) struct State {
    /// The scene so far.
    pub scene: Scene,
    /// The current material.
    pub material: Material,
    /// Named colours.
    pub colors: HashMap<String, Color>,
    /// Saved materials.
    pub saved: HashMap<String, Material>,
    /// The current transform.
    pub transform: DAffine3,
    /// Transforms to come back to, and where each was pushed.
    pub stack: Vec<(DAffine3, Place)>,
    /// Whether meshes take materials from their MTL.
    pub mtl: bool,
    /// Whether meshes are shaded with their vertex normals.
    pub smooth: bool,
    /// What has been said about the camera.
    pub camera: CameraWish,
    /// Numbers of meshes by file and whether it is an octree.
    pub mesh_numbers: HashMap<(PathBuf, bool), usize>,
    /// Folder of the file that is being read.
    pub folder: PathBuf,
    /// The files that are being read, the innermost last.
    pub including: Vec<OpenFile>,
    /// Files that the current command names.
    pub named: Vec<PathBuf>,
    /// A file to be read before the next line.
    pub included: Option<Include>,
    /// Bytes read so far.
    pub bytes: u64,
    material_numbers: HashMap<[u64; 14], usize>,
}

/// A scene file that is being read.
pub(super) struct OpenFile {
    /// Its one true name; empty for text that is not from a file.
    pub canonical: PathBuf,
    /// Its name for the user.
    pub name: Rc<str>,
}

/// A file that an `include` asks for.
pub(super) struct Include {
    /// Path as it can be opened.
    pub path: PathBuf,
    /// Its one true name.
    pub canonical: PathBuf,
    /// Its content.
    pub bytes: Vec<u8>,
}

impl State {
    fn new() -> Self {
        State {
            scene: Scene::default(),
            material: Material::default(),
            colors: HashMap::new(),
            saved: HashMap::new(),
            transform: DAffine3::IDENTITY,
            stack: Vec::new(),
            mtl: true,
            smooth: false,
            camera: CameraWish::default(),
            mesh_numbers: HashMap::new(),
            folder: PathBuf::new(),
            including: Vec::new(),
            named: Vec::new(),
            included: None,
            bytes: 0,
            material_numbers: HashMap::new(),
        }
    }

    /// Number of the current material; equal materials share one.
    pub fn material_index(&mut self) -> usize {
        let materials = &mut self.scene.materials;
        *self.material_numbers.entry(bits(&self.material)).or_insert_with(|| {
            materials.push(self.material);
            materials.len() - 1
        })
    }

    /// Where the current transform puts a point; it must be one that rays, which are f32, can reach.
    pub fn placed(&self, point: DVec3, args: &Args) -> Step<DVec3> {
        let placed = self.transform.transform_point3(point);
        if !placed.as_vec3().is_finite() {
            let message = "the transforms put this too far away: numbers go up to 3.4e38";
            return Err(Problem::new(args.span_from(1), message));
        }
        Ok(placed)
    }
}

/// A material as something that can be compared and hashed.
fn bits(m: &Material) -> [u64; 14] {
    let [a, d, s] = [m.ambient, m.diffuse, m.specular].map(|color| color.to_array());
    let k = [m.local, m.reflect, m.transmit, m.ior, m.shininess];
    [a[0], a[1], a[2], d[0], d[1], d[2], s[0], s[1], s[2], k[0], k[1], k[2], k[3], k[4]].map(f64::to_bits)
}

/// Reads lines, runs their commands, and collects what is wrong.
pub(super) struct Parser<'a> {
    log: Log<'a>,
    state: State,
    commands: u64,
}

impl<'a> Parser<'a> {
    pub fn new(log: Log<'a>) -> Self {
        Parser { log, state: State::new(), commands: 0 }
    }

    /// Reads a whole scene from the bytes of its main file; `canonical` is that file's one true name, if it has one.
    pub fn read(mut self, bytes: Vec<u8>, name: &str, folder: &Path, canonical: Option<PathBuf>) -> Result<Scene> {
        let name: Rc<str> = name.into();
        self.state.bytes = bytes.len() as u64;
        self.state.folder = folder.to_path_buf();
        self.state.including.push(OpenFile { canonical: canonical.unwrap_or_default(), name: name.clone() });
        self.file(bytes, &name)?;
        self.finish(&name)
    }

    fn file(&mut self, bytes: Vec<u8>, name: &Rc<str>) -> Result<()> {
        let (text, not_text) = decode(&bytes, name);
        drop(bytes);
        if let Some(diagnostic) = not_text {
            self.log.tell(diagnostic)?;
            if !self.log.lenient {
                return Ok(()); // each line of a binary file would be an error
            }
        }
        for (number, text) in (1..).zip(text.split('\n')) {
            let line = Line { file: name, number, text: text.strip_suffix('\r').unwrap_or(text) };
            if number % CHECK_LINES == 0 {
                self.log.monitor.check()?;
            }
            if let Err(problem) = self.line(line)? {
                self.log.tell(line.diagnostic(Severity::Error, problem))?;
            }
        }
        Ok(())
    }

    /// One line; the inner result is its first problem.
    fn line(&mut self, line: Line) -> Result<Step<()>> {
        let words = match lexer::words(line.text) {
            Ok(words) => words,
            Err(problem) => return Ok(Err(problem)),
        };
        let Some(word) = words.first() else { return Ok(Ok(())) };
        self.commands += 1;
        if self.commands > MOST_COMMANDS {
            let message = format!("a scene has at most {MOST_COMMANDS} commands");
            let problem = Problem::new(word.span.clone(), message).help("many shapes are better kept in a mesh");
            return Err(self.log.fatal(line.diagnostic(Severity::Error, problem)));
        }
        let Some(command) = command::find(word.text) else {
            let problem = Problem::new(word.span.clone(), format!("unknown command {}", quote(word.text)));
            return Ok(Err(problem.maybe_help(did_you_mean(word.text, COMMANDS.iter().map(|c| c.name)))));
        };
        let mut args = Args::new(line, &words, command.usage);
        let run = (command.run)(&mut self.state, &mut args);
        self.state.named.drain(..).for_each(|file| self.log.monitor.send(Event::File(file)));
        if let Err(problem) = run {
            return Ok(Err(problem));
        }
        args.warn_of_rest();
        for warning in args.warnings {
            self.log.tell(line.diagnostic(Severity::Warning, warning))?;
        }
        match self.state.included.take() {
            Some(include) => self.include(include, word),
            None => Ok(Ok(())),
        }
    }

    /// Reads an included file as if it stood in place of the command; only names in it are relative to its own folder.
    fn include(&mut self, include: Include, word: &lexer::Word) -> Result<Step<()>> {
        if self.state.including.len() == MOST_INCLUDES {
            let message = format!("files include each other at most {MOST_INCLUDES} deep");
            let names: Vec<_> = self.state.including.iter().map(|file| file.name.to_string()).collect();
            return Ok(Err(Problem::new(word.span.clone(), message).help(names.join(" includes "))));
        }
        let name: Rc<str> = include.path.to_string_lossy().into();
        let folder = include.path.parent().unwrap_or(Path::new("")).to_path_buf();
        let outer = std::mem::replace(&mut self.state.folder, folder);
        self.state.including.push(OpenFile { canonical: include.canonical, name: name.clone() });
        self.file(include.bytes, &name)?;
        self.state.including.pop();
        self.state.folder = outer;
        Ok(Ok(()))
    }

    /// What can be judged only now that all has been read.
    fn finish(mut self, name: &str) -> Result<Scene> {
        let (camera, told) = self.state.camera.finish();
        for diagnostic in told {
            self.log.tell(diagnostic)?;
        }
        for (_, place) in &self.state.stack {
            let help = "transforms end with the scene anyway, but a `pop` may be missing";
            self.log.tell(place.diagnostic(Severity::Warning, "this `push` has no `pop`", help))?;
        }
        let monitor = self.log.monitor;
        self.log.finish()?;
        let scene = Scene { camera, ..self.state.scene };
        if scene.shapes.is_empty() && scene.instances.is_empty() {
            monitor.warn(format!("{name}: nothing has been placed, so there is nothing to see"));
        }
        Ok(scene)
    }
}
