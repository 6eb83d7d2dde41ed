//! What is measured on a force-balanced system: contacts, shapes, areas, voids, energies and stresses.
//!
//! Everything here is collective and gives the same bits on any number of ranks and threads: sums over particles are
//! order-independent, everything else is a count or a maximum.

mod approximations;
mod contacts;
mod crossings;
mod outlines;
mod packing_fraction;
mod sample;
mod shape;
mod voids;

pub use approximations::Approximations;
pub use contacts::{Contacts, Rattlers};
pub use crossings::check_no_crossing;
pub use packing_fraction::PackingFraction;
pub use sample::{OnsetBracket, PerParticle, Sample};
pub use shape::{Shape, ShapeParameter};
pub use voids::{Void, VoidStatistics, Voids, rattler_ids};
