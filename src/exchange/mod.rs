//! Exchange of single configurations with other programs, as JSON: one configuration in, its energies, forces,
//! stresses, contacts and areas out, or the same configuration relaxed.
//!
//! Every rank passes the same text and reads all of it; results are on rank 0.

mod configuration;
mod evaluation;
mod problem;
mod reader;

pub use configuration::{Cell, Configuration, ContactForm};
pub use evaluation::{Energy, Evaluation, Extra, Stress};
pub use problem::{ExchangeError, Problem};

use crate::comm::Comm;
use crate::engine::{EngineError, System};
use crate::geometry::{Frac, PeriodicBox, Vec2, add};
use crate::minimize::{Goal, Minimized, Minimizer};
use crate::model::{Deformable, DeformableParameters, EdgeEdge, Harmonic, Model, SoftDisks, VertexEdge};
use crate::observe::{Look, check_no_crossing, refuse_coincident, refuse_crossings};
use crate::particles::Bodies;
use serde::Serialize;

/// Evaluates the configuration in `text` as it stands: the text of an [`Evaluation`] on rank 0, an empty one on the
/// others. `origin` names the file in error messages, `extras` what to add. Collective.
pub fn evaluate(comm: Comm, text: &str, origin: &str, extras: &[Extra]) -> Result<String, ExchangeError> {
    with_system(comm, text, origin, Evaluate { extras })
}

/// Relaxes the configuration in `text`: on rank 0 the text of the relaxed one, in the same format, with an object
/// `minimize` that says how it went (iterations, force_evaluations, max_force, energy, converged); an empty text on the
/// others. A state that did not converge is returned all the same, and the second value says so. Collective.
///
/// Positions come out as Cartesian numbers in the cell, rounded to 10⁻¹⁶ of its size: forces evaluated from them differ
/// from those reported by that much times the stiffness of the contacts.
pub fn minimize(
    comm: Comm,
    text: &str,
    origin: &str,
    minimizer: &impl Minimizer,
    goal: &Goal,
) -> Result<(String, Minimized), ExchangeError> {
    with_system(comm, text, origin, Relax { minimizer, goal })
}

/// Sets up the configuration in `text` and has a look at it. Collective.
pub fn look<L: Look<Error = EngineError>>(
    comm: Comm,
    text: &str,
    origin: &str,
    look: L,
) -> Result<L::Output, ExchangeError> {
    with_system(comm, text, origin, AsTask(look))
}

struct AsTask<L>(L);

impl<L: Look<Error = EngineError>> Task for AsTask<L> {
    type Output = L::Output;

    const SKIN: f64 = Evaluate::SKIN;

    fn run<M: Model>(self, _: Configuration, mut system: System<M>) -> Result<L::Output, EngineError> {
        self.0.look(&mut system)
    }
}

/// What to do with a system whose model is only known once the text has been read.
trait Task {
    type Output;

    /// Extra range of the neighbour lists, over the contact range (disks: the smallest diameter).
    const SKIN: f64;

    fn run<M: Model>(self, input: Configuration, system: System<M>) -> Result<Self::Output, EngineError>;
}

/// Reads a configuration, sets up the system of its model and hands it to the task.
fn with_system<T: Task>(comm: Comm, text: &str, origin: &str, task: T) -> Result<T::Output, ExchangeError> {
    let refuse = |problem| ExchangeError::Input { origin: origin.to_string(), problem };
    let input = Configuration::read(text).map_err(refuse)?;
    match &input {
        Configuration::Sp { diameters, epsilon, .. } => {
            let smallest = diameters.iter().copied().fold(f64::INFINITY, f64::min);
            start(comm, SoftDisks { epsilon: *epsilon, smallest }, T::SKIN * smallest, input, origin, task)
        }
        Configuration::Dp { line_tension, k_area, epsilon, delta, contact, n_vertices, a0, .. } => {
            let parameters = DeformableParameters {
                line_tension: *line_tension,
                k_area: *k_area,
                contact: Harmonic { epsilon: *epsilon, delta: *delta },
                largest_area_per_vertex: a0.iter().zip(n_vertices).map(|(a, &n)| a / n as f64).fold(0.0, f64::max),
            };
            let skin = T::SKIN * delta;
            match contact {
                ContactForm::VertexEdge => {
                    start(comm, Deformable::<VertexEdge>::new(parameters), skin, input, origin, task)
                }
                ContactForm::EdgeEdge => {
                    start(comm, Deformable::<EdgeEdge>::new(parameters), skin, input, origin, task)
                }
            }
        }
    }
}

fn start<M: Model, T: Task>(
    comm: Comm,
    model: M,
    skin: f64,
    input: Configuration,
    origin: &str,
    task: T,
) -> Result<T::Output, ExchangeError> {
    let fail = |source| ExchangeError::Engine { origin: origin.to_string(), source };
    let pbox = input.pbox();
    let particles = input.particles(comm.rank(), comm.size());
    let mut system = System::new(comm, model, pbox, &pbox, particles, skin).map_err(fail)?;
    if let Some((a, b)) = check_no_crossing(&mut system).map_err(fail)? {
        return Err(ExchangeError::Input {
            origin: origin.to_string(),
            problem: Problem::Crossing { particles: [a, b] },
        });
    }
    task.run(input, system).map_err(fail)
}

struct Evaluate<'a> {
    extras: &'a [Extra],
}

impl Task for Evaluate<'_> {
    type Output = String;

    const SKIN: f64 = 0.0;

    fn run<M: Model>(self, _: Configuration, mut system: System<M>) -> Result<String, EngineError> {
        let evaluation = Evaluation::of(&mut system, self.extras)?;
        Ok(if system.comm.is_root() { to_text(&evaluation) } else { String::new() })
    }
}

struct Relax<'a, Z> {
    minimizer: &'a Z,
    goal: &'a Goal,
}

impl<Z: Minimizer> Task for Relax<'_, Z> {
    type Output = (String, Minimized);

    const SKIN: f64 = 0.5;

    fn run<M: Model>(self, input: Configuration, mut system: System<M>) -> Result<Self::Output, EngineError> {
        refuse_coincident(&mut system)?;
        let minimized = self.minimizer.minimize(&mut system, self.goal)?;
        refuse_crossings(&mut system)?;
        let energy = system.energies()?.total;
        let coordinates = by_id(&system, |p| {
            let points = system.particles().points_of(p);
            whole(system.pbox(), &system.particles().bodies, points).into_iter().flatten().collect()
        });
        if !system.comm.is_root() {
            return Ok((String::new(), minimized));
        }
        let points = coordinates.concat().chunks_exact(2).map(|v| [v[0], v[1]]).collect();
        let report = minimized.report();
        let relaxed = Relaxed {
            configuration: input.at(points),
            minimize: Minimize {
                iterations: report.iterations,
                force_evaluations: report.force_evaluations,
                max_force: report.max_force,
                energy,
                converged: minimized.is_converged(),
            },
        };
        Ok((to_text(&relaxed), minimized))
    }
}

#[derive(Serialize)]
struct Relaxed {
    #[serde(flatten)]
    configuration: Configuration,
    minimize: Minimize,
}

#[derive(Serialize)]
struct Minimize {
    iterations: u64,
    force_evaluations: u64,
    max_force: f64,
    energy: f64,
    converged: bool,
}

/// Cartesian positions of the points of one particle, in one periodic image, its first point inside the cell.
fn whole(pbox: &PeriodicBox, bodies: &Bodies, points: &[Frac]) -> Vec<Vec2> {
    let first = pbox.position(points[0]);
    match bodies {
        Bodies::Disks => vec![first],
        Bodies::Polygons { .. } => {
            let polygon = crate::geometry::Polygon::from_vertices(pbox, points);
            polygon.offsets().map(|offset| add(first, offset)).collect()
        }
    }
}

/// What `row` says about each own particle, from all ranks, in the order of global ids, on rank 0; nothing elsewhere.
/// Collective.
fn by_id<M: Model>(system: &System<M>, row: impl Fn(usize) -> Vec<f64>) -> Vec<Vec<f64>> {
    let mut words = Vec::new();
    for (p, &id) in system.particles().id.iter().enumerate() {
        let row = row(p);
        words.extend([id as u64, row.len() as u64]);
        words.extend(row.into_iter().map(f64::to_bits));
    }
    let mut rows = Vec::new();
    for part in system.comm.gather(words) {
        let mut rest = &part[..];
        while let [id, n, tail @ ..] = rest {
            let (row, after) = tail.split_at(*n as usize);
            rows.push((*id, row.iter().map(|&word| f64::from_bits(word)).collect()));
            rest = after;
        }
    }
    rows.sort_unstable_by_key(|&(id, _): &(u64, Vec<f64>)| id);
    rows.into_iter().map(|(_, row)| row).collect()
}

/// One line of JSON; f64 as the shortest text that reads back to the same bits.
fn to_text(value: &impl Serialize) -> String {
    let mut text = serde_json::to_string(value).expect("plain structures of numbers are JSON");
    text.push('\n');
    text
}
