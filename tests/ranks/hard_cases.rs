//! Configurations at which implementations break: forces finite, equal on any number of ranks, and minus the gradient
//! of the energy where that is smooth.

use crate::harness::Outcome;
use crate::systems::*;
use jamhpc::comm::Comm;
use jamhpc::engine::System;
use jamhpc::geometry::{Frac, PeriodicBox, Vec2, norm};
use jamhpc::minimize::{Fire, Minimizer};
use jamhpc::model::{Contact, Deformable, DeformableParameters, EdgeEdge, Harmonic, VertexEdge};
use jamhpc::observe::check_no_crossing;
use jamhpc::protocol::{Species, compress_to, deformable_particles};

const EDGE: f64 = 10.0;

/// Constants of order one: the finite differences need no more.
fn model<C: Contact>() -> Deformable<C> {
    Deformable::new(DeformableParameters {
        line_tension: 1.0,
        k_area: 10.0,
        contact: Harmonic { epsilon: 1.0, delta: DELTA },
        largest_area_per_vertex: 1.0,
    })
}

/// Polygons about the origin.
struct Scene {
    name: &'static str,
    polygons: Vec<Vec<Vec2>>,
    /// No kink of the energy within a finite difference step.
    smooth: bool,
}

fn square(center: Vec2, half: f64) -> Vec<Vec2> {
    [[-half, -half], [half, -half], [half, half], [-half, half]].map(|v| [center[0] + v[0], center[1] + v[1]]).to_vec()
}

/// Cut into a square from above.
fn notched() -> Vec<Vec2> {
    vec![[-1.0, -1.0], [1.0, -1.0], [1.0, 0.5], [0.4, 0.5], [0.0, -0.3], [-0.4, 0.5], [-1.0, 0.5]]
}

fn scenes() -> Vec<Scene> {
    let scene = |name, smooth, polygons| Scene { name, polygons, smooth };
    let gap = 0.6 * DELTA;
    let mut with_collapsed_edge = square([0.0, 0.0], 0.5);
    with_collapsed_edge.insert(2, [0.5, 0.5 - 1e-9]);
    let mut with_no_edge = square([0.0, 0.0], 0.5);
    with_no_edge.insert(2, [0.5, 0.5]);
    vec![
        // its outline passes through four subdomains of a 2 × 2 grid, at the corner of the box and in the middle
        scene(
            "one in four subdomains",
            true,
            vec![
                regular(12, [0.02, -0.01], 0.8, 0.1),
                regular(17, [1.66, 0.1], 0.8, 0.2),
                regular(12, [0.1, 1.62], 0.8, 0.3),
                regular(17, [-1.1, -1.2], 0.8, 0.4),
            ],
        ),
        scene("parallel facets", true, vec![square([0.0, 0.0], 0.5), square([1.0 + gap, 0.013], 0.5)]),
        scene("parallel facets face to face", true, vec![square([0.0, 0.0], 0.5), square([1.0 + gap, 0.0], 0.5)]),
        scene(
            "vertex before vertex",
            true,
            vec![regular(4, [0.0, 0.0], 0.5, 0.0), regular(4, [1.0 + gap, 0.0], 0.5, 0.0)],
        ),
        scene("vertex on vertex", false, vec![regular(4, [0.0, 0.0], 0.5, 0.0), regular(4, [1.0, 0.0], 0.5, 0.0)]),
        scene("vertex on edge", false, vec![regular(4, [0.0, 0.0], 0.5, 0.0), square([1.0, 0.1], 0.5)]),
        scene("collapsed edge", false, vec![with_collapsed_edge, square([1.0 + gap, 0.4], 0.5)]),
        scene("edge of length zero", false, vec![with_no_edge, square([1.0 + gap, 0.4], 0.5)]),
        scene("reflex notch", true, vec![notched(), vec![[0.02, -0.2], [0.3, 0.9], [-0.3, 0.9]]]),
        scene("reflex corner on a corner", true, vec![notched(), vec![[-0.97, 0.55], [1.1, 0.57], [0.0, 1.2]]]),
        scene("48 vertices", true, vec![regular(48, [0.0, 0.0], 0.8, 0.0), regular(48, [1.55, 0.3], 0.8, 0.05)]),
        scene("crossing", true, vec![square([0.0, 0.0], 0.5), regular(5, [0.8, 0.3], 0.6, 0.3)]),
    ]
}

fn system<C: Contact>(comm: Comm, pbox: PeriodicBox, polygons: &[Vec<Vec2>]) -> System<Deformable<C>> {
    let particles = polygons_at(&comm, &pbox, polygons, |id| 0.9 + 0.1 * id as f64);
    System::new(comm, model(), pbox, &pbox, particles, 0.1).unwrap()
}

/// All scenes, at the corner of the box, in its middle and off both, square and sheared, with both contact terms.
pub fn all(mut comm: Comm) -> Outcome {
    let mut outcome = Vec::new();
    for scene in scenes() {
        for (at, tilt) in
            [([0.0, 0.0], 0.0), ([0.0, 0.0], 0.3), ([0.5, 0.5], 0.0), ([0.5, 0.0], -0.3), ([0.3, 0.8], 0.1)]
        {
            let pbox = PeriodicBox::new(EDGE, EDGE, tilt * EDGE);
            let shift = |v: &Vec2| [v[0] + (at[0] + tilt * at[1]) * EDGE, v[1] + at[1] * EDGE];
            let polygons: Vec<Vec<Vec2>> = scene.polygons.iter().map(|p| p.iter().map(shift).collect()).collect();
            let when = format!("{} at {at:?}, tilt {tilt}", scene.name);

            let mut smooth = system::<VertexEdge>(comm, pbox, &polygons);
            check(&mut smooth, &when, &mut outcome);
            if scene.smooth {
                assert_gradient(&smooth, &when);
            }
            let mut edges = system::<EdgeEdge>(smooth.comm, pbox, &polygons);
            check(&mut edges, &when, &mut outcome);
            comm = edges.comm;
        }
    }
    for (turn, slide) in [(1e-9, 0.0), (-1e-9, 0.0), (0.0, 1e-9), (0.0, -1e-9)] {
        assert_continuous(turn, slide);
    }
    outcome
}

fn check<C: Contact + Clone>(system: &mut System<Deformable<C>>, when: &str, outcome: &mut Outcome) {
    let largest = system.max_force().unwrap();
    assert!(largest.is_finite() && largest > 0.0, "{when}: {largest}");
    let e = system.energies().unwrap();
    assert!(e.contact > 0.0, "{when}: nothing touches");
    assert!(e.virial.iter().chain(&e.centroid).all(|s| s.is_finite()), "{when}: {e:?}");
    assert_forces_as_rebuilt(system, 0.1, when);
    outcome.push(when.into());
    outcome.extend(describe(system));
}

/// F = −∇U by central differences, every coordinate of every vertex, on this rank alone.
fn assert_gradient<C: Contact + Clone>(system: &System<Deformable<C>>, when: &str) {
    const STEP: f64 = 1e-6;
    let mut alone = rebuilt_alone(system, 0.1);
    alone.max_force().unwrap();
    let forces = alone.forces().to_vec();
    let (pbox, at_rest) = (*alone.pbox(), alone.own_particles());
    let mut energy = |point: usize, by: Vec2| {
        let mut moved = at_rest.clone();
        moved.position[point] = pbox.moved(moved.position[point], by);
        alone.restore(pbox, moved);
        alone.energies().unwrap().total
    };
    for (point, force) in forces.iter().enumerate() {
        let slope = |by: Vec2, energy: &mut dyn FnMut(usize, Vec2) -> f64| {
            (energy(point, by) - energy(point, [-by[0], -by[1]])) / (2.0 * STEP)
        };
        let gradient = [slope([STEP, 0.0], &mut energy), slope([0.0, STEP], &mut energy)];
        let error = norm([force[0] + gradient[0], force[1] + gradient[1]]);
        // the curvature may jump (by ε/δ² = 100) within a step
        assert!(error < 200.0 * STEP, "{when}: point {point} feels {force:?}, energy falls by {gradient:?}");
    }
}

/// A hair's turn or slide of facing facets changes forces by a hair.
fn assert_continuous(turn: f64, slide: f64) {
    let pbox = PeriodicBox::square(EDGE);
    let pair = |turn: f64, slide: f64| {
        let turned = square([0.0, 0.0], 0.5).iter().map(|v| [v[0] - turn * v[1], v[1] + turn * v[0]]).collect();
        [turned, square([1.0 + 0.6 * DELTA, slide], 0.5)]
    };
    let forces = |turn, slide| {
        let mut system = system::<VertexEdge>(Comm::alone(), pbox, &pair(turn, slide));
        system.max_force().unwrap();
        own_forces(&system)
    };
    let (before, after) = (forces(0.0, 0.0), forces(turn, slide));
    for (id, forces) in &before {
        for (f, g) in forces.iter().zip(&after[id]) {
            assert!(norm([f[0] - g[0], f[1] - g[1]]) < 1e-6, "turn {turn}, slide {slide}: {f:?} becomes {g:?}");
        }
    }
}

/// Small polygons among one whose area is 80 times theirs, relaxed for a while.
pub fn area_ratio_80(comm: Comm) -> Outcome {
    let species = [Species { count: 300, size: 0.5, n_vertices: 12 }, Species { count: 3, size: 40.0, n_vertices: 48 }];
    let area: f64 = species.iter().map(|s| s.count as f64 * s.undeformed_area(DELTA)).sum();
    let pbox = PeriodicBox::square((area / 0.7).sqrt());
    let (comm, polygons) = deformable_particles(comm, pbox, &species, 3, DELTA).unwrap();
    let smaller = pbox.with_area(area / 0.8);
    let mut system = System::new(comm, model::<VertexEdge>(), pbox, &smaller, polygons, 0.1).unwrap();
    system.deform_rigidly(smaller);
    let goal = goal(0.0, 300);
    let _ = Fire.minimize(&mut system, &goal).unwrap();
    assert!(system.energies().unwrap().contact > 0.0);
    assert_forces_as_rebuilt(&mut system, 0.1, "area ratio 80");
    describe(&mut system)
}

/// All particles in one corner of a large box: most ranks own none, and must still take part.
pub fn empty_subdomains(comm: Comm) -> Outcome {
    let pbox = PeriodicBox::square(40.0);
    let near_the_corner =
        |k: usize| regular(12, [1.0 + 1.55 * (k % 4) as f64, 1.0 + 1.55 * (k / 4) as f64], 0.8, 0.1 * k as f64);
    let polygons: Vec<Vec<Vec2>> = (0..12).map(near_the_corner).collect();
    let mut system = system::<VertexEdge>(comm, pbox, &polygons);
    system.prepare().unwrap();
    let empty = system.comm.sum_count(system.particles().is_empty() as u64);
    assert!(system.comm.size() < 3 || empty > 0);
    let goal = goal(0.0, 300);
    let minimized = Fire.minimize(&mut system, &goal).unwrap();
    let mut outcome = describe(&mut system);
    outcome.push(format!("{:?}", minimized.report()));
    outcome
}

/// Facing squares whose shells touch, in a box that shrinks by a third: moved there at once as rigid wholes they
/// cross; brought there by [`compress_to`] they do not. One step of it brings no touching centres closer than half a
/// contact width, and the widest pair just that.
pub fn compression_without_crossing(comm: Comm) -> Outcome {
    let pbox = PeriodicBox::square(EDGE);
    let smallest = PeriodicBox::square(EDGE / 1.5);
    let reach = 0.5f64.sqrt();
    let pairs = [
        square([1.0, 1.0], 0.5),
        square([2.0 + DELTA, 1.013], 0.5),
        // across the corner of the box
        square([-0.55, -1.0], 0.5),
        square([0.45 + DELTA, -1.0], 0.5),
        // corner to corner, as far apart as touching centres can be
        regular(4, [5.0, 5.0], reach, 0.0),
        regular(4, [5.0 + 2.0 * reach + DELTA, 5.0], reach, 0.0),
    ];
    let particles = polygons_at(&comm, &pbox, &pairs, |_| 1.0);
    let mut system = System::new(comm, model::<VertexEdge>(), pbox, &smallest, particles, 0.1).unwrap();
    assert_eq!(check_no_crossing(&mut system).unwrap(), None);
    let start = system.own_particles();
    let area = system.own_area().unwrap();

    system.deform_rigidly(smallest);
    assert_eq!(check_no_crossing(&mut system).unwrap(), Some((0, 1)), "one step of this size must be too large");
    system.restore(pbox, start.clone());

    let distances = |system: &System<Deformable<VertexEdge>>| -> Vec<f64> {
        let all = whole(system);
        let centers: Vec<Frac> = (0..all.len()).map(|p| all.center(system.pbox(), p)).collect();
        centers.chunks(2).map(|pair| norm(system.pbox().displacement(pair[0], pair[1]))).collect()
    };
    let before = distances(&system);
    system.deform_rigidly(pbox.with_area(pbox.area() / system.densest_step()));
    let approach: Vec<f64> = before.iter().zip(distances(&system)).map(|(then, now)| then - now).collect();
    assert!(approach.iter().all(|a| (0.3 * DELTA..0.5 * DELTA + 1e-12).contains(a)), "{approach:?}");
    assert!(approach[2] > 0.5 * DELTA - 1e-9, "{approach:?}");
    assert_eq!(check_no_crossing(&mut system).unwrap(), None);
    system.restore(pbox, start);

    let report = compress_to(&mut system, &Fire, &goal(1e-3, 100_000), area / smallest.area()).unwrap();
    assert_eq!(check_no_crossing(&mut system).unwrap(), None);
    let mut outcome = describe(&mut system);
    outcome.push(format!("{report:?}"));
    outcome
}
