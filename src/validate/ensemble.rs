//! Ensembles of random packings of soft disks: what is known of their means.
//!
//! Every rank makes the packings of its share of the seeds by itself, so that the numbers are the same on any number of
//! ranks.

use super::packings::{random_polygons, random_soft_disks};
use super::{Check, Effort};
use crate::comm::Comm;
use crate::engine::{EngineError, System};
use crate::minimize::{ConjugateGradient, Goal, Newton};
use crate::model::SoftDisks;
use crate::observe::{
    Approximations, Contacts, Moduli, PackingFraction, Rattlers, Shape, Stability, Voids, rattler_ids, touching,
};
use crate::protocol::{Onset, OnsetSearch, ProtocolError, compress_to, find_onset};
use std::collections::BTreeMap;
use std::f64::consts::PI;
use std::ops::RangeInclusive;

/// Balanced to this in units of ε/σ_S, far below the forces at the lowest pressure that counts as jammed.
const GOAL: Goal = Goal { force_tolerance: 1e-13, max_iterations: 1_000_000 };
/// Down to here a disk that weak forces push out of the way has left its contacts.
const SETTLED: Goal = Goal { force_tolerance: 1e-15, max_iterations: 1_000_000 };
/// Far below any onset, where nothing bears pressure: up to here a compression takes steps of 10⁻³.
const DILUTE: f64 = 0.8;

/// A packing at its onset, sought in first steps of `step` and relaxed to `goal`, until contacts without force have
/// opened. By Newton's method: one packing of 1024 in twelve takes conjugate gradients more than a million iterations.
fn at_onset(n: u32, seed: u64, step: f64, goal: &Goal) -> Result<(System<SoftDisks>, Onset), ProtocolError> {
    let mut system = random_soft_disks(Comm::alone(), n, seed, 0.2)?;
    let coarse = step.max(1e-3);
    let mut density = 0.2 + coarse;
    while density < DILUTE {
        compress_to(&mut system, &ConjugateGradient, &GOAL, density)?;
        density += coarse;
    }
    let search = OnsetSearch { step, smallest_step: 1e-12, pressure: [1e-10, 1e-8] };
    let onset = find_onset(&mut system, &Newton, goal, &search, |_, _, _| ())?;
    Ok((system, onset))
}

/// What `of` says of each seed, in their order, on all ranks. Where it fails it says NaN. Collective.
fn over_seeds<const K: usize>(
    comm: &Comm,
    seeds: RangeInclusive<u64>,
    of: impl Fn(u64) -> Result<[f64; K], ProtocolError>,
) -> Vec<[f64; K]> {
    let mine = seeds.clone().filter(|seed| *seed as usize % comm.size() == comm.rank());
    let words = mine.flat_map(|seed| {
        let row = of(seed).unwrap_or_else(|error| {
            tracing::warn!(seed, %error, "a packing without result");
            [f64::NAN; K]
        });
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

/// The rows of packings that have a result, and a check that nearly all have. Where 2 % are left out, means are off by
/// less than 0.02 of the spread of single packings, a fraction of their errors.
fn with_result<const K: usize>(name: &str, rows: Vec<[f64; K]>) -> (Vec<[f64; K]>, Check) {
    let n = rows.len() as f64;
    let finite: Vec<[f64; K]> = rows.into_iter().filter(|row| row.iter().all(|x| x.is_finite())).collect();
    let check = Check::new(format!("{name}: packings with a result"), 1.0, finite.len() as f64 / n, 0.02);
    (finite, check)
}

/// The mean of some numbers and its standard error.
pub fn mean_and_error(numbers: impl Iterator<Item = f64> + Clone) -> [f64; 2] {
    let n = numbers.clone().count() as f64;
    let mean = numbers.clone().sum::<f64>() / n;
    let variance = numbers.map(|x| (x - mean).powi(2)).sum::<f64>() / (n - 1.0);
    [mean, (variance / n).sqrt()]
}

/// The median of some numbers and its standard error, half the distance between the order statistics
/// that are √n/2, one standard deviation of a rank, away on either side. NaN if one of them is, or if there are none.
fn median_and_error(numbers: impl Iterator<Item = f64>) -> [f64; 2] {
    let mut sorted: Vec<f64> = numbers.collect();
    if sorted.is_empty() || sorted.iter().any(|x| x.is_nan()) {
        return [f64::NAN; 2];
    }
    sorted.sort_unstable_by(f64::total_cmp);
    let n = sorted.len();
    let median = 0.5 * (sorted[(n - 1) / 2] + sorted[n / 2]);
    let away = (0.5 * (n as f64).sqrt()).ceil() as usize;
    let (low, high) = (sorted[((n - 1) / 2).saturating_sub(away)], sorted[(n / 2 + away).min(n - 1)]);
    [median, 0.5 * (high - low)]
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
            let (mut system, onset) = at_onset(n, seed, step, &SETTLED)?;
            let contacts = Contacts::of(&mut system, Rattlers::default())?;
            let backbone = contacts.n_backbone() as f64;
            // before particles may be stored in another order
            let hexagons = hexagons(&mut system)? as f64;
            let removed = rattler_ids(&system, &contacts);
            let voids = Voids::of(&mut system, &removed, None)?.statistics;
            let [three, four, five, six, _] = voids.fractions();
            let excess = contacts.n_contacts as f64 - (2.0 * backbone - 1.0);
            let rattlers = 1.0 - backbone / n as f64;
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
fn hexagons(system: &mut System<SoftDisks>) -> Result<usize, EngineError> {
    let touching = touching(system)?;
    let particles = system.particles();
    let place: BTreeMap<u32, usize> = particles.id.iter().enumerate().map(|(p, &id)| (id, p)).collect();
    let is_middle = |p: &usize| {
        let ring: Vec<usize> = touching.row(*p).iter().map(|id| place[id]).collect();
        let same_size = |&q: &usize| particles.size[q] == particles.size[*p];
        let in_ring = |&q: &usize| touching.row(q).iter().filter(|id| ring.contains(&place[id])).count() == 2;
        ring.len() == 6 && ring.iter().all(same_size) && ring.iter().all(in_ring)
    };
    Ok((0..particles.len()).filter(is_middle).count())
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
    // equal disks have the least, one small and two large ones the most
    let [least, most] = [[1.0; 3], [1.0, 1.4, 1.4]].map(shape_parameter_between);
    let middle = 0.5 * (least + most);
    checks.push(Check::new(name("A of 3 sides"), middle, shape, (most - middle) / middle));
    checks
}

/// p²/4πa of the void between three disks of these radii that touch.
fn shape_parameter_between(radii: [f64; 3]) -> f64 {
    let sides = [0, 1, 2].map(|k| radii[(k + 1) % 3] + radii[(k + 2) % 3]);
    let half = 0.5 * sides.iter().sum::<f64>();
    let mut area = sides.iter().map(|side| half - side).product::<f64>();
    area = (area * half).sqrt();
    let mut perimeter = 0.0;
    for k in 0..3 {
        let [a, b, c] = [sides[k], sides[(k + 1) % 3], sides[(k + 2) % 3]];
        let angle = ((b * b + c * c - a * a) / (2.0 * b * c)).acos();
        perimeter += angle * radii[k];
        area -= 0.5 * angle * radii[k] * radii[k];
    }
    perimeter * perimeter / (4.0 * PI * area)
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
            let shapes: Vec<Shape> = system.outlines(Shape::of)?;
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

    checks.extend(amplitude_checks(&comm));
    Ok(checks)
}

/// z₀ and G₀ (in ε/σ_LS², σ_LS = 1.2 the mean diameter) of one packing: least squares of z − z_J = z₀ √Δφ and
/// G = G₀ √Δφ over Δφ = 0.01 to 0.11, unstable states left out.
fn amplitudes(n: u32, seed: u64) -> Result<[f64; 2], ProtocolError> {
    // ten times the force: rounding keeps one packing in thirty of this size above the smallest
    let (mut system, onset) = at_onset(n, seed, 1e-3, &Goal { force_tolerance: 1e-14, ..SETTLED })?;
    let z_onset = Contacts::of(&mut system, Rattlers::default())?.contact_number();
    let (mut products, mut squares) = ([0.0; 2], [0.0; 2]);
    for k in 1..=11 {
        let increment = 0.01 * k as f64;
        compress_to(&mut system, &ConjugateGradient, &GOAL, onset.density + increment)?;
        let z = Contacts::of(&mut system, Rattlers::default())?.contact_number();
        products[0] += (z - z_onset) * increment.sqrt();
        squares[0] += increment;
        let moduli = Moduli::of(&mut system)?;
        if moduli.stability == Stability::Stable {
            products[1] += 1.44 * moduli.mean_shear_modulus * increment.sqrt();
            squares[1] += increment;
        }
    }
    Ok([products[0] / squares[0], products[1] / squares[1]])
}

/// The paper's amplitudes. They come to their limits slowly: G₀ rises from 0.20 at N = 32 to 0.37 at 1024 and 0.39 from
/// 4096 on (docs/study.md). So what is left at N = 1024, 0.2 in z₀ and 0.05 in G₀, is allowed besides two standard errors.
fn amplitude_checks(comm: &Comm) -> Vec<Check> {
    const REFERENCE: [(&str, f64, f64); 2] = [("z0", 3.7, 0.2), ("G0", 0.42, 0.05)];
    let (rows, check) = with_result("SP N = 1024", over_seeds(comm, 1..=64, |seed| amplitudes(1024, seed)));
    let mut checks = vec![check];
    for (k, (what, expected, left)) in REFERENCE.into_iter().enumerate() {
        let [mean, error] = mean_and_error(rows.iter().map(|row| row[k]));
        checks.push(Check::new(format!("SP N = 1024: {what}"), expected, mean, (left + 2.0 * error) / expected));
    }
    checks
}

/// Statistics of deformable particles near confluence, in the long mode, with δ = 0.1 and the paper's stiffness.
///
/// A packing that is about to change neighbours has a G as far below zero as it is near to it, so that the mean of some
/// packings is what the worst of them says; their median is compared, to two standard errors and the last digit of the
/// reference. From ρ ≈ 0.97 on, read as 0.975, all voids that are left have three sides; to half a percent.
pub fn deformable(world: &dyn Fn() -> Comm, effort: Effort) -> Result<Vec<Check>, ProtocolError> {
    if effort == Effort::Quick {
        return Ok(Vec::new());
    }
    // ρ; G and what its last digit leaves open; P_3
    type Reference = (f64, Option<[f64; 2]>, Option<f64>);
    const REFERENCE: [Reference; 4] = [
        (0.92, Some([0.5, 0.05]), None),
        (0.95, Some([0.65, 0.005]), None),
        (0.975, None, Some(1.0)),
        (0.98, Some([0.97, 0.005]), Some(1.0)),
    ];
    const N: u32 = 64;
    const SEEDS: u64 = 64;
    let comm = world();
    let rows = over_seeds(&comm, 1..=SEEDS, |seed| {
        let mut system = random_polygons(Comm::alone(), N, seed, 1.1)?;
        let coarse = Goal { force_tolerance: 1e-3, max_iterations: 300_000 };
        for density in [0.86, 0.9] {
            compress_to(&mut system, &Newton, &coarse, density)?;
        }
        let goal = Goal { force_tolerance: 1e-8, max_iterations: 300_000 };
        let mut row = [0.0; 8];
        for ((density, ..), row) in REFERENCE.into_iter().zip(row.chunks_exact_mut(2)) {
            // shells grow as particles deform: again, to make up for it
            for _ in 0..2 {
                compress_to(&mut system, &Newton, &goal, density)?;
            }
            let voids = Voids::of(&mut system, &[], None)?.statistics;
            row.copy_from_slice(&[Moduli::of(&mut system)?.mean_shear_modulus, voids.fractions()[0]]);
        }
        Ok(row)
    });
    let (rows, check) = with_result(&format!("DP N = {N}"), rows);
    let mut checks = vec![check];
    for (k, (density, modulus, three)) in REFERENCE.into_iter().enumerate() {
        let name = |what: &str| format!("DP N = {N}, rho = {density}: {what}");
        let of = |column: usize| rows.iter().map(move |row| row[2 * k + column]);
        if let Some([expected, rounded]) = modulus {
            let [g, error] = median_and_error(of(0));
            checks.push(Check::new(name("median G"), expected, g, (rounded + 2.0 * error) / expected));
        }
        if let Some(expected) = three {
            let [p, error] = mean_and_error(of(1));
            checks.push(Check::new(name("voids with 3 sides"), expected, p, 0.005 + 2.0 * error));
        }
    }
    Ok(checks)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn touching_disks_enclose_a_plateau_border() {
        let shape = shape_parameter_between([0.7; 3]);
        assert!((shape / super::super::plateau_shape_parameter() - 1.0).abs() < 1e-12);
        assert!((shape_parameter_between([1.0, 1.4, 1.4]) - 4.875442928013839).abs() < 1e-12);
    }

    #[test]
    fn medians() {
        assert_eq!(median_and_error([3.0, 1.0, 2.0, 9.0].into_iter()), [2.5, 4.0]);
        let [median, error] = median_and_error((0..100).map(f64::from));
        assert!(median == 49.5 && (5.0..=6.0).contains(&error));
        assert!(median_and_error([1.0, f64::NAN].into_iter())[0].is_nan());
    }
}
