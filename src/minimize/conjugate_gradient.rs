use super::{Goal, Minimized, Minimizer, Report, memory_of, remembered};
use crate::comm::{FusedSums, Grid, Sums, Totals};
use crate::engine::{EngineError, System};
use crate::geometry::{Frac, PeriodicBox, Vec2, dot};
use crate::lanes::{self, Kernel, Lanes};
use crate::model::Model;
use bytemuck::{Pod, Zeroable};

/// Nonlinear conjugate gradients after Polak and Ribière, β never negative (PR+: Nocedal and Wright, Numerical
/// Optimization, Eqs. 5.44 and 5.45), at little more than one force evaluation a step.
///
/// A line search would take a second one. But as long as no contact opens or closes the forces along a line are
/// almost linear: those at its start, g, and at the end of a trial step, F, tell where the slope vanishes, at
/// t = g·d/(g·d − F·d) of the trial step (the secant), and the forces there, g + t (F − g). That point is the base of
/// the next direction; it is passed on the way to the next trial point, not visited. Forces of the base are thus
/// interpolated, with an error that the next step multiplies by 1 − t, so that it dies out: only evaluated forces tell
/// whether the state is relaxed. Where t is far from 1 the same line is tried again at its zero.
///
/// One collective operation per evaluation: F·d, F·f and F·g are summed, all other products follow from them.
/// For particles of many points f are the forces over masses that differ (`Model::accelerate`), the preconditioner;
/// elsewhere f = F.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ConjugateGradient;

/// Zeros of the slope between these parts of a trial step are interpolated; others are gone to.
const NEAR: std::ops::RangeInclusive<f64> = 0.5..=2.0;
/// How often one line is tried again.
const TRIALS: u64 = 3;
/// A further trial is at least and at most so many times as long as the last.
const SHRINK: f64 = 0.1;
const GROW: f64 = 4.0;
/// A direction descends when its slope is more than this part of steepest descent's.
const LEAST_SLOPE: f64 = 1e-3;

/// The point that a line starts from: products of its forces g, with g·g short for that of forces and accelerations.
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
#[repr(C)]
struct Base {
    /// g·g.
    square: f64,
    /// g·d, not positive before the first step.
    slope: f64,
    /// Bound on any |g|.
    largest: f64,
}

/// What one step is decided by: forces F and accelerations f at the trial point.
#[derive(Clone, Copy, Debug)]
struct Trial {
    /// F·d.
    slope: f64,
    /// F·f.
    square: f64,
    /// F·g.
    overlap: f64,
    max_force: f64,
    max_acceleration: f64,
    max_direction: f64,
}

/// What it knows between two steps, besides the directions d and the forces g.
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct Memory {
    base: Base,
    /// Of the trial step, in units of d.
    length: f64,
    trials: u64,
    grids: [Grid; 3],
    report: Report,
}

impl Minimizer for ConjugateGradient {
    fn advance<M: Model>(
        &self,
        system: &mut System<M>,
        goal: &Goal,
        memory: &mut Vec<u64>,
        iterations: u64,
    ) -> Result<Option<Minimized>, EngineError> {
        // no point moves farther than twice this in one step: once along the old direction, once along the new
        let cap = 0.5 * system.model.step_cap();
        let Memory { mut base, mut length, mut trials, grids, mut report } = remembered(memory).unwrap_or_else(|| {
            system.carry(2);
            Memory {
                base: Base::default(),
                // the step of steepest descent that is stable for the stiffest mode
                length: system.model.time_step().powi(2),
                trials: 0,
                grids: FusedSums::default().grids,
                report: Report::default(),
            }
        });
        let mut sums = FusedSums { grids };
        let until = report.iterations.saturating_add(iterations);
        loop {
            if report.iterations >= until {
                system.tell(report.max_force);
                *memory = memory_of(&Memory { base, length, trials, grids: sums.grids, report });
                return Ok(None);
            }
            let trial = measure(system, &mut sums)?;
            if let Some(end) = report.count(system, goal, trial.max_force)? {
                return Ok(Some(end));
            }

            // where the slope vanishes, in trial steps
            let zero = match base.slope - trial.slope {
                _ if base.slope <= 0.0 => 1.0,
                fall if fall > 0.0 => base.slope / fall,
                _ => f64::INFINITY,
            };
            let longest = (cap / trial.max_direction).max(length);
            if !NEAR.contains(&zero) && trials < TRIALS && (zero < 1.0 || length < longest) {
                trials += 1;
                let further = (length * zero.clamp(SHRINK, GROW)).min(longest) - length;
                length += further;
                let bound = further.abs() * trial.max_direction;
                system.move_points_keeping(bound * (1.0 + 1e-9), |pbox, positions, directions, _, _| {
                    lanes::run(Further { pbox, further, positions, directions })
                });
                continue;
            }
            trials = 0;
            // the new base lies at t; elsewhere than near its end the line is not known well enough, and t = 1
            let t = if NEAR.contains(&zero) { zero } else { 1.0 };
            let s = 1.0 - t;
            let along = s * base.slope + t * trial.slope;
            let overlap = s * base.square + t * trial.overlap;
            let square = (s * (overlap + t * trial.overlap) + t * t * trial.square).max(0.0);
            let mut beta = if base.slope > 0.0 { ((square - overlap) / base.square).max(0.0) } else { 0.0 };
            let descends = square + beta * along > LEAST_SLOPE * square;
            if !descends {
                beta = 0.0;
            }
            let largest = s.abs() * base.largest + t * trial.max_acceleration;
            base = Base { square, slope: square + beta * along, largest };

            let back = -s * length;
            let max_direction = largest + beta * trial.max_direction;
            let bound = back.abs() * trial.max_direction;
            length = (t * length).min(cap / max_direction);
            system.move_points_keeping(
                (bound + length * max_direction) * (1.0 + 1e-9),
                |pbox, positions, directions, bases, forces| {
                    lanes::run(Step { pbox, s, t, beta, back, length, positions, directions, bases, forces });
                },
            );
        }
    }
}

/// Another trial along the same directions.
struct Further<'a> {
    pbox: &'a PeriodicBox,
    further: f64,
    positions: &'a mut [Frac],
    directions: &'a [Vec2],
}

impl Kernel for Further<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self, _: impl Lanes) {
        let Further { pbox, further, positions, directions } = self;
        for (position, d) in positions.iter_mut().zip(directions) {
            *position = pbox.moved(*position, [further * d[0], further * d[1]]);
        }
    }
}

/// The step of a run of points: g ← s g + t f, d ← g + beta d, and from the trial point back to the new base and on
/// along the new direction.
struct Step<'a> {
    pbox: &'a PeriodicBox,
    s: f64,
    t: f64,
    beta: f64,
    back: f64,
    length: f64,
    positions: &'a mut [Frac],
    directions: &'a mut [Vec2],
    bases: &'a mut [Vec2],
    forces: &'a [Vec2],
}

impl Kernel for Step<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self, _: impl Lanes) {
        let Step { pbox, s, t, beta, back, length, positions, directions, bases, forces } = self;
        for (((position, direction), base), f) in positions.iter_mut().zip(directions).zip(bases).zip(forces) {
            let old = *direction;
            let g: Vec2 = [s * base[0] + t * f[0], s * base[1] + t * f[1]];
            let d: Vec2 = [g[0] + beta * old[0], g[1] + beta * old[1]];
            (*base, *direction) = (g, d);
            *position = pbox.moved(*position, [back * old[0] + length * d[0], back * old[1] + length * d[1]]);
        }
    }
}

/// What a run of points adds to the sums and maxima of a step.
struct Partial<'a> {
    grids: &'a [Grid; 3],
    forces: &'a [Vec2],
    accelerations: &'a [Vec2],
    directions: &'a [Vec2],
    bases: &'a [Vec2],
}

impl Kernel for Partial<'_> {
    type Output = Totals<3>;

    #[inline(always)]
    fn run(self, _: impl Lanes) -> Totals<3> {
        let Partial { grids, forces, accelerations, directions, bases } = self;
        let mut totals = Totals::default();
        for (((&force, &f), &d), &g) in forces.iter().zip(accelerations).zip(directions).zip(bases) {
            let terms = [dot(force, d), dot(force, f), dot(force, g)];
            totals.add(grids, terms, [dot(force, force), dot(f, f), dot(d, d)]);
        }
        totals
    }
}

/// Forces at the present positions, and what the step is decided by: one fused reduction, repeated only when the terms
/// have outgrown the grids of the sums.
fn measure<M: Model>(system: &mut System<M>, fused: &mut FusedSums<3>) -> Result<Trial, EngineError> {
    let partial = |grids: &[Grid; 3], forces: &[Vec2], accelerations: &[Vec2], directions: &[Vec2], bases: &[Vec2]| {
        // the compiler sees that these are the same, and reads them once
        let accelerations = if M::BODIES { accelerations } else { forces };
        lanes::run(Partial { grids, forces, accelerations, directions, bases })
    };
    let grids = fused.grids;
    let mut totals = system
        .evaluate(
            |chunk, particles, forces, accelerations| {
                let [directions, bases] = [0, 1].map(|k| &particles.carried[k][chunk.points.clone()]);
                partial(&grids, forces, accelerations, directions, bases)
            },
            Totals::merged,
        )?
        .unwrap_or_default();
    loop {
        system.comm.combine(&mut totals);
        if let Some(Sums { sum: [slope, square, overlap], extremes }) = fused.settle(&totals) {
            let [max_force, max_acceleration, max_direction] = extremes.map(f64::sqrt);
            return Ok(Trial { slope, square, overlap, max_force, max_acceleration, max_direction });
        }
        let [directions, bases] = [0, 1].map(|k| &system.particles().carried[k][..]);
        totals = partial(&fused.grids, system.forces(), system.accelerations(), directions, bases);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::comm::Comm;
    use crate::minimize::Fire;
    use crate::model::SoftDisks;
    use crate::particles::{Bodies, Particles};

    const EDGE: f64 = 10.0;

    fn disks(centers: &[Vec2]) -> System<SoftDisks> {
        let pbox = PeriodicBox::square(EDGE);
        let mut particles = Particles::empty(&Bodies::Disks);
        for (id, &center) in centers.iter().enumerate() {
            particles.push(id as u32, 1.0, &[pbox.frac(center)]);
        }
        let model = SoftDisks { epsilon: 1.0, smallest: 1.0 };
        System::new(Comm::alone(), model, pbox, &pbox, particles, 0.3).unwrap()
    }

    /// Disks at the points of a low-discrepancy sequence.
    fn scattered(n: usize) -> System<SoftDisks> {
        let part = |k: usize, step: f64| EDGE * (k as f64 * step).fract();
        disks(&(0..n).map(|k| [part(k, 0.754_877_666), part(k, 0.569_840_291)]).collect::<Vec<_>>())
    }

    /// Disks in a row around the box that is too short for them by `squeeze` a disk; one is moved off it.
    fn row(n: usize, squeeze: f64, aside: f64) -> System<SoftDisks> {
        let spacing = 1.0 - squeeze;
        assert!((spacing * n as f64 - EDGE).abs() < 1e-9);
        let at = |k: usize| [k as f64 * spacing, 5.0 + if k == 3 { aside } else { 0.0 }];
        disks(&(0..n).map(at).collect::<Vec<_>>())
    }

    fn relax(system: &mut System<SoftDisks>, minimizer: impl Minimizer, force_tolerance: f64) -> Report {
        let minimized = minimizer.minimize(system, &Goal { force_tolerance, max_iterations: 20_000 }).unwrap();
        assert!(minimized.is_converged(), "{minimized:?}");
        *minimized.report()
    }

    #[test]
    fn a_dense_packing_is_relaxed_in_fewer_evaluations() {
        let (mut one, mut other) = (scattered(120), scattered(120));
        let before = one.energies().unwrap().total;
        let (cg, fire) = (relax(&mut one, ConjugateGradient, 1e-13), relax(&mut other, Fire, 1e-13));
        assert!(one.max_force().unwrap() <= 1e-13);
        let (least, by_fire) = (one.energies().unwrap().total, other.energies().unwrap().total);
        assert!(
            0.0 < least && least < 0.5 * before && (least / by_fire - 1.0).abs() < 0.2,
            "{least} {by_fire} {before}"
        );
        assert!(cg.force_evaluations < fire.force_evaluations, "{cg:?} {fire:?}");
    }

    #[test]
    fn a_small_compression_ends_in_the_minimum_that_fire_finds() {
        let mut start = scattered(120);
        relax(&mut start, Fire, 1e-13);
        let tighter = start.pbox().with_area(0.9999 * start.pbox().area());
        let [cg, fire] = [true, false].map(|conjugate| {
            let mut system = scattered(120);
            system.restore(tighter, start.own_particles());
            let report =
                if conjugate { relax(&mut system, ConjugateGradient, 1e-13) } else { relax(&mut system, Fire, 1e-13) };
            (system.energies().unwrap().total, report.force_evaluations)
        });
        assert!((cg.0 / fire.0 - 1.0).abs() < 1e-9, "{cg:?} {fire:?}");
        assert!(cg.1 < fire.1, "{cg:?} {fire:?}");
    }

    #[test]
    fn a_floppy_state_is_left_without_energy() {
        let mut system = scattered(70);
        assert!(system.energies().unwrap().total > 1e-3);
        let report = relax(&mut system, ConjugateGradient, 1e-13);
        assert!(report.force_evaluations < 1500, "{report:?}");
        assert!(system.energies().unwrap().total < 1e-22);
    }

    #[test]
    fn a_contact_that_opens_on_the_way() {
        // the middle one is pushed off the left, far past what the slope at the start tells
        let mut system = disks(&[[1.0, 5.0], [1.3, 5.0], [2.9, 5.0]]);
        relax(&mut system, ConjugateGradient, 1e-13);
        assert!(system.energies().unwrap().total < 1e-24);
    }

    #[test]
    fn a_straight_row_buckles() {
        // balanced along the row, unstable across it: negative curvature from the first step
        let mut system = row(11, 1.0 / 11.0, 1e-6);
        let before = system.energies().unwrap().total;
        relax(&mut system, ConjugateGradient, 1e-12);
        let after = system.energies().unwrap().total;
        assert!(after < 1e-6 * before, "{before} {after}");
    }

    #[test]
    fn coincident_disks_part_when_a_third_pushes() {
        // by themselves they feel nothing
        let mut pair = disks(&[[5.0, 5.0], [5.0, 5.0]]);
        assert_eq!(relax(&mut pair, ConjugateGradient, 1e-12).iterations, 0);
        let mut three = disks(&[[5.0, 5.0], [5.0, 5.0], [5.6, 5.3]]);
        relax(&mut three, ConjugateGradient, 1e-12);
        assert!(three.max_force().unwrap() <= 1e-12);
    }

    #[test]
    fn the_limit_of_iterations_and_of_a_step() {
        let mut system = scattered(120);
        let before = system.own_particles();
        for iterations in [0, 1, 7] {
            system.restore(*system.pbox(), before.clone());
            let outcome = ConjugateGradient
                .minimize(&mut system, &Goal { force_tolerance: 0.0, max_iterations: iterations })
                .unwrap();
            assert_eq!(outcome.report().iterations, iterations);
            assert_eq!(outcome.report().force_evaluations, iterations + 1);
            assert!(!outcome.is_converged());
            let moved = |p: usize| {
                let id = system.particles().id[p] as usize;
                let start = before.id.iter().position(|&b| b as usize == id).unwrap();
                let d = system.pbox().displacement(system.particles().position[p], before.position[start]);
                dot(d, d).sqrt()
            };
            let farthest = (0..system.particles().len()).map(moved).fold(0.0, f64::max);
            assert!(farthest <= iterations as f64 * 0.1 * (1.0 + 1e-9), "{iterations}: {farthest}");
        }
    }

    #[test]
    fn forces_that_run_away_end_it() {
        let mut system = scattered(120);
        system.model.epsilon = 1e17;
        let goal = Goal { force_tolerance: 1e-12, max_iterations: 10 };
        assert!(matches!(ConjugateGradient.minimize(&mut system, &goal), Err(EngineError::Runaway { .. })));
        system.model.epsilon = f64::NAN;
        assert!(matches!(ConjugateGradient.minimize(&mut system, &goal), Err(EngineError::Runaway { .. })));
    }
}
