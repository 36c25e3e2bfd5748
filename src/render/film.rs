//! The film: linear light of every pixel.

use crate::error::{Error, Result};
use crate::map::free_memory;

/// A picture in linear RGB, rows from the top.
#[derive(Clone, Debug, PartialEq)]
pub struct Film {
    width: u32,
    height: u32,
    pixels: Vec<[f32; 3]>,
}

impl Film {
    /// A black film; fails if memory does not allow it.
    pub fn new(width: u32, height: u32) -> Result<Film> {
        let count = u64::from(width) * u64::from(height);
        let bytes = count.saturating_mul(size_of::<[f32; 3]>() as u64);
        let what = || format!("a picture of {width} x {height}");
        room_for(bytes, what)?;
        let mut pixels = Vec::new();
        let count = usize::try_from(count).map_err(|_| too_large(bytes, what))?;
        pixels.try_reserve_exact(count).map_err(|_| too_large(bytes, what))?;
        pixels.resize(count, [0.0; 3]);
        Ok(Film { width, height, pixels })
    }

    /// Width in pixels.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Height in pixels.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// All pixels, rows from the top.
    pub fn pixels(&self) -> &[[f32; 3]] {
        &self.pixels
    }

    /// All pixels, to be written.
    pub(super) fn pixels_mut(&mut self) -> &mut [[f32; 3]] {
        &mut self.pixels
    }

    /// The pixel in column `x` from the left and row `y` from the top, both within the picture.
    pub fn at(&self, x: u32, y: u32) -> [f32; 3] {
        self.pixels[y as usize * self.width as usize + x as usize]
    }

    /// Writes the pixels of columns x0..x1 and rows y0..y1, which lie within the picture, rows from the top.
    ///
    /// # Panics
    /// If they do not, or if there are fewer pixels.
    pub fn put_tile(&mut self, [x0, y0, x1, y1]: [u32; 4], pixels: &[[f32; 3]]) {
        for (y, row) in (y0..y1).zip(pixels.chunks_exact((x1 - x0) as usize)) {
            let first = y as usize * self.width as usize + x0 as usize;
            self.pixels[first..first + row.len()].copy_from_slice(row);
        }
    }
}

/// Sees whether so many bytes of memory are free, where the system tells; an error about `what` if not.
pub fn room_for(bytes: u64, what: impl FnOnce() -> String) -> Result<()> {
    match free_memory() {
        Some(free) if bytes > free => Err(too_large(bytes, what)),
        _ => Ok(()),
    }
}

/// The error about pictures that memory does not suffice for.
pub(super) fn too_large(bytes: u64, what: impl FnOnce() -> String) -> Error {
    let gib = bytes as f64 / f64::from(1 << 30);
    let (what, more) = (what(), "more than there is; ask for a smaller size, or for parts with a crop");
    Error::Option(format!("{what} needs {gib:.1} GiB of memory, {more}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn refuses_what_memory_cannot_hold() {
        let error = Film::new(u32::MAX, u32::MAX).unwrap_err();
        assert!(error.to_string().contains("GiB"), "{error}");
        assert_eq!(Film::new(3, 2).unwrap().pixels().len(), 6);
    }
}
