use super::{ProtocolError, compress_to};
use crate::engine::{Energies, System};
use crate::minimize::{Goal, Minimizer, Report};
use crate::model::Model;

/// How the jamming onset is searched.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OnsetSearch {
    /// First increment of the density.
    pub step: f64,
    /// Give up when the increment has become smaller than this.
    pub smallest_step: f64,
    /// A state is jammed when its pressure exceeds the first value; the search ends at a jammed state whose pressure
    /// is below the second. Units of the model: ε/σ_S² (disks), γ/l (deformable particles).
    pub pressure: [f64; 2],
}

/// A packing at its jamming onset: the state of the system when the search returns.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Onset {
    /// Density of the marginally jammed state: φ_J, or ρ_J.
    pub density: f64,
    /// Highest density below it at which the search found no pressure.
    pub unjammed: f64,
    pub pressure: f64,
    /// Minimisations that it took.
    pub steps: u64,
}

/// Largest force at which a state on the way counts as balanced, over that of the least pressure of a jammed state on a
/// particle.
const ROUGH: f64 = 0.1;

/// Compresses until the system jams, decompresses until it does not, with ever smaller increments, and leaves it in a
/// marginally jammed state.
///
/// What decides is the pressure of a force-balanced state. An energy would not do for deformable particles, whose
/// energy is never zero; and a state that is not balanced decides nothing, it ends the search with an error. On the way
/// forces count as balanced when they are [`ROUGH`] of what the pressure of a jammed state needs, since just below the
/// onset overlaps vanish slowly; the state that is returned is balanced to `goal`. `visit` sees every state on the way.
pub fn find_onset<M: Model>(
    system: &mut System<M>,
    minimizer: &impl Minimizer,
    goal: &Goal,
    search: &OnsetSearch,
    mut visit: impl FnMut(f64, &Energies, &Report),
) -> Result<Onset, ProtocolError> {
    let mut density = system.density()?;
    let mut step = search.step;
    let mut unjammed = density;
    let mut compressing = true;
    // density and pressure of the jammed states since the last unjammed one, which belong to one packing
    let mut jammed: Option<(f64, f64)> = None;
    let mut steps = 0;
    loop {
        let least = search.pressure[0] * system.spacing();
        let rough = Goal { force_tolerance: goal.force_tolerance.max(ROUGH * least), ..*goal };
        let mut report = compress_to(system, minimizer, &rough, density)?;
        density = system.density()?;
        let mut energies = system.energies()?;
        let is_marginal = |pressure: f64| search.pressure[0] < pressure && pressure <= search.pressure[1];
        let may_end = is_marginal(energies.pressure()) && unjammed < density;
        if may_end {
            report = compress_to(system, minimizer, goal, density)?;
            density = system.density()?;
            energies = system.energies()?;
        }
        steps += 1;
        let pressure = energies.pressure();
        visit(density, &energies, &report);
        if may_end && is_marginal(pressure) {
            return Ok(Onset { density, unjammed, pressure, steps });
        }
        let is_jammed = pressure > search.pressure[0];
        if step < search.smallest_step {
            return Err(ProtocolError::NoOnset { density, step, pressure });
        }
        if is_jammed == compressing {
            step *= 0.5;
            compressing = !compressing;
        }
        if is_jammed {
            // The pressure of one packing falls linearly towards its onset: aim a little above it. The increment
            // bounds the move, so that a bad extrapolation costs no more than bisection.
            let target = (search.pressure[0] * search.pressure[1]).sqrt();
            let aim = match jammed {
                Some((there, then)) if then > pressure && there > density && pressure > target => {
                    (pressure - target) * (there - density) / (then - pressure)
                }
                _ => step,
            };
            jammed = Some((density, pressure));
            density -= aim.min(step);
        } else {
            unjammed = density;
            jammed = None;
            density += step;
        }
    }
}
