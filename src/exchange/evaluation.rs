use super::by_id;
use crate::engine::{EngineError, System};
use crate::geometry::Vec2;
use crate::minimize::Report;
use crate::model::Model;
use crate::observe::{Contacts, Rattlers, Sample, ShapeParameter};
use crate::particles::Bodies;
use serde::Serialize;

/// What one configuration is evaluated to. Lists have one entry per particle (or point) in the order of the input, and
/// are empty on ranks other than 0. Units are those of the input.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Evaluation {
    pub energy: Energy,
    /// −∂U/∂x of every point: disks, or vertices of all particles in order.
    pub forces: Vec<Vec2>,
    /// Largest length of a force.
    pub max_force: f64,
    pub stress: Stress,
    /// Half the trace of the centroid stress.
    pub pressure: f64,
    /// All touching pairs, rattlers included, smaller particle first, ascending.
    pub contacts: Vec<[u32; 2]>,
    /// 2 N_c/N′ without rattlers.
    pub contact_number: f64,
    pub rattlers: Vec<u32>,
    /// Polygon areas, or areas of the disks cut along the radical axes of their overlaps.
    pub areas: Vec<f64>,
    pub perimeters: Vec<f64>,
    pub packing_fraction: f64,
    pub reduced_number_density: f64,
    /// Means over all particles; the three are equal for disks.
    pub shape_parameter: ShapeParameter,
}

/// U and its terms.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(untagged)]
pub enum Energy {
    Disks { total: f64, pair: f64 },
    Deformable { total: f64, line: f64, area: f64, contact: f64 },
}

/// [[xx, xy], [yx, yy]] of both stress forms, which are equal at force balance only.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Stress {
    pub virial: [Vec2; 2],
    pub centroid: [Vec2; 2],
}

impl Evaluation {
    /// Of the present state. Collective.
    pub fn of<M: Model>(system: &mut System<M>) -> Result<Evaluation, EngineError> {
        let max_force = system.max_force()?;
        if !max_force.is_finite() {
            return Err(EngineError::Runaway { particle: system.offender(f64::INFINITY).unwrap_or_default() });
        }
        let report = Report { max_force, force_evaluations: 1, ..Report::default() };
        let rattlers = Rattlers::default();
        let (sample, columns) = Sample::measure(system, &report, rattlers)?;
        let contacts = Contacts::of(system, rattlers)?.all_pairs(system);
        let e = sample.energies;
        let rows = by_id(system, |p| {
            let forces = &system.forces()[system.particles().bodies.points(p)];
            let mut row = vec![columns.is_rattler[p] as u8 as f64, columns.area[p], columns.perimeter[p]];
            row.extend(forces.iter().flatten());
            row
        });
        let matrix = |t: [f64; 4]| [[t[0], t[1]], [t[2], t[3]]];
        Ok(Evaluation {
            energy: match system.model.bodies() {
                Bodies::Disks => Energy::Disks { total: e.total, pair: e.contact },
                Bodies::Polygons { .. } => {
                    Energy::Deformable { total: e.total, line: e.line, area: e.area, contact: e.contact }
                }
            },
            forces: rows.iter().flat_map(|row| row[3..].chunks_exact(2)).map(|f| [f[0], f[1]]).collect(),
            max_force,
            stress: Stress { virial: matrix(e.virial), centroid: matrix(e.centroid) },
            pressure: sample.pressure(),
            contacts,
            contact_number: sample.contact_number,
            rattlers: (0..).zip(&rows).filter(|(_, row)| row[0] != 0.0).map(|(id, _)| id).collect(),
            areas: rows.iter().map(|row| row[1]).collect(),
            perimeters: rows.iter().map(|row| row[2]).collect(),
            packing_fraction: sample.density.packing_fraction,
            reduced_number_density: sample.density.reduced_number_density,
            shape_parameter: sample.shape_parameter,
        })
    }
}
