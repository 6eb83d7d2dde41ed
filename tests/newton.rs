//! Newton's method on the cases that minimisers fail at: ill-conditioned, floppy, unstable, broken ones.

use jamhpc::comm::Comm;
use jamhpc::engine::{EngineError, System};
use jamhpc::geometry::{PeriodicBox, Vec2};
use jamhpc::minimize::{Fire, Goal, HeavyBall, Minimized, Minimizer, Newton, Report};
use jamhpc::model::{Deformable, DeformableParameters, Harmonic, Prestress, SoftDisks, VertexEdge};
use jamhpc::observe::check_no_crossing;
use jamhpc::particles::{Bodies, Particles};
use jamhpc::protocol::{OnsetSearch, Species, compress_to, deformable_particles, find_onset};
use jamhpc::stiffness::Stiffness;

type Packing = System<Deformable<VertexEdge>>;

const DELTA: f64 = 0.1;

fn goal(force_tolerance: f64) -> Goal {
    Goal { force_tolerance, max_iterations: 200_000 }
}

/// 16 particles at rho = 0.7, or so many times as many; `stiffness` is that of contacts over that of areas, 1.1 for the paper's and 0.01 for
/// soft ones.
fn dilute(stiffness: f64, seed: u64) -> Packing {
    many(1, stiffness, seed)
}

fn many(times: u32, stiffness: f64, seed: u64) -> Packing {
    let small = (24.0f64 / 29.0).powi(2);
    let large = small * (17.0f64 / 12.0).powi(2);
    let species = [(small, 12), (large, 17)].map(|(size, n_vertices)| Species { count: 8 * times, size, n_vertices });
    let k_area = 1000.0 / (small * small);
    let area: f64 = species.iter().map(|s| s.count as f64 * s.undeformed_area(DELTA)).sum();
    let at = |density: f64| PeriodicBox::square((area / density).sqrt());
    let (comm, polygons) = deformable_particles(Comm::alone(), at(0.7), &species, seed, DELTA, 0.0).unwrap();
    let model = Deformable::new(DeformableParameters {
        line_tension: 1.0,
        k_area,
        contact: Harmonic { epsilon: stiffness * k_area * large * large, delta: DELTA },
        largest_area_per_vertex: large / 17.0,
    });
    System::new(comm, model, at(0.7), &at(0.96), polygons, 0.1).unwrap()
}

fn disks(centers: &[Vec2]) -> System<SoftDisks> {
    let pbox = PeriodicBox::square(10.0);
    let mut particles = Particles::empty(&Bodies::Disks);
    for (id, &center) in centers.iter().enumerate() {
        particles.push(id as u32, 1.0, &[pbox.frac(center)]);
    }
    System::new(Comm::alone(), SoftDisks { epsilon: 1.0, smallest: 1.0 }, pbox, &pbox, particles, 0.3).unwrap()
}

fn relaxed(minimized: Minimized) -> Report {
    assert!(minimized.is_converged(), "{minimized:?}");
    *minimized.report()
}

#[test]
fn stiff_contacts_relax_to_rounding_in_few_evaluations() {
    let mut packing = dilute(1.1, 1);
    let tolerance = 1e-12 * packing.model.parameters.contact.epsilon;
    for density in [0.75, 0.80, 0.85, 0.88, 0.92, 0.95] {
        let report = compress_to(&mut packing, &Newton, &goal(tolerance), density).unwrap();
        assert!(report.force_evaluations < 30_000, "{density}: {report:?}"); // FIRE takes more than 100,000
        assert!(packing.max_force().unwrap() <= tolerance);
        assert_eq!(check_no_crossing(&mut packing).unwrap(), None);
        let energies = packing.energies().unwrap();
        assert!(energies.stress_mismatch() < 1e-8, "{density}: {energies:?}");
        assert!(density < 0.85 || energies.pressure() > 1e-3, "{density}: {energies:?}");
    }
}

/// Large enough for all that is done in large systems only.
#[test]
fn a_large_packing_relaxes_to_rounding_in_few_evaluations() {
    let mut packing = many(10, 1.1, 1);
    assert!(packing.n_points() > 2000);
    let tolerance = 1e-12 * packing.model.parameters.contact.epsilon;
    for density in [0.80, 0.88, 0.92] {
        let report = compress_to(&mut packing, &Newton, &goal(tolerance), density).unwrap();
        assert!(report.force_evaluations < 80_000, "{density}: {report:?}");
        assert!(packing.max_force().unwrap() <= tolerance);
    }
    assert_eq!(check_no_crossing(&mut packing).unwrap(), None);
}

#[test]
fn a_small_compression_ends_in_the_minimum_that_fire_finds() {
    let mut packing = dilute(0.01, 1);
    for density in [0.78, 0.84, 0.90] {
        compress_to(&mut packing, &Newton, &goal(1e-9), density).unwrap();
    }
    let (pbox, before) = (*packing.pbox(), packing.own_particles());
    let newton = compress_to(&mut packing, &Newton, &goal(1e-9), 0.9003).unwrap();
    let by_newton = packing.energies().unwrap();
    packing.restore(pbox, before);
    let fire = compress_to(&mut packing, &Fire, &goal(1e-9), 0.9003).unwrap();
    let by_fire = packing.energies().unwrap();
    assert!((by_newton.total / by_fire.total - 1.0).abs() < 1e-11, "{by_newton:?} {by_fire:?}");
    assert!((by_newton.pressure() / by_fire.pressure() - 1.0).abs() < 1e-6, "{by_newton:?} {by_fire:?}");
    assert!(20 * newton.force_evaluations < fire.force_evaluations, "{newton:?} {fire:?}");
}

#[test]
fn a_coarse_goal_near_the_onset_is_reached_through_soft_contacts() {
    // too coarse for a factor of the Hessian to be made: all evaluations are those of FIRE
    let evaluations = |minimizer: &dyn Fn(&mut Packing) -> Report| -> u64 {
        (1..=4).map(|seed| minimizer(&mut dilute(0.01, seed)).force_evaluations).sum()
    };
    let newton = evaluations(&|packing| {
        let report = compress_to(packing, &Newton, &goal(1e-3), 0.85).unwrap();
        assert!(packing.max_force().unwrap() <= 1e-3, "contacts are as hard as before");
        report
    });
    let fire = evaluations(&|packing| compress_to(packing, &Fire, &goal(1e-3), 0.85).unwrap());
    assert!(2 * newton < fire, "{newton} {fire}");
}

#[test]
fn motion_with_friction_ends_in_the_minimum_that_fire_finds() {
    let mut packing = dilute(0.01, 1);
    for density in [0.78, 0.84, 0.90] {
        compress_to(&mut packing, &Newton, &goal(1e-3), density).unwrap();
    }
    let (pbox, before) = (*packing.pbox(), packing.own_particles());
    relaxed(HeavyBall.minimize(&mut packing, &goal(1e-8)).unwrap());
    assert!(packing.max_force().unwrap() <= 1e-8);
    let by_friction = packing.energies().unwrap();
    packing.restore(pbox, before);
    relaxed(Fire.minimize(&mut packing, &goal(1e-8)).unwrap());
    let by_fire = packing.energies().unwrap();
    assert!((by_friction.total / by_fire.total - 1.0).abs() < 1e-12, "{by_friction:?} {by_fire:?}");
    assert!((by_friction.pressure() / by_fire.pressure() - 1.0).abs() < 1e-7, "{by_friction:?} {by_fire:?}");
}

#[test]
fn a_floppy_state_is_left_without_contact_energy() {
    let mut packing = dilute(1.1, 1);
    packing.deform_rigidly(packing.pbox().with_area(0.97 * packing.pbox().area()));
    let report = relaxed(Newton.minimize(&mut packing, &goal(1e-9)).unwrap());
    assert!(report.force_evaluations < 10_000, "{report:?}");
    assert!(packing.energies().unwrap().contact < 1e-20);
}

#[test]
fn areas_that_hardly_change_are_relaxed_to_their_rounding() {
    let mut packing = dilute(0.01, 1);
    packing.model.parameters.k_area *= 1e3;
    packing.deform_rigidly(packing.pbox().with_area(0.97 * packing.pbox().area()));
    relaxed(Newton.minimize(&mut packing, &goal(1e-8)).unwrap());
    assert!(packing.max_force().unwrap() <= 1e-8);
}

#[test]
fn the_potential_is_the_same_afterwards() {
    let mut packing = dilute(1.1, 1);
    let before = packing.model;
    packing.deform_rigidly(packing.pbox().with_area(0.9 * packing.pbox().area()));
    for iterations in [0, 3, 500, 2000] {
        let limited = Goal { force_tolerance: 0.0, max_iterations: iterations };
        let outcome = Newton.minimize(&mut packing, &limited).unwrap();
        assert!(!outcome.is_converged());
        assert_eq!(outcome.report().iterations, iterations);
        assert_eq!(packing.model, before);
        assert_eq!(outcome.report().max_force, packing.max_force().unwrap(), "no force of softer contacts");
    }
    packing.model.parameters.line_tension = f64::NAN;
    assert!(matches!(Newton.minimize(&mut packing, &goal(1e-9)), Err(EngineError::Runaway { .. })));
}

#[test]
fn forces_are_foreseen_where_contacts_open_and_close() {
    let mut packing = dilute(1.1, 1);
    for density in [0.78, 0.84, 0.90] {
        compress_to(&mut packing, &Newton, &goal(1e-9), density).unwrap();
    }
    // far more than the overlaps of hard contacts, far less than the outlines' edges
    let step = |k: usize, start: f64| 1e-5 * (2.0 * (start + k as f64 * 0.754_877_666).fract() - 1.0);
    let shake = |packing: &mut Packing, start: f64| {
        let n = packing.forces().len();
        let moves: Vec<Vec2> = (0..n).map(|k| [step(2 * k, start), step(2 * k + 1, start)]).collect();
        packing.carry_these(vec![moves.clone()]);
        packing.move_points(2e-5, |pbox, positions, moves, _| {
            positions.iter_mut().zip(moves).for_each(|(position, &mut by)| *position = pbox.moved(*position, by));
        });
        moves
    };
    shake(&mut packing, 0.1);
    packing.max_force().unwrap();
    packing.prepare_for_reach().unwrap();
    packing.max_force().unwrap();
    let (pbox, here, before) = (*packing.pbox(), packing.own_particles(), packing.forces().to_vec());
    let moves = shake(&mut packing, 0.6);
    packing.max_force().unwrap();
    let after = packing.forces().to_vec();
    packing.restore(pbox, here);
    packing.max_force().unwrap();
    packing.prepare_for_reach().unwrap();
    packing.max_force().unwrap();
    assert_eq!(packing.forces(), before, "stored in the same order");
    let (still, present) = (
        Stiffness::ahead(&mut packing, Prestress::ALL, &vec![[0.0; 2]; moves.len()]),
        Stiffness::of(&mut packing, Prestress::ALL),
    );
    assert!(still.0 == present.unwrap(), "where nothing moves contacts are the present ones, to the last bit");
    let ahead = Stiffness::ahead(&mut packing, Prestress::ALL, &moves);
    let plain = (Stiffness::of(&mut packing, Prestress::ALL).unwrap(), vec![[0.0; 2]; before.len()]);
    let [ahead, plain] = [ahead, plain].map(|(form, changes)| {
        let mut product = vec![[[0.0; 2]]; before.len()];
        form.product(&mut packing, &mut moves.iter().map(|&m| [m]).collect(), &mut product);
        let foreseen = |i: usize, k: usize| before[i][k] + changes[i][k] - product[i][0][k];
        (0..before.len()).flat_map(|i| [0, 1].map(|k| (after[i][k] - foreseen(i, k)).abs())).fold(0.0, f64::max)
    });
    assert!(plain > 0.1, "contacts open or close: {plain}");
    assert!(ahead < 1e-3 * plain, "{ahead} {plain}");
}

#[test]
fn a_stiff_packing_comes_to_its_onset() {
    let search = OnsetSearch { step: 0.01, smallest_step: 1e-8, pressure: [1e-6, 1e-4] };
    for seed in 1..=3 {
        let mut packing = dilute(1.1, seed);
        let onset = find_onset(&mut packing, &Newton, &goal(1e-9), &search, |_, _, _| ()).unwrap();
        assert!(onset.unjammed < onset.density, "{onset:?}");
        // states on the way need not be so well balanced, the last must
        assert!(packing.max_force().unwrap() <= 1e-9, "{onset:?}");
        let pressure = packing.energies().unwrap().pressure();
        assert!(pressure == onset.pressure && (1e-6..1e-4).contains(&pressure), "{onset:?}");
    }
}

#[test]
fn a_straight_row_of_disks_buckles() {
    // balanced along the row, unstable across it: no Hessian to trust at first
    let spacing = 10.0 / 11.0;
    let mut row =
        disks(&(0..11).map(|k| [k as f64 * spacing, 5.0 + if k == 3 { 1e-6 } else { 0.0 }]).collect::<Vec<_>>());
    let before = row.energies().unwrap().total;
    relaxed(Newton.minimize(&mut row, &goal(1e-13)).unwrap());
    assert!(row.energies().unwrap().total < 1e-6 * before);
}

#[test]
fn a_contact_that_opens_on_the_way() {
    let mut three = disks(&[[1.0, 5.0], [1.3, 5.0], [2.9, 5.0]]);
    relaxed(Newton.minimize(&mut three, &goal(1e-13)).unwrap());
    assert!(three.energies().unwrap().total < 1e-24);
}
