//! Pictures of data as files: the numbers themselves as EXR, or false colours as PNG.

use std::io::Cursor;
use std::path::Path;

use exr::prelude::{AnyChannel, AnyChannels, Encoding, FlatSamples, Image, Layer, LayerAttributes, WritableImage};
use image::{ImageFormat, Rgb, RgbImage};
use smallvec::{SmallVec, smallvec};

use super::drawing::{Anchor, Drawing, SCALE, Text};
use super::{Format, write};
use crate::error::{Error, Result};
use crate::render::{Aov, AovKind, Values};

/// Height of the legend under a picture, and the least width that has room for one, in pixels.
const LEGEND: u32 = 44;
const LEAST_WIDTH: u32 = 160;
/// Where nothing is met.
const NOTHING: [u8; 3] = [0; 3];

/// How a picture of data is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AovFormat {
    /// OpenEXR: f32 or u32 as they are. Depth is channel `Z`, normals are `N.X`, `N.Y`, `N.Z`, positions `P.X` and so on, ids are `id`, the rest
    /// is `Y`, as renderers name them and compositors expect them.
    Exr,
    /// False colours, eight bits a channel, with a legend below where colours stand for a scale.
    Png,
}

impl AovFormat {
    /// By the suffix of a file's name; fails for all but `.exr` and `.png`.
    pub fn of(path: &Path) -> Result<AovFormat> {
        match Format::of(path).map(|format| format.0) {
            Ok(ImageFormat::OpenExr) => Ok(AovFormat::Exr),
            Ok(ImageFormat::Png) => Ok(AovFormat::Png),
            _ => {
                let what = "a picture of data is written as .exr (the numbers) or .png (false colours)";
                Err(Error::Input { file: path.to_owned(), what: what.into() })
            }
        }
    }
}

/// Writes a picture of data, its kind by the suffix of `path`.
pub fn save_aov(aov: Aov, path: &Path) -> Result<()> {
    let bytes = encode_aov(aov, AovFormat::of(path)?)
        .map_err(|e| Error::Input { file: path.to_owned(), what: format!("cannot write this picture: {e}") })?;
    write(&bytes, path)
}

/// A picture of data as the bytes of a file.
pub fn encode_aov(aov: Aov, format: AovFormat) -> Result<Vec<u8>> {
    let mut bytes = Cursor::new(Vec::new());
    let (width, height) = (aov.width, aov.height);
    let failed = |e: &dyn std::fmt::Display| Error::Option(format!("{width} x {height} pixels: {e}"));
    match format {
        AovFormat::Exr => {
            let size = (width as usize, height as usize);
            let attributes = LayerAttributes::named(aov.kind.name());
            let layer = Layer::new(size, attributes, Encoding::FAST_LOSSLESS, AnyChannels::sort(channels(aov)));
            Image::from_layer(layer).write().to_buffered(&mut bytes).map_err(|e| failed(&e))?;
        }
        AovFormat::Png => painted(&aov).write_to(&mut bytes, ImageFormat::Png).map_err(|e| failed(&e))?,
    }
    Ok(bytes.into_inner())
}

/// The channels of an EXR file.
fn channels(aov: Aov) -> SmallVec<[AnyChannel<FlatSamples>; 4]> {
    match aov.values {
        Values::Scalar(values) => {
            let name = if aov.kind == AovKind::Depth { "Z" } else { "Y" };
            smallvec![AnyChannel::new(name, FlatSamples::F32(values))]
        }
        Values::Vector(values) => {
            let names = if aov.kind == AovKind::Normal { ["N.X", "N.Y", "N.Z"] } else { ["P.X", "P.Y", "P.Z"] };
            let channel = |(axis, name): (usize, &str)| {
                AnyChannel::new(name, FlatSamples::F32(values.iter().map(|v| v[axis]).collect()))
            };
            names.into_iter().enumerate().map(channel).collect()
        }
        Values::Id(values) => smallvec![AnyChannel::new("id", FlatSamples::U32(values))],
    }
}

/// In false colours.
fn painted(aov: &Aov) -> RgbImage {
    match &aov.values {
        Values::Scalar(values) => {
            let [low, high] = match aov.kind {
                AovKind::Shadow => [0.0, 1.0],
                AovKind::Depth => most(values.iter().copied()),
                // Work is counted from nothing on.
                _ => [0.0, values.iter().copied().fold(0.0, f32::max)],
            };
            let color = |&v: &f32| if v.is_finite() { scale(share(v, [low, high])) } else { NOTHING };
            with_legend(picture(aov, values.iter().map(color)), aov.kind, [low, high])
        }
        Values::Vector(values) if aov.kind == AovKind::Normal => {
            picture(aov, values.iter().map(|n| if *n == [0.0; 3] { NOTHING } else { n.map(|x| byte(0.5 * x + 0.5)) }))
        }
        Values::Vector(values) => {
            let seen = || values.iter().filter(|p| **p != [0.0; 3]);
            let ranges: [[f32; 2]; 3] = std::array::from_fn(|axis| most(seen().map(|p| p[axis])));
            let color = |p: &[f32; 3]| std::array::from_fn(|axis| byte(share(p[axis], ranges[axis])));
            picture(aov, values.iter().map(|p| if *p == [0.0; 3] { NOTHING } else { color(p) }))
        }
        Values::Id(values) => picture(aov, values.iter().map(|&id| if id == u32::MAX { NOTHING } else { of_id(id) })),
    }
}

fn picture(aov: &Aov, colors: impl Iterator<Item = [u8; 3]>) -> RgbImage {
    let bytes = colors.flatten().collect();
    RgbImage::from_raw(aov.width, aov.height, bytes).expect("a colour a pixel")
}

/// The range of most of the finite numbers, without the least and the greatest twentieth: a plane reaches as far as the horizon, and
/// what is before it would all have one colour. 0 and 0 if there are none.
fn most(values: impl Iterator<Item = f32>) -> [f32; 2] {
    let mut finite: Vec<f32> = values.filter(|v| v.is_finite()).collect();
    let Some(last) = finite.len().checked_sub(1) else { return [0.0; 2] };
    let cut = last / 20;
    let mut at = |rank: usize| *finite.select_nth_unstable_by(rank, f32::total_cmp).1;
    [at(cut), at(last - cut)]
}

/// Where a number lies within a range, 0 to 1.
fn share(value: f32, [low, high]: [f32; 2]) -> f32 {
    if high > low { ((value - low) / (high - low)).clamp(0.0, 1.0) } else { 0.0 }
}

fn byte(x: f32) -> u8 {
    (255.0 * x.clamp(0.0, 1.0)).round() as u8
}

/// The colour of a place on a scale, dark to bright; differences look as large as they are (viridis, Smith and van der Walt 2015).
fn scale(share: f32) -> [u8; 3] {
    colorous::VIRIDIS.eval_continuous(share.into()).as_array()
}

/// A colour for an id: neighbours differ, none is black (a step by the golden ratio around a wheel of hues).
fn of_id(id: u32) -> [u8; 3] {
    let hue = id.wrapping_mul(0x9e37_79b9);
    let bright = 0.65 + 0.35 * (id.wrapping_mul(0x85eb_ca6b) >> 24) as f32 / 255.0;
    let color = colorous::SINEBOW.eval_continuous(f64::from(hue) / 4_294_967_296.0).as_array();
    color.map(|x| byte(bright * (0.15 + 0.85 * f32::from(x) / 255.0)))
}

/// The picture with its scale below, if there is room for one.
fn with_legend(picture: RgbImage, kind: AovKind, [low, high]: [f32; 2]) -> RgbImage {
    let (width, height) = picture.dimensions();
    if width < LEAST_WIDTH {
        return picture;
    }
    let [w, h] = [width, LEGEND].map(|x| x as f32 / SCALE);
    let mut drawing = Drawing::new([w, h]);
    let (left, right) = (8.0, w - 8.0);
    let steps = (right - left).ceil() as u32;
    for i in 0..steps {
        let x = |i: u32| left + (right - left) * i as f32 / steps as f32;
        let share = (i as f32 + 0.5) / steps as f32;
        drawing.area([[x(i), 3.0], [x(i + 1), 9.0]], scale(share));
    }
    let mut text = |x: f32, text: String, anchor| {
        drawing.text(Text { at: [x, 18.0], text, exponent: String::new(), size: 8.0, anchor, upward: false });
    };
    text(left, number(low), Anchor::Start);
    text(right, number(high), Anchor::End);
    text(0.5 * w, what(kind).into(), Anchor::Middle);
    let legend = drawing.picture();
    let pixel = |x, y| if y < height { *picture.get_pixel(x, y) } else { *legend.get_pixel(x, y - height) };
    RgbImage::from_fn(width, height + LEGEND, |x, y| -> Rgb<u8> { pixel(x, y) })
}

/// What a scale is of.
fn what(kind: AovKind) -> &'static str {
    match kind {
        AovKind::Depth => "depth, nine tenths of it",
        AovKind::Cost => "nodes and leaves a pixel",
        AovKind::Pages => "pages a pixel",
        AovKind::Reads => "waits for pages a pixel",
        AovKind::Shadow => "lights kept off",
        _ => kind.name(),
    }
}

/// A number with four digits that count; with a power of ten where it would be long.
fn number(x: f32) -> String {
    if x != 0.0 && !(1e-3..1e7).contains(&x.abs()) {
        return format!("{x:.3e}");
    }
    let digits = if x == 0.0 { 0 } else { (3 - x.abs().log10().floor() as i32).clamp(0, 6) };
    let text = format!("{x:.*}", digits as usize);
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn aov(kind: AovKind, width: u32, values: Values) -> Aov {
        Aov { kind, width, height: 2, values }
    }

    #[test]
    fn exr_keeps_every_bit() {
        use exr::prelude::*;
        let read = |aov: Aov| {
            let bytes = encode_aov(aov, AovFormat::Exr).unwrap();
            let reader = read().no_deep_data().largest_resolution_level().all_channels().first_valid_layer();
            let image = reader.all_attributes().from_buffered(Cursor::new(bytes)).unwrap();
            let channels = image.layer_data.channel_data.list;
            channels.into_iter().map(|c| (c.name.to_string(), c.sample_data)).collect::<Vec<_>>()
        };
        let depths = vec![0.0, 1.5e-30, f32::INFINITY, 16_777_217.0];
        let back = read(aov(AovKind::Depth, 2, Values::Scalar(depths.clone())));
        assert_eq!(back, [("Z".to_owned(), FlatSamples::F32(depths))]);
        let ids = vec![0, 16_777_217, u32::MAX, 4_000_000_001];
        let back = read(aov(AovKind::Face, 2, Values::Id(ids.clone())));
        assert_eq!(back, [("id".to_owned(), FlatSamples::U32(ids))]);
        let vectors = vec![[1.0, 2.0, 3.0], [4.0, 5.0, 6.0], [0.0; 3], [-1.0, -2.0, -3.0]];
        let back = read(aov(AovKind::Position, 2, Values::Vector(vectors)));
        assert_eq!(back[1], ("P.Y".to_owned(), FlatSamples::F32(vec![2.0, 5.0, 0.0, -2.0])));
        let back = read(aov(AovKind::Normal, 1, Values::Vector(vec![[0.0, 0.0, 1.0]; 2])));
        assert_eq!(back.iter().map(|c| c.0.as_str()).collect::<Vec<_>>(), ["N.X", "N.Y", "N.Z"]);
    }

    #[test]
    fn false_colors_rise_with_the_value_and_nothing_is_black() {
        let values = (0..400).map(|i| if i == 7 { f32::INFINITY } else { i as f32 }).collect();
        let bytes = encode_aov(aov(AovKind::Depth, 200, Values::Scalar(values)), AovFormat::Png).unwrap();
        let image = image::load_from_memory(&bytes).unwrap().into_rgb8();
        assert_eq!(image.dimensions(), (200, 2 + LEGEND));
        assert_eq!((image.get_pixel(0, 0).0, image.get_pixel(199, 1).0), (scale(0.0), scale(1.0)));
        assert_eq!(image.get_pixel(0, 1).0, scale(share(200.0, [20.0, 380.0])));
        assert_eq!(image.get_pixel(7, 0).0, NOTHING);
        // The legend has the same ends, and text below.
        let bar = |x| image.get_pixel(x, 2 + 12).0;
        let off = |a: [u8; 3], b: [u8; 3]| (0..3).map(|i| a[i].abs_diff(b[i])).max().unwrap();
        assert!(off(bar(18), scale(0.0)) < 12 && off(bar(181), scale(1.0)) < 12, "{:?} {:?}", bar(18), bar(181));
        assert!((0..200).any(|x| image.get_pixel(x, 2 + 32).0[0] < 128));
        // A narrow one has no room for it.
        let bytes =
            encode_aov(aov(AovKind::Cost, 2, Values::Scalar(vec![0.0, 1.0, 2.0, 4.0])), AovFormat::Png).unwrap();
        let image = image::load_from_memory(&bytes).unwrap().into_rgb8();
        assert_eq!((image.dimensions(), image.get_pixel(0, 1).0), ((2, 2), scale(0.5)));
    }

    #[test]
    fn ids_differ_and_normals_are_as_usual() {
        let colors: std::collections::HashSet<[u8; 3]> = (0..200).map(of_id).collect();
        assert!(colors.len() > 190 && !colors.contains(&NOTHING), "{}", colors.len());
        let values = Values::Vector(vec![[0.0, 0.0, 1.0], [0.0; 3], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
        let image = painted(&aov(AovKind::Normal, 2, values));
        assert_eq!(image.get_pixel(0, 0).0, [128, 128, 255]);
        assert_eq!((image.get_pixel(1, 0).0, image.get_pixel(0, 1).0), (NOTHING, [0, 128, 128]));
    }

    #[test]
    fn numbers_are_short() {
        let shown = [0.0, 1.0, 0.25, 1234.5678, 0.001_234, 123_456.7].map(number);
        assert_eq!(shown, ["0", "1", "0.25", "1235", "0.001234", "123457"]);
        assert_eq!([1.25e-7, 7e9, -1e30].map(number), ["1.250e-7", "7.000e9", "-1.000e30"]);
    }
}
