//! Forces and stresses of every energy term against finite differences of the energy, in square and sheared boxes.

mod perturbed;

use jamhpc::comm::Comm;
use jamhpc::engine::{Energies, System};
use jamhpc::geometry::{PeriodicBox, Vec2, dot, norm, scale, sub};
use jamhpc::model::{Deformable, EdgeEdge, Harmonic, Model, SoftDisks, VertexEdge};
use jamhpc::particles::{Bodies, Particles};
use jamhpc::protocol::{Species, deformable_particles};
use perturbed::*;

/// Fourth-order central difference of f at 0.
fn derivative(step: f64, f: impl Fn(f64) -> f64) -> f64 {
    (8.0 * (f(step) - f(-step)) - (f(2.0 * step) - f(-2.0 * step))) / (12.0 * step)
}

fn energies<M: Model + Copy>(model: M, pbox: PeriodicBox, particles: &Particles) -> Energies {
    system(model, pbox, particles).energies().unwrap()
}

/// Compares all forces and the virial stress with differences of the energy over `step`. The kinks of the contact
/// terms are points of measure zero: a short step does not meet one.
fn check<M: Model + Copy>(model: M, pbox: PeriodicBox, particles: &Particles, step: f64) {
    let mut here = system(model, pbox, particles);
    let largest = here.max_force().unwrap();
    assert!(largest > 0.0, "nothing acts");
    let stored = here.own_particles();
    let forces = here.forces().to_vec();
    for (point, force) in forces.iter().enumerate() {
        for (axis, &component) in force.iter().enumerate() {
            let slope = derivative(step, |h| {
                let mut moved = stored.clone();
                let by = if axis == 0 { [h, 0.0] } else { [0.0, h] };
                moved.position[point] = pbox.moved(moved.position[point], by);
                energies(model, pbox, &moved).total
            });
            let error = (component + slope).abs();
            assert!(error <= 1e-8 * largest, "point {point}, axis {axis}: {component} against {}", -slope);
        }
    }
    let virial = here.energies().unwrap().virial;
    let size = virial.iter().fold(0.0, |m: f64, s| m.max(s.abs()));
    let (lx, ly, xy) = (pbox.lx(), pbox.ly(), pbox.xy());
    let strains: [(usize, &dyn Fn(f64) -> PeriodicBox); 3] = [
        (0, &|e| PeriodicBox::new(lx * (1.0 + e), ly, xy * (1.0 + e))),
        (1, &|e| PeriodicBox::new(lx, ly, xy + e * ly)),
        (3, &|e| PeriodicBox::new(lx, ly * (1.0 + e), xy)),
    ];
    for (component, strained) in strains {
        let slope = derivative(step, |e| energies(model, strained(e), &stored).total) / pbox.area();
        assert!((virial[component] + slope).abs() <= 1e-8 * size, "{component}: {} {}", virial[component], -slope);
    }
    assert!((virial[1] - virial[2]).abs() <= 1e-12 * size, "no torque: {} {}", virial[1], virial[2]);
}

#[test]
fn soft_disks() {
    for xy in [0.0, 2.3] {
        let (pbox, particles) = shaken(DISKS, 0.05, xy);
        check(SoftDisks { epsilon: 1.3, smallest: 1.0 }, pbox, &particles, 1e-5);
    }
}

#[test]
fn line_tension() {
    for (pbox, particles, delta) in deformable(0.0) {
        check(Deformable::<VertexEdge>::new(parameters(1.7, 0.0, 0.0, delta)), pbox, &particles, 1e-4);
    }
}

#[test]
fn area() {
    for (pbox, particles, delta) in deformable(0.0) {
        check(Deformable::<VertexEdge>::new(parameters(0.0, 300.0, 0.0, delta)), pbox, &particles, 1e-4);
    }
}

#[test]
fn vertex_edge_contacts() {
    for (pbox, particles, delta) in deformable(0.0) {
        check(Deformable::<VertexEdge>::new(parameters(0.0, 0.0, 50.0, delta)), pbox, &particles, 2e-6);
    }
}

#[test]
fn edge_edge_contacts() {
    for (pbox, particles, delta) in deformable_in_wide_boxes(0.7) {
        check(Deformable::<EdgeEdge>::new(parameters(0.0, 0.0, 50.0, delta)), pbox, &particles, 2e-6);
    }
}

#[test]
fn all_terms_together() {
    for (pbox, particles, delta) in deformable(0.0) {
        check(Deformable::<VertexEdge>::new(parameters(1.0, 300.0, 50.0, delta)), pbox, &particles, 5e-6);
    }
}

/// Distance of the point p from the segment a…a + u by the textbook formula, all relative to a.
fn distance(p: Vec2, u: Vec2) -> f64 {
    let t = (dot(p, u) / dot(u, u)).clamp(0.0, 1.0);
    norm(sub(p, scale(t, u)))
}

/// Both contact sums written out as they are defined, over all vertices and edges of all pairs.
#[test]
fn contact_energies_are_the_sums_that_define_them() {
    for (pbox, particles, delta) in deformable_in_wide_boxes(0.7) {
        let law = Harmonic { epsilon: 50.0, delta };
        let energy = |d: f64| if d < delta { law.energy(d) } else { 0.0 };
        // (start, vector) of every edge, by particle
        let edges: Vec<Vec<_>> = (0..particles.len())
            .map(|p| {
                let points = particles.points_of(p);
                let n = points.len();
                (0..n).map(|i| (points[i], pbox.displacement(points[(i + 1) % n], points[i]))).collect()
            })
            .collect();
        let (mut vertex_edge, mut edge_edge) = (0.0, 0.0);
        for m in 0..edges.len() {
            for n in (0..edges.len()).filter(|&n| n != m) {
                for &(a, u) in &edges[m] {
                    for &(b, v) in &edges[n] {
                        let from_a = pbox.displacement(b, a);
                        vertex_edge += energy(distance(from_a, u)) - energy(norm(from_a));
                        let from_b = scale(-1.0, from_a);
                        let ends = [
                            distance(from_a, u),
                            distance([from_a[0] + v[0], from_a[1] + v[1]], u),
                            distance(from_b, v),
                            distance([from_b[0] + u[0], from_b[1] + u[1]], v),
                        ];
                        // each pair of particles comes twice
                        edge_edge += 0.5 * energy(ends.into_iter().fold(f64::INFINITY, f64::min));
                    }
                }
            }
        }
        let close = |x: f64, y: f64| (x - y).abs() <= 1e-12 * y && y > 0.0;
        let constants = parameters(0.0, 0.0, 50.0, delta);
        let e = energies(Deformable::<VertexEdge>::new(constants), pbox, &particles).contact;
        assert!(close(e, vertex_edge), "{e} {vertex_edge}");
        let e = energies(Deformable::<EdgeEdge>::new(constants), pbox, &particles).contact;
        assert!(close(e, edge_edge), "{e} {edge_edge}");
    }
}

/// What forces accelerate along the growth of a particle that reaches around the boundary is what it is elsewhere.
#[test]
fn growth_is_known_where_a_particle_is_wider_than_half_the_box() {
    let model = Deformable::<VertexEdge>::new(parameters(1.0, 300.0, 0.5, 0.2));
    let outline = [[0.4, 1.0], [1.35, 1.0], [2.3, 1.0], [2.3, 2.0], [1.35, 2.0], [0.4, 2.0]];
    let of = |pbox: PeriodicBox| {
        let mut particles = Particles::empty(&Bodies::Polygons { first: vec![0] });
        particles.push(0, 1.9, &outline.map(|corner| pbox.frac(corner)));
        let mut system = system(model, pbox, &particles);
        system.max_force().unwrap();
        let mut gradient = vec![[0.0; 2]; 6];
        model.area_stiffness(&system.view(), 0, &mut gradient);
        let mut accelerated = gradient.clone();
        model.accelerate(&system.view(), 0..1, &gradient, &mut accelerated);
        (gradient, accelerated)
    };
    let (gradient, elsewhere) = of(PeriodicBox::square(10.0));
    assert!(norm(elsewhere[0]) < 0.5 * norm(gradient[0]), "it is slowed down");
    for (a, b) in of(PeriodicBox::new(3.15, 5.0, 0.3)).1.iter().zip(&elsewhere) {
        assert!(norm(sub(*a, *b)) < 1e-12, "{a:?} {b:?}");
    }
}

/// The forces that minimisers use leave out contributions that cancel and pairs that cannot touch; the sums over all
/// touches leave out nothing.
#[test]
fn forces_are_the_sums_over_all_touches() {
    forces_of_contacts_are_the_sums_over_all(50.0, 0.0);
    // the growth of particles is slowed down where contacts are soft, and what areas are rounded to is more than they push
    forces_of_contacts_are_the_sums_over_all(0.5, 300.0 * 1.4 * f64::EPSILON);
}

fn forces_of_contacts_are_the_sums_over_all(epsilon: f64, rounding: f64) {
    let species = [(12, 0.7), (17, 1.4)].map(|(n_vertices, size)| Species { count: 32, size, n_vertices });
    let dilute = PeriodicBox::new(10.0, 10.0, 2.0);
    let (comm, polygons) = deformable_particles(Comm::alone(), dilute, &species, 1, 0.1, 0.0).unwrap();
    let model = Deformable::<VertexEdge>::new(parameters(1.0, 300.0, epsilon, 0.2));
    let dense = PeriodicBox::new(9.7, 9.7, 1.5);
    let mut system = System::new(comm, model, dilute, &dense, polygons, 0.1).unwrap();
    system.deform_rigidly(dense);
    system.carry(1);
    let n = system.particles().len();
    for step in 0..50 {
        let limit = (1e-14 * system.max_force().unwrap()).max(rounding);
        let view = system.view();
        let (mut right, mut accelerations) = (system.forces().to_vec(), system.forces().to_vec());
        model.forces(&view, 0..n, &mut right);
        model.accelerate(&view, 0..n, &right, &mut accelerations);
        for chunk in system.chunks() {
            let touching = view.lists.narrowed(chunk.particles.start).unwrap();
            let all = chunk.particles.clone().all(|p| touching.of(p).is_some());
            assert!(all, "no particle reaches around the box");
        }
        for (made, right) in [(system.forces(), &right), (system.accelerations(), &accelerations)] {
            for (point, (f, g)) in made.iter().zip(right).enumerate() {
                assert!(norm(sub(*f, *g)) < limit, "step {step}, point {point}: {f:?} and {g:?}");
            }
        }
        // steps of changing length, so that pairs are picked anew now and then
        let by = 4e-4 * (1 + step % 3) as f64;
        system.move_points(1.5 * by, |pbox, positions, _, _| {
            for (k, point) in positions.iter_mut().enumerate() {
                *point = pbox.moved(*point, [by * noise(100 * step + 2 * k), by * noise(100 * step + 2 * k + 1)]);
            }
        });
    }
    let narrowings = system.counters.narrowings;
    assert!(narrowings > 2 && narrowings < 25, "{narrowings}");
}
