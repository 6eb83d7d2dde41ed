use super::{Goal, Minimized, Minimizer, Report, memory_of, remembered};
use crate::comm::{FusedSums, Grid, Sums, Totals};
use crate::engine::{EngineError, System};
use crate::geometry::{Frac, PeriodicBox, Vec2, dot};
use crate::lanes::{self, Kernel, Lanes};
use crate::model::Model;
use bytemuck::{Pod, Zeroable};

/// Fast inertial relaxation engine, version 2.0 (Guénolé et al., Comput. Mater. Sci. 175, 109584 (2020)), semi-implicit
/// Euler steps: mixing after the velocity update, half a step back where the power turns negative.
///
/// One collective operation per step: the power F·v and the squared norms of F and v before the step determine the
/// norms after it, so everything that the step decides is known from one reduction.
///
/// For particles of many points the masses are not all one (`Model::accelerate`): rigid motions of a particle are lighter,
/// so that the softest modes of a packing, particles rolling on each other, keep up with the stiffest, and its growth is
/// heavier where contacts are soft. This is FIRE in mass-weighted coordinates; the minimum is the same.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Fire;

const ALPHA_START: f64 = 0.25;
const ALPHA_SHRINK: f64 = 0.99;
const STEP_GROW: f64 = 1.1;
const STEP_SHRINK: f64 = 0.5;
/// Steps with positive power before the time step grows.
const DELAY: u64 = 20;
/// First time step over the largest.
const STEP_START: f64 = 0.1;
/// Smallest time step over the largest: below it FIRE would stand still with unbalanced forces.
const STEP_LEAST: f64 = 0.01;

/// What one step is decided by. With f the accelerations, M⁻¹F, the scalar products are those of mass-weighted
/// coordinates: F·f = |F|² and vᵀMv = |v|² there.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Norms {
    /// F·v.
    power: f64,
    /// F·f.
    force2: f64,
    pub max_force: f64,
    pub max_velocity: f64,
    pub max_acceleration: f64,
}

/// What it knows between two steps, besides the velocities.
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct Memory {
    dt: f64,
    alpha: f64,
    /// Steps since the power was last negative.
    uphill_free: u64,
    /// vᵀMv, followed from step to step by what the power and the forces say about it; M turns with the particles, but slowly.
    velocity2: f64,
    grids: [Grid; 2],
    report: Report,
}

impl Minimizer for Fire {
    fn advance<M: Model>(
        &self,
        system: &mut System<M>,
        goal: &Goal,
        memory: &mut Vec<u64>,
        iterations: u64,
    ) -> Result<Option<Minimized>, EngineError> {
        let largest_step = system.model.time_step();
        let cap = system.model.step_cap();
        let Memory { mut dt, mut alpha, mut uphill_free, mut velocity2, grids, mut report } = remembered(memory)
            .unwrap_or_else(|| {
                system.carry(1);
                Memory {
                    dt: STEP_START * largest_step,
                    alpha: ALPHA_START,
                    uphill_free: 0,
                    velocity2: 0.0,
                    grids: FusedSums::default().grids,
                    report: Report::default(),
                }
            });
        let mut sums = FusedSums { grids };
        let until = report.iterations.saturating_add(iterations);
        loop {
            if report.iterations >= until {
                system.tell(report.max_force);
                *memory = memory_of(&Memory { dt, alpha, uphill_free, velocity2, grids: sums.grids, report });
                return Ok(None);
            }
            let norms = measure(system, &mut sums)?;
            if let Some(end) = report.count(system, goal, norms.max_force)? {
                return Ok(Some(end));
            }

            let downhill = norms.power > 0.0 || velocity2 == 0.0;
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
            // v ← (1 − α)(v + dt f) + α |v + dt f| f/|f|, or dt f after a turn
            let (mut keep, mut push) = if downhill {
                let speed2 = velocity2 + dt * (2.0 * norms.power + dt * norms.force2);
                (1.0 - alpha, (1.0 - alpha) * dt + alpha * (speed2.max(0.0) / norms.force2).sqrt())
            } else {
                (0.0, dt)
            };
            let fastest = keep * norms.max_velocity + push * norms.max_acceleration;
            let slowed = (cap / (dt * fastest)).min(1.0);
            (keep, push) = (slowed * keep, slowed * push);
            velocity2 = keep * (keep * velocity2 + 2.0 * push * norms.power) + push * push * norms.force2;
            let bound = dt * slowed * fastest + step_back * norms.max_velocity;
            system.move_points(bound * (1.0 + 1e-9), |pbox, positions, velocities, forces| {
                lanes::run(Step { pbox, keep, push, dt, step_back, positions, velocities, forces });
            });
        }
    }
}

/// The step of a run of points: v ← keep v + push f, x ← x + dt v − step_back (v before).
pub(super) struct Step<'a> {
    pub pbox: &'a PeriodicBox,
    pub keep: f64,
    pub push: f64,
    pub dt: f64,
    pub step_back: f64,
    pub positions: &'a mut [Frac],
    pub velocities: &'a mut [Vec2],
    pub forces: &'a [Vec2],
}

impl Kernel for Step<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self, _: impl Lanes) {
        let Step { pbox, keep, push, dt, step_back, positions, velocities, forces } = self;
        for ((position, velocity), force) in positions.iter_mut().zip(velocities).zip(forces) {
            let back = *velocity;
            let v: Vec2 = [keep * back[0] + push * force[0], keep * back[1] + push * force[1]];
            *velocity = v;
            let step = [dt * v[0] - step_back * back[0], dt * v[1] - step_back * back[1]];
            *position = pbox.moved(*position, step);
        }
    }
}

/// What a run of points adds to the sums and maxima of a step.
struct Partial<'a> {
    grids: &'a [Grid; 2],
    forces: &'a [Vec2],
    accelerations: &'a [Vec2],
    velocities: &'a [Vec2],
}

impl Kernel for Partial<'_> {
    type Output = Totals<2>;

    #[inline(always)]
    fn run(self, _: impl Lanes) -> Totals<2> {
        let mut totals = Totals::default();
        for ((&f, &g), &v) in self.forces.iter().zip(self.accelerations).zip(self.velocities) {
            totals.add(self.grids, [dot(f, v), dot(f, g)], [dot(f, f), dot(v, v), dot(g, g)]);
        }
        totals
    }
}

/// Forces at the present positions, and the norms of the step: one fused reduction, repeated only when forces or
/// velocities have outgrown the grids of the sums.
pub(super) fn measure<M: Model>(system: &mut System<M>, fused: &mut FusedSums<2>) -> Result<Norms, EngineError> {
    let partial = |grids: &[Grid; 2], forces: &[Vec2], accelerations: &[Vec2], velocities: &[Vec2]| {
        // the compiler sees that these are the same, and reads them once
        let accelerations = if M::BODIES { accelerations } else { forces };
        lanes::run(Partial { grids, forces, accelerations, velocities })
    };
    let grids = fused.grids;
    let mut totals = system
        .evaluate(
            |chunk, particles, forces, accelerations| {
                partial(&grids, forces, accelerations, &particles.carried[0][chunk.points.clone()])
            },
            Totals::merged,
        )?
        .unwrap_or_default();
    loop {
        system.comm.combine(&mut totals);
        if let Some(Sums { sum: [power, force2], extremes }) = fused.settle(&totals) {
            let [max_force, max_velocity, max_acceleration] = extremes.map(f64::sqrt);
            return Ok(Norms { power, force2, max_force, max_velocity, max_acceleration });
        }
        let velocities = &system.particles().carried[0];
        totals = partial(&fused.grids, system.forces(), system.accelerations(), velocities);
    }
}
