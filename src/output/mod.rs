//! Pictures as files: PNG, EXR, HDR and what else crate `image` writes.
//!
//! EXR and HDR hold linear light as it is, unclamped. The others hold 8 bits a channel: values are clamped to 0..1 and
//! stored as they are, `round(255 x)`, as classic scenes expect, or sRGB-encoded first. A file is written under a
//! temporary name beside its own and renamed, so that a broken-off write leaves nothing that looks whole.

mod aov;
pub mod drawing;
mod part;
mod sheet;

use std::io::{Cursor, Write};
use std::path::Path;

use image::{DynamicImage, ImageFormat, Rgb32FImage, RgbImage};

use crate::error::{Error, Result, folder_of};
use crate::render::Film;
use crate::scene::ToneMap;

pub use aov::{AovFormat, encode_aov, save_aov};
pub use part::{Part, encode_part, save_part};

/// Suffixes and what they stand for.
const SUFFIXES: [(&str, ImageFormat); 9] = [
    ("png", ImageFormat::Png),
    ("exr", ImageFormat::OpenExr),
    ("hdr", ImageFormat::Hdr),
    ("jpg", ImageFormat::Jpeg),
    ("jpeg", ImageFormat::Jpeg),
    ("bmp", ImageFormat::Bmp),
    ("tga", ImageFormat::Tga),
    ("tif", ImageFormat::Tiff),
    ("tiff", ImageFormat::Tiff),
];

/// A kind of picture file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Format(ImageFormat);

impl Format {
    /// PNG, the default.
    pub const PNG: Format = Format(ImageFormat::Png);

    /// By the suffix of a file's name, upper or lower case; no suffix at all is PNG. An unknown one is an error that
    /// lists those known.
    pub fn of(path: &Path) -> Result<Format> {
        let Some(suffix) = path.extension() else { return Ok(Format::PNG) };
        let found = SUFFIXES.iter().find(|(s, _)| suffix.eq_ignore_ascii_case(s));
        found.map(|(_, format)| Format(*format)).ok_or_else(|| {
            let known: Vec<&str> = SUFFIXES.iter().map(|x| x.0).collect();
            let what = format!("unknown kind of picture; known suffixes: {}", known.join(", "));
            Error::Input { file: path.to_owned(), what }
        })
    }

    /// Whether it holds linear light, unclamped.
    pub fn is_linear(self) -> bool {
        matches!(self.0, ImageFormat::OpenExr | ImageFormat::Hdr)
    }
}

/// Writes a picture, its kind by the suffix of `path`.
///
/// Fails for an unknown suffix, for a side that the format cannot hold, and where the file cannot be written.
pub fn save(film: &Film, path: &Path, tonemap: ToneMap) -> Result<()> {
    let format = Format::of(path)?;
    let bytes = encode(film, format, tonemap)
        .map_err(|e| Error::Input { file: path.to_owned(), what: format!("cannot write this picture: {e}") })?;
    write(&bytes, path)
}

/// Writes a file under a temporary name beside its own and renames it.
fn write(bytes: &[u8], path: &Path) -> Result<()> {
    // A device or a pipe is written to as it is, a link is followed.
    let real = path.canonicalize().unwrap_or_else(|_| path.to_owned());
    if real.metadata().is_ok_and(|m| !m.is_file() && !m.is_dir()) {
        return std::fs::write(&real, bytes).map_err(Error::io(path, "write"));
    }
    let mut builder = tempfile::Builder::new();
    builder.prefix(".octrace-").suffix(".tmp");
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    let mut file = builder.tempfile_in(folder_of(&real)).map_err(Error::create(path))?;
    file.write_all(bytes).map_err(Error::io(path, "write"))?;
    // Else a machine that fails soon after may leave an empty file under the new name.
    file.as_file().sync_all().map_err(Error::io(path, "write"))?;
    let temporary = file.into_temp_path();
    std::fs::rename(&temporary, &real).map_err(Error::create(path))?;
    // It has gone: there is nothing to be removed.
    let _ = temporary.keep();
    Ok(())
}

/// A picture's bytes in the given format.
pub fn encode(film: &Film, format: Format, tonemap: ToneMap) -> Result<Vec<u8>> {
    let (width, height) = (film.width(), film.height());
    let picture = if format.is_linear() {
        let values = film.pixels().iter().flatten().copied().collect();
        Rgb32FImage::from_raw(width, height, values).map(DynamicImage::from)
    } else {
        let values = film.pixels().iter().flatten().map(|&x| stored(x, tonemap)).collect();
        RgbImage::from_raw(width, height, values).map(DynamicImage::from)
    };
    let mut bytes = Cursor::new(Vec::new());
    let wrong = |e: image::ImageError| Error::Option(format!("{width} x {height} pixels: {e}"));
    let picture = picture.ok_or_else(|| Error::Option("a picture without pixels".into()))?;
    match format.0 {
        ImageFormat::Jpeg => picture
            .write_with_encoder(image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, 95))
            .map_err(wrong)?,
        format => picture.write_to(&mut bytes, format).map_err(wrong)?,
    }
    Ok(bytes.into_inner())
}

/// The byte that stands for a linear value; 0 for a NaN.
fn stored(x: f32, tonemap: ToneMap) -> u8 {
    let x = x.clamp(0.0, 1.0);
    let x = match tonemap {
        ToneMap::None => x,
        ToneMap::Srgb if x <= 0.003_130_8 => 12.92 * x,
        ToneMap::Srgb => 1.055 * x.powf(1.0 / 2.4) - 0.055,
    };
    (255.0 * x).round() as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_of_values() {
        let plain = [-1.0, 0.0, 0.5, 1.0, 7.0, f32::NAN].map(|x| stored(x, ToneMap::None));
        assert_eq!(plain, [0, 0, 128, 255, 255, 0]);
        assert_eq!([0.0, 0.002, 0.5, 1.0].map(|x| stored(x, ToneMap::Srgb)), [0, 7, 188, 255]);
    }

    #[test]
    fn formats_by_suffix() {
        assert_eq!(Format::of(Path::new("a.PNG")).unwrap(), Format::PNG);
        assert_eq!(Format::of(Path::new("a")).unwrap(), Format::PNG);
        assert!(Format::of(Path::new("a.exr")).unwrap().is_linear());
        let error = Format::of(Path::new("a.gif")).unwrap_err().to_string();
        assert!(error.contains("a.gif") && error.contains("exr"), "{error}");
    }

    #[test]
    fn every_format_reads_back() {
        let folder = tempfile::tempdir().unwrap();
        let film = Film::new(5, 3).unwrap();
        for (suffix, format) in SUFFIXES {
            let path = folder.path().join("picture").with_extension(suffix);
            save(&film, &path, ToneMap::None).unwrap();
            let back = image::load_from_memory_with_format(&std::fs::read(&path).unwrap(), format).unwrap();
            assert_eq!((back.width(), back.height()), (5, 3), "{suffix}");
        }
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), SUFFIXES.len(), "no temporary file stays");
        let nowhere = folder.path().join("no/such/folder/x.png");
        assert!(matches!(save(&film, &nowhere, ToneMap::None), Err(Error::Io { .. })));
    }
}
