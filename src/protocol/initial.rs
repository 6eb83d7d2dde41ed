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

    /// Diameter of the circle about the regular polygon and its shell of width δ.
    pub fn outer_diameter(&self, delta: f64) -> f64 {
        2.0 * self.circumradius() + delta
    }

    /// Area that one undeformed particle covers: πσ²/4, or the regular polygon of area a₀ with its shell of width δ.
    pub fn undeformed_area(&self, delta: f64) -> f64 {
        if self.n_vertices == 1 {
            return 0.25 * PI * self.size * self.size;
        }
        rounded_area(self.size, self.perimeter(), delta)
    }

    /// Of the regular polygon of area a₀, than which no outline about that area is shorter.
    pub fn perimeter(&self) -> f64 {
        let n = self.n_vertices as f64;
        (4.0 * n * (PI / n).tan() * self.size).sqrt()
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

/// Skin of the disks that centres are relaxed as, over the smallest of their diameters.
pub const START_SKIN: f64 = 0.3;
/// max|F| of disks that spread centres, in ε over the smallest diameter: one contact overlaps by this part of it.
const SPREAD: f64 = 1e-4;

/// By how much disks at the centres of particles are wider that cover the part `spread` of a box ([`spread_disks`]).
pub fn widening(pbox: &PeriodicBox, species: &[Species], diameter: impl Fn(&Species) -> f64, spread: f64) -> f64 {
    let covered: f64 = species.iter().map(|s| s.count as f64 * 0.25 * PI * diameter(s).powi(2)).sum();
    (spread * pbox.area() / covered).sqrt()
}

/// Disks at random centres that are first spread evenly: relaxed as wider ones which cover this part of the box; at the
/// random centres themselves if `spread` is 0.
///
/// Equal parts of a box hold different numbers of random centres. When particles jam, what is dense flows into what is
/// not, in the more iterations the longer the box.
pub fn spread_disks(
    comm: Comm,
    pbox: PeriodicBox,
    species: &[Species],
    seed: u64,
    diameter: impl Fn(&Species) -> f64,
    spread: f64,
) -> Result<(Comm, Particles), ProtocolError> {
    if spread == 0.0 {
        let disks = random_disks(&comm, species, seed, diameter);
        return Ok((comm, disks));
    }
    let wider = widening(&pbox, species, &diameter, spread);
    let disks = random_disks(&comm, species, seed, |s| wider * diameter(s));
    let (comm, mut disks) = relaxed(comm, pbox, disks, wider * smallest(species, &diameter), SPREAD)?;
    for (size, &id) in disks.size.iter_mut().zip(&disks.id) {
        *size = diameter(species_of(species, id));
    }
    Ok((comm, disks))
}

fn smallest(species: &[Species], diameter: impl Fn(&Species) -> f64) -> f64 {
    species.iter().map(diameter).fold(f64::INFINITY, f64::min)
}

/// Soft disks relaxed to max|F| of `tolerance` times ε over the smallest of their diameters.
fn relaxed(
    comm: Comm,
    pbox: PeriodicBox,
    disks: Particles,
    smallest: f64,
    tolerance: f64,
) -> Result<(Comm, Particles), ProtocolError> {
    let model = SoftDisks { epsilon: 1.0, smallest };
    let mut system = System::new(comm, model, pbox, &pbox, disks, START_SKIN * smallest)?;
    let goal = Goal { force_tolerance: tolerance / smallest, max_iterations: 100_000 };
    if let Minimized::Unconverged(report) = Fire.minimize(&mut system, &goal)? {
        return Err(ProtocolError::NoStart { density: system.density()?, report });
    }
    let disks = system.own_particles();
    Ok((system.comm, disks))
}

/// Regular polygons about random centres, none crossing another.
///
/// Random polygons cross already at low density, and crossed polygons never untangle: first the centres, spread evenly
/// if `spread` is not 0 ([`spread_disks`]), are relaxed as soft disks of the full outer size, circulo-lines included,
/// until no two of them overlap by more than a hair. Polygon m is turned by its own random angle.
pub fn deformable_particles(
    comm: Comm,
    pbox: PeriodicBox,
    species: &[Species],
    seed: u64,
    delta: f64,
    spread: f64,
) -> Result<(Comm, Particles), ProtocolError> {
    let outer = |s: &Species| s.outer_diameter(delta);
    let (comm, disks) = spread_disks(comm, pbox, species, seed, outer, spread)?;
    // forces of 1e-6 ε/σ are overlaps of 1e-6 σ, far within the shells
    let (comm, centers) = relaxed(comm, pbox, disks, smallest(species, outer), 1e-6)?;
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
    Ok((comm, polygons))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Variance of the numbers of centres in the 25 equal parts of a box, over their mean: 1 for points at random.
    fn unevenness(centers: &Particles) -> f64 {
        let mut counts = [0.0f64; 25];
        centers.position.iter().for_each(|c| counts[5 * c.slab(0, 5) + c.slab(1, 5)] += 1.0);
        let mean = centers.len() as f64 / 25.0;
        counts.iter().map(|n| (n - mean).powi(2)).sum::<f64>() / 25.0 / mean
    }

    #[test]
    fn a_spread_start_is_even() {
        let species = [1.0, 1.4].map(|size| Species { count: 1000, size, n_vertices: 1 });
        let area: f64 = species.iter().map(|s| s.count as f64 * s.undeformed_area(0.0)).sum();
        let pbox = PeriodicBox::square((area / 0.7).sqrt());
        let start = |spread| spread_disks(Comm::alone(), pbox, &species, 1, |s| s.size, spread).unwrap().1;
        let (random, spread) = (start(0.0), start(0.9));
        let mut sizes = spread.size.clone();
        sizes.sort_by(f64::total_cmp);
        assert_eq!(sizes, random.size); // its disks are no wider than they should be
        let [before, after] = [random, spread].map(|disks| unevenness(&disks));
        assert!(before > 0.4 && after < before / 5.0, "{before:.3} {after:.3}");
    }
}
