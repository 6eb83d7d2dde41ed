mod past;
mod steps;

use super::{ConjugateGradient, Fire, Goal, HeavyBall, Minimized, Minimizer, Report, check_not_runaway};
use crate::engine::{EngineError, System};
use crate::model::{Model, Prestress};
use crate::stiffness::Cholesky;
use past::Past;

/// Newton's method with a sparse factor of the Hessian, led to the minimum through softer contacts.
///
/// Hard contacts between soft outlines are what makes deformable particles slow to relax: the stiffest modes are up to
/// 10⁶ times as stiff as the softest, and where a contact opens or closes a long step along the soft ones excites the
/// stiff. So contacts are first made softer by [`SOFTEST`], which leaves shapes and positions nearly as they are;
/// FIRE then relaxes in a thousand steps or so what takes hundreds of thousands with hard contacts. From there the
/// minimum is followed while contacts harden, [`HARDER`] times at once, each time by some Newton steps, in which the
/// contact forces of the level before are kept at first (pre-stress). Where they lead nowhere FIRE and conjugate gradients
/// go on: they are quick where little is left to move. After a small change of a relaxed state Newton steps at full
/// stiffness are tried first: they follow the minimum of before. Goals that FIRE reaches soon need no factor at all, so
/// that systems too large for one can be relaxed to them.
///
/// Outlines that press on each other sink into each other when their contacts are much softer than their shapes, and end
/// in another minimum, from where the way back is long. So contacts that are not much stiffer than shapes are made only
/// so soft that they overlap by a small part of their width.
///
/// Disks have nothing but contacts: conjugate gradients until they press on each other, then Newton steps.
///
/// Turns end between iterations of FIRE and conjugate gradients, and after Newton steps towards one level, which are made
/// in one with what conjugate gradients do between them.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Newton;

/// The softest contacts, as a part of their stiffness: the stiffest modes are then those of the areas, which FIRE slows
/// down (`Model::accelerate`).
const SOFTEST: f64 = 1e-3;
/// With mild contacts their stiffest modes are this part of those of shapes. Where [`SOFTEST`] is more than ten times
/// softer, so many iterations at most tell how strongly outlines press on each other.
const MILD: f64 = 0.5;
const MILDLY: u64 = 10_000;
/// Near the onset contacts are so soft that they overlap by this part of [`Model::step_cap`], but no softer than
/// [`GENTLEST`]: there they are about as stiff as the softest shapes.
const GENTLE: f64 = 2e-3;
const GENTLEST: f64 = 1e-6;
/// Contacts harden by this factor at once; near the onset by its root where Newton steps do not follow, and so on down to
/// the other.
const HARDER: f64 = 10.0;
const HARDER_LEAST: f64 = 1.5;
/// max|F| of intermediate levels, and that to which FIRE or conjugate gradients go before Newton's method is tried and
/// where it has failed on the way, in the unit of [`Model::force_unit`].
const ON_THE_WAY: f64 = 1e-6;
const ROUGH: f64 = 1e-4;
/// Contacts harden when forces are balanced to this part of the pressure: below the onset, where nothing touches at the
/// minimum, soft contacts vanish quickly, and hard ones bounce.
const BALANCED: f64 = 1e-4;
/// Forces of shapes are rounded to a tenth of this, in the same unit, or in this part of their stiffness if that is more.
const ROUNDED: f64 = 1e-12;
const STIFF: f64 = 5e-4;
/// Particles press on each other where forces are balanced to this part of the pressure: disks are brought to their minimum
/// by Newton's method from there. Just below the onset they never are: overlaps vanish slowly there, and forces with them.
const PRESSED: f64 = 1e-2;
/// Polygons are relaxed by FIRE to this force, in the same unit; from there on its bounces off hard contacts cost more than
/// the line searches of conjugate gradients.
const FINE: f64 = 1e-5;
/// Either may come to nothing, conjugate gradients where outlines only just touch, FIRE where an edge has become so short
/// that its tension is stiffer than contacts: not more than so many iterations at once where Newton steps can go on. Where
/// contacts are softest FIRE needs more in larger boxes, as their length: in systems of more points than the other it gets
/// so many more.
const PATIENCE: u64 = 10_000;
const PATIENT_FROM: f64 = 1000.0;
/// In systems of so many points and more FIRE does not come to rest on hard contacts ([`HeavyBall`]).
const MANY: u64 = 100_000;
/// Largest overlap of contacts, over [`Model::step_cap`], that forces may tell of for a change to count as small.
const SMALL: f64 = 0.1;

impl Minimizer for Newton {
    fn advance<M: Model>(
        &self,
        system: &mut System<M>,
        goal: &Goal,
        memory: &mut Vec<u64>,
        iterations: u64,
    ) -> Result<Option<Minimized>, EngineError> {
        let (past, inner) = Past::remembered(memory);
        let mut search = Search {
            goal,
            unit: system.model.force_unit(),
            stiffest: 0.0,
            is_gentle: false,
            is_hard: false,
            patience: (PATIENCE as f64 * (system.n_points() as f64 / PATIENT_FROM).sqrt().max(1.0)) as u64,
            cholesky: Cholesky::default(),
            report: Report::default(),
            past,
            inner,
            turn: iterations,
        };
        let outcome = match system.model.softened(1.0) {
            Some(full) => {
                let outcome = search.through_softer(system, &full);
                system.model = full;
                outcome
            }
            None => {
                search.stiffest = system.model.stiffest();
                search.settle(system, goal.force_tolerance)
            }
        };
        if let Err(EngineError::Interrupted) = outcome {
            // the turn is over, or its Newton steps are taken back
            *memory = search.past.memory(&search.inner);
            return Ok(None);
        }
        let converged = outcome?;
        let mut report = search.report;
        if !converged {
            report.max_force = system.max_force()?; // not that of softer contacts
        }
        Ok(Some(if converged { Minimized::Converged(report) } else { Minimized::Unconverged(report) }))
    }
}

struct Search<'a> {
    goal: &'a Goal,
    /// [`Model::force_unit`].
    unit: f64,
    /// Bound on the stiffest mode where contacts are softest.
    stiffest: f64,
    /// Whether contacts began softer than [`SOFTEST`], as near the onset.
    is_gentle: bool,
    /// Whether contacts have hardened to their full stiffness.
    is_hard: bool,
    /// See [`PATIENCE`].
    patience: u64,
    cholesky: Cholesky,
    report: Report,
    past: Past,
    /// Memory of the minimiser that was left.
    inner: Vec<u64>,
    /// Iterations of FIRE or conjugate gradients after which they are left; `u64::MAX` if the search is not to be left.
    turn: u64,
}

/// Where a turn ends, they answer [`EngineError::Interrupted`]. What moves particles or looks at them goes through
/// [`Search::once`].
impl Search<'_> {
    /// Relaxes with soft contacts, then hardens them; leaves the last model tried in the system.
    fn through_softer<M: Model>(&mut self, system: &mut System<M>, full: &M) -> Result<bool, EngineError> {
        let at = |level: f64| full.softened(level).expect("what was softened once can be again");
        let is_fine = self.is_fine();
        let small = SMALL * full.step_cap() * full.stiffest() / 4.0;
        self.stiffest = at(SOFTEST).stiffest();
        if is_fine && self.once(system, |search, system| search.forces(system))? <= small {
            // contact forces as they are after a change of the box say nothing of those at balance: no pre-stress
            if self.attempt(system, self.goal.force_tolerance, Prestress::NONE)? {
                return Ok(true);
            }
        }
        let mut level = self.soft_level(system, full, at)?;
        system.model = at(level);
        let on_the_way = self.goal.force_tolerance.max(ON_THE_WAY * self.unit);
        if !self.settle(system, on_the_way)? {
            return Ok(false);
        }
        let mut fine = on_the_way;
        if is_fine {
            let shapes = at(0.0).stiffest();
            match self.balance_softly(system, level, shapes)? {
                Some(tolerance) => fine = tolerance.clamp(self.goal.force_tolerance, on_the_way),
                None => return Ok(false),
            }
        }
        self.patience = PATIENCE;
        let mut harder = HARDER;
        while level < 1.0 {
            let next = (harder * level).min(1.0);
            let tolerance = if next == 1.0 { self.goal.force_tolerance } else { fine };
            system.model = at(next);
            self.is_hard = next == 1.0;
            if is_fine && self.attempt(system, tolerance, Prestress::part(level / next))? {
                harder = HARDER;
            } else if self.is_gentle && harder > HARDER_LEAST {
                harder = harder.sqrt();
                continue;
            } else {
                // away from the onset the next level brings shapes near to their minimum again
                let enough = if next == 1.0 || self.is_gentle { tolerance } else { tolerance.max(ROUGH * self.unit) };
                if !self.settle(system, enough)? {
                    return Ok(false);
                }
                harder = HARDER;
            }
            self.say(|| tracing::debug!(level = next, "contacts are harder"));
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
        let shapes = at(0.0).stiffest();
        let mild = MILD * (shapes / (4.0 * stiffness)).min(1.0);
        // what contacts push with that overlap by a step
        let deep = full.step_cap() * stiffness;
        if mild <= 10.0 * SOFTEST {
            if !self.is_fine() {
                return Ok(SOFTEST);
            }
            system.model = at(SOFTEST);
            let goal = self.goal_of(ROUGH * self.unit, self.patience);
            self.relax(system, &Fire, &goal)?;
            let level = (self.push(system)? / (GENTLE * deep)).clamp(GENTLEST, SOFTEST);
            self.is_gentle = level < SOFTEST;
            self.say(|| tracing::debug!(level, "stiff contacts"));
            return Ok(level);
        }
        system.model = at(mild);
        let goal = self.goal_of(self.goal.force_tolerance.max(SOFTEST * deep), MILDLY);
        self.relax(system, &Fire, &goal)?;
        let level = (self.push(system)? / deep).max(SOFTEST).min(mild); // also where both are 0
        self.say(|| tracing::debug!(level, mild, "soft contacts overlap little"));
        Ok(level)
    }

    /// Relaxes contacts that are softened to `level` until forces are balanced to a small part of what they push with, or
    /// to what is balance at full stiffness, too; to which force, or `None` if the iterations did not suffice.
    fn balance_softly<M: Model>(
        &mut self,
        system: &mut System<M>,
        level: f64,
        shapes: f64,
    ) -> Result<Option<f64>, EngineError> {
        let least = (level * self.goal.force_tolerance).max(ROUNDED * self.unit.max(STIFF * shapes));
        let mut tolerance = ON_THE_WAY * self.unit;
        while tolerance > least {
            let push = self.push(system)?;
            self.say(|| tracing::debug!(push, tolerance, "soft contacts"));
            if tolerance <= BALANCED * push {
                break;
            }
            tolerance = (0.01 * tolerance).max(least);
            if self.attempt(system, tolerance, Prestress::ALL)? {
                continue;
            }
            let goal = self.goal_of(tolerance, u64::MAX);
            if !self.rest(system, &goal)? && !self.settle(system, tolerance)? {
                return Ok(None);
            }
        }
        Ok(Some(tolerance))
    }

    /// What the pressure of contacts is on a particle, a force.
    fn push<M: Model>(&mut self, system: &mut System<M>) -> Result<f64, EngineError> {
        self.once(system, |_, system| Ok(system.energies()?.pressure() * system.spacing()))
    }

    /// What `act` came to: it is not done again when a search that was left comes to it once more.
    fn once<M: Model>(
        &mut self,
        system: &mut System<M>,
        act: impl FnOnce(&mut Self, &mut System<M>) -> Result<f64, EngineError>,
    ) -> Result<f64, EngineError> {
        if let Some((value, report)) = self.past.repeat() {
            self.report = report;
            return Ok(value);
        }
        let value = act(self, system)?;
        self.past.push(value, self.report);
        Ok(value)
    }

    /// The same for what succeeds or does not.
    fn succeeds<M: Model>(
        &mut self,
        system: &mut System<M>,
        act: impl FnOnce(&mut Self, &mut System<M>) -> Result<bool, EngineError>,
    ) -> Result<bool, EngineError> {
        Ok(self.once(system, |search, system| Ok(f64::from(act(search, system)?)))? == 1.0)
    }

    /// Says something once, too.
    fn say(&mut self, message: impl FnOnce()) {
        if self.past.repeat().is_none() {
            message();
            self.past.push(0.0, self.report);
        }
    }

    /// A goal on the way, with the iterations that are left, at most so many.
    fn goal_of(&self, force_tolerance: f64, max_iterations: u64) -> Goal {
        let left = self.goal.max_iterations.saturating_sub(self.report.iterations);
        Goal { force_tolerance, max_iterations: left.min(max_iterations) }
    }

    /// Whether factors of the Hessian are worth their cost.
    fn is_fine(&self) -> bool {
        self.goal.force_tolerance <= ROUGH * self.unit
    }

    /// By conjugate gradients or FIRE alone.
    fn rest<M: Model>(&mut self, system: &mut System<M>, goal: &Goal) -> Result<bool, EngineError> {
        if !M::BODIES {
            return self.relax(system, &ConjugateGradient, goal);
        }
        let patience = if self.is_fine() { self.patience } else { u64::MAX };
        let patient = |left: u64| Goal { max_iterations: left.min(patience), ..*goal };
        let mut left = goal.max_iterations;
        if goal.force_tolerance < FINE * self.unit {
            if self.relax(system, &ConjugateGradient, &patient(left))? {
                return Ok(true);
            }
            left -= patient(left).max_iterations;
        }
        if self.is_hard && system.n_points() >= MANY {
            return self.relax(system, &HeavyBall, &patient(left));
        }
        self.relax(system, &Fire, &patient(left))
    }

    fn relax<M: Model>(
        &mut self,
        system: &mut System<M>,
        minimizer: &impl Minimizer,
        goal: &Goal,
    ) -> Result<bool, EngineError> {
        self.succeeds(system, |search, system| {
            let mut memory = std::mem::take(&mut search.inner);
            let Some(minimized) = minimizer.advance(system, goal, &mut memory, search.turn)? else {
                search.inner = memory;
                return Err(EngineError::Interrupted);
            };
            let Report { iterations, max_force, .. } = *minimized.report();
            search.add(minimized.report());
            tracing::debug!(iterations, max_force, "relaxed roughly");
            Ok(minimized.is_converged())
        })
    }

    fn add(&mut self, report: &Report) {
        self.report.iterations += report.iterations;
        self.report.force_evaluations += report.force_evaluations;
        self.report.max_force = report.max_force;
    }

    /// Down to a minimum from wherever the system is; false when the iterations do not suffice.
    fn settle<M: Model>(&mut self, system: &mut System<M>, tolerance: f64) -> Result<bool, EngineError> {
        let mut rough = ROUGH * self.unit;
        let mut bends = false;
        loop {
            let goal = self.goal_of(rough.max(tolerance), u64::MAX);
            let is_rough = self.rest(system, &goal)?;
            if self.report.max_force <= tolerance {
                return Ok(true);
            }
            if self.report.iterations >= self.goal.max_iterations {
                return Ok(false);
            }
            // disks that do not press on each other yet are still on their way to other contacts
            let is_near = M::BODIES || self.report.max_force <= PRESSED * self.push(system)?;
            if is_near && self.steps(system, tolerance, Prestress::ALL, &[bends], false)? {
                return Ok(true);
            }
            bends = self.is_gentle && is_near && !bends;
            if is_rough {
                rough *= 0.1;
            }
        }
    }

    /// Newton steps, taken back when they do not go well; near the onset then tried again on ways that bend.
    fn attempt<M: Model>(
        &mut self,
        system: &mut System<M>,
        tolerance: f64,
        prestress: Prestress,
    ) -> Result<bool, EngineError> {
        let ways: &[bool] = if self.is_gentle { &[false, true] } else { &[false] };
        self.steps(system, tolerance, prestress, ways, true)
    }

    /// Newton steps on straight ways or those that bend, one kind after the other until one succeeds; taken back when they are
    /// to end before their time, and where they do not go well if `back` says so. A turn ends with them, as they take long.
    fn steps<M: Model>(
        &mut self,
        system: &mut System<M>,
        tolerance: f64,
        prestress: Prestress,
        bends: &[bool],
        back: bool,
    ) -> Result<bool, EngineError> {
        let is_new = self.past.is_over();
        let succeeded = self.succeeds(system, |search, system| {
            system.carry(0); // what travelled with the points has served
            let (pbox, before) = (*system.pbox(), system.own_particles());
            for &bends in bends {
                let outcome = search.newton(system, tolerance, prestress, bends);
                if let Ok(true) = outcome {
                    return Ok(true);
                }
                if back || outcome.is_err() {
                    system.restore(pbox, before.clone());
                }
                outcome?;
            }
            Ok(false)
        })?;
        if is_new && self.turn < u64::MAX { Err(EngineError::Interrupted) } else { Ok(succeeded) }
    }

    /// Largest force at the present positions.
    fn forces<M: Model>(&mut self, system: &mut System<M>) -> Result<f64, EngineError> {
        let max_force = system.max_force()?;
        self.report.force_evaluations += 1;
        self.report.max_force = max_force;
        check_not_runaway(system, max_force)?;
        Ok(max_force)
    }
}
