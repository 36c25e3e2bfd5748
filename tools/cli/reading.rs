//! How octree files are read: the flags, and what they mean for a bound on memory.

use std::path::Path;

use octrace::Error;
use octrace::format::{Flags, Header};
use octrace::map::{Octree, Read, half_of_free_memory};

/// Flags for reading octree files.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "General")]
pub struct Reading {
    /// Bound on resident memory, all included: pages of the octree file are read as they are needed, and go when room is
    /// needed for others [default: none, the file is mapped]
    #[arg(long, value_name = "SIZE", value_parser = super::args::size)]
    pub memory: Option<u64>,
    /// How octree files are read: mapped, or pages within a budget of memory [default: budgeted with --memory and for packed
    /// files, which take half of the free memory without it; else mapped]
    #[arg(long, value_name = "HOW")]
    pub read: Option<How>,
}

/// How octree files are read.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum How {
    /// In place, where the system maps them
    Mapped,
    /// Page by page into memory of a given size
    Budgeted,
}

/// Most times that files are looked at because others took their places meanwhile.
const LOOKS: usize = 100;

/// Memory for what is not counted: code that has not run yet, stacks, small things. Half of it was seen to be needed.
const REST: u64 = 8 << 20;

impl Reading {
    /// The bound on memory, if these files are to be read within one.
    pub fn bound(&self, headers: &[Header]) -> Result<Option<u64>, Error> {
        let packed = headers.iter().any(|header| header.flags.has(Flags::PACKED));
        match (self.read, self.memory) {
            (Some(How::Mapped), Some(_)) => Err(Error::Option(
                "--memory bounds what is read page by page; it cannot bound a file that is mapped: leave out --read mapped"
                    .into(),
            )),
            (Some(How::Mapped), None) => Ok(None),
            (None, None) if !packed => Ok(None),
            (_, Some(memory)) => Ok(Some(memory)),
            (_, None) => Ok(Some(half_of_free_memory())),
        }
    }
}

/// Opens octree files: mapped, or with the least of memory for their pages if there is a bound on memory, which is told too.
///
/// How a file is opened depends on its header, which is read before; if another file has taken its place meanwhile, all begins anew.
pub fn open(paths: &[impl AsRef<Path>], reading: &Reading) -> Result<(Vec<Octree>, Option<u64>), Error> {
    let headers = || paths.iter().map(|path| Octree::header_of(path.as_ref())).collect::<Result<Vec<_>, _>>();
    let sums = |headers: &[Header]| headers.iter().map(|header| header.checksum).collect::<Vec<_>>();
    for look in 1.. {
        let before = headers()?;
        if reading.read == Some(How::Mapped)
            && let Some((path, _)) = paths.iter().zip(&before).find(|(_, header)| header.flags.has(Flags::PACKED))
        {
            let what = "its pages are packed, so it cannot be mapped; leave out --read mapped".into();
            return Err(Error::Input { file: path.as_ref().to_owned(), what });
        }
        let bound = reading.bound(&before)?;
        let open = |(path, header): (&_, &Header)| match bound {
            Some(_) => Octree::open_with(AsRef::as_ref(path), Read::Budgeted { cache: Octree::least_of(header) }),
            None => Octree::open_with(AsRef::as_ref(path), Read::Mapped),
        };
        let opened = paths.iter().zip(&before).map(open).collect::<Result<Vec<_>, _>>();
        let now = match &opened {
            Ok(octrees) => octrees.iter().map(|octree| *octree.header()).collect(),
            Err(_) => headers()?,
        };
        if sums(&now) == sums(&before) || look == LOOKS {
            return opened.map(|octrees| (octrees, bound));
        }
    }
    unreachable!("the last look returns")
}

/// What of the bound is left beside what this process has taken so far, and what the files will take beside their pages.
pub fn left_of(memory: u64, headers: &[Header]) -> Result<u64, u64> {
    let beside: u64 = headers.iter().map(Octree::beside_cache).sum();
    let taken = resident_bytes().unwrap_or(32 << 20) + REST + beside;
    memory.checked_sub(taken).ok_or(taken)
}

/// The error for a bound that is too small.
pub fn too_small(least: u64) -> Error {
    // Rounded up, and a little more, since another run may take a little more.
    let mib = (least + (1 << 20)).div_ceil(1 << 20);
    Error::Option(format!("--memory is too small for this: the least is {mib}M"))
}

/// What a file whose pages are large for the bound is warned of, if it is.
pub fn warning(name: &std::path::Path, header: &Header, memory: u64) -> Option<String> {
    let largest = u64::from(header.largest_page);
    (largest > memory / 8).then(|| {
        let (name, largest, memory) = (name.display(), largest >> 10, memory >> 20);
        format!(
            "{name}: its largest page has {largest} KiB, more than an eighth of --memory ({memory} MiB), which makes reading slow; \
             build it with smaller pages (octbuild --brick 16384)"
        )
    })
}

/// Resident memory of this process now, where the system tells.
fn resident_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
    Some(line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()? << 10)
}
