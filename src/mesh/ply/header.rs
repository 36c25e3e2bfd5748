//! The header of a PLY file: a text that says which elements follow, and how each is laid out.

use crate::error::Result;
use crate::mesh::bytes::Bytes;

/// How values are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Coding {
    Ascii,
    LittleEndian,
    BigEndian,
}

/// A type of number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Type {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

/// A property: a number, or a list of numbers after their count.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Property {
    pub name: String,
    pub of: Type,
    /// Type of the count, for a list.
    pub list: Option<Type>,
}

/// An element: so many items of the same properties.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Element {
    pub name: String,
    pub count: u64,
    pub properties: Vec<Property>,
}

/// All that the header says.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Header {
    pub coding: Coding,
    pub elements: Vec<Element>,
}

impl Type {
    fn of(name: &str) -> Option<Type> {
        Some(match name {
            "char" | "int8" => Type::I8,
            "uchar" | "uint8" => Type::U8,
            "short" | "int16" => Type::I16,
            "ushort" | "uint16" => Type::U16,
            "int" | "int32" => Type::I32,
            "uint" | "uint32" => Type::U32,
            "float" | "float32" => Type::F32,
            "double" | "float64" => Type::F64,
            _ => return None,
        })
    }

    /// Bytes of a number in a binary file.
    pub fn size(self) -> usize {
        match self {
            Type::I8 | Type::U8 => 1,
            Type::I16 | Type::U16 => 2,
            Type::I32 | Type::U32 | Type::F32 => 4,
            Type::F64 => 8,
        }
    }
}

impl Header {
    /// Reads a header to its end; the inner error says what is wrong with it.
    pub fn read(bytes: &mut Bytes<'_>) -> Result<Result<Header, String>> {
        let (mut coding, mut elements) = (None, Vec::<Element>::new());
        for number in 1.. {
            let Some(line) = bytes.line()? else {
                return Ok(Err(
                    "the header has no end: end_header is missing; the file was cut short or is no mesh".into()
                ));
            };
            let line = String::from_utf8_lossy(line).into_owned();
            let words: Vec<&str> = line.split_ascii_whitespace().collect();
            let wrong = || {
                Ok(Err(format!(
                    "line {number} of the header makes no sense: `{}`; correct it, or export the mesh again",
                    shortened(&line)
                )))
            };
            match (number, &words[..]) {
                (1, ["ply"]) => {}
                (1, _) => {
                    return Ok(Err(
                        "this is not a PLY file: it does not begin with `ply`; name it after what it is".into()
                    ));
                }
                (_, [] | ["comment" | "obj_info", ..]) => {}
                (_, ["format", name, _]) => match *name {
                    "ascii" => coding = Some(Coding::Ascii),
                    "binary_little_endian" => coding = Some(Coding::LittleEndian),
                    "binary_big_endian" => coding = Some(Coding::BigEndian),
                    _ => return wrong(),
                },
                (_, ["element", name, count]) => match count.parse() {
                    Ok(count) => elements.push(Element { name: (*name).into(), count, properties: Vec::new() }),
                    Err(_) => return wrong(),
                },
                (_, ["property", rest @ ..]) => match (property(rest), elements.last_mut()) {
                    (Some(property), Some(element)) => element.properties.push(property),
                    _ => return wrong(),
                },
                (_, ["end_header"]) => break,
                _ => return wrong(),
            }
            if number > MOST_LINES {
                return Ok(Err(format!(
                    "the header has more than {MOST_LINES} lines, the most that are read; take out comments"
                )));
            }
        }
        Ok(coding.map(|coding| Header { coding, elements }).ok_or_else(|| {
            "the header names no format (ascii, binary_little_endian or binary_big_endian); export the mesh again"
                .into()
        }))
    }
}

/// Lines that a header may have.
const MOST_LINES: usize = 100_000;

fn property(words: &[&str]) -> Option<Property> {
    match *words {
        ["list", count, of, name] => {
            let count = Type::of(count).filter(|t| !matches!(t, Type::F32 | Type::F64))?;
            Some(Property { name: name.into(), of: Type::of(of)?, list: Some(count) })
        }
        [of, name] => Some(Property { name: name.into(), of: Type::of(of)?, list: None }),
        _ => None,
    }
}

fn shortened(line: &str) -> String {
    line.chars().filter(|c| !c.is_control()).take(80).collect()
}
