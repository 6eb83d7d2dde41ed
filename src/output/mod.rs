//! What a run or a study leaves behind: one results file, pictures and plots; checkpoints on the way.

mod checkpoint;
mod error;
pub mod folder;
pub mod h5md;
pub mod info;
pub mod picture;
pub mod plot;
pub mod read;
pub mod render;
mod rows;
mod stdout;
pub mod tables;

pub use checkpoint::{Record, read_records, write_records};
pub use error::OutputError;
pub use folder::Folder;
pub use h5md::{Frame, Header, ResultsFile};
pub use info::info;
pub use read::{Results, Snapshot};
pub use stdout::print;
