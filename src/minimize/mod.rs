//! Minimisers: from a system to a nearby minimum of its energy.

mod conjugate_gradient;
mod fire;
mod heavy_ball;
mod newton;

pub use conjugate_gradient::ConjugateGradient;
pub use fire::Fire;
pub use heavy_ball::HeavyBall;
pub use newton::Newton;

use crate::engine::{EngineError, System};
use crate::model::Model;
use bytemuck::{Pod, Zeroable};
use serde::{Deserialize, Serialize};

/// When to stop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Goal {
    /// Converged when no point feels a larger force than this.
    pub force_tolerance: f64,
    /// Give up after this many iterations.
    pub max_iterations: u64,
}

/// What a minimisation did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, Pod, Zeroable)]
#[repr(C)]
pub struct Report {
    pub iterations: u64,
    pub force_evaluations: u64,
    /// Largest force on any point at the end.
    pub max_force: f64,
}

impl Report {
    /// Counts a force evaluation whose largest force is `max_force`. How the minimisation ends with it, if it does; else an
    /// iteration is counted that begins with it. Collective.
    fn count<M: Model>(
        &mut self,
        system: &System<M>,
        goal: &Goal,
        max_force: f64,
    ) -> Result<Option<Minimized>, EngineError> {
        self.force_evaluations += 1;
        self.max_force = max_force;
        check_not_runaway(system, max_force)?;
        if max_force <= goal.force_tolerance {
            return Ok(Some(Minimized::Converged(*self)));
        }
        if self.iterations >= goal.max_iterations {
            return Ok(Some(Minimized::Unconverged(*self)));
        }
        self.iterations += 1;
        Ok(None)
    }
}

/// Refuses forces that can only come from a broken state. Collective.
fn check_not_runaway<M: Model>(system: &System<M>, max_force: f64) -> Result<(), EngineError> {
    if max_force.is_nan() || max_force >= RUNAWAY {
        return Err(EngineError::Runaway { particle: system.offender(RUNAWAY).unwrap_or_default() });
    }
    Ok(())
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

/// Forces beyond this, in the scene's units, can only come from a broken state: contacts of the stiffest scene, half as
/// deep as they are wide, push with 10¹².
const RUNAWAY: f64 = 1e15;

/// Iterations between two looks at the clock and the signals: fewer than some seconds' even of millions of particles, and
/// enough that looking costs nothing.
pub const TURN: u64 = 64;

/// A way to minimise. Implementations must give the same bits on any number of ranks and threads: decide only by
/// values that are reduced over all ranks by order-independent sums or maxima.
pub trait Minimizer {
    /// Turns of at most so many iterations, with `None` for an answer until it has come to its end. What it must know at
    /// the next turn lies in `memory` (empty before the first, the same on all ranks) and in the carried vectors of the
    /// particles: put back with them, also in another process, it goes on to the same bits. Iterations that cannot be
    /// left are taken back where [`System::is_to_end`].
    fn advance<M: Model>(
        &self,
        system: &mut System<M>,
        goal: &Goal,
        memory: &mut Vec<u64>,
        iterations: u64,
    ) -> Result<Option<Minimized>, EngineError>;

    /// All in one turn.
    fn minimize<M: Model>(&self, system: &mut System<M>, goal: &Goal) -> Result<Minimized, EngineError> {
        self.advance(system, goal, &mut Vec::new(), u64::MAX)?.ok_or(EngineError::Interrupted)
    }
}

/// What a minimiser left in its memory, or `None` before the first turn.
fn remembered<T: Pod>(memory: &[u64]) -> Option<T> {
    (!memory.is_empty()).then(|| bytemuck::pod_read_unaligned(bytemuck::cast_slice(memory)))
}

/// The memory that [`remembered`] reads; T is made of 64-bit numbers.
fn memory_of<T: Pod>(state: &T) -> Vec<u64> {
    bytemuck::cast_slice(bytemuck::bytes_of(state)).to_vec()
}
