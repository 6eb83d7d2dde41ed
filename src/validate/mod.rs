//! The program against exact formulas: crystals, single polygons, foams, and two ways to one modulus; and, in the long
//! mode, against what is known of the means of many random packings.
//!
//! Every check runs the engine itself, over all ranks, and compares one number with what theory says. A tolerance is
//! rounding where the formula holds for what is computed; the next power where it is a limit, of hard contacts or many
//! vertices; where it is a mean over packings, standard errors and what the reference leaves open, as said there.

mod border;
mod ensemble;
mod foam;
mod lattice;
mod packings;
mod polygon;
mod rounded_hexagon;
mod table;
mod yielding;

pub use ensemble::{AtOnset, mean_and_error, onset_checks};
pub use table::{header, line};

use crate::comm::Comm;
use crate::engine::{EngineError, System};
use crate::geometry::Polygon;
use crate::model::{Model, Outline};
use crate::protocol::ProtocolError;
use std::f64::consts::PI;

/// One number that is known and what the program makes of it.
#[derive(Clone, Debug, PartialEq)]
pub struct Check {
    pub name: String,
    pub expected: f64,
    pub got: f64,
    /// Largest error that passes.
    pub tolerance: f64,
}

impl Check {
    fn new(name: impl Into<String>, expected: f64, got: f64, tolerance: f64) -> Check {
        Check { name: name.into(), expected, got, tolerance }
    }

    /// Relative; no expected value is zero.
    pub fn error(&self) -> f64 {
        (self.got / self.expected - 1.0).abs()
    }

    pub fn passes(&self) -> bool {
        // not "≤ fails": NaN does not pass
        self.error() <= self.tolerance
    }
}

/// How fine the checks are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Effort {
    /// Seconds on one core.
    Quick,
    /// More vertices, smaller strains, ensembles of packings: seven minutes.
    Long,
}

/// A group of checks; it starts its systems on communicators that it asks for.
type Group = fn(&dyn Fn() -> Comm, Effort) -> Result<Vec<Check>, ProtocolError>;

/// From the cheapest to the dearest.
const GROUPS: [Group; 7] = [
    lattice::checks,
    polygon::checks,
    foam::checks,
    yielding::checks,
    packings::checks,
    ensemble::soft_disks,
    ensemble::deformable,
];

/// Runs all checks; `show` sees each as soon as it is known. `world` makes a communicator of all ranks. Collective, and
/// the same bits on any number of ranks.
///
/// A group with a state that does not come to force balance is one check that fails.
///
/// # Errors
/// More ranks than the small boxes of the checks hold.
pub fn run(
    world: &dyn Fn() -> Comm,
    effort: Effort,
    mut show: impl FnMut(&Check),
) -> Result<Vec<Check>, ProtocolError> {
    let mut all = Vec::new();
    for group in GROUPS {
        let checks = or_unrelaxed(group(world, effort))?;
        checks.iter().for_each(&mut show);
        all.extend(checks);
    }
    Ok(all)
}

/// The checks of a group, or one that fails for a state that did not come to force balance.
fn or_unrelaxed(checks: Result<Vec<Check>, ProtocolError>) -> Result<Vec<Check>, ProtocolError> {
    if let Err(ProtocolError::Unconverged { density, report } | ProtocolError::NoStart { density, report }) = checks {
        let name = format!("density {density:.4}: relaxed in {} iterations", report.iterations);
        return Ok(vec![Check::new(name, 1.0, 0.0, 0.0)]);
    }
    checks
}

/// π/(4√3 − 2π) = 4.8706, p²/4πa of the void between three equal arcs that touch: a Plateau border.
fn plateau_shape_parameter() -> f64 {
    PI / (4.0 * 3.0f64.sqrt() - 2.0 * PI)
}

/// Means of some numbers over the polygons of all ranks; all zero for disks. Collective.
fn mean<M: Model, const K: usize>(
    system: &mut System<M>,
    of: impl Fn(&Polygon) -> [f64; K] + Sync,
) -> Result<[f64; K], EngineError> {
    let rows = system.outlines(|outline| match outline {
        Outline::Polygon { polygon, .. } => of(polygon),
        Outline::Disk { .. } => [0.0; K],
    })?;
    let n = system.n_particles() as f64;
    Ok(system.comm.sum_terms(rows.len(), |p| rows[p]).map(|sum| sum / n))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::minimize::Report;

    #[test]
    fn what_passes() {
        assert!(Check::new("", 2.0, 2.002, 1.1e-3).passes());
        assert!(!Check::new("", 2.0, 2.002, 0.9e-3).passes());
        assert!(!Check::new("", -2.0, 2.0, 0.1).passes());
        assert!(!Check::new("", 2.0, f64::NAN, 1e9).passes());
    }

    #[test]
    fn a_state_that_does_not_relax_is_a_check_that_fails() {
        let report = Report { iterations: 7, ..Report::default() };
        let checks = or_unrelaxed(Err(ProtocolError::Unconverged { density: 0.85, report })).unwrap();
        let [check] = &checks[..] else { panic!("{checks:?}") };
        assert!(!check.passes() && check.name.contains("0.8500") && check.name.contains("7 iterations"), "{check:?}");
        assert!(or_unrelaxed(Err(EngineError::Interrupted.into())).is_err());
    }

    #[test]
    fn cheap_groups_pass() {
        for group in [lattice::checks, polygon::checks, foam::checks, yielding::checks] {
            for check in group(&Comm::alone, Effort::Quick).unwrap() {
                assert!(check.passes(), "{check:?}");
            }
        }
    }
}
