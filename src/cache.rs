//! Meshes that are used without being built first: an octree file is kept beside the source, or in the user's cache.
//!
//! `MODEL.obj` is built once into `MODEL.obj.cache.oct` in its own folder; where that cannot be written, or where a file
//! of that name stands that this cache did not write, into the user's cache folder under a name made from the source's
//! absolute path. Beside the octree file lies `….oct.key`, a small JSON file: it says of which source the octree was built
//! (size, time, a hash of its first and last 64 KiB, how it was read, size and time of the material libraries named in the
//! first 64 KiB), and carries the checksum of the octree's header. An octree file without such a key, or with another
//! checksum, is not this cache's and is never overwritten. The key is written before the octree is built, then without a checksum, and again
//! after it: a process that is killed in between leaves an octree that the next one may replace.
//!
//! What it does not see: a source changed in its middle with size and time kept, textures (they are read anew for each
//! picture), and material libraries named only further down the source.

use std::fs::{self, File};
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::time::UNIX_EPOCH;

use serde::{Deserialize, Serialize};
use xxhash_rust::xxh3::{Xxh3, xxh3_64};

use crate::build::{BuildOptions, build};
use crate::error::{Error, Result, folder_of};
use crate::event::{Event, Monitor};
use crate::format::{HEADER_BYTES, VERSION};
use crate::map::Octree;
use crate::mesh::{self, ReadOptions};

/// Most bytes of a key file; a larger one is none of this cache's.
const LARGEST_KEY: u64 = 16 << 20;
/// Bytes at either end of the source that are hashed.
const END: u64 = 64 << 10;

/// Opens an octree file; for a mesh (any other name), opens the octree file built from it, building that first if
/// there is none or the mesh has changed. It is kept beside the mesh as `MODEL.obj.cache.oct`, or else in the user's cache folder.
///
/// `read` says how the mesh is read; it is built with [`BuildOptions::default`].
pub fn open_or_build(mesh: &Path, read: &ReadOptions, monitor: Monitor<'_>) -> Result<Octree> {
    open_or_build_in(mesh, read, BuildOptions::default().memory, user_folder().as_deref(), monitor)
}

/// The same within `memory` bytes, if it has to be built; the octree file's path instead of the opened file.
pub fn find_or_build(mesh: &Path, read: &ReadOptions, memory: u64, monitor: Monitor<'_>) -> Result<PathBuf> {
    let octree = open_or_build_in(mesh, read, memory, user_folder().as_deref(), monitor)?;
    Ok(octree.path().to_owned())
}

/// Where octree files are kept that cannot be kept beside their meshes.
fn user_folder() -> Option<PathBuf> {
    dirs::cache_dir().map(|folder| folder.join("octrace"))
}

/// [`open_or_build`] with the user's cache folder given.
fn open_or_build_in(
    mesh: &Path,
    read: &ReadOptions,
    memory: u64,
    user: Option<&Path>,
    monitor: Monitor<'_>,
) -> Result<Octree> {
    if mesh.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("oct")) {
        return Octree::open(mesh);
    }
    let source = Source::of(mesh, read)?;
    for library in &source.libraries {
        monitor.send(Event::File(mesh.with_file_name(&library.name)));
    }
    let beside = Place::beside(mesh);
    let in_cache = user.map(|folder| Place::in_cache(folder, mesh));
    let places = || std::iter::once(&beside).chain(&in_cache);
    if let Some(octree) = places().find_map(|place| place.open(&source)) {
        return Ok(octree);
    }
    for place in places() {
        if place.is_free() && place.prepare() {
            place.build(mesh, read, memory, source, monitor)?;
            return Octree::open(&place.octree);
        }
    }
    Err(Error::Input {
        file: mesh.to_owned(),
        what: format!(
            "no place to build its octree: {} cannot be written, or was not made by this program, and neither can the \
             user's cache folder; build it with octbuild and name the .oct file",
            beside.octree.display()
        ),
    })
}

/// What the source was when it was built.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Source {
    bytes: u64,
    modified: String,
    ends: String,
    lenient: bool,
    origin: [f64; 3],
    libraries: Vec<Library>,
}

/// A material library.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Library {
    name: String,
    bytes: u64,
    modified: String,
}

/// The key file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Key {
    /// [`KEY_OF`], so that no other JSON file is taken for a key.
    key_of: String,
    /// The version of the octree format.
    format: u32,
    source: Source,
    /// Checksum of the octree's header, which covers all else in it.
    header: String,
}

const KEY_OF: &str = "octrace mesh cache";

impl Source {
    fn of(mesh: &Path, read: &ReadOptions) -> Result<Source> {
        // Asked before: opening a pipe would wait for its other end.
        let metadata = fs::metadata(mesh).map_err(Error::io(mesh, "open"))?;
        if !metadata.is_file() {
            return Err(Error::Input {
                file: mesh.to_owned(),
                what: "is not an ordinary file; name a mesh file".into(),
            });
        }
        let mut file = File::open(mesh).map_err(Error::io(mesh, "open"))?;
        let metadata = file.metadata().map_err(Error::io(mesh, "open"))?;
        let (head, tail) = ends(&mut file, metadata.len()).map_err(Error::io(mesh, "read"))?;
        let mut hash = Xxh3::new();
        hash.update(&head);
        hash.update(&tail);
        Ok(Source {
            bytes: metadata.len(),
            modified: modified(&metadata),
            ends: format!("{:016x}", hash.digest()),
            lenient: read.lenient,
            origin: read.origin,
            libraries: libraries(mesh, &head),
        })
    }
}

/// The first and the last [`END`] bytes; in a short file they overlap.
fn ends(file: &mut File, bytes: u64) -> std::io::Result<(Vec<u8>, Vec<u8>)> {
    let (mut head, mut tail) = (Vec::new(), Vec::new());
    file.take(END).read_to_end(&mut head)?;
    file.seek(SeekFrom::Start(bytes.saturating_sub(END)))?;
    file.take(END).read_to_end(&mut tail)?;
    Ok((head, tail))
}

/// Time of last change since 1970, to the nanosecond where the system knows it.
fn modified(metadata: &fs::Metadata) -> String {
    let since = metadata.modified().ok().and_then(|time| time.duration_since(UNIX_EPOCH).ok()).unwrap_or_default();
    format!("{}.{:09}", since.as_secs(), since.subsec_nanos())
}

/// The material libraries that the source's head names, as far as they exist.
fn libraries(mesh: &Path, head: &[u8]) -> Vec<Library> {
    let text = String::from_utf8_lossy(head);
    let names = text.lines().filter_map(|line| line.trim().strip_prefix("mtllib")).map(str::trim);
    let library = |name: &str| {
        let metadata = fs::metadata(mesh.with_file_name(name)).ok()?;
        Some(Library { name: name.to_owned(), bytes: metadata.len(), modified: modified(&metadata) })
    };
    names.filter_map(library).collect()
}

/// Where an octree file may be kept.
struct Place {
    octree: PathBuf,
    key: PathBuf,
}

impl Place {
    fn beside(mesh: &Path) -> Place {
        Place::at(mesh, mesh)
    }

    fn in_cache(folder: &Path, mesh: &Path) -> Place {
        let absolute = mesh.canonicalize().unwrap_or_else(|_| mesh.to_owned());
        let name = mesh.file_name().unwrap_or_default().to_string_lossy();
        let hash = xxh3_64(absolute.as_os_str().as_encoded_bytes());
        let stem = folder.join(format!("{hash:016x}-{name}"));
        Place::at(&stem, &stem)
    }

    fn at(folder_of: &Path, name_of: &Path) -> Place {
        let name = |suffix: &str| {
            let mut name = name_of.file_name().unwrap_or_default().to_owned();
            name.push(suffix);
            folder_of.with_file_name(name)
        };
        Place { octree: name(".cache.oct"), key: name(".cache.oct.key") }
    }

    /// The key, if there is one of this cache's, whatever octree it was for.
    fn key(&self) -> Option<Key> {
        let mut bytes = Vec::new();
        File::open(&self.key).ok()?.take(LARGEST_KEY).read_to_end(&mut bytes).ok()?;
        serde_json::from_slice(&bytes).ok().filter(|key: &Key| key.key_of == KEY_OF)
    }

    /// The key, if the octree file is there and is the one the key was written for.
    fn own_key(&self) -> Option<Key> {
        self.key().filter(|key| Some(&key.header) == header_checksum(&self.octree).as_ref())
    }

    /// The octree file, if it was built from this source. One with a damaged header is as good as none: it is
    /// built again.
    fn open(&self, source: &Source) -> Option<Octree> {
        let key = self.own_key().filter(|key| key.format == VERSION && key.source == *source)?;
        Octree::open(&self.octree).ok().filter(|octree| octree.header().version == key.format)
    }

    /// Whether nothing stands here but what this cache wrote.
    fn is_free(&self) -> bool {
        let absent = |path: &Path| fs::symlink_metadata(path).is_err();
        let key = self.key();
        let unfinished = key.as_ref().is_some_and(|key| key.header.is_empty());
        (absent(&self.octree) && (absent(&self.key) || key.is_some())) || unfinished || self.own_key().is_some()
    }

    /// Makes the folder if need be; whether files can be made in it.
    fn prepare(&self) -> bool {
        let folder = folder_of(&self.octree);
        fs::create_dir_all(folder).is_ok() && tempfile::tempfile_in(folder).is_ok()
    }

    /// Builds the octree file and writes its key, before and after.
    fn build(&self, mesh: &Path, read: &ReadOptions, memory: u64, source: Source, monitor: Monitor<'_>) -> Result<()> {
        let name = Some(mesh.to_owned());
        let options = BuildOptions { origin: read.origin, name, memory, ..BuildOptions::default() };
        let material_memory = options.material_memory().min(read.material_memory);
        let read = ReadOptions { material_memory, ..*read };
        let read = read.within(options.reading_memory(), rayon::current_num_threads());
        let mut key = Key { key_of: KEY_OF.into(), format: VERSION, source, header: String::new() };
        self.write_key(&key)?;
        let built =
            mesh::open(mesh, &read).and_then(|mut source| build(source.as_mut(), &self.octree, &options, monitor));
        if let Err(error) = built {
            if !self.octree.exists() {
                let _ = fs::remove_file(&self.key);
            }
            return Err(error);
        }
        key.header = header_checksum(&self.octree).unwrap_or_default();
        self.write_key(&key)
    }

    fn write_key(&self, key: &Key) -> Result<()> {
        let write = || {
            // A name that says whose it is, should the process be killed here.
            let mut file =
                tempfile::Builder::new().prefix(".octrace-").suffix(".tmp").tempfile_in(folder_of(&self.key))?;
            serde_json::to_writer_pretty(&mut file, key)?;
            file.write_all(b"\n")?;
            file.persist(&self.key)?;
            Ok(())
        };
        write().map_err(Error::io(&self.key, "write"))
    }
}

/// The checksum at the end of an octree file's header page.
fn header_checksum(octree: &Path) -> Option<String> {
    let mut header = [0; HEADER_BYTES];
    File::open(octree).ok()?.read_exact(&mut header).ok()?;
    let checksum: [u8; 8] = header[HEADER_BYTES - 8..].try_into().ok()?;
    Some(format!("{:016x}", u64::from_le_bytes(checksum)))
}

#[cfg(test)]
mod tests {
    use super::*;

    const TRIANGLE: &str = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 1\nf 1 2 3\n";

    fn open(mesh: &Path, user: &Path) -> Result<Octree> {
        open_or_build_in(mesh, &ReadOptions::default(), 1 << 30, Some(user), Monitor::silent())
    }

    #[cfg(unix)]
    #[test]
    fn nobody_waits_for_the_other_end_of_a_pipe() {
        let folder = tempfile::tempdir().unwrap();
        let pipe = folder.path().join("a.obj");
        nix::unistd::mkfifo(&pipe, nix::sys::stat::Mode::S_IRWXU).unwrap();
        let error = open(&pipe, folder.path()).err().unwrap().to_string();
        assert!(error.ends_with("a.obj: is not an ordinary file; name a mesh file"), "{error}");
    }

    #[test]
    fn built_once_and_again_when_the_source_changes() {
        let folder = tempfile::tempdir().unwrap();
        let (mesh, user) = (folder.path().join("a.obj"), folder.path().join("user"));
        fs::write(&mesh, TRIANGLE).unwrap();
        let first = open(&mesh, &user).unwrap();
        let octree = folder.path().join("a.obj.cache.oct");
        assert_eq!((first.header().triangles, first.path()), (1, &*octree));
        let written = || fs::metadata(&octree).unwrap().modified().unwrap();
        let time = written();
        open(&mesh, &user).unwrap();
        assert_eq!(written(), time);
        fs::write(&mesh, format!("{TRIANGLE}f 1 2 4\n")).unwrap();
        assert_eq!(open(&mesh, &user).unwrap().header().triangles, 2);
        assert_ne!(written(), time);
        assert!(!user.exists());
        // An octree file is opened as it is.
        assert_eq!(open(&octree, &user).unwrap().header().triangles, 2);
    }

    #[test]
    fn a_file_of_somebody_else_is_left_alone() {
        let folder = tempfile::tempdir().unwrap();
        let (mesh, user) = (folder.path().join("a.obj"), folder.path().join("user"));
        let octree = folder.path().join("a.obj.cache.oct");
        fs::write(&mesh, TRIANGLE).unwrap();
        fs::write(&octree, "mine").unwrap();
        assert!(open(&mesh, &user).unwrap().path().starts_with(&user));
        assert_eq!(fs::read(&octree).unwrap(), b"mine");
        // Nor with a key that belongs to another octree.
        fs::remove_file(&octree).unwrap();
        fs::remove_dir_all(&user).unwrap();
        open(&mesh, &user).unwrap();
        fs::write(&octree, vec![7; 5000]).unwrap();
        assert!(open(&mesh, &user).unwrap().path().starts_with(&user));
        assert_eq!(fs::read(&octree).unwrap(), vec![7; 5000]);
    }

    #[test]
    fn what_a_killed_process_left_is_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let (mesh, user) = (folder.path().join("a.obj"), folder.path().join("user"));
        fs::write(&mesh, TRIANGLE).unwrap();
        let octree = open(&mesh, &user).unwrap().path().to_owned();
        // Killed when the octree was renamed and its checksum was not in the key yet.
        let place = Place::beside(&mesh);
        let key = place.own_key().unwrap();
        place.write_key(&Key { header: String::new(), ..key }).unwrap();
        assert!(place.own_key().is_none());
        fs::write(&mesh, format!("{TRIANGLE}f 1 2 4\n")).unwrap();
        let again = open(&mesh, &user).unwrap();
        assert_eq!((again.path(), again.header().triangles), (&*octree, 2));
        assert!(place.own_key().is_some() && !user.exists());
    }

    #[test]
    fn options_and_libraries_count_as_changes() {
        let folder = tempfile::tempdir().unwrap();
        let mesh = folder.path().join("a.obj");
        fs::write(&mesh, format!("mtllib a.mtl\n{TRIANGLE}")).unwrap();
        let source = |read: &ReadOptions| Source::of(&mesh, read).unwrap();
        let plain = source(&ReadOptions::default());
        assert_ne!(plain, source(&ReadOptions { lenient: true, ..Default::default() }));
        fs::write(folder.path().join("a.mtl"), "newmtl a\n").unwrap();
        assert_ne!(plain, source(&ReadOptions::default()));
    }

    #[test]
    fn a_mesh_that_is_not_there_or_broken_leaves_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let (mesh, user) = (folder.path().join("a.obj"), folder.path().join("user"));
        assert_eq!(open(&mesh, &user).err().map(|e| e.kind()), Some(crate::Kind::Input));
        fs::write(&mesh, "v 0 0 0\n").unwrap();
        let message = open(&mesh, &user).err().unwrap().to_string();
        assert!(message.ends_with("a.obj: holds no triangles; name a mesh that has faces"), "{message}");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }
}
