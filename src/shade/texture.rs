//! Textures: bilinear, repeating, with the picture's upper edge at v = 1 as OBJ has it.
//!
//! Files are decoded by crate `image` within its limits, so that a small file cannot claim all memory. Values are
//! 8 bits a channel, as stored in the file ("linear as it is", as classic scenes expect), or decoded from sRGB where the
//! picture will be sRGB-encoded. No mip-mapping: take more samples per pixel.

use std::path::Path;

use glam::DVec3;
use image::{ImageDecoder, ImageReader};

use crate::error::{Error, Result};
use crate::scene::ToneMap;

/// Most pixels on a side.
const SIDE: u32 = 32_768;
/// Most pixels.
const PIXELS: u64 = 1 << 28;
/// Most bytes of pixels as the file has them, and most that the decoder may use beside them.
const BYTES: u64 = 1 << 30;

/// A picture wrapped over the unit square of texture coordinates.
#[derive(Clone)]
pub struct Texture {
    width: usize,
    height: usize,
    /// Rows from the top.
    texels: Vec<[u8; 3]>,
    /// Linear value of each byte.
    linear: [f32; 256],
}

impl Texture {
    /// Reads a picture file.
    pub fn open(path: &Path, tonemap: ToneMap) -> Result<Texture> {
        let wrong = |what: String| Error::Input { file: path.to_owned(), what: format!("texture: {what}") };
        // Opening a pipe would wait for its other end.
        if !std::fs::metadata(path).map_err(Error::io(path, "open"))?.is_file() {
            return Err(wrong("not an ordinary file; name a picture".into()));
        }
        let reader = ImageReader::open(path).map_err(Error::io(path, "open"))?;
        let mut reader = reader.with_guessed_format().map_err(Error::io(path, "read"))?;
        let mut limits = image::Limits::default();
        limits.max_alloc = Some(BYTES);
        reader.limits(limits);
        // Some decoders end what they say with a line break.
        let undecodable = |e: image::ImageError| wrong(e.to_string().trim_end().to_owned());
        let decoder = reader.into_decoder().map_err(undecodable)?;
        let ((width, height), bytes) = (decoder.dimensions(), decoder.total_bytes());
        if width.max(height) > SIDE || u64::from(width) * u64::from(height) > PIXELS || bytes > BYTES {
            return Err(wrong(format!(
                "{width} x {height} pixels ({bytes} bytes) are too many: at most {SIDE} on a side, {PIXELS} in all and {BYTES} \
                 bytes; make it smaller"
            )));
        }
        if width == 0 || height == 0 {
            return Err(wrong("it has no pixels".into()));
        }
        let picture = image::DynamicImage::from_decoder(decoder).map_err(undecodable)?.into_rgb8();
        let (width, height) = (width as usize, height as usize);
        let texels = picture.pixels().map(|p| p.0).collect();
        Ok(Texture::new(width, height, texels, tonemap))
    }

    /// A texture from `width * height` texels, both at least 1, rows from the top.
    pub fn new(width: usize, height: usize, texels: Vec<[u8; 3]>, tonemap: ToneMap) -> Texture {
        assert!(width > 0 && height > 0 && texels.len() == width * height);
        let value = |byte: usize| {
            let stored = byte as f32 / 255.0;
            match tonemap {
                ToneMap::None => stored,
                ToneMap::Srgb if stored <= 0.04045 => stored / 12.92,
                ToneMap::Srgb => ((stored + 0.055) / 1.055).powf(2.4),
            }
        };
        Texture { width, height, texels, linear: std::array::from_fn(value) }
    }

    /// The mean colour, linear: of at most 256 texels a side, evenly spread.
    pub fn mean(&self) -> DVec3 {
        let places = |size: usize| {
            let count = size.min(256);
            (0..count).map(move |i| i * size / count)
        };
        let texel = |(x, y): (usize, usize)| {
            DVec3::from_array(self.texels[y * self.width + x].map(|byte| f64::from(self.linear[usize::from(byte)])))
        };
        let of_row = |y: usize| places(self.width).map(|x| texel((x, y))).sum::<DVec3>();
        places(self.height).map(of_row).sum::<DVec3>() / (places(self.width).len() * places(self.height).len()) as f64
    }

    /// Bytes of memory that it takes.
    pub fn bytes(&self) -> u64 {
        3 * self.texels.len() as u64
    }

    /// The colour at (u, v), linear; black where a coordinate is not finite.
    pub fn at(&self, u: f64, v: f64) -> DVec3 {
        if !(u.is_finite() && v.is_finite()) {
            return DVec3::ZERO;
        }
        // Texel centres lie at half-integers; the texture repeats.
        let x = (u - u.floor()) * self.width as f64 - 0.5;
        let y = (1.0 - (v - v.floor())) * self.height as f64 - 0.5;
        let (left, top) = (x.floor(), y.floor());
        let (fx, fy) = (x - left, y - top);
        let (left, top) = (left as i64, top as i64);
        let row = |y: i64| self.texel(left, y).lerp(self.texel(left + 1, y), fx);
        row(top).lerp(row(top + 1), fy)
    }

    /// Texels as stored, rows from the top.
    pub(super) fn texels(&self) -> &[[u8; 3]] {
        &self.texels
    }

    fn texel(&self, x: i64, y: i64) -> DVec3 {
        let (x, y) = (x.rem_euclid(self.width as i64) as usize, y.rem_euclid(self.height as i64) as usize);
        let texel = self.texels[y * self.width + x];
        DVec3::from_array(texel.map(|byte| f64::from(self.linear[usize::from(byte)])))
    }
}

impl std::fmt::Debug for Texture {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Texture({} x {})", self.width, self.height)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn checker() -> Texture {
        // Upper row: red, green; lower row: blue, white.
        Texture::new(2, 2, vec![[255, 0, 0], [0, 255, 0], [0, 0, 255], [255; 3]], ToneMap::None)
    }

    #[test]
    fn v_runs_upward_and_texels_are_hit_at_their_centres() {
        let t = checker();
        assert_eq!(t.at(0.25, 0.75), DVec3::new(1.0, 0.0, 0.0));
        assert_eq!(t.at(0.75, 0.75), DVec3::new(0.0, 1.0, 0.0));
        assert_eq!(t.at(0.25, 0.25), DVec3::new(0.0, 0.0, 1.0));
        assert_eq!(t.at(0.75, 0.25), DVec3::ONE);
    }

    #[cfg(unix)]
    #[test]
    fn nobody_waits_for_the_other_end_of_a_pipe() {
        let folder = tempfile::tempdir().unwrap();
        let pipe = folder.path().join("a.png");
        nix::unistd::mkfifo(&pipe, nix::sys::stat::Mode::S_IRWXU).unwrap();
        let error = Texture::open(&pipe, ToneMap::None).err().unwrap().to_string();
        assert!(error.ends_with("a.png: texture: not an ordinary file; name a picture"), "{error}");
    }

    #[test]
    fn repeats_and_blends() {
        let t = checker();
        assert_eq!(t.at(0.25, 0.75), t.at(-2.75, 5.75));
        assert_eq!(t.at(0.5, 0.75), DVec3::new(0.5, 0.5, 0.0));
        // On the seam the last and the first column meet in equal parts.
        assert_eq!(t.at(0.0, 0.75), DVec3::new(0.5, 0.5, 0.0));
        assert_eq!(t.at(0.5, 0.5), DVec3::splat(0.5));
        assert_eq!(t.at(f64::NAN, 0.0), DVec3::ZERO);
        assert_eq!(t.at(1e300, 0.25), t.at(0.0, 0.25));
    }

    #[test]
    fn srgb_is_decoded_when_the_picture_will_be_encoded() {
        let t = Texture::new(1, 1, vec![[188, 0, 255]], ToneMap::Srgb);
        assert!((t.at(0.5, 0.5) - DVec3::new(0.5028864, 0.0, 1.0)).abs().max_element() < 1e-6);
    }
}
