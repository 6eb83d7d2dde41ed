//! Ensembles of random packings of soft disks: what is known of their means.
//!
//! Every rank makes the packings of its share of the seeds by itself, so that the numbers are the same on any number of
//! ranks.

use super::packings::{random_polygons, random_soft_disks};
use super::{Check, Effort};
use crate::comm::Comm;
use crate::engine::System;
use crate::minimize::{ConjugateGradient, Fire, Goal, Minimized, Minimizer};
use crate::model::SoftDisks;
use crate::observe::{Approximations, Contacts, Moduli, PackingFraction, Rattlers, Shape, Voids, rattler_ids};
use crate::protocol::{Onset, OnsetSearch, ProtocolError, compress_to, find_onset};
use std::collections::BTreeMap;
use std::ops::RangeInclusive;

/// Balanced to this in units of ε/σ_S, far below the forces at the lowest pressure that counts as jammed.
const GOAL: Goal = Goal { force_tolerance: 1e-13, max_iterations: 1_000_000 };
/// Down to here a disk that weak forces push out of the way has left its contacts.
const SETTLED: Goal = Goal { force_tolerance: 1e-15, max_iterations: 1_000_000 };
/// Far below any onset, where nothing bears pressure: up to here a compression takes steps of 10⁻³.
const DILUTE: f64 = 0.8;

/// A packing at its onset. The onset is sought in first steps of `step`; then it is relaxed until contacts without
/// force have opened.
fn at_onset(n: u32, seed: u64, step: f64) -> Result<(System<SoftDisks>, Onset), ProtocolError> {
    let mut system = random_soft_disks(Comm::alone(), n, seed, 0.2)?;
    let coarse = step.max(1e-3);
    let mut density = 0.2 + coarse;
    while density < DILUTE {
        compress_to(&mut system, &ConjugateGradient, &GOAL, density)?;
        density += coarse;
    }
    let search = OnsetSearch { step, smallest_step: 1e-12, pressure: [1e-10, 1e-8] };
    let onset = find_onset(&mut system, &ConjugateGradient, &GOAL, &search, |_, _, _| ())?;
    match ConjugateGradient.minimize(&mut system, &SETTLED)? {
        Minimized::Converged(_) => Ok((system, onset)),
        Minimized::Unconverged(report) => Err(ProtocolError::Unconverged { density: onset.density, report }),
    }
}

/// What `of` says of each seed, in their order, on all ranks. Where it fails it says NaN. Collective.
fn over_seeds<const K: usize>(
    comm: &Comm,
    seeds: RangeInclusive<u64>,
    of: impl Fn(u64) -> Result<[f64; K], ProtocolError>,
) -> Vec<[f64; K]> {
    let mine = seeds.clone().filter(|seed| *seed as usize % comm.size() == comm.rank());
    let words = mine.flat_map(|seed| {
        let row = of(seed).unwrap_or([f64::NAN; K]);
        [seed].into_iter().chain(row.map(f64::to_bits))
    });
    let all = comm.gather(words.collect()).concat();
    let mut rows: Vec<&[u64]> = all.chunks_exact(K + 1).collect();
    rows.sort_unstable_by_key(|row| row[0]);
    let bytes = rows.iter().flat_map(|row| &row[1..]).flat_map(|word| word.to_le_bytes()).collect();
    let shared = comm.broadcast(bytes);
    let numbers = shared.chunks_exact(8).map(|b| f64::from_le_bytes(std::array::from_fn(|k| b[k])));
    let numbers: Vec<f64> = numbers.collect();
    numbers.chunks_exact(K).map(|row| std::array::from_fn(|k| row[k])).collect()
}

/// The mean of some numbers and its standard error.
pub fn mean_and_error(numbers: impl Iterator<Item = f64> + Clone) -> [f64; 2] {
    let n = numbers.clone().count() as f64;
    let mean = numbers.clone().sum::<f64>() / n;
    let variance = numbers.map(|x| (x - mean).powi(2)).sum::<f64>() / (n - 1.0);
    [mean, (variance / n).sqrt()]
}

/// One packing at its onset.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AtOnset {
    /// φ_J
    pub density: f64,
    /// Contacts beyond the isostatic number, 2 N′ − 1.
    pub excess: f64,
    /// Of those the ones that hexagons of equal disks explain.
    pub hexagons: f64,
    /// 1 − N′/N
    pub rattlers: f64,
    /// Fractions with 3, 4, 5 and 6 sides of the voids between particles that are no rattlers.
    pub fractions: [f64; 4],
    /// Shape parameter of those with 3 sides.
    pub border_shape_parameter: f64,
}

impl AtOnset {
    /// Packings of `n` disks from these seeds, in their order, on all ranks; NaN where a state did not come to force
    /// balance. Collective.
    pub fn of_seeds(comm: &Comm, n: u32, seeds: RangeInclusive<u64>, step: f64) -> Vec<AtOnset> {
        let rows = over_seeds(comm, seeds, |seed| {
            let (mut system, onset) = at_onset(n, seed, step)?;
            let contacts = Contacts::of(&mut system, Rattlers::default())?;
            let backbone = contacts.n_backbone() as f64;
            let removed = rattler_ids(&system, &contacts);
            let voids = Voids::of(&mut system, &removed, None)?.statistics;
            let [three, four, five, six, _] = voids.fractions();
            let excess = contacts.n_contacts as f64 - (2.0 * backbone - 1.0);
            let (hexagons, rattlers) = (hexagons(&system, &contacts) as f64, 1.0 - backbone / n as f64);
            Ok([onset.density, excess, hexagons, rattlers, three, four, five, six, voids.border_shape_parameter])
        });
        let packing = |row: &[f64; 9]| {
            let [density, excess, hexagons, rattlers, three, four, five, six, border_shape_parameter] = *row;
            AtOnset { density, excess, hexagons, rattlers, fractions: [three, four, five, six], border_shape_parameter }
        };
        rows.iter().map(packing).collect()
    }

    /// As many contacts as hold it, and those that equal disks have beyond.
    pub fn is_isostatic(&self) -> bool {
        self.excess == self.hexagons
    }
}

/// Disks in the middle of six of their own size that touch it and each other in a ring. Of these 12 contacts the last
/// closes by itself, because equal disks fit: one more than 2 N′ − 1 at any pressure, however close to the onset.
fn hexagons(system: &System<SoftDisks>, contacts: &Contacts) -> usize {
    let particles = system.particles();
    let place: BTreeMap<u32, usize> = particles.id.iter().enumerate().map(|(p, &id)| (id, p)).collect();
    let is_middle = |p: &usize| {
        let ring: Vec<usize> = contacts.touching[*p].iter().map(|id| place[id]).collect();
        let same_size = |&q: &usize| particles.size[q] == particles.size[*p];
        let in_ring = |&q: &usize| contacts.touching[q].iter().filter(|id| ring.contains(&place[id])).count() == 2;
        ring.len() == 6 && ring.iter().all(same_size) && ring.iter().all(in_ring)
    };
    (0..particles.len()).filter(is_middle).count()
}

/// Packings of an independent implementation at their onset, N = 128, in steps of 10⁻⁴: mean φ_J, its standard error
/// and the spread of single packings, so that there were 24.
const PHI_J: [f64; 2] = [0.8344, 0.0011];
const SPREAD: f64 = 0.0054;
/// The fraction of another set of theirs that is isostatic, and how many that are.
const ISOSTATIC: [f64; 2] = [107.0 / 108.0, 108.0];
/// P_3 to P_6 of theirs, and the error of rounding.
const FRACTIONS: [f64; 4] = [0.35, 0.38, 0.205, 0.04];
const ROUNDED: [f64; 4] = [0.005, 0.005, 0.0025, 0.005];

/// Statistics of soft disks at their onset: φ_J to the combined standard error, which also depends on the first step of
/// the search; the fraction that is isostatic; voids. Tolerances of means are one combined standard error for φ_J and the
/// isostatic fraction and two for those of voids, theirs being ours for 24 packings, and what rounding leaves open.
/// Collective.
pub fn onset_checks(comm: &Comm, seeds: u64, step: f64) -> Vec<Check> {
    let packings = AtOnset::of_seeds(comm, 128, 1..=seeds, step);
    let name = |what: &str| format!("SP onset, N = 128, {seeds} seeds: {what}");
    let [mean, error] = mean_and_error(packings.iter().map(|p| p.density));
    let theirs = (SPREAD / PHI_J[1]).powi(2);
    let mut checks = vec![
        Check::new(name("phi_J"), PHI_J[0], mean, error.hypot(PHI_J[1]) / PHI_J[0]),
        Check::new(
            name("spread of phi_J"),
            SPREAD,
            error * (seeds as f64).sqrt(),
            // the relative error of a spread is 1/√(2n)
            2.0 * (0.5 / theirs + 0.5 / seeds as f64).sqrt(),
        ),
    ];
    let isostatic = packings.iter().filter(|p| p.is_isostatic()).count() as f64 / seeds as f64;
    let [expected, of] = ISOSTATIC;
    let combined = (expected * (1.0 - expected) * (1.0 / of + 1.0 / seeds as f64)).sqrt();
    checks.push(Check::new(name("isostatic"), expected, isostatic, combined / expected));
    for (k, (expected, rounded)) in FRACTIONS.into_iter().zip(ROUNDED).enumerate() {
        let [mean, error] = mean_and_error(packings.iter().map(|p| p.fractions[k]));
        let combined = error * (1.0 + seeds as f64 / theirs).sqrt();
        checks.push(Check::new(
            name(&format!("voids with {} sides", k + 3)),
            expected,
            mean,
            (2.0 * combined + rounded) / expected,
        ));
    }
    let [shape, _] = mean_and_error(packings.iter().map(|p| p.border_shape_parameter));
    // of disks of two sizes
    checks.push(Check::new(name("A of 3 sides"), super::plateau_shape_parameter(), shape, 1e-3));
    checks
}

/// Statistics of soft disks, in the long mode: at their onset; compressed far beyond it, where the paper's areas fail;
/// and in between, where z and G rise with the square root of the distance.
pub fn soft_disks(world: &dyn Fn() -> Comm, effort: Effort) -> Result<Vec<Check>, ProtocolError> {
    if effort == Effort::Quick {
        return Ok(Vec::new());
    }
    let comm = world();
    let mut checks = onset_checks(&comm, 100, 1e-4);

    const DENSITIES: [f64; 5] = [0.85, 0.9, 1.0, 1.1, 1.24];
    let rows = over_seeds(&comm, 1..=10, |seed| {
        let mut system = random_soft_disks(Comm::alone(), 128, seed, 0.2)?;
        let mut row = [0.0; 15];
        for (density, row) in DENSITIES.into_iter().zip(row.chunks_exact_mut(3)) {
            compress_to(&mut system, &ConjugateGradient, &GOAL, density)?;
            let shapes: Vec<Shape> = system.outlines()?.iter().map(Shape::of).collect();
            let rho = PackingFraction::of(&mut system, &shapes)?.packing_fraction;
            let a = Approximations::of(&mut system)?;
            let voids = Voids::of(&mut system, &[], Some(rho))?.statistics;
            row.copy_from_slice(&[a.eq9_eq10 - rho, a.eq12 - rho, voids.border_shape_parameter]);
        }
        Ok(row)
    });
    let mut of = |k: usize, column: usize, what: &str, expected: f64, rounded: f64| {
        let [mean, error] = mean_and_error(rows.iter().map(|row| row[3 * k + column]));
        let name = format!("SP phi = {}: {what}", DENSITIES[k]);
        checks.push(Check::new(name, expected, mean, (rounded + 2.0 * error) / expected.abs()));
    };
    of(2, 0, "Eqs. 9, 10 less rho", -0.48, 0.005);
    of(4, 1, "Eq. 12 less rho", 2e-3, 5e-4);
    of(2, 2, "A of 3 sides", 2.3, 0.05);

    const INCREMENTS: [f64; 3] = [3e-3, 1e-2, 3e-2];
    let rows = over_seeds(&comm, 1..=6, |seed| {
        let (mut system, onset) = at_onset(1024, seed, 1e-3)?;
        let mut row = [0.0; 6];
        for (increment, row) in INCREMENTS.into_iter().zip(row.chunks_exact_mut(2)) {
            compress_to(&mut system, &ConjugateGradient, &GOAL, onset.density + increment)?;
            let z = Contacts::of(&mut system, Rattlers::default())?.contact_number();
            let shear_modulus = Moduli::of(&mut system)?.mean_shear_modulus;
            // in ε/σ_LS², σ_LS = 1.2 the mean diameter
            row.copy_from_slice(&[(z - 4.0) / increment.sqrt(), 1.44 * shear_modulus / increment.sqrt()]);
        }
        Ok(row)
    });
    for (k, increment) in INCREMENTS.into_iter().enumerate() {
        let of = |column: usize| mean_and_error(rows.iter().map(|row| row[2 * k + column]));
        let name = |what: &str| format!("SP N = 1024, dphi = {increment}: {what}");
        let ([z, z_error], [g, g_error]) = (of(0), of(1));
        checks.push(Check::new(name("z0"), 3.7, z, 0.1 + 2.0 * z_error / 3.7));
        checks.push(Check::new(name("G0"), 0.42, g, 0.1 + 2.0 * g_error / 0.42));
    }
    Ok(checks)
}

/// Statistics of deformable particles near confluence, in the long mode, δ = 0.1: means of G over seeds, and of the
/// voids that are left nearly all have three sides.
pub fn deformable(world: &dyn Fn() -> Comm, effort: Effort) -> Result<Vec<Check>, ProtocolError> {
    if effort == Effort::Quick {
        return Ok(Vec::new());
    }
    const DENSITIES: [f64; 3] = [0.92, 0.95, 0.98];
    const EXPECTED: [f64; 3] = [0.5, 0.65, 0.97];
    const SEEDS: u64 = 4;
    let comm = world();
    let rows = over_seeds(&comm, 1..=SEEDS, |seed| {
        let mut system = random_polygons(Comm::alone(), 32, seed, 0.01)?;
        let mut row = [0.0; 6];
        let coarse = Goal { force_tolerance: 1e-2, max_iterations: 10_000_000 };
        for density in [0.8, 0.84, 0.88, 0.9] {
            compress_to(&mut system, &Fire, &coarse, density)?;
        }
        let goal = Goal { force_tolerance: 1e-7, max_iterations: 10_000_000 };
        for (density, row) in DENSITIES.into_iter().zip(row.chunks_exact_mut(2)) {
            compress_to(&mut system, &Fire, &goal, density)?;
            let voids = Voids::of(&mut system, &[], None)?.statistics;
            let g = Moduli::of(&mut system)?.mean_shear_modulus;
            row.copy_from_slice(&[g, voids.fractions()[0]]);
        }
        Ok(row)
    });
    let mut checks = Vec::new();
    for (k, (density, expected)) in DENSITIES.into_iter().zip(EXPECTED).enumerate() {
        let [g, error] = mean_and_error(rows.iter().map(|row| row[2 * k]));
        let name = |what: &str| format!("DP N = 32, rho = {density}, {SEEDS} seeds: {what}");
        checks.push(Check::new(name("G"), expected, g, (0.01 + 2.0 * error) / expected));
    }
    let [three, _] = mean_and_error(rows.iter().map(|row| row[5]));
    checks.push(Check::new("DP rho = 0.98: voids with 3 sides", 1.0, three, 0.02));
    Ok(checks)
}
