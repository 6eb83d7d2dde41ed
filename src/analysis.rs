//! Stored states measured again: `analyze` tells everything about them, `check` whether they are valid.

use crate::comm::{Comm, Session};
use crate::engine::{EngineError, System};
use crate::exchange;
use crate::failure::Failure;
use crate::frames::{Frame, with_frame};
use crate::minimize::Report;
use crate::model::Model;
use crate::observe::{Invariant, Look, Moduli, PerParticle, Rattlers, Sample, invariants};
use crate::output::Results;
use std::fmt::Write as _;
use std::path::Path;

/// Named numbers of one state.
type Row = Vec<(String, f64)>;

/// Everything that can be measured on a state.
struct Measure;

impl Look for Measure {
    type Output = Row;
    type Error = EngineError;

    fn look<M: Model>(self, system: &mut System<M>) -> Result<Row, EngineError> {
        let mut sample = measured(system)?.0;
        sample.moduli = Some(Moduli::of(system)?);
        let tensors = sample.tensors();
        let components = tensors.iter().flat_map(|&(name, t)| {
            ["xx", "xy", "yx", "yy"].into_iter().zip(t).map(move |(component, x)| (format!("{name}_{component}"), x))
        });
        let named = sample.scalars().into_iter().filter(|(name, _)| !HISTORY.contains(name));
        Ok(named.map(|(name, x)| (name.to_string(), x)).chain(components).collect())
    }
}

/// What a state does not tell about itself.
const HISTORY: [&str; 3] = ["iterations", "force_evaluations", "strain"];

fn measured<M: Model>(system: &mut System<M>) -> Result<(Sample, PerParticle), EngineError> {
    let max_force = system.max_force()?;
    let report = Report { max_force, ..Report::default() };
    Sample::measure(system, &report, Rattlers::default())
}

/// Measures frames of a results file, or the configuration in a file of the exchange format whose text is `text`: one
/// line a number, or for all frames one line of a table (CSV) each. Collective.
pub fn analyze(session: &Session, file: &Path, text: Option<&str>, frame: Frame, all: bool) -> Result<String, Failure> {
    let mut rows: Vec<Row> = Vec::new();
    match text {
        Some(text) => rows.push(exchange::look(session.world(), text, &file.display().to_string(), Measure)?),
        None => {
            let results = Results::open(&session.world(), file)?;
            let frames: Vec<Frame> = if all { (0..results.frames).map(Some).collect() } else { vec![frame] };
            for frame in frames {
                // what the state does not tell, the file does
                let mut known = Row::new();
                let measured = with_frame(session.world(), file, &results, frame, |_, snapshot| {
                    let stored =
                        snapshot.scalars.iter().filter(|(name, _)| ["density", "strain"].contains(&name.as_str()));
                    known.extend(stored.cloned());
                    Measure
                })??;
                let number = frame.filter(|_| all).map(|k| ("frame".to_string(), k as f64));
                rows.push(number.into_iter().chain(known).chain(measured).collect());
            }
        }
    }
    Ok(if all { csv(&rows) } else { rows.iter().map(lines).collect() })
}

fn lines(row: &Row) -> String {
    row.iter().fold(String::new(), |mut text, (name, value)| {
        let _ = writeln!(text, "{name:<34} {value}");
        text
    })
}

fn csv(rows: &[Row]) -> String {
    let line = |cells: Vec<String>| cells.join(",") + "\n";
    let header = rows.first().map(|row| line(row.iter().map(|(name, _)| name.clone()).collect()));
    header.into_iter().chain(rows.iter().map(|row| line(row.iter().map(|(_, x)| x.to_string()).collect()))).collect()
}

/// Whether a state is valid.
struct Check {
    force_tolerance: f64,
    /// What a file says about the state.
    stored: Stored,
}

/// Numbers of a frame, those of particles for some of them on each rank.
#[derive(Default)]
struct Stored {
    scalars: Row,
    tensors: Vec<(String, [f64; 4])>,
    ids: Vec<u32>,
    columns: Vec<(String, Vec<f64>)>,
}

impl Look for Check {
    type Output = Vec<Invariant>;
    type Error = EngineError;

    fn look<M: Model>(self, system: &mut System<M>) -> Result<Vec<Invariant>, EngineError> {
        let (sample, columns) = measured(system)?;
        let mut found = invariants(system, &sample, self.force_tolerance)?;
        for (name, value) in sample.scalars() {
            // the largest force of a relaxed state is rounding
            if HISTORY.contains(&name) || ["max_force", "stress_mismatch"].contains(&name) {
                continue;
            }
            if let Some((_, stored)) = self.stored.scalars.iter().find(|(n, _)| n == name) {
                found.push(same(name, *stored, value));
            }
        }
        for (name, tensor) in sample.tensors() {
            let stored = self.stored.tensors.iter().find(|(n, _)| n == name);
            let most = tensor.iter().fold(0.0, |m: f64, x| m.max(x.abs()));
            for (component, (&stored, value)) in stored.iter().flat_map(|(_, t)| t).zip(tensor).enumerate() {
                let name = format!("stored {name} {component}");
                found.push(Invariant::new(&name, (value - stored).abs(), limit(most), &format!("{stored} stored")));
            }
        }
        for (name, column) in columns.named() {
            if let Some((_, stored)) = self.stored.columns.iter().find(|(n, _)| n == name) {
                let ids = &system.particles().id;
                let measured: Vec<f64> = (0..ids.len()).map(column).collect();
                let worst = largest_difference(&system.comm, (&self.stored.ids, stored), (ids, &measured));
                found.push(Invariant::new(&format!("stored {name} of particles"), worst, 1.0, "in units of the limit"));
            }
        }
        Ok(found)
    }
}

/// By how much a number measured again may differ.
fn limit(value: f64) -> f64 {
    1e-9 * value.abs() + 1e-12
}

fn same(name: &str, stored: f64, value: f64) -> Invariant {
    Invariant::new(&format!("stored {name}"), (value - stored).abs(), limit(value), &format!("{stored} stored"))
}

/// The largest difference between two columns, each in any order of ids on any ranks, over what it may be. Two numbers
/// that are none do not differ. Collective.
fn largest_difference(comm: &Comm, stored: (&[u32], &[f64]), measured: (&[u32], &[f64])) -> f64 {
    let [stored, measured] = [stored, measured].map(|(ids, values)| {
        let words = ids.iter().zip(values).flat_map(|(&id, value)| [id as u64, value.to_bits()]).collect();
        let all = comm.gather(words).concat();
        let mut rows: Vec<(u64, f64)> = all.chunks_exact(2).map(|row| (row[0], f64::from_bits(row[1]))).collect();
        rows.sort_unstable_by_key(|row| row.0);
        rows
    });
    let difference = |(a, b): (&(u64, f64), &(u64, f64))| match a.1.is_nan() && b.1.is_nan() {
        true => 0.0,
        false => (a.1 - b.1).abs() / limit(b.1),
    };
    let worse = |m: f64, x: f64| if m.is_nan() || x.is_nan() { f64::NAN } else { m.max(x) };
    // the root has seen all
    comm.max(stored.iter().zip(&measured).map(difference).fold(0.0, worse))
}

/// Checks one frame or all frames of a results file, or a configuration: a table of what must hold, or a failure that
/// names what does not. `force_tolerance` in the units of the model; that of the scene if not given. Collective.
pub fn check(
    session: &Session,
    file: &Path,
    text: Option<&str>,
    frame: Frame,
    force_tolerance: Option<f64>,
) -> Result<String, Failure> {
    let mut states = Vec::new();
    match text {
        Some(text) => {
            let check =
                Check { force_tolerance: force_tolerance.unwrap_or(FORCE_TOLERANCE), stored: Stored::default() };
            states.push((String::new(), exchange::look(session.world(), text, &file.display().to_string(), check)?));
        }
        None => {
            let results = Results::open(&session.world(), file)?;
            if let Some(failure) = &results.failure {
                return Err(Failure::Other(format!("{}: the run did not finish: {failure}", file.display())));
            }
            let frames = frame.map_or((0..results.frames).collect(), |k| vec![k]);
            for k in frames {
                let found = with_frame(session.world(), file, &results, Some(k), |scene, snapshot| Check {
                    force_tolerance: force_tolerance
                        .unwrap_or(scene.minimize.force_tolerance * scene.force_unit() * (1.0 + 1e-9)),
                    stored: Stored {
                        scalars: snapshot.scalars.clone(),
                        tensors: snapshot.tensors.clone(),
                        ids: snapshot.particles.id.clone(),
                        columns: snapshot.columns.clone(),
                    },
                })??;
                states.push((format!("frame {k}: "), found));
            }
        }
    }
    let mut table = String::new();
    let mut failed = Vec::new();
    for (state, found) in &states {
        for invariant in found {
            let Invariant { name, value, limit, detail } = invariant;
            let verdict = if invariant.holds() { "ok" } else { "FAILED" };
            let _ = writeln!(table, "{verdict:<6}  {state}{name:<40} {value:10.3e}  limit {limit:.3e}");
            if !invariant.holds() {
                let detail = if detail.is_empty() { String::new() } else { format!(" ({detail})") };
                failed.push(format!("{state}{name}: {value:.3e}, limit {limit:.3e}{detail}"));
            }
        }
    }
    if failed.is_empty() {
        return Ok(table);
    }
    Err(Failure::Other(format!("{} is not valid:\n  {}", file.display(), failed.join("\n  "))))
}

/// Of a configuration that does not say how well it is relaxed.
const FORCE_TOLERANCE: f64 = 1e-8;
