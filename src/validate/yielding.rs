//! The hexagonal foam sheared until its cells change neighbours.

use super::foam::{GOAL, inside, material};
use super::rounded_hexagon::RoundedHexagon;
use super::{Check, Effort};
use crate::comm::Comm;
use crate::minimize::Newton;
use crate::protocol::{ProtocolError, shear_by};

/// Wide enough for two ranks when it is tilted by half its edge.
const COLUMNS: usize = 5;
const ROWS: usize = 2;
const N_VERTICES: usize = 24;
const DENSITY: f64 = 0.98;
/// Thin films: growing, they would take the liquid out of the borders.
const DELTA: f64 = 0.05;
/// Facets then overlap by some 10⁻⁴ δ, which is 10⁻⁴ of the stress.
const EPSILON: f64 = 400.0;

/// Before yield τ = G s/√(1 + s²/4), G with the film tension at the present border radius. The film that shrinks is
/// gone at s = 2/√3 when borders are small, and at [`RoundedHexagon::yield_strain`] when two borders meet on it: there
/// cells change neighbours and the stress drops. (Films of finitely many vertices rest on four of them and go at once a
/// little earlier: with 24 and 36 vertices, any ε and any step of strain when they are 0.01 long, 0.02 before that
/// strain. Its tolerance is that, and the step.) Which neighbours come next is a matter of rounding.
pub fn checks(world: &dyn Fn() -> Comm, effort: Effort) -> Result<Vec<Check>, ProtocolError> {
    let steps = match effort {
        Effort::Quick => 96,
        Effort::Long => 384,
    };
    let step = 2.0 / 3.0f64.sqrt() / steps as f64;
    let material = material(DELTA, EPSILON);
    let cell = RoundedHexagon::at_density(&material, DENSITY).with_corners(&material, N_VERTICES / 6);
    let mut system = cell.system(world(), &material, N_VERTICES, COLUMNS, ROWS)?;
    let mut curve = Vec::new();
    for k in 0..=steps {
        shear_by(&mut system, &Newton, &GOAL, if k == 0 { 0.0 } else { step })?;
        let now = inside(&mut system, &material, &cell)?;
        curve.push((k as f64 * step, -system.energies()?.virial[1], now));
        if fall(&curve).is_some() {
            break;
        }
    }
    let mut checks = Vec::new();
    let name = |what: &str| format!("sheared foam {DENSITY}: {what}");
    for quarter in 1..=4 {
        let Some(&(s, stress, now)) = curve.get(quarter * steps / 8) else { continue };
        checks.push(Check::new(name(&format!("tau at s = {s:.3}")), now.shear_stress(s), stress, 2e-4));
    }
    // NaN, and so no pass, if it never does
    let dropped = fall(&curve).unwrap_or(f64::NAN);
    checks.push(Check::new(name("strain of the stress drop"), cell.yield_strain(), dropped, 0.05));
    Ok(checks)
}

/// The middle of the first step over which the stress falls to less than half.
fn fall(curve: &[(f64, f64, RoundedHexagon)]) -> Option<f64> {
    let falls = curve.windows(2).find(|pair| pair[1].1 < 0.5 * pair[0].1);
    falls.map(|pair| 0.5 * (pair[0].0 + pair[1].0))
}
