//! How a command ends when it cannot give its result: one message, one exit code, the same on every rank.

use crate::engine::EngineError;
use crate::exchange::ExchangeError;
use crate::output::OutputError;
use crate::protocol::ProtocolError;
use crate::scene::SceneError;
use serde::{Deserialize, Serialize};

/// Exit codes; a panic ends with [`crate::comm::EXIT_PANIC`].
pub mod exit {
    pub const SUCCESS: u8 = 0;
    pub const FAILURE: u8 = 1;
    pub const BAD_INPUT: u8 = 2;
    pub const NOT_CONVERGED: u8 = 3;
    /// By a signal, with all work kept: batch systems take it for a wish to be started again.
    pub const INTERRUPTED: u8 = 85;
}

/// Why a command has no result. The message says what to do about it.
#[derive(Clone, Debug, PartialEq, thiserror::Error, Serialize, Deserialize)]
pub enum Failure {
    /// What the user gave cannot be used: a key, a file, a folder, a number of ranks.
    #[error("{0}")]
    Input(String),
    /// A state did not come to force balance.
    #[error("{0}")]
    NotConverged(String),
    /// A signal ended it; it can be resumed.
    #[error("{0}")]
    Interrupted(String),
    /// Anything else: a full disk, forces that run away.
    #[error("{0}")]
    Other(String),
}

impl Failure {
    pub fn exit_code(&self) -> u8 {
        match self {
            Failure::Input(_) => exit::BAD_INPUT,
            Failure::NotConverged(_) => exit::NOT_CONVERGED,
            Failure::Interrupted(_) => exit::INTERRUPTED,
            Failure::Other(_) => exit::FAILURE,
        }
    }

    /// The same failure with a remark after its message.
    pub fn and(self, remark: &str) -> Self {
        let message = format!("{self}; {remark}");
        self.saying(message)
    }

    /// One of the same kind with another message.
    fn saying(self, message: String) -> Self {
        match self {
            Failure::Input(_) => Failure::Input(message),
            Failure::NotConverged(_) => Failure::NotConverged(message),
            Failure::Interrupted(_) => Failure::Interrupted(message),
            Failure::Other(_) => Failure::Other(message),
        }
    }
}

impl From<SceneError> for Failure {
    fn from(error: SceneError) -> Self {
        Failure::Input(error.to_string())
    }
}

impl From<EngineError> for Failure {
    fn from(error: EngineError) -> Self {
        match error {
            EngineError::TooManyRanks(_)
            | EngineError::BoxTooSmall { .. }
            | EngineError::LongEdges { .. }
            | EngineError::Coincident(..) => Failure::Input(error.to_string()),
            EngineError::Interrupted => Failure::Interrupted(error.to_string()),
            EngineError::Runaway { .. }
            | EngineError::Crossing(..)
            | EngineError::Voids { .. }
            | EngineError::OpenVoids
            | EngineError::Moduli { .. } => Failure::Other(error.to_string()),
        }
    }
}

impl From<ExchangeError> for Failure {
    fn from(error: ExchangeError) -> Self {
        let message = error.to_string();
        match error {
            ExchangeError::Input { .. } => Failure::Input(message),
            ExchangeError::Engine { source, .. } => Failure::from(source).saying(message),
        }
    }
}

impl From<OutputError> for Failure {
    fn from(error: OutputError) -> Self {
        match error {
            OutputError::Read { .. } => Failure::Input(error.to_string()),
            OutputError::Write { .. } => Failure::Other(error.to_string()),
        }
    }
}

impl From<ProtocolError> for Failure {
    fn from(error: ProtocolError) -> Self {
        match error {
            ProtocolError::Engine(error) => error.into(),
            ProtocolError::Unconverged { .. } | ProtocolError::NoStart { .. } | ProtocolError::NoOnset { .. } => {
                Failure::NotConverged(error.to_string())
            }
        }
    }
}
