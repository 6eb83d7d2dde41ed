use super::{Contacts, Moduli, PackingFraction, Rattlers, Shape, ShapeParameter, Stability, VoidStatistics, Voids};
use crate::engine::{Energies, EngineError, System};
use crate::minimize::Report;
use crate::model::Model;
use crate::particles::Column;

/// Everything that is measured on one state of a system, the same on all ranks.
///
/// Units: lengths and energies of the model (σ_S and ε for disks, l and γ l for deformable particles).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sample {
    pub density: PackingFraction,
    pub energies: Energies,
    pub n_particles: u64,
    /// Contacts between particles that are no rattlers.
    pub n_contacts: u64,
    pub n_rattlers: u64,
    /// z = 2 N_c/N′
    pub contact_number: f64,
    /// Rattlers count as particles.
    pub voids: VoidStatistics,
    /// Means over all particles that have an area; the three are equal for disks.
    pub shape_parameter: ShapeParameter,
    /// Mean area of a particle: of its polygon, or of the cut disk.
    pub mean_area: f64,
    /// Root mean square of a/a₀ − 1 over deformable particles; 1 − Σa/Σa₀ of disks, the part of their areas lost in
    /// overlaps.
    pub area_deviation: f64,
    /// Largest force on any point.
    pub max_force: f64,
    /// What the minimisation of this state cost.
    pub iterations: u64,
    pub force_evaluations: u64,
    /// Simple shear strain since the compression ended.
    pub strain: f64,
    /// Elastic moduli, if they were asked for.
    pub moduli: Option<Moduli>,
    /// Where this packing jams, if that is known.
    pub onset: Option<OnsetBracket>,
}

/// Densities between which a packing jams.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct OnsetBracket {
    /// Lowest density at which it was jammed.
    pub onset: f64,
    /// Highest density below that at which it was not.
    pub unjammed: f64,
}

/// Columns with one entry per own particle, in the order of storage.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PerParticle {
    /// Number of particles that it touches, rattlers included.
    pub contacts: Vec<u32>,
    pub is_rattler: Vec<bool>,
    /// Polygon area, or area of the cut disk.
    pub area: Vec<f64>,
    pub perimeter: Vec<f64>,
    /// p²/4πa of the polygon or the cut disk; NaN without area.
    pub shape_parameter: Vec<f64>,
    /// Half the trace of the particle's share of the centroid stress (its own halves of the contacts) over its own
    /// area, so that Σ pressure × area / A is the pressure of the system. NaN without area.
    pub pressure: Vec<f64>,
}

impl PerParticle {
    /// All columns by the names that files give them: the values of a particle by its place.
    pub fn named(&self) -> [(&'static str, Column<'_>); 6] {
        [
            ("contacts", Box::new(|p| self.contacts[p] as f64)),
            ("is_rattler", Box::new(|p| self.is_rattler[p] as u8 as f64)),
            ("area", Box::new(|p| self.area[p])),
            ("perimeter", Box::new(|p| self.perimeter[p])),
            ("shape_parameter", Box::new(|p| self.shape_parameter[p])),
            ("pressure", Box::new(|p| self.pressure[p])),
        ]
    }
}

impl Sample {
    /// Measures the present state, which `report` says how it was reached. Collective.
    pub fn measure<M: Model>(
        system: &mut System<M>,
        report: &Report,
        rattlers: Rattlers,
    ) -> Result<(Sample, PerParticle), EngineError> {
        system.carry(0); // what a minimiser has left
        // one after the other, and of each only what is kept: of a million particles memory holds little at once
        let voids = Voids::of(system, &[], None)?.statistics;
        let mut contacts = Contacts::of(system, rattlers)?;
        let shapes: Vec<Shape> = system.outlines(Shape::of)?;
        let density = PackingFraction::of(system, &shapes)?;
        voids.fill(system.pbox(), density.packing_fraction)?;
        let [mean_area, area_deviation] = areas(system, &shapes, contacts.n_particles);
        let shape_parameter = mean_shape_parameter(system, &shapes);
        let mut columns = PerParticle {
            contacts: std::mem::take(&mut contacts.n_touching),
            is_rattler: std::mem::take(&mut contacts.is_rattler),
            area: shapes.iter().map(|s| s.area).collect(),
            perimeter: shapes.iter().map(|s| s.perimeter).collect(),
            shape_parameter: shapes.iter().map(|s| s.parameter().map_or(f64::NAN, |a| a.polygon)).collect(),
            pressure: Vec::new(),
        };
        drop(shapes);
        columns.pressure = system.terms(|p, t| {
            let area = columns.area[p];
            if area > 0.0 { 0.5 * (t.centroid[0] + t.centroid[3]) / area } else { f64::NAN }
        })?;
        let sample = Sample {
            density,
            voids,
            energies: system.energies()?,
            n_particles: contacts.n_particles,
            n_contacts: contacts.n_contacts,
            n_rattlers: contacts.n_rattlers,
            contact_number: contacts.contact_number(),
            shape_parameter,
            mean_area,
            area_deviation,
            max_force: report.max_force,
            iterations: report.iterations,
            force_evaluations: report.force_evaluations,
            strain: 0.0,
            moduli: None,
            onset: None,
        };
        Ok((sample, columns))
    }

    /// Mean of the diagonal of the centroid stress.
    pub fn pressure(&self) -> f64 {
        self.energies.pressure()
    }

    /// −Σ_xy = (dU/dγ)/A: rises with the strain γ.
    pub fn shear_stress(&self) -> f64 {
        -self.energies.virial[1]
    }

    /// All numbers by the names that files give them.
    pub fn scalars(&self) -> Vec<(&'static str, f64)> {
        let mut named = vec![
            ("reduced_number_density", self.density.reduced_number_density),
            ("packing_fraction", self.density.packing_fraction),
            ("packing_fraction_double_counted", self.density.double_counted),
            ("energy_total", self.energies.total),
            ("energy_line", self.energies.line),
            ("energy_area", self.energies.area),
            ("energy_contact", self.energies.contact),
            ("pressure", self.pressure()),
            ("shear_stress", self.shear_stress()),
            ("strain", self.strain),
            ("stress_mismatch", self.energies.stress_mismatch()),
            ("n_particles", self.n_particles as f64),
            ("n_contacts", self.n_contacts as f64),
            ("n_rattlers", self.n_rattlers as f64),
            ("contact_number", self.contact_number),
            ("n_voids", self.voids.n_voids as f64),
            ("voids_3_sided", self.voids.fractions()[0]),
            ("voids_4_sided", self.voids.fractions()[1]),
            ("voids_5_sided", self.voids.fractions()[2]),
            ("voids_6_sided", self.voids.fractions()[3]),
            ("void_shape_parameter_3_sided", self.voids.border_shape_parameter),
            ("shape_parameter_polygon", self.shape_parameter.polygon),
            ("shape_parameter_relative", self.shape_parameter.relative),
            ("shape_parameter_shell", self.shape_parameter.shell),
            ("mean_area", self.mean_area),
            ("area_deviation", self.area_deviation),
            ("max_force", self.max_force),
            ("iterations", self.iterations as f64),
            ("force_evaluations", self.force_evaluations as f64),
        ];
        if let Some(moduli) = &self.moduli {
            named.extend([
                ("shear_modulus", moduli.shear_modulus.linear_response),
                ("shear_modulus_affine", moduli.shear_modulus.affine),
                ("pure_shear_modulus", moduli.pure_shear_modulus.linear_response),
                ("mean_shear_modulus", moduli.mean_shear_modulus),
                ("bulk_modulus", moduli.bulk_modulus.linear_response),
                ("moduli_are_stable", (moduli.stability == Stability::Stable) as u8 as f64),
            ]);
        }
        if let Some(bracket) = self.onset {
            named.extend([("onset_density", bracket.onset), ("unjammed_density", bracket.unjammed)]);
        }
        named
    }

    /// All tensors by the names that files give them: xx, xy, yx, yy.
    pub fn tensors(&self) -> Vec<(&'static str, [f64; 4])> {
        vec![("stress_virial", self.energies.virial), ("stress_centroid", self.energies.centroid)]
    }
}

/// Mean over all particles that have an area.
fn mean_shape_parameter<M: Model>(system: &System<M>, shapes: &[Shape]) -> ShapeParameter {
    let row = |p: usize| shapes[p].parameter().map_or([0.0; 4], |a| [a.polygon, a.relative, a.shell, 1.0]);
    let [polygon, relative, shell, n] = system.comm.sum_terms(shapes.len(), row);
    let mean = |sum: f64| if n > 0.0 { sum / n } else { 0.0 };
    ShapeParameter { polygon: mean(polygon), relative: mean(relative), shell: mean(shell) }
}

/// Mean area, and the deviation of areas from those at rest.
fn areas<M: Model>(system: &System<M>, shapes: &[Shape], n_particles: u64) -> [f64; 2] {
    let excess = |s: &Shape| s.area / s.rest_area - 1.0;
    let row = |s: &Shape| [s.area, s.rest_area, excess(s).powi(2)];
    let [area, rest, squares] = system.comm.sum_terms(shapes.len(), |p| row(&shapes[p]));
    let deviation = match system.model.bodies() {
        crate::particles::Bodies::Disks => 1.0 - area / rest,
        crate::particles::Bodies::Polygons { .. } => (squares / n_particles as f64).sqrt(),
    };
    [area / n_particles as f64, deviation]
}
