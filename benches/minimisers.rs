//! Work against error of the minimisers of deformable particles, in one run on one core: packings are compressed by a
//! small step and relaxed again, by Newton's method and by FIRE, from the same state.
//!
//! `cargo bench --bench minimisers` prints a table for 64 particles at four densities;
//! `cargo bench --bench minimisers -- paper 1024 0.01 200000 0.86,0.90` names preset, particles, step of the density,
//! the largest number of FIRE's steps and the densities. Work is CPU time over that of one force evaluation, measured
//! in the same run, so that factors of the Hessian and all else count at what they cost.

use jamhpc::comm::{Comm, Session};
use jamhpc::engine::System;
use jamhpc::geometry::PeriodicBox;
use jamhpc::minimize::{Fire, Goal, Minimizer, Newton, Report};
use jamhpc::model::{Deformable, DeformableParameters, Harmonic, VertexEdge};
use jamhpc::observe::{Contacts, Rattlers};
use jamhpc::profile::cpu_seconds;
use jamhpc::protocol::{Species, compress_to, deformable_particles};

type Packing = System<Deformable<VertexEdge>>;

const DELTA: f64 = 0.1;

fn main() {
    let asked: Vec<String> = std::env::args().skip(1).filter(|word| !word.starts_with("--")).collect();
    let word = |k: usize, default: &str| asked.get(k).cloned().unwrap_or(default.into());
    let preset = word(0, "paper");
    let stiffness = match &preset[..] {
        "paper" => 1.1,
        "fast" => 0.01,
        other => panic!("preset {other}: paper or fast"),
    };
    let n: u32 = word(1, "64").parse().expect("a number of particles");
    let step: f64 = word(2, "0.01").parse().expect("a step of the density");
    let limit: u64 = word(3, "200000").parse().expect("a number of steps");
    let densities = word(4, "0.86,0.90,0.95,0.98");

    rayon::ThreadPoolBuilder::new().num_threads(1).use_current_thread().build_global().expect("the first pool");
    let session = Session::start();
    let mut packing = dilute(session.world(), n, stiffness);
    // 10⁻¹² ε, where the forces of contacts are ε/δ times their overlap over δ
    let tight = 1e-12 * packing.model.parameters.contact.epsilon;
    println!("deformable particles, preset {preset}, N = {n}, one core, after a step of {step} in the density");
    println!("  rho  method   max|F|    forces      work     CPU s              U         p      z");
    for density in densities.split(',').map(|d| d.parse::<f64>().expect("densities")) {
        prepare(&mut packing, density - step, tight);
        let (pbox, start) = (*packing.pbox(), packing.own_particles());
        let fire = |tolerance: f64| Goal { force_tolerance: tolerance, max_iterations: limit };
        let (by_fire, fire_seconds) = timed(&mut packing, density, &Fire, &fire(1e-6));
        let cost = fire_seconds / by_fire.force_evaluations as f64;
        print(&mut packing, density, "fire", &by_fire, fire_seconds, cost);
        for tolerance in [1e-6, tight] {
            packing.restore(pbox, start.clone());
            let goal = Goal { force_tolerance: tolerance, max_iterations: 1_000_000 };
            let (report, seconds) = timed(&mut packing, density, &Newton, &goal);
            print(&mut packing, density, "newton", &report, seconds, cost);
        }
    }
}

/// Polygons at rho = 0.7, none crossing another, with half of the particles of each kind.
fn dilute(comm: Comm, n: u32, stiffness: f64) -> Packing {
    let small = (24.0f64 / 29.0).powi(2);
    let large = small * (17.0f64 / 12.0).powi(2);
    let species = [
        Species { count: n / 2, size: small, n_vertices: 12 },
        Species { count: n - n / 2, size: large, n_vertices: 17 },
    ];
    let k_area = 1000.0 / (small * small);
    let area: f64 = species.iter().map(|s| s.count as f64 * s.undeformed_area(DELTA)).sum();
    let at = |density: f64| PeriodicBox::square((area / density).sqrt());
    let (comm, polygons) = deformable_particles(comm, at(0.7), &species, 1, DELTA, 0.0).expect("a dilute start");
    let model = Deformable::new(DeformableParameters {
        line_tension: 1.0,
        k_area,
        contact: Harmonic { epsilon: stiffness * k_area * large * large, delta: DELTA },
        largest_area_per_vertex: large / 17.0,
    });
    System::new(comm, model, at(0.7), &at(0.995), polygons, 0.1).expect("a box that fits")
}

/// Compresses to `density` in small steps, the last state relaxed to `tolerance`.
fn prepare(packing: &mut Packing, density: f64, tolerance: f64) {
    let goal = |force_tolerance: f64| Goal { force_tolerance, max_iterations: 1_000_000 };
    loop {
        let next = (packing.density().expect("lists") + 0.01).min(density);
        if next == density {
            break;
        }
        compress_to(packing, &Newton, &goal(1e-3), next).expect("a state on the way");
    }
    compress_to(packing, &Newton, &goal(tolerance), density).expect("the state before the step");
}

fn timed(packing: &mut Packing, density: f64, minimizer: &impl Minimizer, goal: &Goal) -> (Report, f64) {
    let area = packing.own_area().expect("lists");
    packing.deform_rigidly(packing.pbox().with_area(area / density));
    let begin = cpu_seconds();
    let minimized = minimizer.minimize(packing, goal).expect("finite forces");
    (*minimized.report(), cpu_seconds() - begin)
}

fn print(packing: &mut Packing, density: f64, method: &str, report: &Report, seconds: f64, cost: f64) {
    let energies = packing.energies().expect("lists");
    let z = Contacts::of(packing, Rattlers::default()).expect("lists").contact_number();
    println!(
        "{density:5.2}  {method:6} {:9.1e} {:9} {:9.0} {seconds:9.2} {:14.8} {:9.4} {z:6.3}",
        report.max_force,
        report.force_evaluations,
        seconds / cost,
        energies.total,
        energies.pressure(),
    );
}
