use super::ProtocolError;
use crate::engine::System;
use crate::minimize::{Goal, Minimized, Minimizer, Report};
use crate::model::Model;

/// Shears the box by `strain` (x displaced by `strain` × y, every vertex taken along affinely), then minimises.
///
/// One step of quasi-static simple shear. Steps add up to any strain: the box is kept within half a period of tilt by
/// exact flips.
pub fn shear_by<M: Model>(
    system: &mut System<M>,
    minimizer: &impl Minimizer,
    goal: &Goal,
    strain: f64,
) -> Result<Report, ProtocolError> {
    system.shear(strain);
    match minimizer.minimize(system, goal)? {
        Minimized::Converged(report) => Ok(report),
        Minimized::Unconverged(report) => Err(ProtocolError::Unconverged { density: system.density()?, report }),
    }
}

/// G = −dΣ_xy/dγ from the stress after relaxed strains of ±`strain`; the system is left as it was.
///
/// The error is of the order `strain`² as long as no contact opens or closes on the way.
pub fn quasi_static_shear_modulus<M: Model>(
    system: &mut System<M>,
    minimizer: &impl Minimizer,
    goal: &Goal,
    strain: f64,
) -> Result<f64, ProtocolError> {
    let (pbox, particles) = (*system.pbox(), system.own_particles());
    let mut stress = [0.0; 2];
    for (stress, strain) in stress.iter_mut().zip([strain, -strain]) {
        shear_by(system, minimizer, goal, strain)?;
        *stress = system.energies()?.virial[1];
        system.restore(pbox, particles.clone());
    }
    Ok((stress[1] - stress[0]) / (2.0 * strain))
}
