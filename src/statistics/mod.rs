//! Averages, their errors, and fits. Numbers in, numbers out.

mod bootstrap;
mod fit;

pub use bootstrap::{Estimate, bootstrap, mean, spread};
pub use fit::{Curve, amplitudes, free_exponent, free_exponents, power_law};
