//! Do minimisers end in the same packings? Many random packings are compressed along the same densities by each of them,
//! and single steps are made by all of them from one state. `scripts/basins` starts this program with the folder of its
//! results, which must be there, the number of packings, and max|F| where they begin to jam; ranks share the packings.
//! Each is written when it is done, so that a program that was stopped goes on where it was.

use jamhpc::comm::{Comm, Session};
use jamhpc::engine::System;
use jamhpc::failure::Failure;
use jamhpc::minimize::{ConjugateGradient, Fire, Goal, Minimizer, Newton, Report};
use jamhpc::model::Model;
use jamhpc::observe::{Moduli, Rattlers, Sample, check_no_crossing};
use jamhpc::profile::cpu_seconds;
use jamhpc::protocol::{ProtocolError, compress_to};
use jamhpc::run::{Task, with_system};
use jamhpc::scene::Scene;
use jamhpc::statistics::{mean, spread};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

const SCENE: &str = "model = 'dp'\nn_particles = 64\ninitial.packing_fraction = 0.7";

/// Ways from the random start to the densest state: a minimiser, and what its steps are divided by. The first is the
/// reference, as close to overdamped motion as can be had.
const WAYS: [(&str, &str, f64); 3] =
    [("fire in small steps", "fire", 4.0), ("fire", "fire", 1.0), ("newton", "newton", 1.0)];
/// Minimisers that make the same steps from one state.
const METHODS: [&str; 3] = ["fire", "cg", "newton"];
/// Densities to which compression goes, and by which steps; small ones where packings begin to jam.
const STAGES: [(f64, f64); 3] = [(0.82, 0.01), (0.86, 0.0025), (0.95, 0.01)];
/// The stage in which packings begin to jam.
const ONSET: usize = 1;
/// Where states are measured, and relaxed for that.
const MEASURED: [f64; 2] = [0.90, 0.95];
/// The last step to them when it is made from one state.
const LAST: f64 = 0.01;
/// What is measured there.
const NAMES: [&str; 5] = ["U", "p", "z", "A", "G"];
/// A packing counts as jammed from where its pressure passes through this, in γ/l.
const JAMMED: f64 = 1e-2;
/// max|F| in γ where states are measured, and on the way; where packings begin to jam it is an argument.
const EXACT: f64 = 1e-8;
const COARSE: f64 = 1e-4;
const MAX_ITERATIONS: u64 = 10_000_000;
/// Two minima whose energies differ by less than this part of them are one.
const ONE_MINIMUM: f64 = 1e-9;

/// One packing on one way: its number, that of the way, crossed outlines met, CPU time, the density where it jams, and
/// what is measured; NaN from where a state did not come to force balance.
const ROW: usize = 5 + MEASURED.len() * NAMES.len();
type Row = [f64; ROW];
/// One state relaxed by each of [`METHODS`]: packing, density, energies.
const STEP: usize = 2 + METHODS.len();
type Step = [f64; STEP];

fn main() {
    let words: Vec<String> = std::env::args().skip(1).filter(|word| !word.starts_with('-')).collect();
    let [out, packings, forces] = words.as_slice() else {
        println!("scripts/basins starts this program");
        return;
    };
    let packings: u64 = packings.parse().expect("the number of packings");
    let forces: f64 = forces.parse().expect("max|F| where packings begin to jam");
    let session = Session::start();
    let world = session.world();
    let out = Path::new(out);
    for seed in (1..=packings).filter(|seed| seed % world.size() as u64 == world.rank() as u64) {
        if read(&file(out, seed, forces)).is_none() {
            write(&file(out, seed, forces), compress(seed, forces));
            eprintln!("packing {seed}");
        }
    }
    world.barrier();
    if world.is_root() {
        let all = (1..=packings).map(|seed| read(&file(out, seed, forces)).expect("all packings are there"));
        let (rows, steps): (Vec<[Row; WAYS.len()]>, Vec<[Step; MEASURED.len()]>) = all.unzip();
        let (rows, steps) = (rows.concat(), steps.concat());
        let columns = MEASURED.map(|density| NAMES.map(|name| format!("{name}_{density}"))).concat().join(",");
        let mut text = format!("packing,way,crossed,cpu_seconds,rho_jammed,{columns}\n");
        for row in &rows {
            write!(text, "{},{},", row[0], WAYS[row[1] as usize].0).expect("a string takes all");
            line(&mut text, &row[2..]);
        }
        std::fs::write(out.join("ways.csv"), text).expect("the folder takes files");
        let mut text = String::from("packing,density,U_fire,U_cg,U_newton\n");
        steps.iter().for_each(|row| line(&mut text, row));
        std::fs::write(out.join("steps.csv"), text).expect("the folder takes files");
        report(&rows, &steps);
    }
}

/// One packing on all ways, and its single steps.
type Packing = ([Row; WAYS.len()], [Step; MEASURED.len()]);

fn compress(seed: u64, forces: f64) -> Packing {
    let (mut rows, mut steps) = (Vec::new(), Vec::new());
    for way in 0..WAYS.len() {
        let scene = Scene::parse(SCENE, "basins", &[format!("seed={seed}")]).unwrap_or_else(|e| panic!("{e}"));
        let task = Compress { seed, way, forces, rows: &mut rows, steps: &mut steps };
        with_system(Comm::alone(), &scene, task).unwrap_or_else(|e| panic!("packing {seed}: {e}"));
    }
    // Newton's way may end before its single steps are made.
    steps.resize(MEASURED.len(), [f64::NAN; STEP]);
    (rows.try_into().expect("a row a way"), steps.try_into().expect("a step a density"))
}

fn file(out: &Path, seed: u64, forces: f64) -> PathBuf {
    out.join(format!("packing-{seed}-{forces:e}.csv"))
}

fn write(path: &Path, (rows, steps): Packing) {
    let mut text = String::new();
    rows.iter().for_each(|row| line(&mut text, row));
    steps.iter().for_each(|step| line(&mut text, step));
    std::fs::write(path, text).expect("the folder takes files");
}

/// A packing that was written whole.
fn read(path: &Path) -> Option<Packing> {
    let text = std::fs::read_to_string(path).ok().filter(|text| text.ends_with('\n'))?;
    let numbers = |line: &str| line.split(',').map(|word| word.parse().ok()).collect::<Option<Vec<f64>>>();
    let lines: Vec<Vec<f64>> = text.lines().map(numbers).collect::<Option<_>>()?;
    let (rows, steps) = lines.split_at_checked(WAYS.len())?;
    let rows: Vec<Row> = rows.iter().map(|row| row.as_slice().try_into().ok()).collect::<Option<_>>()?;
    let steps: Vec<Step> = steps.iter().map(|step| step.as_slice().try_into().ok()).collect::<Option<_>>()?;
    Some((rows.try_into().ok()?, steps.try_into().ok()?))
}

struct Compress<'a> {
    seed: u64,
    way: usize,
    /// max|F| where packings begin to jam.
    forces: f64,
    rows: &'a mut Vec<Row>,
    steps: &'a mut Vec<Step>,
}

impl Task for Compress<'_> {
    fn act<M: Model>(self, mut system: System<M>, _: &impl Minimizer) -> Result<(), Failure> {
        let (_, method, divisor) = WAYS[self.way];
        let mut row = [f64::NAN; ROW];
        (row[0], row[1], row[2]) = (self.seed as f64, self.way as f64, 0.0);
        let mut last = [system.density()?, 0.0]; // density and pressure
        let mut density = last[0];
        let begin = cpu_seconds();
        for (stage, (end, step)) in STAGES.into_iter().enumerate() {
            let coarse = if stage == ONSET { self.forces } else { COARSE };
            while density < end - 1e-9 {
                density = (density + step / divisor).min(end);
                let measured = MEASURED.iter().position(|m| (density - m).abs() < 1e-9);
                let goal = goal(if measured.is_some() { EXACT } else { coarse });
                if measured.is_some() && method == "newton" {
                    let energies = self.after_one_state(&mut system, density)?;
                    self.steps.push([vec![self.seed as f64, density], energies].concat().try_into().expect("a step"));
                }
                match by(method, &mut system, &goal, density) {
                    Err(ProtocolError::Unconverged { .. }) => {
                        self.rows.push(row);
                        return Ok(());
                    }
                    done => done?,
                };
                row[2] += f64::from(u8::from(check_no_crossing(&mut system)?.is_some()));
                let now = [system.density()?, system.energies()?.pressure()];
                if row[4].is_nan() && now[1] >= JAMMED {
                    let part = (JAMMED - last[1]) / (now[1] - last[1]);
                    row[4] = last[0] + part * (now[0] - last[0]);
                }
                last = now;
                if let Some(k) = measured {
                    row[5 + k * NAMES.len()..][..NAMES.len()].copy_from_slice(&observed(&mut system)?);
                }
            }
        }
        row[3] = cpu_seconds() - begin;
        self.rows.push(row);
        Ok(())
    }
}

impl Compress<'_> {
    /// Energies after the step to `density`, by each minimiser from one state, in which it leaves the system.
    fn after_one_state<M: Model>(&self, system: &mut System<M>, density: f64) -> Result<Vec<f64>, Failure> {
        by("newton", system, &goal(EXACT), density - LAST)?;
        let (pbox, start) = (*system.pbox(), system.own_particles());
        let mut energies = Vec::new();
        for method in METHODS {
            system.restore(pbox, start.clone());
            let is_there = by(method, system, &goal(EXACT), density).is_ok();
            energies.push(if is_there { system.energies()?.total } else { f64::NAN });
        }
        system.restore(pbox, start);
        Ok(energies)
    }
}

fn goal(force_tolerance: f64) -> Goal {
    Goal { force_tolerance, max_iterations: MAX_ITERATIONS }
}

fn by<M: Model>(method: &str, system: &mut System<M>, goal: &Goal, density: f64) -> Result<Report, ProtocolError> {
    match method {
        "newton" => compress_to(system, &Newton, goal, density),
        "cg" => compress_to(system, &ConjugateGradient, goal, density),
        _ => compress_to(system, &Fire, goal, density),
    }
}

fn observed<M: Model>(system: &mut System<M>) -> Result<[f64; 5], Failure> {
    let (sample, _) = Sample::measure(system, &Report::default(), Rattlers::default())?;
    let modulus = Moduli::of(system)?.mean_shear_modulus;
    Ok([sample.energies.total, sample.pressure(), sample.contact_number, sample.shape_parameter.relative, modulus])
}

fn line(text: &mut String, row: &[f64]) {
    writeln!(text, "{}", row.iter().map(f64::to_string).collect::<Vec<_>>().join(",")).expect("a string takes all");
}

fn report(rows: &[Row], steps: &[Step]) {
    let of = |way: usize| rows.iter().filter(move |row| row[1] == way as f64);
    println!("way                 packings  not relaxed  crossed  CPU s a packing");
    for (way, (name, ..)) in WAYS.iter().enumerate() {
        let open = of(way).filter(|row| row[ROW - 1].is_nan()).count();
        let crossed = of(way).filter(|row| row[2] > 0.0).count();
        println!("{name:19} {:8} {open:12} {crossed:8} {:16.2}", of(way).count(), mean(of(way).map(|row| row[3])));
    }
    let columns = MEASURED.iter().flat_map(|density| NAMES.map(|name| format!("{name} at {density:.2}")));
    println!(
        "\n                        mean and spread over packings       difference from the first, and over its error"
    );
    for (k, name) in std::iter::once("rho jammed".to_string()).chain(columns).enumerate() {
        for (way, (label, ..)) in WAYS.iter().enumerate() {
            let values: Vec<f64> = of(way).map(|row| row[4 + k]).collect();
            let shift: Vec<f64> = values.iter().zip(of(0)).map(|(x, first)| x - first[4 + k]).collect();
            let known = shift.iter().filter(|x| !x.is_nan()).count() as f64;
            let (by, error) = (mean(shift.iter().copied()), spread(shift.iter().copied()) / known.sqrt());
            let (center, width) = (mean(values.iter().copied()), spread(values.iter().copied()));
            print!("{:12} {label:19} {center:12.6} {width:10.6}", if way == 0 { &name } else { "" });
            println!("{}", if way == 0 { String::new() } else { format!("       {by:12.6} {:6.1}", by / error) });
        }
    }
    println!("\npairs in one minimum");
    for [a, b] in [[0, 1], [0, 2], [1, 2]] {
        for (k, density) in MEASURED.iter().enumerate() {
            let u = 5 + k * NAMES.len();
            let names = format!("{} and {}", WAYS[a].0, WAYS[b].0);
            let pairs = of(a).zip(of(b)).map(|(x, y)| [x[u], y[u]]);
            println!("{names:30} the whole way to {density:.2}  {}", equal(pairs));
        }
    }
    for [a, b] in [[0, 1], [0, 2], [1, 2]] {
        for density in MEASURED {
            let names = format!("{} and {}", METHODS[a], METHODS[b]);
            let here = steps.iter().filter(|step| (step[1] - density).abs() < 1e-9);
            println!(
                "{names:30} one step to {density:.2}       {}",
                equal(here.map(|step| [step[2 + a], step[2 + b]]))
            );
        }
    }
}

/// How many pairs of energies are those of one minimum.
fn equal(pairs: impl Iterator<Item = [f64; 2]>) -> String {
    let known: Vec<[f64; 2]> = pairs.filter(|[a, b]| !a.is_nan() && !b.is_nan()).collect();
    let same = known.iter().filter(|[a, b]| (a / b - 1.0).abs() <= ONE_MINIMUM).count();
    format!("{same:4} of {}", known.len())
}
