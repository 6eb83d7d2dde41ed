use crate::comm::Comm;
use std::fmt::Display;
use std::path::{Path, PathBuf};

/// Why a file could not be written or read. All ranks get the same value.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum OutputError {
    #[error("cannot write {}: {reason}", path.display())]
    Write { path: PathBuf, reason: String },
    #[error("cannot read {}: {reason}", path.display())]
    Read { path: PathBuf, reason: String },
}

impl OutputError {
    pub(super) fn write(path: &Path, reason: impl Display) -> Self {
        OutputError::Write { path: path.to_owned(), reason: reason.to_string() }
    }

    pub(super) fn read(path: &Path, reason: impl Display) -> Self {
        OutputError::Read { path: path.to_owned(), reason: reason.to_string() }
    }
}

/// The value of every rank if all succeeded, else the reason of the first rank that failed, on all of them: the next
/// collective call is then made by all ranks or by none. Collective.
pub(super) fn agree<T, E: Display>(comm: &Comm, outcome: Result<T, E>) -> Result<T, String> {
    if !comm.any(outcome.is_err()) {
        return outcome.map_err(|error| error.to_string());
    }
    let reason = outcome.err().map_or(String::new(), |error| error.to_string());
    // one byte a word: these messages are short, and rare
    let all = comm.gather(reason.bytes().map(u64::from).collect());
    let first = all.iter().find(|words| !words.is_empty());
    let bytes = first.map_or(Vec::new(), |words| words.iter().map(|&word| word as u8).collect());
    Err(String::from_utf8_lossy(&comm.broadcast(bytes)).into_owned())
}

/// What `act` answers on rank 0, success or failure, on all ranks. Collective.
pub(super) fn on_root(comm: &Comm, act: impl FnOnce() -> Result<(), String>) -> Result<(), String> {
    comm.from_root(|| act().map(|()| Vec::new())).map(|_| ())
}
