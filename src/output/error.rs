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
    /// What went wrong, without the path.
    pub fn reason(self) -> String {
        match self {
            OutputError::Write { reason, .. } | OutputError::Read { reason, .. } => reason,
        }
    }

    pub(super) fn write(path: &Path, reason: impl Display) -> Self {
        OutputError::Write { path: path.to_owned(), reason: reason.to_string() }
    }

    pub(super) fn read(path: &Path, reason: impl Display) -> Self {
        OutputError::Read { path: path.to_owned(), reason: reason.to_string() }
    }
}

/// [`Comm::agree`] on errors of any kind, as text. Collective.
pub(super) fn agree<T, E: Display>(comm: &Comm, outcome: Result<T, E>) -> Result<T, String> {
    comm.agree(outcome.map_err(|error| error.to_string()))
}

/// What `act` answers on rank 0, success or failure, on all ranks. Collective.
pub(super) fn on_root(comm: &Comm, act: impl FnOnce() -> Result<(), String>) -> Result<(), String> {
    comm.from_root(|| act().map(|()| Vec::new())).map(|_| ())
}
