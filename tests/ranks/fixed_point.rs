//! The smallest forces that can be reached do not grow with the box.

use crate::harness::Outcome;
use crate::systems::*;
use jamhpc::comm::Comm;
use jamhpc::engine::System;
use jamhpc::geometry::{Frac, PeriodicBox};
use jamhpc::minimize::{Fire, Minimizer};
use jamhpc::model::{Model, VertexEdge};
use jamhpc::particles::{Bodies, Particles};

const COPIES: u64 = 1024;

/// The system COPIES times side by side, in a box that much longer: point f of copy k lies at (f + k)/COPIES.
fn replicated<M: Model + Clone>(system: &System<M>, skin: f64) -> System<M> {
    let b = system.pbox();
    let pbox = PeriodicBox::new(COPIES as f64 * b.lx(), b.ly(), b.xy());
    let one = whole(system);
    let mut many = Particles::empty(&one.bodies);
    for copy in 0..COPIES {
        for p in 0..one.len() {
            // a particle across the boundary stays whole: its points follow the first
            let origin = one.points_of(p)[0];
            let [x, y] = origin.to_bits();
            let first = Frac::from_bits([(((copy as u128) << 64 | x as u64 as u128) / COPIES as u128) as i64, y]);
            let place = |point: &Frac| {
                let [dx, dy] = point.minus(origin);
                first.plus([dx / COPIES as i64, dy])
            };
            let points: Vec<Frac> = one.points_of(p).iter().map(place).collect();
            many.push((copy as usize * one.len() + p) as u32, one.size[p], &points);
        }
    }
    System::new(Comm::alone(), system.model, pbox, &pbox, many, skin).unwrap()
}

/// The smallest max|F| that FIRE comes to, to within a factor of two.
fn floor<M: Model>(system: &mut System<M>, patience: u64) -> f64 {
    let mut reached = system.max_force().unwrap();
    loop {
        let goal = goal(0.5 * reached, patience);
        let minimized = Fire.minimize(system, &goal).unwrap();
        if !minimized.is_converged() {
            return reached;
        }
        reached = minimized.report().max_force;
    }
}

fn force_noise<M: Model + Clone>(mut system: System<M>, skin: f64, patience: u64, unit: f64) -> Outcome {
    let small = floor(&mut system, 20_000);
    let mut system = replicated(&system, skin);
    let unrelaxed = system.max_force().unwrap();
    let large = floor(&mut system, patience);
    eprintln!(
        "edges {:.1} and {:.1}: max|F| falls to {small:e} and, from {unrelaxed:e}, to {large:e}",
        system.pbox().ly(),
        system.pbox().lx()
    );
    // coordinates of the box as f64 would cost a factor 1024
    assert!(small > 0.0 && small < 1e-14 * unit, "{small:e}");
    assert!(large < 8.0 * small, "{large:e} after {small:e}");
    Vec::new()
}

pub fn force_noise_sp(_: Comm) -> Outcome {
    let system = random_sp(Comm::alone(), 76, unit_box(0.0), 0.95, 0.95);
    force_noise(system, 0.3, 200, 1.0)
}

pub fn force_noise_dp(_: Comm) -> Outcome {
    let mut system = random_dp::<VertexEdge>(Comm::alone(), 8, unit_box(0.0), 0.7, 0.95);
    let goal = goal(1e-3, 100_000);
    let density = system.density().unwrap();
    for k in 1..=20 {
        let target = density + (0.93 - density) * k as f64 / 20.0;
        jamhpc::protocol::compress_to(&mut system, &Fire, &goal, target).unwrap();
    }
    let p = polygon_parameters();
    assert!(matches!(system.particles().bodies, Bodies::Polygons { .. }));
    force_noise(system, 0.1, 200, p.contact.epsilon / DELTA)
}
