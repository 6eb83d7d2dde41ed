//! The triangular lattice of equal soft disks.

use super::{Check, Effort};
use crate::comm::Comm;
use crate::engine::System;
use crate::geometry::PeriodicBox;
use crate::model::SoftDisks;
use crate::observe::{Contacts, Moduli, Rattlers};
use crate::particles::{Bodies, Particles};
use crate::protocol::ProtocolError;
use std::f64::consts::PI;

const COLUMNS: usize = 8;
const ROWS: usize = 8;
/// Rounding, far below what any mistake in a law or a box would be.
const TOLERANCE: f64 = 1e-11;

/// Disks of diameter σ at a distance r = fσ: the three quantities per disk follow from six equal contacts,
///
/// φ = π/(2√3 f²), p = √3 ε(1 − f)/(f σ²), G = (√3 ε/4σ²)(1 − 3(1 − f)/f) for simple shear of a fixed cell, z = 6.
///
/// The lattice deforms affinely, so G is also what linear response must give.
pub fn checks(world: &dyn Fn() -> Comm, effort: Effort) -> Result<Vec<Check>, ProtocolError> {
    let spacings: &[f64] = match effort {
        Effort::Quick => &[0.99, 0.95, 0.9],
        Effort::Long => &[0.9999, 0.999, 0.99, 0.97, 0.95, 0.92, 0.9, 0.85, 0.8],
    };
    let mut checks = Vec::new();
    for &f in spacings {
        let mut system = lattice(world(), f)?;
        let root = 3.0f64.sqrt();
        let mut check = |what: &str, expected: f64, got: f64| {
            checks.push(Check::new(format!("SP lattice f = {f}: {what}"), expected, got, TOLERANCE));
        };
        check("phi", PI / (2.0 * root * f * f), system.density()?);
        check("pressure", root * (1.0 - f) / f, system.energies()?.pressure());
        let moduli = Moduli::of(&mut system)?;
        check("G", 0.25 * root * (1.0 - 3.0 * (1.0 - f) / f), moduli.shear_modulus.linear_response);
        check("z", 6.0, Contacts::of(&mut system, Rattlers::default())?.contact_number());
    }
    Ok(checks)
}

/// ε = σ = 1, rows along x.
fn lattice(comm: Comm, spacing: f64) -> Result<System<SoftDisks>, ProtocolError> {
    let pbox = PeriodicBox::new(COLUMNS as f64 * spacing, ROWS as f64 * spacing * 0.75f64.sqrt(), 0.0);
    let mut disks = Particles::empty(&Bodies::Disks);
    if comm.is_root() {
        for id in 0..COLUMNS * ROWS {
            let (column, row) = (id % COLUMNS, id / COLUMNS);
            let x = column as f64 + 0.5 * (row % 2) as f64;
            disks.push(id as u32, 1.0, &[pbox.frac([x * spacing, row as f64 * spacing * 0.75f64.sqrt()])]);
        }
    }
    Ok(System::new(comm, SoftDisks { epsilon: 1.0, smallest: 1.0 }, pbox, &pbox, disks, 0.1)?)
}
