//! Errors of one state against the work that it took: a relaxed packing is compressed by a small step and relaxed again
//! by each minimiser to each tolerance. `scripts/work-precision` starts this program with the folder of its results, which
//! must be there. Scenes are those of `jamhpc run`, as differences from its defaults.

use jamhpc::comm::Comm;
use jamhpc::engine::System;
use jamhpc::failure::Failure;
use jamhpc::minimize::{ConjugateGradient, Fire, Goal, Minimized, Minimizer, Newton, Report};
use jamhpc::model::Model;
use jamhpc::observe::{Moduli, Rattlers, Sample};
use jamhpc::output::plot::{Axes, Series, panels};
use jamhpc::profile::cpu_seconds;
use jamhpc::protocol::compress_to;
use jamhpc::run::{Task, with_system};
use jamhpc::scene::Scene;
use std::fmt::Write as _;
use std::path::Path;

/// What is compared of a state.
const NAMES: [&str; 5] = ["U", "p", "z", "A - 1", "G"];

const DISKS: &str = "model = 'sp'\ninitial.packing_fraction = 0.7\nminimize.method = 'newton'";
const POLYGONS: &str = "model = 'dp'\ninitial.packing_fraction = 0.7";

/// Its name, scene, further lines of the scene, density and the step to it.
type Case = (&'static str, &'static str, &'static str, f64, f64);
/// The first of each model, then what differs from it.
const CASES: [Case; 13] = [
    ("sp", DISKS, "", 0.86, 1e-2),
    ("sp, phi = 0.95", DISKS, "", 0.95, 1e-2),
    ("sp, step 0.001", DISKS, "", 0.86, 1e-3),
    ("dp", POLYGONS, "", 0.90, 1e-2),
    ("dp, rho = 0.86", POLYGONS, "", 0.86, 1e-2),
    ("dp, rho = 0.95", POLYGONS, "", 0.95, 1e-2),
    ("dp, step 0.001", POLYGONS, "", 0.90, 1e-3),
    ("dp, step 0.0001", POLYGONS, "", 0.90, 1e-4),
    ("dp, paper", POLYGONS, "potential.preset = 'paper'", 0.90, 1e-2),
    ("dp, delta = 0.05", POLYGONS, "potential.delta = 0.05", 0.90, 1e-2),
    ("dp, 24 and 34 vertices", POLYGONS, "particles.n_vertices = [24, 34]\npotential.delta = 0.05", 0.90, 1e-2),
    ("dp, kappa = 3000", POLYGONS, "potential.kappa = 3000", 0.90, 1e-2),
    ("dp, edge-edge", POLYGONS, "potential.contact = 'edge-edge'\nminimize.method = 'fire'", 0.90, 1e-2),
];

/// In units of ε/σ_S or γ.
const TOLERANCES: [f64; 8] = [1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9];
/// On the way to the step.
const COARSE: f64 = 1e-3;
/// About what rounding leaves of forces.
const EXACT: f64 = 1e-9;
const EXACT_OF_DISKS: f64 = 1e-13;
const MAX_ITERATIONS: u64 = 1_000_000;
/// Where forces are balanced nowhere.
const MAX_ITERATIONS_ROUGH: u64 = 20_000;
/// Two minima whose energies differ by less than this part of them are one.
const ONE_MINIMUM: f64 = 1e-9;

/// One relaxation.
struct Row {
    case: &'static str,
    method: &'static str,
    tolerance: f64,
    report: Report,
    /// CPU time over that of one force evaluation of the same case.
    work: f64,
    seconds: f64,
    /// Of [`NAMES`], against the minimum that this state goes to when it is relaxed on: parts of it, but z as it is.
    errors: [f64; 5],
    /// The minimum is that of Newton's method.
    is_same: bool,
}

fn main() {
    match std::env::args().skip(1).find(|word| !word.starts_with('-')) {
        Some(out) => run(Path::new(&out)),
        None => println!("scripts/work-precision starts this program"),
    }
}

fn run(out: &Path) {
    let mut rows = Vec::new();
    for case in CASES {
        let (name, model, lines, density, _) = case;
        let text = format!("{model}\n{lines}\ncompression.densities = [{density}]");
        let scene = Scene::parse(&text, name, &[]).unwrap_or_else(|error| panic!("{error}"));
        let before = rows.len();
        with_system(Comm::alone(), &scene, Relax { case, rows: &mut rows }).unwrap_or_else(|e| panic!("{name}: {e}"));
        print(&rows[before..]);
    }
    for (file, text) in [("tolerances.csv", csv(&rows)), ("tolerances.svg", plot(&rows))] {
        std::fs::write(out.join(file), text).unwrap_or_else(|error| panic!("{file}: {error}"));
    }
    println!("\nleast work for errors of at most 1 % in p and G and 0.05 in z\n");
    for (case, ..) in CASES {
        for method in ["fire", "cg", "newton"] {
            let good = |row: &Row| row.errors[1] <= 0.01 && row.errors[4] <= 0.01 && row.errors[2] <= 0.05;
            let mine: Vec<&Row> = rows.iter().filter(|row| row.case == case && row.method == method).collect();
            // from where all tighter tolerances are good, too
            let first = mine.iter().rposition(|row| !good(row)).map_or(0, |bad| bad + 1);
            if let Some(row) = mine.get(first) {
                println!("{case:24} {method:7} tolerance {:5.0e}  work {:9.0}", row.tolerance, row.work);
            } else if !mine.is_empty() {
                println!("{case:24} {method:7} at none of these tolerances");
            }
        }
    }
}

struct Relax<'a> {
    case: Case,
    rows: &'a mut Vec<Row>,
}

impl Task for Relax<'_> {
    fn act<M: Model>(self, mut system: System<M>, minimizer: &impl Minimizer) -> Result<(), Failure> {
        let (case, _, lines, density, step) = self.case;
        // its forces are balanced nowhere
        let is_rough = lines.contains("edge-edge");
        let exact = if M::BODIES { EXACT } else { EXACT_OF_DISKS };
        let unit = system.model.force_unit();
        let max_iterations = if is_rough { MAX_ITERATIONS_ROUGH } else { MAX_ITERATIONS };
        let goal = |tolerance: f64| Goal { force_tolerance: tolerance * unit, max_iterations };
        let mut on_the_way = system.density()?;
        while on_the_way < density - step {
            on_the_way = (on_the_way + 0.01).min(density - step);
            let tolerance = if on_the_way == density - step { exact } else { COARSE };
            match compress_to(&mut system, minimizer, &goal(tolerance), on_the_way) {
                Err(error) if !is_rough => return Err(error.into()),
                _ => {}
            }
        }
        let area = system.own_area()?;
        system.deform_rigidly(system.pbox().with_area(area / density));
        let (pbox, start) = (*system.pbox(), system.own_particles());

        let begin = cpu_seconds();
        let evaluations = Fire.minimize(&mut system, &Goal { force_tolerance: 0.0, max_iterations: 2000 })?;
        let cost = (cpu_seconds() - begin) / evaluations.report().force_evaluations as f64;

        let mut minimum = f64::NAN;
        for method in ["newton", "fire", "cg"] {
            if is_rough && method != "fire" {
                continue;
            }
            for tolerance in TOLERANCES {
                system.restore(pbox, start.clone());
                let begin = cpu_seconds();
                let minimized = by(method, &mut system, &goal(tolerance))?;
                let seconds = cpu_seconds() - begin;
                let now = measured(&mut system)?;
                let _ = if is_rough {
                    Fire.minimize(&mut system, &goal(exact))?
                } else {
                    Newton.minimize(&mut system, &goal(exact))?
                };
                let end = measured(&mut system)?;
                if minimum.is_nan() {
                    minimum = end[0];
                }
                let mut errors = [0, 1, 2, 3, 4].map(|k| (now[k] / end[k] - 1.0).abs());
                errors[2] = (now[2] - end[2]).abs();
                self.rows.push(Row {
                    case,
                    method,
                    tolerance,
                    report: *minimized.report(),
                    work: seconds / cost,
                    seconds,
                    errors,
                    is_same: (end[0] / minimum - 1.0).abs() <= ONE_MINIMUM,
                });
                if !minimized.is_converged() {
                    break;
                }
            }
        }
        Ok(())
    }
}

fn by<M: Model>(method: &str, system: &mut System<M>, goal: &Goal) -> Result<Minimized, Failure> {
    Ok(match method {
        "newton" => Newton.minimize(system, goal)?,
        "cg" => ConjugateGradient.minimize(system, goal)?,
        _ => Fire.minimize(system, goal)?,
    })
}

fn measured<M: Model>(system: &mut System<M>) -> Result<[f64; 5], Failure> {
    let (sample, _) = Sample::measure(system, &Report::default(), Rattlers::default())?;
    let shape = sample.shape_parameter.relative - 1.0;
    let modulus = Moduli::of(system)?.mean_shear_modulus;
    Ok([sample.energies.total, sample.pressure(), sample.contact_number, shape, modulus])
}

fn print(rows: &[Row]) {
    println!("\n{}", rows[0].case);
    let names = NAMES.map(|name| format!("{name:8}")).concat();
    println!("method  tolerance  max|F|    forces      work   CPU s   errors of {}", names.trim_end());
    for row in rows {
        let errors = row.errors.map(|e| format!(" {e:7.0e}")).concat();
        println!(
            "{:7} {:9.0e} {:7.0e} {:9} {:9.0} {:7.2}          {errors}{}",
            row.method,
            row.tolerance,
            row.report.max_force,
            row.report.force_evaluations,
            row.work,
            row.seconds,
            if row.is_same { "" } else { "  another minimum" },
        );
    }
}

fn csv(rows: &[Row]) -> String {
    let mut text = String::from("case,method,tolerance,max_force,force_evaluations,work,cpu_seconds,");
    text += "error_energy,error_pressure,error_contact_number,error_shape,error_shear_modulus,same_minimum\n";
    for row in rows {
        let errors = row.errors.map(|e| format!("{e:e}")).join(",");
        let Row { case, method, tolerance, report, work, seconds, is_same, .. } = row;
        let Report { max_force, force_evaluations, .. } = report;
        writeln!(
            text,
            "\"{case}\",{method},{tolerance:e},{max_force:e},{force_evaluations},{work:.0},{seconds:.4},{errors},{is_same}",
        )
        .expect("a string takes all");
    }
    text
}

/// Errors of p and G against work, for the first case of each model and for the paper's stiffness.
fn plot(rows: &[Row]) -> String {
    let mut axes = Vec::new();
    for case in ["sp", "dp", "dp, paper"] {
        for (k, what) in [(1, "p"), (4, "G")] {
            let series = ["fire", "cg", "newton"].map(|method| {
                let mine = rows.iter().filter(|row| row.case == case && row.method == method);
                let points = mine.map(|row| [row.work, row.errors[k].max(1e-16)]).collect();
                Series { name: method.into(), points, error: None, line: true, style: None }
            });
            axes.push(Axes {
                title: case.into(),
                x_label: "work, force evaluations".into(),
                y_label: format!("relative error of {what}"),
                log_x: true,
                log_y: true,
                series: series.to_vec(),
            });
        }
    }
    panels(&axes, 2).to_svg()
}
