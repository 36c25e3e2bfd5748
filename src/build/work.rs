//! The folder in which a build keeps its temporary files.
//!
//! It is named after the output, so that a build that was killed is found again, and is made when the first file is:
//! a small mesh never needs it. The output's partial file, which is locked while a build runs, guards it as well.

use std::fs::{self, File, OpenOptions};
use std::io::Read;
use std::path::{Path, PathBuf};

use xxhash_rust::xxh3::xxh3_64;

use crate::error::{Error, Result, folder_of};
use crate::format::is_single;

/// A folder for temporary files, removed with all that is in it when the value goes. Only a process that is killed leaves it.
pub(super) struct WorkFolder {
    path: PathBuf,
    /// Whose files this process makes there, where the system tells.
    owner: Option<u32>,
}

impl WorkFolder {
    /// The folder of the build that writes `output`, in `temp`. What an earlier build left there stays. If another process
    /// writes the same output now (this is not the `first` to do so), the folder has a name of its own.
    ///
    /// Fails if nothing can be written in `temp`, which is tried, so that it is told before a long scan.
    pub fn new(temp: &Path, output: &Path, first: bool) -> Result<WorkFolder> {
        let failed = || Error::io(temp, "create a temporary file in this folder");
        let owner = owner(&tempfile::tempfile_in(temp).and_then(|file| file.metadata()).map_err(failed())?);
        let folder = folder_of(output);
        // Whatever way leads there.
        let folder =
            folder.canonicalize().or_else(|_| std::path::absolute(folder)).unwrap_or_else(|_| folder.to_owned());
        let whole = folder.join(output.file_name().unwrap_or_default());
        // Systems allow 255 bytes; the hash tells long names apart.
        let name: String = output.file_name().unwrap_or_default().to_string_lossy().chars().take(50).collect();
        let hash = xxh3_64(whole.as_os_str().as_encoded_bytes()) as u32;
        let unique = if first { String::new() } else { format!("-{}", std::process::id()) };
        Ok(WorkFolder { path: temp.join(format!(".{name}-{hash:08x}{unique}.octbuild")), owner })
    }

    /// Whether it is a folder of this user's, not somebody else's, nor a link.
    pub fn is_own(&self) -> bool {
        fs::symlink_metadata(&self.path).is_ok_and(|data| data.is_dir() && owner(&data) == self.owner)
    }

    /// The folder that it lies in.
    pub fn temp(&self) -> &Path {
        self.path.parent().unwrap_or(Path::new("."))
    }

    /// Where it lies, or would.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Removes what an earlier build left.
    pub fn clear(&self) -> Result<()> {
        match fs::remove_dir_all(&self.path) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                Err(Error::io(&self.path, "remove what an earlier build left here")(error))
            }
            _ => Ok(()),
        }
    }

    /// A new, empty file of that name in it.
    pub fn create(&self, name: &str) -> Result<File> {
        let failed = || Error::io(&self.path, "create this folder for temporary files");
        fs::create_dir_all(&self.path).map_err(failed())?;
        if !self.is_own() {
            return Err(failed()(std::io::ErrorKind::PermissionDenied.into()));
        }
        // What has the name is not written over: it may be a link to something else.
        self.remove(name);
        let mut options = OpenOptions::new();
        let path = self.path.join(name);
        options.read(true).write(true).create_new(true).open(&path).map_err(Error::io(&path, "create"))
    }

    /// A file that an earlier build left; a link, one of several names, a pipe or a folder is none.
    pub fn reopen(&self, name: &str) -> Result<File> {
        let path = self.path.join(name);
        let is_file = fs::symlink_metadata(&path).map(|data| data.is_file() && is_single(&data));
        let file = match is_file {
            Ok(true) => OpenOptions::new().read(true).write(true).open(&path),
            Ok(false) => Err(std::io::ErrorKind::InvalidInput.into()),
            Err(error) => Err(error),
        };
        file.map_err(Error::io(&path, "open again"))
    }

    /// The first `bytes` of a file that an earlier build left, if there are so many.
    pub fn read(&self, name: &str, bytes: u64) -> Option<Vec<u8>> {
        let mut file = self.reopen(name).ok()?;
        let mut read = vec![0; (file.metadata().ok()?.len() >= bytes).then_some(bytes as usize)?];
        file.read_exact(&mut read).ok()?;
        Some(read)
    }

    /// Bytes of a file that an earlier build left; 0 if there is none.
    pub fn bytes(&self, name: &str) -> u64 {
        fs::symlink_metadata(self.path.join(name)).ok().filter(fs::Metadata::is_file).map_or(0, |data| data.len())
    }

    /// Removes all files but these: what an earlier build had no time to remove.
    pub fn keep(&self, names: &[&str]) {
        let files = fs::read_dir(&self.path).into_iter().flatten().flatten();
        let others = files.filter(|file| !names.iter().any(|name| *name == file.file_name()));
        others.for_each(|file| drop(fs::remove_file(file.path()).or_else(|_| fs::remove_dir_all(file.path()))));
    }

    /// Removes a file; that is no error if there is none.
    pub fn remove(&self, name: &str) {
        let _ = fs::remove_file(self.path.join(name));
    }
}

/// Whose a file is, where the system tells.
#[cfg(unix)]
fn owner(data: &fs::Metadata) -> Option<u32> {
    Some(std::os::unix::fs::MetadataExt::uid(data))
}

#[cfg(not(unix))]
fn owner(_: &fs::Metadata) -> Option<u32> {
    None
}

impl Drop for WorkFolder {
    fn drop(&mut self) {
        // What cannot be removed now is named after the output, and removed by its next build.
        let _ = fs::remove_dir_all(&self.path);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_made_with_the_first_file_and_goes_with_the_value() {
        let temp = tempfile::tempdir().unwrap();
        let entries = || fs::read_dir(temp.path()).unwrap().count();
        let work = WorkFolder::new(temp.path(), Path::new("out/a.oct"), true).unwrap();
        assert_eq!(entries(), 0);
        work.create("faces").unwrap();
        assert_eq!(entries(), 1);
        drop(work);
        assert_eq!(entries(), 0);
        let work = WorkFolder::new(temp.path(), Path::new("out/a.oct"), true).unwrap();
        work.create("faces").unwrap();
        // As a kill does.
        std::mem::forget(work);
        let other = WorkFolder::new(temp.path(), Path::new("in/a.oct"), true).unwrap();
        assert!(other.reopen("faces").is_err());
        let again = WorkFolder::new(temp.path(), Path::new("out/a.oct"), true).unwrap();
        again.reopen("faces").unwrap();
        again.clear().unwrap();
        again.clear().unwrap();
        assert_eq!(entries(), 0);
    }

    #[cfg(unix)]
    #[test]
    fn a_file_of_two_names_is_none_that_was_left() {
        let temp = tempfile::tempdir().unwrap();
        let work = WorkFolder::new(temp.path(), Path::new("out/a.oct"), true).unwrap();
        work.create("pages").unwrap();
        work.reopen("pages").unwrap();
        let other = temp.path().join("other");
        fs::hard_link(work.path().join("pages"), &other).unwrap();
        assert!(work.reopen("pages").is_err());
        fs::remove_file(other).unwrap();
        work.reopen("pages").unwrap();
    }

    #[test]
    fn the_folder_that_is_not_there_is_named() {
        let message =
            WorkFolder::new(Path::new("/no/such/folder"), Path::new("a.oct"), true).err().unwrap().to_string();
        assert!(message.starts_with("/no/such/folder: cannot create a temporary file in"), "{message}");
    }
}
