use super::{Goal, Minimized, Minimizer, Report};
use crate::comm::{FusedSums, Grid, Sums, Totals};
use crate::engine::{EngineError, System};
use crate::geometry::{Vec2, dot};
use crate::model::Model;

/// Fast inertial relaxation engine, version 2.0 (Guénolé et al., Comput. Mater. Sci. 175, 109584 (2020)), semi-implicit
/// Euler steps with unit masses: mixing after the velocity update, half a step back where the power turns negative.
///
/// One collective operation per step: the power F·v and the squared norms of F and v before the step determine the
/// norms after it, so everything that the step decides is known from one reduction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fire {
    /// Largest time step over the model's own safe one.
    pub time_step_factor: f64,
}

impl Default for Fire {
    fn default() -> Self {
        Fire { time_step_factor: 1.0 }
    }
}

const ALPHA_START: f64 = 0.25;
const ALPHA_SHRINK: f64 = 0.99;
const STEP_GROW: f64 = 1.1;
const STEP_SHRINK: f64 = 0.5;
/// Steps with positive power before the time step grows.
const DELAY: u32 = 20;
/// First time step over the largest.
const STEP_START: f64 = 0.1;
/// Smallest time step over the largest: below it FIRE would stand still with unbalanced forces.
const STEP_LEAST: f64 = 0.01;

/// Steps between looks at whether any two particles still touch.
const FREE_INTERVAL: u64 = 100;
/// Forces beyond this, in the scene's units, can only come from a broken state.
const RUNAWAY: f64 = 1e12;

/// The norms that one step is decided by.
#[derive(Clone, Copy, Debug, Default)]
struct Norms {
    power: f64,
    force2: f64,
    velocity2: f64,
    max_force: f64,
    max_velocity: f64,
}

impl Minimizer for Fire {
    fn minimize<M: Model>(&self, system: &mut System<M>, goal: &Goal) -> Result<Minimized, EngineError> {
        let largest_step = self.time_step_factor * system.model.time_step();
        let cap = system.model.step_cap();
        system.carry(1);
        let (mut dt, mut alpha, mut uphill_free) = (STEP_START * largest_step, ALPHA_START, 0u32);
        let mut sums = FusedSums::default();
        let mut report = Report::default();
        loop {
            let norms = measure(system, &mut sums)?;
            report.force_evaluations += 1;
            report.max_force = norms.max_force;
            if norms.max_force.is_nan() || norms.max_force >= RUNAWAY {
                let particle = system.offender(RUNAWAY).unwrap_or_default();
                return Err(EngineError::Runaway { particle });
            }
            if norms.max_force <= goal.force_tolerance {
                return Ok(Minimized::Converged(report));
            }
            if goal.stop_when_free && report.iterations % FREE_INTERVAL == 0 && system.energies()?.contact == 0.0 {
                return Ok(Minimized::Free(report));
            }
            if report.iterations >= goal.max_iterations {
                return Ok(Minimized::Unconverged(report));
            }
            report.iterations += 1;

            let downhill = norms.power > 0.0 || norms.velocity2 == 0.0;
            let step_back = if downhill { 0.0 } else { 0.5 * dt };
            if downhill {
                uphill_free += 1;
                if uphill_free > DELAY {
                    dt = (dt * STEP_GROW).min(largest_step);
                    alpha *= ALPHA_SHRINK;
                }
            } else {
                uphill_free = 0;
                dt = (dt * STEP_SHRINK).max(STEP_LEAST * largest_step);
                alpha = ALPHA_START;
            }
            // v ← (1 − α)(v + dt F) + α |v + dt F| F/|F|, or dt F after a turn
            let (keep, push) = if downhill {
                let speed2 = norms.velocity2 + dt * (2.0 * norms.power + dt * norms.force2);
                (1.0 - alpha, (1.0 - alpha) * dt + alpha * (speed2.max(0.0) / norms.force2).sqrt())
            } else {
                (0.0, dt)
            };
            let fastest = keep * norms.max_velocity + push * norms.max_force;
            let bound = (dt * fastest).min(cap) + step_back * norms.max_velocity;
            let capped = dt * fastest > cap;
            system.move_points(bound * (1.0 + 1e-9), |pbox, positions, velocities, forces| {
                for ((position, velocity), force) in positions.iter_mut().zip(velocities).zip(forces) {
                    let back = *velocity;
                    let mut v: Vec2 = [keep * back[0] + push * force[0], keep * back[1] + push * force[1]];
                    if capped {
                        let length = dt * dot(v, v).sqrt();
                        if length > cap {
                            v = [v[0] * (cap / length), v[1] * (cap / length)];
                        }
                    }
                    *velocity = v;
                    let step = [dt * v[0] - step_back * back[0], dt * v[1] - step_back * back[1]];
                    *position = pbox.moved(*position, step);
                }
            });
        }
    }
}

/// Forces at the present positions, and the norms of the step: one fused reduction, repeated only when forces or
/// velocities have outgrown the grids of the sums.
fn measure<M: Model>(system: &mut System<M>, fused: &mut FusedSums) -> Result<Norms, EngineError> {
    let partial = |grids: &[Grid; Totals::SUMS], forces: &[Vec2], velocities: &[Vec2]| {
        let mut totals = Totals::default();
        for (&f, &v) in forces.iter().zip(velocities) {
            totals.add(grids, [dot(f, v), dot(f, f), dot(v, v)]);
        }
        totals
    };
    let grids = fused.grids;
    let mut totals = system
        .evaluate(
            |chunk, particles, forces| partial(&grids, forces, &particles.carried[0][chunk.points.clone()]),
            Totals::merged,
        )?
        .unwrap_or_default();
    loop {
        system.comm.combine(&mut totals);
        if let Some(Sums { sum, max }) = fused.settle(&totals) {
            return Ok(Norms {
                power: sum[0],
                force2: sum[1],
                velocity2: sum[2],
                max_force: max[1].sqrt(),
                max_velocity: max[2].sqrt(),
            });
        }
        totals = partial(&fused.grids, system.forces(), &system.particles().carried[0]);
    }
}
