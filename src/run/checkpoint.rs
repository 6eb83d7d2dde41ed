//! A run that can be left at any moment and taken up again, to the same bits.
//!
//! All that a run does follows from its scene, and nearly all that it costs are minimisations. So a checkpoint is the
//! list of what they came to, in their order. A resumed run starts its protocol from the beginning; each minimisation
//! is answered from the list, until the list ends. The one that was under way goes on from where it was. Nothing here
//! decides what comes out: what is missing or damaged is done again.
//!
//! ```text
//! DIRECTORY/checkpoint/
//!     scene.toml              what is run; a checkpoint exists when this does
//!     done-000000.records     outcomes from number 0; the next file begins where this one ends
//!     running.records         the minimisation under way ...
//!     running-before.records  ... and as it was one checkpoint earlier
//! ```

use crate::comm::Comm;
use crate::engine::{EngineError, System};
use crate::failure::Failure;
use crate::geometry::PeriodicBox;
use crate::minimize::{Goal, Minimized, Minimizer, Report, TURN};
use crate::model::Model;
use crate::output::folder::{explain, remove_own, write_whole};
use crate::output::{OutputError, Record, read_records, write_records};
use crate::particles::{Bodies, Particles};
use crate::scene::Scene;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use signal_hook::consts::{SIGTERM, SIGUSR1, SIGUSR2};
use std::borrow::Cow;
use std::cell::RefCell;
use std::collections::VecDeque;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

/// Outcomes that a rank keeps in memory, in bytes, before they are written whatever the time.
const MOST_KEPT: usize = 8 << 20;
/// The same for one of many packings: most take seconds and thousands of minimisations, and should come to their end without
/// loading a disk that many ranks share.
const MOST_KEPT_OF_MEMBER: usize = 64 << 20;
/// Which program a checkpoint is from.
const PROGRAM: &str = concat!("# jamhpc ", env!("CARGO_PKG_VERSION"), " ", env!("JAMHPC_GIT_HASH"));

/// A minimiser that remembers its outcomes.
pub struct Checkpoints<'a, Inner> {
    inner: &'a Inner,
    list: RefCell<List>,
}

/// What a minimisation came to, beside the particles.
#[derive(Serialize, Deserialize)]
struct Outcome {
    /// lx, ly, xy of its box.
    edges: [f64; 3],
    is_converged: bool,
    report: Report,
}

/// Where a minimisation is, beside the particles.
#[derive(Serialize, Deserialize)]
struct UnderWay {
    /// Outcomes before it.
    number: usize,
    edges: [f64; 3],
    /// Of the minimiser.
    memory: Vec<u64>,
    /// Which the memory is of.
    program: String,
}

impl<'a, Inner: Minimizer> Checkpoints<'a, Inner> {
    /// Of a run of this scene. Refuses to resume where there is nothing to resume, or something else, and to begin
    /// where something could be resumed. Collective.
    pub fn new(comm: &Comm, inner: &'a Inner, scene: &Scene, resume: bool) -> Result<Self, Failure> {
        let folder = Path::new(&scene.output.directory).join("checkpoint");
        let stored = stored_scene(comm, &folder)?;
        match (resume, stored.is_empty()) {
            (false, true) => {}
            (true, false) => check_scene(&stored, &folder.join(SCENE), scene)?,
            (true, true) => {
                let folder = folder.display();
                return Err(Failure::Input(format!(
                    "there is nothing to resume: no checkpoint in {folder}. Leave --resume out to begin"
                )));
            }
            (false, false) => {
                let folder = folder.display();
                return Err(Failure::Input(format!(
                    "{folder} is the checkpoint of a run that has not ended: go on with it by --resume, remove it, or \
                     choose another folder with -o"
                )));
            }
        }
        Checkpoints::in_folder(comm, inner, scene, folder, resume, MOST_KEPT)
    }

    /// Of one of many packings: goes on if the folder holds a checkpoint of this scene by this very program; any other
    /// is removed. Collective.
    pub fn of_member(comm: &Comm, inner: &'a Inner, scene: &Scene, folder: PathBuf) -> Result<Self, Failure> {
        let stored = stored_scene(comm, &folder)?;
        let resumes = stored == signed(&scene.of_results().to_toml());
        if !stored.is_empty() && !resumes {
            tracing::warn!("{} is of another plan or version: begun anew", folder.display());
        }
        Checkpoints::in_folder(comm, inner, scene, folder, resumes, MOST_KEPT_OF_MEMBER)
    }

    fn in_folder(
        comm: &Comm,
        inner: &'a Inner,
        scene: &Scene,
        folder: PathBuf,
        resumes: bool,
        most_kept: usize,
    ) -> Result<Self, Failure> {
        if !resumes {
            // outcomes of something else must not be taken for those that are written now
            comm.from_root(|| match clear(&folder) {
                Ok(()) => Ok(Vec::new()),
                Err(e) => Err(Failure::Other(format!("cannot remove {}: {e}", folder.display()))),
            })?;
        }
        let list = List {
            folder,
            scene: scene.of_results().to_toml(),
            interval: Duration::from_secs_f64(scene.checkpoint.interval),
            most_kept,
            signals: Signals::listen()?,
            saved: 0,
            fresh: Vec::new(),
            replayed: VecDeque::new(),
            replays: resumes,
            takes_up: resumes,
            written: Instant::now(),
            failure: None,
        };
        Ok(Checkpoints { inner, list: RefCell::new(list) })
    }

    /// What `compute` finds out about the present state, or found out before. Collective.
    pub fn remember<M: Model, T: Serialize + DeserializeOwned>(
        &self,
        system: &mut System<M>,
        compute: impl FnOnce(&mut System<M>) -> Result<T, EngineError>,
    ) -> Result<T, Failure> {
        let mut list = self.list.borrow_mut();
        let known = list.next(&system.comm, &system.model.bodies())?;
        // numbers that are not finite cannot be read back
        if let Some(value) = known.as_ref().and_then(|record| serde_json::from_str(&record.note).ok()) {
            return Ok(value);
        }
        let value = compute(system)?;
        if known.is_none() {
            list.fresh.push(Record { note: json(&value), particles: None });
        }
        Ok(value)
    }

    /// Set when a signal asks for the end.
    pub fn ends(&self) -> Arc<AtomicBool> {
        self.list.borrow().signals.end.clone()
    }

    /// Why [`EngineError::Interrupted`] was answered, if it was.
    pub fn interruption(&self) -> Option<Failure> {
        self.list.borrow_mut().failure.take()
    }

    /// Removes what is on the disk: the run has come to its end. Collective.
    pub fn remove(self, comm: &Comm) {
        if comm.is_root() {
            remove(&self.list.into_inner().folder);
        }
    }
}

/// Removes the checkpoint in a folder, if there is one; that this fails is worth a warning only. For one rank.
pub fn remove(folder: &Path) {
    if let Err(error) = clear(folder) {
        tracing::warn!("cannot remove {}: {error}", folder.display());
    }
}

fn clear(folder: &Path) -> std::io::Result<()> {
    // without the scene it is no checkpoint, whatever becomes of the rest
    match fs::remove_file(folder.join(SCENE)) {
        Err(e) if e.kind() != std::io::ErrorKind::NotFound => return Err(e),
        _ => {}
    }
    remove_own(folder, |name| name.ends_with(".records"))
}

/// The scene of the checkpoint in a folder, after a line on the program; empty if there is none. Collective.
fn stored_scene(comm: &Comm, folder: &Path) -> Result<String, Failure> {
    let place = folder.join(SCENE);
    let stored = comm.from_root(|| match fs::read(&place) {
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => Ok(Vec::new()),
        outcome => outcome.map_err(|e| Failure::Input(format!("cannot read {}: {e}", place.display()))),
    })?;
    Ok(String::from_utf8_lossy(&stored).into_owned())
}

fn signed(scene: &str) -> String {
    format!("{PROGRAM}\n{scene}")
}

impl<Inner: Minimizer> Minimizer for Checkpoints<'_, Inner> {
    fn minimize<M: Model>(&self, system: &mut System<M>, goal: &Goal) -> Result<Minimized, EngineError> {
        let mut list = self.list.borrow_mut();
        list.minimize(self.inner, system, goal).map_err(|stop| match stop {
            Stop::Engine(error) => error,
            Stop::Failure(failure) => {
                list.failure = Some(failure);
                EngineError::Interrupted
            }
        })
    }

    /// One turn is all: it is here that turns are taken.
    fn advance<M: Model>(
        &self,
        system: &mut System<M>,
        goal: &Goal,
        _: &mut Vec<u64>,
        _: u64,
    ) -> Result<Option<Minimized>, EngineError> {
        self.minimize(system, goal).map(Some)
    }
}

/// Why a minimisation has no outcome.
enum Stop {
    Engine(EngineError),
    Failure(Failure),
}

impl From<EngineError> for Stop {
    fn from(error: EngineError) -> Self {
        Stop::Engine(error)
    }
}

impl From<Failure> for Stop {
    fn from(failure: Failure) -> Self {
        Stop::Failure(failure)
    }
}

impl From<OutputError> for Stop {
    fn from(error: OutputError) -> Self {
        Stop::Failure(Failure::from(error).and(
            "the checkpoint before it, if there is one, is whole: --resume goes on from there, a study by the same command",
        ))
    }
}

const SCENE: &str = "scene.toml";

/// Outcomes in their order: those on the disk, then those that are not yet.
struct List {
    folder: PathBuf,
    scene: String,
    interval: Duration,
    /// Bytes of outcomes in memory.
    most_kept: usize,
    signals: Signals,
    /// How many are on the disk and have been read or written.
    saved: usize,
    fresh: Vec<Record<'static>>,
    /// Read, and not yet asked for.
    replayed: VecDeque<Record<'static>>,
    /// There may be more to read.
    replays: bool,
    /// A minimisation may have been under way.
    takes_up: bool,
    written: Instant,
    failure: Option<Failure>,
}

impl List {
    fn minimize<M: Model>(
        &mut self,
        inner: &impl Minimizer,
        system: &mut System<M>,
        goal: &Goal,
    ) -> Result<Minimized, Stop> {
        if let Some(record) = self.next(&system.comm, &system.model.bodies())? {
            return Ok(self.replay(system, record)?);
        }
        let mut memory = self.take_up(system)?;
        loop {
            let minimized = inner.advance(system, goal, &mut memory, TURN)?;
            if let Some(minimized) = minimized {
                let outcome = Outcome {
                    edges: edges(system.pbox()),
                    is_converged: minimized.is_converged(),
                    report: *minimized.report(),
                };
                // directions and velocities have served, and are more than the particles themselves
                system.carry(0);
                system.lay_bare(); // memory has no room for lists and for the particles twice
                let particles = Some(Cow::Owned(system.own_particles()));
                self.fresh.push(Record { note: json(&outcome), particles });
                memory.clear();
            }
            self.heed(system, &memory)?;
            if let Some(minimized) = minimized {
                return Ok(minimized);
            }
        }
    }

    /// The next outcome that is known from before. Collective.
    fn next(&mut self, comm: &Comm, bodies: &Bodies) -> Result<Option<Record<'static>>, Failure> {
        if self.replays && self.replayed.is_empty() {
            let records = read_if_whole(comm, &self.done(), bodies)?;
            self.saved += records.len();
            self.replays = !records.is_empty();
            self.replayed.extend(records);
        }
        Ok(self.replayed.pop_front())
    }

    /// The file of the outcomes that come next.
    fn done(&self) -> PathBuf {
        self.folder.join(format!("done-{:06}.records", self.saved))
    }

    fn running(&self) -> [PathBuf; 2] {
        ["running.records", "running-before.records"].map(|name| self.folder.join(name))
    }

    /// Puts the system where a minimisation has brought it before.
    fn replay<M: Model>(&self, system: &mut System<M>, record: Record<'_>) -> Result<Minimized, Failure> {
        let outcome = serde_json::from_str::<Outcome>(&record.note).ok();
        match (outcome, record.particles) {
            (Some(Outcome { edges: there, is_converged, report }), Some(particles))
                if there == edges(system.pbox()) && holds_all(system, &particles) =>
            {
                system.restore(*system.pbox(), particles.into_owned());
                Ok(if is_converged { Minimized::Converged(report) } else { Minimized::Unconverged(report) })
            }
            _ => Err(Failure::Input(format!(
                "{} is the checkpoint of another run, or of another version of jamhpc: remove it and begin anew",
                self.folder.display()
            ))),
        }
    }

    /// Puts the system where the minimisation that now begins was left, and answers the minimiser's memory; empty if
    /// nothing is known of it. Collective.
    fn take_up<M: Model>(&mut self, system: &mut System<M>) -> Result<Vec<u64>, Failure> {
        if !std::mem::take(&mut self.takes_up) {
            return Ok(Vec::new());
        }
        let number = self.saved + self.fresh.len();
        for path in self.running() {
            let Some(Record { note, particles: Some(particles) }) =
                read_if_whole(&system.comm, &path, &system.model.bodies())?.pop()
            else {
                continue;
            };
            if let Ok(at) = serde_json::from_str::<UnderWay>(&note)
                && (at.number, at.edges, &at.program[..]) == (number, edges(system.pbox()), PROGRAM)
                && holds_all(system, &particles)
            {
                system.restore(*system.pbox(), particles.into_owned());
                return Ok(at.memory);
            }
        }
        Ok(Vec::new())
    }

    /// Writes a checkpoint if it is time or a signal asks for one; an error if a signal asks for the end. `memory` is
    /// that of a minimisation under way. Collective: ranks act together if one of them has reason to.
    fn heed<M: Model>(&mut self, system: &System<M>, memory: &[u64]) -> Result<(), Stop> {
        let kept: usize = self.fresh.iter().filter_map(|r| r.particles.as_deref()).map(bytes).sum();
        let is_due = self.written.elapsed() >= self.interval || kept > self.most_kept;
        let here = [is_due | self.signals.asks_for_checkpoint(), self.signals.asks_for_end()].map(u64::from);
        let ranks = system.comm.all_gather(&here);
        let [write, end] = [0, 1].map(|k| ranks.iter().any(|rank| rank[k] > 0));
        if write || end {
            self.write(system, memory)?;
        }
        if end {
            let folder = self.folder.display();
            let text = format!("ended by a signal; all work is kept in {folder}: --resume goes on with it");
            return Err(Failure::Interrupted(text).into());
        }
        Ok(())
    }

    fn write<M: Model>(&mut self, system: &System<M>, memory: &[u64]) -> Result<(), OutputError> {
        let comm = &system.comm;
        let place = self.folder.join(SCENE);
        let begin = || -> Result<Vec<u8>, String> {
            if !place.exists() {
                fs::create_dir_all(&self.folder).map_err(|e| explain(&e))?;
                write_whole(&place, signed(&self.scene).as_bytes()).map_err(OutputError::reason)?;
            }
            Ok(Vec::new())
        };
        comm.from_root(begin).map_err(|reason| OutputError::Write { path: place.clone(), reason })?;
        if !self.fresh.is_empty() {
            write_records(comm, &self.done(), &self.fresh, None)?;
            self.saved += self.fresh.len();
            self.fresh.clear();
        }
        if !memory.is_empty() {
            let at = UnderWay {
                number: self.saved,
                edges: edges(system.pbox()),
                memory: memory.to_vec(),
                program: PROGRAM.to_owned(),
            };
            let record = Record { note: json(&at), particles: Some(Cow::Borrowed(system.particles())) };
            let [running, before] = self.running();
            write_records(comm, &running, &[record], Some(&before))?;
        }
        self.written = Instant::now();
        tracing::info!(outcomes = self.saved, "checkpoint written");
        Ok(())
    }
}

/// The records of a file; none if it does not exist or is damaged, which is worth a warning. Collective.
fn read_if_whole(comm: &Comm, path: &Path, bodies: &Bodies) -> Result<Vec<Record<'static>>, Failure> {
    if comm.from_root(|| Ok::<_, Failure>(vec![path.exists() as u8]))? == [0] {
        return Ok(Vec::new());
    }
    Ok(read_records(comm, path, bodies).unwrap_or_else(|error| {
        tracing::warn!("{error}; what it was about is done again");
        Vec::new()
    }))
}

/// Whether these are as many particles and points as the system has, over all ranks.
fn holds_all<M: Model>(system: &System<M>, particles: &Particles) -> bool {
    let counts = |p: &Particles| [p.len(), p.owned_points()].map(|n| system.comm.sum_count(n as u64));
    counts(particles) == counts(system.particles())
}

fn edges(pbox: &PeriodicBox) -> [f64; 3] {
    [pbox.lx(), pbox.ly(), pbox.xy()]
}

/// Memory of own particles.
fn bytes(particles: &Particles) -> usize {
    16 * (particles.len() + particles.owned_points())
}

fn json(value: &impl Serialize) -> String {
    // cannot fail for plain structs; what cannot be read back is done again
    serde_json::to_string(value).unwrap_or_default()
}

/// Refuses to go on with another scene; folders and pictures may change.
fn check_scene(stored: &str, place: &Path, scene: &Scene) -> Result<(), Failure> {
    let origin = place.display().to_string();
    let before = Scene::parse(stored, &origin, &[])?;
    let (before, now) = (keys(&before), keys(scene));
    let value = |rows: &[(String, String)], key: &str| {
        rows.iter().find(|(k, _)| k == key).map_or("absent".to_owned(), |(_, value)| value.clone())
    };
    let all = before.iter().chain(&now).map(|(key, _)| key);
    if let Some(key) = all.into_iter().find(|key| value(&before, key) != value(&now, key)) {
        return Err(Failure::Input(format!(
            "`{key}` is {}, but {} in the run to be resumed ({origin}): set it back, or begin another run in another \
             folder",
            value(&now, key),
            value(&before, key)
        )));
    }
    if stored.lines().next() != Some(PROGRAM) {
        tracing::warn!("{origin} was written by another version of jamhpc: results may not be the same bits");
    }
    Ok(())
}

/// The keys of a scene that decide its results, with their values.
fn keys(scene: &Scene) -> Vec<(String, String)> {
    fn collect(table: toml::Table, section: &str, rows: &mut Vec<(String, String)>) {
        for (key, value) in table {
            match value {
                toml::Value::Table(inner) => collect(inner, &format!("{section}{key}."), rows),
                value => rows.push((format!("{section}{key}"), value.to_string())),
            }
        }
    }
    let mut rows = Vec::new();
    collect(scene.of_results().to_toml().parse().unwrap_or_default(), "", &mut rows);
    rows
}

/// What batch systems ask for: a checkpoint, or one and the end.
#[derive(Clone)]
pub struct Signals {
    checkpoint: Arc<AtomicBool>,
    end: Arc<AtomicBool>,
}

impl Signals {
    /// From the first call on these signals do not end the process.
    pub fn listen() -> Result<Self, Failure> {
        // once for all packings of a process
        static SIGNALS: OnceLock<Result<Signals, String>> = OnceLock::new();
        let signals = SIGNALS.get_or_init(|| {
            let signals = Signals { checkpoint: Arc::default(), end: Arc::default() };
            // mpirun passes the second on as it is, and ends its ranks by force soon after the third
            for (signal, flag) in [(SIGUSR1, &signals.checkpoint), (SIGUSR2, &signals.end), (SIGTERM, &signals.end)] {
                signal_hook::flag::register(signal, Arc::clone(flag)).map_err(|e| e.to_string())?;
            }
            Ok(signals)
        });
        signals.clone().map_err(|reason| Failure::Other(format!("cannot listen to signals: {reason}")))
    }

    fn asks_for_checkpoint(&self) -> bool {
        self.checkpoint.swap(false, Ordering::Relaxed)
    }

    /// Whether this rank has been told to end.
    pub fn asks_for_end(&self) -> bool {
        self.end.load(Ordering::Relaxed)
    }
}
