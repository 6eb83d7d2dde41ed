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
