//! What follows the header: the elements, one after the other.

use std::path::Path;

use super::header::{Coding, Element, Header, Property, Type};
use crate::error::{Error, Result};
use crate::mesh::bytes::Bytes;
use crate::mesh::obj::{parse_f32, parse_f64};
use crate::mesh::{FaceBatch, MeshSink, ReadOptions, SourceInfo};

/// Items that are sent on at a time.
const BATCH: usize = 1 << 15;

/// A number as it was read.
#[derive(Clone, Copy, Debug)]
enum Value {
    Single(f32),
    Double(f64),
    Whole(i64),
}

impl Value {
    fn to_f32(self, origin: f64) -> f32 {
        match self {
            Value::Single(x) if origin == 0.0 => x,
            Value::Single(x) => (f64::from(x) - origin) as f32,
            Value::Double(x) => (x - origin) as f32,
            Value::Whole(x) => (x as f64 - origin) as f32,
        }
    }

    fn to_whole(self) -> i64 {
        match self {
            Value::Single(x) => x as i64,
            Value::Double(x) => x as i64,
            Value::Whole(x) => x,
        }
    }
}

/// The elements, being read.
pub(super) struct Body<'a> {
    bytes: Bytes<'a>,
    header: &'a Header,
    options: ReadOptions,
    file: &'a Path,
    progress: &'a dyn Fn(),
    vertices: u64,
    info: SourceInfo,
    faces: FaceBatch,
    /// Whether any face of the batch is not a triangle.
    mixed: bool,
}

/// Where a vertex's values stand among its properties.
struct Places {
    position: [usize; 3],
    normal: Option<[usize; 3]>,
    texcoord: Option<[usize; 2]>,
}

impl<'a> Body<'a> {
    /// Begins after the header.
    pub fn new(
        bytes: Bytes<'a>,
        header: &'a Header,
        options: ReadOptions,
        file: &'a Path,
        progress: &'a dyn Fn(),
    ) -> Result<Body<'a>> {
        let (info, faces) = Default::default();
        let vertices = header.elements.iter().filter(|e| e.name == "vertex").map(|e| e.count).sum();
        let body = Body { bytes, header, options, file, progress, vertices, info, faces, mixed: false };
        if vertices > u64::from(u32::MAX) {
            return Err(
                body.wrong(format!("more than {} vertices, the most that can be counted; split the mesh", u32::MAX))
            );
        }
        Ok(body)
    }

    /// Reads everything.
    pub fn read(mut self, sink: &mut dyn MeshSink) -> Result<SourceInfo> {
        for element in &self.header.elements {
            match &element.name[..] {
                "vertex" => self.vertices(element, sink)?,
                "face" | "tristrips" => self.faces(element, sink)?,
                _ => self.others(element)?,
            }
        }
        Ok(self.info)
    }

    fn wrong(&self, what: String) -> Error {
        Error::Input { file: self.file.to_owned(), what }
    }

    /// The error for an input that ends too early.
    fn ended(&self, element: &Element, item: u64) -> Error {
        self.wrong(format!(
            "the file ends in the middle: {item} of {} items of `{}` are there; it was cut short, fetch it again",
            element.count, element.name
        ))
    }

    /// The next number; `None` at the end.
    #[inline]
    fn value(&mut self, of: Type) -> Result<Option<Value>> {
        if self.header.coding == Coding::Ascii {
            return self.written(of);
        }
        let big = self.header.coding == Coding::BigEndian;
        let Some(bytes) = self.bytes.take(of.size())? else { return Ok(None) };
        macro_rules! read {
            ($type:ty) => {{
                let bytes = bytes.try_into().unwrap_or_default();
                if big { <$type>::from_be_bytes(bytes) } else { <$type>::from_le_bytes(bytes) }
            }};
        }
        Ok(Some(match of {
            Type::I8 => Value::Whole(read!(i8).into()),
            Type::U8 => Value::Whole(read!(u8).into()),
            Type::I16 => Value::Whole(read!(i16).into()),
            Type::U16 => Value::Whole(read!(u16).into()),
            Type::I32 => Value::Whole(read!(i32).into()),
            Type::U32 => Value::Whole(read!(u32).into()),
            Type::F32 => Value::Single(read!(f32)),
            Type::F64 => Value::Double(read!(f64)),
        }))
    }

    /// The next number of a text.
    fn written(&mut self, of: Type) -> Result<Option<Value>> {
        let shifted = self.options.origin != [0.0; 3];
        let Some(word) = self.bytes.word()? else { return Ok(None) };
        let value = match of {
            Type::F32 if !shifted => parse_f32(word).map(Value::Single),
            Type::F32 | Type::F64 => parse_f64(word).map(Value::Double),
            _ => std::str::from_utf8(word).ok().and_then(|word| word.parse().ok()).map(Value::Whole),
        };
        match value {
            Some(value) => Ok(Some(value)),
            None => {
                let word: String = String::from_utf8_lossy(word).chars().take(40).collect();
                Err(self.wrong(format!(
                    "at byte {}: `{word}` is not a number of its type; correct it, or export the mesh again",
                    self.bytes.position()
                )))
            }
        }
    }

    /// The count of a list.
    fn length(&mut self, of: Type, element: &Element, item: u64) -> Result<usize> {
        let length = self.value(of)?.ok_or_else(|| self.ended(element, item))?.to_whole();
        match usize::try_from(length) {
            Ok(length) if length < FaceBatch::GAP as usize => Ok(length),
            _ => Err(self.wrong(format!(
                "item {item} of `{}` has a list of {length} numbers, more than there can be; the file is damaged, fetch it again",
                element.name
            ))),
        }
    }

    /// Passes over a property of an item; the value, if it is a single one.
    fn pass(&mut self, property: &Property, element: &Element, item: u64) -> Result<Value> {
        let Some(count) = property.list else {
            return self.value(property.of)?.ok_or_else(|| self.ended(element, item));
        };
        for _ in 0..self.length(count, element, item)? {
            self.value(property.of)?.ok_or_else(|| self.ended(element, item))?;
        }
        Ok(Value::Whole(0))
    }

    fn others(&mut self, element: &Element) -> Result<()> {
        // Items without properties take no bytes, however many there are said to be.
        let items = if element.properties.is_empty() { 0 } else { element.count };
        for item in 0..items {
            element.properties.iter().try_for_each(|property| self.pass(property, element, item).map(drop))?;
        }
        Ok(())
    }

    fn vertices(&mut self, element: &Element, sink: &mut dyn MeshSink) -> Result<()> {
        let place = |name: &str| element.properties.iter().position(|p| p.name == name && p.list.is_none());
        let three = |names: [&str; 3]| Some([place(names[0])?, place(names[1])?, place(names[2])?]);
        let two = |[a, b]: [&str; 2]| Some([place(a)?, place(b)?]);
        let position = three(["x", "y", "z"])
            .ok_or_else(|| self.wrong("its vertices have no x, y and z; export it with positions".into()))?;
        let texcoord = [["s", "t"], ["u", "v"], ["texture_u", "texture_v"]].into_iter().find_map(two);
        let places = Places { position, normal: three(["nx", "ny", "nz"]), texcoord };
        let mut values = vec![Value::Whole(0); element.properties.len()];
        let (mut positions, mut normals, mut texcoords) = (Vec::new(), Vec::new(), Vec::new());
        for item in 0..element.count {
            for (value, property) in values.iter_mut().zip(&element.properties) {
                *value = self.pass(property, element, item)?;
            }
            let origin = self.options.origin;
            positions.push([0, 1, 2].map(|axis| values[places.position[axis]].to_f32(origin[axis])));
            normals.extend(places.normal.map(|places| places.map(|i| values[i].to_f32(0.0))));
            texcoords.extend(places.texcoord.map(|places| places.map(|i| values[i].to_f32(0.0))));
            if positions.len() == BATCH || item + 1 == element.count {
                sink.positions(&positions)?;
                sink.normals(&normals)?;
                sink.texcoords(&texcoords)?;
                positions.clear();
                normals.clear();
                texcoords.clear();
                (self.progress)();
            }
        }
        Ok(())
    }

    fn faces(&mut self, element: &Element, sink: &mut dyn MeshSink) -> Result<()> {
        let is_corners = |p: &Property| p.list.is_some() && ["vertex_indices", "vertex_index"].contains(&&p.name[..]);
        if !element.properties.iter().any(is_corners) {
            return Err(
                self.wrong(format!("its element `{}` has no list vertex_indices; export it with faces", element.name))
            );
        }
        for item in 0..element.count {
            for property in &element.properties {
                match property.list {
                    Some(count) if is_corners(property) => {
                        let length = self.length(count, element, item)?;
                        if element.name == "face" && 12 * length > self.options.longest_line {
                            let what = format!(
                                "face {item} has {length} corners, more than fit in the memory allowed; allow more"
                            );
                            return Err(self.wrong(what));
                        }
                        match &element.name[..] {
                            "face" => self.face(property.of, length, element, item)?,
                            _ => self.strips(property.of, length, element, sink)?,
                        }
                    }
                    _ => drop(self.pass(property, element, item)?),
                }
            }
            if self.faces.corners.len() >= 3 * BATCH {
                self.send(sink)?;
            }
        }
        self.send(sink)
    }

    /// A corner's vertex, if there is one of that number.
    fn corner(&mut self, of: Type, element: &Element, item: u64) -> Result<Result<u32, i64>> {
        let number = self.value(of)?.ok_or_else(|| self.ended(element, item))?.to_whole();
        Ok(u32::try_from(number).ok().filter(|&n| u64::from(n) < self.vertices).ok_or(number))
    }

    fn face(&mut self, of: Type, length: usize, element: &Element, item: u64) -> Result<()> {
        let start = self.faces.corners.len();
        let mut bad = None;
        for _ in 0..length {
            match self.corner(of, element, item)? {
                Ok(corner) => self.faces.corners.push(corner),
                Err(number) => bad = Some(number),
            }
        }
        if length < 3 {
            self.faces.corners.truncate(start);
            self.info.too_few_corners += 1;
            return Ok(());
        }
        if let Some(number) = bad {
            self.refuse(element, item, number)?;
            self.faces.corners.truncate(start);
            self.info.bad_index += length as u64 - 2;
            self.end_face(start, FaceBatch::GAP | (length as u32 - 2));
        } else {
            self.end_face(start, length as u32);
        }
        Ok(())
    }

    /// Fails at a bad number, unless such faces are to be skipped.
    fn refuse(&self, element: &Element, item: u64, number: i64) -> Result<()> {
        if self.options.lenient {
            return Ok(());
        }
        let (name, vertices) = (&element.name, self.vertices);
        Err(self
            .wrong(format!("item {item} of `{name}` names vertex {number}, but there are {vertices}, counted from 0; --lenient drops such faces")))
    }

    /// Counts a face whose corners begin at `start`.
    fn end_face(&mut self, start: usize, size: u32) {
        if size != 3 && !self.mixed {
            // All before were triangles.
            self.faces.sizes = vec![3; start / 3];
            self.mixed = true;
        }
        if self.mixed {
            self.faces.sizes.push(size);
        }
    }

    /// Strips of triangles: each corner from the third on makes one with the two before, every other one turned.
    fn strips(&mut self, of: Type, length: usize, element: &Element, sink: &mut dyn MeshSink) -> Result<()> {
        let (mut last, mut held) = ([0; 2], 0u64);
        for item in 0..length as u64 {
            let corner = match self.corner(of, element, item)? {
                Ok(corner) => corner,
                Err(-1) => {
                    held = 0;
                    continue;
                }
                Err(number) => {
                    self.refuse(element, item, number)?;
                    u32::MAX // Dropped as a bad index once the triangles are joined.
                }
            };
            if held >= 2 {
                let [a, b] = if held.is_multiple_of(2) { last } else { [last[1], last[0]] };
                let start = self.faces.corners.len();
                self.faces.corners.extend([a, b, corner]);
                self.end_face(start, 3);
                if self.faces.corners.len() >= 3 * BATCH {
                    self.send(sink)?;
                }
            }
            (last, held) = ([last[1], corner], held + 1);
        }
        Ok(())
    }

    /// Sends on the faces so far. A vertex's normal and texture coordinate have its number.
    fn send(&mut self, sink: &mut dyn MeshSink) -> Result<()> {
        let mut faces = std::mem::take(&mut self.faces);
        self.mixed = false;
        let has = |names: &[&str]| {
            let vertex = self.header.elements.iter().find(|e| e.name == "vertex");
            vertex.is_some_and(|v| {
                names.iter().all(|name| v.properties.iter().any(|p| p.name == *name && p.list.is_none()))
            })
        };
        if has(&["nx", "ny", "nz"]) {
            faces.normals = faces.corners.clone();
        }
        if has(&["s", "t"]) || has(&["u", "v"]) || has(&["texture_u", "texture_v"]) {
            faces.texcoords = faces.corners.clone();
        }
        (self.progress)();
        if faces.corners.is_empty() && faces.sizes.is_empty() { Ok(()) } else { sink.faces(&faces) }
    }
}
