//! From random points to jammed packings: initial state, onset search, compression.
//!
//! Protocols act on a system and answer with values; they read and write no files.

mod compression;
mod initial;
mod onset;
mod shear;

pub use compression::compress_to;
pub use initial::{START_SKIN, Species, deformable_particles, random_disks, spread_disks, widening};
pub use onset::{Onset, OnsetSearch, find_onset};
pub use shear::{quasi_static_shear_modulus, shear_by};

use crate::engine::EngineError;
use crate::minimize::Report;

/// Why a protocol ended without its result.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ProtocolError {
    #[error(transparent)]
    Engine(#[from] EngineError),
    #[error(
        "not converged at density {density:.9}: max|F| = {:.3e} after {} iterations. Raise minimize.max_iterations, \
         loosen minimize.force_tolerance or take smaller steps", report.max_force, report.iterations
    )]
    Unconverged { density: f64, report: Report },
    #[error(
        "no random start: the disks around particles do not come to rest at density {density:.4}, max|F| = {:.3e} after {} \
         iterations. Lower initial.packing_fraction, or raise initial.spread if that is set", report.max_force,
        report.iterations
    )]
    NoStart { density: f64, report: Report },
    #[error(
        "no onset found: the step has shrunk to {step:.1e} at density {density:.9} while the pressure {pressure:.3e} is \
         not within the window. Widen onset.pressure or lower onset.smallest_step"
    )]
    NoOnset { density: f64, step: f64, pressure: f64 },
}
