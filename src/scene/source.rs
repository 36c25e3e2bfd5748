//! Reading scene files as bytes and as text, with a bound on their size.

use std::fs::{self, File};
use std::io::Read;
use std::path::{Path, PathBuf};
use std::rc::Rc;

use super::diagnose::{Line, Problem};
use crate::error::{Diagnostic, Severity};

/// Most bytes of a scene with all that it includes.
pub(super) const MAX_BYTES: u64 = 256 << 20;

/// Sees whether a file is there and may be read; gives its one true name, or says why not.
pub(super) fn check_readable(path: &Path) -> Result<PathBuf, String> {
    let say = |error: std::io::Error| match error.kind() {
        std::io::ErrorKind::NotFound => "there is no such file".to_string(),
        std::io::ErrorKind::PermissionDenied => "permission denied".to_string(),
        _ => error.to_string(),
    };
    let meta = fs::metadata(path).map_err(say)?;
    if meta.is_dir() {
        return Err("it is a folder".into());
    }
    // Opening a pipe would wait for its other end.
    if !meta.is_file() {
        return Err("it is not a regular file".into());
    }
    File::open(path).map_err(say)?;
    fs::canonicalize(path).map_err(say)
}

/// The bytes of a file of at most `most` bytes.
pub(super) fn read_limited(path: &Path, most: u64) -> Result<Vec<u8>, String> {
    let file = File::open(path).map_err(|error| error.to_string())?;
    take_limited(file, most)
}

/// All bytes that `reader` gives, if they are at most `most`.
pub(super) fn take_limited(reader: impl Read, most: u64) -> Result<Vec<u8>, String> {
    let mut bytes = Vec::new();
    reader.take(most.saturating_add(1)).read_to_end(&mut bytes).map_err(|error| error.to_string())?;
    match bytes.len() as u64 > most {
        true => Err(format!("a scene with all that it includes has at most {MAX_BYTES} bytes; keep shapes in a mesh")),
        false => Ok(bytes),
    }
}

/// Bytes as text without byte-order mark; what is not UTF-8 is replaced, and the first such place told.
pub(super) fn decode(bytes: &[u8], name: &Rc<str>) -> (String, Option<Diagnostic>) {
    let bytes = bytes.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(bytes);
    let invalid = std::str::from_utf8(bytes).err().map(|error| error.valid_up_to());
    let nul = bytes.iter().position(|b| *b == 0);
    let text = String::from_utf8_lossy(bytes).into_owned();
    // Up to the first invalid byte, text and bytes are the same.
    let first = [invalid, nul].into_iter().flatten().min();
    let told = first.map(|at| not_text(bytes, at, &text, name));
    (text, told)
}

/// Tells of the byte `at` that no text should have.
fn not_text(bytes: &[u8], at: usize, text: &str, name: &Rc<str>) -> Diagnostic {
    let start = text[..at].rfind('\n').map_or(0, |newline| newline + 1);
    let end = text[at..].find('\n').map_or(text.len(), |length| at + length);
    let number = bytes[..at].iter().filter(|b| **b == b'\n').count() as u64 + 1;
    let character = text[at..].chars().next().map_or(0, char::len_utf8);
    let help = if bytes.starts_with(b"\xFF\xFE") || bytes.starts_with(b"\xFE\xFF") {
        "it looks like UTF-16: save it as UTF-8"
    } else if bytes.contains(&0) {
        "it looks like a binary file, not like a scene"
    } else {
        "save it as UTF-8"
    };
    let message = format!("the file is not UTF-8 text: it has a byte 0x{:02X}", bytes[at]);
    let line = Line { file: name, number, text: &text[start..end] };
    line.diagnostic(Severity::Error, Problem::new(at - start..at - start + character, message).help(help))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn told(bytes: &[u8]) -> Option<Diagnostic> {
        decode(bytes, &"f".into()).1
    }

    #[test]
    fn text_is_taken_as_it_is_without_its_mark() {
        let (text, told) = decode("\u{feff}eye é".as_bytes(), &"f".into());
        assert_eq!((text.as_str(), told), ("eye é", None));
    }

    #[test]
    fn the_first_byte_that_is_no_text_is_told() {
        let latin = told(b"sphere\n# caf\xE9\nlight").unwrap();
        assert_eq!((latin.line, latin.column, &latin.text[latin.span]), (2, 6, "\u{fffd}"));
        assert!(latin.message.ends_with("0xE9"));
        assert!(told(b"\xFF\xFEs\0").unwrap().help.unwrap().contains("UTF-16"));
        assert!(told(b"ab\0\n").unwrap().help.unwrap().contains("binary"));
        assert!(told(b"\xFF").is_some());
    }

    #[test]
    fn size_is_limited() {
        assert_eq!(take_limited(&b"abc"[..], 3).unwrap(), b"abc");
        assert!(take_limited(&b"abcd"[..], 3).unwrap_err().contains("at most"));
    }
}
