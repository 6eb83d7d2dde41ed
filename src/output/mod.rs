//! What a run leaves behind: results files and pictures.

pub mod picture;
pub mod plot;
