//! Sizes of memory: a number of bytes, or text like "512M".

use pyo3::prelude::*;

use crate::errors::wrong;

/// Bytes of memory, as an argument.
pub struct Size(pub u64);

impl<'py> FromPyObject<'_, 'py> for Size {
    type Error = PyErr;

    fn extract(value: Borrowed<'_, 'py, PyAny>) -> PyResult<Size> {
        match value.extract::<String>() {
            Ok(text) => text_of(&text).ok_or_else(|| wrong(format!("{text:?} is no size; say 512M or 1.5G"))),
            Err(_) => bytes_of(value.extract()?).ok_or_else(|| wrong(format!("{} is no number of bytes", &*value))),
        }
        .map(Size)
    }
}

/// A number of bytes, if it is one.
fn bytes_of(number: f64) -> Option<u64> {
    (number >= 0.0 && number < u64::MAX as f64).then_some(number.round() as u64)
}

/// As the tools take it: a number, then nothing, K, M, G or T, then nothing, B or iB; powers of 1024.
fn text_of(text: &str) -> Option<u64> {
    let digits = text.find(|c: char| !c.is_ascii_digit() && c != '.').unwrap_or(text.len());
    let number: f64 = text[..digits].parse().ok()?;
    let unit = text[digits..].trim().to_ascii_lowercase();
    let unit = unit.strip_suffix("ib").or(unit.strip_suffix('b')).unwrap_or(&unit);
    let power = ["", "k", "m", "g", "t"].iter().position(|name| *name == unit)?;
    bytes_of(number * (1u64 << (10 * power)) as f64)
}
