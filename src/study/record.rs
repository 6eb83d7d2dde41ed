//! What is kept of one packing: its onset and its samples as numbers by name, or why they are missing.

use super::plan::{Member, scene_text};
use crate::comm::Comm;
use crate::engine::{System, Watch};
use crate::failure::Failure;
use crate::minimize::Minimizer;
use crate::model::Model;
use crate::observe::{Moduli, PerParticle, Sample};
use crate::protocol::Onset;
use crate::run::checkpoint::Checkpoints;
use crate::run::progress::Progress;
use crate::run::records::scalars;
use crate::run::{Sink, Task, drawing, protocol, with_system};
use crate::scene::{ColorBy, Scene};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// A packing as files hold it: the same bits whatever group of ranks made it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Record {
    pub ensemble: String,
    pub n_particles: u64,
    pub seed: u64,
    /// Plan of all packings of the group.
    pub scene: String,
    /// Density at onset, highest unjammed density below it, pressure at onset, minimisations that the search took.
    pub onset: Option<[f64; 4]>,
    /// Numbers of each sample by name, the onset first.
    #[serde(with = "numbers")]
    pub samples: Vec<(String, Vec<f64>)>,
    /// Why the packing ended early, if it did.
    pub failure: Option<String>,
}

/// A packing just made, with pictures of it on rank 0: densities and SVG documents.
#[derive(Default)]
pub struct Made {
    pub record: Record,
    pub pictures: Vec<(f64, String)>,
    /// Densities that are still to be drawn.
    to_draw: Vec<f64>,
}

/// Packing fractions at which the first packing of a group is drawn, as in the paper's figures 2 and 7.
pub const DRAWN: [f64; 2] = [0.92, 0.97];
/// Larger packings are not drawn.
const LARGEST_DRAWN: usize = 256;

impl Record {
    /// Makes a packing, or goes on with it if the folder `checkpoint` holds a part of it. What belongs to this packing
    /// alone, no convergence or no onset, is a failure inside the record; an error is something that would befall all of
    /// them. Collective.
    pub fn make(comm: Comm, member: &Member, checkpoint: PathBuf) -> Result<Made, Failure> {
        let scene = member.scene();
        let is_drawn = member.seed == member.group.seeds.start && scene.n_particles <= LARGEST_DRAWN;
        let to_draw = if is_drawn { DRAWN.to_vec() } else { Vec::new() };
        let record = Record {
            ensemble: member.group.ensemble.clone(),
            n_particles: scene.n_particles as u64,
            seed: member.seed,
            scene: scene_text(&scene),
            ..Record::default()
        };
        let mut made = Made { record, to_draw, ..Made::default() };
        let mut stopped = None;
        let task = Make { scene: &scene, checkpoint, made: &mut made, stopped: &mut stopped };
        let outcome = with_system(comm, &scene, task);
        if let Some(reason) = stopped {
            return Err(reason);
        }
        match outcome {
            Ok(()) => {}
            Err(Failure::NotConverged(reason) | Failure::Other(reason)) => made.record.failure = Some(reason),
            Err(interrupted @ Failure::Interrupted(_)) => return Err(interrupted),
            Err(Failure::Input(reason)) => return Err(Failure::Input(format!("{}: {reason}", member.id()))),
        }
        Ok(made)
    }

    pub fn id(&self) -> String {
        format!("{}-N{}-seed{}", self.ensemble, self.n_particles, self.seed)
    }
}

/// JSON has no NaN: null stands for a number that is none.
mod numbers {
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    type Named<T> = Vec<(String, Vec<T>)>;

    pub fn serialize<S: Serializer>(samples: &Named<f64>, serializer: S) -> Result<S::Ok, S::Error> {
        let finite = |values: &Vec<f64>| values.iter().map(|&x| x.is_finite().then_some(x)).collect();
        let named: Named<Option<f64>> = samples.iter().map(|(name, values)| (name.clone(), finite(values))).collect();
        named.serialize(serializer)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Named<f64>, D::Error> {
        let named = Named::<Option<f64>>::deserialize(deserializer)?;
        let plain = |values: Vec<Option<f64>>| values.into_iter().map(|x| x.unwrap_or(f64::NAN)).collect();
        Ok(named.into_iter().map(|(name, values)| (name, plain(values))).collect())
    }
}

struct Make<'a> {
    scene: &'a Scene,
    checkpoint: PathBuf,
    made: &'a mut Made,
    /// Why its checkpoints end it, if they do: a signal, a full disk, a folder that is not to be written to.
    stopped: &'a mut Option<Failure>,
}

impl Task for Make<'_> {
    fn act<M: Model>(self, mut system: System<M>, minimizer: &impl Minimizer) -> Result<(), Failure> {
        let checkpoints = Checkpoints::of_member(&system.comm, minimizer, self.scene, self.checkpoint)
            .inspect_err(|failure| *self.stopped = Some(failure.clone()))?;
        system.watch = Some(Watch { told: Box::new(|_, _| {}), ends: checkpoints.ends() });
        let moduli = |system: &mut System<M>| checkpoints.remember(system, Moduli::of);
        let silent = Progress::new(false);
        let outcome = protocol(&mut system, &checkpoints, moduli, self.scene, self.made, &silent);
        *self.stopped = checkpoints.interruption();
        outcome
    }
}

impl Sink for Made {
    fn set_onset(&mut self, onset: Onset) {
        self.record.onset = Some([onset.density, onset.unjammed, onset.pressure, onset.steps as f64]);
    }

    fn append<M: Model>(
        &mut self,
        system: &mut System<M>,
        density: f64,
        sample: Sample,
        columns: &PerParticle,
    ) -> Result<(), Failure> {
        let row = scalars(density, &sample);
        let samples = &mut self.record.samples;
        if samples.is_empty() {
            *samples = row.iter().map(|(name, _)| (name.to_string(), Vec::new())).collect();
        }
        for ((_, values), (_, value)) in samples.iter_mut().zip(row) {
            values.push(value);
        }
        while let Some(&next) = self.to_draw.first().filter(|&&next| sample.density.packing_fraction >= next) {
            self.to_draw.remove(0);
            if let Some(picture) = drawing::svg(system, &sample, columns, ColorBy::Z)? {
                self.pictures.push((next, picture));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_bit_survives_the_file() {
        let record = Record { samples: vec![("x".into(), vec![0.1, f64::NAN, 1e-300])], ..Record::default() };
        let text = serde_json::to_string(&record).unwrap();
        let back: Record = serde_json::from_str(&text).unwrap();
        let bits = |r: &Record| r.samples[0].1.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
        assert_eq!(bits(&back), bits(&record));
    }
}
