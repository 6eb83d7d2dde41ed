//! One measurement of a scaling study, and its table and plot; `scripts/scaling` and `jobs/scaling.slurm` start it.
//!
//!   mpirun -n RANKS scaling measure strong|weak sp|dp PARTICLES THREADS      one line of CSV from rank 0
//!   scaling header                                                           the line before them
//!   scaling predict                                                          the model of docs/performance.md
//!   scaling summary FILE.csv PLOT.svg                                        efficiencies, as a table and a plot

mod systems;

use jamhpc::comm::Session;
use jamhpc::engine::System;
use jamhpc::model::Model;
use jamhpc::output::plot::{Axes, Series, panels};
use jamhpc::profile::{self, Count, Phase};
use std::collections::BTreeMap;
use std::time::Instant;
use systems::{RELAXING, deformable, run, soft_disks};

const HEADER: &str = "study,model,particles,ranks,threads,points,us_per_step,forces_us,halo_us,reductions_us,\
                      halo_bytes_per_step,halo_messages_per_step,collectives_per_step,rebuilds,peak_bytes_per_point";
/// Each this many steps; the median counts.
const REPEATS: usize = 5;
const STEPS: u64 = 100;

fn main() {
    let words: Vec<String> = std::env::args().skip(1).filter(|word| word != "--bench").collect();
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    match words[..] {
        ["header"] => println!("{HEADER}"),
        ["predict"] => predict(),
        ["summary", csv, plot] => summary(csv, plot),
        ["measure", study, model, particles, threads] => {
            let n: u32 = particles.parse().expect("a number of particles");
            let threads: usize = threads.parse().expect("a number of threads");
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).use_current_thread();
            pool.build_global().expect("the first pool");
            let session = Session::start();
            match model {
                "sp" => measure(study, model, n, &mut soft_disks(session.world(), n)),
                "dp" => measure(study, model, n, &mut deformable(session.world(), n)),
                _ => panic!("{model} is neither sp nor dp"),
            }
        }
        _ => println!("scripts/scaling starts this program"),
    }
}

fn measure<M: Model>(study: &str, model: &str, n: u32, system: &mut System<M>) {
    run(system, RELAXING);
    let rebuilds = system.counters.rebuilds;
    profile::start();
    let times: Vec<f64> = (0..REPEATS)
        .map(|_| {
            system.comm.barrier();
            let start = Instant::now();
            run(system, STEPS);
            system.comm.max(start.elapsed().as_secs_f64() * 1e6 / STEPS as f64)
        })
        .collect();
    let (seconds, counts) = (profile::seconds(), profile::counts());
    let steps = counts[Count::Steps as usize];
    let ranks = system.comm.size() as f64;
    // means over ranks
    let mean =
        |x: f64| system.comm.all_gather(&[x.to_bits()]).iter().map(|r| f64::from_bits(r[0])).sum::<f64>() / ranks;
    let phase = |which: Phase| {
        let k = Phase::ALL.iter().position(|&p| p == which).expect("all are there");
        mean(seconds[k] * 1e6 / steps)
    };
    let count = |which: Count| mean(counts[which as usize] / steps);
    let points = system.n_points();
    let row = [
        median_and_least(&times)[0],
        phase(Phase::Forces),
        phase(Phase::Halo),
        phase(Phase::Reductions),
        count(Count::HaloBytes),
        count(Count::HaloMessages),
        count(Count::Collectives),
        (system.counters.rebuilds - rebuilds) as f64,
        system.comm.max(profile::peak_memory()) * ranks / points as f64,
    ];
    if system.comm.is_root() {
        let row: Vec<String> = row.iter().map(|x| format!("{x:.3}")).collect();
        let threads = rayon::current_num_threads();
        println!("{study},{model},{n},{},{threads},{points},{}", system.comm.size(), row.join(","));
    }
}

/// What a step costs on a rank with so many points, by the model of docs/performance.md.
struct Cost {
    name: &'static str,
    /// Seconds for each own point.
    per_point: f64,
    /// Points of a particle.
    points: f64,
    /// Bytes that a rank sends, over the square root of its number of particles.
    halo_bytes: f64,
}

const COSTS: [Cost; 2] = [
    Cost { name: "dp", per_point: 28e-9, points: 14.5, halo_bytes: 410.0 },
    Cost { name: "sp", per_point: 25e-9, points: 1.0, halo_bytes: 62.0 },
];
/// Of a network: seconds from rank to rank, seconds a rank is busy with a message, bytes a second.
const LATENCY: f64 = 2e-6;
const OVERHEAD: f64 = 0.5e-6;
const BANDWIDTH: f64 = 10e9;

fn predict() {
    println!("model  points a rank  halo bytes   halo us  efficiency on 100, 1000, 10000 ranks  1 us less latency");
    for Cost { name, per_point, points, halo_bytes } in COSTS {
        for n in [500.0, 1000.0, 2000.0, 5000.0, 10_000.0, 50_000.0f64] {
            let bytes = halo_bytes * (n / points).sqrt();
            let halo = |latency: f64| latency + 2.0 * 8.0 * OVERHEAD + bytes / BANDWIDTH;
            let efficiency = |ranks: f64, latency: f64| {
                // a reduction climbs a tree, and its answer comes back with it (recursive doubling)
                let work = per_point * n;
                work / (work + halo(latency) + ranks.log2() * latency)
            };
            println!(
                "{name:<5}{n:>15}{bytes:>12.0}{:>10.1}{:>13.2}{:>10.2}{:>10.2}{:>22.2}",
                1e6 * halo(LATENCY),
                efficiency(1e2, LATENCY),
                efficiency(1e3, LATENCY),
                efficiency(1e4, LATENCY),
                efficiency(1e4, LATENCY - 1e-6),
            );
        }
    }
}

/// For each number of cores particles and the times that were measured, which is more than one with REPEATS.
type Curve = BTreeMap<u64, (u64, Vec<f64>)>;

/// What counts of several times, and what other load on the machine has lengthened least.
fn median_and_least(times: &[f64]) -> [f64; 2] {
    let mut times = times.to_vec();
    times.sort_by(f64::total_cmp);
    [times[times.len() / 2], times[0]]
}

fn summary(csv: &str, plot: &str) {
    let text = std::fs::read_to_string(csv).unwrap_or_else(|e| panic!("{csv}: {e}"));
    let mut curves: BTreeMap<(String, String), Curve> = BTreeMap::new();
    for line in text.lines().skip(1) {
        let cells: Vec<&str> = line.split(',').collect();
        let [study, model, particles, ranks, threads, _, time, ..] = cells[..] else { panic!("{csv}: {line}") };
        let whole = |cell: &str| cell.parse::<u64>().unwrap_or_else(|e| panic!("{csv}: {cell}: {e}"));
        let (n, ranks, threads) = (whole(particles), whole(ranks), whole(threads));
        let time: f64 = time.parse().unwrap_or_else(|e| panic!("{csv}: {time}: {e}"));
        let size = if study == "weak" { n / (ranks * threads) } else { n };
        let name = format!("{model}, {size}{}, {threads} thread(s)", if study == "weak" { " a core" } else { "" });
        let curve = curves.entry((study.into(), name)).or_default();
        curve.entry(ranks * threads).or_insert((n, Vec::new())).1.push(time);
    }
    println!("{:72}medians, and least of repeated measurements", "");
    println!(
        "{:<8}{:<36}{:>8}{:>12}{:>14}{:>12}{:>14}{:>12}",
        "study", "curve", "cores", "particles", "us per step", "efficiency", "us per step", "efficiency"
    );
    let alone = |study: &str, name: &str| -> Option<[f64; 2]> {
        let size = name.rsplit_once(", ").map_or(name, |(size, _)| size);
        let one = curves.get(&(study.to_string(), format!("{size}, 1 thread(s)")))?;
        one.get(&1).map(|(_, times)| median_and_least(times))
    };
    let mut axes: Vec<Axes> = Vec::new();
    for study in ["strong", "weak"] {
        let mut series = Vec::new();
        for ((_, name), curve) in curves.iter().filter(|((s, _), _)| s == study) {
            let Some(one) = alone(study, name) else { continue };
            let efficiency = |cores: u64, times: [f64; 2]| {
                let cores = if study == "weak" { 1.0 } else { cores as f64 };
                [0, 1].map(|k| one[k] / (times[k] * cores))
            };
            let mut points = Vec::new();
            for (&cores, (n, times)) in curve {
                let times = median_and_least(times);
                let [efficiency, of_least] = efficiency(cores, times);
                println!(
                    "{study:<8}{name:<36}{cores:>8}{n:>12}{:>14.1}{efficiency:>12.3}{:>14.1}{of_least:>12.3}",
                    times[0], times[1]
                );
                points.push([cores as f64, efficiency]);
            }
            series.push(Series { name: name.clone(), points, error: None, line: true, style: None });
        }
        series.push(Series { name: "ideal".into(), points: ideal(&series), error: None, line: true, style: None });
        axes.push(Axes {
            title: format!("{study} scaling"),
            x_label: "cores".into(),
            y_label: "efficiency".into(),
            log_x: true,
            log_y: false,
            series,
        });
    }
    std::fs::write(plot, panels(&axes, 2).to_svg()).unwrap_or_else(|e| panic!("{plot}: {e}"));
}

fn ideal(series: &[Series]) -> Vec<[f64; 2]> {
    let most = series.iter().flat_map(|s| &s.points).map(|p| p[0]).fold(1.0, f64::max);
    vec![[1.0, 1.0], [most, 1.0]]
}
