use super::fire::{Norms, Step, measure};
use super::{Goal, Minimized, Minimizer, Report, memory_of, remembered};
use crate::comm::{FusedSums, Grid};
use crate::engine::{EngineError, System};
use crate::lanes;
use crate::model::Model;
use bytemuck::{Pod, Zeroable};

/// Motion with friction (Polyak, USSR Comput. Math. Math. Phys. 4, 1 (1964)): v ← (1 − c)(v + dt f), x ← x + dt v. The friction
/// falls as 3/k over the steps k, as in Nesterov's method (Su, Boyd and Candès, J. Mach. Learn. Res. 17, 153 (2016)), to a
/// constant.
///
/// FIRE brakes all particles where its power F·v turns negative. In a system of very many that hardly happens: its sum over
/// all hides the few that go uphill, friction dies out, and points that bounce on hard contacts, which gain energy at FIRE's
/// largest time step (a step ends deep in a contact that its start did not feel), are never at rest. After a turn FIRE
/// puts a quarter of the speed of all along the forces, that is on the few places where these are large. Friction has no
/// part in either, and all it decides is local.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct HeavyBall;

/// Time step, over [`Model::time_step`]: with this, friction cools what bounces, with the whole it does not.
const STEP: f64 = 0.5;
const FRICTION_FALL: f64 = 3.0;
/// Least friction a step: what slides on is not slowed down much in the thousands of steps that it takes, and what bounces
/// is.
const FRICTION_LEAST: f64 = 0.003;

/// What it knows between two steps, besides the velocities.
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct Memory {
    grids: [Grid; 2],
    report: Report,
}

impl Minimizer for HeavyBall {
    fn advance<M: Model>(
        &self,
        system: &mut System<M>,
        goal: &Goal,
        memory: &mut Vec<u64>,
        iterations: u64,
    ) -> Result<Option<Minimized>, EngineError> {
        let dt = STEP * system.model.time_step();
        let cap = system.model.step_cap();
        let Memory { grids, mut report } = remembered(memory).unwrap_or_else(|| {
            system.carry(1);
            Memory { grids: FusedSums::default().grids, report: Report::default() }
        });
        let mut sums = FusedSums { grids };
        let until = report.iterations.saturating_add(iterations);
        loop {
            if report.iterations >= until {
                system.tell(report.max_force);
                *memory = memory_of(&Memory { grids: sums.grids, report });
                return Ok(None);
            }
            let Norms { max_force, max_velocity, max_acceleration, .. } = measure(system, &mut sums)?;
            if let Some(end) = report.count(system, goal, max_force)? {
                return Ok(Some(end));
            }

            let friction = (FRICTION_FALL / (report.iterations as f64 + FRICTION_FALL)).max(FRICTION_LEAST);
            let fastest = (1.0 - friction) * (max_velocity + dt * max_acceleration);
            let slowed = (cap / (dt * fastest)).min(1.0);
            let keep = slowed * (1.0 - friction);
            let push = keep * dt;
            system.move_points(dt * slowed * fastest * (1.0 + 1e-9), |pbox, positions, velocities, forces| {
                lanes::run(Step { pbox, keep, push, dt, step_back: 0.0, positions, velocities, forces });
            });
        }
    }
}
