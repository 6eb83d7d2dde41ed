//! The folder of a run: made, found writable, held for one run at a time; files that appear whole or not at all.

use super::error::{OutputError, on_root};
use crate::comm::Comm;
use rustix::fs::{FallocateFlags, fallocate, fstatvfs};
use std::fs::{self, File, TryLockError};
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};

/// A folder that this run may write to. Another run that wants it meanwhile is refused.
#[derive(Debug)]
pub struct Folder {
    path: PathBuf,
    /// Held by rank 0; the lock goes with the process.
    _lock: Option<File>,
}

impl Folder {
    /// Makes the folder if need be and finds out whether files can be written to it. Collective.
    pub fn prepare(comm: &Comm, path: &Path) -> Result<Folder, OutputError> {
        let mut lock = None;
        let made = on_root(comm, || {
            fs::create_dir_all(path).map_err(|e| explain(&e))?;
            let probe = path.join(".jamhpc-writable");
            File::create(&probe).and_then(|_| fs::remove_file(&probe)).map_err(|e| explain(&e))?;
            lock = hold(path)?;
            Ok(())
        });
        made.map_err(|reason| OutputError::write(path, reason))?;
        Ok(Folder { path: path.to_owned(), _lock: lock })
    }

    /// The path of a file in the folder.
    pub fn file(&self, name: &str) -> PathBuf {
        self.path.join(name)
    }

    /// Removes a file of the folder, if there is one. Collective.
    pub fn remove(&self, comm: &Comm, name: &str) -> Result<(), OutputError> {
        let path = self.file(name);
        let removed = on_root(comm, || match fs::remove_file(&path) {
            Err(e) if e.kind() != ErrorKind::NotFound => Err(explain(&e)),
            _ => Ok(()),
        });
        removed.map_err(|reason| OutputError::write(&path, reason))
    }
}

/// Locks a folder, where its file system knows locks.
fn hold(path: &Path) -> Result<Option<File>, String> {
    let folder = File::open(path).map_err(|e| explain(&e))?;
    match folder.try_lock() {
        Ok(()) => Ok(Some(folder)),
        Err(TryLockError::WouldBlock) => {
            Err("another run is writing to this folder; wait for it or choose another folder".to_owned())
        }
        Err(TryLockError::Error(_)) => Ok(None),
    }
}

/// An operating system error with what to do about it.
pub fn explain(error: &std::io::Error) -> String {
    let advice = match error.kind() {
        ErrorKind::PermissionDenied | ErrorKind::ReadOnlyFilesystem => "choose a folder that you may write to",
        ErrorKind::StorageFull | ErrorKind::QuotaExceeded => "free some space or choose another file system",
        ErrorKind::NotFound => "check the path",
        ErrorKind::AlreadyExists | ErrorKind::NotADirectory => "a file stands where a folder is wanted",
        ErrorKind::IsADirectory => "name a file in it",
        _ => return error.to_string(),
    };
    format!("{error}; {advice}")
}

/// Moves an existing file out of the way, to the first free `NAME.1.EXT`, `NAME.2.EXT`, ...: results are never
/// overwritten. Answers where it went.
pub(super) fn make_way(path: &Path) -> std::io::Result<Option<PathBuf>> {
    if !path.exists() {
        return Ok(None);
    }
    let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let (stem, extension) = name.split_once('.').unwrap_or((&name, ""));
    for k in 1.. {
        let free = path.with_file_name(format!("{stem}.{k}.{extension}"));
        if !free.exists() {
            fs::rename(path, &free)?;
            return Ok(Some(free));
        }
    }
    Ok(None)
}

/// Writes a small file at once: nobody ever sees it half-written, and an older one stays until the new one is whole. A link
/// stays one, and what is no file, as a pipe or a terminal, is written to as it is.
pub fn write_whole(path: &Path, bytes: &[u8]) -> Result<(), OutputError> {
    if is_stream(path) {
        let written = File::options().write(true).open(path).and_then(|mut stream| stream.write_all(bytes));
        return written.map_err(|e| OutputError::write(path, explain(&e)));
    }
    let place = followed(path);
    let part = part_of(&place);
    let written = File::create(&part)
        .and_then(|mut file| file.write_all(bytes).and_then(|()| file.sync_all()))
        .and_then(|()| fs::rename(&part, &place));
    written.map_err(|e| {
        let _ = fs::remove_file(&part); // it may never have come to be
        OutputError::write(path, explain(&e))
    })
}

/// Whether [`write_whole`] can begin to write a file: asked before what is to be in it is computed.
pub fn can_be_written(path: &Path) -> Result<(), OutputError> {
    if is_stream(path) {
        return Ok(());
    }
    let part = part_of(&followed(path));
    let tried = match path.is_dir() {
        true => Err(ErrorKind::IsADirectory.into()),
        false => File::create(&part).and_then(|_| fs::remove_file(&part)),
    };
    tried.map_err(|e| OutputError::write(path, explain(&e)))
}

/// Whether a path is there, but neither a file nor a folder.
fn is_stream(path: &Path) -> bool {
    fs::metadata(path).is_ok_and(|about| !about.is_file() && !about.is_dir())
}

/// Where a link leads to, also to a file that is not there yet; the path itself if it is none.
fn followed(path: &Path) -> PathBuf {
    let mut place = path.to_owned();
    // as many links in a row as file systems follow
    for _ in 0..40 {
        let Ok(next) = fs::read_link(&place) else { break };
        place = place.parent().unwrap_or(Path::new("")).join(next);
    }
    place
}

/// Removes the files in a folder whose names are this program's own, and what a killed one was writing; and the folder, if
/// nothing of anybody else's is in it.
pub fn remove_own(folder: &Path, is_own: impl Fn(&str) -> bool) -> std::io::Result<()> {
    let unless_gone = |outcome: std::io::Result<()>| match outcome {
        Err(e) if matches!(e.kind(), ErrorKind::NotFound | ErrorKind::DirectoryNotEmpty) => Ok(()),
        outcome => outcome,
    };
    let entries = match fs::read_dir(folder) {
        Err(e) if e.kind() == ErrorKind::NotFound => return Ok(()),
        entries => entries?,
    };
    for entry in entries {
        let path = entry?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        if is_own(&name) || is_part(&name) {
            unless_gone(fs::remove_file(path))?;
        }
    }
    unless_gone(fs::remove_dir(folder))
}

/// Whether a file is one that [`write_whole`] has not come to the end of.
pub fn is_part(name: &str) -> bool {
    name.starts_with('.') && name.ends_with(".part")
}

fn part_of(path: &Path) -> PathBuf {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    path.with_file_name(format!(".{name}.part"))
}

/// Makes sure that a file can grow by `bytes`. Parallel writes to a full file system may be lost without an error or
/// hang, so that the space is taken beforehand: this sees quotas too, and no other program can take it meanwhile.
/// Where a file system cannot reserve, its free space is looked at.
pub(super) fn reserve(path: &Path, bytes: u64) -> Result<(), String> {
    let grow = || -> std::io::Result<()> {
        let file = File::options().write(true).open(path)?;
        let length = file.metadata()?.len();
        match fallocate(&file, FallocateFlags::KEEP_SIZE, length, bytes) {
            Err(rustix::io::Errno::OPNOTSUPP | rustix::io::Errno::NOSYS) => {
                let system = fstatvfs(&file)?;
                let free = system.f_bavail.saturating_mul(system.f_frsize);
                if free < bytes { Err(ErrorKind::StorageFull.into()) } else { Ok(()) }
            }
            outcome => Ok(outcome?),
        }
    };
    grow().map_err(|e| format!("{:.1} MB more are needed: {}", bytes as f64 / 1e6, explain(&e)))
}

/// Gives a finished file its name: all bytes on the disk, older results of that name moved aside, then renamed.
pub(super) fn publish(part: &Path, path: &Path) -> Result<Option<PathBuf>, String> {
    let act = || -> std::io::Result<Option<PathBuf>> {
        let file = File::options().write(true).open(part)?;
        file.set_len(file.metadata()?.len())?; // returns what was reserved and not used
        file.sync_all()?;
        let moved = make_way(path)?;
        fs::rename(part, path)?;
        let folder = path.parent().filter(|f| !f.as_os_str().is_empty()).unwrap_or(Path::new("."));
        File::open(folder)?.sync_all()?;
        Ok(moved)
    };
    act().map_err(|e| explain(&e))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_run_at_a_time() {
        let home = tempfile::tempdir().unwrap();
        let path = home.path().join("a/b");
        let first = Folder::prepare(&Comm::alone(), &path).unwrap();
        let second = Folder::prepare(&Comm::alone(), &path).unwrap_err();
        assert!(second.to_string().contains("another run"), "{second}");
        drop(first);
        Folder::prepare(&Comm::alone(), &path).unwrap();
        assert_eq!(fs::read_dir(&path).unwrap().count(), 0, "no traces");
    }

    #[test]
    fn a_file_in_the_way_is_named() {
        let home = tempfile::tempdir().unwrap();
        let path = home.path().join("file");
        fs::write(&path, "x").unwrap();
        let error = Folder::prepare(&Comm::alone(), &path).unwrap_err().to_string();
        assert!(error.contains("file") && error.contains("folder is wanted"), "{error}");
    }

    #[test]
    fn older_files_are_kept() {
        let home = tempfile::tempdir().unwrap();
        let path = home.path().join("run.h5");
        assert_eq!(make_way(&path).unwrap(), None);
        for k in 1..4 {
            fs::write(&path, k.to_string()).unwrap();
            let moved = make_way(&path).unwrap().unwrap();
            assert_eq!(moved, home.path().join(format!("run.{k}.h5")));
            assert_eq!(fs::read_to_string(moved).unwrap(), k.to_string());
        }
    }

    #[test]
    fn whole_or_not_at_all() {
        let home = tempfile::tempdir().unwrap();
        let path = home.path().join("picture.svg");
        write_whole(&path, b"one").unwrap();
        write_whole(&path, b"two").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"two");
        assert_eq!(fs::read_dir(home.path()).unwrap().count(), 1);
        let nowhere = write_whole(&home.path().join("none/p.svg"), b"x").unwrap_err().to_string();
        assert!(nowhere.contains("none/p.svg") && nowhere.contains("check the path"), "{nowhere}");
    }

    #[test]
    fn links_and_streams_stay() {
        let home = tempfile::tempdir().unwrap();
        let [link, second, target] = ["link", "second", "there/picture.svg"].map(|name| home.path().join(name));
        fs::create_dir(target.parent().unwrap()).unwrap();
        std::os::unix::fs::symlink("second", &link).unwrap();
        std::os::unix::fs::symlink("there/picture.svg", &second).unwrap();
        for text in ["one", "two"] {
            can_be_written(&link).unwrap();
            write_whole(&link, text.as_bytes()).unwrap();
            assert!(link.is_symlink() && second.is_symlink());
            assert_eq!(fs::read_to_string(&target).unwrap(), text);
        }
        let full = home.path().join("full");
        std::os::unix::fs::symlink("/dev/full", &full).unwrap();
        can_be_written(&full).unwrap();
        let error = write_whole(&full, b"x").unwrap_err().to_string();
        assert!(error.contains("free some space"), "{error}");
        assert!(full.is_symlink() && is_stream(Path::new("/dev/full")));
    }

    #[test]
    fn space_is_reserved_or_refused() {
        let file = tempfile::NamedTempFile::new().unwrap();
        reserve(file.path(), 1 << 16).unwrap();
        assert_eq!(file.as_file().metadata().unwrap().len(), 0);
        assert!(reserve(file.path(), 1 << 55).is_err());
    }
}
