//! Cost of one FIRE step and of one list build, and memory per particle: soft disks at φ = 0.86, relaxed first, and
//! deformable particles at ρ = 0.90; on one rank with one thread and with two, and on two ranks.
//!
//! `cargo bench --bench step` prints the table for 10⁴ and 10⁵ disks and 10⁴ polygons;
//! `cargo bench --bench step -- sp 1000000` or `-- dp 1000` one model and size.

use jamhpc::comm::{Comm, Session};
use jamhpc::engine::System;
use jamhpc::geometry::PeriodicBox;
use jamhpc::minimize::{Fire, Goal, Minimizer};
use jamhpc::model::{Deformable, DeformableParameters, Harmonic, Model, SoftDisks, VertexEdge};
use jamhpc::protocol::{Species, deformable_particles, random_disks};
use std::process::Command;
use std::time::Instant;

const STEPS: u64 = 300;
const REBUILDS: u32 = 10;

/// Ranks, and threads on each.
const STARTS: [[&str; 2]; 3] = [["1", "1"], ["1", "2"], ["2", "1"]];

fn main() {
    if let Ok(case) = std::env::var("JAMHPC_BENCH") {
        let [model, n, threads] = case.split(' ').collect::<Vec<_>>()[..] else { panic!("{case}?") };
        let [n, threads] = [n, threads].map(|number| number.parse::<u32>().expect("a number"));
        rayon::ThreadPoolBuilder::new()
            .num_threads(threads as usize)
            .use_current_thread()
            .build_global()
            .expect("the first pool");
        let session = Session::start();
        match model {
            "sp" => soft_disks(session.world(), n),
            _ => deformable(session.world(), n),
        }
        return;
    }
    let asked: Vec<String> = std::env::args().skip(1).filter(|word| !word.starts_with('-')).collect();
    let cases = match &asked[..] {
        [] => vec!["sp 10000".to_string(), "sp 100000".to_string(), "dp 10000".to_string()],
        words => words.chunks(2).map(|pair| pair.join(" ")).collect(),
    };
    println!("                                   ns per    ns per point              halo   peak bytes per");
    println!("model  ranks x threads    points  point-step  and rebuild  rebuilds  points   point and rank");
    let launcher = std::env::var("MPIRUN").unwrap_or_else(|_| "mpirun".into());
    for case in cases {
        for [ranks, threads] in STARTS {
            let me = std::env::current_exe().expect("own path");
            let status = Command::new(&launcher)
                .args(["-n", ranks])
                .arg(me)
                .env("JAMHPC_BENCH", format!("{case} {threads}"))
                .envs([("OMPI_ALLOW_RUN_AS_ROOT", "1"), ("OMPI_ALLOW_RUN_AS_ROOT_CONFIRM", "1")])
                .env("OMPI_MCA_hwloc_base_binding_policy", "none") // or both threads share a core
                .status();
            assert!(status.is_ok_and(|s| s.success()), "{launcher} -n {ranks} failed");
        }
    }
}

fn soft_disks(comm: Comm, n: u32) {
    let species =
        [Species { count: n / 2, size: 1.0, n_vertices: 1 }, Species { count: n - n / 2, size: 1.4, n_vertices: 1 }];
    let area: f64 = species.iter().map(|s| s.count as f64 * s.undeformed_area(0.0)).sum();
    let pbox = PeriodicBox::square((area / 0.86).sqrt());
    let disks = random_disks(&comm, &species, 1, |s| s.size);
    let model = SoftDisks { epsilon: 1.0, smallest: 1.0 };
    let mut system = System::new(comm, model, pbox, &pbox, disks, 0.3).expect("a box that fits");
    run(&mut system, 2000);
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
    measure("dp", &mut system);
}

fn run<M: Model>(system: &mut System<M>, steps: u64) {
    let goal = Goal { force_tolerance: 0.0, max_iterations: steps };
    let _ = Fire.minimize(system, &goal).expect("finite forces");
}

fn measure<M: Model>(model: &str, system: &mut System<M>) {
    run(system, 500);
    let rebuilds = system.counters.rebuilds;
    let stepping = timed(system, |system| run(system, STEPS));
    let rebuilds = system.counters.rebuilds - rebuilds;
    let pbox = *system.pbox();
    let rebuilding = timed(system, |system| {
        for _ in 0..REBUILDS {
            // the same particles in the same box, which the system cannot know
            let own = system.own_particles();
            system.restore(pbox, own);
            system.prepare().expect("a box that fits");
        }
    });
    let points = system.n_points() as f64;
    let ranks = system.comm.size();
    let peak = system.comm.max(peak_bytes());
    if system.comm.is_root() {
        println!(
            "{model:5}  {ranks:5} x {:<7} {points:9} {:11.1} {:12.1} {rebuilds:9} {:7} {:16.0}",
            rayon::current_num_threads(),
            stepping * 1e9 / (STEPS as f64 * points),
            rebuilding * 1e9 / (REBUILDS as f64 * points),
            system.halo_points().1,
            peak / (points / ranks as f64),
        );
    }
}

/// Seconds that it takes on the slowest rank.
fn timed<M: Model>(system: &mut System<M>, work: impl FnOnce(&mut System<M>)) -> f64 {
    system.comm.barrier();
    let start = Instant::now();
    work(system);
    system.comm.barrier();
    start.elapsed().as_secs_f64()
}

/// Peak resident memory of this process.
fn peak_bytes() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find(|l| l.starts_with("VmHWM"));
    line.and_then(|l| l.split_whitespace().nth(1)?.parse::<f64>().ok()).map_or(f64::NAN, |kib| kib * 1024.0)
}
