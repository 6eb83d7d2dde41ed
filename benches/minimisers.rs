//! prototype
use jamhpc::comm::Session;
use jamhpc::engine::System;
use jamhpc::geometry::PeriodicBox;
use jamhpc::minimize::{Fire, Goal, Newton};
use jamhpc::model::{Model, Deformable, DeformableParameters, Harmonic, VertexEdge};
use jamhpc::protocol::{Species, deformable_particles, compress_to};
use std::time::Instant;

fn knob(name: &str, default: f64) -> f64 {
    std::env::var(name).ok().and_then(|v| v.parse().ok()).unwrap_or(default)
}

fn main() {
    let session = Session::start();
    let n = knob("N", 64.0) as u32;
    let stiffness = knob("STIFF", 1.1);
    let small = (24.0f64 / 29.0).powi(2);
    let large = small * (17.0f64 / 12.0).powi(2);
    let species = [
        Species { count: n / 2, size: small, n_vertices: 12 },
        Species { count: n - n / 2, size: large, n_vertices: 17 },
    ];
    let (delta, k_area) = (0.1, 1000.0 / (small * small));
    let area: f64 = species.iter().map(|s| s.count as f64 * s.undeformed_area(delta)).sum();
    let at = |density: f64| PeriodicBox::square((area / density).sqrt());
    let comm = session.world();
    let seed = knob("SEED", 1.0) as u64;
    let (comm, polygons) = deformable_particles(comm, at(0.7), &species, seed, delta).expect("a dilute start");
    let model = |stiffness: f64| Deformable::<VertexEdge>::new(DeformableParameters {
        line_tension: 1.0,
        k_area,
        contact: Harmonic { epsilon: stiffness * k_area * large * large, delta },
        largest_area_per_vertex: large / 17.0,
    });
    let mut system = System::new(comm, model(stiffness), at(0.7), &at(0.99), polygons, 0.1).expect("a box that fits");
    let goal = Goal { force_tolerance: knob("TOL", 4.4e-9), max_iterations: 1000000 };
    let (from, to, step) = (knob("FROM", 0.78), knob("TO", 0.96), knob("STEP", 0.01));
    let loose = Goal { force_tolerance: 0.1, max_iterations: 100000 };
    system.model = model(stiffness).softened(1e-3).unwrap();
    let mut density = 0.7;
    while density < from - 1e-9 {
        density = (density + 0.02f64).min(from);
        let _ = compress_to(&mut system, &Fire, &loose, density);
    }
    system.model = model(stiffness);
    while density < to + 1e-9 {
        let t = Instant::now();
        let out = compress_to(&mut system, &Newton, &goal, density);
        let p = system.energies().unwrap().pressure();
        let u = system.energies().unwrap().total;
        match out {
            Ok(r) => println!("rho {density:.4} p {p:.4e} U {u:.8} evals {} its {} F {:.1e} {:?}", r.force_evaluations, r.iterations, r.max_force, t.elapsed()),
            Err(e) => println!("rho {density:.4} p {p:.4e} {e} {:?}", t.elapsed()),
        }
        density += step;
    }
}
