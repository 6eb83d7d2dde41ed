//! The systems that are timed: soft disks at φ = 0.86, and deformable particles at ρ = 0.90 (fast preset), both from
//! random starts and not relaxed yet.

use jamhpc::comm::Comm;
use jamhpc::engine::System;
use jamhpc::geometry::PeriodicBox;
use jamhpc::minimize::{Fire, Goal, Minimizer};
use jamhpc::model::{Deformable, DeformableParameters, Harmonic, Model, SoftDisks, VertexEdge};
use jamhpc::protocol::{Species, deformable_particles, random_disks};

/// Soft disks at random places.
pub fn soft_disks(comm: Comm, n: u32) -> System<SoftDisks> {
    let species =
        [Species { count: n / 2, size: 1.0, n_vertices: 1 }, Species { count: n - n / 2, size: 1.4, n_vertices: 1 }];
    let area: f64 = species.iter().map(|s| s.count as f64 * s.undeformed_area(0.0)).sum();
    let pbox = PeriodicBox::square((area / 0.86).sqrt());
    let disks = random_disks(&comm, &species, 1, |s| s.size);
    let model = SoftDisks { epsilon: 1.0, smallest: 1.0 };
    System::new(comm, model, pbox, &pbox, disks, 0.3).expect("a box that fits")
}

/// Deformable particles, compressed from ρ = 0.7 with 100 steps at each of four densities on the way.
pub fn deformable(comm: Comm, n: u32) -> System<Deformable<VertexEdge>> {
    let small = (24.0f64 / 29.0).powi(2);
    let large = small * (17.0f64 / 12.0).powi(2);
    let species = [
        Species { count: n / 2, size: small, n_vertices: 12 },
        Species { count: n - n / 2, size: large, n_vertices: 17 },
    ];
    let (delta, k_area) = (0.1, 1000.0 / (small * small));
    let area: f64 = species.iter().map(|s| s.count as f64 * s.undeformed_area(delta)).sum();
    let at = |density: f64| PeriodicBox::square((area / density).sqrt());
    let (comm, polygons) = deformable_particles(comm, at(0.7), &species, 1, delta, 0.0).expect("a dilute start");
    let model = Deformable::<VertexEdge>::new(DeformableParameters {
        line_tension: 1.0,
        k_area,
        contact: Harmonic { epsilon: 0.01 * k_area * large * large, delta },
        largest_area_per_vertex: large / 17.0,
    });
    let mut system = System::new(comm, model, at(0.7), &at(0.9), polygons, 0.1).expect("a box that fits");
    for density in [0.74, 0.78, 0.82, 0.86] {
        system.deform_rigidly(at(density));
        run(&mut system, 100);
    }
    system.deform_rigidly(at(0.90));
    system
}

/// So many steps relax either: from then on points move as little as they do during most of a minimisation.
pub const RELAXING: u64 = 2000;

/// So many steps of FIRE.
pub fn run<M: Model>(system: &mut System<M>, steps: u64) {
    let goal = Goal { force_tolerance: 0.0, max_iterations: steps };
    let _ = Fire.minimize(system, &goal).expect("finite forces");
}
