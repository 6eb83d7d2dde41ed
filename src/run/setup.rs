//! From the scene to a system at its random start.

use crate::comm::Comm;
use crate::engine::{EngineError, System, edges_fit, fits};
use crate::failure::Failure;
use crate::geometry::PeriodicBox;
use crate::minimize::Goal;
use crate::model::{Contact, Deformable, DeformableParameters, EdgeEdge, Harmonic, SoftDisks, VertexEdge};
use crate::output::Header;
use crate::protocol::{OnsetSearch, START_SKIN, Species, deformable_particles, spread_disks, widening};
use crate::scene::{self, Compression, DpPhysics, LINE_TENSION, Physics, Scene, SpPhysics};

/// No packing of disks or polygons of several sizes jams above this density: the hexagonal crystal has 0.907.
const DENSEST_ONSET: f64 = 0.91;

/// The potential of soft disks.
pub fn disk_model(sp: &SpPhysics) -> SoftDisks {
    SoftDisks { epsilon: sp.potential.epsilon, smallest: 1.0 }
}

/// The potential of deformable particles.
pub fn deformable_model<C: Contact>(dp: &DpPhysics) -> Deformable<C> {
    let per_vertex = |&n: &usize| dp.rest_area(n) / n as f64;
    Deformable::new(DeformableParameters {
        line_tension: LINE_TENSION,
        k_area: dp.k_area(),
        contact: Harmonic { epsilon: dp.epsilon(), delta: dp.potential.delta },
        largest_area_per_vertex: dp.particles.n_vertices.iter().map(per_vertex).fold(0.0, f64::max),
    })
}

/// Whether particles fit into the box of a scene and the box can be split among so many ranks, as far as can be told
/// before any of them is made.
pub fn check(ranks: usize, scene: &Scene) -> Result<(), EngineError> {
    let skin = scene.neighbor.skin;
    match &scene.physics {
        Physics::Sp(sp) => {
            let species = disk_species(scene, sp);
            let boxes = Boxes::new(scene, &species, 0.0);
            let diameters: Vec<f64> = species.iter().map(|s| s.size).collect();
            if scene.initial.spread > 0.0 {
                let wider = widening(&boxes.start, &species, |s| s.size, scene.initial.spread);
                start_fits(ranks, &boxes.start, &diameters, wider)?;
            }
            fits(ranks, &boxes.smallest, true, [0.0, largest(&diameters), skin])?;
        }
        Physics::Dp(dp) => {
            let delta = dp.potential.delta;
            let species = polygon_species(scene, dp);
            let boxes = Boxes::new(scene, &species, delta);
            let diameters: Vec<f64> = species.iter().map(|s| s.outer_diameter(delta)).collect();
            let wider = widening(&boxes.start, &species, |s| s.outer_diameter(delta), scene.initial.spread);
            start_fits(ranks, &boxes.start, &diameters, wider.max(1.0))?;
            let radius = 0.5 * (largest(&diameters) - delta);
            fits(ranks, &boxes.smallest, false, [radius, delta, skin])?;
            let between = match dp.potential.contact {
                scene::Contact::VertexEdge => VertexEdge::EDGES_AND_SKINS_BETWEEN,
                scene::Contact::EdgeEdge => EdgeEdge::EDGES_AND_SKINS_BETWEEN,
            };
            let edge = species.iter().map(|s| s.perimeter() / s.n_vertices as f64).fold(0.0, f64::max);
            edges_fit(&boxes.smallest, between, [edge, delta, skin])?;
        }
    }
    Ok(())
}

/// The same for the disks that centres are relaxed as: particles are that much `wider`.
fn start_fits(ranks: usize, start: &PeriodicBox, diameters: &[f64], wider: f64) -> Result<(), EngineError> {
    let smallest = diameters.iter().copied().fold(f64::INFINITY, f64::min);
    fits(ranks, start, true, [0.0, wider * largest(diameters), wider * START_SKIN * smallest])?;
    Ok(())
}

fn largest(diameters: &[f64]) -> f64 {
    diameters.iter().copied().fold(0.0, f64::max)
}

fn disk_species(scene: &Scene, sp: &SpPhysics) -> Vec<Species> {
    let species = sp.species(scene.n_particles).into_iter();
    species.map(|s| Species { count: s.count as u32, size: s.diameter, n_vertices: 1 }).collect()
}

fn polygon_species(scene: &Scene, dp: &DpPhysics) -> Vec<Species> {
    let species = dp.species(scene.n_particles).into_iter();
    species.map(|s| Species { count: s.count as u32, size: s.a0, n_vertices: s.n_vertices as u32 }).collect()
}

/// Soft disks at random centres, which may be spread evenly.
pub fn soft_disks(comm: Comm, scene: &Scene, sp: &SpPhysics) -> Result<System<SoftDisks>, Failure> {
    let species = disk_species(scene, sp);
    let boxes = Boxes::new(scene, &species, 0.0);
    let (comm, disks) = spread_disks(comm, boxes.start, &species, scene.seed, |s| s.size, scene.initial.spread)?;
    Ok(System::new(comm, disk_model(sp), boxes.start, &boxes.smallest, disks, scene.neighbor.skin)?)
}

/// Regular polygons about the same random centres, none crossing another.
pub fn deformable<C: Contact>(comm: Comm, scene: &Scene, dp: &DpPhysics) -> Result<System<Deformable<C>>, Failure> {
    let delta = dp.potential.delta;
    let species = polygon_species(scene, dp);
    let boxes = Boxes::new(scene, &species, delta);
    let (comm, polygons) = deformable_particles(comm, boxes.start, &species, scene.seed, delta, scene.initial.spread)?;
    Ok(System::new(comm, deformable_model(dp), boxes.start, &boxes.smallest, polygons, scene.neighbor.skin)?)
}

/// The box of the random start, and the smallest that the run can come to.
struct Boxes {
    start: PeriodicBox,
    smallest: PeriodicBox,
}

impl Boxes {
    fn new(scene: &Scene, species: &[Species], delta: f64) -> Self {
        let covered: f64 = species.iter().map(|s| s.count as f64 * s.undeformed_area(delta)).sum();
        let smallest = PeriodicBox::square((covered / largest_density(scene)).sqrt());
        // tilted by half its edge, a box is as narrow as shear makes it
        let tilt = scene.shear.until.min(0.5);
        Boxes {
            start: PeriodicBox::square((covered / scene.initial.packing_fraction).sqrt()),
            smallest: smallest.sheared(tilt),
        }
    }
}

/// No density of the run is above this.
fn largest_density(scene: &Scene) -> f64 {
    let searched = DENSEST_ONSET + scene.onset.step;
    let sampled = match &scene.compression {
        Compression::Until { until, .. } => *until,
        Compression::Increments { increments } => DENSEST_ONSET + increments.last().copied().unwrap_or(0.0),
        Compression::Log { log } => DENSEST_ONSET + log.to,
        Compression::Densities { densities } => densities.iter().copied().fold(0.0, f64::max),
    };
    if scene.compression.needs_onset() { searched.max(sampled) } else { sampled }
}

/// When a state counts as relaxed, in the units of the model.
pub fn goal(scene: &Scene) -> Goal {
    Goal {
        force_tolerance: scene.minimize.force_tolerance * scene.force_unit(),
        max_iterations: scene.minimize.max_iterations as u64,
    }
}

/// How the onset is searched, in the units of the model.
pub fn onset_search(scene: &Scene) -> OnsetSearch {
    OnsetSearch {
        step: scene.onset.step,
        smallest_step: scene.onset.smallest_step,
        pressure: scene.onset.pressure.map(|p| p * scene.pressure_unit()),
    }
}

/// What a results file says about the scene that it comes from.
pub fn header(scene: &Scene) -> Header {
    let (units, contact, potential) = match &scene.physics {
        Physics::Sp(sp) => (SP_UNITS, "disks", vec![("epsilon", sp.potential.epsilon)]),
        Physics::Dp(dp) => {
            let contact = match dp.potential.contact {
                scene::Contact::VertexEdge => "vertex-edge",
                scene::Contact::EdgeEdge => "edge-edge",
            };
            let constants = vec![
                ("line_tension", LINE_TENSION),
                ("k_area", dp.k_area()),
                ("epsilon", dp.epsilon()),
                ("delta", dp.potential.delta),
            ];
            (DP_UNITS, contact, constants)
        }
    };
    Header {
        scene: scene.of_results().to_toml(),
        seed: scene.seed,
        units: units.into(),
        contact: contact.into(),
        potential: potential.into_iter().map(|(name, value)| (name.to_string(), value)).collect(),
    }
}

const SP_UNITS: &str = "length: sigma_S, the smallest diameter; energy: that in which potential.epsilon is given; \
    stress: energy/sigma_S^2 (the paper's is epsilon/sigma_LS^2, sigma_LS the mean diameter)";
const DP_UNITS: &str = "length: l, the mean of sqrt(a0) over the smallest and the largest species; energy: gamma l; \
    force: gamma; stress: gamma/l";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_density_of_a_run_is_above_the_largest() {
        for (form, largest) in [
            ("compression.until=0.97", 0.97),
            ("compression.until=0.6", 0.92),
            ("compression.increments=[0.001, 0.1]", 1.01),
            ("compression.log.to=0.2", 1.11),
            ("compression.densities=[0.3, 0.6]", 0.6),
        ] {
            let scene = Scene::parse("model = 'dp'", "test", &[form.to_string()]).unwrap();
            assert!((largest_density(&scene) - largest).abs() < 1e-12, "{form}");
        }
    }

    fn from_start(model: &str, spread: f64) -> Scene {
        let text = format!("model = '{model}'\ninitial.packing_fraction = 0.7\ninitial.spread = {spread}");
        Scene::parse(&text, "test", &[]).unwrap()
    }

    #[test]
    fn disks_that_were_spread_do_not_overlap() {
        let energy = |spread| {
            let scene = from_start("sp", spread);
            let Physics::Sp(sp) = &scene.physics else { panic!("disks") };
            soft_disks(Comm::alone(), &scene, sp).unwrap().energies().unwrap().total
        };
        let [random, spread] = [0.0, 0.9].map(energy);
        assert!(random > 1.0 && spread < 1e-3, "{random} {spread}");
    }

    #[test]
    fn polygons_stand_where_disks_were_spread() {
        let start = |spread| {
            let scene = from_start("dp", spread);
            let Physics::Dp(dp) = &scene.physics else { panic!("polygons") };
            deformable::<VertexEdge>(Comm::alone(), &scene, dp).unwrap().own_particles()
        };
        assert_ne!(start(0.9).position, start(0.0).position);
    }
}
