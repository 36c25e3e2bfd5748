//! Takes triangles out of an octree file again, as OBJ, in the order of their face ids.
//!
//! The file is walked in its own order, which is not that of the ids. So at most [`WINDOW`] triangles are gathered at a
//! time: the least ids not yet written. A mesh of more takes several passes over the file, in bounded memory. Vertices, texture
//! coordinates and normals are written where they are first used and shared, by their bits, within a window.

use std::collections::HashMap;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use octrace::error::folder_of;
use octrace::format::MaterialRecord;
use octrace::geometry::{Aabb, FaceId};
use octrace::map::Octree;
use octrace::trace::{Stored, triangles_in_box};
use octrace::{Error, Monitor, Result};

use crate::cli::args::{Part, is_stdio};
use crate::cli::output::{Whole, same_file};

/// Triangles gathered at a time.
const WINDOW: usize = 4 << 20;

/// What was taken out.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Extracted {
    /// Triangles.
    pub triangles: u64,
    /// Vertices.
    pub vertices: u64,
}

/// Refuses, before any work is done, an output whose OBJ or MTL file would take the place of the model or of each other.
pub fn check(model: &Path, output: &Path) -> Result<()> {
    crate::cli::output::check(output)?;
    let materials = output.with_extension("mtl");
    if materials == output {
        let what = "this is the name that the materials get; name an .obj file".into();
        return Err(Error::Input { file: output.to_owned(), what });
    }
    match [output, &materials].into_iter().find(|path| same_file(model, path)) {
        Some(path) => {
            Err(Error::Option(format!("{}: input and output are the same file; name another output", path.display())))
        }
        None => Ok(()),
    }
}

/// Writes a part of the mesh to `output` (`-`: standard output), and its materials to an MTL file beside it.
pub fn extract(octree: &Octree, part: Part, output: &Path, monitor: Monitor<'_>) -> Result<Extracted> {
    let part = match part {
        Part::All => None,
        Part::Box(part) => Some(part),
    };
    if is_stdio(output) {
        let out = BufWriter::with_capacity(1 << 20, std::io::stdout().lock());
        return ObjWriter::new(octree, out, "<stdout>".into(), None)?.write(part, WINDOW, monitor);
    }
    let materials = (!octree.materials().is_empty()).then(|| output.with_extension("mtl"));
    if let Some(path) = &materials {
        let text = mtl(octree, path)?;
        crate::cli::output::write_whole(path, text.as_bytes())?;
    }
    let mut file = Whole::create(output)?;
    let extracted =
        ObjWriter::new(octree, &mut file, output.to_owned(), materials.as_deref())?.write(part, WINDOW, monitor)?;
    file.commit()?;
    Ok(extracted)
}

/// An OBJ file being written.
struct ObjWriter<'a, W: Write> {
    octree: &'a Octree,
    out: W,
    name: PathBuf,
    material: u32,
    positions: Table<3>,
    texcoords: Table<2>,
    normals: Table<3>,
    done: Extracted,
}

/// Numbers of points that were written, by their bits.
#[derive(Default)]
struct Table<const N: usize> {
    numbers: HashMap<[u32; N], u64>,
    written: u64,
}

impl<const N: usize> Table<N> {
    /// The number of a point from 1, and whether it is new.
    fn number(&mut self, point: [f32; N]) -> (u64, bool) {
        let next = self.written + 1;
        let number = *self.numbers.entry(point.map(f32::to_bits)).or_insert(next);
        if number == next {
            self.written = next;
        }
        (number, number == next)
    }
}

impl<'a, W: Write> ObjWriter<'a, W> {
    /// Begins the file: its head and the name of its materials.
    fn new(octree: &'a Octree, mut out: W, name: PathBuf, materials: Option<&Path>) -> Result<Self> {
        let origin = octree.header().origin;
        let mut head = "# taken out of an octree file by octinfo\n".to_owned();
        if origin != [0.0; 3] {
            let [x, y, z] = origin;
            head += &format!("# the origin {x} {y} {z} was subtracted from the source and is not added back\n");
        }
        if let Some(file) = materials.and_then(Path::file_name) {
            head += &format!("mtllib {}\n", file.to_string_lossy());
        }
        out.write_all(head.as_bytes()).map_err(Error::io(&name, "write"))?;
        Ok(ObjWriter {
            octree,
            out,
            name,
            material: 0,
            positions: Table::default(),
            texcoords: Table::default(),
            normals: Table::default(),
            done: Extracted::default(),
        })
    }

    /// Writes the triangles that touch `part`, at most `window` of them gathered at a time.
    fn write(mut self, part: Option<Aabb>, window: usize, monitor: Monitor<'_>) -> Result<Extracted> {
        monitor.phase("extract");
        let mut from = Some(0);
        while let Some(least) = from {
            let (found, next) = self.gather(part, least, window, monitor)?;
            for triangle in &found {
                self.face(triangle)?;
            }
            monitor.progress(self.done.triangles, Some(self.octree.header().triangles), "triangles");
            self.positions.numbers.clear();
            self.texcoords.numbers.clear();
            self.normals.numbers.clear();
            from = next;
        }
        self.out.flush().map_err(Error::io(&self.name, "write"))?;
        self.done.vertices = self.positions.written;
        Ok(self.done)
    }

    /// The `window` triangles of least ids from `least` on, in order, and the id at which the next pass begins.
    fn gather(
        &self,
        part: Option<Aabb>,
        least: u32,
        window: usize,
        monitor: Monitor<'_>,
    ) -> Result<(Vec<Stored>, Option<u32>)> {
        let id = |f: &Stored| f.face;
        let mut found: Vec<Stored> = Vec::new();
        let mut end = FaceId::NONE;
        triangles_in_box(self.octree, part, &mut |f| {
            if id(&f) >= FaceId(least) && id(&f) < end {
                found.push(f);
                if found.len() == 2 * window {
                    monitor.check()?;
                    end = id(found.select_nth_unstable_by_key(window, id).1);
                    found.truncate(window);
                }
            }
            Ok(())
        })?;
        found.sort_unstable_by_key(id);
        found.dedup_by_key(|f| id(f));
        if found.len() > window {
            end = id(&found[window]);
            found.truncate(window);
        }
        Ok((found, (end != FaceId::NONE).then_some(end.0)))
    }

    /// Writes a triangle, and before it what it is the first to use.
    fn face(&mut self, found: &Stored) -> Result<()> {
        let (material, texcoords, normals) = self.octree.with_page(found.page, |page| {
            let reference = found.reference;
            (page.material(reference), page.texcoords(reference), page.normals(reference))
        })?;
        self.triangle(found, material, texcoords, normals).map_err(Error::io(&self.name, "write"))
    }

    fn triangle(
        &mut self,
        found: &Stored,
        material: u32,
        texcoords: Option<[[f32; 2]; 3]>,
        normals: Option<[[f32; 3]; 3]>,
    ) -> std::io::Result<()> {
        if material != self.material {
            self.material = material;
            let record = material.checked_sub(1).and_then(|i| self.octree.materials().get(i as usize));
            writeln!(self.out, "usemtl {}", record.map_or("", |r| self.octree.string(r.name)))?;
        }
        let mut corners = [String::new(), String::new(), String::new()];
        for (i, corner) in corners.iter_mut().enumerate() {
            let v = number(&mut self.positions, &mut self.out, "v", found.triangle.vertices()[i].to_array())?;
            let vt = texcoords.map(|t| number(&mut self.texcoords, &mut self.out, "vt", t[i])).transpose()?;
            let vn = normals.map(|n| number(&mut self.normals, &mut self.out, "vn", n[i])).transpose()?;
            *corner = match (vt, vn) {
                (None, None) => format!("{v}"),
                (Some(vt), None) => format!("{v}/{vt}"),
                (None, Some(vn)) => format!("{v}//{vn}"),
                (Some(vt), Some(vn)) => format!("{v}/{vt}/{vn}"),
            };
        }
        self.done.triangles += 1;
        writeln!(self.out, "f {} {} {}", corners[0], corners[1], corners[2])
    }
}

/// The number of a point in its table; a new one is written first, with the fewest digits that give the same f32 again.
fn number<const N: usize>(
    table: &mut Table<N>,
    out: &mut impl Write,
    keyword: &str,
    point: [f32; N],
) -> std::io::Result<u64> {
    let (number, new) = table.number(point);
    if new {
        write!(out, "{keyword}")?;
        point.iter().try_for_each(|x| write!(out, " {x}"))?;
        writeln!(out)?;
    }
    Ok(number)
}

/// The materials as an MTL file that will be named `path`.
fn mtl(octree: &Octree, path: &Path) -> Result<String> {
    let mut text = "# taken out of an octree file by octinfo\n".to_owned();
    for material in octree.materials() {
        text += &material_text(material, octree.string(material.name));
        let map = octree.string(material.map_kd);
        if !map.is_empty() {
            text += &format!("map_Kd {}\n", from_folder_of(path, octree.path(), map)?.display());
        }
    }
    Ok(text)
}

fn material_text(m: &MaterialRecord, name: &str) -> String {
    let given = |bit: u32| m.given >> bit & 1 == 1;
    let mut text = format!("newmtl {name}\n");
    for (bit, keyword, [r, g, b]) in [(0, "Ka", m.ka), (1, "Kd", m.kd), (2, "Ks", m.ks)] {
        if given(bit) {
            text += &format!("{keyword} {r} {g} {b}\n");
        }
    }
    for (bit, keyword, x) in [(3, "Ns", m.ns), (4, "Ni", m.ni), (5, "d", m.d)] {
        if given(bit) {
            text += &format!("{keyword} {x}\n");
        }
    }
    if given(6) {
        text += &format!("illum {}\n", m.illum);
    }
    text
}

/// The path `map`, which counts from the folder of `octree`, as it reads from the folder of `file`.
fn from_folder_of(file: &Path, octree: &Path, map: &str) -> Result<PathBuf> {
    let folder = |path: &Path| {
        let folder = folder_of(path);
        folder.canonicalize().map_err(Error::io(folder, "read"))
    };
    let (here, there) = (folder(file)?, folder(octree)?);
    Ok(if here == there { map.into() } else { there.join(map) })
}
