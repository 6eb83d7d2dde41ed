use super::ProtocolError;
use crate::engine::System;
use crate::minimize::{Goal, Minimized, Minimizer, Report};
use crate::model::Model;

/// States between a density and the next only stand for a change too large for rigid outlines: they are relaxed just
/// enough for outlines to part, to contacts that overlap by this part of [`Model::step_cap`], as long as max|F| is between
/// these in the unit of [`Model::force_unit`]. Disks are relaxed to the smaller one.
const PARTED: f64 = 2.5e-3;
const BETWEEN: [f64; 2] = [1e-3, 0.1];

/// max|F| of such states.
fn between<M: Model>(model: &M) -> f64 {
    let [least, most] = BETWEEN.map(|f| f * model.force_unit());
    let push = model.contact_stiffness().map_or(0.0, |stiffness| stiffness * PARTED * model.step_cap());
    push.max(least).min(most)
}

/// Densities at which a compression is sampled.
#[derive(Clone, Debug, PartialEq)]
pub enum Increments {
    /// These distances above the onset, ascending.
    Above(Vec<f64>),
    /// Steps of a given size from the onset up to a density.
    Until { density: f64, step: f64 },
}

impl Increments {
    /// The densities to visit, ascending, for a packing whose onset is at `onset`.
    pub fn densities(&self, onset: f64) -> Vec<f64> {
        match self {
            Increments::Above(increments) => increments.iter().map(|d| onset + d).collect(),
            Increments::Until { density, step } => {
                let n = ((density - onset) / step).ceil().max(0.0) as usize;
                (1..=n).map(|k| (onset + k as f64 * step).min(*density)).collect()
            }
        }
    }
}

/// Sets the density of the present particles by changing the box (centres move affinely, particles as rigid wholes),
/// then minimises; a change too large for rigid outlines is made in several such steps, all but the last relaxed roughly.
/// The density after that differs a little for deformable particles, whose shells grow as they deform.
pub fn compress_to<M: Model>(
    system: &mut System<M>,
    minimizer: &impl Minimizer,
    goal: &Goal,
    density: f64,
) -> Result<Report, ProtocolError> {
    loop {
        let area = system.own_area()?;
        let next = density.min(area / system.pbox().area() * system.densest_step());
        let pbox = system.pbox().with_area(area / next);
        system.deform_rigidly(pbox);
        let least = if next == density { 0.0 } else { between(&system.model) };
        let goal = Goal { force_tolerance: goal.force_tolerance.max(least), ..*goal };
        match minimizer.minimize(system, &goal)? {
            Minimized::Converged(report) if next == density => return Ok(report),
            Minimized::Converged(report) => tracing::debug!(density = next, report.iterations, "on the way"),
            Minimized::Unconverged(report) => return Err(ProtocolError::Unconverged { density: next, report }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn densities_ascend_to_the_end() {
        let until = Increments::Until { density: 0.95, step: 0.04 };
        let d = until.densities(0.84);
        assert_eq!(d.len(), 3);
        assert!((d[0] - 0.88).abs() < 1e-15 && d[2] == 0.95);
        assert!(until.densities(0.96).is_empty());
        assert_eq!(Increments::Above(vec![0.01, 0.1]).densities(0.5), [0.51, 0.6]);
    }
}
