use super::by_id;
use crate::engine::{EngineError, System};
use crate::geometry::Vec2;
use crate::minimize::{Fire, Goal, Report};
use crate::model::Model;
use crate::observe::{
    Approximations, Contacts, Moduli, Modulus, Rattlers, Sample, ShapeParameter, Spectrum, Stability, Void,
    VoidStatistics, Voids, all_pairs, rattler_ids,
};
use crate::particles::Bodies;
use crate::protocol::{ProtocolError, quasi_static_shear_modulus};
use serde::Serialize;
use std::collections::BTreeMap;

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
    /// Exact, and with everything that particles share counted twice.
    pub packing_fraction: f64,
    pub packing_fraction_double_counted: f64,
    pub reduced_number_density: f64,
    /// Means over all particles that have an area; the three are equal for disks.
    pub shape_parameter: ShapeParameter,
    /// Those with most sides first, then the largest.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub voids: Option<Vec<VoidRow>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub void_statistics: Option<VoidSummaries>,
    /// G of simple shear at fixed area; the other moduli are in `moduli`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub shear_modulus: Option<Modulus>,
    /// K, all points relaxed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bulk_modulus: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub moduli: Option<Moduli>,
    /// G again, from relaxed strains of the box.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub quasi_static: Option<QuasiStatic>,
    /// Eigenvalues of the Hessian; null if the system is too large for all of them.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub spectrum: Option<Option<Spectrum>>,
    /// Packing fractions of the paper's approximations, and their errors.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub approximations: Option<BTreeMap<&'static str, Approximation>>,
}

/// What an evaluation may hold besides, on demand.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Extra {
    Voids,
    Moduli,
    QuasiStatic,
    Spectrum,
    Approximations,
}

/// The shear modulus by straining the box by ±`strain` and relaxing.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct QuasiStatic {
    pub shear_modulus: f64,
    pub strain: f64,
    /// Relative difference from linear response, at most [`MAX_DIFFERENCE`].
    pub difference: f64,
}

/// Strain of a quasi-static shear modulus: its square, and the changes of contacts on the way, are its error.
const STRAIN: f64 = 5e-5;
/// What the two ways to the shear modulus may differ by, relative to it.
const MAX_DIFFERENCE: f64 = 1e-6;
/// Steps of FIRE that a strain may take.
const MAX_ITERATIONS: u64 = 2_000_000;

#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct VoidRow {
    pub sides: u32,
    pub area: f64,
    pub perimeter: f64,
    pub shape_parameter: f64,
    pub islands: u32,
    pub percolates: bool,
}

/// With all particles, and with those alone that are no rattlers; none of the latter where all rattle.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct VoidSummaries {
    pub all: VoidSummary,
    pub without_rattlers: Option<VoidSummary>,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct VoidSummary {
    pub n_voids: u64,
    pub n_percolating: u64,
    /// Fractions with 3, 4, 5, 6 and more sides, of those that do not percolate.
    pub fractions: [f64; 5],
    /// Means over those with 3 sides.
    pub border_shape_parameter: f64,
    pub border_radius: f64,
    /// Of deformable particles only.
    pub border_radius_over_delta: Option<f64>,
    /// Gaps inside single contacts, which are no voids.
    pub n_slivers: u64,
    pub sliver_area: f64,
}

impl VoidSummary {
    fn new(s: &VoidStatistics, delta: Option<f64>) -> Self {
        VoidSummary {
            n_voids: s.n_voids,
            n_percolating: s.n_percolating,
            fractions: s.fractions(),
            border_shape_parameter: s.border_shape_parameter,
            border_radius: s.border_radius,
            border_radius_over_delta: delta.map(|delta| s.border_radius / delta),
            n_slivers: s.n_slivers,
            sliver_area: s.sliver_area,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Approximation {
    pub value: f64,
    /// Less the exact packing fraction.
    pub error: f64,
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
    pub fn of<M: Model>(system: &mut System<M>, extras: &[Extra]) -> Result<Evaluation, EngineError> {
        let max_force = system.max_force()?;
        if !max_force.is_finite() {
            return Err(EngineError::Runaway { particle: system.offender(f64::INFINITY).unwrap_or_default() });
        }
        let report = Report { max_force, force_evaluations: 1, ..Report::default() };
        let rattlers = Rattlers::default();
        let (sample, columns) = Sample::measure(system, &report, rattlers)?;
        let network = Contacts::of(system, rattlers)?;
        let contacts = all_pairs(system)?;
        let rho = sample.density.packing_fraction;
        let is_disks = matches!(system.model.bodies(), Bodies::Disks);
        let (mut voids, mut void_statistics, mut approximations) = (None, None, None);
        if extras.contains(&Extra::Voids) {
            let delta = (!is_disks).then(|| system.model.range(system.largest_size()));
            let all = Voids::of(system, &[], Some(rho))?;
            let removed = rattler_ids(system, &network);
            let without_rattlers = match removed.len() as u64 {
                n if n == network.n_particles => None,
                _ => Some(VoidSummary::new(&Voids::of(system, &removed, None)?.statistics, delta)),
            };
            void_statistics = Some(VoidSummaries { all: VoidSummary::new(&all.statistics, delta), without_rattlers });
            let row = |v: &Void| VoidRow {
                sides: v.sides,
                area: v.area,
                perimeter: v.perimeter,
                shape_parameter: v.shape_parameter(),
                islands: v.islands,
                percolates: v.percolates,
            };
            voids = Some(all.on_root(&system.comm).iter().map(row).collect());
        }
        if extras.contains(&Extra::Approximations) && is_disks {
            let named = Approximations::of(system)?.named();
            let entry = |(name, value): (&'static str, f64)| (name, Approximation { value, error: value - rho });
            approximations = Some(named.into_iter().map(entry).collect());
        }
        let wanted = |extra: Extra| extras.contains(&extra);
        let moduli = (wanted(Extra::Moduli) || wanted(Extra::QuasiStatic)).then(|| Moduli::of(system)).transpose()?;
        let spectrum = wanted(Extra::Spectrum).then(|| Spectrum::of(system)).transpose()?;
        let e = sample.energies;
        system.max_force()?; // forces were let go of on the way
        let rows = by_id(system, |p| {
            let forces = &system.forces()[system.particles().bodies.points(p)];
            let mut row = vec![columns.is_rattler[p] as u8 as f64, columns.area[p], columns.perimeter[p]];
            row.extend(forces.iter().flatten());
            row
        });
        let quasi_static = match &moduli {
            Some(moduli) if wanted(Extra::QuasiStatic) => Some(QuasiStatic::of(system, moduli, max_force)?),
            _ => None,
        };
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
            packing_fraction: rho,
            packing_fraction_double_counted: sample.density.double_counted,
            reduced_number_density: sample.density.reduced_number_density,
            shape_parameter: sample.shape_parameter,
            voids,
            void_statistics,
            shear_modulus: moduli.map(|m| m.shear_modulus),
            bulk_modulus: moduli.map(|m| m.bulk_modulus.linear_response),
            moduli,
            quasi_static,
            spectrum,
            approximations,
        })
    }
}

impl QuasiStatic {
    /// Of a state whose largest force is `max_force`, which must agree with linear response. Collective.
    fn of<M: Model>(system: &mut System<M>, moduli: &Moduli, max_force: f64) -> Result<QuasiStatic, EngineError> {
        let linear_response = moduli.shear_modulus.linear_response;
        // as well relaxed as the state itself: an unbalanced force is an error of the stress
        let goal = Goal { force_tolerance: max_force, max_iterations: MAX_ITERATIONS };
        let shear_modulus = match quasi_static_shear_modulus(system, &Fire, &goal, STRAIN) {
            Ok(modulus) => modulus,
            Err(ProtocolError::Engine(error)) => return Err(error),
            Err(_) => f64::NAN, // not relaxed: no agreement
        };
        let difference = (shear_modulus / linear_response - 1.0).abs();
        if moduli.stability == Stability::Stable && (difference <= MAX_DIFFERENCE || shear_modulus == linear_response) {
            return Ok(QuasiStatic { shear_modulus, strain: STRAIN, difference });
        }
        Err(EngineError::Moduli { linear_response, strained: shear_modulus })
    }
}
