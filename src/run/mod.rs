//! A scene from beginning to end: random start, onset search, compression, shear, and what is kept of it.

pub mod checkpoint;
pub mod drawing;
mod memory;
pub mod progress;
pub mod records;
pub mod setup;
mod table;

use crate::comm::Comm;
use crate::engine::{EngineError, System, Watch};
use crate::failure::Failure;
use crate::minimize::{ConjugateGradient, Fire, Minimizer, Newton, Report};
use crate::model::{EdgeEdge, Model, VertexEdge};
use crate::observe::{Moduli, OnsetBracket, PerParticle, Rattlers, Sample, refuse_crossings};
use crate::output::{Folder, print};
use crate::protocol::{Onset, compress_to, find_onset, shear_by};
use crate::scene::{self, Compression, Contact, Method, Physics, Scene};
use checkpoint::{Checkpoints, Signals};
use progress::Progress;
use records::Records;
use std::path::Path;

/// Runs a scene, or goes on with a run of it, and keeps its results in a folder; `speaks` allows progress lines.
pub fn run(comm: Comm, scene: &Scene, resume: bool, speaks: bool) -> Result<(), Failure> {
    Signals::listen()?;
    // not after hours, when the box has become small
    setup::check(comm.size(), scene)?;
    with_system(comm, scene, Keep { scene, resume, speaks })
}

/// Something to do with the system of a scene, whose types are known only once the scene has been read.
pub trait Task {
    fn act<M: Model>(self, system: System<M>, minimizer: &impl Minimizer) -> Result<(), Failure>;
}

/// Sets a scene up at its random start. The types of its model and its minimiser are chosen here, once.
pub fn with_system(comm: Comm, scene: &Scene, task: impl Task) -> Result<(), Failure> {
    match &scene.physics {
        Physics::Sp(sp) => minimized_by(setup::soft_disks(comm, scene, sp)?, scene, task),
        Physics::Dp(dp) => match dp.potential.contact {
            Contact::VertexEdge => minimized_by(setup::deformable::<VertexEdge>(comm, scene, dp)?, scene, task),
            Contact::EdgeEdge => minimized_by(setup::deformable::<EdgeEdge>(comm, scene, dp)?, scene, task),
        },
    }
}

fn minimized_by<M: Model>(system: System<M>, scene: &Scene, task: impl Task) -> Result<(), Failure> {
    match scene.minimize.method {
        Method::Fire => task.act(system, &Fire),
        Method::Cg => task.act(system, &ConjugateGradient),
        Method::Newton => task.act(system, &Newton),
    }
}

/// A run that is kept.
#[derive(Clone, Copy)]
struct Keep<'a> {
    scene: &'a Scene,
    resume: bool,
    speaks: bool,
}

impl Task for Keep<'_> {
    fn act<M: Model>(self, system: System<M>, minimizer: &impl Minimizer) -> Result<(), Failure> {
        keep(system, minimizer, self)
    }
}

/// Who takes what a protocol gives.
pub trait Sink {
    fn set_onset(&mut self, onset: Onset);

    /// A sample of the system's present state; `density` is what the protocol set. Collective.
    fn append<M: Model>(
        &mut self,
        system: &mut System<M>,
        density: f64,
        sample: Sample,
        columns: &PerParticle,
    ) -> Result<(), Failure>;
}

/// Runs the protocol and keeps what it gives: samples as they come, then picture, plot and table. A run that fails
/// keeps the samples that it had; one that is interrupted leaves its results file unfinished.
fn keep<M: Model>(
    mut system: System<M>,
    minimizer: &impl Minimizer,
    Keep { scene, resume, speaks }: Keep,
) -> Result<(), Failure> {
    // held until the end of the run; a new one must not judge the checkpoint of another that is still working
    let hold = |comm: &Comm| {
        Folder::prepare(comm, Path::new(&scene.output.directory)).map_err(|e| Failure::Input(e.to_string()))
    };
    let held = if resume { None } else { Some(hold(&system.comm)?) };
    let checkpoints = Checkpoints::new(&system.comm, minimizer, scene, resume)?;
    // a run that has nothing to resume leaves no folder
    let folder = held.map_or_else(|| hold(&system.comm), Ok)?;
    let progress = Progress::new(speaks && system.comm.is_root());
    let (speaker, unit) = (progress.clone(), system.model.force_unit());
    let told = Box::new(move |forces, max_force| speaker.relaxing(forces, max_force / unit));
    system.watch = Some(Watch { told, ends: checkpoints.ends() });
    let mut records = Records::create(&system, scene, &folder, resume)?;
    let moduli = |system: &mut System<M>| checkpoints.remember(system, Moduli::of);
    let outcome = protocol(&mut system, &checkpoints, moduli, scene, &mut records, &progress);
    progress.finish();
    if let Some(interruption) = checkpoints.interruption() {
        return Err(interruption);
    }
    let kept = records.finish(&mut system, scene, &folder, outcome.as_ref().err());
    progress.end(memory::peak(&system.comm, system.n_points()));
    // what went wrong outside of the run, like a full disk, need not go wrong again
    if kept.is_ok() && matches!(outcome, Ok(()) | Err(Failure::NotConverged(_))) {
        checkpoints.remove(&system.comm);
    }
    match (outcome, kept) {
        (Ok(()), kept) => Ok(print(&system.comm, &kept?)?),
        (Err(failure), Ok(text)) => {
            let _ = print(&system.comm, &text); // the failure of the run is what is to be known
            Err(failure.and(&format!("{} samples until then are kept", records.n_samples())))
        }
        (Err(failure), Err(_)) => Err(failure),
    }
}

/// The protocol: a sample at the onset if samples are counted from there, then at each density and at each shear strain
/// of the scene, every one force-balanced and uncrossed.
pub fn protocol<M: Model>(
    system: &mut System<M>,
    minimizer: &impl Minimizer,
    moduli: impl Fn(&mut System<M>) -> Result<Moduli, Failure>,
    scene: &Scene,
    records: &mut impl Sink,
    progress: &Progress,
) -> Result<(), Failure> {
    let goal = setup::goal(scene);
    refuse_crossings(system).map_err(|error| match error {
        EngineError::Crossing(..) => Failure::from(error).and("lower initial.packing_fraction"),
        other => other.into(),
    })?;
    let mut state = State { scene, onset: None, strain: 0.0 };
    if scene.compression.needs_onset() {
        let mut last = Report::default();
        let onset = find_onset(system, minimizer, &goal, &setup::onset_search(scene), |density, energies, report| {
            last = *report;
            progress.state("onset", density, energies.pressure() / scene.pressure_unit(), report.iterations);
        })?;
        records.set_onset(onset);
        state.onset = Some(onset);
        sample(system, &moduli, &last, state, records)?;
    }
    let onset = state.onset.map_or(0.0, |onset| onset.density);
    let densities = scene.samples(onset);
    if let (Compression::Until { until, .. }, []) = (&scene.compression, &densities[..]) {
        tracing::warn!("`compression.until` = {until} is not above the onset at {onset:.6}: no sample but that");
    }
    let left_out = scene.compression.samples(onset).len() - densities.len();
    if left_out > 0 {
        tracing::warn!(
            "{left_out} of the samples above the onset at {onset:.6} are left out: polygons are not compressed beyond {}",
            scene::DENSEST_DP
        );
    }
    for density in densities {
        let report = compress_to(system, minimizer, &goal, density)?;
        let pressure = sample(system, &moduli, &report, state, records)?;
        progress.state("compression", density, pressure / scene.pressure_unit(), report.iterations);
    }
    for strain in scene.shear.strains() {
        let report = shear_by(system, minimizer, &goal, strain - state.strain)?;
        state.strain = strain;
        let pressure = sample(system, &moduli, &report, state, records)?;
        progress.state("shear", system.density()?, pressure / scene.pressure_unit(), report.iterations);
    }
    Ok(())
}

/// What a sample cannot see of its state.
#[derive(Clone, Copy)]
struct State<'a> {
    scene: &'a Scene,
    /// None if it was not searched.
    onset: Option<Onset>,
    strain: f64,
}

/// Measures the present state and appends it to the results; answers its pressure.
fn sample<M: Model>(
    system: &mut System<M>,
    moduli: &impl Fn(&mut System<M>) -> Result<Moduli, Failure>,
    report: &Report,
    State { scene, onset, strain }: State,
    records: &mut impl Sink,
) -> Result<f64, Failure> {
    refuse_crossings(system)?;
    let (mut sample, columns) = Sample::measure(system, report, Rattlers::default())?;
    sample.strain = strain;
    if scene.measure.moduli {
        sample.moduli = Some(moduli(system)?);
    }
    sample.onset = onset.map(|onset| OnsetBracket { onset: onset.density, unjammed: onset.unjammed });
    let density = system.density()?;
    records.append(system, density, sample, &columns)?;
    Ok(sample.pressure())
}
