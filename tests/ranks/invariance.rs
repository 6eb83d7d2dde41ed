//! The same bits on any number of ranks and threads, from one force evaluation to a whole onset search.

use crate::harness::Outcome;
use crate::systems::*;
use jamhpc::comm::Comm;
use jamhpc::engine::{System, Watch};
use jamhpc::geometry::PeriodicBox;
use jamhpc::minimize::{ConjugateGradient, Fire, Goal, HeavyBall, Minimizer, Newton};
use jamhpc::model::{Contact, Deformable, EdgeEdge, Model, VertexEdge};
use jamhpc::observe::{Contacts, PackingFraction, Rattlers, Shape, Voids, rattler_ids};
use jamhpc::particles::Particles;
use jamhpc::protocol::{OnsetSearch, compress_to, find_onset};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

pub fn forces_sp(comm: Comm) -> Outcome {
    let mut system = random_sp(comm, 1024, unit_box(0.1), 0.9, 0.9);
    let outcome = describe(&mut system);
    assert!(system.max_force().unwrap() > 0.5, "random disks overlap deeply");
    outcome
}

/// Polygons pushed into each other as rigid wholes, so that contacts of every kind occur.
fn forces_of_polygons<C: Contact>(comm: Comm) -> Outcome {
    let mut system = random_dp::<C>(comm, 128, unit_box(0.1), 0.7, 0.9);
    let tighter = system.pbox().with_area(0.8 * system.pbox().area());
    system.deform_rigidly(tighter);
    let outcome = describe(&mut system);
    assert!(system.energies().unwrap().contact > 1.0);
    outcome
}

pub fn forces_dp(comm: Comm) -> Outcome {
    forces_of_polygons::<VertexEdge>(comm)
}

pub fn forces_dp_edge_edge(comm: Comm) -> Outcome {
    forces_of_polygons::<EdgeEdge>(comm)
}

/// 2,000 steps of a minimiser, on the way of which particles change owners and lists are made anew, in parts before
/// which the box may be strained. After each part the forces must be those of lists made afresh.
fn relax<M: Model + Clone>(mut system: System<M>, minimizer: impl Minimizer, parts: u64, strain: f64) -> Outcome {
    let mut outcome = Vec::new();
    system.prepare().unwrap();
    let before = system.counters;
    for _ in 0..parts {
        let b = *system.pbox();
        system.deform(PeriodicBox::new(b.lx(), b.ly(), b.xy() + strain * b.ly()));
        let goal = goal(0.0, 2000 / parts);
        let minimized = minimizer.minimize(&mut system, &goal).unwrap();
        assert_eq!(minimized.report().iterations, 2000 / parts);
        outcome.push(format!("{:?}", minimized.report()));
        // what the minimiser converged by is what its lists gave it
        let kept = own_forces(&system);
        let mut fresh = rebuilt_alone(&system, 0.2);
        fresh.max_force().unwrap();
        let right = own_forces(&fresh);
        assert!(kept.iter().all(|(id, forces)| *forces == right[id]), "lists have lost a contact");
    }
    let rebuilds = system.counters.rebuilds - before.rebuilds;
    let migrated = system.comm.sum_count(system.counters.migrated - before.migrated);
    assert!(rebuilds > 2, "lists were made anew {rebuilds} times only");
    assert!(system.comm.size() == 1 || migrated > 0, "no particle changed its owner");
    outcome.extend(describe(&mut system));
    outcome.push(format!("{rebuilds} rebuilds"));
    outcome
}

pub fn fire_sp(comm: Comm) -> Outcome {
    relax(random_sp(comm, 1024, unit_box(0.0), 0.9, 0.9), Fire, 1, 0.0)
}

pub fn cg_sp(comm: Comm) -> Outcome {
    relax(random_sp(comm, 1024, unit_box(0.0), 0.9, 0.9), ConjugateGradient, 5, 0.02)
}

/// A loose packing compressed past its onset, then sheared until particles pass each other.
pub fn fire_dp(comm: Comm) -> Outcome {
    let mut system = random_dp::<VertexEdge>(comm, 128, unit_box(0.0), 0.75, 0.9);
    let tighter = system.pbox().with_area(0.88 * system.pbox().area());
    system.deform_rigidly(tighter);
    relax(system, Fire, 5, 0.1)
}

/// Polygons about centres that were spread evenly.
pub fn spread_start(comm: Comm) -> Outcome {
    let mut system = polygons_of::<VertexEdge>(comm, 128, unit_box(0.0), [0.75, 0.9], 0.9);
    let tighter = system.pbox().with_area(0.8 * system.pbox().area());
    system.deform_rigidly(tighter);
    describe(&mut system)
}

/// Few particles: what matters is that accelerations are another vector than forces.
pub fn cg_dp(comm: Comm) -> Outcome {
    let mut system = random_dp::<VertexEdge>(comm, 128, unit_box(0.0), 0.75, 0.9);
    let tighter = system.pbox().with_area(0.88 * system.pbox().area());
    system.deform_rigidly(tighter);
    relax(system, ConjugateGradient, 5, 0.1)
}

/// Whoever watches a minimiser and asks it to end, more seldom as it goes on, so that it comes to its end.
fn watched<M: Model>(system: &mut System<M>) -> Arc<AtomicBool> {
    let (ends, told) = (Arc::new(AtomicBool::new(false)), AtomicU64::new(0));
    let asks = ends.clone();
    let told = move |_, _| {
        let times = 1 + told.fetch_add(1, Ordering::Relaxed);
        if times.isqrt().pow(2) == times {
            asks.store(true, Ordering::Relaxed);
        }
    };
    system.watch = Some(Watch { told: Box::new(told), ends: ends.clone() });
    ends
}

/// A minimiser in short turns, between which its memory and the particles are all that is left of it: new lists, new
/// owners. It must go the way of one that is never left, also if so many times or more it takes back what it has done
/// since.
fn in_turns<M: Model + Clone>(
    mut system: System<M>,
    minimizer: impl Minimizer,
    goal: &Goal,
    taken_back: usize,
) -> Outcome {
    let start = (*system.pbox(), system.own_particles());
    let whole = minimizer.minimize(&mut system, goal).unwrap();
    let expected = describe(&mut system);
    system.restore(start.0, start.1);
    let (mut memory, mut turns, mut backs) = (Vec::new(), 0, 0);
    let ends = watched(&mut system);
    let parted = loop {
        if let Some(minimized) = minimizer.advance(&mut system, goal, &mut memory, 17).unwrap() {
            break minimized;
        }
        turns += 1;
        // FIRE and conjugate gradients leave vectors
        backs += usize::from(ends.swap(false, Ordering::Relaxed) && system.particles().carried.is_empty());
        // rank 0 gets all of them, and keeps those that are its own
        let mut message = Vec::new();
        (0..system.particles().len()).for_each(|p| system.particles().pack(p, true, &mut message));
        let mut particles = Particles::empty(&system.model.bodies());
        particles.carried = vec![Vec::new(); system.particles().carried.len()];
        system.comm.gather(message).iter().for_each(|message| particles.unpack(message, true));
        system.restore(start.0, particles);
    };
    assert!(turns > 10, "{turns} turns");
    assert!(backs >= taken_back, "{backs} times");
    assert_eq!(parted, whole);
    assert_eq!(describe(&mut system), expected);
    expected
}

fn turns_with_hard_contacts(comm: Comm, minimizer: impl Minimizer) -> Outcome {
    let mut system = random_dp::<VertexEdge>(comm, 64, unit_box(0.0), 0.75, 0.9);
    let tighter = system.pbox().with_area(0.88 * system.pbox().area());
    system.deform_rigidly(tighter);
    in_turns(system, minimizer, &goal(1e-9, 500), 0)
}

pub fn turns_fire(comm: Comm) -> Outcome {
    turns_with_hard_contacts(comm, Fire)
}

pub fn turns_heavy_ball(comm: Comm) -> Outcome {
    turns_with_hard_contacts(comm, HeavyBall)
}

/// Its Newton steps are interrupted, too, and lists that are younger then must not be seen in its report. As many particles
/// as it takes for conjugate gradients between the steps.
pub fn turns_newton(comm: Comm) -> Outcome {
    let mut system = random_dp::<VertexEdge>(comm, 144, unit_box(0.0), 0.75, 0.95);
    let tighter = system.pbox().with_area(0.8 * system.pbox().area());
    system.deform_rigidly(tighter);
    in_turns(system, Newton, &goal(1e-9, 1_000_000), 2)
}

pub fn turns_cg(comm: Comm) -> Outcome {
    in_turns(random_sp(comm, 256, unit_box(0.0), 0.9, 0.9), ConjugateGradient, &goal(1e-12, 5000), 0)
}

/// An onset search and a compression step, with every state on the way.
fn onset<M: Model>(mut system: System<M>, minimizer: impl Minimizer, goal: &Goal, search: &OnsetSearch) -> Outcome {
    let mut outcome = Vec::new();
    let onset = find_onset(&mut system, &minimizer, goal, search, |density, energies, report| {
        outcome.push(format!("{density:e} {} {report:?}", hex(&[energies.total, energies.pressure()])));
    })
    .unwrap();
    assert!(onset.steps > 3 && onset.pressure > search.pressure[0] && onset.unjammed < onset.density, "{outcome:#?}");
    let report = compress_to(&mut system, &minimizer, goal, onset.density + 0.01).unwrap();
    outcome.push(format!("{onset:?} {report:?}"));
    outcome.extend(describe(&mut system));
    outcome
}

pub fn onset_sp(comm: Comm) -> Outcome {
    let system = random_sp(comm, 1024, unit_box(0.0), 0.6, 0.95);
    let goal = goal(1e-7, 100_000);
    onset(system, ConjugateGradient, &goal, &OnsetSearch { step: 0.04, smallest_step: 1e-6, pressure: [1e-5, 1e-3] })
}

pub fn onset_dp(comm: Comm) -> Outcome {
    let system: System<Deformable<VertexEdge>> = random_dp(comm, 128, unit_box(0.0), 0.7, 0.95);
    let goal = goal(1e-2, 100_000);
    onset(system, Fire, &goal, &OnsetSearch { step: 0.02, smallest_step: 1e-6, pressure: [0.1, 0.5] })
}

/// Relaxed to where contact forces are rounding, an onset and a state above it.
pub fn newton_dp(comm: Comm) -> Outcome {
    let system: System<Deformable<VertexEdge>> = random_dp(comm, 128, unit_box(0.1), 0.7, 0.95);
    let goal = goal(1e-9, 1_000_000);
    onset(system, Newton, &goal, &OnsetSearch { step: 0.04, smallest_step: 1e-6, pressure: [1e-4, 1e-2] })
}

pub fn newton_sp(comm: Comm) -> Outcome {
    let mut system = random_sp(comm, 256, unit_box(0.1), 0.9, 0.9);
    let minimized = Newton.minimize(&mut system, &goal(1e-14, 100_000)).unwrap();
    assert!(minimized.is_converged(), "{minimized:?}");
    let mut outcome = vec![format!("{:?}", minimized.report())];
    outcome.extend(describe(&mut system));
    outcome
}

/// The packing fraction and all voids of a state, with and without rattlers, to the last bit.
fn voids<M: Model>(system: &mut System<M>) -> Outcome {
    let shapes: Vec<Shape> = system.outlines(Shape::of).unwrap();
    let density = PackingFraction::of(system, &shapes).unwrap();
    let contacts = Contacts::of(system, Rattlers::default()).unwrap();
    let removed = rattler_ids(system, &contacts);
    let all = Voids::of(system, &[], Some(density.packing_fraction)).unwrap();
    let some = Voids::of(system, &removed, None).unwrap();
    let mut lines = vec![
        hex(&[density.packing_fraction, density.double_counted]),
        format!("{removed:?} {:?} {:?}", all.statistics, some.statistics),
    ];
    for void in all.on_root(&system.comm).iter().chain(&some.on_root(&system.comm)) {
        lines.push(format!(
            "{} {} {} {}",
            void.sides,
            void.islands,
            void.percolates,
            hex(&[void.area, void.perimeter])
        ));
    }
    lines
}

pub fn voids_sp(comm: Comm) -> Outcome {
    let mut system = random_sp(comm, 256, unit_box(0.2), 0.6, 0.9);
    let mut outcome = voids(&mut system); // random: deep overlaps, nothing percolates
    system.deform(system.pbox().with_area(system.pbox().area() * 0.6 / 0.88));
    assert!(Fire.minimize(&mut system, &goal(1e-10, 100_000)).unwrap().is_converged());
    outcome.extend(voids(&mut system));
    outcome
}

pub fn voids_dp(comm: Comm) -> Outcome {
    let mut system = random_dp::<VertexEdge>(comm, 64, unit_box(0.1), 0.5, 0.95);
    let mut outcome = voids(&mut system); // one void with many islands
    compress_to(&mut system, &Fire, &goal(1e-3, 50_000), 0.9).unwrap();
    outcome.extend(voids(&mut system));
    outcome
}
