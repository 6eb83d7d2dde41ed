use super::{ConjugateGradient, Fire, Goal, Minimized, Minimizer, RUNAWAY, Report, TURN};
use crate::comm::FusedSums;
use crate::engine::{EngineError, System};
use crate::geometry::{Vec2, add, dot, norm};
use crate::model::Model;
use crate::stiffness::{Cholesky, Stiffness, sums};

/// Newton's method with a sparse factor of the Hessian, led to the minimum through softer contacts.
///
/// Hard contacts between soft outlines are what makes deformable particles slow to relax: the stiffest modes are up to
/// 10⁶ times as stiff as the softest, and where a contact opens or closes a long step along the soft ones excites the
/// stiff. So contacts are first made softer by [`SOFTEST`], which leaves shapes and positions nearly as they are;
/// FIRE then relaxes in a thousand steps or so what takes hundreds of thousands with hard contacts. From there the
/// minimum is followed while contacts harden, [`HARDER`] times at once, each time by some Newton steps, in which the
/// contact forces of the level before are kept at first (pre-stress). Where they lead nowhere, near the onset above all,
/// FIRE does it: it is quick where little is left to move. After a small change of a relaxed state Newton steps at full
/// stiffness are tried first: they follow the minimum of before. Goals that FIRE reaches soon need no factor at all, so
/// that systems too large for one can be relaxed to them.
///
/// Outlines that press on each other sink into each other when their contacts are much softer than their shapes, and end
/// in another minimum, from where the way back is long. So contacts that are not much stiffer than shapes are made only
/// so soft that they overlap by a small part of their width.
///
/// With the contacts at its start alone a step ends at the next outline, and near the onset hundreds of them lead nowhere.
/// Once that has been met with, steps minimise a quadratic form of the energy in which contacts push one way only: those
/// that open on the way are left out and those that close are put in, chosen again up to [`CHOICES`] times.
///
/// Disks have nothing but contacts: conjugate gradients until they press on each other, then Newton steps.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Newton;

/// The softest contacts, as a part of their stiffness: the stiffest modes are then those of the areas.
const SOFTEST: f64 = 1e-3;
/// With mild contacts their stiffest modes are this part of those of shapes. Where [`SOFTEST`] is more than ten times
/// softer, so many iterations at most tell how strongly outlines press on each other.
const MILD: f64 = 0.5;
const MILDLY: u64 = 10_000;
/// Contacts harden by this factor at once.
const HARDER: f64 = 10.0;
/// max|F| of intermediate levels, and that to which FIRE or conjugate gradients go before Newton's method is tried and
/// where it has failed on the way, in the unit of [`Model::force_unit`].
const ON_THE_WAY: f64 = 1e-6;
const ROUGH: f64 = 1e-4;
/// Contacts harden when forces are balanced to this part of the pressure: below the onset, where nothing touches at the
/// minimum, soft contacts vanish quickly, and hard ones bounce. Not more iterations than these are spent on it at once.
const BALANCED: f64 = 1e-4;
const BALANCING: u64 = 100_000;
/// Particles press on each other where forces are balanced to this part of the pressure: disks are brought to their minimum
/// by Newton's method from there. Just below the onset they never are: overlaps vanish slowly there, and forces with them.
const PRESSED: f64 = 1e-2;
/// Polygons are relaxed by FIRE to this force, in the same unit; from there on its bounces off hard contacts cost more than
/// the line searches of conjugate gradients.
const FINE: f64 = 1e-5;
/// Those may come to nothing where outlines only just touch: after so many of their iterations FIRE goes on.
const PATIENCE: u64 = 50_000;
/// Largest overlap of contacts, over [`Model::step_cap`], that forces may tell of for a change to count as small.
const SMALL: f64 = 0.1;
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
/// Force evaluations on the way of one step.
const TRIALS: u32 = 12;

impl Minimizer for Newton {
    fn minimize<M: Model>(&self, system: &mut System<M>, goal: &Goal) -> Result<Minimized, EngineError> {
        let unit = system.model.force_unit();
        let mut search = Search { goal, unit, stiffest: 0.0, cholesky: Cholesky::default(), report: Report::default() };
        let converged = match system.model.softened(1.0) {
            Some(full) => {
                let outcome = search.through_softer(system, &full);
                system.model = full;
                outcome?
            }
            None => {
                search.stiffest = system.model.time_step().powi(-2);
                search.settle(system, goal.force_tolerance)?
            }
        };
        let report = search.report;
        Ok(if converged { Minimized::Converged(report) } else { Minimized::Unconverged(report) })
    }
}

struct Search<'a> {
    goal: &'a Goal,
    /// [`Model::force_unit`].
    unit: f64,
    /// Bound on the stiffest mode where contacts are softest.
    stiffest: f64,
    cholesky: Cholesky,
    report: Report,
}

impl Search<'_> {
    /// Relaxes with soft contacts, then hardens them; leaves the last model tried in the system.
    fn through_softer<M: Model>(&mut self, system: &mut System<M>, full: &M) -> Result<bool, EngineError> {
        let at = |level: f64| full.softened(level).expect("what was softened once can be again");
        let is_fine = self.goal.force_tolerance <= ROUGH * self.unit;
        let small = SMALL * full.step_cap() / (4.0 * full.time_step().powi(2));
        self.stiffest = at(SOFTEST).time_step().powi(-2);
        if is_fine && self.forces(system)? <= small {
            // contact forces as they are after a change of the box say nothing of those at balance: no pre-stress
            if self.attempt(system, self.goal.force_tolerance, 0.0)? {
                return Ok(true);
            }
        }
        let mut level = self.soft_level(system, full, at)?;
        system.model = at(level);
        let on_the_way = self.goal.force_tolerance.max(ON_THE_WAY * self.unit);
        if !self.settle(system, on_the_way)? {
            return Ok(false);
        }
        if is_fine {
            self.balance_softly(system, level)?;
        }
        while level < 1.0 {
            let next = (HARDER * level).min(1.0);
            let tolerance = if next == 1.0 { self.goal.force_tolerance } else { on_the_way };
            system.model = at(next);
            if !is_fine || !self.attempt(system, tolerance, level / next)? {
                let enough = if next == 1.0 { tolerance } else { tolerance.max(ROUGH * self.unit) };
                if !self.settle(system, enough)? {
                    return Ok(false);
                }
            }
            tracing::debug!(level = next, "contacts are harder");
            level = next;
        }
        Ok(true)
    }

    /// How soft contacts are made first, as a part of their stiffness; leaves the system roughly relaxed with the mildest.
    fn soft_level<M: Model>(
        &mut self,
        system: &mut System<M>,
        full: &M,
        at: impl Fn(f64) -> M,
    ) -> Result<f64, EngineError> {
        let stiffness = full.contact_stiffness().unwrap_or_default();
        let shapes = at(0.0).time_step().powi(-2);
        let mild = MILD * (shapes / (4.0 * stiffness)).min(1.0);
        if mild <= 10.0 * SOFTEST {
            return Ok(SOFTEST);
        }
        system.model = at(mild);
        // what contacts push with that overlap by a step
        let deep = full.step_cap() * stiffness;
        let left = self.goal.max_iterations.saturating_sub(self.report.iterations);
        let goal =
            Goal { force_tolerance: self.goal.force_tolerance.max(SOFTEST * deep), max_iterations: left.min(MILDLY) };
        self.relax(system, &Fire, &goal)?;
        let level = (self.push(system)? / deep).max(SOFTEST).min(mild); // also where both are 0
        tracing::debug!(level, mild, "soft contacts overlap little");
        Ok(level)
    }

    /// Relaxes contacts that are softened to `level` until forces are balanced to a small part of what they push with, or
    /// to what is balance at full stiffness, too.
    fn balance_softly<M: Model>(&mut self, system: &mut System<M>, level: f64) -> Result<(), EngineError> {
        let least = level * self.goal.force_tolerance;
        let mut tolerance = ON_THE_WAY * self.unit;
        while tolerance > least {
            let push = self.push(system)?;
            tracing::debug!(push, tolerance, "soft contacts");
            if tolerance <= BALANCED * push {
                break;
            }
            tolerance = (0.01 * tolerance).max(least);
            if self.attempt(system, tolerance, 1.0)? {
                continue;
            }
            let left = self.goal.max_iterations.saturating_sub(self.report.iterations);
            if !self.rest(system, &Goal { force_tolerance: tolerance, max_iterations: left.min(BALANCING) })? {
                break;
            }
        }
        Ok(())
    }

    /// What the pressure of contacts is on a particle, a force.
    fn push<M: Model>(&self, system: &mut System<M>) -> Result<f64, EngineError> {
        Ok(system.energies()?.pressure() * system.spacing())
    }

    /// By FIRE or conjugate gradients alone.
    fn rest<M: Model>(&mut self, system: &mut System<M>, goal: &Goal) -> Result<bool, EngineError> {
        if !M::BODIES {
            return self.relax(system, &ConjugateGradient, goal);
        }
        let mut left = *goal;
        if goal.force_tolerance < FINE * self.unit {
            let patient = Goal { max_iterations: goal.max_iterations.min(PATIENCE), ..*goal };
            if self.relax(system, &ConjugateGradient, &patient)? {
                return Ok(true);
            }
            left.max_iterations -= patient.max_iterations;
        }
        self.relax(system, &Fire, &left)
    }

    fn relax<M: Model>(
        &mut self,
        system: &mut System<M>,
        minimizer: &impl Minimizer,
        goal: &Goal,
    ) -> Result<bool, EngineError> {
        let mut memory = Vec::new();
        let minimized = loop {
            if let Some(minimized) = minimizer.advance(system, goal, &mut memory, TURN)? {
                break minimized;
            }
            heed(system)?;
        };
        let Report { iterations, force_evaluations, max_force } = *minimized.report();
        self.report.iterations += iterations;
        self.report.force_evaluations += force_evaluations;
        self.report.max_force = max_force;
        tracing::debug!(iterations, max_force, "relaxed roughly");
        Ok(minimized.is_converged())
    }

    /// Down to a minimum from wherever the system is; false when the iterations do not suffice.
    fn settle<M: Model>(&mut self, system: &mut System<M>, tolerance: f64) -> Result<bool, EngineError> {
        let mut rough = ROUGH * self.unit;
        loop {
            let left = self.goal.max_iterations.saturating_sub(self.report.iterations);
            let goal = Goal { force_tolerance: rough.max(tolerance), max_iterations: left };
            if !self.rest(system, &goal)? {
                return Ok(false);
            }
            // disks that do not press on each other yet are still on their way to other contacts
            let is_near = M::BODIES || self.report.max_force <= PRESSED * self.push(system)?;
            if self.report.max_force <= tolerance || is_near && self.newton(system, tolerance, 1.0)? {
                return Ok(true);
            }
            rough *= 0.1;
        }
    }

    /// Newton steps, taken back when they do not go well.
    fn attempt<M: Model>(
        &mut self,
        system: &mut System<M>,
        tolerance: f64,
        prestress: f64,
    ) -> Result<bool, EngineError> {
        let (pbox, before) = (*system.pbox(), system.own_particles());
        let is_reached = self.newton(system, tolerance, prestress)?;
        if !is_reached {
            system.restore(pbox, before);
        }
        Ok(is_reached)
    }

    /// Newton steps until no force is above `tolerance`; false when that does not go well. The first step takes
    /// `prestress` times the present contact forces for what they contribute to the Hessian.
    fn newton<M: Model>(
        &mut self,
        system: &mut System<M>,
        tolerance: f64,
        mut prestress: f64,
    ) -> Result<bool, EngineError> {
        let cap = LONGEST * system.model.step_cap();
        let least = SHIFT_LEAST * self.stiffest;
        let mut shift = least;
        let mut looks_ahead = false;
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
            heed(system)?;
            if looks_ahead && system.prepare_for_reach()? {
                self.forces(system)?;
            }
            let form = (Stiffness::of(system, prestress)?, vec![[0.0; 2]; system.forces().len()]);
            let Some(mut step) = self.direction(system, &form, &mut shift, cap) else {
                return Ok(false);
            };
            if looks_ahead {
                step = self.ahead(system, form, step, prestress, &mut shift, cap);
            }
            prestress = 1.0;
            let longest = step.1;
            let (length, last) = self.along(system, step, cap, tolerance)?;
            tracing::trace!(shift, longest, length, max_force = last, "Newton step");
            if length > BLOCKED {
                shift = (SHIFT_FALL * shift).max(least);
            } else {
                looks_ahead = M::BODIES;
            }
            max_force = last;
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
        prestress: f64,
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
            let Some(better) = self.direction(system, &form, shift, cap) else { break };
            step = better;
        }
        if slope(system, &step.0) > 0.0 { step } else { plain }
    }

    /// The minimum of a quadratic form of the energy, given by its Hessian and what its forces differ from the present
    /// ones, with the smallest shift from `shift` on that keeps the step short; and the longest displacement in it.
    fn direction<M: Model>(
        &mut self,
        system: &System<M>,
        (stiffness, changes): &(Stiffness, Vec<Vec2>),
        shift: &mut f64,
        cap: f64,
    ) -> Option<(Vec<Vec2>, f64)> {
        self.cholesky.load(system, stiffness);
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

    /// Moves the points along their directions, the longest of which is `longest`, to where the slope has fallen
    /// enough; how far, in units of the directions, and the largest force there.
    fn along<M: Model>(
        &mut self,
        system: &mut System<M>,
        (direction, longest): (Vec<Vec2>, f64),
        cap: f64,
        tolerance: f64,
    ) -> Result<(f64, f64), EngineError> {
        system.carry_these(direction);
        let first = slope(system, &system.particles().carried[0]);
        let mut here = 0.0f64;
        let mut next = (cap / longest).min(1.0);
        let (mut before, mut beyond) = ((0.0, first), None);
        for trial in 1.. {
            let by = next - here;
            system.move_points(by.abs() * longest * (1.0 + 1e-9), |pbox, positions, directions, _| {
                for (position, d) in positions.iter_mut().zip(directions) {
                    *position = pbox.moved(*position, [by * d[0], by * d[1]]);
                }
            });
            here = next;
            let max_force = self.forces(system)?;
            let now = slope(system, &system.particles().carried[0]);
            if max_force <= tolerance || now.abs() <= SLOPE * first || trial == TRIALS {
                return Ok((here, max_force));
            }
            if now < 0.0 {
                beyond = Some((here, now));
            } else {
                before = (here, now);
            }
            let Some((end, end_slope)) = beyond else { return Ok((here, max_force)) };
            // the secant's zero, well inside
            let (start, start_slope) = before;
            let zero = start + (end - start) * start_slope / (start_slope - end_slope);
            let margin = 0.1 * (end - start);
            next = zero.clamp(start + margin, end - margin);
        }
        unreachable!("trials are limited")
    }

    /// Largest force at the present positions.
    fn forces<M: Model>(&mut self, system: &mut System<M>) -> Result<f64, EngineError> {
        let max_force = system.max_force()?;
        self.report.force_evaluations += 1;
        self.report.max_force = max_force;
        if max_force.is_nan() || max_force >= RUNAWAY {
            let particle = system.offender(RUNAWAY).unwrap_or_default();
            return Err(EngineError::Runaway { particle });
        }
        Ok(max_force)
    }
}

/// Nothing of a minimisation is kept that ends before its time.
fn heed<M: Model>(system: &System<M>) -> Result<(), EngineError> {
    if system.is_to_end() { Err(EngineError::Interrupted) } else { Ok(()) }
}

/// −dU/dt of own points that move by `directions` t.
fn slope<M: Model>(system: &System<M>, directions: &[Vec2]) -> f64 {
    let forces = system.forces();
    let [slope] = sums(system, &mut FusedSums::default(), |i| [dot(forces[i], directions[i])]);
    slope
}
