//! Cost of one FIRE step, list builds included, and memory: soft disks at φ = 0.86 and deformable particles at ρ = 0.90,
//! both in the first 500 steps from a random start or a compression, when points move far, and once 2000 steps have relaxed
//! them; cost of one list build; on one rank with one thread and with two, and on two ranks.
//!
//! `cargo bench --bench step` prints the table for 10⁴ and 10⁵ disks and 10⁴ polygons;
//! `cargo bench --bench step -- sp 1000000` or `-- dp 1000` one model and size.

mod systems;

use jamhpc::comm::Session;
use jamhpc::engine::System;
use jamhpc::model::Model;
use jamhpc::profile::peak_memory;
use std::process::Command;
use std::time::Instant;
use systems::{RELAXING, deformable, run, soft_disks};

/// Steps that are timed, at first and once relaxed.
const STEPS: u64 = 500;
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
            "sp" => measure("sp", &mut soft_disks(session.world(), n)),
            _ => measure("dp", &mut deformable(session.world(), n)),
        }
        return;
    }
    let asked: Vec<String> = std::env::args().skip(1).filter(|word| !word.starts_with('-')).collect();
    let cases = match &asked[..] {
        [] => vec!["sp 10000".to_string(), "sp 100000".to_string(), "dp 10000".to_string()],
        words => words.chunks(2).map(|pair| pair.join(" ")).collect(),
    };
    println!("                                   ns per point-step  rebuilds   ns per point    halo  peak bytes");
    println!("model  ranks x threads    points    first  relaxed  first  relaxed  and rebuild  points   per point");
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

fn measure<M: Model>(model: &str, system: &mut System<M>) {
    let stepping = |system: &mut System<M>| {
        let before = system.counters.rebuilds;
        let seconds = timed(system, |system| run(system, STEPS));
        (seconds * 1e9 / (STEPS * system.n_points()) as f64, system.counters.rebuilds - before)
    };
    let (at_first, first_rebuilds) = stepping(system);
    run(system, RELAXING - STEPS);
    let (relaxed, rebuilds) = stepping(system);
    let peak = system.comm.max(peak_memory());
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
    if system.comm.is_root() {
        println!(
            "{model:5}  {ranks:5} x {:<7} {points:9} {at_first:8.1} {relaxed:8.1} {first_rebuilds:6} {rebuilds:8} {:12.1} {:7} {:11.0}",
            rayon::current_num_threads(),
            rebuilding * 1e9 / (REBUILDS as f64 * points),
            system.halo_points().1,
            peak * ranks as f64 / points,
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
