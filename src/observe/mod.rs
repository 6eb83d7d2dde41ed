//! What is measured on a force-balanced system: contacts, shapes, areas, voids, energies and stresses.
//!
//! Everything here is collective and gives the same bits on any number of ranks and threads: sums over particles are
//! order-independent, everything else is a count or a maximum.

mod approximations;
mod contacts;
mod crossings;
mod invariants;
mod moduli;
mod outlines;
mod packing_fraction;
mod sample;
mod shape;
mod spectrum;
mod voids;

pub use approximations::Approximations;
pub use contacts::{Contacts, Rattlers, all_pairs, touching};
pub use crossings::{check_no_coincident, check_no_crossing, refuse_coincident, refuse_crossings};
pub use invariants::{Invariant, invariants};
pub use moduli::{Moduli, Modulus, Stability};
pub use packing_fraction::PackingFraction;
pub use sample::{OnsetBracket, PerParticle, Sample};
pub use shape::{Shape, ShapeParameter};
pub use spectrum::{MAX_COORDINATES, Spectrum};
pub use voids::{Void, VoidStatistics, Voids, rattler_ids};

use crate::engine::System;
use crate::model::Model;

/// Something to do with a system whose model is known only once a file has been read.
pub trait Look {
    type Output;
    type Error;

    fn look<M: Model>(self, system: &mut System<M>) -> Result<Self::Output, Self::Error>;
}
