//! Random packings: one modulus by two ways, and the count of contacts at the onset.

use super::ensemble::AtOnset;
use super::{Check, Effort};
use crate::comm::Comm;
use crate::engine::System;
use crate::geometry::PeriodicBox;
use crate::minimize::{Fire, Goal, Newton};
use crate::model::{Deformable, DeformableParameters, Harmonic, Model, SoftDisks, VertexEdge};
use crate::observe::Moduli;
use crate::protocol::{
    ProtocolError, Species, compress_to, deformable_particles, quasi_static_shear_modulus, random_disks,
};

const DISKS: SoftDisks = SoftDisks { epsilon: 1.0, smallest: 1.0 };
const DELTA: f64 = 0.1;
/// Below it no contact opens or closes, and the error, of its square, is as small as that of the stress over it.
const STRAIN: f64 = 1e-5;
/// Between the modulus of relaxed strains and that of linear response.
const AGREEMENT: f64 = 1e-6;

/// G by relaxed strains of ±10⁻⁵ is that of linear response, U_γγ − X·H⁺·X, for disks and for polygons. Disks at their
/// onset are isostatic: 2 N′ − 1 contacts between N′ particles without rattlers, and one more for each hexagon of equal
/// disks.
pub fn checks(world: &dyn Fn() -> Comm, effort: Effort) -> Result<Vec<Check>, ProtocolError> {
    let mut checks = Vec::new();
    let mut disks = random_soft_disks(world(), 64, 1, 0.95)?;
    let goal = Goal { force_tolerance: 1e-14, max_iterations: 1_000_000 };
    compress_to(&mut disks, &Fire, &goal, 0.95)?;
    checks.push(agreement("SP, N = 64, phi = 0.95", &mut disks, &goal)?);

    // particle number and seed
    let chosen: &[(u32, u64)] = match effort {
        Effort::Quick => &[(16, 2)],
        Effort::Long => &[(12, 2), (16, 2), (16, 3), (32, 1)],
    };
    // over the strain, an error of 10⁻⁷ in G
    let goal = Goal { force_tolerance: 1e-12, max_iterations: 1_000_000 };
    for &(n, seed) in chosen {
        let mut polygons = random_polygons(world(), n, seed, 0.01)?;
        let coarse = Goal { force_tolerance: 1e-3, max_iterations: 1_000_000 };
        for density in [0.8, 0.85, 0.88, 0.9, 0.92] {
            compress_to(&mut polygons, &Newton, &coarse, density)?;
        }
        compress_to(&mut polygons, &Newton, &goal, 0.93)?;
        checks.push(agreement(&format!("DP, N = {n}, seed {seed}, rho = 0.93"), &mut polygons, &goal)?);
    }

    let seeds = match effort {
        Effort::Quick => 4,
        Effort::Long => 20,
    };
    for (seed, packing) in (1..).zip(AtOnset::of_seeds(&world(), 64, 1..=seeds, 0.01)) {
        let name = format!("SP onset, seed {seed}: N_c less 2 N' - 2");
        checks.push(Check::new(name, 1.0, 1.0 + packing.excess - packing.hexagons, 0.0));
    }
    Ok(checks)
}

/// G by strain, that of linear response being expected. FIRE, as it stays in the minimum that it starts in.
fn agreement<M: Model>(what: &str, system: &mut System<M>, goal: &Goal) -> Result<Check, ProtocolError> {
    let linear = Moduli::of(system)?.shear_modulus.linear_response;
    let strained = quasi_static_shear_modulus(system, &Fire, goal, STRAIN)?;
    Ok(Check::new(format!("{what}: G by strain"), linear, strained, AGREEMENT))
}

/// Half of diameter 1, half of 1.4, at random in a square.
pub fn random_soft_disks(comm: Comm, n: u32, seed: u64, density: f64) -> Result<System<SoftDisks>, ProtocolError> {
    let species = [1.0, 1.4].map(|size| Species { count: n / 2, size, n_vertices: 1 });
    let area: f64 = species.iter().map(|s| s.count as f64 * s.undeformed_area(0.0)).sum();
    let pbox = PeriodicBox::square((area / density).sqrt());
    let disks = random_disks(&comm, &species, seed, |s| s.size);
    let smallest = pbox.with_area(area / 0.95).sheared(STRAIN);
    Ok(System::new(comm, DISKS, pbox, &smallest, disks, 0.3)?)
}

/// Half of 12, half of 17 vertices, edges of one length. `stiffness` is that of contacts, ε over k_a a_L0².
pub fn random_polygons(
    comm: Comm,
    n: u32,
    seed: u64,
    stiffness: f64,
) -> Result<System<Deformable<VertexEdge>>, ProtocolError> {
    let small = (24.0f64 / 29.0).powi(2);
    let species =
        [12, 17].map(|n_v: u32| Species { count: n / 2, size: small * (n_v as f64 / 12.0).powi(2), n_vertices: n_v });
    let area: f64 = species.iter().map(|s| s.count as f64 * s.undeformed_area(DELTA)).sum();
    let pbox = PeriodicBox::square((area / 0.7).sqrt());
    let (comm, polygons) = deformable_particles(comm, pbox, &species, seed, DELTA, 0.0)?;
    let k_area = 1000.0 / (small * small);
    let model = Deformable::new(DeformableParameters {
        line_tension: 1.0,
        k_area,
        contact: Harmonic { epsilon: stiffness * k_area * species[1].size * species[1].size, delta: DELTA },
        largest_area_per_vertex: species[1].size / 17.0,
    });
    let smallest = pbox.with_area(area / 0.95).sheared(STRAIN);
    Ok(System::new(comm, model, pbox, &smallest, polygons, 0.1)?)
}
