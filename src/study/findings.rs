//! What a study finds: fits of the paper's laws, each with its window, and what the paper says beside it.

use super::data::{Ensemble, Packings, Quantity};
use super::paper;
use crate::scene::Model;
use crate::statistics::{
    Curve, Estimate, amplitudes, bootstrap, free_exponent, free_exponents, mean, power_law, spread,
};

/// Resamples for the errors of fits.
pub(super) const RESAMPLES: usize = 200;
/// Distances above onset at which amplitudes are fitted: above the crossover of a packing so large, which is at some 10 to
/// 100 N⁻², and below confluence. The smallest packings are not asymptotic anywhere.
pub fn window(n_particles: usize) -> [f64; 2] {
    [(100.0 / (n_particles as f64).powi(2)).clamp(2e-3, 2e-2), 0.11]
}

/// Deformable particles between these are fitted by a single power, as in the paper.
const SINGLE: [f64; 2] = [1e-2, 0.13];
/// Ranges of freed exponents.
const FIRST: [f64; 2] = [0.05, 0.95];
const SECOND: [f64; 2] = [0.96, 3.0];
const SINGLE_RANGE: [f64; 2] = [0.05, 2.0];
/// Fewer packings have no errors.
pub(super) const FEWEST: usize = 3;
/// Fits of single sizes want as many.
const ENOUGH: usize = 20;

/// A number that was found.
#[derive(Clone, Debug, PartialEq)]
pub struct Finding {
    /// Such as `z_0`.
    pub symbol: String,
    /// Which law, and where it was fitted.
    pub law: String,
    pub found: Estimate,
    /// What the paper says, where it says something.
    pub paper: Option<f64>,
}

/// Numbers of one kind of packings, or of all sizes of an ensemble.
#[derive(Clone, Debug, PartialEq)]
pub struct Findings {
    pub title: String,
    pub rows: Vec<Finding>,
}

impl Findings {
    fn new(title: String) -> Self {
        Findings { title, rows: Vec::new() }
    }

    fn add(&mut self, symbol: &str, law: &str, found: Estimate, paper: Option<f64>) {
        if found.value.is_finite() {
            self.rows.push(Finding { symbol: symbol.into(), law: law.into(), found, paper });
        }
    }

    /// What was found under a symbol by a law that begins so.
    pub fn get(&self, symbol: &str, law: &str) -> Option<Estimate> {
        self.rows.iter().find(|row| row.symbol == symbol && row.law.starts_with(law)).map(|row| row.found)
    }
}

/// The size whose fits stand in tables 1 and 2: the paper's 256, or else the largest with enough packings.
pub fn table_size(ensemble: &Ensemble) -> Option<&Packings> {
    let enough: Vec<&Packings> = ensemble.sizes.iter().filter(|s| s.all.len() >= ENOUGH).collect();
    let paper = enough.iter().copied().find(|s| s.n_particles == 256);
    paper.or(enough.last().copied()).or_else(|| ensemble.sizes.iter().rfind(|s| s.all.len() >= FEWEST))
}

fn window_text([low, high]: [f64; 2], of: &str) -> String {
    format!("{low} ≤ {of} ≤ {high}")
}

/// Fits of one size.
pub fn of_size(packings: &Packings) -> Findings {
    let mut out = Findings::new(format!("{}, N = {}", packings.ensemble, packings.n_particles));
    if packings.all.len() < FEWEST {
        return out;
    }
    let onset = |name: Quantity| packings.average(name).first().copied().unwrap_or_default();
    out.add("z_J", "mean at onset", onset(Quantity::ContactNumber), Some(paper::Z_ONSET));
    if packings.resolves_onsets() {
        let onsets = packings.onsets();
        let mean_onset = bootstrap(&[onsets.len()], RESAMPLES, |d| vec![mean(d[0].iter().map(|&k| onsets[k]))])[0];
        let name = if packings.model == Model::Sp { "φ_J" } else { "ρ_J" };
        out.add(name, "mean", mean_onset, Some(paper::Row::of(packings.model).onset));
    }
    if packings.model == Model::Sp {
        scaling(&mut out, packings, Quantity::DeltaPhi, "Δφ", &paper::SP_PHI, false);
        scaling(&mut out, packings, Quantity::DeltaRho, "Δρ", &paper::SP_RHO, true);
        of_disks(&mut out, packings);
    } else {
        scaling(&mut out, packings, Quantity::DeltaRho, "Δρ", &paper::DP_RHO, true);
        single_powers(&mut out, packings);
    }
    shapes(&mut out, packings);
    for (k, fraction) in paper::VOIDS.iter().enumerate() {
        let sides = k + 3;
        out.add(&format!("P_{sides}"), "mean at onset", onset(Quantity::Voids(sides)), Some(*fraction));
    }
    out.add("𝒜_3", "voids of three sides, mean at onset", onset(Quantity::BorderShape), Some(paper::PLATEAU));
    out
}

/// Eqs. 1 and 2, or 13 and 14. Amplitudes are fitted as the paper does on its linear scales, where samples are evenly
/// spaced and count alike; freed exponents to means that count by their errors.
fn scaling(out: &mut Findings, packings: &Packings, x: Quantity, name: &str, row: &paper::Row, two: bool) {
    let window = window(packings.n_particles);
    let place = window_text(window, name);
    let laws = [
        ("z", "Δz", Quantity::DeltaContactNumber, row.contacts, "α"),
        ("G", "G", Quantity::ShearModulus, row.modulus, "β"),
    ];
    for (symbol, of, y, paper, exponent) in laws {
        let (zero, one) = (format!("{symbol}_0"), format!("{symbol}_1"));
        let none = vec![f64::NAN; 4];
        if two {
            let law = format!("{of} = {zero} {name}^0.5 + {one} {name}, {place}");
            let fit = |curve: &Curve| match amplitudes(&curve.evenly(), &[0.5, 1.0]) {
                Some((a, _)) => vec![a[0], a[1], a[1] / a[0]],
                None => none.clone(),
            };
            let found = packings.fitted([x, y], window, RESAMPLES, fit);
            out.add(&zero, &law, found[0], Some(paper[0]));
            out.add(&one, &law, found[1], Some(paper[1]));
            out.add(&format!("{one}/{zero}"), &law, found[2], Some(paper[1] / paper[0]));
            let law =
                format!("{of} = {zero} {name}^{exponent}_0 + {one} {name}^{exponent}_1, exponents freed, {place}");
            let fit = |curve: &Curve| match free_exponents(curve, [FIRST, SECOND]) {
                Some((e, a)) => vec![e[0], e[1], a[0], a[1]],
                None => none.clone(),
            };
            let found = packings.fitted([x, y], window, RESAMPLES / 4, fit);
            // at the end of their ranges the data do not tell two powers apart
            let inside = |e: f64, [low, high]: [f64; 2]| low + 0.01 < e && e < high - 0.01;
            if inside(found[0].value, FIRST) && inside(found[1].value, SECOND) {
                out.add(&format!("{exponent}_0"), &law, found[0], Some(0.5));
                out.add(&format!("{exponent}_1"), &law, found[1], Some(1.0));
            }
            let law = format!("{of} ∝ {name}^{exponent}′, one exponent freed, {place}");
            let fit =
                |curve: &Curve| free_exponent(curve, &[], SINGLE_RANGE).map_or(vec![f64::NAN], |(e, _, _)| vec![e]);
            let found = packings.fitted([x, y], window, RESAMPLES, fit);
            out.add(&format!("{exponent}′"), &law, found[0], None);
        } else {
            let law = format!("{of} = {zero} {name}^0.5, {place}");
            let fit = |curve: &Curve| amplitudes(&curve.evenly(), &[0.5]).map_or(vec![f64::NAN], |(a, _)| a);
            let found = packings.fitted([x, y], window, RESAMPLES, fit);
            out.add(&zero, &law, found[0], Some(paper[0]));
            let law = format!("{of} = {zero} {name}^{exponent}_0, exponent freed, {place}");
            let fit =
                |curve: &Curve| free_exponent(curve, &[], SINGLE_RANGE).map_or(none.clone(), |(e, a, _)| vec![e, a[0]]);
            let found = packings.fitted([x, y], window, RESAMPLES, fit);
            out.add(&format!("{exponent}_0"), &law, found[0], Some(0.5));
            out.add(&zero, &law, found[1], None);
        }
    }
}

/// Single powers of deformable particles.
fn single_powers(out: &mut Findings, packings: &Packings) {
    for (symbol, y) in [("α′", Quantity::DeltaContactNumber), ("β′", Quantity::ShearModulus)] {
        exponent(out, packings, symbol, [Quantity::DeltaRho, y], SINGLE, "Δρ", Some(paper::SINGLE_POWER));
    }
}

/// An exponent by a line through logarithms.
fn exponent(
    out: &mut Findings,
    packings: &Packings,
    symbol: &str,
    xy: [Quantity; 2],
    window: [f64; 2],
    of: &str,
    paper: Option<f64>,
) {
    let fit = |curve: &Curve| power_law(curve).map_or(vec![f64::NAN], |[_, e]| vec![e]);
    let found = packings.fitted(xy, window, RESAMPLES, fit)[0];
    out.add(symbol, &format!("line through logarithms, {}", window_text(window, of)), found, paper);
}

/// What overlaps do to soft disks.
fn of_disks(out: &mut Findings, packings: &Packings) {
    use Quantity::{AreaLoss, DeltaPhi, DeltaRho, EnergyPerParticle, Overlap};
    let window = [1e-8, 1e-3];
    exponent(out, packings, "κ", [EnergyPerParticle, Overlap], window, "U/N", Some(paper::KAPPA));
    for (symbol, window, paper) in [("C", [1e-4, 1e-2], None), ("C", [1e-2, 0.2], Some(paper::C))] {
        let fit = |curve: &Curve| {
            let shape = |&x: &f64| x - x.powf(1.5);
            let linear = Curve { x: curve.x.iter().map(shape).collect(), ..curve.clone() };
            amplitudes(&linear, &[1.0]).map_or(vec![f64::NAN], |(a, _)| a)
        };
        let found = packings.fitted([DeltaPhi, DeltaRho], window, RESAMPLES, fit)[0];
        out.add(symbol, &format!("Δρ = C (Δφ − Δφ^1.5), {}", window_text(window, "Δφ")), found, paper);
    }
    let windows = [[1e-4, 1e-2], [0.1, 0.15]];
    for (k, window) in windows.into_iter().enumerate() {
        exponent(out, packings, "ζ", [DeltaRho, AreaLoss], window, "Δρ", Some(paper::ZETA[k]));
    }
    exponent(out, packings, "λ", [Quantity::Shape, DeltaPhi], [1e-6, 1e-2], "𝒜 − 1", Some(paper::LAMBDA));
}

/// Density against shape.
fn shapes(out: &mut Findings, packings: &Packings) {
    let small = if packings.model == Model::Sp { [1e-6, 1e-3] } else { [1e-4, 1e-2] };
    for (k, window) in [small, [1e-2, 0.2]].into_iter().enumerate() {
        let paper = paper::omega(packings.model)[k];
        exponent(out, packings, "ω", [Quantity::Shape, Quantity::DeltaRho], window, "𝒜 − 1", Some(paper));
    }
}

/// What only several sizes together tell.
pub fn of_ensemble(ensemble: &Ensemble) -> Findings {
    let mut out = Findings::new(format!("{}, all sizes", ensemble.name));
    onsets(&mut out, ensemble);
    crossover(&mut out, ensemble);
    out
}

/// Spread and mean of onsets against size, of the sizes whose onsets are known well enough.
fn onsets(out: &mut Findings, ensemble: &Ensemble) {
    let name = if ensemble.model == Model::Sp { "φ_J" } else { "ρ_J" };
    let onsets: Vec<(f64, Vec<f64>)> = ensemble
        .sizes
        .iter()
        .filter(|s| s.resolves_onsets())
        .map(|s| (s.n_particles as f64, s.onsets()))
        .filter(|(_, onsets)| onsets.len() >= FEWEST)
        .collect();
    let Some((smallest, _)) = onsets.first() else { return };
    let window = format!("{smallest} ≤ N ≤ {}", onsets[onsets.len() - 1].0);
    let counts: Vec<usize> = onsets.iter().map(|(_, values)| values.len()).collect();
    let drawn_of = |drawn: &[Vec<usize>], j: usize| drawn[j].iter().map(|&k| onsets[j].1[k]).collect::<Vec<f64>>();
    let sizes: Vec<f64> = onsets.iter().map(|(n, _)| *n).collect();
    let spreads: Vec<f64> = onsets.iter().map(|(_, values)| spread(values.iter().copied())).collect();
    // of a spread from n packings: 1/√(2(n − 1)) of it
    let spread_errors = spreads.iter().zip(&counts).map(|(s, &n)| s / (2.0 * (n as f64 - 1.0)).sqrt()).collect();
    let mean_errors: Vec<f64> = spreads.iter().zip(&counts).map(|(s, &n)| s / (n as f64).sqrt()).collect();

    let mut widths = Curve { x: sizes.clone(), y: spreads.clone(), error: spread_errors };
    let theta = bootstrap(&counts, RESAMPLES, |drawn| {
        let y = (0..counts.len()).map(|j| spread(drawn_of(drawn, j).into_iter())).collect();
        power_law(&Curve { y, ..widths.clone() }).map_or(vec![f64::NAN; 2], |[a, e]| vec![-e, a])
    });
    widths.y = spreads;
    if counts.len() > 1 {
        out.add("θ", &format!("spread of {name} ∝ N^−θ, {window}"), theta[0], Some(paper::THETA));
    }
    // the scale of finite-size shifts, L^−1/ν with 1/ν = 1.4 in two dimensions (O'Hern et al. 2003)
    const SHIFT: f64 = 0.7;
    let limit = |free: bool| {
        bootstrap(&counts, RESAMPLES, |drawn| {
            let y = (0..counts.len()).map(|j| mean(drawn_of(drawn, j).into_iter())).collect();
            let curve = Curve { x: sizes.clone(), y, error: mean_errors.clone() };
            let found = if free {
                free_exponent(&curve, &[0.0], [-3.0, -0.2]).map(|(e, a, _)| vec![a[1], -e, a[0]])
            } else {
                amplitudes(&curve, &[0.0, -SHIFT]).map(|(a, _)| vec![a[0], SHIFT, a[1]])
            };
            found.unwrap_or(vec![f64::NAN; 3])
        })
    };
    let fixed = limit(false);
    let law = format!("{name} = {name}∞ + b N^−{SHIFT}, {window}");
    out.add(&format!("{name}∞"), &law, fixed[0], Some(paper::ONSET_LIMIT));
    out.add("b", &law, fixed[2], None);
    let free = limit(true);
    let law = format!("{name} = {name}∞ + b N^−e, exponent freed, {window}");
    out.add(&format!("{name}∞"), &law, free[0], Some(paper::ONSET_LIMIT));
    out.add("e", &law, free[1], None);
}

/// Where Δz turns from a line into a square root: Δ* = (z_0/a_N)² with Δz = a_N Δ far below, which goes as N^−μ. The
/// amplitude z_0, the same for all sizes, is no matter.
fn crossover(out: &mut Findings, ensemble: &Ensemble) {
    let (x, name) = match ensemble.model {
        Model::Sp => (Quantity::DeltaPhi, "Δφ"),
        Model::Dp => (Quantity::DeltaRho, "Δρ"),
    };
    let sizes: Vec<&Packings> = ensemble.sizes.iter().filter(|s| s.all.len() >= ENOUGH).collect();
    if sizes.len() < 2 {
        return;
    }
    // Δ N² of a few: about one more contact in the whole packing
    let reach = 3.0;
    let z = Quantity::DeltaContactNumber;
    let tables: Vec<[Vec<Vec<f64>>; 2]> =
        sizes.iter().map(|s| [x, z].map(|q| s.values(|p, k| p.value(q, k)))).collect();
    let at = |drawn: &[Vec<usize>], j: usize| {
        let n = sizes[j].n_particles as f64;
        let (mut products, mut squares) = (0.0, 0.0);
        let [deltas, contacts] = &tables[j];
        for k in 1..sizes[j].n_samples() {
            let of = |table: &[Vec<f64>]| mean(drawn[j].iter().map(|&m| table[m][k]));
            let (delta, dz) = (of(deltas), of(contacts));
            if delta * n * n < reach && dz.is_finite() {
                // least squares through the origin
                products += delta * dz;
                squares += delta * delta;
            }
        }
        (squares / products).powi(2)
    };
    let counts: Vec<usize> = sizes.iter().map(|s| s.all.len()).collect();
    let found = bootstrap(&counts, RESAMPLES, |drawn| {
        let stars: Vec<f64> = (0..sizes.len()).map(|j| at(drawn, j)).collect();
        let n: Vec<f64> = sizes.iter().map(|s| s.n_particles as f64).collect();
        let curve = Curve { x: n, error: stars.iter().map(|s| 0.1 * s.abs()).collect(), y: stars };
        power_law(&curve.within([0.0, f64::INFINITY])).map_or(vec![f64::NAN], |[_, e]| vec![-e])
    });
    let law = format!("crossover {name}* ∝ N^−μ from Δz ∝ {name} where {name} N² < {reach}");
    out.add("μ", &law, found[0], Some(paper::CROSSOVER));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::study::data::ensembles;
    use crate::study::record::Record;
    use crate::study::store::Store;

    /// Two sizes of a hundred packings, whose onsets spread by 0.016 and 0.008 and are known to a bracket.
    fn study(bracket: f64) -> Ensemble {
        let onset = |n: u64, seed: u64| 0.83 + 0.32 / (n as f64).sqrt() * ((seed as f64 + 0.5) / 100.0 - 0.5);
        let seeds = [32, 128].into_iter().flat_map(|n| (0..100).map(move |seed| (n, seed)));
        let record = |(n_particles, seed)| {
            let above = (onset(n_particles, seed) / bracket).ceil() * bracket;
            Record {
                ensemble: "sp".into(),
                n_particles,
                seed,
                scene: format!("model = 'sp'\nn_particles = {n_particles}"),
                onset: Some([above, above - bracket, 1e-6, 1.0]),
                ..Record::default()
            }
        };
        ensembles(&Store { records: seeds.map(record).collect() }).unwrap().remove(0)
    }

    #[test]
    fn onsets_that_a_search_does_not_resolve_are_not_fitted() {
        let theta = |bracket: f64| of_ensemble(&study(bracket)).get("θ", "spread");
        assert!((theta(1e-4).unwrap().value - 0.5).abs() < 0.01);
        assert!((theta(1e-3).unwrap().value - 0.5).abs() < 0.05);
        assert_eq!(theta(1e-2), None);
    }
}
