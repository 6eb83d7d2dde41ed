//! What deformable particles have at given packing fractions, whatever their onsets: where they part from soft disks, and
//! what they come to near confluence.

use super::data::{Packing, Packings, Quantity};
use super::findings::{FEWEST, Finding, Findings, RESAMPLES};
use crate::statistics::{bootstrap, mean};

/// Where they are compared with disks.
const PARTING: [f64; 5] = [0.86, 0.88, 0.9, 0.92, 0.94];
/// Where most of the box is covered.
const DENSE: [f64; 4] = [0.92, 0.95, 0.98, 0.99];

/// Means over packings of one size, and over their differences from `twins`, which started from the same centres.
pub fn at_densities(packings: &Packings, twins: Option<&Packings>) -> Findings {
    let title = format!("{}, N = {}, at packing fractions", packings.ensemble, packings.n_particles);
    let mut out = Findings { title, rows: Vec::new() };
    let mut add = |symbol: &str, law: String, values: Vec<f64>| {
        let known: Vec<f64> = values.into_iter().filter(|x| !x.is_nan()).collect();
        if known.len() >= FEWEST {
            let found = bootstrap(&[known.len()], RESAMPLES, |d| vec![mean(d[0].iter().map(|&k| known[k]))])[0];
            out.rows.push(Finding { symbol: symbol.into(), law, found, paper: None });
        }
    };
    let pairs: Vec<[&Packing; 2]> = twins
        .into_iter()
        .flat_map(|twins| twins.all.iter())
        .filter_map(|disks| packings.all.iter().find(|p| p.seed == disks.seed).map(|p| [p, disks]))
        .collect();
    let differences = [("z − z(SP)", Quantity::ContactNumber), ("P_3 − P_3(SP)", Quantity::Voids(3))];
    for (symbol, quantity) in differences {
        for rho in PARTING {
            let law = format!("difference from soft disks of the same start, mean at ρ = {rho}");
            add(symbol, law, pairs.iter().map(|pair| pair[0].at(quantity, rho) - pair[1].at(quantity, rho)).collect());
        }
    }
    let values = [("z", Quantity::ContactNumber, 0.0), ("𝒜", Quantity::Shape, 1.0), ("G", Quantity::ShearModulus, 0.0)];
    for (symbol, quantity, base) in values {
        for rho in DENSE {
            add(
                symbol,
                format!("mean at ρ = {rho}"),
                packings.all.iter().map(|p| base + p.at(quantity, rho)).collect(),
            );
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use crate::study::data::ensembles;
    use crate::study::record::Record;
    use crate::study::report::findings;
    use crate::study::store::Store;

    /// Five pairs that part at ρ = 0.88, where deformable particles gain two contacts more for each 0.1.
    #[test]
    fn twins_are_compared_at_one_density() {
        let rho = |model: &str, k: usize| if model == "sp" { 0.85 + 0.03 * k as f64 } else { 0.84 + 0.04 * k as f64 };
        let contacts = |model: &str, seed: u64, rho: f64| {
            4.0 + seed as f64 + 10.0 * (rho - 0.84) + if model == "sp" { 0.0 } else { 20.0 * (rho - 0.88).max(0.0) }
        };
        let record = |(model, seed): (&str, u64)| {
            let of = |value: &dyn Fn(f64) -> f64| (0..5).map(|k| value(rho(model, k))).collect();
            Record {
                ensemble: model.into(),
                n_particles: 64,
                seed,
                scene: format!("model = '{model}'\nn_particles = 64"),
                samples: vec![
                    ("packing_fraction".into(), of(&|rho| rho)),
                    ("contact_number".into(), of(&|rho| contacts(model, seed, rho))),
                ],
                ..Record::default()
            }
        };
        let all = ["sp", "dp"].into_iter().flat_map(|model| (1..=5).map(move |seed| (model, seed)));
        let found = findings(&ensembles(&Store { records: all.map(record).collect() }).unwrap());
        let at = found.iter().find(|f| f.title == "dp, N = 64, at packing fractions").unwrap();
        let difference = |rho: &str| {
            let row = at.rows.iter().find(|row| row.symbol == "z − z(SP)" && row.law.ends_with(rho));
            row.map(|row| row.found.value)
        };
        for (rho, expected) in [("0.86", 0.0), ("0.88", 0.0), ("0.9", 0.4), ("0.94", 1.2)] {
            assert!((difference(&format!("= {rho}")).unwrap() - expected).abs() < 1e-12, "{rho}");
        }
        let contacts = at.rows.iter().find(|row| row.symbol == "z" && row.law.ends_with("0.95")).unwrap();
        assert!((contacts.found.value - 9.5).abs() < 1e-12);
    }
}
