//! Stored states measured again: `analyze` tells everything about them, `check` whether they are valid.

use crate::comm::Session;
use crate::engine::{EngineError, System};
use crate::exchange;
use crate::failure::Failure;
use crate::frames::{Frame, with_frame};
use crate::minimize::Report;
use crate::model::Model;
use crate::observe::{Invariant, Look, Moduli, Rattlers, Sample, invariants};
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
        let mut sample = measured(system)?;
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

fn measured<M: Model>(system: &mut System<M>) -> Result<Sample, EngineError> {
    let max_force = system.max_force()?;
    let report = Report { max_force, ..Report::default() };
    Ok(Sample::measure(system, &report, Rattlers::default())?.0)
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
                rows.push(with_frame(session.world(), file, &results, frame, |_, _| Measure)??);
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
    stored: Row,
}

impl Look for Check {
    type Output = Vec<Invariant>;
    type Error = EngineError;

    fn look<M: Model>(self, system: &mut System<M>) -> Result<Vec<Invariant>, EngineError> {
        let sample = measured(system)?;
        let mut found = invariants(system, &sample, self.force_tolerance)?;
        for (name, value) in sample.scalars() {
            // the largest force of a relaxed state is rounding
            let Some((_, stored)) = self.stored.iter().find(|(n, _)| n == name && name != "max_force") else {
                continue;
            };
            if HISTORY.contains(&name) || name == "stress_mismatch" {
                continue;
            }
            let (detail, limit) = (format!("{stored} stored"), 1e-9 * value.abs() + 1e-12);
            found.push(Invariant::new(&format!("stored {name}"), (value - stored).abs(), limit, &detail));
        }
        Ok(found)
    }
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
            let check = Check { force_tolerance: force_tolerance.unwrap_or(FORCE_TOLERANCE), stored: Row::new() };
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
                    stored: snapshot.scalars.clone(),
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
