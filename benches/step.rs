//! Cost of one FIRE step, lists and reductions included, and memory per particle: soft disks at φ = 0.86 on 1 and 2
//! ranks, and deformable particles relaxed at ρ = 0.90, 64, 1024 and DP_N of them, the last also on 2 ranks (one thread
//! each).
//!
//! `cargo bench --bench step` prints the table; `cargo bench --bench step -- SP_N DP_N` takes other sizes.

use jamhpc::comm::{Comm, Session};
use jamhpc::engine::System;
use jamhpc::geometry::PeriodicBox;
use jamhpc::minimize::{Fire, Goal, Minimizer};
use jamhpc::model::{Deformable, DeformableParameters, Harmonic, Model, SoftDisks, VertexEdge};
use jamhpc::protocol::{Species, deformable_particles, random_disks};
use std::process::Command;
use std::time::Instant;

const STEPS: u64 = 300;

fn main() {
    let sizes: Vec<u32> = std::env::args().filter_map(|a| a.parse().ok()).collect();
    let (disks, polygons) = (sizes.first().copied().unwrap_or(100_000), sizes.get(1).copied().unwrap_or(10_000));
    if let Ok(case) = std::env::var("JAMHPC_BENCH") {
        rayon::ThreadPoolBuilder::new().num_threads(1).build_global().expect("the first pool");
        let session = Session::start();
        match case.as_str() {
            "sp" => soft_disks(session.world(), disks),
            _ => deformable(session.world(), polygons),
        }
        return;
    }
    println!(
        "model  ranks        N   points  ns per point-step  rebuilds  halo points  bytes per point (peak, per rank)"
    );
    let launcher = std::env::var("MPIRUN").unwrap_or_else(|_| "mpirun".into());
    let start = |case: &str, ranks: &str, polygons: u32| {
        let me = std::env::current_exe().expect("own path");
        let status = Command::new(&launcher)
            .args(["-n", ranks])
            .arg(me)
            .args([disks.to_string(), polygons.to_string()])
            .env("JAMHPC_BENCH", case)
            .envs([("OMPI_ALLOW_RUN_AS_ROOT", "1"), ("OMPI_ALLOW_RUN_AS_ROOT_CONFIRM", "1")])
            .status();
        assert!(status.is_ok_and(|s| s.success()), "{launcher} -n {ranks} failed");
    };
    for ranks in ["1", "2"] {
        start("sp", ranks, polygons);
    }
    for polygons in [64, 1024, polygons] {
        start("dp", "1", polygons);
    }
    start("dp", "2", polygons);
}

fn soft_disks(comm: Comm, n: u32) {
    let species =
        [Species { count: n / 2, size: 1.0, n_vertices: 1 }, Species { count: n - n / 2, size: 1.4, n_vertices: 1 }];
    let area: f64 = species.iter().map(|s| s.count as f64 * s.undeformed_area(0.0)).sum();
    let pbox = PeriodicBox::square((area / 0.86).sqrt());
    let disks = random_disks(&comm, &species, 1, |s| s.size);
    let model = SoftDisks { epsilon: 1.0, smallest: 1.0 };
    let mut system = System::new(comm, model, pbox, &pbox, disks, 0.3).expect("a box that fits");
    measure("sp", &mut system);
}

fn deformable(comm: Comm, n: u32) {
    let small = (24.0f64 / 29.0).powi(2);
    let large = small * (17.0f64 / 12.0).powi(2);
    let species = [
        Species { count: n / 2, size: small, n_vertices: 12 },
        Species { count: n - n / 2, size: large, n_vertices: 17 },
    ];
    let (delta, k_area) = (0.1, 1000.0 / (small * small));
    let area: f64 = species.iter().map(|s| s.count as f64 * s.undeformed_area(delta)).sum();
    let at = |density: f64| PeriodicBox::square((area / density).sqrt());
    let (comm, polygons) = deformable_particles(comm, at(0.7), &species, 1, delta).expect("a dilute start");
    let model = Deformable::<VertexEdge>::new(DeformableParameters {
        line_tension: 1.0,
        k_area,
        contact: Harmonic { epsilon: 0.01 * k_area * large * large, delta },
        largest_area_per_vertex: large / 17.0,
    });
    let mut system = System::new(comm, model, at(0.7), &at(0.9), polygons, 0.1).expect("a box that fits");
    for density in [0.74, 0.78, 0.82, 0.86, 0.90] {
        system.deform_rigidly(at(density));
        run(&mut system, 100);
    }
    relaxed(&mut system);
}

/// Steps of a packing that has relaxed for 1000 steps (fewer where it is large): the time of each per vertex, and what list builds cost.
fn relaxed<M: Model>(system: &mut System<M>) {
    let (particles, points, ranks) = (system.n_particles(), system.n_points(), system.comm.size());
    run(system, (200_000_000 / points).min(1000));
    let steps = (3_000_000 / points).clamp(200, 20_000);
    let before = system.counters;
    let peak = system.comm.max(peak_bytes());
    // other processes disturb: the median of five
    let mut times = [(); 5].map(|()| seconds(system, |system| run(system, steps / 5)));
    times.sort_by(f64::total_cmp);
    let stepping = times[2];
    let after = system.counters;
    let builds = (1_000_000 / points).clamp(2, 500);
    let building = seconds(system, |system| {
        for _ in 0..builds {
            let (pbox, own) = (*system.pbox(), system.own_particles());
            system.restore(pbox, own);
            system.prepare().expect("a box that fits");
        }
    });
    let per_point = |seconds: f64, times: u64| seconds * 1e9 / (times * points) as f64 * ranks as f64;
    if system.comm.is_root() {
        println!(
            "dp     {ranks:5} {particles:8} {points:8} {:18.1} {:9} {:12} {:16.0}   {:.0} ns per point and list build, {} narrowings in {steps} steps",
            per_point(stepping, steps / 5),
            after.rebuilds - before.rebuilds,
            system.halo_points().1,
            peak / (points as f64 / ranks as f64),
            per_point(building, builds),
            after.narrowings - before.narrowings,
        );
    }
}

fn seconds<M: Model>(system: &mut System<M>, work: impl FnOnce(&mut System<M>)) -> f64 {
    system.comm.barrier();
    let start = Instant::now();
    work(system);
    system.comm.barrier();
    start.elapsed().as_secs_f64()
}

fn run<M: Model>(system: &mut System<M>, steps: u64) {
    let goal = Goal { force_tolerance: 0.0, max_iterations: steps };
    let _ = Fire.minimize(system, &goal).expect("finite forces");
}

fn measure<M: Model>(model: &str, system: &mut System<M>) {
    run(system, 500);
    let rebuilds = system.counters.rebuilds;
    system.comm.barrier();
    let start = Instant::now();
    run(system, STEPS);
    system.comm.barrier();
    let seconds = start.elapsed().as_secs_f64();
    let (particles, points) = (system.n_particles(), system.n_points());
    let ranks = system.comm.size();
    let peak = system.comm.max(peak_bytes());
    if system.comm.is_root() {
        println!(
            "{model:5}  {ranks:5} {particles:8} {points:8} {:18.1} {:9} {:12} {:16.0}",
            seconds * 1e9 / (STEPS * points) as f64 * ranks as f64,
            system.counters.rebuilds - rebuilds,
            system.halo_points().1,
            peak / (points as f64 / ranks as f64),
        );
    }
}

/// Peak resident memory of this process.
fn peak_bytes() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find(|l| l.starts_with("VmHWM"));
    line.and_then(|l| l.split_whitespace().nth(1)?.parse::<f64>().ok()).map_or(f64::NAN, |kib| kib * 1024.0)
}
