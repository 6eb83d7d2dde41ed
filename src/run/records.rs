//! What a run leaves behind: the results file, pictures, a plot, and the table on the standard output.

use super::{Sink, drawing, setup, table};
use crate::engine::System;
use crate::failure::Failure;
use crate::model::Model;
use crate::observe::{PerParticle, Rattlers, Sample};
use crate::output::render::write_plot;
use crate::output::{Folder, Frame, ResultsFile};
use crate::profile::{self, Phase};
use crate::protocol::Onset;
use crate::scene::Scene;
use std::path::PathBuf;

const RESULTS: &str = "results.h5";
const UNFINISHED: &str = "results.h5.part";
const PICTURES: [&str; 2] = ["packing.svg", "packing.png"];
const PLOTS: [&str; 2] = ["plot.svg", "plot.png"];

/// The samples of a run, on the disk and, as single numbers, in memory.
pub struct Records {
    /// None once it is finished.
    file: Option<ResultsFile>,
    onset: Option<Onset>,
    samples: Vec<Sample>,
    /// Density of each sample as the protocol set it.
    densities: Vec<f64>,
}

impl Records {
    /// A run that is resumed writes the unfinished file of the one before anew, with all that was in it. Collective,
    /// like everything here.
    pub fn create<M: Model>(system: &System<M>, scene: &Scene, folder: &Folder, resume: bool) -> Result<Self, Failure> {
        let header = setup::header(scene);
        if resume {
            folder.remove(&system.comm, UNFINISHED)?;
        }
        let file = ResultsFile::create(&system.comm, &folder.file(RESULTS), &header, &system.own_particles())?;
        Ok(Records { file: Some(file), onset: None, samples: Vec::new(), densities: Vec::new() })
    }

    pub fn n_samples(&self) -> usize {
        self.samples.len()
    }

    /// Gives the results file its name, marked with the failure if there was one, and draws. Answers what is to be said of
    /// it, on rank 0.
    pub fn finish<M: Model>(
        &mut self,
        system: &mut System<M>,
        scene: &Scene,
        folder: &Folder,
        failure: Option<&Failure>,
    ) -> Result<String, Failure> {
        let _output = profile::enter(Phase::Output);
        let mut written = vec![RESULTS];
        let mut moved = None;
        if let Some(file) = self.file.take() {
            moved = file.finish(&system.comm, failure.map(|f| f.to_string()).as_deref())?;
        }
        // after a failure the system is not in the state of a sample
        if scene.output.picture && failure.is_none() {
            let (sample, columns) = Sample::measure(system, &Default::default(), Rattlers::default())?;
            let pictures = PICTURES.map(|name| folder.file(name));
            drawing::draw(system, &sample, &columns, scene.output.color_by, None, &pictures)?;
            written.extend(PICTURES);
        }
        if !self.samples.is_empty() {
            system.comm.from_root(|| self.plot(folder).map(|()| Vec::new()))?;
            written.extend(PLOTS);
        }
        let is_root = system.comm.is_root();
        Ok(if is_root { self.table(scene) + &table_of_files(folder, &written, moved) } else { String::new() })
    }

    fn plot(&self, folder: &Folder) -> Result<(), Failure> {
        let rows: Vec<_> = self.samples.iter().zip(&self.densities).map(|(s, &d)| scalars(d, s)).collect();
        let series: Vec<(String, Vec<f64>)> =
            (0..rows[0].len()).map(|k| (rows[0][k].0.to_string(), rows.iter().map(|row| row[k].1).collect())).collect();
        PLOTS.iter().try_for_each(|name| Ok(write_plot(&folder.file(name), &series)?))
    }

    fn table(&self, scene: &Scene) -> String {
        let onset = self.onset.as_ref().map(|onset| table::onset_line(scene.model(), onset) + "\n");
        let samples = (!self.samples.is_empty()).then(|| table::table(scene, &self.samples));
        onset.into_iter().chain(samples).collect()
    }
}

impl Sink for Records {
    fn set_onset(&mut self, onset: Onset) {
        self.onset = Some(onset);
    }

    fn append<M: Model>(
        &mut self,
        system: &mut System<M>,
        density: f64,
        sample: Sample,
        columns: &PerParticle,
    ) -> Result<(), Failure> {
        let Some(file) = &mut self.file else { return Ok(()) };
        system.lay_bare();
        let frame = Frame {
            step: self.samples.len() as u64,
            pbox: system.pbox(),
            particles: system.particles(),
            scalars: &scalars(density, &sample),
            tensors: &sample.tensors(),
            columns: &columns.named(),
        };
        let _output = profile::enter(Phase::Output);
        file.append(&system.comm, &frame)?;
        self.samples.push(sample);
        self.densities.push(density);
        Ok(())
    }
}

/// Everything that files call a scalar of a sample.
pub fn scalars(density: f64, sample: &Sample) -> Vec<(&'static str, f64)> {
    [vec![("density", density)], sample.scalars()].concat()
}

/// What was written, with sizes.
fn table_of_files(folder: &Folder, names: &[&str], moved: Option<PathBuf>) -> String {
    let line = |name: &&str| {
        let path = folder.file(name);
        let bytes = std::fs::metadata(&path).map_or(0, |m| m.len());
        format!("{:>9.1} kB  {}\n", bytes as f64 / 1e3, path.display())
    };
    let moved = moved.map(|moved| format!("older results are now {}\n", moved.display()));
    std::iter::once("\n".to_owned()).chain(names.iter().map(line)).chain(moved).collect()
}
