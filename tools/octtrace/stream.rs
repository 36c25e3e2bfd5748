//! Rays in, answers out: 32 bytes a ray, 16 bytes a hit or 1 byte an any-hit answer, little-endian.

use std::io::{ErrorKind, Read, Write};

use octrace::geometry::Ray;
use octrace::{Error, Result};

/// Name of standard input in messages.
const STDIN: &str = "<stdin>";
/// Bytes of a ray.
const RAY_BYTES: usize = size_of::<Ray>();

// Rays and hits are read and written as they lie in memory.
const _: () = assert!(cfg!(target_endian = "little"));

/// Reads rays in batches.
pub struct RayReader<R> {
    input: R,
    offset: u64,
}

impl<R: Read> RayReader<R> {
    /// A reader at the start of `input`.
    pub fn new(input: R) -> Self {
        RayReader { input, offset: 0 }
    }

    /// Fills `rays` as far as the input goes and returns how many there were; 0 at its end.
    ///
    /// An input that ends within a ray is an error that names the byte.
    pub fn fill(&mut self, rays: &mut [Ray]) -> Result<usize> {
        let bytes: &mut [u8] = bytemuck::cast_slice_mut(rays);
        let mut filled = 0;
        while filled < bytes.len() {
            match self.input.read(&mut bytes[filled..]) {
                Ok(0) => break,
                Ok(n) => filled += n,
                Err(e) if e.kind() == ErrorKind::Interrupted => {}
                Err(e) => return Err(Error::io(STDIN, "read")(e)),
            }
        }
        self.offset += filled as u64;
        match filled % RAY_BYTES {
            0 => Ok(filled / RAY_BYTES),
            rest => Err(self.cut_short(rest as u64)),
        }
    }

    fn cut_short(&self, rest: u64) -> Error {
        let what = format!(
            "the rays end within a ray: the one at byte offset {} has {rest} of {RAY_BYTES} bytes; look whether they were cut short: \
             a ray is 8 little-endian f32 (origin, direction, tmin, tmax)",
            self.offset - rest
        );
        Error::Input { file: STDIN.into(), what }
    }

    /// All rays.
    pub fn read_all(&mut self, batch: usize) -> Result<Vec<Ray>> {
        let mut rays = Vec::new();
        loop {
            let start = rays.len();
            rays.resize(start + batch, NO_RAY);
            let n = self.fill(&mut rays[start..])?;
            rays.truncate(start + n);
            if n == 0 {
                return Ok(rays);
            }
        }
    }
}

/// A ray that hits nothing, to fill buffers with.
pub const NO_RAY: Ray = Ray { origin: [0.0; 3], direction: [0.0; 3], tmin: 0.0, tmax: 0.0 };

/// Writes answers.
pub fn write<T: bytemuck::NoUninit>(out: &mut impl Write, answers: &[T]) -> Result<()> {
    out.write_all(bytemuck::cast_slice(answers)).map_err(Error::io("<stdout>", "write"))
}

/// Sends on what is still buffered.
pub fn flush(out: &mut impl Write) -> Result<()> {
    out.flush().map_err(Error::io("<stdout>", "write"))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Gives its bytes in small pieces, as pipes do.
    struct Pieces<'a>(&'a [u8]);

    impl Read for Pieces<'_> {
        fn read(&mut self, out: &mut [u8]) -> std::io::Result<usize> {
            let n = self.0.len().min(out.len()).min(7);
            out[..n].copy_from_slice(&self.0[..n]);
            self.0 = &self.0[n..];
            Ok(n)
        }
    }

    fn rays(n: usize) -> Vec<Ray> {
        (0..n).map(|i| Ray::new([i as f32, 0.0, 0.0], [0.0, 0.0, 1.0])).collect()
    }

    #[test]
    fn batches_put_together_are_the_whole() {
        let all = rays(10);
        for batch in [1, 3, 10, 100] {
            let mut reader = RayReader::new(Pieces(bytemuck::cast_slice(&all)));
            assert_eq!(reader.read_all(batch).unwrap(), all);
        }
    }

    #[test]
    fn a_cut_ray_is_named_by_its_offset() {
        let all = rays(3);
        let bytes: &[u8] = bytemuck::cast_slice(&all);
        let error = RayReader::new(Pieces(&bytes[..69])).read_all(2).unwrap_err().to_string();
        assert!(error.contains("byte offset 64 has 5 of 32 bytes"), "{error}");
        assert!(RayReader::new(Pieces(&[])).read_all(2).unwrap().is_empty());
    }
}
