use super::{ROUGH, Search};
use crate::comm::FusedSums;
use crate::engine::{EngineError, System};
use crate::geometry::{Vec2, add, dot, norm, scale, sub};
use crate::minimize::{ConjugateGradient, Minimizer};
use crate::model::{Model, Prestress};
use crate::stiffness::{Stiffness, sums};

/// Newton steps after which a level counts as not reached.
const STEPS: u32 = 60;
/// A step that ends before this part of it has met with something that its quadratic form does not know: from then on the
/// contacts of each step are chosen again, so many times at most.
const BLOCKED: f64 = 0.3;
const CHOICES: u32 = 8;
/// Factors that are tried for one step.
const SHIFTS: u32 = 40;
/// Shifts of the Hessian over the stiffest mode of the softest level: the smallest, below all that matters and above
/// rounding, so that free motions of rattlers have a factor too, and the first where the Hessian is not positive.
const SHIFT_LEAST: f64 = 1e-11;
const SHIFT_FIRST: f64 = 1e-5;
/// A shift that was needed falls by this factor from step to step, one that was too small rises by the other.
const SHIFT_FALL: f64 = 0.1;
const SHIFT_RISE: f64 = 4.0;
/// Longest step of a point over [`Model::step_cap`]; a longer solution is shortened to it, one that is too long by
/// more than this factor again is replaced by one with a larger shift.
const LONGEST: f64 = 3.0;
/// A step ends where the slope has fallen to this part of its first value, or the full step still goes down.
const SLOPE: f64 = 0.5;
/// The way of a step ends as far from its straight line as this part of its length at most: it is shortened to that where
/// it would turn by more, up to the other; what turns by yet more is no curve but new contacts, and the bend is shortened.
const BEND: f64 = 1.0;
const CURVED: f64 = 30.0;
/// Force evaluations on the way of one step, besides those for its bend.
const TRIALS: u32 = 12;
/// Iterations of conjugate gradients after a step that leaves rough forces, in systems of more points than the other.
const SMOOTHING: u64 = 150;
const SMALL_SYSTEM: u64 = 2000;

/// Newton steps with a shifted Hessian (Levenberg, Marquardt) and a line search along a way that bends.
///
/// With the contacts at its start alone a step ends at the next outline, and near the onset hundreds of them lead nowhere.
/// Once that has been met with, steps minimise a quadratic form of the energy in which contacts push one way only: those
/// that open on the way are left out and those that close are put in, chosen again up to [`CHOICES`] times.
///
/// Where the Hessian is not positive, some pair of particles is about to roll off each other, and a shift that holds that
/// holds back the soft motions of all the others. Large systems, which have such a pair more often than not, leave out what
/// lets vertices on vertices buckle first, and shift only what is not positive then either. Small ones gain nothing.
///
/// One step is for the whole system: it ends where the worst of its contacts is. What such places are
/// left with is stiff and local, and gone after some conjugate gradients: with them steps are fewer in large systems. Small
/// ones gain nothing, nor do contacts that are softer yet, near the onset.
///
/// Particles that roll on each other, the softest motions, move on curves, and a straight step of length s pushes stiff
/// contacts and areas by s² times the curvature: it ends where that costs more than the soft motion gains. So the way
/// bends back to where these are at rest: x + t d + t² c, with c from the same factor. Only near the onset, and only where
/// straight steps have led nowhere: they come to the minimum in half the time where they do.
impl Search<'_> {
    /// Newton steps until no force is above `tolerance`; false when that does not go well. The first step takes
    /// `prestress` of the present contact forces for what they contribute to the Hessian. Steps that bend come later to the
    /// minimum than straight ones, where those do.
    pub(super) fn newton<M: Model>(
        &mut self,
        system: &mut System<M>,
        tolerance: f64,
        mut prestress: Prestress,
        bends: bool,
    ) -> Result<bool, EngineError> {
        let cap = LONGEST * system.model.step_cap();
        let least = SHIFT_LEAST * self.stiffest;
        let mut shift = least;
        let mut looks_ahead = false;
        let is_large = M::BODIES && system.n_points() > SMALL_SYSTEM;
        let mut max_force = self.forces(system)?;
        for _ in 0..STEPS {
            if max_force <= tolerance {
                return Ok(true);
            }
            if self.report.iterations >= self.goal.max_iterations {
                return Ok(false);
            }
            self.report.iterations += 1;
            system.tell(max_force);
            if system.is_to_end() {
                return Err(EngineError::Interrupted);
            }
            if looks_ahead && system.prepare_for_reach()? {
                system.max_force()?; // not counted: when lists are made must not be seen in a report
            }
            let mut form = (Stiffness::of(system, prestress)?, vec![[0.0; 2]; system.forces().len()]);
            self.cholesky.load(system, &form.0);
            if is_large && prestress.buckling > 0.0 && !self.cholesky.factorize(&system.comm, least) {
                prestress = prestress.braced();
                form.0 = Stiffness::of(system, prestress)?;
                self.cholesky.load(system, &form.0);
            }
            let Some(mut step) = self.direction(system, &form.1, &mut shift, cap) else {
                return Ok(false);
            };
            if looks_ahead {
                step = self.ahead(system, form, step, prestress, &mut shift, cap);
            }
            let mut way = self.set_out(system, step, shift, cap, bends.then_some(tolerance))?;
            prestress = Prestress::ALL;
            max_force = self.along(system, &mut way, tolerance)?;
            let Way { longest, turn, here, .. } = way;
            tracing::trace!(shift, longest, turn, length = here, max_force, "Newton step");
            if way.is_curved() {
                shift = shift.max(way.curvature);
            } else if here > BLOCKED {
                shift = (SHIFT_FALL * shift).max(least);
            } else {
                looks_ahead = M::BODIES;
                shift *= if self.is_gentle { SHIFT_RISE } else { 1.0 };
            }
            let rough = tolerance.max(ROUGH * self.unit);
            if is_large && !self.is_gentle && max_force > rough {
                let goal = self.goal_of(rough, SMOOTHING);
                self.add(ConjugateGradient.minimize(system, &goal)?.report());
                max_force = self.report.max_force;
            }
        }
        Ok(max_force <= tolerance)
    }

    /// The step with the contacts that it opens and closes, from `form` and `plain`, that with the present ones; `plain` if
    /// contacts do not settle and it leads uphill, as only the minimum of a form is sure not to.
    fn ahead<M: Model>(
        &mut self,
        system: &mut System<M>,
        mut form: (Stiffness, Vec<Vec2>),
        plain: (Vec<Vec2>, f64),
        prestress: Prestress,
        shift: &mut f64,
        cap: f64,
    ) -> (Vec<Vec2>, f64) {
        let mut step = plain.clone();
        for _ in 0..CHOICES {
            let next = Stiffness::ahead(system, prestress, &step.0);
            if !system.comm.any(next != form) {
                return step;
            }
            form = next;
            self.cholesky.load(system, &form.0);
            let Some(better) = self.direction(system, &form.1, shift, cap) else { break };
            step = better;
        }
        if slope(system, |i| step.0[i]) > 0.0 { step } else { plain }
    }

    /// The minimum of a quadratic form of the energy, with the Hessian that was loaded and forces that differ by `changes`
    /// from the present ones, with the smallest shift from `shift` on that keeps the step short; and the longest
    /// displacement in it.
    fn direction<M: Model>(
        &mut self,
        system: &System<M>,
        changes: &[Vec2],
        shift: &mut f64,
        cap: f64,
    ) -> Option<(Vec<Vec2>, f64)> {
        let least = SHIFT_LEAST * self.stiffest;
        for _ in 0..SHIFTS {
            if self.cholesky.factorize(&system.comm, *shift) {
                let forces: Vec<Vec2> = system.forces().iter().zip(changes).map(|(&f, &c)| add(f, c)).collect();
                let direction = self.cholesky.solve(system, &forces);
                let longest = system.comm.max(direction.iter().map(|&v| norm(v)).fold(0.0, f64::max));
                if longest <= LONGEST * cap {
                    return Some((direction, longest));
                }
                *shift *= (longest / cap).min(30.0);
            } else {
                // bodies need a shift often, and one that is too long hides their soft modes
                let first = if M::BODIES && *shift > least { 0.0 } else { SHIFT_FIRST * self.stiffest };
                *shift = (SHIFT_RISE * *shift).max(first);
            }
        }
        None
    }

    /// Moves the points along their directions, the longest of which is given, to the first trial of the way. It bends if
    /// some force is above `straight_enough` before, where that is given.
    fn set_out<M: Model>(
        &mut self,
        system: &mut System<M>,
        (direction, longest): (Vec<Vec2>, f64),
        shift: f64,
        cap: f64,
        straight_enough: Option<f64>,
    ) -> Result<Way, EngineError> {
        let forces = system.forces();
        let terms = |i: usize| [dot(forces[i], direction[i]), dot(direction[i], direction[i])];
        let [slope, square] = sums(system, &mut FusedSums::default(), terms);
        let forces = forces.to_vec();
        system.carry_these(vec![direction, forces]);
        let curvature = slope / square;
        let mut way = Way { here: 0.0, slope, curvature, longest, bent: 0.0, farthest_bend: 0.0, turn: 0.0 };
        way.go(system, (cap / longest).min(1.0));
        let straight = self.forces(system)?;
        if straight_enough.is_some_and(|tolerance| straight > tolerance) {
            self.bend(system, &mut way, shift);
            let nearly_straight = if way.is_curved() { BEND / way.turn } else { 1.0 };
            way.go(system, nearly_straight * way.here);
            if self.forces(system)? > straight {
                way.unbend(system);
                self.forces(system)?;
            }
        }
        Ok(way)
    }

    /// From the first trial of a way to where the slope has fallen enough, or the full step still goes down; the largest
    /// force there.
    fn along<M: Model>(&mut self, system: &mut System<M>, way: &mut Way, tolerance: f64) -> Result<f64, EngineError> {
        let mut max_force = self.report.max_force;
        let (mut before, mut beyond) = ((0.0, way.slope), None::<(f64, f64)>);
        for _ in 1..TRIALS {
            let (here, now) = (way.here, way.slope_here(system));
            if max_force <= tolerance || now.abs() <= SLOPE * way.slope {
                break;
            }
            // near the onset slopes jump, and the secant creeps: the slope at an end that stays is halved (Illinois)
            let stays = if self.is_gentle { 0.5 } else { 1.0 };
            if now < 0.0 {
                before.1 *= if beyond.is_some() { stays } else { 1.0 };
                beyond = Some((here, now));
            } else {
                beyond = beyond.map(|(end, slope)| (end, if before.0 > 0.0 { stays * slope } else { slope }));
                before = (here, now);
            }
            let (Some((end, end_slope)), (start, start_slope)) = (beyond, before) else { break };
            // the secant's zero, well inside
            let zero = start + (end - start) * start_slope / (start_slope - end_slope);
            let margin = 0.1 * (end - start);
            way.go(system, zero.clamp(start + margin, end - margin));
            max_force = self.forces(system)?;
        }
        Ok(max_force)
    }

    /// Takes c, the bend of a straight way up to here, for the second vectors of the points, which hold the forces at its
    /// start. At t d a quadratic form of the energy leaves the forces F(0) − t H d, with (H + shift) d = F(0); t² c is what
    /// the same factor answers to the others.
    fn bend<M: Model>(&mut self, system: &mut System<M>, way: &mut Way, shift: f64) {
        let t = way.here;
        let carried = &system.particles().carried;
        let others = |((&force, &d), &before): ((&Vec2, &Vec2), &Vec2)| {
            sub(force, add(scale(1.0 - t, before), scale(t * shift, d)))
        };
        let others: Vec<Vec2> = system.forces().iter().zip(&carried[0]).zip(&carried[1]).map(others).collect();
        let mut bends = self.cholesky.solve(system, &others);
        bends.resize(others.len(), [0.0; 2]); // there may be no factor any more
        let farthest = system.comm.max(bends.iter().map(|&c| norm(c)).fold(0.0, f64::max));
        way.turn = farthest / (t * way.longest);
        // contacts that were made on the way answer with more than a bend
        let part = if way.turn > CURVED { BEND / way.turn } else { 1.0 };
        bends.iter_mut().for_each(|c| *c = scale(part / (t * t), *c));
        way.farthest_bend = part * farthest / (t * t);
        let directions = carried[0].clone();
        system.carry_these(vec![directions, bends]);
    }
}

/// The way x + t d + t² c, with d and c the first and second vectors of the points.
struct Way {
    /// t.
    here: f64,
    /// −dU/dt at its start, and that over Σ d², the curvature of the energy with the shift.
    slope: f64,
    curvature: f64,
    /// Longest of the d.
    longest: f64,
    /// t² as far as the points have moved by it.
    bent: f64,
    /// Longest of the c, 0 as long as there are none.
    farthest_bend: f64,
    /// How far the full step would end from its straight line, over its length.
    turn: f64,
}

impl Way {
    fn go<M: Model>(&mut self, system: &mut System<M>, to: f64) {
        let along = to - self.here;
        let aside = if self.farthest_bend > 0.0 { to * to - self.bent } else { 0.0 };
        (self.here, self.bent) = (to, self.bent + aside);
        self.step(system, along, aside);
    }

    fn step<M: Model>(&self, system: &mut System<M>, along: f64, aside: f64) {
        let bound = along.abs() * self.longest + aside.abs() * self.farthest_bend;
        system.move_points_keeping(bound * (1.0 + 1e-9), |pbox, positions, directions, bends, _| {
            for ((position, d), c) in positions.iter_mut().zip(directions).zip(bends) {
                *position = pbox.moved(*position, add(scale(along, *d), scale(aside, *c)));
            }
        });
    }

    /// Whether it turns by more than it may at its full length, on a curve that a shorter one follows.
    fn is_curved(&self) -> bool {
        self.turn > BEND && self.turn <= CURVED
    }

    /// Back to the straight way.
    fn unbend<M: Model>(&mut self, system: &mut System<M>) {
        self.step(system, 0.0, -self.bent);
        (self.bent, self.farthest_bend) = (0.0, 0.0);
    }

    /// −dU/dt.
    fn slope_here<M: Model>(&self, system: &System<M>) -> f64 {
        let [directions, bends] = [0, 1].map(|k| &system.particles().carried[k]);
        let turn = if self.farthest_bend > 0.0 { 2.0 * self.here } else { 0.0 };
        slope(system, |i| add(directions[i], scale(turn, bends[i])))
    }
}

/// −dU/dt of own points that move by `directions` t.
fn slope<M: Model>(system: &System<M>, directions: impl Fn(usize) -> Vec2 + Sync) -> f64 {
    let forces = system.forces();
    let [slope] = sums(system, &mut FusedSums::default(), |i| [dot(forces[i], directions(i))]);
    slope
}
