//! Shares of a picture as files, which travel from machine to machine: OpenEXR, f32, ZIP.
//!
//! The tiles of a share lie side by side, in rows of about as many as there are rows, in the order of the curve; what a tile leaves of its
//! cell, where it is cut at the picture's edge, is zero. Pictures of data of the share are further channels (`sheet.rs`). The text attribute `octracePart`
//! holds a JSON object that says which tiles these are, of which share and picture, what data there is, and a checksum of it all.
//!
//! A part may have been written by anybody. No more than its beginning is read, of bounded length, until what it says of itself is what its share
//! must have: side and number of its tiles first, then which these are, then size and channels of the pixels and the least length of the file. Memory
//! is taken for its tiles and for its pixels only if there is as much; its checksum is held to the pixels after.

use std::cell::Cell;
use std::fs::File;
use std::io::{self, BufReader, Cursor, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::rc::Rc;

use bytemuck::cast_slice;
use exr::block::reader::Reader;
use exr::meta::attribute::{AttributeValue, Text};
use exr::prelude::{Encoding, Image, Layer, LayerAttributes, ReadChannels, ReadLayers, WritableImage};
use serde::{Deserialize, Serialize};
use xxhash_rust::xxh3::Xxh3;

use super::sheet::Sheet;
use super::write;
use crate::error::{Error, Result};
use crate::render::{self, AovKind, Identity, Portion, Share, Tiling, Values};
use crate::scene::ToneMap;

/// The attribute that makes an EXR file a part.
const ATTRIBUTE: &str = "octracePart";
/// The version of what it says.
const VERSION: u32 = 2;
/// Most bytes before the pixels.
const MOST_HEAD: u64 = 8 << 20;
/// ZIP packs no tighter than 1:1032; the rest is for tables.
const TIGHTEST: u64 = 1100;

/// What an attribute of any version says.
#[derive(Deserialize)]
struct Version {
    part: u32,
}

/// What the attribute says.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Said {
    part: u32,
    octrace: String,
    /// Hexadecimal, as the checksum.
    scene: String,
    size: [u32; 2],
    crop: [u32; 4],
    samples: u32,
    depth: u32,
    tonemap: String,
    share: u32,
    of: u32,
    /// Side of a tile.
    tile: u32,
    /// Where the tiles stand along the curve.
    tiles: Vec<u32>,
    /// Names of the pictures of data.
    data: Vec<String>,
    /// Of all before, of the pixels, and of the values of each picture of data.
    checksum: String,
}

/// A part whose beginning was read and holds.
#[derive(Clone, Debug)]
pub struct Part {
    /// Where it lies.
    pub path: PathBuf,
    /// The picture that it belongs to.
    pub identity: Identity,
    /// Which share it is.
    pub share: Share,
    /// Which pictures of data it has.
    pub data: Vec<AovKind>,
    said: Said,
    tiling: Tiling,
}

impl Said {
    /// Reads it; fails for another version, whatever else that says.
    fn parse(text: &str) -> Result<Said, String> {
        let wrong = |e: serde_json::Error| format!("{ATTRIBUTE}: {e}");
        let Version { part } = serde_json::from_str(text).map_err(wrong)?;
        if part != VERSION {
            return Err(format!("it is a part of version {part}, and this program reads version {VERSION}"));
        }
        serde_json::from_str(text).map_err(wrong)
    }

    fn of(portion: &Portion, tiling: &Tiling) -> Said {
        let id = &portion.identity;
        let mut said = Said {
            part: VERSION,
            octrace: id.version.clone(),
            scene: format!("{:016x}", id.scene),
            size: id.whole,
            crop: id.crop,
            samples: id.samples,
            depth: id.depth,
            tonemap: name(id.tonemap).to_owned(),
            share: portion.share.index(),
            of: portion.share.of(),
            tile: tiling.side,
            tiles: tiling.numbers.clone(),
            data: portion.data.iter().map(|data| data.0.name().to_owned()).collect(),
            checksum: String::new(),
        };
        said.checksum = said.checksum_with(&portion.pixels, &portion.data);
        said
    }

    /// What the checksum has to be.
    fn checksum_with(&self, pixels: &[[f32; 3]], data: &[(AovKind, Values)]) -> String {
        let mut hash = Xxh3::new();
        let blank = Said { checksum: String::new(), ..self.clone() };
        // Numbers, texts and lists of these are always JSON.
        hash.update(&serde_json::to_vec(&blank).unwrap_or_default());
        hash.update(cast_slice(pixels));
        for (_, values) in data {
            hash.update(match values {
                Values::Scalar(values) => cast_slice(values),
                Values::Vector(values) => cast_slice(values),
                Values::Id(values) => cast_slice(values),
            });
        }
        format!("{:016x}", hash.digest())
    }

    /// The picture, the share, its tiles and its data, if they make sense together; else what does not.
    fn resolve(&self) -> Result<(Identity, Share, Tiling, Vec<AovKind>), String> {
        let [width, height] = self.size;
        let [x0, y0, x1, y1] = self.crop;
        if x0 >= x1 || y0 >= y1 || x1 > width || y1 > height || width.max(height) > 65_536 {
            return Err(format!("it is of no picture: {width} x {height} pixels, of these {:?}", self.crop));
        }
        let tonemap = [ToneMap::None, ToneMap::Srgb].into_iter().find(|t| name(*t) == self.tonemap);
        let tonemap = tonemap.ok_or_else(|| format!("tone mapping `{}` is not known", self.tonemap))?;
        let scene = u64::from_str_radix(&self.scene, 16).map_err(|_| "its scene is no hash".to_owned())?;
        let identity = Identity {
            version: self.octrace.clone(),
            scene,
            whole: self.size,
            crop: self.crop,
            samples: self.samples,
            depth: self.depth,
            tonemap,
        };
        let share = Share::new(self.share, self.of).map_err(|e| e.to_string())?;
        let others = || format!("its tiles are not those of share {share}");
        if Tiling::outline(identity.size(), share) != (self.tile, self.tiles.len() as u64) {
            return Err(others());
        }
        let tiling = Tiling::new(identity.size(), share).map_err(|e| e.to_string())?;
        if tiling.numbers != self.tiles {
            return Err(others());
        }
        let data: Option<Vec<AovKind>> = self.data.iter().map(|name| AovKind::named(name)).collect();
        let data = data.filter(|data| data.is_sorted_by(|a, b| a < b));
        let data = data.ok_or_else(|| {
            format!("its pictures of data are not known, or not each once and in order: {}", self.data.join(", "))
        })?;
        Ok((identity, share, tiling, data))
    }
}

fn name(tonemap: ToneMap) -> &'static str {
    match tonemap {
        ToneMap::None => "none",
        ToneMap::Srgb => "srgb",
    }
}

/// Writes a share as a part; it appears whole or not at all.
///
/// Fails where the file cannot be written, and for a portion whose pixels, or values of data, are not those of its share.
pub fn save_part(portion: &Portion, path: &Path) -> Result<()> {
    write(&encode_part(portion)?, path)
}

/// A part's bytes.
pub fn encode_part(portion: &Portion) -> Result<Vec<u8>> {
    let tiling = Tiling::new(portion.identity.size(), portion.share)?;
    let count = |values: &Values| match values {
        Values::Scalar(values) => values.len(),
        Values::Vector(values) => values.len(),
        Values::Id(values) => values.len(),
    };
    let mut counts = portion.data.iter().map(|data| count(&data.1)).chain([portion.pixels.len()]);
    if counts.any(|count| count != tiling.pixels()) {
        return Err(Error::Option(format!("share {} has other pixels than its tiles", portion.share)));
    }
    let failed = |e: &dyn std::fmt::Display| Error::Option(format!("share {} as EXR: {e}", portion.share));
    let said = Said::of(portion, &tiling);
    let sheet = Sheet::of(&tiling);
    let [width, height] = sheet.size;
    let text = serde_json::to_string(&said).map_err(|e| failed(&e))?;
    let mut attributes = LayerAttributes::default();
    attributes.other.insert(Text::from(ATTRIBUTE), AttributeValue::Text(Text::from(text.as_str())));
    let mut bytes = Cursor::new(Vec::new());
    let layer = Layer::new((width, height), attributes, Encoding::SMALL_LOSSLESS, sheet.channels(portion));
    Image::from_layer(layer).write().non_parallel().to_buffered(&mut bytes).map_err(|e| failed(&e))?;
    Ok(bytes.into_inner())
}

impl Part {
    /// Reads the beginning of a part.
    ///
    /// Fails if it cannot be read, or does not hold together: then it has to be made again.
    pub fn open(path: &Path) -> Result<Part> {
        Ok(begin(path)?.0)
    }

    /// Bytes of memory that [`read`](Part::read) takes at most: what the file has room for, and what is made of it.
    pub fn reading(&self) -> u64 {
        let made = 12 + self.data.iter().map(|kind| kind.bytes()).sum::<u64>();
        Sheet::of(&self.tiling).reading(&self.data) + made * self.tiling.pixels() as u64
    }

    /// Reads its pixels, and those of its pictures of data.
    ///
    /// Fails if memory does not allow it, and for a part that is damaged or was written again since it was opened.
    pub fn read(&self) -> Result<Portion> {
        let wrong = |what: &str| damaged(&self.path, what);
        let (again, reader) = begin(&self.path)?;
        if again.said != self.said {
            return Err(wrong("it has been written again meanwhile"));
        }
        render::room_for(self.reading(), || format!("{}, a part of a picture,", self.path.display()))?;
        let layers = exr::prelude::read().no_deep_data().largest_resolution_level().all_channels().first_valid_layer();
        let image = layers.all_attributes().non_parallel().from_chunks(reader).map_err(|e| wrong(&e.to_string()))?;
        let (sheet, channels) = (Sheet::of(&self.tiling), &image.layer_data.channel_data.list);
        let values = |&kind: &AovKind| Some((kind, sheet.values(channels, kind)?));
        let data: Option<Vec<(AovKind, Values)>> = self.data.iter().map(values).collect();
        let (Some(pixels), Some(data)) = (sheet.colors(channels), data) else {
            return Err(wrong("its channels are not those that it says"));
        };
        if self.said.checksum_with(&pixels, &data) != self.said.checksum {
            return Err(wrong("its checksum is wrong"));
        }
        Ok(Portion { identity: self.identity.clone(), share: self.share, pixels, data })
    }
}

/// A part that cannot be used, and what to do about it.
fn damaged(path: &Path, what: &str) -> Error {
    Error::Input { file: path.to_owned(), what: format!("no part that can be used: {what}; make this share again") }
}

/// Reads a part up to its pixels, and sees whether these can be as it says.
fn begin(path: &Path) -> Result<(Part, Reader<BufReader<Limited>>)> {
    let wrong = |what: &str| damaged(path, what);
    let file = File::open(path).map_err(Error::io(path, "open"))?;
    let metadata = file.metadata().map_err(Error::io(path, "open"))?;
    if !metadata.is_file() {
        return Err(wrong("it is not a file"));
    }
    let left = Rc::new(Cell::new(MOST_HEAD));
    let limited = Limited { file, left: left.clone() };
    let reader = exr::block::read(BufReader::new(limited), false)
        .map_err(|e| wrong(&format!("it cannot be read as EXR ({e})")))?;
    let [header] = reader.headers() else { return Err(wrong("it has several layers")) };
    let text = header.own_attributes.other.get(&Text::from(ATTRIBUTE));
    let Some(AttributeValue::Text(text)) = text else {
        return Err(wrong("it is a picture, but no part: it was not made with --shard"));
    };
    let said = Said::parse(&text.to_string()).map_err(|what| wrong(&what))?;
    let (identity, share, tiling, data) = said.resolve().map_err(|what| wrong(&what))?;
    let sheet = Sheet::of(&tiling);
    if !sheet.fits(header, &data) {
        return Err(wrong("its size and channels are not those of its share"));
    }
    let bytes = [sheet.size[0], sheet.size[1], 4 * header.channels.list.len()].map(|x| x as u64).iter().product();
    if metadata.len().saturating_mul(TIGHTEST) < bytes {
        return Err(wrong("it is cut short"));
    }
    left.set(u64::MAX);
    Ok((Part { path: path.to_owned(), identity, share, data, said, tiling }, reader))
}

/// A file of which no more than so many bytes are read.
struct Limited {
    file: File,
    left: Rc<Cell<u64>>,
}

impl Read for Limited {
    fn read(&mut self, to: &mut [u8]) -> io::Result<usize> {
        let count = self.file.read(to)?;
        let left = self.left.get().checked_sub(count as u64);
        self.left.set(left.ok_or_else(|| io::Error::other("too much before the pixels"))?);
        Ok(count)
    }
}

impl Seek for Limited {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.file.seek(to)
    }
}

#[cfg(test)]
mod tests;
