//! The Hessian and what is solved with it: the same bits on any number of ranks and threads.

use crate::harness::Outcome;
use crate::systems::*;
use jamhpc::comm::Comm;
use jamhpc::engine::System;
use jamhpc::minimize::{Fire, Minimizer};
use jamhpc::model::{Model, VertexEdge};
use jamhpc::observe::{Moduli, Stability};
use jamhpc::protocol::compress_to;

fn moduli<M: Model>(system: &mut System<M>) -> Outcome {
    let moduli = Moduli::of(system).unwrap();
    assert_eq!(moduli.stability, Stability::Stable, "{moduli:?}");
    assert!(moduli.bulk_modulus.linear_response > 0.1, "{moduli:?}");
    assert!(moduli.shear_modulus.linear_response < 0.9 * moduli.shear_modulus.affine, "{moduli:?}");
    vec![format!("{moduli:?}")]
}

pub fn sp(comm: Comm) -> Outcome {
    let mut system = random_sp(comm, 256, unit_box(0.1), 0.95, 0.95);
    assert!(Fire.minimize(&mut system, &goal(1e-11, 100_000)).unwrap().is_converged());
    moduli(&mut system)
}

pub fn dp(comm: Comm) -> Outcome {
    let mut system = random_dp::<VertexEdge>(comm, 32, unit_box(0.1), 0.8, 0.95);
    // larger forces may belong to a state on its way past a saddle
    compress_to(&mut system, &Fire, &goal(1e-6, 1_000_000), 0.93).unwrap();
    moduli(&mut system)
}
