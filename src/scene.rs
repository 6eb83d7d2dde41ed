//! The scene: a TOML text, checked key by key, becomes the typed plan of a run. Nothing is read or written here.
//!
//! To add a key, add a row to `KEYS`, a field to the struct of its section, and a commented line to the starter scenes
//! in `src/scenes/` (a test compares the three). Rules that tie several keys together stand in `check_rules`.

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use toml::{Table, Value};

/// The scene that runs when none is given.
pub const DEFAULT: &str = include_str!("scenes/default.toml");
/// Commented scene of soft particles with every key, for `jamhpc init sp`.
pub const SP_STARTER: &str = include_str!("scenes/sp.toml");
/// Commented scene of deformable particles with every key, for `jamhpc init dp`.
pub const DP_STARTER: &str = include_str!("scenes/dp.toml");

/// Line tension gamma of deformable particles: the unit of force, times l the unit of energy.
pub const LINE_TENSION: f64 = 1.0;

// ---------------------------------------------------------------------------------------------------------------------
// The plan

/// A validated plan. Units: sp uses sigma_S (the smallest diameter, = 1) and epsilon; dp uses l and gamma (both = 1).
///
/// Make one with [`Scene::parse`]; deserializing directly skips the checks.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Scene {
    /// `model`, `[particles]` and `[potential]`: match on it once to choose the types of a run.
    #[serde(flatten)]
    pub physics: Physics,
    /// In the periodic box, over all species.
    pub n_particles: usize,
    /// Key of the random numbers; sp and dp runs with one seed start from the same centres.
    pub seed: u64,
    pub initial: Initial,
    pub onset: Onset,
    pub compression: Compression,
    pub shear: Shear,
    pub measure: Measure,
    pub minimize: Minimize,
    pub neighbor: Neighbor,
    pub checkpoint: Checkpoint,
    pub output: Output,
}

/// What the particles are and how they interact.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "model", rename_all = "lowercase")]
pub enum Physics {
    /// Soft disks.
    Sp(SpPhysics),
    /// Deformable particles.
    Dp(DpPhysics),
}

/// The two particle models.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Model {
    Sp,
    Dp,
}

/// Soft disks: `[particles]` and `[potential]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SpPhysics {
    pub particles: SpParticles,
    pub potential: SpPotential,
}

/// Sizes of soft disks, one entry a species.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SpParticles {
    /// In units of the smallest diameter sigma_S, which is 1.
    pub diameters: Vec<f64>,
    /// Fraction of the particles in each species; sums to 1.
    pub fractions: Vec<f64>,
}

/// Energy of two soft disks, epsilon/2 (1 - r/sigma)^2.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SpPotential {
    /// Contact energy scale.
    pub epsilon: f64,
}

/// Deformable particles: `[particles]` and `[potential]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DpPhysics {
    pub particles: DpParticles,
    pub potential: DpPotential,
}

/// Vertex numbers of deformable particles, one entry a species; rest areas follow from them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DpParticles {
    pub n_vertices: Vec<usize>,
    /// Fraction of the particles in each species; sums to 1.
    pub fractions: Vec<f64>,
}

/// Numbers of the deformable-particle energy, preset and overrides already resolved.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DpPotential {
    /// Where numbers not given in the scene came from.
    pub preset: Preset,
    /// Circulo-line width (l).
    pub delta: f64,
    /// Area stiffness k_a a_S0^2/(gamma l).
    pub kappa: f64,
    /// Contact energy over area energy, epsilon/(k_a a_L0^2).
    pub stiffness: f64,
    pub contact: Contact,
}

/// A named choice of `delta`, `kappa` and `stiffness`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Preset {
    /// Contacts about as stiff as areas: several times fewer force evaluations by FIRE and conjugate gradients.
    Fast,
    /// Contacts stiffer than areas, areas stiffer than line tension, as the paper asks.
    Paper,
}

/// Form of the contact energy between circulo-lines.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Contact {
    /// Smooth.
    VertexEdge,
    /// The paper's form: forces jump where facing edges are parallel, so minimisation may not converge.
    EdgeEdge,
}

/// The random start.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Initial {
    /// Particle area over box area.
    pub packing_fraction: f64,
    /// Centres are first spread evenly, relaxed as disks that cover this part of the box; 0 leaves them random.
    pub spread: f64,
}

/// Search for the jamming onset. `step` and `smallest_step` are increments of phi (sp) or rho (dp).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Onset {
    /// First increment.
    pub step: f64,
    /// The search gives up when its increment has become smaller than this.
    pub smallest_step: f64,
    /// Window \[lo, hi\] of the pressure at onset; a state above lo is jammed. Unit [`Scene::pressure_unit`].
    pub pressure: [f64; 2],
}

/// Where samples are taken, in phi (sp) or rho (dp).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Compression {
    /// These distances above each packing's own onset.
    Increments { increments: Vec<f64> },
    /// From onset in steps, the last sample at `until` itself.
    Until { until: f64, step: f64 },
    /// Distances above onset evenly spaced in the logarithm.
    Log { log: LogSteps },
    /// These densities, whether jammed or not: no onset is searched.
    Densities { densities: Vec<f64> },
}

/// Logarithmic list of distances from onset: `from`, then `per_decade` a decade, up to `to`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LogSteps {
    pub from: f64,
    pub to: f64,
    pub per_decade: usize,
}

/// Quasi-static simple shear of the last state of the compression.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Shear {
    /// Strain at the end; 0 for none.
    pub until: f64,
    /// Strain between samples, each relaxed.
    pub step: f64,
}

impl Shear {
    /// The strains to sample, ascending.
    pub fn strains(&self) -> Vec<f64> {
        // a last step of nothing but rounding is none
        let n = (self.until / self.step - 1e-9).ceil().max(0.0) as usize;
        (1..=n).map(|k| (k as f64 * self.step).min(self.until)).collect()
    }
}

/// What is measured at each sample besides what costs little.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Measure {
    /// Elastic moduli by linear response.
    pub moduli: bool,
}

/// How a state is relaxed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Minimize {
    pub method: Method,
    /// max|F| at which a state is relaxed. Unit [`Scene::force_unit`].
    pub force_tolerance: f64,
    /// Iterations after which a state counts as not converged.
    pub max_iterations: usize,
}

/// Minimiser.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Method {
    /// Fast inertial relaxation engine.
    Fire,
    /// Nonlinear conjugate gradients.
    Cg,
    /// Newton's method with a sparse factor of the Hessian, through softer contacts.
    Newton,
}

/// Neighbour lists.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Neighbor {
    /// Extra reach of the neighbour lists (sigma_S or l).
    pub skin: f64,
}

/// What a run that is killed does not lose.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Checkpoint {
    /// Seconds between checkpoints.
    pub interval: f64,
}

/// What is written, and where.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Output {
    pub directory: String,
    /// Draw the last state.
    pub picture: bool,
    pub color_by: ColorBy,
}

/// What colours the particles of a picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ColorBy {
    /// Contacts of the particle.
    Z,
    ShapeParameter,
    Pressure,
}

/// One species of soft disks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpSpecies {
    pub fraction: f64,
    /// Particles of this species.
    pub count: usize,
    /// In sigma_S.
    pub diameter: f64,
}

/// One species of deformable particles.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DpSpecies {
    pub fraction: f64,
    /// Particles of this species.
    pub count: usize,
    pub n_vertices: usize,
    /// Rest area of the polygon, in l^2.
    pub a0: f64,
}

impl Model {
    /// The value of the key `model`.
    pub fn name(self) -> &'static str {
        match self {
            Model::Sp => "sp",
            Model::Dp => "dp",
        }
    }
}

impl Preset {
    /// `delta` (l), `kappa` and `stiffness`.
    fn values(self) -> [(&'static str, f64); 3] {
        let [delta, kappa, stiffness] = match self {
            Preset::Fast => [0.1, 1000.0, 0.01],
            Preset::Paper => [0.1, 1000.0, 1.1],
        };
        [("potential.delta", delta), ("potential.kappa", kappa), ("potential.stiffness", stiffness)]
    }
}

impl SpPhysics {
    /// The species in the order of the scene, with the number of particles of each among `n_particles`.
    pub fn species(&self, n_particles: usize) -> Vec<SpSpecies> {
        let SpParticles { diameters, fractions } = &self.particles;
        let counts = species_counts(n_particles, fractions);
        let rows = fractions.iter().zip(counts).zip(diameters);
        rows.map(|((&fraction, count), &diameter)| SpSpecies { fraction, count, diameter }).collect()
    }
}

impl DpPhysics {
    /// The species in the order of the scene, with the number of particles of each among `n_particles`.
    pub fn species(&self, n_particles: usize) -> Vec<DpSpecies> {
        let DpParticles { n_vertices, fractions } = &self.particles;
        let counts = species_counts(n_particles, fractions);
        let rows = fractions.iter().zip(counts).zip(n_vertices);
        rows.map(|((&fraction, count), &n_vertices)| DpSpecies {
            fraction,
            count,
            n_vertices,
            a0: self.rest_area(n_vertices),
        })
        .collect()
    }

    /// Rest area (l^2) of a polygon of `n_vertices`: it grows with n_vertices^2, so that all species have edges of one
    /// length, and l = (sqrt(a_S0) + sqrt(a_L0))/2 = 1.
    pub fn rest_area(&self, n_vertices: usize) -> f64 {
        let (smallest, largest) = self.extreme_n_vertices();
        (2.0 * n_vertices as f64 / (smallest + largest) as f64).powi(2)
    }

    fn extreme_n_vertices(&self) -> (usize, usize) {
        let all = || self.particles.n_vertices.iter().copied();
        (all().min().unwrap_or(0), all().max().unwrap_or(0))
    }

    /// Area stiffness k_a = kappa gamma l/a_S0^2 (gamma/l^3).
    pub fn k_area(&self) -> f64 {
        self.potential.kappa * LINE_TENSION / self.rest_area(self.extreme_n_vertices().0).powi(2)
    }

    /// Contact energy scale epsilon = stiffness k_a a_L0^2 (gamma l).
    pub fn epsilon(&self) -> f64 {
        self.potential.stiffness * self.k_area() * self.rest_area(self.extreme_n_vertices().1).powi(2)
    }
}

/// How many of `n_particles` each species gets: largest remainders, the earlier species first where they tie.
fn species_counts(n_particles: usize, fractions: &[f64]) -> Vec<usize> {
    let total: f64 = fractions.iter().sum();
    let shares: Vec<f64> = fractions.iter().map(|f| f / total * n_particles as f64).collect();
    let mut counts: Vec<usize> = shares.iter().map(|&share| share as usize).collect();
    let remainder = |&species: &usize| shares[species].fract();
    let mut order: Vec<usize> = (0..shares.len()).collect();
    order.sort_by(|a, b| remainder(b).total_cmp(&remainder(a))); // a stable sort keeps ties in scene order
    let missing = n_particles.saturating_sub(counts.iter().sum());
    order.iter().take(missing).for_each(|&species| counts[species] += 1);
    counts
}

impl Compression {
    /// Whether the samples are counted from the onset.
    pub fn needs_onset(&self) -> bool {
        !matches!(self, Compression::Densities { .. })
    }

    /// Packing fractions (phi or rho, ascending) at which to sample a packing that jams at `onset`, which counts for
    /// nothing where densities are given; empty if `until` is not above onset.
    pub fn samples(&self, onset: f64) -> Vec<f64> {
        // Rounding must not make a step of 1e-16 before the end, nor lose the end.
        const ROUNDING: f64 = 1e-6;
        match self {
            Compression::Increments { increments } => increments.iter().map(|delta| onset + delta).collect(),
            Compression::Until { until, step } if onset < *until => {
                let inner = ((until - onset) / step - ROUNDING) as usize;
                (1..=inner).map(|k| onset + k as f64 * step).chain([*until]).collect()
            }
            Compression::Until { .. } => Vec::new(),
            Compression::Log { log: LogSteps { from, to, per_decade } } => {
                let n = (to / from).log10() * *per_decade as f64;
                let delta = |k| from * 10f64.powf(k as f64 / *per_decade as f64);
                (0..=(n + ROUNDING) as usize).map(|k| onset + delta(k)).collect()
            }
            Compression::Densities { densities } => densities.clone(),
        }
    }
}

/// Deformable particles are not compressed further; the greatest `compression.until` that they accept.
pub const DENSEST_DP: f64 = 0.999;

impl Scene {
    /// Packing fractions at which to sample a packing that jams at `onset`. Deformable particles cannot cover more than
    /// the box: distances above onset that ask for it are left out.
    pub fn samples(&self, onset: f64) -> Vec<f64> {
        let mut densities = self.compression.samples(onset);
        if self.model() == Model::Dp {
            densities.retain(|&density| density <= DENSEST_DP);
        }
        densities
    }

    /// Reads and checks a scene. `origin` is the file's name in messages; `overrides` are `path.to.key=value` with TOML
    /// values (bare words are strings) and win over the text.
    pub fn parse(text: &str, origin: &str, overrides: &[String]) -> Result<Scene, SceneError> {
        let mut entries = read_text(text, origin)?;
        let set = read_overrides(overrides)?;
        // An override may choose another form of [compression] than the file, which it then replaces.
        if let Some(form) = set.keys().find_map(|key| compression_form(key)) {
            entries.retain(|key, _| compression_form(key).is_none_or(|other| other == form));
        }
        entries.extend(set);

        let model = check_keys(&mut entries, origin)?;
        let place = |key: &str| entries.get(key).map_or(origin.to_string(), |entry| entry.place.clone());
        let scene = with_defaults(&entries, model)
            .and_then(|values| values.try_into::<Scene>().map_err(|e| ("", Problem::Rule(e.to_string()))))
            .and_then(|scene| check_rules(&scene).map(|()| scene));
        scene.map_err(|(key, problem)| SceneError { place: place(key), problem })
    }

    /// The effective scene with every key, defaults included; parses back to an equal scene.
    pub fn to_toml(&self) -> String {
        // Cannot fail for a parsed scene: TOML lacks only integers above i64::MAX, and the ranges exclude them.
        toml::to_string(self).unwrap_or_else(|e| format!("# this scene has no TOML form: {e}\n"))
    }

    /// As files hold it that do not depend on where a run writes, what it draws and when it saves itself: these have their
    /// defaults.
    pub fn of_results(&self) -> Scene {
        let plain = Scene::parse(DEFAULT, "the built-in scene", &[]).expect("it is tested");
        Scene { output: plain.output, checkpoint: plain.checkpoint, ..self.clone() }
    }

    /// Which of the two models this scene is for.
    pub fn model(&self) -> Model {
        match self.physics {
            Physics::Sp(_) => Model::Sp,
            Physics::Dp(_) => Model::Dp,
        }
    }

    /// Unit of `minimize.force_tolerance`: epsilon/sigma_S (sp) or gamma (dp).
    pub fn force_unit(&self) -> f64 {
        match &self.physics {
            Physics::Sp(sp) => sp.potential.epsilon, // sigma_S = 1
            Physics::Dp(_) => LINE_TENSION,
        }
    }

    /// Unit of `onset.pressure`: epsilon/sigma_S^2 (sp) or gamma/l (dp). As sigma_S = l = 1, it equals the force unit.
    pub fn pressure_unit(&self) -> f64 {
        self.force_unit()
    }
}

// ---------------------------------------------------------------------------------------------------------------------
// What a scene may contain

/// One key: what it accepts and what it is when absent.
#[derive(Debug)]
struct Key {
    path: &'static str,
    /// The model that knows the key; `None` for both.
    model: Option<Model>,
    kind: Kind,
    /// A TOML value; empty where there is none or [`with_defaults`] decides it.
    default: &'static str,
}

/// Type and accepted values of a key; limits are inclusive.
#[derive(Debug)]
enum Kind {
    Float(f64, f64),
    Int(i64, i64),
    Choice(&'static [&'static str]),
    Bool,
    Text,
    /// Kind of the entries, and least and greatest number of them.
    List(&'static Kind, usize, usize),
}
use Kind::{Bool, Choice, Float, Int, List, Text};

const fn both(path: &'static str, kind: Kind, default: &'static str) -> Key {
    Key { path, model: None, kind, default }
}
const fn sp(path: &'static str, kind: Kind, default: &'static str) -> Key {
    Key { path, model: Some(Model::Sp), kind, default }
}
const fn dp(path: &'static str, kind: Kind, default: &'static str) -> Key {
    Key { path, model: Some(Model::Dp), kind, default }
}

/// Every key with its range and default. A default or range that differs between the models has a row for each.
const KEYS: &[Key] = &[
    both("model", Choice(&["sp", "dp"]), ""),
    both("n_particles", Int(2, 100_000_000), "64"),
    both("seed", Int(0, i64::MAX), "1"),
    sp("particles.diameters", List(&Float(0.01, 100.0), 1, 64), "[1.0, 1.4]"),
    dp("particles.n_vertices", List(&Int(3, 1000), 1, 64), "[12, 17]"),
    both("particles.fractions", List(&Float(1e-4, 1.0), 1, 64), ""), // equal shares
    sp("potential.epsilon", Float(1e-6, 1e6), "1.0"),
    dp("potential.preset", Choice(&["fast", "paper"]), "\"fast\""),
    dp("potential.delta", Float(1e-3, 0.5), ""), // these three from the preset
    dp("potential.kappa", Float(10.0, 1e6), ""), // below some 5 the tension shrinks polygons to points
    dp("potential.stiffness", Float(1e-6, 1e3), ""),
    dp("potential.contact", Choice(&["vertex-edge", "edge-edge"]), "\"vertex-edge\""),
    both("initial.packing_fraction", Float(0.01, 0.7), "0.2"),
    both("initial.spread", Float(0.0, 1.5), "0.0"),
    sp("onset.step", Float(1e-8, 0.1), "0.001"),
    dp("onset.step", Float(1e-8, 0.1), "0.01"),
    both("onset.smallest_step", Float(1e-12, 0.01), "1e-8"),
    sp("onset.pressure", List(&Float(1e-14, 0.1), 2, 2), "[1e-9, 1e-7]"),
    dp("onset.pressure", List(&Float(1e-14, 0.1), 2, 2), "[1e-6, 1e-4]"),
    both("compression.increments", List(&Float(1e-9, 1.0), 1, 10_000), ""),
    sp("compression.until", Float(0.5, 2.0), "1.0"),
    dp("compression.until", Float(0.5, DENSEST_DP), "0.95"),
    both("compression.step", Float(1e-6, 0.2), "0.01"),
    both("compression.log.from", Float(1e-9, 1.0), "1e-4"),
    both("compression.log.to", Float(1e-9, 1.0), "0.1"),
    both("compression.log.per_decade", Int(1, 1000), "4"),
    sp("compression.densities", List(&Float(0.01, 2.0), 1, 10_000), ""),
    dp("compression.densities", List(&Float(0.01, 0.999), 1, 10_000), ""),
    both("shear.until", Float(0.0, 100.0), "0.0"),
    both("shear.step", Float(1e-7, 0.1), "0.01"),
    both("measure.moduli", Bool, "true"),
    sp("minimize.method", Choice(&["fire", "cg", "newton"]), "\"cg\""),
    dp("minimize.method", Choice(&["fire", "cg", "newton"]), "\"newton\""),
    sp("minimize.force_tolerance", Float(1e-16, 1e-3), "1e-12"),
    dp("minimize.force_tolerance", Float(1e-16, 1e-3), "1e-9"),
    both("minimize.max_iterations", Int(1, 1_000_000_000), "1_000_000"),
    sp("neighbor.skin", Float(1e-3, 5.0), "0.3"),
    dp("neighbor.skin", Float(1e-3, 5.0), "0.1"),
    both("checkpoint.interval", Float(0.0, 1e9), "600.0"),
    both("output.directory", Text, "\"jamhpc-out\""),
    both("output.picture", Bool, "true"),
    both("output.color_by", Choice(&["z", "shape_parameter", "pressure"]), "\"z\""),
];

/// The keys of the four exclusive forms of `[compression]`; the first form is taken when a scene has none.
const FORMS: [&[&str]; 4] = [
    &["compression.until", "compression.step"],
    &["compression.increments"],
    &["compression.log.from", "compression.log.to", "compression.log.per_decade"],
    &["compression.densities"],
];

/// Index in [`FORMS`] of the form that a key belongs to.
fn compression_form(key: &str) -> Option<usize> {
    FORMS.iter().position(|keys| keys.contains(&key))
}

fn is_key(path: &str) -> bool {
    KEYS.iter().any(|key| key.path == path)
}

/// Whether `path` is a table that holds keys.
fn is_section(path: &str) -> bool {
    KEYS.iter().any(|key| key.path.strip_prefix(path).is_some_and(|rest| rest.starts_with('.')))
}

fn find_key(path: &str, model: Model) -> Option<&'static Key> {
    KEYS.iter().find(|key| key.path == path && key.model.is_none_or(|m| m == model))
}

impl Key {
    /// What to write instead, for messages.
    fn advice(&self) -> String {
        match self.default {
            "" => self.kind.accepted(),
            default => format!("{} (default {default})", self.kind.accepted()),
        }
    }

    /// Refuses a wrong type or a value out of range; makes integers floats where floats belong.
    fn check(&self, value: &mut Value) -> Result<(), Problem> {
        self.check_as(&self.kind, self.path.to_string(), value)
    }

    /// `name` is the path, with an index for an entry of a list.
    fn check_as(&self, kind: &Kind, name: String, value: &mut Value) -> Result<(), Problem> {
        if let (Float(..), Value::Integer(i)) = (kind, &*value) {
            *value = Value::Float(*i as f64);
        }
        let accepted = match (kind, &mut *value) {
            (Float(lo, hi), Value::Float(x)) => *lo <= *x && *x <= *hi, // false for NaN
            (Int(lo, hi), Value::Integer(i)) => *lo <= *i && *i <= *hi,
            (Choice(choices), Value::String(s)) => choices.contains(&s.as_str()),
            (Text, Value::String(s)) => !s.trim().is_empty() && !s.contains('\0'),
            (Bool, Value::Boolean(_)) => true,
            (List(item, shortest, longest), Value::Array(items)) => {
                for (i, entry) in items.iter_mut().enumerate() {
                    self.check_as(item, format!("{name}[{i}]"), entry)?;
                }
                (*shortest..=*longest).contains(&items.len())
            }
            (_, other) => {
                let (expected, got) = (kind.accepted(), describe(other));
                return Err(Problem::WrongType { key: name, expected, got });
            }
        };
        if accepted {
            return Ok(());
        }
        // The default of a list is no advice for one of its entries.
        let advice = if name == self.path { self.advice() } else { kind.accepted() };
        Err(Problem::OutOfRange { key: name, value: show_value(value), advice })
    }
}

impl Kind {
    /// Type and range in words.
    fn accepted(&self) -> String {
        match self {
            Float(lo, hi) => format!("a number from {} to {}", show(*lo), show(*hi)),
            Int(lo, i64::MAX) => format!("an integer from {lo}"),
            Int(lo, hi) => format!("an integer from {lo} to {hi}"),
            Choice(choices) => choices.iter().map(|c| format!("\"{c}\"")).collect::<Vec<_>>().join(" or "),
            Bool => "true or false".into(),
            Text => "a text in quotes that is not blank".into(),
            List(item, n, m) if n == m => format!("a list of {n} entries, each {}", item.accepted()),
            List(item, n, m) => format!("a list of {n} to {m} entries, each {}", item.accepted()),
        }
    }
}

/// A number as a person would write it.
fn show(x: f64) -> String {
    if x != 0.0 && !(1e-3..1e5).contains(&x.abs()) { format!("{x:e}") } else { x.to_string() }
}

/// A value on one short line.
fn show_value(value: &Value) -> String {
    match value {
        Value::Float(x) => format!("{x:?}"),
        _ => shorten(&value.to_string()),
    }
}

/// Type and value of what was given, for messages.
fn describe(value: &Value) -> String {
    let article = match value {
        Value::Integer(_) | Value::Array(_) => "an",
        _ => "a",
    };
    match value {
        Value::Table(_) => "a table".into(),
        _ => format!("{article} {} ({})", value.type_str(), show_value(value)),
    }
}

/// One short line of a text that may be long.
fn shorten(text: &str) -> String {
    let line = text.replace(char::is_control, " ");
    if line.chars().count() <= 60 { line } else { line.chars().take(57).chain("...".chars()).collect() }
}

// ---------------------------------------------------------------------------------------------------------------------
// Errors

/// Why a scene was refused, and where.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{place}: {problem}")]
pub struct SceneError {
    /// `file:line`, the file alone where no line is at fault, or the `--set` argument.
    pub place: String,
    pub problem: Problem,
}

/// What is wrong with a scene and what to do about it.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Problem {
    #[error("the scene is empty; `jamhpc init dp` or `jamhpc init sp` prints a commented one to start from")]
    Empty,
    #[error("this is not TOML: {0}")]
    Syntax(String),
    #[error("an override has the form path.to.key=value, such as --set n_particles=128")]
    Override,
    #[error("unknown key `{key}`{hint}; {known}")]
    UnknownKey { key: String, hint: String, known: String },
    #[error("`{key}` belongs to {other} scenes, but model = \"{model}\": remove the key, or set model = \"{other}\"")]
    OtherModel { key: String, model: &'static str, other: &'static str },
    #[error("`model` is missing: add model = \"sp\" (soft disks) or model = \"dp\" (deformable particles)")]
    NoModel,
    #[error("`{key}` must be {expected}, but is {got}")]
    WrongType { key: String, expected: String, got: String },
    #[error("`{key}` = {value} is not accepted: give {advice}")]
    OutOfRange { key: String, value: String, advice: String },
    /// Keys that contradict each other.
    #[error("{0}")]
    Rule(String),
}

// ---------------------------------------------------------------------------------------------------------------------
// From text to values

/// A value of the scene and where it was given.
struct Entry {
    value: Value,
    place: String,
}

/// Values by full path.
type Entries = BTreeMap<String, Entry>;

fn read_text(text: &str, origin: &str) -> Result<Entries, SceneError> {
    let line = |offset: usize| 1 + text.bytes().take(offset).filter(|&byte| byte == b'\n').count();
    let syntax = |e: toml::de::Error| SceneError {
        place: e.span().map_or(origin.to_string(), |span| format!("{origin}:{}", line(span.start))),
        problem: Problem::Syntax(e.message().trim().replace('\n', ", ")),
    };
    // Parsed twice, for the places of the keys and for the values.
    let mut lines = BTreeMap::new();
    let located = toml::de::DeTable::parse(text).map_err(syntax)?;
    collect_lines(located.get_ref(), "", &line, &mut lines)
        .map_err(|(at, problem)| SceneError { place: format!("{origin}:{at}"), problem })?;
    let table: Table = text.parse().map_err(syntax)?;
    if table.is_empty() {
        return Err(SceneError { place: origin.to_string(), problem: Problem::Empty });
    }
    let place = |path: &str| lines.get(path).map_or(origin.to_string(), |line| format!("{origin}:{line}"));

    let mut entries = Entries::new();
    flatten(table, "", &place, &mut entries)?;
    Ok(entries)
}

fn read_overrides(overrides: &[String]) -> Result<Entries, SceneError> {
    let mut entries = Entries::new();
    for argument in overrides {
        let place = format!("--set {}", shorten(argument));
        let fail = |problem| SceneError { place: place.clone(), problem };
        let (path, text) = argument.split_once('=').ok_or_else(|| fail(Problem::Override))?;
        let (path, text) = (path.trim(), text.trim());
        if path.is_empty() || text.is_empty() {
            return Err(fail(Problem::Override));
        }
        let is_text = KEYS.iter().any(|key| key.path == path && matches!(key.kind, Text));
        let bare = || Value::String(text.to_string());
        let value = match text.parse::<Value>() {
            Ok(value) if value.is_str() || !is_text => value,
            Err(e) if !is_text && text.starts_with(['[', '{', '"', '\'']) => {
                return Err(fail(Problem::Syntax(e.message().trim().replace('\n', ", "))));
            }
            _ => bare(), // a word, or a directory that looks like a number or a date
        };
        insert(path.to_string(), value, &|_: &str| place.clone(), &mut entries)?;
    }
    Ok(entries)
}

/// The full path of `key` in the table `section`. Quotes keep a key with a dot in it from passing for a path.
fn join(section: &str, key: &str) -> String {
    let bare = !key.is_empty() && key.chars().all(|c| c.is_alphanumeric() || c == '_' || c == '-');
    let key = if bare { key.to_string() } else { format!("{key:?}") };
    if section.is_empty() { key } else { format!("{section}.{key}") }
}

/// The line of each key by full path. Refuses integers beyond 64 bits, for which the value parser has no clear message.
fn collect_lines(
    table: &toml::de::DeTable,
    section: &str,
    line: &impl Fn(usize) -> usize,
    lines: &mut BTreeMap<String, usize>,
) -> Result<(), (usize, Problem)> {
    use toml::de::DeValue;
    for (key, value) in table {
        let path = join(section, key.get_ref());
        let at = line(key.span().start);
        lines.insert(path.clone(), at);
        match value.get_ref() {
            DeValue::Table(inner) => collect_lines(inner, &path, line, lines)?,
            DeValue::Integer(i) if i64::from_str_radix(i.as_str(), i.radix()).is_err() => {
                let advice = format!("an integer up to {}", i64::MAX);
                return Err((at, Problem::OutOfRange { key: path, value: shorten(i.as_str()), advice }));
            }
            _ => {}
        }
    }
    Ok(())
}

fn flatten(table: Table, section: &str, place: &dyn Fn(&str) -> String, into: &mut Entries) -> Result<(), SceneError> {
    table.into_iter().try_for_each(|(key, value)| insert(join(section, &key), value, place, into))
}

/// Adds the value at `path`, or all values of a table; refuses a path that no model knows.
fn insert(path: String, value: Value, place: &dyn Fn(&str) -> String, into: &mut Entries) -> Result<(), SceneError> {
    let fail = |problem| Err(SceneError { place: place(&path), problem });
    match value {
        Value::Table(table) if is_section(&path) => flatten(table, &path, place, into),
        value if is_section(&path) => {
            let expected = format!("a table with the keys {}", children(&path));
            fail(Problem::WrongType { key: path.clone(), expected, got: describe(&value) })
        }
        value if is_key(&path) => {
            let place = place(&path);
            into.insert(path, Entry { value, place });
            Ok(())
        }
        _ => fail(unknown_key(&path)),
    }
}

/// Refuses keys of the other model and values out of range; returns the model.
fn check_keys(entries: &mut Entries, origin: &str) -> Result<Model, SceneError> {
    let Some(entry) = entries.get_mut("model") else {
        return Err(SceneError { place: origin.to_string(), problem: Problem::NoModel });
    };
    KEYS[0].check(&mut entry.value).map_err(|problem| SceneError { place: entry.place.clone(), problem })?;
    let (model, other) = match entry.value.as_str() {
        Some("sp") => (Model::Sp, Model::Dp),
        _ => (Model::Dp, Model::Sp),
    };
    for (path, entry) in entries {
        let checked = match find_key(path, model) {
            Some(key) => key.check(&mut entry.value),
            None => Err(Problem::OtherModel { key: path.clone(), model: model.name(), other: other.name() }),
        };
        checked.map_err(|problem| SceneError { place: entry.place.clone(), problem })?;
    }
    Ok(model)
}

/// A broken rule and the key at whose place to report it.
type Fault = (&'static str, Problem);

/// The given values and the default of every key that is absent.
fn with_defaults(entries: &Entries, model: Model) -> Result<Table, Fault> {
    let mut values = BTreeMap::new();
    for key in KEYS.iter().filter(|key| key.model.is_none_or(|m| m == model)) {
        if let Some(entry) = entries.get(key.path) {
            values.insert(key.path, entry.value.clone());
        }
    }

    // Defaults that depend on other keys come first.
    let mut forms = values.keys().filter_map(|&key| Some((key, compression_form(key)?)));
    let (first, form) = forms.next().unwrap_or(("", 0));
    if let Some((second, _)) = forms.find(|&(_, other)| other != form) {
        let text = format!(
            "`{first}` and `{second}` exclude each other: in [compression] keep either `until` and `step`, or \
             `increments`, or `log`, or `densities`"
        );
        return Err((second, Problem::Rule(text)));
    }
    let sizes = if model == Model::Sp { "particles.diameters" } else { "particles.n_vertices" };
    let n_species = values.get(sizes).and_then(Value::as_array).map_or(2, Vec::len);
    let equal_shares = vec![Value::Float(1.0 / n_species as f64); n_species];
    values.entry("particles.fractions").or_insert(Value::Array(equal_shares));
    if model == Model::Dp {
        let paper = values.get("potential.preset").and_then(Value::as_str) == Some("paper");
        let preset = if paper { Preset::Paper } else { Preset::Fast };
        for (key, value) in preset.values() {
            values.entry(key).or_insert(Value::Float(value));
        }
    }

    for key in KEYS.iter().filter(|key| key.model.is_none_or(|m| m == model)) {
        let wanted = compression_form(key.path).is_none_or(|other| other == form);
        if let (true, Ok(default)) = (wanted, key.default.parse::<Value>()) {
            values.entry(key.path).or_insert(default);
        }
    }

    let mut table = Table::new();
    values.into_iter().for_each(|(path, value)| insert_nested(&mut table, path, value));
    Ok(table)
}

/// Puts a value at its path, making the tables on the way.
fn insert_nested(table: &mut Table, path: &str, value: Value) {
    match path.split_once('.') {
        None => {
            table.insert(path.to_string(), value);
        }
        Some((section, rest)) => {
            let inner = table.entry(section).or_insert_with(|| Value::Table(Table::new()));
            if let Value::Table(inner) = inner {
                insert_nested(inner, rest, value);
            }
        }
    }
}

/// Rules that tie several keys together.
fn check_rules(scene: &Scene) -> Result<(), Fault> {
    fn refuse_if(broken: bool, key: &'static str, text: impl FnOnce() -> String) -> Result<(), Fault> {
        if broken { Err((key, Problem::Rule(text()))) } else { Ok(()) }
    }

    let (sizes, n_species, fractions) = match &scene.physics {
        Physics::Sp(sp) => ("particles.diameters", sp.particles.diameters.len(), &sp.particles.fractions),
        Physics::Dp(dp) => ("particles.n_vertices", dp.particles.n_vertices.len(), &dp.particles.fractions),
    };
    refuse_if(n_species != fractions.len(), "particles.fractions", || {
        let n = fractions.len();
        format!("`{sizes}` lists {n_species} species and `particles.fractions` {n}: give one fraction for each")
    })?;
    let sum: f64 = fractions.iter().sum();
    refuse_if((sum - 1.0).abs() > 1e-6, "particles.fractions", || {
        format!("`particles.fractions` must sum to 1, but sum to {}: change one of them", show(sum))
    })?;
    let n = scene.n_particles;
    let all_appear = |n: &usize| species_counts(*n, fractions).iter().all(|&count| count > 0);
    refuse_if(!all_appear(&n), "n_particles", || {
        let enough = (n..).find(all_appear).unwrap_or(n);
        format!("`n_particles` = {n} is too small for all {n_species} species of `{sizes}`: give at least {enough}")
    })?;
    if let Physics::Sp(sp) = &scene.physics {
        let diameters = &sp.particles.diameters;
        let unit = diameters.iter().copied().fold(f64::INFINITY, f64::min);
        refuse_if(unit != 1.0, "particles.diameters", || {
            let scaled: Vec<f64> = diameters.iter().map(|d| d / unit).collect();
            format!(
                "the smallest of `particles.diameters` is the unit of length, so 1 and not {unit}: write {scaled:?}"
            )
        })?;
    }

    let Onset { step, smallest_step, pressure: [lo, hi] } = scene.onset;
    refuse_if(smallest_step > step, "onset.smallest_step", || {
        let (small, step) = (show(smallest_step), show(step));
        format!("`onset.smallest_step` = {small} must not be above `onset.step` = {step}: lower it")
    })?;
    refuse_if(lo >= hi, "onset.pressure", || {
        let (lo, hi) = (show(lo), show(hi));
        format!("`onset.pressure` = [{lo}, {hi}] must be [low, high]: make the first number the smaller one")
    })?;
    // Else forces that are not balanced yet would pass for jamming.
    let tolerance = scene.minimize.force_tolerance;
    refuse_if(scene.compression.needs_onset() && tolerance >= lo, "minimize.force_tolerance", || {
        let (tolerance, lo) = (show(tolerance), show(lo));
        format!("`minimize.force_tolerance` = {tolerance} must be below the low `onset.pressure` = {lo}: lower it")
    })?;

    let Initial { packing_fraction: start, spread } = scene.initial;
    refuse_if(spread != 0.0 && spread <= start, "initial.spread", || {
        format!("`initial.spread` = {spread} must be above `initial.packing_fraction` = {start}, or 0: raise it")
    })?;

    match &scene.compression {
        Compression::Increments { increments } => {
            let unsorted = increments.windows(2).find(|pair| pair[0] >= pair[1]).unwrap_or(&[]);
            refuse_if(!unsorted.is_empty(), "compression.increments", || {
                format!("`compression.increments` must ascend, but has {unsorted:?}: sort them, each once")
            })
        }
        Compression::Until { until, .. } => refuse_if(*until <= start, "compression.until", || {
            format!("`compression.until` = {until} must be above `initial.packing_fraction` = {start}: raise it")
        }),
        Compression::Log { log: LogSteps { from, to, .. } } => refuse_if(from >= to, "compression.log.from", || {
            let (from, to) = (show(*from), show(*to));
            format!("`compression.log.from` = {from} must be below `compression.log.to` = {to}: lower it")
        }),
        Compression::Densities { densities } => {
            let from_start: Vec<f64> = [start].iter().chain(densities).copied().collect();
            let unsorted = from_start.windows(2).find(|pair| pair[0] >= pair[1]).unwrap_or(&[]);
            refuse_if(!unsorted.is_empty(), "compression.densities", || {
                format!(
                    "`compression.densities` must ascend from `initial.packing_fraction` = {start}, but {unsorted:?} \
                     follow each other: sort them, or lower the start"
                )
            })
        }
    }
}

// ---------------------------------------------------------------------------------------------------------------------
// Help for unknown keys

/// The last part of a path.
fn leaf(path: &str) -> &str {
    path.rsplit('.').next().unwrap_or(path)
}

/// The table that a path is in; empty for the top.
fn section_of(path: &str) -> &str {
    path.rsplit_once('.').map_or("", |(section, _)| section)
}

/// Every key and every section, each once, in the order of [`KEYS`].
fn all_paths() -> Vec<&'static str> {
    let mut paths = Vec::new();
    for key in KEYS {
        let sections = key.path.match_indices('.').map(|(dot, _)| &key.path[..dot]);
        for path in sections.chain([key.path]) {
            if !paths.contains(&path) {
                paths.push(path);
            }
        }
    }
    paths
}

/// Names of what stands directly in a section.
fn children(section: &str) -> String {
    let inside = all_paths().into_iter().filter(|path| section_of(path) == section);
    inside
        .map(|path| if is_section(path) { format!("[{path}]") } else { leaf(path).to_string() })
        .collect::<Vec<_>>()
        .join(", ")
}

fn unknown_key(path: &str) -> Problem {
    let name = leaf(path);
    // Words apart by few letters, or one the beginning or end of the other; a key in the wrong section also counts.
    let distance = |known: &&'static str| {
        let known_name = leaf(known);
        let part = |long: &str, short: &str| short.len() > 3 && (long.starts_with(short) || long.ends_with(short));
        let letters =
            if part(name, known_name) || part(known_name, name) { 1 } else { edit_distance(name, known_name) };
        let elsewhere = usize::from(section_of(path) != section_of(known));
        (letters <= 1 + known_name.len() / 4 && letters < known_name.len()).then_some((2 * letters + elsewhere, *known))
    };
    let nearest = all_paths().iter().filter_map(distance).min_by_key(|(distance, _)| *distance);
    let hint = nearest.map_or(String::new(), |(_, known)| format!(", did you mean `{known}`?"));
    // The deepest section on the way that exists.
    let mut section = section_of(path);
    while !section.is_empty() && !is_section(section) {
        section = section_of(section);
    }
    let place = if section.is_empty() { "the top level".to_string() } else { format!("[{section}]") };
    Problem::UnknownKey { key: shorten(path), hint, known: format!("{place} has {}", children(section)) }
}

/// Least number of insertions, deletions, replacements and swaps of neighbours that turn `a` into `b`.
fn edit_distance(a: &str, b: &str) -> usize {
    let (a, b): (Vec<char>, Vec<char>) = (a.chars().take(100).collect(), b.chars().collect());
    let mut d: Vec<Vec<usize>> =
        (0..=a.len()).map(|i| (0..=b.len()).map(|j| if i == 0 { j } else { i }).collect()).collect();
    for i in 1..=a.len() {
        for j in 1..=b.len() {
            let replace = d[i - 1][j - 1] + usize::from(a[i - 1] != b[j - 1]);
            d[i][j] = replace.min(d[i - 1][j] + 1).min(d[i][j - 1] + 1);
            if i > 1 && j > 1 && a[i - 1] == b[j - 2] && a[i - 2] == b[j - 1] {
                d[i][j] = d[i][j].min(d[i - 2][j - 2] + 1);
            }
        }
    }
    d[a.len()][b.len()]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn parse(text: &str) -> Result<Scene, SceneError> {
        Scene::parse(text, "test.toml", &[])
    }

    fn with(text: &str, overrides: &[&str]) -> Result<Scene, SceneError> {
        let overrides: Vec<String> = overrides.iter().map(|s| s.to_string()).collect();
        Scene::parse(text, "test.toml", &overrides)
    }

    fn message(result: Result<Scene, SceneError>) -> String {
        result.expect_err("this scene should have been refused").to_string()
    }

    /// All values of a TOML text by full path.
    fn values(text: &str) -> BTreeMap<String, Value> {
        read_text(text, "").unwrap().into_iter().map(|(path, entry)| (path, entry.value)).collect()
    }

    const FORM_EXAMPLES: [&str; 4] = [
        "",
        "\n[compression]\nincrements = [1e-4]",
        "\n[compression.log]\nfrom = 1e-5",
        "\n[compression]\ndensities = [0.8, 0.9]",
    ];
    const MINIMAL: [(&str, Model); 2] = [("model = 'sp'", Model::Sp), ("model = 'dp'", Model::Dp)];

    #[test]
    fn every_row_of_the_table_accepts_its_own_default() {
        for key in KEYS.iter().filter(|key| !key.default.is_empty()) {
            let mut value: Value = key.default.parse().unwrap_or_else(|e| panic!("{}: {e}", key.path));
            key.check(&mut value).unwrap();
        }
        assert_eq!(KEYS[0].path, "model"); // check_keys relies on it
    }

    #[test]
    fn a_scene_that_names_only_its_model_has_the_defaults() {
        let scene = parse("model = 'dp'").unwrap();
        assert_eq!((scene.model(), scene.n_particles, scene.seed), (Model::Dp, 64, 1));
        assert_eq!(scene.compression, Compression::Until { until: 0.95, step: 0.01 });
        assert_eq!(
            scene.minimize,
            Minimize { method: Method::Newton, force_tolerance: 1e-9, max_iterations: 1_000_000 }
        );
        let Physics::Dp(dp) = scene.physics else { panic!() };
        assert_eq!(dp.particles, DpParticles { n_vertices: vec![12, 17], fractions: vec![0.5, 0.5] });
        let expected = DpPotential {
            preset: Preset::Fast,
            delta: 0.1,
            kappa: 1000.0,
            stiffness: 0.01,
            contact: Contact::VertexEdge,
        };
        assert_eq!(dp.potential, expected);

        let scene = parse("model = 'sp'").unwrap();
        assert_eq!((scene.model(), scene.neighbor.skin, scene.minimize.force_tolerance), (Model::Sp, 0.3, 1e-12));
        let Physics::Sp(sp) = scene.physics else { panic!() };
        assert_eq!(sp.particles, SpParticles { diameters: vec![1.0, 1.4], fractions: vec![0.5, 0.5] });
    }

    #[test]
    fn the_echo_holds_every_key_and_parses_back() {
        for (text, model) in MINIMAL {
            for (form, keys) in FORM_EXAMPLES.iter().zip(FORMS) {
                let scene = parse(&format!("{text}{form}")).unwrap();
                let echo = scene.to_toml();
                assert_eq!(parse(&echo).unwrap(), scene, "{echo}");
                let echoed: Vec<String> = values(&echo).into_keys().collect();
                let belongs = |key: &&Key| {
                    key.model.is_none_or(|m| m == model)
                        && (compression_form(key.path).is_none() || keys.contains(&key.path))
                };
                let mut expected: Vec<&str> = KEYS.iter().filter(belongs).map(|key| key.path).collect();
                expected.sort();
                assert_eq!(echoed, expected);
            }
        }
    }

    /// Comment, section and assignment of each line `key = value` or `# key = value` of a starter, by full path.
    fn documented(starter: &str) -> BTreeMap<String, (String, String)> {
        let (mut section, mut comment, mut keys) = (String::new(), String::new(), BTreeMap::new());
        for line in starter.lines() {
            let bare = line.trim_start_matches("# ");
            if let Some(name) = bare.strip_prefix('[').and_then(|rest| rest.strip_suffix(']')) {
                (section, comment) = (name.to_string(), String::new());
            } else if let Some((key, value)) = bare.split_once(" = ").filter(|(key, _)| !key.contains(' ')) {
                keys.insert(join(&section, key), (std::mem::take(&mut comment), value.to_string()));
            } else {
                comment = format!("{comment} {}", bare.trim_start_matches('#')).trim().to_string();
            }
        }
        keys
    }

    #[test]
    fn starters_document_every_key_with_its_range_and_default() {
        for ((minimal, model), starter) in MINIMAL.into_iter().zip([SP_STARTER, DP_STARTER]) {
            let scene = parse(starter).unwrap();
            assert_eq!(scene, parse(minimal).unwrap());
            let effective = values(&scene.to_toml());
            let documented = documented(starter);
            let known = KEYS.iter().filter(|key| key.model.is_none_or(|m| m == model));
            assert_eq!(documented.len(), known.clone().count());
            for key in known {
                let (comment, value) =
                    documented.get(key.path).unwrap_or_else(|| panic!("{} is not in the {model:?} starter", key.path));
                let range = key.kind.accepted();
                assert!(comment.to_lowercase().contains(&range), "{}: `{comment}` does not say `{range}`", key.path);
                let mut value: Value = value.parse().unwrap();
                key.check(&mut value).unwrap();
                let default = effective.get(key.path).cloned().or_else(|| key.default.parse().ok());
                if let Some(mut default) = default {
                    key.check(&mut default).unwrap();
                    assert_eq!(value, default, "{}", key.path);
                }
            }
        }
    }

    #[test]
    fn the_embedded_default_is_the_scene_the_manual_promises() {
        let scene = parse(DEFAULT).unwrap();
        assert_eq!((scene.model(), scene.n_particles), (Model::Dp, 64));
        assert_eq!(scene.compression, Compression::Until { until: 0.95, step: 0.01 });
    }

    #[test]
    fn species_counts_sum_to_the_number_of_particles() {
        assert_eq!(species_counts(65, &[0.5, 0.5]), [33, 32]);
        assert_eq!(species_counts(100, &[0.29, 0.71]), [29, 71]); // 0.29 * 100 is just below 29
        assert_eq!(species_counts(10, &[1.0 / 3.0; 3]), [4, 3, 3]);
        assert_eq!(species_counts(10, &[0.55, 0.26, 0.19]), [5, 3, 2]);
        for n in 2..500 {
            assert_eq!(species_counts(n, &[0.123, 0.377, 0.5]).iter().sum::<usize>(), n);
        }
    }

    #[test]
    fn deformable_particles_follow_the_definition_of_l_and_the_presets() {
        let scene = with("model = 'dp'\nn_particles = 9", &["potential.preset=paper"]).unwrap();
        let Physics::Dp(dp) = &scene.physics else { panic!() };
        let [small, large] = dp.species(9)[..] else { panic!() };
        assert_eq!((small.count, large.count, small.n_vertices, large.n_vertices), (5, 4, 12, 17));
        assert!((small.a0.sqrt() + large.a0.sqrt() - 2.0).abs() < 1e-15);
        assert!((large.a0 / small.a0 - (17.0f64 / 12.0).powi(2)).abs() < 1e-14);
        assert!((dp.k_area() * small.a0.powi(2) / 1000.0 - 1.0).abs() < 1e-14);
        assert!((dp.epsilon() / (dp.k_area() * large.a0.powi(2)) - 1.1).abs() < 1e-14);

        // A number of the scene wins over the preset; a single species has rest area 1; the order does not matter.
        let scene = with("model = 'dp'", &["particles.n_vertices=[20]", "potential.kappa=3000"]).unwrap();
        let Physics::Dp(dp) = &scene.physics else { panic!() };
        assert_eq!((dp.species(64)[0].a0, dp.k_area(), dp.epsilon()), (1.0, 3000.0, 30.0));
        let scene = with("model = 'dp'", &["particles.n_vertices=[17, 12]"]).unwrap();
        let Physics::Dp(dp) = &scene.physics else { panic!() };
        assert_eq!(dp.species(64)[0].a0, large.a0);
    }

    #[test]
    fn samples_follow_the_form() {
        let close = |samples: Vec<f64>, expected: &[f64]| {
            assert_eq!(samples.len(), expected.len(), "{samples:?}");
            assert!(samples.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-12), "{samples:?}");
        };
        let until = Compression::Until { until: 0.95, step: 0.05 };
        close(until.samples(0.84), &[0.89, 0.94, 0.95]);
        close(until.samples(0.85), &[0.9, 0.95]); // no sample 1e-16 before the last
        close(until.samples(0.94), &[0.95]);
        close(until.samples(0.95), &[]);
        close(Compression::Increments { increments: vec![0.01, 0.1] }.samples(0.8), &[0.81, 0.9]);
        let log = |from, to| Compression::Log { log: LogSteps { from, to, per_decade: 1 } };
        close(log(1e-4, 0.1).samples(0.8), &[0.8001, 0.801, 0.81, 0.9]);
        close(log(1e-2, 0.2).samples(0.8), &[0.81, 0.9]);
        close(log(1e-3, 1e-2 - 1e-17).samples(0.8), &[0.801, 0.81]); // nor is the last one lost to rounding
    }

    #[test]
    fn units_of_the_thresholds() {
        let scene = with("model = 'sp'", &["potential.epsilon=5"]).unwrap();
        assert_eq!((scene.force_unit(), scene.pressure_unit()), (5.0, 5.0));
        assert_eq!(parse("model = 'dp'").unwrap().pressure_unit(), LINE_TENSION);
    }

    #[test]
    fn overrides_win_over_the_text() {
        let text = "model = 'dp'\nseed = 3\n[compression]\nuntil = 0.9\nstep = 0.02";
        let scene = with(text, &["seed = 7", "output.directory=2024-01-01", "potential.contact=edge-edge"]).unwrap();
        assert_eq!((scene.seed, scene.output.directory.as_str()), (7, "2024-01-01"));
        assert_eq!(with(text, &["seed=7", "seed=8"]).unwrap().seed, 8);
        assert_eq!(with(text, &["output.directory=\"a b\""]).unwrap().output.directory, "a b");
        assert_eq!(with(text, &["output.directory=[run 1]"]).unwrap().output.directory, "[run 1]");
        // Another form of [compression] replaces that of the file.
        let scene = with(text, &["compression.increments=[1e-3, 1]"]).unwrap();
        assert_eq!(scene.compression, Compression::Increments { increments: vec![1e-3, 1.0] });
        let scene = with(text, &["compression={ log = { from = 1e-3 } }", "compression.log.per_decade=2"]).unwrap();
        assert_eq!(scene.compression, Compression::Log { log: LogSteps { from: 1e-3, to: 0.1, per_decade: 2 } });
        let scene = with(text, &["compression.step=0.03"]).unwrap();
        assert_eq!(scene.compression, Compression::Until { until: 0.9, step: 0.03 });
    }

    #[test]
    fn refused_overrides_name_themselves() {
        for (overrides, expected) in [
            (&["seed"][..], "--set seed: an override has the form"),
            (&["=3"], "form path.to.key=value"),
            (&["seed="], "form path.to.key=value"),
            (&["seed=x"], "--set seed=x: `seed` must be an integer from 0, but is a string (\"x\")"),
            (&["sede=3"], "--set sede=3: unknown key `sede`, did you mean `seed`?"),
            (&["onset.pressure=[1e-7"], "--set onset.pressure=[1e-7: this is not TOML"),
            (&["seed=1\nmodel='sp'"], "--set seed=1 model='sp': `seed` must be an integer"),
            (&["onset=3"], "`onset` must be a table with the keys step, smallest_step, pressure"),
            (&["onset.step.x=3"], "unknown key `onset.step.x`"),
            (&["compression.until=0.9", "compression.increments=[1]"], "exclude each other"),
            (
                &["particles.fractions=[0.2, 0.2]"],
                "--set particles.fractions=[0.2, 0.2]: `particles.fractions` must sum",
            ),
        ] {
            let message = message(with("model = 'dp'", overrides));
            assert!(message.contains(expected), "{message}\ndoes not contain\n{expected}");
            assert!(!message.contains('\n'), "{message}");
        }
    }

    #[test]
    fn nothing_is_an_empty_scene() {
        for text in ["", " \n", "# nothing\n", "\u{feff}"] {
            let message = message(parse(text));
            assert!(message.starts_with("test.toml: the scene is empty; `jamhpc init dp`"), "{message}");
        }
    }

    #[test]
    fn nearest_known_key() {
        for (given, nearest) in [
            ("potential.detla", "potential.delta"),
            ("potental", "potential"),
            ("skin", "neighbor.skin"),
            ("neighbour", "neighbor"),
            ("minimize.tolerance", "minimize.force_tolerance"),
            ("minimize.max_iter", "minimize.max_iterations"),
            ("nparticles", "n_particles"),
            ("onset.Step", "onset.step"),
            ("output.colour_by", "output.color_by"),
            ("compression.stpe", "compression.step"),
        ] {
            let Problem::UnknownKey { hint, .. } = unknown_key(given) else { panic!() };
            assert_eq!(hint, format!(", did you mean `{nearest}`?"), "{given}");
        }
        for given in ["banana", "potential.gamma", "x", "\u{1F980}"] {
            let Problem::UnknownKey { hint, .. } = unknown_key(given) else { panic!() };
            assert_eq!(hint, "", "{given}");
        }
        assert_eq!(edit_distance("kitten", "sitting"), 3);
        assert_eq!(edit_distance("delta", "detla"), 1);
        assert_eq!(edit_distance("", "abc"), 3);
    }

    fn scene_files(folder: &str) -> Vec<(String, String)> {
        let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/scenes").join(folder);
        let mut files: Vec<(String, String)> = std::fs::read_dir(&path)
            .unwrap_or_else(|e| panic!("{}: {e}", path.display()))
            .map(|entry| entry.unwrap().path())
            .map(|path| {
                (path.file_name().unwrap().to_string_lossy().into_owned(), std::fs::read_to_string(path).unwrap())
            })
            .collect();
        files.sort();
        files
    }

    #[test]
    fn good_scenes_are_accepted_and_round_trip() {
        let files = scene_files("good");
        assert!(files.len() >= 5);
        for (name, text) in files {
            let scene = Scene::parse(&text, &name, &[]).unwrap_or_else(|e| panic!("{e}"));
            assert_eq!(Scene::parse(&scene.to_toml(), &name, &[]).as_ref(), Ok(&scene), "{name}");
        }
    }

    #[test]
    fn bad_scenes_are_refused_with_what_they_expect() {
        let files = scene_files("bad");
        assert!(files.len() >= 30);
        let mut complaints = Vec::new();
        for (name, text) in files {
            let expected: Vec<&str> = text.lines().filter_map(|line| line.strip_prefix("# expect: ")).collect();
            assert!(!expected.is_empty(), "{name} has no `# expect: ` line");
            let message = match Scene::parse(&text, &name, &[]) {
                Ok(_) => "was accepted".to_string(),
                Err(error) => error.to_string(),
            };
            assert!(message.starts_with(&name) && !message.contains('\n'), "{name}: {message}");
            let missing = expected.into_iter().filter(|part| !message.contains(part));
            complaints.extend(missing.map(|part| format!("{name}: `{message}` does not contain `{part}`")));
        }
        assert!(complaints.is_empty(), "{}", complaints.join("\n"));
    }

    /// A value that the kind accepts.
    fn any_accepted(kind: &'static Kind) -> BoxedStrategy<Value> {
        match kind {
            Float(lo, hi) => (*lo..=*hi).prop_map(Value::Float).boxed(),
            Int(lo, hi) => (*lo..=*hi).prop_map(Value::Integer).boxed(),
            Choice(choices) => prop::sample::select(*choices).prop_map(|c| Value::String(c.into())).boxed(),
            Bool => any::<bool>().prop_map(Value::Boolean).boxed(),
            Text => "\\PC*[a-z]".prop_map(Value::String).boxed(),
            List(item, shortest, longest) => {
                let n = *shortest..=(*longest).min(4);
                prop::collection::vec(any_accepted(item), n).prop_map(Value::Array).boxed()
            }
        }
    }

    proptest! {
        #[test]
        fn no_text_makes_it_panic(text in "\\PC*", bytes in prop::collection::vec(any::<u8>(), 0..200)) {
            let _ = parse(&text);
            let _ = parse(&String::from_utf8_lossy(&bytes));
            let _ = Scene::parse(DEFAULT, "test.toml", &[text]);
        }

        #[test]
        fn no_damage_makes_it_panic(
            start in 0..DP_STARTER.len(),
            length in 0..40usize,
            new in "[\\[\\]{}=.\"'0-9a-z\n]{0,8}",
        ) {
            let cut = |n: usize| n.min(DP_STARTER.len());
            prop_assert!(DP_STARTER.is_ascii()); // any cut falls between characters
            let text = format!("{}{new}{}", &DP_STARTER[..cut(start)], &DP_STARTER[cut(start + length)..]);
            if let Err(error) = parse(&text) {
                let message = error.to_string();
                prop_assert!(message.starts_with("test.toml") && !message.contains('\n'), "{message}");
            }
        }

        /// One key at a time takes any accepted value: it is accepted, or a rule about several keys refuses it.
        #[test]
        fn accepted_values_round_trip(
            (key, value) in prop::sample::select((1..KEYS.len()).collect::<Vec<_>>())
                .prop_flat_map(|i| (Just(&KEYS[i]), any_accepted(&KEYS[i].kind)))
        ) {
            let model = key.model.unwrap_or(Model::Dp).name();
            match with(&format!("model = '{model}'"), &[&format!("{}={value}", key.path)]) {
                Ok(scene) => {
                    let echo = scene.to_toml();
                    prop_assert_eq!(parse(&echo), Ok(scene));
                    prop_assert_eq!(values(&echo).remove(key.path), Some(value));
                }
                Err(error) => prop_assert!(matches!(error.problem, Problem::Rule(_)), "{error}"),
            }
        }

        #[test]
        fn counts_are_within_one_of_the_shares(
            n in 1..10_000usize,
            weights in prop::collection::vec(0.01..1.0f64, 1..8),
        ) {
            let total: f64 = weights.iter().sum();
            let counts = species_counts(n, &weights);
            prop_assert_eq!(counts.iter().sum::<usize>(), n);
            for (&count, weight) in counts.iter().zip(&weights) {
                prop_assert!((count as f64 - weight / total * n as f64).abs() < 1.0 + 1e-6);
            }
        }
    }
}
