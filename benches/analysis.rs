//! What it costs to measure a packing, against what it costs to make it: soft disks at φ = 0.86 on two ranks, minimised
//! from a random start to max|F| = 10⁻¹⁰ ε/σ, then ρ, voids, z and the elastic moduli; and the peak memory per particle
//! after each.
//!
//! `cargo bench --bench analysis` prints the table for 10⁵ disks, `cargo bench --bench analysis -- 1000000` for another
//! number.

use jamhpc::comm::{Comm, Session};
use jamhpc::engine::System;
use jamhpc::geometry::PeriodicBox;
use jamhpc::minimize::{ConjugateGradient, Goal, Minimizer};
use jamhpc::model::SoftDisks;
use jamhpc::observe::{Contacts, Moduli, PackingFraction, Rattlers, Shape, Voids};
use jamhpc::profile::peak_memory;
use jamhpc::protocol::{Species, random_disks};
use std::process::Command;
use std::time::Instant;

const DENSITY: f64 = 0.86;
const RANKS: &str = "2";
const GOAL: Goal = Goal { force_tolerance: 1e-10, max_iterations: 1_000_000 };

fn main() {
    if let Ok(n) = std::env::var("JAMHPC_BENCH") {
        let session = Session::start();
        return measure(session.world(), n.parse().expect("a number"));
    }
    let asked = std::env::args().skip(1).find(|word| !word.starts_with('-'));
    let launcher = std::env::var("MPIRUN").unwrap_or_else(|_| "mpirun".into());
    let status = Command::new(&launcher)
        .args(["-n", RANKS])
        .arg(std::env::current_exe().expect("own path"))
        .env("JAMHPC_BENCH", asked.unwrap_or_else(|| "100000".into()))
        .envs([("OMPI_ALLOW_RUN_AS_ROOT", "1"), ("OMPI_ALLOW_RUN_AS_ROOT_CONFIRM", "1")])
        .status();
    assert!(status.is_ok_and(|s| s.success()), "{launcher} -n {RANKS} failed");
}

fn measure(comm: Comm, n: u32) {
    let species =
        [Species { count: n / 2, size: 1.0, n_vertices: 1 }, Species { count: n - n / 2, size: 1.4, n_vertices: 1 }];
    let area: f64 = species.iter().map(|s| s.count as f64 * s.undeformed_area(0.0)).sum();
    let pbox = PeriodicBox::square((area / DENSITY).sqrt());
    let disks = random_disks(&comm, &species, 1, |s| s.size);
    let model = SoftDisks { epsilon: 1.0, smallest: 1.0 };
    let mut system = System::new(comm, model, pbox, &pbox, disks, 0.3).expect("a box that fits");
    if system.comm.is_root() {
        println!("what            seconds  bytes per particle and rank  result");
    }
    show(&mut system, "minimisation", |system| {
        let minimized = ConjugateGradient.minimize(system, &GOAL).expect("finite forces");
        assert!(minimized.is_converged(), "{minimized:?}");
        format!("{:?}", minimized.report())
    });
    let mut rho = 0.0;
    show(&mut system, "rho", |system| {
        let shapes: Vec<Shape> = system.outlines(Shape::of).expect("a box that fits");
        rho = PackingFraction::of(system, &shapes).expect("a box that fits").packing_fraction;
        format!("{rho:.15}")
    });
    show(&mut system, "voids", |system| {
        let voids = Voids::of(system, &[], Some(rho)).expect("voids that fill what is left");
        format!("{} with 3, 4, 5, 6, more sides: {:?}", voids.statistics.n_voids, voids.statistics.with_sides)
    });
    show(&mut system, "z", |system| {
        let contacts = Contacts::of(system, Rattlers::default()).expect("a box that fits");
        format!("{:.6}, {} rattlers", contacts.contact_number(), contacts.n_rattlers)
    });
    show(&mut system, "moduli", |system| {
        let m = Moduli::of(system).expect("a box that fits");
        format!(
            "G = {:.6}, K = {:.6}, {:?}, {} products, residual {:.0e}",
            m.shear_modulus.linear_response, m.bulk_modulus.linear_response, m.stability, m.products, m.residual
        )
    });
}

/// Does it, and prints seconds and peak memory of the slowest and of the largest rank.
fn show(system: &mut System<SoftDisks>, what: &str, work: impl FnOnce(&mut System<SoftDisks>) -> String) {
    system.comm.barrier();
    let start = Instant::now();
    let result = work(system);
    let seconds = system.comm.max(start.elapsed().as_secs_f64());
    let bytes = system.comm.max(peak_memory()) * system.comm.size() as f64 / system.n_particles() as f64;
    if system.comm.is_root() {
        println!("{what:<14} {seconds:8.2}  {bytes:27.0}  {result}");
    }
}
