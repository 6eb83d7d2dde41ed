//! The data set of a study: packings of one kind together, and averages over them at one distance above their onsets.

use super::plan::by_ensemble;
use super::record::Record;
use super::store::Store;
use crate::failure::Failure;
use crate::scene::{Model, Physics, Scene};
use crate::statistics::{Curve, Estimate, bootstrap, mean, spread};
use std::collections::BTreeMap;

/// Resamples for the errors of averages.
const RESAMPLES: usize = 400;

/// What may be averaged. Stresses are in ε/σ_LS² for soft disks, as in the paper, and in γ/l for deformable particles.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quantity {
    Phi,
    Rho,
    /// φ − φ_J and ρ − ρ_J, of each packing's own onset.
    DeltaPhi,
    DeltaRho,
    ContactNumber,
    /// z − z_J
    DeltaContactNumber,
    /// Mean over all directions of shear; NaN where the state was not stable.
    ShearModulus,
    EnergyPerParticle,
    /// φ − ρ
    Overlap,
    /// 1 − ⟨a⟩/a_J
    AreaLoss,
    /// 𝒜 − 1, relative to the undeformed particle.
    Shape,
    /// Fraction of the voids that have so many sides.
    Voids(usize),
    /// 𝒜 of the voids with three sides; NaN if there are none.
    BorderShape,
}

/// One packing as numbers.
pub struct Packing {
    pub seed: u64,
    /// Density at onset, and the highest below it that was unjammed.
    pub onset: Option<[f64; 2]>,
    n_samples: usize,
    named: BTreeMap<String, Vec<f64>>,
    /// What a stress is multiplied by.
    stress: f64,
    n_particles: f64,
}

/// Packings that differ by their seeds only.
pub struct Packings {
    pub ensemble: String,
    pub model: Model,
    pub n_particles: usize,
    pub all: Vec<Packing>,
    pub failures: Vec<String>,
}

/// Everything of one ensemble, by system size.
pub struct Ensemble {
    pub name: String,
    pub model: Model,
    pub sizes: Vec<Packings>,
}

/// The ensembles of a data set, their sizes ascending.
pub fn ensembles(store: &Store) -> Result<Vec<Ensemble>, Failure> {
    let mut out = Vec::new();
    for (name, records) in by_ensemble(&store.records, |r| &r.ensemble) {
        let mut by_size: BTreeMap<u64, Vec<&Record>> = BTreeMap::new();
        records.into_iter().for_each(|r| by_size.entry(r.n_particles).or_default().push(r));
        let sizes = by_size.into_values().map(|records| packings(&records)).collect::<Result<Vec<_>, Failure>>()?;
        let Some(model) = sizes.first().map(|s| s.model) else { continue };
        out.push(Ensemble { name, model, sizes });
    }
    Ok(out)
}

fn packings(records: &[&Record]) -> Result<Packings, Failure> {
    let scene = Scene::parse(&records[0].scene, &records[0].id(), &[])?;
    // the paper's unit of stress has the mean diameter in it, and its unit of energy is that of a contact
    let stress = match &scene.physics {
        Physics::Sp(sp) => {
            let (low, high) = sp
                .particles
                .diameters
                .iter()
                .fold((f64::INFINITY, 0.0f64), |(low, high), &d| (low.min(d), high.max(d)));
            (0.5 * (low + high)).powi(2) / sp.potential.epsilon
        }
        Physics::Dp(_) => 1.0,
    };
    let packing = |r: &&Record| Packing {
        seed: r.seed,
        onset: r.onset.map(|[density, unjammed, ..]| [density, unjammed]),
        n_samples: r.samples.first().map_or(0, |(_, values)| values.len()),
        named: r.samples.iter().cloned().collect(),
        stress,
        n_particles: r.n_particles as f64,
    };
    Ok(Packings {
        ensemble: records[0].ensemble.clone(),
        model: scene.model(),
        n_particles: scene.n_particles,
        all: records.iter().map(packing).collect(),
        failures: records.iter().filter_map(|r| r.failure.clone()).collect(),
    })
}

impl Packing {
    fn named(&self, name: &str, k: usize) -> f64 {
        self.named.get(name).and_then(|values| values.get(k)).copied().unwrap_or(f64::NAN)
    }

    /// The value at sample `k`, 0 being the onset; NaN if there is none. A packing that a compression has made to fall
    /// apart, so that no contacts hold it, has none until it jams again.
    pub fn value(&self, quantity: Quantity, k: usize) -> f64 {
        if self.named("contact_number", k) == 0.0 {
            return f64::NAN;
        }
        let at = |name: &str| self.named(name, k);
        let since_onset = |name: &str| self.named(name, k) - self.named(name, 0);
        match quantity {
            Quantity::Phi => at("reduced_number_density"),
            Quantity::Rho => at("packing_fraction"),
            Quantity::DeltaPhi => since_onset("reduced_number_density"),
            Quantity::DeltaRho => since_onset("packing_fraction"),
            Quantity::ContactNumber => at("contact_number"),
            Quantity::DeltaContactNumber => since_onset("contact_number"),
            Quantity::ShearModulus if at("moduli_are_stable") == 1.0 => at("mean_shear_modulus") * self.stress,
            Quantity::ShearModulus => f64::NAN,
            Quantity::EnergyPerParticle => at("energy_total") / self.n_particles,
            Quantity::Overlap => at("reduced_number_density") - at("packing_fraction"),
            Quantity::AreaLoss => 1.0 - at("mean_area") / self.named("mean_area", 0),
            Quantity::Shape => at("shape_parameter_relative") - 1.0,
            Quantity::Voids(sides) => at(&format!("voids_{sides}_sided")),
            Quantity::BorderShape => match at("void_shape_parameter_3_sided") {
                shape if shape > 0.0 => shape,
                _ => f64::NAN,
            },
        }
    }

    /// The value at a packing fraction, on the line between two samples; NaN outside of them.
    pub fn at(&self, quantity: Quantity, rho: f64) -> f64 {
        let point = |k: usize| [self.value(Quantity::Rho, k), self.value(quantity, k)];
        let mut pieces = (1..self.n_samples).map(|k| [point(k - 1), point(k)]);
        let piece = pieces.find(|[a, b]| a[0] <= rho && rho <= b[0]);
        piece.map_or(f64::NAN, |[a, b]| a[1] + (b[1] - a[1]) * (rho - a[0]) / (b[0] - a[0]))
    }

    pub fn n_samples(&self) -> usize {
        self.n_samples
    }

    /// How far above its onset it was found jammed: as far as the slope of the pressure up to the next sample says, but
    /// not beyond the density where it was not jammed.
    fn onset_excess(&self) -> Option<f64> {
        let [density, unjammed] = self.onset?;
        let [first, next] = [0, 1].map(|k| [self.named("density", k), self.named("pressure", k)]);
        let by_pressure = first[1] * (next[0] - first[0]) / (next[1] - first[1]);
        let bracket = density - unjammed;
        Some(if by_pressure >= 0.0 { by_pressure.min(bracket) } else { bracket })
    }
}

impl Packings {
    pub fn n_samples(&self) -> usize {
        self.all.iter().map(|p| p.n_samples).max().unwrap_or(0)
    }

    /// φ_J or ρ_J of all packings that have one.
    pub fn onsets(&self) -> Vec<f64> {
        self.all.iter().filter_map(|p| p.onset.map(|[density, _]| density)).collect()
    }

    /// Mean distance of packings from their onsets where these were found.
    pub fn onset_excess(&self) -> f64 {
        mean(self.all.iter().filter_map(Packing::onset_excess))
    }

    /// Whether the spread of onsets is that of packings, and not that of the search.
    pub fn resolves_onsets(&self) -> bool {
        spread(self.onsets().into_iter()) > 4.0 * self.onset_excess()
    }

    /// Values of all packings at all samples.
    pub fn values(&self, of: impl Fn(&Packing, usize) -> f64) -> Vec<Vec<f64>> {
        let n = self.n_samples();
        self.all.iter().map(|p| (0..n).map(|k| of(p, k)).collect()).collect()
    }

    /// Mean of each sample, the onset first.
    pub fn average(&self, quantity: Quantity) -> Vec<Estimate> {
        let values = self.values(|p, k| p.value(quantity, k));
        bootstrap(&[values.len()], RESAMPLES, |drawn| means(&values, &drawn[0]))
    }

    /// Means of two quantities, one against the other; errors of the second.
    pub fn curve(&self, x: Quantity, y: Quantity) -> Curve {
        let [x, y] = [x, y].map(|q| self.values(|p, k| p.value(q, k)));
        let everyone: Vec<usize> = (0..self.all.len()).collect();
        Curve { x: means(&x, &everyone), y: means(&y, &everyone), error: errors(&y) }
    }

    /// A fit to means of two quantities within a window of the first, with errors by resampling packings.
    pub fn fitted(
        &self,
        [x, y]: [Quantity; 2],
        window: [f64; 2],
        resamples: usize,
        fit: impl Fn(&Curve) -> Vec<f64>,
    ) -> Vec<Estimate> {
        let [x, y] = [x, y].map(|q| self.values(|p, k| p.value(q, k)));
        let error = errors(&y);
        bootstrap(&[self.all.len()], resamples, |drawn| {
            let curve = Curve { x: means(&x, &drawn[0]), y: means(&y, &drawn[0]), error: error.clone() };
            fit(&curve.within(window))
        })
    }
}

fn means(values: &[Vec<f64>], drawn: &[usize]) -> Vec<f64> {
    let n = values.first().map_or(0, Vec::len);
    (0..n).map(|k| mean(drawn.iter().map(|&m| values[m][k]))).collect()
}

/// Standard errors of the means. Few packings, all alike, would have none: 10⁻⁶ of the mean is the least.
fn errors(values: &[Vec<f64>]) -> Vec<f64> {
    let n = values.first().map_or(0, Vec::len);
    let error = |k: usize| {
        let column = values.iter().map(|row| row[k]);
        let count = column.clone().filter(|x| !x.is_nan()).count() as f64;
        let error = spread(column.clone()) / count.sqrt();
        error.max(1e-6 * mean(column).abs())
    };
    (0..n).map(error).collect()
}
