//! The hexagonal foam at rest, against the rounded hexagons that it becomes as N_v → ∞.

use super::rounded_hexagon::{Material, RoundedHexagon};
use super::{Check, Effort, mean};
use crate::comm::Comm;
use crate::engine::System;
use crate::minimize::{Fire, Goal, Minimized, Minimizer};
use crate::model::{Deformable, VertexEdge};
use crate::observe::{Moduli, VoidStatistics, Voids};
use crate::protocol::ProtocolError;
use std::f64::consts::PI;

/// The smallest box that two ranks can share.
const COLUMNS: usize = 4;
const ROWS: usize = 2;
const CELLS: f64 = (COLUMNS * ROWS) as f64;

/// Sliding along a facet costs a vertex nothing; smaller forces would be slow to come by and change nothing.
pub const GOAL: Goal = Goal { force_tolerance: 1e-6, max_iterations: 1_000_000 };

/// Small particles of a mixture of 12 and 17 vertices, κ = 1000, contacts about as stiff as areas.
pub fn material(delta: f64) -> Material {
    let rest_area = (24.0f64 / 29.0).powi(2);
    Material { rest_area, k_area: 1000.0 / (rest_area * rest_area), epsilon: 40.0, delta }
}

/// Finitely many vertices and finitely stiff contacts let facets approach each other by a little less than δ, which
/// makes the borders wider than in the limit. So each state is compared twice: P and G with the formulas at the border
/// radius that its own pressure inside says, k_a(a₀ − a) = γ/r; and P with the limit at the same box, by its order of
/// convergence (the overlap of facets goes with the distance of vertices: 1) and extrapolated in 1/N_v (Richardson).
///
/// The three arcs that meet in a border have the radius r + δ/2, their shells included; the area of the border says it
/// with an error that falls as 1/N_v. (Its shape parameter says nothing here: where facets are nearer than δ their shells
/// blunt the thin cusps, which are most of its perimeter.)
///
/// The decoration theorem: G/(1 + δ/2r) is that of a dry foam, γ/(√3 h), whatever the borders. And as these vanish, the
/// shape parameter tends to that of the hexagon, 𝒜 = 2√3/π (quadratic extrapolation in r/H).
pub fn checks(world: &dyn Fn() -> Comm, effort: Effort) -> Result<Vec<Check>, ProtocolError> {
    let mut checks = Vec::new();
    let counts: &[usize] = match effort {
        Effort::Quick => &[12, 18, 24, 36],
        Effort::Long => &[12, 15, 18, 21, 24, 30, 36],
    };
    let soft = material(0.2);
    let cell = RoundedHexagon::at_density(&soft, 0.98);
    let mut pressures = Vec::new();
    for &n in counts {
        let state = State::of(world(), &soft, &cell, n)?;
        let name = |what: &str| format!("hexagonal foam 0.98, N_v = {n}: {what}");
        checks.push(Check::new(name("P at its own r"), state.inside.pressure(), state.pressure, 5e-3));
        checks.push(Check::new(name("G at its own r"), state.inside.shear_modulus(), state.shear_modulus, 1.5e-2));
        let borders = state.voids;
        checks.push(Check::new(name("Plateau borders a cell"), 2.0, borders.with_sides[0] as f64 / CELLS, 0.0));
        let radius = state.inside.border + 0.5 * soft.delta;
        let tolerance = 1.5 / n as f64;
        checks.push(Check::new(name("r + delta/2 of a border"), radius, borders.border_radius, tolerance));
        pressures.push((n, state.pressure));
    }
    let of = |n: usize| pressures.iter().find(|p| p.0 == n).map_or(f64::NAN, |p| p.1);
    let limit = cell.pressure();
    let order = |n: usize| ((limit - of(n)) / (limit - of(2 * n))).log2();
    checks.push(Check::new("hexagonal foam 0.98: order of P, N_v = 12 to 24", 1.0, order(12), 0.25));
    checks.push(Check::new("hexagonal foam 0.98: order of P, N_v = 18 to 36", 1.0, order(18), 0.2));
    let extrapolated = 2.0 * of(36) - of(18);
    checks.push(Check::new("hexagonal foam 0.98: P, N_v to infinity", limit, extrapolated, 2e-2));

    let densities: &[f64] = match effort {
        Effort::Quick => &[0.95, 0.97, 0.98, 0.99],
        Effort::Long => &[0.93, 0.94, 0.95, 0.96, 0.97, 0.98, 0.985, 0.99],
    };
    for &density in densities {
        let thin = material(0.1);
        let cell = RoundedHexagon::at_density(&thin, density);
        let state = State::of(world(), &thin, &cell, 12)?;
        // the same for all
        let dry = state.shear_modulus / state.inside.shear_modulus();
        checks.push(Check::new(format!("decoration, foam {density}: sqrt3 G h/(1 + delta/2r)"), 1.0, dry, 1e-2));
    }

    let mut shapes = Vec::new();
    for density in [0.96, 0.98, 0.993] {
        let cell = RoundedHexagon::at_density(&soft, density);
        let state = State::of(world(), &soft, &cell, 24)?;
        shapes.push((state.inside.border / cell.hexagon(), state.shape_parameter));
    }
    let hexagon = 2.0 * 3.0f64.sqrt() / PI;
    checks.push(Check::new("dry hexagon: A = p^2/(4 pi a), r to 0", hexagon, at_zero(&shapes), 5e-3));
    Ok(checks)
}

/// The value at x = 0 of the polynomial through all points (x, y).
fn at_zero(points: &[(f64, f64)]) -> f64 {
    let term = |i: usize| {
        let others = points.iter().enumerate().filter(|(j, _)| *j != i);
        points[i].1 * others.map(|(_, other)| other.0 / (other.0 - points[i].0)).product::<f64>()
    };
    (0..points.len()).map(term).sum()
}

/// A relaxed foam.
struct State {
    pressure: f64,
    shear_modulus: f64,
    /// p²/4πa of the mean cell.
    shape_parameter: f64,
    voids: VoidStatistics,
    /// The cell with the border radius of its pressure inside.
    inside: RoundedHexagon,
}

impl State {
    fn of(comm: Comm, material: &Material, cell: &RoundedHexagon, n_vertices: usize) -> Result<State, ProtocolError> {
        let mut system = cell.system(comm, material, n_vertices, COLUMNS, ROWS)?;
        if let Minimized::Unconverged(report) = Fire.minimize(&mut system, &GOAL)? {
            return Err(ProtocolError::Unconverged { density: system.density()?, report });
        }
        let [shape_parameter] = mean(&mut system, |p| [p.perimeter().powi(2) / (4.0 * PI * p.area())])?;
        Ok(State {
            pressure: system.energies()?.pressure(),
            shear_modulus: Moduli::of(&mut system)?.shear_modulus.linear_response,
            shape_parameter,
            voids: Voids::of(&mut system, &[], None)?.statistics,
            inside: inside(&mut system, material, cell)?,
        })
    }
}

/// The cell with the border radius that the pressure inside says, k_a(a₀ − a) = γ/r.
pub fn inside(
    system: &mut System<Deformable<VertexEdge>>,
    material: &Material,
    cell: &RoundedHexagon,
) -> Result<RoundedHexagon, ProtocolError> {
    let [area] = mean(system, |polygon| [polygon.area()])?;
    Ok(cell.with_other_border(1.0 / (material.k_area * (material.rest_area - area))))
}
