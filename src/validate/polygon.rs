//! One deformable particle by itself.

use super::{Check, Effort, mean};
use crate::comm::Comm;
use crate::engine::System;
use crate::geometry::{PeriodicBox, norm, sub};
use crate::minimize::{Fire, Goal, Minimized, Minimizer};
use crate::model::{Deformable, DeformableParameters, Harmonic, VertexEdge};
use crate::particles::{Bodies, Particles};
use crate::protocol::ProtocolError;
use std::f64::consts::{PI, TAU};

const K_AREA: f64 = 100.0;
const REST_AREA: f64 = 1.0;
/// Forces of this size leave what is linear in the shape at 10⁻⁹ and what is quadratic at rounding.
const FORCE_TOLERANCE: f64 = 1e-11;

/// A polygon with line tension γ = 1 relaxes to the regular one, where the pressure of its area holds the tension of
/// its outline: with R_in the radius of the inscribed circle,
///
/// a = N tan(π/N) R_in², k_a(a₀ − a) = γ/R_in.
///
/// R_in is 2a/p of any polygon around a circle; that all corners are equally far from the centre says the rest.
pub fn checks(world: &dyn Fn() -> Comm, effort: Effort) -> Result<Vec<Check>, ProtocolError> {
    let counts: &[usize] = match effort {
        Effort::Quick => &[12, 17, 24, 48],
        Effort::Long => &[5, 12, 17, 24, 48, 96],
    };
    let mut checks = Vec::new();
    for &n in counts {
        let [area, radius, nearest, farthest] = relaxed(world(), n)?;
        let mut check = |what: &str, expected: f64, got: f64, tolerance: f64| {
            checks.push(Check::new(format!("DP lone {n}-gon: {what}"), expected, got, tolerance));
        };
        check("farthest over nearest corner", 1.0, farthest / nearest, 1e-8);
        check("a/R_in^2", n as f64 * (PI / n as f64).tan(), area / (radius * radius), 1e-12);
        check("k_a(a0 - a) R_in/gamma", 1.0, K_AREA * (REST_AREA - area) * radius, 1e-8);
    }
    Ok(checks)
}

/// Area, 2a/p, and distances of the nearest and the farthest corner from the centroid, of an ellipse let go.
fn relaxed(comm: Comm, n: usize) -> Result<[f64; 4], ProtocolError> {
    let pbox = PeriodicBox::square(8.0);
    let mut polygons = Particles::empty(&Bodies::Polygons { first: vec![0] });
    if comm.is_root() {
        let corner = |k: usize| {
            let angle = TAU * k as f64 / n as f64;
            pbox.frac([0.6 * angle.cos(), 0.5 * angle.sin()])
        };
        polygons.push(0, REST_AREA, &(0..n).map(corner).collect::<Vec<_>>());
    }
    let model = Deformable::<VertexEdge>::new(DeformableParameters {
        line_tension: 1.0,
        k_area: K_AREA,
        contact: Harmonic { epsilon: 1.0, delta: 0.1 },
        largest_area_per_vertex: REST_AREA / n as f64,
    });
    let mut system = System::new(comm, model, pbox, &pbox, polygons, 0.1)?;
    let goal = Goal { force_tolerance: FORCE_TOLERANCE, max_iterations: 1_000_000 };
    if let Minimized::Unconverged(report) = Fire.minimize(&mut system, &goal)? {
        return Err(ProtocolError::Unconverged { density: system.density()?, report });
    }
    Ok(mean(&mut system, |polygon| {
        let center = polygon.centroid();
        let distances = || polygon.offsets().map(|corner| norm(sub(corner, center)));
        let nearest = distances().fold(f64::INFINITY, f64::min);
        let area = polygon.area();
        [area, 2.0 * area / polygon.perimeter(), nearest, distances().fold(0.0, f64::max)]
    })?)
}
