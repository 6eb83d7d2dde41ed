//! Quasi-static shear past the flip of the box.

use crate::harness::Outcome;
use crate::systems::*;
use jamhpc::comm::Comm;
use jamhpc::engine::System;
use jamhpc::minimize::{Fire, Minimizer};
use jamhpc::model::{Model, VertexEdge};
use jamhpc::protocol::shear_by;
use std::collections::BTreeMap;

/// Shears in `steps` to a total of `strain`; the stress at every step, and the last state.
fn sheared<M: Model>(mut system: System<M>, tolerance: f64, strain: f64, steps: u32) -> Outcome {
    let goal = goal(tolerance, 1_000_000);
    assert!(Fire.minimize(&mut system, &goal).unwrap().is_converged());
    let mut outcome = Vec::new();
    let mut flips = 0;
    for _ in 0..steps {
        let tilt = system.pbox().xy();
        let report = shear_by(&mut system, &Fire, &goal, strain / steps as f64).unwrap();
        assert!(system.pbox().xy().abs() <= 0.5 * system.pbox().lx());
        flips += (system.pbox().xy() < tilt) as u32;
        let stress = system.energies().unwrap().virial;
        outcome.push(format!("{} {report:?}", hex(&stress)));
    }
    assert_eq!(flips, (0.5 + strain).round() as u32, "the box starts with half a period of tilt");
    outcome.extend(describe(&mut system));
    outcome
}

pub fn sp(comm: Comm) -> Outcome {
    sheared(random_sp(comm, 256, unit_box(0.5), 0.9, 0.9), 1e-8, 1.2, 12)
}

pub fn dp(comm: Comm) -> Outcome {
    let mut system = random_dp::<VertexEdge>(comm, 32, unit_box(0.5), 0.75, 0.9);
    let tighter = system.pbox().with_area(0.9 * system.pbox().area());
    system.deform_rigidly(tighter);
    sheared(system, 1e-3, 0.8, 4)
}

/// A flip is another name for the same state: forces and stress stay, to rounding.
pub fn flip(comm: Comm) -> Outcome {
    let mut system = random_sp(comm, 256, unit_box(0.5), 0.9, 0.9);
    system.max_force().unwrap();
    let before = by_id(&system, force_words);
    let stress = system.energies().unwrap().virial;
    // half a period of tilt is as good to the left as to the right
    system.shear(0.0);
    assert_eq!(system.pbox().xy(), -0.5 * system.pbox().lx());
    system.max_force().unwrap();
    let after = by_id(&system, force_words);
    let forces = |words: &BTreeMap<u32, Vec<u64>>| -> Vec<f64> {
        words.values().flatten().map(|&word| f64::from_bits(word)).collect()
    };
    let (before, after) = (forces(&before), forces(&after));
    let largest = before.iter().fold(0.0, |m: f64, f| m.max(f.abs()));
    assert!(before.iter().zip(&after).all(|(a, b)| (a - b).abs() < 1e-13 * largest));
    for (a, b) in stress.iter().zip(system.energies().unwrap().virial) {
        assert!((a - b).abs() < 1e-13, "{a} {b}");
    }
    Vec::new()
}
