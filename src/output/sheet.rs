//! How the pixels of a part lie in its EXR file: tiles side by side, and a channel for each number of a pixel.
//!
//! Each tile lies in the upper left corner of a cell; cells are as wide as the widest tile of the share, and as high as the highest.
//! `R`, `G` and `B` are the picture; a picture of data has a channel of its name (`depth`), or three of its layer (`normal.X`). All are f32, ids u32.

use exr::meta::attribute::SampleType;
use exr::meta::header::Header;
use exr::prelude::{AnyChannel, AnyChannels, FlatSamples};

use crate::render::{AovKind, Portion, Tiling, Values};

/// Components of a colour, and of a vector.
const COLOR: [&str; 3] = ["R", "G", "B"];
const VECTOR: [&str; 3] = ["X", "Y", "Z"];
/// Bytes of a colour.
const COLOR_BYTES: u64 = 12;
/// Rows that ZIP packs together.
const BLOCK: u64 = 16;

/// Where the tiles lie.
pub struct Sheet<'a> {
    tiling: &'a Tiling,
    columns: usize,
    /// Of a cell.
    cell: [usize; 2],
    /// Width and height in pixels.
    pub size: [usize; 2],
}

impl<'a> Sheet<'a> {
    /// In rows of about as many tiles as there are rows.
    pub fn of(tiling: &'a Tiling) -> Sheet<'a> {
        let (cell, [columns, rows]) = (tiling.cell().map(|side| side as usize), tiling.grid());
        Sheet { tiling, columns, cell, size: [columns * cell[0], rows * cell[1]] }
    }

    /// Bytes that reading it takes, with pictures of data: all channels, and a block of rows, packed and not.
    pub fn reading(&self, kinds: &[AovKind]) -> u64 {
        let [width, height] = self.size.map(|side| side as u64);
        let bytes = COLOR_BYTES + kinds.iter().map(|kind| kind.bytes()).sum::<u64>();
        bytes * width * (height + 2 * height.min(BLOCK))
    }

    /// The index of each pixel of the tiles, tile after tile, rows from the top.
    fn pixels(&self) -> impl Iterator<Item = usize> {
        let (columns, width, [across, down]) = (self.columns, self.size[0], self.cell);
        self.tiling.places().enumerate().flat_map(move |(i, [x0, y0, x1, y1])| {
            let corner = (i / columns * down) * width + i % columns * across;
            (0..(y1 - y0) as usize).flat_map(move |y| (0..(x1 - x0) as usize).map(move |x| corner + y * width + x))
        })
    }

    /// The channels of a share, in order of the alphabet, as EXR wants them. What no tile covers is zero.
    pub fn channels(&self, portion: &Portion) -> AnyChannels<FlatSamples> {
        let mut list: Vec<AnyChannel<FlatSamples>> = self.vector(COLOR.map(str::to_owned), &portion.pixels).into();
        for (kind, values) in &portion.data {
            match values {
                Values::Scalar(values) => list.push(self.floats(kind.name(), values.iter().copied())),
                Values::Vector(values) => list.extend(self.vector(layer(*kind), values)),
                Values::Id(values) => {
                    list.push(AnyChannel::new(kind.name(), FlatSamples::U32(self.spread(values.iter().copied()))));
                }
            }
        }
        AnyChannels::sort(list.into())
    }

    fn vector(&self, names: [String; 3], values: &[[f32; 3]]) -> [AnyChannel<FlatSamples>; 3] {
        let mut axis = 0..3;
        names.map(|name| {
            let axis = axis.next().unwrap_or_default();
            self.floats(&name, values.iter().map(|value| value[axis]))
        })
    }

    fn floats(&self, name: &str, values: impl Iterator<Item = f32>) -> AnyChannel<FlatSamples> {
        AnyChannel::new(name, FlatSamples::F32(self.spread(values)))
    }

    fn spread<T: Copy + Default>(&self, values: impl Iterator<Item = T>) -> Vec<T> {
        let mut samples = vec![T::default(); self.size[0] * self.size[1]];
        self.pixels().zip(values).for_each(|(at, value)| samples[at] = value);
        samples
    }

    /// The colours in these channels, in the order of the tiles; nothing if they are not there.
    pub fn colors(&self, channels: &[AnyChannel<FlatSamples>]) -> Option<Vec<[f32; 3]>> {
        self.vectors(channels, COLOR.map(str::to_owned))
    }

    /// The values of a picture of data, likewise.
    pub fn values(&self, channels: &[AnyChannel<FlatSamples>], kind: AovKind) -> Option<Values> {
        match kind.nothing(0) {
            Values::Scalar(_) => {
                let from = floats(channels, kind.name())?;
                Some(Values::Scalar(self.gather(|at| from[at])))
            }
            Values::Vector(_) => self.vectors(channels, layer(kind)).map(Values::Vector),
            Values::Id(_) => match samples(channels, kind.name())? {
                FlatSamples::U32(from) => Some(Values::Id(self.gather(|at| from[at]))),
                _ => None,
            },
        }
    }

    fn vectors(&self, channels: &[AnyChannel<FlatSamples>], names: [String; 3]) -> Option<Vec<[f32; 3]>> {
        let [Some(x), Some(y), Some(z)] = names.map(|name| floats(channels, &name)) else { return None };
        Some(self.gather(|at| [x[at], y[at], z[at]]))
    }

    /// What is there at each pixel, in memory of just that size.
    fn gather<T>(&self, value: impl Fn(usize) -> T) -> Vec<T> {
        let mut values = Vec::with_capacity(self.tiling.pixels());
        values.extend(self.pixels().map(value));
        values
    }

    /// Whether a header is that of this sheet, with a picture and these pictures of data.
    pub fn fits(&self, header: &Header, kinds: &[AovKind]) -> bool {
        let one_level = header.blocks == exr::meta::BlockDescription::ScanLines && !header.deep;
        let mut expected: Vec<(String, SampleType)> = COLOR.map(|name| (name.to_owned(), SampleType::F32)).into();
        for &kind in kinds {
            match kind.nothing(0) {
                Values::Scalar(_) => expected.push((kind.name().to_owned(), SampleType::F32)),
                Values::Vector(_) => expected.extend(layer(kind).map(|name| (name, SampleType::F32))),
                Values::Id(_) => expected.push((kind.name().to_owned(), SampleType::U32)),
            }
        }
        expected.sort_by(|a, b| a.0.cmp(&b.0));
        let channels = &header.channels.list;
        [header.layer_size.x(), header.layer_size.y()] == self.size
            && one_level
            && channels.len() == expected.len()
            && channels.iter().zip(&expected).all(|(channel, (name, kind))| {
                channel.name == *name.as_str() && channel.sample_type == *kind && channel.sampling.area() == 1
            })
    }
}

/// The names of the channels of a picture of vectors.
fn layer(kind: AovKind) -> [String; 3] {
    VECTOR.map(|axis| format!("{}.{axis}", kind.name()))
}

fn samples<'a>(channels: &'a [AnyChannel<FlatSamples>], name: &str) -> Option<&'a FlatSamples> {
    channels.iter().find(|channel| channel.name == *name).map(|channel| &channel.sample_data)
}

fn floats<'a>(channels: &'a [AnyChannel<FlatSamples>], name: &str) -> Option<&'a [f32]> {
    match samples(channels, name)? {
        FlatSamples::F32(values) => Some(values),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::Share;

    #[test]
    fn each_pixel_has_a_place_of_its_own_in_the_room_that_is_counted() {
        for (size, of) in [([1, 2000], 1), ([2000, 1], 3), ([257, 300], 2), ([37, 100], 4), ([9, 1025], 1)] {
            for index in 0..of {
                let tiling = Tiling::new(size, Share::new(index, of).unwrap()).unwrap();
                let sheet = Sheet::of(&tiling);
                assert_eq!(sheet.size[0] * sheet.size[1], tiling.room());
                assert_eq!(sheet.spread(std::iter::repeat_n(1u8, tiling.pixels())).len(), tiling.room());
                let mut places: Vec<usize> = sheet.pixels().collect();
                assert_eq!(places.len(), tiling.pixels());
                places.sort_unstable();
                places.dedup();
                assert_eq!(places.len(), tiling.pixels(), "{size:?} of {of}");
                assert!(places.iter().all(|at| *at < tiling.room()));
            }
        }
    }
}
