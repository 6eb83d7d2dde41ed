//! Minimisers: from a system to a nearby minimum of its energy.

mod conjugate_gradient;
mod fire;
mod newton;

pub use conjugate_gradient::ConjugateGradient;
pub use fire::Fire;
pub use newton::Newton;

use crate::engine::{EngineError, System};
use crate::model::Model;

/// When to stop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Goal {
    /// Converged when no point feels a larger force than this.
    pub force_tolerance: f64,
    /// Give up after this many iterations.
    pub max_iterations: u64,
}

/// What a minimisation did.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Report {
    pub iterations: u64,
    pub force_evaluations: u64,
    /// Largest force on any point at the end.
    pub max_force: f64,
}

/// How a minimisation ended. Whoever minimises must say what becomes of a state that is not force-balanced.
#[derive(Clone, Copy, Debug, PartialEq)]
#[must_use = "a state that is not converged is not a result"]
pub enum Minimized {
    Converged(Report),
    /// The iteration limit came first; forces are unbalanced.
    Unconverged(Report),
}

impl Minimized {
    pub fn report(&self) -> &Report {
        match self {
            Minimized::Converged(report) | Minimized::Unconverged(report) => report,
        }
    }

    pub fn is_converged(&self) -> bool {
        matches!(self, Minimized::Converged(_))
    }
}

/// Forces beyond this, in the scene's units, can only come from a broken state.
const RUNAWAY: f64 = 1e12;

/// A way to minimise. Implementations must give the same bits on any number of ranks and threads: decide only by
/// values that are reduced over all ranks by order-independent sums or maxima.
pub trait Minimizer {
    fn minimize<M: Model>(&self, system: &mut System<M>, goal: &Goal) -> Result<Minimized, EngineError>;
}
