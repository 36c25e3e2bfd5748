//! Readers of mesh files: they stream vertices and faces, in file order, into a [`MeshSink`].
//!
//! A reader never holds the mesh: memory is bounded by a constant (a few read blocks), whatever the size of the file.

mod bytes;
mod input;
pub mod mtl;
mod names;
mod obj;
mod ply;
mod stl;

use std::path::Path;

use crate::error::{Error, Result};
use crate::event::Monitor;
use input::{Codec, Input};

/// How a mesh file is to be read.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReadOptions {
    /// Skip what is wrong and count it, instead of failing at the first wrong thing.
    pub lenient: bool,
    /// Subtracted from every vertex, in f64, before it becomes f32. Where a coordinate's origin is zero, the f32 is
    /// the one nearest to the decimal number in the file.
    pub origin: [f64; 3],
    /// Bytes of text in a block, the unit of reading and parsing; longer lines make longer blocks. See
    /// [`ReadOptions::within`].
    pub block: usize,
    /// Most bytes of a line, continued ones included; a longer one is an error.
    pub longest_line: usize,
    /// Most bytes that a decoder may hold of the text behind it; input packed with a larger window is an error.
    pub window: u64,
    /// Most bytes that the materials of an OBJ file may take, names and all; more are an error. Each takes some 200.
    pub material_memory: u64,
}

impl Default for ReadOptions {
    fn default() -> Self {
        ReadOptions {
            lenient: false,
            origin: [0.0; 3],
            block: 8 << 20,
            longest_line: 1 << 30,
            window: 1 << 31,
            material_memory: u64::MAX,
        }
    }
}

impl ReadOptions {
    /// Sets the size of blocks so that reading with `threads` threads takes about `memory` bytes at most (down to
    /// 64 KiB a block, up to 8 MiB).
    ///
    /// For t threads there are at most t + 4 blocks of text at a time, and the results of t + 1 of them, which may be
    /// three times as large as their text (`f 1/1/1 2/2/2 3/3/3`); allocators round up. A line may take half of the memory. The
    /// window of a packed input may take all of it, most of which blocks do not: they are smaller then.
    pub fn within(self, memory: u64, threads: usize) -> Self {
        let blocks = 4 * threads as u64 + 8;
        let block = (memory / blocks).clamp(64 << 10, 8 << 20) as usize;
        ReadOptions { block, longest_line: (memory / 2).max(1 << 20) as usize, window: memory, ..self }
    }

    /// The size of blocks of an input that is `packed` or not.
    fn block_of(&self, packed: bool) -> usize {
        if packed { (self.block / 2).max(self.block.min(64 << 10)) } else { self.block }
    }
}

/// Opens a mesh file for reading: `.obj`, `.ply` or `.stl`, each also with `.gz` or `.zst`, and `-` for standard input (OBJ,
/// also compressed).
///
/// Fails with [`Error::Input`] where the name says another format or the content is not what the name says, and with
/// [`Error::Io`] "open" where the file cannot be opened.
pub fn open(path: &Path, options: &ReadOptions) -> Result<Box<dyn TriangleSource>> {
    if path == Path::new("-") {
        return Ok(Box::new(obj::ObjSource::new(Input::stdin(), *options)));
    }
    let (form, codec) = form_of(path)?;
    let input = Input::file(path, codec)?;
    Ok(match form {
        Form::Obj => Box::new(obj::ObjSource::new(input, *options)),
        Form::Ply => Box::new(ply::PlySource::new(input, *options)),
        Form::Stl => Box::new(stl::StlSource::new(input, *options)),
    })
}

/// A format of mesh files.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Form {
    Obj,
    Ply,
    Stl,
}

/// What a mesh file is: its place, size and time of change, and how it is read, as text. `None` if it cannot be read twice.
pub fn identity(path: &Path, options: &ReadOptions) -> Option<String> {
    let place = path.canonicalize().ok()?;
    let how = if options.lenient { "lenient" } else { "strict" };
    Some(format!("{} {} {how}", place.display(), stamp(&place)?))
}

/// Size and time of change of a file, as text; `None` if it is not there, or no file.
pub(crate) fn stamp(path: &Path) -> Option<String> {
    let data = std::fs::metadata(path).ok()?;
    let changed = data.modified().ok()?.duration_since(std::time::UNIX_EPOCH).ok()?;
    data.is_file().then(|| format!("{} {}", data.len(), changed.as_nanos()))
}

/// Which format and compression the file's name promises.
fn form_of(path: &Path) -> Result<(Form, Option<Codec>)> {
    let name = path.file_name().map(|name| name.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
    let (stem, codec) = match () {
        _ if name.ends_with(".gz") => (&name[..name.len() - 3], Some(Codec::Gzip)),
        _ if name.ends_with(".zst") => (&name[..name.len() - 4], Some(Codec::Zstd)),
        _ => (&name[..], None),
    };
    let form = [(".obj", Form::Obj), (".ply", Form::Ply), (".stl", Form::Stl)].into_iter();
    match form.into_iter().find(|(suffix, _)| stem.ends_with(suffix)) {
        Some((_, form)) => Ok((form, codec)),
        None => {
            let what = match () {
                _ if path.is_dir() => "this is a folder; name the mesh file in it",
                _ if name.ends_with(".oct") => {
                    "this is an octree file by its name, and a mesh is wanted; name the mesh, or give octrender, octtrace or \
                     octinfo this file as it is"
                }
                _ => {
                    "not a mesh format this program knows by its name; it reads .obj, .ply and .stl, each also with .gz or \
                     .zst, and - for OBJ on standard input"
                }
            };
            Err(Error::Input { file: path.to_owned(), what: what.into() })
        }
    }
}

/// Something that streams a mesh, once, in file order.
pub trait TriangleSource {
    /// Sends the whole mesh into `sink`.
    ///
    /// Fails at the first wrong thing in the file, unless the reader was told to be lenient.
    fn read(&mut self, sink: &mut dyn MeshSink, monitor: Monitor<'_>) -> Result<SourceInfo>;

    /// Bytes of the input, if known before it is read.
    fn size_hint(&self) -> Option<u64>;

    /// How many triangles it is likely to hold, judged by its size, if that is known: of a text, one for 40 bytes.
    fn triangles_hint(&self) -> Option<u64> {
        self.size_hint().map(|bytes| bytes / 40)
    }
}

/// Where a mesh goes while it is read. Calls come in file order.
pub trait MeshSink {
    /// More vertex positions (the f32 values, origin subtracted; may be NaN or infinite).
    fn positions(&mut self, positions: &[[f32; 3]]) -> Result<()>;
    /// More texture coordinates (`vt`).
    fn texcoords(&mut self, texcoords: &[[f32; 2]]) -> Result<()>;
    /// More vertex normals (`vn`).
    fn normals(&mut self, normals: &[[f32; 3]]) -> Result<()>;
    /// More faces. They may name vertices that come later, or never (see [`FaceBatch`]).
    fn faces(&mut self, faces: &FaceBatch) -> Result<()>;
}

/// No texture coordinate or normal at a corner.
pub const NO_INDEX: u32 = u32::MAX;

/// Faces in file order, as flat arrays.
///
/// Corner numbers count from 0 and are absolute (negative ones are resolved). A number may lie beyond the vertices read
/// so far, since OBJ lets a face come before its vertices; one that is still out of range at the end of the file
/// is an error of the reader, or, when lenient, the sink drops the face and counts it as a bad index.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct FaceBatch {
    /// Corners of each face (3 or more), or `GAP | n`: a face that was skipped, whose fan would have had n triangles. Empty: all faces are triangles.
    pub sizes: Vec<u32>,
    /// Vertex number of each corner, faces one after another.
    pub corners: Vec<u32>,
    /// Texture coordinate number of each corner, [`NO_INDEX`] = none; empty = none at all.
    pub texcoords: Vec<u32>,
    /// Normal number of each corner, [`NO_INDEX`] = none; empty = none at all.
    pub normals: Vec<u32>,
    /// From which face (counted in this batch, gaps included) on which material number holds (0 = none, k = k-th
    /// name of [`SourceInfo::materials`]); the first entry is face 0.
    pub materials: Vec<(u32, u32)>,
}

impl FaceBatch {
    /// Marks a gap in `sizes`.
    pub const GAP: u32 = 1 << 31;
}

/// What a source knows when it has been read to its end.
#[derive(Clone, Debug, Default)]
pub struct SourceInfo {
    /// Names of materials in the order of first use; face material k is `materials[k - 1]`.
    pub materials: Vec<MaterialInfo>,
    /// Faces with fewer than three corners, dropped by the reader.
    pub too_few_corners: u64,
    /// Triangles of faces that were skipped for a bad index or number (lenient only); they stand as gaps in the batches.
    pub bad_index: u64,
    /// Files that it read beside its own, or found missing, as absolute paths: material libraries.
    pub files: Vec<std::path::PathBuf>,
}

/// A material of the mesh's MTL, `None` where the MTL does not say.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MaterialInfo {
    /// Its name.
    pub name: String,
    /// Ambient colour.
    pub ka: Option<[f32; 3]>,
    /// Diffuse colour.
    pub kd: Option<[f32; 3]>,
    /// Specular colour.
    pub ks: Option<[f32; 3]>,
    /// Specular exponent.
    pub ns: Option<f32>,
    /// Index of refraction.
    pub ni: Option<f32>,
    /// Opacity.
    pub d: Option<f32>,
    /// Illumination model.
    pub illum: Option<u32>,
    /// Diffuse texture, as a path that can be opened from the current folder.
    pub map_kd: Option<std::path::PathBuf>,
}
