//! The hexagonal foam at rest, against the rounded hexagons that it becomes as N_v → ∞.

use super::border::Border;
use super::rounded_hexagon::{Material, RoundedHexagon};
use super::{Check, Effort, mean};
use crate::comm::Comm;
use crate::engine::System;
use crate::minimize::{Goal, Minimized, Minimizer, Newton};
use crate::model::{Deformable, VertexEdge};
use crate::observe::{Moduli, VoidStatistics, Voids};
use crate::protocol::ProtocolError;
use std::f64::consts::PI;

/// The smallest box that two ranks can share.
const COLUMNS: usize = 4;
const ROWS: usize = 2;
const CELLS: f64 = (COLUMNS * ROWS) as f64;

/// Sliding along a facet costs a vertex nothing; smaller forces change nothing.
pub const GOAL: Goal = Goal { force_tolerance: 1e-7, max_iterations: 1_000_000 };

/// Small particles of a mixture of 12 and 17 vertices, κ = 1000.
pub fn material(delta: f64, epsilon: f64) -> Material {
    let rest_area = (24.0f64 / 29.0).powi(2);
    Material { rest_area, k_area: 1000.0 / (rest_area * rest_area), epsilon, delta }
}

/// Numbers of vertices, whole ones in each of six arcs.
const QUICK: [usize; 4] = [12, 18, 24, 36];
/// ε of ever harder contacts: from 2 to 40 % of the paper's.
const HARDER: [f64; 3] = [100.0, 400.0, 1600.0];
/// The hardest of them.
const HARD: f64 = HARDER[2];

/// The limit of hard contacts of what falls as ε^−`power`, from its values at [`HARDER`].
fn hard(values: [f64; 3], power: f64) -> f64 {
    at_zero(&std::array::from_fn::<_, 3, _>(|k| (HARDER[k].powf(-power), values[k])))
}

/// The formulas hold where contacts are hard. Vertices leave the facets, along which they slide without effort, for the
/// arcs, where they shorten the outline: a facet is one edge, pressed on by the ends of the other, and an arc has all
/// k = N_v/6 vertices of a sector. So the overlap of facets depends on ε only, and limits of hard contacts are
/// polynomials through three ε; what is left of errors is the next power.
///
/// The border radius r of a state is what its pressure inside says, k_a(a₀ − a) = γ/r. P and G at that r are those of
/// rounded hexagons with any number of vertices, because each facet bears γ/r between the points where it touches the
/// circles of radius r. In a given box P and r are exactly known too ([`RoundedHexagon::with_corners`]); P comes to that
/// of arcs as 1/N_v², and next 1/N_v⁴.
///
/// Area and shape parameter of a border are those of [`Border::between_polygons`]. Overlaps blunt its cusps by an angle
/// √(overlap) ∝ ε^−1/2; missing ends of cusps make 𝒜 smaller by a part ∝ 1/N_v, and p/√a at the four numbers of
/// vertices extrapolates to that of three touching arcs with an error ∝ 1/N_v⁴, which is 1.7·10⁻³ of 𝒜 by the formula.
///
/// The decoration theorem: G/(1 + δ/2r) is that of a dry foam, γ/(√3 h), whatever the borders.
/// And as these vanish, the shape parameter tends to that of the hexagon, 𝒜 = 2√3/π (quadratic extrapolation in r/H,
/// which misses 1.7·10⁻⁴ by the formulas for these polygons).
pub fn checks(world: &dyn Fn() -> Comm, effort: Effort) -> Result<Vec<Check>, ProtocolError> {
    let mut checks = Vec::new();
    let counts: &[usize] = match effort {
        Effort::Quick => &QUICK,
        Effort::Long => &[12, 18, 24, 30, 36, 42, 48],
    };
    let delta = 0.2;
    let hardest = material(delta, HARD);
    let cell = RoundedHexagon::at_density(&hardest, 0.98);
    let (mut pressures, mut cusps) = (Vec::new(), Vec::new());
    for &n in counts {
        let mut states = Vec::new();
        for epsilon in HARDER {
            states.push(State::of(world(), &material(delta, epsilon), &cell, n)?);
        }
        let limit = |of: &dyn Fn(&State) -> f64, power: f64| hard(std::array::from_fn(|k| of(&states[k])), power);
        let mut check = |what: &str, expected: f64, got: f64, tolerance: f64| {
            checks.push(Check::new(format!("foam 0.98, N_v = {n}: {what}"), expected, got, tolerance));
        };
        let exact = cell.with_corners(&hardest, n / 6);
        let pressure = limit(&|s| s.pressure, 1.0);
        check("P", exact.pressure(), pressure, 1e-5);
        check("P over P(r)", 1.0, limit(&|s| s.pressure / s.inside.pressure(), 1.0), 1e-6);
        check("G over G(r)", 1.0, limit(&|s| s.shear_modulus / s.inside.shear_modulus(), 1.0), 1e-6);
        check("Plateau borders a cell", 2.0, states[0].voids.with_sides[0] as f64 / CELLS, 0.0);
        let border = Border::between_polygons(exact.border, delta, n / 6);
        check("radius of borders by area", border.radius(), limit(&|s| s.voids.border_radius, 1.0), 1e-5);
        let shape = limit(&|s| s.voids.border_shape_parameter, 0.5);
        check(&format!("A, r = {:.3} delta", exact.border / delta), border.shape_parameter(), shape, 5e-4);
        pressures.push((n, pressure));
        cusps.push((1.0 / n as f64, shape.sqrt()));
    }
    let of = |n: usize| pressures.iter().find(|p| p.0 == n).map_or(f64::NAN, |p| p.1);
    let limit = cell.pressure();
    let order = |n: usize| ((limit - of(n)) / (limit - of(2 * n))).log2();
    checks.push(Check::new("foam 0.98: order of P, N_v = 18 to 36", 2.0, order(18), 0.05));
    checks.push(Check::new("foam 0.98: P, N_v to infinity", limit, (4.0 * of(36) - of(18)) / 3.0, 1e-3));
    cusps.retain(|(x, _)| QUICK.contains(&((1.0 / x).round() as usize)));
    let shape = at_zero(&cusps).powi(2);
    checks.push(Check::new("foam 0.98: A of borders, N_v to infinity", super::plateau_shape_parameter(), shape, 2e-3));

    let densities: &[f64] = match effort {
        Effort::Quick => &[0.95, 0.97, 0.98, 0.99],
        Effort::Long => &[0.93, 0.94, 0.95, 0.96, 0.97, 0.98, 0.985, 0.99],
    };
    for &density in densities {
        let mut ratios = [0.0; 3];
        for (ratio, epsilon) in ratios.iter_mut().zip(HARDER) {
            let thin = material(0.1, epsilon);
            let state = State::of(world(), &thin, &RoundedHexagon::at_density(&thin, density), 12)?;
            *ratio = state.shear_modulus / state.inside.shear_modulus();
        }
        // the same for all
        let dry = hard(ratios, 1.0);
        checks.push(Check::new(format!("foam {density}: sqrt3 G h/(1 + delta/2r)"), 1.0, dry, 1e-6));
    }

    let mut shapes = Vec::new();
    for density in [0.96, 0.98, 0.993] {
        let soft = material(delta, HARD);
        let cell = RoundedHexagon::at_density(&soft, density);
        let state = State::of(world(), &soft, &cell, 24)?;
        shapes.push((state.inside.border / cell.hexagon(), state.shape_parameter));
    }
    let hexagon = 2.0 * 3.0f64.sqrt() / PI;
    checks.push(Check::new("dry hexagon: A = p^2/(4 pi a), r to 0", hexagon, at_zero(&shapes), 3e-4));
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
        if let Minimized::Unconverged(report) = Newton.minimize(&mut system, &GOAL)? {
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Softened contacts let an edge at the end of a facet become so short that FIRE alone does not relax it.
    #[test]
    fn a_foam_with_short_edges_relaxes() {
        let hardest = material(0.2, HARD);
        let cell = RoundedHexagon::at_density(&hardest, 0.98);
        let state = State::of(Comm::alone(), &hardest, &cell, 48).unwrap();
        let exact = cell.with_corners(&hardest, 48 / 6);
        assert!((state.pressure / exact.pressure() - 1.0).abs() < 0.01);
    }
}
