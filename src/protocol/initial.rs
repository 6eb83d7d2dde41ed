use super::ProtocolError;
use crate::comm::Comm;
use crate::engine::System;
use crate::geometry::{Frac, PeriodicBox, rounded_area};
use crate::minimize::{Fire, Goal, Minimized, Minimizer};
use crate::model::SoftDisks;
use crate::particles::{Bodies, Particles};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::f64::consts::{PI, TAU};

/// One kind of particle in a mixture; ids are dealt out in runs, species after species.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Species {
    /// How many there are in the whole system.
    pub count: u32,
    /// Disk diameter, or rest area a₀ of a polygon.
    pub size: f64,
    /// Vertices of a polygon; 1 for a disk.
    pub n_vertices: u32,
}

impl Species {
    /// Radius of the circle through the vertices of the regular polygon of area a₀.
    pub fn circumradius(&self) -> f64 {
        let n = self.n_vertices as f64;
        (2.0 * self.size / (n * (TAU / n).sin())).sqrt()
    }

    /// Area that one undeformed particle covers: πσ²/4, or the regular polygon of area a₀ with its shell of width δ.
    pub fn undeformed_area(&self, delta: f64) -> f64 {
        if self.n_vertices == 1 {
            return 0.25 * PI * self.size * self.size;
        }
        let n = self.n_vertices as f64;
        let perimeter = (4.0 * n * (PI / n).tan() * self.size).sqrt();
        rounded_area(self.size, perimeter, delta)
    }
}

/// Which species particle `id` belongs to.
fn species_of(species: &[Species], id: u32) -> &Species {
    let mut end = 0;
    species
        .iter()
        .find(|s| {
            end += s.count;
            id < end
        })
        .unwrap_or(&species[species.len() - 1])
}

/// The ids that this rank makes: any split will do, because particles migrate to their owners.
fn ids_here(comm: &Comm, species: &[Species]) -> std::ops::Range<u32> {
    let n: u64 = species.iter().map(|s| s.count as u64).sum();
    let cut = |rank: usize| (n * rank as u64 / comm.size() as u64) as u32;
    cut(comm.rank())..cut(comm.rank() + 1)
}

/// Random numbers of one particle: a stream of its own, the same on whatever rank asks.
fn random(seed: u64, id: u32) -> ChaCha8Rng {
    let mut generator = ChaCha8Rng::seed_from_u64(seed);
    generator.set_stream(id as u64);
    generator
}

/// Disks at uniformly random centres; `diameter` may differ from the species' own size (twins start from the same
/// centres whatever the particles are).
pub fn random_disks(comm: &Comm, species: &[Species], seed: u64, diameter: impl Fn(&Species) -> f64) -> Particles {
    let mut disks = Particles::empty(&Bodies::Disks);
    for id in ids_here(comm, species) {
        let mut numbers = random(seed, id);
        let center = Frac::from_bits([numbers.next_u64() as i64, numbers.next_u64() as i64]);
        disks.push(id, diameter(species_of(species, id)), &[center]);
    }
    disks
}

/// Skin of the disks about the centres of [`deformable_particles`], over the smallest of their diameters.
pub const START_SKIN: f64 = 0.3;

/// Regular polygons about random centres, none crossing another.
///
/// Random polygons cross already at low density, and crossed polygons never untangle: first the centres are relaxed as
/// soft disks of the full outer size, circulo-lines included, until no two of them overlap by more than a hair.
/// Polygon m is turned by its own random angle.
pub fn deformable_particles(
    comm: Comm,
    pbox: PeriodicBox,
    species: &[Species],
    seed: u64,
    delta: f64,
) -> Result<(Comm, Particles), ProtocolError> {
    let outer = |s: &Species| 2.0 * s.circumradius() + delta;
    let smallest = species.iter().map(outer).fold(f64::INFINITY, f64::min);
    let disks = random_disks(&comm, species, seed, outer);
    let model = SoftDisks { epsilon: 1.0, smallest };
    let mut system = System::new(comm, model, pbox, &pbox, disks, START_SKIN * smallest)?;
    // forces of 1e-6 ε/σ are overlaps of 1e-6 σ, far within the shells
    let goal = Goal { force_tolerance: 1e-6 / smallest, max_iterations: 100_000 };
    if let Minimized::Unconverged(report) = Fire.minimize(&mut system, &goal)? {
        return Err(ProtocolError::NoStart { density: system.density()?, report });
    }
    let centers = system.own_particles();
    let mut polygons = Particles::empty(&Bodies::Polygons { first: vec![0] });
    for (&id, &center) in centers.id.iter().zip(&centers.position) {
        let kind = species_of(species, id);
        let mut numbers = random(seed, id);
        numbers.set_word_pos(4); // after the two coordinates of the centre
        let turn = TAU * (numbers.next_u64() as f64 / 2.0f64.powi(64));
        let corner = |k: u32| {
            let angle = turn + TAU * k as f64 / kind.n_vertices as f64;
            pbox.moved(center, [kind.circumradius() * angle.cos(), kind.circumradius() * angle.sin()])
        };
        polygons.push(id, kind.size, &(0..kind.n_vertices).map(corner).collect::<Vec<_>>());
    }
    Ok((system.comm, polygons))
}
