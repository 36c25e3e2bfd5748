//! Where the bytes of a mesh come from: a file or standard input, plain or compressed.
//!
//! Standard input and files whose name says nothing of compression are recognised by their first bytes. Large
//! sequential reads, no mapping: a mapped input would count against the memory limit and could fault. A compressed
//! stream that ends early or is damaged is an error, never a shorter mesh.

use std::fs::File;
use std::io::{self, BufReader, Cursor, Read};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::SystemTime;

use crate::error::{Error, Result};

/// Bytes of the buffer between the file and a decoder.
const BUFFER: usize = 1 << 20;

/// A compression.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Codec {
    /// RFC 1952, any number of members.
    Gzip,
    /// RFC 8878, any number of frames.
    Zstd,
}

impl Codec {
    /// The codec whose magic `head` begins with.
    fn detect(head: &[u8]) -> Option<Codec> {
        match head {
            [0x1f, 0x8b, ..] => Some(Codec::Gzip),
            [0x28, 0xb5, 0x2f, 0xfd, ..] | [0x50..=0x5f, 0x2a, 0x4d, 0x18, ..] => Some(Codec::Zstd),
            _ => None,
        }
    }

    fn name(self) -> &'static str {
        match self {
            Codec::Gzip => "gzip",
            Codec::Zstd => "zstd",
        }
    }
}

/// An input that has been named and checked, but not yet read.
pub(super) struct Input {
    /// The path as the user gave it; `-` for standard input.
    path: PathBuf,
    /// The compression its name promises.
    promised: Option<Codec>,
    /// The opened file, until it is read; `None` for standard input.
    file: Option<File>,
    /// Bytes, where they are known.
    size: Option<u64>,
    /// When it was changed last, where that is known.
    changed: Option<SystemTime>,
}

impl Input {
    /// Standard input.
    pub fn stdin() -> Input {
        Input { path: "-".into(), promised: None, file: None, size: None, changed: None }
    }

    /// A file, which must exist.
    pub fn file(path: &Path, promised: Option<Codec>) -> Result<Input> {
        let file = File::open(path).map_err(Error::io(path, "open"))?;
        let data = file.metadata().map_err(Error::io(path, "open"))?;
        if data.is_dir() {
            let what = "this is a folder; name the mesh file in it".into();
            return Err(Error::Input { file: path.to_owned(), what });
        }
        let size = data.is_file().then_some(data.len());
        let changed = data.modified().ok().filter(|_| data.is_file());
        Ok(Input { path: path.to_owned(), promised, file: Some(file), size, changed })
    }

    /// The name to show in messages.
    pub fn name(&self) -> String {
        if self.is_stdin() { "<stdin>".into() } else { self.path.to_string_lossy().into_owned() }
    }

    /// The name to put into [`Error`]s.
    pub fn error_path(&self) -> PathBuf {
        if self.is_stdin() { "<stdin>".into() } else { self.path.clone() }
    }

    /// Bytes of the (compressed) input, if known.
    pub fn size(&self) -> Option<u64> {
        self.size
    }

    /// The first bytes, unpacked, and whether they were packed; `None` if they cannot be had before the rest.
    pub fn head(&self, bytes: usize) -> Option<(Vec<u8>, bool)> {
        self.size?;
        let mut again = Input::file(&self.path, self.promised).ok()?;
        let mut stream = again.start(1 << 31).ok()?;
        let mut head = Vec::new();
        stream.fill(&mut head, bytes).ok()?;
        Some((head, stream.is_packed()))
    }

    /// The folder that relative names in the input are relative to.
    pub fn folder(&self) -> PathBuf {
        self.path.parent().map(Path::to_owned).unwrap_or_default()
    }

    /// Whether it can be read a second time.
    pub fn is_repeatable(&self) -> bool {
        self.size.is_some()
    }

    /// Fails if the file is no longer what it was when it was opened: then what was read may be half of each.
    pub fn check_unchanged(&self) -> Result<()> {
        let (Some(size), Some(changed)) = (self.size, self.changed) else { return Ok(()) };
        let same =
            std::fs::metadata(&self.path).is_ok_and(|now| now.len() == size && now.modified().ok() == Some(changed));
        if same {
            return Ok(());
        }
        let what = "it was changed while it was read; read it again when it is complete".into();
        Err(Error::Input { file: self.error_path(), what })
    }

    fn is_stdin(&self) -> bool {
        self.path == Path::new("-")
    }

    /// Starts reading from the beginning. A decoder may hold `window` bytes of the text behind it.
    pub fn start(&mut self, window: u64) -> Result<Stream> {
        let raw: Box<dyn Read + Send> = match self.file.take() {
            Some(file) => Box::new(file),
            None if self.is_stdin() => Box::new(io::stdin()),
            None => Box::new(File::open(&self.path).map_err(Error::io(&self.path, "open"))?),
        };
        let taken = Arc::new(AtomicU64::new(0));
        let counted = Counted { raw, taken: taken.clone() };
        let (text, codec) =
            self.decoder(counted, window).map_err(|error| read_error(self.error_path(), None, error))??;
        Ok(Stream { text, codec, taken, file: self.error_path() })
    }

    /// Puts the decoder that the first bytes ask for before `raw`.
    #[allow(clippy::type_complexity)]
    fn decoder(&self, mut raw: Counted, window: u64) -> io::Result<Result<(Box<dyn Read + Send>, Option<Codec>)>> {
        let mut head = Vec::new();
        raw.by_ref().take(4).read_to_end(&mut head)?;
        let found = Codec::detect(&head);
        if let Some(promised) = self.promised.filter(|_| found != self.promised) {
            let what = format!(
                "its name says {0}, but its content is not {0} data; rename it, or fetch it again",
                promised.name()
            );
            return Ok(Err(Error::Input { file: self.error_path(), what }));
        }
        let whole = Cursor::new(head).chain(raw);
        let text: Box<dyn Read + Send> = match found {
            None => Box::new(whole),
            Some(Codec::Gzip) => {
                Box::new(flate2::bufread::MultiGzDecoder::new(BufReader::with_capacity(BUFFER, whole)))
            }
            Some(Codec::Zstd) => {
                let mut decoder = zstd::stream::read::Decoder::with_buffer(BufReader::with_capacity(BUFFER, whole))?;
                // What the library takes: 1 KiB to 2 GiB.
                decoder.window_log_max(window.clamp(1 << 10, 1 << 31).ilog2())?;
                Box::new(decoder)
            }
        };
        Ok(Ok((text, found)))
    }
}

/// The text of an input, being read.
pub(super) struct Stream {
    text: Box<dyn Read + Send>,
    codec: Option<Codec>,
    taken: Arc<AtomicU64>,
    file: PathBuf,
}

impl Stream {
    /// Appends at most `limit` bytes to `buffer`; fewer only at the end. Returns how many.
    pub fn fill(&mut self, buffer: &mut Vec<u8>, limit: usize) -> Result<usize> {
        let mut part = self.text.by_ref().take(limit as u64);
        part.read_to_end(buffer).map_err(|error| read_error(self.file.clone(), self.codec, error))
    }

    /// Whether the text comes out of a decoder.
    pub fn is_packed(&self) -> bool {
        self.codec.is_some()
    }

    /// The counter of bytes taken from the (compressed) input, which other threads may look at.
    pub fn taken(&self) -> Arc<AtomicU64> {
        self.taken.clone()
    }

    /// The name to put into errors.
    pub fn file(&self) -> &Path {
        &self.file
    }

    #[cfg(test)]
    pub fn of_bytes(text: &[u8]) -> Stream {
        Stream {
            text: Box::new(Cursor::new(text.to_vec())),
            codec: None,
            taken: Arc::default(),
            file: "test.obj".into(),
        }
    }
}

/// What zstd says of a window beyond the largest it may take.
const TOO_LARGE: &str = "Frame requires too much memory for decoding";

/// Says what a failed read means: the operating system's errors carry a number, a decoder's do not.
fn read_error(file: PathBuf, codec: Option<Codec>, error: io::Error) -> Error {
    match codec {
        Some(codec) if error.raw_os_error().is_none() => {
            let what = if error.kind() == io::ErrorKind::UnexpectedEof {
                format!("the {} data ends early; the file was cut short, fetch it again", codec.name())
            } else if error.to_string() == TOO_LARGE {
                "the zstd data was packed with a window (--long, --ultra) that does not fit in the memory allowed; allow more \
                 (about five times the window), or unpack it first: `zstd -d --memory=2048MB`"
                    .into()
            } else {
                format!("the {} data cannot be decompressed ({error}); fetch it again", codec.name())
            };
            Error::Input { file, what }
        }
        _ => Error::Io { file, doing: "read", source: error },
    }
}

/// Counts the bytes that pass.
struct Counted {
    raw: Box<dyn Read + Send>,
    taken: Arc<AtomicU64>,
}

impl Read for Counted {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let n = self.raw.read(buffer)?;
        self.taken.fetch_add(n as u64, Ordering::Relaxed);
        Ok(n)
    }
}
