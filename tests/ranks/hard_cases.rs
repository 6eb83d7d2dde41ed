//! Configurations at which implementations break: forces finite, equal on any number of ranks, and minus the gradient
//! of the energy where that is smooth.

use crate::harness::Outcome;
use crate::systems::*;
use jamhpc::comm::Comm;
use jamhpc::engine::{EngineError, System};
use jamhpc::geometry::{Frac, PeriodicBox, Vec2, cross, dot, norm};
use jamhpc::minimize::{Fire, Minimizer};
use jamhpc::model::{Contact, Deformable, DeformableParameters, EdgeEdge, Harmonic, VertexEdge};
use jamhpc::observe::{Contacts, Rattlers, Spectrum, check_no_crossing};
use jamhpc::particles::{Bodies, Particles};
use jamhpc::protocol::{OnsetSearch, Species, compress_to, deformable_particles, find_onset};

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
    let (comm, polygons) = deformable_particles(comm, pbox, &species, 3, DELTA, 0.0).unwrap();
    let smaller = pbox.with_area(area / 0.8);
    let mut system = System::new(comm, model::<VertexEdge>(), pbox, &smaller, polygons, 0.1).unwrap();
    system.deform_rigidly(smaller);
    let goal = goal(0.0, 300);
    let _ = Fire.minimize(&mut system, &goal).unwrap();
    let energies = system.energies().unwrap();
    assert!(energies.contact > 0.0);
    assert_forces_as_rebuilt(&mut system, 0.1, "area ratio 80");
    let all = whole(&system);
    let expected = energy_of_all_pairs(system.pbox(), &all);
    println!("residual {:e}, {energies:?}, all pairs {expected:?}", system.max_force().unwrap());
    for (got, expected) in [energies.line, energies.area, energies.contact].into_iter().zip(expected) {
        assert!((got - expected).abs() < 1e-11 * energies.total, "{got} instead of {expected}");
    }
    describe(&mut system)
}

/// γ Σ p, k_a/2 Σ (a − a₀)² and U_int of [`model`], every vertex against every edge and vertex of all others.
fn energy_of_all_pairs(pbox: &PeriodicBox, all: &Particles) -> [f64; 3] {
    let law = Harmonic { epsilon: 1.0, delta: DELTA };
    let phi = |d: f64| if d < law.delta { 0.5 * law.epsilon * (1.0 - d / law.delta).powi(2) } else { 0.0 };
    let [mut line, mut area, mut contact] = [0.0; 3];
    let edges = |p: usize| {
        let points = all.points_of(p);
        (0..points.len()).map(move |k| (points[k], points[(k + 1) % points.len()]))
    };
    for p in 0..all.len() {
        let origin = all.points_of(p)[0];
        let mut own = 0.0;
        for (a, b) in edges(p) {
            line += norm(pbox.displacement(b, a));
            own += 0.5 * cross(pbox.displacement(a, origin), pbox.displacement(b, origin));
        }
        area += 0.5 * 10.0 * (own - all.size[p]).powi(2);
        for &v in all.points_of(p) {
            for q in (0..all.len()).filter(|&q| q != p) {
                for (a, b) in edges(q) {
                    let (edge, to) = (pbox.displacement(b, a), pbox.displacement(v, a));
                    let t = (dot(to, edge) / dot(edge, edge)).clamp(0.0, 1.0);
                    contact += phi(norm([to[0] - t * edge[0], to[1] - t * edge[1]])) - phi(norm(to));
                }
            }
        }
    }
    [line, area, contact]
}

/// All particles in one corner of a large box: most ranks own none, and must still take part. They push each other
/// apart until each is the regular polygon that a lone one becomes: a = N tan(π/N) R², k_a(a₀ − a) = γ/R, p = 2a/R.
pub fn empty_subdomains(comm: Comm) -> Outcome {
    let pbox = PeriodicBox::square(40.0);
    let near_the_corner =
        |k: usize| regular(12, [1.0 + 1.65 * (k % 4) as f64, 1.0 + 1.65 * (k / 4) as f64], 0.8, 0.1 * k as f64);
    let polygons: Vec<Vec<Vec2>> = (0..12).map(near_the_corner).collect();
    let mut system = system::<VertexEdge>(comm, pbox, &polygons);
    assert!(system.energies().unwrap().contact > 0.0 && check_no_crossing(&mut system).unwrap().is_none());
    let empty = system.comm.sum_count(system.particles().is_empty() as u64);
    assert!(system.comm.size() < 3 || empty > 0);
    let minimized = Fire.minimize(&mut system, &goal(1e-7, 200_000)).unwrap();
    let alone = |id: usize| {
        let (rest, shape) = (0.9 + 0.1 * id as f64, 12.0 * (std::f64::consts::PI / 12.0).tan());
        let (mut low, mut high) = (1e-3, 10.0);
        for _ in 0..100 {
            let r: f64 = 0.5 * (low + high);
            if 10.0 * (rest - shape * r * r) > 1.0 / r { low = r } else { high = r }
        }
        2.0 * shape * low + 0.5 * 10.0 * (rest - shape * low * low).powi(2)
    };
    let expected: f64 = (0..12).map(alone).sum();
    let energy = system.energies().unwrap().total;
    println!("{minimized:?}: U {energy}, {expected} when apart");
    assert!(minimized.is_converged() && (energy - expected).abs() < 1e-6 * expected, "{energy} instead of {expected}");
    let mut outcome = describe(&mut system);
    outcome.push(format!("{:?}", minimized.report()));
    outcome
}

/// U_int of two outlines, worked out by hand: each vertex within reach of the other outline counts once,
/// φ(d) = ε/2 (1 − d/δ)² at its distance from it; inside a notch once for each flank. Forces between the two cancel.
pub fn known_energies(mut comm: Comm) -> Outcome {
    let law = Harmonic { epsilon: 1.0, delta: DELTA };
    let gap = 0.6 * DELTA;
    // inside the notch of `notched`: the tip touches its two flanks, which rise by 2 in 1, and nothing else does
    let tip = vec![[0.0, -0.3 + 0.1], [0.2, 0.9], [-0.2, 0.9]];
    // distance of (0, −0.2) from the flank: |0.4·0.1|/√(0.4² + 0.8²)
    let to_flank = 0.4 * 0.1 / 0.4f64.hypot(0.8);
    let mut collapsed = square([0.0, 0.0], 0.5);
    collapsed.insert(2, [0.5, 0.5 - 1e-9]);
    // name, outlines, distances of the touches
    let cases = [
        // slid, so that one corner of each stands before the facet of the other
        ("parallel facets", vec![square([0.0, 0.0], 0.5), square([1.0 + gap, 0.3], 0.5)], vec![gap; 2]),
        ("face to face", vec![square([0.0, 0.0], 0.5), square([1.0 + gap, 0.0], 0.5)], vec![gap; 4]),
        (
            "vertex before vertex",
            vec![regular(4, [0.0, 0.0], 0.5, 0.0), regular(4, [1.0 + gap, 0.0], 0.5, 0.0)],
            vec![gap; 2],
        ),
        ("vertex on vertex", vec![regular(4, [0.0, 0.0], 0.5, 0.0), regular(4, [1.0, 0.0], 0.5, 0.0)], vec![0.0; 2]),
        // the corners of the short edge are one corner as far as its length goes: both stand before the facet
        ("collapsed edge", vec![collapsed, square([1.0 + gap, 0.3], 0.5)], vec![gap; 3]),
        ("reflex notch", vec![notched(), tip], vec![to_flank; 2]),
    ];
    let mut outcome = Vec::new();
    for (name, polygons, touches) in cases {
        for at in [[0.0, 0.0], [0.5 * EDGE, 0.5 * EDGE], [3.1, 7.7]] {
            let place = |v: &Vec2| [v[0] + at[0], v[1] + at[1]];
            let placed: Vec<Vec<Vec2>> = polygons.iter().map(|p| p.iter().map(place).collect()).collect();
            let mut system = system::<VertexEdge>(comm, PeriodicBox::square(EDGE), &placed);
            let residual = system.max_force().unwrap();
            let energy = system.energies().unwrap().contact;
            let expected: f64 = touches.iter().map(|&d| law.energy(d)).sum();
            let words = by_id(&system, force_words);
            let total: Vec2 = words
                .values()
                .flat_map(|w| w.chunks_exact(2))
                .fold([0.0; 2], |sum, f| [sum[0] + f64::from_bits(f[0]), sum[1] + f64::from_bits(f[1])]);
            if system.comm.is_root() {
                println!("{name} at {at:?}: U_int {energy:e}, by hand {expected:e}, max|F| {residual:e}");
                assert!(norm(total) < 1e-12, "{name}: the forces sum up to {total:?}");
            }
            assert!((energy - expected).abs() < 1e-7 * expected, "{name} at {at:?}: {energy} instead of {expected}");
            // γ at both edges of a corner, the pressure of areas, and the touches
            let bound = 2.0 + 10.0 * 2.0 + touches.len() as f64 * law.epsilon / law.delta;
            assert!(residual.is_finite() && residual < bound, "{name}: {residual}");
            outcome.extend(describe(&mut system));
            comm = system.comm;
        }
    }
    outcome
}

/// Two 48-gons pushed together relax to force balance, also across the corner of the box and among four subdomains.
pub fn relaxed_pair_of_48(mut comm: Comm) -> Outcome {
    let mut outcome = Vec::new();
    for at in [[0.0, 0.0], [0.5 * EDGE, 0.5 * EDGE]] {
        let place = |x: f64| regular(48, [at[0] + x, at[1] + 0.01], 0.8, 0.1);
        let mut system = system::<VertexEdge>(comm, PeriodicBox::square(EDGE), &[place(-0.8), place(0.85)]);
        let minimized = Fire.minimize(&mut system, &goal(1e-8, 200_000)).unwrap();
        let residual = system.max_force().unwrap();
        let contact = system.energies().unwrap().contact;
        println!("two 48-gons at {at:?}: max|F| {residual:e}, U_int {contact:e}, {:?}", minimized.report());
        assert!(minimized.is_converged() && residual <= 1e-8, "{minimized:?}");
        // nothing holds them together: they end just out of reach
        assert!(contact < 1e-6, "{contact}");
        outcome.extend(describe(&mut system));
        comm = system.comm;
    }
    outcome
}

/// Compressed to ρ = 0.995, far beyond confluence of the facets: every state converges and none crosses.
pub fn deep_compression(comm: Comm) -> Outcome {
    const THIN: f64 = 0.05;
    let species = polygon_species(20); // the fewest that four ranks can share
    let area: f64 = species.iter().map(|s| s.count as f64 * s.undeformed_area(THIN)).sum();
    let pbox = unit_box(0.0).with_area(area / 0.7);
    let (comm, polygons) = deformable_particles(comm, pbox, &species, 1, THIN, 0.0).unwrap();
    let usual = polygon_parameters();
    let k_area = 3.0 * usual.k_area;
    let parameters = DeformableParameters {
        k_area,
        contact: Harmonic { epsilon: 0.01 * k_area * species[1].size * species[1].size, delta: THIN },
        ..usual
    };
    let model = Deformable::<VertexEdge>::new(parameters);
    let mut system = System::new(comm, model, pbox, &pbox.with_area(area), polygons, 0.1).unwrap();
    let mut outcome = Vec::new();
    for density in [0.8, 0.85, 0.88, 0.9, 0.92, 0.94, 0.95, 0.96, 0.97, 0.98, 0.985, 0.99, 0.995] {
        let report = compress_to(&mut system, &Fire, &goal(1e-2, 1_000_000), density).unwrap();
        assert_eq!(check_no_crossing(&mut system).unwrap(), None, "at {density}");
        let (pressure, reached) = (system.energies().unwrap().pressure(), system.density().unwrap());
        println!("rho {reached:.5}: P {pressure:e}, max|F| {:e}, {} iterations", report.max_force, report.iterations);
        outcome.push(format!("{density} {} {report:?}", hex(&[pressure])));
    }
    // shells that overlap are counted twice, so that the density is near its aim and not at it
    assert!((system.density().unwrap() - 0.995).abs() < 5e-3);
    outcome.extend(describe(&mut system));
    outcome
}

/// At the onset, where modes are marginal: balanced to 10⁻¹³, isostatic when rattlers are left out, and no mode
/// negative; those of no stiffness are the two shifts and the motions of rattlers.
pub fn onset_itself(comm: Comm) -> Outcome {
    let mut system = random_sp(comm, 48, unit_box(0.0), 0.2, 0.95);
    let search = OnsetSearch { step: 0.01, smallest_step: 1e-12, pressure: [1e-10, 1e-8] };
    let found = find_onset(&mut system, &Fire, &goal(1e-13, 1_000_000), &search, |_, _, _| ()).unwrap();
    let residual = system.max_force().unwrap();
    assert!(residual <= 1e-13, "{residual}");
    let contacts = Contacts::of(&mut system, Rattlers::default()).unwrap();
    println!("{found:?}, {} rattlers, {} contacts, max|F| {residual:e}", contacts.n_rattlers, contacts.n_contacts);
    assert_eq!(contacts.n_contacts, 2 * contacts.n_backbone() - 1);
    let spectrum = Spectrum::of(&mut system).unwrap().unwrap();
    assert_eq!(spectrum.n_negative, 0);
    let mut outcome = vec![format!("{found:?} {} {}", contacts.n_contacts, contacts.n_rattlers)];
    if system.comm.is_root() {
        assert!(spectrum.n_zero >= 2, "{spectrum:?}");
        outcome.push(format!("{} modes of no stiffness", spectrum.n_zero));
    }
    outcome.extend(describe(&mut system));
    outcome
}

/// Two triangles of disks with an edge in common, a tail of two more and one alone: what counts as a rattler decides
/// how far the packing is taken apart.
pub fn rattlers(comm: Comm) -> Outcome {
    let pbox = PeriodicBox::square(EDGE);
    let at = [[4.0, 4.0], [4.9, 4.0], [4.45, 4.78], [5.35, 4.78], [6.25, 4.78], [7.15, 4.78], [1.0, 8.0]];
    let mut disks = Particles::empty(&Bodies::Disks);
    if comm.is_root() {
        at.iter().enumerate().for_each(|(id, &x)| disks.push(id as u32, 1.0, &[pbox.frac(x)]));
    }
    let mut system = System::new(comm, DISKS, pbox, &pbox, disks, 0.3).unwrap();
    for (fewer_than, left) in [(1, 6), (2, 4), (3, 0)] {
        let contacts = Contacts::of(&mut system, Rattlers { fewer_than }).unwrap();
        println!("fewer than {fewer_than}: {} rattlers, {} contacts", contacts.n_rattlers, contacts.n_contacts);
        assert_eq!(contacts.n_backbone(), left, "fewer than {fewer_than}");
    }
    describe(&mut system)
}

/// A state with crossed outlines is refused by name, wherever they cross.
pub fn crossed_outlines(mut comm: Comm) -> Outcome {
    let mut outcome = Vec::new();
    for at in [[0.0, 0.0], [0.5 * EDGE, 0.5 * EDGE], [2.0, 7.0]] {
        let polygons = [[3.0, 3.0], [0.0, 0.0], [0.9, 0.1]].map(|c: Vec2| square([at[0] + c[0], at[1] + c[1]], 0.5));
        let mut system = system::<VertexEdge>(comm, PeriodicBox::square(EDGE), &polygons);
        let crossing = check_no_crossing(&mut system).unwrap();
        assert_eq!(crossing, Some((1, 2)));
        let message = EngineError::Crossing(1, 2).to_string();
        assert!(message.contains("particles 1 and 2 cross"), "{message}");
        outcome.push(format!("{crossing:?} {message}"));
        comm = system.comm;
    }
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
